//! Masks of the photographs, from one of several sources, each checked before it is used.

use crate::codec::file::read_folder;
use crate::codec::image::Orientation::AsStored;
use crate::codec::image::{Gamma, decode_picture, image_header, read_image, read_mask};
use crate::codec::nearby::missing_file_help;
use crate::codec::png_file::write_gray8;
use crate::dataset::mask_stems;
use crate::error::stop::check_interrupted;
use crate::error::{Error, Result};
use crate::pass::progress::Progress;
use crate::prepare::backdrop::mask_before_backdrop;
use crate::prepare::photographs::PhotographFile;
use crate::prepare::program::Program;
use image::metadata::Orientation;
use image::{DynamicImage, GrayImage};
use std::collections::BTreeMap;
use std::ffi::OsString;
use std::fs;
use std::path::{Path, PathBuf};

/// Where masks come from.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub enum MaskSource {
    /// The photographs' alpha, if all of them have it; else there are none.
    #[default]
    Alpha,
    /// A folder of images, by the names of the photographs: white is the object, or a cutout with alpha.
    Folder(PathBuf),
    /// A command per photograph, with `{in}` for the photograph and `{out}` for the mask (`.png`) that it writes.
    Command(String),
    /// The photographs themselves, taken before a plain backdrop.
    Backdrop,
}

/// What to do about a command that cannot be used.
const COMMAND_HELP: &str = "Give a command such as 'rembg i {in} {out}': {in} is the photograph, {out} the mask that it writes, a PNG.";

impl MaskSource {
    /// # Errors
    /// [`Error::Usage`] if a command has no `{in}` or `{out}`, or unbalanced quotes.
    pub fn check(&self) -> Result<()> {
        let Self::Command(command) = self else { return Ok(()) };
        let Some(words) = shlex::split(command).filter(|words| !words.is_empty()) else {
            return Err(Error::usage(
                format!("the mask command `{command}` is no command line"),
                COMMAND_HELP,
            ));
        };
        match ["{in}", "{out}"].into_iter().find(|mark| !words[1..].iter().any(|word| word.contains(mark))) {
            Some(mark) => {
                Err(Error::usage(format!("the mask command `{command}` has no {mark}"), COMMAND_HELP))
            }
            None => Ok(()),
        }
    }

    /// Whether there will be masks.
    pub(super) fn gives_masks(&self, photographs: &[PhotographFile]) -> bool {
        *self != Self::Alpha || photographs.iter().all(|photograph| photograph.has_alpha)
    }
}

/// Writes the mask of each photograph as `masks/NAME.png`, gray, of the photograph's size. `images` has the photographs under their
/// names.
///
/// # Errors
/// [`Error::Input`] that names the photograph if its mask is missing, of another size, or all black or white; errors of the command.
pub(super) fn write_masks(
    source: &MaskSource,
    photographs: &[PhotographFile],
    images: &Path,
    masks: &Path,
    log: &Path,
    progress: &dyn Progress,
) -> Result<()> {
    let bar = progress.bar("masks", photographs.len() as u64);
    let folder = match source {
        MaskSource::Folder(folder) => Some(MaskFolder::open(folder)?),
        _ => None,
    };
    for photograph in photographs {
        check_interrupted()?;
        let image = images.join(&photograph.name);
        let to = masks.join(format!("{}.png", photograph.name));
        let parent = to.parent().unwrap_or(masks);
        fs::create_dir_all(parent).map_err(Error::io("create folder", parent))?;
        let (file, mask) = match (source, &folder) {
            (MaskSource::Command(command), _) => {
                (to.clone(), by_command(command, photograph, &image, &to, log)?)
            }
            (_, Some(folder)) => {
                let file = folder.of(photograph)?;
                let mask = as_stored(mask_of_file(&file)?, photograph);
                (file, mask)
            }
            (MaskSource::Backdrop, _) => (photograph.source.clone(), before_backdrop(&photograph.source)?),
            _ => (photograph.source.clone(), alpha_of(&image)?),
        };
        check(&mask, photograph, &file)?;
        write_gray8(&to, &mask)?;
        bar.inc(1);
    }
    bar.finish_and_clear();
    Ok(())
}

