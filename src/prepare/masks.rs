//! Masks of the photographs, from one of several sources, each checked before it is used.

use crate::prepare::work::{Program, Work, make_folder_of, remove};
use crate::{prepare::PrepareOptions, prepare::photographs::PhotographFile, progress::Progress};
use image::{DynamicImage, GrayImage, metadata::Orientation};
use lobelia_geometry::{Error, Result, error::stop::check_interrupted};
use lobelia_io::codec::image::{Gamma, image_header, read_image, read_mask};
use lobelia_io::codec::png_file::write_gray8;
use lobelia_io::dataset::files::{StemIndex, file_name, find_mask};
use lobelia_io::{codec::image::Orientation::AsStored, codec::nearby::missing_file_help};
use std::ffi::{OsStr, OsString};
use std::path::{Path, PathBuf};

/// Where masks come from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum MaskSource {
    /// The photographs' alpha, if all of them have it; else `rembg`, if it is installed; else there
    /// are none.
    Auto,
    /// A folder of images, by the names of the photographs: white is the object, or a cutout with
    /// alpha.
    Folder(PathBuf),
    /// A command per photograph, with `{in}` for the photograph and `{out}` for the mask (`.png`)
    /// that it writes.
    Command(String),
    /// The photographs' alpha.
    Alpha,
    /// `rembg`, which is this program.
    Rembg(PathBuf),
}

/// The model of rembg: the weights of its default one are not free for all uses.
const MODEL: &str = "isnet-general-use";
/// Help for a command that cannot be used.
const COMMAND_HELP: &str = "Give a command such as 'rembg i -om {in} {out}': {in} is the photograph, {out} the mask that it writes, a PNG.";

impl MaskSource {
    /// # Errors
    /// [`Error::Usage`] if a command has no `{in}` or `{out}`, or unbalanced quotes.
    pub fn check(&self) -> Result<()> {
        let Self::Command(command) = self else { return Ok(()) };
        let words = shlex::split(command).unwrap_or_default();
        let is_missing = |mark: &&str| !words[1..].iter().any(|word| word.contains(mark));
        let problem = match ["{in}", "{out}"].into_iter().find(|mark| words.is_empty() || is_missing(mark)) {
            None => return Ok(()),
            Some(_) if words.is_empty() => "is no command line".to_owned(),
            Some(mark) => format!("has no {mark}"),
        };
        Err(Error::usage(format!("the mask command `{command}` {problem}"), COMMAND_HELP))
    }

    /// The maker of these photographs' masks, which is not `Auto`, if there are to be any; else a
    /// note says how there would be.
    pub(super) fn decided(
        options: &PrepareOptions,
        photographs: &[PhotographFile],
        progress: &dyn Progress,
    ) -> Option<Self> {
        if options.masks != Self::Auto {
            return Some(options.masks.clone());
        }
        let with_alpha = photographs.iter().filter(|photograph| photograph.has_alpha).count();
        if with_alpha == photographs.len() {
            return Some(Self::Alpha);
        }
        if with_alpha > 0 {
            progress.note("some photographs have alpha and some have none: no alpha is taken as mask");
        }
        if is_installed(&options.rembg, &std::env::var_os("PATH").unwrap_or_default()) {
            progress.note("rembg makes the masks: look at them; --masks or --mask-command give others");
            return Some(Self::Rembg(options.rembg.clone()));
        }
        progress.note(
            "there will be no masks; for some, install rembg (`pip install \"rembg[cpu,cli]\"`), give --mask-command or --masks DIR, or \
             photographs with alpha",
        );
        None
    }

