//! The photographs of a folder: which files, what their headers say, and copies of them that no program turns.
//!
//! COLMAP takes pixels as they are stored and ignores EXIF's orientation. So that every other program does the same, a photograph
//! that EXIF turns is copied with that entry reset; its pixels stay as they are.

use crate::codec::file::{open, read_bytes, read_folder};
use crate::codec::image::Orientation::AsStored;
use crate::codec::image::decode_samples;
use crate::codec::nearby::{missing_file_help, natural_order};
use crate::error::stop::check_interrupted;
use crate::error::{Error, Result};
use crate::pass::progress::Progress;
use crate::prepare::left_out::{FEWEST, UNREADABLE, VIDEOS, note_of_left_out, too_few};
use image::metadata::Orientation;
use image::{ImageDecoder, ImageFormat, ImageReader};
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io::Cursor;
use std::path::{Path, PathBuf};

/// Most bytes of pixels that are decoded at once.
const MOST_DECODED: u64 = 1 << 30;
/// What to do about a photograph that is damaged.
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

/// Photographs of a folder, with notes for the user.
pub(super) struct Listing {
    /// In natural order of their names.
    pub photographs: Vec<PhotographFile>,
    pub notes: Vec<String>,
}

/// Lists the photographs of a folder: its JPEG and PNG files. Where their sizes or focal lengths differ, `name` has a folder for each.
///
/// # Errors
/// [`Error::Input`] if the folder is missing, has fewer than three photographs, or one of them is damaged or not what its name says;
/// or if two have the same name but for the extension.
pub(super) fn list(folder: &Path) -> Result<Listing> {
    if !folder.is_dir() {
        let what = if folder.exists() { "this is a file, not a folder" } else { "there is no such folder" };
        let help = "Give a folder of JPEG or PNG photographs, or a video file.";
        return Err(Error::input(folder, "", what, help));
    }
    let (mut files, others) = files_in(folder)?;
    if files.len() < FEWEST {
        return Err(too_few(folder, files.len(), &others));
    }
    files.sort_by(|a, b| natural_order(&a.to_string_lossy(), &b.to_string_lossy()));
    let mut photographs = files.iter().map(|path| header(path)).collect::<Result<Vec<_>>>()?;
    refuse_same_stems(&photographs)?;
    sort_into_folders(&mut photographs);
    let notes = others.iter().map(|(extension, count)| note_of_left_out(extension, *count)).collect();
    Ok(Listing { photographs, notes })
}

/// The files of a folder that are called as photographs, and how many others that photographs or films could be have each extension.
fn files_in(folder: &Path) -> Result<(Vec<PathBuf>, BTreeMap<String, usize>)> {
    let (mut files, mut others) = (Vec::new(), BTreeMap::new());
    for entry in read_folder(folder)? {
        let path = entry.map_err(Error::io("read", folder))?.path();
        let extension = path.extension().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
        let is_hidden = path.file_name().is_some_and(|name| name.to_string_lossy().starts_with('.'));
        if is_hidden || path.is_dir() {
            continue;
        }
        // What is called as a photograph and is no file, or may not be read, is refused where it is opened.
        if ["jpg", "jpeg", "png"].contains(&extension.as_str()) {
            files.push(path);
        } else if UNREADABLE.iter().chain(&VIDEOS).any(|known| extension == *known) {
            *others.entry(extension).or_default() += 1;
        }
    }
    Ok((files, others))
}

fn refuse_same_stems(photographs: &[PhotographFile]) -> Result<()> {
    let mut stems = BTreeSet::new();
    let twice = photographs.iter().find(|photograph| !stems.insert(photograph.source.with_extension("")));
    twice.map_or(Ok(()), |photograph| {
        let problem = "another photograph has the same name with another extension";
        Err(Error::input(&photograph.source, "", problem, "Rename one of them, or remove it."))
    })
}

/// COLMAP's cameras per folder are one of each group of equal size and focal length.
fn sort_into_folders(photographs: &mut [PhotographFile]) {
    let group = |photograph: &PhotographFile| (photograph.size, photograph.focal);
    let groups: BTreeSet<_> = photographs.iter().map(group).collect();
    if groups.len() < 2 {
        return;
    }
    for photograph in photographs {
        let [width, height] = photograph.size;
        let focal = photograph.focal.map_or_else(String::new, |f| format!("_{}mm", f64::from(f) / 100.0));
        photograph.name = format!("{width}x{height}{focal}/{}", photograph.name);
    }
}

/// How many folders the photographs' names have.
pub(super) fn folders(photographs: &[PhotographFile]) -> usize {
    let folder = |photograph: &PhotographFile| Path::new(&photograph.name).parent().map(Path::to_owned);
    photographs.iter().map(folder).collect::<BTreeSet<_>>().len()
}

