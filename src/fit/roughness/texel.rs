//! One roughness per texel, and a factor on the specular albedo, with a smoothness prior.
//!
//! Texels blend the two nearest of several base materials of fixed roughness, so that shading does not depend on this module. The
//! systems here replace [`crate::fit::roughness::blend::move_blends`] and use the same lattice.
//!
//! | system | stage, slot | reads | writes |
//! | --- | --- | --- | --- |
//! | `tie_specular` | Update, `Slot::Optimizer` | | `SpecularGradient`: one albedo for all base materials |
//! | `move_roughness` | Update, `Slot::Optimizer` | [`BlendGradient`], [`TexelPlaces`], [`RoughnessPrior`], `DiffuseAlbedo` | [`TexelRoughness`], `SpecularBlend` |

use crate::fit::adam::{AdamStep, Bounded, Moments};
use crate::fit::components::{SpecularGradient, StepRates, Unknowns};
use crate::fit::roughness::blend::{BlendGradient, PerMaterial, TexelPlaces, average_at};
use crate::material::{DiffuseAlbedo, SpecularBlend, Texels, texels_in_order};
use crate::mesh::atlas::TexelAtlas;
use crate::pipeline::SystemResult;
use bevy_ecs::prelude::{Component, Query, Res, Resource, World};
use glam::Vec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Roughnesses of the base materials. A blend of two neighbors is close to a lobe of a roughness between them.
pub(crate) const BASE_ROUGHNESSES: [f32; 6] = [0.1, 0.15, 0.225, 0.3375, 0.506_25, 0.759_375];
/// Difference of the logarithms of neighboring roughnesses, ln 1.5.
const STEP: f32 = 0.405_465_1;
/// Initial factor on the specular albedo.
const FIRST_SHARE: f32 = 0.8;
/// Range of the factor.
const SHARE: Bounded = Bounded { low: 0.0, high: 1.0 };
/// Rate of the logarithm of roughness and the logit of the factor, relative to that of albedo.
const RATE: f32 = 1.0;
/// The prior is quadratic for differences of logarithms well below this, and linear above.
const KINK: f32 = 0.02;
/// Neighbors in the texture are neighbors on the surface if their distance is below this many mean distances.
const NEAR: f32 = 3.0;

/// Roughness of a texel.
#[derive(Component, Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct TexelRoughness {
    /// Roughness R, 0.1 to 0.76.
    pub roughness: f32,
    /// Factor on the specular lobe, in (0, 1].
    pub share: f32,
}

impl TexelRoughness {
    /// The initial value of texels.
    pub fn first(roughness: f32, varied_specular: bool) -> Self {
        let share = if varied_specular { FIRST_SHARE } else { 1.0 };
        let at = ((roughness / BASE_ROUGHNESSES[0]).ln() / STEP)
            .clamp(0.0, (BASE_ROUGHNESSES.len() - 1) as f32 - 1e-3);
        // Never exactly a base roughness, because a zero weight has no adjoint.
        let off_rung = at.floor() + at.fract().clamp(1e-3, 1.0 - 1e-3);
        Self { roughness: BASE_ROUGHNESSES[0] * (off_rung * STEP).exp(), share }
    }

    /// Index of the next lower base roughness, and the fraction of the step above it.
    fn place(&self) -> (usize, f32) {
        let at = (self.roughness / BASE_ROUGHNESSES[0]).ln() / STEP;
        let below = (at.max(0.0) as usize).min(BASE_ROUGHNESSES.len() - 2);
        (below, (at - below as f32).clamp(0.0, 1.0))
    }

    /// Blend weights of the base materials: hat functions of the logarithm of roughness, times `share`.
    pub fn weights(&self) -> PerMaterial {
        let (below, part) = self.place();
        let mut weights = PerMaterial::default();
        weights[below] = self.share * (1.0 - part);
        weights[below + 1] = self.share * part;
        weights
    }

    /// Adjoints of the logarithm of roughness and of the logit of `share`, given those of the weights.
    fn adjoint_of(&self, adjoint: &PerMaterial) -> [f32; 2] {
        let (below, part) = self.place();
        let (low, high) = (adjoint[below], adjoint[below + 1]);
        let along_share = (1.0 - part) * low + part * high;
        [self.share * (high - low) / STEP, along_share * SHARE.derivative(self.share)]
    }

    fn moved(&self, step: [f32; 2], varied_specular: bool) -> Self {
        let roughness = self.roughness * (-step[0]).exp();
        let share = if varied_specular { SHARE.move_by(self.share, -step[1]) } else { self.share };
        Self { share, ..Self::first(roughness, false) }
    }
}

/// Adam's moments of the roughness of a texel.
#[derive(Component, Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RoughnessMoments(Moments<2>);