fn check(mask: &GrayImage, photograph: &PhotographFile, file: &Path) -> Result<()> {
    let [width, height] = photograph.size;
    let wrong = |problem: String, help: &str| Err(Error::input(file, "", problem, help));
    if mask.dimensions() != (width, height) {
        let (w, h) = mask.dimensions();
        let problem =
            format!("the mask is {w}×{h} pixels, the photograph {} {width}×{height}", photograph.name);
        return wrong(problem, "Make the masks of the same photographs, at full size.");
    }
    let full = mask.iter().filter(|value| **value >= 224).count();
    let between = mask.iter().filter(|value| (32..224).contains(*value)).count();
    if between > full && between > mask.len() / 100 {
        return wrong(
            format!("the mask of {} is mostly gray, as a photograph is", photograph.name),
            "The object is white and all else black. A mask command writes the mask, or a cutout with alpha, to {out}.",
        );
    }
    let (low, high) = mask.iter().fold((255, 0), |(low, high), value| (low.min(*value), high.max(*value)));
    match (low, high) {
        (128.., _) => wrong(
            format!("the mask of {} is white everywhere: nothing is masked out", photograph.name),
            "The object is white and all else black.",
        ),
        (_, ..128) => wrong(
            format!("the mask of {} is black everywhere: there is no object", photograph.name),
            "The object is white and all else black. Remove a photograph that does not show it.",
        ),
        _ => Ok(()),
    }
}

/// A mask, or a cutout with alpha, as 8 bits.
fn mask_of_file(file: &Path) -> Result<GrayImage> {
    if image_header(file)?.has_alpha() {
        let cutout = read_image(file, Gamma::Linear, AsStored)?;
        let [width, height] = [cutout.image.width, cutout.image.height];
        if let Some(alpha) = cutout.alpha.filter(|alpha| alpha.iter().any(|a| *a < 0.5)) {
            return gray(width, height, &alpha)
                .ok_or_else(|| Error::input(file, "", "the mask is damaged", ""));
        }
    }
    let mask = read_mask(file, AsStored)?.mask;
    gray(mask.width, mask.height, &mask.coverage)
        .ok_or_else(|| Error::input(file, "", "the mask is damaged", ""))
}

fn gray(width: u32, height: u32, coverage: &[f32]) -> Option<GrayImage> {
    GrayImage::from_raw(width, height, coverage.iter().map(|c| (255.0 * c).round() as u8).collect())
}

/// A mask of a photograph that EXIF turns may have been made of the turned one: it is turned back.
fn as_stored(mask: GrayImage, photograph: &PhotographFile) -> GrayImage {
    let [width, height] = photograph.size;
    let upright = mask.dimensions() == (height, width) && width != height;
    let back = match photograph.orientation {
        Orientation::Rotate90 => Orientation::Rotate270,
        Orientation::Rotate270 => Orientation::Rotate90,
        // The others are their own inverses.
        other => other,
    };
    if !upright {
        return mask;
    }
    let mut turned = DynamicImage::ImageLuma8(mask);
    turned.apply_orientation(back);
    turned.into_luma8()
}

fn alpha_of(image: &Path) -> Result<GrayImage> {
    let loaded = read_image(image, Gamma::Linear, AsStored)?;
    let coverage = loaded.alpha.unwrap_or_default();
    let mask = gray(loaded.image.width, loaded.image.height, &coverage);
    mask.ok_or_else(|| Error::input(image, "", "the photograph has no alpha", "Give masks with --masks DIR."))
}

fn before_backdrop(source: &Path) -> Result<GrayImage> {
    mask_before_backdrop(&decode_picture(source)?.into_rgb8()).map_err(|problem| {
        let help = "Take masks of another source: --masks DIR, or --mask-command 'rembg i {in} {out}'.";
        Error::input(source, "", problem, help)
    })
}

