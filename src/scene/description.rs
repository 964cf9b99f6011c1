//! A whole scene file: surface, views, light, material, and the passes.
//!
//! Unless a field says otherwise, lengths are in the data set's own unit, colors are linear Rec.
//! 709 and paths may begin with `$DATA` (the folder given by `--data`) or are relative to the scene
//! file.

use crate::scene::{Pass, Views};
use glam::Vec3;
use lobelia_io::codec::npy::NpyConvention;
use lobelia_sg::brdf::Ndf;
use lobelia_solve::fit::scale::ScaleRule;
use lobelia_world::light::{LightLobe, convention::MapConvention, light_frame::LightFrame};
use lobelia_world::material::SpecularLobe;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// The version of the format that this crate reads and writes.
pub const VERSION: u32 = 1;

/// A whole scene file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scene {
    /// Format version; must be [`VERSION`].
    pub version: u32,
    /// Seed of every random choice. Default 0.
    #[serde(default)]
    pub seed: u64,
    /// The world's up direction, for orbits (not zero; need not be unit). Default (0, 1, 0).
    #[serde(default = "y_axis")]
    pub up: Vec3,
    /// The object's surface.
    pub surface: Surface,
    /// The cameras, with or without photographs.
    pub views: Views,
    /// The light around the object. Default `Unknown(lobes: 128)`.
    #[serde(default)]
    pub light: Light,
    /// In which frame the light stands still. Default `Auto`: found from the photographs, if the
    /// light is unknown.
    #[serde(default)]
    pub light_frame: LightFrameChoice,
    /// The object's material. Default: all unknown.
    #[serde(default)]
    pub material: Material,
    /// Rule for the scale between light and albedo, if both are unknown: the two are known only up
    /// to one factor a channel. Default `Highlights()`.
    #[serde(default)]
    pub scale: ScaleRule,
    /// Shadows that the object throws on itself, and light that it reflects onto itself, in fits
    /// and closed-form renders. Default `Traced()`.
    #[serde(default)]
    pub visibility: Visibility,
    /// The passes, in order. Default: nothing.
    #[serde(default)]
    pub passes: Vec<Pass>,
}

impl Scene {
    /// Views of an object of which nothing is known.
    pub fn of_views(views: Views) -> Self {
        Self {
            version: VERSION,
            seed: 0,
            up: y_axis(),
            surface: Surface::Unknown { cells: number::<128>(), texture_size: number::<512>() },
            views,
            light: Light::default(),
            light_frame: LightFrameChoice::default(),
            material: Material::default(),
            scale: ScaleRule::default(),
            visibility: Visibility::default(),
            passes: Vec::new(),
        }
    }

    /// The pass with a name.
    pub fn pass_named(&self, name: Option<&str>) -> Option<&Pass> {
        self.passes.iter().find(|pass| Some(pass.name()) == name)
    }

    /// The mesh file that the material is read from, if it is not `material` that says it.
    pub fn own_material(&self) -> Option<&Path> {
        match &self.surface {
            Surface::Mesh { path, own_material: true, .. } => Some(path),
            _ => None,
        }
    }
}

/// The object's surface.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum Surface {
    /// A glTF/GLB file.
    Mesh {
        /// The `.gltf` or `.glb` file; must exist.
        path: PathBuf,
        /// Width and height of the albedo texture in texels, 8 to 4096. Default 256.
        #[serde(default = "number::<256>")]
        texture_size: u32,
        /// Take the file's own material, as `Export` writes it: one dielectric, no metal, no
        /// textures but the base color's. It counts as fixed, and `material` must not be given.
        /// Default false.
        #[serde(default)]
        own_material: bool,
    },
    /// The shape is not known: it is found from the photographs' masks. `views` must be a
    /// `Dataset`.
    Unknown {
        /// Cells a side of the grid that the shape is found on, 16 to 256. Default 128.
        #[serde(default = "number::<128>")]
        cells: u32,
        /// Width and height of the albedo texture in texels, 8 to 4096. Default 512.
        #[serde(default = "number::<512>")]
        texture_size: u32,
    },
    /// A sphere.
    Sphere {
        /// Center. Default (0, 0, 0).
        #[serde(default)]
        center: Vec3,
        /// Radius > 0. Default 0.8.
        #[serde(default = "sphere_radius")]
        radius: f32,
        /// Width and height of the albedo texture in texels, 8 to 4096. Default 128.
        #[serde(default = "number::<128>")]
        texture_size: u32,
    },
    /// A box with axis-aligned faces.
    Box {
        /// Center. Default (0, 0, 0).
        #[serde(default)]
        center: Vec3,
        /// Edge lengths > 0. Default (1, 1, 1).
        #[serde(default = "ones")]
        size: Vec3,
        /// Width and height of the albedo texture in texels, 8 to 4096. Default 128.
        #[serde(default = "number::<128>")]
        texture_size: u32,
    },
}

