//! The `Export` pass: the object as a mesh for other programs.

use crate::codec::gltf::export::write_glb;
use crate::codec::gltf::material::{GltfMaterial, diffuse_share};
use crate::codec::ply_obj::{ObjMaterial, write_obj, write_ply};
use crate::error::{Error, Result};
use crate::material::sheen::mean_albedo;
use crate::material::{SpecularBlend, SpecularLobe};
use crate::mesh::Surface;
use crate::mesh::atlas::{address, fill_uncovered, unwrap_mesh};
use crate::mesh::decimate::decimate;
use crate::mesh::nearest::NearestTriangle;
use crate::pass::session::Session;
use crate::pass::show::material_of;
use crate::report::tone::srgb8;
use crate::scene::{ExportPass, MeshFormat};
use glam::{Vec2, Vec3};
use image::{ImageEncoder, codecs::png::PngEncoder};
use rayon::prelude::*;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// The exported object: a surface, the albedo of its texels, and one specular lobe, whose roughness may vary.
struct Object {
    surface: Arc<Surface>,
    albedo: Vec<Vec3>,
    /// The specular lobe, or the mean of several over the surface.
    specular: SpecularLobe,
    /// Roughness of each texel, if there are several lobes.
    roughness: Option<Vec<f32>>,
}

/// Writes the object in the formats that the pass names.
///
/// # Errors
/// If the object cannot be unwrapped, or a file cannot be written.
pub fn run(session: &mut Session, pass: &ExportPass) -> Result<()> {
    let mut object = object(session, pass.of.as_deref())?;
    if let Some(target) = pass.triangles.filter(|&n| (n as usize) < object.surface.mesh().triangles.len()) {
        object = object.coarser(target as usize)?;
    }
    for format in &pass.formats {
        let path = object.write(&session.folder(&pass.name), *format)?;
        session.progress.print(&format!("{}: {}", pass.name, path.display()));
    }
    Ok(())
}

/// The object with the recovered material, or with the material of the pass `of`.
fn object(session: &mut Session, of: Option<&str>) -> Result<Object> {
    let material = material_of(session, of)?;
    let surface = session.surface.clone();
    // Other programs know no sheen of this kind: they get its mean.
    let both = material.albedo.iter().zip(&material.sheen);
    let albedo = both.map(|(albedo, sheen)| mean_albedo(albedo.0, sheen.0)).collect();
    if let Some(specular) = material.uniform() {
        return Ok(Object { surface, albedo, specular, roughness: None });
    }
    let at = |blend: &SpecularBlend| {
        let albedo: Vec3 = material.materials().map(|(k, lobe)| lobe.albedo * blend.0[k]).sum();
        (albedo, blend.roughness(material.materials()))
    };
    let texels: Vec<(Vec3, f32)> = material.blends.iter().map(at).collect();
    let covered = || texels.iter().zip(&surface.atlas().covered).filter(|(_, covered)| **covered);
    let count = covered().count().max(1) as f32;
    let mean = covered().fold((Vec3::ZERO, 0.0), |sum, (t, _)| (sum.0 + t.0 / count, sum.1 + t.1 / count));
    let specular = SpecularLobe::new(mean.0, mean.1);
    Ok(Object { surface, albedo, specular, roughness: Some(texels.iter().map(|t| t.1).collect()) })
}

impl Object {
    /// The object with about `target` triangles; normals and albedo are those of the nearest points of the full surface.
    fn coarser(&self, target: usize) -> Result<Self> {
        let size = self.surface.atlas().width;
        let nearest = NearestTriangle::new(self.surface.mesh());
        let below = |at: &Vec3| nearest.nearest(*at).map(|found| self.surface.hit(found));
        let mut mesh = decimate(self.surface.mesh(), target);
        let normals = mesh.positions.par_iter().map(|at| below(at).map_or(Vec3::Y, |hit| hit.normal));
        mesh.normals = normals.collect();
        let surface = Surface::new(unwrap_mesh(&mesh, size)?.mesh, size)?;
        let atlas = surface.atlas();
        let carried = |values: &[Vec3]| {
            let at = |(at, covered): (&Vec3, &bool)| {
                let hit = covered.then(|| below(at)).flatten();
                hit.map_or(Vec3::ZERO, |hit| hit.texels.blend(values))
            };
            let mut carried: Vec<Vec3> = atlas.position.par_iter().zip(&atlas.covered).map(at).collect();
            fill_uncovered(&mut carried, &atlas.covered, atlas);
            carried
        };
        let albedo = carried(&self.albedo);
        let roughness = self.roughness.as_ref().map(|values| {
            let gray: Vec<Vec3> = values.iter().map(|r| Vec3::splat(*r)).collect();
            carried(&gray).iter().map(|r| r.x).collect()
        });
        Ok(Self { surface: Arc::new(surface), albedo, specular: self.specular, roughness })
    }

    /// Writes one format into a folder and returns the file's path.
    fn write(&self, folder: &Path, format: MeshFormat) -> Result<PathBuf> {
        let mesh = self.surface.mesh();
        let SpecularLobe { albedo, roughness, .. } = self.specular;
        let path = match format {
            MeshFormat::Glb => folder.join("mesh.glb"),
            MeshFormat::Ply => folder.join("mesh.ply"),
            MeshFormat::Obj => folder.join("mesh.obj"),
        };
        match format {
            MeshFormat::Glb => {
                let base_color_image = Some(self.texture(diffuse_share(albedo))?);
                let mut material =
                    GltfMaterial { base_color_image, ..GltfMaterial::of_lobe(albedo, roughness) };
                if let Some(roughness) = &self.roughness {
                    material.roughness = 1.0;
                    material.roughness_image = Some(self.roughness_texture(roughness)?);
                }
                write_glb(&path, mesh, Some(&material))?;
            }
            MeshFormat::Ply => write_ply(&path, mesh, &self.vertex_colors())?,
            MeshFormat::Obj => {
                let albedo_png = &self.texture(1.0)?;
                write_obj(&path, mesh, &ObjMaterial { albedo_png, specular: albedo, roughness })?;
            }
        }
        Ok(path)
    }

    fn vertex_colors(&self) -> Vec<[u8; 3]> {
        let atlas = self.surface.atlas();
        let color = |uv: &Vec2| address(*uv, atlas.width, atlas.height).blend(&self.albedo);
        self.surface.mesh().uvs.iter().flatten().map(|uv| srgb8(color(uv))).collect()
    }

    /// The albedo divided by `share` as an sRGB PNG, clamped to 1.
    fn texture(&self, share: f32) -> Result<Vec<u8>> {
        let bytes: Vec<u8> = self.albedo.iter().flat_map(|a| srgb8((*a / share).min(Vec3::ONE))).collect();
        self.png(&bytes)
    }

    /// The roughness texture of glTF: roughness in green, linear; metallic in blue, 0.
    fn roughness_texture(&self, roughness: &[f32]) -> Result<Vec<u8>> {
        let bytes: Vec<u8> = roughness.iter().flat_map(|r| [0, (r * 255.0 + 0.5) as u8, 0]).collect();
        self.png(&bytes)
    }

    fn png(&self, bytes: &[u8]) -> Result<Vec<u8>> {
        let atlas = self.surface.atlas();
        let mut png = Vec::new();
        PngEncoder::new(&mut png)
            .write_image(bytes, atlas.width, atlas.height, image::ExtendedColorType::Rgb8)
            .map_err(|error| Error::run("export", format!("the texture cannot be encoded: {error}")))?;
        Ok(png)
    }
}
