//! Photographs and other pictures as linear radiance.

use crate::codec::image::decode::decode_samples;
use crate::codec::image::header::Orientation;
use crate::codec::image::repair::Repairs;
use crate::codec::image::samples::{Decoded, ImageSamples};
use crate::error::{Error, Result};
use crate::math::color::linear_from_srgb;
use crate::view::Image;
use glam::Vec3;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// How 8- and 16-bit values become linear. Float formats (EXR, HDR) are linear whatever this says.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub enum Gamma {
    /// The sRGB curve of IEC 61966-2-1.
    #[default]
    Srgb,
    /// `linear = stored^exponent`, e.g. `Power(2.2)`; the exponent is finite and above 0.
    Power(f32),
    /// Values are linear as stored.
    Linear,
}

impl Gamma {
    /// Linear value in `[0, 1]` of a stored value in `[0, 1]`.
    pub fn decode(self, stored: f32) -> f32 {
        match self {
            Self::Srgb => linear_from_srgb(stored),
            Self::Power(exponent) => stored.powf(exponent),
            Self::Linear => stored,
        }
    }

    /// Linear values of the stored integers 0 to `top`.
    pub fn curve(self, top: u32) -> Vec<f32> {
        (0..=top).map(|stored| self.decode(stored as f32 / top as f32)).collect()
    }

    /// # Errors
    /// [`Error::Usage`] if the exponent is not finite and above 0.
    pub fn check(self) -> Result<()> {
        match self {
            Self::Power(exponent) if !(exponent.is_finite() && exponent > 0.0) => Err(Error::usage(
                format!("gamma: Power({exponent}) is not a curve"),
                "Give an exponent above 0, e.g. Power(2.2), or Srgb, or Linear.",
            )),
            _ => Ok(()),
        }
    }
}

/// A picture as read from its file.
#[derive(Clone, Debug, PartialEq)]
pub struct LoadedImage {
    /// Linear radiance, coverage-weighted on black: straight (PNG) alpha has been multiplied in, EXR is taken as stored.
    pub image: Image,
    /// Coverage in `[0, 1]`, one value per pixel, if the file has alpha.
    pub alpha: Option<Vec<f32>>,
    /// In integer formats, pixels with a color channel at the highest storable value and an alpha above 0: that channel is a lower
    /// bound. In float formats, the repaired pixels.
    pub saturated: Vec<bool>,
    /// What was repaired in float formats.
    pub repairs: Repairs,
    /// Whether the file held linear floats (EXR, HDR, float TIFF) and not 8- or 16-bit integers.
    pub is_float: bool,
}

/// Reads a picture as linear radiance: PNG, JPEG, TIFF, WebP (8 and 16 bit; gray, RGB, palette, with and without alpha), EXR
/// (half, float, uint; R, G, B or Y, optional A), Radiance HDR or float TIFF.
///
/// NaN, infinite and absurdly bright pixels are set to 0, counted in [`LoadedImage::repairs`] and marked as saturated.
///
/// # Errors
/// [`Error::Input`] if the file is missing, empty, damaged, truncated, in a format that is not read, too large, not in the
/// format that its name says, has no finite pixel, or more than a few absurdly bright ones; [`Error::Usage`] for an impossible
/// `gamma`.
pub fn read_image(path: impl AsRef<Path>, gamma: Gamma, orientation: Orientation) -> Result<LoadedImage> {
    gamma.check()?;
    let path = path.as_ref();
    let mut decoded = decode_samples(path, orientation)?;
    let repairs = decoded.repair();
    repairs.check(path, decoded.pixels())?;
    Ok(linear_image(&decoded, repairs, gamma))
}

/// The samples of a photograph, repaired as [`read_image`] does; negative colors are set to 0.
///
/// # Errors
/// Those of [`read_image`] for its file; also if most pixels that are not black are negative.
pub fn decode_photograph(path: impl AsRef<Path>, orientation: Orientation) -> Result<(Decoded, Repairs)> {
    let path = path.as_ref();
    let mut decoded = decode_samples(path, orientation)?;
    let repairs = decoded.repair();
    repairs.check_photograph(path, decoded.pixels())?;
    if repairs.negative > 0 {
        decoded.clamp_negative();
    }
    Ok((decoded, repairs))
}

/// Samples as linear light.
pub(crate) fn linear_image(decoded: &Decoded, repairs: Repairs, gamma: Gamma) -> LoadedImage {
    let channels = decoded.channels();
    match &decoded.samples {
        ImageSamples::Bytes8(samples) => {
            from_integers(samples, channels, &gamma.curve(255)).into_loaded(decoded, repairs)
        }
        ImageSamples::Words16(samples) => {
            from_integers(samples, channels, &gamma.curve(65_535)).into_loaded(decoded, repairs)
        }
        ImageSamples::Floats(samples) => {
            from_floats(samples, channels, &repairs).into_loaded(decoded, repairs)
        }
    }
}

/// Linear premultiplied colors, alpha, and the flags of pixels with a channel at the top of its range.
struct Pixels {
    colors: Vec<Vec3>,
    alpha: Vec<f32>,
    saturated: Vec<bool>,
}

impl Pixels {
    fn into_loaded(self, decoded: &Decoded, repairs: Repairs) -> LoadedImage {
        let Decoded { header, width, height, .. } = *decoded;
        LoadedImage {
            image: Image { width, height, pixels: self.colors },
            alpha: header.has_alpha().then_some(self.alpha),
            saturated: self.saturated,
            repairs,
            is_float: header.is_float,
        }
    }
}

fn from_integers<T: Copy + Into<u32>>(samples: &[T], channels: usize, curve: &[f32]) -> Pixels {
    let top = curve.len() as u32 - 1;
    let (gray, has_alpha, count) = (channels < 3, channels.is_multiple_of(2), samples.len() / channels);
    let mut pixels = Pixels {
        colors: Vec::with_capacity(count),
        alpha: Vec::with_capacity(if has_alpha { count } else { 0 }),
        saturated: Vec::with_capacity(count),
    };
    for pixel in samples.chunks_exact(channels) {
        let value = |i: usize| curve[pixel[i].into() as usize];
        let color = if gray { Vec3::splat(value(0)) } else { Vec3::new(value(0), value(1), value(2)) };
        let colors = if gray { 1 } else { 3 };
        let mut coverage = top;
        if has_alpha {
            coverage = pixel[colors].into();
            pixels.alpha.push(coverage as f32 / top as f32);
        }
        pixels.colors.push(if has_alpha { color * (coverage as f32 / top as f32) } else { color });
        pixels.saturated.push(coverage > 0 && pixel[..colors].iter().any(|&stored| stored.into() == top));
    }
    pixels
}

fn from_floats(samples: &[f32], channels: usize, repairs: &Repairs) -> Pixels {
    let rows = samples.chunks_exact(channels);
    let color = |pixel: &[f32]| {
        if channels < 3 { Vec3::splat(pixel[0]) } else { Vec3::new(pixel[0], pixel[1], pixel[2]) }
    };
    let colors: Vec<Vec3> = rows.clone().map(color).collect();
    let has_alpha = channels.is_multiple_of(2);
    let alpha = if has_alpha { rows.map(|pixel| pixel[channels - 1]).collect() } else { Vec::new() };
    let mut saturated = vec![false; colors.len()];
    repairs.pixels.iter().for_each(|&i| saturated[i as usize] = true);
    Pixels { colors, alpha, saturated }
}
