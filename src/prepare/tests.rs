//! The whole of `prepare`, with a script in place of COLMAP; and scripts and photographs for the
//! tests of its parts.

use super::*;
use crate::progress::{RecordedMessages, Silent};
use crate::scene::{LoadOptions, load};
use image::{Rgb, RgbImage};
use lobelia_geometry::view::Split;
use lobelia_io::dataset::{DatasetOptions, read_dataset};
use std::{fs, io::Write as _, os::unix::fs::OpenOptionsExt as _, path::Path, sync::Arc};
use tempfile::TempDir;

/// An executable shell script.
pub(super) fn script(folder: &Path, name: &str, body: &str) -> PathBuf {
    let path = folder.join(name);
    let mut options = fs::OpenOptions::new();
    let mut file = options.write(true).create(true).truncate(true).mode(0o755).open(&path).unwrap();
    write!(file, "#!/bin/sh\n{body}\n").unwrap();
    drop(file);
    path
}

/// An ffmpeg that counts this many frames in a video of so many seconds, and writes the frames that
/// lie beside it as `000001.jpg`….
pub(super) fn fake_ffmpeg(folder: &Path, frames: u64, seconds: u64) -> PathBuf {
    // The last argument is the pattern of the frames, or nothing that is written.
    let body = format!(
        r#"here=$(dirname "$0"); echo "$@" >> "$here/ffmpeg-calls"; for last; do :; done
if [ "$last" = - ]; then
  echo frame={frames}; echo out_time_ms={seconds}000000
else
  cp "$here"/0*.jpg "$(dirname "$last")" 2>&1; echo frame=1
fi"#
    );
    script(folder, "ffmpeg", &body)
}

/// A photograph of a reddish disc in front of a gray backdrop.
pub(super) fn disc(width: u32, height: u32) -> RgbImage {
    RgbImage::from_fn(width, height, |x, y| {
        if in_disc(width, height, x, y) { Rgb([160, 60, 40]) } else { Rgb([200 - x as u8, 190, 180]) }
    })
}

/// The mask of [`disc`].
pub(super) fn disc_mask(width: u32, height: u32) -> image::GrayImage {
    image::GrayImage::from_fn(width, height, |x, y| {
        image::Luma([255 * u8::from(in_disc(width, height, x, y))])
    })
}

fn in_disc(width: u32, height: u32, x: u32, y: u32) -> bool {
    let off = |at: u32, side: u32| at as f32 + 0.5 - side as f32 / 2.0;
    off(x, width).hypot(off(y, height)) < width.min(height) as f32 / 4.0
}

