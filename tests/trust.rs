//! Late failures come first or lose nothing, nonsense is told of, and a scene reads nothing that it must not.

use crate::common::{Data, Outcome, command, files_below, manifest, save_png, scene, states};
use lobelia::error::Result;
use lobelia::pass::progress::{Bar, Progress, Silent};
use lobelia::pass::{self, RunOptions};
use lobelia::scene::{LoadOptions, load};
use serde_json::Value;
use std::path::Path;
use std::process::Stdio;
use std::time::Duration;

const FIT: &str = r#"Fit(name: "fit", steps: 30, batch: 256), "#;
const NOVEL: &str = r#"Render(name: "novel"), "#;
const SCORES: &str = r#"Evaluate(scores: [(pass: "novel", truth: Photographs)]), "#;

pub(crate) fn flat(text: &str) -> String {
    let words = text.split(|c: char| c.is_whitespace() || c == '│').filter(|word| !word.is_empty());
    words.collect::<Vec<_>>().join(" ")
}

fn metrics(out: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(out.join("metrics.json")).unwrap()).unwrap()
}

// What can fail late fails first.

#[test]
fn a_test_mask_of_another_size_ends_check_and_run_before_the_first_pass() {
    let data = Data::new();
    let small = image::GrayImage::from_pixel(2, 2, image::Luma([255]));
    save_png(&data.path("test/mask/rgb_000001.png"), &image::DynamicImage::ImageLuma8(small));
    let outcome = data.run(&scene(&[FIT, NOVEL, SCORES].concat()), "out", &["--quiet"]);
    assert_eq!(outcome.code, Some(2));
    assert!(flat(&outcome.stderr).contains("the mask has 2×2 pixels, its view 24×24"), "{}", outcome.stderr);
    assert!(files_below(&data.path("out")).is_empty());
    let check = Outcome::of(command(&["check"]).arg(data.path("scene.ron")).arg("--data").arg(data.root()));
    assert!(
        check.code == Some(2) && flat(&check.stderr).contains("the mask has 2×2 pixels"),
        "{}",
        check.stderr
    );
}

/// Changes the data while a pass is at work.
pub(crate) struct Meddler<F: Fn() + Clone + Send + Sync + 'static>(pub &'static str, pub F);

struct Trigger<F: Fn()>(F);

impl<F: Fn() + Clone + Send + Sync + 'static> Progress for Meddler<F> {
    fn note(&self, _: &str) {}

    fn print(&self, _: &str) {}

    fn bar(&self, title: &str, _: u64) -> Box<dyn Bar> {
        if title == self.0 { Box::new(Trigger(self.1.clone())) } else { Box::new(Silent) }
    }
}

impl<F: Fn() + Send + Sync> Bar for Trigger<F> {
    fn inc(&self, _: u64) {}

    fn set_position(&self, steps: u64) {
        if steps == 5 {
            self.0();
        }
    }

    fn set_message(&self, _: String) {}

    fn finish_and_clear(&self) {}
}

pub(crate) fn run_in(data: &Data, scene: &str, resume: bool, progress: &dyn Progress) -> Result<()> {
    let path = data.path("scene.ron");
    std::fs::write(&path, scene).unwrap();
    let options = LoadOptions { data: Some(data.root().to_owned()), ..LoadOptions::default() };
    let checkpoint = Some(Duration::ZERO);
    let run = RunOptions { out: data.path("out"), checkpoint, resume, ..RunOptions::default() };
    pass::run(&load(&path, &options)?, &run, progress)
}

#[test]
fn a_truth_that_goes_while_the_fit_works_costs_its_scores_alone_and_the_run_goes_on() {
    let data = Data::new();
    let scores = r#"Evaluate(scores: [(pass: "novel", truth: Folder("$DATA/test/gt/relit"))]), Save(),"#;
    let scene = scene(&[FIT, NOVEL, scores].concat());
    let (truth, aside) = (data.path("test/gt/relit/rgb_000001.exr"), data.path("aside.exr"));
    let (from, to) = (truth.clone(), aside.clone());
    let meddler = Meddler("fit", move || _ = std::fs::rename(&from, &to));
    let error = run_in(&data, &scene, false, &meddler).unwrap_err();
    assert!(error.to_string().contains("rgb_000001.exr: the file has gone since the run began"), "{error}");
    assert!(error.help().unwrap().contains("--resume"), "{error:?}");
    let manifest_of = || manifest(&data.path("out"));
    assert_eq!(states(&manifest_of()), ["finished", "finished", "failed", "finished"]);
    assert!(data.path("out/saved/scene.ron").exists() && data.path("out/metrics.json").exists());
    assert_eq!(manifest_of()["state"], "failed");
    // Back where it was, the run goes on.
    std::fs::rename(aside, truth).unwrap();
    run_in(&data, &scene, true, &Silent).unwrap();
    assert_eq!(states(&manifest_of()), ["finished"; 4]);
}

