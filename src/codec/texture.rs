//! Images in texture space: albedo textures and region masks, resampled to the object's atlas.

use crate::codec::exr::read_exr_layers;
use crate::codec::image::{Gamma, Orientation, read_image, read_mask};
use crate::error::{Error, Result};
use crate::material::{MAX_SPECULAR_LOBES, SpecularBlend};
use crate::math::color::linear_from_srgb;
use glam::Vec3;
use std::path::Path;

/// Reads an image (PNG as sRGB, EXR as linear) as `width * height` linear colors, row 0 at v = 0. An image of that size is
/// used as it is; others are resampled bilinearly.
///
/// # Errors
/// If the file cannot be read.
pub fn read_texture(path: &Path, width: u32, height: u32) -> Result<Vec<Vec3>> {
    let image = read_image(path, Gamma::Srgb, Orientation::Upright)?.image;
    Ok(resample(&image.pixels, [image.width, image.height], [width, height]))
}

/// [`read_texture`] for the bytes of an sRGB image in the file `path`.
///
/// # Errors
/// [`Error::Input`] if they are not an image.
pub fn decode_texture(path: &Path, bytes: &[u8], width: u32, height: u32) -> Result<Vec<Vec3>> {
    let image = image::load_from_memory(bytes).map_err(|error| {
        let problem = format!("its texture cannot be decoded: {error}");
        Error::input(path, "", problem, "export the mesh again with a PNG texture")
    })?;
    let image = image.to_rgb32f();
    let linear = |pixel: &image::Rgb<f32>| Vec3::from(pixel.0.map(linear_from_srgb));
    let values: Vec<Vec3> = image.pixels().map(linear).collect();
    Ok(resample(&values, [image.width(), image.height()], [width, height]))
}

/// Reads a mask image as `width * height` weights in `[0, 1]`, row 0 at v = 0.
///
/// # Errors
/// If the file cannot be read.
pub fn read_texture_mask(path: &Path, width: u32, height: u32) -> Result<Vec<f32>> {
    let mask = read_mask(path, Orientation::Upright)?.mask;
    let values: Vec<Vec3> = mask.coverage.iter().map(|c| Vec3::splat(*c)).collect();
    let resampled = resample(&values, [mask.width, mask.height], [width, height]);
    Ok(resampled.into_iter().map(|v| v.x).collect())
}

/// Reads an EXR of vectors, one channel for each of `axes`, as `width * height` values, row 0 at v = 0; resampled like [`read_texture`].
///
/// # Errors
/// [`Error::Input`] if the file is not an EXR with these channels, all finite.
pub fn read_vectors(path: &Path, axes: [&str; 3], width: u32, height: u32) -> Result<Vec<Vec3>> {
    let layers = read_exr_layers(path)?;
    let bad =
        |problem: String| Error::input(path, "", problem, "Use the file that `Save` wrote beside the scene.");
    let channel = |name: &str| {
        let values = layers.channels.get(name).ok_or_else(|| bad(format!("has no channel {name}")))?;
        if values.iter().all(|value| value.is_finite()) {
            Ok(values)
        } else {
            Err(bad(format!("channel {name} has values that are not finite")))
        }
    };
    let [x, y, z] = [channel(axes[0])?, channel(axes[1])?, channel(axes[2])?];
    let vectors: Vec<Vec3> = (0..x.len()).map(|i| Vec3::new(x[i], y[i], z[i])).collect();
    Ok(resample(&vectors, [layers.width, layers.height], [width, height]))
}

/// Reads blend weights: channels `weight0`, `weight1` and so on, one for each of `materials`; weights with a sum above one are
/// normalized to sum to one.
///
/// # Errors
/// [`Error::Input`] if the file is not an EXR of `width` × `height` pixels with those channels, all finite and ≥ 0.
pub fn read_weights(path: &Path, materials: usize, width: u32, height: u32) -> Result<Vec<SpecularBlend>> {
    let layers = read_exr_layers(path)?;
    let bad =
        |problem: String| Error::input(path, "", problem, "Use the file that `Save` wrote beside the scene.");
    if (layers.width, layers.height) != (width, height) {
        let (w, h) = (layers.width, layers.height);
        return Err(bad(format!("has {w}×{h} pixels, the texture {width}×{height}")));
    }
    let mut blends = vec![SpecularBlend([0.0; MAX_SPECULAR_LOBES]); (width * height) as usize];
    for k in 0..materials {
        let name = format!("weight{k}");
        let channel = layers.channels.get(&name).ok_or_else(|| bad(format!("has no channel {name}")))?;
        if channel.iter().any(|w| !(w.is_finite() && *w >= 0.0)) {
            return Err(bad(format!("channel {name} has values that are negative or not finite")));
        }
        blends.iter_mut().zip(channel).for_each(|(blend, weight)| blend.0[k] = *weight);
    }
    if materials == 1 {
        blends.fill(SpecularBlend::default());
    }
    for blend in &mut blends {
        let sum: f32 = blend.0.iter().sum();
        // A sum of at most one keeps its bits, so that a saved object renders identically.
        if sum > 1.0 + 1e-5 {
            blend.0.iter_mut().for_each(|weight| *weight /= sum);
        }
    }
    Ok(blends)
}

fn resample(values: &[Vec3], from: [u32; 2], to: [u32; 2]) -> Vec<Vec3> {
    if from == to {
        return values.to_vec();
    }
    // Position among source texel centers, clamped at the borders, as (first index, second index, weight of the second).
    let along = |i: u32, axis: usize| {
        let at = (i as f32 + 0.5) * from[axis] as f32 / to[axis] as f32 - 0.5;
        let at = at.clamp(0.0, (from[axis] - 1) as f32);
        let low = at.floor() as u32;
        (low, (low + 1).min(from[axis] - 1), at - low as f32)
    };
    let at = |x: u32, y: u32| values[(y * from[0] + x) as usize];
    let mut out = Vec::with_capacity((to[0] * to[1]) as usize);
    for j in 0..to[1] {
        let (y0, y1, fy) = along(j, 1);
        for i in 0..to[0] {
            let (x0, x1, fx) = along(i, 0);
            let (top, bottom) = (at(x0, y0).lerp(at(x1, y0), fx), at(x0, y1).lerp(at(x1, y1), fx));
            out.push(top.lerp(bottom, fy));
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn resampling_keeps_constants_and_ramps() {
        let ramp: Vec<Vec3> = (0..8).map(|i| Vec3::splat(i as f32)).collect();
        let half = resample(&ramp, [8, 1], [4, 1]);
        assert_eq!(half.iter().map(|v| v.x).collect::<Vec<_>>(), [0.5, 2.5, 4.5, 6.5]);
        let same = resample(&ramp, [8, 1], [8, 1]);
        assert_eq!(same, ramp);
        assert!(resample(&[Vec3::ONE; 6], [3, 2], [16, 16]).iter().all(|v| *v == Vec3::ONE));
    }
}
