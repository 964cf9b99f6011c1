//! The systems of the Loss, Gradient and Update stages; each fetches columns and calls a kernel.

use super::adam::{AdamStep, Bounded};
use super::components::{
    AlbedoGradient, AlbedoMoments, LobeGradient, LobeMoments, LossState, SpecularGradient, SpecularMoments,
    StepGradient, StepRates, Unknowns,
};
use super::exposure::Exposures;
use super::loss::image_loss;
use super::metal::{DIELECTRIC_ALBEDO, is_dielectric};
use super::roughness::blend::BlendAdjoints;
use super::roughness::blend_adjoint::{BlendedSamples, pull_back_blended};
use crate::light::LightLobe;
use crate::light::lights::IncidentLight;
use crate::material::material_source::BaseMaterials;
use crate::material::{BaseMaterial, DiffuseAlbedo, SpecularLobe, Texels};
use crate::math::shading::{
    ClosedForm, Layers, Lighting, PairLoops, PointAdjoint, PointVisibility, RadianceAdjoint, RadianceColumns,
    ShadeCall, ShadePoint, SpecularValue,
};
use crate::pipeline::SystemResult;
use crate::sample::Samples;
use crate::sample::pixel::{Observed, PixelOf};
use crate::sample::point::{PointBlend, SurfacePoint};
use crate::sample::turn::{LightTurns, TurnTable};
use crate::shade::device::{ShadingDevice, failed, loops_of};
use crate::shade::systems::kernel_materials;
use crate::visibility::WindowVisibility;
use bevy_ecs::prelude::{IntoScheduleConfigs, Query, Res, ResMut};
use bevy_ecs::schedule::ScheduleConfigs;
use bevy_ecs::system::ScheduleSystem;
use glam::Vec3;
use rayon::prelude::*;

/// Range of roughness in a fit; highlights of lower roughness are too narrow for single precision and for the pixels that show them.
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

/// For [`Slot::ShadingAdjoint`](crate::pipeline::Slot::ShadingAdjoint): propagates radiance adjoints back through this closed form, to the samples and to light and
/// material.
pub fn pull_back_radiance(form: ClosedForm) -> ScheduleConfigs<ScheduleSystem> {
    let system = move |light: Res<IncidentLight>,
                       materials: Res<BaseMaterials>,
                       visibility: Option<Res<WindowVisibility>>,
                       mut gradient: ResMut<StepGradient>,
                       mut blend_adjoints: ResMut<BlendAdjoints>,
                       (turns, device): (LightTurns, Option<Res<ShadingDevice>>),
                       samples: Samples<PullBackColumns>|
          -> SystemResult {
        let (points, blends, seen, (shaded, adjoint), pixels, mut back) = samples.columns()?;
        let visibility = visibility.as_ref().and_then(|visibility| visibility.view(&seen));
        let lighting = Lighting { lobes: &light.lobes, visibility };
        let samples = BlendedSamples {
            points: &points,
            blends: &blends,
            seen: &seen,
            shaded: &shaded,
            adjoint: &adjoint,
        };
        let gradient = &mut *gradient;
        match kernel_materials(&materials).as_slice() {
            many @ [_, ..] if materials.blended => {
                pull_back_blended(form, &samples, many, lighting, &mut back, gradient, &mut blend_adjoints.0);
            }
            materials => {
                let one = materials.first().map_or(SpecularValue::default(), |(_, one)| *one);
                let loops = loops_of(device.as_ref(), form, one.ndf);
                let call = ShadeCall { form, points: &points, specular: &one, lighting };
                pull_back_one(&*loops, call, &samples, &mut back, gradient).map_err(failed)?;
            }
        }
        turn_back(&turns.table(), &pixels, &mut back);
        Ok(())
    };
    system.into_configs()
}

