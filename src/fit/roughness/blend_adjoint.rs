//! The adjoint of shading with several base materials ([`blend`](super::blend)).
//!
//! Samples are worked on in chunks of [`CHUNK`], and what they share is summed over chunks in their order: the bits do not depend on which process has which
//! chunk.

use super::blend::PerMaterial;
use crate::fit::components::{BlendedSums, StepGradient};
use crate::math::shading::{
    CHUNK, ClosedForm, Layers, Lighting, LobeColumns, LobeVisibility, PointAdjoint, PointVisibility,
    RadianceAdjoint, RadianceColumns, ShadePoint, SharedGradient, SpecularValue,
};
use crate::sample::point::PointBlend;
use crate::shade::systems::Showing;
use rayon::prelude::*;

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

impl BlendedSamples<'_> {
    /// Chunk `index` of [`CHUNK`] samples.
    fn chunk(&self, index: usize) -> Self {
        let rows = index * CHUNK..self.points.len().min((index + 1) * CHUNK);
        Self {
            points: &self.points[rows.clone()],
            blends: &self.blends[rows.clone()],
            seen: &self.seen[rows.clone()],
            shaded: &self.shaded[rows.clone()],
            adjoint: &self.adjoint[rows],
        }
    }
}

/// The adjoint of shading with several materials, chunk by chunk: one material at a time, at the samples that have it; diffuse light and
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
    blend_adjoints.clear();
    blend_adjoints.resize(samples.points.len(), PerMaterial::default());
    let rows = lighting.visibility.map_or(&[][..], |v| v.lobes);
    let lighting =
        Lighting { visibility: Some(LobeVisibility { lobes: rows, points: samples.seen }), ..lighting };
    let out = back.par_chunks_mut(CHUNK).zip(blend_adjoints.par_chunks_mut(CHUNK)).enumerate();
    let of_chunk = |(chunk, out): (usize, (&mut [PointAdjoint], &mut [PerMaterial]))| {
        let lighting = Lighting { visibility: lighting.chunk(chunk, CHUNK), ..lighting };
        pull_back_chunk(form, &samples.chunk(chunk), materials, lighting, out)
    };
    gradient.set_blended(out.map(of_chunk).collect(), lighting.lobes.len(), materials.len());
}

/// The same of one chunk; adjoints of its samples and of their blend weights go to `out`.
fn pull_back_chunk(
    form: ClosedForm,
    samples: &BlendedSamples<'_>,
    materials: &[(usize, SpecularValue)],
    lighting: Lighting<'_>,
    (back, blend_adjoints): (&mut [PointAdjoint], &mut [PerMaterial]),
) -> BlendedSums {
    back.fill(PointAdjoint::default());
    let mut sums = BlendedSums { lobes: LobeColumns::zeros(lighting.lobes.len()), specular: Vec::new() };
    let mut has_diffuse = vec![false; samples.points.len()];
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
        sums.lobes.add(&shared.lobes);
        sums.specular.push(shared.specular);
    }
    sums
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

#[cfg(test)]
mod tests {
    use super::*;

    /// Adjoint of the radiance of every point, per channel.
    const ADJOINT: [f32; 3] = [0.7, 0.4, 0.5];

    /// More than one chunk.
    const COUNT: usize = CHUNK + 40;

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
            let work = crate::math::workload::Workload::new(COUNT, 20, 0.3);
            Self {
                blends: (0..COUNT).map(|i| ramp(0.05 + 0.9 * i as f32 / (COUNT - 1) as f32)).collect(),
                seen: vec![PointVisibility { specular: [0.5, 0.8, 1.2], indirect: [0.1, 0.2, 0.3] }; COUNT],
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
}
