//! Outputs never touch inputs, whatever passes, views and folders are called; two runs never mix; and `run.json` says what belongs
//! together, whatever became of the run.

use crate::common::{AtWork, Data, Outcome, SIZE, command, files_below, is_temporary, manifest, scene};
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::Path;

const FIT: &str = r#"Fit(name: "fit", steps: 10, batch: 256), "#;
const NOVEL: &str = r#"Render(name: "novel"), "#;
const SAVE: &str = "Save(), ";
const SCORES: &str = r#"Evaluate(scores: [(pass: "novel", truth: Photographs)]), "#;
/// A fit that does not end.
const ENDLESS: &str = r#"Fit(name: "again", steps: 1500000000, batch: 256), "#;

fn usual() -> String {
    scene(&[FIT, NOVEL, SCORES].concat())
}

/// All files below a folder with their bytes.
fn contents(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let read = |file: String| {
        let bytes = std::fs::read(folder.join(&file)).unwrap();
        (file, bytes)
    };
    files_below(folder).into_iter().map(read).collect()
}

/// Expects that a run into `out` is refused with one message that has all `words`, and that nothing changes.
#[track_caller]
fn refused(data: &Data, scene: &str, out: &str, arguments: &[&str], words: &[&str]) {
    std::fs::write(data.path("scene.ron"), scene).unwrap();
    let before = contents(data.root());
    let outcome = data.run(scene, out, &[&["--quiet"], arguments].concat());
    assert_eq!(outcome.code, Some(2), "{}", outcome.stderr);
    assert_eq!(outcome.stderr.matches("error: ").count(), 1, "{}", outcome.stderr);
    let said: String = outcome.stderr.split_whitespace().collect::<Vec<_>>().join(" ");
    for word in words {
        assert!(said.contains(word), "no {word:?} in\n{said}");
    }
    assert!(before == contents(data.root()), "something was changed");
}

/// The files that a manifest lists as the run's.
fn listed(manifest: &Value) -> Vec<String> {
    let of = |value: &Value| -> Vec<String> { serde_json::from_value(value["files"].clone()).unwrap() };
    let passes = manifest["passes"].as_array().unwrap();
    let mut files: Vec<String> = passes.iter().flat_map(of).chain(of(manifest)).collect();
    files.push("run.json".into());
    files.sort();
    files
}

