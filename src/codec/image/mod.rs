//! Reading photographs and masks: PNG, JPEG, OpenEXR and Radiance HDR.
//!
//! The first bytes of a file determine its format; a file name with another format is an error. Embedded color profiles and gamma
//! chunks are ignored: [`Gamma`] says how 8- and 16-bit values are read.

use crate::codec::file::read_bytes;
use crate::codec::nearby::missing_file_help;
use crate::error::{Error, Result};
use crate::math::color::{linear_from_srgb, luminance};
use crate::view::{Image, Mask};
use glam::Vec3;
use image::metadata::Orientation as ExifOrientation;
use image::{DynamicImage, ImageDecoder, ImageFormat, ImageReader};
use serde::{Deserialize, Serialize};
use std::io::Cursor;
use std::path::Path;

/// How 8- and 16-bit values become linear. Float formats (EXR, HDR) are linear whatever this says.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
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

/// What becomes of the EXIF orientation of a file, the number that says how the camera was held.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Orientation {
    /// Pixels as they lie in the file, which is what COLMAP reads.
    AsStored,
    /// Pixels turned as the file asks, which is what viewers show.
    #[default]
    Upright,
}

/// A photograph as read from its file.
#[derive(Clone, Debug, PartialEq)]
pub struct LoadedImage {
    /// Linear radiance, coverage-weighted on black: straight (PNG) alpha has been multiplied in, EXR is taken as stored.
    pub image: Image,
    /// Coverage in `[0, 1]`, one value per pixel, if the file has alpha.
    pub alpha: Option<Vec<f32>>,
    /// In integer formats, pixels with a color channel at the highest storable value and an alpha above 0: that channel is a lower
    /// bound. In float formats, the repaired pixels.
    pub saturated: Vec<bool>,
    /// Number of pixels that had a NaN or infinite value and were set to 0.
    pub repaired: usize,
    /// Whether the file held linear floats (EXR, HDR) and not 8- or 16-bit integers.
    pub is_float: bool,
}

/// A mask as read from its file.
#[derive(Clone, Debug, PartialEq)]
pub struct LoadedMask {
    /// Coverage of each pixel.
    pub mask: Mask,
    /// The stored value, as a share of the highest storable one, that means full coverage: 1, or less in masks stored as 0 and 1
    /// or 0 and 127 of 255, whose coverage is scaled.
    pub full: f32,
}

/// File formats that can be read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Format {
    Png,
    Jpeg,
    Exr,
    Hdr,
}

impl Format {
    fn from_bytes(bytes: &[u8]) -> Option<Self> {
        let magic: [(&[u8], Self); 4] = [
            (b"\x89PNG\r\n\x1a\n", Self::Png),
            (b"\xff\xd8\xff", Self::Jpeg),
            (b"\x76\x2f\x31\x01", Self::Exr),
            (b"#?", Self::Hdr),
        ];
        magic.iter().find(|(start, _)| bytes.starts_with(start)).map(|&(_, format)| format)
    }

    fn from_extension(path: &Path) -> Option<Self> {
        let extension = path.extension()?.to_str()?.to_ascii_lowercase();
        match extension.as_str() {
            "png" => Some(Self::Png),
            "jpg" | "jpeg" => Some(Self::Jpeg),
            "exr" => Some(Self::Exr),
            "hdr" | "pic" => Some(Self::Hdr),
            _ => None,
        }
    }

    fn name(self) -> &'static str {
        match self {
            Self::Png => "a PNG",
            Self::Jpeg => "a JPEG",
            Self::Exr => "an OpenEXR",
            Self::Hdr => "a Radiance HDR",
        }
    }
}

/// Extensions of image files that can be read, in the order in which they are tried.
pub const IMAGE_EXTENSIONS: [&str; 5] = ["exr", "png", "jpg", "jpeg", "hdr"];

/// A decoded file before its values are interpreted.
enum Decoded {
    Integers(DynamicImage),
    Floats { width: u32, height: u32, color: Vec<Vec3>, alpha: Option<Vec<f32>> },
}

