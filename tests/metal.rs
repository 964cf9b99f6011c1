//! Metal beside paint: a fit finds by itself that one base material is too few.

use crate::common::{Outcome, command};
use std::path::Path;

/// A sphere whose upper half may be of gold.
const SCENE: &str = r#"Scene(
    version: 1,
    surface: Sphere(radius: 0.9, texture_size: 48),
    views: Photographed(
        cameras: (count: 20, test: 2, size: 48),
        spp: 32,
        max_bounces: 1,
        truth: (
            albedo: Waves(colors: ((0.7, 0.3, 0.2), (0.2, 0.35, 0.6)), size: 0.9),
            specular: (albedo: (0.04, 0.04, 0.04), roughness: 0.5, ndf: Ggx),
            edits: [GOLD],
            light: Lobes(lobes: [
                (axis: (0, 1, 0), sharpness: 0.7, amplitude: (0.35, 0.45, 0.6)),
                (axis: (0.5, 0.6, 0.62), sharpness: 60, amplitude: (6, 5, 4)),
                (axis: (-0.8, 0.3, -0.3), sharpness: 30, amplitude: (2, 3, 4)),
                (axis: (0.3, -0.5, -0.8), sharpness: 40, amplitude: (4, 4, 4)),
            ]),
        ),
    ),
    passes: [
        Fit(name: "fit", steps: 300, batch: 512),
        Render(name: "novel"),
        Evaluate(name: "scores", scores: [(pass: "novel", truth: Photographs)]),
        Save(name: "saved"),
    ],
)
"#;
const GOLD: &str = "
    Diffuse(action: Set(0.0, 0.0, 0.0), region: Box(min: (-1, 0, -1), max: (1, 1, 1))),
    Specular(action: Set(1.0, 0.7, 0.3), region: Box(min: (-1, 0, -1), max: (1, 1, 1))),
    Roughness(action: Set(0.25), region: Box(min: (-1, 0, -1), max: (1, 1, 1))),
";

fn run(folder: &Path, edits: &str, settings: &[&str]) -> (serde_json::Value, String) {
    let (scene, out) = (folder.join("scene.ron"), folder.join("out"));
    std::fs::write(&scene, SCENE.replace("GOLD", edits)).unwrap();
    let mut command = command(&["run", "--quiet", "--force"]);
    for setting in settings {
        command.args(["--set", setting]);
    }
    Outcome::of(command.arg(&scene).arg("--out").arg(&out)).succeeded();
    let metrics = serde_json::from_str(&std::fs::read_to_string(out.join("metrics.json")).unwrap()).unwrap();
    (metrics, std::fs::read_to_string(out.join("fit/materials.ron")).unwrap())
}

/// The specular albedo of the least rough material.
fn glossiest(materials: &str) -> [f64; 3] {
    let numbers = |line: &str| -> Vec<f64> {
        line.split(|c: char| !(c.is_ascii_digit() || c == '.')).filter_map(|n| n.parse().ok()).collect()
    };
    let mut lobes: Vec<Vec<f64>> =
        materials.lines().filter(|line| line.contains("roughness: ")).map(numbers).collect();
    lobes.retain(|lobe| lobe.len() >= 4);
    lobes.sort_by(|a, b| a[3].total_cmp(&b[3]));
    [lobes[0][0], lobes[0][1], lobes[0][2]]
}

fn psnr(metrics: &serde_json::Value) -> f64 {
    metrics["passes"]["novel"]["psnr"].as_f64().unwrap()
}

/// The upper half of the sphere, and of its texture, is gold.
fn assert_little_diffuse_light_beneath(folder: &Path) {
    let albedo = image::open(folder.join("out/fit/albedo.png")).unwrap().to_rgb8();
    let (width, height) = albedo.dimensions();
    let mean = |rows: std::ops::Range<u32>| {
        let values = rows.flat_map(|y| (0..width).flat_map(move |x| [(x, y)]));
        let values: Vec<f64> = values
            .flat_map(|(x, y)| albedo.get_pixel(x, y).0)
            .map(|value| f64::from(value) / 255.0)
            .collect();
        values.iter().sum::<f64>() / values.len() as f64
    };
    let (gold, paint) = (mean(height / 8..height * 3 / 8), mean(height * 5 / 8..height * 7 / 8));
    assert!(gold < 0.45 && paint > 0.6, "{gold} {paint}");
}

#[test]
fn metal_beside_paint_gets_a_material_of_its_own() {
    let folder = tempfile::tempdir().unwrap();
    let (gold, materials) = run(folder.path(), GOLD, &[]);
    let tried = &gold["materials_tried"];
    assert!(tried["several"].as_f64() < tried["one"].as_f64().map(|one| 0.9 * one), "{tried}");
    let [r, _, b] = glossiest(&materials);
    assert!(materials.matches("roughness: ").count() == 2 && r > 2.0 * b, "{materials}");
    // The color of the gold is not that of the light, which is (0.32, 0.38, 0.47) on average.
    let light = &gold["scale"]["mean_light"];
    assert!(light[0].as_f64() < light[2].as_f64(), "{light}");
    assert_little_diffuse_light_beneath(folder.path());
    let (one, _) = run(folder.path(), GOLD, &["material.gloss=One"]);
    assert!(
        one["materials_tried"].is_null() && psnr(&gold) > psnr(&one) + 2.0,
        "{} {}",
        psnr(&gold),
        psnr(&one)
    );
}

#[test]
fn paint_alone_keeps_one_material() {
    let folder = tempfile::tempdir().unwrap();
    let (paint, materials) = run(folder.path(), "", &[]);
    assert_eq!(materials.matches("roughness: ").count(), 1, "{materials}");
    let tried = &paint["materials_tried"];
    assert!(
        tried.is_null() || tried["several"].as_f64() > tried["one"].as_f64().map(|one| 0.9 * one),
        "{tried}"
    );
}
