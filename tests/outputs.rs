//! Outputs never touch inputs, whatever passes, views and folders are called; two runs never mix;
//! and `run.json` says what belongs together, whatever became of the run.

use crate::common::*;
use serde_json::Value;
use std::{collections::BTreeMap, path::Path};

const SAVE: &str = "Save(), ";

/// All files below a folder with their bytes.
fn contents(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let files = files_below(folder).into_iter();
    files.map(|file| (file.clone(), std::fs::read(folder.join(file)).unwrap())).collect()
}

/// Expects that a run into `out` with `--force` is refused with one message that has all `words`,
/// and that nothing changes.
#[track_caller]
fn refused(data: &Data, scene: &str, out: &str, words: &[&str]) {
    data.write("scene.ron", scene);
    let before = contents(data.root());
    data.run(scene, out, &["--quiet", "--force", "--profile"]).refused(words);
    assert!(before == contents(data.root()), "something was changed");
}

/// Expects that the manifest of a run lists its files, and returns it.
#[track_caller]
fn lists_its_files(data: &Data) -> Value {
    let manifest = data.manifest("out");
    let of = |value: &Value| -> Vec<String> { serde_json::from_value(value["files"].clone()).unwrap() };
    let mut files = of(&manifest);
    files.extend(manifest["passes"].as_array().unwrap().iter().flat_map(of));
    files.push("run.json".into());
    files.sort();
    assert_eq!(files, files_below(&data.path("out")));
    manifest
}

