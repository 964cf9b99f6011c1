//! Conversion between glTF materials and the BRDF of this crate.
//!
//! A dielectric in glTF is a GGX lobe with Schlick's F from F0 to F90, and what it leaves of a
//! diffuse base color; here the diffuse part is not dimmed, and the lobe has another F and G. With
//! E(c) the reflectance of a lobe seen at the cosine c = n·v
//! ([`reflectance`](lobelia_sg::reflectance)), of the lobe here E_s, of glTF's F0·A + F90·B:
//!
//! - F0 (per channel) and F90 (one for all) minimize ∫ (F0·A + F90·B − E_s)² 2c dc over the
//!   channels, with 0 ≤ F0 ≤ F90 ≤ 1, as `KHR_materials_specular` has it. Both are linear in E_s,
//!   and so a blend of base materials is fitted as a whole.
//! - What glTF leaves to the diffuse part is the mean of 1 − max E over the hemisphere, and the
//!   base color is the albedo divided by that share.
//!
//! With r the largest channel of F0/F90:
//!
//! | glTF | value | lost |
//! | --- | --- | --- |
//! | base color | min(1, a / d), d the mean over the hemisphere of what the lobe leaves | an albedo above d is clamped to it; the falloff toward grazing angles differs |
//! | `metallicFactor` | 0 | |
//! | `roughnessFactor` | R | D is an SG here and GGX in glTF: the same peak, a longer tail |
//! | `KHR_materials_ior` | (1 + √r) / (1 − √r), r at most 0.99 | |
//! | `KHR_materials_specular` | factor F90, color F0 / (F90 r) | |
//!
//! Reading inverts this: a material that was written is read back, except for the clamping and the
//! eight bits of the texture.

use crate::codec::gltf::GltfFile;
use glam::Vec3;
use gltf_json::{Index, Material};
use lobelia_geometry::{Error, Result};
use lobelia_sg::brdf::Facets;
use lobelia_sg::reflectance::{ANGLES, cosine, gltf_reflectance, specular_reflectance, weight};
use lobelia_world::material::SpecularLobe;
use std::{collections::BTreeSet, path::Path};

/// A material for [`crate::codec::gltf::export::write_glb`]: base color, roughness, and the colored
/// reflectance of a dielectric; metallic is 0.
#[derive(Clone, Debug, PartialEq)]
pub struct GltfMaterial {
    /// The material's name in the file.
    pub name: String,
    /// `baseColorFactor`, linear RGB in `[0, 1]`, times the texture.
    pub base_color: Vec3,
    /// An image file's bytes (sRGB; a PNG to be written), embedded as the base color texture; needs
    /// a mesh with texture coordinates.
    pub base_color_image: Option<Vec<u8>>,
    /// `roughnessFactor` in `[0, 1]`, times the texture; GGX's α is its square.
    pub roughness: f32,
    /// A PNG with roughness in green and metallic 0 in blue, embedded as
    /// `metallicRoughnessTexture`. Not read back.
    pub roughness_image: Option<Vec<u8>>,
    /// `specularFactor` of `KHR_materials_specular`, in `[0, 1]`.
    pub specular: f32,
    /// `specularColorFactor` of `KHR_materials_specular`, linear RGB ≥ 0.
    pub specular_color: Vec3,
    /// A PNG with factors on `specular_color` in its colors (sRGB) and on `specular` in its alpha.
    /// Not read back.
    pub specular_image: Option<Vec<u8>>,
    /// A PNG of normals relative to the mesh's tangents
    /// ([`tangents`](lobelia_geometry::mesh::tangents)), embedded as `normalTexture`. Not read
    /// back.
    pub normal_image: Option<Vec<u8>>,
    /// Index of refraction of `KHR_materials_ior`, ≥ 1 (1.5 is glTF's default, a reflectance of
    /// 0.04).
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

