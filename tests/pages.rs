//! Pages: what `View` and `lobelia view` write of a saved object; what `lobelia run` writes of
//! itself after every pass, and `lobelia report` makes of runs; and what they refuse.

use crate::common::{Data, GRAY_SPHERE, files_below, photographed, scene};
use serde_json::Value;

const PASSES: &str = r#"
        Relight(name: "evening", light: Lobes(lobes: [(axis: (1, 0, 0), sharpness: 5, amplitude: (3, 1, 0.5))])),
        Edit(name: "polished", edits: [Roughness(action: Set(0.1))]),
        Save(),
        View(),
        View(name: "shown", of: "evening"),
        View(name: "shiny", of: "polished"),
    "#;

/// Reads the scene in the page.
fn scene_of(data: &Data, page: &str) -> Value {
    let text = data.text(page);
    let (_, after) = text.split_once("id=\"scene\">").unwrap();
    serde_json::from_str(after.split_once("</script>").unwrap().0).unwrap()
}

fn name(entry: &Value) -> String {
    entry["name"].as_str().unwrap().to_owned()
}

fn names(scene: &Value, list: &str) -> Vec<String> {
    scene[list].as_array().unwrap().iter().map(name).collect()
}

/// The views of a page that have photographs.
fn with_photographs(scene: &Value) -> Vec<String> {
    let views = scene["cameras"].as_array().unwrap().iter();
    views.filter(|view| !view["photograph"].is_null()).map(name).collect()
}

#[test]
fn pages_offer_the_lights_and_cameras_of_the_scene() {
    let data = Data::new();
    data.run(&GRAY_SPHERE.replace("{PASS}", PASSES), "out", &["--quiet"]).succeeded();
    assert_eq!(files_below(&data.path("out/view")), ["view.html"]);
    let plain = scene_of(&data, "out/view/view.html");
    assert!(with_photographs(&plain).is_empty(), "cameras alone");
    assert_eq!(names(&plain, "lights"), ["found", "evening"]);
    assert_eq!(names(&plain, "cameras"), ["a"]);
    assert_eq!(plain["title"], "out");
    let shown = scene_of(&data, "out/shown/view.html");
    assert_eq!(names(&shown, "lights"), ["evening", "found"]);
    let shiny = scene_of(&data, "out/shiny/view.html");
    let roughness = |scene: &Value| scene["materials"][0]["roughness"].as_f64().unwrap();
    assert!((roughness(&shiny) - 0.1).abs() < 1e-6 && (roughness(&plain) - 0.3).abs() < 1e-6);
    assert!(shiny["edits"][0].as_str().unwrap().starts_with("Roughness("), "{shiny}");
    assert!(data.bytes("out/view/view.html").len() < 340_000);

    // A saved object gets a page and nothing else; an earlier page is replaced, and a file of the
    // user is not.
    let before = files_below(&data.path("out"));
    data.write("moon.ron", "Lobes(lobes: [(axis: (0, 1, 0), sharpness: 9, amplitude: (1, 1, 2))])");
    data.lobelia(&["view", "out"]).succeeded();
    data.lobelia(&["view", "out", "--light", "moon.ron"]).succeeded();
    let mut after = files_below(&data.path("out"));
    after.retain(|file| !before.contains(file));
    assert_eq!(after, ["view.html"]);
    assert_eq!(names(&scene_of(&data, "out/view.html"), "lights"), ["found", "moon"]);
    data.write("out/view.html", "<p>my own page</p>");
    data.lobelia(&["view", "out"]).refused(&["view.html is not a page"]);
    assert_eq!(data.text("out/view.html"), "<p>my own page</p>");
}