fn header(path: &Path) -> Result<PhotographFile> {
    let damaged = |error: image::ImageError| {
        let problem = format!("the photograph cannot be read: {error}");
        Error::input(path, "", problem, DAMAGED_HELP)
    };
    let reader = ImageReader::new(open(path, missing_file_help)?);
    let reader = reader.with_guessed_format().map_err(Error::io("read", path))?;
    let format = reader.format();
    if format != ImageFormat::from_path(path).ok() {
        let what = match format {
            Some(ImageFormat::Jpeg) => "it holds a JPEG".to_owned(),
            Some(ImageFormat::Png) => "it holds a PNG".to_owned(),
            _ => "it holds neither JPEG nor PNG".to_owned(),
        };
        let problem = format!("the file is not what its name says: {what}");
        return Err(Error::input(path, "", problem, "Rename or convert it."));
    }
    let mut decoder = reader.into_decoder().map_err(damaged)?;
    let (width, height) = decoder.dimensions();
    let chunk = decoder.exif_metadata().ok().flatten().unwrap_or_default();
    let Some(name) = path.file_name().and_then(|name| name.to_str()) else {
        return Err(Error::input(path, "", "the name of the file is not UTF-8", "Rename it."));
    };
    let color = decoder.color_type();
    Ok(PhotographFile {
        source: path.to_owned(),
        name: name.to_owned(),
        size: [width, height],
        orientation: Orientation::from_exif_chunk(&chunk).unwrap_or(Orientation::NoTransforms),
        has_alpha: color.has_alpha(),
        is_deep: color.bytes_per_pixel() > color.channel_count(),
        focal: focal_length(chunk),
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

/// Decodes every photograph, some at once: COLMAP would take what is left of one that is cut off for the whole.
///
/// # Errors
/// [`Error::Input`] that names the first photograph that is damaged, cut off or of a kind that is not read; [`Error::Interrupted`] after
/// Ctrl-C.
pub(super) fn check_pixels(photographs: &[PhotographFile], progress: &dyn Progress) -> Result<()> {
    let bar = progress.bar("photographs", photographs.len() as u64);
    // Up to four channels of 8 or 16 bits.
    let bytes =
        |p: &PhotographFile| u64::from(p.size[0]) * u64::from(p.size[1]) * if p.is_deep { 8 } else { 4 };
    let largest = photographs.iter().map(bytes).max().unwrap_or_default().max(1);
    let at_once = (MOST_DECODED / largest).clamp(1, rayon::current_num_threads() as u64) as usize;
    for group in photographs.chunks(at_once) {
        check_interrupted()?;
        let decoded: Vec<Result<()>> = group.par_iter().map(check_decodes).collect();
        decoded.into_iter().collect::<Result<()>>()?;
        bar.inc(group.len() as u64);
    }
    bar.finish_and_clear();
    Ok(())
}

fn check_decodes(photograph: &PhotographFile) -> Result<()> {
    match decode_samples(&photograph.source, AsStored) {
        Ok(_) => Ok(()),
        Err(Error::Input { path, place, problem, .. }) => {
            Err(Error::input(path, place, problem, DAMAGED_HELP))
        }
        Err(error) => Err(error),
    }
}

/// Puts the photographs under their names into `folder`, as links where that is possible.
///
/// # Errors
/// [`Error::Io`] if one cannot be copied, [`Error::Input`] if one that EXIF turns is damaged.
pub(super) fn place(photographs: &[PhotographFile], folder: &Path) -> Result<()> {
    for photograph in photographs {
        let to = folder.join(&photograph.name);
        let parent = to.parent().unwrap_or(folder);
        fs::create_dir_all(parent).map_err(Error::io("create folder", parent))?;
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

/// A photograph's bytes with EXIF's orientation reset: of a JPEG two bytes change, a PNG is written again without EXIF.
fn unturned(path: &Path) -> Result<Vec<u8>> {
    let damaged = |error: image::ImageError| {
        Error::input(path, "", format!("the photograph cannot be read: {error}"), DAMAGED_HELP)
    };
    let mut bytes = read_bytes(path, missing_file_help)?;
    if bytes.starts_with(&[0xff, 0xd8]) {
        reset_orientation(&mut bytes).map_err(damaged)?;
        return Ok(bytes);
    }
    let mut written = Cursor::new(Vec::new());
    let pixels = image::load_from_memory(&bytes).map_err(damaged)?;
    pixels.write_to(&mut written, ImageFormat::Png).map_err(damaged)?;
    Ok(written.into_inner())
}

fn reset_orientation(jpeg: &mut [u8]) -> image::ImageResult<()> {
    let chunk =
        ImageReader::with_format(Cursor::new(&*jpeg), ImageFormat::Jpeg).into_decoder()?.exif_metadata()?;
    let Some(chunk) = chunk.filter(|chunk| !chunk.is_empty()) else { return Ok(()) };
    let mut reset = chunk.clone();
    let turned = Orientation::remove_from_exif_chunk(&mut reset).is_some();
    let at = jpeg.windows(chunk.len()).position(|window| window == chunk);
    if let Some(at) = at.filter(|_| turned) {
        jpeg[at..at + reset.len()].copy_from_slice(&reset);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pass::progress::Silent;
    use image::codecs::jpeg::JpegEncoder;
    use image::{ImageEncoder, RgbImage, Rgba, RgbaImage};

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
        if let Some(block) = block {
            encoder.set_exif_metadata(block).unwrap();
        }
        encoder.write_image(&picture, size[0], size[1], image::ExtendedColorType::Rgb8).unwrap();
        fs::write(path, bytes).unwrap();
    }

    fn names(listing: &Listing) -> Vec<&str> {
        listing.photographs.iter().map(|photograph| photograph.name.as_str()).collect()
    }

    #[test]
    fn photographs_are_listed_in_order_with_what_is_left_out() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["a10.jpg", "a9.jpg", "a1.JPG"] {
            jpeg(&folder.path().join(name), [8, 6], None);
        }
        for other in ["a1.nef", "a2.NEF", "notes.txt"] {
            fs::write(folder.path().join(other), "x").unwrap();
        }
        let listing = list(folder.path()).unwrap();
        assert_eq!(names(&listing), ["a1.JPG", "a9.jpg", "a10.jpg"]);
        assert_eq!(listing.notes, ["2 .nef files are left out: only JPEG and PNG photographs are used"]);
        fs::rename(folder.path().join("a1.nef"), folder.path().join("a1.HEIC")).unwrap();
        let notes = list(folder.path()).unwrap().notes;
        assert!(
            notes[0].starts_with("1 .heic files are left out") && notes[0].contains("heif-convert"),
            "{notes:?}"
        );
        assert_eq!(folders(&listing.photographs), 1);
        assert_eq!(listing.photographs[0].size, [8, 6]);
    }

    #[test]
    fn sizes_and_focal_lengths_have_folders() {
        let folder = tempfile::tempdir().unwrap();
        jpeg(&folder.path().join("a.jpg"), [8, 6], Some(exif_block(1, 35)));
        jpeg(&folder.path().join("b.jpg"), [8, 6], Some(exif_block(1, 50)));
        jpeg(&folder.path().join("c.jpg"), [6, 8], None);
        jpeg(&folder.path().join("d.jpg"), [8, 6], Some(exif_block(1, 35)));
        let listing = list(folder.path()).unwrap();
        assert_eq!(names(&listing), ["8x6_35mm/a.jpg", "8x6_50mm/b.jpg", "6x8/c.jpg", "8x6_35mm/d.jpg"]);
        assert_eq!(folders(&listing.photographs), 3);
    }

    #[test]
    fn a_turned_photograph_keeps_its_pixels_and_loses_its_turn() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["a.jpg", "b.jpg", "c.jpg"] {
            jpeg(
                &folder.path().join(name),
                [8, 6],
                Some(exif_block(if name == "b.jpg" { 6 } else { 1 }, 35)),
            );
        }
        let listing = list(folder.path()).unwrap();
        assert_eq!(listing.photographs[1].orientation, Orientation::Rotate90);
        assert_eq!(listing.photographs[1].size, [8, 6]);
        assert_eq!(folders(&listing.photographs), 1, "they are of one camera");
        let out = folder.path().join("out");
        place(&listing.photographs, &out).unwrap();
        let placed = list(&out).unwrap();
        assert!(placed.photographs.iter().all(|p| p.orientation == Orientation::NoTransforms));
        assert_eq!(placed.photographs[1].focal, Some(3500), "the rest of EXIF stays");
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
        let listing = list(folder.path()).unwrap();
        let found: Vec<_> = listing.photographs.iter().map(|p| (p.has_alpha, p.is_deep)).collect();
        assert_eq!(found, [(true, false), (true, false), (false, true)]);
    }

    /// Three photographs of some size, so that a part of one has its header.
    fn three() -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        ["a.jpg", "b.jpg", "c.jpg"].iter().for_each(|name| jpeg(&folder.path().join(name), [64, 48], None));
        folder
    }

    #[test]
    fn photographs_that_are_cut_off_are_named() {
        let folder = three();
        RgbImage::from_fn(64, 48, |x, y| image::Rgb([x as u8 * y as u8, 9, 40]))
            .save(folder.path().join("d.png"))
            .unwrap();
        let checked = || check_pixels(&list(folder.path()).unwrap().photographs, &Silent);
        checked().unwrap();
        for name in ["b.jpg", "d.png"] {
            let path = folder.path().join(name);
            let whole = fs::read(&path).unwrap();
            fs::write(&path, &whole[..whole.len() - whole.len() / 8]).unwrap();
            let error = checked().unwrap_err();
            assert!(error.to_string().contains(&format!("{name}: ")) && error.exit_code() == 2, "{error}");
            assert!(error.to_string().contains("damaged or truncated"), "{error}");
            assert_eq!(error.help(), Some(DAMAGED_HELP));
            fs::write(&path, whole).unwrap();
        }
    }

    #[cfg(unix)]
    #[test]
    fn what_is_no_file_is_refused_and_not_opened() {
        let folder = three();
        fs::create_dir(folder.path().join("folder.jpg")).unwrap();
        fs::write(folder.path().join("._a.jpg"), "a file manager's").unwrap();
        assert_eq!(list(folder.path()).unwrap().photographs.len(), 3);
        let pipe = folder.path().join("x.jpg");
        assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        let error = list(folder.path()).err().unwrap();
        assert!(error.to_string().contains("x.jpg: this is a pipe, not a regular file"), "{error}");
        fs::remove_file(&pipe).unwrap();
        std::os::unix::fs::symlink("nowhere", &pipe).unwrap();
        let error = list(folder.path()).err().unwrap();
        assert!(error.to_string().contains("symbolic link to nowhere") && error.exit_code() == 2, "{error}");
    }

    #[cfg(unix)]
    #[test]
    fn a_photograph_that_may_not_be_read_says_how_to_allow_it() {
        use std::os::unix::fs::PermissionsExt as _;
        let folder = three();
        let path = folder.path().join("b.jpg");
        fs::set_permissions(&path, fs::Permissions::from_mode(0o000)).unwrap();
        // Whoever runs the tests may read everything, perhaps.
        if fs::File::open(&path).is_err() {
            let error = list(folder.path()).err().unwrap();
            assert_eq!(error.exit_code(), 2);
            let text = format!("{error} {}", error.help().unwrap_or_default());
            assert!(text.contains("b.jpg: permission denied") && text.contains("chmod u+r"), "{text}");
        }
    }

    #[test]
    fn unusable_folders_are_refused_with_the_reason() {
        let folder = tempfile::tempdir().unwrap();
        let refused = |path: &Path| {
            let error = list(path).err().unwrap();
            assert_eq!(error.exit_code(), 2);
            format!("{error} {}", error.help().unwrap_or_default())
        };
        assert!(refused(&folder.path().join("none")).contains("no such folder"));
        assert!(refused(folder.path()).contains("no JPEG or PNG photographs"));
        fs::write(folder.path().join("a.heic"), "x").unwrap();
        let text = refused(folder.path());
        assert!(
            text.contains("1 .heic files: convert all of them with `heif-convert FILE.heic FILE.jpg`"),
            "{text}"
        );
        assert!(text.contains("`magick mogrify -format jpg *.heic`"), "{text}");
        fs::rename(folder.path().join("a.heic"), folder.path().join("a.cr2")).unwrap();
        assert!(refused(folder.path()).contains("1 .cr2 files: develop or convert"));
        fs::rename(folder.path().join("a.cr2"), folder.path().join("a.mp4")).unwrap();
        assert!(refused(folder.path()).contains("give that file instead of the folder"));
        jpeg(&folder.path().join("a.jpg"), [8, 6], None);
        jpeg(&folder.path().join("b.jpg"), [8, 6], None);
        assert!(refused(folder.path()).contains("2 JPEG or PNG photographs"));
        assert!(refused(&folder.path().join("a.jpg")).contains("a file, not a folder"));
        fs::copy(folder.path().join("a.jpg"), folder.path().join("c.png")).unwrap();
        assert!(refused(folder.path()).contains("it holds a JPEG"));
        fs::write(folder.path().join("c.png"), "no picture").unwrap();
        assert!(refused(folder.path()).contains("neither JPEG nor PNG"));
        fs::remove_file(folder.path().join("c.png")).unwrap();
        fs::write(folder.path().join("c.jpg"), [0xff, 0xd8, 0xff, 0xe0, 0, 4]).unwrap();
        assert!(refused(folder.path()).contains("cannot be read"));
        jpeg(&folder.path().join("c.jpg"), [8, 6], None);
        RgbImage::new(8, 6).save(folder.path().join("b.png")).unwrap();
        assert!(refused(folder.path()).contains("same name with another extension"));
    }
}