    /// The values of its colors and factors.
    pub(super) fn values(&self) -> impl Iterator<Item = f32> + use<> {
        let colors = [self.base_color, self.specular_color].map(|color| color.to_array());
        colors.into_iter().flatten().chain([self.roughness, self.specular, self.ior])
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
/// [`Error::Input`] or [`Error::Io`] if the file cannot be read, has no material or several, or one
/// that the BRDF cannot represent.
pub fn read_material(path: &Path) -> Result<GltfMaterial> {
    let file = GltfFile::open(path)?;
    let primitives = file.root.meshes.iter().flat_map(|mesh| &mesh.primitives);
    let used: BTreeSet<_> = primitives.map(|part| part.material.map(|index| index.value())).collect();
    let (1, Some(Some(index))) = (used.len(), used.first()) else {
        let problem = "not every part of the mesh has the same material";
        let help = "give the material in the scene file, or export the mesh with one material";
        return Err(Error::input(path, "", problem, help));
    };
    let (place, index) = (format!("material {index}"), Index::new(*index as u32));
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
        name: material.name.clone().unwrap_or_else(|| default.name.clone()),
        base_color: Vec3::new(r, g, b).clamp(Vec3::ZERO, Vec3::ONE),
        base_color_image: image.transpose()?,
        roughness: pbr.roughness_factor.0.clamp(0.0, 1.0),
        specular: specular.map_or(default.specular, |s| s.specular_factor.0.clamp(0.0, 1.0)),
        specular_color: specular
            .map_or(default.specular_color, |s| Vec3::from(s.specular_color_factor.0).max(Vec3::ZERO)),
        ior: ior.map_or(default.ior, |ior| ior.ior.0.max(1.0)),
        ..default
    };
    if read.values().all(f32::is_finite) {
        return Ok(read);
    }
    Err(file.error(place, "has a value that is not finite"))
}

/// The property of the material that one lobe and one diffuse texture cannot represent.
fn beyond_words(file: &GltfFile, material: &Material) -> Option<&'static str> {
    let pbr = &material.pbr_metallic_roughness;
    let specular = material.extensions.as_ref().and_then(|e| e.specular.as_ref());
    let transformed = file.root.extensions_used.iter().any(|name| name == "KHR_texture_transform");
    let elsewhere = pbr.base_color_texture.as_ref().is_some_and(|t| t.tex_coord != 0 || transformed);
    let is_textured =
        specular.is_some_and(|s| s.specular_texture.is_some() || s.specular_color_texture.is_some());
    let problems = [
        (pbr.metallic_factor.0 != 0.0, "is metallic"),
        (pbr.metallic_roughness_texture.is_some(), "has a roughness texture"),
        (is_textured, "has a reflectance texture"),
        (elsewhere, "has a texture that does not use the first texture coordinates unchanged"),
    ];
    problems.into_iter().find(|(is, _)| *is).map(|(_, problem)| problem)
}

/// The specular part of a dielectric in glTF, and what it leaves to the diffuse part.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dielectric {
    /// F0, reflectance at normal incidence, linear RGB.
    pub f0: Vec3,
    /// F90, reflectance along the surface, not below F0.
    pub f90: f32,
    /// The part of diffuse light that is left, a mean over the hemisphere.
    pub diffuse_share: f32,
}

/// Reflectances of a specular lobe at the tabulated cosines: `constant` + `slope`·s.
#[derive(Clone, Debug, PartialEq)]
pub struct LobeReflectance {
    constant: [f32; ANGLES],
    slope: [f32; ANGLES],
}

impl LobeReflectance {
    /// The reflectances of a lobe, whatever its albedo is.
    pub fn of(lobe: &SpecularLobe) -> Self {
        let facets = Facets { ndf: lobe.ndf, roughness: f64::from(lobe.roughness) };
        let pairs: [_; ANGLES] = std::array::from_fn(|i| specular_reflectance(facets, cosine(i)));
        Self { constant: pairs.map(|pair| pair.0 as f32), slope: pairs.map(|pair| pair.1 as f32) }
    }

    /// Adds the reflectance for the specular albedo `albedo`, times `share`, to `sum`.
    pub fn add(&self, albedo: Vec3, share: f32, sum: &mut [Vec3; ANGLES]) {
        for (sum, (constant, slope)) in sum.iter_mut().zip(self.constant.iter().zip(&self.slope)) {
            *sum += (albedo * *slope + *constant) * share;
        }
    }
}

