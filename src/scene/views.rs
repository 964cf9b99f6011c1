//! What a scene file says about the views: photographs on disk, or cameras alone.

use crate::codec::image::Gamma;
use crate::dataset::Layout;
use crate::dataset::priors::Priors;
use crate::scene::defaults::{fov_degrees, y_axis};
use crate::scene::light::LightSource;
use crate::scene::photographed::Photographed;
use crate::view::Split;
use glam::Vec3;
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
    /// What lights the groups of photographs after the first: `Own` or `Fixed`.
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
    /// How 8- and 16-bit images are decoded to linear light (EXR and HDR are linear). Default `Srgb`.
    #[serde(default)]
    pub gamma: Gamma,
    /// Where in a pixel its center is, in pixels from its upper left corner, 0 to 1; 0 for data of PhySG's own code. Default: 0 in
    /// the layout `Idr`, 0.5 in all others.
    #[serde(default)]
    pub pixel_center: Option<f32>,
    /// Factor on all focal lengths, 0.5 to 2, such as a fit with `cameras: PosesAndFocal` found. Default 1.
    #[serde(default = "one")]
    pub focal_scale: f32,
    /// Images are shrunk by this whole factor ≥ 1 (box filter). Default 1.
    #[serde(default = "one_u32")]
    pub downscale: u32,
    /// Keep every n-th view of each split, n ≥ 1, starting with the first. Default 1.
    #[serde(default = "one_u32")]
    pub every: u32,
    /// Where the data has no test split of its own (COLMAP, say), every n-th view by name is one of it, n ≥ 2, starting with the
    /// first; 0: there is none. Default 8.
    #[serde(default = "held_out")]
    pub hold_out: u32,
    /// Keep only the views with these names (image file stems); empty: all. Default [].
    #[serde(default)]
    pub select: Vec<String>,
    /// What is known of the surface from elsewhere, as pictures of the user's own for the training photographs: albedo, normals. Default: nothing.
    #[serde(default)]
    pub priors: Priors,
    /// How the object lay, or what light it was in, where that changed between rounds of photographs; fewer than two: it was the same in all. Default [].
    #[serde(default)]
    pub placements: Vec<PlacementSpec>,
}

/// The photographs of an object that lay in one way, in one light.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlacementSpec {
    /// A folder of the data set that the photographs are in, at any depth, or what their names begin with. A photograph belongs to the first entry that it
    /// suits, and must suit one.
    pub photographs: String,
    /// How the object is turned relative to the first placement, about the world's x, then y, then z axis, in degrees: from
    /// its axes, which are those of the cameras, to where they point in the room. Not for the first. Default: a fit finds it; beside a `light` of its own
    /// (0, 0, 0): that light is in the axes of the object.
    #[serde(default)]
    pub turned_degrees: Option<Vec3>,
    /// The light on these photographs. Not for the first. Default `Same`.
    #[serde(default)]
    pub light: PlacementLight,
}

/// The light on the photographs of a placement.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub enum PlacementLight {
    /// That of the first placement: the same room, at the same time.
    #[default]
    Same,
    /// Another room or another day: a light of its own, which a fit finds as it does the scene's `light`.
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
    /// What it looks at. Default (0, 0, 0).
    #[serde(default)]
    pub target: Vec3,
    /// Which direction is up in the image. Default (0, 1, 0).
    #[serde(default = "y_axis")]
    pub up: Vec3,
    /// Vertical field of view in degrees, 0.001 to 170. Default 38.
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

fn one() -> f32 {
    1.0
}

fn one_u32() -> u32 {
    1
}

fn held_out() -> u32 {
    8
}

fn image_size() -> u32 {
    256
}

fn test_split() -> Split {
    Split::Test
}
