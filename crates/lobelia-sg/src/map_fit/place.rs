//! Placement of new lobes: the directions and sharpnesses that lower the error most, one at a time.

use crate::map_fit::kernel::{FitLobe, LobeCap, Tile, TileRow, TileValues, residuals, rows_of, tiles_of};
use crate::map_fit::{gram::mean_product, solve::LobeBounds};
use crate::{dispatch, fibonacci::fibonacci_axes, light::envmap::EnvironmentMap, sg::sphere_integral};
use fearless_simd::Simd;
use glam::DVec3;
use rayon::prelude::*;

/// Sharpnesses tried, each about 2.5 times the one before.
const SHARPNESSES: [f64; 10] = [1.5, 4.0, 10.0, 25.0, 60.0, 150.0, 400.0, 1000.0, 2500.0, 6000.0];
/// Directions tried for each sharpness: λ times this, which makes their spacing slightly more than
/// a standard deviation, as the steps that follow move lobes by that much…
const AXES_PER_SHARPNESS: f64 = 8.0;
/// …within these limits.
const AXES: [usize; 2] = [600, 20_000];
/// Candidates that are evaluated again after each choice. A gain only decreases as others are
/// chosen, so the best candidate is missed only if its gain falls below that of the first one left
/// out.
const SHORT_LIST: usize = 4096;
/// Candidates are summed up where they are above e⁻⁶: the reach, above e⁻¹⁶, of so many times their
/// sharpness.
const REACH: f64 = 16.0 / 6.0;
/// Texels per standard deviation 1/√λ in the map that a sharpness is searched in.
const TEXELS_PER_DEVIATION: f64 = 1.5;

/// A map at one resolution.
#[derive(Clone, Debug)]
pub struct Level {
    /// Width in texels.
    pub width: u32,
    /// The texels.
    pub tiles: Vec<Tile>,
    rows: Vec<TileRow>,
}

impl Level {
    /// The level of a map.
    pub fn new(map: &EnvironmentMap) -> Self {
        let tiles = tiles_of(map);
        Self { width: map.width, rows: rows_of(&tiles, map.width), tiles }
    }
}

/// A candidate lobe: its inner products with the residual (per channel) and with itself.
#[derive(Clone, Copy, Debug)]
struct Candidate {
    axis: DVec3,
    sharpness: f64,
    inner: [f64; 3],
    norm: f64,
}

/// Up to `count` new lobes for the residual of `lobes`, best first.
///
/// Matching pursuit (Mallat and Zhang 1993) on the residual r: a candidate's gain is Σ_c max(0,
/// ⟨r_c, G⟩)²/⟨G, G⟩; the residual is computed once, and the effect of a chosen lobe on the other
/// candidates follows from the integral of SG products. Each sharpness is searched on the coarsest
/// of `levels` (coarse to fine) that resolves it.
pub fn place(levels: &[Level], lobes: &[FitLobe], count: usize, bounds: LobeBounds) -> Vec<FitLobe> {
    let mut candidates = candidates(levels, lobes, bounds);
    let mut chosen = Vec::new();
    while chosen.len() < count {
        // The first of equal ones, so that the result is unique.
        let better = |best: Candidate, c: Candidate| if c.gain() > best.gain() { c } else { best };
        let best = candidates.iter().copied().reduce(better).filter(|best| best.gain() > 0.0);
        let Some(best) = best else { break };
        candidates.par_iter_mut().with_min_len(1024).for_each(|c| c.lose(&best));
        chosen.push(FitLobe::new(best.axis, best.sharpness, best.amplitude()));
    }
    chosen
}