#[test]
fn a_photograph_that_changes_after_the_run_began_is_not_gone_on_with() {
    let data = Data::new();
    let scene = scene(&[FIT, NOVEL, SCORES].concat());
    let (photograph, truth) = (data.path("train/image/rgb_000001.exr"), data.path("out/novel"));
    // Something in the way of the pictures.
    let meddler = Meddler("fit", move || std::fs::write(&truth, "x").unwrap());
    assert!(run_in(&data, &scene, false, &meddler).is_err());
    std::fs::remove_file(data.path("out/novel")).unwrap();
    let bytes = std::fs::read(&photograph).unwrap();
    std::fs::copy(data.path("train/image/rgb_000002.exr"), &photograph).unwrap();
    let error = run_in(&data, &scene, true, &Silent).unwrap_err();
    assert!(error.to_string().contains("rgb_000001.exr is not what it was"), "{error}");
    std::fs::write(&photograph, bytes).unwrap();
    run_in(&data, &scene, true, &Silent).unwrap();
}

// No silent nonsense: see also `guard`.

#[test]
fn views_are_reported_and_nothing_is_wrong_with_sound_data() {
    let data = Data::new();
    data.run(&scene(&[FIT, NOVEL, SCORES].concat()), "out", &["--quiet"]).succeeded();
    let metrics = metrics(&data.path("out"));
    assert_eq!(metrics["steps_taken_back"], 0);
    // What a survey says before the fit may be there.
    let warnings = metrics["warnings"].to_string();
    for words in
        ["no pixel of", "is black in", "overlap to less", "are not explained", "ran away", "taken back"]
    {
        assert!(!warnings.contains(words), "{warnings}");
    }
    let table = std::fs::read_to_string(data.path("out/scores/views.csv")).unwrap();
    let mut rows = csv::Reader::from_reader(table.as_bytes());
    assert_eq!(
        rows.headers().unwrap(),
        vec!["view", "split", "pixels", "hit", "mask_iou", "psnr", "outliers"]
    );
    let rows: Vec<csv::StringRecord> = rows.records().map(|row| row.unwrap()).collect();
    let splits: Vec<&str> = rows.iter().map(|row| &row[1]).collect();
    assert_eq!(splits, ["train", "train", "train", "train", "train", "train", "test", "test"], "{table}");
    for row in &rows {
        let number = |at: usize| row[at].parse::<f64>().unwrap();
        assert!(number(3) > 0.9 && number(4) > 0.8 && number(5) > 10.0 && number(6) < 0.5, "{table}");
        assert!(&row[1] == "test" || number(2) > 50.0, "{table}");
    }
    assert_eq!(metrics["views"].as_array().unwrap().len(), 8);
}

#[test]
fn a_camera_that_looks_elsewhere_is_named() {
    let data = Data::new();
    // Far enough to the side that no pixel of its mask meets the object.
    data.change_camera("train", "rgb_000002.exr", |camera| {
        let w2c = camera["W2C"].as_array_mut().unwrap();
        w2c[3] = (w2c[3].as_f64().unwrap() + 5.0).into();
    });
    let outcome = data.run(&scene(&[FIT, NOVEL, SCORES].concat()), "out", &[]).succeeded();
    let metrics = metrics(&data.path("out"));
    let warnings = metrics["warnings"].to_string();
    for word in ["no pixel of view `rgb_000002` was used", "overlap to less than 0.6 in view `rgb_000002`"] {
        assert!(
            warnings.contains(word) && flat(&outcome.stderr).contains(word),
            "{warnings}\n{}",
            outcome.stderr
        );
    }
}

// Edges.