#[test]
fn passes_called_as_folders_of_the_data_replace_nothing() {
    let data = Data::new();
    let train = scene(r#"Fit(name: "train", steps: 4, cameras: Poses)"#);
    refused(&data, &train, ".", &["--force"], &["pass train would replace", "cam_dict_norm.json", "--out"]);
    let image = scene(&format!(r#"{FIT}Render(name: "image")"#));
    let words = ["pass image would replace", "test/image/rgb_00000", "a photograph", "help"];
    refused(&data, &image, "test", &["--force"], &words);
    let mask = scene(&format!(r#"{FIT}Render(name: "mask", render: (views: Train))"#));
    refused(&data, &mask, "train/../train", &["--force"], &["pass mask would replace", "a mask"]);
    let export = scene(&format!(r#"{FIT}Export(name: "image")"#));
    refused(&data, &export, "test", &["--force"], &["pass image would write", "beside", "a photograph"]);
    // What is not known as an input is not replaced either.
    refused(&data, &usual(), "test", &["--force"], &["test", "no run.json", "--out"]);
    refused(&data, &usual(), "test", &[], &["not empty", "--force replaces the results of an earlier run"]);
}

#[test]
fn force_replaces_what_a_run_wrote_and_nothing_else() {
    let data = Data::new();
    data.run(&usual(), "out", &["--quiet"]).succeeded();
    std::fs::create_dir_all(data.path("out/mine")).unwrap();
    std::fs::write(data.path("out/mine/notes.txt"), "mine").unwrap();
    std::fs::write(data.path("out/novel/notes.txt"), "mine").unwrap();
    data.run(&usual(), "out", &["--quiet", "--force"]).succeeded();
    // A pass that would meet a file of another's.
    std::fs::write(data.path("out/mine/light.npy"), "mine").unwrap();
    let mine = scene(r#"Fit(name: "mine", steps: 4)"#);
    refused(
        &data,
        &mine,
        "out",
        &["--force"],
        &["out/mine/light.npy is in the way", "no run has written it"],
    );
    std::fs::remove_file(data.path("out/mine/light.npy")).unwrap();
    data.run(&mine, "out", &["--quiet", "--force"]).succeeded();
    for kept in ["out/mine/notes.txt", "out/novel/notes.txt"] {
        assert_eq!(std::fs::read_to_string(data.path(kept)).unwrap(), "mine", "{kept}");
    }
    // Results of passes that are no longer there stay, and are said to be older.
    let manifest = manifest(&data.path("out"));
    let earlier: Vec<String> = serde_json::from_value(manifest["earlier"].clone()).unwrap();
    assert!(earlier.contains(&"novel/rgb_000000.exr".to_owned()), "{manifest}");
    assert!(data.path("out/novel/rgb_000000.exr").exists());
    // Without the manifest nobody knows whose the files are.
    std::fs::write(data.path("out/run.json"), "{}").unwrap();
    refused(&data, &mine, "out", &["--force"], &["no run.json", "older version"]);
}

/// Results of an earlier run under the name of a pass would go before it begins, also those that it does not write again.
#[test]
fn force_removes_no_result_that_the_run_reads() {
    let data = Data::new();
    let fixed =
        usual().replace("light: Unknown(lobes: 6)", r#"light: Fixed(Npy(path: "$DATA/out/fit/light.npy"))"#);
    data.run(&scene(&[FIT, r#"Export(formats: [Glb]),"#].concat()), "out", &["--quiet"]).succeeded();
    let export = scene(&[FIT, r#"Export(formats: [Ply]),"#].concat())
        .replace("$DATA/mesh.glb", "$DATA/out/export/mesh.glb");
    refused(
        &data,
        &export,
        "out",
        &["--force"],
        &["--force would replace", "out/export/mesh.glb", "earlier run"],
    );
    refused(&data, &fixed, "out", &["--force"], &["pass fit would replace", "out/fit/light.npy"]);
    data.run(&export, "other", &["--quiet"]).succeeded();
}

#[test]
fn a_manifest_lists_every_file() {
    let data = Data::new();
    let more = r#"Fit(name: "second", steps: 2, cameras: PosesAndFocal, exposure: Color, detail: true),
        Render(name: "film", render: (views: All, orbit: (frames: 2, size: 16, format: Apng))),
        Relight(name: "relit", light: Npy(path: "$DATA/evening.npy")),
        Save(name: "relit_object", of: "relit"),
        Export(formats: [Glb, Ply, Obj]),"#;
    let scene = scene(&[FIT, NOVEL, SCORES, SAVE, more].concat());
    let scene = scene
        .replace("light: Unknown(lobes: 6),", "light: Unknown(lobes: 6),\n    material: (gloss: Texels()),");
    data.run(&scene, "out", &["--quiet"]).succeeded();
    let (out, manifest) = (data.path("out"), manifest(&data.path("out")));
    assert_eq!(listed(&manifest), files_below(&out));
    assert_eq!((&manifest["program"], &manifest["state"]), (&"lobelia".into(), &"finished".into()));
    assert!(manifest["version"].as_str().unwrap().starts_with(env!("CARGO_PKG_VERSION")), "{manifest}");
    assert!(manifest["arguments"].as_array().unwrap().contains(&"--quiet".into()), "{manifest}");
    let passes = manifest["passes"].as_array().unwrap();
    assert!(passes.len() == 9 && passes.iter().all(|pass| pass["state"] == "finished"), "{manifest}");
    // Again, with other views: those of before are gone.
    let other = scene.replace("views: All, ", "views: Train, ");
    data.run(&other, "out", &["--quiet", "--force"]).succeeded();
    assert_eq!(listed(&crate::common::manifest(&out)), files_below(&out));
    assert!(!out.join("film/test_rgb_000000.png").exists());
}

#[cfg(unix)]
#[test]
fn links_lead_no_output_to_an_input() {
    let data = Data::new();
    data.run(&usual(), "out", &["--quiet"]).succeeded();
    let (novel, photograph) = (data.path("out/novel/rgb_000000.exr"), data.path("test/image/rgb_000000.exr"));
    // A result that became a photograph, by a hard link and by a soft one.
    for link in
        [|a: &Path, b: &Path| std::fs::hard_link(a, b), |a: &Path, b: &Path| std::os::unix::fs::symlink(a, b)]
    {
        std::fs::remove_file(&photograph).unwrap();
        link(&novel, &photograph).unwrap();
        refused(&data, &usual(), "out", &["--force"], &["pass novel would replace", "a photograph"]);
    }
    std::fs::remove_file(&photograph).unwrap();
    std::fs::rename(&novel, &photograph).unwrap();
    // A folder of results that leads into the data.
    std::fs::remove_dir_all(data.path("out/novel")).unwrap();
    std::os::unix::fs::symlink(data.path("test/gt"), data.path("out/novel")).unwrap();
    refused(&data, &usual(), "out", &["--force"], &["out/novel is a symbolic link", "outside the output"]);
    // The scene file of a saved object, into the folder that it lies in.
    std::fs::remove_file(data.path("out/novel")).unwrap();
    data.run(&scene(&[FIT, NOVEL, SAVE].concat()), "out", &["--quiet", "--force"]).succeeded();
    let saved = std::fs::read_to_string(data.path("out/saved/scene.ron")).unwrap();
    std::fs::write(data.path("out/saved/scene.ron"), saved.replace("passes: [", "passes: [Save(), "))
        .unwrap();
    let mut run = command(&["run", "--force", "--allow-outside"]);
    let outcome = Outcome::of(run.arg(data.path("out/saved/scene.ron")).arg("--out").arg(data.path("out")));
    assert_eq!(outcome.code, Some(2), "{}", outcome.stderr);
    assert!(outcome.stderr.contains("pass saved would replace"), "{}", outcome.stderr);
    assert!(data.path("out/saved/mesh.glb").exists());
}

/// A model whose photographs have names that lead anywhere.
#[test]
fn views_with_names_of_paths_are_rendered_into_the_output_folder() {
    let data = Data::new();
    for folder in ["colmap/sparse/0", "colmap/images/left", "elsewhere"] {
        std::fs::create_dir_all(data.path(folder)).unwrap();
    }
    let photograph = data.path("train/image/rgb_000000.exr");
    for copy in ["colmap/images/a.exr", "colmap/images/left/a.exr", "elsewhere/a.exr"] {
        std::fs::copy(&photograph, data.path(copy)).unwrap();
    }
    let absolute = data.path("elsewhere/a.exr").display().to_string();
    let names = ["a.exr", "left/a.exr", "../../elsewhere/a.exr", &absolute];
    let lines: Vec<String> = names.iter().map(|name| format!("1 1 0 0 0 0 0 2.8 1 {name}\n\n")).collect();
    std::fs::write(data.path("colmap/sparse/0/images.txt"), lines.concat()).unwrap();
    let camera = format!("1 PINHOLE {SIZE} {SIZE} 40 40 12 12");
    std::fs::write(data.path("colmap/sparse/0/cameras.txt"), camera).unwrap();
    let scene = r#"Scene(
    version: 1,
    surface: Mesh(path: "$DATA/mesh.glb", texture_size: 16),
    views: Dataset(path: "$DATA/colmap"),
    light: Fixed(Npy(path: "$DATA/evening.npy")),
    material: (albedo: Fixed(Constant(0.5, 0.5, 0.5)), specular: (albedo: Fixed(0, 0, 0), roughness: Fixed(1))),
    passes: [Render(name: "novel", render: (views: All))],
)
"#;
    std::fs::write(data.path("scene.ron"), scene).unwrap();
    let before = contents(data.root());
    data.run(scene, "out", &["--quiet"]).succeeded();
    let written = contents(data.root()).into_iter().filter(|(file, _)| !before.contains_key(file));
    let written: Vec<String> = written.map(|(file, _)| file).collect();
    assert!(written.iter().all(|file| file.starts_with("out/")), "{written:?}");
    let pictures = written.iter().filter(|file| file.starts_with("out/novel/") && file.ends_with(".exr"));
    assert_eq!(pictures.count(), names.len(), "{written:?}");
    assert!(
        contents(data.root()).iter().all(|(file, bytes)| before.get(file).is_none_or(|old| old == bytes))
    );
}

#[test]
fn a_killed_run_leaves_no_mixture_and_no_lock() {
    let data = Data::new();
    let whole = scene(&[FIT, NOVEL, SCORES, SAVE].concat());
    data.run(&whole, "out", &["--quiet"]).succeeded();
    let late = scene(&[FIT, SAVE, ENDLESS, NOVEL, SCORES].concat());
    let at_work = AtWork::start(&data, &late, &["--force"], "again");
    let out = data.path("out");
    for force in [&["--force"] as &[&str], &[]] {
        let second = data.run(&whole, "out", force);
        assert_eq!(second.code, Some(2), "{}", second.stderr);
        assert!(second.stderr.contains("another run writes into"), "{}", second.stderr);
    }
    at_work.kill();
    let manifest = manifest(&out);
    assert_eq!(manifest["state"], "running");
    let states: Vec<&str> =
        manifest["passes"].as_array().unwrap().iter().map(|pass| pass["state"].as_str().unwrap()).collect();
    assert_eq!(states, ["finished", "finished", "running", "waiting", "waiting"]);
    for old in ["novel/rgb_000000.exr", "scores/contact_sheet.png", "scores/novel"] {
        assert!(!out.join(old).exists(), "{old} is of the run before");
    }
    // Scores and report are those of the passes that ended.
    let scores: Value = serde_json::from_slice(&std::fs::read(out.join("metrics.json")).unwrap()).unwrap();
    assert!(scores["passes"].as_object().unwrap().is_empty() && scores["fit_secs"].is_number(), "{scores}");
    assert!(std::fs::read_to_string(out.join("report.html")).unwrap().contains("s-running"));
    // What is whole can be used.
    let mut again = command(&["run", "--quiet", "--allow-outside"]);
    again.arg(out.join("saved/scene.ron")).arg("--out").arg(data.path("from_saved"));
    Outcome::of(again.args(["--set", "passes=[Export()]"])).succeeded();
    // What was left unfinished goes with the next run, and the lock of the dead is none.
    std::fs::write(out.join("fit/.lobelia-abc.part.exr"), "half").unwrap();
    std::fs::create_dir(out.join("novel")).unwrap();
    std::fs::write(out.join("novel/.lobelia-def.part.png"), "half").unwrap();
    let refused = data.run(&whole, "out", &[]);
    assert!(
        refused.stderr.contains("did not finish") && refused.stderr.contains("--force"),
        "{}",
        refused.stderr
    );
    data.run(&whole, "out", &["--force"]).succeeded();
    let files = files_below(&out);
    assert!(!files.iter().any(|file| is_temporary(file)), "{files:?}");
    assert_eq!(listed(&crate::common::manifest(&out)), files);
}

#[cfg(unix)]
#[test]
fn a_run_that_fails_late_says_so() {
    let data = Data::new();
    data.run(&usual(), "out", &["--quiet"]).succeeded();
    let before = manifest(&data.path("out"));
    let late = scene(&[FIT, NOVEL, ENDLESS].concat());
    let at_work = AtWork::start(&data, &late, &["--force", "--checkpoint", "0s"], "again");
    // A fit that is stopped before its first step has nothing to write.
    at_work.until_a_step_is_kept(&data);
    // A folder in the way of a result.
    std::fs::create_dir_all(data.path("out/again/light.npy/x")).unwrap();
    at_work.signal("INT");
    assert_eq!(at_work.ended(), Some(1));
    let after = manifest(&data.path("out"));
    assert_eq!((&before["state"], &after["state"]), (&"finished".into(), &"failed".into()));
    assert!(after["error"].as_str().unwrap().contains("light.npy"), "{after}");
    assert_eq!(
        (&after["passes"][1]["state"], &after["passes"][2]["state"]),
        (&"finished".into(), &"failed".into())
    );
    let metrics = metrics(&data);
    assert!(
        metrics["passes"].as_object().is_none_or(|passes| passes.is_empty()),
        "of the run before: {metrics}"
    );
    let report = std::fs::read_to_string(data.path("out/report.html")).unwrap();
    assert!(report.contains("s-failed") && report.contains("light.npy"), "the error is in the report");
}

#[test]
fn a_pass_that_fails_ends_only_what_needs_it() {
    let data = Data::new();
    let rest = r#"Relight(name: "relit", light: Npy(path: "$DATA/evening.npy")),
        Evaluate(name: "broken", scores: [(pass: "relit", truth: Photographs)]), "#;
    let text = scene(&[FIT, NOVEL, rest, SCORES, SAVE].concat()).replace("steps: 10", "steps: 150");
    let at_work = AtWork::start(&data, &text, &[], "fit");
    // A folder where a picture goes.
    std::fs::create_dir_all(data.path("out/relit/rgb_000000.exr/x")).unwrap();
    assert_eq!(at_work.ended(), Some(1));
    let manifest = manifest(&data.path("out"));
    let states: Vec<&str> =
        manifest["passes"].as_array().unwrap().iter().map(|pass| pass["state"].as_str().unwrap()).collect();
    assert_eq!(states, ["finished", "finished", "failed", "skipped", "finished", "finished"]);
    assert_eq!(manifest["state"], "failed");
    assert!(manifest["error"].as_str().unwrap().contains("rgb_000000.exr"), "{manifest}");
    assert!(metrics(&data)["passes"]["novel"]["psnr"].is_number(), "scores that can be taken are written");
    assert!(data.path("out/saved/scene.ron").exists() && data.path("out/scores/contact_sheet.png").exists());
}

fn metrics(data: &Data) -> Value {
    serde_json::from_slice(&std::fs::read(data.path("out/metrics.json")).unwrap()).unwrap()
}

#[test]
fn what_shade_cases_reads_it_does_not_replace() {
    let folder = tempfile::tempdir().unwrap();
    let table = folder.path().join("cases.json");
    std::fs::write(&table, "[]").unwrap();
    let same = folder.path().join("../").join(folder.path().file_name().unwrap()).join("cases.json");
    let outcome = Outcome::of(command(&["shade-cases"]).arg(&table).arg(&same));
    assert_eq!(outcome.code, Some(2), "{}", outcome.stderr);
    assert!(outcome.stderr.contains("the shaded table would replace"), "{}", outcome.stderr);
    assert_eq!(std::fs::read_to_string(&table).unwrap(), "[]");
}

#[test]
fn check_replaces_no_photograph_by_its_sheet() {
    let data = Data::new();
    std::fs::write(data.path("scene.ron"), usual().replace("mesh.glb", "out/contact_sheet.png")).unwrap();
    std::fs::create_dir(data.path("out")).unwrap();
    std::fs::copy(data.path("mesh.glb"), data.path("out/contact_sheet.png")).unwrap();
    let before = contents(data.root());
    let into = |out: &str, word: &str| {
        let mut check = command(&["check"]);
        check.arg(data.path("scene.ron")).arg("--data").arg(data.root()).arg("--out").arg(data.path(out));
        let outcome = Outcome::of(&mut check);
        assert_eq!(outcome.code, Some(2), "{}", outcome.stderr);
        assert!(outcome.stderr.contains(word), "{}", outcome.stderr);
        assert!(before == contents(data.root()));
    };
    into("out", "--out would replace");
    into("train/mask", "--out would write");
}
