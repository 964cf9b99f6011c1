//! Formats of image files by their first bytes and names, what to do with those that are not read,
//! what a header says, and samples.

use lobelia_geometry::error::{Error, Result};
use std::path::Path;

/// Decoded size in bytes above which a file is refused.
pub(crate) const MAX_DECODED_BYTES: usize = 1 << 31;

/// File formats that can be read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// PNG, 8 or 16 bit, or fewer.
    Png,
    /// JPEG, 8 bit.
    Jpeg,
    /// TIFF, 8 or 16 bit, or float.
    Tiff,
    /// WebP, lossy or lossless.
    Webp,
    /// OpenEXR.
    Exr,
    /// Radiance HDR.
    Hdr,
}

/// Extensions of image files that can be read, in the order in which they are tried.
pub const IMAGE_EXTENSIONS: [&str; 8] = ["exr", "png", "jpg", "jpeg", "tif", "tiff", "webp", "hdr"];

/// Extensions of cameras' RAW files. Most of these are TIFF inside, whose first picture is a
/// preview.
const RAW_EXTENSIONS: [&str; 22] = [
    "3fr", "arw", "cr2", "cr3", "crw", "dcr", "dng", "erf", "iiq", "kdc", "mrw", "nef", "nrw", "orf", "pef",
    "raf", "rw2", "rwl", "sr2", "srf", "srw", "x3f",
];

/// Extensions of other image files that are not read: what they are and what to do is told by their
/// first bytes.
const FOREIGN_EXTENSIONS: [&str; 16] = [
    "heic", "heif", "hif", "avif", "jxl", "jp2", "j2k", "gif", "bmp", "psd", "pgm", "ppm", "pnm", "pfm",
    "qoi", "tga",
];

/// True for a file that is named as an image of a format that is not read.
pub fn is_unread_name(path: &Path) -> bool {
    has_extension(path, &RAW_EXTENSIONS) || has_extension(path, &FOREIGN_EXTENSIONS)
}

/// First bytes of cameras' RAW files that are no TIFF, and of those that say so within TIFF.
const RAW_STARTS: [(usize, &[u8]); 9] = [
    (8, b"CR\x02\0"),
    (0, b"FUJIFILMCCD-RAW"),
    (0, b"IIRO"),
    (0, b"IIRS"),
    (0, b"MMOR"),
    (0, b"IIU\0"),
    (0, b"FOVb"),
    (6, b"HEAPCCDR"),
    (4, b"ftypcrx "),
];

const STARTS: [(usize, &[u8], Format); 10] = [
    (0, b"\x89PNG\r\n\x1a\n", Format::Png),
    (0, b"\xff\xd8\xff", Format::Jpeg),
    (0, b"II*\0", Format::Tiff),
    (0, b"MM\0*", Format::Tiff),
    (0, b"II+\0", Format::Tiff),
    (0, b"MM\0+", Format::Tiff),
    (8, b"WEBPVP8", Format::Webp),
    (0, b"\x76\x2f\x31\x01", Format::Exr),
    (0, b"#?RADIANCE", Format::Hdr),
    (0, b"#?RGBE", Format::Hdr),
];

const MAGICK: &str = "Convert it, e.g. with ImageMagick: `magick FILE FILE.png`.";
const HEIC: &str = "Convert all of them with `heif-convert FILE.heic FILE.jpg` or ImageMagick's `magick mogrify -format jpg *.heic`, or set \
                    the camera to JPEG.";

const VIDEO: &str = "a video";
const FRAMES: &str = "`lobelia prepare FILE DATA` makes a data set of it; `ffmpeg -i FILE -qscale:v 2 images/%04d.jpg` takes its frames.";