#[test]
fn pages_have_the_photographs_of_the_run_if_they_are_there_the_held_out_ones_first() {
    let data = Data::new();
    let passes = r#"Fit(name: "fit", steps: 2), Save(), View(), View(name: "few", photographs: 3), View(name: "none", photographs: 0)"#;
    data.run(&scene(passes), "out", &["--quiet"]).succeeded();
    let page = |name: &str| scene_of(&data, &format!("out/{name}/view.html"));
    let all = page("view");
    assert_eq!(with_photographs(&all), names(&all, "cameras"));
    let few = page("few");
    let test = |view: &&Value| view["test"] == true && !view["photograph"].is_null();
    assert_eq!(with_photographs(&few).len(), 3);
    assert_eq!(few["cameras"].as_array().unwrap().iter().filter(test).count(), 2);
    assert!(with_photographs(&page("none")).is_empty());
    let photograph = &few["cameras"][0]["photograph"];
    assert!(photograph["address"].as_str().unwrap().starts_with("data:image/jpeg;base64,/9j/"));
    let side = |key: &str, i: usize| photograph[key][i].as_u64().unwrap();
    assert!(side("window", 2) <= 48 && side("size", 0) == side("window", 2), "{}", photograph["window"]);
    assert!(few["arrays"]["coverage0"]["count"].as_u64().unwrap() == side("size", 0) * side("size", 1));

    // The saved object finds its photographs again, or does without.
    let root = data.root().to_str().unwrap();
    let page = || scene_of(&data, "out/view.html");
    let seen = data.lobelia(&["view", "out", "--data", root, "--photographs", "1"]).succeeded();
    assert!((seen.stderr + &seen.stdout).contains("1 photograph,"));
    assert_eq!(with_photographs(&page()).len(), 1);
    let without = || {
        let outcome = data.lobelia(&["view", "out", "--data", root]).succeeded();
        let said = outcome.stderr.matches("the page has neither photographs nor their cameras").count();
        assert_eq!(said, 1, "{}", outcome.stderr);
        assert!(names(&page(), "cameras").is_empty());
    };
    std::fs::remove_file(data.path("train/image/rgb_000000.exr")).unwrap();
    without();
    let saved = data.text("out/saved/scene.ron").replace(root, &format!("{root}/nowhere"));
    data.write("out/saved/scene.ron", saved);
    without();
}

#[test]
fn folders_without_a_saved_object_are_refused() {
    let data = Data::new();
    data.lobelia(&["view", "nowhere"]).refused(&["is not there"]);
    std::fs::create_dir(data.path("nowhere")).unwrap();
    data.lobelia(&["view", "nowhere"]).refused(&["has no saved/scene.ron", "`Save("]);
    let text = GRAY_SPHERE.replace("albedo: Fixed(Constant(0.5, 0.5, 0.5))", "albedo: Unknown");
    data.write("unknown.ron", text.replace("passes: [{PASS}],", ""));
    data.lobelia(&["view", "unknown.ron"]).refused(&["diffuse albedo"]);
    assert!(!files_below(data.root()).iter().any(|file| file.ends_with(".html")));
}

// Reports of runs.

/// A run with a second pass without scores, and scores of the first.
fn reported() -> String {
    let passes = r#"Fit(steps: 45, batch: 256), Render(name: "novel"),
        Edit(name: "polished", edits: [Roughness(action: Set(0.1))]),
        Evaluate(name: "scores", scores: [(pass: "novel", truth: Photographs)]),"#;
    photographed(passes, "Lobes(lobes: [(axis: (0, 1, 0), sharpness: 0.7, amplitude: (0.6, 0.6, 0.6))])")
}

#[track_caller]
fn has(text: &str, all: &[&str]) {
    for words in all {
        assert!(text.contains(words), "no {words:?} in\n{}", &text[..text.len().min(20_000)]);
    }
}

