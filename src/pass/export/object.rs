//! The object that is exported: its surface, and the material of its texels.

use crate::codec::gltf::dielectric::{Dielectric, GltfReflectance, GltfTable, LobeReflectance};
use crate::codec::image::{PngPixels, encode_png};
use crate::error::Result;
use crate::material::edit::MaterialState;
use crate::material::sheen::mean_albedo;
use crate::material::{MAX_SPECULAR_LOBES, SpecularBlend, SpecularLobe};
use crate::math::color::srgb_from_linear;
use crate::math::reflectance::ANGLES;
use crate::mesh::Surface;
use crate::mesh::atlas::{address, fill_uncovered, unwrap_mesh};
use crate::mesh::decimate::decimate;
use crate::mesh::nearest::NearestTriangle;
use crate::mesh::tangents::{relative_normals, texel_frames, vertex_tangents};
use crate::mesh::triangles::Mesh;
use crate::report::tone::srgb8;
use glam::{Vec2, Vec3};
use rayon::prelude::*;
use std::sync::Arc;

/// Triplets of values that hold the blend weights of a texel.
const WEIGHT_TRIPLETS: usize = MAX_SPECULAR_LOBES.div_ceil(3);

/// The exported object.
pub struct Object {
    surface: Arc<Surface>,
    /// Diffuse albedo of its texels.
    pub albedo: Vec<Vec3>,
    /// Its base materials, with their numbers.
    lobes: Vec<(usize, SpecularLobe)>,
    /// Their weights at each texel; `None` if there is one lobe with weight one everywhere.
    blends: Option<Vec<SpecularBlend>>,
    /// Of an object with fewer triangles, the normals of the full surface relative to its own ([`tangents`](crate::mesh::tangents)).
    relative_normals: Option<Vec<Vec3>>,
}

/// The material of texels in other programs.
pub struct TexelMaterial {
    /// Base color.
    pub base: Vec<Vec3>,
    /// Specular part: one for all, or one of each texel.
    pub dielectrics: Vec<Dielectric>,
    /// Roughness, as many.
    pub roughness: Vec<f32>,
}

impl TexelMaterial {
    /// What reflectance textures are multiplied by, and the textures, whose values are at most one.
    pub fn factors(&self) -> (Dielectric, Vec<(Vec3, f32)>) {
        let ratio = |d: &Dielectric| if d.f90 > 0.0 { d.f0 / d.f90 } else { Vec3::ZERO };
        let strongest = self.dielectrics.iter().map(ratio).fold(Vec3::ZERO, Vec3::max);
        let f90 = self.dielectrics.iter().map(|d| d.f90).fold(0.0, f32::max);
        let fraction = |x: Vec3| Vec3::select(strongest.cmpgt(Vec3::ZERO), x / strongest, Vec3::ONE);
        let part = |d: &Dielectric| (fraction(ratio(d)), if f90 > 0.0 { d.f90 / f90 } else { 1.0 });
        let factors = Dielectric { f0: strongest * f90, f90, diffuse_share: 1.0 };
        (factors, self.dielectrics.iter().map(part).collect())
    }
}

impl Object {
    /// The object with a material.
    pub fn new(surface: Arc<Surface>, material: MaterialState) -> Self {
        // Other programs know no sheen of this kind: they get its mean.
        let both = material.albedo.iter().zip(&material.sheen);
        let albedo = both.map(|(albedo, sheen)| mean_albedo(albedo.0, sheen.0)).collect();
        let lobes: Vec<_> = material.materials().map(|(number, lobe)| (number, *lobe)).collect();
        let is_uniform = material.uniform().is_some();
        let blends = (!is_uniform).then_some(material.blends);
        Self { surface, albedo, lobes, blends, relative_normals: None }
    }

    /// Its mesh, in the coordinates of the data.
    pub fn mesh(&self) -> &Mesh {
        self.surface.mesh()
    }

    /// Number of triangles.
    pub fn triangles(&self) -> usize {
        self.mesh().triangles.len()
    }

