//! The page that shows a saved object: what `View` and `lobelia view` write, and what they refuse.

use crate::common::{Data, Outcome, command, files_below, scene};
use serde_json::Value;
use std::path::Path;

const SCENE: &str = r#"Scene(
    version: 1,
    surface: Box(texture_size: 32),
    views: Cameras([
        (name: "front", eye: (1.6, 1.3, 1.9), width: 24, height: 16),
    ]),
    light: Fixed(Lobes(lobes: [
        (axis: (0, 1, 0), sharpness: 0.7, amplitude: (0.35, 0.45, 0.6)),
        (axis: (0.5, 0.6, 0.62), sharpness: 20, amplitude: (2.5, 2.2, 1.9)),
    ])),
    material: (
        albedo: Fixed(Constant(0.5, 0.3, 0.2)),
        specular: (albedo: Fixed(0.3, 0.22, 0.08), roughness: Fixed(0.3)),
    ),
    passes: [
        Relight(name: "evening", light: Lobes(lobes: [
            (axis: (1, 0, 0), sharpness: 5, amplitude: (3, 1, 0.5)),
        ])),
        Edit(name: "polished", edits: [Roughness(action: Set(0.1))]),
        Save(),
        View(),
        View(name: "shown", of: "evening"),
        View(name: "shiny", of: "polished"),
    ],
)"#;

/// What the page says of its scene.
fn scene_of(page: &Path) -> Value {
    let text = std::fs::read_to_string(page).unwrap();
    let (_, after) = text.split_once("id=\"scene\">").unwrap();
    serde_json::from_str(after.split_once("</script>").unwrap().0).unwrap()
}

fn names(scene: &Value, list: &str) -> Vec<String> {
    let name = |entry: &Value| entry["name"].as_str().unwrap().to_owned();
    scene[list].as_array().unwrap().iter().map(name).collect()
}

fn view(arguments: &[&str]) -> Outcome {
    Outcome::of(&mut command(&[&["view"], arguments].concat()))
}

#[test]
fn pages_offer_the_lights_and_cameras_of_the_scene() {
    let data = Data::new();
    data.run(SCENE, "out", &["--quiet"]).succeeded();
    assert_eq!(files_below(&data.path("out/view")), ["view.html"]);
    let plain = scene_of(&data.path("out/view/view.html"));
    assert!(with_photographs(&plain).is_empty(), "cameras alone");
    assert_eq!(names(&plain, "lights"), ["found", "evening"]);
    assert_eq!(names(&plain, "cameras"), ["front"]);
    assert_eq!(plain["title"], "out");
    let shown = scene_of(&data.path("out/shown/view.html"));
    assert_eq!(names(&shown, "lights"), ["evening", "found"]);
    let shiny = scene_of(&data.path("out/shiny/view.html"));
    let roughness = |scene: &Value| scene["materials"][0]["roughness"].as_f64().unwrap();
    assert!((roughness(&shiny) - 0.1).abs() < 1e-6 && (roughness(&plain) - 0.3).abs() < 1e-6);
    assert!(shiny["edits"][0].as_str().unwrap().starts_with("Roughness("), "{shiny}");
    assert!(std::fs::metadata(data.path("out/view/view.html")).unwrap().len() < 340_000);
}

#[test]
fn a_saved_object_gets_a_page_and_nothing_else() {
    let data = Data::new();
    data.run(SCENE, "out", &["--quiet"]).succeeded();
    let before = files_below(&data.path("out"));
    let light = data.path("moon.ron");
    std::fs::write(&light, "Lobes(lobes: [(axis: (0, 1, 0), sharpness: 9, amplitude: (1, 1, 2))])").unwrap();
    let out = data.path("out");
    view(&[out.to_str().unwrap(), "--light", light.to_str().unwrap()]).succeeded();
    let mut after = files_below(&out);
    after.retain(|file| !before.contains(file));
    assert_eq!(after, ["view.html"]);
    assert_eq!(names(&scene_of(&out.join("view.html")), "lights"), ["found", "moon"]);
}

