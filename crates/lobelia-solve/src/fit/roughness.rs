//! Roughness that varies over the surface: a few base materials, blended per texel with weights
//! that are fitted.
//!
//! Weights are a softmax of logits (Zhou et al. 2016 fit base materials likewise). A texel shows
//! its roughness only in the few views that mirror a bright light, so logits move together: the
//! gradient is averaged over a lattice around the surface whose cells shrink during the fit, so
//! that regions get sharp boundaries where the photographs show them. With one base material these
//! systems have no effect.
//!
//! Or each texel has a roughness of its own, and a factor on the specular albedo, with a smoothness
//! prior: it blends the two nearest of several base materials of fixed roughness, so that shading
//! does not depend on it. The systems replace [`move_blends`] and use the same lattice.

use crate::fit::components::{AdamStep, Bounded, Moments, StepGradient, StepRates, Unknowns};
use bevy_ecs::prelude::{Component, Res, ResMut, Resource, World};
use glam::{UVec3, Vec3};
use lobelia_geometry::{mesh::atlas::TexelAtlas, parallel};
use lobelia_world::material::{Diffuse, MAX_SPECULAR_LOBES, SpecularBlend, Texels, texels_in_order};
use lobelia_world::sample::{Samples, point::SurfacePoint};
use lobelia_world::{material::material_source::BaseMaterials, pipeline::SystemResult};
use serde::{Deserialize, Serialize};

/// One value per base material.
pub type PerMaterial = [f32; MAX_SPECULAR_LOBES];

/// Gradient of the loss with respect to a texel's blend weights.
#[derive(Component, Clone, Copy, Debug, Default, PartialEq)]
pub struct BlendGradient(pub PerMaterial);

/// Adam's moments of a texel's logits.
#[derive(Component, Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct BlendMoments(pub Moments<MAX_SPECULAR_LOBES>);

/// Where texels are on the surface. Blends move, and albedo has its prior, only if every texel has a
/// position.
#[derive(Resource, Default)]
pub struct TexelPlaces {
    /// World position of each texel; not finite for texels that no surface point reaches.
    pub positions: Vec<Vec3>,
    /// Pairs of neighbors ([`TexelAtlas::neighbors`]).
    pub neighbors: Vec<[u32; 2]>,
    /// Completed fraction of the fit, in [0, 1].
    pub progress: f32,
}

impl TexelPlaces {
    /// The number of cells along the longest side of the lattice.
    fn cells(&self) -> f32 {
        CELLS.0 * (CELLS.1 / CELLS.0).powf(self.progress)
    }
}

/// Least weight of a material, so that it can grow again.
const LEAST_WEIGHT: f32 = 1e-3;
/// Cells along the longest side of the object at the start and at the end of a fit.
const CELLS: (f32, f32) = (8.0, 48.0);

/// Gradient: adds the blend adjoints of the samples to their texels, in the order of
/// [`SampleIndex`](lobelia_world::sample::pixel::SampleIndex).
pub fn scatter_to_blends(
    materials: Res<BaseMaterials>,
    gradient: Res<StepGradient>,
    samples: Samples<&SurfacePoint>,
    texels: Texels<&mut BlendGradient>,
) -> SystemResult {
    if !materials.blended {
        return Ok(());
    }
    let points = samples.columns()?;
    let mut texels = texels.columns()?.quiet();
    let texels = &mut *texels;
    for (point, adjoint) in points.iter().zip(&gradient.blends) {
        for (texel, weight) in point.texels.indices.into_iter().zip(point.texels.weights) {
            // Texels that were added after the start of the fit have no gradient.
            let Some(sums) = texels.get_mut(texel as usize) else { continue };
            for (sum, value) in sums.0.iter_mut().zip(adjoint) {
                *sum += value * weight;
            }
        }
    }
    Ok(())
}

