//! The photograph of a view while it is read: its file's samples if every pixel of the view is one of the file, else linear light.

use crate::codec::image::{
    Decoded, Gamma, ImageSamples, LoadedImage, Orientation, Repairs, decode_photograph, linear_image,
};
use crate::dataset::straighten::Straightening;
use crate::error::Result;
use crate::view::raster::any_downscaled;
use crate::view::stored::{Curve, IntegerSamples};
use crate::view::{Mask, Photograph, PixelWindow};
use glam::Vec3;
use std::fmt;
use std::path::Path;
use std::sync::OnceLock;

/// Tables from stored integers to linear light, made once for all photographs of a data set.
pub(super) struct Curves {
    gamma: Gamma,
    bytes: OnceLock<Curve>,
    words: OnceLock<Curve>,
}

/// Without the tables, which may be made or not.
impl fmt::Debug for Curves {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Curves").field("gamma", &self.gamma).finish_non_exhaustive()
    }
}

impl Curves {
    pub fn new(gamma: Gamma) -> Self {
        Self { gamma, bytes: OnceLock::new(), words: OnceLock::new() }
    }

    pub fn gamma(&self) -> Gamma {
        self.gamma
    }

    /// That of integers with so many values.
    pub fn of(&self, levels: usize) -> Option<&Curve> {
        match levels {
            256 => Some(self.bytes()),
            65_536 => Some(self.words()),
            _ => None,
        }
    }

    fn bytes(&self) -> &Curve {
        self.bytes.get_or_init(|| Curve::new(self.gamma.curve(255)))
    }

    fn words(&self) -> &Curve {
        self.words.get_or_init(|| Curve::new(self.gamma.curve(65_535)))
    }
}

/// A photograph that is being read.
pub(super) enum DecodedPhotograph {
    /// Integers that become the pixels of the view one by one.
    Stored(Decoded, Repairs),
    /// Linear light.
    Linear {
        loaded: LoadedImage,
        /// Whether pixels of the view are means of these.
        is_resampled: bool,
    },
}

impl DecodedPhotograph {
    /// Reads a photograph, of which pixels of the view are means if it `is_resampled`.
    pub fn read(path: &Path, gamma: Gamma, is_resampled: bool) -> Result<Self> {
        gamma.check()?;
        let (decoded, repairs) = decode_photograph(path, Orientation::AsStored)?;
        if is_resampled || decoded.header.is_float {
            return Ok(Self::Linear { loaded: linear_image(&decoded, repairs, gamma), is_resampled });
        }
        Ok(Self::Stored(decoded, repairs))
    }

    pub fn size(&self) -> [u32; 2] {
        match self {
            Self::Stored(decoded, _) => [decoded.width, decoded.height],
            Self::Linear { loaded, .. } => [loaded.image.width, loaded.image.height],
        }
    }

    pub fn repairs(&self) -> &Repairs {
        match self {
            Self::Stored(_, repairs) => repairs,
            Self::Linear { loaded, .. } => &loaded.repairs,
        }
    }

    pub fn has_alpha(&self) -> bool {
        match self {
            Self::Stored(decoded, _) => decoded.header.has_alpha(),
            Self::Linear { loaded, .. } => loaded.alpha.is_some(),
        }
    }

    /// Coverage in `[0, 1]`, if the file has alpha.
    pub fn alpha(&self) -> Option<Vec<f32>> {
        match self {
            Self::Linear { loaded, .. } => loaded.alpha.clone(),
            Self::Stored(decoded, _) if !decoded.header.has_alpha() => None,
            Self::Stored(decoded, _) => {
                let channels = decoded.channels();
                let last = channels - 1..;
                Some(match &decoded.samples {
                    ImageSamples::Bytes8(bytes) => {
                        bytes[last].iter().step_by(channels).map(|&v| f32::from(v) / 255.0).collect()
                    }
                    ImageSamples::Words16(words) => {
                        words[last].iter().step_by(channels).map(|&v| f32::from(v) / 65_535.0).collect()
                    }
                    ImageSamples::Floats(floats) => floats[last].iter().step_by(channels).copied().collect(),
                })
            }
        }
    }