/// The smoothness prior between neighboring texels.
#[derive(Resource, Clone, Debug, Default)]
pub struct RoughnessPrior {
    /// Weight ≥ 0, relative to the image loss, of the mean over neighbors of the differences of the logarithms of roughness and `share`.
    pub smoothness: f32,
    /// Difference of chromaticity (albedo over its sum) > 0 at which the prior has half the weight that it has for neighbors of equal color.
    pub color_width: f32,
    /// Whether `share` varies.
    pub varied_specular: bool,
    /// Pairs of neighboring texels.
    neighbors: Vec<[u32; 2]>,
}

impl RoughnessPrior {
    /// The prior for the texels of an atlas.
    pub fn new(atlas: &TexelAtlas, smoothness: f32, color_width: f32, varied_specular: bool) -> Self {
        Self { smoothness, color_width, varied_specular, neighbors: neighbors(atlas) }
    }
}

/// Texels side by side in the texture and near each other on the surface.
fn neighbors(atlas: &TexelAtlas) -> Vec<[u32; 2]> {
    let (width, height) = (atlas.width as usize, atlas.height as usize);
    let all = (0..width * height).flat_map(|i| {
        let right = (i % width + 1 < width).then_some([i, i + 1]);
        let down = (i + width < width * height).then_some([i, i + width]);
        [right, down].into_iter().flatten()
    });
    let covered: Vec<[usize; 2]> = all.filter(|[a, b]| atlas.covered[*a] && atlas.covered[*b]).collect();
    let distance = |[a, b]: &[usize; 2]| atlas.position[*a].distance(atlas.position[*b]);
    let mean = covered.iter().map(distance).sum::<f32>() / covered.len().max(1) as f32;
    let near = covered.iter().filter(|pair| distance(pair) < NEAR * mean);
    near.map(|[a, b]| [*a as u32, *b as u32]).collect()
}

/// Adds the gradient of the prior to the first two entries of each texel's gradient.
fn add_variation(
    prior: &RoughnessPrior,
    roughness: &[TexelRoughness],
    albedo: &[DiffuseAlbedo],
    gradients: &mut [BlendGradient],
) {
    let weight = prior.smoothness / prior.neighbors.len().max(1) as f32;
    let logs = |g: &TexelRoughness| [g.roughness.ln(), g.share.ln()];
    for [a, b] in prior.neighbors.iter().map(|pair| pair.map(|texel| texel as usize)) {
        let apart = chromaticity(albedo[a].0).distance(chromaticity(albedo[b].0)) / prior.color_width;
        let tie = weight / (1.0 + apart * apart);
        let (of_a, of_b) = (logs(&roughness[a]), logs(&roughness[b]));
        for k in 0..2 {
            let difference = of_a[k] - of_b[k];
            let derivative = tie * difference / (difference * difference + KINK * KINK).sqrt();
            // The derivative of ln s with respect to the logit of s is 1 − s.
            let inner = |g: &TexelRoughness| if k == 0 { 1.0 } else { 1.0 - g.share };
            gradients[a].0[k] += derivative * inner(&roughness[a]);
            gradients[b].0[k] -= derivative * inner(&roughness[b]);
        }
    }
}

fn chromaticity(albedo: Vec3) -> Vec3 {
    albedo / albedo.element_sum().max(1e-6)
}

/// Gives every texel its own roughness, unless it has one.
pub(crate) fn attach_roughness(world: &mut World, roughness: f32, varied_specular: bool) {
    let known = world.query::<&TexelRoughness>().iter(world).len() > 0;
    let roughness = TexelRoughness::first(roughness, varied_specular);
    for texel in texels_in_order(world) {
        let mut texel = world.entity_mut(texel);
        texel.insert(RoughnessMoments::default());
        if !known {
            texel.insert((roughness, SpecularBlend(roughness.weights())));
        }
    }
}

/// Update: sums the gradients of the specular albedo over all base materials, so that they keep one common albedo.
pub(crate) fn tie_specular(mut materials: Query<&mut SpecularGradient>) {
    let mut sum = [0.0; 3];
    materials.iter().for_each(|g| (0..3).for_each(|c| sum[c] += g.0[c]));
    materials.iter_mut().for_each(|mut gradient| gradient.0[..3].copy_from_slice(&sum));
}

type RoughnessColumns = (
    &'static DiffuseAlbedo,
    &'static mut TexelRoughness,
    &'static mut SpecularBlend,
    &'static mut BlendGradient,
    &'static mut RoughnessMoments,
);

