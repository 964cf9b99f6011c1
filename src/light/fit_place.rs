//! Where to put new lobes: the directions and sharpnesses that would lower the error most, one at a time.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::fit_kernel::{FitLobe, TILE, Tile, residuals};
use super::fit_solve::Bounds;
use crate::math::sg::sphere_integral;

/// Sharpnesses tried, each about 2.5 times the one before.
const SHARPNESSES: [f64; 9] = [1.5, 4.0, 10.0, 25.0, 60.0, 150.0, 400.0, 1000.0, 2500.0];

/// A possible new lobe: its inner products with what is left over (per channel) and with itself.
#[derive(Clone, Copy, Debug)]
struct Candidate {
    axis: DVec3,
    sharpness: f64,
    inner: [f64; 3],
    norm: f64,
}

/// Up to `count` new lobes for what `lobes` leave over, best first, at `axes` (possible directions).
///
/// Matching pursuit (Mallat and Zhang 1993) on the residual r: a candidate's gain is Σ_c max(0, ⟨r_c, G⟩)²/⟨G, G⟩; the
/// residual is measured once, and what a chosen lobe takes from the others is computed from the integral of SG products.
pub fn place(
    tiles: &[Tile<f32>],
    lobes: &[FitLobe],
    axes: &[Vec3],
    count: usize,
    bounds: Bounds,
) -> Vec<FitLobe> {
    let residual = residuals(tiles, lobes);
    let usable = |s: &f64| (bounds.dullest..=bounds.sharpest).contains(s);
    let sharpnesses: Vec<f64> = SHARPNESSES.into_iter().filter(usable).collect();
    let at_axis = |&axis: &Vec3| -> Vec<Candidate> {
        sharpnesses.iter().map(|&s| candidate(tiles, &residual, axis, s)).collect()
    };
    let mut candidates: Vec<Candidate> = axes.par_iter().flat_map_iter(at_axis).collect();
    let mut chosen = Vec::new();
    while chosen.len() < count {
        // The first of equals, so that the result is one only.
        let better = |best: Candidate, c: &Candidate| if c.gain() > best.gain() { *c } else { best };
        let Some(best) = candidates.first().map(|first| candidates.iter().fold(*first, better)) else {
            break;
        };
        if best.gain() <= 0.0 {
            break;
        }
        candidates.par_iter_mut().with_min_len(1024).for_each(|c| c.lose(&best));
        chosen.push(FitLobe::new(best.axis, best.sharpness, best.amplitude()));
    }
    chosen
}

impl Candidate {
    /// The best amplitude on its own.
    fn amplitude(&self) -> [f64; 3] {
        self.inner.map(|i| if self.norm > 0.0 { (i / self.norm).max(0.0) } else { 0.0 })
    }

    /// By how much it would lower the error on its own.
    fn gain(&self) -> f64 {
        self.amplitude().iter().map(|a| a * a * self.norm).sum()
    }

    /// Takes from its inner products what `other` explains, once that is chosen.
    fn lose(&mut self, other: &Self) {
        let overlap = mean_product(self.axis, self.sharpness, other.axis, other.sharpness);
        for (inner, amplitude) in self.inner.iter_mut().zip(other.amplitude()) {
            *inner -= amplitude * overlap;
        }
    }
}

/// Mean over the sphere of the product of two unit-amplitude SGs: that product is an SG of sharpness
/// L = |λ₁ξ₁ + λ₂ξ₂| and amplitude e^(L − λ₁ − λ₂).
fn mean_product(a: DVec3, sharpness_a: f64, b: DVec3, sharpness_b: f64) -> f64 {
    let sharpness = (a * sharpness_a + b * sharpness_b).length();
    let peak = (sharpness - sharpness_a - sharpness_b).exp();
    peak * sphere_integral(sharpness) / (4.0 * std::f64::consts::PI)
}

fn candidate(tiles: &[Tile<f32>], residual: &[[[f32; TILE]; 3]], axis: Vec3, sharpness: f64) -> Candidate {
    let mut inner = [0.0_f64; 3];
    let mut norm = 0.0;
    let unit = axis.as_dvec3().normalize();
    for (tile, residual) in tiles.iter().zip(residual) {
        if !tile.is_reached(axis, sharpness as f32 * 2.0) {
            continue;
        }
        let values = tile.values(unit.to_array(), sharpness);
        norm += lanes_product(&values, &values);
        for (sum, channel) in inner.iter_mut().zip(residual) {
            *sum -= lanes_product(&values, channel);
        }
    }
    Candidate { axis: unit, sharpness, inner, norm }
}

fn lanes_product(a: &[f32; TILE], b: &[f32; TILE]) -> f64 {
    let mut sums = [0.0_f32; 8];
    for (a, b) in a.as_chunks::<8>().0.iter().zip(b.as_chunks::<8>().0) {
        for k in 0..8 {
            sums[k] += a[k] * b[k];
        }
    }
    f64::from(sums.iter().sum::<f32>())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::fibonacci::fibonacci_axes;
    use crate::light::fit_kernel::tiles_of;
    use crate::light::{EnvironmentMap, LightLobe};

    #[test]
    fn two_lights_are_found_brightest_first() {
        let light = |axis: Vec3, sharpness, amplitude| LightLobe { axis, sharpness, amplitude };
        let lights = [
            light(Vec3::new(0.6, 0.0, 0.8), 60.0, Vec3::splat(3.0)),
            light(Vec3::new(-0.8, 0.6, 0.0), 10.0, Vec3::new(9.0, 3.0, 1.0)),
        ];
        let map = EnvironmentMap::from_directions(64, 32, |d| lights.iter().map(|l| l.radiance(d)).sum());
        let bounds = Bounds { dullest: 0.1, sharpest: 500.0 };
        let found = place(&tiles_of(&map), &[], &fibonacci_axes(2000), 2, bounds);
        assert_eq!(found.len(), 2);
        for (lobe, light) in found.iter().zip([lights[1], lights[0]]) {
            let axis = DVec3::from_array(lobe.axis).as_vec3();
            assert!(axis.angle_between(light.axis) < 0.06, "{axis}");
            assert_eq!(lobe.sharpness as f32, light.sharpness);
            assert!((lobe.amplitude[1] as f32 / light.amplitude.y - 1.0).abs() < 0.1);
        }
        assert!(place(&tiles_of(&map.scaled(Vec3::ZERO)), &[], &fibonacci_axes(50), 2, bounds).is_empty());
    }

    #[test]
    fn the_mean_of_a_product_is_its_quadrature() {
        let (a, b) = (DVec3::new(0.6, 0.0, 0.8), DVec3::new(0.0, 0.6, 0.8));
        let grid = EnvironmentMap { width: 400, height: 200, radiance: Vec::new() };
        let value = |d: DVec3| (5.0 * (d.dot(a) - 1.0) + 12.0 * (d.dot(b) - 1.0)).exp();
        let row = |j| (0..400).map(|i| value(grid.texel_direction(i, j).as_dvec3())).sum::<f64>();
        let sum: f64 = (0..200).map(|j| row(j) * grid.texel_solid_angle(j)).sum();
        let mean = sum / (4.0 * std::f64::consts::PI);
        assert!((mean_product(a, 5.0, b, 12.0) / mean - 1.0).abs() < 1e-3);
    }
}
