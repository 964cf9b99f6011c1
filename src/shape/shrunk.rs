//! Photographs made smaller, with the object alone: what the pictures of stereo and of hollows have in common.

use crate::view::{Camera, Photograph, PixelWindow, StoredMask};
use glam::Vec3;

/// Coverage of a block of pixels from which it shows the object alone.
const WHOLE: f32 = 0.95;

/// The camera of a picture `factor` times smaller along each axis, the part of it that the mask covers, and the mean radiance of each pixel
/// of that part, `None` where the object is not alone. `None` if the mask is empty.
pub fn shrunk<'a>(
    camera: &'a Camera,
    photograph: &'a Photograph,
    mask: &'a StoredMask,
    factor: u32,
) -> Option<(Camera, PixelWindow, impl Iterator<Item = Option<Vec3>> + use<'a>)> {
    let small = camera.scaled(factor);
    let whole = mask.window();
    let (x, y) = (whole.x / factor, whole.y / factor);
    let right = (whole.x + whole.width).div_ceil(factor).min(small.width);
    let bottom = (whole.y + whole.height).div_ceil(factor).min(small.height);
    if right <= x || bottom <= y {
        return None;
    }
    let window = PixelWindow { x, y, width: right - x, height: bottom - y };
    let width = small.width;
    let block = move |pixel: usize| {
        let (x, y) = (pixel as u32 % width * factor, pixel as u32 / width * factor);
        let pixels = (0..factor * factor).map(|k| (y + k / factor) * camera.width + x + k % factor);
        let (light, covered) = pixels.fold((Vec3::ZERO, 0.0), |(light, covered), i| {
            (light + photograph.radiance(i as usize), covered + mask.coverage(i as usize))
        });
        let is_alone = covered >= WHOLE * (factor * factor) as f32;
        is_alone.then(|| light / covered)
    };
    Some((small, window, window.pixels(width).map(block)))
}
