//! What a scene file says about light.

use crate::codec::npy::NpyConvention;
use crate::light::LightLobe;
use crate::light::convention::MapConvention;
use crate::light::light_frame::LightFrame;
use glam::Vec3;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// What is known about the light.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Light {
    /// Nothing: a fit finds it.
    Unknown(UnknownLight),
    /// An initial value, which a fit improves: `Initial(Npy(path: "light.npy"))`.
    Initial(LightSource),
    /// Known; a fit leaves it as it is: `Fixed(Map(path: "sky.exr"))`.
    Fixed(LightSource),
}

impl Default for Light {
    fn default() -> Self {
        Self::Unknown(UnknownLight::default())
    }
}

/// In which frame the light stands still.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub enum LightFrameChoice {
    /// The first fit of an unknown light finds it from the photographs; a light that is given stands in the world.
    #[default]
    Auto,
    /// The world: the camera goes around the object.
    World,
    /// The camera: the object turns on a turntable before one camera, or lamps move with the camera. The light's x, y and z are right, up
    /// and backward in the picture.
    Camera,
    /// A turntable with this axis (not zero, in the world) before a camera that is raised or tilted between rounds:
    /// `Turntable(0, 1, 0)`.
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
#[serde(deny_unknown_fields, default)]
pub struct UnknownLight {
    /// How many SG lobes to fit, 1 to 2048. Default 128.
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
        /// Gray light: the map's luminance. Default false.
        #[serde(default)]
        white: bool,
    },
}

fn one() -> f32 {
    1.0
}

fn light_lobes() -> u32 {
    128
}
