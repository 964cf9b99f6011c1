//! What the header of an image file says, and which sizes are read.

use crate::codec::exr::MAX_DECODED_BYTES;
use crate::codec::image::format::{Format, damaged};
use crate::error::{Error, Result};
use std::path::Path;

/// Pixels of the largest image that is read: 16 384 × 16 384.
const MOST_PIXELS: u64 = LONGEST_SIDE * LONGEST_SIDE;
const LONGEST_SIDE: u64 = 16_384;

/// What becomes of the EXIF orientation of a file, the number that says how the camera was held.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub enum Orientation {
    /// Pixels as they lie in the file, which is what COLMAP reads.
    AsStored,
    /// Pixels turned as the file asks, which is what viewers show.
    #[default]
    Upright,
}

/// What the header of an image file says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ImageHeader {
    /// The format.
    pub format: Format,
    /// Width in pixels, as stored.
    pub width: u32,
    /// Height in pixels, as stored.
    pub height: u32,
    /// Samples per pixel when decoded: 1 (gray), 2 (gray and alpha), 3 (RGB) or 4 (RGB and alpha).
    pub channels: usize,
    /// Bits per sample: 8, or 16, or 32 (of 32-bit floats; 16 with `is_float` are half floats). Fewer than 8 are decoded to 8.
    pub bits: u32,
    /// Whether samples are linear floats and not integers.
    pub is_float: bool,
    /// EXIF orientation, 1 to 8; 1 where the file says nothing.
    pub exif: u8,
}

impl ImageHeader {
    /// Whether there is an alpha channel.
    pub fn has_alpha(&self) -> bool {
        self.channels.is_multiple_of(2)
    }

    /// Whether turning the pixels upright swaps width and height.
    pub fn is_turned(&self) -> bool {
        self.exif >= 5
    }

    /// Width and height in pixels with this treatment of the EXIF orientation.
    pub fn size(&self, orientation: Orientation) -> [u32; 2] {
        match orientation {
            Orientation::Upright if self.is_turned() => [self.height, self.width],
            _ => [self.width, self.height],
        }
    }

    /// Bytes of the decoded samples.
    pub fn decoded_bytes(&self) -> u64 {
        let of_sample = if self.is_float { 4 } else { u64::from(self.bits / 8) };
        u64::from(self.width) * u64::from(self.height) * self.channels as u64 * of_sample
    }
}

/// Whether an image of this size is read.
pub(super) fn check_pixels(path: &Path, format: Format, [width, height]: [u32; 2]) -> Result<()> {
    if width == 0 || height == 0 {
        return Err(damaged(path, format, &format!("its size is {width}×{height}")));
    }
    if u64::from(width) * u64::from(height) > MOST_PIXELS {
        let problem = format!(
            "its header declares {width}×{height} pixels, more than {LONGEST_SIDE}×{LONGEST_SIDE}, the most that is read"
        );
        let help = "Reduce its size, e.g. with `magick FILE -resize 50% FILE`. If it is not that large, copy it again.";
        return Err(Error::input(path, "", problem, help));
    }
    Ok(())
}

/// Whether the pixels fit into memory, and a file of so many bytes can hold them.
pub(super) fn check_bytes(path: &Path, header: &ImageHeader, file_bytes: u64) -> Result<()> {
    let ImageHeader { format, width, height, .. } = *header;
    let decoded = header.decoded_bytes();
    // A JPEG is read as a whole, the others piece by piece.
    let held = if format == Format::Jpeg { decoded.max(file_bytes) } else { decoded };
    if held > MAX_DECODED_BYTES as u64 {
        let mib = |bytes: u64| bytes >> 20;
        let problem = format!(
            "{width}×{height} pixels in {} MiB, {} MiB when decoded, more than the {} MiB that are read",
            mib(file_bytes),
            mib(decoded),
            MAX_DECODED_BYTES >> 20
        );
        return Err(Error::input(path, "", problem, "Reduce its size, or save it with 8 or 16 bits."));
    }
    let pixels = u64::from(width) * u64::from(height);
    let least = match format {
        // The most that Deflate saves; up to 8 pixels in a byte.
        Format::Png => (pixels / 8).max(if header.bits == 16 { decoded } else { 0 }) / 1032,
        // A bit for each block of 8×8, at four pixels for one sample of color and more.
        Format::Jpeg => pixels / 1024,
        // The most that LZW saves.
        Format::Tiff => pixels / 8 / 4096,
        // The start of each row.
        Format::Hdr => 4 * u64::from(height),
        // WebP needs no more for a single color; the header of an EXR is checked with its channels.
        Format::Webp | Format::Exr => 0,
    };
    if file_bytes < least {
        let why =
            format!("its header declares {width}×{height} pixels, more than {file_bytes} bytes can hold");
        return Err(damaged(path, format, &why));
    }
    Ok(())
}
