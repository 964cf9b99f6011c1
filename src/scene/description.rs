//! What a scene file says about the object: surface, views, light, material, and the list of passes.
//!
//! Unless a field says otherwise, lengths are in the data set's own unit, colours are linear Rec. 709 and
//! paths may begin with `$DATA` (the folder given by `--data`) or are relative to the scene file.

pub use crate::codec::image::Gamma;
pub use crate::codec::npy::NpyConvention;
pub use crate::dataset::Layout;
pub use crate::fit::scale::ScaleRule;
use crate::light::LightLobe;
pub use crate::light::convention::MapConvention;
pub use crate::math::brdf::Ndf;
use crate::scene::passes::Pass;
pub use crate::scene::photographed::{CameraRing, Pattern, Photographed, TruthObject};
pub use crate::scene::roughness::Gloss;
use crate::view::Split;
use glam::Vec3;
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
    /// The object's material. Default: all unknown.
    #[serde(default)]
    pub material: Material,
    /// What decides the scale between light and albedo, if both are unknown: the two are known only up to one factor a channel.
    /// Default `Highlights()`.
    #[serde(default)]
    pub scale: ScaleRule,
    /// Shadows that the object throws on itself, and light that it reflects onto itself, in fits and closed-form renders.
    /// Default `Traced()`.
    #[serde(default)]
    pub visibility: Visibility,
    /// What to do, in order. Default: nothing.
    #[serde(default)]
    pub passes: Vec<Pass>,
}

impl Scene {
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
        #[serde(default = "mesh_texture_size")]
        texture_size: u32,
        /// Take the file's own material, as `Export` writes it: one dielectric, no metal, no textures but the base colour's. It
        /// counts as fixed, and `material` must not be given. Default false.
        #[serde(default)]
        own_material: bool,
    },
    /// The shape is not known: it is found from the photographs' masks. `views` must be a `Dataset`.
    Unknown {
        /// Cells a side of the grid that the shape is found on, 16 to 256. Default 128.
        #[serde(default = "unknown_cells")]
        cells: u32,
        /// Width and height of the albedo texture in texels, 8 to 4096. Default 512.
        #[serde(default = "unknown_texture_size")]
        texture_size: u32,
    },
    /// A sphere.
    Sphere {
        /// Centre. Default (0, 0, 0).
        #[serde(default)]
        center: Vec3,
        /// Radius > 0. Default 0.8.
        #[serde(default = "sphere_radius")]
        radius: f32,
        /// Width and height of the albedo texture in texels, 8 to 4096. Default 128.
        #[serde(default = "primitive_texture_size")]
        texture_size: u32,
    },
    /// A box with axis-aligned faces.
    Box {
        /// Centre. Default (0, 0, 0).
        #[serde(default)]
        center: Vec3,
        /// Edge lengths > 0. Default (1, 1, 1).
        #[serde(default = "ones")]
        size: Vec3,
        /// Width and height of the albedo texture in texels, 8 to 4096. Default 128.
        #[serde(default = "primitive_texture_size")]
        texture_size: u32,
    },
}

/// Where the views come from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Views {
    /// A folder of photographs with known cameras.
    Dataset(Dataset),
    /// Cameras without photographs: they can be rendered, not fitted to.
    Cameras(Vec<CameraSpec>),
    /// Photographs that the project takes itself of a known object, with its own path tracer.
    Photographed(Photographed),
}

/// A folder of photographs with known cameras.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Dataset {
    /// The folder; must exist.
    pub path: PathBuf,
    /// How the folder is laid out. Default `Auto`.
    #[serde(default)]
    pub layout: Layout,
    /// How 8- and 16-bit images are decoded to linear light (EXR and HDR are linear). Default `Srgb`.
    #[serde(default)]
    pub gamma: Gamma,
    /// Where in a pixel its centre is, in pixels from its upper left corner, 0 to 1. Default 0.5 (PhySG's own code: 0).
    #[serde(default = "half")]
    pub pixel_center: f32,
    /// Factor on all focal lengths, 0.5 to 2, such as a fit with `cameras: PosesAndFocal` found. Default 1.
    #[serde(default = "one")]
    pub focal_scale: f32,
    /// Images are shrunk by this whole factor ≥ 1 (box filter). Default 1.
    #[serde(default = "one_u32")]
    pub downscale: u32,
    /// Keep every n-th view of each split, n ≥ 1, starting with the first. Default 1.
    #[serde(default = "one_u32")]
    pub every: u32,
    /// Where the data has no test split of its own (COLMAP), every n-th view by name is one of it, n ≥ 2, starting with the
    /// first; 0: there is none. Default 8.
    #[serde(default = "held_out")]
    pub hold_out: u32,
    /// Keep only the views with these names (image file stems); empty: all. Default [].
    #[serde(default)]
    pub select: Vec<String>,
}

