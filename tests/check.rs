//! `lobelia check` on photographs: what it says, what it writes, what stops a run before it costs
//! time, and that the two agree: what one refuses the other refuses, with the same message, and
//! what `check` takes does run.

use crate::common::{Data, Outcome, files_below, usual};
use serde_json::Value;

/// Checks the scene in the folder of its data.
fn check(data: &Data, arguments: &[&str]) -> Outcome {
    data.write("scene.ron", usual());
    data.lobelia(&[&["check", "scene.ron"], arguments].concat())
}

#[test]
fn good_data_is_described() {
    let data = Data::new();
    let outcome = check(&data, &["--data", "."]).succeeded();
    let text = &outcome.stdout;
    assert!(text.starts_with("scene.ron: fine\n"), "{text}");
    for words in [
        "PhySg: 6 training views of 24×24, 2 test views of 24×24",
        "files of 8 views",
        "masks overlap with the mesh to 0.9",
        "about",
    ] {
        assert!(text.contains(words), "no `{words}` in:\n{text}");
    }
    assert_eq!(outcome.stderr, "");
    // Without --data it is the scene file alone that is looked at.
    let without = check(&data, &[]).succeeded().stdout;
    assert!(without.contains("below $DATA not looked for") && !without.contains("PhySg"), "{without}");
}

#[test]
fn out_gets_the_survey_as_json() {
    let data = Data::new();
    check(&data, &["--data", ".", "--out", "look"]).succeeded();
    assert_eq!(files_below(&data.path("look")), ["survey.json"]);
    let survey = data.json("look/survey.json");
    assert_eq!((survey["views"].as_array().unwrap().len(), &survey["layout"]), (8, &Value::from("PhySg")));
    let (view, distance) = (&survey["views"][4], &survey["cameras"]["distance"][0]);
    assert!(view["mask"].is_object() && view["mask"]["small"].is_null(), "{view}");
    assert!(view["overlap"].is_number() && distance.as_f64() > Some(2.0), "{survey}");
    assert!(survey["findings"].is_array() && survey["estimate"]["bytes"].is_number(), "{survey}");
    check(&data, &["--out", "look"]).refused(&["--out has nothing to show"]);
    // An output that cannot be written is refused before photographs are read.
    data.write("afile", "");
    let outcome = check(&data, &["--data", ".", "--out", "afile"]);
    outcome.refused(&["afile is a file"]);
    assert_eq!(outcome.stdout, "");
}

#[test]
fn a_black_photograph_stops_check_and_run() {
    let data = Data::new();
    data.change_image("train/image/rgb_000003.exr", |layers| {
        layers.channels.values_mut().for_each(|channel| channel.fill(0.0));
    });
    let words = ["black where the object is, in view `rgb_000003`", "help: Replace it"];
    let looked = data.check(&usual());
    looked.refused(&words);
    assert!(looked.stdout.contains("scene.ron: 1 error"), "{}", looked.stdout);
    data.run(&usual(), "out", &["--quiet"]).refused(&words);
    assert!(files_below(&data.path("out")).is_empty(), "nothing is written before the data is looked at");
}

#[test]
fn a_mesh_in_millimeters_stops_a_run_and_a_warning_does_not() {
    let data = Data::new();
    let mesh = lobelia::mesh::primitive::sphere_mesh(glam::Vec3::ZERO, 800.0).unwrap();
    lobelia::codec::gltf::export::write_glb(&data.path("mesh.glb"), &mesh, None).unwrap();
    data.run(&usual(), "out", &["--quiet"]).refused(&["1000 times too large"]);
    let data = Data::new();
    data.change_image("train/image/rgb_000001.exr", |layers| {
        layers.channels.values_mut().flatten().for_each(|value| *value *= 4096.0);
    });
    let said = check(&data, &["--data", "."]).succeeded().stdout;
    assert!(said.contains("scene.ron: 1 warning\n"), "{}", said);
    assert!(said.contains("warning (exposure): the exposure differs"), "{}", said);
    let run = data.run(&usual(), "out", &[]).succeeded();
    assert!(run.stderr.contains("note: the exposure differs from that of views"), "{}", run.stderr);
}

