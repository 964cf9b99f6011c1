//! The arguments of COLMAP's commands, and what its output says of their progress.

use crate::error::{Error, Result};
use crate::prepare::program::Program;
use std::ffi::OsString;
use std::path::{Path, PathBuf};

/// What to do without COLMAP.
pub(super) const INSTALL: &str = "Install COLMAP (Debian and Ubuntu: `apt install colmap`; macOS: `brew install colmap`; else see \
                                  colmap.github.io), or name the program with `--colmap PROGRAM`.";
/// Photographs that are held in memory at once while all pairs are matched; progress is reported per pair of such blocks.
const MATCHING_BLOCK: usize = 10;
/// Largest distance in pixels of a feature from its point, in photographs of [`ERROR_SIDE`] pixels and smaller ones. COLMAP's own 4 lets
/// through enough mismatches to turn single cameras by a degree.
const LEAST_ERROR: f64 = 1.2;
/// COLMAP's own, which is not exceeded in larger photographs.
const MOST_ERROR: f64 = 4.0;
/// Longer side of a photograph whose features are good to [`LEAST_ERROR`]; in larger ones the distance grows with the side.
const ERROR_SIDE: f64 = 1600.0;
/// Neighbors that each frame of a sequence is matched with, on each side.
const SEQUENCE_OVERLAP: usize = 20;

/// The distortion of the lens that COLMAP estimates.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub enum LensModel {
    /// None, one focal length.
    SimplePinhole,
    /// None, two focal lengths.
    Pinhole,
    /// One radial coefficient.
    #[default]
    SimpleRadial,
    /// Two radial coefficients.
    Radial,
    /// Two radial and two tangential coefficients, two focal lengths.
    OpenCv,
    /// A fisheye lens with four coefficients.
    OpenCvFisheye,
}

impl LensModel {
    /// COLMAP's name of it.
    pub fn name(self) -> &'static str {
        match self {
            Self::SimplePinhole => "SIMPLE_PINHOLE",
            Self::Pinhole => "PINHOLE",
            Self::SimpleRadial => "SIMPLE_RADIAL",
            Self::Radial => "RADIAL",
            Self::OpenCv => "OPENCV",
            Self::OpenCvFisheye => "OPENCV_FISHEYE",
        }
    }
}

/// Which photographs share a camera: focal length, center and distortion.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub enum CameraSharing {
    /// All of the same size and EXIF focal length.
    #[default]
    Shared,
    /// None: each has its own.
    PerImage,
}

/// How `feature_extractor` treats cameras.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Cameras {
    One,
    PerFolder,
    PerImage,
}

/// Which pairs of photographs are matched.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Pairs {
    All,
    /// Those near each other by name.
    Sequence,
    /// Those in a file, two names a line.
    Listed(PathBuf),
}

/// COLMAP as it is installed here.
pub(super) struct Colmap {
    pub program: Program,
    /// Whether the graphics card extracts and matches features.
    pub gpu: bool,
    naming: Naming,
}

/// Names of options that versions of COLMAP do not share: from 3.12 on, those of all kinds of features have groups of their own.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Naming {
    Sift,
    Feature,
}

impl Naming {
    fn of_help(help: &str) -> Self {
        if help.contains("FeatureExtraction.use_gpu") { Self::Feature } else { Self::Sift }
    }

    fn extraction(self, option: &str) -> String {
        let group = if self == Self::Sift { "SiftExtraction" } else { "FeatureExtraction" };
        format!("--{group}.{option}")
    }

    fn matching(self, option: &str) -> String {
        let group = if self == Self::Sift { "SiftMatching" } else { "FeatureMatching" };
        format!("--{group}.{option}")
    }
}

impl Colmap {
    /// Looks for the program and asks for its options.
    ///
    /// # Errors
    /// [`Error::Usage`] that says how to install it.
    pub fn find(path: PathBuf, gpu: bool) -> Result<Self> {
        let program = Program { path, install: INSTALL };
        let help = program.help(&["feature_extractor", "-h"])?;
        if !help.contains("ImageReader.single_camera") {
            let problem = format!("the program {} is not COLMAP, or cannot run", program.path.display());
            return Err(Error::usage(problem, INSTALL));
        }
        Ok(Self { program, gpu, naming: Naming::of_help(&help) })
    }

    fn use_gpu(&self) -> OsString {
        if self.gpu { "1".into() } else { "0".into() }
    }

    /// Features of all photographs; with `masks`, of those parts that a mask does not show as black.
    pub fn features(
        &self,
        database: &Path,
        images: &Path,
        masks: Option<&Path>,
        lens: LensModel,
        cameras: Cameras,
    ) -> Vec<OsString> {
        let mut words =
            words("feature_extractor", &[("--database_path", database), ("--image_path", images)]);
        words.extend(["--ImageReader.camera_model", lens.name()].map(OsString::from));
        words.extend(cameras.words().map(OsString::from));
        if let Some(masks) = masks {
            words.extend(["--ImageReader.mask_path".into(), masks.as_os_str().to_owned()]);
        }
        words.extend([self.naming.extraction("use_gpu").into(), self.use_gpu()]);
        words
    }

