//! Roughness that varies over the surface: a few base materials, blended per texel with weights that are fitted.
//!
//! Weights are a softmax of logits (Zhou et al. 2016 fit base materials likewise). A texel shows its roughness only in the few views that
//! mirror a bright light, so logits move together: the gradient is averaged over a lattice around the surface whose cells shrink
//! during the fit, so that regions get sharp boundaries where the photographs show them. With one base material these systems have no effect.
//!
//! | system | stage, slot | reads | writes |
//! | --- | --- | --- | --- |
//! | `pull_back_blended` | called by `pull_back_radiance` | samples, base materials | adjoints of samples, light, materials, blends |
//! | [`scatter_to_blends`] | Gradient | [`BlendAdjoints`], texel addresses | [`BlendGradient`] |
//! | [`move_blends`] | Update, `Slot::Optimizer` | [`BlendGradient`], [`TexelPlaces`] | `SpecularBlend` |

use crate::fit::adam::{AdamStep, Moments};
use crate::fit::components::{StepGradient, StepRates, Unknowns};
use crate::material::material_source::BaseMaterials;
use crate::material::{MAX_SPECULAR_LOBES, SpecularBlend, Texels};
use crate::math::shading::{
    ClosedForm, Layers, Lighting, LobeVisibility, PointAdjoint, PointVisibility, RadianceAdjoint,
    RadianceColumns, ShadePoint, SharedGradient, SpecularValue,
};
use crate::pipeline::SystemResult;
use crate::sample::Samples;
use crate::sample::point::{PointBlend, SurfacePoint};
use crate::shade::systems::Showing;
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

/// The samples of a window, as the kernels read them.
pub struct BlendedSamples<'a> {
    /// The points.
    pub points: &'a [ShadePoint],
    /// Blend weights of the materials there.
    pub blends: &'a [PointBlend],
    /// Their visibility.
    pub seen: &'a [PointVisibility],
    /// Their radiance.
    pub shaded: &'a [Layers],
    /// Adjoint of the radiance.
    pub adjoint: &'a [RadianceAdjoint],
}

/// The adjoint of shading with several materials: one material at a time, at the samples that have it; diffuse light and
/// interreflection belong to the first material of a sample. The adjoint of a zero weight is left at zero.
pub fn pull_back_blended(
    form: ClosedForm,
    samples: &BlendedSamples<'_>,
    materials: &[(usize, SpecularValue)],
    lighting: Lighting<'_>,
    back: &mut [PointAdjoint],
    gradient: &mut StepGradient,
    blend_adjoints: &mut Vec<PerMaterial>,
) {
    let count = samples.points.len();
    blend_adjoints.clear();
    blend_adjoints.resize(count, PerMaterial::default());
    gradient.specular.clear();
    back.fill(PointAdjoint::default());
    let rows = lighting.visibility.map_or(&[][..], |v| v.lobes);
    let lighting =
        Lighting { visibility: Some(LobeVisibility { lobes: rows, points: samples.seen }), ..lighting };
    let mut has_diffuse = vec![false; count];
    for place in 0..materials.len() {
        let mut part = MaterialPart::new(samples, lighting, materials, place, &mut has_diffuse);
        let mut layers = part.shade(form, lighting);
        for ((i, value), adjoint) in part.showing.numbers.iter().zip(&mut layers).zip(&part.adjoint) {
            blend_adjoints[*i][part.number] = (0..3).map(|c| adjoint.0[c] * value.specular[c]).sum();
            value.diffuse = samples.shaded[*i].diffuse;
        }
        part.dim(samples.blends);
        let (points, shared) = part.pull_back(form, &layers, lighting);
        add_points(back, &part.showing.numbers, &points, &part.first);
        add_shared(gradient, shared);
    }
}

/// One material at the samples that have it.
struct MaterialPart<'a> {
    number: usize,
    material: &'a SpecularValue,
    showing: Showing,
    /// Whether a sample has no earlier material: this one then has its diffuse light and interreflection.
    first: Vec<bool>,
    /// Adjoint of the radiance.
    adjoint: Vec<RadianceAdjoint>,
}

