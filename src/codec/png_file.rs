//! 8-bit sRGB pictures and masks as PNG.

use crate::codec::file;
use crate::{Error, Result};
use image::{GrayImage, RgbImage};
use png::{BitDepth, ColorType, Compression, Encoder, SrgbRenderingIntent};
use std::io::{BufReader, Write};
use std::path::Path;

/// Writes an opaque sRGB picture.
///
/// # Errors
/// [`Error::Io`] if the file cannot be written, [`Error::Run`] for an empty picture.
pub fn write_rgb8(path: impl AsRef<Path>, picture: &RgbImage) -> Result<()> {
    write(path.as_ref(), picture.width(), picture.height(), ColorType::Rgb, picture.as_raw())
}

/// [`write_rgb8`] for a frame of a film, with a line of text about it. Files that do not stay are written `fast`: they are larger.
///
/// # Errors
/// Those of [`write_rgb8`].
pub(crate) fn write_film_frame(
    path: &Path,
    picture: &RgbImage,
    fast: bool,
    comment: Option<&str>,
) -> Result<()> {
    let compression = if fast { Compression::Fast } else { Compression::Balanced };
    let form = PngForm { compression, ..PngForm::of(ColorType::Rgb).with(comment) };
    write_rows_by(path, [picture.width(), picture.height()], form, |rows| rows.push(picture.as_raw()))
}

/// Writes a gray picture, such as a mask.
///
/// # Errors
/// [`Error::Io`] if the file cannot be written, [`Error::Run`] for an empty picture.
pub(crate) fn write_gray8(path: impl AsRef<Path>, picture: &GrayImage) -> Result<()> {
    write(path.as_ref(), picture.width(), picture.height(), ColorType::Grayscale, picture.as_raw())
}

/// [`write_rgb8`] with a line of text that says which program wrote it ([`software_of`]).
///
/// # Errors
/// Those of [`write_rgb8`].
pub fn write_rgb8_by(path: impl AsRef<Path>, picture: &RgbImage, software: &str) -> Result<()> {
    let size = [picture.width(), picture.height()];
    let form = PngForm { text: Some((SOFTWARE, software)), ..PngForm::of(ColorType::Rgb) };
    write_rows_by(path.as_ref(), size, form, |rows| rows.push(picture.as_raw()))
}

/// The program that a PNG says it was written by; `None` if it is no PNG, or does not say.
pub fn software_of(path: impl AsRef<Path>) -> Option<String> {
    text_of(path.as_ref(), SOFTWARE)
}

/// What a PNG says about its picture, such as that its noise was filtered away; `None` if it is no PNG, or says nothing.
pub fn comment_of(path: impl AsRef<Path>) -> Option<String> {
    text_of(path.as_ref(), COMMENT)
}

fn text_of(path: &Path, keyword: &str) -> Option<String> {
    let file = file::open(path, |_| String::new()).ok()?;
    let reader = png::Decoder::new(file).read_info().ok()?;
    let texts = &reader.info().uncompressed_latin1_text;
    texts.iter().find(|text| text.keyword == keyword).map(|text| text.text.clone())
}

fn write(path: &Path, width: u32, height: u32, color: ColorType, samples: &[u8]) -> Result<()> {
    write_rows(path, [width, height], color, None, |rows| rows.push(samples))
}

/// The keywords that the PNG specification has for the program, and for what is said about a picture.
const SOFTWARE: &str = "Software";
pub(super) const COMMENT: &str = "Comment";
/// Compressed bytes that are collected before they are written: one chunk of the file.
const CHUNK_BYTES: usize = 1 << 20;

/// Writes an 8-bit sRGB picture of `size` (width, height) that is never whole in memory: `fill` pushes its rows from the top. The file has
/// the same bytes, however many rows are pushed at a time, and gets its name when `fill` has succeeded and all rows are there. A
/// `comment` is Latin text that viewers show ([`comment_of`]).
///
/// # Errors
/// [`Error::Io`] if the file cannot be written, [`Error::Run`] for an empty picture or another number of rows, and whatever
/// `fill` returns.
pub(crate) fn write_rows(
    path: impl AsRef<Path>,
    size: [u32; 2],
    color: ColorType,
    comment: Option<&str>,
    fill: impl FnOnce(&mut PngRows) -> Result<()>,
) -> Result<()> {
    write_rows_by(path.as_ref(), size, PngForm::of(color).with(comment), fill)
}

/// How a PNG is written.
struct PngForm<'a> {
    color: ColorType,
    compression: Compression,
    /// A keyword of the PNG specification, and a text.
    text: Option<(&'static str, &'a str)>,
}

impl<'a> PngForm<'a> {
    fn of(color: ColorType) -> Self {
        Self { color, compression: Compression::Balanced, text: None }
    }