    /// Matches of features.
    pub fn matching(&self, database: &Path, pairs: &Pairs) -> Vec<OsString> {
        let mut words = words(pairs.command(), &[("--database_path", database)]);
        words.extend([self.naming.matching("use_gpu").into(), self.use_gpu()]);
        words.extend(match pairs {
            Pairs::All => ["--ExhaustiveMatching.block_size".into(), MATCHING_BLOCK.to_string().into()],
            Pairs::Sequence => ["--SequentialMatching.overlap".into(), SEQUENCE_OVERLAP.to_string().into()],
            Pairs::Listed(file) => ["--match_list_path".into(), file.as_os_str().to_owned()],
        });
        words
    }

    /// Matches of features where parts of a photograph move apart from each other: several motions are found in each pair.
    ///
    /// # Errors
    /// [`Error::Run`] if the program does not say what its options are.
    pub fn moving_matching(&self, database: &Path, pairs: &Pairs) -> Result<Vec<OsString>> {
        let help = self.program.help(&[pairs.command(), "-h"])?;
        // Version 3.9 has given the option another name.
        let option = ["--TwoViewGeometry.multiple_models", "--SiftMatching.multiple_models"];
        let known = option.into_iter().find(|option| help.contains(option));
        let mut words = self.matching(database, pairs);
        words.extend(known.into_iter().flat_map(|option| [option, "1"]).map(OsString::from));
        Ok(words)
    }

    /// Cameras and points, as one or several models in folders of `models` with numbers as names. `side` is the longest side of the
    /// photographs in pixels.
    pub fn mapping(database: &Path, images: &Path, models: &Path, side: u32) -> Vec<OsString> {
        let paths = [("--database_path", database), ("--image_path", images), ("--output_path", models)];
        let mut words = words("mapper", &paths);
        words.extend(largest_error(side));
        words
    }

    /// The cameras of a model with all its points found anew, into `output`. `side` is that of [`mapping`](Self::mapping).
    pub fn triangulation(
        database: &Path,
        images: &Path,
        model: &Path,
        output: &Path,
        side: u32,
    ) -> Vec<OsString> {
        let paths = [
            ("--database_path", database),
            ("--image_path", images),
            ("--input_path", model),
            ("--output_path", output),
        ];
        let mut words = words("point_triangulator", &paths);
        words.extend(["--clear_points", "1"].map(OsString::from));
        words.extend(largest_error(side));
        words
    }

    /// The same model with points, poses and cameras moved to where points project best, and the cameras' centers as well if these are
    /// to be found, which a mapper takes for the middle of the image.
    pub fn adjustment(model: &Path, output: &Path, finds_center: bool) -> Vec<OsString> {
        let mut words = words("bundle_adjuster", &[("--input_path", model), ("--output_path", output)]);
        if finds_center {
            words.extend(["--BundleAdjustment.refine_principal_point", "1"].map(OsString::from));
        }
        words
    }

    /// Photographs without distortion, and their cameras.
    pub fn undistortion(images: &Path, model: &Path, output: &Path) -> Vec<OsString> {
        let paths = [("--image_path", images), ("--input_path", model), ("--output_path", output)];
        words("image_undistorter", &paths)
    }
}

/// The largest distance of a feature from its point's projection in photographs of this longer side in pixels.
fn largest_error(side: u32) -> [OsString; 2] {
    let error = (LEAST_ERROR * f64::from(side) / ERROR_SIDE).clamp(LEAST_ERROR, MOST_ERROR);
    ["--Mapper.filter_max_reproj_error".into(), error.to_string().into()]
}

impl Pairs {
    fn command(&self) -> &'static str {
        match self {
            Self::All => "exhaustive_matcher",
            Self::Sequence => "sequential_matcher",
            Self::Listed(_) => "matches_importer",
        }
    }
}

impl Cameras {
    fn words(self) -> [&'static str; 2] {
        match self {
            Self::One => ["--ImageReader.single_camera", "1"],
            Self::PerFolder => ["--ImageReader.single_camera_per_folder", "1"],
            Self::PerImage => ["--ImageReader.single_camera_per_image", "1"],
        }
    }
}

fn words(command: &str, paths: &[(&str, &Path)]) -> Vec<OsString> {
    let mut words = vec![OsString::from(command)];
    for (option, path) in paths {
        words.extend([OsString::from(option), path.as_os_str().to_owned()]);
    }
    words
}

