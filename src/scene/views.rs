//! The views: photographs on disk, cameras alone, or photographs that the project takes itself.

use crate::scene::{Edit, LightSource, fov_degrees, number, one, y_axis};
use glam::Vec3;
use lobelia_geometry::{Result, view::Camera, view::Split};
use lobelia_io::{codec::image::Gamma, dataset::Layout, dataset::Priors};
use lobelia_world::{light::light_frame::LightFrame, material::SpecularLobe};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

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

impl Views {
    /// Returns the lights of the groups of photographs after the first: `Own` or `Fixed`.
    pub fn other_lights(&self) -> Vec<PlacementLight> {
        match self {
            Self::Dataset(data) => {
                let lights = data.placements.iter().map(|placement| placement.light.clone());
                lights.filter(|light| *light != PlacementLight::Same).collect()
            }
            Self::Photographed(spec) => vec![PlacementLight::Own; spec.truth.other_lights.len()],
            Self::Cameras(_) => Vec::new(),
        }
    }

    /// In how many ways the object lies, or is lit, at least 1.
    pub fn placements(&self) -> usize {
        match self {
            Self::Dataset(data) => data.placements.len().max(1),
            Self::Photographed(spec) => spec.truth.rounds(),
            Self::Cameras(_) => 1,
        }
    }
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
    /// How 8- and 16-bit images are decoded to linear light (EXR and HDR are linear). Default
    /// `Srgb`.
    #[serde(default)]
    pub gamma: Gamma,
    /// Where in a pixel its center is, in pixels from its upper left corner, 0 to 1; 0 for data of
    /// PhySG's own code. Default: 0 in the layout `Idr`, 0.5 in all others.
    #[serde(default)]
    pub pixel_center: Option<f32>,
    /// Factor on all focal lengths, 0.5 to 2, such as a fit with `cameras: PosesAndFocal` found.
    /// Default 1.
    #[serde(default = "one")]
    pub focal_scale: f32,
    /// Images are shrunk by this whole factor ≥ 1 (box filter). Default 1.
    #[serde(default = "number::<1>")]
    pub downscale: u32,
    /// Keep every n-th view of each split, n ≥ 1, starting with the first. Default 1.
    #[serde(default = "number::<1>")]
    pub every: u32,
    /// Where the data has no test split of its own (COLMAP, say), every n-th view by name is one of
    /// it, n ≥ 2, starting with the first; 0: there is none. Default 8.
    #[serde(default = "number::<8>")]
    pub hold_out: u32,
    /// Keep only the views with these names (image file stems); empty: all. Default [].
    #[serde(default)]
    pub select: Vec<String>,
    /// The user's own pictures of the surface for the training photographs: albedo, normals.
    /// Default: nothing.
    #[serde(default)]
    pub priors: Priors,
    /// How the object lay, or what light it was in, where that changed between rounds of
    /// photographs; fewer than two: it was the same in all. Default [].
    #[serde(default)]
    pub placements: Vec<PlacementSpec>,
}

/// The photographs of an object that lay in one way, in one light.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlacementSpec {
    /// A folder of the data set that the photographs are in, at any depth, or what their names
    /// begin with. A photograph belongs to the first entry that it suits, and must suit one.
    pub photographs: String,
    /// How the object is turned relative to the first placement, about the world's x, then y, then
    /// z axis, in degrees: from its axes, which are those of the cameras, to where they point in
    /// the room. Not for the first. Default: a fit finds it; beside a `light` of its own (0, 0, 0):
    /// that light is in the axes of the object.
    #[serde(default)]
    pub turned_degrees: Option<Vec3>,
    /// The light on these photographs. Not for the first. Default `Same`.
    #[serde(default)]
    pub light: PlacementLight,
}

/// The light on the photographs of a placement.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub enum PlacementLight {
    /// The light of the first placement: the same room, at the same time.
    #[default]
    Same,
    /// Another room or another day: a light of its own, which a fit finds as it does the scene's
    /// `light`.
    Own,
    /// Another light that is known, where the scene's `light` is: `Fixed(Map(path: "garden.exr"))`.
    Fixed(LightSource),
}

/// One pinhole camera, by what it looks at.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraSpec {
    /// The view's name; output files carry it. Letters, digits, `_`, `-`.
    pub name: String,
    /// Where the camera stands.
    pub eye: Vec3,
    /// Point that it looks at. Default (0, 0, 0).
    #[serde(default)]
    pub target: Vec3,
    /// Which direction is up in the image. Default (0, 1, 0).
    #[serde(default = "y_axis")]
    pub up: Vec3,
    /// Vertical field of view in degrees, 0.001 to 170. Default 38.
    #[serde(default = "fov_degrees")]
    pub fov_degrees: f32,
    /// Image width in pixels, 1 to 16384. Default 256.
    #[serde(default = "number::<256>")]
    pub width: u32,
    /// Image height in pixels, 1 to 16384. Default 256.
    #[serde(default = "number::<256>")]
    pub height: u32,
    /// The split this view belongs to. Default `Test`.
    #[serde(default = "test_split")]
    pub split: Split,
}

impl CameraSpec {
    pub(crate) fn camera(&self) -> Result<Camera> {
        Camera::look_at(self.eye, self.target, self.up, self.fov_degrees, self.width, self.height)
    }
}

fn test_split() -> Split {
    Split::Test
}

/// Photographs that the project takes itself: the scene's surface, with a known material, under a
/// known light, path traced.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Photographed {
    /// The cameras around the object.
    #[serde(default)]
    pub cameras: CameraRing,
    /// Paths per pixel, 1 to 65536. Default 64.
    #[serde(default = "number::<64>")]
    pub spp: u32,
    /// Most surface hits of a path, 1 to 64. Default 4.
    #[serde(default = "number::<4>")]
    pub max_bounces: u32,
    /// The photographed material and light. The fit is not told.
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
    /// Point that the cameras look at. Default (0, 0, 0).
    pub target: Vec3,
    /// Distance from the target > 0. Default 2.8.
    pub radius: f32,
    /// Field of view in degrees, 0.001 to 170. Default 38.
    pub fov_degrees: f32,
    /// Image width and height in pixels, 1 to 16384. Default 96.
    pub size: u32,
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
    /// Specular albedo in [0, 1], roughness in [0.03, 1] and, if not the paper's, `ndf`:
    /// `(albedo: (…), roughness: 0.25, ndf: Ggx)`.
    pub specular: SpecularLobe,
    /// The light.
    pub light: LightSource,
    /// The frame in which it stands still, as `light_frame` of the scene. Default `World`.
    #[serde(default)]
    pub light_frame: LightFrame,
    /// How the object is turned for each further round of photographs, as `turned_degrees` of
    /// `placements` of a data set; views are of the rounds in turn. The fit is told which, and not
    /// how the object is turned. Default [].
    #[serde(default)]
    pub placements: Vec<Vec3>,
    /// Lights of further rounds of photographs, after those of `placements`: another room, or
    /// another day. The fit is told which photographs are of which. Default [].
    #[serde(default)]
    pub other_lights: Vec<LightSource>,
    /// Further changes of the material: regions of other color or gloss. Default [].
    #[serde(default)]
    pub edits: Vec<Edit>,
}

impl TruthObject {
    /// Rounds of photographs.
    pub fn rounds(&self) -> usize {
        1 + self.placements.len() + self.other_lights.len()
    }
}

/// A diffuse albedo that varies with the position in space. Colors are in [0, 1].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum Pattern {
    /// One albedo everywhere: `Constant(0.5, 0.5, 0.5)`.
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

fn pattern_size() -> f32 {
    0.3
}