    fn with(self, comment: Option<&'a str>) -> Self {
        Self { text: comment.map(|comment| (COMMENT, comment)), ..self }
    }
}

fn write_rows_by(
    path: &Path,
    size: [u32; 2],
    PngForm { color, compression, text }: PngForm,
    fill: impl FnOnce(&mut PngRows) -> Result<()>,
) -> Result<()> {
    let failed = |error| failed(path, error);
    file::write_file(path, |writer| {
        let mut encoder = Encoder::new(writer, size[0], size[1]);
        encoder.set_color(color);
        encoder.set_depth(BitDepth::Eight);
        encoder.set_compression(compression);
        encoder.set_source_srgb(SrgbRenderingIntent::Perceptual);
        if let Some((keyword, text)) = text {
            encoder.add_text_chunk(keyword.to_owned(), text.to_owned()).map_err(failed)?;
        }
        let mut picture = encoder.write_header().map_err(failed)?;
        let mut stream = picture.stream_writer_with_size(CHUNK_BYTES).map_err(failed)?;
        let left = size[0] as usize * size[1] as usize * color.samples();
        let mut rows = PngRows { path, stream: &mut stream, left };
        fill(&mut rows)?;
        rows.complete()?;
        stream.finish().map_err(failed)?;
        picture.finish().map_err(failed)
    })
}

/// The rows of a picture that is being written.
pub struct PngRows<'a> {
    path: &'a Path,
    stream: &'a mut dyn Write,
    /// Samples still to come.
    left: usize,
}

impl PngRows<'_> {
    /// Writes the samples of the next rows: R, G, B and perhaps alpha of each pixel.
    ///
    /// # Errors
    /// [`Error::Io`] if they cannot be written, [`Error::Run`] if there are more than the picture has.
    pub fn push(&mut self, samples: &[u8]) -> Result<()> {
        let more =
            || Error::run(format!("writing {}", self.path.display()), "it has more rows than it should");
        self.left = self.left.checked_sub(samples.len()).ok_or_else(more)?;
        self.stream.write_all(samples).map_err(Error::io("write", self.path))
    }

    fn complete(&self) -> Result<()> {
        if self.left == 0 {
            return Ok(());
        }
        let problem = format!("{} of its samples were not rendered", self.left);
        Err(Error::run(format!("writing {}", self.path.display()), problem))
    }
}

/// Reads an opaque 8-bit picture that [`write_rgb8`] wrote.
///
/// # Errors
/// [`Error::Io`] if the file cannot be opened, [`Error::Input`] if it is another or a damaged one.
pub(crate) fn read_rgb8(path: &Path) -> Result<RgbImage> {
    let failed = |problem: String| Error::input(path, "", problem, "Render it again.");
    let file = file::DiskFile::open(path).map_err(Error::io("read", path))?;
    let mut reader =
        png::Decoder::new(BufReader::new(file)).read_info().map_err(|error| failed(error.to_string()))?;
    let size = [reader.info().width, reader.info().height];
    let mut samples = vec![0; reader.output_buffer_size().unwrap_or(0)];
    reader.next_frame(&mut samples).map_err(|error| failed(error.to_string()))?;
    RgbImage::from_raw(size[0], size[1], samples).ok_or_else(|| failed("it is not 8-bit RGB".to_owned()))
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
    use image::{Luma, Rgb};

    #[test]
    fn pictures_round_trip() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        let rgb = RgbImage::from_fn(7, 5, |x, y| Rgb([x as u8 * 30, y as u8 * 40, 200]));
        write_rgb8(&path, &rgb).unwrap();
        assert_eq!(image::open(&path).unwrap().into_rgb8(), rgb);
        let gray = GrayImage::from_fn(5, 2, |x, y| Luma([x as u8 * 50 + y as u8]));
        write_gray8(&path, &gray).unwrap();
        assert_eq!(image::open(&path).unwrap(), image::DynamicImage::ImageLuma8(gray));
    }

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
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        for rows in [0, 3, 5] {
            let pushed = write_rows(&path, [2, 4], ColorType::Rgb, None, |file| {
                (0..rows).try_for_each(|_| file.push(&[7; 6]))
            });
            assert!(matches!(pushed, Err(Error::Run { .. })), "{rows}");
        }
        let stopped = write_rows(&path, [2, 4], ColorType::Rgb, None, |_| Err(Error::Interrupted));
        assert!(matches!(stopped, Err(Error::Interrupted)));
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }

    #[test]
    fn an_empty_picture_is_an_error_without_a_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        assert!(matches!(write_rgb8(&path, &RgbImage::new(0, 3)).unwrap_err(), Error::Run { .. }));
        assert!(!path.exists());
    }
}
