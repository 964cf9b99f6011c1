//! `lobelia check` on photographs: what it says, what it writes, and what stops a run before it costs time.

use crate::common::{Data, Outcome, command, files_below};
use serde_json::Value;

const SCENE: &str = r#"Scene(
    version: 1,
    surface: Mesh(path: "$DATA/mesh.glb", texture_size: 32),
    views: Dataset(path: "$DATA"),
    light: Unknown(lobes: 8),
    visibility: None,
    passes: [
        Fit(name: "fit", steps: 2, batch: 64),
        Render(name: "novel"),
        Evaluate(name: "scores", scores: [(pass: "novel", truth: Photographs)]),
    ],
)
"#;

fn check(data: &Data, scene: &str, arguments: &[&str]) -> Outcome {
    let path = data.path("scene.ron");
    std::fs::write(&path, scene).unwrap();
    Outcome::of(command(&["check"]).arg(path).args(arguments))
}

fn check_data(data: &Data, arguments: &[&str]) -> Outcome {
    let root = data.root().to_str().unwrap().to_owned();
    check(data, SCENE, &[&["--data", root.as_str()], arguments].concat())
}

#[test]
fn good_data_is_described() {
    let data = Data::new();
    let outcome = check_data(&data, &[]).succeeded();
    let text = &outcome.stdout;
    assert!(text.starts_with(&format!("{}: fine\n", data.path("scene.ron").display())), "{text}");
    for words in [
        "PhySg: 6 training views of 24×24, 2 test views of 24×24",
        "files of 8 views",
        "mesh and masks overlap to 0.9",
        "about",
    ] {
        assert!(text.contains(words), "no `{words}` in:\n{text}");
    }
    assert_eq!(outcome.stderr, "");
    let shared = check_data(&data, &["--processes", "4"]).succeeded().stdout;
    assert!(shared.contains("in each of 4 processes"), "{shared}");
    // Without --data it is the scene file alone that is looked at.
    let without = check(&data, SCENE, &[]).succeeded().stdout;
    assert!(without.contains("below $DATA not looked for") && !without.contains("PhySg"), "{without}");
}

#[test]
fn out_gets_a_contact_sheet_and_json() {
    let data = Data::new();
    let out = data.path("look");
    check_data(&data, &["--out", out.to_str().unwrap()]).succeeded();
    assert_eq!(files_below(&out), ["contact_sheet.png", "survey.json"]);
    let sheet = image::open(out.join("contact_sheet.png")).unwrap();
    assert!(sheet.width() > 400 && sheet.height() > 400);
    let survey: Value = serde_json::from_slice(&std::fs::read(out.join("survey.json")).unwrap()).unwrap();
    assert_eq!((survey["views"].as_array().unwrap().len(), &survey["layout"]), (8, &Value::from("PhySg")));
    let outcome = check(&data, SCENE, &["--out", out.to_str().unwrap()]);
    assert_eq!(outcome.code, Some(2));
    assert!(outcome.stderr.contains("--out has nothing to show"), "{}", outcome.stderr);
}

#[test]
fn a_black_photograph_stops_check_and_run() {
    let data = Data::new();
    data.change_image("train/image/rgb_000003.exr", |layers| {
        layers.channels.values_mut().for_each(|channel| channel.fill(0.0));
    });
    let outcome = check_data(&data, &[]);
    assert_eq!(outcome.code, Some(2), "{}", outcome.stderr);
    assert!(outcome.stdout.contains("scene.ron: 1 error"), "{}", outcome.stdout);
    let run = data.run(SCENE, "out", &["--quiet"]);
    assert_eq!(run.code, Some(2), "{}", run.stderr);
    for stderr in [outcome.stderr, run.stderr] {
        assert!(stderr.contains("black where the object is, in view `rgb_000003`"), "{stderr}");
        assert!(stderr.contains("help: Replace it"), "{stderr}");
    }
    assert!(files_below(&data.path("out")).is_empty(), "nothing is written before the data is looked at");
}

#[test]
fn a_mesh_in_millimeters_stops_a_run_and_a_warning_does_not() {
    let data = Data::new();
    let mesh = lobelia::mesh::primitive::sphere_mesh(glam::Vec3::ZERO, 800.0).unwrap();
    lobelia::codec::gltf::export::write_glb(&data.path("mesh.glb"), &mesh, None).unwrap();
    let run = data.run(SCENE, "out", &["--quiet"]);
    assert_eq!(run.code, Some(2), "{}", run.stderr);
    assert!(run.stderr.contains("1000 times too large"), "{}", run.stderr);
    let data = Data::new();
    let copy = |kind: &str, extension: &str| {
        let path = |number: u32| data.path(&format!("train/{kind}/rgb_{number:06}.{extension}"));
        std::fs::copy(path(0), path(1)).unwrap();
    };
    copy("image", "exr");
    let outcome = check_data(&data, &[]).succeeded();
    assert!(outcome.stdout.contains("scene.ron: 1 warning\n"), "{}", outcome.stdout);
    assert!(outcome.stdout.contains("warning (duplicates): the same photograph"), "{}", outcome.stdout);
    let run = data.run(SCENE, "out", &[]).succeeded();
    assert!(run.stderr.contains("note: the same photograph is there more than once"), "{}", run.stderr);
}

#[test]
fn check_refuses_what_a_run_refuses_before_its_first_pass() {
    let data = Data::new();
    std::fs::write(data.path("bad.npy"), "no numbers").unwrap();
    std::fs::write(data.path("bad.glb"), "no mesh").unwrap();
    let with =
        |pass: &str| SCENE.replace("        Evaluate(", &format!("        {pass},\n        Evaluate("));
    let evaluate = "Evaluate(name: \"scores\", ";
    let cameras = r#"Scene(
        version: 1,
        surface: Sphere(texture_size: 16),
        views: Cameras([(name: "front", eye: (0, 0, 3))]),
        light: Fixed(Npy(path: "$DATA/bad.npy")),
        material: (
            albedo: Fixed(Constant(0.5, 0.5, 0.5)),
            specular: (albedo: Fixed(0.05, 0.05, 0.05), roughness: Fixed(0.3)),
        ),
        passes: [Render(name: "novel", render: (views: All))],
    )"#;
    for (scene, words) in [
        (with(r#"Relight(name: "relit", light: Npy(path: "$DATA/bad.npy"))"#), "bad.npy"),
        (SCENE.replace(evaluate, &format!("{evaluate}mesh: \"$DATA/bad.glb\", ")), "bad.glb"),
        (with(r#"Render(name: "one", render: (views: Named(["nope"])))"#), "there is no view nope"),
        (cameras.to_owned(), "bad.npy"),
    ] {
        let looked = check(&data, &scene, &["--data", data.root().to_str().unwrap()]);
        let run = data.run(&scene, "out", &["--quiet"]);
        assert_eq!((looked.code, run.code), (Some(2), Some(2)), "{}", looked.stdout);
        assert!(looked.stdout.contains("scene.ron: 1 error"), "{}", looked.stdout);
        assert!(looked.stderr.contains(words), "{}", looked.stderr);
        assert_eq!(looked.stderr, run.stderr);
    }
}

#[test]
fn an_output_that_cannot_be_written_is_refused_before_photographs_are_read() {
    let data = Data::new();
    let file = data.path("afile");
    std::fs::write(&file, "").unwrap();
    let outcome = check_data(&data, &["--out", file.to_str().unwrap()]);
    assert_eq!((outcome.code, outcome.stdout.as_str()), (Some(2), ""), "{}", outcome.stderr);
    assert!(outcome.stderr.contains("afile is a file"), "{}", outcome.stderr);
}
