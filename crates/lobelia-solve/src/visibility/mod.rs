//! Shadows and interreflection in closed-form shading: occlusion by other parts of the object, and
//! light that they reflect.
//!
//! They are there in a phase whose [`Slot::Visibility`](lobelia_world::pipeline::Slot::Visibility)
//! is filled ([`see_shown`], [`see_recovered`], [`see_recovered_of_step`]), if the world has an
//! [`ObjectVisibility`]; else all light reaches every point.
//!
//! Diffuse light has one factor per texel and lobe, interpolated at the point like albedo, so that
//! the light can be fitted with it. Specular light has one per point, for the mirror direction and
//! the mean roughness of the base materials there. In the adjoint all factors and the
//! interreflection are constant.
//!
//! Shadows and interreflection are updated when light or material have changed
//! (`light_or_material_changed`), in a fit at most every few steps (`refresh_is_due`).
//!
//! ```
//! use glam::Vec3;
//! use lobelia_geometry::mesh::{Surface, primitive::box_mesh};
//! use lobelia_solve::visibility::{ObjectVisibility, VisibilitySettings};
//!
//! let solid = box_mesh(Vec3::ZERO, Vec3::ONE)?;
//! let mut room = solid.clone();
//! room.normals.iter_mut().for_each(|normal| *normal = -*normal);
//! let settings = VisibilitySettings { directions: 64, ..VisibilitySettings::default() };
//! // Outside a convex object nothing is in the way; inside it, its walls are.
//! assert!(ObjectVisibility::new(&Surface::new(solid, 16)?, settings).sees_all());
//! assert!(!ObjectVisibility::new(&Surface::new(room, 16)?, settings).sees_all());
//! # Ok::<(), lobelia_geometry::Error>(())
//! ```

mod object_visibility;
pub(crate) mod occlusion;
mod point_visibility;
pub mod texel_visibility;

use bevy_ecs::prelude::{
    Changed, IntoScheduleConfigs, Or, Query, Res, ResMut, Resource, SystemCondition, resource_exists,
};
use bevy_ecs::{schedule::ScheduleConfigs, system::ScheduleSystem};
use lobelia_sg::shading::PointVisibility;
use lobelia_world::light::placement::{GroupInTurn, LightGroup};
use lobelia_world::light::{LightLobe, lights::IncidentLight};
use lobelia_world::material::material_source::{
    BaseMaterials, ColumnOf, Holds, MaterialSource, RecoveredMaterial, ShownMaterial, TexelColumns,
};
use lobelia_world::material::{Diffuse, SpecularBlend, SpecularLobe, Texels};
use lobelia_world::pipeline::SystemResult;
use lobelia_world::sample::pixel::{PixelOf, ViewRay};
use lobelia_world::sample::point::{PointBlend, Scenery, SurfacePoint};
use lobelia_world::sample::{LightRotations, Samples};
use object_visibility::Made;
use std::any::TypeId;

pub use object_visibility::{ObjectVisibility, VisibilitySettings, WindowVisibility};
pub use occlusion::Reflectance;
pub use point_visibility::LobeRays;

/// Whether this step of a fit updates shadows and interreflection; a fit does so every few steps.
#[derive(Resource, Clone, Copy, Debug)]
pub struct RefreshDue(pub bool);

/// For [`Slot::Visibility`](lobelia_world::pipeline::Slot::Visibility): shadows and interreflection
/// of the shown material, updated whenever it or the light has changed, if there is an
/// [`ObjectVisibility`].
pub fn see_shown() -> ScheduleConfigs<ScheduleSystem> {
    see_material::<ShownMaterial>()
}

/// [`see_shown`] for the recovered material.
pub fn see_recovered() -> ScheduleConfigs<ScheduleSystem> {
    see_material::<RecoveredMaterial>()
}

// Not for other crates: it would be compiled as they are, and their passes are not optimized.
fn see_material<M: MaterialSource>() -> ScheduleConfigs<ScheduleSystem> {
    let refresh = refresh_visibility::<M>.run_if(light_or_material_changed::<M>);
    (refresh, gather_visibility::<false>).chain().distributive_run_if(resource_exists::<ObjectVisibility>)
}