/// Where the script finds the value of an option: `of --output_path "$@"`.
const OPTIONS: &str = r#"
of() { wanted=$1; shift; while [ $# -gt 0 ]; do if [ "$1" = "$wanted" ]; then echo "$2"; return; fi; shift; done; }
here=$(dirname "$0"); out=$(of --output_path "$@"); echo "$@" >> "$here/calls"
"#;
/// Stand-in for COLMAP, with models that lie beside the script.
const COLMAP: &str = r#"
if [ "$2" = -h ]; then echo "--ImageReader.single_camera arg --SiftExtraction.use_gpu arg"; exit 0; fi
case $1 in
  feature_extractor) echo made > "$(of --database_path "$@")"; echo "Processed file [3/3]" ;;
  exhaustive_matcher | sequential_matcher) test -s "$(of --database_path "$@")" || exit 9; echo "Matching block [1/1, 1/1] in 1s" ;;
  point_triangulator) cp "$here"/found-again/* "$out" ;;
  bundle_adjuster) cp "$(of --input_path "$@")"/* "$out" ;;
  mapper) cp -r "$here"/models/. "$out"; echo "Registering image #1 (3)" ;;
  image_undistorter) mkdir -p "$out/images" "$out/sparse"
    cp -rL "$(of --image_path "$@")"/. "$out/images"; cp "$(of --input_path "$@")"/* "$out/sparse" ;;
  model_analyzer) echo "I2026 model.cc:1] Mean reprojection error: 0.625000px" ;;
  *) echo "unknown command $1"; exit 1 ;;
esac
"#;

struct Capture {
    folder: TempDir,
}

impl Capture {
    /// Four photographs of a disc with masks, of which COLMAP finds the cameras of three.
    fn new() -> Self {
        let capture = Self { folder: tempfile::tempdir().unwrap() };
        fs::create_dir(capture.path("photos")).unwrap();
        fs::create_dir(capture.path("masks")).unwrap();
        for name in ["a.jpg", "b.jpg", "c.png", "d.jpg"] {
            disc(48, 36).save(capture.path("photos").join(name)).unwrap();
            disc_mask(48, 36).save(capture.path("masks").join(name).with_extension("png")).unwrap();
        }
        capture.model("models/0", &["a.jpg", "c.png", "d.jpg"]);
        capture.script("colmap", &format!("{OPTIONS}{COLMAP}"));
        capture
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn script(&self, name: &str, body: &str) -> PathBuf {
        script(self.folder.path(), name, body)
    }

    /// A COLMAP in whose script a part is replaced.
    fn colmap(&self, part: &str, by: &str) {
        let body = COLMAP.replace(part, by);
        assert!(body != COLMAP || part == by);
        self.script("colmap", &format!("{OPTIONS}{body}"));
    }

    /// A COLMAP of which a command fails and says something.
    fn failing(&self, command: &str, said: &str) {
        self.colmap(&format!("  {command})"), &format!("  {command}) echo '{said}'; exit 1;;\n  unused)"));
    }

    /// Prepares with changed options, and returns the notes too.
    fn attempt(&self, change: impl FnOnce(&mut PrepareOptions)) -> (Result<Prepared>, String) {
        let mut options = PrepareOptions::new(self.path("photos"), self.path("out"));
        options.masks = MaskSource::Folder(self.path("masks"));
        (options.colmap, options.rembg) = (self.path("colmap"), self.path("rembg"));
        change(&mut options);
        let notes = RecordedMessages::new(Arc::new(Silent));
        (prepare(&options, &notes), notes.take().join("\n"))
    }

    #[track_caller]
    fn prepare(&self, change: impl FnOnce(&mut PrepareOptions)) -> (Prepared, String) {
        let (prepared, notes) = self.attempt(change);
        (prepared.unwrap(), notes)
    }

    /// Checks that changed options are refused with these words.
    #[track_caller]
    fn refused(&self, change: impl FnOnce(&mut PrepareOptions), words: &[&str]) {
        let error = self.attempt(change).0.unwrap_err();
        let text = format!("{error} {}", error.help().unwrap_or_default());
        words.iter().for_each(|word| assert!(text.contains(word), "no {word:?} in {text}"));
    }

    /// A binary model with these photographs and two points.
    fn model(&self, name: &str, photographs: &[&str]) {
        let model = self.path(name);
        fs::create_dir_all(&model).unwrap();
        let words = |values: &[u64]| values.iter().flat_map(|value| value.to_le_bytes()).collect::<Vec<u8>>();
        let numbers = |values: &[f64]| values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
        // Camera 1 of model 1, PINHOLE.
        let ids = [1u32, 1].map(u32::to_le_bytes).concat();
        let camera = [words(&[1]), ids, words(&[48, 36]), numbers(&[60.0, 60.0, 24.0, 18.0])];
        fs::write(model.join("cameras.bin"), camera.concat()).unwrap();
        let mut images = words(&[photographs.len() as u64]);
        for (i, photograph) in photographs.iter().enumerate() {
            images.extend((i as u32).to_le_bytes());
            images.extend(numbers(&[1.0, 0.0, 0.0, 0.0, i as f64, 0.0, 4.0]));
            images.extend(1u32.to_le_bytes());
            images.extend(format!("{photograph}\0").bytes());
            images.extend(words(&[0]));
        }
        fs::write(model.join("images.bin"), images).unwrap();
        let point = |error: f64| {
            [words(&[1]), numbers(&[0.0; 3]), vec![0; 3], numbers(&[error]), words(&[0])].concat()
        };
        fs::write(model.join("points3D.bin"), [words(&[2]), point(0.5), point(0.75)].concat()).unwrap();
    }

    /// The commands of COLMAP since this was called last.
    fn calls(&self) -> Vec<String> {
        let text = fs::read_to_string(self.path("calls")).unwrap_or_default();
        let _ = fs::remove_file(self.path("calls"));
        let first = |line: &str| line.split(' ').next().unwrap_or_default().to_owned();
        text.lines().filter(|line| !line.ends_with(" -h")).map(first).collect()
    }
}

fn no_masks(options: &mut PrepareOptions) {
    options.masks = MaskSource::Auto;
}

fn as_they_are(_: &mut PrepareOptions) {}

#[test]
fn photographs_become_a_data_set_that_is_read() {
    let capture = Capture::new();
    let (prepared, notes) = capture.prepare(as_they_are);
    assert_eq!(prepared.to_string(), "registered 3 of 4, reprojection error 0.62 px; left out: b.jpg");
    assert!(notes.contains("`--features object`"), "{notes}");
    let out = capture.path("out");
    let options = DatasetOptions { hold_out: 0, ..DatasetOptions::default() };
    let read = read_dataset(&out, Split::Train, &options).unwrap();
    let names: Vec<&str> = read.views.iter().map(|view| view.name.as_str()).collect();
    assert_eq!(names, ["a", "c", "d"]);
    for view in &read.views {
        let mask = view.mask.as_ref().unwrap();
        assert!(mask.coverage(18 * 48 + 24) == 1.0 && mask.coverage(0) == 0.0, "{}", view.name);
    }
    let loaded = load(&out.join("scene.ron"), &LoadOptions::default()).unwrap();
    assert_eq!(prepared.scene, Some(loaded.path));
    assert!(!out.join(".work").exists() && out.join("logs/mapping.log").is_file());
    capture.refused(as_they_are, &["is not empty", "a data set that is finished"]);
}

/// Frames take the place of photographs; a second run, after a stop, does not extract them again.
#[test]
fn a_video_becomes_a_data_set_of_its_frames() {
    let capture = Capture::new();
    let names = ["000001.jpg", "000002.jpg", "000003.jpg", "000004.jpg"];
    names.iter().for_each(|name| disc(48, 36).save(capture.path(name)).unwrap());
    capture.model("models/0", &names);
    fs::write(capture.path("clip.mov"), b"\0\0\0\x18ftypqt  \0\0\0\0").unwrap();
    let of_video = |options: &mut PrepareOptions| {
        (options.photographs, options.masks) = (capture.path("clip.mov"), MaskSource::Auto);
        options.ffmpeg = fake_ffmpeg(capture.folder.path(), 8, 1);
        options.frames = FrameCount::Count(4);
    };
    capture.failing("mapper", "");
    capture.refused(of_video, &["colmap mapper"]);
    capture.colmap("", "");
    let (prepared, _) = capture.prepare(of_video);
    let expected = "4 of 8 frames\nregistered 4 of 4, reprojection error 0.62 px";
    assert_eq!(prepared.to_string(), expected);
    assert_eq!(fs::read_dir(capture.path("out/images")).unwrap().count(), 4);
    let said = fs::read_to_string(capture.path("ffmpeg-calls")).unwrap();
    assert_eq!(said.lines().filter(|line| line.contains("select=")).count(), 1, "{said}");
}

#[test]
fn rembg_makes_masks_where_it_is_installed() {
    let capture = Capture::new();
    let body = r#"here=$(dirname "$0"); echo "$@" > "$here/rembg-call"; for last; do :; done; cp "$here"/masks/* "$last""#;
    capture.script("rembg", body);
    let (prepared, notes) = capture.prepare(no_masks);
    assert!(prepared.scene.is_some());
    assert!(notes.contains("rembg makes the masks"), "{notes}");
    let call = fs::read_to_string(capture.path("rembg-call")).unwrap();
    assert!(call.starts_with("p -m isnet-general-use -om ") && call.contains(".work/photographs"), "{call}");
    // A photograph that it makes no mask of is named.
    fs::remove_dir_all(capture.path("out")).unwrap();
    fs::remove_file(capture.path("masks/c.png")).unwrap();
    capture.refused(no_masks, &["the mask of `c.png` is missing", "rembg"]);
}

/// Files with the name of a result are replaced while work goes on.
#[test]
fn photographs_and_masks_in_the_output_folder_are_refused() {
    let capture = Capture::new();
    let (out, images) = (capture.path("models"), capture.path("models/images"));
    fs::rename(capture.path("photos"), &images).unwrap();
    let photographs = |options: &mut PrepareOptions| {
        (options.photographs, options.out) = (images.clone(), out.clone());
    };
    capture.refused(photographs, &["the photographs, "]);
    let masks = |options: &mut PrepareOptions| {
        (options.masks, options.out) = (MaskSource::Folder(images.clone()), out.clone());
    };
    capture.refused(masks, &["the masks, "]);
    assert!(images.join("a.jpg").is_file());
}

#[test]
fn distorted_photographs_are_kept_byte_by_byte() {
    let capture = Capture::new();
    capture.prepare(|options| options.keep_distortion = true);
    assert!(!capture.calls().contains(&"image_undistorter".to_owned()));
    let bytes = |path: PathBuf| fs::read(path).unwrap();
    let out = capture.path("out");
    assert_eq!(bytes(out.join("images/a.jpg")), bytes(capture.path("photos/a.jpg")));
    assert!(!out.join("images/a.jpg").is_symlink());
    assert!(read_dataset(&out, Split::Train, &DatasetOptions::default()).is_ok());
}

#[test]
fn without_masks_there_is_no_scene_file() {
    let capture = Capture::new();
    let (prepared, notes) = capture.prepare(no_masks);
    assert!(prepared.scene.is_none());
    assert!(notes.contains("pip install \"rembg[cpu,cli]\"") && notes.contains("--mask-command"), "{notes}");
    assert!(!capture.path("out/masks").exists() && !capture.path("out/scene.ron").exists());
    assert!(capture.path("out/sparse/0/images.bin").is_file());
}

/// A step that fails leaves nothing under a final name, and what was done before it is not done
/// again, unless options change.
#[test]
fn a_failure_is_explained_and_work_goes_on_after_it() {
    let capture = Capture::new();
    capture.failing("mapper", "out of memory");
    capture.refused(as_they_are, &["colmap mapper: it failed", "out of memory", "mapping.log"]);
    assert_eq!(fs::read_dir(capture.path("out")).unwrap().count(), 2, "work and logs");
    assert_eq!(capture.calls(), ["feature_extractor", "exhaustive_matcher", "mapper"]);
    capture.failing("image_undistorter", "");
    capture.refused(as_they_are, &["image_undistorter: it failed"]);
    assert_eq!(capture.calls(), ["mapper", "image_undistorter"]);
    capture.colmap("", "");
    capture.prepare(|options| options.lens = "RADIAL");
    assert_eq!(capture.calls()[..3], ["feature_extractor", "exhaustive_matcher", "mapper"]);
}

#[test]
fn no_cameras_are_explained() {
    let capture = Capture::new();
    capture.failing("mapper", "ERROR: failed to create sparse model");
    capture.refused(as_they_are, &["no pair of photographs to start from", "overlap"]);
    capture.model("models/0", &["a.jpg", "d.jpg"]);
    capture.colmap("", "");
    capture.refused(as_they_are, &["the cameras of 2 photographs only"]);
}

#[test]
fn of_several_models_the_largest_is_used_and_said() {
    let capture = Capture::new();
    capture.model("models/1", &["a.jpg", "b.jpg", "c.png", "d.jpg"]);
    let (prepared, notes) = capture.prepare(as_they_are);
    assert!(prepared.left_out.is_empty());
    assert!(notes.contains("2 models of 3, 4 images; only the largest"), "{notes}");
}

#[test]
fn many_photographs_of_one_camera_are_adjusted_in_rounds() {
    let capture = Capture::new();
    let names: Vec<String> = (0..20).map(|i| format!("{i:02}.jpg")).collect();
    fs::create_dir(capture.path("many")).unwrap();
    names.iter().for_each(|name| disc(48, 36).save(capture.path("many").join(name)).unwrap());
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    capture.model("models/0", &names);
    capture.model("found-again", &names[..19]);
    capture.prepare(|options| {
        (options.photographs, options.masks) = (capture.path("many"), MaskSource::Auto);
    });
    let rounds = ["point_triangulator", "bundle_adjuster"].repeat(3);
    assert_eq!(capture.calls()[3..10], [vec!["bundle_adjuster"], rounds].concat());
    let images = |folder: &str| fs::read(capture.path(folder).join("images.bin")).unwrap();
    assert_eq!(images("out/sparse/0"), images("found-again"));
}

#[test]
fn options_are_given_to_colmap() {
    let capture = Capture::new();
    let said = |change: fn(&mut PrepareOptions), all: &[&str]| {
        let _ = fs::remove_dir_all(capture.path("out"));
        capture.prepare(change);
        let text = fs::read_to_string(capture.path("calls")).unwrap();
        all.iter().for_each(|words| assert!(text.contains(words), "{words}\n{text}"));
    };
    let change = |options: &mut PrepareOptions| {
        (options.object_features, options.lens) = (true, "RADIAL");
        options.matching = Matching::Sequential;
    };
    let words = [
        "--ImageReader.camera_model RADIAL --ImageReader.single_camera 1 --ImageReader.mask_path",
        "--SiftExtraction.use_gpu 0",
        "--SiftMatching.use_gpu 0 --SequentialMatching.overlap 20",
        "--Mapper.filter_max_reproj_error 1.2",
    ];
    said(change, &words);
    // Newer versions of COLMAP have other names.
    capture.colmap("SiftExtraction", "FeatureExtraction");
    let words = [
        "--ImageReader.single_camera_per_image 1 --FeatureExtraction.use_gpu 1",
        "--FeatureMatching.use_gpu 1 --ExhaustiveMatching.block_size 10",
    ];
    said(|options| (options.gpu, options.camera_per_image) = (true, true), &words);
}

/// COLMAP would take what is left of it for the whole.
#[test]
fn a_photograph_that_is_cut_off_never_reaches_colmap() {
    let capture = Capture::new();
    let path = capture.path("photos/b.jpg");
    let whole = fs::read(&path).unwrap();
    fs::write(&path, &whole[..whole.len() - 40]).unwrap();
    let words = ["photos/b.jpg: a JPEG that is damaged or truncated", "Copy it again, or remove it."];
    capture.refused(as_they_are, &words);
    assert!(capture.calls().is_empty());
    fs::write(&path, whole).unwrap();
    capture.prepare(as_they_are);
}

#[test]
fn bad_input_leaves_no_folder() {
    let capture = Capture::new();
    let words = ["no program `no-such-colmap` on the PATH", "apt install colmap"];
    capture.refused(|options| options.colmap = "no-such-colmap".into(), &words);
    let other = capture.script("other", "echo some other program");
    capture.refused(|options| options.colmap = other, &["is not COLMAP"]);
    capture.refused(|options| options.photographs = capture.path("none"), &["no such folder"]);
    capture.refused(|options| options.masks = MaskSource::Command("rembg".into()), &["has no {in}"]);
    for bad in [0.0, -1.0, f32::NAN, f32::INFINITY] {
        capture.refused(|options| options.frames = FrameCount::PerSecond(bad), &["frames per second"]);
    }
    let few = "2 frames of a video, and cameras need at least 3";
    capture.refused(|options| options.frames = FrameCount::Count(2), &[few]);
    for frames in [FrameCount::Count(50), FrameCount::PerSecond(2.0)] {
        let words = ["photos is a folder of photographs", "Leave out --frames and --fps"];
        capture.refused(|options| options.frames = frames, &words);
    }
    let video = capture.path("clip");
    fs::write(&video, b"\0\0\0\x18ftypqt  \0\0\0\0").unwrap();
    let of_video = |options: &mut PrepareOptions| {
        (options.photographs, options.ffmpeg) = (video, "no-such-ffmpeg".into());
    };
    capture.refused(of_video, &["apt install ffmpeg"]);
    assert!(!capture.path("out").exists());
}

/// Cameras that were found by what stands still have a distortion that leaves little of the
/// photographs.
#[test]
fn cameras_that_leave_little_of_a_photograph_are_refused() {
    let capture = Capture::new();
    disc(10, 8).save(capture.path("small.jpg")).unwrap();
    let shrink = "cp -f \"$here/small.jpg\" \"$out/images/a.jpg\"; cp \"$(of --input_path \"$@\")\"/* \"$out/sparse\" ;;";
    capture.colmap("cp \"$(of --input_path \"$@\")\"/* \"$out/sparse\" ;;", shrink);
    capture.refused(as_they_are, &["photos/a.jpg", "10×8 of its 48×36", "--features object"]);
    assert!(!capture.path("out/images").exists());
}
