//! The photographs of a folder: which files, what their headers say, and copies of them that no
//! program turns.
//!
//! COLMAP takes pixels as they are stored and ignores EXIF's orientation. So that every other
//! program does the same, a photograph that EXIF turns is copied with that entry reset; its pixels
//! stay as they are.

use crate::{prepare::work::make_folder_of, progress::Progress};
use image::{ImageFormat, codecs::png::PngEncoder, metadata::Orientation};
use lobelia_geometry::{Error, Result, error::stop::check_interrupted, parallel};
use lobelia_io::codec::file::{read_bytes, read_folder};
use lobelia_io::codec::image::Orientation::AsStored;
use lobelia_io::codec::image::{
    Format, IMAGE_EXTENSIONS, decode, decode_samples, exif_block, image_header, is_unread_name,
};
use lobelia_io::codec::nearby::{missing_file_help, natural_order};
use std::{collections::BTreeMap, collections::BTreeSet, fs, path::Path, path::PathBuf};

/// Fewest photographs that cameras can be found for.
pub(super) const FEWEST: usize = 3;
/// Extensions of video files.
pub(super) const VIDEOS: &[&str] = &["mp4", "mov", "m4v", "mkv", "webm", "avi", "mpg", "mpeg", "mts", "m2ts"];
/// Most bytes of pixels that are decoded at once.
const MOST_DECODED: u64 = 1 << 30;
/// Help for a photograph that is damaged.
const DAMAGED_HELP: &str = "Copy it again, or remove it.";

/// A photograph, by its header.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct PhotographFile {
    /// The file that was given.
    pub source: PathBuf,
    /// Its path below the folder of photographs in the data set.
    pub name: String,
    /// Width and height as stored.
    pub size: [u32; 2],
    /// How EXIF says that the stored pixels are to be turned.
    pub orientation: Orientation,
    /// Whether it has an alpha channel.
    pub has_alpha: bool,
    /// Whether it has 16 bits per channel.
    pub is_deep: bool,
    /// Focal length of EXIF in hundredths of a millimeter.
    focal: Option<u32>,
}

/// Lists the photographs of a folder, its JPEG and PNG files, in natural order of their names;
/// notes say what is left out. Where their sizes or focal lengths differ, `name` has a folder for
/// each.
pub(super) fn list(folder: &Path, progress: &dyn Progress) -> Result<Vec<PhotographFile>> {
    let (mut files, mut others) = (Vec::new(), BTreeMap::<String, usize>::new());
    for entry in read_folder(folder)? {
        let path = entry.map_err(Error::io("read", folder))?.path();
        let extension = path.extension().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
        let is_hidden = path.file_name().is_some_and(|name| name.to_string_lossy().starts_with('.'));
        let is_known = || IMAGE_EXTENSIONS.iter().chain(VIDEOS).any(|known| extension == *known);
        if is_hidden || path.is_dir() {
            continue;
        }
        // What is called as a photograph and is no file, or may not be read, is refused where it is
        // opened.
        if ["jpg", "jpeg", "png"].contains(&extension.as_str()) {
            files.push(path);
        } else if is_unread_name(&path) || is_known() {
            *others.entry(extension).or_default() += 1;
        }
    }
    if files.len() < FEWEST {
        return Err(too_few(folder, files.len(), &others));
    }
    files.sort_by(|a, b| natural_order(&a.to_string_lossy(), &b.to_string_lossy()));
    let mut photographs = files.iter().map(|path| header(path)).collect::<Result<Vec<_>>>()?;
    let mut stems = BTreeSet::new();
    if let Some(twice) = files.iter().find(|path| !stems.insert(path.with_extension(""))) {
        let problem = "another photograph has the same name with another extension";
        return Err(Error::input(twice, "", problem, "Rename one of them, or remove it."));
    }
    // COLMAP's cameras per folder are one of each group of equal size and focal length.
    if photographs.iter().any(|p| (p.size, p.focal) != (photographs[0].size, photographs[0].focal)) {
        for PhotographFile { name, size: [width, height], focal, .. } in &mut photographs {
            let focal = focal.map_or_else(String::new, |f| format!("_{}mm", f64::from(f) / 100.0));
            *name = format!("{width}x{height}{focal}/{name}");
        }
    }
    for (extension, count) in others {
        let note = format!("{count} .{extension} files are left out: only JPEG and PNG photographs are used");
        let is_heic = ["heic", "heif"].contains(&extension.as_str());
        progress.note(&if is_heic { format!("{note}; {}", conversion(&extension)) } else { note });
    }
    Ok(photographs)
}

