//! The `Save` pass: the object as a scene that opens again.

use super::Session;
use super::edit::take_material;
use super::photograph::ring;
use crate::error::{Error, Result};
use crate::file::{read_bytes, write_bytes};
use crate::light::LightLobe;
use crate::light::npy::{NpyConvention, write_lobes};
use crate::report::exr_file::write_channels;
use crate::scene::load::to_ron;
use crate::scene::pass_types::Pass;
use crate::scene::types::{
    Albedo, AlbedoSource, Light, LightSource, Material, Roughness, Scene, Specular, SpecularAlbedo,
    Surface as SurfaceSpec, Views,
};
use crate::surface::gltf_export::write_glb;
use crate::view::exr_io::ExrLayers;
use crate::view::nearby::missing_file_help;
use glam::Vec3;
use std::path::Path;

/// Writes `scene.ron`, `mesh.glb`, `albedo.exr` and `light.npy`: the object as it is, everything fixed, with the scene's views.
///
/// # Errors
/// If a file cannot be written, or the object has several specular lobes.
pub fn run(session: &mut Session, name: &str) -> Result<()> {
    let folder = session.folder(name);
    let material = take_material(&mut session.pipeline.world);
    let [specular] = material.lobes.as_slice() else {
        return Err(Error::run(name, "an object with several specular lobes cannot be saved yet"));
    };
    let surface = session.surface.clone();
    let atlas = surface.atlas();
    write_glb(&folder.join("mesh.glb"), surface.mesh(), None)?;
    let colors: Vec<Vec3> = material.albedo.iter().map(|a| a.0).collect();
    let mut texture = ExrLayers { width: atlas.width, height: atlas.height, ..ExrLayers::default() };
    texture.insert_triple(["R", "G", "B"], &colors);
    write_channels(folder.join("albedo.exr"), &texture)?;
    let light = save_light(session, &folder)?;
    let saved = Scene {
        surface: SurfaceSpec::Mesh {
            path: "mesh.glb".into(),
            texture_size: atlas.width,
            own_material: false,
        },
        views: saved_views(session)?,
        light: Light::Fixed(light),
        material: Material {
            albedo: Albedo::Fixed(AlbedoSource::Texture("albedo.exr".into())),
            specular: Specular {
                albedo: SpecularAlbedo::Fixed(specular.albedo),
                roughness: Roughness::Fixed(specular.roughness),
                ndf: specular.ndf,
            },
        },
        passes: session.scene.passes.iter().filter(|pass| matches!(pass, Pass::Render(_))).cloned().collect(),
        ..session.scene.clone()
    };
    let text =
        format!("// Saved by Lobelia. Run it again with: lobelia run scene.ron\n{}\n", to_ron(&saved)?);
    write_bytes(&folder.join("scene.ron"), text.as_bytes())?;
    session.progress.print(&format!("{name}: {}", folder.join("scene.ron").display()));
    Ok(())
}

/// Writes the light: a fixed map as it is, so that path tracing by the map gives the same again; else the lobes.
fn save_light(session: &mut Session, folder: &Path) -> Result<LightSource> {
    if let Light::Fixed(source @ LightSource::Map { path, .. }) = &session.scene.light {
        let bytes = read_bytes(path, missing_file_help)?;
        let name = Path::new("light").with_extension(path.extension().unwrap_or_default());
        write_bytes(&folder.join(&name), &bytes)?;
        let mut saved = source.clone();
        if let LightSource::Map { path, .. } = &mut saved {
            *path = name;
        }
        return Ok(saved);
    }
    let world = &mut session.pipeline.world;
    let lobes: Vec<LightLobe> = world.query::<&LightLobe>().iter(world).copied().collect();
    write_lobes(folder.join("light.npy"), &lobes, NpyConvention::Lobelia)?;
    Ok(LightSource::Npy {
        path: "light.npy".into(),
        convention: NpyConvention::Lobelia,
        scale: 1.0,
        rotation_degrees: Vec3::ZERO,
    })
}

/// The scene's views by absolute path; self-made photographs become bare cameras.
fn saved_views(session: &Session) -> Result<Views> {
    match &session.scene.views {
        Views::Dataset(spec) => {
            let path = std::path::absolute(&spec.path).map_err(Error::io("find", &spec.path))?;
            Ok(Views::Dataset(crate::scene::types::Dataset { path, ..spec.clone() }))
        }
        Views::Cameras(cameras) => Ok(Views::Cameras(cameras.clone())),
        Views::Photographed(spec) => Ok(Views::Cameras(ring(&spec.cameras, session.scene.up))),
    }
}
