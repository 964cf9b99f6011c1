//! The systems of the Loss, Gradient and Update stages; each fetches columns and calls a kernel.

use crate::fit::adam::{AdamStep, Bounded};
use crate::fit::components::{
    AlbedoGradient, AlbedoMoments, LobeGradient, LobeMoments, LossState, SpecularGradient, SpecularMoments,
    StepGradient, StepRates, Unknowns,
};
use crate::fit::exposure::Exposures;
use crate::fit::loss::image_loss;
use crate::fit::roughness::blend::{BlendAdjoints, BlendedSamples, pull_back_blended};
use crate::light::LightLobe;
use crate::material::{DiffuseAlbedo, SpecularLobe};
use crate::math::shading::{
    Layers, Lighting, PointAdjoint, PointVisibility, RadianceAdjoint, RadianceColumns, ShadePoint,
    SpecularValue,
};
use crate::pipeline::SystemResult;
use crate::sample::bundle::only_table;
use crate::sample::pixel::{Observed, PixelOf, Window};
use crate::sample::point::SurfacePoint;
use crate::shade::systems::kernel_specular;
use crate::shade::{IncidentLight, PointBlend, ShadingForm};
use crate::visibility::WindowVisibility;
use bevy_ecs::prelude::{Query, Res, ResMut};
use glam::Vec3;
use rayon::prelude::*;

/// Range of roughness a fit may reach; below, single-precision highlights outrun the pixels that could show them.
pub const ROUGHNESS_RANGE: Bounded = Bounded { low: 0.03, high: 1.0 };
/// Range of lobe sharpness a fit may reach.
const SHARPNESS_RANGE: (f32, f32) = (0.05, 1e4);
/// Least and greatest amplitude a fit may reach; zero could never move again on a logarithmic scale.
const AMPLITUDE_RANGE: (f32, f32) = (1e-5, 1e5);

/// Loss: compares shaded with observed radiance.
pub fn compare_with_photographs(
    (window, exposures): (Res<Window>, Res<Exposures>),
    mut state: ResMut<LossState>,
    mut samples: Query<(&Layers, &Observed, &PixelOf, &mut RadianceAdjoint)>,
) -> SystemResult {
    if let Some((shaded, observed, pixels, mut adjoint)) =
        only_table(samples.contiguous_iter_mut()?, |t| t.0.len(), "pixel")?
    {
        let rows = window.0.clone();
        let adjoint = &mut adjoint.bypass_change_detection()[rows.clone()];
        let pixels = &pixels[rows.clone()];
        let exposure = |i: usize| exposures.factor(pixels[i].view);
        state.last = image_loss(state.loss, &shaded[rows.clone()], &observed[rows], exposure, adjoint);
    }
    Ok(())
}

/// What the adjoint of a sample is made from.
type PullBackColumns<'a> = (
    &'a ShadePoint,
    &'a PointBlend,
    &'a PointVisibility,
    &'a Layers,
    &'a RadianceAdjoint,
    &'a mut PointAdjoint,
);

/// Gradient: pulls radiance adjoints back to the samples and to light and material.
pub fn pull_back_radiance(
    window: Res<Window>,
    (light, form): (Res<IncidentLight>, Res<ShadingForm>),
    visibility: Option<Res<WindowVisibility>>,
    materials: Query<&SpecularLobe>,
    (mut gradient, mut blend_adjoints): (ResMut<StepGradient>, ResMut<BlendAdjoints>),
    mut samples: Query<PullBackColumns>,
) -> SystemResult {
    let Some((points, blends, seen, shaded, adjoint, mut back)) =
        only_table(samples.contiguous_iter_mut()?, |t| t.0.len(), "pixel")?
    else {
        return Ok(());
    };
    let materials: Vec<SpecularValue> = materials.iter().map(kernel_specular).collect();
    let rows = window.0.clone();
    let (points, seen) = (&points[rows.clone()], &seen[rows.clone()]);
    let (shaded, adjoint) = (&shaded[rows.clone()], &adjoint[rows.clone()]);
    let back = &mut back.bypass_change_detection()[rows.clone()];
    let visibility = visibility.as_ref().and_then(|visibility| visibility.view(seen));
    let lighting = Lighting { lobes: &light.lobes, visibility };
    let gradient = &mut *gradient;
    if let [] | [_] = materials.as_slice() {
        let material = materials.first().copied().unwrap_or_default();
        let radiance = RadianceColumns { shaded, adjoint };
        form.0.shade_adjoint(points, &material, lighting, radiance, back, &mut gradient.shared);
        gradient.specular.clear();
        gradient.specular.push(gradient.shared.specular);
        return Ok(());
    }
    let samples = BlendedSamples { points, blends: &blends[rows], seen, shaded, adjoint };
    pull_back_blended(form.0, &samples, &materials, lighting, back, gradient, &mut blend_adjoints.0);
    Ok(())
}