/// The error for a folder with `found` photographs, beside others of these extensions.
fn too_few(folder: &Path, found: usize, others: &BTreeMap<String, usize>) -> Error {
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

fn header(path: &Path) -> Result<PhotographFile> {
    let header = image_header(path)?;
    let named =
        if ImageFormat::from_path(path).ok() == Some(ImageFormat::Png) { Format::Png } else { Format::Jpeg };
    if header.format != named {
        let what = match header.format {
            Format::Jpeg => "a JPEG",
            Format::Png => "a PNG",
            _ => "neither JPEG nor PNG",
        };
        let problem = format!("the file is not what its name says: it holds {what}");
        return Err(Error::input(path, "", problem, "Rename or convert it."));
    }
    Ok(PhotographFile {
        source: path.to_owned(),
        name: path.file_name().unwrap_or_default().to_string_lossy().into_owned(),
        size: [header.width, header.height],
        orientation: Orientation::from_exif(header.exif).unwrap_or(Orientation::NoTransforms),
        has_alpha: header.has_alpha(),
        is_deep: header.bits > 8,
        focal: focal_length(exif_block(path)?),
    })
}

/// The focal length of an EXIF block in hundredths of a millimeter.
fn focal_length(chunk: Vec<u8>) -> Option<u32> {
    let block = exif::Reader::new().read_raw(chunk).ok()?;
    let field = block.get_field(exif::Tag::FocalLength, exif::In::PRIMARY)?;
    let exif::Value::Rational(values) = &field.value else { return None };
    let hundredths = (100.0 * values.first()?.to_f64()).round();
    (hundredths > 0.0 && hundredths < 1e9).then_some(hundredths as u32)
}

/// Decodes every photograph, some at once: COLMAP would take what is left of one that is cut off
/// for the whole.
pub(super) fn check_pixels(photographs: &[PhotographFile], progress: &dyn Progress) -> Result<()> {
    let bar = progress.bar("photographs", photographs.len() as u64);
    // Up to four channels of 8 or 16 bits.
    let bytes =
        |p: &PhotographFile| u64::from(p.size[0]) * u64::from(p.size[1]) * if p.is_deep { 8 } else { 4 };
    let largest = photographs.iter().map(bytes).max().unwrap_or_default().max(1);
    let at_once = (MOST_DECODED / largest).clamp(1, rayon::current_num_threads() as u64) as usize;
    let decoded = |photograph: &PhotographFile| {
        decode_samples(&photograph.source, AsStored).map(drop).map_err(|mut error| {
            if let Error::Input { help, .. } = &mut error {
                DAMAGED_HELP.clone_into(help);
            }
            error
        })
    };
    for group in photographs.chunks(at_once) {
        check_interrupted()?;
        let decoded: Vec<Result<()>> = parallel::map_slice(group, 1, decoded);
        decoded.into_iter().collect::<Result<()>>()?;
        bar.inc(group.len() as u64);
    }
    Ok(())
}

/// Puts the photographs under their names into `folder`, as links where that is possible.
pub(super) fn place(photographs: &[PhotographFile], folder: &Path) -> Result<()> {
    for photograph in photographs {
        let to = folder.join(&photograph.name);
        make_folder_of(&to)?;
        if photograph.orientation == Orientation::NoTransforms {
            link(&photograph.source, &to)?;
        } else {
            fs::write(&to, unturned(&photograph.source)?).map_err(Error::io("write", &to))?;
        }
    }
    Ok(())
}

#[cfg(unix)]
fn link(from: &Path, to: &Path) -> Result<()> {
    let whole = from.canonicalize().map_err(Error::io("read", from))?;
    std::os::unix::fs::symlink(whole, to).map_err(Error::io("create", to))
}

#[cfg(not(unix))]
fn link(from: &Path, to: &Path) -> Result<()> {
    fs::copy(from, to).map(|_| ()).map_err(Error::io("copy", from))
}

/// A photograph's bytes with EXIF's orientation reset: of a JPEG two bytes change, a PNG is written
/// again without EXIF.
fn unturned(path: &Path) -> Result<Vec<u8>> {
    let mut bytes = read_bytes(path, missing_file_help)?;
    if !bytes.starts_with(&[0xff, 0xd8]) {
        let mut written = Vec::new();
        let wrong = |problem: String| Error::input(path, "", problem, DAMAGED_HELP);
        let pixels = decode(&bytes).map_err(|error| wrong(error.to_string()))?;
        let encoded = pixels.write_with_encoder(PngEncoder::new(&mut written));
        encoded.map_err(|error| wrong(format!("the photograph cannot be written anew: {error}")))?;
        return Ok(written);
    }
    let chunk = exif_block(path)?;
    if chunk.is_empty() {
        return Ok(bytes);
    }
    let mut reset = chunk.clone();
    let turned = Orientation::remove_from_exif_chunk(&mut reset).is_some();
    let at = bytes.windows(chunk.len()).position(|window| window == chunk);
    if let Some(at) = at.filter(|_| turned) {
        bytes[at..at + reset.len()].copy_from_slice(&reset);
    }
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::progress::{RecordedMessages, Silent};
    use image::{ImageEncoder, RgbImage, Rgba, RgbaImage, codecs::jpeg::JpegEncoder};
    use std::sync::Arc;
    use tempfile::TempDir;

    /// A little-endian EXIF block with an orientation and a focal length in millimeters.
    fn exif_block(orientation: u16, focal: u32) -> Vec<u8> {
        let entry = |tag: u16, kind: u16, value: u32| {
            [&tag.to_le_bytes()[..], &kind.to_le_bytes(), &1u32.to_le_bytes(), &value.to_le_bytes()].concat()
        };
        let mut block = b"II*\0\x08\0\0\0".to_vec();
        block.extend(2u16.to_le_bytes());
        block.extend(entry(0x0112, 3, u32::from(orientation)));
        // The EXIF directory follows the four bytes that say that there is no other.
        block.extend(entry(0x8769, 4, 38));
        block.extend(0u32.to_le_bytes());
        block.extend(1u16.to_le_bytes());
        block.extend(entry(0x920a, 5, 56));
        block.extend(0u32.to_le_bytes());
        block.extend([focal, 1].map(u32::to_le_bytes).concat());
        block
    }

    fn jpeg(path: &Path, size: [u32; 2], block: Option<Vec<u8>>) {
        let picture = RgbImage::from_fn(size[0], size[1], |x, y| image::Rgb([x as u8 * 9, y as u8 * 9, 40]));
        let mut bytes = Vec::new();
        let mut encoder = JpegEncoder::new_with_quality(&mut bytes, 95);
        block.into_iter().for_each(|block| encoder.set_exif_metadata(block).unwrap());
        encoder.write_image(&picture, size[0], size[1], image::ExtendedColorType::Rgb8).unwrap();
        fs::write(path, bytes).unwrap();
    }

    /// A folder of JPEG files of 8 × 6 pixels, of an orientation and focal length.
    fn folder_of(files: &[(&str, u16, u32)]) -> TempDir {
        let folder = tempfile::tempdir().unwrap();
        for (name, orientation, focal) in files {
            jpeg(&folder.path().join(name), [8, 6], Some(exif_block(*orientation, *focal)));
        }
        folder
    }

    fn listed(folder: &Path) -> Vec<PhotographFile> {
        list(folder, &Silent).unwrap()
    }

    fn names(photographs: &[PhotographFile]) -> Vec<&str> {
        photographs.iter().map(|photograph| photograph.name.as_str()).collect()
    }

    #[test]
    fn photographs_are_listed_in_order_with_what_is_left_out() {
        let folder = folder_of(&[("a10.jpg", 1, 35), ("a9.jpg", 1, 35), ("a1.JPG", 1, 35)]);
        for other in ["a1.nef", "a2.NEF", "notes.txt"] {
            fs::write(folder.path().join(other), "x").unwrap();
        }
        let told = RecordedMessages::new(Arc::new(Silent));
        let photographs = list(folder.path(), &told).unwrap();
        assert_eq!(names(&photographs), ["a1.JPG", "a9.jpg", "a10.jpg"]);
        assert_eq!(photographs[0].size, [8, 6]);
        assert_eq!(told.take(), ["2 .nef files are left out: only JPEG and PNG photographs are used"]);
        fs::rename(folder.path().join("a1.nef"), folder.path().join("a1.HEIC")).unwrap();
        list(folder.path(), &told).unwrap();
        assert!(told.take()[0].contains("heif-convert"));
    }

    #[test]
    fn sizes_and_focal_lengths_have_folders() {
        let folder = folder_of(&[("a.jpg", 1, 35), ("b.jpg", 1, 50), ("d.jpg", 1, 35)]);
        jpeg(&folder.path().join("c.jpg"), [6, 8], None);
        let photographs = listed(folder.path());
        assert_eq!(names(&photographs), ["8x6_35mm/a.jpg", "8x6_50mm/b.jpg", "6x8/c.jpg", "8x6_35mm/d.jpg"]);
    }

    #[test]
    fn a_turned_photograph_keeps_its_pixels_and_loses_its_turn() {
        let folder = folder_of(&[("a.jpg", 1, 35), ("b.jpg", 6, 35), ("c.jpg", 1, 35)]);
        let photographs = listed(folder.path());
        assert_eq!((photographs[1].orientation, photographs[1].size), (Orientation::Rotate90, [8, 6]));
        assert_eq!(names(&photographs), ["a.jpg", "b.jpg", "c.jpg"], "they are of one camera");
        let out = folder.path().join("out");
        place(&photographs, &out).unwrap();
        let placed = listed(&out);
        assert!(placed.iter().all(|p| p.orientation == Orientation::NoTransforms));
        assert_eq!(placed[1].focal, Some(3500), "the rest of EXIF stays");
        let pixels = |path: &Path| image::open(path).unwrap().into_rgb8();
        assert_eq!(pixels(&out.join("b.jpg")), pixels(&folder.path().join("b.jpg")));
        assert_eq!(fs::read(out.join("a.jpg")).unwrap(), fs::read(folder.path().join("a.jpg")).unwrap());
    }

    #[test]
    fn what_png_holds_is_noticed() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["a.png", "b.png"] {
            RgbaImage::from_pixel(4, 4, Rgba([1, 2, 3, 4])).save(folder.path().join(name)).unwrap();
        }
        let deep = image::ImageBuffer::from_pixel(4, 4, image::Rgb([1u16, 2, 3]));
        image::DynamicImage::ImageRgb16(deep).save(folder.path().join("c.png")).unwrap();
        let found: Vec<_> = listed(folder.path()).iter().map(|p| (p.has_alpha, p.is_deep)).collect();
        assert_eq!(found, [(true, false), (true, false), (false, true)]);
    }

    #[cfg(unix)]
    #[test]
    fn what_is_no_file_is_refused_and_not_opened() {
        let folder = folder_of(&[("a.jpg", 1, 35), ("b.jpg", 1, 35), ("c.jpg", 1, 35)]);
        fs::create_dir(folder.path().join("folder.jpg")).unwrap();
        fs::write(folder.path().join("._a.jpg"), "a file manager's").unwrap();
        assert_eq!(listed(folder.path()).len(), 3);
        let pipe = folder.path().join("x.jpg");
        assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        let error = list(folder.path(), &Silent).unwrap_err();
        assert!(error.to_string().contains("x.jpg: this is a pipe, not a regular file"), "{error}");
        fs::remove_file(&pipe).unwrap();
        std::os::unix::fs::symlink("nowhere", &pipe).unwrap();
        let error = list(folder.path(), &Silent).unwrap_err();
        assert!(error.to_string().contains("symbolic link to nowhere") && error.exit_code() == 2, "{error}");
    }

    #[test]
    fn unusable_folders_are_refused_with_the_reason() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        let refused = |path: &Path, words: &str| {
            let error = list(path, &Silent).unwrap_err();
            let text = format!("{error} {}", error.help().unwrap_or_default());
            assert!(text.contains(words) && error.exit_code() == 2, "{words}: {text}");
        };
        refused(&at("none"), "no such folder");
        refused(folder.path(), "no JPEG or PNG photographs");
        for (name, words) in [
            ("a.heic", "1 .heic files: convert all of them with `heif-convert FILE.heic FILE.jpg`"),
            ("a.cr2", "1 .cr2 files: develop or convert"),
            ("a.mp4", "give that file instead of the folder"),
        ] {
            fs::write(at(name), "x").unwrap();
            refused(folder.path(), words);
            fs::remove_file(at(name)).unwrap();
        }
        jpeg(&at("a.jpg"), [8, 6], None);
        jpeg(&at("b.jpg"), [8, 6], None);
        refused(folder.path(), "2 JPEG or PNG photographs");
        refused(&at("a.jpg"), "a file, not a folder");
        for (name, bytes, words) in [
            ("c.png", fs::read(at("a.jpg")).unwrap(), "it holds a JPEG"),
            ("c.png", b"no picture".to_vec(), "neither PNG, JPEG"),
            ("c.jpg", vec![0xff, 0xd8, 0xff, 0xe0, 0, 4], "damaged"),
        ] {
            fs::write(at(name), bytes).unwrap();
            refused(folder.path(), words);
            fs::remove_file(at(name)).unwrap();
        }
        RgbImage::new(8, 6).save(at("b.png")).unwrap();
        refused(folder.path(), "same name with another extension");
    }
}
