//! What a scene file says about the material: albedo, the specular lobe, and gloss that varies over the surface.

use crate::material::SpecularLobe;
use crate::math::brdf::Ndf;
use glam::Vec3;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// What is known about the material.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Material {
    /// Diffuse albedo, one color per texel. Default `Unknown`.
    pub albedo: Albedo,
    /// How the diffuse albedo depends on the angle of view. Default `Auto`.
    pub sheen: Sheen,
    /// How the diffuse albedo depends on the side of view. Default `Unknown`.
    pub tilt: Tilt,
    /// The specular lobe, or what base materials start from. Default: unknown.
    pub specular: Specular,
    /// Gloss that varies over the surface. Default `Auto`.
    pub gloss: Gloss,
}

/// What is known about the diffuse albedo.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub enum Albedo {
    /// Nothing: a fit finds it.
    #[default]
    Unknown,
    /// An initial value, which a fit improves.
    Initial(AlbedoSource),
    /// Known; a fit leaves it as it is.
    Fixed(AlbedoSource),
}

/// How the diffuse albedo depends on the angle of view, as that of woven, coated and dusty surfaces does. Toward a viewer at the
/// cosine c = n·v it is c times `albedo` and 1 − c times that along the surface.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub enum Sheen {
    /// A fit decides: like `Unknown` if that predicts photographs it was not fitted to clearly better, else like `None`.
    #[default]
    Auto,
    /// Not at all: Lambertian.
    None,
    /// A fit finds it, one color per texel; only with an albedo that is not `Fixed`.
    Unknown,
    /// Known: the diffuse albedo along the surface, in [0, 1], as `Save` writes it. `Fixed(Texture("albedo_along.exr"))`.
    Fixed(AlbedoSource),
}

/// How the diffuse albedo depends on the side that it is seen from, as that of fabric, brushed paint and relief finer than the mesh does:
/// each texel is brighter toward one side, and darker toward the other.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub enum Tilt {
    /// A `Fit` with `detail` finds it together with the albedo; another fit, or one beside a known sheen, leaves it out.
    #[default]
    Unknown,
    /// Not at all.
    None,
    /// Known, beside an albedo that is `Fixed`: an EXR of vectors in the object's axes (channels X, Y, Z), as `Save` writes it; must
    /// exist. `Fixed("albedo_tilt.exr")`.
    Fixed(PathBuf),
}

/// A diffuse albedo that is given.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum AlbedoSource {
    /// One color in [0, 1] everywhere: `Constant(0.5, 0.5, 0.5)`.
    Constant(Vec3),
    /// A texture: PNG (sRGB) or EXR (linear), any size; must exist. `Texture("albedo.exr")`.
    Texture(PathBuf),
}

/// What is known about the specular lobe.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Specular {
    /// Specular albedo. Default `Unknown(mono: true)`.
    pub albedo: SpecularAlbedo,
    /// Roughness. Default `Unknown()`.
    pub roughness: Roughness,
    /// Distribution of microfacet normals. Default `Auto`.
    pub ndf: NdfChoice,
}

/// What is known about the distribution of microfacet normals. If `gloss: Auto` takes two base materials, both have `Ggx`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum NdfChoice {
    /// A `Fit` that finds roughness or specular albedo of one base material decides: like `Sg`, unless `Ggx` explains
    /// the photographs clearly better in the first steps. All else is like `Sg`.
    #[default]
    Auto,
    /// One spherical Gaussian as in the paper; `shading: Published` has no other.
    Sg,
    /// GGX with α = R², whose highlights have the long tails of most renderers' and of glTF's.
    Ggx,
}

impl NdfChoice {
    /// What a fit begins with, and all that does not choose has.
    pub fn first(self) -> Ndf {
        match self {
            Self::Auto | Self::Sg => Ndf::Sg,
            Self::Ggx => Ndf::Ggx,
        }
    }
}

impl From<Ndf> for NdfChoice {
    fn from(known: Ndf) -> Self {
        match known {
            Ndf::Sg => Self::Sg,
            Ndf::Ggx => Self::Ggx,
        }
    }
}

/// What is known about the specular albedo (reflectance at normal incidence).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum SpecularAlbedo {
    /// A fit finds it.
    Unknown {
        /// One gray value instead of three channels. Default true.
        #[serde(default = "yes")]
        mono: bool,
        /// Where the fit starts, in [0, 1]. If neither this nor the roughness's is given, the photographs choose a pair.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        initial: Option<Vec3>,
    },
    /// Known, in [0, 1]: `Fixed(0.3, 0.3, 0.3)`.
    Fixed(Vec3),
}

impl Default for SpecularAlbedo {
    fn default() -> Self {
        Self::Unknown { mono: true, initial: None }
    }
}

impl Specular {
    /// Whether nothing at all is said of specular albedo and roughness.
    pub fn is_open(&self) -> bool {
        matches!(self.albedo, SpecularAlbedo::Unknown { initial: None, .. })
            && matches!(self.roughness, Roughness::Unknown { initial: None })
    }
}

/// What is known about the roughness R of the paper (GGX's α is R²).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum Roughness {
    /// A fit finds it.
    Unknown {
        /// Where the fit starts, in [0.03, 1]. If neither this nor the specular albedo's is given, the photographs choose a pair.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        initial: Option<f32>,
    },
    /// Known, in [0.03, 1]: `Fixed(0.25)`.
    Fixed(f32),
}

impl Default for Roughness {
    fn default() -> Self {
        Self::Unknown { initial: None }
    }
}

/// How gloss varies over the surface.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum Gloss {
    /// A `Fit` decides, if nothing is said in `specular` but its `ndf`: like `One`, unless that explains the photographs badly and two base
    /// materials with `Ggx`, a dielectric and one that may be metal, explain them clearly better.
    #[default]
    Auto,
    /// One: the lobe in `specular` everywhere.
    One,
    /// Several, which start from the lobe in `specular` with roughnesses spread around its own; a fit finds them, and for each
    /// texel how they blend.
    Blend {
        /// Base materials, 2 to 4. Default 2.
        #[serde(default = "base_materials")]
        materials: u32,
    },
    /// A roughness for each texel, in [0.1, 0.76], tied to its neighbors by a prior; the specular albedo in `specular` is one for all.
    /// Not together with a `Shape` pass.
    Texels {
        /// Weight ≥ 0, beside the image loss, of the mean difference of the logarithm of roughness (and of the specular lobe's share)
        /// between neighboring texels. Default 0.003.
        #[serde(default = "gloss_smoothness")]
        smoothness: f32,
        /// Difference of chromaticity (albedo over its sum) > 0 at which neighbors are tied half as much as those of one color.
        /// Default 0.1.
        #[serde(default = "gloss_color_width")]
        color_width: f32,
        /// Whether the strength of the specular lobe varies too: a factor up to 1 for each texel. Default false.
        #[serde(default)]
        specular: bool,
    },
    /// Known ones, as `Save` writes them; `specular` must not be given.
    Fixed {
        /// The base materials, 1 to 8.
        lobes: Vec<SpecularLobe>,
        /// An EXR of the texture's size with a channel of blend weights for each, `weight0` and so on; must exist.
        weights: PathBuf,
    },
}

fn yes() -> bool {
    true
}

fn gloss_smoothness() -> f32 {
    0.003
}

fn gloss_color_width() -> f32 {
    0.1
}

fn base_materials() -> u32 {
    2
}
