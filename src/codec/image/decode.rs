//! Reading headers and samples of all formats.

use crate::codec::exr::{decode_exr_picture, exr_header};
use crate::codec::file::{DiskFile, first_bytes, open};
use crate::codec::hdr::RadianceReader;
use crate::codec::image::format::{Format, damaged, recognize};
use crate::codec::image::header::{ImageHeader, Orientation, check_bytes, check_pixels};
use crate::codec::image::samples::{Decoded, ImageSamples};
use crate::codec::image::{jpeg_file, tiff_file, webp_file};
use crate::codec::nearby::missing_file_help;
use crate::error::{Error, Result};
use image::codecs::png::PngDecoder;
use image::metadata::Orientation as ExifOrientation;
use image::{DynamicImage, GrayAlphaImage, GrayImage, ImageDecoder, Limits, RgbImage, RgbaImage};
use std::io::{BufRead, BufReader, Seek};
use std::path::Path;

/// Bytes at the start of a file that say which format it has.
const RECOGNIZED_BY: usize = 64;
/// Bytes that the chunks of a PNG beside its pixels may have.
const MOST_CHUNK_BYTES: u64 = 1 << 26;

/// Reads the header of an image file, and checks format and size. No pixels are decoded.
///
/// # Errors
/// [`Error::Input`] if the file is missing, empty, in a format that is not read (with the tool that converts it), or
/// damaged so that its header cannot be read; also if the declared size is above 2²⁸ pixels, or more than a file of so few bytes can hold.
pub(crate) fn image_header(path: impl AsRef<Path>) -> Result<ImageHeader> {
    let path = path.as_ref();
    read_header(path, &mut open(path, missing_file_help)?)
}

/// [`image_header`] of a file at its beginning.
pub(super) fn read_header(path: &Path, file: &mut BufReader<DiskFile>) -> Result<ImageHeader> {
    let file_bytes = file.get_ref().metadata().map_err(Error::io("read", path))?.len();
    let format = recognize(path, &first_bytes(path, file, RECOGNIZED_BY)?)?;
    let header = match format {
        Format::Png => png_header(path, file)?,
        Format::Jpeg => jpeg_file::header(path, file)?,
        Format::Tiff => tiff_file::header(path, file)?,
        Format::Webp => webp_file::header(path, file, file_bytes)?,
        Format::Exr => {
            let of = exr_header(path, file)?;
            let (width, height, channels, bits) = (of.width, of.height, of.channels, of.bits);
            ImageHeader { format, width, height, channels, bits, is_float: true, exif: 1 }
        }
        Format::Hdr => {
            let reader = RadianceReader::new(file).map_err(|problem| damaged(path, format, &problem))?;
            let [width, height] = reader.size.map(|side| u32::try_from(side).unwrap_or(u32::MAX));
            ImageHeader { format, width, height, channels: 3, bits: 32, is_float: true, exif: 1 }
        }
    };
    check_pixels(path, format, [header.width, header.height])?;
    check_bytes(path, &header, file_bytes)?;
    Ok(header)
}

/// Reads the pixels of an image file as they are stored: nothing is converted to floats, and nothing is linearized.
///
/// # Errors
/// Those of [`image_header`], and [`Error::Input`] if the pixels are damaged or truncated.
pub(crate) fn decode_samples(path: impl AsRef<Path>, orientation: Orientation) -> Result<Decoded> {
    let path = path.as_ref();
    let mut file = open(path, missing_file_help)?;
    let header = read_header(path, &mut file)?;
    file.rewind().map_err(Error::io("read", path))?;
    let samples = match header.format {
        Format::Png => {
            let wrong = |error: image::ImageError| damaged(path, header.format, &error.to_string());
            let decoded = png_decoder(file).and_then(DynamicImage::from_decoder).map_err(wrong)?;
            integers(path, &header, decoded)?
        }
        Format::Jpeg => integers(path, &header, jpeg_file::decode(path, &mut file)?)?,
        Format::Tiff => tiff_file::decode(path, file, &header)?,
        Format::Webp => ImageSamples::Bytes8(webp_file::decode(path, &mut file, &header)?),
        Format::Exr => ImageSamples::Floats(decode_exr_picture(path, file)?.1),
        Format::Hdr => ImageSamples::Floats(decode_hdr(path, file)?),
    };
    let decoded = Decoded { header, width: header.width, height: header.height, samples };
    Ok(match orientation {
        Orientation::AsStored => decoded,
        Orientation::Upright => decoded.upright(),
    })
}

