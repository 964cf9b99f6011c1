//! JPEG: its header segment by segment, and its pixels.

use crate::codec::file::DiskFile;
use crate::codec::image::format::{Format, damaged};
use crate::codec::image::header::ImageHeader;
use crate::error::{Error, Result};
use image::DynamicImage;
use image::codecs::jpeg::JpegDecoder;
use image::metadata::Orientation as ExifOrientation;
use std::io::{self, BufReader, Cursor, Read};
use std::path::Path;

/// Most segments and fill bytes before the first scan.
const MOST_STEPS: usize = 1 << 16;

/// What the segments before the first scan say.
struct Segments {
    size: [u32; 2],
    bits: u8,
    components: u8,
    exif: u8,
    /// Position behind the marker of the first scan.
    scan: usize,
}

/// Reads the header of a JPEG at its beginning.
pub(super) fn header(path: &Path, source: &mut BufReader<DiskFile>) -> Result<ImageHeader> {
    let segments = segments(source).map_err(|error| damaged(path, Format::Jpeg, &error.to_string()))?;
    let Segments { size: [width, height], bits, components, exif, .. } = segments;
    if bits != 8 {
        let problem = format!("a JPEG of {bits} bits per sample, which is not read");
        return Err(Error::input(path, "", problem, "Convert it to 16-bit PNG or TIFF."));
    }
    let channels = if components == 1 { 1 } else { 3 };
    Ok(ImageHeader { format: Format::Jpeg, width, height, channels, bits: 8, is_float: false, exif })
}

/// Decodes a JPEG at its beginning.
///
/// The decoder fills missing data at the end of a file with gray, so the end marker is checked first.
pub(super) fn decode(path: &Path, source: &mut BufReader<DiskFile>) -> Result<DynamicImage> {
    let wrong = |why: &str| damaged(path, Format::Jpeg, why);
    let mut bytes = Vec::new();
    source.read_to_end(&mut bytes).map_err(Error::io("read", path))?;
    let scan = segments(&mut Cursor::new(&bytes)).map_err(|error| wrong(&error.to_string()))?.scan;
    // A thumbnail in the header has an end marker of its own.
    if !bytes[scan..].windows(2).any(|pair| pair == [0xff, 0xd9]) {
        return Err(wrong("its end is missing"));
    }
    let decoder = JpegDecoder::new(Cursor::new(bytes)).map_err(|error| wrong(&error.to_string()))?;
    DynamicImage::from_decoder(decoder).map_err(|error| wrong(&error.to_string()))
}

fn segments(source: &mut impl Read) -> io::Result<Segments> {
    let mut found = Segments { size: [0, 0], bits: 8, components: 0, exif: 1, scan: 2 };
    take(source, 2)?;
    for _ in 0..MOST_STEPS {
        let marker = take(source, 1)?[0];
        let mut kind = take(source, 1)?[0];
        found.scan += 2;
        // Fill bytes may precede a marker.
        while kind == 0xff && found.scan < MOST_STEPS {
            kind = take(source, 1)?[0];
            found.scan += 1;
        }
        match (marker, kind) {
            (0xff, 0xda) if found.components > 0 => return Ok(found),
            // These have no length.
            (0xff, 0x01 | 0xd0..=0xd7) => {}
            (0xff, 0xc0..=0xfe) => {
                let length = take(source, 2)?;
                let length = usize::from(u16::from_be_bytes([length[0], length[1]]));
                found.note(kind, &take(source, length.saturating_sub(2))?);
                found.scan += length;
            }
            _ => break,
        }
    }
    Err(io::Error::new(io::ErrorKind::InvalidData, "its header is not one of a JPEG"))
}

impl Segments {
    /// Takes what a segment says.
    fn note(&mut self, kind: u8, body: &[u8]) {
        match (kind, body) {
            (0xc4 | 0xc8 | 0xcc, _) => {}
            (0xc0..=0xcf, &[bits, h1, h0, w1, w0, components, ..]) => {
                let side = |bytes: [u8; 2]| u32::from(u16::from_be_bytes(bytes));
                self.size = [side([w1, w0]), side([h1, h0])];
                (self.bits, self.components) = (bits, components);
            }
            (0xe1, [b'E', b'x', b'i', b'f', 0, 0, chunk @ ..]) if self.exif == 1 => {
                // With a damaged EXIF block, pixels stay as they are stored.
                self.exif = ExifOrientation::from_exif_chunk(chunk).map_or(1, ExifOrientation::to_exif);
            }
            _ => {}
        }
    }
}

fn take(source: &mut impl Read, count: usize) -> io::Result<Vec<u8>> {
    let mut bytes = vec![0; count];
    source.read_exact(&mut bytes).map_err(|error| match error.kind() {
        io::ErrorKind::UnexpectedEof => io::Error::new(error.kind(), "it ends in its header"),
        _ => error,
    })?;
    Ok(bytes)
}
