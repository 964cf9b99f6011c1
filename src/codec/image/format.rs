//! Formats of image files: by their first bytes, by their names, and what to do with those that are not read.

use crate::error::{Error, Result};
use std::path::Path;

/// File formats that can be read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
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

/// Extensions of cameras' RAW files. Most of these are TIFF inside, whose first picture is a preview.
const RAW_EXTENSIONS: [&str; 22] = [
    "3fr", "arw", "cr2", "cr3", "crw", "dcr", "dng", "erf", "iiq", "kdc", "mrw", "nef", "nrw", "orf", "pef",
    "raf", "rw2", "rwl", "sr2", "srf", "srw", "x3f",
];

/// Extensions of other image files that are not read: what they are and what to do is told by their first bytes.
const FOREIGN_EXTENSIONS: [&str; 16] = [
    "heic", "heif", "hif", "avif", "jxl", "jp2", "j2k", "gif", "bmp", "psd", "pgm", "ppm", "pnm", "pfm",
    "qoi", "tga",
];

/// Whether a file is named as an image of a format that is not read.
pub(crate) fn is_unread_name(path: &Path) -> bool {
    let is_one = |name: &str| RAW_EXTENSIONS.contains(&name) || FOREIGN_EXTENSIONS.contains(&name);
    extension(path).is_some_and(|name| is_one(&name))
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

/// What else is often found: the first bytes, the name, and what to do.
const FOREIGN: [(usize, &[u8], &str, &str); 20] = [
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
    (0, b"\0\0\0\x0cjP  ", "a JPEG 2000", MAGICK),
    (0, b"GIF8", "a GIF", MAGICK),
    (0, b"BM", "a BMP", MAGICK),
    (0, b"8BPS", "a Photoshop document", MAGICK),
    (0, b"P5", "a PGM", MAGICK),
    (0, b"P6", "a PPM", MAGICK),
    (0, b"PF", "a PFM", MAGICK),
    (0, b"qoif", "a QOI", MAGICK),
    (0, b"<", "a web page or other text", "Fetch the file again: a server's answer was saved in its place."),
    (0, b"version https://git-lfs", "a Git LFS pointer", "Fetch the files themselves with `git lfs pull`."),
];

/// Whether a file with these first bytes is a video, of MP4, `QuickTime`, Matroska, `WebM`, AVI or MPEG.
pub(crate) fn is_video_start(start: &[u8]) -> bool {
    let is_raw = RAW_STARTS.iter().any(|(at, magic)| starts(start, *at, magic));
    let first = FOREIGN.iter().find(|(at, magic, ..)| starts(start, *at, magic));
    !is_raw && first.is_some_and(|(_, _, name, _)| *name == VIDEO)
}

fn starts(bytes: &[u8], at: usize, with: &[u8]) -> bool {
    bytes.get(at..).is_some_and(|rest| rest.starts_with(with))
}

fn extension(path: &Path) -> Option<String> {
    Some(path.extension()?.to_str()?.to_ascii_lowercase())
}

impl Format {
    fn from_bytes(bytes: &[u8]) -> Option<Self> {
        STARTS.iter().find(|(at, start, _)| starts(bytes, *at, start)).map(|&(.., format)| format)
    }

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

/// The format of a file with these first bytes, whatever its name; a RAW file's name counts, since many are TIFF inside.
///
/// # Errors
/// [`Error::Input`] with what to do if the file is in another format, or a camera's RAW file.
pub(super) fn recognize(path: &Path, start: &[u8]) -> Result<Format> {
    let format = Format::from_bytes(start);
    let is_named_raw = extension(path).is_some_and(|name| RAW_EXTENSIONS.contains(&name.as_str()));
    let is_raw = RAW_STARTS.iter().any(|(at, magic)| starts(start, *at, magic));
    if is_raw || (is_named_raw && matches!(format, None | Some(Format::Tiff))) {
        return Err(raw(path));
    }
    let Some(format) = format else {
        let foreign = FOREIGN.iter().find(|(at, magic, ..)| starts(start, *at, magic));
        return Err(match foreign {
            Some((_, _, name, help)) => {
                Error::input(path, "", format!("this is {name}, which is not read"), *help)
            }
            None => {
                let problem = "the contents are neither PNG, JPEG, TIFF, WebP, OpenEXR nor Radiance HDR";
                Error::input(path, "", problem, "Convert the image to one of these, or copy it again.")
            }
        });
    };
    Ok(format)
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
