//! TIFF: gray and RGB with and without alpha, 8 and 16 bit and float.

use crate::codec::file::Source;
use crate::codec::image::format::{Format, ImageHeader, ImageSamples, MAX_DECODED_BYTES, damaged, raw};
use lobelia_geometry::{Error, Result};
use std::path::Path;
use tiff::decoder::{Decoder, DecodingResult, Limits};
use tiff::tags::{ExtraSamples, SampleFormat, Tag};
use tiff::{ColorType, TiffError};

/// Version of DNG, in its files alone.
const DNG_VERSION: Tag = Tag::Unknown(50_706);

fn wrong(path: &Path, error: &TiffError) -> Error {
    match error {
        TiffError::UnsupportedError(what) => unsupported(path, &what.to_string()),
        other => damaged(path, Format::Tiff, &other.to_string()),
    }
}

fn unsupported(path: &Path, what: &str) -> Error {
    let help = "Save it as RGB or gray of 8 or 16 bits or floats, without compression or with LZW or Deflate. \
                Develop a camera's RAW file first.";
    Error::input(path, "", format!("this kind of TIFF is not read: {what}"), help)
}

fn open<'a>(path: &Path, source: &'a mut dyn Source) -> Result<Decoder<&'a mut dyn Source>> {
    let mut limits = Limits::default();
    limits.decoding_buffer_size = MAX_DECODED_BYTES;
    limits.intermediate_buffer_size = MAX_DECODED_BYTES;
    Ok(Decoder::new(source).map_err(|error| wrong(path, &error))?.with_limits(limits))
}

/// Reads the header of a TIFF at its beginning.
pub(super) fn header(path: &Path, source: &mut dyn Source) -> Result<ImageHeader> {
    let mut decoder = open(path, source)?;
    let wrong = |error: TiffError| wrong(path, &error);
    let is_reduced = decoder.find_tag_unsigned(Tag::NewSubfileType).map_err(wrong)?.unwrap_or(0u32) & 1 == 1;
    if is_reduced || decoder.find_tag(DNG_VERSION).map_err(wrong)?.is_some() {
        return Err(raw(path));
    }
    let color = decoder.colortype().map_err(wrong)?;
    let channels = match color {
        ColorType::Gray(_) => 1,
        ColorType::Multiband { num_samples: 2, .. } => 2,
        ColorType::RGB(_) => 3,
        ColorType::RGBA(_) => 4,
        other => return Err(unsupported(path, &format!("its colors are {other:?}"))),
    };
    let formats: Vec<u16> =
        decoder.find_tag_unsigned_vec(Tag::SampleFormat).map_err(wrong)?.unwrap_or_default();
    let sample = formats.first().map_or(SampleFormat::Uint, |&code| SampleFormat::from_u16_exhaustive(code));
    let bits = color.bit_depth();
    let is_float = match (sample, bits) {
        (SampleFormat::Uint, 8 | 16) => false,
        (SampleFormat::Uint, 1 | 2 | 4) if channels == 1 => false,
        (SampleFormat::IEEEFP, 16 | 32 | 64) => true,
        _ => return Err(unsupported(path, &format!("its samples are {sample:?} of {bits} bits"))),
    };
    let (width, height) = decoder.dimensions().map_err(wrong)?;
    let exif = decoder.find_tag_unsigned(Tag::Orientation).ok().flatten();
    let exif = exif.filter(|exif| (1..=8).contains(exif)).unwrap_or(1);
    let (format, bits) = (Format::Tiff, u32::from(bits).clamp(8, 32));
    Ok(ImageHeader { format, width, height, channels, bits, is_float, exif })
}

/// Decodes a TIFF at its beginning, which has this header.
pub(super) fn decode(path: &Path, source: &mut dyn Source, header: &ImageHeader) -> Result<ImageSamples> {
    let ImageHeader { width, height, channels, is_float, .. } = *header;
    let mut decoder = open(path, source)?;
    let wrong = |error: TiffError| wrong(path, &error);
    let bits = decoder.colortype().map_err(wrong)?.bit_depth();
    let extra: Vec<u16> =
        decoder.find_tag_unsigned_vec(Tag::ExtraSamples).map_err(wrong)?.unwrap_or_default();
    // Alpha has been multiplied into the colors.
    let is_premultiplied = extra.first() == Some(&ExtraSamples::AssociatedAlpha.to_u16());
    let mut result = DecodingResult::U8(Vec::new());
    let read = decoder.read_image_to_buffer(&mut result).map_err(wrong)?;
    if read.planes > 1 {
        return Err(unsupported(path, "its channels lie in planes of their own"));
    }
    let mut samples = match result {
        DecodingResult::U8(packed) if bits < 8 => ImageSamples::Bytes8(unpacked(&packed, width, bits)),
        DecodingResult::U8(samples) => ImageSamples::Bytes8(samples),
        DecodingResult::U16(samples) => ImageSamples::Words16(samples),
        DecodingResult::F32(samples) => ImageSamples::Floats(samples),
        DecodingResult::F16(halves) => {
            ImageSamples::Floats(halves.iter().map(|half| half.to_f32()).collect())
        }
        DecodingResult::F64(wide) => ImageSamples::Floats(wide.iter().map(|float| *float as f32).collect()),
        _ => return Err(unsupported(path, "its samples are signed or wider than 16 bits")),
    };
    if samples.count() != width as usize * height as usize * channels {
        return Err(damaged(path, Format::Tiff, "it has fewer samples than its header declares"));
    }
    if header.has_alpha() && is_premultiplied != is_float {
        match &mut samples {
            ImageSamples::Bytes8(samples) => make_straight(samples, channels, 255),
            ImageSamples::Words16(samples) => make_straight(samples, channels, 65_535),
            ImageSamples::Floats(samples) => {
                for pixel in samples.chunks_exact_mut(channels) {
                    let alpha = pixel[channels - 1];
                    pixel[..channels - 1].iter_mut().for_each(|color| *color *= alpha);
                }
            }
        }
    }
    Ok(samples)
}

/// Gray samples of 1, 2 or 4 bits, whose rows begin at whole bytes, as bytes.
fn unpacked(packed: &[u8], width: u32, bits: u8) -> Vec<u8> {
    let (width, bits) = (width as usize, usize::from(bits));
    let top = (1u8 << bits) - 1;
    let sample = |row: &[u8], x: usize| {
        let at = x * bits;
        (row[at / 8] >> (8 - bits - at % 8) & top) * (255 / top)
    };
    let rows = packed.chunks_exact((width * bits).div_ceil(8));
    rows.flat_map(|row| (0..width).map(move |x| sample(row, x))).collect()
}

/// Takes alpha out of integers that it is multiplied into.
fn make_straight<T: Copy + Into<u32> + TryFrom<u32>>(samples: &mut [T], channels: usize, top: u32) {
    for pixel in samples.chunks_exact_mut(channels) {
        let alpha: u32 = pixel[channels - 1].into();
        for color in &mut pixel[..channels - 1] {
            let value = ((*color).into() * top + alpha / 2).checked_div(alpha).unwrap_or(0).min(top);
            *color = T::try_from(value).unwrap_or(*color);
        }
    }
}
