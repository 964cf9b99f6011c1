//! The systems of the Loss, Gradient and Update stages; each fetches columns and calls a kernel.
//!
//! With several base materials, samples are worked on in chunks of [`CHUNK`], and what they share
//! is summed over chunks in their order: the bits do not depend on which process has which chunk.

use crate::fit::components::{
    AdamStep, AlbedoGradient, AlbedoMoments, Bounded, LobeMoments, LossState, Moments, SpecularMoments,
    StepGradient, StepRates, Unknowns,
};
use crate::fit::metal::{DIELECTRIC_ALBEDO, is_dielectric};
use crate::fit::{exposure::Exposures, loss::image_loss, roughness::PerMaterial};
use crate::shade::device::{ShadingDevice, failed, loops_of};
use crate::shade::systems::{Showing, kernel_materials, shade_closed_form};
use crate::visibility::WindowVisibility;
use bevy_ecs::prelude::{IntoScheduleConfigs, Query, Res, ResMut};
use bevy_ecs::{schedule::ScheduleConfigs, system::ScheduleSystem};
use glam::Vec3;
use lobelia_geometry::parallel;
use lobelia_sg::shading::{
    CHUNK, ClosedForm, Layers, Lighting, LobeColumns, LobeVisibility, PointAdjoint, PointVisibility,
    RadianceAdjoint, RadianceColumns, ShadeCall, ShadePoint, SharedGradient, SpecularAdjoint, SpecularValue,
};
use lobelia_world::light::{LightLobe, lights::IncidentLight};
use lobelia_world::material::{BaseMaterial, Diffuse, SpecularLobe, Texels, material_source::BaseMaterials};
use lobelia_world::pipeline::{Shader, SystemResult};
use lobelia_world::sample::pixel::{Observed, PixelOf};
use lobelia_world::sample::point::{PointBlend, SurfacePoint};
use lobelia_world::sample::{LightRotations, Samples};

/// Range of roughness in a fit; highlights of lower roughness are too narrow for single precision
/// and for the pixels that show them.
pub const ROUGHNESS_RANGE: Bounded = Bounded { low: 0.03, high: 1.0 };
/// Range of lobe sharpness in a fit.
const SHARPNESS_RANGE: (f32, f32) = (0.05, 1e4);
/// Range of amplitude in a fit; an amplitude of zero can never change on a logarithmic scale.
const AMPLITUDE_RANGE: (f32, f32) = (1e-5, 1e5);

/// Loss: compares shaded with observed radiance.
pub fn compare_with_photographs(
    exposures: Res<Exposures>,
    mut state: ResMut<LossState>,
    samples: Samples<(&Layers, &Observed, &PixelOf, &mut RadianceAdjoint)>,
) -> SystemResult {
    let (shaded, observed, pixels, mut adjoint) = samples.columns()?;
    let exposure = |i: usize| exposures.factor(pixels[i].view);
    state.last = image_loss(state.loss, &shaded, &observed, exposure, &mut adjoint);
    Ok(())
}

/// The columns that the adjoint of a sample reads and writes.
type PullBackColumns = (
    &'static ShadePoint,
    &'static PointBlend,
    &'static PointVisibility,
    (&'static Layers, &'static RadianceAdjoint),
    &'static PixelOf,
    &'static mut PointAdjoint,
);

/// The shader of a closed form.
pub fn closed_form_shader(form: ClosedForm) -> Shader {
    Shader { form, ..Shader::new(shade_closed_form(form)).with_adjoint(pull_back_radiance(form)) }
}