/// Update: Adam on the texels' roughness and share; clears the gradient.
pub(crate) fn move_roughness(
    rates: Res<StepRates>,
    unknowns: Res<Unknowns>,
    places: Res<TexelPlaces>,
    prior: Res<RoughnessPrior>,
    texels: Texels<RoughnessColumns>,
) -> SystemResult {
    let (albedo, mut roughness, mut blends, gradients, moments) = texels.columns()?;
    let (mut gradients, mut moments) = (gradients.quiet(), moments.quiet());
    if !unknowns.blends || places.positions.len() != gradients.len() {
        gradients.fill(BlendGradient::default());
        return Ok(());
    }
    for (roughness, gradient) in roughness.iter().zip(gradients.iter_mut()) {
        let adjoint = roughness.adjoint_of(&gradient.0);
        gradient.0 = PerMaterial::default();
        gradient.0[..2].copy_from_slice(&adjoint);
    }
    average_at(&places, &mut gradients);
    add_variation(&prior, &roughness, &albedo, &mut gradients);
    let adam = AdamStep::new(RATE * rates.albedo, rates.step);
    let columns = roughness.par_iter_mut().zip(&mut *blends).zip(&mut *gradients);
    let columns = columns.zip(&mut *moments).with_min_len(4096);
    columns.for_each(|(((roughness, blend), gradient), moments)| {
        let step = adam.advance(&mut moments.0, &[gradient.0[0], gradient.0[1]]);
        gradient.0 = PerMaterial::default();
        *roughness = roughness.moved(step, prior.varied_specular);
        blend.0 = roughness.weights();
    });
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base_roughnesses_are_even_in_the_logarithm() {
        BASE_ROUGHNESSES.windows(2).for_each(|pair| assert!(((pair[1] / pair[0]).ln() - STEP).abs() < 1e-6));
        for roughness in [0.05, 0.1, 0.2, 0.4, 0.759, 1.0] {
            let weights = TexelRoughness { roughness, share: 0.5 }.weights();
            assert!((weights.iter().sum::<f32>() - 0.5).abs() < 1e-6 && weights.iter().all(|w| *w >= 0.0));
        }
    }

    #[test]
    fn adjoint_of_roughness_agrees_with_differences() {
        let adjoint = [0.5, -1.0, 2.0, 0.3, -0.7, 1.1, 0.0, 0.0];
        let loss = |roughness: TexelRoughness| -> f64 {
            roughness.weights().iter().zip(&adjoint).map(|(w, g)| f64::from(w * g)).sum()
        };
        for (roughness, share) in [(0.12, 0.3), (0.2, 0.9), (0.4, 0.5), (0.7, 0.8)] {
            let roughness = TexelRoughness { roughness, share };
            for (k, found) in roughness.adjoint_of(&adjoint).into_iter().enumerate() {
                let at =
                    |step: f32| loss(roughness.moved(if k == 0 { [-step, 0.0] } else { [0.0, -step] }, true));
                let exact = (at(5e-3) - at(-5e-3)) / 1e-2;
                assert!((f64::from(found) - exact).abs() < 2e-3, "{k}: {found} {exact}");
            }
        }
    }

    #[test]
    fn the_gradient_of_variation_agrees_with_differences() {
        let prior = RoughnessPrior {
            smoothness: 2.0,
            color_width: 0.1,
            varied_specular: true,
            neighbors: vec![[0, 1], [1, 2]],
        };
        let roughness = [(0.2, 0.5), (0.21, 0.52), (0.4, 0.9)]
            .map(|(roughness, share)| TexelRoughness { roughness, share });
        let albedo = [Vec3::new(0.5, 0.4, 0.3), Vec3::new(0.5, 0.45, 0.3), Vec3::new(0.3, 0.4, 0.6)]
            .map(DiffuseAlbedo);
        let value = |roughness: &[TexelRoughness]| -> f64 {
            let pair = |[a, b]: &[u32; 2]| {
                let (a, b) = (*a as usize, *b as usize);
                let apart = chromaticity(albedo[a].0).distance(chromaticity(albedo[b].0)) / 0.1;
                let cost = |d: f64| (d * d + f64::from(KINK * KINK)).sqrt();
                let (r, s) = (
                    f64::from(roughness[a].roughness / roughness[b].roughness),
                    f64::from(roughness[a].share / roughness[b].share),
                );
                f64::from(prior.smoothness / 2.0 / (1.0 + apart * apart)) * (cost(r.ln()) + cost(s.ln()))
            };
            prior.neighbors.iter().map(pair).sum()
        };
        let mut gradients = [BlendGradient::default(); 3];
        add_variation(&prior, &roughness, &albedo, &mut gradients);
        for texel in 0..3 {
            for k in 0..2 {
                let at = |step: f32| {
                    let mut moved = roughness;
                    moved[texel] =
                        roughness[texel].moved(if k == 0 { [-step, 0.0] } else { [0.0, -step] }, true);
                    value(&moved)
                };
                let exact = (at(1e-3) - at(-1e-3)) / 2e-3;
                let found = f64::from(gradients[texel].0[k]);
                assert!((found - exact).abs() < 1e-2 * exact.abs() + 1e-3, "{texel} {k}: {found} {exact}");
            }
        }
    }
}
