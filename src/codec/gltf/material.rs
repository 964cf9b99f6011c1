//! Conversion between glTF materials and the BRDF of this crate.
//!
//! A dielectric in glTF is a GGX lobe with Schlick's F from F0 to F90, and what it leaves of a diffuse base color; here the diffuse part
//! is not dimmed, and the lobe has another F and G. [`dielectric`](crate::codec::gltf::dielectric) finds F0 and F90 whose lobe reflects as
//! much at all angles. With r the largest channel of F0/F90:
//!
//! | glTF | value | lost |
//! | --- | --- | --- |
//! | base color | min(1, a / d), d the mean over the hemisphere of what the lobe leaves | an albedo above d is clamped to it; the falloff toward grazing angles differs |
//! | `metallicFactor` | 0 | |
//! | `roughnessFactor` | R | D is an SG here and GGX in glTF: the same peak, a longer tail |
//! | `KHR_materials_ior` | (1 + √r) / (1 − √r), r at most 0.99 | |
//! | `KHR_materials_specular` | factor F90, color F0 / (F90 r) | |
//!
//! Reading inverts this: a material that was written is read back, except for the clamping and the eight bits of the texture.

use crate::codec::gltf::dielectric::{Dielectric, GltfReflectance, LobeReflectance};
use crate::codec::gltf::file::GltfFile;
use crate::material::SpecularLobe;
use crate::{Error, Result};
use glam::Vec3;
use gltf::json::{Index, Material};
use std::path::Path;

/// A material for [`crate::codec::gltf::export::write_glb`]: base color, roughness, and the colored reflectance of a dielectric; metallic is 0.
#[derive(Clone, Debug, PartialEq)]
pub struct GltfMaterial {
    /// The material's name in the file.
    pub name: String,
    /// `baseColorFactor`, linear RGB in `[0, 1]`, times the texture.
    pub base_color: Vec3,
    /// An image file's bytes (sRGB; a PNG to be written), embedded as the base color texture; needs a mesh with texture coordinates.
    pub base_color_image: Option<Vec<u8>>,
    /// `roughnessFactor` in `[0, 1]`, times the texture; GGX's α is its square.
    pub roughness: f32,
    /// A PNG with roughness in green and metallic 0 in blue, embedded as `metallicRoughnessTexture`. Not read back.
    pub roughness_image: Option<Vec<u8>>,
    /// `specularFactor` of `KHR_materials_specular`, in `[0, 1]`.
    pub specular: f32,
    /// `specularColorFactor` of `KHR_materials_specular`, linear RGB ≥ 0.
    pub specular_color: Vec3,
    /// A PNG with factors on `specular_color` in its colors (sRGB) and on `specular` in its alpha. Not read back.
    pub specular_image: Option<Vec<u8>>,
    /// A PNG of normals relative to the mesh's tangents ([`tangents`](crate::mesh::tangents)), embedded as `normalTexture`. Not read back.
    pub normal_image: Option<Vec<u8>>,
    /// Index of refraction of `KHR_materials_ior`, ≥ 1 (1.5 is glTF's default, a reflectance of 0.04).
    pub ior: f32,
}

impl Default for GltfMaterial {
    /// A white dielectric with roughness 1: an empty glTF material, but not metallic.
    fn default() -> Self {
        Self {
            name: "surface".to_owned(),
            base_color: Vec3::ONE,
            base_color_image: None,
            roughness: 1.0,
            roughness_image: None,
            specular: 1.0,
            specular_color: Vec3::ONE,
            specular_image: None,
            normal_image: None,
            ior: 1.5,
        }
    }
}

/// Largest ratio of F0 and F90; 1 needs an infinite index of refraction.
const MAX_RATIO: f32 = 0.99;

impl GltfMaterial {
    /// A dielectric as a glTF material with a white base color.
    pub fn of_dielectric(found: &Dielectric, roughness: f32) -> Self {
        let Dielectric { f0, f90, .. } = *found;
        let ratio = if f90 > 0.0 { f0 / f90 } else { Vec3::ZERO };
        let strongest = ratio.max_element().clamp(0.0, MAX_RATIO);
        let root = strongest.sqrt();
        Self {
            roughness,
            specular: f90,
            ior: (1.0 + root) / (1.0 - root),
            specular_color: if strongest > 0.0 { ratio / strongest } else { Vec3::ONE },
            ..Self::default()
        }
    }