/// For [`Slot::ShadingAdjoint`](lobelia_world::pipeline::Slot::ShadingAdjoint): propagates radiance
/// adjoints back through this closed form, to the samples and to light and material.
pub fn pull_back_radiance(form: ClosedForm) -> ScheduleConfigs<ScheduleSystem> {
    let system = move |light: Res<IncidentLight>,
                       materials: Res<BaseMaterials>,
                       visibility: Option<Res<WindowVisibility>>,
                       mut gradient: ResMut<StepGradient>,
                       (turns, device): (LightRotations, Option<Res<ShadingDevice>>),
                       samples: Samples<PullBackColumns>|
          -> SystemResult {
        let (points, blends, seen, (shaded, adjoint), pixels, mut back) = samples.columns()?;
        let visibility = visibility.as_ref().and_then(|visibility| visibility.view(&seen));
        let lighting = Lighting { lobes: &light.lobes, visibility };
        let gradient = &mut *gradient;
        match kernel_materials(&materials).as_slice() {
            many @ [_, ..] if materials.blended => {
                let (points, blends, seen) = (&*points, &*blends, &*seen);
                let samples = BlendedSamples { points, blends, seen, shaded: &shaded, adjoint: &adjoint };
                pull_back_blended(form, &samples, many, lighting, &mut back, gradient);
            }
            materials => {
                let one = materials.first().map_or(SpecularValue::default(), |(_, one)| *one);
                let loops = loops_of(device.as_ref(), form, one.ndf);
                let call = ShadeCall { form, points: &points, specular: &one, lighting };
                let radiance = RadianceColumns { shaded: &shaded, adjoint: &adjoint };
                loops.shade_adjoint(call, radiance, &mut back, &mut gradient.chunks).map_err(failed)?;
                gradient.chunks.total_into(&mut gradient.shared);
                gradient.specular = vec![gradient.shared.specular];
            }
        }
        // Samples are shaded in the light's frame.
        let turns = turns.by_view();
        for (back, pixel) in back.iter_mut().zip(&*pixels) {
            if let Some(turn) = turns.get(pixel.view) {
                back.normal = (turn.transpose() * Vec3::from(back.normal)).into();
            }
        }
        Ok(())
    };
    system.into_configs()
}

/// Gradient: adds the albedo adjoints of the samples to their texels, in the order of
/// [`SampleIndex`](lobelia_world::sample::pixel::SampleIndex).
pub fn scatter_to_texels(
    samples: Samples<(&SurfacePoint, &PointAdjoint)>,
    texels: Texels<&mut AlbedoGradient>,
) -> SystemResult {
    let (points, back) = samples.columns()?;
    let mut texels = texels.columns()?.quiet();
    let texels = &mut *texels;
    for (point, back) in points.iter().zip(&*back) {
        for i in 0..4 {
            texels[point.texels.indices[i] as usize].0 += Vec3::from(back.albedo) * point.texels.weights[i];
        }
    }
    Ok(())
}

/// Update: Adam on the logit of each texel's albedo, if it has no unknown sheen; clears the
/// gradient.
pub fn move_texels(
    rates: Res<StepRates>,
    unknowns: Res<Unknowns>,
    texels: Texels<(&mut Diffuse, &mut AlbedoGradient, &mut AlbedoMoments)>,
) -> SystemResult {
    if !unknowns.albedo || unknowns.sheen {
        return Ok(());
    }
    let (mut texels, gradient, moments) = texels.columns()?;
    let (mut gradient, mut moments) = (gradient.quiet(), moments.quiet());
    let adam = AdamStep::new(rates.albedo, rates.step);
    let columns = ((&mut *texels, &mut *gradient), &mut *moments);
    parallel::for_each_row(columns, 4096, |((texel, gradient), moments)| {
        texel.albedo = moved_color(&adam, texel.albedo, gradient.0, &mut moments.0);
        gradient.0 = Vec3::ZERO;
    });
    Ok(())
}

/// A color after a step of Adam on its logit.
pub(super) fn moved_color(adam: &AdamStep, color: Vec3, gradient: Vec3, moments: &mut Moments<3>) -> Vec3 {
    let by_logit = std::array::from_fn(|c| gradient[c] * Bounded::UNIT.derivative(color[c]));
    let step = adam.advance(moments, &by_logit);
    if step == [0.0; 3] {
        return color;
    }
    Vec3::from_array(std::array::from_fn(|c| Bounded::UNIT.move_by(color[c], -step[c])))
}