/// How many of `whole` steps a line of output says are done: `Processed file [3/66]`, `Matching block [1/2, 2/2]`,
/// `Registering image #7 (12)`.
pub(super) fn steps_done(line: &str, whole: u64) -> Option<u64> {
    if let Some(at) = line.find("Registering image #") {
        let count = line[at..].split_once('(')?.1.split(')').next()?;
        return count.rsplit('=').next()?.trim().parse().ok();
    }
    let inside = ["file [", "block [", "image ["].iter().find_map(|mark| line.split_once(mark))?.1;
    let fraction = |text: &str| -> Option<(u64, u64)> {
        let (done, all) = text.trim().split_once('/')?;
        Some((done.parse().ok()?, all.parse().ok()?)).filter(|(done, all)| done <= all && *all > 0)
    };
    let (done, all) = match inside.split(']').next()?.split_once(',') {
        None => fraction(inside.split(']').next()?)?,
        Some((row, column)) => {
            let ((row, rows), (column, columns)) = (fraction(row)?, fraction(column)?);
            (row.checked_sub(1)?.checked_mul(columns)?.checked_add(column)?, rows.checked_mul(columns)?)
        }
    };
    Some((u128::from(whole) * u128::from(done) / u128::from(all)) as u64)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn colmap(naming: Naming) -> Colmap {
        Colmap { program: Program { path: "colmap".into(), install: INSTALL }, gpu: false, naming }
    }

    fn joined(words: &[OsString]) -> String {
        words.iter().map(|word| word.to_string_lossy()).collect::<Vec<_>>().join(" ")
    }

    #[test]
    fn arguments_say_what_is_wanted() {
        let colmap = colmap(Naming::Sift);
        let masks = Some(Path::new("m"));
        let words = colmap.features(Path::new("db"), Path::new("i"), masks, LensModel::Radial, Cameras::One);
        assert_eq!(
            joined(&words),
            "feature_extractor --database_path db --image_path i --ImageReader.camera_model RADIAL \
             --ImageReader.single_camera 1 --ImageReader.mask_path m --SiftExtraction.use_gpu 0"
        );
        let words = colmap.matching(Path::new("db"), &Pairs::Sequence);
        assert!(joined(&words).starts_with("sequential_matcher --database_path db --SiftMatching.use_gpu 0"));
        assert!(joined(&words).ends_with("--SequentialMatching.overlap 20"));
        for (side, error) in [(800, "1.2"), (3200, "2.4"), (12_000, "4")] {
            let words = joined(&Colmap::mapping(Path::new("db"), Path::new("i"), Path::new("m"), side));
            assert!(
                words.ends_with(&format!("--output_path m --Mapper.filter_max_reproj_error {error}")),
                "{words}"
            );
        }
        let words = colmap.matching(Path::new("db"), &Pairs::Listed("pairs.txt".into()));
        assert_eq!(
            joined(&words),
            "matches_importer --database_path db --SiftMatching.use_gpu 0 --match_list_path pairs.txt"
        );
        let [db, images, model] = ["db", "i", "m"].map(Path::new);
        let words = joined(&Colmap::triangulation(db, images, model, Path::new("t"), 1600));
        assert!(
            words.ends_with("--output_path t --clear_points 1 --Mapper.filter_max_reproj_error 1.2"),
            "{words}"
        );
        let words = Colmap::undistortion(Path::new("i"), Path::new("m/0"), Path::new("d"));
        assert_eq!(joined(&words), "image_undistorter --image_path i --input_path m/0 --output_path d");
    }

    #[test]
    fn newer_versions_have_other_names() {
        assert_eq!(Naming::of_help("--SiftExtraction.use_gpu arg"), Naming::Sift);
        let naming = Naming::of_help("  --FeatureExtraction.use_gpu arg (=1)");
        let words = joined(&colmap(naming).matching(Path::new("db"), &Pairs::All));
        assert!(words.contains("--FeatureMatching.use_gpu 0"), "{words}");
        assert!(!words.contains("Sift"), "{words}");
    }

    #[test]
    fn progress_is_read_from_output() {
        assert_eq!(steps_done("Processed file [3/66]", 66), Some(3));
        assert_eq!(steps_done("I20260101 feature_extraction.cc:254] Processed file [33/66]", 66), Some(33));
        assert_eq!(steps_done("Matching block [1/2, 2/2] in 8.1s", 100), Some(50));
        assert_eq!(steps_done("Matching block [2/2, 2/2] in 8.1s", 100), Some(100));
        assert_eq!(steps_done("Registering image #3 (5)", 66), Some(5));
        assert_eq!(steps_done("Registering image #3 (num_reg_frames=5)", 66), Some(5));
        assert_eq!(steps_done("Undistorting image [2/4]", 8), Some(4));
        let no_progress = [
            "",
            "Name: a[1/2].jpg",
            "Processed file [x/3]",
            "Processed file [1/0]",
            "file [9/3]",
            "block [0/2, 1/2]",
            "Registering image #3",
            "Registering image #3 (many)",
        ];
        for other in no_progress {
            assert_eq!(steps_done(other, 10), None, "{other}");
        }
    }
}