/// Reflectances of glTF's lobe at the tabulated cosines, F0·A + F90·B.
#[derive(Clone, Debug, PartialEq)]
pub struct GltfReflectance {
    a: [f32; ANGLES],
    b: [f32; ANGLES],
}

impl GltfReflectance {
    /// The reflectances of a `roughnessFactor`.
    pub fn of(roughness: f32) -> Self {
        let pairs: [_; ANGLES] = std::array::from_fn(|i| gltf_reflectance(f64::from(roughness), cosine(i)));
        Self { a: pairs.map(|(a, _)| a as f32), b: pairs.map(|(_, b)| b as f32) }
    }

    /// The reflectances between two, at `t` from `self` (0) to `other` (1).
    fn toward(&self, other: &Self, t: f32) -> Self {
        let mix = |x: &[f32; ANGLES], y: &[f32; ANGLES]| std::array::from_fn(|i| x[i] + (y[i] - x[i]) * t);
        Self { a: mix(&self.a, &other.a), b: mix(&self.b, &other.b) }
    }

    /// The dielectric whose reflectance is nearest to `target`; `f90` is F90 where a format gives
    /// no choice.
    pub fn fit(&self, target: &[Vec3; ANGLES], f90: Option<f32>) -> Dielectric {
        let (aa, ab, bb) = (dot(&self.a, &self.a), dot(&self.a, &self.b), dot(&self.b, &self.b));
        let (on_a, on_b) = (project(&self.a, target), project(&self.b, target));
        let mean = |v: Vec3| v.element_sum() / 3.0;
        let free = (mean(on_b) * aa - mean(on_a) * ab) / (aa * bb - ab * ab).max(f32::MIN_POSITIVE);
        let mut f90 = f90.unwrap_or(free).clamp(0.0, 1.0);
        let f0_beside = |f90: f32| (on_a - f90 * ab) / aa;
        if f0_beside(f90).max_element() > f90 {
            // The strongest channel is then the same at all angles.
            f90 = ((on_a + on_b).max_element() / (aa + 2.0 * ab + bb)).clamp(0.0, 1.0);
        }
        let f0 = f0_beside(f90).clamp(Vec3::ZERO, Vec3::splat(f90));
        Dielectric { f0, f90, diffuse_share: self.diffuse_share(f0, f90) }
    }

    /// The specular albedo with which a lobe reflects as much as glTF's with this F0 and F90:
    /// inverse of [`Self::fit`].
    pub fn specular_albedo(&self, f0: Vec3, f90: f32, lobe: &LobeReflectance) -> Vec3 {
        let (aa, ab, bb) = (dot(&self.a, &self.a), dot(&self.a, &self.b), dot(&self.b, &self.b));
        let (constant_a, slope_a) = (dot(&self.a, &lobe.constant), dot(&self.a, &lobe.slope));
        let (constant_b, slope_b) = (dot(&self.b, &lobe.constant), dot(&self.b, &lobe.slope));
        let channel = |f0: f32| {
            let flat = f90 > 0.0 && f0 > 0.999 * f90;
            let (reflected, constant, slope) = if flat {
                (f90 * (aa + 2.0 * ab + bb), constant_a + constant_b, slope_a + slope_b)
            } else {
                (f0 * aa + f90 * ab, constant_a, slope_a)
            };
            ((reflected - constant) / slope).clamp(0.0, 1.0)
        };
        Vec3::from_array(f0.to_array().map(channel))
    }

    /// The mean over the hemisphere of 1 − E, in the channel that reflects most.
    pub fn diffuse_share(&self, f0: Vec3, f90: f32) -> f32 {
        let reflected = |i: usize| f0.max_element() * self.a[i] + f90 * self.b[i];
        (1.0 - (0..ANGLES).map(|i| reflected(i) * weight(i) as f32).sum::<f32>()).clamp(0.01, 1.0)
    }
}

/// The sum over angles of the product, weighted as means over the hemisphere are.
fn dot(x: &[f32; ANGLES], y: &[f32; ANGLES]) -> f32 {
    (0..ANGLES).map(|i| x[i] * y[i] * weight(i) as f32).sum()
}

