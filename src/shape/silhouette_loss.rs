//! The silhouettes' loss: a pixel's coverage against how near its ray comes to the surface.
//!
//! Coverage is c = clamp(½ − φ/(w ρ), 0, 1), where φ is the least signed distance along the ray, ρ the size of a pixel there
//! and w a width in pixels. The loss is Huber's of c less the mask's coverage; its slope moves the surface at the point
//! where the ray comes nearest.

use crate::fit::cameras::AlignedRow;
use crate::math::ray::Ray;
use crate::pipeline::pool::pool_index;
use crate::sample::pixel::PixelOf;
use crate::sdf::SdfGrid;
use crate::shape::adjoint::FieldAdjoint;
use crate::view::Camera;
use bevy_ecs::prelude::Component;
use glam::{Vec2, Vec3};
use rayon::prelude::*;

/// Where Huber's loss turns from a square to a line: beyond it a mask is not believed the more for being wrong.
const HUBER: f32 = 0.25;

pool_index! {
    /// Row of a pixel near an outline, in the order in which a fit visits them.
    OutlineIndex("silhouette sample");
}

/// A pixel near an outline.
#[derive(Component, Clone, Copy, Debug, PartialEq)]
pub struct SilhouetteSample {
    /// Which pixel it is.
    pub pixel: PixelOf,
    /// Its camera ray, world space.
    pub ray: Ray,
    /// Signed distance to the mask's outline in pixels, negative inside.
    pub outline: f32,
    /// That distance's slope in the image, per pixel.
    pub outline_slope: Vec2,
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
    let slopes: Vec<Option<(Vec3, f32)>> =
        samples.par_iter().with_min_len(64).map(|sample| slope(grid, sample, width)).collect();
    let each = weight / samples.len().max(1) as f32;
    for (position, slope) in slopes.into_iter().flatten() {
        adjoint.add_value(grid, position, each * slope);
    }
}

/// Where a sample's ray comes nearest, and the loss's slope with respect to the distance there.
fn slope(grid: &SdfGrid, sample: &SilhouetteSample, width: f32) -> Option<(Vec3, f32)> {
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

/// Pixels from an outline within which it says where the camera is.
const ALIGNED_REACH: f32 = 3.0;

/// How far an outline is from that of the surface, and what a change of the camera, or of the object around `center`, would
/// make of it.
pub fn aligned_outline(
    grid: &SdfGrid,
    camera: &Camera,
    center: Vec3,
    sample: &SilhouetteSample,
) -> Option<AlignedRow> {
    if sample.outline.abs() > ALIGNED_REACH {
        return None;
    }
    let far = (grid.origin - sample.ray.origin).length() + grid.spacing * grid.side as f32;
    let least = grid.least_distance(&sample.ray, -2.0 * ALIGNED_REACH * sample.pixel_size * far)?;
    let pixels = least.value / (sample.pixel_size * least.distance);
    let point = sample.ray.origin + sample.ray.direction * least.distance;
    let row = AlignedRow::new(camera, point, center, sample.outline_slope, sample.outline - pixels);
    row.filter(|_| pixels.abs() < ALIGNED_REACH)
}
