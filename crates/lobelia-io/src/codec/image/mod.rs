//! Reading photographs and masks: PNG, JPEG, TIFF, WebP, OpenEXR and Radiance HDR.
//!
//! The first bytes of a file determine its format, whatever its name. Embedded color profiles and
//! gamma chunks are ignored: [`Gamma`] says how 8- and 16-bit values are read. Headers are read and
//! checked before pixels are decoded. [`decode_photograph`] gives pixels as compact as the file has
//! them; [`read_image`] and [`read_mask`] convert these to linear radiance and coverage.
//!
//! [`encode_jpeg`] and [`encode_png`] are for pictures in memory, such as those that a page holds.
//!
//! ```
//! use image::ExtendedColorType;
//! use lobelia_io::codec::image::{decode, encode_png};
//!
//! let red_and_blue = encode_png(&[255, 0, 0, 0, 0, 255], [2, 1], ExtendedColorType::Rgb8)?;
//! let picture = decode(&red_and_blue)?.into_rgb8();
//! assert_eq!(picture.dimensions(), (2, 1));
//! assert_eq!(picture.get_pixel(1, 0).0, [0, 0, 255]);
//! # Ok::<(), lobelia_geometry::Error>(())
//! ```

pub(crate) mod format;
mod linear;
mod tiff_file;

pub(crate) use format::has_extension;
pub use format::{
    Format, IMAGE_EXTENSIONS, ImageHeader, ImageSamples, Orientation, is_unread_name, is_video_start,
};
pub use linear::{
    BRIGHTEST, Gamma, LoadedImage, Repairs, decode_photograph, linear_image, read_image, read_mask,
};

use crate::codec::file::{DiskFile, Source, first_bytes, open};
use crate::codec::{exr::decode_exr_picture, exr::exr_header, nearby::missing_file_help};
use format::{check_size, damaged, recognize};
use image::{
    DynamicImage, ExtendedColorType, ImageDecoder, ImageEncoder, ImageError, Limits, RgbImage,
    codecs::hdr::HdrDecoder, codecs::jpeg::JpegDecoder, codecs::jpeg::JpegEncoder, codecs::png::PngDecoder,
    codecs::png::PngEncoder, codecs::webp::WebPDecoder, metadata::Orientation as ExifOrientation,
};
use lobelia_geometry::{Error, Result};
use std::io::{BufReader, Cursor, Read as _, Seek as _};
use std::path::Path;

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
pub fn encode_png(samples: &[u8], [width, height]: [u32; 2], pixels: ExtendedColorType) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    PngEncoder::new(&mut bytes).write_image(samples, width, height, pixels).map_err(not_encoded)?;
    Ok(bytes)
}

/// The picture in the bytes of a PNG, JPEG or GIF file.
///
/// # Errors
/// [`Error::Run`] if they are of none of these, or damaged.
pub fn decode(bytes: &[u8]) -> Result<DynamicImage> {
    image::load_from_memory(bytes).map_err(|error| Error::run("a picture", error.to_string()))
}

fn not_encoded(error: image::ImageError) -> Error {
    Error::run("a picture", format!("it cannot be encoded: {error}"))
}

/// Bytes at the start of a file that say which format it has.
const RECOGNIZED_BY: usize = 64;
/// Bytes that the chunks of a PNG beside its pixels may have.
const MOST_CHUNK_BYTES: u64 = 1 << 26;
/// Bytes in which the header of a JPEG is looked for: its usual segments, and more than it can have
/// in all. Its decoder takes whole files.
const JPEG_HEADER_BYTES: [usize; 2] = [1 << 18, 1 << 24];

/// An image whose samples are as the file has them.
#[derive(Clone, Debug, PartialEq)]
pub struct Decoded {
    /// The header; its size is that after turning, if the pixels are turned, and its orientation
    /// that which is left.
    pub header: ImageHeader,
    /// `width * height` times `channels` samples.
    pub samples: ImageSamples,
}

