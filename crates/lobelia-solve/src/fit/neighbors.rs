//! A prior for the albedo: neighboring texels have the same paint, but at edges.
//!
//! Residuals of the photographs have a Laplace distribution of mean b, which a fit measures, and so
//! have differences of the logarithm of albedo between neighbors, of mean [`SPREAD`]. The logarithm
//! of the posterior, in units of the image loss, is the mean of |r| over N pixels and their channels
//! plus b/(3 N s) times the sum of |ln A_i − ln A_j|, the total variation. So where a texel is seen
//! often and lit well, photographs decide; where it is dark or seldom seen, its neighbors do.
//! Logarithms make it free of the scale between light and albedo.

use crate::fit::components::{AlbedoGradient, LossState, Unknowns};
use crate::fit::roughness::TexelPlaces;
use bevy_ecs::prelude::Res;
use glam::Vec3;
use lobelia_geometry::parallel;
use lobelia_world::material::{Diffuse, Texels};
use lobelia_world::pipeline::SystemResult;
use lobelia_world::sample::Observations;

/// Mean s of the difference that neighbors are expected to have.
const SPREAD: f32 = 0.3;
/// Differences well below this are held by a square: no cusp stops what moves together.
const KINK: f32 = 0.1 * SPREAD;
/// Albedo below which logarithms stop.
const DARKEST: Vec3 = Vec3::splat(1e-3);

/// Gradient: adds that of the prior, if texels have neighbors.
pub(crate) fn hold_to_neighbors(
    places: Res<TexelPlaces>,
    state: Res<LossState>,
    unknowns: Res<Unknowns>,
    observations: Observations,
    texels: Texels<(&Diffuse, &mut AlbedoGradient)>,
) -> SystemResult {
    let pixels = observations.columns()?.len();
    let (texels, gradients) = texels.columns()?;
    if unknowns.albedo && places.positions.len() == texels.len() {
        let weight = state.last.mean() as f32 / (3 * pixels.max(1)) as f32 / SPREAD;
        add_variation(&places.neighbors, &texels, weight, &mut gradients.quiet());
    }
    Ok(())
}

/// Adds the gradient of `weight` · Σ √(|ln A_i − ln A_j|² + KINK²) over pairs of neighbors.
fn add_variation(pairs: &[[u32; 2]], texels: &[Diffuse], weight: f32, gradients: &mut [AlbedoGradient]) {
    let mut rows: Vec<(Vec3, Vec3)> =
        parallel::map_slice(texels, 4096, |of| (of.albedo.max(DARKEST).map(f32::ln), Vec3::ZERO));
    for [a, b] in pairs.iter().map(|pair| pair.map(|texel| texel as usize)) {
        let apart = rows[a].0 - rows[b].0;
        let slope = apart * (weight / (apart.length_squared() + KINK * KINK).sqrt());
        rows[a].1 += slope;
        rows[b].1 -= slope;
    }
    for ((gradient, (_, slope)), of) in gradients.iter_mut().zip(rows).zip(texels) {
        gradient.0 += slope / of.albedo.max(DARKEST);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_gradient_of_variation_agrees_with_differences() {
        let pairs = [[0, 1], [1, 2], [2, 0]];
        let albedo = [Vec3::new(0.5, 0.4, 0.3), Vec3::new(0.51, 0.4, 0.29), Vec3::new(0.1, 0.8, 0.02)];
        let value = |albedo: [Vec3; 3]| -> f64 {
            let cost = |[a, b]: &[u32; 2]| {
                let apart = albedo[*a as usize].as_dvec3() / albedo[*b as usize].as_dvec3();
                (apart.map(f64::ln).length_squared() + f64::from(KINK * KINK)).sqrt()
            };
            2.0 * pairs.iter().map(cost).sum::<f64>()
        };
        let mut gradients = [AlbedoGradient::default(); 3];
        add_variation(&pairs, &albedo.map(Diffuse::of_albedo), 2.0, &mut gradients);
        for (texel, c) in (0..3).flat_map(|texel| (0..3).map(move |c| (texel, c))) {
            let at = |step: f32| {
                let mut moved = albedo;
                moved[texel][c] *= 1.0 + step;
                value(moved)
            };
            let exact = (at(1e-3) - at(-1e-3)) / f64::from(2e-3 * albedo[texel][c]);
            let found = f64::from(gradients[texel].0[c]);
            assert!((found - exact).abs() < 1e-2 * exact.abs() + 1e-2, "{texel} {c}: {found} {exact}");
        }
    }
}
