//! The steps that run COLMAP: features, matching, mapping, undistortion.

use crate::codec::image::{decode_picture, image_header};
use crate::codec::png_file::write_gray8;
use crate::dataset::colmap::registered_names;
use crate::error::stop::check_interrupted;
use crate::error::{Error, Result};
use crate::pass::progress::Progress;
use crate::prepare::colmap::{CameraSharing, Cameras, Colmap, Pairs, steps_done};
use crate::prepare::model::{mean_reprojection_error, models, points_seen};
use crate::prepare::options::{Matching, PrepareOptions, Prepared};
use crate::prepare::photographs::{PhotographFile, folders};
use crate::prepare::work::Work;
use image::GrayImage;
use image::codecs::jpeg::JpegEncoder;
use std::collections::BTreeSet;
use std::ffi::OsString;
use std::fs;
use std::io::BufWriter;
use std::path::{Path, PathBuf};

/// Photographs and frames of a video up to which all pairs are matched.
const MOST_EXHAUSTIVE: [usize; 2] = [500, 100];
/// Fewest photographs with cameras that are a data set.
const FEWEST_REGISTERED: usize = 3;
/// A photograph that sees fewer points than the usual one divided by this is weak.
const WEAK_SHARE: u64 = 4;
/// How often points are found anew and cameras adjusted. On a head of polished metal on a turntable, rotations are off by 0.30° before what
/// turns with it is used, then by 0.20°, 0.17°, 0.15° and 0.15°; on a skull before a cloth by 0.13°, 0.12°, 0.12° and 0.11°.
const ROUNDS: u64 = 3;
/// Fewest photographs of one camera that determine the center of its image.
const FEWEST_FOR_CENTER: usize = 20;
/// Grays of a resampled mask this near to black and white are these: the noise of its compression.
const MASK_NOISE: u8 = 8;
/// Part of a side that a photograph keeps when it is undistorted. COLMAP leaves no less than 0.2.
const LEAST_LEFT: f64 = 0.4;

/// What to do if cameras are not found.
const NO_CAMERAS_HELP: &str = "Neighboring photographs must overlap by 60 % and more and be sharp, and the object needs texture. On a \
                               turntable, mask the background; before a plain object, mask nothing.";

/// What of a photograph features are taken from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Features {
    All,
    /// The object alone.
    Object,
    /// The object alone, and once cameras are known by it, what turns with it.
    ObjectAndPlatter,
}

/// Rounds of finding points and adjusting cameras.
pub(super) struct Rounds {
    /// What they are called in progress and logs.
    pub name: &'static str,
    /// The features and matches that are used.
    pub database: &'static str,
    /// The folder of the model.
    pub output: &'static str,
    /// Whether the center of the image is found too.
    pub finds_center: bool,
}

/// Photographs whose cameras are to be found.
pub(super) struct Reconstruction<'a> {
    pub options: &'a PrepareOptions,
    pub colmap: Colmap,
    pub photographs: &'a [PhotographFile],
    pub is_video: bool,
    pub has_masks: bool,
    pub features: Features,
    pub progress: &'a dyn Progress,
}

/// The photographs that see far fewer points than the others: their cameras may be off.
fn weak(mut seen: Vec<(String, u64)>) -> Vec<String> {
    let mut counts: Vec<u64> = seen.iter().map(|(_, count)| *count).collect();
    counts.sort_unstable();
    let usual = counts.get(counts.len() / 2).copied().unwrap_or_default();
    seen.retain(|(_, count)| count * WEAK_SHARE < usual);
    seen.sort();
    seen.into_iter().map(|(name, _)| name).collect()
}