/// Reads a photograph as linear radiance: PNG (8 and 16 bit; gray, RGB, palette, with and without alpha), JPEG, EXR (half, float, uint; R, G, B or Y, optional A) or Radiance HDR.
///
/// NaN and infinite pixels are set to 0, counted in [`LoadedImage::repaired`] and marked as saturated.
///
/// # Errors
/// [`Error::Input`] if the file is missing, empty, damaged, truncated, not in the format that its name says, or has no finite
/// pixel; [`Error::Usage`] for an impossible `gamma`.
pub fn read_image(path: impl AsRef<Path>, gamma: Gamma, orientation: Orientation) -> Result<LoadedImage> {
    gamma.check()?;
    let path = path.as_ref();
    match decode(path, orientation)? {
        Decoded::Integers(image) => Ok(from_integers(&image, gamma)),
        Decoded::Floats { width, height, color, alpha } => {
            let loaded = from_floats(Image { width, height, pixels: color }, alpha);
            if loaded.repaired == loaded.image.pixels.len() {
                let problem = "every pixel is NaN or infinite";
                return Err(Error::input(path, "", problem, "Render or convert the image again."));
            }
            Ok(loaded)
        }
    }
}

/// Reads a mask: the stored luma (not linearized) divided by the highest storable value. Alpha is used instead if it varies while
/// the colors do not. In float formats the mask is alpha, if any, else luminance, clamped to `[0, 1]`.
///
/// # Errors
/// Those of [`read_image`]; also if an EXR or HDR mask has NaN or infinite values.
pub fn read_mask(path: impl AsRef<Path>, orientation: Orientation) -> Result<LoadedMask> {
    let path = path.as_ref();
    let (width, height, coverage) = match decode(path, orientation)? {
        Decoded::Integers(image) => {
            let loaded = from_integers_straight(&image, Gamma::Linear);
            (image.width(), image.height(), mask_from_straight(&loaded.0, loaded.1.as_deref()))
        }
        Decoded::Floats { width, height, color, alpha } => {
            (width, height, alpha.unwrap_or_else(|| color.into_iter().map(luma).collect()))
        }
    };
    if let Some(i) = coverage.iter().position(|c| !c.is_finite()) {
        let place = format!("pixel ({}, {})", i as u32 % width, i as u32 / width);
        return Err(Error::input(path, place, "the mask is NaN or infinite", "Write the mask again."));
    }
    let coverage = coverage.into_iter().map(|c| c.clamp(0.0, 1.0)).collect();
    Ok(LoadedMask { mask: Mask { width, height, coverage }, full: 1.0 })
}

fn decode(path: &Path, orientation: Orientation) -> Result<Decoded> {
    let bytes = read_bytes(path, missing_file_help)?;
    let format = Format::from_bytes(&bytes).ok_or_else(|| unknown_format(path, &bytes))?;
    if let Some(named) = Format::from_extension(path)
        && named != format
    {
        let problem = format!("the file is named as {} but holds {}", named.name(), format.name());
        return Err(Error::input(path, "", problem, "Rename it, or convert it to what its name says."));
    }
    match format {
        Format::Exr => decode_exr_picture(path, &bytes),
        Format::Png => decode_with_image(path, &bytes, ImageFormat::Png, orientation),
        Format::Jpeg => decode_jpeg(path, &bytes, orientation),
        Format::Hdr => decode_with_image(path, &bytes, ImageFormat::Hdr, orientation),
    }
}

fn unknown_format(path: &Path, bytes: &[u8]) -> Error {
    if bytes.starts_with(b"version https://git-lfs") {
        let help = "Fetch the files themselves with `git lfs pull`.";
        return Error::input(path, "", "this is a Git LFS pointer, not an image", help);
    }
    let problem = "the contents are neither PNG, JPEG, OpenEXR nor Radiance HDR";
    Error::input(path, "", problem, "Convert the image to one of these, or copy it again.")
}

