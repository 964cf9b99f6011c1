//! An object as a scene file, which [`open`](Object::open) and `lobelia run` read.

use crate::object::{Object, photograph::ring, show::Appearance};
use crate::scene::{
    Albedo, AlbedoSource, Dataset, Gloss, Light, LightSource, Material, NdfChoice, Pass, PlacementLight,
    PlacementSpec, Roughness, Scene, Sheen, Specular, SpecularAlbedo, Surface as SurfaceSpec, Tilt, Views,
};
use crate::{scene::load::to_ron, spawn::light::angles, spawn::light::inlined};
use bevy_ecs::prelude::World;
use glam::Vec3;
use lobelia_geometry::{error::Error, error::Result, mesh::atlas::TexelAtlas};
use lobelia_io::codec::file::{read_bytes, write_bytes};
use lobelia_io::codec::{exr::ExrLayers, nearby::missing_file_help, npy::NpyConvention, npy::write_lobes};
use lobelia_io::{codec::exr_frame::write_channels, codec::gltf::export::write_glb, dataset::Priors};
use lobelia_sg::brdf::Ndf;
use lobelia_solve::fit::cameras::CameraFit;
use lobelia_world::light::placement::{PlacementTurn, Placements, TurnSource};
use lobelia_world::light::{LightLobe, groups::lobes_of_group, light_frame::OwnLightFrame};
use lobelia_world::material::diffuse::{Diffuse, has_sheen, has_tilt};
use lobelia_world::material::{SpecularBlend, SpecularLobe, edit::MaterialState};
use std::path::{Path, PathBuf};

/// Channels of colors.
pub(crate) const RGB: [&str; 3] = ["R", "G", "B"];

impl Object {
    /// Writes the object as [`Appearance::save`] does.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub fn save(&mut self, folder: impl AsRef<Path>) -> Result<()> {
        self.shown().save(folder)
    }
}

impl Appearance<'_> {
    /// Writes `scene.ron`, `mesh.glb`, `albedo.exr` and `light.npy` into a folder: the object with
    /// the material and light that are shown, all fixed, with the scene's views (without the
    /// optimized poses of training views).
    ///
    /// # Errors
    /// If a file cannot be written.
    pub fn save(&mut self, folder: impl AsRef<Path>) -> Result<()> {
        let folder = folder.as_ref();
        let material = self.material()?;
        let (scene, surface) = (self.object.scene(), self.object.surface());
        let atlas = surface.atlas();
        write_glb(&folder.join("mesh.glb"), surface.mesh(), None)?;
        let material = write_material(folder, &material, atlas)?;
        let fixed = match &scene.light {
            Light::Fixed(source) => Some(source.clone()),
            Light::Unknown(_) | Light::Initial(_) => None,
        };
        let relit = self.relit.is_some();
        let light = save_source(self.relit.clone().unwrap_or(fixed), &self.light().0, &folder.join("light"))?;
        let world = &mut self.object.pipeline.world;
        let own = world.get_resource::<OwnLightFrame>().filter(|_| !relit);
        let frame = own.map(|own| own.0).unwrap_or_default();
        // With absolute paths; rendered photographs become cameras only, of the object in its first
        // placement. An object that is relit lies in its new light the same in all.
        let views = match &scene.views {
            Views::Dataset(spec) => {
                let path = std::path::absolute(&spec.path).map_err(Error::io("find", &spec.path))?;
                let found = world.get_resource::<CameraFit>();
                let focal_scale = spec.focal_scale * found.map_or(1.0, CameraFit::focal_factor);
                // All is known: nothing is left that prior maps would say.
                let priors = Priors::default();
                let placements = if relit { Vec::new() } else { placements_found(world, spec, folder)? };
                Views::Dataset(Dataset { path, focal_scale, priors, placements, ..spec.clone() })
            }
            Views::Cameras(cameras) => Views::Cameras(cameras.clone()),
            Views::Photographed(spec) => Views::Cameras(ring(&spec.cameras, scene.up)),
        };
        let texture_size = atlas.width;
        let saved = Scene {
            surface: SurfaceSpec::Mesh { path: "mesh.glb".into(), texture_size, own_material: false },
            views,
            light: Light::Fixed(light),
            light_frame: frame.into(),
            material,
            passes: scene.passes.iter().filter(|pass| matches!(pass, Pass::Render(_))).cloned().collect(),
            ..Scene::clone(&scene)
        };
        let text = to_ron(&saved)?;
        let text = format!("// Saved by Lobelia. Run it again with: lobelia run scene.ron\n{text}\n");
        write_bytes(&folder.join("scene.ron"), text.as_bytes())
    }
}