    /// The object with about `target` triangles; normals, albedo and weights are those of the nearest points of the full surface.
    pub fn coarser(&self, target: usize) -> Result<Self> {
        let size = self.surface.atlas().width;
        let nearest = NearestTriangle::new(self.surface.mesh());
        let below = |at: &Vec3| nearest.nearest(*at).map(|found| self.surface.hit(found));
        let mut mesh = decimate(self.surface.mesh(), target);
        let normals = mesh.positions.par_iter().map(|at| below(at).map_or(Vec3::Y, |hit| hit.normal));
        mesh.normals = normals.collect();
        let surface = Surface::new(unwrap_mesh(&mesh, size)?.mesh, size)?;
        let atlas = surface.atlas();
        let full = |(at, covered): (&Vec3, &bool)| {
            covered.then(|| below(at)).flatten().map_or(Vec3::ZERO, |hit| hit.normal)
        };
        let full: Vec<Vec3> = atlas.position.par_iter().zip(&atlas.covered).map(full).collect();
        let frames = texel_frames(surface.mesh(), &vertex_tangents(surface.mesh()), atlas);
        let normals = relative_normals(&frames, &full);
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
        let blends = self.blends.as_ref().map(|blends| carried_blends(blends, &carried));
        Ok(Self {
            surface: Arc::new(surface),
            albedo,
            lobes: self.lobes.clone(),
            blends,
            relative_normals: Some(normals),
        })
    }

    /// The specular lobe, or the mean of several over the surface.
    pub fn mean_lobe(&self) -> SpecularLobe {
        let Some(blends) = &self.blends else {
            return self.lobes.first().map_or(SpecularLobe::new(Vec3::ZERO, 1.0), |(_, lobe)| *lobe);
        };
        let covered = || blends.iter().zip(&self.surface.atlas().covered).filter(|(_, covered)| **covered);
        let count = covered().count().max(1) as f32;
        let (albedo, roughness) = covered().fold((Vec3::ZERO, 0.0), |(albedo, roughness), (blend, _)| {
            let here: Vec3 = self.lobes.iter().map(|(k, lobe)| lobe.albedo * blend.0[*k]).sum();
            (albedo + here / count, roughness + self.roughness_of(blend) / count)
        });
        SpecularLobe::new(albedo, roughness)
    }

    fn roughness_of(&self, blend: &SpecularBlend) -> f32 {
        blend.roughness(self.lobes.iter().map(|(number, lobe)| (*number, lobe)))
    }

    /// The material that reflects as much in other programs; `f90` is F90 where it is given.
    pub fn look(&self, f90: Option<f32>) -> TexelMaterial {
        let reflectances: Vec<_> = self
            .lobes
            .iter()
            .map(|(number, lobe)| (*number, lobe.albedo, LobeReflectance::of(lobe)))
            .collect();
        let target = |blend: &SpecularBlend| {
            let mut target = [Vec3::ZERO; ANGLES];
            for (number, albedo, reflectance) in reflectances.iter().filter(|(k, ..)| blend.0[*k] > 0.0) {
                reflectance.add(*albedo, blend.0[*number], &mut target);
            }
            target
        };
        let (roughness, dielectrics): (Vec<f32>, Vec<Dielectric>) = match &self.blends {
            None => {
                let lobe = self.mean_lobe();
                let found = GltfReflectance::of(lobe.roughness).fit(&target(&SpecularBlend::default()), f90);
                (vec![lobe.roughness], vec![found])
            }
            Some(blends) => {
                let table = GltfTable::default();
                let each = |blend: &SpecularBlend| {
                    let roughness = self.roughness_of(blend);
                    (roughness, table.at(roughness).fit(&target(blend), f90))
                };
                blends.par_iter().map(each).unzip()
            }
        };
        let share = |i: usize| dielectrics[i.min(dielectrics.len() - 1)].diffuse_share;
        let base = self.albedo.iter().enumerate().map(|(i, albedo)| (*albedo / share(i)).min(Vec3::ONE));
        TexelMaterial { base: base.collect(), dielectrics, roughness }
    }

    /// The albedo of each vertex, sRGB.
    pub fn vertex_colors(&self) -> Vec<[u8; 3]> {
        let atlas = self.surface.atlas();
        let color = |uv: &Vec2| address(*uv, atlas.width, atlas.height).blend(&self.albedo);
        self.surface.mesh().uvs.iter().flatten().map(|uv| srgb8(color(uv))).collect()
    }

    /// A texture of linear colors as an sRGB PNG.
    pub fn color_png(&self, colors: &[Vec3]) -> Result<Vec<u8>> {
        let bytes: Vec<u8> = colors.iter().flat_map(|color| srgb8(*color)).collect();
        self.png(&bytes, PngPixels::Rgb)
    }

    /// The roughness texture of glTF: roughness in green, linear; metallic in blue, 0.
    pub fn roughness_png(&self, roughness: &[f32]) -> Result<Vec<u8>> {
        let bytes: Vec<u8> = roughness.iter().flat_map(|r| [0, byte(*r), 0]).collect();
        self.png(&bytes, PngPixels::Rgb)
    }

    /// The normal map of an object with fewer triangles.
    pub fn normal_png(&self) -> Result<Option<Vec<u8>>> {
        let code = |normal: &Vec3| (0.5 * *normal + 0.5).to_array().map(byte);
        let bytes = |normals: &Vec<Vec3>| normals.iter().flat_map(code).collect::<Vec<u8>>();
        self.relative_normals.as_ref().map(|normals| self.png(&bytes(normals), PngPixels::Rgb)).transpose()
    }