fn decode_exr_picture(path: &Path, bytes: &[u8]) -> Result<Decoded> {
    let layers = crate::codec::exr::decode_exr(path, bytes)?;
    let Some((names, alpha)) = layers.picture() else {
        let names: Vec<&str> = layers.channels.keys().map(String::as_str).collect();
        let problem = format!("no channels R, G, B or Y; the file has {}", names.join(", "));
        return Err(Error::input(path, "", problem, "Write the picture as channels R, G, B."));
    };
    let [r, g, b] = names.map(|name| &layers.channels[name]);
    let color = (0..r.len()).map(|i| Vec3::new(r[i], g[i], b[i])).collect();
    let alpha = alpha.map(|name| layers.channels[name].clone());
    Ok(Decoded::Floats { width: layers.width, height: layers.height, color, alpha })
}

/// The JPEG decoder fills missing data at the end of a file with gray, so the end marker is checked first.
fn decode_jpeg(path: &Path, bytes: &[u8], orientation: Orientation) -> Result<Decoded> {
    let find = |from: usize, marker: [u8; 2]| {
        bytes[from..].windows(2).position(|pair| pair == marker).map(|i| from + i)
    };
    let end = jpeg_scan_start(bytes).and_then(|scan| find(scan, [0xff, 0xd9]));
    if end.is_none() {
        return Err(damaged(path, "a JPEG", "its end is missing"));
    }
    decode_with_image(path, bytes, ImageFormat::Jpeg, orientation)
}

/// Position of the first scan of a JPEG: after the header segments, which may contain a thumbnail with its own end marker.
fn jpeg_scan_start(bytes: &[u8]) -> Option<usize> {
    let mut at = 2;
    loop {
        let &[0xff, marker] = bytes.get(at..at + 2)?.first_chunk::<2>()? else { return None };
        match marker {
            0xda => return Some(at),
            // Fill bytes may precede a marker.
            0xff => at += 1,
            _ => at += 2 + usize::from(u16::from_be_bytes(*bytes.get(at + 2..at + 4)?.first_chunk()?)),
        }
    }
}

fn damaged(path: &Path, what: &str, why: &str) -> Error {
    let problem = format!("{what} that is damaged or truncated: {why}");
    Error::input(path, "", problem, "Copy or convert the file again.")
}

fn decode_with_image(
    path: &Path,
    bytes: &[u8],
    format: ImageFormat,
    orientation: Orientation,
) -> Result<Decoded> {
    let what = Format::from_bytes(bytes).map_or("an image", Format::name);
    let wrong = |error: image::ImageError| damaged(path, what, &error.to_string());
    let mut decoder = ImageReader::with_format(Cursor::new(bytes), format).into_decoder().map_err(wrong)?;
    let (width, height) = decoder.dimensions();
    if width == 0 || height == 0 {
        return Err(damaged(path, what, &format!("its size is {width}×{height}")));
    }
    if decoder.total_bytes() > crate::codec::exr::MAX_DECODED_BYTES as u64 {
        return Err(damaged(path, what, &format!("its header declares {width}×{height} pixels")));
    }
    // With a damaged EXIF block, pixels stay as they are stored.
    let exif = decoder.orientation().unwrap_or(ExifOrientation::NoTransforms);
    let mut decoded = DynamicImage::from_decoder(decoder).map_err(wrong)?;
    if orientation == Orientation::Upright {
        decoded.apply_orientation(exif);
    }
    Ok(match decoded {
        DynamicImage::ImageRgb32F(floats) => Decoded::Floats {
            width: floats.width(),
            height: floats.height(),
            color: floats.pixels().map(|pixel| Vec3::from(pixel.0)).collect(),
            alpha: None,
        },
        integers => Decoded::Integers(integers),
    })
}

/// Linear straight color, alpha, and the flags of pixels with a channel at the top of its range.
type Straight = (Vec<Vec3>, Option<Vec<f32>>, Vec<bool>);

