//! The silhouettes' loss: a pixel's coverage against how near its ray comes to the surface.
//!
//! Coverage is c = clamp(½ − φ/(w ρ), 0, 1), where φ is the least signed distance along the ray, ρ the size of a pixel there
//! and w a width in pixels. The loss is Huber's of c less the mask's coverage; its slope moves the surface at the point
//! where the ray comes nearest.

use super::adjoint::FieldAdjoint;
use crate::math::ray::Ray;
use crate::surface::sdf::SdfGrid;
use bevy_ecs::prelude::Component;
use rayon::prelude::*;

/// Where Huber's loss turns from a square to a line: beyond it a mask is not believed the more for being wrong.
const HUBER: f32 = 0.25;

/// A pixel near an outline.
#[derive(Component, Clone, Copy, Debug, PartialEq)]
pub struct SilhouetteSample {
    /// Its camera ray, world space.
    pub ray: Ray,
    /// Covered part of the pixel, in [0, 1].
    pub coverage: f32,
    /// Size of a pixel at distance 1.
    pub pixel_size: f32,
}

/// Adds the adjoint of `weight` times the mean loss of `samples`, in their order.
pub fn add_silhouettes(
    grid: &SdfGrid,
    samples: &[SilhouetteSample],
    width: f32,
    weight: f32,
    adjoint: &mut FieldAdjoint,
) {
    let slopes: Vec<Option<(glam::Vec3, f32)>> =
        samples.par_iter().with_min_len(64).map(|sample| slope(grid, sample, width)).collect();
    let each = weight / samples.len().max(1) as f32;
    for (position, slope) in slopes.into_iter().flatten() {
        adjoint.add_value(grid, position, each * slope);
    }
}

/// Where a sample's ray comes nearest, and the loss's slope with respect to the distance there.
fn slope(grid: &SdfGrid, sample: &SilhouetteSample, width: f32) -> Option<(glam::Vec3, f32)> {
    let far = (grid.origin - sample.ray.origin).length() + grid.spacing * grid.side as f32;
    let enough = -width * sample.pixel_size * far;
    let least = grid.least_distance(&sample.ray, enough)?;
    let scale = width * sample.pixel_size * least.distance;
    let coverage = (0.5 - least.value / scale).clamp(0.0, 1.0);
    let residual = coverage - sample.coverage;
    // Where coverage is clamped a wrong pixel still pulls, or a lost part could never come back.
    let right = residual == 0.0 || least.value.abs() > 8.0 * scale.max(grid.spacing);
    (!right).then(|| {
        let position = sample.ray.origin + sample.ray.direction * least.distance;
        (position, -residual.clamp(-HUBER, HUBER) / scale)
    })
}
