//! Which files of a folder are used: how many are needed, what is left out, and how that is made readable.

use crate::error::Error;
use std::collections::BTreeMap;
use std::path::Path;

/// Fewest photographs that cameras can be found for.
pub(super) const FEWEST: usize = 3;
/// Extensions of video files.
pub(super) const VIDEOS: [&str; 10] =
    ["mp4", "mov", "m4v", "mkv", "webm", "avi", "mpg", "mpeg", "mts", "m2ts"];
/// Formats of photographs that are not given to COLMAP, which reads only some of them on some machines, by extension.
pub(super) const UNREADABLE: [&str; 16] = [
    "heic", "heif", "avif", "webp", "tif", "tiff", "dng", "cr2", "cr3", "nef", "arw", "raf", "orf", "rw2",
    "exr", "hdr",
];

/// What the user should know of so many files with this extension.
pub(super) fn note_of_left_out(extension: &str, count: usize) -> String {
    let note = format!("{count} .{extension} files are left out: only JPEG and PNG photographs are used");
    let is_heic = ["heic", "heif"].contains(&extension);
    if is_heic { format!("{note}; {}", conversion(extension)) } else { note }
}

/// The error for a folder with `found` photographs, beside others of these extensions.
pub(super) fn too_few(folder: &Path, found: usize, others: &BTreeMap<String, usize>) -> Error {
    let problem = match found {
        0 => "there are no JPEG or PNG photographs in this folder".to_owned(),
        n => format!("{n} JPEG or PNG photographs are in this folder, and cameras need at least {FEWEST}"),
    };
    let help = match others.iter().max_by_key(|(_, count)| **count) {
        Some((extension, _)) if VIDEOS.contains(&extension.as_str()) => {
            format!("It has a .{extension} file: give that file instead of the folder.")
        }
        Some((extension, count)) => format!("It has {count} .{extension} files: {}.", conversion(extension)),
        None if found > 0 => "Take 20 or more from all sides, each overlapping the next.".to_owned(),
        None => "Give the folder that has them directly in it: folders inside are not searched.".to_owned(),
    };
    Error::input(folder, "", problem, help)
}

/// How photographs with this extension are made readable.
fn conversion(extension: &str) -> String {
    match extension {
        "heic" | "heif" => format!(
            "convert all of them with `heif-convert FILE.{extension} FILE.jpg` (libheif) or `magick mogrify -format jpg *.{extension}` \
             (ImageMagick), or set the camera to JPEG"
        ),
        "tif" | "tiff" => format!(
            "convert all of them with `magick mogrify -format png *.{extension}` (ImageMagick), which keeps 16 bits"
        ),
        _ => "develop or convert them to JPEG or 16-bit PNG, all with the same settings".to_owned(),
    }
}
