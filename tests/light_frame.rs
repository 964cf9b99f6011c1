//! How a fit starts: a light that stands still before the camera, while the object turns, is found as such, saved and rendered as such, and
//! the specular lobe starts as one that suits the photographs.

use crate::common::{Outcome, command};
use std::path::Path;

/// A sphere under one lamp at the side and a faint sky.
const SCENE: &str = r#"Scene(
    version: 1,
    surface: Sphere(radius: 0.9, texture_size: 48),
    light_frame: ASSUMED,
    views: Photographed(
        cameras: (count: 16, test: 3, size: 48),
        spp: 32,
        max_bounces: 1,
        truth: (
            albedo: Waves(colors: ((0.7, 0.3, 0.2), (0.2, 0.35, 0.6)), size: 0.9),
            specular: (albedo: (0.3, 0.3, 0.3), roughness: 0.3),
            light_frame: TRUE,
            light: Lobes(lobes: [
                (axis: (0, 1, 0), sharpness: 0.7, amplitude: (0.4, 0.4, 0.4)),
                (axis: (0.8, 0.5, 0.4), sharpness: 20, amplitude: (4, 4, 4)),
            ]),
        ),
    ),
    light: Unknown(lobes: 32),
    passes: [
        Fit(name: "fit", steps: 250, batch: 2048),
        Render(name: "novel"),
        Evaluate(name: "scores", scores: [(pass: "novel", truth: Photographs)]),
        Save(name: "saved"),
    ],
)
"#;

/// Metrics of a run, and the scene that it saves.
fn run(folder: &Path, assumed: &str, truth: &str) -> (serde_json::Value, String) {
    let scene = folder.join("scene.ron");
    std::fs::write(&scene, SCENE.replace("ASSUMED", assumed).replace("TRUE", truth)).unwrap();
    let out = folder.join("out");
    Outcome::of(command(&["run", "--quiet", "--force"]).arg(&scene).arg("--out").arg(&out)).succeeded();
    let text = std::fs::read_to_string(out.join("metrics.json")).unwrap();
    let saved = std::fs::read_to_string(out.join("saved/scene.ron")).unwrap();
    (serde_json::from_str(&text).unwrap(), saved)
}

fn psnr(metrics: &serde_json::Value) -> f64 {
    metrics["passes"]["novel"]["psnr"].as_f64().unwrap()
}

#[test]
fn the_frame_of_the_light_is_found() {
    let folder = tempfile::tempdir().unwrap();
    let (still, saved) = run(folder.path(), "Auto", "World");
    assert_eq!(still["light_frame"], "World");
    assert!(saved.contains("light_frame: World") && psnr(&still) > 32.0, "{saved} {}", psnr(&still));
    let (turning, saved) = run(folder.path(), "Auto", "Camera");
    assert_eq!(turning["light_frame"], "Camera");
    assert!(saved.contains("light_frame: Camera"), "{saved}");
    assert!(psnr(&turning) > 32.0, "{}", psnr(&turning));
    let (wrong, _) = run(folder.path(), "World", "Camera");
    assert!(psnr(&wrong) < psnr(&turning) - 5.0, "{} {}", psnr(&wrong), psnr(&turning));
    assert!(wrong["light_frame"].is_null());
}

#[test]
fn a_turntable_with_tilted_cameras_is_found_and_its_light_saved() {
    let folder = tempfile::tempdir().unwrap();
    let (found, saved) = run(folder.path(), "Auto", "Turntable(0, 1, 0)");
    assert!(found["light_frame"].as_str().unwrap().starts_with("Turntable"), "{found}");
    assert!(saved.contains("light_frame: Turntable"), "{saved}");
    let out = folder.path().join("again");
    let scene = folder.path().join("out/saved/scene.ron");
    Outcome::of(command(&["run", "--quiet"]).arg(&scene).arg("--out").arg(&out)).succeeded();
    let exr = |root: &Path| {
        let mut files: Vec<_> =
            std::fs::read_dir(root.join("novel")).unwrap().map(|file| file.unwrap().path()).collect();
        files.retain(|file| file.extension().is_some_and(|end| end == "exr"));
        files.sort();
        files.into_iter().map(|file| std::fs::read(file).unwrap()).collect::<Vec<_>>()
    };
    let (first, again) = (exr(&folder.path().join("out")), exr(&out));
    assert!(!first.is_empty() && first == again);
}

/// Specular albedo and roughness that `lobelia run` finds in one step on a surface with the specular `lobe`, under a light whose frame it finds.
fn lobe_after_a_step(lobe: &str) -> [f64; 2] {
    let folder = tempfile::tempdir().unwrap();
    let text =
        SCENE.replace("albedo: (0.3, 0.3, 0.3), roughness: 0.3", lobe).replace("steps: 250", "steps: 1");
    let scene = folder.path().join("scene.ron");
    std::fs::write(&scene, text.replace("ASSUMED", "Auto").replace("TRUE", "World")).unwrap();
    let out = folder.path().join("out");
    Outcome::of(command(&["run", "--quiet"]).arg(&scene).arg("--out").arg(&out)).succeeded();
    let saved = std::fs::read_to_string(out.join("saved/scene.ron")).unwrap();
    assert!(saved.contains("light_frame: World"), "{saved}");
    let found = std::fs::read_to_string(out.join("fit/materials.ron")).unwrap();
    ["(albedo: (", "roughness: "].map(|word| {
        let (_, after) = found.split_once(word).unwrap();
        after.split([',', ')']).next().unwrap().parse().unwrap()
    })
}

#[test]
fn the_specular_lobe_starts_as_the_surface_looks() {
    let matte = lobe_after_a_step("albedo: (0.04, 0.04, 0.04), roughness: 0.8");
    assert!(matte[0] < 0.1 && matte[1] > 0.7, "{matte:?}");
    let glossy = lobe_after_a_step("albedo: (0.3, 0.3, 0.3), roughness: 0.3");
    assert!(glossy[0] > 0.2 && glossy[1] < 0.5, "{glossy:?}");
}

#[test]
fn a_turntable_without_an_axis_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let scene = folder.path().join("scene.ron");
    std::fs::write(&scene, SCENE.replace("ASSUMED", "Turntable(0, 0, 0)").replace("TRUE", "World")).unwrap();
    let outcome = Outcome::of(command(&["check"]).arg(&scene));
    assert_eq!(outcome.code, Some(2), "{}", outcome.stderr);
    assert!(outcome.stderr.contains("light_frame"), "{}", outcome.stderr);
}