    /// Writes the mask of each photograph as `masks/NAME.png` of `work`, gray, of the photograph's
    /// size.
    pub(super) fn write(&self, photographs: &[PhotographFile], work: &Work) -> Result<()> {
        let images = work.path("photographs");
        let bar = work.progress.bar("masks", photographs.len() as u64);
        let folder = match self {
            Self::Folder(folder) => Some(masks_of(folder)?),
            Self::Rembg(rembg) => {
                // In one call, since it reads its model anew in each.
                let masks = work.emptied("rembg")?;
                let mut words: Vec<OsString> = ["p", "-m", MODEL, "-om"].map(OsString::from).into();
                words.extend([&images, &masks].map(Into::into));
                let rembg = Program { path: rembg.clone(), install: "Install it, or give --mask-command." };
                rembg.run(&words, &work.log("masks"), |_| ())?;
                Some(masks_of(&masks)?)
            }
            Self::Auto | Self::Alpha | Self::Command(_) => None,
        };
        for photograph in photographs {
            check_interrupted()?;
            let image = images.join(&photograph.name);
            let to = work.path("masks").join(format!("{}.png", photograph.name));
            make_folder_of(&to)?;
            let (file, mask) = match (self, &folder) {
                (Self::Command(command), _) => {
                    (to.clone(), by_command(command, photograph, &image, &to, &work.log("masks"))?)
                }
                (_, Some(folder)) => {
                    let file = find_mask(folder, &file_name(&photograph.source))?;
                    (file.clone(), as_stored(mask_of_file(&file)?, photograph))
                }
                _ => {
                    let loaded = read_image(&image, Gamma::Linear, AsStored)?;
                    let Some(alpha) = &loaded.alpha else {
                        let problem = "the photograph has no alpha";
                        return Err(Error::input(&image, "", problem, "Give masks with --masks DIR."));
                    };
                    (photograph.source.clone(), gray(loaded.image.width, loaded.image.height, alpha))
                }
            };
            check(&mask, photograph, &file)?;
            write_gray8(&to, &mask)?;
            bar.inc(1);
        }
        Ok(())
    }
}

/// Whether a program, a name in a folder of `path` or a path of its own, is there.
fn is_installed(program: &Path, path: &OsStr) -> bool {
    match program.components().count() {
        1 => std::env::split_paths(path).any(|folder| folder.join(program).is_file()),
        _ => program.is_file(),
    }
}

fn masks_of(folder: &Path) -> Result<StemIndex> {
    let missing = || Error::input(folder, "", "there is no such folder", missing_file_help(folder));
    StemIndex::of_folder(folder)?.ok_or_else(missing)
}

fn check(mask: &GrayImage, photograph: &PhotographFile, file: &Path) -> Result<()> {
    let PhotographFile { name, size: [width, height], .. } = photograph;
    let wrong = |problem: String, help: &str| Err(Error::input(file, "", problem, help));
    if mask.dimensions() != (*width, *height) {
        let (w, h) = mask.dimensions();
        let problem = format!("the mask is {w}×{h} pixels, the photograph {name} {width}×{height}");
        return wrong(problem, "Make the masks of the same photographs, at full size.");
    }
    let full = mask.iter().filter(|value| **value >= 224).count();
    let between = mask.iter().filter(|value| (32..224).contains(*value)).count();
    let (problem, more) = if between > full && between > mask.len() / 100 {
        let more = " A mask command writes the mask, or a cutout with alpha, to {out}.";
        ("mostly gray, as a photograph is", more)
    } else if mask.iter().all(|value| *value >= 128) {
        ("white everywhere: nothing is masked out", "")
    } else if mask.iter().all(|value| *value < 128) {
        ("black everywhere: there is no object", " Remove a photograph that does not show it.")
    } else {
        return Ok(());
    };
    let help = format!("The object is white and all else black.{more}");
    wrong(format!("the mask of {name} is {problem}"), &help)
}

/// A mask, or a cutout with alpha, as 8 bits.
fn mask_of_file(file: &Path) -> Result<GrayImage> {
    if image_header(file)?.has_alpha() {
        let cutout = read_image(file, Gamma::Linear, AsStored)?;
        if let Some(alpha) = cutout.alpha.filter(|alpha| alpha.iter().any(|a| *a < 0.5)) {
            return Ok(gray(cutout.image.width, cutout.image.height, &alpha));
        }
    }
    let mask = read_mask(file, AsStored)?;
    Ok(gray(mask.width, mask.height, &mask.coverage))
}

fn gray(width: u32, height: u32, coverage: &[f32]) -> GrayImage {
    let bytes = coverage.iter().map(|c| (255.0 * c).round() as u8).collect();
    GrayImage::from_raw(width, height, bytes).expect("each pixel has its coverage")
}