fn by_command(
    command: &str,
    photograph: &PhotographFile,
    image: &Path,
    to: &Path,
    log: &Path,
) -> Result<GrayImage> {
    let words = shlex::split(command).unwrap_or_default();
    let output = to.with_extension("part.png");
    let place = |word: &String| {
        let word = word.replace("{in}", &image.to_string_lossy());
        OsString::from(word.replace("{out}", &output.to_string_lossy()))
    };
    let (program, arguments) =
        words.split_first().ok_or_else(|| Error::usage("no mask command", COMMAND_HELP))?;
    let program = Program { path: program.into(), install: "Install it, or give another --mask-command." };
    let arguments: Vec<OsString> = arguments.iter().map(place).collect();
    let run = program.run(&arguments, log, &mut |_| ());
    run.map_err(|error| failed_command(error, &program, &arguments, photograph))?;
    if !output.is_file() {
        let problem = format!("the mask command wrote no mask of {}", photograph.source.display());
        return Err(Error::usage(
            problem,
            format!("It ended without an error; its output is in {}.", log.display()),
        ));
    }
    let mask = mask_of_file(&output).map_err(|error| about_command(error, photograph))?;
    fs::remove_file(&output).map_err(Error::io("remove", &output))?;
    Ok(mask)
}

/// The error for a command that fails: what was run, of which photograph, and what to try.
fn failed_command(
    error: Error,
    program: &Program,
    arguments: &[OsString],
    photograph: &PhotographFile,
) -> Error {
    let Error::Run { problem, .. } = error else { return error };
    let words = std::iter::once(program.path.to_string_lossy())
        .chain(arguments.iter().map(|word| word.to_string_lossy()));
    let words: Vec<_> = words.collect();
    let line = shlex::try_join(words.iter().map(AsRef::as_ref)).unwrap_or_else(|_| words.join(" "));
    let problem = format!("the mask command failed. This was run:\n{line}\n{problem}");
    let help = "Run that line in a shell, with a file of your own in place of the last one, until it writes a PNG; then give the same \
                command to --mask-command. If it fails for this photograph alone, leave it out, or give masks with --masks DIR.";
    Error::input(&photograph.source, "", problem, help)
}

/// What is wrong with a mask that a command wrote, said of the photograph: the file's name is of no use to anyone.
fn about_command(error: Error, photograph: &PhotographFile) -> Error {
    match error {
        Error::Input { problem, .. } => {
            let problem = format!("the mask command wrote no mask that can be used: {problem}");
            let help = "The mask command must write a PNG to {out}: white where the object is, or a cutout with alpha.";
            Error::input(&photograph.source, "", problem, help)
        }
        other => other,
    }
}

/// A folder of masks, looked up by the names of photographs.
struct MaskFolder {
    folder: PathBuf,
    /// By names as they are, and in lower case where that is no other's name.
    files: BTreeMap<String, PathBuf>,
}

impl MaskFolder {
    fn open(folder: &Path) -> Result<Self> {
        if !folder.is_dir() {
            let what =
                if folder.exists() { "this is a file, not a folder" } else { "there is no such folder" };
            return Err(Error::input(folder, "", what, missing_file_help(folder)));
        }
        let mut paths = Vec::new();
        for entry in read_folder(folder)? {
            paths.push(entry.map_err(Error::io("read", folder))?.path());
        }
        paths.retain(|path| path.is_file());
        paths.sort();
        let stem = |path: &Path| path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let mut files: BTreeMap<String, PathBuf> =
            paths.iter().map(|path| (key(&stem(path)), path.clone())).collect();
        for path in paths {
            files.entry(key(&stem(&path).to_lowercase())).or_insert(path);
        }
        Ok(Self { folder: folder.to_owned(), files })
    }

    /// The mask of a photograph under any of its [`mask_stems`], with any extension; numbers in names match by value.
    fn of(&self, photograph: &PhotographFile) -> Result<PathBuf> {
        let name = photograph.source.file_name().unwrap_or_default().to_string_lossy();
        let stem = photograph.source.file_stem().unwrap_or_default().to_string_lossy();
        let stems = mask_stems(&name);
        let in_lower_case = || stems.iter().find_map(|stem| self.files.get(&key(&stem.to_lowercase())));
        let found = stems.iter().find_map(|stem| self.files.get(&key(stem))).or_else(in_lower_case);
        found.cloned().ok_or_else(|| {
            let path = self.folder.join(format!("{stem}.png"));
            let problem = format!("there is no mask of the photograph {name}");
            Error::input(&path, "", problem, missing_file_help(&path))
        })
    }
}