/// Shadows and reflections between parts of the object in closed-form shading. (Path tracing has
/// both.)
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum Visibility {
    /// None: every point sees all light.
    None,
    /// Found by rays from every texel.
    Traced {
        /// Directions over the sphere that texels look in, 64 to 4096, rounded up to a multiple of 64.
        /// Default 512.
        #[serde(default = "number::<512>")]
        directions: u32,
        /// Reflections from one part of the object onto another, 0 (shadows alone) to 8. Default 2.
        #[serde(default = "number::<2>")]
        bounces: u32,
        /// Steps of a fit after which shadows and reflections are recomputed ≥ 1. Default 50.
        #[serde(default = "number::<50>")]
        refresh_every: u32,
    },
}

impl Default for Visibility {
    fn default() -> Self {
        Self::Traced { directions: 512, bounces: 2, refresh_every: 50 }
    }
}

/// The light: unknown, initial or known.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Light {
    /// Unknown; a fit finds it.
    Unknown(UnknownLight),
    /// An initial value, which a fit improves: `Initial(Npy(path: "light.npy"))`.
    Initial(LightSource),
    /// Known; a fit leaves it as it is: `Fixed(Map(path: "sky.exr"))`.
    Fixed(LightSource),
}

impl Light {
    /// The light that is given, if one is.
    pub fn source(&self) -> Option<&LightSource> {
        match self {
            Self::Initial(source) | Self::Fixed(source) => Some(source),
            Self::Unknown(_) => None,
        }
    }
}

impl Default for Light {
    fn default() -> Self {
        Self::Unknown(UnknownLight { lobes: 128 })
    }
}

/// In which frame the light stands still.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub enum LightFrameChoice {
    /// The first fit of an unknown light finds it from the photographs; a light that is given
    /// stands in the world.
    #[default]
    Auto,
    /// The world: the camera goes around the object.
    World,
    /// The camera: the object turns on a turntable before one camera, or lamps move with the
    /// camera. The light's x, y and z are right, up and backward in the picture.
    Camera,
    /// A turntable with this axis (not zero, in the world) before a camera that is raised or tilted
    /// between rounds: `Turntable(0, 1, 0)`.
    Turntable(Vec3),
}

impl LightFrameChoice {
    /// The frame; `None` if a fit is to find it.
    pub fn frame(self, light: &Light) -> Option<LightFrame> {
        match self {
            Self::Auto if matches!(light, Light::Unknown(_)) => None,
            Self::Auto | Self::World => Some(LightFrame::World),
            Self::Camera => Some(LightFrame::Camera),
            Self::Turntable(axis) => Some(LightFrame::Turntable(axis)),
        }
    }
}

impl From<LightFrame> for LightFrameChoice {
    fn from(frame: LightFrame) -> Self {
        match frame {
            LightFrame::World => Self::World,
            LightFrame::Camera => Self::Camera,
            LightFrame::Turntable(axis) => Self::Turntable(axis),
        }
    }
}

/// A light that is not known.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct UnknownLight {
    /// How many SG lobes to fit, 1 to 2048. Default 128.
    #[serde(default = "number::<128>")]
    pub lobes: u32,
}

