//! Volume rendering of a ray through a [`RadianceField`], and its adjoint.
//!
//! With the density of a sample σ = softplus(s) per cell and the step Δ in cells, its opacity is α = 1 − exp(−σΔ), what reaches it
//! T = Π (1 − α) over the samples before it, and the color of the ray Σ T α c (Max, "Optical Models for Direct Volume Rendering",
//! TVCG 1995).

use super::radiance_field::RadianceField;
use crate::math::ray::Ray;
use glam::{Vec3, Vec4, Vec4Swizzles};

/// Length of a step, in cells.
const STEP: f32 = 0.6;
/// How far before the surface a ray begins, in cells.
const BEFORE: f32 = 1.0;
/// Transmittance below which a ray ends, and the most samples that it has.
const DARK: f32 = 1e-4;
const MOST_SAMPLES: usize = 400;
/// Opacity of a sample above which its color counts.
const FAINT: f32 = 1e-5;

/// A point of a ray, as rendering it has met it.
#[derive(Clone, Copy, Debug)]
pub struct FieldSample {
    rows: [u32; 8],
    weights: [f32; 8],
    /// Color, and density before the softplus.
    value: Vec4,
    opacity: f32,
    /// Derivative of the softplus.
    slope: f32,
    /// What reaches the sample.
    transmittance: f32,
    /// Distance along the ray, world units.
    distance: f32,
}

/// Renders a ray whose surface is `surface` world units away: its color and what passes through the whole object. `jitter` in [0, 1) is the
/// share of a step by which samples are shifted. Leaves the samples in `samples`.
pub fn march(
    field: &RadianceField,
    ray: &Ray,
    surface: f32,
    jitter: f32,
    samples: &mut Vec<FieldSample>,
) -> (Vec3, f32) {
    samples.clear();
    let (mut color, mut transmittance) = (Vec3::ZERO, 1.0);
    let step = STEP * field.spacing;
    let (first, exit) = (surface - BEFORE * field.spacing, field.exit(ray));
    for k in 0..MOST_SAMPLES {
        let distance = first + (k as f32 + jitter) * step;
        if distance > exit {
            break;
        }
        let Some(sample) = sample_at(field, ray, distance, transmittance) else { continue };
        color += transmittance * sample.opacity * sample.value.xyz();
        transmittance *= 1.0 - sample.opacity;
        samples.push(sample);
        if transmittance < DARK {
            break;
        }
    }
    (color, transmittance)
}

/// The sample at a distance; `None` outside the field.
#[inline]
fn sample_at(field: &RadianceField, ray: &Ray, distance: f32, transmittance: f32) -> Option<FieldSample> {
    let (rows, weights) = field.corners_inside(ray.origin + distance * ray.direction)?;
    let value = (0..8).map(|k| field.values[rows[k] as usize] * weights[k]).sum::<Vec4>();
    let (density, slope) = softplus(value.w);
    let opacity = 1.0 - (-density * STEP).exp();
    Some(FieldSample { rows, weights, value, opacity, slope, transmittance, distance })
}

/// Adds the gradient of the field's values to `gradient`, from those of a ray's color and of what passes through.
pub fn pull_back(samples: &[FieldSample], color: Vec3, passing: f32, gradient: &mut [Vec4]) {
    let last = samples.last().map_or(1.0, |s| s.transmittance * (1.0 - s.opacity));
    let mut behind = passing * last;
    for sample in samples.iter().rev() {
        let shown = color.dot(sample.value.xyz());
        let opacity = sample.transmittance * shown - behind / (1.0 - sample.opacity).max(DARK);
        behind += sample.transmittance * sample.opacity * shown;
        let density = opacity * (1.0 - sample.opacity) * STEP * sample.slope;
        let weight = sample.transmittance * sample.opacity;
        let own = if weight > FAINT { weight * color } else { Vec3::ZERO }.extend(density);
        for (row, share) in sample.rows.iter().zip(sample.weights) {
            gradient[*row as usize] += own * share;
        }
    }
}

/// Distance at which half of the light of a ray is stopped; `None` if more than that passes.
pub fn depth(samples: &[FieldSample]) -> Option<f32> {
    let stopped = |sample: &&FieldSample| sample.transmittance * (1.0 - sample.opacity) < 0.5;
    samples.iter().find(stopped).map(|sample| sample.distance)
}

/// The softplus and its derivative. Without the exact logarithm near 1, which takes twice as long: densities are not as small.
fn softplus(x: f32) -> (f32, f32) {
    if x > 15.0 {
        return (x, 1.0);
    }
    let power = x.exp();
    ((1.0 + power).ln(), power / (1.0 + power))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sdf::SdfGrid;

    #[test]
    fn the_adjoint_of_a_ray_is_its_finite_difference() {
        let grid = SdfGrid::from_fn(Vec3::ZERO, 1.0, 6, |p| p.length() - 0.7);
        let mut field = RadianceField::new(&grid, Vec3::splat(0.4));
        for row in 1..field.values.len() {
            let p = field.position(row);
            field.values[row] +=
                Vec4::new((3.0 * p.x).sin(), p.y, (2.0 * p.z).cos(), 2.0 * (4.0 * p.x + p.z).sin());
        }
        let ray =
            Ray { origin: Vec3::new(0.1, 0.2, 3.0), direction: Vec3::new(0.02, -0.05, -1.0).normalize() };
        let (by_color, by_passing) = (Vec3::new(0.7, -0.3, 0.5), 0.9);
        let mut samples = Vec::new();
        let mut loss = |field: &RadianceField| {
            let (color, passing) = march(field, &ray, 2.4, 0.3, &mut samples);
            f64::from(by_color.dot(color) + by_passing * passing)
        };
        let mut gradient = vec![Vec4::ZERO; field.values.len()];
        let mut marched = Vec::new();
        let (_, passing) = march(&field, &ray, 2.4, 0.3, &mut marched);
        assert!(passing > 0.01 && marched.len() > 8, "{passing} {}", marched.len());
        pull_back(&marched, by_color, by_passing, &mut gradient);
        let touched: Vec<usize> = (1..gradient.len()).filter(|row| gradient[*row] != Vec4::ZERO).collect();
        assert!(touched.len() > 20);
        for row in touched {
            for axis in Vec4::AXES {
                let mut moved = [field.clone(), field.clone()];
                moved[0].values[row] += 4e-2 * axis;
                moved[1].values[row] -= 4e-2 * axis;
                let numeric = (loss(&moved[0]) - loss(&moved[1])) / 8e-2;
                let exact = f64::from(gradient[row].dot(axis));
                assert!(
                    (numeric - exact).abs() < 3e-5 + 3e-3 * exact.abs(),
                    "{row} {axis}: {numeric} {exact}"
                );
            }
        }
    }

    #[test]
    fn rays_leave_out_only_what_is_outside() {
        let grid = SdfGrid::from_fn(Vec3::ZERO, 1.0, 10, |p| p.length() - 0.6);
        let field = RadianceField::new(&grid, Vec3::ONE);
        let ray = Ray { origin: Vec3::new(0.1, 0.2, 3.0), direction: Vec3::NEG_Z };
        assert!((field.exit(&ray) - 4.0).abs() < 1e-5);
        for k in 0..200 {
            let point = ray.origin + 0.03 * k as f32 * ray.direction;
            let (rows, weights) = field.corners(point);
            assert_eq!(field.corners_inside(point), (rows != [0; 8]).then_some((rows, weights)), "{point}");
        }
    }
}