    /// Resamples to the camera without distortion.
    pub fn straighten(&mut self, way: &Straightening) {
        if let Self::Linear { loaded, .. } = self {
            loaded.image = way.image(&loaded.image);
            loaded.saturated = way.flags(&loaded.saturated);
        }
    }

    /// Makes the picture black where its mask is empty, so that it is on black like all others; returns whether anything changed.
    ///
    /// A picture with alpha is on black already. A float image is often a rendering on black, whose light at the rim reaches beyond a
    /// mask of 8 bits; that is left as it is.
    pub fn blacken(&mut self, mask: &Mask) -> bool {
        if self.has_alpha() {
            return false;
        }
        match self {
            Self::Stored(decoded, _) => {
                let channels = decoded.channels();
                match &mut decoded.samples {
                    ImageSamples::Bytes8(bytes) => blacken_samples(bytes, channels, mask),
                    ImageSamples::Words16(words) => blacken_samples(words, channels, mask),
                    ImageSamples::Floats(floats) => blacken_samples(floats, channels, mask),
                }
            }
            Self::Linear { loaded, .. } => shows_background(loaded, mask) && blacken_light(loaded, mask),
        }
    }

    /// The photograph as it is kept: cropped to its mask, and rounded to half floats if its pixels are means anyway.
    pub fn keep(self, downscale: u32, mask: Option<&Mask>, curves: &Curves) -> Result<Photograph> {
        let [width, height] = self.size().map(|side| side / downscale);
        let window = mask.map_or(PixelWindow::whole(width, height), PixelWindow::of_mask);
        match self {
            Self::Stored(decoded, _) => {
                let (size, channels) = ([decoded.width, decoded.height], decoded.channels());
                let (samples, curve) = match &decoded.samples {
                    ImageSamples::Bytes8(bytes) => (IntegerSamples::Bytes(bytes), curves.bytes()),
                    ImageSamples::Words16(words) => (IntegerSamples::Words(words), curves.words()),
                    ImageSamples::Floats(_) => unreachable!("floats are read as linear light"),
                };
                Ok(Photograph::of_integers(size, samples, channels, curve, window))
            }
            Self::Linear { loaded: LoadedImage { mut image, mut saturated, .. }, is_resampled } => {
                if downscale > 1 {
                    saturated = any_downscaled(&saturated, image.width, image.height, downscale);
                    image = image.downscaled(downscale);
                }
                Photograph::new(&image, &saturated, window, is_resampled)
            }
        }
    }
}

fn blacken_samples<T: Copy + Default + PartialEq>(samples: &mut [T], channels: usize, mask: &Mask) -> bool {
    let mut changed = false;
    let pixels = samples.chunks_exact_mut(channels).zip(&mask.coverage);
    for (pixel, _) in pixels.filter(|(_, coverage)| **coverage == 0.0) {
        changed |= pixel.iter().any(|sample| *sample != T::default());
        pixel.fill(T::default());
    }
    changed
}

/// Whether a picture without alpha may show more than the object.
fn shows_background(loaded: &LoadedImage, mask: &Mask) -> bool {
    const RIM_SHARE: f32 = 0.05;
    let outside = || loaded.image.pixels.iter().zip(&mask.coverage).filter(|(_, coverage)| **coverage == 0.0);
    let lit = outside().filter(|(pixel, _)| **pixel != Vec3::ZERO).count();
    !loaded.is_float || lit as f32 > RIM_SHARE * outside().count() as f32
}

fn blacken_light(loaded: &mut LoadedImage, mask: &Mask) -> bool {
    let mut changed = false;
    for (i, _) in mask.coverage.iter().enumerate().filter(|(_, coverage)| **coverage == 0.0) {
        changed |= loaded.image.pixels[i] != Vec3::ZERO;
        loaded.image.pixels[i] = Vec3::ZERO;
        loaded.saturated[i] = false;
    }
    changed
}