/// A name with the zeros left out that numbers begin with: `000007` and `7` are the same.
fn key(name: &str) -> String {
    let mut short = String::new();
    let mut rest = name;
    while let Some(first) = rest.chars().next() {
        let is_digit = first.is_ascii_digit();
        let end = rest.find(|c: char| c.is_ascii_digit() != is_digit).unwrap_or(rest.len());
        let (run, after) = rest.split_at(end);
        let plain = if is_digit { run.trim_start_matches('0') } else { run };
        short += if plain.is_empty() { "0" } else { plain };
        rest = after;
    }
    short
}

#[cfg(unix)]
#[cfg(test)]
mod tests {
    use super::*;
    use crate::pass::progress::Silent;
    use crate::prepare::photographs::{list, place};
    use crate::prepare::test_data::{disc, script};
    use image::{Luma, Rgba, RgbaImage};
    use tempfile::TempDir;

    struct Set {
        folder: TempDir,
        photographs: Vec<PhotographFile>,
    }

    impl Set {
        fn new() -> Self {
            let folder = tempfile::tempdir().unwrap();
            let photos = folder.path().join("photos");
            fs::create_dir(&photos).unwrap();
            for name in ["000007.jpg", "000008.jpg", "000010.jpg"] {
                disc(40, 30).save(photos.join(name)).unwrap();
            }
            let photographs = list(&photos).unwrap().photographs;
            place(&photographs, &folder.path().join("images")).unwrap();
            Self { folder, photographs }
        }

        fn path(&self, name: &str) -> PathBuf {
            self.folder.path().join(name)
        }

        fn masks(&self, source: &MaskSource) -> Result<Vec<GrayImage>> {
            source.check()?;
            let (images, masks) = (self.path("images"), self.path("masks"));
            write_masks(source, &self.photographs, &images, &masks, &self.path("log"), &Silent)?;
            let names = self.photographs.iter().map(|p| masks.join(format!("{}.png", p.name)));
            Ok(names.map(|path| image::open(path).unwrap().into_luma8()).collect())
        }

        fn refused(&self, source: &MaskSource) -> String {
            let error = self.masks(source).unwrap_err();
            format!("{error} {}", error.help().unwrap_or_default())
        }
    }

    fn half(width: u32, height: u32) -> GrayImage {
        GrayImage::from_fn(width, height, |x, _| Luma([if 2 * x < width { 255 } else { 0 }]))
    }

    #[test]
    fn a_folder_of_masks_is_matched_by_name_and_number() {
        let set = Set::new();
        let folder = set.path("given");
        fs::create_dir(&folder).unwrap();
        half(40, 30).save(folder.join("007.png")).unwrap();
        half(40, 30).save(folder.join("000008.jpg.png")).unwrap();
        let source = MaskSource::Folder(folder.clone());
        assert!(set.refused(&source).contains("no mask of the photograph 000010.jpg"));
        // A cutout: its alpha counts, whatever its colors.
        let cutout = RgbaImage::from_fn(40, 30, |x, _| Rgba([10, 20, 200, if x < 20 { 255 } else { 0 }]));
        for name in ["10_mask.png", "010_SEG.PNG"] {
            cutout.save(folder.join(name)).unwrap();
            assert_eq!(set.masks(&source).unwrap(), vec![half(40, 30); 3]);
            fs::remove_file(folder.join(name)).unwrap();
        }
    }

    #[test]
    fn unusable_masks_are_named() {
        let set = Set::new();
        let folder = set.path("given");
        fs::create_dir(&folder).unwrap();
        let source = MaskSource::Folder(folder.clone());
        let give = |mask: &GrayImage| {
            for name in ["7.png", "8.png", "10.png"] {
                mask.save(folder.join(name)).unwrap();
            }
        };
        give(&half(20, 15));
        assert!(set.refused(&source).contains("is 20×15 pixels, the photograph 000007.jpg 40×30"));
        give(&GrayImage::new(40, 30));
        assert!(set.refused(&source).contains("black everywhere"));
        give(&GrayImage::from_pixel(40, 30, Luma([255])));
        assert!(set.refused(&source).contains("white everywhere"));
        give(&GrayImage::from_fn(40, 30, |x, y| Luma([(5 * x + y) as u8])));
        assert!(set.refused(&source).contains("mostly gray, as a photograph is"));
        fs::write(folder.join("7.png"), "no picture").unwrap();
        assert!(set.refused(&source).contains("7.png"));
        assert!(set.refused(&MaskSource::Folder(set.path("none"))).contains("no such folder"));
        assert!(set.refused(&MaskSource::Alpha).contains("no alpha"));
    }