/// Update: Adam on lobe axes (on the sphere), log sharpness and log amplitude.
pub fn move_lobes(
    (rates, unknowns): (Res<StepRates>, Res<Unknowns>),
    light: Res<IncidentLight>,
    gradient: Res<StepGradient>,
    mut lobes: Query<(&mut LightLobe, &mut LobeMoments)>,
) {
    if !unknowns.light {
        return;
    }
    let adam = AdamStep::new(rates.light, rates.step);
    for (i, entity) in light.entities.iter().enumerate() {
        let Ok((mut lobe, mut moments)) = lobes.get_mut(*entity) else { continue };
        let gradient = gradient.shared.lobes.get(i);
        let along = Vec3::from(gradient.axis);
        // An axis of angular width 1/√λ moves in units of that width.
        let width = 1.0 / lobe.sharpness.max(1.0).sqrt();
        let [tx, ty, tz] = ((along - lobe.axis * lobe.axis.dot(along)) * width).to_array();
        let [r, g, b] = (Vec3::from(gradient.amplitude) * lobe.amplitude).to_array();
        let by_logs = [tx, ty, tz, gradient.sharpness * lobe.sharpness, r, g, b];
        let step = adam.advance(&mut moments.0, &by_logs);
        let axis = lobe.axis - Vec3::new(step[0], step[1], step[2]) * width;
        let amplitude = lobe.amplitude * Vec3::new(-step[4], -step[5], -step[6]).exp();
        *lobe = LightLobe {
            axis: axis.normalize_or(lobe.axis),
            sharpness: (lobe.sharpness * (-step[3]).exp()).clamp(SHARPNESS_RANGE.0, SHARPNESS_RANGE.1),
            amplitude: amplitude.clamp(Vec3::splat(AMPLITUDE_RANGE.0), Vec3::splat(AMPLITUDE_RANGE.1)),
        };
    }
}

/// Update: Adam on the logits of specular albedo and roughness.
pub fn move_specular(
    (rates, unknowns): (Res<StepRates>, Res<Unknowns>),
    base_materials: Res<BaseMaterials>,
    gradient: Res<StepGradient>,
    mut materials: Query<(&BaseMaterial, &mut SpecularLobe, &mut SpecularMoments)>,
) {
    let adam = AdamStep::new(rates.specular, rates.step);
    for (entity, gradient) in base_materials.entities.iter().zip(&gradient.specular) {
        let Ok((number, mut lobe, mut moments)) = materials.get_mut(*entity) else { continue };
        let dielectric = is_dielectric(&unknowns, *number);
        let mut by_logit: [f32; 4] = std::array::from_fn(|i| match i {
            3 => gradient.roughness * ROUGHNESS_RANGE.derivative(lobe.roughness),
            c => gradient.albedo[c] * Bounded::UNIT.derivative(lobe.albedo[c]),
        });
        if unknowns.mono_specular || dielectric {
            let mean = (by_logit[0] + by_logit[1] + by_logit[2]) / 3.0;
            by_logit[..3].fill(mean);
        }
        let step = adam.advance(&mut moments.0, &by_logit);
        let mut moved = *lobe;
        if unknowns.specular_albedo {
            let channel = |c: usize| Bounded::UNIT.move_by(lobe.albedo[c], -step[c]);
            moved.albedo = Vec3::from_array(std::array::from_fn(channel));
        }
        if unknowns.roughness {
            moved.roughness = ROUGHNESS_RANGE.move_by(lobe.roughness, -step[3]);
        }
        if dielectric {
            let (low, high) = DIELECTRIC_ALBEDO;
            moved.albedo = moved.albedo.clamp(Vec3::splat(low), Vec3::splat(high));
        }
        *lobe = moved;
    }
}

/// The samples of a window, as the kernels read them.
struct BlendedSamples<'a> {
    points: &'a [ShadePoint],
    blends: &'a [PointBlend],
    seen: &'a [PointVisibility],
    shaded: &'a [Layers],
    adjoint: &'a [RadianceAdjoint],
}

/// The adjoint of shading with several materials, chunk by chunk: one material at a time, at the
/// samples that have it; diffuse light and interreflection belong to the first material of a
/// sample. The adjoint of a zero weight is left at zero.
fn pull_back_blended(
    form: ClosedForm,
    samples: &BlendedSamples<'_>,
    materials: &[(usize, SpecularValue)],
    lighting: Lighting<'_>,
    back: &mut [PointAdjoint],
    gradient: &mut StepGradient,
) {
    gradient.blends.clear();
    gradient.blends.resize(samples.points.len(), PerMaterial::default());
    let lobes = lighting.visibility.map_or(&[][..], |v| v.lobes);
    let lighting = Lighting { visibility: Some(LobeVisibility { lobes, points: samples.seen }), ..lighting };
    let out = back.chunks_mut(CHUNK).zip(gradient.blends.chunks_mut(CHUNK)).enumerate();
    let chunks: Vec<BlendedSums> = parallel::map_items(out, |(chunk, out)| {
        pull_back_chunk(form, samples, chunk, materials, lighting, out)
    });
    let mut lobes = LobeColumns::zeros(lighting.lobes.len());
    gradient.specular = vec![SpecularAdjoint::default(); materials.len()];
    for chunk in &chunks {
        lobes.add(&chunk.0);
        for (sum, one) in gradient.specular.iter_mut().zip(&chunk.1) {
            (0..3).for_each(|c| sum.albedo[c] += one.albedo[c]);
            sum.roughness += one.roughness;
        }
    }
    gradient.shared = SharedGradient { lobes, specular: gradient.specular[0] };
}

