//! Views: cameras, photographs and masks.
//!
//! Camera axes are OpenCV's (x right, y down, z forward). The centre of pixel (i, j) is (i + 0.5, j + 0.5).

pub mod pixel;

use crate::math::ray::Ray;
use bevy_ecs::prelude::Component;
use glam::{Affine3A, Vec3};
use serde::{Deserialize, Serialize};

/// A pinhole camera.
#[derive(Component, Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// Image width in pixels.
    pub width: u32,
    /// Image height in pixels.
    pub height: u32,
    /// Focal lengths in pixels.
    pub focal: [f32; 2],
    /// Principal point in pixels.
    pub center: [f32; 2],
    /// Skew in pixels (0 for nearly every camera).
    pub skew: f32,
    /// Rigid transform from OpenCV camera axes to world space.
    pub world_from_camera: Affine3A,
    /// Offset of a pixel's centre from its index (0.5; PhySG's own code uses 0).
    pub pixel_center: f32,
}

impl Camera {
    /// The world ray through image position (`x`, `y`) in pixels, where pixel (i, j) spans `[i, i + 1) × [j, j + 1)`.
    pub fn ray(&self, x: f32, y: f32) -> Ray {
        let shift = self.pixel_center - 0.5;
        let y_camera = (y + shift - self.center[1]) / self.focal[1];
        let x_camera = (x + shift - self.center[0] - self.skew * y_camera) / self.focal[0];
        let direction = self.world_from_camera.transform_vector3(Vec3::new(x_camera, y_camera, 1.0));
        Ray { origin: self.world_from_camera.translation.into(), direction: direction.normalize() }
    }
}

/// A linear RGB image, row by row from the top left.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Image {
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// `width * height` linear Rec. 709 radiances.
    pub pixels: Vec<Vec3>,
}

/// Coverage of each pixel by the object, row by row from the top left.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mask {
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// `width * height` values in `[0, 1]`.
    pub coverage: Vec<f32>,
}

/// What a view is called; output files carry this name.
#[derive(Component, Clone, Debug, PartialEq, Eq)]
pub struct ViewName(pub String);

/// A view's photograph.
#[derive(Component, Clone, Debug)]
pub struct Photograph {
    /// Linear radiance, coverage-weighted on black.
    pub image: Image,
    /// Pixels whose stored value was at the top of its range (8-bit 255, 16-bit 65535): left out of the loss.
    pub saturated: Vec<bool>,
}

/// A view's mask.
#[derive(Component, Clone, Debug)]
pub struct ViewMask(pub Mask);

/// Which part of a data set a view belongs to.
#[derive(Component, Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Split {
    /// Fitted to.
    Train,
    /// Held out.
    Test,
}

/// One view as read from a data set, before it is spawned.
#[derive(Clone, Debug)]
pub struct ViewRecord {
    /// File stem of the image, e.g. `rgb_000000`.
    pub name: String,
    /// Which part of the data set.
    pub split: Split,
    /// The camera.
    pub camera: Camera,
    /// The photograph, unless the data set has cameras only.
    pub photograph: Option<Photograph>,
    /// The mask, unless there is none.
    pub mask: Option<Mask>,
}
