//! Late failures come first or lose nothing, nonsense is told of, and what a run reads is neither
//! changed nor written over.

use crate::common::*;
use lobelia::progress::Silent;
use serde_json::json;
use std::process::{Command, Stdio};
use std::{sync::Arc, time::Duration};

const FIT: &str = r#"Fit(name: "fit", steps: 30, batch: 256), "#;

/// A right scene.
fn usual() -> String {
    scene(&[FIT, NOVEL, SCORES].concat())
}

// What can fail late fails first.

#[test]
fn a_truth_that_goes_while_the_fit_works_costs_its_scores_alone_and_the_run_goes_on() {
    let data = Data::new();
    let scores = r#"Evaluate(scores: [(pass: "novel", truth: Folder("$DATA/test/gt/relit"))]), Save(),"#;
    let scene = scene(&[FIT, NOVEL, scores].concat());
    let (truth, aside) = (data.path("test/gt/relit/rgb_000001.exr"), data.path("aside.exr"));
    let (from, to) = (truth.clone(), aside.clone());
    let meddler = AtStep("fit", 5, move || _ = std::fs::rename(&from, &to));
    let error = data.run_here(&scene, "out", Some(Duration::ZERO), false, Arc::new(meddler)).unwrap_err();
    assert!(error.to_string().contains("rgb_000001.exr: the file has gone since the run began"), "{error}");
    assert!(error.help().unwrap().contains("--resume"), "{error:?}");
    assert_eq!(data.states("out"), ["finished", "finished", "failed", "finished"]);
    assert!(data.path("out/saved/scene.ron").exists() && data.path("out/metrics.json").exists());
    assert_eq!(data.manifest("out")["state"], "failed");
    // Back where it was, the run goes on.
    std::fs::rename(aside, truth).unwrap();
    data.run_here(&scene, "out", Some(Duration::ZERO), true, Arc::new(Silent)).unwrap();
    assert_eq!(data.states("out"), ["finished"; 4]);
}

// No silent nonsense: see also `guard`.

#[test]
fn views_are_reported_and_nothing_is_wrong_with_sound_data() {
    let data = Data::new();
    data.run(&usual(), "out", &["--quiet"]).succeeded();
    let metrics = data.metrics("out");
    assert_eq!(metrics["steps_taken_back"], 0);
    // What a survey says before the fit may be there.
    let warnings = metrics["warnings"].to_string();
    let wrong = ["no pixel of", "is black in", "overlap to less", "not explained", "ran away", "taken back"];
    assert!(!wrong.iter().any(|words| warnings.contains(words)), "{warnings}");
    let table = data.text("out/scores/views.csv");
    let (head, rows) = table.split_once('\n').unwrap();
    assert_eq!(head, "view,split,pixels,hit,mask_iou,psnr,outliers");
    let rows: Vec<Vec<&str>> = rows.lines().map(|row| row.split(',').collect()).collect();
    let splits: Vec<&str> = rows.iter().map(|row| row[1]).collect();
    assert_eq!(splits, [&["train"; 6][..], &["test"; 2]].concat(), "{table}");
    for row in &rows {
        let number = |at: usize| row[at].parse::<f64>().unwrap();
        assert!(number(3) > 0.9 && number(4) > 0.8 && number(5) > 10.0 && number(6) < 0.5, "{table}");
        assert!(row[1] == "test" || number(2) > 50.0, "{table}");
    }
    assert_eq!(metrics["views"].as_array().unwrap().len(), 8);
}

#[test]
fn a_camera_that_looks_elsewhere_is_named() {
    let data = Data::new();
    // Far enough to the side that no pixel of its mask meets the object.
    data.change_cameras("train", |cameras| {
        let w2c = &mut cameras["rgb_000002.exr"]["W2C"];
        w2c[3] = (w2c[3].as_f64().unwrap() + 5.0).into();
    });
    let outcome = data.run(&usual(), "out", &[]).succeeded();
    let metrics = data.metrics("out");
    let warnings = metrics["warnings"].to_string();
    for word in ["no pixel of view `rgb_000002` was used", "overlap to less than 0.6 in view `rgb_000002`"] {
        let said = flat(&outcome.stderr);
        assert!(warnings.contains(word) && said.contains(word), "{warnings}\n{said}");
    }
}