/// The samples of an image with this header, turned by its EXIF orientation.
fn turned<T: Copy>(samples: Vec<T>, header: &ImageHeader) -> Vec<T> {
    let ImageHeader { exif, channels, .. } = *header;
    let (w, h) = (header.width as usize, header.height as usize);
    let (columns, rows) = if exif >= 5 { (h, w) } else { (w, h) };
    let mut out = Vec::with_capacity(samples.len());
    for v in 0..rows {
        for u in 0..columns {
            let (x, y) = if exif >= 5 { (v, u) } else { (u, v) };
            let x = if matches!(exif, 2 | 3 | 7 | 8) { w - 1 - x } else { x };
            let y = if matches!(exif, 3 | 4 | 6 | 7) { h - 1 - y } else { y };
            out.extend_from_slice(&samples[(y * w + x) * channels..][..channels]);
        }
    }
    out
}

/// Reads the header of an image file, and checks format and size. No pixels are decoded.
///
/// # Errors
/// [`Error::Input`] if the file is missing, empty, in a format that is not read (with the tool that
/// converts it), or damaged so that its header cannot be read; also if the declared size is above
/// 2²⁸ pixels, or more than a file of so few bytes can hold.
pub fn image_header(path: impl AsRef<Path>) -> Result<ImageHeader> {
    let path = path.as_ref();
    read_header(path, &mut open(path, missing_file_help)?)
}

/// [`image_header`] of a file at its beginning.
fn read_header(path: &Path, file: &mut BufReader<DiskFile>) -> Result<ImageHeader> {
    let file_bytes = file.get_ref().file.metadata().map_err(Error::io("read", path))?.len();
    let format = recognize(path, &first_bytes(path, file, RECOGNIZED_BY)?)?;
    let header = match format {
        Format::Tiff => tiff_file::header(path, file)?,
        Format::Exr => exr_header(path, Box::new(file))?,
        format => header_of(format, header_decoder(path, format, file)?),
    };
    check_size(path, &header, file_bytes)?;
    Ok(header)
}

/// Reads the EXIF block of a PNG, JPEG or WebP; it is empty if the file has none that can be read.
///
/// # Errors
/// As for [`image_header`].
pub fn exif_block(path: &Path) -> Result<Vec<u8>> {
    let mut file = open(path, missing_file_help)?;
    match recognize(path, &first_bytes(path, &mut file, RECOGNIZED_BY)?)? {
        Format::Tiff | Format::Exr => Ok(Vec::new()),
        format => {
            let block = header_decoder(path, format, &mut file)?.exif_metadata();
            Ok(block.ok().flatten().unwrap_or_default())
        }
    }
}

/// A decoder of a file at its beginning, for its header alone.
fn header_decoder<'a>(
    path: &Path,
    format: Format,
    file: &'a mut BufReader<DiskFile>,
) -> Result<Box<dyn ImageDecoder + 'a>> {
    if format != Format::Jpeg {
        return decoder(path, format, Box::new(file));
    }
    let [usual, most] = JPEG_HEADER_BYTES;
    let mut read = |count| decoder(path, format, Box::new(Cursor::new(first_bytes(path, file, count)?)));
    read(usual).or_else(|_| read(most))
}

/// A decoder of the crate `image`, for formats that are not [`Format::Tiff`] or [`Format::Exr`].
fn decoder<'a>(
    path: &Path,
    format: Format,
    source: Box<dyn Source + 'a>,
) -> Result<Box<dyn ImageDecoder + 'a>> {
    let wrong = |error: ImageError| damaged(path, format, &error.to_string());
    Ok(match format {
        Format::Png => {
            let mut limits = Limits::no_limits();
            limits.max_alloc = Some(MOST_CHUNK_BYTES);
            Box::new(PngDecoder::with_limits(source, limits).map_err(wrong)?)
        }
        Format::Webp => Box::new(WebPDecoder::new(source).map_err(wrong)?),
        Format::Hdr => Box::new(HdrDecoder::new_nonstrict(source).map_err(wrong)?),
        _ => Box::new(JpegDecoder::new(source).map_err(wrong)?),
    })
}

/// The header of a decoder's image.
fn header_of(format: Format, mut decoder: Box<dyn ImageDecoder + '_>) -> ImageHeader {
    let ((width, height), color) = (decoder.dimensions(), decoder.color_type());
    let channels = usize::from(color.channel_count());
    let bits = u32::from(color.bytes_per_pixel()) * 8 / channels as u32;
    // With a damaged EXIF block, pixels stay as they are stored.
    let exif = decoder.orientation().map_or(1, ExifOrientation::to_exif);
    ImageHeader { format, width, height, channels, bits, is_float: format == Format::Hdr, exif }
}