#[test]
fn an_earlier_page_is_replaced_and_a_file_of_the_user_is_not() {
    let data = Data::new();
    data.run(SCENE, "out", &["--quiet"]).succeeded();
    let (out, page) = (data.path("out"), data.path("out/view.html"));
    view(&[out.to_str().unwrap()]).succeeded();
    view(&[out.to_str().unwrap()]).succeeded();
    std::fs::write(&page, "<p>my own page</p>").unwrap();
    let outcome = view(&[out.to_str().unwrap()]);
    assert!(
        outcome.code == Some(2) && outcome.stderr.contains("view.html is not a page"),
        "{}",
        outcome.stderr
    );
    assert_eq!(std::fs::read_to_string(&page).unwrap(), "<p>my own page</p>");
}

/// The views of a page that have photographs.
fn with_photographs(scene: &Value) -> Vec<String> {
    let views = scene["cameras"].as_array().unwrap().iter();
    views
        .filter(|view| !view["photograph"].is_null())
        .map(|view| view["name"].as_str().unwrap().to_owned())
        .collect()
}

#[test]
fn pages_have_the_photographs_of_the_run_the_held_out_ones_first() {
    let data = Data::new();
    let passes = r#"Fit(name: "fit", steps: 2), Save(), View(), View(name: "few", photographs: 3), View(name: "none", photographs: 0)"#;
    data.run(&scene(passes), "out", &["--quiet"]).succeeded();
    let page = |name: &str| scene_of(&data.path(&format!("out/{name}/view.html")));
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
}

#[test]
fn a_saved_object_finds_its_photographs_again_or_does_without() {
    let data = Data::new();
    data.run(&scene(r#"Fit(name: "fit", steps: 2), Save()"#), "out", &["--quiet"]).succeeded();
    let (out, root) = (data.path("out"), data.root().to_str().unwrap().to_owned());
    let page = || scene_of(&out.join("view.html"));
    let seen = view(&[out.to_str().unwrap(), "--data", &root, "--photographs", "1"]).succeeded();
    assert!(
        seen.stderr.contains("1 photograph,") || seen.stdout.contains("1 photograph,"),
        "{}",
        seen.stderr
    );
    assert_eq!(with_photographs(&page()).len(), 1);
    let without = || {
        let outcome = view(&[out.to_str().unwrap(), "--data", &root]).succeeded();
        let said = outcome.stderr.matches("the page has neither photographs nor their cameras").count();
        assert_eq!(said, 1, "{}", outcome.stderr);
        assert!(names(&page(), "cameras").is_empty());
    };
    std::fs::remove_file(data.path("train/image/rgb_000000.exr")).unwrap();
    without();
    let saved = out.join("saved/scene.ron");
    let text = std::fs::read_to_string(&saved).unwrap();
    std::fs::write(&saved, text.replace(&root, &format!("{root}/nowhere"))).unwrap();
    without();
}

#[test]
fn folders_without_a_saved_object_are_refused() {
    let data = Data::new();
    let nowhere = data.path("nowhere");
    let outcome = view(&[nowhere.to_str().unwrap()]);
    assert!(outcome.code == Some(2) && outcome.stderr.contains("is not there"), "{}", outcome.stderr);
    std::fs::create_dir(&nowhere).unwrap();
    let outcome = view(&[nowhere.to_str().unwrap()]);
    let said = outcome.stderr.contains("has no saved/scene.ron") && outcome.stderr.contains("`Save(");
    assert!(outcome.code == Some(2) && said, "{}", outcome.stderr);
    let unknown = data.path("unknown.ron");
    let text = SCENE.replace("albedo: Fixed(Constant(0.5, 0.3, 0.2))", "albedo: Unknown");
    let (head, _) = text.split_once("    passes: [").unwrap();
    std::fs::write(&unknown, format!("{head})")).unwrap();
    let outcome = view(&[unknown.to_str().unwrap()]);
    assert!(outcome.code == Some(2) && outcome.stderr.contains("diffuse albedo"), "{}", outcome.stderr);
    assert!(!files_below(data.root()).iter().any(|file| file.ends_with(".html")));
}
