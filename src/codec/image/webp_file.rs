//! WebP: lossy and lossless, with and without alpha.

use crate::codec::file::DiskFile;
use crate::codec::image::format::{Format, damaged};
use crate::codec::image::header::ImageHeader;
use crate::error::{Error, Result};
use image::metadata::Orientation as ExifOrientation;
use image_webp::{DecodingError, WebPDecoder};
use std::io::BufReader;
use std::path::Path;

type Decoder<'a> = WebPDecoder<&'a mut BufReader<DiskFile>>;

fn open<'a>(path: &Path, source: &'a mut BufReader<DiskFile>, file_bytes: u64) -> Result<Decoder<'a>> {
    let mut decoder = WebPDecoder::new(source).map_err(|error| wrong(path, &error))?;
    // Of a chunk that is read whole, which a file cannot have larger than itself.
    decoder.set_memory_limit(usize::try_from(file_bytes).unwrap_or(usize::MAX));
    if decoder.is_animated() {
        let help = "Take a frame with `webpmux -get frame 1 FILE -o FRAME`.";
        return Err(Error::input(path, "", "this WebP is an animation", help));
    }
    Ok(decoder)
}

fn wrong(path: &Path, error: &DecodingError) -> Error {
    damaged(path, Format::Webp, &error.to_string())
}

/// Reads the header of a WebP at its beginning.
pub(super) fn header(path: &Path, source: &mut BufReader<DiskFile>, file_bytes: u64) -> Result<ImageHeader> {
    let mut decoder = open(path, source, file_bytes)?;
    let (width, height) = decoder.dimensions();
    let channels = if decoder.has_alpha() { 4 } else { 3 };
    // With a damaged EXIF block, pixels stay as they are stored.
    let chunk = decoder.exif_metadata().ok().flatten().unwrap_or_default();
    let exif = ExifOrientation::from_exif_chunk(&chunk).map_or(1, ExifOrientation::to_exif);
    Ok(ImageHeader { format: Format::Webp, width, height, channels, bits: 8, is_float: false, exif })
}

/// Decodes a WebP at its beginning, which has this header.
pub(super) fn decode(path: &Path, source: &mut BufReader<DiskFile>, header: &ImageHeader) -> Result<Vec<u8>> {
    let mut decoder = open(path, source, u64::MAX)?;
    let mut samples = vec![0; header.decoded_bytes() as usize];
    decoder.read_image(&mut samples).map_err(|error| wrong(path, &error))?;
    Ok(samples)
}
