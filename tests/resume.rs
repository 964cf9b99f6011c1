//! Runs that are killed go on where they were, and end with the same bits as runs without a break.

use crate::common::{self, AtStep, AtWork, Data, ENDLESS, Outcome, changed, colmap_scene, files_below, join};
use crate::photos::photographs;
use lobelia::progress::{Progress, Silent};
use lobelia::{codec::gltf::export::write_glb, ecs::*, prelude::*};
use serde_json::Value;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::{collections::BTreeMap, sync::LazyLock, time::Duration};

/// Where a run is killed: a pass, and the position of its bar.
type Death = (&'static str, u64);

/// Runs a scene into `out`; `Err` if it was killed, without any of its code after that.
fn run(data: &Data, scene: &str, out: &str, resume: bool, death: Option<Death>) -> Result<Result<()>, ()> {
    // A run without a break does not pause either.
    let checkpoint_every = (resume || death.is_some()).then_some(Duration::ZERO);
    let kill: fn() = || resume_unwind(Box::new("killed"));
    let progress: Arc<dyn Progress> = match death {
        Some((pass, step)) => Arc::new(AtStep(pass, step, kill)),
        None => Arc::new(Silent),
    };
    let run = || data.run_here(scene, out, checkpoint_every, resume, progress.clone());
    catch_unwind(AssertUnwindSafe(run)).map_err(|_| ())
}

/// The results of a run, without times and what the manifest says of the run itself.
fn results(data: &Data, out: &str) -> BTreeMap<String, String> {
    let read = |file: String| {
        let bytes = data.bytes(format!("{out}/{file}"));
        let shown = match file.rsplit('/').next().unwrap() {
            "log.csv" => {
                // Without the second column, which has times.
                let parts = |line: &str| -> String {
                    let (step, rest) = line.split_once(',').unwrap();
                    format!("{step}{}\n", rest.split_once(',').unwrap().1)
                };
                String::from_utf8(bytes).unwrap().lines().map(parts).collect()
            }
            "metrics.json" => {
                let mut scores: Value = serde_json::from_slice(&bytes).unwrap();
                scores["fit_secs"].take();
                scores["materials_tried"]["seconds"].take();
                scores["peak_rss_mib"].take();
                scores.to_string()
            }
            "run.json" => data.states(out).join(" "),
            "contact_sheet.png" | "scene.ron" | "report.html" => String::new(),
            _ => bytes
                .iter()
                .fold(0u64, |sum, byte| sum.rotate_left(7) ^ u64::from(*byte) ^ sum.wrapping_mul(31))
                .to_string(),
        };
        (file, shown)
    };
    files_below(&data.path(out)).into_iter().map(read).collect()
}

/// Runs a scene without a break, and with a break at each of these deaths in turn: the results must
/// be the same.
#[track_caller]
fn survives(data: &Data, scene: &str, deaths: &[Death]) {
    run(data, scene, "whole", false, None).unwrap().unwrap();
    for (i, death) in deaths.iter().enumerate() {
        let killed = run(data, scene, "broken", i > 0, Some(*death));
        assert!(killed.is_err(), "{death:?}: the run was not killed but ended: {killed:?}");
        assert_eq!(data.manifest("broken")["state"], "running");
    }
    run(data, scene, "broken", true, None).unwrap().unwrap();
    let (whole, broken) = (results(data, "whole"), results(data, "broken"));
    assert_eq!(whole.keys().collect::<Vec<_>>(), broken.keys().collect::<Vec<_>>());
    for (file, bits) in &whole {
        assert!(*bits == broken[file], "{file} differs:\n{bits}\n{}", broken[file]);
    }
}

/// A ball with a small one before it, so that there are shadows.
fn two_balls() -> Data {
    let data = Data::new();
    let mut mesh = sphere_mesh(Vec3::ZERO, 0.8).unwrap();
    let small = sphere_mesh(Vec3::new(0.0, 0.0, 0.95), 0.1).unwrap();
    join(&mut mesh, &small);
    mesh.uvs = None;
    write_glb(&data.path("mesh.glb"), &mesh, None).unwrap();
    data
}

/// A fit of which these words are said, a picture, and files of the object.
fn fit_and_save(words: &str) -> String {
    format!(r#"Fit(name: "fit", batch: 64, {words}), Render(name: "novel"), Save(), Export(),"#)
}

/// A scene of the data set with its mesh.
fn scene(material: &str, passes: &str) -> String {
    common::scene(passes)
        .replace("texture_size: 16", "texture_size: 64")
        .replace("passes:", "visibility: Traced(directions: 64, refresh_every: 4),\n    passes:")
        .replace("passes:", &format!("{material}\n    passes:"))
}

#[test]
fn a_fit_goes_on_from_the_last_part_that_was_done() {
    let data = two_balls();
    let text = scene("", &fit_and_save("steps: 300, detail: true"));
    // With one material, with several, with what was chosen, while the texture gets its detail, and
    // during the pictures.
    let tried = ("fit, several base materials", 40);
    survives(&data, &text, &[("fit", 60), tried, ("fit", 160), ("fit", 85), ("novel", 1)]);
}

#[test]
fn a_fit_that_moves_cameras_and_vertices_has_no_parts_but_its_choices_and_its_detail() {
    let data = two_balls();
    let passes = r#"Fit(name: "fit", steps: 80, batch: 64, cameras: PosesAndFocal, exposure: Color, vertices: true, detail: true),
        Render(name: "novel"), Evaluate(name: "scores", scores: [(pass: "novel", truth: Photographs)]), Save(), Export(),"#;
    let text = scene("material: (gloss: Blend(materials: 2)),", passes);
    survives(&data, &text, &[("fit", 77), ("fit", 85), ("novel", 1)]);
}

/// A scene whose first photograph of each split is of one placement, and the others of another, of
/// which more is `said`.
fn in_two_rounds(passes: &str, said: &str) -> String {
    let rounds = format!(r#"[(photographs: "rgb_000000"), (photographs: "rgb_"{said})]"#);
    let views = format!(r#"Dataset(path: "$DATA", placements: {rounds})"#);
    changed(&scene("material: (gloss: One),", passes), r#"Dataset(path: "$DATA")"#, &views)
}

#[test]
fn an_object_that_was_turned_over_goes_on_and_one_under_two_lights() {
    let data = two_balls();
    let text = in_two_rounds(&fit_and_save("steps: 120"), "");
    // Between two moves of the rotation, after more, and during the pictures.
    survives(&data, &text, &[("fit", 40), ("fit", 90), ("novel", 1)]);
    let data = two_balls();
    let text = in_two_rounds(&fit_and_save("steps: 80, detail: true"), ", light: Own");
    survives(&data, &text, &[("fit", 30), ("fit", 61), ("novel", 1)]);
}

#[test]
fn roughness_of_texels_goes_on_through_two_fits() {
    let data = Data::new();
    let passes = r#"Fit(name: "fit", steps: 6, batch: 64), Fit(name: "again", steps: 6, batch: 64), Save(),"#;
    let text = scene("material: (gloss: Texels()),", passes);
    survives(&data, &text, &[("fit", 5), ("again", 5)]);
}

#[test]
fn a_shape_goes_on_from_the_last_level_that_was_done() {
    let data = photographs();
    let passes = r#"Shape(name: "shape", levels: [
            (cells: 16, texel_cells: 12, steps: 54, hold: 5), (cells: 20, texel_cells: 16, steps: 12),
        ], batch: 64, silhouette_batch: 32, cameras: PosesAndFocal, exposure: Color),
        Fit(name: "fit", steps: 10, batch: 64), Render(name: "novel"), Save(), Export(),"#;
    let mesh = r#"Mesh(path: "$DATA/mesh.glb", texture_size: 64)"#;
    let text = changed(&scene("", passes), mesh, "Unknown(cells: 16, texture_size: 128)");
    survives(&data, &text, &[("shape", 1), ("shape", 53), ("shape", 63), ("fit", 7)]);
}

/// A fit, and another that takes some seconds.
fn long_fits() -> String {
    let passes = r#"Fit(name: "fit", steps: 10, batch: 64), Fit(name: "again", steps: 500, batch: 64, vertices: true), Save(),"#;
    scene("", passes)
}

/// The results of these without a break.
static WHOLE: LazyLock<BTreeMap<String, String>> = LazyLock::new(|| {
    let data = Data::new();
    data.run(&long_fits(), "whole", &["--quiet", "--threads", "2"]).succeeded();
    results(&data, "whole")
});

/// A run of these whose second fit is at work.
fn at_work(data: &Data) -> AtWork {
    let at_work = AtWork::start(data, &long_fits(), &["--threads", "2"], "again");
    at_work.until_a_step();
    at_work
}

fn resumed(data: &Data, arguments: &[&str]) -> Outcome {
    data.run_file("scene.ron", "out", &[&["--quiet", "--threads", "2", "--resume"], arguments].concat())
}

#[test]
fn a_killed_process_goes_on_with_what_it_was_begun_with_and_nothing_else() {
    let data = Data::new();
    at_work(&data).kill();
    let refused = |arguments: &[&str], words: &[&str]| resumed(&data, arguments).refused(words);
    refused(&["--seed", "9"], &["scene is not the one", "--force"]);
    refused(&["--set", "passes.again.rates.light=0.011"], &["scene is not the one"]);
    refused(&["--force"], &["--resume"]);
    let photograph = "train/image/rgb_000000.exr";
    let bytes = data.bytes(photograph);
    data.write(photograph, data.bytes("train/image/rgb_000001.exr"));
    refused(&[], &["rgb_000000.exr is not what it was", "Put it back"]);
    data.write(photograph, bytes);
    let begun = data.text("out/run.json");
    let version = data.manifest("out")["version"].as_str().unwrap().to_owned();
    data.write("out/run.json", begun.replace(&version, "0.0.1"));
    refused(&[], &["begun by version 0.0.1"]);
    data.write("out/run.json", begun);
    // A finished run is left as it is.
    for _ in 0..2 {
        let said = resumed(&data, &[]).succeeded().stderr;
        assert_eq!(results(&data, "out"), *WHOLE, "{said}");
    }
}

#[test]
fn a_resumed_run_reports_what_was_done_before_its_break() {
    let data = Data::new();
    let passes = r#"Fit(name: "fit", steps: 6, batch: 64), Fit(name: "again", steps: 6, batch: 64),"#;
    let text = scene("", passes);
    let page = || data.text("out/report.html");
    run(&data, &text, "out", false, Some(("again", 5))).unwrap_err();
    let before = data.manifest("out")["passes"][0].clone();
    assert!(before["secs"].is_number() && before["said"].to_string().contains("6 steps"), "{before}");
    assert!(page().contains("s-running") && page().contains("fit: albedo"));
    run(&data, &text, "out", true, None).unwrap().unwrap();
    let after = data.manifest("out");
    assert_eq!(after["passes"][0], before);
    assert!(after["said"].to_string().contains("goes on in pass again"), "{after}");
    let again = &after["passes"][1];
    assert!(again["secs"].is_number() && again["said"].to_string().contains("6 steps"), "{again}");
    for words in ["s-finished", "fit: albedo", "again: albedo", "fit: 6 steps", "again: 6 steps"] {
        assert!(page().contains(words), "no {words:?} in the report");
    }
}

#[cfg(unix)]
#[test]
fn a_stopped_process_goes_on_and_its_first_results_are_replaced() {
    let data = Data::new();
    let at_work = at_work(&data);
    at_work.signal("TERM");
    assert_eq!(at_work.ended(), Some(143));
    assert_eq!(data.states("out"), ["finished", "interrupted", "finished"]);
    resumed(&data, &[]).succeeded();
    assert_eq!(results(&data, "out"), *WHOLE);
}

#[test]
fn without_a_run_to_go_on_with_one_begins() {
    let data = Data::new();
    let text = scene("", r#"Fit(name: "fit", steps: 4, batch: 128),"#);
    data.write("scene.ron", &text);
    resumed(&data, &[]).succeeded();
    assert_eq!(data.manifest("out")["state"], "finished");
    assert!(!data.path("out/.checkpoint").exists());
    // What no run has written is left alone.
    data.write("other/mine.txt", "mine");
    data.run(&text, "other", &["--resume"]).refused(&[]);
    assert_eq!(files_below(&data.path("other")), ["mine.txt"]);
}

/// Going on is never another word for beginning again, or for leaving another scene as it is.
#[cfg(unix)]
#[test]
fn results_that_cannot_be_gone_on_with_stay() {
    let data = Data::new();
    let endless = scene("", &[r#"Fit(name: "fit", steps: 4), "#, ENDLESS, "Save(),"].concat());
    let at_work = AtWork::start(&data, &endless, &["--threads", "2"], "endless");
    at_work.until_a_step();
    at_work.signal("TERM");
    assert_eq!(at_work.ended(), Some(143));
    std::fs::remove_dir_all(data.path("out/.checkpoint")).unwrap();
    let before = files_below(&data.path("out"));
    assert!(before.iter().any(|file| file.starts_with("saved/")), "{before:?}");
    let refused = |words: &[&str]| resumed(&data, &[]).refused(words);
    refused(&["kept no checkpoints", "--force"]);
    assert_eq!(files_below(&data.path("out")), before);
    let text = scene("", r#"Fit(name: "fit", steps: 4, batch: 128),"#);
    data.run(&text, "out", &["--force", "--quiet"]).succeeded();
    data.write("scene.ron", text.replace("steps: 4", "steps: 5"));
    refused(&["has finished", "another scene", "--force"]);
}

/// Not only files count, but what they say: cameras may be in files of their own.
#[test]
fn other_cameras_are_not_gone_on_with() {
    let data = Data::new();
    for name in ["a.exr", "b.exr"] {
        data.write(format!("colmap/images/{name}"), data.bytes("train/image/rgb_000000.exr"));
    }
    let camera = |focal: f32| data.write_colmap(&["a.exr", "b.exr"], focal);
    camera(40.0);
    run(&data, &colmap_scene(), "out", false, Some(("novel", 1))).unwrap_err();
    camera(41.0);
    let error = run(&data, &colmap_scene(), "out", true, None).unwrap().unwrap_err();
    assert!(error.to_string().contains("cameras"), "{error}");
    camera(40.0);
    run(&data, &colmap_scene(), "out", true, None).unwrap().unwrap();
}
