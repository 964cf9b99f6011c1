//! COLMAP: its arguments, what its output says of progress, and the steps that run it: features,
//! matching, mapping, undistortion.

use crate::prepare::photographs::{FEWEST, PhotographFile};
use crate::prepare::work::{Program, Work, make_folder_of, remove, words};
use crate::prepare::{Matching, PrepareOptions, Prepared};
use image::{DynamicImage, GrayImage, codecs::jpeg::JpegEncoder};
use lobelia_geometry::{Error, Result, error::stop::check_interrupted};
use lobelia_io::codec::file::{read_bytes, write_bytes};
use lobelia_io::codec::image::{decode, image_header};
use lobelia_io::dataset::colmap::{LargestModel, largest_model};
use lobelia_io::{codec::nearby::missing_file_help, codec::png_file::write_gray8};
use std::{collections::BTreeSet, ffi::OsStr, ffi::OsString, fs, path::Path};

/// Help for a missing COLMAP.
const INSTALL: &str = "Install COLMAP (Debian and Ubuntu: `apt install colmap`; macOS: `brew install colmap`; else see \
                       colmap.github.io), or name the program with `--colmap PROGRAM`.";
/// Command, option and its value: matches of all pairs, with so many photographs in memory at once
/// (progress is reported per pair of such blocks); and of each with so many neighbors on each side.
const EXHAUSTIVE: [&str; 3] = ["exhaustive_matcher", "--ExhaustiveMatching.block_size", "10"];
const SEQUENTIAL: [&str; 3] = ["sequential_matcher", "--SequentialMatching.overlap", "20"];
/// Photographs and frames of a video up to which all pairs are matched.
const MOST_EXHAUSTIVE: [usize; 2] = [500, 100];
/// Largest distance in pixels of a feature from its point, in photographs of [`ERROR_SIDE`] pixels
/// and smaller ones. COLMAP's own 4 lets through enough mismatches to turn single cameras by a
/// degree.
const LEAST_ERROR: f64 = 1.2;
/// COLMAP's own, which is not exceeded in larger photographs.
const MOST_ERROR: f64 = 4.0;
/// Longer side of a photograph whose features are good to [`LEAST_ERROR`]; in larger ones the
/// distance grows with the side.
const ERROR_SIDE: f64 = 1600.0;
/// How often points are found anew and cameras adjusted.
const ROUNDS: u64 = 3;
/// Fewest photographs of one camera that determine the center of its image.
const FEWEST_FOR_CENTER: usize = 20;
/// Grays of a resampled mask this near to black and white are these: the noise of its compression.
const MASK_NOISE: u8 = 8;
/// Part of a side that a photograph keeps when it is undistorted. COLMAP leaves no less than 0.2.
const LEAST_LEFT: f64 = 0.4;
/// Help where cameras are not found.
const NO_CAMERAS_HELP: &str = "Neighboring photographs must overlap by 60 % and more and be sharp, and the object needs texture. On a \
                               turntable, give masks and `--features object`; before a plain object, leave that out.";

