//! `check` and `run` agree: what one refuses the other refuses, with the same message, and what `check` takes does run.

use crate::common::{Data, Outcome, command, files_below};
use rand::rngs::SmallRng;
use rand::{RngExt, SeedableRng};

/// Scenes that are tried.
const SCENES: u64 = 48;

/// What each part of a scene may be: words that are right, and some that are not.
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
const PASSES: [&str; 12] = [
    r#"Fit(name: "more", steps: 2, batch: 64)"#,
    r#"Edit(name: "edit", edits: [Roughness(action: Set(0.2))])"#,
    r#"Relight(name: "relit", light: Npy(path: "$DATA/evening.npy"))"#,
    r#"Evaluate(scores: [(pass: "novel", truth: Photographs)])"#,
    "Save()",
    "Export(formats: [Glb, Ply])",
    r#"Evaluate(name: "meshes", mesh: "$DATA/mesh.glb")"#,
    r#"Render(name: "named", render: (views: Named(["rgb_000000"])))"#,
    r#"Render(name: "wrong", render: (views: Named(["nope"])))"#,
    r#"Edit(name: "edit", edits: [Diffuse(action: Texture("$DATA/mesh.glb"))])"#,
    r#"Evaluate(name: "folder", scores: [(pass: "novel", truth: Folder("$DATA/test/gt"))])"#,
    r#"Evaluate(name: "relit_scores", scores: [(pass: "relit", truth: Folder("$DATA/test/gt/relit"))])"#,
];

/// A scene of random words; most of them are right.
fn scene(seed: u64) -> String {
    let mut random = SmallRng::seed_from_u64(seed);
    let mut pick = |words: &[&'static str]| {
        // The first are right: they are taken more often.
        let most = if random.random_range(0..5) == 0 { words.len() } else { words.len().div_ceil(2) };
        words[random.random_range(0..most)]
    };
    let (surface, views, light) = (pick(&SURFACES), pick(&VIEWS), pick(&LIGHTS));
    let mut passes: Vec<&str> = vec![r#"Fit(name: "fit", steps: 2, batch: 64)"#, r#"Render(name: "novel")"#];
    passes.extend((0..2).map(|_| pick(&PASSES)));
    passes.dedup();
    let passes = passes.join(",\n        ");
    format!(
        "Scene(\n    version: 1,\n    surface: {surface},\n    views: {views},\n    light: {light},\n    visibility: None,\n    passes: [\n        \
         {passes},\n    ],\n)\n"
    )
}

/// The message without its drawing.
fn message(outcome: &Outcome) -> String {
    let line = outcome.stderr.lines().find(|line| line.starts_with("error")).unwrap_or_default();
    line.to_owned()
}

#[test]
fn what_check_takes_runs_and_what_it_refuses_does_not() {
    let data = Data::new();
    let mut taken = 0;
    for seed in 0..SCENES {
        let (text, out) = (scene(seed), format!("out-{seed}"));
        std::fs::write(data.path("scene.ron"), &text).unwrap();
        let mut check = command(&["check"]);
        let check = Outcome::of(check.arg(data.path("scene.ron")).arg("--data").arg(data.root()));
        let run = data.run(&text, &out, &["--quiet"]);
        assert!(!run.stderr.contains("panicked") && !check.stderr.contains("panicked"), "{text}");
        assert_eq!(check.code, run.code, "seed {seed}\n{text}\ncheck: {}\nrun: {}", check.stderr, run.stderr);
        if run.code == Some(0) {
            taken += 1;
        } else {
            assert_eq!(message(&check), message(&run), "{text}");
            assert!(files_below(&data.path(&out)).is_empty(), "{text}");
        }
    }
    assert!(taken > 8 && taken < SCENES - 8, "{taken} of {SCENES} scenes are taken");
}