/// [`see_recovered`] in a step of a fit, updated if [`RefreshDue`] is set.
pub fn see_recovered_of_step() -> ScheduleConfigs<ScheduleSystem> {
    let is_due = refresh_is_due.and_then(light_or_material_changed::<RecoveredMaterial>);
    let refresh = refresh_visibility::<RecoveredMaterial>.run_if(is_due);
    let systems = (take_turn, refresh, gather_visibility::<true>).chain();
    systems.distributive_run_if(resource_exists::<ObjectVisibility>)
}

/// Gather: takes up the shadows and interreflection of the [`GroupInTurn`].
fn take_turn(in_turn: Option<Res<GroupInTurn>>, mut object: ResMut<ObjectVisibility>) {
    object.turn_to(in_turn.map_or(LightGroup::OWN, |turn| turn.0));
}

/// Gather: forgets the visibility of the window before, for all light reaches points of which
/// nothing else is found.
pub fn forget_window(mut out: ResMut<WindowVisibility>) {
    out.stride = 0;
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
    Changed<ColumnOf<M, SpecularLobe>>,
    Changed<ColumnOf<M, Diffuse>>,
    Changed<ColumnOf<M, SpecularBlend>>,
)>;

/// Run condition: whether light or material have changed since the last call, or the last update
/// was for other entities.
pub fn light_or_material_changed<M: MaterialSource>(
    light: Res<IncidentLight>,
    materials: Res<BaseMaterials>,
    object: Option<Res<ObjectVisibility>>,
    changed: Query<(), Inputs<M>>,
) -> bool {
    let made = Some(inputs::<M>(&light, &materials));
    object.is_none_or(|object| object.made != made) || !changed.is_empty()
}

fn inputs<M: MaterialSource>(light: &IncidentLight, materials: &BaseMaterials) -> Made {
    let sources = light.entities.iter().chain(&materials.entities).copied().collect();
    (sources, light.turn, TypeId::of::<M>())
}

/// Gather: computes shadows and interreflection for the current light and material.
pub fn refresh_visibility<M: MaterialSource>(
    light: Res<IncidentLight>,
    materials: Res<BaseMaterials>,
    texels: Texels<TexelColumns<M>>,
    turns: LightRotations,
    mut object: ResMut<ObjectVisibility>,
) -> SystemResult {
    let (diffuse, blends) = texels.columns()?;
    // Specular light of a second reflection is treated as diffuse, but where rays find it.
    let reflectance = |texel: u32| {
        let blend = blends[texel as usize].value();
        Reflectance {
            diffuse: diffuse[texel as usize].value().mean_albedo(),
            specular: materials.by_number().map(|(k, lobe)| lobe.albedo * blend.0[k]).sum(),
            roughness: blend.roughness(materials.by_number()),
        }
    };
    object.refresh(&light.lobes, turns.by_view().all(), &reflectance);
    object.made = Some(inputs::<M>(&light, &materials));
    Ok(())
}

/// Gather: the visibility of the points of the window; with fewer rays in a step of a fit.
pub fn gather_visibility<const OF_STEP: bool>(
    object: Res<ObjectVisibility>,
    (materials, scenery): (Res<BaseMaterials>, Res<Scenery>),
    samples: Samples<(&SurfacePoint, &ViewRay, &PixelOf, &PointBlend, &mut PointVisibility)>,
    mut out: ResMut<WindowVisibility>,
) -> SystemResult {
    let (points, rays, pixels, blends, mut seen) = samples.columns()?;
    let viewer = |i: usize| (-rays[i].0.direction, pixels[i]);
    let mean = |i: usize| match materials.lobes.as_slice() {
        [(_, one)] => one.roughness,
        _ => SpecularBlend(blends[i].0).roughness(materials.by_number()),
    };
    let lobe_rays = LobeRays::new(&*scenery.0, OF_STEP);
    object.window(&points, viewer, mean, Some(lobe_rays), &mut out, &mut seen);
    Ok(())
}