/// The bytes of a JPEG at its beginning. The decoder fills missing data at the end of a file with
/// gray, so the end marker is checked first.
fn whole_jpeg(path: &Path, mut source: BufReader<DiskFile>) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    source.read_to_end(&mut bytes).map_err(Error::io("read", path))?;
    // A thumbnail in the header has an end marker of its own.
    let scan = first_scan(&bytes).unwrap_or_default();
    if bytes[scan..].windows(2).any(|pair| pair == [0xff, 0xd9]) {
        return Ok(bytes);
    }
    Err(damaged(path, Format::Jpeg, "its end is missing"))
}

/// Where the first scan of a JPEG begins, behind all segments of its header.
fn first_scan(bytes: &[u8]) -> Option<usize> {
    let mut at = 2;
    loop {
        at += match *bytes.get(at..at + 2)? {
            [0xff, 0xda] => return Some(at),
            // Fill bytes may precede a marker.
            [0xff, 0xff] => 1,
            [0xff, 0x01 | 0xd0..=0xd7] => 2,
            [0xff, _] => 2 + usize::from(u16::from_be_bytes(*bytes.get(at + 2..)?.first_chunk()?)),
            _ => return None,
        };
    }
}

/// Reads the pixels of an image file as they are stored: nothing is converted to floats, and
/// nothing is linearized.
///
/// # Errors
/// As for [`image_header`], and [`Error::Input`] if the pixels are damaged or truncated.
pub fn decode_samples(path: impl AsRef<Path>, orientation: Orientation) -> Result<Decoded> {
    let path = path.as_ref();
    let mut file = open(path, missing_file_help)?;
    let header = read_header(path, &mut file)?;
    file.rewind().map_err(Error::io("read", path))?;
    let samples = match header.format {
        Format::Tiff => tiff_file::decode(path, &mut file, &header)?,
        Format::Exr => ImageSamples::Floats(decode_exr_picture(path, Box::new(file))?),
        Format::Jpeg => {
            let bytes = Cursor::new(whole_jpeg(path, file)?);
            samples_of(path, &header, decoder(path, header.format, Box::new(bytes))?)?
        }
        format => samples_of(path, &header, decoder(path, format, Box::new(file))?)?,
    };
    if orientation == Orientation::AsStored || !(2..=8).contains(&header.exif) {
        return Ok(Decoded { header, samples });
    }
    let samples = match samples {
        ImageSamples::Bytes8(samples) => ImageSamples::Bytes8(turned(samples, &header)),
        ImageSamples::Words16(samples) => ImageSamples::Words16(turned(samples, &header)),
        ImageSamples::Floats(samples) => ImageSamples::Floats(turned(samples, &header)),
    };
    let [width, height] = header.size(orientation);
    Ok(Decoded { header: ImageHeader { width, height, exif: 1, ..header }, samples })
}

/// The samples of a decoder's image, if they are those of its header.
fn samples_of(
    path: &Path,
    header: &ImageHeader,
    decoder: Box<dyn ImageDecoder + '_>,
) -> Result<ImageSamples> {
    let wrong = |why: &str| damaged(path, header.format, why);
    let samples = match DynamicImage::from_decoder(decoder).map_err(|error| wrong(&error.to_string()))? {
        DynamicImage::ImageLuma16(image) => ImageSamples::Words16(image.into_raw()),
        DynamicImage::ImageLumaA16(image) => ImageSamples::Words16(image.into_raw()),
        DynamicImage::ImageRgb16(image) => ImageSamples::Words16(image.into_raw()),
        DynamicImage::ImageRgb32F(image) => ImageSamples::Floats(image.into_raw()),
        image if image.color().bytes_per_pixel() == image.color().channel_count() => {
            ImageSamples::Bytes8(image.into_bytes())
        }
        other => ImageSamples::Words16(other.into_rgba16().into_raw()),
    };
    if samples.count() as u64 != u64::from(header.width) * u64::from(header.height) * header.channels as u64 {
        return Err(wrong("its pixels are not those that its header declares"));
    }
    Ok(samples)
}

#[cfg(test)]
mod tests;