/// Gradient of what the samples of a chunk share: the light, and each base material.
type BlendedSums = (LobeColumns, Vec<SpecularAdjoint>);

/// The adjoint of one chunk of [`CHUNK`] samples; adjoints of these and of their blend weights go
/// to `out`.
fn pull_back_chunk(
    form: ClosedForm,
    samples: &BlendedSamples<'_>,
    chunk: usize,
    materials: &[(usize, SpecularValue)],
    lighting: Lighting<'_>,
    (back, blend_adjoints): (&mut [PointAdjoint], &mut [PerMaterial]),
) -> BlendedSums {
    back.fill(PointAdjoint::default());
    let rows = chunk * CHUNK..chunk * CHUNK + back.len();
    let (points, blends) = (&samples.points[rows.clone()], &samples.blends[rows.clone()]);
    let (shaded, adjoint) = (&samples.shaded[rows.clone()], &samples.adjoint[rows]);
    let lighting = Lighting { visibility: lighting.chunk(chunk, CHUNK), ..lighting };
    let mut sums = (LobeColumns::zeros(lighting.lobes.len()), Vec::new());
    let mut has_diffuse = vec![false; points.len()];
    for (place, (number, material)) in materials.iter().enumerate() {
        let mut showing = Showing::new(points, blends, lighting, materials, place);
        let is_first = |i: &usize| !std::mem::replace(&mut has_diffuse[*i], true);
        let first: Vec<bool> = showing.numbers.iter().map(is_first).collect();
        for (point, _) in showing.points.iter_mut().zip(&first).filter(|(_, first)| !**first) {
            point.albedo = [0.0; 3];
        }
        let adjoint: Vec<RadianceAdjoint> = showing.numbers.iter().map(|i| adjoint[*i]).collect();
        let mut layers = vec![Layers::default(); first.len()];
        form.shade(&showing.points, material, showing.lighting(lighting), &mut layers);
        for ((i, value), adjoint) in showing.numbers.iter().zip(&mut layers).zip(&adjoint) {
            blend_adjoints[*i][*number] = (0..3).map(|c| adjoint.0[c] * value.specular[c]).sum();
            value.diffuse = shaded[*i].diffuse;
        }
        for ((i, seen), first) in showing.numbers.iter().zip(&mut showing.seen).zip(&first) {
            seen.specular = seen.specular.map(|s| s * blends[*i].0[*number]);
            if !first {
                seen.indirect = [0.0; 3];
            }
        }
        let (mut own, mut shared) = (vec![PointAdjoint::default(); first.len()], SharedGradient::default());
        let radiance = RadianceColumns { shaded: &layers, adjoint: &adjoint };
        let lighting = showing.lighting(lighting);
        form.shade_adjoint(&showing.points, material, lighting, radiance, &mut own, &mut shared);
        for ((i, one), first) in showing.numbers.iter().zip(&own).zip(&first) {
            let sum = &mut back[*i];
            sum.normal = std::array::from_fn(|c| sum.normal[c] + one.normal[c]);
            if *first {
                sum.albedo = one.albedo;
            }
        }
        sums.0.add(&shared.lobes);
        sums.1.push(shared.specular);
    }
    sums
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
            let work = lobelia_sg::workload::Workload::new(COUNT, 20, 0.3);
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
        fn pull_back(&self) -> StepGradient {
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
            let (mut gradient, form) = (StepGradient::default(), ClosedForm::default());
            pull_back_blended(form, &samples, &numbered, self.lighting(), &mut back, &mut gradient);
            gradient
        }
    }

    /// Radiance is linear in weights, specular albedo and amplitudes, so that differences are exact
    /// up to rounding.
    #[test]
    fn the_adjoint_of_blended_shading_agrees_with_differences() {
        let scene = Blended::new();
        let gradient = scene.pull_back();
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
            close("weight", gradient.blends.iter().map(|adjoint| adjoint[k]).sum(), &moved, 0.25);
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
