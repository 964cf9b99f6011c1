//! From a scene to a world: the surface, the views, the light and the material as resources and
//! entities. What is unknown begins with the values that a fit starts from.

pub mod light;

pub use light::{LoadedLight, initial_lobes, load_light};

use crate::scene::{
    Albedo, AlbedoSource, Gloss, Light, MIN_ROUGHNESS, Material, PlacementLight, PlacementSpec, Roughness,
    Scene, Sheen, Specular, SpecularAlbedo, Surface as SurfaceSpec, Tilt, Views,
};
use crate::spawn::light::rotation;
use bevy_ecs::prelude::World;
use glam::Vec3;
use lobelia_geometry::mesh::{Surface, atlas::unwrap_mesh, primitive::box_mesh, primitive::sphere_mesh};
use lobelia_geometry::{error::Error, error::Result, view::Split, view::ViewRecord, view::spawn_views};
use lobelia_io::codec::{gltf::import::read_mesh_with_report, gltf::material::read_material, texture};
use lobelia_sg::brdf::Ndf;
use lobelia_solve::fit::{components::Unknowns, roughness::BASE_ROUGHNESSES, roughness::TexelRoughness};
use lobelia_solve::shape::hull::{check_hull, extract_parts, visual_hull};
use lobelia_solve::{fit::priors::NormalWeight, shape::silhouette::Silhouette};
use lobelia_world::light::placement::{LightGroup, PlacementTurn, Placements, TurnSource};
use lobelia_world::light::{groups::spawn_group_lights, light_frame::OwnLightFrame, lights::LightMap};
use lobelia_world::material::diffuse::{KnownAlong, MOST_TILT, of_albedos};
use lobelia_world::material::{SpecularBlend, SpecularLobe, USUAL_ALBEDO, spawn_materials, spawn_texels};
use lobelia_world::{pipeline::Pipeline, sample::point::Scenery};
use std::{path::Path, sync::Arc};

/// Puts the scene into the pipeline's world: surface, views, light lobes, texels, the specular
/// lobe, and what is unknown.
///
/// `light` is the scene's own, if it names one; `others` are those of [`Views::other_lights`], if
/// they are named.
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
            let albedo = match &scene.material.albedo {
                Albedo::Unknown => &AlbedoSource::Constant(Vec3::splat(USUAL_ALBEDO)),
                Albedo::Initial(source) | Albedo::Fixed(source) => source,
            };
            (given_albedo(albedo, surface)?, initial_specular(&scene.material.specular))
        }
    };
    let (specular, blends) = initial_gloss(&scene.material.gloss, specular, surface)?;
    if let Views::Dataset(data) = &scene.views
        && let Some(prior) = &data.priors.normals
    {
        pipeline.world.insert_resource(NormalWeight(prior.weight));
    }
    let world = &mut pipeline.world;
    world.insert_resource(Scenery(surface.clone()));
    world.insert_resource(unknowns(scene));
    spawn_views(world, views);
    world.insert_resource(OwnLightFrame(scene.light_frame.frame(&scene.light).unwrap_or_default()));
    world.insert_resource(placements(scene));
    world.spawn_batch(lobes.clone());
    // Lights of further groups of photographs that are not known begin as the scene's own does.
    let other = |light: &Option<LoadedLight>| match light {
        Some(light) => (light.lobes.clone(), light.map.clone()),
        None => (lobes.clone(), None),
    };
    spawn_group_lights(world, &others.iter().map(other).collect::<Vec<_>>());
    if let Some(map) = light.and_then(|light| light.map.clone()) {
        world.spawn(LightMap(map));
    }
    insert_known_along(world, &scene.material.sheen, surface)?;
    let mut diffuse = of_albedos(world, albedo);
    if let Tilt::Fixed(path) = &scene.material.tilt {
        let (width, height) = (surface.atlas().width, surface.atlas().height);
        let known = texture::read_vectors(path, ["X", "Y", "Z"], width, height)?;
        let texels = diffuse.iter_mut().zip(known);
        texels.for_each(|(texel, tilt)| texel.tilt = tilt.clamp_length_max(MOST_TILT));
    }
    spawn_texels(world, &diffuse, &blends);
    spawn_materials(world, &specular);
    Ok(())
}

/// Returns the turn of the object in each placement as the scene says it, and whose light is there.
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

