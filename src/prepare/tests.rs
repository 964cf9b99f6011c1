//! The whole of `prepare`, with a script in place of COLMAP.

use super::*;
use crate::dataset::{DatasetOptions, read_dataset};
use crate::pass::progress::{Bar, Silent};
use crate::prepare::test_data::{disc, fake_ffmpeg, script};
use crate::scene::{LoadOptions, load};
use crate::view::Split;
use std::cell::RefCell;
use std::fs;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// Where the script finds the value of an option: `of --output_path "$@"`.
const OPTIONS: &str = r#"
of() { wanted=$1; shift; while [ $# -gt 0 ]; do if [ "$1" = "$wanted" ]; then echo "$2"; return; fi; shift; done; }
here=$(dirname "$0"); out=$(of --output_path "$@"); echo "$@" >> "$here/calls"
"#;
/// What COLMAP does, with models that lie beside the script.
const COLMAP: &str = r#"
if [ "$2" = -h ]; then echo "--ImageReader.single_camera arg --SiftExtraction.use_gpu arg"; exit 0; fi
case $1 in
  feature_extractor) echo made > "$(of --database_path "$@")"; echo "Processed file [3/3]" ;;
  exhaustive_matcher) test -s "$(of --database_path "$@")" || exit 9; echo "Matching block [1/1, 1/1] in 1s" ;;
  matches_importer) cp "$(of --match_list_path "$@")" "$here/pairs" ;;
  point_triangulator) cp "$here"/found-again/* "$out" ;;
  bundle_adjuster) cp "$(of --input_path "$@")"/* "$out" ;;
  mapper) cp -r "$here"/models/. "$out"; echo "Registering image #1 (3)" ;;
  image_undistorter) mkdir -p "$out/images" "$out/sparse"
    cp -rL "$(of --image_path "$@")"/. "$out/images"; cp "$(of --input_path "$@")"/* "$out/sparse" ;;
  *) echo "unknown command $1"; exit 1 ;;
esac
"#;

struct Capture {
    folder: TempDir,
}

impl Capture {
    /// Four photographs of a disc, of which COLMAP finds the cameras of three.
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let capture = Self { folder };
        fs::create_dir(capture.path("photos")).unwrap();
        for name in ["a.jpg", "b.jpg", "c.png", "d.jpg"] {
            disc(48, 36).save(capture.path("photos").join(name)).unwrap();
        }
        capture.model("0", &["a.jpg", "c.png", "d.jpg"]);
        capture.colmap(COLMAP);
        capture
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn colmap(&self, body: &str) {
        script(self.folder.path(), "colmap", &format!("{OPTIONS}{body}"));
    }

    /// A binary model with these photographs and two points.
    fn model(&self, name: &str, photographs: &[&str]) {
        write_model(&self.path("models").join(name), photographs, 0);
    }

    fn options(&self) -> PrepareOptions {
        let masks = MaskSource::Backdrop;
        let colmap = self.path("colmap");
        PrepareOptions { masks, colmap, ..PrepareOptions::new(self.path("photos"), self.path("out")) }
    }

    /// What is said of options, changed so that they are refused.
    fn refused(&self, change: impl FnOnce(&mut PrepareOptions)) -> String {
        let mut options = self.options();
        change(&mut options);
        refused(&options)
    }

    fn calls(&self) -> Vec<String> {
        let text = fs::read_to_string(self.path("calls")).unwrap_or_default();
        let _ = fs::remove_file(self.path("calls"));
        let first = |line: &str| line.split(' ').next().unwrap_or_default().to_owned();
        text.lines().filter(|line| !line.ends_with(" -h")).map(first).collect()
    }
}

/// A binary model with these photographs, each with so many features of the first of two points.
fn write_model(model: &Path, photographs: &[&str], features: u64) {
    fs::create_dir_all(model).unwrap();
    let words = |values: &[u64]| values.iter().flat_map(|value| value.to_le_bytes()).collect::<Vec<u8>>();
    let numbers = |values: &[f64]| values.iter().flat_map(|value| value.to_le_bytes()).collect::<Vec<u8>>();
    // Camera 1 of model 1, PINHOLE.
    let camera = [
        words(&[1]),
        [1u32, 1].map(u32::to_le_bytes).concat(),
        words(&[48, 36]),
        numbers(&[60.0, 60.0, 24.0, 18.0]),
    ];
    fs::write(model.join("cameras.bin"), camera.concat()).unwrap();
    let mut images = words(&[photographs.len() as u64]);
    for (i, photograph) in photographs.iter().enumerate() {
        images.extend((i as u32).to_le_bytes());
        images.extend(numbers(&[1.0, 0.0, 0.0, 0.0, i as f64, 0.0, 4.0]));
        images.extend(1u32.to_le_bytes());
        images.extend(photograph.as_bytes());
        images.push(0);
        images.extend(words(&[features]));
        for _ in 0..features {
            images.extend(numbers(&[0.0, 0.0]));
            images.extend(words(&[1]));
        }
    }
    fs::write(model.join("images.bin"), images).unwrap();
    let point =
        |error: f64| [words(&[1]), numbers(&[0.0; 3]), vec![0; 3], numbers(&[error]), words(&[0])].concat();
    fs::write(model.join("points3D.bin"), [words(&[2]), point(0.5), point(0.75)].concat()).unwrap();
}

fn refused(options: &PrepareOptions) -> String {
    let error = prepare(options, &Silent).unwrap_err();
    format!("{error} {}", error.help().unwrap_or_default())
}

#[test]
fn photographs_become_a_data_set_that_is_read() {
    let capture = Capture::new();
    let prepared = prepare(&capture.options(), &Silent).unwrap();
    assert_eq!(prepared.to_string(), "registered 3 of 4, reprojection error 0.62 px; left out: b.jpg");
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
    assert!(refused(&capture.options()).contains("is not empty"));
}

/// The sharpest frames take the place of photographs; a second run, after a stop, does not extract them again.
#[test]
fn a_video_becomes_a_data_set_of_its_sharpest_frames() {
    let capture = Capture::new();
    let names = |numbers: &[u32]| numbers.iter().map(|n| format!("{n:06}.jpg")).collect::<Vec<_>>();
    for (i, name) in names(&[1, 2, 3, 4, 5, 6, 7, 8]).iter().enumerate() {
        let sharp = disc(48, 36);
        let frame = if i % 2 == 1 { sharp } else { image::imageops::blur(&sharp, 1.5) };
        frame.save(capture.path(name)).unwrap();
    }
    let kept = names(&[2, 4, 6, 8]);
    fs::remove_dir_all(capture.path("models")).unwrap();
    capture.model("0", &kept.iter().map(String::as_str).collect::<Vec<_>>());
    fs::write(capture.path("clip.mov"), b"\0\0\0\x18ftypqt  \0\0\0\0").unwrap();
    let ffmpeg = fake_ffmpeg(capture.folder.path(), 8, "00:00:00.32");
    let (photographs, frames) = (capture.path("clip.mov"), FrameCount::Count(4));
    let options = PrepareOptions { photographs, frames, ffmpeg, ..capture.options() };
    capture.colmap(&COLMAP.replace("  mapper)", "  mapper) exit 1;;\n  unused)"));
    assert!(refused(&options).contains("colmap mapper"));
    capture.colmap(COLMAP);
    let prepared = prepare(&options, &Silent).unwrap();
    let expected =
        "4 of 8 frames, the sharpest of each interval\nregistered 4 of 4, reprojection error 0.62 px";
    assert_eq!(prepared.to_string(), expected);
    let mut made: Vec<_> = fs::read_dir(capture.path("out/images"))
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    made.sort();
    assert_eq!(made, kept);
    let said = fs::read_to_string(capture.path("ffmpeg-calls")).unwrap();
    assert_eq!(said.lines().filter(|line| line.contains("select=")).count(), 1, "{said}");
    assert!(!capture.path("out/.work").exists() && prepared.scene.is_some());
}

/// What has the name of a result is replaced while work goes on.
#[test]
fn photographs_and_masks_in_the_output_folder_are_refused() {
    let capture = Capture::new();
    let out = capture.path("photos");
    fs::create_dir_all(out.join(".work")).unwrap();
    fs::rename(capture.path("photos/a.jpg"), capture.path("a.jpg")).unwrap();
    fs::create_dir(out.join("images")).unwrap();
    fs::rename(capture.path("a.jpg"), out.join("images/a.jpg")).unwrap();
    let given = PrepareOptions { photographs: out.join("images"), out: out.clone(), ..capture.options() };
    assert!(refused(&given).contains("the photographs, "), "{}", refused(&given));
    let masks = MaskSource::Folder(out.join("images"));
    let given = PrepareOptions { photographs: capture.path("models"), out, masks, ..capture.options() };
    assert!(refused(&given).contains("the masks, "), "{}", refused(&given));
    assert!(capture.path("photos/images/a.jpg").is_file());
}

#[test]
fn distorted_photographs_are_kept_byte_by_byte() {
    let capture = Capture::new();
    prepare(&PrepareOptions { keep_distortion: true, ..capture.options() }, &Silent).unwrap();
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
    let prepared =
        prepare(&PrepareOptions { masks: MaskSource::Alpha, ..capture.options() }, &Silent).unwrap();
    assert!(prepared.scene.is_none() && !prepared.has_masks);
    assert!(!capture.path("out/masks").exists() && !capture.path("out/scene.ron").exists());
    assert!(capture.path("out/sparse/0/images.bin").is_file());
}

/// A step that fails leaves nothing under a final name, and what was done before it is not done again.
#[test]
fn a_failure_is_explained_and_work_goes_on_after_it() {
    let capture = Capture::new();
    capture.colmap(&COLMAP.replace("  mapper)", "  mapper) echo 'out of memory'; exit 1;;\n  unused)"));
    let text = refused(&capture.options());
    assert!(text.contains("colmap mapper: it failed") && text.contains("out of memory"), "{text}");
    assert!(text.contains("mapping.log"), "{text}");
    let names: Vec<_> =
        fs::read_dir(capture.path("out")).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    assert_eq!(names.len(), 2, "{names:?}");
    assert_eq!(capture.calls(), ["feature_extractor", "exhaustive_matcher", "mapper"]);
    capture.colmap(COLMAP);
    prepare(&capture.options(), &Silent).unwrap();
    assert_eq!(capture.calls(), ["mapper", "image_undistorter", "image_undistorter"]);
}

#[test]
fn other_options_do_later_steps_again() {
    let capture = Capture::new();
    capture.colmap(&COLMAP.replace("  image_undistorter)", "  image_undistorter) exit 1;;\n  unused)"));
    refused(&capture.options());
    capture.calls();
    capture.colmap(COLMAP);
    prepare(&PrepareOptions { lens: LensModel::Radial, ..capture.options() }, &Silent).unwrap();
    assert_eq!(capture.calls()[..3], ["feature_extractor", "exhaustive_matcher", "mapper"]);
}

#[test]
fn no_cameras_are_explained() {
    let capture = Capture::new();
    capture.colmap(
        &COLMAP.replace(
            "  mapper)",
            "  mapper) echo 'ERROR: failed to create sparse model'; exit 1;;\n  unused)",
        ),
    );
    let text = refused(&capture.options());
    assert!(text.contains("no pair of photographs to start from") && text.contains("overlap"), "{text}");
    fs::remove_dir_all(capture.path("models")).unwrap();
    capture.model("0", &["a.jpg", "d.jpg"]);
    capture.colmap(COLMAP);
    assert!(refused(&capture.options()).contains("the cameras of 2 photographs only"));
}

/// Notes that are told.
#[derive(Default)]
struct Notes(RefCell<Vec<String>>);

impl Progress for Notes {
    fn note(&self, text: &str) {
        self.0.borrow_mut().push(text.to_owned());
    }

    fn print(&self, _: &str) {}

    fn bar(&self, _: &str, _: u64) -> Box<dyn Bar> {
        Box::new(Silent)
    }
}

#[test]
fn of_several_models_the_largest_is_used_and_said() {
    let capture = Capture::new();
    capture.model("1", &["a.jpg", "b.jpg", "c.png", "d.jpg"]);
    let notes = Notes::default();
    let prepared = prepare(&capture.options(), &notes).unwrap();
    assert!(prepared.left_out.is_empty());
    let notes = notes.0.into_inner().join("\n");
    assert!(notes.contains("2 models, of 4, 3 photographs"), "{notes}");
    assert!(notes.contains("the background is plain"), "{notes}");
}

#[test]
fn many_photographs_of_one_camera_are_adjusted_in_rounds() {
    let capture = Capture::new();
    let names: Vec<String> = (0..20).map(|i| format!("{i:02}.jpg")).collect();
    fs::create_dir(capture.path("many")).unwrap();
    names.iter().for_each(|name| disc(48, 36).save(capture.path("many").join(name)).unwrap());
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    capture.model("0", &names);
    write_model(&capture.path("found-again"), &names, 2);
    let photographs = capture.path("many");
    let options = PrepareOptions { photographs, masks: MaskSource::Alpha, ..capture.options() };
    prepare(&options, &Silent).unwrap();
    let calls = capture.calls();
    let expected =
        [["bundle_adjuster"; 1].as_slice(), &["point_triangulator", "bundle_adjuster"].repeat(3)].concat();
    assert_eq!(calls[3..10], expected);
    let images = |folder: &str| fs::read(capture.path(folder).join("images.bin")).unwrap();
    assert_eq!(images("out/sparse/0"), images("found-again"));
}

/// Three photographs of a square that changes before a pattern that does not, and their masks.
fn turntable() -> (Capture, PrepareOptions) {
    let capture = Capture::new();
    let (photos, masks) = (capture.path("table"), capture.path("masks"));
    fs::create_dir(&photos).unwrap();
    fs::create_dir(&masks).unwrap();
    let inside = |x: u32, y: u32| (18..30).contains(&x) && (12..24).contains(&y);
    for (i, name) in ["a", "c", "d"].iter().enumerate() {
        let pattern = |x: u32, y: u32| 60 * ((x / 6 + y / 6) % 3) as u8;
        let photograph = image::RgbImage::from_fn(48, 36, |x, y| {
            image::Rgb([if inside(x, y) { 80 * i as u8 } else { pattern(x, y) }; 3])
        });
        photograph.save(photos.join(format!("{name}.png"))).unwrap();
        let mask = image::GrayImage::from_fn(48, 36, |x, y| image::Luma([255 * u8::from(inside(x, y))]));
        mask.save(masks.join(format!("{name}.png"))).unwrap();
    }
    write_model(&capture.path("models/0"), &["a.png", "c.png", "d.png"], 4);
    let options =
        PrepareOptions { photographs: photos, masks: MaskSource::Folder(masks), ..capture.options() };
    (capture, options)
}

#[test]
fn on_a_turntable_cameras_are_adjusted_by_what_turns_with_the_object() {
    let (capture, options) = turntable();
    write_model(&capture.path("found-again"), &["a.png", "c.png", "d.png"], 5);
    let notes = Notes::default();
    prepare(&options, &notes).unwrap();
    let notes = notes.0.into_inner().join("\n");
    assert!(notes.contains("25 % more observations of points"), "{notes}");
    let round = ["point_triangulator", "bundle_adjuster"];
    let first =
        ["feature_extractor", "exhaustive_matcher", "mapper", "feature_extractor", "matches_importer"];
    let expected = [first.as_slice(), &round, &round, &round, &["image_undistorter"; 2]].concat();
    assert_eq!(capture.calls(), expected);
    assert_eq!(fs::read_to_string(capture.path("pairs")).unwrap(), "a.png c.png\na.png d.png\nc.png d.png\n");
    let images = |folder: &str| fs::read(capture.path(folder).join("images.bin")).unwrap();
    assert_eq!(images("out/sparse/0"), images("found-again"));
}

#[test]
fn cameras_stay_where_nothing_else_turns() {
    let (capture, options) = turntable();
    write_model(&capture.path("found-again"), &["a.png", "c.png", "d.png"], 3);
    let notes = Notes::default();
    prepare(&options, &notes).unwrap();
    assert!(notes.0.into_inner().join("\n").contains("nothing around the object turns with it"));
    let images = |folder: &str| fs::read(capture.path(folder).join("images.bin")).unwrap();
    assert_eq!(images("out/sparse/0"), images("models/0"));
    fs::remove_dir_all(capture.path("out")).unwrap();
    capture.colmap(
        &COLMAP.replace("  bundle_adjuster)", "  bundle_adjuster) echo 'no residuals'; exit 1;;\n  unused)"),
    );
    let notes = Notes::default();
    prepare(&options, &notes).unwrap();
    let notes = notes.0.into_inner().join("\n");
    assert!(
        notes.contains("by the object alone: colmap bundle_adjuster") && notes.contains("no residuals"),
        "{notes}"
    );
    assert_eq!(images("out/sparse/0"), images("models/0"));
    fs::remove_dir_all(capture.path("out")).unwrap();
    capture.calls();
    prepare(&PrepareOptions { features: FeatureArea::Object, ..options }, &Silent).unwrap();
    assert_eq!(
        capture.calls()[..4],
        ["feature_extractor", "exhaustive_matcher", "mapper", "image_undistorter"]
    );
}

/// COLMAP would take what is left of it for the whole.
#[test]
fn a_photograph_that_is_cut_off_never_reaches_colmap() {
    let capture = Capture::new();
    let path = capture.path("photos/b.jpg");
    let whole = fs::read(&path).unwrap();
    fs::write(&path, &whole[..whole.len() - 40]).unwrap();
    let text = refused(&capture.options());
    assert!(text.contains("photos/b.jpg: a JPEG that is damaged or truncated"), "{text}");
    assert!(text.contains("Copy it again, or remove it."), "{text}");
    assert!(capture.calls().is_empty());
    fs::write(&path, whole).unwrap();
    prepare(&capture.options(), &Silent).unwrap();
}

#[test]
fn bad_input_leaves_no_folder() {
    let capture = Capture::new();
    let text = capture.refused(|options| options.colmap = "no-such-colmap-anywhere".into());
    assert!(
        text.contains("no program `no-such-colmap-anywhere` on the PATH")
            && text.contains("apt install colmap"),
        "{text}"
    );
    let text = capture.refused(|options| options.photographs = capture.path("none"));
    assert!(text.contains("no such folder"), "{text}");
    let text = capture.refused(|options| options.masks = MaskSource::Command("rembg".into()));
    assert!(text.contains("has no {in}"), "{text}");
    assert!(!capture.path("out").exists());
    let other = script(capture.folder.path(), "other", "echo some other program");
    let text = capture.refused(|options| options.colmap = other);
    assert!(text.contains("is not COLMAP"), "{text}");
    fs::create_dir(capture.path("out")).unwrap();
    fs::write(capture.path("out/thesis.txt"), "x").unwrap();
    assert!(refused(&capture.options()).contains("it has thesis.txt"));
    assert_eq!(fs::read_dir(capture.path("out")).unwrap().count(), 1);
}

#[test]
fn bad_videos_leave_no_folder() {
    let capture = Capture::new();
    for bad in [0.0, -1.0, f32::NAN, f32::INFINITY] {
        let text = capture.refused(|options| options.frames = FrameCount::PerSecond(bad));
        assert!(text.contains("frames per second"), "{text}");
    }
    let text = capture.refused(|options| options.frames = FrameCount::Count(2));
    assert!(text.contains("2 frames of a video, and cameras need at least 3"), "{text}");
    let video = capture.path("clip");
    fs::write(&video, b"\0\0\0\x18ftypqt  \0\0\0\0").unwrap();
    let of_video = |ffmpeg: PathBuf| {
        capture.refused(|options| {
            (options.photographs, options.ffmpeg) = (video.clone(), ffmpeg);
            options.frames = FrameCount::Count(50);
        })
    };
    assert!(of_video("no-such-ffmpeg-anywhere".into()).contains("apt install ffmpeg"));
    let broken = script(capture.folder.path(), "broken", "echo moov atom not found >&2; exit 1");
    assert!(of_video(broken).contains("moov atom not found"));
    let text = of_video(fake_ffmpeg(capture.folder.path(), 40, "00:00:01.60"));
    assert!(text.contains("40 frames, fewer than the 50 of --frames 50"), "{text}");
    assert!(!capture.path("out").exists());
}

#[test]
fn frames_of_a_folder_of_photographs_are_refused() {
    let capture = Capture::new();
    for frames in [FrameCount::Count(50), FrameCount::PerSecond(2.0)] {
        let error = prepare(&PrepareOptions { frames, ..capture.options() }, &Silent).unwrap_err();
        assert_eq!(error.exit_code(), 2);
        assert!(error.to_string().contains("photos is a folder of photographs"), "{error}");
        assert!(error.help().unwrap().contains("Leave out --frames and --fps"), "{error:?}");
        assert!(!capture.path("out").exists(), "it is refused before anything is written");
    }
}

/// Cameras that were found by what stands still have a distortion that leaves little of the photographs.
#[test]
fn cameras_that_leave_little_of_a_photograph_are_refused() {
    let capture = Capture::new();
    disc(10, 8).save(capture.path("small.jpg")).unwrap();
    let shrink = "cp -f \"$here/small.jpg\" \"$out/images/a.jpg\"; cp \"$(of --input_path \"$@\")\"/* \"$out/sparse\" ;;";
    let body = COLMAP.replace("cp \"$(of --input_path \"$@\")\"/* \"$out/sparse\" ;;", shrink);
    assert_ne!(body, COLMAP);
    capture.colmap(&body);
    let text = refused(&capture.options());
    assert!(
        ["photos/a.jpg", "10×8 of its 48×36", "--masks DIR"].iter().all(|word| text.contains(word)),
        "{text}"
    );
    assert!(!capture.path("out/images").exists());
}

#[test]
fn a_turntable_without_masks_is_named() {
    let capture = Capture::new();
    let notes = Notes::default();
    prepare(&PrepareOptions { masks: MaskSource::Alpha, ..capture.options() }, &notes).unwrap();
    let said = notes.0.into_inner().join("\n");
    assert!(said.contains("the same in all photographs") && said.contains("no masks"), "{said}");
}
