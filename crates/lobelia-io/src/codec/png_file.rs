//! 8-bit sRGB pictures and masks as PNG. A file is written whole or by rows, with the same bytes,
//! and may say which program wrote it.
//!
//! ```
//! use image::{Rgb, RgbImage};
//! use lobelia_io::codec::png_file::{software_of, write_rgb8_by};
//!
//! let folder = tempfile::tempdir()?;
//! let path = folder.path().join("brown.png");
//! let brown = RgbImage::from_pixel(3, 2, Rgb([90, 60, 30]));
//! write_rgb8_by(&path, &brown, "a program")?;
//! assert_eq!(image::open(&path)?.into_rgb8(), brown);
//! assert_eq!(software_of(&path).as_deref(), Some("a program"));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use crate::codec::file;
use crate::codec::image::{Decoded, ImageSamples, Orientation, decode_samples};
use image::{GrayImage, RgbImage};
use lobelia_geometry::{Error, Result};
use png::{BitDepth, ColorType, Compression, Encoder, SrgbRenderingIntent};
use std::{io::Write, path::Path};

/// Writes an opaque sRGB picture.
///
/// # Errors
/// [`Error::Io`] if the file cannot be written, [`Error::Run`] for an empty picture.
pub fn write_rgb8(path: impl AsRef<Path>, picture: &RgbImage) -> Result<()> {
    let size = picture.dimensions().into();
    write_rows(path, size, ColorType::Rgb, None, |rows| rows.push(picture.as_raw()))
}

/// Writes a gray picture, such as a mask.
///
/// # Errors
/// As for [`write_rgb8`].
pub fn write_gray8(path: impl AsRef<Path>, picture: &GrayImage) -> Result<()> {
    let size = picture.dimensions().into();
    write_rows(path, size, ColorType::Grayscale, None, |rows| rows.push(picture.as_raw()))
}

/// [`write_rgb8`] with a line of text that says which program wrote it ([`software_of`]).
///
/// # Errors
/// As for [`write_rgb8`].
pub fn write_rgb8_by(path: impl AsRef<Path>, picture: &RgbImage, software: &str) -> Result<()> {
    let size = picture.dimensions().into();
    write_rows(path, size, ColorType::Rgb, Some(software), |rows| rows.push(picture.as_raw()))
}

/// The program that a PNG says it was written by; `None` if it is no PNG, or does not say.
pub fn software_of(path: impl AsRef<Path>) -> Option<String> {
    let file = file::open(path.as_ref(), |_| String::new()).ok()?;
    let reader = png::Decoder::new(file).read_info().ok()?;
    let texts = &reader.info().uncompressed_latin1_text;
    texts.iter().find(|text| text.keyword == SOFTWARE).map(|text| text.text.clone())
}

/// The keyword that the PNG specification has for the program that wrote a file.
const SOFTWARE: &str = "Software";
/// Compressed bytes that are collected before they are written: one chunk of the file.
const CHUNK_BYTES: usize = 1 << 20;

/// Writes an 8-bit sRGB picture of `size` (width, height) that is never whole in memory: `fill`
/// pushes its rows from the top. The file has the same bytes, however many rows are pushed at a
/// time, and gets its name when `fill` has succeeded and all rows are there. `software` is the
/// program that it says it was written by.
///
/// # Errors
/// [`Error::Io`] if the file cannot be written, [`Error::Run`] for an empty picture or another
/// number of rows, and whatever `fill` returns.
pub fn write_rows(
    path: impl AsRef<Path>,
    size: [u32; 2],
    color: ColorType,
    software: Option<&str>,
    fill: impl FnOnce(&mut PngRows) -> Result<()>,
) -> Result<()> {
    let path = path.as_ref();
    let failed = |error| match error {
        png::EncodingError::IoError(source) => Error::io("write", path)(source),
        other => file::not_written(path, other),
    };
    file::write_file(path, |writer| {
        let mut encoder = Encoder::new(writer, size[0], size[1]);
        encoder.set_color(color);
        encoder.set_depth(BitDepth::Eight);
        encoder.set_compression(Compression::Balanced);
        encoder.set_source_srgb(SrgbRenderingIntent::Perceptual);
        if let Some(software) = software {
            encoder.add_text_chunk(SOFTWARE.to_owned(), software.to_owned()).map_err(failed)?;
        }
        let mut picture = encoder.write_header().map_err(failed)?;
        let mut stream = picture.stream_writer_with_size(CHUNK_BYTES).map_err(failed)?;
        fill(&mut PngRows { path, stream: &mut stream })?;
        stream.finish().map_err(failed)?;
        picture.finish().map_err(failed)
    })
}

/// The rows of a picture that is being written.
pub struct PngRows<'a> {
    path: &'a Path,
    stream: &'a mut dyn Write,
}

impl PngRows<'_> {
    /// Writes the samples of the next rows: R, G, B and perhaps alpha of each pixel.
    ///
    /// # Errors
    /// [`Error::Io`] if they cannot be written, or are more than the picture has.
    pub fn push(&mut self, samples: &[u8]) -> Result<()> {
        self.stream.write_all(samples).map_err(Error::io("write", self.path))
    }
}

/// Reads an opaque 8-bit picture that [`write_rgb8`] wrote.
///
/// # Errors
/// As for [`decode_samples`]; [`Error::Input`] if it is another kind of picture.
pub(crate) fn read_rgb8(path: &Path) -> Result<RgbImage> {
    let Decoded { header, samples } = decode_samples(path, Orientation::AsStored)?;
    let picture = match samples {
        ImageSamples::Bytes8(samples) => RgbImage::from_raw(header.width, header.height, samples),
        _ => None,
    };
    picture.ok_or_else(|| Error::input(path, "", "it is not 8-bit RGB", "Render it again."))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::codec::test_data::temporary;
    use image::Rgb;

    #[test]
    fn rows_at_a_time_give_the_bytes_of_the_whole() {
        let folder = tempfile::tempdir().unwrap();
        let (whole, parts) = (folder.path().join("whole.png"), folder.path().join("parts.png"));
        let picture = RgbImage::from_fn(31, 19, |x, y| Rgb([x as u8 * 8, y as u8 * 13, (x * y) as u8]));
        write_rgb8(&whole, &picture).unwrap();
        for rows in [1, 3, 7] {
            let parted =
                |file: &mut PngRows| picture.as_raw().chunks(rows * 31 * 3).try_for_each(|r| file.push(r));
            write_rows(&parts, [31, 19], ColorType::Rgb, None, parted).unwrap();
            assert_eq!(std::fs::read(&parts).unwrap(), std::fs::read(&whole).unwrap(), "{rows}");
        }
        assert_eq!(read_rgb8(&parts).unwrap(), picture);
        std::fs::write(&parts, &std::fs::read(&whole).unwrap()[..200]).unwrap();
        assert!(matches!(read_rgb8(&parts), Err(Error::Input { .. })));
    }

    #[test]
    fn missing_and_surplus_rows_are_refused_and_leave_no_file() {
        let (folder, path) = temporary("a.png");
        for rows in [0, 3, 5] {
            let pushed = write_rows(&path, [2, 4], ColorType::Rgb, None, |file| {
                (0..rows).try_for_each(|_| file.push(&[7; 6]))
            });
            assert!(matches!(pushed, Err(Error::Run { .. } | Error::Io { .. })), "{rows}");
        }
        let stopped = write_rows(&path, [2, 4], ColorType::Rgb, None, |_| Err(Error::Interrupted));
        assert!(matches!(stopped, Err(Error::Interrupted)));
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }
}