/// Reads the pixels of an image file of integers as they are stored, with 8 bits per sample.
///
/// # Errors
/// [`Error::Input`] if the file is missing, not an image that is read, damaged, too large, or holds floats.
pub fn decode_picture(path: impl AsRef<Path>) -> Result<DynamicImage> {
    let path = path.as_ref();
    let decoded = decode_samples(path, Orientation::AsStored)?;
    let (format, channels, [w, h]) =
        (decoded.header.format, decoded.channels(), [decoded.width, decoded.height]);
    let samples = match decoded.samples {
        ImageSamples::Bytes8(samples) => samples,
        ImageSamples::Words16(samples) => {
            samples.into_iter().map(|sample| ((u32::from(sample) + 128) / 257) as u8).collect()
        }
        ImageSamples::Floats(_) => {
            let problem = format!("{} with floats, where a picture of integers is needed", format.name());
            return Err(Error::input(path, "", problem, "Convert it to JPEG or PNG."));
        }
    };
    let picture = match channels {
        1 => GrayImage::from_raw(w, h, samples).map(DynamicImage::ImageLuma8),
        2 => GrayAlphaImage::from_raw(w, h, samples).map(DynamicImage::ImageLumaA8),
        3 => RgbImage::from_raw(w, h, samples).map(DynamicImage::ImageRgb8),
        _ => RgbaImage::from_raw(w, h, samples).map(DynamicImage::ImageRgba8),
    };
    picture.ok_or_else(|| damaged(path, format, "its pixels are not those that its header declares"))
}

fn integers(path: &Path, header: &ImageHeader, decoded: DynamicImage) -> Result<ImageSamples> {
    let samples = match decoded {
        DynamicImage::ImageLuma8(image) => ImageSamples::Bytes8(image.into_raw()),
        DynamicImage::ImageLumaA8(image) => ImageSamples::Bytes8(image.into_raw()),
        DynamicImage::ImageRgb8(image) => ImageSamples::Bytes8(image.into_raw()),
        DynamicImage::ImageRgba8(image) => ImageSamples::Bytes8(image.into_raw()),
        DynamicImage::ImageLuma16(image) => ImageSamples::Words16(image.into_raw()),
        DynamicImage::ImageLumaA16(image) => ImageSamples::Words16(image.into_raw()),
        DynamicImage::ImageRgb16(image) => ImageSamples::Words16(image.into_raw()),
        other => ImageSamples::Words16(other.into_rgba16().into_raw()),
    };
    if samples.count() as u64 != u64::from(header.width) * u64::from(header.height) * header.channels as u64 {
        return Err(damaged(path, header.format, "its pixels are not those that its header declares"));
    }
    Ok(samples)
}

fn decode_hdr(path: &Path, file: BufReader<DiskFile>) -> Result<Vec<f32>> {
    let wrong = |problem: String| damaged(path, Format::Hdr, &problem);
    let mut reader = RadianceReader::new(file).map_err(wrong)?;
    let [width, height] = reader.size;
    let mut samples = vec![0.0; 3 * width * height];
    for row in samples.chunks_exact_mut(3 * width) {
        let texel = |x: usize, value: glam::Vec3| row[3 * x..3 * x + 3].copy_from_slice(&value.to_array());
        reader.scanline(texel).map_err(wrong)?;
    }
    Ok(samples)
}

fn png_header(path: &Path, file: &mut BufReader<DiskFile>) -> Result<ImageHeader> {
    // The decoder takes memory for a row: the size is checked before.
    let start = first_bytes(path, file, 24)?;
    let Some(&[w3, w2, w1, w0, h3, h2, h1, h0]) = start.get(16..24).and_then(|size| size.first_chunk())
    else {
        return Err(damaged(path, Format::Png, "it ends in its header"));
    };
    let size = [u32::from_be_bytes([w3, w2, w1, w0]), u32::from_be_bytes([h3, h2, h1, h0])];
    check_pixels(path, Format::Png, size)?;
    let wrong = |error: image::ImageError| damaged(path, Format::Png, &error.to_string());
    let mut decoder = png_decoder(file).map_err(wrong)?;
    let (width, height) = decoder.dimensions();
    let color = decoder.color_type();
    let channels = usize::from(color.channel_count());
    let bits = u32::from(color.bytes_per_pixel()) * 8 / channels as u32;
    // With a damaged EXIF block, pixels stay as they are stored.
    let exif = decoder.orientation().map_or(1, ExifOrientation::to_exif);
    Ok(ImageHeader { format: Format::Png, width, height, channels, bits, is_float: false, exif })
}

/// A decoder of a PNG, with a bound on what its other chunks may take.
fn png_decoder<R: BufRead + Seek>(source: R) -> image::ImageResult<PngDecoder<R>> {
    let mut limits = Limits::no_limits();
    limits.max_alloc = Some(MOST_CHUNK_BYTES);
    PngDecoder::with_limits(source, limits)
}
