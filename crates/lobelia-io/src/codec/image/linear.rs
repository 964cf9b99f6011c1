//! Decoded samples as linear radiance, with the repair of float pixels that are NaN, infinite,
//! absurdly bright or negative, and as masks: the coverage of each pixel, from gray values, labels
//! or alpha.

use crate::codec::image::format::{Format, ImageHeader, ImageSamples, Orientation};
use crate::codec::image::{Decoded, decode_samples};
use glam::Vec3;
use lobelia_geometry::{Error, Result, view::Image, view::Mask};
use lobelia_sg::color::{linear_from_srgb, luminance};
use serde::{Deserialize, Serialize};
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
    /// Linear radiance, coverage-weighted on black: straight (PNG) alpha has been multiplied in,
    /// EXR is taken as stored.
    pub image: Image,
    /// Coverage in `[0, 1]`, one value per pixel, if the file has alpha.
    pub alpha: Option<Vec<f32>>,
    /// In integer formats, pixels with a color channel at the highest storable value and an alpha
    /// above 0: that channel is a lower bound. In float formats, the repaired pixels.
    pub saturated: Vec<bool>,
    /// The repairs of float formats.
    pub repairs: Repairs,
    /// True if the file held linear floats (EXR, HDR, float TIFF) and not 8- or 16-bit integers.
    pub is_float: bool,
}

/// Reads a picture as linear radiance: PNG, JPEG, TIFF, WebP (8 and 16 bit; gray, RGB, palette,
/// with and without alpha), EXR (half, float, uint; R, G, B or Y, optional A), Radiance HDR or
/// float TIFF.
///
/// NaN, infinite and absurdly bright pixels are set to 0, counted in [`LoadedImage::repairs`] and
/// marked as saturated.
///
/// # Errors
/// [`Error::Input`] if the file is missing, empty, damaged, truncated, in a format that is not
/// read, too large, not in the format that its name says, has no finite pixel, or more than a few
/// absurdly bright ones; [`Error::Usage`] for an impossible `gamma`.
pub fn read_image(path: impl AsRef<Path>, gamma: Gamma, orientation: Orientation) -> Result<LoadedImage> {
    gamma.check()?;
    let (decoded, repairs) = repaired(path.as_ref(), orientation)?;
    Ok(linear_image(&decoded, repairs, gamma))
}

/// The samples of a photograph, repaired as [`read_image`] does; negative colors are set to 0.
///
/// # Errors
/// As for [`read_image`] for its file.
pub fn decode_photograph(path: impl AsRef<Path>, orientation: Orientation) -> Result<(Decoded, Repairs)> {
    let (mut decoded, repairs) = repaired(path.as_ref(), orientation)?;
    if let (ImageSamples::Floats(samples), true) = (&mut decoded.samples, repairs.negative > 0) {
        samples.iter_mut().for_each(|sample| *sample = sample.max(0.0));
    }
    Ok((decoded, repairs))
}

/// Samples as linear light.
pub fn linear_image(decoded: &Decoded, repairs: Repairs, gamma: Gamma) -> LoadedImage {
    let header @ ImageHeader { width, height, .. } = decoded.header;
    let count = width as usize * height as usize;
    let mut loaded = LoadedImage {
        image: Image { width, height, pixels: Vec::with_capacity(count) },
        alpha: header.has_alpha().then(|| Vec::with_capacity(count)),
        saturated: Vec::with_capacity(count),
        repairs,
        is_float: header.is_float,
    };
    match &decoded.samples {
        ImageSamples::Bytes8(samples) => loaded.add_integers(samples, header.channels, &gamma.curve(255)),
        ImageSamples::Words16(samples) => loaded.add_integers(samples, header.channels, &gamma.curve(65_535)),
        ImageSamples::Floats(samples) => {
            for pixel in samples.chunks_exact(header.channels) {
                let color = if pixel.len() < 3 { Vec3::splat(pixel[0]) } else { Vec3::from_slice(pixel) };
                loaded.image.pixels.push(color);
                loaded.alpha.iter_mut().for_each(|alpha| alpha.extend(pixel.last()));
            }
            loaded.saturated.resize(count, false);
            loaded.repairs.pixels.iter().for_each(|&i| loaded.saturated[i as usize] = true);
        }
    }
    loaded
}

