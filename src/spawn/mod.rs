//! From a scene to a world: the surface, the views, the light and the material as resources and entities.
pub mod light_file;

use crate::codec::gltf::import::read_mesh_with_report;
use crate::codec::gltf::material::{diffuse_share, read_material};
use crate::codec::npy::read_lobes;
use crate::codec::texture;
use crate::error::{Error, Result};
use crate::fit::components::Unknowns;
use crate::fit::roughness::texel::{LADDER, TexelGloss};
use crate::light::illuminate::MapLight;
use crate::light::lights::LightMap;
use crate::light::map_fit::{MapFit, fit_map, target_of};
use crate::light::{EnvironmentMap, LightLobe, rotate_lobes, scale_lobes, validate_lobes};
use crate::material::{SpecularBlend, SpecularLobe, spawn_materials, spawn_texels};
use crate::math::brdf::Ndf;
use crate::mesh::atlas::unwrap_mesh;
use crate::mesh::primitive::{box_mesh, sphere_mesh};
use crate::mesh::{MAX_COORDINATE, Surface};
use crate::pipeline::Pipeline;
use crate::sample::point::Scenery;
use crate::scene::description::{
    Albedo, AlbedoSource, Gloss, Light, LightSource, Material, Roughness, Scene, SpecularAlbedo,
};
use crate::scene::description::{Specular, Surface as SurfaceSpec};
use crate::scene::validate::MIN_ROUGHNESS;
use crate::sdf::extract::extract_mesh;
use crate::shape::hull::{Silhouette, visual_hull};
use crate::shape::repair::check_hull;
use crate::spawn::light_file::inlined;
use crate::view::{Split, ViewIndex, ViewMask, ViewName, ViewRecord};
use bevy_ecs::prelude::World;
use glam::{EulerRot, Quat, Vec3};
use std::path::Path;
use std::sync::Arc;

/// What a surface is made for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SurfaceUse {
    /// All passes.
    Lasting,
    /// Those before a `Shape` puts another in place of an unknown one: a coarse one will do.
    UntilShape,
}

/// Most cells and texels a side of an unknown surface that is to be replaced.
const DRAFT: (u32, u32) = (48, 256);