impl<'a> MaterialPart<'a> {
    /// The material at this `place` among `materials`; `has_diffuse` then says so of its samples.
    fn new(
        samples: &BlendedSamples<'_>,
        lighting: Lighting<'_>,
        materials: &'a [(usize, SpecularValue)],
        place: usize,
        has_diffuse: &mut [bool],
    ) -> Self {
        let mut showing = Showing::new(samples.points, samples.blends, lighting, materials, place);
        let is_first = |i: &usize| !std::mem::replace(&mut has_diffuse[*i], true);
        let first: Vec<bool> = showing.numbers.iter().map(is_first).collect();
        let rest = showing.points.iter_mut().zip(&first).filter(|(_, first)| !**first);
        rest.for_each(|(point, _)| point.albedo = [0.0; 3]);
        let adjoint = showing.numbers.iter().map(|i| samples.adjoint[*i]).collect();
        let (number, material) = &materials[place];
        Self { number: *number, material, showing, first, adjoint }
    }

    /// Radiance of the samples, as if they had nothing but the material.
    fn shade(&self, form: ClosedForm, lighting: Lighting<'_>) -> Vec<Layers> {
        let mut layers = vec![Layers::default(); self.showing.numbers.len()];
        form.shade(&self.showing.points, self.material, self.showing.lighting(lighting), &mut layers);
        layers
    }

    /// Weights specular light by the blends, and leaves interreflection to the first material of a sample.
    fn dim(&mut self, blends: &[PointBlend]) {
        let (number, mut is_first) = (self.number, self.first.iter());
        self.showing.change_seen(|i, seen| {
            seen.specular = seen.specular.map(|s| s * blends[i].0[number]);
            if is_first.next() == Some(&false) {
                seen.indirect = [0.0; 3];
            }
        });
    }

    /// Adjoints of the samples' points, and of what they share, given the radiance.
    fn pull_back(
        &self,
        form: ClosedForm,
        layers: &[Layers],
        lighting: Lighting<'_>,
    ) -> (Vec<PointAdjoint>, SharedGradient) {
        let (points, lighting) = (&self.showing.points, self.showing.lighting(lighting));
        let mut one = vec![PointAdjoint::default(); points.len()];
        let mut shared = SharedGradient::default();
        let radiance = RadianceColumns { shaded: layers, adjoint: &self.adjoint };
        form.shade_adjoint(points, self.material, lighting, radiance, &mut one, &mut shared);
        (one, shared)
    }
}

/// Adds one material's adjoints to those of its samples; the adjoint of the albedo comes from the first material.
fn add_points(back: &mut [PointAdjoint], numbers: &[usize], one: &[PointAdjoint], first: &[bool]) {
    for ((i, one), first) in numbers.iter().zip(one).zip(first) {
        let sum = &mut back[*i];
        sum.normal = std::array::from_fn(|c| sum.normal[c] + one.normal[c]);
        if *first {
            sum.albedo = one.albedo;
        }
    }
}