impl LoadedImage {
    /// Adds linear premultiplied colors, alpha, and the flags of pixels with a channel at the top
    /// of its range.
    fn add_integers<T: Copy + Into<u32>>(&mut self, samples: &[T], channels: usize, curve: &[f32]) {
        let top = curve.len() as u32 - 1;
        for pixel in samples.chunks_exact(channels) {
            let value = |i: usize| curve[pixel[i].into() as usize];
            let (colors, mut color) = match channels {
                1 | 2 => (1, Vec3::splat(value(0))),
                _ => (3, Vec3::new(value(0), value(1), value(2))),
            };
            let mut is_covered = true;
            if let Some(alpha) = &mut self.alpha {
                let stored = pixel[colors].into();
                let coverage = stored as f32 / top as f32;
                is_covered = stored > 0;
                color *= coverage;
                alpha.push(coverage);
            }
            self.image.pixels.push(color);
            self.saturated.push(is_covered && pixel[..colors].iter().any(|&stored| stored.into() == top));
        }
    }
}

/// The greatest magnitude of a float sample that is taken as radiance. Half floats end at 65 504.
pub const BRIGHTEST: f32 = 1.0e6;

/// The share of absurdly bright pixels from which on an image is refused: they are no stray ones.
const MOST_TOO_BRIGHT: f64 = 0.01;

/// The pixels of a float image that no photograph has.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Repairs {
    /// Number of pixels that had a NaN or infinite value and were set to 0.
    pub not_finite: usize,
    /// Number of pixels with a value above 10⁶ (or below its negative), which were set to 0.
    pub too_bright: usize,
    /// Number of pixels with a negative color that is neither.
    pub negative: usize,
    /// Indices of the pixels that were set to 0, in ascending order.
    pub pixels: Vec<u32>,
}

/// Reads the samples of an image, and sets pixels of floats to 0 that are NaN, infinite or absurdly
/// bright; clamps alpha to `[0, 1]`. A pixel whose color is not finite is still covered. Integers
/// have nothing to repair.
fn repaired(path: &Path, orientation: Orientation) -> Result<(Decoded, Repairs)> {
    let mut decoded = decode_samples(path, orientation)?;
    let (channels, mut repairs) = (decoded.header.channels, Repairs::default());
    let ImageSamples::Floats(samples) = &mut decoded.samples else { return Ok((decoded, repairs)) };
    for (i, pixel) in samples.chunks_exact_mut(channels).enumerate() {
        let (color, alpha) = pixel.split_at_mut(if channels < 3 { 1 } else { 3 });
        let is_finite = color.iter().chain(&*alpha).all(|sample| sample.is_finite());
        let is_bright = color.iter().any(|c| c.abs() > BRIGHTEST);
        if !is_finite || is_bright {
            *(if is_finite { &mut repairs.too_bright } else { &mut repairs.not_finite }) += 1;
            repairs.pixels.push(i as u32);
            color.fill(0.0);
        }
        repairs.negative += usize::from(color.iter().any(|&c| c < 0.0));
        for a in alpha {
            *a = if a.is_finite() { a.clamp(0.0, 1.0) } else { 0.0 };
        }
    }
    let (pixels, too_bright) = (samples.len() / channels, repairs.too_bright);
    if repairs.not_finite == pixels {
        let problem = "every pixel is NaN or infinite";
        return Err(Error::input(path, "", problem, "Render or convert the image again."));
    }
    if too_bright as f64 > MOST_TOO_BRIGHT * pixels as f64 {
        let problem = format!("{too_bright} of {pixels} pixels are absurdly bright (above {BRIGHTEST})");
        let help = "Divide the values so that white is about 1, in all images by the same number, or replace this one.";
        return Err(Error::input(path, "", problem, help));
    }
    Ok((decoded, repairs))
}

/// The greatest gray value that is taken for the number of a label, not for coverage.
const GREATEST_LABEL: u32 = 31;
/// The greatest number of colors of a picture of labels, without black.
const MOST_LABELS: usize = 16;

/// Reads a mask: the stored luma (not linearized) divided by the highest storable value. If all
/// that is covered is of one lower value (1 or 127 of 255, or one color), that value is full
/// coverage, and others are scaled. A palette's colors count, not its indices. Alpha is the mask if
/// it varies while the colors do not, or if the colors are those of a cut-out photograph. In float
/// formats the mask is alpha, if any, else luminance, clamped to `[0, 1]`.
///
/// # Errors
/// [`Error::Input`] if the file is missing, not an image that is read, too large or damaged, if a
/// float mask has NaN or infinite values, or if the mask has labels of several objects.
pub fn read_mask(path: impl AsRef<Path>, orientation: Orientation) -> Result<Mask> {
    let path = path.as_ref();
    let decoded = decode_samples(path, orientation)?;
    let ImageHeader { format, width, height, channels, .. } = decoded.header;
    // Compression changes the values of a JPEG a little: they say neither labels nor that one value
    // is full.
    let is_exact = format != Format::Jpeg;
    let mut coverage = match &decoded.samples {
        ImageSamples::Bytes8(samples) => of_integers(path, samples, channels, 255, is_exact)?,
        ImageSamples::Words16(samples) => of_integers(path, samples, channels, 65_535, is_exact)?,
        ImageSamples::Floats(samples) => of_floats(path, samples, channels, width)?,
    };
    drop(decoded.samples);
    let greatest = coverage.iter().copied().fold(0.0, f32::max);
    let covered = coverage.iter().filter(|&&c| c > 0.0).count();
    let near = coverage.iter().filter(|&&c| c >= 0.9 * greatest).count();
    // Noise of a black JPEG is no object.
    let is_noise = !is_exact && greatest < 0.2;
    // Nearly all covered pixels are of one lower value.
    if covered > 0 && greatest < 1.0 && !is_noise && 2 * near >= covered {
        coverage.iter_mut().for_each(|c| *c = (*c / greatest).min(1.0));
    }
    Ok(Mask { width, height, coverage })
}

