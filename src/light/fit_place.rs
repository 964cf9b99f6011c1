//! Where to put new lobes: the directions and sharpnesses that would lower the error most, one at a time.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::fit_kernel::{FitLobe, TILE, Tile, residuals};
use super::fit_solve::Bounds;

/// Sharpnesses tried, each about 2.5 times the one before.
const SHARPNESSES: [f64; 9] = [1.5, 4.0, 10.0, 25.0, 60.0, 150.0, 400.0, 1000.0, 2500.0];

/// A possible new lobe and by how much it would lower the error on its own.
#[derive(Clone, Copy, Debug)]
struct Candidate {
    axis: Vec3,
    sharpness: f64,
    amplitude: [f64; 3],
    gain: f64,
}

/// Up to `count` new lobes for what `lobes` leave over, best first, at `axes` (possible directions).
///
/// A matching pursuit in batches: a candidate lobe's gain is Σ_c max(0, ⟨r_c, G⟩)²/⟨G, G⟩ on the residual r; chosen lobes
/// keep others out of the reach of √(2/λ) radians around them, as they would explain the same light.
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
    candidates.retain(|c| c.gain > 0.0);
    // A stable sort, so that ties keep the order of the axes.
    candidates.sort_by(|a, b| b.gain.total_cmp(&a.gain));
    let mut chosen: Vec<Candidate> = Vec::new();
    for c in candidates {
        let crowded = |other: &Candidate| c.axis.distance_squared(other.axis) < 2.0 / other.sharpness as f32;
        if chosen.len() < count && !chosen.iter().any(crowded) {
            chosen.push(c);
        }
    }
    chosen.iter().map(|c| FitLobe::new(c.axis.as_dvec3(), c.sharpness, c.amplitude)).collect()
}

fn candidate(tiles: &[Tile<f32>], residual: &[[[f32; TILE]; 3]], axis: Vec3, sharpness: f64) -> Candidate {
    let mut inner = [0.0_f64; 3];
    let mut norm = 0.0;
    for (tile, residual) in tiles.iter().zip(residual) {
        if !tile.is_reached(axis, sharpness as f32 * 2.0) {
            continue;
        }
        let values = tile.values(DVec3::from(axis).to_array(), sharpness);
        norm += lanes_product(&values, &values);
        for (sum, channel) in inner.iter_mut().zip(residual) {
            *sum -= lanes_product(&values, channel);
        }
    }
    let amplitude = inner.map(|i| if norm > 0.0 { (i / norm).max(0.0) } else { 0.0 });
    let gain = amplitude.iter().map(|a| a * a * norm).sum();
    Candidate { axis, sharpness, amplitude, gain }
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
}