/// The adjoint of shading with one material at all samples.
fn pull_back_one(
    loops: &dyn PairLoops,
    call: ShadeCall<'_>,
    samples: &BlendedSamples<'_>,
    back: &mut [PointAdjoint],
    gradient: &mut StepGradient,
) -> Result<(), String> {
    let radiance = RadianceColumns { shaded: samples.shaded, adjoint: samples.adjoint };
    let mut chunks = gradient.take_chunks();
    loops.shade_adjoint(call, radiance, back, &mut chunks)?;
    gradient.set_chunks(chunks);
    Ok(())
}

/// Rotates the adjoints of normals from the light's frame, in which samples are shaded, back into the world.
fn turn_back(turns: &TurnTable, pixels: &[PixelOf], back: &mut [PointAdjoint]) {
    for (back, pixel) in back.iter_mut().zip(pixels) {
        if let Some(turn) = turns.of(pixel.view) {
            back.normal = (turn.transpose() * Vec3::from(back.normal)).into();
        }
    }
}

/// Gradient: adds the albedo adjoints of the samples to their texels, in the order of [`SampleIndex`](crate::sample::pixel::SampleIndex).
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

/// Gradient: writes the gradient of each light lobe and base material to its entity.
pub fn hand_out_gradient(
    gradient: Res<StepGradient>,
    light: Res<IncidentLight>,
    base_materials: Res<BaseMaterials>,
    mut lobes: Query<&mut LobeGradient>,
    mut materials: Query<&mut SpecularGradient>,
) {
    for (i, entity) in light.entities.iter().enumerate() {
        let Ok(mut share) = lobes.get_mut(*entity) else { continue };
        let lobe = gradient.shared.lobes.get(i);
        let ([x, y, z], [r, g, b]) = (lobe.axis, lobe.amplitude);
        share.0 = [x, y, z, lobe.sharpness, r, g, b];
    }
    for (entity, specular) in base_materials.entities.iter().zip(&gradient.specular) {
        let Ok(mut share) = materials.get_mut(*entity) else { continue };
        let [r, g, b] = specular.albedo;
        share.0 = [r, g, b, specular.roughness];
    }
}

/// Update: Adam on the logit of each texel's albedo, if it has no unknown sheen; clears the gradient.
pub fn move_texels(
    rates: Res<StepRates>,
    unknowns: Res<Unknowns>,
    texels: Texels<(&mut DiffuseAlbedo, &mut AlbedoGradient, &mut AlbedoMoments)>,
) -> SystemResult {
    if !unknowns.albedo || unknowns.sheen {
        return Ok(());
    }
    let (mut albedo, gradient, moments) = texels.columns()?;
    let (mut gradient, mut moments) = (gradient.quiet(), moments.quiet());
    let adam = AdamStep::new(rates.albedo, rates.step);
    let columns = albedo.par_iter_mut().zip(&mut *gradient).zip(&mut *moments).with_min_len(4096);
    columns.for_each(|((albedo, gradient), moments)| move_texel(&adam, albedo, gradient, moments));
    Ok(())
}

/// Adam on the logit of a texel's albedo; clears its gradient.
pub(super) fn move_texel(
    adam: &AdamStep,
    albedo: &mut DiffuseAlbedo,
    gradient: &mut AlbedoGradient,
    moments: &mut AlbedoMoments,
) {
    let value = albedo.0.to_array();
    let by_logit: [f32; 3] = std::array::from_fn(|c| gradient.0[c] * Bounded::UNIT.derivative(value[c]));
    gradient.0 = Vec3::ZERO;
    let step = adam.advance(&mut moments.0, &by_logit);
    if step != [0.0; 3] {
        albedo.0 = Vec3::from_array(std::array::from_fn(|c| Bounded::UNIT.move_by(value[c], -step[c])));
    }
}

