//! The page that shows a run: what `lobelia run` writes after every pass, what `lobelia report` makes of runs, and what it refuses.

use crate::common::{Data, Outcome, command, files_below};
use serde_json::Value;
use std::path::Path;

/// A run that makes its own photographs, with a known light, a second pass without scores, and scores of the first.
const SCENE: &str = r#"Scene(
    version: 1,
    surface: Sphere(radius: 0.9, texture_size: 16),
    visibility: None,
    views: Photographed(
        cameras: (count: 6, test: 2, size: 20),
        spp: 2,
        truth: (
            albedo: Constant(0.5, 0.3, 0.2),
            specular: (albedo: (0.3, 0.3, 0.3), roughness: 0.25),
            light: Lobes(lobes: [(axis: (0, 1, 0), sharpness: 0.7, amplitude: (0.6, 0.6, 0.6))]),
        ),
    ),
    light: Unknown(lobes: 6),
    passes: [
        Fit(steps: 45, batch: 256),
        Render(name: "novel"),
        Edit(name: "polished", edits: [Roughness(action: Set(0.1))]),
        Evaluate(name: "scores", scores: [(pass: "novel", truth: Photographs)]),
    ],
)"#;

fn page(path: &Path) -> String {
    std::fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

fn report(arguments: &[&Path]) -> Outcome {
    Outcome::of(command(&["report"]).args(arguments))
}

#[track_caller]
fn has(text: &str, all: &[&str]) {
    for words in all {
        assert!(text.contains(words), "no {words:?} in\n{}", &text[..text.len().min(20_000)]);
    }
}

#[track_caller]
fn refused(arguments: &[&Path], words: &[&str]) {
    let outcome = report(arguments);
    let said: String = outcome.stderr.split_whitespace().collect::<Vec<_>>().join(" ");
    assert_eq!((outcome.code, said.matches("error: ").count()), (Some(2), 1), "{said}");
    has(&said, words);
}

#[test]
fn a_run_has_a_report_with_everything() {
    let data = Data::new();
    data.run(SCENE, "out", &["--quiet"]).succeeded();
    let out = data.path("out");
    let text = page(&out.join("report.html"));
    assert!(text.len() < 1_000_000, "{} bytes", text.len());
    for part in ["scores", "views", "light", "curves", "found", "passes", "scene", "run"] {
        has(&text, &[&format!("<section id=\"{part}\"")]);
    }
    has(
        &text,
        &["photograph of view", "fit: recovered light", "fit: true light", "fit: albedo", "s-finished"],
    );
    has(&text, &["6 lobes", "PSNR of training pixels, dB", "data:image/jpeg;base64,", "<h3>polished</h3>"]);
    assert!(!text.contains("http:") && !text.contains("https:"), "it asks no server for anything");
    // The same page comes of the folder alone, also where it was moved.
    std::fs::rename(&out, data.path("moved")).unwrap();
    report(&[&data.path("moved")]).succeeded();
    assert_eq!(page(&data.path("moved/report.html")), text.replace(">out<", ">moved<"));
    let manifest: Value = serde_json::from_str(&page(&data.path("moved/run.json"))).unwrap();
    has(manifest["scene_text"].as_str().unwrap(), &["Scene("]);
    assert!(manifest["machine"]["threads"].as_u64().unwrap() > 0 && manifest["seed"] == 0, "{manifest}");
    let fit = &manifest["passes"][0];
    assert!(fit["secs"].as_f64().unwrap() > 0.0 && fit["said"].to_string().contains("45 steps"), "{fit}");
}

#[test]
fn a_folder_that_lost_files_has_a_report_of_what_is_left() {
    let data = Data::new();
    data.run(SCENE, "out", &["--quiet"]).succeeded();
    let out = data.path("out");
    let mut manifest: Value = serde_json::from_str(&page(&out.join("run.json"))).unwrap();
    manifest["state"] = "failed".into();
    manifest["error"] = "scores: <no> room".into();
    std::fs::write(out.join("run.json"), manifest.to_string()).unwrap();
    std::fs::remove_dir_all(out.join("scores")).unwrap();
    std::fs::remove_dir_all(out.join("fit")).unwrap();
    report(&[&out]).succeeded();
    has(&page(&out.join("report.html")), &["s-failed", "scores: &lt;no&gt; room"]);
}

#[test]
fn runs_stand_side_by_side() {
    let data = Data::new();
    data.run(SCENE, "a", &["--quiet"]).succeeded();
    data.run(SCENE, "b", &["--quiet", "--set", "passes.fit.steps=5"]).succeeded();
    let both = data.path("both.html");
    report(&[&data.path("a"), &data.path("b"), Path::new("--out"), &both]).succeeded();
    let text = page(&both);
    has(
        &text,
        &[
            "<title>a · b</title>",
            "passes.fit.steps",
            "<td>45</td><td>5</td>",
            "a: render of view",
            "b: render of view",
        ],
    );
    has(&text, &["class=\"worse\">(▼ -", "b: error of view"]);
    assert_eq!(files_below(&data.path("a")).iter().filter(|file| file.ends_with(".html")).count(), 1);
    // An earlier report is replaced, and a file of the user is not.
    report(&[&data.path("a"), &data.path("b"), Path::new("--out"), &both]).succeeded();
    std::fs::write(&both, "<p>my own page</p>").unwrap();
    let arguments = [&data.path("a"), &data.path("b"), Path::new("--out"), both.as_path()];
    refused(&arguments, &["both.html is not a page that this command wrote"]);
    assert_eq!(page(&both), "<p>my own page</p>");
    let view = data.path("view.html");
    std::fs::write(&view, r#"<meta name="generator" content="Lobelia">"#).unwrap();
    refused(&[&data.path("a"), Path::new("--out"), &view], &["view.html is not a page"]);
    refused(&[&data.path("a"), Path::new("--out"), &data.path("train")], &["train: it is a folder"]);
}

#[test]
fn what_is_no_run_is_refused() {
    let data = Data::new();
    let (nowhere, other) = (data.path("nowhere"), data.path("train"));
    refused(&[&nowhere], &["nowhere is not there", "help: Give the output folder"]);
    refused(&[&other], &["train is not the folder of a run: it has no run.json"]);
    std::fs::create_dir(&nowhere).unwrap();
    std::fs::write(nowhere.join("run.json"), r#"{"program": "lobelia", "version": "0.0.1"}"#).unwrap();
    refused(
        &[&nowhere],
        &["run.json was not written by this version of lobelia", "help: Run the scene again"],
    );
    let record = r#"{"program": "lobelia", "version": "1", "state": "running", "scene": "a.ron", "passes": [], "files": []}"#;
    std::fs::write(nowhere.join("run.json"), record).unwrap();
    refused(&[&nowhere], &["nowhere has no metrics.json: no pass of the run has ended"]);
    std::fs::write(nowhere.join("metrics.json"), "{\n\"passes\": 3}").unwrap();
    refused(&[&nowhere], &["metrics.json", "line 2", "help: Run the scene again"]);
    assert_eq!(report(&[]).code, Some(2));
    let nine = [nowhere.as_path(); 9];
    assert_eq!(report(&nine).code, Some(2));
    assert!(!files_below(data.root()).iter().any(|file| file.ends_with(".html")));
}

#[test]
fn a_report_in_the_way_stays() {
    let data = Data::new();
    data.run(SCENE, "out", &["--quiet"]).succeeded();
    let mut manifest: Value = serde_json::from_str(&page(&data.path("out/run.json"))).unwrap();
    manifest["files"] = serde_json::json!(["metrics.json"]);
    std::fs::write(data.path("out/run.json"), manifest.to_string()).unwrap();
    std::fs::write(data.path("out/report.html"), "mine").unwrap();
    let outcome = data.run(SCENE, "out", &["--quiet", "--force"]);
    assert!(
        outcome.code == Some(2) && outcome.stderr.contains("report.html is in the way"),
        "{}",
        outcome.stderr
    );
    assert_eq!(page(&data.path("out/report.html")), "mine");
}
