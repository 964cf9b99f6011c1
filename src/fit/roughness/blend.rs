//! Roughness that varies over the surface: a few base materials, blended per texel with weights that are fitted.
//!
//! Weights are a softmax of logits (Zhou et al. 2016 fit base materials likewise). A texel shows its roughness only in the few views that
//! mirror a bright light, so logits move together: the gradient is averaged over a lattice around the surface whose cells shrink
//! during the fit, so that regions get sharp boundaries where the photographs show them. With one base material these systems have no effect.
//!
//! | system | stage, slot | reads | writes |
//! | --- | --- | --- | --- |
//! | [`pull_back_blended`](super::blend_adjoint::pull_back_blended) | called by `pull_back_radiance` | samples, base materials | adjoints of samples, light, materials, blends |
//! | [`scatter_to_blends`] | Gradient | [`BlendAdjoints`], texel addresses | [`BlendGradient`] |
//! | [`move_blends`] | Update, `Slot::Optimizer` | [`BlendGradient`], [`TexelPlaces`] | `SpecularBlend` |

use crate::fit::adam::{AdamStep, Moments};
use crate::fit::components::{StepRates, Unknowns};
use crate::material::material_source::BaseMaterials;
use crate::material::{MAX_SPECULAR_LOBES, SpecularBlend, Texels};
use crate::pipeline::SystemResult;
use crate::sample::Samples;
use crate::sample::point::SurfacePoint;
use bevy_ecs::prelude::{Component, Res, Resource};
use glam::{UVec3, Vec3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// One value per base material.
pub type PerMaterial = [f32; MAX_SPECULAR_LOBES];

/// Gradient of the loss with respect to a texel's blend weights.
#[derive(Component, Clone, Copy, Debug, Default, PartialEq)]
pub struct BlendGradient(pub PerMaterial);

/// Adam's moments of a texel's logits.
#[derive(Component, Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct BlendMoments(pub Moments<MAX_SPECULAR_LOBES>);

/// Adjoints of the blend weights at the window's samples.
#[derive(Resource, Default)]
pub struct BlendAdjoints(pub Vec<PerMaterial>);

/// Positions of the texels, for the lattice over which their gradients are averaged. Blends move only if every texel has a position.
#[derive(Resource, Default)]
pub struct TexelPlaces {
    /// World position of each texel; not finite for texels that no surface point reaches.
    pub positions: Vec<Vec3>,
    /// Completed fraction of the fit, in [0, 1].
    pub progress: f32,
}

/// Rate of the logits relative to that of albedo.
const RATE: f32 = 1.0;
/// Least weight of a material, so that it can grow again.
const LEAST_WEIGHT: f32 = 1e-3;
/// Cells along the longest side of the object at the start and at the end of a fit.
const CELLS: (f32, f32) = (8.0, 48.0);

/// Gradient: adds the blend adjoints of the samples to their texels, in the order of [`SampleIndex`](crate::sample::pixel::SampleIndex).
pub fn scatter_to_blends(
    materials: Res<BaseMaterials>,
    adjoints: Res<BlendAdjoints>,
    samples: Samples<&SurfacePoint>,
    texels: Texels<&mut BlendGradient>,
) -> SystemResult {
    if !materials.blended {
        return Ok(());
    }
    let points = samples.columns()?;
    let mut texels = texels.columns()?.quiet();
    let texels = &mut *texels;
    for (point, adjoint) in points.iter().zip(&adjoints.0) {
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
    average_at(&places, &mut gradients);
    let adam = AdamStep::new(RATE * rates.albedo, rates.step);
    let numbers: Vec<usize> = materials.by_number().map(|(number, _)| number).collect();
    let columns = blends.par_iter_mut().zip(&mut *gradients).zip(&mut *moments);
    columns.with_min_len(4096).for_each(|((blend, gradient), moments)| {
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

/// Moves the logits of these base materials by −`step`; weights start from at least [`LEAST_WEIGHT`], and sum to one.
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

    fn len(&self) -> usize {
        (self.size.x * self.size.y * self.size.z) as usize
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

/// `average_over_cells` with the current number of cells.
pub(crate) fn average_at(places: &TexelPlaces, gradients: &mut [BlendGradient]) {
    let cells = CELLS.0 * (CELLS.1 / CELLS.0).powf(places.progress);
    average_over_cells(&places.positions, gradients, cells);
}

/// Replaces each gradient by the mean of those around it: accumulated on a lattice of about `cells` cells per side and interpolated from it.
fn average_over_cells(positions: &[Vec3], gradients: &mut [BlendGradient], cells: f32) {
    let Some(lattice) = Lattice::new(positions, cells) else { return };
    let mut sums = vec![(PerMaterial::default(), 0.0f32); lattice.len()];
    for (position, gradient) in positions.iter().zip(gradients.iter()).filter(|(p, _)| p.is_finite()) {
        for (vertex, weight) in lattice.corners(*position) {
            sums[vertex].1 += weight;
            for (sum, value) in sums[vertex].0.iter_mut().zip(&gradient.0) {
                *sum += weight * value;
            }
        }
    }
    let both = gradients.par_iter_mut().zip(positions).with_min_len(4096);
    both.filter(|(_, p)| p.is_finite()).for_each(|(gradient, position)| {
        gradient.0 = PerMaterial::default();
        for (vertex, weight) in lattice.corners(*position) {
            let (sum, total) = &sums[vertex];
            for (value, sum) in gradient.0.iter_mut().zip(sum) {
                *value += weight * sum / total.max(1e-6);
            }
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn adjoint_of_logits_is_that_of_the_softmax() {
        let logits = [0.3, -0.7, 0.1];
        let adjoint = [0.5, -1.0, 2.0];
        let loss = |logits: [f64; 3]| {
            let sum: f64 = logits.iter().map(|l| l.exp()).sum();
            (0..3).map(|k| logits[k].exp() / sum * adjoint[k]).sum::<f64>()
        };
        let sum: f64 = logits.iter().map(|l: &f64| l.exp()).sum();
        let mut weights = PerMaterial::default();
        let mut wide = PerMaterial::default();
        for k in 0..3 {
            weights[k] = (logits[k].exp() / sum) as f32;
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
}