impl Reconstruction<'_> {
    /// Does all steps. What they make lies in `data` of `work`, as `images`, `masks` and `sparse`.
    ///
    /// # Errors
    /// Those of [`prepare`](crate::prepare::prepare).
    pub fn run(&self, work: &mut Work) -> Result<Prepared> {
        self.find_cameras(work)?;
        let (largest, names) = self.largest_model(work)?;
        let model = self.refine(work, &largest, names.len())?;
        let with_platter = self.features == Features::ObjectAndPlatter;
        let model = if with_platter { self.adjust_by_platter(work, &model)? } else { model };
        let error = mean_reprojection_error(&model)?;
        let settings = format!("{} {with_platter}", self.options.keep_distortion);
        work.step("undistortion", &settings, |work| self.finish(work, &model, &names))?;
        let left_out = self.photographs.iter().map(|photograph| photograph.name.clone());
        Ok(Prepared {
            photographs: self.photographs.len(),
            video_frames: None,
            left_out: left_out.filter(|name| !names.contains(name)).collect(),
            reprojection_error: error,
            weak: weak(points_seen(&model)?),
            has_masks: self.has_masks,
            scene: None,
        })
    }

    /// Finds features, matches them, and makes models of cameras and points, as `models` of `work`.
    fn find_cameras(&self, work: &mut Work) -> Result<()> {
        let (lens, cameras, pairs) = (self.options.lens, self.cameras(), self.pairs());
        work.step("features", &format!("{lens:?} {cameras:?} {}", self.on_object()), |work| {
            self.extract(work, cameras)
        })?;
        work.step("matching", &format!("{pairs:?}"), |work| {
            self.colmap_step(work, "matching", 100, &self.colmap.matching(&work.path("database.db"), &pairs))
        })?;
        work.step("mapping", "", |work| self.map(work))?;
        Ok(())
    }

    /// The folder of the model with the most photographs, and their names.
    fn largest_model(&self, work: &Work) -> Result<(PathBuf, BTreeSet<String>)> {
        let found = models(&work.path("models"))?;
        let largest = found.first().ok_or_else(|| self.no_cameras("COLMAP made no model"))?;
        if found.len() > 1 {
            let sizes: Vec<String> = found.iter().map(|model| model.images.to_string()).collect();
            self.progress.note(&format!(
                "COLMAP could not join all photographs: it made {} models, of {} photographs; the largest is used",
                found.len(),
                sizes.join(", ")
            ));
        }
        let names: BTreeSet<String> = registered_names(&largest.folder)?.into_iter().collect();
        if names.len() < FEWEST_REGISTERED {
            return Err(
                self.no_cameras(&format!("COLMAP found the cameras of {} photographs only", names.len()))
            );
        }
        Ok((largest.folder.clone(), names))
    }

    /// Finds the center of the image too, where the `registered` photographs determine it. Returns the folder of the model from then on.
    fn refine(&self, work: &mut Work, largest: &Path, registered: usize) -> Result<PathBuf> {
        let refines = self.refines_center(registered);
        let model = if refines { work.path("refined") } else { largest.to_owned() };
        work.step("refinement", &format!("{refines} {}", largest.display()), |work| {
            let rounds =
                Rounds { name: "refinement", database: "database.db", output: "refined", finds_center: true };
            if refines { self.adjust_in_rounds(work, &rounds, largest) } else { Ok(()) }
        })?;
        Ok(model)
    }

    fn on_object(&self) -> bool {
        self.features != Features::All
    }

    /// The longest side of the photographs in pixels.
    pub(super) fn longest_side(&self) -> u32 {
        self.photographs.iter().flat_map(|photograph| photograph.size).max().unwrap_or_default()
    }

    pub(super) fn cameras(&self) -> Cameras {
        match self.options.cameras {
            CameraSharing::PerImage => Cameras::PerImage,
            CameraSharing::Shared if folders(self.photographs) > 1 => Cameras::PerFolder,
            CameraSharing::Shared => Cameras::One,
        }
    }

    fn pairs(&self) -> Pairs {
        let few = self.photographs.len() <= MOST_EXHAUSTIVE[usize::from(self.is_video)];
        match self.options.matching {
            Matching::Exhaustive => Pairs::All,
            Matching::Auto if few => Pairs::All,
            Matching::Sequential => Pairs::Sequence,
            Matching::Auto => {
                let problem =
                    "photographs are matched with their neighbors by name only, because they are many";
                self.progress.note(&format!("{problem}; --matching exhaustive matches all pairs"));
                Pairs::Sequence
            }
        }
    }

    /// Whether the center of the image is found too. It moves like a turn of the camera: only many photographs of one camera with features
    /// over the whole frame tell the two apart.
    fn refines_center(&self, registered: usize) -> bool {
        self.cameras() == Cameras::One && !self.on_object() && registered >= FEWEST_FOR_CENTER
    }

    fn no_cameras(&self, problem: &str) -> Error {
        Error::input(&self.options.photographs, "", problem, NO_CAMERAS_HELP)
    }

    fn extract(&self, work: &Work, cameras: Cameras) -> Result<()> {
        let database = work.path("database.db");
        remove_database(work, "database.db")?;
        let masks = self.on_object().then(|| work.path("masks"));
        let images = work.path("photographs");
        let words = self.colmap.features(&database, &images, masks.as_deref(), self.options.lens, cameras);
        self.colmap_step(work, "features", self.photographs.len() as u64, &words)
    }

    fn map(&self, work: &Work) -> Result<()> {
        let models = work.emptied("models")?;
        let (database, images) = (work.path("database.db"), work.path("photographs"));
        let words = Colmap::mapping(&database, &images, &models, self.longest_side());
        let ran = self.colmap_step(work, "mapping", self.photographs.len() as u64, &words);
        let is_empty = fs::read_dir(&models).map_err(Error::io("read", &models))?.next().is_none();
        let log = fs::read(work.log("mapping")).unwrap_or_default();
        let log = String::from_utf8_lossy(&log);
        let no_pair = ["failed to create sparse model", "No good initial image pair"]
            .iter()
            .any(|text| log.contains(text));
        match ran {
            Ok(()) | Err(Error::Run { .. }) if is_empty && no_pair => {
                Err(self.no_cameras("COLMAP found no pair of photographs to start from"))
            }
            ran => ran,
        }
    }

    /// Puts the model into a folder with its points found anew and its cameras adjusted, several times.
    pub(super) fn adjust_in_rounds(&self, work: &Work, rounds: &Rounds, model: &Path) -> Result<()> {
        let (database, images) = (work.path(rounds.database), work.path("photographs"));
        let [adjusted, points] = [work.emptied(rounds.output)?, work.emptied("points")?];
        let run = |words: &[OsString]| self.colmap.program.run(words, &work.log(rounds.name), &mut |_| ());
        let bar = self.progress.bar(rounds.name, ROUNDS);
        if rounds.finds_center {
            run(&Colmap::adjustment(model, &adjusted, true))?;
        } else {
            copy_folder(model, &adjusted)?;
        }
        for _ in 0..ROUNDS {
            run(&Colmap::triangulation(&database, &images, &adjusted, &points, self.longest_side()))?;
            run(&Colmap::adjustment(&points, &adjusted, rounds.finds_center))?;
            bar.inc(1);
        }
        bar.finish_and_clear();
        Ok(())
    }

    /// Runs one of COLMAP's commands with a bar of `length` steps.
    pub(super) fn colmap_step(&self, work: &Work, name: &str, length: u64, words: &[OsString]) -> Result<()> {
        let bar = self.progress.bar(name, length);
        let ran = self.colmap.program.run(words, &work.log(name), &mut |line| {
            if let Some(done) = steps_done(line, length) {
                bar.set_position(done);
            }
        });
        bar.finish_and_clear();
        ran
    }

    /// Makes the data set of a model.
    fn finish(&self, work: &Work, model: &Path, names: &BTreeSet<String>) -> Result<()> {
        let data = work.emptied("data")?;
        let photographs = work.path("photographs");
        if self.options.keep_distortion {
            copy_all(names.iter(), &photographs, &data.join("images"))?;
            let masks: Vec<String> = names.iter().map(|name| format!("{name}.png")).collect();
            if self.has_masks {
                copy_all(masks.iter(), &work.path("masks"), &data.join("masks"))?;
            }
            return copy_folder(model, &data.join("sparse"));
        }
        if self.photographs.iter().any(|photograph| photograph.is_deep) {
            let note = "COLMAP writes undistorted photographs with 8 bits; --keep-distortion keeps all 16";
            self.progress.note(note);
        }
        let count = names.len() as u64;
        self.colmap_step(work, "undistortion", count, &Colmap::undistortion(&photographs, model, &data))?;
        self.check_undistorted(&data.join("images"), names)?;
        if self.has_masks {
            self.undistort_masks(work, model, names)?;
        }
        Ok(())
    }

    /// Refuses cameras whose distortion leaves little of a photograph: they were found by what does not move as the object does.
    fn check_undistorted(&self, images: &Path, names: &BTreeSet<String>) -> Result<()> {
        for photograph in self.photographs.iter().filter(|photograph| names.contains(&photograph.name)) {
            let header = image_header(images.join(&photograph.name))?;
            let ([width, height], [w, h]) = (photograph.size, [header.width, header.height]);
            if f64::from(w) >= LEAST_LEFT * f64::from(width) && f64::from(h) >= LEAST_LEFT * f64::from(height)
            {
                continue;
            }
            let problem = format!(
                "the cameras that were found have a distortion that no lens has: undistorted, the \
                 photograph has {w}×{h} of its {width}×{height} pixels"
            );
            let help = "Photographs of a turntable need masks (--masks DIR, --mask-command, --backdrop); others more overlap, or one lens and \
                        zoom for all.";
            return Err(Error::input(&photograph.source, "", problem, help));
        }
        Ok(())
    }

    /// COLMAP undistorts photographs. Masks are given to it as photographs of these names, so that they are moved alike.
    fn undistort_masks(&self, work: &Work, model: &Path, names: &BTreeSet<String>) -> Result<()> {
        let (bent, straight) = (work.emptied("bent_masks")?, work.emptied("straight_masks")?);
        for name in names {
            check_interrupted()?;
            write_as(
                &bent.join(name),
                &decode_picture(work.path("masks").join(format!("{name}.png")))?.into_luma8(),
            )?;
        }
        let words = Colmap::undistortion(&bent, model, &straight);
        self.colmap_step(work, "undistortion of masks", names.len() as u64, &words)?;
        for name in names {
            let mut mask = decode_picture(straight.join("images").join(name))?.into_luma8();
            for value in mask.iter_mut() {
                *value = match *value {
                    dark if dark <= MASK_NOISE => 0,
                    light if light >= 255 - MASK_NOISE => 255,
                    edge => edge,
                };
            }
            write_gray8(work.path("data/masks").join(format!("{name}.png")), &mask)?;
        }
        Ok(())
    }
}