/// COLMAP as it is installed here: the program, and its options that let features and matches use
/// the graphics card; version 3.12 renamed their groups.
pub(super) fn find(path: &Path) -> Result<(Program, [&'static str; 2])> {
    let program = Program { path: path.to_owned(), install: INSTALL };
    let help = program.help(&["feature_extractor", "-h"])?;
    if !help.contains("ImageReader.single_camera") {
        let problem = format!("the program {} is not COLMAP, or cannot run", path.display());
        return Err(Error::usage(problem, INSTALL));
    }
    let use_gpu = match help.contains("FeatureExtraction.use_gpu") {
        true => ["--FeatureExtraction.use_gpu", "--FeatureMatching.use_gpu"],
        false => ["--SiftExtraction.use_gpu", "--SiftMatching.use_gpu"],
    };
    Ok((program, use_gpu))
}

/// Photographs whose cameras are to be found, by COLMAP as [`find`] has found it.
pub(super) struct Reconstruction<'a> {
    pub options: &'a PrepareOptions,
    pub program: Program,
    pub use_gpu: [&'static str; 2],
    pub photographs: &'a [PhotographFile],
    pub is_video: bool,
    pub has_masks: bool,
}

impl Reconstruction<'_> {
    /// Does all steps. What they make lies in `data` of `work`, as `images`, `masks` and `sparse`.
    pub fn run(&self, work: &mut Work) -> Result<Prepared> {
        let Self { options, photographs, .. } = self;
        let gpu = if options.gpu { "1" } else { "0" };
        let cameras = match photographs.iter().any(|photograph| photograph.name.contains('/')) {
            _ if options.camera_per_image => "--ImageReader.single_camera_per_image",
            true => "--ImageReader.single_camera_per_folder",
            false => "--ImageReader.single_camera",
        };
        let lens = ("--ImageReader.camera_model", &options.lens as _);
        let mut features = over_photographs(work, "feature_extractor", &[lens, (cameras, &"1")]);
        // Features of all of the photographs, or of those parts that a mask does not show as black.
        let on_object = self.has_masks && options.object_features;
        if on_object {
            features.extend(["--ImageReader.mask_path".into(), work.path("masks").into_os_string()]);
        }
        features.extend([self.use_gpu[0], gpu].map(OsString::from));
        work.step("features", &format!("{features:?}"), |work| {
            for end in ["", "-wal", "-shm"] {
                remove(&work.path(&format!("database.db{end}")))?;
            }
            self.colmap(work, "features", photographs.len(), &features)
        })?;
        let is_few = photographs.len() <= MOST_EXHAUSTIVE[usize::from(self.is_video)];
        let is_guess = !is_few && options.matching == Matching::Auto;
        if is_guess {
            work.progress.note(
                "photographs are matched with their neighbors by name only, because they are many; --matching exhaustive matches all pairs",
            );
        }
        let is_sequence = is_guess || options.matching == Matching::Sequential;
        let [command, option, value] = if is_sequence { SEQUENTIAL } else { EXHAUSTIVE };
        let database = ("--database_path", &work.path("database.db") as _);
        let matching = words(command, &[database, (self.use_gpu[1], &gpu), (option, &value)]);
        work.step("matching", &format!("{matching:?}"), |work| {
            self.colmap(work, "matching", 100, &matching)
        })?;
        work.step("mapping", "", |work| self.map(work))?;
        let LargestModel { folder, names, note } =
            largest_model(&work.path("models"))?.ok_or_else(|| self.no_cameras("COLMAP made no model"))?;
        note.iter().for_each(|note| work.progress.note(note));
        if names.len() < FEWEST {
            let problem = format!("COLMAP found the cameras of {} photographs only", names.len());
            return Err(self.no_cameras(&problem));
        }
        // The center of the image moves like a turn of the camera: only many photographs of one
        // camera with features over the whole frame tell the two apart.
        let refines = cameras.ends_with("single_camera") && !on_object && names.len() >= FEWEST_FOR_CENTER;
        let model = if refines { work.path("refined") } else { folder.clone() };
        work.step("refinement", &format!("{refines} {}", folder.display()), |work| {
            if refines { self.refine(work, &folder) } else { Ok(()) }
        })?;
        work.step("undistortion", &options.keep_distortion.to_string(), |work| {
            let make = if options.keep_distortion { Self::copy } else { Self::undistort };
            make(self, work, &model, &names)
        })?;
        let (mut error, analysis) = (None::<f64>, words("model_analyzer", &[("--path", &model)]));
        // Without this number, all is there.
        let _ = self.program.run(&analysis, &work.log("analysis"), |line| {
            let told = line.split_once("Mean reprojection error: ");
            error = told.and_then(|(_, told)| told.trim_end_matches("px").parse().ok()).or(error);
        });
        check_interrupted()?;
        let left_out = photographs.iter().map(|photograph| photograph.name.clone());
        Ok(Prepared {
            photographs: photographs.len(),
            video_frames: None,
            left_out: left_out.filter(|name| !names.contains(name)).collect(),
            reprojection_error: error.filter(|error| *error > 0.0),
            scene: None,
        })
    }

    fn no_cameras(&self, problem: &str) -> Error {
        Error::input(&self.options.photographs, "", problem, NO_CAMERAS_HELP)
    }

    /// Runs one of COLMAP's commands under a bar of `length` steps.
    fn colmap(&self, work: &Work, name: &str, length: usize, words: &[OsString]) -> Result<()> {
        let length = length as u64;
        work.run(name, &self.program, words, length, |line| steps_done(line, length))
    }

    /// Cameras and points, as one or several models in folders of `models` with numbers as names.
    fn map(&self, work: &Work) -> Result<()> {
        let models = work.emptied("models")?;
        let error = ("--Mapper.filter_max_reproj_error", &self.largest_error() as _);
        let words = over_photographs(work, "mapper", &[("--output_path", &models), error]);
        let ran = self.colmap(work, "mapping", self.photographs.len(), &words);
        let is_empty = fs::read_dir(&models).map_err(Error::io("read", &models))?.next().is_none();
        let log = fs::read(work.log("mapping")).unwrap_or_default();
        let log = String::from_utf8_lossy(&log);
        let no_pair =
            log.contains("failed to create sparse model") || log.contains("No good initial image pair");
        match ran {
            Ok(()) | Err(Error::Run { .. }) if is_empty && no_pair => {
                Err(self.no_cameras("COLMAP found no pair of photographs to start from"))
            }
            ran => ran,
        }
    }

    /// The largest distance of a feature from its point's projection, by the longest side of the
    /// photographs.
    fn largest_error(&self) -> String {
        let side = self.photographs.iter().flat_map(|photograph| photograph.size).max().unwrap_or_default();
        (LEAST_ERROR * f64::from(side) / ERROR_SIDE).clamp(LEAST_ERROR, MOST_ERROR).to_string()
    }

    /// Finds the center of the image too, which a mapper takes for its middle: points are found
    /// anew and cameras adjusted, several times.
    fn refine(&self, work: &Work, model: &Path) -> Result<()> {
        let [refined, points] = [work.emptied("refined")?, work.emptied("points")?];
        let run = |words: &[OsString]| self.program.run(words, &work.log("refinement"), |_| ());
        let adjust = |from: &Path| {
            let center = ("--BundleAdjustment.refine_principal_point", &"1" as _);
            run(&words("bundle_adjuster", &[("--input_path", &from), ("--output_path", &refined), center]))
        };
        let error = ("--Mapper.filter_max_reproj_error", &self.largest_error() as _);
        let (input, output) = (("--input_path", &refined as _), ("--output_path", &points as _));
        let clear = ("--clear_points", &"1" as _);
        let triangulation = over_photographs(work, "point_triangulator", &[input, output, clear, error]);
        let bar = work.progress.bar("refinement", ROUNDS);
        adjust(model)?;
        for _ in 0..ROUNDS {
            run(&triangulation)?;
            adjust(&points)?;
            bar.inc(1);
        }
        Ok(())
    }

    /// The data set of a model with its distortion: files under the same names, what links lead to
    /// instead of links.
    fn copy(&self, work: &Work, model: &Path, names: &BTreeSet<String>) -> Result<()> {
        let data = work.emptied("data")?;
        let copy = |name: &str, from: &Path, to: &str| {
            check_interrupted()?;
            let (source, target) = (from.join(name), data.join(to).join(name));
            make_folder_of(&target)?;
            fs::copy(&source, &target).map(|_| ()).map_err(Error::io("copy", &source))
        };
        for name in names {
            copy(name, &work.path("photographs"), "images")?;
            if self.has_masks {
                copy(&format!("{name}.png"), &work.path("masks"), "masks")?;
            }
        }
        for file in fs::read_dir(model).map_err(Error::io("read", model))?.flatten() {
            copy(&file.file_name().to_string_lossy(), model, "sparse")?;
        }
        Ok(())
    }

    /// The data set of a model without its distortion. COLMAP undistorts photographs; masks are
    /// given to it as photographs of these names, so that they are moved alike.
    fn undistort(&self, work: &Work, model: &Path, names: &BTreeSet<String>) -> Result<()> {
        if self.photographs.iter().any(|photograph| photograph.is_deep) {
            let note = "COLMAP writes undistorted photographs with 8 bits; --keep-distortion keeps all 16";
            work.progress.note(note);
        }
        let run = |name: &str, images: &Path, output: &Path| {
            let (photographs, model) = (("--image_path", &images as _), ("--input_path", &model as _));
            let words = words("image_undistorter", &[photographs, model, ("--output_path", &output)]);
            self.colmap(work, name, names.len(), &words)
        };
        let data = work.emptied("data")?;
        run("undistortion", &work.path("photographs"), &data)?;
        // Cameras whose distortion leaves little of a photograph were found by what does not move
        // as the object does.
        for photograph in self.photographs.iter().filter(|photograph| names.contains(&photograph.name)) {
            let header = image_header(data.join("images").join(&photograph.name))?;
            let ([width, height], [w, h]) = (photograph.size, [header.width, header.height]);
            let is_little = |left: u32, whole: u32| f64::from(left) < LEAST_LEFT * f64::from(whole);
            if is_little(w, width) || is_little(h, height) {
                let problem = format!(
                    "the cameras that were found have a distortion that no lens has: undistorted, the \
                     photograph has {w}×{h} of its {width}×{height} pixels"
                );
                let help = "Photographs of a turntable need masks and `--features object`; others more overlap, or one lens and zoom for all.";
                return Err(Error::input(&photograph.source, "", problem, help));
            }
        }
        if !self.has_masks {
            return Ok(());
        }
        let (bent, straight) = (work.emptied("bent_masks")?, work.emptied("straight_masks")?);
        for name in names {
            check_interrupted()?;
            let mask = read_mask(&work.path("masks").join(format!("{name}.png")))?;
            write_as(&bent.join(name), &mask)?;
        }
        run("undistortion of masks", &bent, &straight)?;
        for name in names {
            let mut mask = read_mask(&straight.join("images").join(name))?;
            mask.iter_mut().filter(|value| **value <= MASK_NOISE).for_each(|value| *value = 0);
            mask.iter_mut().filter(|value| **value >= 255 - MASK_NOISE).for_each(|value| *value = 255);
            write_gray8(data.join("masks").join(format!("{name}.png")), &mask)?;
        }
        Ok(())
    }
}