/// Other contents that are often found: first bytes, name, and remedy.
const FOREIGN: [(usize, &[u8], &str, &str); 13] = [
    (4, b"ftypavi", "an AVIF", "Convert it with `avifdec FILE.avif FILE.png`."),
    (4, b"ftyphe", "a HEIC", HEIC),
    (4, b"ftypmif1", "a HEIC", HEIC),
    (4, b"ftypmsf1", "a HEIC", HEIC),
    (4, b"ftyp", VIDEO, FRAMES),
    (0, b"\x1a\x45\xdf\xa3", VIDEO, FRAMES),
    (8, b"AVI ", VIDEO, FRAMES),
    (0, b"\0\0\x01\xba", VIDEO, FRAMES),
    (0, b"\0\0\0\x0cJXL ", "a JPEG XL", "Convert it with `djxl FILE.jxl FILE.png`."),
    (0, b"\xff\x0a", "a JPEG XL", "Convert it with `djxl FILE.jxl FILE.png`."),
    (0, b"GIF8", "a GIF", MAGICK),
    (0, b"<", "a web page or other text", "Fetch the file again: a server's answer was saved in its place."),
    (0, b"version https://git-lfs", "a Git LFS pointer", "Fetch the files themselves with `git lfs pull`."),
];

/// Whether a file with these first bytes is a video, of MP4, `QuickTime`, Matroska, `WebM`, AVI or
/// MPEG.
pub fn is_video_start(start: &[u8]) -> bool {
    let first = FOREIGN.iter().find(|(at, magic, ..)| starts(start, *at, magic));
    !is_raw(start) && first.is_some_and(|(_, _, name, _)| *name == VIDEO)
}

fn is_raw(start: &[u8]) -> bool {
    RAW_STARTS.iter().any(|(at, magic)| starts(start, *at, magic))
}

fn starts(bytes: &[u8], at: usize, with: &[u8]) -> bool {
    bytes.get(at..).is_some_and(|rest| rest.starts_with(with))
}

/// Whether a path has one of these extensions, in any case.
pub(crate) fn has_extension(path: &Path, known: &[&str]) -> bool {
    path.extension().is_some_and(|own| known.iter().any(|known| own.eq_ignore_ascii_case(known)))
}

impl Format {
    /// "a PNG", for messages.
    pub fn name(self) -> &'static str {
        match self {
            Self::Png => "a PNG",
            Self::Jpeg => "a JPEG",
            Self::Tiff => "a TIFF",
            Self::Webp => "a WebP",
            Self::Exr => "an OpenEXR",
            Self::Hdr => "a Radiance HDR",
        }
    }
}

/// The format of a file with these first bytes, whatever its name; a RAW file's name counts, since
/// many are TIFF inside.
///
/// # Errors
/// [`Error::Input`] with what to do if the file is in another format, or a camera's RAW file.
pub(super) fn recognize(path: &Path, start: &[u8]) -> Result<Format> {
    let format = STARTS.iter().find(|(at, magic, _)| starts(start, *at, magic)).map(|&(.., format)| format);
    let may_be_raw = matches!(format, None | Some(Format::Tiff)) && has_extension(path, &RAW_EXTENSIONS);
    if is_raw(start) || may_be_raw {
        return Err(raw(path));
    }
    format.ok_or_else(|| match FOREIGN.iter().find(|(at, magic, ..)| starts(start, *at, magic)) {
        Some((.., name, help)) => Error::input(path, "", format!("this is {name}, which is not read"), *help),
        None => {
            let problem = "the contents are neither PNG, JPEG, TIFF, WebP, OpenEXR nor Radiance HDR";
            Error::input(path, "", problem, format!("Copy it again. {MAGICK}"))
        }
    })
}

/// The error for a camera's RAW file.
pub(super) fn raw(path: &Path) -> Error {
    let help = "Develop all of them with the same settings to 16-bit PNG or TIFF: with `darktable-cli`, or with \
                `dcraw -w -4 -T FILE`, whose TIFF is linear (say `gamma: Linear`).";
    Error::input(path, "", "this is a camera's RAW file, which is not read", help)
}

/// The error for a file that is damaged; `what` is "a PNG", `why` a clause.
pub(super) fn damaged(path: &Path, format: Format, why: &str) -> Error {
    let problem = format!("{} that is damaged or truncated: {why}", format.name());
    Error::input(path, "", problem, "Copy or convert the file again.")
}