/// Update: Adam on the logits of the texels' blends; clears the gradient.
pub fn move_blends(
    rates: Res<StepRates>,
    unknowns: Res<Unknowns>,
    materials: Res<BaseMaterials>,
    places: Res<TexelPlaces>,
    texels: Texels<(&mut SpecularBlend, &mut BlendGradient, &mut BlendMoments)>,
) -> SystemResult {
    let (mut blends, gradients, moments) = texels.columns()?;
    let (mut gradients, mut moments) = (gradients.quiet(), moments.quiet());
    if materials.lobes.len() < 2 || !unknowns.blends || places.positions.len() != blends.len() {
        gradients.fill(BlendGradient::default());
        return Ok(());
    }
    for (blend, gradient) in blends.iter().zip(gradients.iter_mut()) {
        gradient.0 = logit_adjoint(&blend.0, &gradient.0);
    }
    average_over_cells(&places.positions, &mut gradients, places.cells());
    let adam = AdamStep::new(rates.albedo, rates.step);
    let numbers: Vec<usize> = materials.by_number().map(|(number, _)| number).collect();
    let columns = ((&mut *blends, &mut *gradients), &mut *moments);
    parallel::for_each_row(columns, 4096, |((blend, gradient), moments)| {
        let step = adam.advance(&mut moments.0, &gradient.0);
        gradient.0 = PerMaterial::default();
        move_blend(&mut blend.0, &numbers, &step);
    });
    Ok(())
}

/// Adjoints of the logits θ, w = softmax(θ): w_k·(g_k − Σ_j w_j·g_j).
fn logit_adjoint(weights: &PerMaterial, adjoint: &PerMaterial) -> PerMaterial {
    let mean: f32 = weights.iter().zip(adjoint).map(|(w, g)| w * g).sum();
    std::array::from_fn(|k| weights[k] * (adjoint[k] - mean))
}

/// Moves the logits of these base materials by −`step`; weights start from at least
/// [`LEAST_WEIGHT`], and sum to one.
fn move_blend(weights: &mut PerMaterial, numbers: &[usize], step: &PerMaterial) {
    for &k in numbers {
        weights[k] = weights[k].max(LEAST_WEIGHT) * (-step[k]).exp();
    }
    let sum: f32 = numbers.iter().map(|&k| weights[k]).sum();
    numbers.iter().for_each(|&k| weights[k] /= sum);
}

/// A lattice over the bounding box of the texels.
struct Lattice {
    low: Vec3,
    scale: f32,
    size: UVec3,
}

impl Lattice {
    fn new(positions: &[Vec3], cells: f32) -> Option<Self> {
        let finite = || positions.iter().filter(|p| p.is_finite());
        let low = finite().copied().reduce(Vec3::min)?;
        let high = finite().copied().reduce(Vec3::max)?;
        let scale = cells / (high - low).max_element().max(1e-12);
        Some(Self { low, scale, size: ((high - low) * scale).as_uvec3() + 2 })
    }

    /// The eight vertices around a position, and their trilinear weights.
    fn corners(&self, position: Vec3) -> [(usize, f32); 8] {
        let place = (position - self.low) * self.scale;
        let base = place.floor().min((self.size - 2).as_vec3()).max(Vec3::ZERO);
        let part = place - base;
        std::array::from_fn(|i| {
            let side = UVec3::new(i as u32 & 1, i as u32 >> 1 & 1, i as u32 >> 2);
            let vertex = base.as_uvec3() + side;
            let weight = Vec3::select(side.cmpeq(UVec3::ONE), part, 1.0 - part).element_product();
            ((vertex.x + self.size.x * (vertex.y + self.size.y * vertex.z)) as usize, weight)
        })
    }
}

/// Replaces each gradient by the mean of those around it: accumulated on a lattice of about `cells`
/// cells per side and interpolated from it.
fn average_over_cells(positions: &[Vec3], gradients: &mut [BlendGradient], cells: f32) {
    let Some(lattice) = Lattice::new(positions, cells) else { return };
    let mut sums = vec![(PerMaterial::default(), 0.0f32); lattice.size.element_product() as usize];
    for (position, gradient) in positions.iter().zip(gradients.iter()).filter(|(p, _)| p.is_finite()) {
        for (vertex, weight) in lattice.corners(*position) {
            sums[vertex].1 += weight;
            for (sum, value) in sums[vertex].0.iter_mut().zip(&gradient.0) {
                *sum += weight * value;
            }
        }
    }
    parallel::for_each_row((gradients, positions), 4096, |(gradient, position)| {
        if !position.is_finite() {
            return;
        }
        gradient.0 = PerMaterial::default();
        for (vertex, weight) in lattice.corners(*position) {
            let (sum, total) = &sums[vertex];
            for (value, sum) in gradient.0.iter_mut().zip(sum) {
                *value += weight * sum / total.max(1e-6);
            }
        }
    });
}