/// Returns the unknowns that a fit of this scene may move.
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

/// Albedo and roughness from which the base materials start that a fit may choose instead of one:
/// what may be metal (between [metal and dielectrics](lobelia_solve::fit::metal)), and a
/// dielectric.
const METAL: (f32, f32) = (0.3, 0.25);
const DIELECTRIC: (f32, f32) = (0.04, 0.5);

/// The roughest base material at first, over the least rough.
const SPREAD: f32 = 2.5;

/// The base materials and each texel's blend of them, starting from the lobe `specular`.
fn initial_gloss(
    gloss: &Gloss,
    specular: SpecularLobe,
    surface: &Surface,
) -> Result<(Vec<SpecularLobe>, Vec<SpecularBlend>)> {
    let (width, height) = (surface.atlas().width, surface.atlas().height);
    let count = (width * height) as usize;
    match gloss {
        Gloss::Auto | Gloss::One => Ok((vec![specular], vec![SpecularBlend::default(); count])),
        Gloss::Blend { materials } => {
            // With roughnesses spread around that of `specular`.
            let place = |k: u32| k as f32 / (materials - 1) as f32 - 0.5;
            let roughness = |k| (specular.roughness * SPREAD.powf(place(k))).clamp(MIN_ROUGHNESS, 1.0);
            let lobes = (0..*materials).map(|k| SpecularLobe { roughness: roughness(k), ..specular });
            Ok((lobes.collect(), vec![SpecularBlend::even(*materials as usize); count]))
        }
        Gloss::Texels { specular: varied, .. } => {
            let lobes = BASE_ROUGHNESSES.map(|roughness| SpecularLobe { roughness, ..specular });
            let blend = SpecularBlend(TexelRoughness::first(specular.roughness, *varied).weights());
            Ok((lobes.to_vec(), vec![blend; count]))
        }
        Gloss::Fixed { lobes, weights: of } => {
            Ok((lobes.clone(), texture::read_weights(of, lobes.len(), width, height)?))
        }
    }
}

/// The base materials that a fit may choose instead of one ([`Gloss::Auto`]), and the blend that it
/// starts with: see [`metal`](lobelia_solve::fit::metal).
pub fn several_materials() -> (Vec<SpecularLobe>, SpecularBlend) {
    let lobe = |(albedo, roughness)| SpecularLobe { albedo: Vec3::splat(albedo), roughness, ndf: Ndf::Ggx };
    (vec![lobe(METAL), lobe(DIELECTRIC)], SpecularBlend::even(2))
}

/// Puts what is known of the albedo along this surface into the world.
pub(crate) fn insert_known_along(world: &mut World, sheen: &Sheen, surface: &Surface) -> Result<()> {
    match sheen {
        Sheen::Auto | Sheen::None | Sheen::Unknown => drop(world.remove_resource::<KnownAlong>()),
        Sheen::Fixed(AlbedoSource::Constant(color)) => world.insert_resource(KnownAlong::Everywhere(*color)),
        Sheen::Fixed(source) => {
            world.insert_resource(KnownAlong::Texels(given_albedo(source, surface)?));
        }
    }
    Ok(())
}

fn given_albedo(source: &AlbedoSource, surface: &Surface) -> Result<Vec<Vec3>> {
    let (width, height) = (surface.atlas().width, surface.atlas().height);
    match source {
        AlbedoSource::Constant(color) => Ok(vec![*color; (width * height) as usize]),
        AlbedoSource::Texture(path) => texture::read_texture(path, width, height),
    }
}

/// Specular albedo and roughness that a fit starts from where nothing else is said.
const START: (f32, f32) = (0.3, 0.4);

/// The lobe that a fit starts from, or the known one.
pub(crate) fn initial_specular(specular: &Specular) -> SpecularLobe {
    SpecularLobe {
        albedo: match specular.albedo {
            SpecularAlbedo::Unknown { mono: true, initial: Some(of) } => Vec3::splat(of.element_sum() / 3.0),
            SpecularAlbedo::Unknown { initial, .. } => initial.unwrap_or(Vec3::splat(START.0)),
            SpecularAlbedo::Fixed(value) => value,
        },
        roughness: match specular.roughness {
            Roughness::Unknown { initial } => initial.unwrap_or(START.1),
            Roughness::Fixed(value) => value,
        },
        ndf: specular.ndf.first(),
    }
}