/// Writes the textures of a material into a folder; returns it as in a scene file there, all fixed.
/// The material may be the [recovered](lobelia_world::material::shown::recovered_material) or the
/// [shown](lobelia_solve::shade::frame::frame_material) one.
///
/// # Errors
/// If a file cannot be written.
pub fn write_material(folder: &Path, material: &MaterialState, atlas: &TexelAtlas) -> Result<Material> {
    let write = |name: &str, channels: [&str; 3], of: fn(&Diffuse) -> Vec3| {
        let values: Vec<Vec3> = material.diffuse.iter().map(of).collect();
        write_layers(&folder.join(name), atlas, vector_channels(channels, &values)).map(|()| name.into())
    };
    let mut saved = Material {
        albedo: Albedo::Fixed(AlbedoSource::Texture(write("albedo.exr", RGB, |texel| texel.albedo)?)),
        sheen: Sheen::None,
        tilt: Tilt::None,
        ..Material::default()
    };
    if has_sheen(&material.diffuse) {
        let along = write("albedo_along.exr", RGB, Diffuse::along)?;
        saved.sheen = Sheen::Fixed(AlbedoSource::Texture(along));
    }
    if has_tilt(&material.diffuse) {
        saved.tilt = Tilt::Fixed(write("albedo_tilt.exr", ["X", "Y", "Z"], |texel| texel.tilt)?);
    }
    if let Some(one) = material.uniform() {
        saved.specular = Specular {
            albedo: SpecularAlbedo::Fixed(one.albedo),
            roughness: Roughness::Fixed(one.roughness),
            ndf: if one.ndf == Ndf::Ggx { NdfChoice::Ggx } else { NdfChoice::Sg },
        };
    } else {
        // Base materials of a scene are numbered from 0: unused numbers are left out.
        let (numbers, lobes): (Vec<usize>, Vec<SpecularLobe>) =
            material.materials().map(|(number, lobe)| (number, *lobe)).unzip();
        let weights = "blend.exr";
        write_layers(&folder.join(weights), atlas, weight_channels(&material.blends, numbers))?;
        saved.gloss = Gloss::Fixed { lobes, weights: weights.into() };
    }
    Ok(saved)
}

/// Writes channels of a value for each texel, by their names.
pub(crate) fn write_layers(
    path: &Path,
    atlas: &TexelAtlas,
    channels: impl IntoIterator<Item = (String, Vec<f32>)>,
) -> Result<()> {
    let (width, height, channels) = (atlas.width, atlas.height, channels.into_iter().collect());
    write_channels(path, &ExrLayers { width, height, channels })
}

/// The channels of vectors.
pub(crate) fn vector_channels(names: [&str; 3], values: &[Vec3]) -> [(String, Vec<f32>); 3] {
    [0, 1, 2].map(|axis| (names[axis].to_owned(), values.iter().map(|v| v[axis]).collect()))
}

/// The channels of the blend weights of the base materials with these numbers for
/// [`read_weights`](lobelia_io::codec::texture::read_weights).
pub(crate) fn weight_channels(
    blends: &[SpecularBlend],
    numbers: impl IntoIterator<Item = usize>,
) -> impl Iterator<Item = (String, Vec<f32>)> {
    let weights = |k: usize| blends.iter().map(move |blend| blend.0[k]).collect();
    numbers.into_iter().enumerate().map(move |(place, k)| (format!("weight{place}"), weights(k)))
}

/// Writes a light to a file with this stem: the map that it is given by, unchanged, so that path
/// tracing with it gives the same result, or else its lobes. Returns it with the name of that file.
fn save_source(given: Option<LightSource>, lobes: &[LightLobe], stem: &Path) -> Result<LightSource> {
    let given = match given {
        Some(LightSource::Ron { path, scale, rotation_degrees: turn }) => Some(inlined(&path, scale, turn)?),
        source => source,
    };
    let name = |file: &Path| PathBuf::from(file.file_name().unwrap_or_default());
    if let Some(mut map @ LightSource::Map { .. }) = given {
        if let LightSource::Map { path, .. } = &mut map {
            let bytes = read_bytes(path, missing_file_help)?;
            let file = stem.with_extension(path.extension().unwrap_or_default());
            write_bytes(&file, &bytes)?;
            *path = name(&file);
        }
        return Ok(map);
    }
    let file = stem.with_extension("npy");
    write_lobes(&file, lobes, NpyConvention::Lobelia)?;
    let (path, convention) = (name(&file), NpyConvention::Lobelia);
    Ok(LightSource::Npy { path, convention, scale: 1.0, rotation_degrees: Vec3::ZERO })
}

/// The placements with the rotations and lights that were found.
fn placements_found(world: &mut World, spec: &Dataset, folder: &Path) -> Result<Vec<PlacementSpec>> {
    let turns = world.get_resource::<Placements>().cloned().unwrap_or_default();
    let found = |(of, turn): (&PlacementSpec, &PlacementTurn)| {
        let found = (turn.source == TurnSource::Found).then(|| angles(turn.room_from_object));
        let given = match &of.light {
            PlacementLight::Same => None,
            PlacementLight::Own => Some(None),
            PlacementLight::Fixed(source) => Some(Some(source.clone())),
        };
        let lobes = lobes_of_group(world, turn.light);
        let stem = folder.join(format!("light_{}", turn.light.0 + 1));
        let saved = |given| save_source(given, &lobes, &stem);
        let light = given.map(saved).transpose()?.map_or(PlacementLight::Same, PlacementLight::Fixed);
        Ok(PlacementSpec { turned_degrees: found.or(of.turned_degrees), light, ..of.clone() })
    };
    spec.placements.iter().zip(&turns.0).map(found).collect()
}
