//! Decoded samples, as compact as the file has them.

use crate::codec::image::header::ImageHeader;

/// Samples of an image, rows from the top down, the samples of a pixel side by side.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum ImageSamples {
    /// Integers of 8 bits, with straight alpha: colors are not multiplied by it.
    Bytes8(Vec<u8>),
    /// Integers of 16 bits, with straight alpha.
    Words16(Vec<u16>),
    /// Linear floats, with alpha multiplied into the colors.
    Floats(Vec<f32>),
}

impl ImageSamples {
    /// Number of samples.
    pub fn count(&self) -> usize {
        match self {
            Self::Bytes8(samples) => samples.len(),
            Self::Words16(samples) => samples.len(),
            Self::Floats(samples) => samples.len(),
        }
    }
}

/// An image whose samples are as the file has them.
#[derive(Clone, Debug, PartialEq)]
pub struct Decoded {
    /// What the header says; its size is as stored.
    pub header: ImageHeader,
    /// Width in pixels, after turning.
    pub width: u32,
    /// Height in pixels, after turning.
    pub height: u32,
    /// `width * height` times `header.channels` samples.
    pub samples: ImageSamples,
}

impl Decoded {
    /// Samples per pixel: 1 (gray), 2 (gray and alpha), 3 (RGB) or 4 (RGB and alpha).
    pub fn channels(&self) -> usize {
        self.header.channels
    }

    /// Turned as EXIF asks.
    pub(super) fn upright(self) -> Self {
        let (size, channels, exif) = ([self.width, self.height], self.channels(), self.header.exif);
        let samples = match self.samples {
            ImageSamples::Bytes8(samples) => ImageSamples::Bytes8(turned(samples, size, channels, exif)),
            ImageSamples::Words16(samples) => ImageSamples::Words16(turned(samples, size, channels, exif)),
            ImageSamples::Floats(samples) => ImageSamples::Floats(turned(samples, size, channels, exif)),
        };
        let [width, height] = if self.header.is_turned() { [size[1], size[0]] } else { size };
        Self { header: self.header, width, height, samples }
    }
}

/// Samples of an image of `width` × `height` pixels with `channels` samples each, turned by an EXIF orientation (1 to 8).
fn turned<T: Copy>(samples: Vec<T>, [width, height]: [u32; 2], channels: usize, exif: u8) -> Vec<T> {
    if !(2..=8).contains(&exif) {
        return samples;
    }
    let (w, h) = (width as usize, height as usize);
    let (columns, rows) = if exif >= 5 { (h, w) } else { (w, h) };
    let mut out = Vec::with_capacity(samples.len());
    for v in 0..rows {
        for u in 0..columns {
            let (x, y) = match exif {
                2 => (w - 1 - u, v),
                3 => (w - 1 - u, h - 1 - v),
                4 => (u, h - 1 - v),
                5 => (v, u),
                6 => (v, h - 1 - u),
                7 => (w - 1 - v, h - 1 - u),
                _ => (w - 1 - v, u),
            };
            out.extend_from_slice(&samples[(y * w + x) * channels..][..channels]);
        }
    }
    out
}
