//! Pixels of float images that no photograph has: NaN, infinite, absurdly bright, negative.

use crate::codec::image::samples::{Decoded, ImageSamples};
use crate::error::{Error, Result};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// The greatest magnitude of a float sample that is taken as radiance. Half floats end at 65 504.
pub(crate) const BRIGHTEST: f32 = 1.0e6;

/// The share of absurdly bright pixels from which on an image is refused: they are no stray ones.
const MOST_TOO_BRIGHT: f64 = 0.01;

/// The pixels of a float image that are not as they should be.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Repairs {
    /// Number of pixels that had a NaN or infinite value and were set to 0.
    pub not_finite: usize,
    /// Number of pixels with a value above 10⁶ (or below its negative), which were set to 0.
    pub too_bright: usize,
    /// Number of pixels with a negative color that is neither.
    pub negative: usize,
    /// Number of pixels with a color other than black, before the repair.
    pub lit: usize,
    /// Indices of the pixels that were set to 0, in ascending order.
    pub pixels: Vec<u32>,
}

impl Decoded {
    /// Sets pixels of a float image to 0 that are NaN, infinite or absurdly bright, and clamps alpha to `[0, 1]`. A pixel whose
    /// color is not finite is still covered. Integers have nothing to repair.
    pub fn repair(&mut self) -> Repairs {
        let channels = self.channels();
        let colors = if channels < 3 { 1 } else { 3 };
        let mut repairs = Repairs::default();
        let ImageSamples::Floats(samples) = &mut self.samples else { return repairs };
        for (i, pixel) in samples.chunks_exact_mut(channels).enumerate() {
            let (color, alpha) = pixel.split_at_mut(colors);
            repairs.lit += usize::from(color.iter().any(|&c| c != 0.0));
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
        repairs
    }

    /// Number of pixels.
    pub fn pixels(&self) -> usize {
        self.width as usize * self.height as usize
    }

    /// Sets negative colors of a float image to 0.
    pub(super) fn clamp_negative(&mut self) {
        if let ImageSamples::Floats(samples) = &mut self.samples {
            samples.iter_mut().for_each(|sample| *sample = sample.max(0.0));
        }
    }
}

impl Repairs {
    /// Whether anything is left of an image of so many pixels.
    pub(super) fn check(&self, path: &Path, pixels: usize) -> Result<()> {
        if self.not_finite == pixels {
            let problem = "every pixel is NaN or infinite";
            return Err(Error::input(path, "", problem, "Render or convert the image again."));
        }
        if self.too_bright as f64 > MOST_TOO_BRIGHT * pixels as f64 {
            let problem =
                format!("{} of {pixels} pixels are absurdly bright (above {BRIGHTEST})", self.too_bright);
            let help = "Divide the values so that white is about 1, in all images by the same number, or replace this one.";
            return Err(Error::input(path, "", problem, help));
        }
        Ok(())
    }

    /// [`Self::check`], and whether this can be a photograph.
    pub(super) fn check_photograph(&self, path: &Path, pixels: usize) -> Result<()> {
        self.check(path, pixels)?;
        if 2 * self.negative > self.lit {
            let problem = format!("{} of {} pixels that are not black are negative", self.negative, self.lit);
            let help = "Light is never negative: is this an image of normals or differences? Render or convert it again.";
            return Err(Error::input(path, "", problem, help));
        }
        Ok(())
    }
}