#[cfg(unix)]
#[test]
fn notes_that_nobody_can_read_do_not_fail_a_run() {
    let data = Data::new();
    let scene = scene(&[FIT, NOVEL, SCORES].concat());
    std::fs::write(data.path("scene.ron"), &scene).unwrap();
    let full = || std::fs::File::options().write(true).open("/dev/full").ok();
    for (i, to_full) in [false, true].into_iter().enumerate() {
        let out = data.path(&format!("out-{i}"));
        let line = if to_full { "exec \"$@\" 2>/dev/full >/dev/full" } else { "exec \"$@\" 2>&- >&-" };
        if to_full && full().is_none() {
            continue;
        }
        let mut run = std::process::Command::new("sh");
        run.args(["-c", line, "sh", env!("CARGO_BIN_EXE_lobelia"), "run"]).arg(data.path("scene.ron"));
        run.arg("--data").arg(data.root()).arg("--out").arg(&out).stdin(Stdio::null());
        assert_eq!(run.status().unwrap().code(), Some(0), "{line}");
        assert_eq!(manifest(&out)["state"], "finished");
        assert!(out.join("scores/views.csv").exists());
    }
}

#[cfg(unix)]
#[test]
fn a_reader_that_goes_away_does_not_fail_a_run() {
    let data = Data::new();
    std::fs::write(data.path("scene.ron"), scene(FIT)).unwrap();
    let mut run = command(&["run"]);
    run.arg(data.path("scene.ron")).arg("--data").arg(data.root()).arg("--out").arg(data.path("out"));
    let mut run = run.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    drop((run.stdout.take(), run.stderr.take()));
    assert_eq!(run.wait().unwrap().code(), Some(0));
    assert!(data.path("out/fit/light.npy").exists());
}

/// A scene in a folder of its own, whose mesh is named by `path`.
pub(crate) fn confined(data: &Data, path: &str) -> std::path::PathBuf {
    let folder = data.path("mine");
    std::fs::create_dir_all(&folder).unwrap();
    let text = format!(
        r#"Scene(version: 1, surface: Mesh(path: "{path}", texture_size: 16),
        views: Cameras([(name: "a", eye: (0, 0, 3), width: 8, height: 8)]),
        light: Fixed(Lobes(lobes: [(axis: (0, 1, 0), sharpness: 5, amplitude: (1, 1, 1))])),
        material: (albedo: Fixed(Constant(0.5, 0.5, 0.5)), specular: (albedo: Fixed(0.2, 0.2, 0.2), roughness: Fixed(0.3))),
        passes: [Render(name: "novel")])"#
    );
    let scene = folder.join("scene.ron");
    std::fs::write(&scene, text).unwrap();
    scene
}

pub(crate) fn check_and_run(data: &Data, scene: &Path, arguments: &[&str]) -> [Outcome; 2] {
    let out = data.path("mine/out");
    let _ = std::fs::remove_dir_all(&out);
    let check = Outcome::of(command(&["check"]).arg(scene).args(arguments));
    let run = Outcome::of(command(&["run", "--quiet"]).arg(scene).args(arguments).arg("--out").arg(out));
    [check, run]
}

#[test]
fn a_scene_reads_nothing_outside_its_folder_unless_told_so() {
    let data = Data::new();
    let outside = data.path("mesh.glb");
    let absolute = outside.to_str().unwrap().replace('\\', "/");
    std::fs::create_dir_all(data.path("mine")).unwrap();
    let mut paths = vec![absolute.clone(), "../mesh.glb".to_owned(), "../mine/../mesh.glb".to_owned()];
    #[cfg(unix)]
    {
        std::os::unix::fs::symlink(&outside, data.path("mine/link.glb")).unwrap();
        paths.push("link.glb".to_owned());
    }
    let root = data.root().to_str().unwrap();
    for path in paths {
        let scene = confined(&data, &path);
        for outcome in check_and_run(&data, &scene, &[]) {
            let said = flat(&outcome.stderr);
            assert_eq!(outcome.code, Some(2), "{path}: {said}");
            for word in ["outside the folder of the scene file", "--allow-outside", "--data"] {
                assert!(said.contains(word), "no {word:?} in {said}");
            }
        }
        for arguments in [&["--allow-outside"][..], &["--data", root]] {
            for outcome in check_and_run(&data, &scene, arguments) {
                outcome.succeeded();
            }
        }
    }
    std::fs::copy(&outside, data.path("mine/mesh.glb")).unwrap();
    for outcome in check_and_run(&data, &confined(&data, "mesh.glb"), &[]) {
        outcome.succeeded();
    }
}