fn of_floats(path: &Path, samples: &[f32], channels: usize, width: u32) -> Result<Vec<f32>> {
    let value = |pixel: &[f32]| match channels {
        1 => pixel[0],
        3 => luma(Vec3::new(pixel[0], pixel[1], pixel[2])),
        _ => pixel[channels - 1],
    };
    let coverage: Vec<f32> = samples.chunks_exact(channels).map(value).collect();
    if let Some(i) = coverage.iter().position(|c| !c.is_finite()) {
        let place = format!("pixel ({}, {})", i as u32 % width, i as u32 / width);
        return Err(Error::input(path, place, "the mask is NaN or infinite", "Write the mask again."));
    }
    Ok(coverage.into_iter().map(|c| c.clamp(0.0, 1.0)).collect())
}

fn of_integers<T: Copy + Into<u32>>(
    path: &Path,
    samples: &[T],
    channels: usize,
    top: u32,
    is_exact: bool,
) -> Result<Vec<f32>> {
    let gray = channels < 3;
    let color = |pixel: &[T]| if gray { [pixel[0].into(); 3] } else { [0, 1, 2].map(|i| pixel[i].into()) };
    let pixels = || samples.chunks_exact(channels);
    let share = |value: u32| value as f32 / top as f32;
    let value = |pixel: &[T]| luma(Vec3::from_array(color(pixel).map(share)));
    let colors = colors_of(pixels().filter(|_| is_exact).map(color));
    if !channels.is_multiple_of(2) {
        check_labels(path, &colors)?;
        return Ok(pixels().map(value).collect());
    }
    let alpha = |pixel: &[T]| share(pixel[channels - 1].into());
    let is_flat = pixels().all(|pixel| color(pixel) == color(&samples[..channels]));
    let varies = pixels().any(|pixel| alpha(pixel) != alpha(&samples[..channels]));
    if varies && (is_flat || (is_colorful(&colors) && colors.len() > MOST_LABELS)) {
        return Ok(pixels().map(alpha).collect());
    }
    check_labels(path, &colors)?;
    // A fully transparent pixel is not covered, whatever its color.
    Ok(pixels().map(|pixel| value(pixel) * alpha(pixel)).collect())
}

/// The colors other than black, up to one more than labels have.
fn colors_of(pixels: impl Iterator<Item = [u32; 3]>) -> Vec<[u32; 3]> {
    let mut found: Vec<[u32; 3]> = Vec::new();
    let mut last = [0; 3];
    for color in pixels {
        if color != last && color != [0; 3] && !found.contains(&color) {
            found.push(color);
            if found.len() > MOST_LABELS {
                break;
            }
        }
        last = color;
    }
    found
}

fn is_colorful(colors: &[[u32; 3]]) -> bool {
    colors.iter().any(|[r, g, b]| r != g || g != b)
}

/// Refuses a few colors or low values, which are labels of several objects: they say nothing of
/// which one is meant.
fn check_labels(path: &Path, colors: &[[u32; 3]]) -> Result<()> {
    if !(2..=MOST_LABELS).contains(&colors.len()) {
        return Ok(());
    }
    let greatest = colors.iter().map(|color| color[0]).max().unwrap_or(0);
    let what = if is_colorful(colors) {
        format!("{} colors", colors.len())
    } else if greatest <= GREATEST_LABEL {
        format!("values from 0 to {greatest}")
    } else {
        return Ok(());
    };
    let help = "Write a mask that is white where the object is, black elsewhere.";
    Err(Error::input(path, "", format!("the mask has {what}: labels of several objects?"), help))
}

/// Rec. 709 luma; exactly the value itself for grays.
fn luma(color: Vec3) -> f32 {
    if color.x == color.y && color.y == color.z { color.x } else { luminance(color) }
}