#[test]
fn passes_called_as_folders_of_the_data_replace_nothing() {
    let data = Data::new();
    let train = scene(r#"Fit(name: "train", steps: 4, cameras: Poses)"#);
    refused(&data, &train, ".", &["pass train would replace", "cam_dict_norm.json", "--out"]);
    let image = scene(&format!(r#"{FIT}Render(name: "image")"#));
    let words = ["pass image would replace", "test/image/rgb_00000", "a photograph", "help"];
    refused(&data, &image, "test", &words);
    let mask = scene(&format!(r#"{FIT}Render(name: "mask", render: (views: Train))"#));
    refused(&data, &mask, "train/../train", &["pass mask would replace", "a mask"]);
    let export = scene(&format!(r#"{FIT}Export(name: "image")"#));
    refused(&data, &export, "test", &["pass image would write", "beside", "a photograph"]);
    // What is not known as an input is not replaced either.
    refused(&data, &usual(), "test", &["test", "no run.json", "--out"]);
    let words = ["not empty", "--force replaces the results of an earlier run"];
    data.run(&usual(), "test", &["--quiet"]).refused(&words);
}

#[test]
fn force_replaces_what_a_run_wrote_and_nothing_else() {
    let data = Data::new();
    data.run(&usual(), "out", &["--quiet", "--profile"]).succeeded();
    data.write("out/mine/notes.txt", "mine");
    data.write("out/novel/notes.txt", "mine");
    data.run(&usual(), "out", &["--quiet", "--force", "--profile"]).succeeded();
    assert!(data.text("out/profile.txt").contains("pass fit"));
    // A pass that would meet a file of another's.
    data.write("out/mine/light.npy", "mine");
    let mine = scene(r#"Fit(name: "mine", steps: 4)"#);
    refused(&data, &mine, "out", &["out/mine/light.npy is in the way", "no run has written it"]);
    std::fs::remove_file(data.path("out/mine/light.npy")).unwrap();
    data.run(&mine, "out", &["--quiet", "--force"]).succeeded();
    for kept in ["out/mine/notes.txt", "out/novel/notes.txt"] {
        assert_eq!(data.text(kept), "mine", "{kept}");
    }
    // Results of passes that are no longer there stay, and are said to be older.
    let earlier = &data.manifest("out")["earlier"];
    assert!(earlier.as_array().unwrap().contains(&"novel/rgb_000000.exr".into()), "{earlier}");
    assert!(data.path("out/novel/rgb_000000.exr").exists());
    // Without the manifest nobody knows whose the files are.
    data.write("out/run.json", "{}");
    refused(&data, &mine, "out", &["no run.json", "older version"]);
}

/// Results of an earlier run under the name of a pass would go before it begins, also those that it
/// does not write again.
#[test]
fn force_removes_no_result_that_the_run_reads() {
    let data = Data::new();
    let fixed = usual().replace("Unknown(lobes: 6)", r#"Fixed(Npy(path: "$DATA/out/fit/light.npy"))"#);
    data.run(&scene(&[FIT, "Export(formats: [Glb]),"].concat()), "out", &["--quiet"]).succeeded();
    let export = scene(&[FIT, "Export(formats: [Usdz])"].concat()).replace("mesh.glb", "out/export/mesh.glb");
    refused(&data, &export, "out", &["--force would replace", "out/export/mesh.glb", "earlier run"]);
    refused(&data, &fixed, "out", &["pass fit would replace", "out/fit/light.npy"]);
    data.run(&export, "other", &["--quiet"]).succeeded();
}

#[test]
fn a_manifest_lists_every_file() {
    let data = Data::new();
    let more = r#"Fit(name: "second", steps: 2, cameras: PosesAndFocal, exposure: Color, detail: true),
        Render(name: "film", render: (views: All, orbit: (frames: 2, size: 16))),
        Relight(name: "relit", light: Npy(path: "$DATA/evening.npy")),
        Save(name: "relit_object", of: "relit"),
        Export(formats: [Glb, Usda, Usdz]),"#;
    let scene = scene(&[FIT, NOVEL, SCORES, SAVE, more].concat())
        .replace("passes:", "material: (gloss: Texels()), passes:");
    data.run(&scene, "out", &["--quiet"]).succeeded();
    let manifest = lists_its_files(&data);
    assert_eq!((&manifest["program"], &manifest["state"]), (&"lobelia".into(), &"finished".into()));
    assert!(manifest["version"].as_str().unwrap().starts_with(env!("CARGO_PKG_VERSION")), "{manifest}");
    assert!(manifest["arguments"].as_array().unwrap().contains(&"--quiet".into()), "{manifest}");
    let passes = manifest["passes"].as_array().unwrap();
    assert!(passes.len() == 9 && passes.iter().all(|pass| pass["state"] == "finished"), "{manifest}");
    // Again, with other views: those of before are gone.
    let other = scene.replace("views: All, ", "views: Train, ");
    data.run(&other, "out", &["--quiet", "--force"]).succeeded();
    lists_its_files(&data);
    assert!(!data.path("out/film/test_rgb_000000.png").exists());
}

#[cfg(unix)]
#[test]
fn links_lead_no_output_to_an_input() {
    let data = Data::new();
    data.run(&usual(), "out", &["--quiet"]).succeeded();
    let (novel, photograph) = (data.path("out/novel/rgb_000000.exr"), data.path("test/image/rgb_000000.exr"));
    // A result that became a photograph.
    std::fs::remove_file(&photograph).unwrap();
    std::os::unix::fs::symlink(&novel, &photograph).unwrap();
    refused(&data, &usual(), "out", &["pass novel would replace", "a photograph"]);
    std::fs::remove_file(&photograph).unwrap();
    std::fs::rename(&novel, &photograph).unwrap();
    // A folder of results that leads into the data.
    std::fs::remove_dir_all(data.path("out/novel")).unwrap();
    std::os::unix::fs::symlink(data.path("test/gt"), data.path("out/novel")).unwrap();
    refused(&data, &usual(), "out", &["out/novel is a symbolic link", "outside the output"]);
    // The scene file of a saved object, into the folder that it lies in.
    std::fs::remove_file(data.path("out/novel")).unwrap();
    data.run(&scene(&[FIT, NOVEL, SAVE].concat()), "out", &["--quiet", "--force"]).succeeded();
    let saved = data.text("out/saved/scene.ron");
    data.write("out/saved/scene.ron", saved.replace("passes: [", "passes: [Save(), "));
    data.run_file("out/saved/scene.ron", "out", &["--force"]).refused(&["pass saved would replace"]);
    assert!(data.path("out/saved/mesh.glb").exists());
}

/// A model whose photographs have names that lead anywhere.
#[test]
fn views_with_names_of_paths_are_rendered_into_the_output_folder() {
    let data = Data::new();
    for copy in ["colmap/images/a.exr", "colmap/images/left/a.exr", "elsewhere/a.exr"] {
        data.write(copy, data.bytes("train/image/rgb_000000.exr"));
    }
    let absolute = data.path("elsewhere/a.exr").display().to_string();
    let names = ["a.exr", "left/a.exr", "../../elsewhere/a.exr", &absolute];
    data.write_colmap(&names, 40.0);
    data.write("scene.ron", colmap_scene());
    let before = contents(data.root());
    data.run(&colmap_scene(), "out", &["--quiet"]).succeeded();
    assert_eq!(data.pictures("out/novel").len(), names.len());
    let mut after = contents(data.root());
    after.retain(|file, _| !file.starts_with("out/"));
    assert!(before == after, "something beside the output was changed");
}

#[test]
fn a_killed_run_leaves_no_mixture_and_no_lock() {
    let data = Data::new();
    let whole = scene(&[FIT, NOVEL, SCORES, SAVE].concat());
    data.run(&whole, "out", &["--quiet"]).succeeded();
    let late = scene(&[FIT, SAVE, ENDLESS, NOVEL, SCORES].concat());
    let at_work = AtWork::start(&data, &late, &["--force"], "endless");
    let out = data.path("out");
    for force in [&["--force"] as &[&str], &[]] {
        data.run(&whole, "out", force).refused(&["another run writes into"]);
    }
    at_work.kill();
    assert_eq!(data.manifest("out")["state"], "running");
    assert_eq!(data.states("out"), ["finished", "finished", "running", "waiting", "waiting"]);
    for old in ["novel/rgb_000000.exr", "scores/contact_sheet.png", "scores/novel"] {
        assert!(!out.join(old).exists(), "{old} is of the run before");
    }
    // Scores and report are those of the passes that ended.
    let scores = data.metrics("out");
    assert!(scores["passes"].as_object().unwrap().is_empty() && scores["fit_secs"].is_number(), "{scores}");
    assert!(data.text("out/report.html").contains("s-running"));
    // What is whole can be used.
    let export = ["--quiet", "--set", "passes=[Export()]"];
    data.run_file("out/saved/scene.ron", "from_saved", &export).succeeded();
    // What was left unfinished goes with the next run, and the lock of the dead is none.
    data.write("out/fit/.lobelia-abc.part.exr", "half");
    data.write("out/novel/.lobelia-def.part.png", "half");
    data.run(&whole, "out", &[]).refused(&["did not finish", "--force"]);
    data.run(&whole, "out", &["--force"]).succeeded();
    lists_its_files(&data);
    assert!(!files_below(&out).iter().any(|file| is_temporary(file)));
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
    let manifest = data.manifest("out");
    assert_eq!(data.states("out"), ["finished", "finished", "failed", "skipped", "finished", "finished"]);
    assert_eq!(manifest["state"], "failed");
    assert!(manifest["error"].as_str().unwrap().contains("rgb_000000.exr"), "{manifest}");
    let report = data.text("out/report.html");
    assert!(report.contains("s-failed") && report.contains("rgb_000000.exr"), "the error is in the report");
    // Scores that can be taken are.
    assert!(data.metrics("out")["passes"]["novel"]["psnr"].is_number());
    assert!(data.path("out/saved/scene.ron").exists() && data.path("out/scores/contact_sheet.png").exists());
}

#[test]
fn check_replaces_nothing_that_it_reads() {
    let data = Data::new();
    data.write("scene.ron", usual().replace("mesh.glb", "out/survey.json"));
    data.write("out/survey.json", data.bytes("mesh.glb"));
    let before = contents(data.root());
    for (out, word) in [("out", "--out would replace"), ("train/mask", "--out would write")] {
        data.lobelia(&["check", "scene.ron", "--data", ".", "--out", out]).refused(&[word]);
        assert!(before == contents(data.root()));
    }
}