    /// F0, linear RGB in `[0, 1]`.
    pub fn f0(&self) -> Vec3 {
        let root = (self.ior - 1.0) / (self.ior + 1.0);
        (self.specular_color * root * root).min(Vec3::ONE) * self.specular
    }

    /// The specular albedo with which `lobe` reflects as much, whatever its own is.
    pub fn specular_albedo(&self, lobe: &SpecularLobe) -> Vec3 {
        let reflectance = GltfReflectance::of(lobe.roughness);
        reflectance.specular_albedo(self.f0(), self.specular, &LobeReflectance::of(lobe))
    }

    /// The part of diffuse light that the specular part leaves.
    pub fn diffuse_share(&self, roughness: f32) -> f32 {
        GltfReflectance::of(roughness).diffuse_share(self.f0(), self.specular)
    }
}

/// Reads the one material that all primitives of a `.glb` or `.gltf` file have.
///
/// # Errors
/// [`Error::Input`] or [`Error::Io`] if the file cannot be read, has no material or several, or one that the BRDF cannot represent.
pub fn read_material(path: &Path) -> Result<GltfMaterial> {
    let file = GltfFile::open(path)?;
    let index = only_material(&file)?;
    let place = format!("material {}", index.value());
    let material = file.item(&file.root.materials, index, "material", "a primitive")?;
    if let Some(problem) = beyond_words(&file, material) {
        let help =
            "give the material in the scene file, or export the mesh with one plain dielectric material";
        return Err(Error::input(path, place, problem, help));
    }
    let pbr = &material.pbr_metallic_roughness;
    let image = pbr.base_color_texture.as_ref().map(|info| {
        let texture = file.item(&file.root.textures, info.index, "texture", &place)?;
        file.image(texture.source, &place)
    });
    let extensions = material.extensions.as_ref();
    let ior = extensions.and_then(|e| e.ior.as_ref());
    let specular = extensions.and_then(|e| e.specular.as_ref());
    let [r, g, b, _] = pbr.base_color_factor.0;
    let default = GltfMaterial::default();
    let read = GltfMaterial {
        name: material.name.clone().unwrap_or(default.name),
        base_color: Vec3::new(r, g, b).clamp(Vec3::ZERO, Vec3::ONE),
        base_color_image: image.transpose()?,
        roughness: pbr.roughness_factor.0.clamp(0.0, 1.0),
        roughness_image: None,
        specular: specular.map_or(default.specular, |s| s.specular_factor.0.clamp(0.0, 1.0)),
        specular_color: specular
            .map_or(default.specular_color, |s| Vec3::from(s.specular_color_factor.0).max(Vec3::ZERO)),
        specular_image: None,
        normal_image: None,
        ior: ior.map_or(default.ior, |ior| ior.ior.0.max(1.0)),
    };
    let numbers = [read.roughness, read.specular, read.ior].iter().all(|x| x.is_finite());
    let finite = read.base_color.is_finite() && read.specular_color.is_finite() && numbers;
    if finite { Ok(read) } else { Err(file.error(place, "has a value that is not finite")) }
}

fn only_material(file: &GltfFile) -> Result<Index<Material>> {
    let mut used: Vec<Option<usize>> = Vec::new();
    for primitive in file.root.meshes.iter().flat_map(|mesh| &mesh.primitives) {
        used.push(primitive.material.map(|index| index.value()));
    }
    used.sort_unstable();
    used.dedup();
    match used.as_slice() {
        [Some(index)] => Ok(Index::new(*index as u32)),
        _ => {
            let problem = "not every part of the mesh has the same material";
            let help = "give the material in the scene file, or export the mesh with one material";
            Err(Error::input(&file.path, "", problem, help))
        }
    }
}