/// Roughnesses of the base materials. A blend of two neighbors is close to a lobe of a roughness
/// between them.
pub const BASE_ROUGHNESSES: [f32; 6] = [0.1, 0.15, 0.225, 0.3375, 0.506_25, 0.759_375];
/// Difference of the logarithms of neighboring roughnesses, ln 1.5.
const STEP: f32 = 0.405_465_1;
/// Initial factor on the specular albedo.
const FIRST_SHARE: f32 = 0.8;
/// The prior is quadratic for differences of logarithms well below this, and linear above.
const KINK: f32 = 0.02;

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

    /// Blend weights of the base materials: hat functions of the logarithm of roughness, times
    /// `share`.
    pub fn weights(&self) -> PerMaterial {
        let (below, part) = self.place();
        let mut weights = PerMaterial::default();
        weights[below] = self.share * (1.0 - part);
        weights[below + 1] = self.share * part;
        weights
    }

    /// Adjoints of the logarithm of roughness and of the logit of `share`, given those of the
    /// weights.
    fn adjoint_of(&self, adjoint: &PerMaterial) -> [f32; 2] {
        let (below, part) = self.place();
        let (low, high) = (adjoint[below], adjoint[below + 1]);
        let along_share = (1.0 - part) * low + part * high;
        [self.share * (high - low) / STEP, along_share * Bounded::UNIT.derivative(self.share)]
    }

    fn moved(&self, step: [f32; 2], varied_specular: bool) -> Self {
        let roughness = self.roughness * (-step[0]).exp();
        let share = if varied_specular { Bounded::UNIT.move_by(self.share, -step[1]) } else { self.share };
        Self { share, ..Self::first(roughness, false) }
    }
}

/// Adam's moments of the roughness of a texel.
#[derive(Component, Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RoughnessMoments(Moments<2>);

/// The smoothness prior between neighboring texels.
#[derive(Resource, Clone, Debug, Default)]
pub struct RoughnessPrior {
    /// Weight ≥ 0, relative to the image loss, of the mean over neighbors of the differences of the
    /// logarithms of roughness and `share`.
    pub smoothness: f32,
    /// Difference of chromaticity (albedo over its sum) > 0 at which the prior has half the weight
    /// that it has for neighbors of equal color.
    pub color_width: f32,
    /// Whether `share` varies.
    pub varied_specular: bool,
    /// Pairs of neighboring texels.
    neighbors: Vec<[u32; 2]>,
}

impl RoughnessPrior {
    /// The prior for the texels of an atlas.
    pub fn new(atlas: &TexelAtlas, smoothness: f32, color_width: f32, varied_specular: bool) -> Self {
        Self { smoothness, color_width, varied_specular, neighbors: atlas.neighbors() }
    }
}

