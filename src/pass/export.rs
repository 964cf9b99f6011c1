//! The `Export` pass: the object as a mesh for other programs.

use super::Session;
use super::edit::take_material;
use crate::error::{Error, Result};
use crate::material::SpecularLobe;
use crate::report::tone::srgb8;
use crate::scene::pass_types::ExportPass;
use crate::surface::Surface;
use crate::surface::atlas::TexelAtlas;
use crate::surface::gltf_export::write_glb;
use crate::surface::gltf_material::{GltfMaterial, diffuse_share};
use glam::Vec3;
use image::{ImageEncoder, codecs::png::PngEncoder};
use std::sync::Arc;

/// What is exported: a surface, the albedo of its texels, and one specular lobe.
struct Object {
    surface: Arc<Surface>,
    albedo: Vec<Vec3>,
    specular: SpecularLobe,
}

/// Writes the object as it is in the formats that the pass names.
///
/// # Errors
/// If the object has several specular lobes, or a file cannot be written.
pub fn run(session: &mut Session, pass: &ExportPass) -> Result<()> {
    let object = object(session, &pass.name)?;
    let path = session.folder(&pass.name).join("mesh.glb");
    write_glb(&path, object.surface.mesh(), Some(&object.gltf_material(&pass.name)?))?;
    session.progress.print(&format!("{}: {}", pass.name, path.display()));
    Ok(())
}

fn object(session: &mut Session, name: &str) -> Result<Object> {
    let material = take_material(&mut session.pipeline.world);
    let [specular] = material.lobes.as_slice() else {
        return Err(Error::run(name, "an object with several specular lobes cannot be exported yet"));
    };
    let albedo = material.albedo.iter().map(|albedo| albedo.0).collect();
    Ok(Object { surface: session.surface.clone(), albedo, specular: *specular })
}

impl Object {
    /// The material with the albedo as base colour, raised by what glTF dims and this BRDF does not.
    fn gltf_material(&self, name: &str) -> Result<GltfMaterial> {
        let share = diffuse_share(self.specular.albedo);
        let texture = png(name, self.surface.atlas(), self.albedo.iter().map(|a| *a / share))?;
        Ok(GltfMaterial {
            base_color_image: Some(texture),
            ..GltfMaterial::of_lobe(self.specular.albedo, self.specular.roughness)
        })
    }
}

/// An sRGB PNG of an atlas's texels; colours above 1 are cut.
fn png(name: &str, atlas: &TexelAtlas, colors: impl Iterator<Item = Vec3>) -> Result<Vec<u8>> {
    let bytes: Vec<u8> = colors.flat_map(|color| srgb8(color.min(Vec3::ONE))).collect();
    let mut png = Vec::new();
    PngEncoder::new(&mut png)
        .write_image(&bytes, atlas.width, atlas.height, image::ExtendedColorType::Rgb8)
        .map_err(|error| Error::run(name, format!("the texture cannot be encoded: {error}")))?;
    Ok(png)
}