/// One pinhole camera, by what it looks at.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraSpec {
    /// The view's name; output files carry it. Letters, digits, `_`, `-`.
    pub name: String,
    /// Where the camera stands.
    pub eye: Vec3,
    /// What it looks at. Default (0, 0, 0).
    #[serde(default)]
    pub target: Vec3,
    /// Which direction is up in the image. Default (0, 1, 0).
    #[serde(default = "y_axis")]
    pub up: Vec3,
    /// Vertical field of view in degrees, in (0, 170]. Default 38.
    #[serde(default = "fov_degrees")]
    pub fov_degrees: f32,
    /// Image width in pixels, 1 to 16384. Default 256.
    #[serde(default = "image_size")]
    pub width: u32,
    /// Image height in pixels, 1 to 16384. Default 256.
    #[serde(default = "image_size")]
    pub height: u32,
    /// The split this view belongs to. Default `Test`.
    #[serde(default = "test_split")]
    pub split: Split,
}

/// What is known about the light.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Light {
    /// Nothing: a fit finds it.
    Unknown(UnknownLight),
    /// A first guess, which a fit improves: `Initial(Npy(path: "light.npy"))`.
    Initial(LightSource),
    /// Known; a fit leaves it as it is: `Fixed(Map(path: "sky.exr"))`.
    Fixed(LightSource),
}

impl Default for Light {
    fn default() -> Self {
        Self::Unknown(UnknownLight::default())
    }
}

/// A light that is not known.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct UnknownLight {
    /// How many SG lobes to fit, 1 to 512. Default 128.
    pub lobes: u32,
}

impl Default for UnknownLight {
    fn default() -> Self {
        Self { lobes: light_lobes() }
    }
}

/// A light that is given.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum LightSource {
    /// SG lobes, written out.
    Lobes {
        /// The lobes, 1 to 512; axes are normalised, sharpness and amplitude are ≥ 0.
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
    /// A light in a RON file of its own, as `lobelia env fit --out` writes it: one of the others here, with paths from where that
    /// file is.
    Ron {
        /// The file; must exist.
        path: PathBuf,
        /// Factor on the radiance ≥ 0, beside the file's own. Default 1.
        #[serde(default = "one")]
        scale: f32,
        /// Turn after the file's own about the world's x, then y, then z axis, in degrees. Default (0, 0, 0).
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
        #[serde(default = "light_lobes")]
        lobes: u32,
        /// Which program's way the map faces. Default `Lobelia`.
        #[serde(default)]
        convention: MapConvention,
        /// Light from above only: the map below the horizon counts as black, and no lobe's axis points below it (before
        /// `rotation_degrees`). Default false.
        #[serde(default)]
        upper_hemisphere: bool,
        /// Grey light: the map's luminance. Default false.
        #[serde(default)]
        white: bool,
    },
}

/// What closed-form shading knows of shadows and reflections between parts of the object. (Path tracing knows both.)
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum Visibility {
    /// Nothing: every point sees all light.
    None,
    /// Rays from every texel find out.
    Traced {
        /// Directions over the sphere that texels look in, 64 to 4096, rounded up to a multiple of 64. Default 512.
        #[serde(default = "directions")]
        directions: u32,
        /// Reflections from one part of the object onto another, 0 (shadows alone) to 8. Default 2.
        #[serde(default = "bounces")]
        bounces: u32,
        /// Steps of a fit after which shadows and reflections are made anew ≥ 1. Default 50.
        #[serde(default = "refresh_every")]
        refresh_every: u32,
    },
}