/// The words of a command that reads the database and the photographs.
fn over_photographs(work: &Work, command: &str, more: &[(&str, &dyn AsRef<OsStr>)]) -> Vec<OsString> {
    let (database, images) = (work.path("database.db"), work.path("photographs"));
    let read = [("--database_path", &database as _), ("--image_path", &images as _)];
    words(command, &[&read[..], more].concat())
}

/// How many of `whole` steps a line of output says are done: `Processed file [3/66]`,
/// `Matching block [1/2, 2/2]`, `Registering image #7 (12)`.
fn steps_done(line: &str, whole: u64) -> Option<u64> {
    if let Some(at) = line.find("Registering image #") {
        let count = line[at..].split_once('(')?.1.split(')').next()?;
        return count.rsplit('=').next()?.trim().parse().ok();
    }
    let inside = ["file [", "block [", "image ["].iter().find_map(|mark| line.split_once(mark))?.1;
    let fraction = |text: &str| -> Option<(u64, u64)> {
        let (done, all) = text.trim().split_once('/')?;
        Some((done.parse().ok()?, all.parse().ok()?)).filter(|(done, all)| done <= all && *all > 0)
    };
    let inside = inside.split(']').next()?;
    let (done, all) = match inside.split_once(',') {
        None => fraction(inside)?,
        Some((row, column)) => {
            let ((row, rows), (column, columns)) = (fraction(row)?, fraction(column)?);
            (row.checked_sub(1)?.checked_mul(columns)?.checked_add(column)?, rows.checked_mul(columns)?)
        }
    };
    Some((u128::from(whole) * u128::from(done) / u128::from(all)) as u64)
}