#[test]
fn a_run_has_a_report_with_everything() {
    let data = Data::new();
    data.run(&reported(), "out", &["--quiet"]).succeeded();
    let text = data.text("out/report.html");
    assert!(text.len() < 1_000_000, "{} bytes", text.len());
    for part in ["scores", "views", "light", "curves", "found", "passes", "scene", "run"] {
        has(&text, &[&format!("<section id=\"{part}\"")]);
    }
    has(&text, &["photograph of view", "fit: recovered light", "fit: true light", "fit: albedo"]);
    let others = ["s-finished", "PSNR of training pixels", "data:image/jpeg;base64,", "<h3>polished</h3>"];
    has(&text, &others);
    assert!(!text.contains("http:") && !text.contains("https:"), "it asks no server for anything");
    // The same page comes of the folder alone, also where it was moved.
    std::fs::rename(data.path("out"), data.path("moved")).unwrap();
    data.lobelia(&["report", "moved"]).succeeded();
    assert_eq!(data.text("moved/report.html"), text.replace(">out<", ">moved<"));
    let mut manifest = data.manifest("moved");
    has(manifest["scene_text"].as_str().unwrap(), &["Scene("]);
    assert!(manifest["machine"]["threads"].as_u64().unwrap() > 0 && manifest["seed"] == 0, "{manifest}");
    let fit = &manifest["passes"][0];
    assert!(fit["secs"].as_f64().unwrap() > 0.0 && fit["said"].to_string().contains("45 steps"), "{fit}");

    // A folder that lost files has a report of what is left.
    manifest["state"] = "failed".into();
    manifest["error"] = "scores: <no> room".into();
    data.write("moved/run.json", manifest.to_string());
    std::fs::remove_dir_all(data.path("moved/scores")).unwrap();
    std::fs::remove_dir_all(data.path("moved/fit")).unwrap();
    data.lobelia(&["report", "moved"]).succeeded();
    has(&data.text("moved/report.html"), &["s-failed", "scores: &lt;no&gt; room"]);
}

#[test]
fn runs_stand_side_by_side() {
    let data = Data::new();
    data.run(&reported(), "a", &["--quiet"]).succeeded();
    data.run(&reported(), "b", &["--quiet", "--set", "passes.fit.steps=5"]).succeeded();
    let both = ["report", "a", "b", "--out", "both.html"];
    data.lobelia(&both).succeeded();
    let text = data.text("both.html");
    has(&text, &["<title>a · b</title>", "passes.fit.steps", "<td>45</td><td>5</td>"]);
    has(&text, &["class=\"worse\">(▼ -", "a: render of view", "b: render of view", "b: error of view"]);
    assert_eq!(files_below(&data.path("a")).iter().filter(|file| file.ends_with(".html")).count(), 1);
    // An earlier report is replaced, and a file of the user is not.
    data.lobelia(&both).succeeded();
    data.write("both.html", "<p>my own page</p>");
    data.lobelia(&both).refused(&["both.html is not a page that this command wrote"]);
    assert_eq!(data.text("both.html"), "<p>my own page</p>");
    data.write("view.html", r#"<meta name="generator" content="Lobelia">"#);
    data.lobelia(&["report", "a", "--out", "view.html"]).refused(&["view.html is not a page"]);
    data.lobelia(&["report", "a", "--out", "train"]).refused(&["train: it is a folder"]);
    // A report in the way of a run stays.
    let mut manifest = data.manifest("a");
    manifest["files"] = serde_json::json!(["metrics.json"]);
    data.write("a/run.json", manifest.to_string());
    data.write("a/report.html", "mine");
    data.run(&reported(), "a", &["--quiet", "--force"]).refused(&["report.html is in the way"]);
    assert_eq!(data.text("a/report.html"), "mine");
}

#[test]
fn what_is_no_run_is_refused() {
    let data = Data::new();
    data.lobelia(&["report", "nowhere"]).refused(&["nowhere is not there", "help: Give the output folder"]);
    data.lobelia(&["report", "train"]).refused(&["train is not the folder of a run: it has no run.json"]);
    assert_eq!(data.lobelia(&["report"]).code, Some(2));
    assert!(!files_below(data.root()).iter().any(|file| file.ends_with(".html")));
}