/// The property of the material that one lobe and one diffuse texture cannot represent.
fn beyond_words(file: &GltfFile, material: &Material) -> Option<&'static str> {
    let pbr = &material.pbr_metallic_roughness;
    let specular = material.extensions.as_ref().and_then(|e| e.specular.as_ref());
    let transformed = file.root.extensions_used.iter().any(|name| name == "KHR_texture_transform");
    let elsewhere = pbr.base_color_texture.as_ref().is_some_and(|t| t.tex_coord != 0 || transformed);
    let problems = [
        (pbr.metallic_factor.0 != 0.0, "is metallic"),
        (pbr.metallic_roughness_texture.is_some(), "has a roughness texture"),
        (specular.is_some_and(|s| s.specular_texture.is_some()), "has a reflectance texture"),
        (specular.is_some_and(|s| s.specular_color_texture.is_some()), "has a reflectance texture"),
        (elsewhere, "has a texture that does not use the first texture coordinates unchanged"),
    ];
    problems.into_iter().find(|(is, _)| *is).map(|(_, problem)| problem)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::codec::gltf::dielectric::dielectric_of;
    use crate::codec::gltf::export::write_glb;
    use crate::mesh::primitive::box_mesh;

    #[test]
    fn a_lobe_survives_gltf() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("mesh.glb");
        let mesh = box_mesh(Vec3::ZERO, Vec3::ONE).unwrap();
        for specular in [Vec3::new(0.3, 0.2, 0.05), Vec3::splat(0.04), Vec3::new(0.9, 0.5, 0.1)] {
            let lobe = SpecularLobe::new(specular, 0.35);
            let found = dielectric_of(&lobe);
            let written = GltfMaterial {
                base_color: Vec3::new(0.1, 0.7, 1.0),
                base_color_image: Some(vec![1, 2, 3]),
                ..GltfMaterial::of_dielectric(&found, 0.35)
            };
            write_glb(&path, &mesh, Some(&written)).unwrap();
            let read = read_material(&path).unwrap();
            assert_eq!(read, written);
            assert!(read.f0().distance(found.f0) < 2e-6, "{specular} {read:?}");
            assert!(read.specular_albedo(&lobe).distance(specular) < 2e-3, "{specular} {read:?}");
            assert!((read.diffuse_share(0.35) - found.diffuse_share).abs() < 1e-5);
        }
    }

    #[test]
    fn four_percent_is_the_default_dielectric() {
        let usual = Dielectric { f0: Vec3::splat(0.04), f90: 1.0, diffuse_share: 1.0 };
        let material = GltfMaterial::of_dielectric(&usual, 0.5);
        assert!((material.ior - 1.5).abs() < 1e-6 && material.specular_color == Vec3::ONE);
        // A mirror leaves the mean of (1 − 0.04)(1 − (1 − c)⁵) weighted by 2c over c in [0, 1].
        assert!((material.diffuse_share(0.02) - 0.96 * 20.0 / 21.0).abs() < 3e-3);
        let black = Dielectric { f0: Vec3::ZERO, f90: 0.0, diffuse_share: 1.0 };
        let material = GltfMaterial::of_dielectric(&black, 0.5);
        assert_eq!((material.f0(), material.specular, material.diffuse_share(0.5)), (Vec3::ZERO, 0.0, 1.0));
    }

    #[test]
    fn what_has_no_words_here_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("mesh.gltf");
        let refused = |materials: &str, primitives: &str, word: &str| {
            let text = format!(
                r#"{{"asset": {{"version": "2.0"}}, "materials": [{materials}], "meshes": [{{"primitives": [{primitives}]}}]}}"#
            );
            std::fs::write(&path, text).unwrap();
            let error = read_material(&path).expect_err(word);
            assert!(error.to_string().contains(word), "{error} should say {word}");
        };
        let first = r#"{"attributes": {}, "material": 0}"#;
        refused("{}", first, "metallic");
        refused("", r#"{"attributes": {}}"#, "same material");
        refused("{}, {}", &format!(r#"{first}, {{"attributes": {{}}, "material": 1}}"#), "same material");
        refused("", first, "refers to material 0");
        let rough =
            r#"{"pbrMetallicRoughness": {"metallicFactor": 0, "metallicRoughnessTexture": {"index": 0}}}"#;
        refused(rough, first, "roughness");
        let missing = r#"{"pbrMetallicRoughness": {"metallicFactor": 0, "baseColorTexture": {"index": 3}}}"#;
        refused(missing, first, "texture 3");
    }
}