/// Reads a mask that this program or COLMAP wrote.
fn read_mask(path: &Path) -> Result<GrayImage> {
    let mask = decode(&read_bytes(path, missing_file_help)?);
    let failed = |error| Error::run("undistorting masks", format!("{}: {error}", path.display()));
    mask.map(DynamicImage::into_luma8).map_err(failed)
}

/// Writes a mask in the format of its name, without visible loss.
fn write_as(path: &Path, mask: &GrayImage) -> Result<()> {
    if path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("png")) {
        return write_gray8(path, mask);
    }
    let mut jpeg = Vec::new();
    let encoded = mask.write_with_encoder(JpegEncoder::new_with_quality(&mut jpeg, 100));
    encoded.map_err(|error| Error::run("undistorting masks", format!("{}: {error}", path.display())))?;
    write_bytes(path, &jpeg)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn progress_is_read_from_output() {
        for (line, whole, done) in [
            ("Processed file [3/66]", 66, Some(3)),
            ("I20260101 feature_extraction.cc:254] Processed file [33/66]", 66, Some(33)),
            ("Matching block [1/2, 2/2] in 8.1s", 100, Some(50)),
            ("Registering image #3 (5)", 66, Some(5)),
            ("Registering image #3 (num_reg_frames=5)", 66, Some(5)),
            ("Undistorting image [2/4]", 8, Some(4)),
            ("Name: a[1/2].jpg", 10, None),
            ("Processed file [1/0]", 10, None),
            ("file [9/3]", 10, None),
            ("block [0/2, 1/2]", 10, None),
            ("Registering image #3 (many)", 10, None),
        ] {
            assert_eq!(steps_done(line, whole), done, "{line}");
        }
    }
}