/// Choices for each part of a scene: words that are right, and some that are not. The first of each
/// are right together.
const SURFACES: [&str; 6] = [
    r#"Mesh(path: "$DATA/mesh.glb", texture_size: 16)"#,
    "Sphere(radius: 0.8, texture_size: 16)",
    "Box(size: (1, 1, 1), texture_size: 16)",
    r#"Mesh(path: "$DATA/none.glb")"#,
    r#"Mesh(path: "$DATA/evening.npy")"#,
    "Sphere(radius: 9, texture_size: 16)",
];
const VIEWS: [&str; 5] = [
    r#"Dataset(path: "$DATA")"#,
    "Photographed(cameras: (count: 3, test: 1, size: 16), truth: (albedo: Constant(0.5, 0.3, 0.2), \
     specular: (albedo: (0.2, 0.2, 0.2), roughness: 0.3), \
     light: Lobes(lobes: [(axis: (0, 1, 0), sharpness: 3, amplitude: (1, 1, 1))])))",
    r#"Dataset(path: "$DATA", downscale: 2)"#,
    r#"Dataset(path: "$DATA", select: ["nope"])"#,
    r#"Cameras([(name: "rgb_000000", eye: (0, 0, 3), width: 16, height: 16, split: Test)])"#,
];
const LIGHTS: [&str; 4] = [
    "Unknown(lobes: 4)",
    r#"Fixed(Npy(path: "$DATA/evening.npy"))"#,
    r#"Fixed(Npy(path: "$DATA/mesh.glb"))"#,
    r#"Initial(Map(path: "$DATA/mesh.glb"))"#,
];
const PASSES: [&str; 14] = [
    r#"Fit(name: "more", steps: 2, batch: 64)"#,
    r#"Edit(name: "edit", edits: [Roughness(action: Set(0.2))])"#,
    r#"Relight(name: "relit", light: Npy(path: "$DATA/evening.npy"))"#,
    r#"Evaluate(scores: [(pass: "novel", truth: Photographs)])"#,
    "Save()",
    "Export(formats: [Glb, Usda])",
    r#"Evaluate(name: "meshes", mesh: "$DATA/mesh.glb")"#,
    r#"Render(name: "named", render: (views: Named(["rgb_000000"])))"#,
    r#"Render(name: "wrong", render: (views: Named(["nope"])))"#,
    r#"Edit(name: "edit", edits: [Diffuse(action: Texture("$DATA/mesh.glb"))])"#,
    r#"Relight(name: "relit", light: Npy(path: "$DATA/mesh.glb"))"#,
    r#"Evaluate(name: "meshes", mesh: "$DATA/evening.npy")"#,
    r#"Evaluate(name: "folder", scores: [(pass: "novel", truth: Folder("$DATA/test/gt"))])"#,
    r#"Evaluate(name: "relit_scores", scores: [(pass: "relit", truth: Folder("$DATA/test/gt/relit"))])"#,
];

/// The message without its drawing.
fn message(outcome: &Outcome) -> Option<&str> {
    outcome.stderr.lines().find(|line| line.starts_with("error"))
}

#[test]
fn what_check_takes_runs_and_what_it_refuses_does_not() {
    let data = Data::new();
    let choices: [&[&str]; 4] = [&SURFACES, &VIEWS, &LIGHTS, &PASSES];
    let (mut taken, mut tried) = (0, 0);
    for (part, word) in (0..4).flat_map(|part| choices[part].iter().map(move |word| (part, *word))) {
        let mut words = choices.map(|choices| choices[0]);
        words[part] = word;
        let [surface, views, light, pass] = words;
        let text = format!(
            "Scene(version: 1,\nsurface: {surface},\nviews: {views},\nlight: {light},\nvisibility: None,\npasses: \
             [Fit(name: \"fit\", steps: 2, batch: 64),\nRender(name: \"novel\"),\n{pass}])\n"
        );
        let out = format!("out-{part}-{tried}");
        let (check, run) = (data.check(&text), data.run(&text, &out, &["--quiet"]));
        assert!(!run.stderr.contains("panicked") && !check.stderr.contains("panicked"), "{text}");
        assert_eq!(check.code, run.code, "{text}\ncheck: {}\nrun: {}", check.stderr, run.stderr);
        tried += 1;
        if run.code == Some(0) {
            taken += 1;
        } else {
            assert_eq!(message(&check), message(&run), "{text}");
            assert!(files_below(&data.path(&out)).is_empty(), "{text}");
        }
    }
    assert!(taken > 4 && taken < tried - 4, "{taken} of {tried} scenes are taken");
}
