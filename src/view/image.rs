//! Images and masks as grids of pixels.

use glam::Vec3;

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
