//! The systems in [`Slot::Visibility`].
//!
//! | system | reads | writes |
//! | --- | --- | --- |
//! | [`refresh_visibility`] | [`IncidentLight`], [`BaseMaterials`], texels, [`ObjectVisibility`] | [`ObjectVisibility`] |
//! | [`gather_visibility`], [`gather_visibility_of_step`] | the same, rays, texel addresses | [`PointVisibility`], [`WindowVisibility`] |
//!
//! Shadows and interreflection are updated when light or material have changed (`light_or_material_changed`), in a fit at most
//! every few steps (`refresh_is_due`).

use super::mirrored::LobeRays;
use super::object_visibility::{Made, ObjectVisibility, WindowVisibility};
use super::occlusion::Reflectance;
use crate::light::LightLobe;
use crate::light::lights::IncidentLight;
use crate::material::SpecularBlend;
use crate::material::material_source::{
    AlbedoColumn, BaseMaterials, BlendColumn, MaterialSource, MaterialTexels, Recovered, SheenColumn, Shown,
};
use crate::material::sheen::mean_albedo;
use crate::math::shading::PointVisibility;
use crate::pipeline::{Phase, Pipeline, Plugin, Slot, SystemResult};
use crate::ranks::Ranks;
use crate::sample::Samples;
use crate::sample::pixel::{PixelOf, ViewRay};
use crate::sample::point::{PointBlend, Scenery, SurfacePoint};
use crate::sample::turn::LightTurns;
use bevy_ecs::prelude::{
    Changed, Entity, IntoScheduleConfigs, Or, Query, Res, ResMut, Resource, SystemCondition, World,
};
use std::any::TypeId;

/// Whether this step of a fit updates shadows and interreflection; a fit does so every few steps.
#[derive(Resource, Clone, Copy, Debug)]
pub struct RefreshDue(pub bool);

/// Shadows and interreflection of the shown material in the Frame phase; needs an [`ObjectVisibility`].
pub struct FrameVisibilityPlugin;

impl Plugin for FrameVisibilityPlugin {
    fn build(&self, pipeline: &mut Pipeline) {
        pipeline.world.init_resource::<WindowVisibility>();
        let refresh = refresh_visibility::<Shown>.run_if(light_or_material_changed::<Shown>);
        pipeline.swap(Phase::Frame, Slot::Visibility, (refresh, gather_visibility).chain());
    }

    fn cleanup(world: &mut World) {
        world.insert_resource(WindowVisibility::default());
    }
}

/// Shadows and interreflection of the recovered material in the FitStep phase, updated if [`RefreshDue`] is set; needs an
/// [`ObjectVisibility`].
pub struct FitVisibilityPlugin;

impl Plugin for FitVisibilityPlugin {
    fn build(&self, pipeline: &mut Pipeline) {
        pipeline.world.init_resource::<WindowVisibility>();
        pipeline.world.insert_resource(RefreshDue(true));
        let refresh = refresh_visibility::<Recovered>
            .run_if(refresh_is_due.and_then(light_or_material_changed::<Recovered>));
        pipeline.swap(Phase::FitStep, Slot::Visibility, (refresh, gather_visibility_of_step).chain());
    }

    fn cleanup(world: &mut World) {
        world.insert_resource(WindowVisibility::default());
        world.remove_resource::<RefreshDue>();
    }
}

/// Run condition: whether this step of a fit updates visibility, or the set of lobes has changed.
pub fn refresh_is_due(
    due: Res<RefreshDue>,
    light: Res<IncidentLight>,
    object: Option<Res<ObjectVisibility>>,
) -> bool {
    due.0 || object.is_none_or(|object| object.stride != light.lobes.stride())
}

/// Changes of light and material that affect shadows and interreflection.
type Inputs<M> = Or<(
    Changed<LightLobe>,
    Changed<<M as MaterialSource>::Specular>,
    Changed<<M as MaterialSource>::Albedo>,
    Changed<<M as MaterialSource>::Sheen>,
    Changed<<M as MaterialSource>::Blend>,
)>;

/// Run condition: whether light or material have changed since the last call, or the last update was for other entities.
pub fn light_or_material_changed<M: MaterialSource>(
    light: Res<IncidentLight>,
    materials: Res<BaseMaterials>,
    object: Option<Res<ObjectVisibility>>,
    changed: Query<(), Inputs<M>>,
) -> bool {
    let sources = sources(&light, &materials);
    !object.is_some_and(|object| object.is_made_from::<M>(&sources, light.turn)) || !changed.is_empty()
}

fn sources(light: &IncidentLight, materials: &BaseMaterials) -> Vec<Entity> {
    light.entities.iter().chain(&materials.entities).copied().collect()
}

/// Gather: computes shadows and interreflection for the current light and material.
pub fn refresh_visibility<M: MaterialSource>(
    light: Res<IncidentLight>,
    materials: Res<BaseMaterials>,
    texels: MaterialTexels<M>,
    turns: LightTurns,
    ranks: Option<Res<Ranks>>,
    mut object: ResMut<ObjectVisibility>,
) -> SystemResult {
    let (albedo, sheen, _, blends) = texels.columns()?;
    // Specular light of a second reflection is treated as diffuse, but where rays find it.
    let reflectance = |texel: u32| {
        let blend = blends[texel as usize].blend();
        Reflectance {
            diffuse: mean_albedo(albedo[texel as usize].albedo(), sheen[texel as usize].sheen()),
            specular: materials.by_number().map(|(k, lobe)| lobe.albedo * blend.0[k]).sum(),
            roughness: blend.roughness(materials.by_number()),
        }
    };
    object.refresh(&light.lobes, turns.table().all(), &reflectance, ranks.as_deref())?;
    let from = sources(&light, &materials);
    object.made = Some(Made { from, turn: light.turn, source: TypeId::of::<M>() });
    Ok(())
}

/// The columns that the visibility of a point depends on.
type PointColumns = (
    &'static SurfacePoint,
    &'static ViewRay,
    &'static PixelOf,
    &'static PointBlend,
    &'static mut PointVisibility,
);

/// Gather: the visibility of the points of the window.
pub fn gather_visibility(
    object: Res<ObjectVisibility>,
    (materials, scenery): (Res<BaseMaterials>, Res<Scenery>),
    samples: Samples<PointColumns>,
    out: ResMut<WindowVisibility>,
) -> SystemResult {
    see_points(&object, &materials, LobeRays::of_frame(&*scenery.0), samples, out)
}

/// Gather: the same in a step of a fit, with fewer rays.
pub fn gather_visibility_of_step(
    object: Res<ObjectVisibility>,
    (materials, scenery): (Res<BaseMaterials>, Res<Scenery>),
    samples: Samples<PointColumns>,
    out: ResMut<WindowVisibility>,
) -> SystemResult {
    see_points(&object, &materials, LobeRays::of_step(&*scenery.0), samples, out)
}

fn see_points(
    object: &ObjectVisibility,
    materials: &BaseMaterials,
    lobe_rays: LobeRays,
    samples: Samples<PointColumns>,
    mut out: ResMut<WindowVisibility>,
) -> SystemResult {
    let (points, rays, pixels, blends, mut seen) = samples.columns()?;
    let viewer = |i: usize| (-rays[i].0.direction, pixels[i]);
    let mean = |i: usize| match materials.lobes.as_slice() {
        [(_, one)] => one.roughness,
        _ => SpecularBlend(blends[i].0).roughness(materials.by_number()),
    };
    object.window(&points, viewer, mean, Some(lobe_rays), &mut out, &mut seen);
    Ok(())
}