/// Pixels of the largest image that is read: 16 384 × 16 384.
const MOST_PIXELS: u64 = LONGEST_SIDE * LONGEST_SIDE;
const LONGEST_SIDE: u64 = 16_384;

/// The treatment of the EXIF orientation of a file, the number that says how the camera was held.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Orientation {
    /// Pixels as they lie in the file, which is what COLMAP reads.
    AsStored,
    /// Pixels turned as the file asks, which is what viewers show.
    #[default]
    Upright,
}

/// The header of an image file.
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
    /// Bits per sample: 8, or 16, or 32 (of 32-bit floats; 16 with `is_float` are half floats).
    /// Fewer than 8 are decoded to 8.
    pub bits: u32,
    /// True for linear floats, false for integers.
    pub is_float: bool,
    /// EXIF orientation, 1 to 8; 1 where the file says nothing.
    pub exif: u8,
}

impl ImageHeader {
    /// True if there is an alpha channel.
    pub fn has_alpha(&self) -> bool {
        self.channels.is_multiple_of(2)
    }

    /// Width and height in pixels with this treatment of the EXIF orientation.
    pub fn size(&self, orientation: Orientation) -> [u32; 2] {
        let is_turned = orientation == Orientation::Upright && self.exif >= 5;
        if is_turned { [self.height, self.width] } else { [self.width, self.height] }
    }

    /// Bytes of the decoded samples.
    pub fn decoded_bytes(&self) -> u64 {
        let of_sample = if self.is_float { 4 } else { u64::from(self.bits / 8) };
        u64::from(self.width) * u64::from(self.height) * self.channels as u64 * of_sample
    }
}

/// Samples of an image, rows from the top down, the samples of a pixel side by side.
#[derive(Clone, Debug, PartialEq)]
pub enum ImageSamples {
    /// Integers of 8 bits, with straight alpha: colors are not multiplied by it.
    Bytes8(Vec<u8>),
    /// Integers of 16 bits, with straight alpha.
    Words16(Vec<u16>),
    /// Linear floats, with alpha multiplied into the colors.
    Floats(Vec<f32>),
}

impl ImageSamples {
    /// Number of samples.
    pub fn count(&self) -> usize {
        match self {
            Self::Bytes8(samples) => samples.len(),
            Self::Words16(samples) => samples.len(),
            Self::Floats(samples) => samples.len(),
        }
    }
}

/// Checks that an image of this size is read, that its pixels fit into memory, and that a file of
/// so many bytes can hold them.
pub(super) fn check_size(path: &Path, header: &ImageHeader, file_bytes: u64) -> Result<()> {
    let ImageHeader { format, width, height, .. } = *header;
    let (pixels, decoded) = (u64::from(width) * u64::from(height), header.decoded_bytes());
    if pixels == 0 {
        return Err(damaged(path, format, &format!("its size is {width}×{height}")));
    }
    // A JPEG is read as a whole, the others piece by piece.
    let held = if format == Format::Jpeg { decoded.max(file_bytes) } else { decoded };
    if pixels > MOST_PIXELS || held > MAX_DECODED_BYTES as u64 {
        let [held, most] = [held, MAX_DECODED_BYTES as u64].map(|bytes| bytes >> 20);
        let problem = format!(
            "its header declares {width}×{height} pixels in {held} MiB, more than {LONGEST_SIDE}×{LONGEST_SIDE} in {most} MiB, the most that is read"
        );
        let help = "Reduce its size, e.g. with `magick FILE -resize 50% FILE`, or save it with 8 or 16 bits. If it is not that large, copy it again.";
        return Err(Error::input(path, "", problem, help));
    }
    // The most that any of these saves: LZW, of eight pixels in a byte. WebP needs no more for a
    // single color, and the header of an EXR is checked with its channels.
    let has_least = !matches!(format, Format::Webp | Format::Exr);
    if has_least && file_bytes < pixels / 8 / 4096 {
        let why =
            format!("its header declares {width}×{height} pixels, more than {file_bytes} bytes can hold");
        return Err(damaged(path, format, &why));
    }
    Ok(())
}