/// Gradient: adds the samples' albedo adjoints onto the texels they blend, in row order.
pub fn scatter_to_texels(
    window: Res<Window>,
    samples: Query<(&SurfacePoint, &PointAdjoint)>,
    mut texels: Query<&mut AlbedoGradient>,
) -> SystemResult {
    let Some((points, back)) = only_table(samples.contiguous_iter()?, |t| t.0.len(), "pixel")? else {
        return Ok(());
    };
    let Some(mut texels) = only_table(texels.contiguous_iter_mut()?, |t| t.len(), "texel")? else {
        return Ok(());
    };
    let texels = texels.bypass_change_detection();
    let rows = window.0.clone();
    for (point, back) in points[rows.clone()].iter().zip(&back[rows]) {
        for i in 0..4 {
            texels[point.texels.indices[i] as usize].0 += Vec3::from(back.albedo) * point.texels.weights[i];
        }
    }
    Ok(())
}

/// Gradient: hands each light lobe and specular lobe its share.
pub fn hand_out_gradient(
    gradient: Res<StepGradient>,
    mut lobes: Query<&mut LobeGradient>,
    mut materials: Query<&mut SpecularGradient>,
) {
    for (i, mut share) in lobes.iter_mut().enumerate() {
        let lobe = gradient.shared.lobes.get(i);
        let ([x, y, z], [r, g, b]) = (lobe.axis, lobe.amplitude);
        share.0 = [x, y, z, lobe.sharpness, r, g, b];
    }
    for (mut share, specular) in materials.iter_mut().zip(&gradient.specular) {
        let [r, g, b] = specular.albedo;
        share.0 = [r, g, b, specular.roughness];
    }
}

/// Update: Adam on the logit of each texel's albedo; clears the gradient.
pub fn move_texels(
    rates: Res<StepRates>,
    unknowns: Res<Unknowns>,
    mut texels: Query<(&mut DiffuseAlbedo, &mut AlbedoGradient, &mut AlbedoMoments)>,
) -> SystemResult {
    let Some((mut albedo, mut gradient, mut moments)) =
        only_table(texels.contiguous_iter_mut()?, |t| t.0.len(), "texel")?
    else {
        return Ok(());
    };
    if !unknowns.albedo {
        return Ok(());
    }
    let adam = AdamStep::new(rates.albedo, rates.step);
    let columns = (albedo.bypass_change_detection(), gradient.bypass_change_detection());
    columns
        .0
        .par_iter_mut()
        .zip(columns.1)
        .zip(moments.bypass_change_detection())
        .with_min_len(4096)
        .for_each(|((albedo, gradient), moments)| move_texel(&adam, albedo, gradient, moments));
    Ok(())
}

fn move_texel(
    adam: &AdamStep,
    albedo: &mut DiffuseAlbedo,
    gradient: &mut AlbedoGradient,
    moments: &mut AlbedoMoments,
) {
    let value = albedo.0.to_array();
    let slope: [f32; 3] = std::array::from_fn(|c| gradient.0[c] * Bounded::UNIT.slope(value[c]));
    gradient.0 = Vec3::ZERO;
    let step = adam.advance(&mut moments.0, &slope);
    if step != [0.0; 3] {
        albedo.0 = Vec3::from_array(std::array::from_fn(|c| Bounded::UNIT.move_by(value[c], -step[c])));
    }
}

/// Update: Adam on lobe axes (along the sphere), log sharpness and log amplitude.
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
    mut materials: Query<(&mut SpecularLobe, &SpecularGradient, &mut SpecularMoments)>,
) {
    let adam = AdamStep::new(rates.specular, rates.step);
    for (mut lobe, gradient, mut moments) in &mut materials {
        *lobe = move_specular_lobe(&adam, *unknowns, &lobe, &gradient.0, &mut moments);
    }
}

fn move_specular_lobe(
    adam: &AdamStep,
    unknowns: Unknowns,
    lobe: &SpecularLobe,
    gradient: &[f32; 4],
    moments: &mut SpecularMoments,
) -> SpecularLobe {
    let mut slopes: [f32; 4] = std::array::from_fn(|i| match i {
        3 => gradient[3] * ROUGHNESS_RANGE.slope(lobe.roughness),
        c => gradient[c] * Bounded::UNIT.slope(lobe.albedo[c]),
    });
    if unknowns.mono_specular {
        let mean = (slopes[0] + slopes[1] + slopes[2]) / 3.0;
        slopes[..3].fill(mean);
    }
    let step = adam.advance(&mut moments.0, &slopes);
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
