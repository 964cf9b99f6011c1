//! A new world between two passes, with what a resumed run would begin the next pass with.
//!
//! A world keeps the room of every table that it ever had: the pools of observed pixels, silhouettes, bricks and texels that a `Shape`
//! or a `Fit` needs stay allocated when their entities are gone. State and derived data are told apart for checkpoints
//! ([`checkpoint`](crate::checkpoint)), so that a world can be left as well: photographs move, state is put back, the rest is made again.

use crate::checkpoint::{Span, carry, restore};
use crate::error::Result;
use crate::fit::ObjectTurned;
use crate::material::{TexelIndex, replace_materials};
use crate::pass::session::{SceneLights, Session};
use crate::pipeline::Pipeline;
use crate::profile::stage;
use crate::sample::point::Scenery;
use crate::scene::{Albedo, AlbedoSource, Gloss, Scene, Sheen, Surface, Tilt};
use crate::shape::field::ModelError;
use crate::shape::run::replace_texels;
use crate::spawn::{insert_known_along, several_materials, spawn};
use crate::view::Placement;
use crate::view::{
    AlbedoMap, Camera, NormalMap, Photograph, Split, ViewIndex, ViewMask, ViewName, ViewPriors, ViewRecord,
};
use crate::visibility::ObjectVisibility;
use bevy_ecs::prelude::{Entity, World};
use glam::Vec3;

/// Whether the world can be made again without a file that may be gone by now.
fn reads_nothing(scene: &Scene) -> bool {
    let read = |source: &AlbedoSource| matches!(source, AlbedoSource::Texture(_));
    let material = &scene.material;
    let reads = match &material.albedo {
        Albedo::Unknown => false,
        Albedo::Initial(source) | Albedo::Fixed(source) => read(source),
    };
    let reads = reads
        || matches!(&material.sheen, Sheen::Fixed(source) if read(source))
        || matches!(material.tilt, Tilt::Fixed(_))
        || matches!(material.gloss, Gloss::Fixed { .. });
    !reads && matches!(scene.surface, Surface::Unknown { .. })
}

/// Puts what the rest of a run needs into a new world, in place of the session's. Nothing changes where the scene has files to read again.
///
/// # Errors
/// Those of state that cannot be put back; no state is such.
pub(super) fn renew(session: &mut Session) -> Result<()> {
    if !reads_nothing(session.scene) {
        return Ok(());
    }
    let _renewing = stage("world renewed");
    let carried = carry(&mut session.pipeline.world, Span::Run)?;
    let views = take_views(&mut session.pipeline.world);
    let turned = session.pipeline.world.remove_resource::<ObjectTurned>();
    let traced = session.pipeline.world.remove_resource::<ObjectVisibility>();
    let error = session.pipeline.world.remove_resource::<ModelError>();
    let texels = session.pipeline.world.query::<&TexelIndex>().iter(&session.pipeline.world).len();
    // The old world goes before the new one is filled.
    session.pipeline = Pipeline::new();
    session.add_plugins();
    let SceneLights { own, of_groups, .. } = &session.lights;
    spawn(&mut session.pipeline, session.scene, &session.surface, views, own.as_ref(), of_groups)?;
    let world = &mut session.pipeline.world;
    if session.surface_found {
        world.insert_resource(Scenery(session.surface.clone()));
        insert_known_along(world, &session.scene.material.sheen, &session.surface)?;
    }
    // During a `Shape` these are not the texels of an atlas.
    replace_texels(world, &vec![Vec3::ZERO; texels]);
    if session.several {
        let (lobes, blend) = several_materials();
        replace_materials(world, &lobes, blend)?;
    }
    error.into_iter().for_each(|error| world.insert_resource(error));
    turned.into_iter().for_each(|turned| world.insert_resource(turned));
    traced.into_iter().for_each(|traced| world.insert_resource(traced.unlit()));
    restore(world, carried)
}

/// Takes the views out of a world, in their order.
fn take_views(world: &mut World) -> Vec<ViewRecord> {
    let mut query = world.query::<(&ViewIndex, Entity, &ViewName, &Camera, &Split, &Placement)>();
    let mut found: Vec<_> = query
        .iter(world)
        .map(|(index, entity, name, camera, split, of)| {
            (
                *index,
                entity,
                ViewRecord { placement: *of, ..ViewRecord::of_camera(name.0.clone(), *split, *camera) },
            )
        })
        .collect();
    found.sort_by_key(|(index, ..)| *index);
    let mut view = |(_, entity, record): (ViewIndex, Entity, ViewRecord)| {
        let mut entity = world.entity_mut(entity);
        let (photograph, mask) = (entity.take::<Photograph>(), entity.take::<ViewMask>());
        let albedo = entity.take::<AlbedoMap>().map(|map| map.0);
        let normals = entity.take::<NormalMap>().map(|map| map.0);
        let priors = ViewPriors { albedo, normals };
        ViewRecord { photograph, mask: mask.map(|mask| mask.0), priors, ..record }
    };
    found.into_iter().map(&mut view).collect()
}
