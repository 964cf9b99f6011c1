//! The silhouette loss: the coverage of a pixel against the least distance of its ray to the surface.
//!
//! Coverage is c = clamp(½ − φ/(w ρ), 0, 1), where φ is the least signed distance along the ray, ρ the size of a pixel there
//! and w a width in pixels. The loss is Huber's of c minus the coverage of the mask; its gradient acts on the surface at the point
//! where the ray is nearest.

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

/// Residual at which the Huber loss changes from quadratic to linear, which limits the influence of wrong masks.
const HUBER: f32 = 0.25;

pool_index! {
    /// Row of a pixel near a silhouette, in the order in which a fit visits them.
    SilhouetteIndex("silhouette sample");
}

/// A pixel near a silhouette.
#[derive(Component, Clone, Copy, Debug, PartialEq)]
pub struct SilhouetteSample {
    /// The pixel.
    pub pixel: PixelOf,
    /// Its camera ray, world space.
    pub ray: Ray,
    /// Signed distance to the silhouette of the mask in pixels, negative inside.
    pub distance: f32,
    /// Gradient of that distance in the image, per pixel.
    pub distance_gradient: Vec2,
    /// Coverage of the pixel, in [0, 1].
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
    let derivatives: Vec<Option<(Vec3, f32)>> =
        samples.par_iter().with_min_len(64).map(|sample| derivative(grid, sample, width)).collect();
    let each = weight / samples.len().max(1) as f32;
    for (position, derivative) in derivatives.into_iter().flatten() {
        adjoint.add_value(grid, position, each * derivative);
    }
}

/// The point where the ray of a sample is nearest, and the derivative of the loss with respect to the distance there.
fn derivative(grid: &SdfGrid, sample: &SilhouetteSample, width: f32) -> Option<(Vec3, f32)> {
    let far = (grid.origin - sample.ray.origin).length() + grid.spacing * grid.side as f32;
    let enough = -width * sample.pixel_size * far;
    let least = grid.least_distance(&sample.ray, enough)?;
    let scale = width * sample.pixel_size * least.distance;
    let coverage = (0.5 - least.value / scale).clamp(0.0, 1.0);
    let residual = coverage - sample.coverage;
    // A wrong pixel keeps its derivative where coverage is clamped, so that a missing part can grow back.
    let right = residual == 0.0 || least.value.abs() > 8.0 * scale.max(grid.spacing);
    (!right).then(|| {
        let position = sample.ray.origin + sample.ray.direction * least.distance;
        (position, -residual.clamp(-HUBER, HUBER) / scale)
    })
}

/// Distance from a silhouette, in pixels, within which it is used for camera alignment.
const ALIGNED_REACH: f32 = 3.0;

/// The distance between the silhouettes of the mask and of the surface, and its derivatives with respect to the camera, and to the
/// object around `center`.
pub fn aligned_silhouette(
    grid: &SdfGrid,
    camera: &Camera,
    center: Vec3,
    sample: &SilhouetteSample,
) -> Option<AlignedRow> {
    if sample.distance.abs() > ALIGNED_REACH {
        return None;
    }
    let far = (grid.origin - sample.ray.origin).length() + grid.spacing * grid.side as f32;
    let least = grid.least_distance(&sample.ray, -2.0 * ALIGNED_REACH * sample.pixel_size * far)?;
    let pixels = least.value / (sample.pixel_size * least.distance);
    let point = sample.ray.origin + sample.ray.direction * least.distance;
    let row = AlignedRow::new(camera, point, center, sample.distance_gradient, sample.distance - pixels);
    row.filter(|_| pixels.abs() < ALIGNED_REACH)
}