impl Default for Visibility {
    fn default() -> Self {
        Self::Traced { directions: directions(), bounces: bounces(), refresh_every: refresh_every() }
    }
}

/// What is known about the material.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Material {
    /// Diffuse albedo, one colour per texel. Default `Unknown`.
    pub albedo: Albedo,
    /// The specular lobe that the whole object shares. Default: unknown.
    pub specular: Specular,
    /// Gloss that varies over the surface. Default `One`.
    pub gloss: Gloss,
}

/// What is known about the diffuse albedo.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub enum Albedo {
    /// Nothing: a fit finds it.
    #[default]
    Unknown,
    /// A first guess, which a fit improves.
    Initial(AlbedoSource),
    /// Known; a fit leaves it as it is.
    Fixed(AlbedoSource),
}

/// A diffuse albedo that is given.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum AlbedoSource {
    /// One colour in [0, 1] everywhere: `Constant(0.5, 0.5, 0.5)`.
    Constant(Vec3),
    /// A texture: PNG (sRGB) or EXR (linear), any size; must exist. `Texture("albedo.exr")`.
    Texture(PathBuf),
}

/// What is known about the specular lobe.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Specular {
    /// Specular albedo. Default `Unknown(mono: true, initial: (0.3, 0.3, 0.3))`.
    pub albedo: SpecularAlbedo,
    /// Roughness. Default `Unknown(initial: 0.4)`.
    pub roughness: Roughness,
    /// Distribution of microfacet normals: `Sg`, one spherical Gaussian as in the paper, or `Ggx`, whose highlights have the long
    /// tails of most renderers' and of glTF's. A choice, not fitted; not for `shading: Published`. Default `Sg`.
    pub ndf: Ndf,
}

/// What is known about the specular albedo (reflectance at normal incidence).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum SpecularAlbedo {
    /// A fit finds it.
    Unknown {
        /// One grey value instead of three channels. Default true.
        #[serde(default = "yes")]
        mono: bool,
        /// Where the fit starts, in [0, 1]. Default (0.3, 0.3, 0.3).
        #[serde(default = "specular_initial")]
        initial: Vec3,
    },
    /// Known, in [0, 1]: `Fixed(0.3, 0.3, 0.3)`.
    Fixed(Vec3),
}

impl Default for SpecularAlbedo {
    fn default() -> Self {
        Self::Unknown { mono: true, initial: specular_initial() }
    }
}

/// What is known about the roughness R of the paper (GGX's α is R²).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum Roughness {
    /// A fit finds it.
    Unknown {
        /// Where the fit starts, in [0.03, 1]. Default 0.4.
        #[serde(default = "roughness_initial")]
        initial: f32,
    },
    /// Known, in [0.03, 1]: `Fixed(0.25)`.
    Fixed(f32),
}

impl Default for Roughness {
    fn default() -> Self {
        Self::Unknown { initial: roughness_initial() }
    }
}

pub(super) fn y_axis() -> Vec3 {
    Vec3::Y
}
fn ones() -> Vec3 {
    Vec3::ONE
}
fn one() -> f32 {
    1.0
}
fn half() -> f32 {
    0.5
}
fn yes() -> bool {
    true
}
fn one_u32() -> u32 {
    1
}
fn held_out() -> u32 {
    8
}
fn unknown_cells() -> u32 {
    128
}

fn unknown_texture_size() -> u32 {
    512
}

fn mesh_texture_size() -> u32 {
    256
}
fn primitive_texture_size() -> u32 {
    128
}
fn sphere_radius() -> f32 {
    0.8
}
pub(super) fn fov_degrees() -> f32 {
    38.0
}
fn image_size() -> u32 {
    256
}
fn test_split() -> Split {
    Split::Test
}
fn light_lobes() -> u32 {
    128
}
fn specular_initial() -> Vec3 {
    Vec3::splat(0.3)
}
fn roughness_initial() -> f32 {
    0.4
}

fn directions() -> u32 {
    512
}

fn bounces() -> u32 {
    2
}

fn refresh_every() -> u32 {
    50
}
