//! Whether the texture has as much detail as the photographs.

use crate::math::statistics::median;
use crate::survey::finding::Finding;
use crate::survey::look::ViewLook;
use crate::view::Split;

/// Share of the atlas that charts cover, about.
pub(crate) const ATLAS_FILL: f32 = 0.6;
/// A texel this many pixels wide loses what the photographs show.
const COARSE: f32 = 3.0;
/// Largest texture of a scene file.
const MOST_TEXTURE: u32 = 4096;

/// How wide a texel is in pixels of the training photographs, for a texture of `texture_size`² texels. A view shows about a quarter of the
/// surface: the mean projected area of a convex object (Cauchy). `None` without masks.
pub(crate) fn pixels_per_texel(looks: &[ViewLook], texture_size: u32) -> Option<f32> {
    let train = looks.iter().filter(|look| look.split == Split::Train && look.light.is_some());
    let mut areas: Vec<f32> = train.filter_map(ViewLook::object_pixels).collect();
    let texels = ATLAS_FILL * (texture_size as f32).powi(2);
    median(&mut areas).map(|area| (4.0 * area / texels).sqrt())
}

/// A texture that is too small for the photographs, if no fit refines it (`is_refined`).
pub(crate) fn finding(looks: &[ViewLook], texture_size: u32, is_refined: bool) -> Option<Finding> {
    if is_refined {
        return None;
    }
    let wide =
        pixels_per_texel(looks, texture_size).filter(|wide| *wide > COARSE && texture_size < MOST_TEXTURE)?;
    let enough = ((texture_size as f32 * wide).ceil() as u32).next_power_of_two().min(MOST_TEXTURE);
    let problem = format!(
        "the texture is too small for the photographs: a texel of {texture_size}² is about {wide:.1} pixels wide"
    );
    let help = format!(
        "Say `Fit(detail: true)` or `texture_size: {enough}` in `surface`, or shrink the photographs with `downscale`."
    );
    Some(Finding::warning("coarse-texture", Vec::new(), problem, help))
}
