//! What a scene file says about photographs that the project takes itself: cameras, and the true material and light.
//!
//! Conventions as in [`description`](crate::scene::description).

use crate::light::light_frame::LightFrame;
use crate::material::SpecularLobe;
use crate::scene::defaults::{fov_degrees, y_axis};
use crate::scene::edit::Edit;
use crate::scene::light::LightSource;
use glam::Vec3;
use serde::{Deserialize, Serialize};

/// Photographs that the project takes itself: the scene's surface, with a known material, under a known light, path traced.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Photographed {
    /// The cameras around the object.
    #[serde(default)]
    pub cameras: CameraRing,
    /// Paths per pixel, 1 to 65536. Default 64.
    #[serde(default = "photograph_spp")]
    pub spp: u32,
    /// Most surface hits of a path, 1 to 64. Default 4.
    #[serde(default = "max_bounces")]
    pub max_bounces: u32,
    /// What is photographed. The fit is not told.
    pub truth: TruthObject,
}

/// Cameras spread evenly over a sphere around a target, all looking at it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CameraRing {
    /// Training views ≥ 1. Default 24.
    pub count: u32,
    /// Test views, placed between the training views. Default 4.
    pub test: u32,
    /// What the cameras look at. Default (0, 0, 0).
    pub target: Vec3,
    /// Distance from the target > 0. Default 2.8.
    pub radius: f32,
    /// Field of view in degrees, 0.001 to 170. Default 38.
    pub fov_degrees: f32,
    /// Image width and height in pixels, 1 to 16384. Default 96.
    pub size: u32,
}

impl TruthObject {
    /// Rounds of photographs.
    pub fn rounds(&self) -> usize {
        1 + self.placements.len() + self.other_lights.len()
    }
}

impl Default for CameraRing {
    fn default() -> Self {
        Self { count: 24, test: 4, target: Vec3::ZERO, radius: 2.8, fov_degrees: fov_degrees(), size: 96 }
    }
}

/// The true material and light of self-made photographs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TruthObject {
    /// Diffuse albedo over the surface.
    pub albedo: Pattern,
    /// Specular albedo in [0, 1], roughness in [0.03, 1] and, if not the paper's, `ndf`: `(albedo: (…), roughness: 0.25, ndf: Ggx)`.
    pub specular: SpecularLobe,
    /// The light.
    pub light: LightSource,
    /// The frame in which it stands still, as `light_frame` of the scene. Default `World`.
    #[serde(default)]
    pub light_frame: LightFrame,
    /// How the object is turned for each further round of photographs, as `turned_degrees` of `placements` of a data set; views are of the
    /// rounds in turn. The fit is told which, and not how the object is turned. Default [].
    #[serde(default)]
    pub placements: Vec<Vec3>,
    /// Lights of further rounds of photographs, after those of `placements`: another room, or another day. The fit is told which photographs are of which. Default [].
    #[serde(default)]
    pub other_lights: Vec<LightSource>,
    /// What else is done to the material: regions of other color or gloss. Default [].
    #[serde(default)]
    pub edits: Vec<Edit>,
}

/// A diffuse albedo that varies with the position in space. Colors are in [0, 1].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum Pattern {
    /// The same everywhere: `Constant(0.5, 0.5, 0.5)`.
    Constant(Vec3),
    /// Cubes of two alternating colors.
    Checker {
        /// The two colors.
        colors: (Vec3, Vec3),
        /// Edge length of a cube > 0. Default 0.3.
        #[serde(default = "pattern_size")]
        size: f32,
    },
    /// Slabs whose colors repeat.
    Stripes {
        /// The colors in order, at least one.
        colors: Vec<Vec3>,
        /// The direction across the slabs, not zero. Default (0, 1, 0).
        #[serde(default = "y_axis")]
        axis: Vec3,
        /// Thickness of a slab > 0. Default 0.3.
        #[serde(default = "pattern_size")]
        width: f32,
    },
    /// Smooth waves in space that blend between two colors.
    Waves {
        /// The two colors.
        colors: (Vec3, Vec3),
        /// Wavelength > 0. Default 0.3.
        #[serde(default = "pattern_size")]
        size: f32,
    },
}

fn photograph_spp() -> u32 {
    64
}

fn max_bounces() -> u32 {
    4
}

fn pattern_size() -> f32 {
    0.3
}