/// Adds the gradient of a material; that of the light is the sum over materials.
fn add_shared(gradient: &mut StepGradient, shared: SharedGradient) {
    gradient.specular.push(shared.specular);
    if gradient.specular.len() == 1 {
        gradient.shared = shared;
    } else {
        gradient.shared.lobes.add(&shared.lobes);
    }
}

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
    use crate::math::shading::LobeColumns;

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

    /// Adjoint of the radiance of every point, per channel.
    const ADJOINT: [f32; 3] = [0.7, 0.4, 0.5];

    /// Points that have two materials, and their light.
    #[derive(Clone)]
    struct Blended {
        points: Vec<ShadePoint>,
        blends: Vec<PointBlend>,
        seen: Vec<PointVisibility>,
        materials: [SpecularValue; 2],
        lobes: LobeColumns,
    }

    impl Blended {
        fn new() -> Self {
            let work = crate::math::workload::Workload::new(40, 20, 0.3);
            Self {
                blends: (0..40).map(|i| ramp(0.05 + 0.9 * i as f32 / 39.0)).collect(),
                seen: vec![PointVisibility { specular: [0.5, 0.8, 1.2], indirect: [0.1, 0.2, 0.3] }; 40],
                materials: [0.25, 0.5].map(|roughness| SpecularValue { roughness, ..work.specular }),
                points: work.points,
                lobes: work.lobes,
            }
        }

        fn lighting(&self) -> Lighting<'_> {
            let visibility = LobeVisibility { lobes: &[], points: &self.seen };
            Lighting { lobes: &self.lobes, visibility: Some(visibility) }
        }

        /// Radiance by its definition: the sum over materials.
        fn radiance(&self) -> Vec<Layers> {
            let mut total = vec![Layers::default(); self.points.len()];
            let mut one = total.clone();
            for (k, material) in self.materials.iter().enumerate() {
                ClosedForm::default().shade(&self.points, material, self.lighting(), &mut one);
                for ((sum, one), blend) in total.iter_mut().zip(&one).zip(&self.blends) {
                    sum.diffuse = one.diffuse;
                    (0..3).for_each(|c| sum.specular[c] += blend.0[k] * one.specular[c]);
                }
            }
            total
        }

        /// The loss of which [`ADJOINT`] is the derivative.
        fn loss(&self) -> f64 {
            let of_point = |l: &Layers| -> f32 {
                (0..3).map(|c| ADJOINT[c] * (l.diffuse[c] + l.specular[c])).sum::<f32>()
            };
            self.radiance().iter().map(|layers| f64::from(of_point(layers))).sum()
        }

        /// The gradient of the loss: with respect to what points share, and to the blends of each.
        fn pull_back(&self) -> (StepGradient, Vec<PerMaterial>) {
            let (shaded, adjoint) = (self.radiance(), vec![RadianceAdjoint(ADJOINT); self.points.len()]);
            let samples = BlendedSamples {
                points: &self.points,
                blends: &self.blends,
                seen: &self.seen,
                shaded: &shaded,
                adjoint: &adjoint,
            };
            let numbered = [(0, self.materials[0]), (1, self.materials[1])];
            let mut back = vec![PointAdjoint::default(); self.points.len()];
            let (mut gradient, mut to_blends) = (StepGradient::default(), Vec::new());
            let (form, lighting) = (ClosedForm::default(), self.lighting());
            pull_back_blended(form, &samples, &numbered, lighting, &mut back, &mut gradient, &mut to_blends);
            (gradient, to_blends)
        }
    }

    /// Radiance is linear in weights, specular albedo and amplitudes, so that differences are exact up to rounding.
    #[test]
    fn the_adjoint_of_blended_shading_agrees_with_differences() {
        let scene = Blended::new();
        let (gradient, to_blends) = scene.pull_back();
        let base = scene.loss();
        let close = |name: &str, found: f32, moved: &Blended, step: f64| {
            let exact = (moved.loss() - base) / step;
            assert!((f64::from(found) - exact).abs() < 1e-2 * exact.abs() + 1e-3, "{name}: {found} {exact}");
        };
        for k in 0..2 {
            let mut moved = scene.clone();
            moved.materials[k].albedo[1] += 0.25;
            close("specular albedo", gradient.specular[k].albedo[1], &moved, 0.25);
            let mut moved = scene.clone();
            moved.blends.iter_mut().for_each(|blend| blend.0[k] += 0.25);
            close("weight", to_blends.iter().map(|adjoint| adjoint[k]).sum(), &moved, 0.25);
        }
        let brighter = |i: usize| {
            let mut lobe = scene.lobes.get(i);
            lobe.amplitude[2] += if i == 3 { 1.0 } else { 0.0 };
            lobe
        };
        let moved = Blended { lobes: LobeColumns::from_lobes((0..20).map(brighter)), ..scene.clone() };
        close("amplitude", gradient.shared.lobes.get(3).amplitude[2], &moved, 1.0);
    }

    /// All of the second material at 1, of the first at 0.
    fn ramp(part: f32) -> PointBlend {
        let mut blend = PointBlend::default();
        (blend.0[0], blend.0[1]) = (1.0 - part, part);
        blend
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