/// A light that is given.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum LightSource {
    /// SG lobes, written out.
    Lobes {
        /// The lobes, 1 to 2048; axes are normalized, sharpness and amplitude are ≥ 0.
        lobes: Vec<LightLobe>,
        /// Factor on the radiance ≥ 0. Default 1.
        #[serde(default = "one")]
        scale: f32,
        /// Turn about the world's x, then y, then z axis, in degrees. Default (0, 0, 0).
        #[serde(default)]
        rotation_degrees: Vec3,
    },
    /// SG lobes from an `.npy` array of shape `[M, 7]`: axis, sharpness, RGB amplitude.
    Npy {
        /// The file; must exist.
        path: PathBuf,
        /// Which way the file's axes point. Default `Lobelia`.
        #[serde(default)]
        convention: NpyConvention,
        /// Factor on the radiance ≥ 0. Default 1.
        #[serde(default = "one")]
        scale: f32,
        /// Turn about the world's x, then y, then z axis, in degrees. Default (0, 0, 0).
        #[serde(default)]
        rotation_degrees: Vec3,
    },
    /// A light in a RON file of its own, as `lobelia env fit --out` writes it: one of the others
    /// here, with paths from where that file is.
    Ron {
        /// The file; must exist.
        path: PathBuf,
        /// Factor on the radiance ≥ 0, beside the file's own. Default 1.
        #[serde(default = "one")]
        scale: f32,
        /// Turn after the file's own about the world's x, then y, then z axis, in degrees. Default
        /// (0, 0, 0).
        #[serde(default)]
        rotation_degrees: Vec3,
    },
    /// A latitude-longitude EXR or HDR image; SG shading uses lobes fitted to it.
    Map {
        /// The file; must exist.
        path: PathBuf,
        /// Factor on the radiance ≥ 0. Default 1.
        #[serde(default = "one")]
        scale: f32,
        /// Turn about the world's x, then y, then z axis, in degrees. Default (0, 0, 0).
        #[serde(default)]
        rotation_degrees: Vec3,
        /// How many SG lobes are fitted to the map, 1 to 512. Default 128.
        #[serde(default = "number::<128>")]
        lobes: u32,
        /// Which program's way the map faces. Default `Lobelia`.
        #[serde(default)]
        convention: MapConvention,
        /// Light from above only: the map below the horizon counts as black, and no lobe's axis
        /// points below it (before `rotation_degrees`). Default false.
        #[serde(default)]
        upper_hemisphere: bool,
        /// Gray light: the map's luminance. Default false.
        #[serde(default)]
        white: bool,
    },
}

impl LightSource {
    /// A map as it is, with 128 lobes fitted to it.
    pub fn map(path: PathBuf) -> Self {
        Self::Map {
            path,
            scale: 1.0,
            rotation_degrees: Vec3::ZERO,
            lobes: number::<128>(),
            convention: MapConvention::default(),
            upper_hemisphere: false,
            white: false,
        }
    }

    /// Its factor on the radiance and its turn in degrees.
    pub fn scale_and_turn(&self) -> (f32, Vec3) {
        match self {
            Self::Lobes { scale, rotation_degrees, .. }
            | Self::Npy { scale, rotation_degrees, .. }
            | Self::Ron { scale, rotation_degrees, .. }
            | Self::Map { scale, rotation_degrees, .. } => (*scale, *rotation_degrees),
        }
    }
}

/// The material, known or unknown in each part.
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

/// Diffuse albedo: unknown, initial or known.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub enum Albedo {
    /// Unknown; a fit finds it.
    #[default]
    Unknown,
    /// An initial value, which a fit improves.
    Initial(AlbedoSource),
    /// Known; a fit leaves it as it is.
    Fixed(AlbedoSource),
}

/// How the diffuse albedo depends on the angle of view, as that of woven, coated and dusty surfaces
/// does. Toward a viewer at the cosine c = n·v it is c times `albedo` and 1 − c times that along
/// the surface.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub enum Sheen {
    /// A fit decides: like `Unknown` if that predicts photographs it was not fitted to clearly
    /// better, else like `None`.
    #[default]
    Auto,
    /// Not at all: Lambertian.
    None,
    /// A fit finds it, one color per texel; only with an albedo that is not `Fixed`.
    Unknown,
    /// Known: the diffuse albedo along the surface, in [0, 1], as `Save` writes it.
    /// `Fixed(Texture("albedo_along.exr"))`.
    Fixed(AlbedoSource),
}

