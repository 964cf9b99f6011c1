//! Images in texture space: albedo textures and region masks, resampled to the object's atlas.

use crate::codec::exr::read_exr_groups;
use crate::codec::image::{Gamma, Orientation, read_image, read_mask};
use glam::Vec3;
use lobelia_geometry::error::{Error, Result};
use lobelia_sg::color::linear_from_srgb;
use lobelia_world::material::{MAX_SPECULAR_LOBES, SpecularBlend};
use std::path::Path;

const SAVED: &str = "Use the file that `Save` wrote beside the scene.";

/// Reads an image (PNG as sRGB, EXR as linear) as `width * height` linear colors, row 0 at v = 0.
/// An image of that size is used as it is; others are resampled bilinearly.
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
    let mask = read_mask(path, Orientation::Upright)?;
    let values: Vec<Vec3> = mask.coverage.iter().map(|c| Vec3::splat(*c)).collect();
    let resampled = resample(&values, [mask.width, mask.height], [width, height]);
    Ok(resampled.into_iter().map(|v| v.x).collect())
}

/// Reads an EXR of vectors, one channel for each of `axes`, as `width * height` values, row 0 at v =
/// 0; resampled like [`read_texture`].
///
/// # Errors
/// [`Error::Input`] if the file is not an EXR with these channels, all finite.
pub fn read_vectors(path: &Path, axes: [&str; 3], width: u32, height: u32) -> Result<Vec<Vec3>> {
    let (size, values) = read_exr_groups(path, &[&axes])?;
    let vectors: Vec<Vec3> = values[0].chunks_exact(3).map(Vec3::from_slice).collect();
    if vectors.iter().all(|vector| vector.is_finite()) {
        return Ok(resample(&vectors, size.map(|side| side as u32), [width, height]));
    }
    Err(Error::input(path, "", "has values that are not finite", SAVED))
}

/// Reads blend weights: channels `weight0`, `weight1` and so on, one for each of `materials`;
/// weights with a sum above one are normalized to sum to one.
///
/// # Errors
/// [`Error::Input`] if the file is not an EXR of `width` × `height` pixels with those channels, all
/// finite and ≥ 0.
pub fn read_weights(path: &Path, materials: usize, width: u32, height: u32) -> Result<Vec<SpecularBlend>> {
    let names: Vec<String> = (0..materials).map(|k| format!("weight{k}")).collect();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let ([w, h], weights) = read_exr_groups(path, &[&names])?;
    let bad = |problem: String| Error::input(path, "", problem, SAVED);
    if [w, h] != [width as usize, height as usize] {
        return Err(bad(format!("has {w}×{h} pixels, the texture {width}×{height}")));
    }
    if weights[0].iter().any(|weight| !(weight.is_finite() && *weight >= 0.0)) {
        return Err(bad("has weights that are negative or not finite".to_owned()));
    }
    if materials == 1 {
        return Ok(vec![SpecularBlend::default(); w * h]);
    }
    let blend = |weights: &[f32]| {
        let mut blend = [0.0; MAX_SPECULAR_LOBES];
        blend[..materials].copy_from_slice(weights);
        let sum: f32 = blend.iter().sum();
        // A sum of at most one keeps its bits, so that a saved object renders identically.
        SpecularBlend(if sum > 1.0 + 1e-5 { blend.map(|weight| weight / sum) } else { blend })
    };
    Ok(weights[0].chunks_exact(materials).map(blend).collect())
}

fn resample(values: &[Vec3], from: [u32; 2], to: [u32; 2]) -> Vec<Vec3> {
    if from == to {
        return values.to_vec();
    }
    // Position among source texel centers, clamped at the borders, as (first index, second index,
    // weight of the second).
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