fn from_integers_straight(image: &DynamicImage, gamma: Gamma) -> Straight {
    match image {
        DynamicImage::ImageLuma8(i) => straight(i.as_raw(), 1, 255, gamma),
        DynamicImage::ImageLumaA8(i) => straight(i.as_raw(), 2, 255, gamma),
        DynamicImage::ImageRgb8(i) => straight(i.as_raw(), 3, 255, gamma),
        DynamicImage::ImageRgba8(i) => straight(i.as_raw(), 4, 255, gamma),
        DynamicImage::ImageLuma16(i) => straight(i.as_raw(), 1, 65535, gamma),
        DynamicImage::ImageLumaA16(i) => straight(i.as_raw(), 2, 65535, gamma),
        DynamicImage::ImageRgb16(i) => straight(i.as_raw(), 3, 65535, gamma),
        other => straight(other.to_rgba16().as_raw(), 4, 65535, gamma),
    }
}

fn straight<T: Copy + Into<u32>>(samples: &[T], channels: usize, top: u32, gamma: Gamma) -> Straight {
    let curve: Vec<f32> = (0..=top).map(|stored| gamma.decode(stored as f32 / top as f32)).collect();
    let (colors, has_alpha) = (if channels < 3 { 1 } else { 3 }, channels.is_multiple_of(2));
    let pixels = samples.len() / channels;
    let (mut color, mut saturated) = (Vec::with_capacity(pixels), Vec::with_capacity(pixels));
    let mut alpha = Vec::with_capacity(if has_alpha { pixels } else { 0 });
    for pixel in samples.chunks_exact(channels) {
        let value = |i: usize| curve[pixel[i].into() as usize];
        color.push(if colors == 1 { Vec3::splat(value(0)) } else { Vec3::new(value(0), value(1), value(2)) });
        let coverage = if has_alpha { pixel[colors].into() } else { top };
        if has_alpha {
            alpha.push(coverage as f32 / top as f32);
        }
        saturated.push(coverage > 0 && pixel[..colors].iter().any(|&stored| stored.into() == top));
    }
    (color, has_alpha.then_some(alpha), saturated)
}

fn from_integers(image: &DynamicImage, gamma: Gamma) -> LoadedImage {
    let (mut pixels, alpha, saturated) = from_integers_straight(image, gamma);
    if let Some(alpha) = &alpha {
        pixels.iter_mut().zip(alpha).for_each(|(pixel, &coverage)| *pixel *= coverage);
    }
    let image = Image { width: image.width(), height: image.height(), pixels };
    LoadedImage { image, alpha, saturated, repaired: 0, is_float: false }
}

fn from_floats(mut image: Image, mut alpha: Option<Vec<f32>>) -> LoadedImage {
    let is_broken = |i: usize, pixel: &Vec3| {
        !pixel.is_finite() || alpha.as_ref().is_some_and(|alpha| !alpha[i].is_finite())
    };
    let broken: Vec<bool> = image.pixels.iter().enumerate().map(|(i, pixel)| is_broken(i, pixel)).collect();
    for (i, _) in broken.iter().enumerate().filter(|&(_, &broken)| broken) {
        image.pixels[i] = Vec3::ZERO;
        if let Some(alpha) = &mut alpha {
            // A pixel whose color is not finite is still covered.
            alpha[i] = if alpha[i].is_finite() { alpha[i] } else { 0.0 };
        }
    }
    let alpha = alpha.map(|alpha| alpha.into_iter().map(|a| a.clamp(0.0, 1.0)).collect());
    let repaired = broken.iter().filter(|&&broken| broken).count();
    LoadedImage { image, alpha, saturated: broken, repaired, is_float: true }
}

fn mask_from_straight(color: &[Vec3], alpha: Option<&[f32]>) -> Vec<f32> {
    let varies = |alpha: &[f32]| alpha.iter().any(|&a| a != alpha[0]);
    let flat = color.iter().all(|c| *c == color[0]);
    match alpha {
        Some(alpha) if flat && varies(alpha) => alpha.to_vec(),
        // A fully transparent pixel is not covered, whatever its color.
        Some(alpha) => color.iter().zip(alpha).map(|(&c, &a)| luma(c) * a).collect(),
        None => color.iter().map(|&c| luma(c)).collect(),
    }
}

/// Rec. 709 luma; exactly the value itself for grays.
fn luma(color: Vec3) -> f32 {
    if color.x == color.y && color.y == color.z { color.x } else { luminance(color) }
}

#[cfg(test)]
mod tests;