/// A mask of a photograph that EXIF turns may have been made of the turned one: it is turned back.
fn as_stored(mask: GrayImage, photograph: &PhotographFile) -> GrayImage {
    let [width, height] = photograph.size;
    if mask.dimensions() != (height, width) || width == height {
        return mask;
    }
    let mut turned = DynamicImage::ImageLuma8(mask);
    turned.apply_orientation(match photograph.orientation {
        Orientation::Rotate90 => Orientation::Rotate270,
        Orientation::Rotate270 => Orientation::Rotate90,
        // The others are their own inverses.
        other => other,
    });
    turned.into_luma8()
}

/// The mask that a command makes of a photograph. Errors are about the photograph: the files that
/// the command sees are of no use to anyone.
fn by_command(
    command: &str,
    photograph: &PhotographFile,
    image: &Path,
    to: &Path,
    log: &Path,
) -> Result<GrayImage> {
    let output = to.with_extension("part.png");
    let place = |word: String| {
        word.replace("{in}", &image.to_string_lossy()).replace("{out}", &output.to_string_lossy())
    };
    let mut words = shlex::split(command).unwrap_or_default();
    words[1..].iter_mut().for_each(|word| *word = place(std::mem::take(word)));
    let program =
        Program { path: (&words[0]).into(), install: "Install it, or give another --mask-command." };
    let arguments: Vec<OsString> = words[1..].iter().map(OsString::from).collect();
    let wrong = |problem: String, help: &str| Error::input(&photograph.source, "", problem, help);
    program.run(&arguments, log, |_| ()).map_err(|error| {
        let Error::Run { problem, .. } = error else { return error };
        let line = shlex::try_join(words.iter().map(String::as_str)).unwrap_or_else(|_| words.join(" "));
        wrong(
            format!("the mask command failed. This was run:\n{line}\n{problem}"),
            "Run that line in a shell, with a file of your own in place of the last one, until it writes a PNG; then give the same \
             command to --mask-command. If it fails for this photograph alone, leave it out, or give masks with --masks DIR.",
        )
    })?;
    let mask = mask_of_file(&output).map_err(|error| {
        let Error::Input { problem, .. } = error else { return error };
        let help = format!(
            "The mask command must write a PNG to {{out}}: white where the object is, or a cutout with alpha. Its output is in {}.",
            log.display()
        );
        wrong(format!("the mask command wrote no mask that can be used: {problem}"), &help)
    })?;
    remove(&output)?;
    Ok(mask)
}

