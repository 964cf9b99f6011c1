//! Rays against the zero level of an SDF: sphere tracing (Hart 1996) to a bracket, then bracketed root finding.

use crate::math::ray::Ray;
use crate::sdf::grid::SdfGrid;

/// Step length relative to the distance: values between vertices are interpolated and may be too large.
const STEP: f32 = 0.9;
/// Least step, in cells. A thinner part could be stepped over, but the grid cannot represent one.
const MIN_STEP: f32 = 0.25;
/// Rounds of root finding (Illinois, Dowell and Jarratt 1971) in a bracket of at most a few cells.
const REFINEMENTS: usize = 4;

/// The least distance of a ray to the surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LeastDistance {
    /// Distance along the ray, world units.
    pub distance: f32,
    /// The SDF's value there; negative inside.
    pub value: f32,
}

impl SdfGrid {
    /// The interval of the ray inside the cube of the grid; `None` if it is empty beyond `min_distance`.
    fn span(&self, ray: &Ray, min_distance: f32) -> Option<(f32, f32)> {
        let high = self.position(glam::UVec3::splat(self.side - 1));
        let inverse = ray.direction.recip();
        let (a, b) = ((self.origin - ray.origin) * inverse, (high - ray.origin) * inverse);
        // A ray along a face gives 0 · ∞ = NaN; min and max then return the other operand.
        let (near, far) = (a.min(b).max_element().max(min_distance), a.max(b).min_element());
        (near < far).then_some((near, far))
    }

    /// Distance along the ray to the first point where it enters the surface, beyond `min_distance`.
    pub fn first_crossing(&self, ray: &Ray, min_distance: f32) -> Option<f32> {
        let (near, far) = self.span(ray, min_distance)?;
        let at = |t: f32| self.value(ray.origin + ray.direction * t);
        let least = MIN_STEP * self.spacing;
        let (mut t, mut value) = (near, at(near));
        while t < far {
            let next = t + (STEP * value.abs()).max(least);
            let next_value = at(next);
            if value > 0.0 && next_value <= 0.0 {
                return Some(root(at, (t, value), (next, next_value)));
            }
            (t, value) = (next, next_value);
        }
        None
    }

    /// The point of the ray with the least value, up to the first local minimum below `enough` or the exit from the grid.
    pub fn least_distance(&self, ray: &Ray, enough: f32) -> Option<LeastDistance> {
        let (near, far) = self.span(ray, 0.0)?;
        let least_step = MIN_STEP * self.spacing;
        let mut least = LeastDistance { distance: near, value: f32::INFINITY };
        let mut t = near;
        while t < far {
            let value = self.value(ray.origin + ray.direction * t);
            if value < least.value {
                least = LeastDistance { distance: t, value };
            } else if least.value < 0.0 {
                break;
            }
            if least.value < enough {
                break;
            }
            t += (STEP * value).max(least_step);
        }
        Some(least)
    }
}

/// The root of `at` between a positive and a non-positive value.
fn root(at: impl Fn(f32) -> f32, mut outside: (f32, f32), mut inside: (f32, f32)) -> f32 {
    let secant = |a: (f32, f32), b: (f32, f32)| a.0 + (b.0 - a.0) * (a.1 / (a.1 - b.1)).clamp(0.0, 1.0);
    for _ in 0..REFINEMENTS {
        let t = secant(outside, inside);
        let value = at(t);
        if value > 0.0 {
            outside = (t, value);
            inside.1 *= 0.5;
        } else {
            inside = (t, value);
            outside.1 *= 0.5;
        }
    }
    secant(outside, inside)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    fn ball() -> SdfGrid {
        SdfGrid::from_fn(Vec3::ZERO, 1.0, 64, |p| p.length() - 0.7)
    }

    #[test]
    fn a_ray_meets_a_ball_where_it_should() {
        let grid = ball();
        for (x, y) in [(0.0, 0.0), (0.3, 0.2), (0.5, -0.4), (0.0, 0.69)] {
            let ray = Ray { origin: Vec3::new(x, y, -5.0), direction: Vec3::Z };
            let exact = 5.0 - f32::sqrt(0.49 - x * x - y * y);
            let found = grid.first_crossing(&ray, 0.0).unwrap();
            assert!((found - exact).abs() < 4e-3, "{found} {exact}");
            assert!(grid.value(ray.origin + found * ray.direction).abs() < 1e-5);
        }
        let past = Ray { origin: Vec3::new(0.8, 0.0, -5.0), direction: Vec3::Z };
        assert_eq!(grid.first_crossing(&past, 0.0), None);
        let away = Ray { origin: Vec3::new(0.0, 0.0, -5.0), direction: -Vec3::Z };
        assert_eq!(grid.first_crossing(&away, 0.0), None);
    }

    #[test]
    fn a_sheet_two_cells_thick_is_met_from_any_side() {
        let grid = SdfGrid::from_fn(Vec3::ZERO, 1.0, 64, |p| (p.y - 0.3).abs() - 1.0 / 32.0);
        for i in 0..200 {
            let angle = i as f32 * 0.0314;
            let origin = Vec3::new(2.0 * angle.cos(), 3.0 - 0.01 * i as f32, 2.0 * angle.sin());
            let ray = Ray { origin, direction: (Vec3::new(0.01, 0.29, 0.0) - origin).normalize() };
            assert!(grid.first_crossing(&ray, 0.0).is_some(), "{i}");
        }
    }

    #[test]
    fn the_least_distance_is_that_of_the_nearest_point() {
        let grid = ball();
        for height in [0.6, 0.68, 0.75, 0.9] {
            let ray = Ray { origin: Vec3::new(0.0, height, -5.0), direction: Vec3::Z };
            let least = grid.least_distance(&ray, -0.5).unwrap();
            assert!((least.value - (height - 0.7)).abs() < 3e-3, "{height}: {least:?}");
            assert!((least.distance - 5.0).abs() < 0.1, "{height}: {least:?}");
        }
    }
}
