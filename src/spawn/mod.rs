//! From a scene to a world: the surface, the views, the light and the material as resources and entities.

mod light;
pub mod light_file;
mod material;
mod surface;

pub use light::{LoadedLight, initial_lobes, load_light};
pub use material::several_materials;
pub(crate) use material::{initial_specular, insert_known_along};
pub use surface::{SurfaceUse, make_surface};

use crate::error::Result;
use crate::fit::components::Unknowns;
use crate::fit::priors::{NormalMapPlugin, NormalWeight};
use crate::light::LightLobe;
use crate::light::groups::spawn_group_lights;
use crate::light::light_frame::OwnLightFrame;
use crate::light::lights::LightMap;
use crate::light::placement::{LightGroup, PlacementTurn, Placements, TurnSource};
use crate::material::{DiffuseSheen, DiffuseTilt};
use crate::material::{SpecularBlend, SpecularLobe, spawn_materials, spawn_texels};
use crate::mesh::Surface;
use crate::pipeline::Pipeline;
use crate::sample::point::Scenery;
use crate::scene::{
    Albedo, Gloss, Light, Material, PlacementLight, PlacementSpec, Roughness, Scene, Sheen, SpecularAlbedo,
    Views,
};
use crate::spawn::light_file::rotation;
use crate::view::{AlbedoMap, NormalMap, ViewIndex, ViewMask, ViewName, ViewRecord};
use bevy_ecs::prelude::World;
use glam::Vec3;
use material::{initial_albedo, initial_gloss, initial_sheen, initial_tilt, own_material};
use std::sync::Arc;

/// Puts the scene into the pipeline's world: surface, views, light lobes, texels, the specular lobe, and what is unknown.
///
/// `light` is the scene's own, if it names one; `others` are those of [`Views::other_lights`], if they are named.
///
/// # Errors
/// If an albedo texture cannot be read.
pub fn spawn(
    pipeline: &mut Pipeline,
    scene: &Scene,
    surface: &Arc<Surface>,
    views: Vec<ViewRecord>,
    light: Option<&LoadedLight>,
    others: &[Option<LoadedLight>],
) -> Result<()> {
    let lobes = initial_lobes(&scene.light, light);
    let (albedo, specular) = match scene.own_material() {
        Some(path) => own_material(path, surface)?,
        None => {
            (initial_albedo(&scene.material.albedo, surface)?, initial_specular(&scene.material.specular))
        }
    };
    let (specular, blends) = initial_gloss(&scene.material.gloss, specular, surface)?;
    if let Some(weight) = normal_weight(scene) {
        pipeline.add_plugin(&NormalMapPlugin(weight));
    }
    let world = &mut pipeline.world;
    world.insert_resource(Scenery(surface.clone()));
    world.insert_resource(unknowns(scene));
    spawn_views(world, views);
    world.insert_resource(OwnLightFrame(scene.light_frame.frame(&scene.light).unwrap_or_default()));
    world.insert_resource(placements(scene));
    world.spawn_batch(lobes.clone());
    spawn_other_lights(world, &lobes, others);
    if let Some(map) = light.and_then(|light| light.map.clone()) {
        world.spawn(LightMap(map));
    }
    insert_known_along(world, &scene.material.sheen, surface)?;
    let sheen = initial_sheen(world, &albedo);
    let tilt = initial_tilt(&scene.material.tilt, surface)?;
    spawn_texels(world, &albedo, &sheen, &tilt, &blends);
    spawn_materials(world, &specular);
    Ok(())
}

/// Spawns the lights of further groups of photographs; those that are not known begin as the scene's own does, with these lobes.
fn spawn_other_lights(world: &mut World, lobes: &[LightLobe], others: &[Option<LoadedLight>]) {
    let other = |light: &Option<LoadedLight>| match light {
        Some(light) => (light.lobes.clone(), light.map.clone()),
        None => (lobes.to_vec(), None),
    };
    spawn_group_lights(world, &others.iter().map(other).collect::<Vec<_>>());
}

