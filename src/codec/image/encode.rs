//! Pictures as the bytes of a file, and back.

use crate::error::{Error, Result};
use image::codecs::jpeg::JpegEncoder;
use image::codecs::png::PngEncoder;
use image::{DynamicImage, ExtendedColorType, ImageEncoder, RgbImage};

/// Kinds of pixels of [`encode_png`], all with 8 bits a channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum PngPixels {
    /// One channel.
    Gray,
    /// Three channels.
    Rgb,
    /// Three channels and alpha.
    Rgba,
}

impl PngPixels {
    fn color_type(self) -> ExtendedColorType {
        match self {
            Self::Gray => ExtendedColorType::L8,
            Self::Rgb => ExtendedColorType::Rgb8,
            Self::Rgba => ExtendedColorType::Rgba8,
        }
    }
}

/// A picture as a JPEG of this quality, 1 to 100.
///
/// # Errors
/// [`Error::Run`] for a picture without pixels.
pub fn encode_jpeg(picture: &RgbImage, quality: u8) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    JpegEncoder::new_with_quality(&mut bytes, quality).encode_image(picture).map_err(not_encoded)?;
    Ok(bytes)
}

/// The samples of a picture of `size` (width, height), row by row, as a PNG.
///
/// # Errors
/// [`Error::Run`] for a picture without pixels.
///
/// # Panics
/// If `samples` are not as many as the picture has.
pub fn encode_png(samples: &[u8], [width, height]: [u32; 2], pixels: PngPixels) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    PngEncoder::new(&mut bytes)
        .write_image(samples, width, height, pixels.color_type())
        .map_err(not_encoded)?;
    Ok(bytes)
}

/// The picture in the bytes of a PNG, JPEG or GIF file.
///
/// # Errors
/// [`Error::Run`] if they are of none of these, or damaged.
pub(crate) fn decode(bytes: &[u8]) -> Result<DynamicImage> {
    image::load_from_memory(bytes).map_err(|error| Error::run("a picture", error.to_string()))
}

fn not_encoded(error: image::ImageError) -> Error {
    Error::run("a picture", format!("it cannot be encoded: {error}"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Rgb;

    #[test]
    fn what_is_encoded_is_decoded_again() {
        let picture = RgbImage::from_pixel(6, 4, Rgb([200, 40, 10]));
        let png = encode_png(picture.as_raw(), [6, 4], PngPixels::Rgb).unwrap();
        assert_eq!(decode(&png).unwrap().to_rgb8(), picture);
        let gray = encode_png(&[9; 6], [3, 2], PngPixels::Gray).unwrap();
        assert_eq!(decode(&gray).unwrap().to_luma8().as_raw(), &[9; 6]);
        let clear = encode_png(&[1, 2, 3, 0], [1, 1], PngPixels::Rgba).unwrap();
        assert_eq!(decode(&clear).unwrap().to_rgba8().as_raw(), &[1, 2, 3, 0]);
        let jpeg = decode(&encode_jpeg(&picture, 90).unwrap()).unwrap().to_rgb8();
        assert!(jpeg.as_raw().iter().zip(picture.as_raw()).all(|(a, b)| a.abs_diff(*b) < 6));
    }

    #[test]
    fn nothing_is_no_picture() {
        assert!(encode_jpeg(&RgbImage::new(0, 4), 90).is_err());
        assert!(encode_png(&[], [0, 4], PngPixels::Gray).is_err());
        assert!(decode(b"no picture").is_err());
    }
}