fn candidates(levels: &[Level], lobes: &[FitLobe], bounds: LobeBounds) -> Vec<Candidate> {
    let residuals: Vec<Vec<TileValues>> = levels.iter().map(|level| residuals(&level.tiles, lobes)).collect();
    let mut candidates = Vec::new();
    for sharpness in SHARPNESSES.into_iter().filter(|s| (bounds.dullest..=bounds.sharpest).contains(s)) {
        let finest = std::f64::consts::TAU * TEXELS_PER_DEVIATION * sharpness.sqrt();
        let resolves = |level: &Level| f64::from(level.width) >= finest;
        let index = levels.iter().position(resolves).unwrap_or(levels.len().saturating_sub(1));
        let Some(level) = levels.get(index) else { break };
        let axes = fibonacci_axes(((sharpness * AXES_PER_SHARPNESS) as usize).clamp(AXES[0], AXES[1]));
        let allowed = |axis: &glam::Vec3| !bounds.upper_only || axis.y >= 0.0;
        let at = |axis: glam::Vec3| {
            let lobe = FitLobe::new(axis.as_dvec3(), sharpness, [0.0; 3]);
            dispatch!(simd => candidate(simd, level, &residuals[index], &lobe))
        };
        candidates.par_extend(axes.into_par_iter().filter(allowed).map(at));
    }
    // A stable sort, so that equal ones stay in order and the result is unique.
    candidates.par_sort_by(|a, b| b.gain().total_cmp(&a.gain()));
    candidates.truncate(SHORT_LIST);
    candidates
}

#[inline(always)]
fn candidate<S: Simd>(simd: S, level: &Level, residual: &[TileValues], lobe: &FitLobe) -> Candidate {
    let mut inner = [0.0; 3];
    let reach = LobeCap::new(lobe.axis, lobe.sharpness * REACH);
    for at in level.rows.iter().flat_map(|row| reach.tiles_in(row)) {
        if reach.meets(&level.tiles[at]) {
            let more = level.tiles[at].products(simd, lobe, &residual[at]);
            inner.iter_mut().zip(more).for_each(|(sum, product)| *sum += product);
        }
    }
    let norm = sphere_integral(2.0 * lobe.sharpness) / (4.0 * std::f64::consts::PI);
    Candidate { axis: lobe.axis, sharpness: lobe.sharpness, inner, norm }
}

impl Candidate {
    /// The best amplitude of this lobe alone.
    fn amplitude(&self) -> [f64; 3] {
        self.inner.map(|i| (i / self.norm).max(0.0))
    }

    /// The decrease of the error with this lobe alone.
    fn gain(&self) -> f64 {
        self.amplitude().iter().map(|a| a * a * self.norm).sum()
    }

    /// Subtracts the contribution of `other`, once chosen, from the inner products.
    fn lose(&mut self, other: &Self) {
        let (overlap, _) = mean_product(self.axis, self.sharpness, other.axis, other.sharpness);
        for (inner, amplitude) in self.inner.iter_mut().zip(other.amplitude()) {
            *inner -= amplitude * overlap;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::lobe::LightLobe;
    use glam::Vec3;

    #[test]
    fn two_lights_are_found_brightest_first() {
        let light = |axis: Vec3, sharpness, amplitude| LightLobe { axis, sharpness, amplitude };
        let lights = [
            light(Vec3::new(0.6, 0.0, 0.8), 60.0, Vec3::splat(3.0)),
            light(Vec3::new(-0.8, 0.6, 0.0), 10.0, Vec3::new(9.0, 3.0, 1.0)),
        ];
        let map = EnvironmentMap::from_directions(64, 32, |d| lights.iter().map(|l| l.radiance(d)).sum());
        let bounds = LobeBounds { dullest: 0.1, sharpest: 500.0, upper_only: false };
        let found = place(&[Level::new(&map)], &[], 2, bounds);
        assert_eq!(found.len(), 2);
        for (lobe, light) in found.iter().zip([lights[1], lights[0]]) {
            let axis = lobe.axis.as_vec3();
            assert!(axis.angle_between(light.axis) < 0.12, "{axis}");
            assert_eq!(lobe.sharpness as f32, light.sharpness);
            assert!((lobe.amplitude[1] as f32 / light.amplitude.y - 1.0).abs() < 0.1);
        }
        assert!(place(&[Level::new(&map.scaled(Vec3::ZERO))], &[], 2, bounds).is_empty());
    }
}