/// How the diffuse albedo depends on the side that it is seen from, as that of fabric, brushed
/// paint and relief finer than the mesh does: each texel is brighter toward one side, and darker
/// toward the other.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub enum Tilt {
    /// A `Fit` with `detail` finds it together with the albedo; another fit, or one beside a known
    /// sheen, leaves it out.
    #[default]
    Unknown,
    /// Not at all.
    None,
    /// Known, beside an albedo that is `Fixed`: an EXR of vectors in the object's axes (channels X,
    /// Y, Z), as `Save` writes it; must exist. `Fixed("albedo_tilt.exr")`.
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

/// The specular lobe, known or unknown in each part.
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

/// Distribution of microfacet normals. If `gloss: Auto` takes two base materials, both have `Ggx`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum NdfChoice {
    /// A `Fit` that finds roughness or specular albedo of one base material decides: like `Sg`,
    /// unless `Ggx` explains the photographs clearly better in the first steps. All else is like
    /// `Sg`.
    #[default]
    Auto,
    /// One spherical Gaussian as in the paper; `shading: Published` has no other.
    Sg,
    /// GGX with α = R², whose highlights have the long tails of most renderers' and of glTF's.
    Ggx,
}

impl NdfChoice {
    /// Returns the distribution that a fit begins with, and that all else has.
    pub fn first(self) -> Ndf {
        if self == Self::Ggx { Ndf::Ggx } else { Ndf::Sg }
    }
}

/// Specular albedo (reflectance at normal incidence), known or unknown.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum SpecularAlbedo {
    /// A fit finds it.
    Unknown {
        /// One gray value instead of three channels. Default true.
        #[serde(default = "yes")]
        mono: bool,
        /// Where the fit starts, in [0, 1]. If neither this nor the roughness's is given, the
        /// photographs choose a pair.
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

/// Roughness R of the paper (GGX's α is R²), known or unknown.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum Roughness {
    /// A fit finds it.
    Unknown {
        /// Where the fit starts, in [0.03, 1]. If neither this nor the specular albedo's is given,
        /// the photographs choose a pair.
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
    /// A `Fit` decides, if nothing is said in `specular` but its `ndf`: like `One`, unless that
    /// explains the photographs badly and two base materials with `Ggx`, a dielectric and one that
    /// may be metal, explain them clearly better.
    #[default]
    Auto,
    /// One: the lobe in `specular` everywhere.
    One,
    /// Several, which start from the lobe in `specular` with roughnesses spread around its own; a
    /// fit finds them, and for each texel how they blend.
    Blend {
        /// Base materials, 2 to 4. Default 2.
        #[serde(default = "number::<2>")]
        materials: u32,
    },
    /// A roughness for each texel, in [0.1, 0.76], tied to its neighbors by a prior; the specular
    /// albedo in `specular` is one for all. Not together with a `Shape` pass.
    Texels {
        /// Weight ≥ 0, beside the image loss, of the mean difference of the logarithm of roughness
        /// (and of the specular lobe's share) between neighboring texels. Default 0.003.
        #[serde(default = "gloss_smoothness")]
        smoothness: f32,
        /// Difference of chromaticity (albedo over its sum) > 0 at which neighbors are tied half as
        /// much as those of one color. Default 0.1.
        #[serde(default = "gloss_color_width")]
        color_width: f32,
        /// Whether the strength of the specular lobe varies too: a factor up to 1 for each texel.
        /// Default false.
        #[serde(default)]
        specular: bool,
    },
    /// Known ones, as `Save` writes them; `specular` must not be given.
    Fixed {
        /// The base materials, 1 to 8.
        lobes: Vec<SpecularLobe>,
        /// An EXR of the texture's size with a channel of blend weights for each, `weight0` and so
        /// on; must exist.
        weights: PathBuf,
    },
}

// Defaults of fields, here and in other modules.

pub(super) fn number<const N: u32>() -> u32 {
    N
}

pub(super) fn yes() -> bool {
    true
}

pub(super) fn one() -> f32 {
    1.0
}

pub(super) fn fov_degrees() -> f32 {
    38.0
}

pub(super) fn y_axis() -> Vec3 {
    Vec3::Y
}

fn ones() -> Vec3 {
    Vec3::ONE
}

fn sphere_radius() -> f32 {
    0.8
}

fn gloss_smoothness() -> f32 {
    0.003
}

fn gloss_color_width() -> f32 {
    0.1
}