#[test]
fn a_light_within_that_names_a_map_outside_is_refused() {
    let data = Data::new();
    std::fs::create_dir_all(data.path("mine")).unwrap();
    std::fs::copy(data.path("mesh.glb"), data.path("mine/mesh.glb")).unwrap();
    std::fs::write(data.path("mine/light.ron"), r#"Npy(path: "../evening.npy")"#).unwrap();
    let scene = confined(&data, "mesh.glb");
    let text = std::fs::read_to_string(&scene).unwrap();
    let from = text.find("light: Fixed(").unwrap();
    let to = text.find("material:").unwrap();
    let text = format!("{}light: Fixed(Ron(path: \"light.ron\")),\n{}", &text[..from], &text[to..]);
    std::fs::write(&scene, text).unwrap();
    for outcome in check_and_run(&data, &scene, &[]) {
        let said = flat(&outcome.stderr);
        assert!(
            outcome.code == Some(2) && said.contains("evening.npy, a light of the scene, is outside"),
            "{said}"
        );
    }
    for outcome in check_and_run(&data, &scene, &["--allow-outside"]) {
        outcome.succeeded();
    }
}

#[test]
fn a_data_set_within_that_names_photographs_outside_is_refused() {
    let data = Data::new();
    std::fs::create_dir_all(data.path("mine/set")).unwrap();
    let picture = image::RgbaImage::from_pixel(8, 8, image::Rgba([90, 120, 60, 255]));
    save_png(&data.path("elsewhere/a.png"), &image::DynamicImage::ImageRgba8(picture));
    let cameras = r#"{"fl_x": 10, "fl_y": 10, "cx": 4, "cy": 4, "w": 8, "h": 8, "frames": [{"file_path": "../../elsewhere/a.png",
        "transform_matrix": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 3], [0, 0, 0, 1]]}]}"#;
    std::fs::write(data.path("mine/set/transforms.json"), cameras).unwrap();
    let scene = data.path("mine/scene.ron");
    let text = r#"Scene(version: 1, surface: Sphere(radius: 0.8, texture_size: 16), views: Dataset(path: "set", hold_out: 0),
        light: Unknown(lobes: 4), passes: [Fit(name: "fit", steps: 2)])"#;
    std::fs::write(&scene, text).unwrap();
    for outcome in check_and_run(&data, &scene, &[]) {
        let said = flat(&outcome.stderr);
        assert!(
            outcome.code == Some(2) && said.contains("a.png, a photograph, is outside the folder"),
            "{said}"
        );
    }
    for outcome in check_and_run(&data, &scene, &["--allow-outside"]) {
        assert!(!outcome.stderr.contains("is outside"), "{}", outcome.stderr);
    }
}

#[test]
fn a_run_that_was_killed_at_its_very_end_is_tidy_once_it_is_resumed() {
    let data = Data::new();
    data.run(&scene(FIT), "out", &["--quiet"]).succeeded();
    let report = std::fs::read(data.path("out/report.html")).unwrap();
    std::fs::write(data.path("out/.lobelia.lock"), "").unwrap();
    std::fs::write(data.path("out/report.html"), "of before").unwrap();
    std::fs::write(data.path("out/.lobelia-abc.part.html"), "half a").unwrap();
    data.run(&scene(FIT), "out", &["--quiet", "--resume"]).succeeded();
    assert!(!data.path("out/.lobelia.lock").exists() && !data.path("out/.lobelia-abc.part.html").exists());
    assert!(report == std::fs::read(data.path("out/report.html")).unwrap());
}

#[test]
fn a_saved_scene_says_what_it_needs() {
    let data = Data::new();
    data.run(&scene(&[FIT, NOVEL, "Save(), "].concat()), "out", &["--quiet"]).succeeded();
    let saved = data.path("out/saved/scene.ron");
    let again = |arguments: &[&str]| {
        let out = data.path("again");
        let _ = std::fs::remove_dir_all(&out);
        Outcome::of(command(&["run", "--quiet"]).arg(&saved).args(arguments).arg("--out").arg(out))
    };
    let refused = again(&[]);
    let root = data.root().to_str().unwrap();
    let said = flat(&refused.stderr);
    assert!(
        refused.code == Some(2) && said.contains("A scene that a `Save` pass wrote names its data by path"),
        "{said}"
    );
    again(&["--data", root]).succeeded();
    again(&["--allow-outside"]).succeeded();
    let view = Outcome::of(command(&["view"]).arg(data.path("out")));
    assert!(view.code == Some(2) && view.stderr.contains("--allow-outside"), "{}", view.stderr);
    Outcome::of(command(&["view", "--data", root]).arg(data.path("out"))).succeeded();
}
