//! 8-bit sRGB pictures and masks as PNG.

use crate::codec::file;
use crate::{Error, Result};
use image::{GrayImage, RgbImage, RgbaImage};
use png::{BitDepth, ColorType, Compression, Encoder, SrgbRenderingIntent};
use std::path::Path;

/// Writes an opaque sRGB picture.
///
/// # Errors
/// [`Error::Io`] if the file cannot be written, [`Error::Run`] for an empty picture.
pub fn write_rgb8(path: impl AsRef<Path>, picture: &RgbImage) -> Result<()> {
    write(path.as_ref(), picture.width(), picture.height(), ColorType::Rgb, picture.as_raw())
}

/// Writes an sRGB picture with straight alpha.
///
/// # Errors
/// [`Error::Io`] if the file cannot be written, [`Error::Run`] for an empty picture.
pub fn write_rgba8(path: impl AsRef<Path>, picture: &RgbaImage) -> Result<()> {
    write(path.as_ref(), picture.width(), picture.height(), ColorType::Rgba, picture.as_raw())
}

/// Writes a gray picture, such as a mask.
///
/// # Errors
/// [`Error::Io`] if the file cannot be written, [`Error::Run`] for an empty picture.
pub fn write_gray8(path: impl AsRef<Path>, picture: &GrayImage) -> Result<()> {
    write(path.as_ref(), picture.width(), picture.height(), ColorType::Grayscale, picture.as_raw())
}

fn write(path: &Path, width: u32, height: u32, color: ColorType, samples: &[u8]) -> Result<()> {
    file::write_file(path, |writer| {
        let mut encoder = Encoder::new(writer, width, height);
        encoder.set_color(color);
        encoder.set_depth(BitDepth::Eight);
        encoder.set_compression(Compression::Balanced);
        encoder.set_source_srgb(SrgbRenderingIntent::Perceptual);
        let mut picture = encoder.write_header().map_err(|error| failed(path, error))?;
        picture.write_image_data(samples).map_err(|error| failed(path, error))?;
        picture.finish().map_err(|error| failed(path, error))
    })
}

/// Converts an error of the encoder.
pub(super) fn failed(path: &Path, error: png::EncodingError) -> Error {
    match error {
        png::EncodingError::IoError(source) => Error::io("write", path)(source),
        other => Error::run(format!("writing {}", path.display()), other.to_string()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::{Luma, Rgb, Rgba};

    #[test]
    fn pictures_round_trip() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        let rgb = RgbImage::from_fn(7, 5, |x, y| Rgb([x as u8 * 30, y as u8 * 40, 200]));
        write_rgb8(&path, &rgb).unwrap();
        assert_eq!(image::open(&path).unwrap().into_rgb8(), rgb);
        let rgba = RgbaImage::from_fn(3, 4, |x, y| Rgba([x as u8 * 30, 7, 9, y as u8 * 60]));
        write_rgba8(&path, &rgba).unwrap();
        assert_eq!(image::open(&path).unwrap().into_rgba8(), rgba);
        let gray = GrayImage::from_fn(5, 2, |x, y| Luma([x as u8 * 50 + y as u8]));
        write_gray8(&path, &gray).unwrap();
        assert_eq!(image::open(&path).unwrap(), image::DynamicImage::ImageLuma8(gray));
    }

    #[test]
    fn an_empty_picture_is_an_error_without_a_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        assert!(matches!(write_rgb8(&path, &RgbImage::new(0, 3)).unwrap_err(), Error::Run { .. }));
        assert!(!path.exists());
    }
}
