//! Masks: the coverage of each pixel, from gray values, labels or alpha.

use crate::codec::image::decode::decode_samples;
use crate::codec::image::format::Format;
use crate::codec::image::header::Orientation;
use crate::codec::image::samples::ImageSamples;
use crate::error::{Error, Result};
use crate::math::color::luminance;
use crate::view::Mask;
use glam::Vec3;
use std::path::Path;

/// A mask as read from its file.
#[derive(Clone, Debug, PartialEq)]
pub struct LoadedMask {
    /// Coverage of each pixel.
    pub mask: Mask,
    /// The stored value, as a share of the highest storable one, that means full coverage: 1, or less in masks stored as 0 and 1
    /// or 0 and 127 of 255, or in a dark color, whose coverage is scaled.
    pub full: f32,
}

/// The greatest gray value that is taken for the number of a label, not for coverage.
const GREATEST_LABEL: u32 = 31;
/// The greatest number of colors of a picture of labels, without black.
const MOST_LABELS: usize = 16;

/// Reads a mask: the stored luma (not linearized) divided by the highest storable value. If all that is covered is of one lower
/// value (1 or 127 of 255, or one color), that value is full coverage: see [`LoadedMask::full`]. A palette's colors count, not
/// its indices. Alpha is the mask if it varies while the colors do not, or if the colors are those of a cut-out photograph. In
/// float formats the mask is alpha, if any, else luminance, clamped to `[0, 1]`.
///
/// # Errors
/// [`Error::Input`] if the file is missing, not an image that is read, too large or damaged, if a float mask has NaN or infinite values, or
/// if the mask has labels of several objects.
pub fn read_mask(path: impl AsRef<Path>, orientation: Orientation) -> Result<LoadedMask> {
    let path = path.as_ref();
    let decoded = decode_samples(path, orientation)?;
    let (width, height, channels) = (decoded.width, decoded.height, decoded.channels());
    // Compression changes the values of a JPEG a little: they say neither labels nor that one value is full.
    let is_exact = decoded.header.format != Format::Jpeg;
    let coverage = match &decoded.samples {
        ImageSamples::Bytes8(samples) => of_integers(path, samples, channels, 255, is_exact)?,
        ImageSamples::Words16(samples) => of_integers(path, samples, channels, 65_535, is_exact)?,
        ImageSamples::Floats(samples) => of_floats(path, samples, channels, width)?,
    };
    drop(decoded.samples);
    let (coverage, full) = scaled_to_full(coverage, is_exact);
    Ok(LoadedMask { mask: Mask { width, height, coverage }, full })
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
    let colors = Colors::of(pixels().filter(|_| is_exact).map(color));
    if !channels.is_multiple_of(2) {
        colors.check_labels(path)?;
        return Ok(pixels().map(value).collect());
    }
    let alpha = |pixel: &[T]| share(pixel[channels - 1].into());
    let is_flat = pixels().all(|pixel| color(pixel) == color(&samples[..channels]));
    let varies = pixels().any(|pixel| alpha(pixel) != alpha(&samples[..channels]));
    if varies && (is_flat || (!gray && colors.is_picture())) {
        return Ok(pixels().map(alpha).collect());
    }
    colors.check_labels(path)?;
    // A fully transparent pixel is not covered, whatever its color.
    Ok(pixels().map(|pixel| value(pixel) * alpha(pixel)).collect())
}

/// The colors other than black, up to one more than labels have.
struct Colors(Vec<[u32; 3]>);

impl Colors {
    fn of(colors: impl Iterator<Item = [u32; 3]>) -> Self {
        let mut found: Vec<[u32; 3]> = Vec::new();
        let mut last = [0; 3];
        for color in colors {
            if color != last && color != [0; 3] && !found.contains(&color) {
                found.push(color);
                if found.len() > MOST_LABELS {
                    break;
                }
            }
            last = color;
        }
        Self(found)
    }

    fn is_colorful(&self) -> bool {
        self.0.iter().any(|[r, g, b]| r != g || g != b)
    }

    /// Whether all are shades of one color, as at the soft edges of an object that is painted in it.
    fn are_shades(&self) -> bool {
        let sum = |color: &[u32; 3]| u64::from(color[0]) + u64::from(color[1]) + u64::from(color[2]);
        let Some(brightest) = self.0.iter().max_by_key(|color| sum(color)) else { return false };
        let full = sum(brightest);
        // Rounded to whole values.
        let is_shade = |color: &[u32; 3]| {
            (0..3).all(|c| {
                let (own, scaled) = (u64::from(color[c]) * full, u64::from(brightest[c]) * sum(color));
                own.abs_diff(scaled) <= 2 * full
            })
        };
        self.is_colorful() && self.0.iter().all(is_shade)
    }

    /// Whether these are the colors of a picture and not of a few labels.
    fn is_picture(&self) -> bool {
        self.is_colorful() && self.0.len() > MOST_LABELS
    }

    /// Labels of several objects say nothing of which one is meant.
    fn check_labels(&self, path: &Path) -> Result<()> {
        let Self(colors) = self;
        let help = "Write a mask that is white where the object is, black elsewhere.";
        let refused = |problem: String| Err(Error::input(path, "", problem, help));
        if !(2..=MOST_LABELS).contains(&colors.len()) {
            return Ok(());
        }
        if self.are_shades() {
            return Ok(());
        }
        if self.is_colorful() {
            return refused(format!("the mask has {} colors: labels of several objects?", colors.len()));
        }
        let greatest = colors.iter().map(|color| color[0]).max().unwrap_or(0);
        if greatest <= GREATEST_LABEL {
            return refused(format!("the mask has values from 0 to {greatest}: labels of several objects?"));
        }
        Ok(())
    }
}

/// Coverage scaled so that the one value of which nearly all covered pixels are is 1, and that value.
fn scaled_to_full(coverage: Vec<f32>, is_exact: bool) -> (Vec<f32>, f32) {
    let greatest = coverage.iter().copied().fold(0.0, f32::max);
    let covered = coverage.iter().filter(|&&c| c > 0.0).count();
    let near = coverage.iter().filter(|&&c| c >= 0.9 * greatest).count();
    // Noise of a black JPEG is no object.
    let is_noise = !is_exact && greatest < 0.2;
    if covered == 0 || greatest >= 1.0 || is_noise || 2 * near < covered {
        return (coverage, 1.0);
    }
    (coverage.into_iter().map(|c| (c / greatest).min(1.0)).collect(), greatest)
}

/// Rec. 709 luma; exactly the value itself for grays.
fn luma(color: Vec3) -> f32 {
    if color.x == color.y && color.y == color.z { color.x } else { luminance(color) }
}