fn project(x: &[f32; ANGLES], target: &[Vec3; ANGLES]) -> Vec3 {
    (0..ANGLES).map(|i| target[i] * (x[i] * weight(i) as f32)).sum()
}

/// glTF's reflectances for any roughness, between tabulated ones.
pub struct GltfTable(Vec<GltfReflectance>);

/// Steps of roughness in a table.
const STEPS: usize = 48;

impl Default for GltfTable {
    fn default() -> Self {
        Self((0..=STEPS).map(|i| GltfReflectance::of((i as f32 / STEPS as f32).max(0.01))).collect())
    }
}

impl GltfTable {
    /// The reflectances of a roughness.
    pub fn at(&self, roughness: f32) -> GltfReflectance {
        let place = roughness.clamp(0.0, 1.0) * STEPS as f32;
        let below = (place as usize).min(STEPS - 1);
        self.0[below].toward(&self.0[below + 1], place - below as f32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::codec::{gltf::export::write_glb, test_data::temporary};
    use lobelia_geometry::mesh::primitive::box_mesh;
    use lobelia_sg::brdf::Ndf;

    /// The dielectric that is nearest to a lobe.
    fn dielectric_of(lobe: &SpecularLobe) -> Dielectric {
        let mut target = [Vec3::ZERO; ANGLES];
        LobeReflectance::of(lobe).add(lobe.albedo, 1.0, &mut target);
        GltfReflectance::of(lobe.roughness).fit(&target, None)
    }

    #[test]
    fn a_lobe_survives_gltf() {
        let (_folder, path) = temporary("mesh.glb");
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
        let (_folder, path) = temporary("mesh.gltf");
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

    /// Albedo of the diffuse part in these tests.
    const DIFFUSE: f32 = 0.4;

    /// The total reflectance of the surface here and of its dielectric at each cosine.
    fn totals(lobe: &SpecularLobe) -> [(f32, f32); ANGLES] {
        let (ours, theirs) = (LobeReflectance::of(lobe), GltfReflectance::of(lobe.roughness));
        let found = dielectric_of(lobe);
        std::array::from_fn(|i| {
            let specular = found.f0.x * theirs.a[i] + found.f90 * theirs.b[i];
            let here = DIFFUSE + ours.constant[i] + ours.slope[i] * lobe.albedo.x;
            (here, DIFFUSE / found.diffuse_share * (1.0 - specular) + specular)
        })
    }

    fn lobes() -> impl Iterator<Item = SpecularLobe> {
        let roughness = [0.1_f32, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9];
        let albedos = [0.02_f32, 0.05, 0.1, 0.2, 0.3];
        let each = move |roughness| albedos.map(|s| SpecularLobe::new(Vec3::splat(s), roughness));
        let sg = roughness.into_iter().flat_map(each);
        sg.flat_map(|lobe| [lobe, SpecularLobe { ndf: Ndf::Ggx, ..lobe }])
    }

    #[test]
    fn a_dielectric_reflects_as_much_as_its_lobe() {
        for lobe in lobes() {
            let totals = totals(&lobe);
            let mean = |pick: fn((f32, f32)) -> f32| -> f32 {
                (0..ANGLES).map(|i| pick(totals[i]) * weight(i) as f32).sum()
            };
            // All that is reflected over the hemisphere, as the slopes of an object add up in a
            // picture.
            let ratio = mean(|t| t.1) / mean(|t| t.0);
            assert!((ratio - 1.0).abs() < 0.01, "{lobe:?}: {ratio}");
            // At single angles one base color cannot follow glTF's diffuse part, which falls as E
            // rises. With GGX's shadowing more is reflected along the surface, and there is more to
            // follow.
            let most = match (lobe.ndf, lobe.albedo.x > 0.1) {
                (_, true) => 0.09,
                (Ndf::Sg, false) => 0.045,
                (Ndf::Ggx, false) => 0.055,
            };
            for i in (0..ANGLES).filter(|i| cosine(*i) > 0.4) {
                let (here, there) = totals[i];
                assert!((there / here - 1.0).abs() < most, "{lobe:?} at {}: {there} for {here}", cosine(i));
            }
        }
    }
}