    /// A texture of numbers in [0, 1], linear.
    pub fn gray_png(&self, values: &[f32]) -> Result<Vec<u8>> {
        let bytes: Vec<u8> = values.iter().map(|value| byte(*value)).collect();
        self.png(&bytes, PngPixels::Gray)
    }

    /// Colors as sRGB, with linear numbers as alpha.
    pub fn reflectance_png(&self, texels: &[(Vec3, f32)]) -> Result<Vec<u8>> {
        let encoded = |x: f32| byte(srgb_from_linear(x));
        let texel = |(color, alpha): &(Vec3, f32)| {
            let [r, g, b] = color.to_array().map(encoded);
            [r, g, b, byte(*alpha)]
        };
        let bytes: Vec<u8> = texels.iter().flat_map(texel).collect();
        self.png(&bytes, PngPixels::Rgba)
    }

    fn png(&self, bytes: &[u8], pixels: PngPixels) -> Result<Vec<u8>> {
        let atlas = self.surface.atlas();
        encode_png(bytes, [atlas.width, atlas.height], pixels)
    }
}

fn byte(value: f32) -> u8 {
    (value.clamp(0.0, 1.0) * 255.0 + 0.5) as u8
}

/// Blend weights as `carried` carries triplets of values from one atlas to another.
fn carried_blends(blends: &[SpecularBlend], carried: &dyn Fn(&[Vec3]) -> Vec<Vec3>) -> Vec<SpecularBlend> {
    let weight = |blend: &SpecularBlend, k: usize| blend.0.get(k).copied().unwrap_or(0.0);
    let triplets: [Vec<Vec3>; WEIGHT_TRIPLETS] = std::array::from_fn(|t| {
        let triplet = |blend: &SpecularBlend| Vec3::from_array([0, 1, 2].map(|c| weight(blend, 3 * t + c)));
        carried(&blends.iter().map(triplet).collect::<Vec<_>>())
    });
    let count = triplets[0].len();
    (0..count).map(|i| SpecularBlend(std::array::from_fn(|k| triplets[k / 3][i][k % 3]))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::material::{DiffuseAlbedo, DiffuseSheen, DiffuseTilt};
    use crate::math::brdf::Ndf;
    use crate::mesh::primitive::sphere_mesh;

    #[test]
    fn a_normal_map_has_the_normals_of_the_full_surface() {
        // Normals that vary more finely than the triangles of the coarse mesh.
        let bent = |at: Vec3| (at.normalize() + 0.2 * (9.0 * at).map(f32::sin)).normalize();
        let mut mesh = unwrap_mesh(&sphere_mesh(Vec3::ZERO, 1.0).unwrap(), 128).unwrap().mesh;
        mesh.normals = mesh.positions.iter().map(|at| bent(*at)).collect();
        let surface = Arc::new(Surface::new(mesh, 128).unwrap());
        let texels = surface.atlas().covered.len();
        let material = MaterialState {
            albedo: vec![DiffuseAlbedo(Vec3::splat(0.5)); texels],
            sheen: vec![DiffuseSheen::default(); texels],
            tilt: vec![DiffuseTilt::default(); texels],
            blends: vec![SpecularBlend::default(); texels],
            lobes: vec![Some(SpecularLobe { ndf: Ndf::Sg, ..SpecularLobe::new(Vec3::splat(0.04), 0.4) })],
        };
        let full = Object::new(surface, material);
        assert!(full.normal_png().unwrap().is_none());
        let coarse = full.coarser(120).unwrap();
        let atlas = coarse.surface.atlas();
        let frames = texel_frames(coarse.mesh(), &vertex_tangents(coarse.mesh()), atlas);
        let (mut with, mut without, mut count) = (0.0, 0.0, 0.0);
        for row in (0..atlas.covered.len()).filter(|row| atlas.covered[*row]) {
            let truth = bent(atlas.position[row].normalize());
            // As a program reads it: eight bits a channel.
            let code = coarse.relative_normals.as_ref().unwrap()[row];
            let read = (0.5 * code + 0.5).to_array().map(|value| f32::from(byte(value)) / 127.5 - 1.0);
            let mapped = (frames[row] * Vec3::from(read)).normalize();
            with += mapped.angle_between(truth).to_degrees();
            without += atlas.normal[row].angle_between(truth).to_degrees();
            count += 1.0;
        }
        let (with, without) = (with / count, without / count);
        assert!(with < 2.0 && without > 3.0 * with, "{with} {without}");
    }
}