/// The material of a mesh file, with what glTF's lobe leaves of the base color as albedo.
fn own_material(path: &Path, surface: &Surface) -> Result<(Vec<Vec3>, SpecularLobe)> {
    let material = read_material(path)?;
    let roughness = material.roughness.clamp(MIN_ROUGHNESS, 1.0);
    // As this project writes it: a file made by other programs means GGX, but does not say what
    // wrote it.
    let lobe = SpecularLobe::new(Vec3::ONE, roughness);
    let albedo = material.specular_albedo(&lobe);
    let factor = material.base_color * material.diffuse_share(roughness);
    let (width, height) = (surface.atlas().width, surface.atlas().height);
    let mut texels = match &material.base_color_image {
        Some(bytes) => texture::decode_texture(path, bytes, width, height)?,
        None => vec![Vec3::ONE; (width * height) as usize],
    };
    texels.iter_mut().for_each(|texel| *texel *= factor);
    Ok((texels, SpecularLobe { albedo, ..lobe }))
}

/// Use of a surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SurfaceUse {
    /// All passes.
    Lasting,
    /// Passes before a `Shape` puts another in place of an unknown surface: a coarse one will do.
    UntilShape,
    /// Checks alone: a speck stands for an unknown one, whose masks a survey has looked at.
    Checks,
}

/// Radius of that speck, world units: no camera is inside.
const SPECK: f32 = 1e-6;

/// Most cells and texels a side of an unknown surface that is to be replaced.
const DRAFT: (u32, u32) = (48, 256);

/// A surface, and notes of what was repaired on the way.
pub type Made = (Surface, Vec<String>);

/// Makes the surface, from the training views' masks where it is unknown.
///
/// # Errors
/// If the mesh cannot be read or unwrapped.
pub fn make_surface(spec: &SurfaceSpec, views: &[ViewRecord], use_of: SurfaceUse) -> Result<Made> {
    match spec {
        SurfaceSpec::Unknown { cells, texture_size } => match use_of {
            SurfaceUse::Lasting => hull_of_masks(views, *cells, *texture_size),
            SurfaceUse::UntilShape => hull_of_masks(views, DRAFT.0.min(*cells), DRAFT.1.min(*texture_size)),
            SurfaceUse::Checks => Ok((Surface::new(sphere_mesh(Vec3::ZERO, SPECK)?, DRAFT.1)?, Vec::new())),
        },
        SurfaceSpec::Mesh { path, texture_size, own_material } => {
            let (mesh, report) = read_mesh_with_report(path)?;
            let unwrapped = unwrap_mesh(&mesh, *texture_size)?;
            // Its own material needs its own texture coordinates.
            if *own_material && unwrapped.charts.is_some() {
                let problem =
                    "its texture coordinates are missing or overlap, so that its own material has no place";
                let help = "Give the material in the scene file, or unwrap the mesh in another program.";
                return Err(Error::input(path, "", problem, help));
            }
            let notes = report.notes().into_iter().chain(unwrapped.note);
            let notes = notes.map(|note| format!("{}: {note}", path.display())).collect();
            Ok((Surface::new(unwrapped.mesh, *texture_size)?, notes))
        }
        SurfaceSpec::Sphere { center, radius, texture_size } => {
            Ok((Surface::new(sphere_mesh(*center, *radius)?, *texture_size)?, Vec::new()))
        }
        SurfaceSpec::Box { center, size, texture_size } => {
            Ok((Surface::new(box_mesh(*center, *size)?, *texture_size)?, Vec::new()))
        }
    }
}

/// The visual hull of the training views' masks, on a grid of `cells` cells a side.
fn hull_of_masks(views: &[ViewRecord], cells: u32, texture_size: u32) -> Result<Made> {
    let train = views.iter().filter(|view| view.split == Split::Train);
    let silhouette = |view: &ViewRecord| Silhouette::new(&view.name, &view.camera, view.mask.as_ref()?);
    let mut silhouettes: Vec<Silhouette> = train.filter_map(silhouette).collect();
    let hull = visual_hull(&mut silhouettes, cells)?;
    let notes = check_hull(&hull, &silhouettes)?;
    let unwrapped = unwrap_mesh(&extract_parts(&hull, &silhouettes), texture_size)?;
    Ok((Surface::new(unwrapped.mesh, texture_size)?, notes))
}