/// Adds the gradient of the prior to the first two entries of each texel's gradient.
fn add_variation(
    prior: &RoughnessPrior,
    roughness: &[TexelRoughness],
    texels: &[Diffuse],
    gradients: &mut [BlendGradient],
) {
    let weight = prior.smoothness / prior.neighbors.len().max(1) as f32;
    let logs = |g: &TexelRoughness| [g.roughness.ln(), g.share.ln()];
    for [a, b] in prior.neighbors.iter().map(|pair| pair.map(|texel| texel as usize)) {
        let apart = chromaticity(texels[a].albedo).distance(chromaticity(texels[b].albedo));
        let apart = apart / prior.color_width;
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
pub fn attach_roughness(world: &mut World, roughness: f32, varied_specular: bool) {
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

/// Update: sums the gradients of the specular albedo over all base materials, so that they keep one
/// common albedo.
pub(crate) fn tie_specular(mut gradient: ResMut<StepGradient>) {
    let mut sum = [0.0; 3];
    gradient.specular.iter().for_each(|of| (0..3).for_each(|c| sum[c] += of.albedo[c]));
    gradient.specular.iter_mut().for_each(|of| of.albedo = sum);
}

/// Update: Adam on the texels' roughness and share; clears the gradient.
pub(crate) fn move_roughness(
    rates: Res<StepRates>,
    unknowns: Res<Unknowns>,
    places: Res<TexelPlaces>,
    prior: Res<RoughnessPrior>,
    texels: Texels<(
        &Diffuse,
        &mut TexelRoughness,
        &mut SpecularBlend,
        &mut BlendGradient,
        &mut RoughnessMoments,
    )>,
) -> SystemResult {
    let (texels, mut roughness, mut blends, gradients, moments) = texels.columns()?;
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
    average_over_cells(&places.positions, &mut gradients, places.cells());
    add_variation(&prior, &roughness, &texels, &mut gradients);
    let adam = AdamStep::new(rates.albedo, rates.step);
    let columns = ((&mut *roughness, &mut *blends), (&mut *gradients, &mut *moments));
    parallel::for_each_row(columns, 4096, |((roughness, blend), (gradient, moments))| {
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
    fn adjoint_of_logits_is_that_of_the_softmax() {
        let logits = [0.3, -0.7, 0.1];
        let adjoint = [0.5, -1.0, 2.0];
        let softmax = |logits: [f64; 3]| {
            let sum: f64 = logits.iter().map(|l| l.exp()).sum();
            logits.map(|l| l.exp() / sum)
        };
        let loss = |logits| softmax(logits).iter().zip(adjoint).map(|(w, g)| w * g).sum::<f64>();
        let mut weights = PerMaterial::default();
        let mut wide = PerMaterial::default();
        for k in 0..3 {
            weights[k] = softmax(logits)[k] as f32;
            wide[k] = adjoint[k] as f32;
        }
        let found = logit_adjoint(&weights, &wide);
        for k in 0..3 {
            let (mut up, mut down) = (logits, logits);
            up[k] += 1e-5;
            down[k] -= 1e-5;
            let exact = (loss(up) - loss(down)) / 2e-5;
            assert!((f64::from(found[k]) - exact).abs() < 1e-5, "{k}: {} {exact}", found[k]);
        }
    }

    #[test]
    fn averaging_keeps_an_even_gradient_and_spreads_an_uneven_one() {
        let positions: Vec<Vec3> =
            (0..1000).map(|i| Vec3::new((i % 10) as f32, (i / 10 % 10) as f32, (i / 100) as f32)).collect();
        let even = BlendGradient([0.5; MAX_SPECULAR_LOBES]);
        let mut gradients = vec![even; positions.len()];
        average_over_cells(&positions, &mut gradients, 4.0);
        assert!(gradients.iter().all(|g| (g.0[0] - 0.5).abs() < 1e-5));
        gradients.fill(BlendGradient::default());
        gradients[555].0[1] = 1.0;
        average_over_cells(&positions, &mut gradients, 4.0);
        assert!(gradients[555].0[1] < 0.3 && gradients[556].0[1] > 0.01);
        assert_eq!(gradients[0].0[1], 0.0);
        let mut nowhere = vec![even; 2];
        average_over_cells(&[Vec3::NAN; 2], &mut nowhere, 4.0);
        assert_eq!(nowhere, [even; 2]);
    }

    #[test]
    fn weights_stay_weights() {
        let mut weights = PerMaterial::default();
        (weights[0], weights[2]) = (0.999, 0.001);
        for _ in 0..100 {
            move_blend(&mut weights, &[0, 2], &[1.0, 5.0, -1.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
            assert!((weights[0] + weights[2] - 1.0).abs() < 1e-6 && weights[0] > 0.0 && weights[2] > 0.0);
        }
        assert!(weights[2] > 0.99 && weights[1] == 0.0, "a number that no material has keeps no weight");
    }

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
        let neighbors = vec![[0, 1], [1, 2]];
        let prior = RoughnessPrior { smoothness: 2.0, color_width: 0.1, varied_specular: true, neighbors };
        let roughness = [(0.2, 0.5), (0.21, 0.52), (0.4, 0.9)]
            .map(|(roughness, share)| TexelRoughness { roughness, share });
        let texels = [Vec3::new(0.5, 0.4, 0.3), Vec3::new(0.5, 0.45, 0.3), Vec3::new(0.3, 0.4, 0.6)]
            .map(Diffuse::of_albedo);
        let value = |roughness: &[TexelRoughness]| -> f64 {
            let pair = |[a, b]: &[u32; 2]| {
                let (a, b) = (*a as usize, *b as usize);
                let apart = chromaticity(texels[a].albedo).distance(chromaticity(texels[b].albedo)) / 0.1;
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
        add_variation(&prior, &roughness, &texels, &mut gradients);
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