// Edges.

#[cfg(unix)]
#[test]
fn notes_that_nobody_can_read_and_readers_that_go_away_do_not_fail_a_run() {
    let data = Data::new();
    data.write("scene.ron", usual());
    for (out, line) in [
        ("full", "\"$@\" 2>/dev/full >/dev/full"),
        ("closed", "\"$@\" 2>&- >&-"),
        ("gone", "\"$@\" 2>&1 | true"),
    ] {
        if line.contains("/dev/full") && std::fs::File::options().write(true).open("/dev/full").is_err() {
            skipped("there is no /dev/full");
            continue;
        }
        let mut run = Command::new("sh");
        run.args(["-c", line, "sh", env!("CARGO_BIN_EXE_lobelia"), "run", "scene.ron", "--data", "."]);
        run.args(["--out", out]).current_dir(data.root()).stdin(Stdio::null());
        assert_eq!(run.status().unwrap().code(), Some(0), "{line}");
        assert_eq!(data.manifest(out)["state"], "finished");
        assert!(data.path(out).join("scores/views.csv").exists());
    }
}

#[test]
fn a_run_that_was_killed_at_its_very_end_is_tidy_once_it_is_resumed() {
    let data = Data::new();
    data.run(&scene(FIT), "out", &["--quiet"]).succeeded();
    let report = data.bytes("out/report.html");
    data.write("out/.lobelia.lock", "");
    data.write("out/report.html", "of before");
    data.write("out/.lobelia-abc.part.html", "half a");
    data.run(&scene(FIT), "out", &["--quiet", "--resume"]).succeeded();
    assert!(!data.path("out/.lobelia.lock").exists() && !data.path("out/.lobelia-abc.part.html").exists());
    assert!(report == data.bytes("out/report.html"));
}

/// Writes `true/mesh.gltf`, a triangle, and its buffer of 36 bytes, which the first names by this
/// address.
fn write_triangle(data: &Data, address: &str) {
    let document = json!({
        "asset": {"version": "2.0"},
        "buffers": [{"byteLength": 36, "uri": address}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "images": [{"uri": "none.png"}],
        "nodes": [{"mesh": 0}], "scenes": [{"nodes": [0]}],
    });
    let corners = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0f32];
    data.write(format!("true/{address}"), corners.map(f32::to_le_bytes).concat());
    data.write("true/mesh.gltf", document.to_string());
}

#[test]
fn what_a_mesh_or_a_light_names_is_never_written_over() {
    let data = Data::new();
    write_triangle(&data, "out/novel/a.png");
    let scene = GRAY_SPHERE
        .replace("Sphere(", r#"Mesh(path: "$DATA/true/mesh.gltf", "#)
        .replace("{PASS}", r#"Render(name: "novel")"#);
    data.run(&scene, "true/out", &["--quiet", "--force"]).refused(&["pass novel would replace"]);
    assert_eq!(data.bytes("true/out/novel/a.png").len(), 36);
    // The light of photographs that a scene takes.
    data.write("out/fit/light.npy", data.bytes("evening.npy"));
    data.write("light.ron", r#"Npy(path: "out/fit/light.npy")"#);
    let scene = photographed(FIT, r#"Ron(path: "light.ron")"#);
    data.run(&scene, "out", &["--quiet", "--force"]).refused(&["pass fit would replace"]);
}

#[test]
fn what_a_true_mesh_names_is_watched() {
    let data = Data::new();
    write_triangle(&data, "a.bin");
    let scene = usual().replace("Evaluate(", r#"Evaluate(mesh: "$DATA/true/mesh.gltf", "#);
    let buffer = data.path("true/a.bin");
    let meddler = AtStep("fit", 5, move || std::fs::write(&buffer, [0; 48]).unwrap());
    let error = data.run_here(&scene, "out", Some(Duration::ZERO), false, Arc::new(meddler)).unwrap_err();
    assert!(error.to_string().contains("a.bin: the file has changed since the run began"), "{error}");
}