/// What the scene says of how the object lies in each placement, and whose light is there.
fn placements(scene: &Scene) -> Placements {
    let mut groups = (1..).map(LightGroup);
    let mut turn = |spec: &PlacementSpec| {
        let turn = match spec.turned_degrees {
            Some(degrees) => PlacementTurn::said(rotation(degrees)),
            None => PlacementTurn::default(),
        };
        match spec.light {
            PlacementLight::Same => turn,
            // Its light is in the axes of the object, however that lies.
            PlacementLight::Own | PlacementLight::Fixed(_) => PlacementTurn {
                room_from_object: turn.room_from_object,
                ..PlacementTurn::under(groups.next().unwrap_or_default())
            },
        }
    };
    let mut turns: Vec<PlacementTurn> = match &scene.views {
        Views::Dataset(data) => data.placements.iter().map(&mut turn).collect(),
        Views::Photographed(spec) if spec.truth.rounds() > 1 => {
            let turned = vec![PlacementTurn::default(); spec.truth.placements.len() + 1];
            let lit = (1..).map(LightGroup).map(PlacementTurn::under).take(spec.truth.other_lights.len());
            turned.into_iter().chain(lit).collect()
        }
        Views::Photographed(_) | Views::Cameras(_) => Vec::new(),
    };
    turns.iter_mut().take(1).for_each(|first| first.source = TurnSource::Said);
    Placements(turns)
}

/// The weight of the scene's maps of normals, if it has some.
fn normal_weight(scene: &Scene) -> Option<NormalWeight> {
    let Views::Dataset(data) = &scene.views else { return None };
    data.priors.normals.as_ref().map(|prior| NormalWeight(prior.weight))
}

/// Spawns views, numbered on from those that are there.
pub fn spawn_views(world: &mut World, views: Vec<ViewRecord>) {
    let next = world.query::<&ViewIndex>().iter(world).map(|index| index.0 + 1).max().unwrap_or(0);
    for (view, index) in views.into_iter().zip(next..) {
        let mut entity =
            world.spawn((ViewIndex(index), ViewName(view.name), view.camera, view.split, view.placement));
        if let Some(photograph) = view.photograph {
            entity.insert(photograph);
        }
        if let Some(mask) = view.mask {
            entity.insert(ViewMask(mask));
        }
        if let Some(albedo) = view.priors.albedo {
            entity.insert(AlbedoMap(albedo));
        }
        if let Some(normals) = view.priors.normals {
            entity.insert(NormalMap(normals));
        }
    }
}

/// Spawns an object: its surface, the albedo of each texel of the surface's atlas, base materials with the numbers 0, 1, … (texels show
/// the first), and the lobes of its light.
pub fn spawn_object(
    world: &mut World,
    surface: &Arc<Surface>,
    albedo: &[Vec3],
    materials: &[SpecularLobe],
    light: &[LightLobe],
) {
    world.insert_resource(Scenery(surface.clone()));
    let count = albedo.len();
    let (sheen, tilt) = (vec![DiffuseSheen::default(); count], vec![DiffuseTilt::default(); count]);
    spawn_texels(world, albedo, &sheen, &tilt, &vec![SpecularBlend::default(); count]);
    spawn_materials(world, materials);
    world.spawn_batch(light.to_vec());
}

/// What a fit of this scene may move.
pub fn unknowns(scene: &Scene) -> Unknowns {
    let Material { albedo, sheen, specular, gloss, .. } = &scene.material;
    let open = scene.own_material().is_none();
    let open_gloss = open && !matches!(gloss, Gloss::Fixed { .. });
    Unknowns {
        albedo: open && !matches!(albedo, Albedo::Fixed(_)),
        sheen: open && !matches!(albedo, Albedo::Fixed(_)) && *sheen == Sheen::Unknown,
        light: !matches!(scene.light, Light::Fixed(_)),
        specular_albedo: open_gloss && matches!(specular.albedo, SpecularAlbedo::Unknown { .. }),
        mono_specular: matches!(specular.albedo, SpecularAlbedo::Unknown { mono: true, .. }),
        metal: false,
        blends: open && matches!(gloss, Gloss::Blend { .. } | Gloss::Texels { .. }),
        roughness: open_gloss
            && !matches!(gloss, Gloss::Texels { .. })
            && matches!(specular.roughness, Roughness::Unknown { .. }),
    }
}