    #[test]
    fn a_command_makes_masks() {
        let set = Set::new();
        half(40, 30).save(set.path("half.png")).unwrap();
        let copy = script(
            set.folder.path(),
            "my segmenter",
            &format!("test -f \"$1\" && cp {}/half.png \"$2\"", set.folder.path().display()),
        );
        let source = MaskSource::Command(format!("'{}' {{in}} {{out}}", copy.display()));
        assert_eq!(set.masks(&source).unwrap(), vec![half(40, 30); 3]);
        let left: Vec<_> = fs::read_dir(set.path("masks")).unwrap().collect();
        assert_eq!(left.len(), 3);
    }

    #[test]
    fn a_command_that_makes_none_is_refused() {
        let set = Set::new();
        let idle = script(set.folder.path(), "idle", "exit 0");
        let text = set.refused(&MaskSource::Command(format!("{} {{in}} {{out}}", idle.display())));
        assert!(text.contains("wrote no mask of") && text.contains("000007.jpg"), "{text}");
        let body = "echo 'no picture' > \"$2\"";
        let other = script(set.folder.path(), "other", body);
        let text = set.refused(&MaskSource::Command(format!("{} {{in}} {{out}}", other.display())));
        let words = ["photos/000007.jpg: ", "neither PNG, JPEG", "must write a PNG to {out}"];
        assert!(words.iter().all(|word| text.contains(word)), "{text}");
        assert!(!text.contains(".part") && !text.contains("Rename"), "{text}");
        let failing = script(set.folder.path(), "failing", "echo started; echo no such model >&2; exit 7");
        let text =
            set.refused(&MaskSource::Command(format!("{} --size 'a b' {{in}} {{out}}", failing.display())));
        for part in [
            "photos/000007.jpg: the mask command failed. This was run:",
            "failing --size 'a b' ",
            "images/000007.jpg",
            "exit status: 7",
            "started\nno such model",
            "Run that line in a shell",
        ] {
            assert!(text.contains(part), "`{part}` is not in: {text}");
        }
        for (command, why) in [
            ("rembg i {in}", "has no {out}"),
            ("rembg i {out}", "has no {in}"),
            ("rembg 'i {in} {out}", "is no command line"),
            ("", "is no command line"),
            ("{in} {out}", "has no {in}"),
        ] {
            let text = set.refused(&MaskSource::Command(command.to_owned()));
            assert!(text.contains(why), "{command}: {text}");
        }
    }

    #[test]
    fn a_backdrop_is_masked_out() {
        let set = Set::new();
        let masks = set.masks(&MaskSource::Backdrop).unwrap();
        assert_eq!((masks[0].get_pixel(20, 15).0[0], masks[0].get_pixel(2, 2).0[0]), (255, 0));
        GrayImage::from_pixel(40, 30, Luma([90])).save(set.path("photos/000008.jpg")).unwrap();
        let text = set.refused(&MaskSource::Backdrop);
        assert!(text.contains("000008.jpg") && text.contains("--mask-command"), "{text}");
    }

    #[test]
    fn a_mask_of_the_upright_photograph_is_turned_back() {
        let set = Set::new();
        let mut photograph = set.photographs[0].clone();
        photograph.orientation = Orientation::Rotate90;
        let stored = half(40, 30);
        let mut upright = DynamicImage::ImageLuma8(stored.clone());
        upright.apply_orientation(Orientation::Rotate90);
        assert_eq!(as_stored(upright.into_luma8(), &photograph), stored);
        assert_eq!(as_stored(stored.clone(), &photograph), stored);
    }

    #[test]
    fn numbers_in_names_are_numbers() {
        assert_eq!(key("img_0007"), key("img_7"));
        assert_eq!(key("000"), "0");
        assert_ne!(key("a10"), key("a1"));
        assert_eq!(key("0a0"), "0a0");
    }
}