/// Makes the surface, from the training views' masks where it is unknown; the notes say what was repaired on the way.
///
/// # Errors
/// If the mesh cannot be read or unwrapped.
pub fn make_surface(
    spec: &SurfaceSpec,
    views: &[ViewRecord],
    use_of: SurfaceUse,
) -> Result<(Surface, Vec<String>)> {
    match spec {
        SurfaceSpec::Unknown { cells, texture_size } => {
            let train = views.iter().filter(|view| view.split == Split::Train);
            let silhouette =
                |view: &ViewRecord| Silhouette::new(&view.name, &view.camera, view.mask.as_ref()?);
            let silhouettes: Vec<Silhouette> = train.filter_map(silhouette).collect();
            let (cells, texture_size) = match use_of {
                SurfaceUse::Lasting => (*cells, *texture_size),
                SurfaceUse::UntilShape => (DRAFT.0.min(*cells), DRAFT.1.min(*texture_size)),
            };
            let hull = visual_hull(&silhouettes, cells)?;
            let notes = check_hull(&hull, &silhouettes)?;
            let unwrapped = unwrap_mesh(&extract_mesh(&hull), texture_size)?;
            Ok((Surface::new(unwrapped.mesh, texture_size)?, notes))
        }
        SurfaceSpec::Mesh { path, texture_size, own_material } => {
            let (mesh, report) = read_mesh_with_report(path)?;
            if let Some(at) = mesh.positions.iter().find(|p| p.abs().max_element() > MAX_COORDINATE) {
                let problem = format!("a vertex is at {at}: no coordinate may be beyond {MAX_COORDINATE:e}");
                return Err(Error::input(path, "", problem, "Scale the mesh to the unit of the cameras."));
            }
            let unwrapped = unwrap_mesh(&mesh, *texture_size)?;
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

/// A light ready to shade with: lobes for closed forms, and the thing itself for path tracing.
#[derive(Clone)]
pub struct LoadedLight {
    /// SG lobes, given or fitted.
    pub lobes: Vec<LightLobe>,
    /// The map, if that is what was given.
    pub map: Option<Arc<MapLight>>,
    /// What was repaired on reading.
    pub notes: Vec<String>,
}

/// Turn about the world's x, then y, then z axis.
pub fn rotation(degrees: Vec3) -> Quat {
    let radians = degrees * (std::f32::consts::PI / 180.0);
    Quat::from_euler(EulerRot::XYZEx, radians.x, radians.y, radians.z)
}

/// Reads (and for a map, fits) a light.
///
/// # Errors
/// If a file is missing or wrong, or a lobe is.
pub fn load_light(source: &LightSource) -> Result<LoadedLight> {
    let turned = |lobes: &[LightLobe], scale: f32, degrees: Vec3| {
        rotate_lobes(&scale_lobes(lobes, Vec3::splat(scale)), rotation(degrees))
    };
    let light = match source {
        LightSource::Ron { path, scale, rotation_degrees } => {
            return load_light(&inlined(path, *scale, *rotation_degrees)?);
        }
        LightSource::Lobes { lobes, scale, rotation_degrees } => {
            let unit: Vec<LightLobe> =
                lobes.iter().map(|l| LightLobe { axis: l.axis.normalize_or(l.axis), ..*l }).collect();
            LoadedLight { lobes: turned(&unit, *scale, *rotation_degrees), map: None, notes: Vec::new() }
        }
        LightSource::Npy { path, convention, scale, rotation_degrees } => {
            let lobes = read_lobes(path, *convention)?;
            LoadedLight { lobes: turned(&lobes, *scale, *rotation_degrees), map: None, notes: Vec::new() }
        }
        LightSource::Map { path, scale, rotation_degrees, lobes, convention, upper_hemisphere, white } => {
            let (map, notes) = EnvironmentMap::read_with_notes(path)?;
            let options = MapFit { upper_hemisphere: *upper_hemisphere, white: *white, ..MapFit::default() };
            let map = target_of(&convention.to_lobelia(map).scaled(Vec3::splat(*scale)), &options);
            let fitted = fit_map(&map, *lobes as usize, &options)?.lobes;
            let turn = rotation(*rotation_degrees);
            let map = if *rotation_degrees == Vec3::ZERO { map } else { map.rotated(turn) };
            LoadedLight { lobes: rotate_lobes(&fitted, turn), map: Some(Arc::new(MapLight::new(map))), notes }
        }
    };
    validate_lobes(&light.lobes).map_err(|problem| Error::run("light", problem))?;
    Ok(light)
}

/// Puts the scene into the pipeline's world: surface, views, light lobes, texels, the specular lobe, and what is unknown.
///
/// `light` is the scene's own, if it names one.
///
/// # Errors
/// If an albedo texture cannot be read.
pub fn spawn(
    pipeline: &mut Pipeline,
    scene: &Scene,
    surface: &Arc<Surface>,
    views: Vec<ViewRecord>,
    light: Option<&LoadedLight>,
) -> Result<()> {
    let lobes = initial_lobes(&scene.light, light);
    let (albedo, specular) = match scene.own_material() {
        Some(path) => own_material(path, surface)?,
        None => {
            (initial_albedo(&scene.material.albedo, surface)?, initial_specular(&scene.material.specular))
        }
    };
    let (specular, blends) = initial_gloss(&scene.material.gloss, specular, surface)?;
    let world = &mut pipeline.world;
    world.insert_resource(Scenery(surface.clone()));
    world.insert_resource(unknowns(scene));
    spawn_views(world, views);
    world.spawn_batch(lobes);
    if let Some(map) = light.and_then(|light| light.map.clone()) {
        world.spawn(LightMap(map));
    }
    spawn_texels(world, &albedo, &blends);
    spawn_materials(world, &specular);
    Ok(())
}

/// Spawns views, numbered on from those that are there.
pub fn spawn_views(world: &mut World, views: Vec<ViewRecord>) {
    let next = world.query::<&ViewIndex>().iter(world).map(|index| index.0 + 1).max().unwrap_or(0);
    for (view, index) in views.into_iter().zip(next..) {
        let mut entity = world.spawn((ViewIndex(index), ViewName(view.name), view.camera, view.split));
        if let Some(photograph) = view.photograph {
            entity.insert(photograph);
        }
        if let Some(mask) = view.mask {
            entity.insert(ViewMask(mask));
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
    spawn_texels(world, albedo, &vec![SpecularBlend::default(); albedo.len()]);
    spawn_materials(world, materials);
    world.spawn_batch(light.to_vec());
}

/// The roughest base material at first, over the least rough.
const ROUGHNESS_SPREAD: f32 = 2.5;

/// The base materials and each texel's blend of them, starting from the lobe `specular`.
fn initial_gloss(
    gloss: &Gloss,
    specular: SpecularLobe,
    surface: &Surface,
) -> Result<(Vec<SpecularLobe>, Vec<SpecularBlend>)> {
    let (width, height) = (surface.atlas().width, surface.atlas().height);
    let count = (width * height) as usize;
    match gloss {
        Gloss::One => Ok((vec![specular], vec![SpecularBlend::default(); count])),
        Gloss::Blend { materials } => {
            let place = |k: u32| k as f32 / (materials - 1) as f32 - 0.5;
            let roughness =
                |k| (specular.roughness * ROUGHNESS_SPREAD.powf(place(k))).clamp(MIN_ROUGHNESS, 1.0);
            let lobe = |k| SpecularLobe { roughness: roughness(k), ..specular };
            let even = SpecularBlend::even(*materials as usize);
            Ok(((0..*materials).map(lobe).collect(), vec![even; count]))
        }
        Gloss::Texels { specular: varied, .. } => {
            let lobes = LADDER.map(|roughness| SpecularLobe { roughness, ..specular });
            let blend = SpecularBlend(TexelGloss::first(specular.roughness, *varied).weights());
            Ok((lobes.to_vec(), vec![blend; count]))
        }
        Gloss::Fixed { lobes, weights } => {
            Ok((lobes.clone(), texture::read_weights(weights, lobes.len(), width, height)?))
        }
    }
}

fn initial_lobes(light: &Light, loaded: Option<&LoadedLight>) -> Vec<LightLobe> {
    match (light, loaded) {
        (_, Some(loaded)) => loaded.lobes.clone(),
        (Light::Unknown(unknown), None) => LightLobe::even(unknown.lobes as usize),
        (Light::Initial(_) | Light::Fixed(_), None) => Vec::new(),
    }
}

fn initial_albedo(albedo: &Albedo, surface: &Surface) -> Result<Vec<Vec3>> {
    let (width, height) = (surface.atlas().width, surface.atlas().height);
    let grey = vec![Vec3::splat(0.4); (width * height) as usize];
    match albedo {
        Albedo::Unknown => Ok(grey),
        Albedo::Initial(source) | Albedo::Fixed(source) => match source {
            AlbedoSource::Constant(color) => Ok(vec![*color; grey.len()]),
            AlbedoSource::Texture(path) => texture::read_texture(path, width, height),
        },
    }
}

/// The lobe that a fit starts from, or the known one.
pub fn initial_specular(specular: &Specular) -> SpecularLobe {
    SpecularLobe {
        albedo: match specular.albedo {
            SpecularAlbedo::Unknown { mono: true, initial } => Vec3::splat(initial.element_sum() / 3.0),
            SpecularAlbedo::Unknown { initial, .. } => initial,
            SpecularAlbedo::Fixed(value) => value,
        },
        roughness: match specular.roughness {
            Roughness::Unknown { initial } => initial,
            Roughness::Fixed(value) => value,
        },
        ndf: specular.ndf,
    }
}

/// The material of a mesh file, with what glTF dims by 1 − F taken off the base colour.
fn own_material(path: &Path, surface: &Surface) -> Result<(Vec<Vec3>, SpecularLobe)> {
    let material = read_material(path)?;
    let albedo = material.specular_albedo();
    let factor = material.base_color * diffuse_share(albedo);
    let (width, height) = (surface.atlas().width, surface.atlas().height);
    let mut texels = match &material.base_color_image {
        Some(bytes) => texture::decode_texture(path, bytes, width, height)?,
        None => vec![Vec3::ONE; (width * height) as usize],
    };
    texels.iter_mut().for_each(|texel| *texel *= factor);
    let roughness = material.roughness.clamp(MIN_ROUGHNESS, 1.0);
    // As this project writes it: a file made by other programs means GGX, but does not say what wrote it.
    Ok((texels, SpecularLobe { albedo, roughness, ndf: Ndf::default() }))
}

/// What a fit of this scene may move.
pub fn unknowns(scene: &Scene) -> Unknowns {
    let Material { albedo, specular, gloss } = &scene.material;
    let open = scene.own_material().is_none();
    let open_gloss = open && !matches!(gloss, Gloss::Fixed { .. });
    Unknowns {
        albedo: open && !matches!(albedo, Albedo::Fixed(_)),
        light: !matches!(scene.light, Light::Fixed(_)),
        specular_albedo: open_gloss && matches!(specular.albedo, SpecularAlbedo::Unknown { .. }),
        mono_specular: matches!(specular.albedo, SpecularAlbedo::Unknown { mono: true, .. }),
        blends: open && matches!(gloss, Gloss::Blend { .. } | Gloss::Texels { .. }),
        roughness: open_gloss
            && !matches!(gloss, Gloss::Texels { .. })
            && matches!(specular.roughness, Roughness::Unknown { .. }),
    }
}