/// Update: Adam on lobe axes (on the sphere), log sharpness and log amplitude.
pub fn move_lobes(
    rates: Res<StepRates>,
    unknowns: Res<Unknowns>,
    mut lobes: Query<(&mut LightLobe, &LobeGradient, &mut LobeMoments)>,
) {
    if !unknowns.light {
        return;
    }
    let adam = AdamStep::new(rates.light, rates.step);
    for (mut lobe, gradient, mut moments) in &mut lobes {
        *lobe = move_lobe(&adam, &lobe, &gradient.0, &mut moments);
    }
}

fn move_lobe(adam: &AdamStep, lobe: &LightLobe, gradient: &[f32; 7], moments: &mut LobeMoments) -> LightLobe {
    let [x, y, z, sharpness, r, g, b] = *gradient;
    let along = Vec3::new(x, y, z);
    // An axis of angular width 1/√λ moves in units of that width.
    let width = 1.0 / lobe.sharpness.max(1.0).sqrt();
    let tangent = (along - lobe.axis * lobe.axis.dot(along)) * width;
    let amplitude = Vec3::new(r, g, b) * lobe.amplitude;
    let [tx, ty, tz] = tangent.to_array();
    let [ar, ag, ab] = amplitude.to_array();
    let step = adam.advance(&mut moments.0, &[tx, ty, tz, sharpness * lobe.sharpness, ar, ag, ab]);
    let axis = lobe.axis - Vec3::new(step[0], step[1], step[2]) * width;
    let scale = Vec3::new(-step[4], -step[5], -step[6]).exp();
    LightLobe {
        axis: axis.normalize_or(lobe.axis),
        sharpness: (lobe.sharpness * (-step[3]).exp()).clamp(SHARPNESS_RANGE.0, SHARPNESS_RANGE.1),
        amplitude: (lobe.amplitude * scale)
            .clamp(Vec3::splat(AMPLITUDE_RANGE.0), Vec3::splat(AMPLITUDE_RANGE.1)),
    }
}

/// Update: Adam on the logits of specular albedo and roughness.
pub fn move_specular(
    rates: Res<StepRates>,
    unknowns: Res<Unknowns>,
    mut materials: Query<(&BaseMaterial, &mut SpecularLobe, &SpecularGradient, &mut SpecularMoments)>,
) {
    let adam = AdamStep::new(rates.specular, rates.step);
    for (number, mut lobe, gradient, mut moments) in &mut materials {
        let dielectric = is_dielectric(&unknowns, *number);
        let unknowns = Unknowns { mono_specular: unknowns.mono_specular || dielectric, ..*unknowns };
        let mut moved = move_specular_lobe(&adam, unknowns, &lobe, &gradient.0, &mut moments);
        if dielectric {
            let (low, high) = DIELECTRIC_ALBEDO;
            moved.albedo = moved.albedo.clamp(Vec3::splat(low), Vec3::splat(high));
        }
        *lobe = moved;
    }
}

fn move_specular_lobe(
    adam: &AdamStep,
    unknowns: Unknowns,
    lobe: &SpecularLobe,
    gradient: &[f32; 4],
    moments: &mut SpecularMoments,
) -> SpecularLobe {
    let mut by_logit: [f32; 4] = std::array::from_fn(|i| match i {
        3 => gradient[3] * ROUGHNESS_RANGE.derivative(lobe.roughness),
        c => gradient[c] * Bounded::UNIT.derivative(lobe.albedo[c]),
    });
    if unknowns.mono_specular {
        let mean = (by_logit[0] + by_logit[1] + by_logit[2]) / 3.0;
        by_logit[..3].fill(mean);
    }
    let step = adam.advance(&mut moments.0, &by_logit);
    let mut moved = *lobe;
    if unknowns.specular_albedo {
        moved.albedo =
            Vec3::from_array(std::array::from_fn(|c| Bounded::UNIT.move_by(lobe.albedo[c], -step[c])));
    }
    if unknowns.roughness {
        moved.roughness = ROUGHNESS_RANGE.move_by(lobe.roughness, -step[3]);
    }
    moved
}
