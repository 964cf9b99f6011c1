//! The `Save` pass: the object as a scene that opens again.

use crate::codec::exr::ExrLayers;
use crate::codec::file::{read_bytes, write_bytes};
use crate::codec::frame::write_channels;
use crate::codec::gltf::export::write_glb;
use crate::codec::nearby::missing_file_help;
use crate::codec::npy::{NpyConvention, write_lobes};
use crate::error::{Error, Result};
use crate::fit::cameras::CameraFit;
use crate::light::LightLobe;
use crate::material::SpecularBlend;
use crate::material::edit::MaterialState;
use crate::mesh::atlas::TexelAtlas;
use crate::pass::Session;
use crate::pass::edit::take_material;
use crate::pass::photograph::ring;
use crate::scene::description::{
    Albedo, AlbedoSource, Gloss, Light, LightSource, Material, Roughness, Scene, Specular, SpecularAlbedo,
    Surface as SurfaceSpec, Views,
};
use crate::scene::load::to_ron;
use crate::scene::passes::Pass;
use crate::spawn::light_file::inlined;
use glam::Vec3;
use std::path::Path;

/// Writes `scene.ron`, `mesh.glb`, `albedo.exr` and `light.npy`: the object as it is, everything fixed, with the scene's views (poses of
/// training views that a fit moved are not among it).
///
/// # Errors
/// If a file cannot be written.
pub fn run(session: &mut Session, name: &str) -> Result<()> {
    let folder = session.folder(name);
    let material = take_material(&mut session.pipeline.world);
    let surface = session.surface.clone();
    let atlas = surface.atlas();
    write_glb(&folder.join("mesh.glb"), surface.mesh(), None)?;
    let colors: Vec<Vec3> = material.albedo.iter().map(|a| a.0).collect();
    let mut texture = ExrLayers { width: atlas.width, height: atlas.height, ..ExrLayers::default() };
    texture.insert_triple(["R", "G", "B"], &colors);
    write_channels(folder.join("albedo.exr"), &texture)?;
    let light = save_light(session, &folder)?;
    let specular = save_gloss(&material, surface.atlas(), &folder)?;
    let saved = Scene {
        surface: SurfaceSpec::Mesh {
            path: "mesh.glb".into(),
            texture_size: atlas.width,
            own_material: false,
        },
        views: saved_views(session)?,
        light: Light::Fixed(light),
        material: Material { albedo: Albedo::Fixed(AlbedoSource::Texture("albedo.exr".into())), ..specular },
        passes: session.scene.passes.iter().filter(|pass| matches!(pass, Pass::Render(_))).cloned().collect(),
        ..session.scene.clone()
    };
    let text =
        format!("// Saved by Lobelia. Run it again with: lobelia run scene.ron\n{}\n", to_ron(&saved)?);
    write_bytes(&folder.join("scene.ron"), text.as_bytes())?;
    session.progress.print(&format!("{name}: {}", folder.join("scene.ron").display()));
    Ok(())
}

/// The specular material in a scene's words; the weights of several base materials go to a file.
fn save_gloss(material: &MaterialState, atlas: &TexelAtlas, folder: &Path) -> Result<Material> {
    if let [one] = material.lobes.as_slice() {
        let specular = Specular {
            albedo: SpecularAlbedo::Fixed(one.albedo),
            roughness: Roughness::Fixed(one.roughness),
            ndf: one.ndf,
        };
        return Ok(Material { specular, ..Material::default() });
    }
    let (path, lobes) = (folder.join("blend.exr"), material.lobes.clone());
    write_weights(&path, &material.blends, lobes.len(), atlas.width, atlas.height)?;
    Ok(Material { gloss: Gloss::Fixed { lobes, weights: "blend.exr".into() }, ..Material::default() })
}

/// Writes blend weights for [`read_weights`](crate::codec::texture::read_weights).
///
/// # Errors
/// [`Error::Io`] when the system refuses.
pub fn write_weights(
    path: &Path,
    blends: &[SpecularBlend],
    materials: usize,
    width: u32,
    height: u32,
) -> Result<()> {
    let mut layers = ExrLayers { width, height, ..ExrLayers::default() };
    for k in 0..materials {
        layers.channels.insert(format!("weight{k}"), blends.iter().map(|blend| blend.0[k]).collect());
    }
    write_channels(path, &layers)
}

/// Writes the light: a fixed map as it is, so that path tracing by the map gives the same again; else the lobes.
fn save_light(session: &mut Session, folder: &Path) -> Result<LightSource> {
    let given = match &session.scene.light {
        Light::Fixed(LightSource::Ron { path, scale, rotation_degrees }) => {
            Some(inlined(path, *scale, *rotation_degrees)?)
        }
        Light::Fixed(source) => Some(source.clone()),
        Light::Unknown(_) | Light::Initial(_) => None,
    };
    if let Some(source @ LightSource::Map { path, .. }) = &given {
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
            let found =
                session.pipeline.world.get_resource::<CameraFit>().map_or(1.0, CameraFit::focal_factor);
            let focal_scale = spec.focal_scale * found;
            Ok(Views::Dataset(crate::scene::description::Dataset { path, focal_scale, ..spec.clone() }))
        }
        Views::Cameras(cameras) => Ok(Views::Cameras(cameras.clone())),
        Views::Photographed(spec) => Ok(Views::Cameras(ring(&spec.cameras, session.scene.up))),
    }
}