#[cfg(unix)]
#[cfg(test)]
mod tests {
    use super::*;
    use crate::prepare::tests::{disc, script};
    use crate::{prepare::photographs::list, prepare::photographs::place, progress::Silent};
    use image::{Luma, Rgba, RgbaImage};
    use std::fs;
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
            let photographs = list(&photos, &Silent).unwrap();
            Self { folder, photographs }
        }

        fn path(&self, name: &str) -> PathBuf {
            self.folder.path().join(name)
        }

        fn masks(&self, source: &MaskSource) -> Result<Vec<GrayImage>> {
            source.check()?;
            let options = PrepareOptions { masks: source.clone(), ..PrepareOptions::new("", "") };
            let maker =
                MaskSource::decided(&options, &self.photographs, &Silent).unwrap_or(MaskSource::Alpha);
            let work = Work::claim(&self.path("out"), &Silent).unwrap();
            place(&self.photographs, &work.emptied("photographs").unwrap()).unwrap();
            maker.write(&self.photographs, &work)?;
            let names = self.photographs.iter().map(|p| work.path("masks").join(format!("{}.png", p.name)));
            Ok(names.map(|path| image::open(path).unwrap().into_luma8()).collect())
        }

        /// Checks that masks are refused with these words, and returns all of them.
        #[track_caller]
        fn refused(&self, source: &MaskSource, words: &[&str]) -> String {
            let error = self.masks(source).unwrap_err();
            let text = format!("{error} {}", error.help().unwrap_or_default());
            words.iter().for_each(|part| assert!(text.contains(part), "`{part}` is not in: {text}"));
            text
        }

        /// A mask command that is a shell script.
        fn command(&self, name: &str, body: &str, more: &str) -> MaskSource {
            let path = script(self.folder.path(), name, body);
            MaskSource::Command(format!("'{}' {more}{{in}} {{out}}", path.display()))
        }
    }

    fn half(width: u32, height: u32) -> GrayImage {
        GrayImage::from_fn(width, height, |x, _| Luma([if 2 * x < width { 255 } else { 0 }]))
    }

    #[test]
    fn a_folder_of_masks_is_matched_by_name() {
        let set = Set::new();
        let folder = set.path("given");
        fs::create_dir(&folder).unwrap();
        half(40, 30).save(folder.join("000007.png")).unwrap();
        half(40, 30).save(folder.join("000008.jpg.png")).unwrap();
        let source = MaskSource::Folder(folder.clone());
        set.refused(&source, &["the mask of `000010.jpg` is missing"]);
        // A cutout: its alpha counts, whatever its colors.
        let cutout = RgbaImage::from_fn(40, 30, |x, _| Rgba([10, 20, 200, if x < 20 { 255 } else { 0 }]));
        for name in ["000010_mask.png", "000010_SEG.PNG"] {
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
        for (mask, words) in [
            (half(20, 15), "is 20×15 pixels, the photograph 000007.jpg 40×30"),
            (GrayImage::new(40, 30), "black everywhere"),
            (GrayImage::from_pixel(40, 30, Luma([255])), "white everywhere"),
            (GrayImage::from_fn(40, 30, |x, y| Luma([(5 * x + y) as u8])), "mostly gray, as a photograph is"),
        ] {
            mask.save(folder.join("000007.png")).unwrap();
            set.refused(&source, &[words]);
        }
        fs::write(folder.join("000007.png"), "no picture").unwrap();
        set.refused(&source, &["000007.png"]);
        set.refused(&MaskSource::Folder(set.path("none")), &["no such folder"]);
    }

    #[test]
    fn a_command_makes_masks() {
        let set = Set::new();
        half(40, 30).save(set.path("half.png")).unwrap();
        let body = format!("test -f \"$1\" && cp {}/half.png \"$2\"", set.folder.path().display());
        assert_eq!(set.masks(&set.command("my segmenter", &body, "")).unwrap(), vec![half(40, 30); 3]);
        assert_eq!(fs::read_dir(set.path("out/.work/masks")).unwrap().count(), 3);
    }

    #[test]
    fn a_command_that_makes_none_is_refused() {
        let set = Set::new();
        set.refused(
            &set.command("idle", "exit 0", ""),
            &["000007.jpg: the mask command wrote no mask", "there is no such file"],
        );
        let other = set.command("other", "echo 'no picture' > \"$2\"", "");
        let text =
            set.refused(&other, &["photos/000007.jpg: ", "neither PNG, JPEG", "must write a PNG to {out}"]);
        assert!(!text.contains(".part") && !text.contains("Rename"), "{text}");
        let failing = set.command("failing", "echo started; echo no such model >&2; exit 7", "--size 'a b' ");
        let parts = [
            "photos/000007.jpg: the mask command failed. This was run:",
            "failing --size 'a b' ",
            "photographs/000007.jpg",
            "exit status: 7",
            "started\nno such model",
            "Run that line in a shell",
        ];
        set.refused(&failing, &parts);
        for (command, why) in [
            ("rembg i {in}", "has no {out}"),
            ("rembg i {out}", "has no {in}"),
            ("rembg 'i {in} {out}", "is no command line"),
            ("", "is no command line"),
            ("{in} {out}", "has no {in}"),
        ] {
            set.refused(&MaskSource::Command(command.to_owned()), &[why]);
        }
    }

    #[test]
    fn a_program_is_looked_for_on_the_path() {
        let folder = tempfile::tempdir().unwrap();
        let rembg = script(folder.path(), "rembg", "exit 0");
        let path = std::env::join_paths([Path::new("/nowhere"), folder.path()]).unwrap();
        assert!(is_installed(Path::new("rembg"), &path) && is_installed(&rembg, OsStr::new("")));
        assert!(!is_installed(Path::new("rembg"), OsStr::new("/nowhere")));
        assert!(!is_installed(&folder.path().join("none"), &path));
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
}