/// Removes a database that an earlier run left, and what belongs to it.
pub(super) fn remove_database(work: &Work, name: &str) -> Result<()> {
    for rest in ["", "-wal", "-shm"].map(|end| work.path(&format!("{name}{end}"))) {
        match fs::remove_file(&rest) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                return Err(Error::io("remove", &rest)(error));
            }
            _ => {}
        }
    }
    Ok(())
}

/// Writes a mask in the format of its name, without visible loss.
fn write_as(path: &Path, mask: &GrayImage) -> Result<()> {
    let parent = path.parent().unwrap_or(path);
    fs::create_dir_all(parent).map_err(Error::io("create folder", parent))?;
    if path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("png")) {
        return write_gray8(path, mask);
    }
    let file = BufWriter::new(fs::File::create(path).map_err(Error::io("write", path))?);
    let written = mask.write_with_encoder(JpegEncoder::new_with_quality(file, 100));
    written.map_err(|error| Error::run("undistorting masks", format!("{}: {error}", path.display())))
}

/// Copies files under the same names, what links lead to instead of links.
fn copy_all<'a>(names: impl Iterator<Item = &'a String>, from: &Path, to: &Path) -> Result<()> {
    for name in names {
        check_interrupted()?;
        let (source, target) = (from.join(name), to.join(name));
        let parent = target.parent().unwrap_or(to);
        fs::create_dir_all(parent).map_err(Error::io("create folder", parent))?;
        fs::copy(&source, &target).map_err(Error::io("copy", &source))?;
    }
    Ok(())
}

fn copy_folder(from: &Path, to: &Path) -> Result<()> {
    let entries = fs::read_dir(from).map_err(Error::io("read", from))?;
    let names = entries
        .map(|entry| Ok(entry.map_err(Error::io("read", from))?.file_name().to_string_lossy().into_owned()));
    copy_all(names.collect::<Result<Vec<String>>>()?.iter(), from, to)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn photographs_with_few_points_are_weak() {
        let seen =
            |counts: &[u64]| counts.iter().enumerate().map(|(i, count)| (format!("{i}"), *count)).collect();
        assert_eq!(weak(seen(&[500, 119, 480, 20, 520, 126])), ["1", "3"]);
        assert!(weak(seen(&[0, 0, 0])).is_empty() && weak(Vec::new()).is_empty());
    }
}
