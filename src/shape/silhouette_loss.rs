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
use crate::shape::field_adjoint::FieldAdjoint;
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
pub(crate) fn add_silhouettes(
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
pub(crate) fn aligned_silhouette(
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::view::ViewIndex;

    const WIDTH: f32 = 2.0;
    /// Size of a pixel at distance 1; the camera is 3 away.
    const PIXEL: f32 = 0.02;
    const EDGE: f32 = 0.6;

    /// A square plate across the z axis, of half the thickness `half`.
    fn plate(half: f32, edge: f32) -> SdfGrid {
        SdfGrid::from_fn(Vec3::ZERO, 1.0, 80, |p| {
            let out = p.abs() - Vec3::new(edge, edge, half);
            out.max(Vec3::ZERO).length() + out.max_element().min(0.0)
        })
    }

    fn in_mask(x: f32) -> f32 {
        if x < EDGE { 1.0 } else { 0.0 }
    }

    /// A ray down on the plate, at `x`; the edge of the mask is at [`EDGE`].
    fn sample(x: f32) -> SilhouetteSample {
        SilhouetteSample {
            pixel: PixelOf { view: ViewIndex(0), pixel: 0 },
            ray: Ray { origin: Vec3::new(x, 0.013, 3.0), direction: -Vec3::Z },
            distance: (x - EDGE) / (3.0 * PIXEL),
            distance_gradient: Vec2::X,
            coverage: in_mask(x),
            pixel_size: PIXEL,
        }
    }

    #[test]
    fn what_a_mask_shows_and_the_surface_lacks_pulls_outward_and_the_reverse_inward() {
        let pull =
            |grid: &SdfGrid, x: f32| derivative(grid, &sample(x), WIDTH).map(|(_, derivative)| derivative);
        assert!(pull(&plate(0.02, 0.45), 0.55).unwrap() > 0.0);
        assert!(pull(&plate(0.02, 0.75), 0.65).unwrap() < 0.0);
        assert!(pull(&plate(0.2, 0.75), 0.65).unwrap() < 0.0);
    }

    #[test]
    fn the_derivative_is_that_of_the_loss() {
        let loss = |grid: &SdfGrid, x: f32| {
            let least = grid.least_distance(&sample(x).ray, -1.0).unwrap();
            let scale = WIDTH * PIXEL * least.distance;
            let residual = ((0.5 - least.value / scale).clamp(0.0, 1.0) - in_mask(x)).abs();
            if residual < HUBER { 0.5 * residual * residual } else { HUBER * (residual - 0.5 * HUBER) }
        };
        // The surface is outside of the mask's edge, and inside.
        for (radius, x) in [(0.62, 0.61), (0.66, 0.63), (0.58, 0.61)] {
            let ball = |by: f32| SdfGrid::from_fn(Vec3::ZERO, 1.0, 80, |p| p.length() - radius + by);
            let moved = |by: f32| f64::from(loss(&ball(by), x));
            let expected = (moved(1e-3) - moved(-1e-3)) / 2e-3;
            let found = f64::from(derivative(&ball(0.0), &sample(x), WIDTH).unwrap().1);
            assert!((found - expected).abs() < 0.05 * expected.abs() + 1e-3, "{found} {expected}");
        }
    }
}
