//! A material with `ndf: Ggx` from the scene file to photographs, fit, edit, path tracing and a saved scene; and the choice where nothing is said.

use crate::common::{Outcome, command};
use lobelia::codec::exr::read_exr_layers;
use std::path::{Path, PathBuf};

/// A sphere of one color, which a fit finds with its roughness and specular albedo; nothing can hide anything.
const SCENE: &str = r#"Scene(
    version: 1,
    surface: Sphere(radius: 0.9, texture_size: 32),
    views: Photographed(
        cameras: (count: 8, test: 1, size: 40),
        spp: 96,
        max_bounces: 1,
        truth: (
            albedo: Constant(0.4, 0.3, 0.2),
            specular: (albedo: (0.3, 0.3, 0.3), roughness: 0.3, ndf: Ggx),
            light: Lobes(lobes: [
                (axis: (0, 1, 0), sharpness: 0.7, amplitude: (0.35, 0.45, 0.6)),
                (axis: (0.5, 0.6, 0.62), sharpness: 60, amplitude: (6, 5, 4)),
                (axis: (-0.8, 0.3, -0.3), sharpness: 30, amplitude: (2, 3, 4)),
            ]),
        ),
    ),
    light: Fixed(Lobes(lobes: [
        (axis: (0, 1, 0), sharpness: 0.7, amplitude: (0.35, 0.45, 0.6)),
        (axis: (0.5, 0.6, 0.62), sharpness: 60, amplitude: (6, 5, 4)),
        (axis: (-0.8, 0.3, -0.3), sharpness: 30, amplitude: (2, 3, 4)),
    ])),
    material: (specular: (roughness: Unknown(initial: 0.45), ndf: Ggx)),
    passes: [
        Fit(name: "fit", steps: 300, batch: 1024),
        Render(name: "novel"),
        Render(name: "traced", render: (shading: PathTraced(spp: 256, max_bounces: 1))),
        Edit(name: "dull", edits: [Roughness(action: Set(0.6))]),
        Save(name: "saved"),
        Export(name: "export"),
    ],
)
"#;

fn run(scene: &Path, out: &Path, arguments: &[&str]) -> Outcome {
    let mut command = command(&["run", "--quiet"]);
    command.arg(scene).arg("--out").arg(out).args(arguments);
    Outcome::of(&mut command).succeeded()
}

fn text(path: PathBuf) -> String {
    std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// The picture of the only test view that a pass wrote.
fn picture(pass: &Path) -> PathBuf {
    let files = std::fs::read_dir(pass).unwrap().map(|entry| entry.unwrap().path());
    let mut pictures = files.filter(|path| path.extension().is_some_and(|e| e == "exr"));
    pictures.next().unwrap()
}

fn specular(pass: &Path) -> Vec<f32> {
    read_exr_layers(picture(pass)).unwrap().channels["specular.G"].clone()
}

/// Mean absolute difference relative to the mean.
fn difference(a: &[f32], b: &[f32]) -> f32 {
    let off: f32 = a.iter().zip(b).map(|(a, b)| (a - b).abs()).sum();
    off / b.iter().sum::<f32>()
}

/// The number after `word` in a RON text.
fn number(text: &str, word: &str) -> f32 {
    let rest = &text[text.find(word).unwrap() + word.len()..];
    rest[..rest.find([',', ')']).unwrap()].trim().parse().unwrap()
}

/// Mean PSNR of the photographs after a run, in dB.
fn mean_psnr(out: &Path) -> f64 {
    let metrics: serde_json::Value = serde_json::from_str(&text(out.join("metrics.json"))).unwrap();
    let views = metrics["views"].as_array().unwrap();
    views.iter().map(|view| view["psnr"].as_f64().unwrap()).sum::<f64>() / views.len() as f64
}

#[test]
fn a_ggx_material_is_photographed_fitted_traced_and_saved() {
    let folder = tempfile::tempdir().unwrap();
    let (scene, out) = (folder.path().join("scene.ron"), folder.path().join("out"));
    std::fs::write(&scene, SCENE).unwrap();
    run(&scene, &out, &[]);
    let found = text(out.join("fit/materials.ron"));
    let (roughness, albedo) = (number(&found, "roughness:"), number(&found, "albedo: ("));
    assert!((roughness - 0.3).abs() < 0.02 && (albedo - 0.3).abs() < 0.03, "{found}");
    assert!(found.contains("ndf: Ggx"), "{found}");
    let metrics: serde_json::Value = serde_json::from_str(&text(out.join("metrics.json"))).unwrap();
    let deviation = |of: &str| metrics["determined"][of].as_f64().unwrap();
    // The light is known, and with it the material.
    assert!(metrics["determined"]["brightness"].is_null() && metrics["determined"]["lobes"].is_null());
    assert!(f64::from((roughness / 0.3).ln().abs()) < deviation("roughness") && deviation("roughness") < 0.2);
    assert!(f64::from((albedo / 0.3).ln().abs()) < deviation("specular_albedo"));
    let (closed, traced) = (specular(&out.join("novel")), specular(&out.join("traced")));
    let off = difference(&closed, &traced);
    assert!(off < 0.04, "closed form and path tracer differ by {off}");
    let dull = specular(&out.join("dull"));
    assert!(difference(&dull, &closed) > 0.1, "the edit shows");
    assert!(text(out.join("saved/scene.ron")).contains("ndf: Ggx"));
    let again = folder.path().join("again");
    run(&out.join("saved/scene.ron"), &again, &[]);
    let [a, b] = [&out, &again].map(|out| std::fs::read(picture(&out.join("novel"))).unwrap());
    assert!(a == b, "the saved object renders other bits");
    // The same photographs read as one SG: no roughness explains the tail.
    let other = folder.path().join("sg");
    run(&scene, &other, &["--set", "material.specular.ndf=Sg"]);
    let [right, wrong] = [out, other].map(|out| mean_psnr(&out));
    assert!(right > wrong + 6.0, "{right} {wrong}");
}

/// What `material.specular.ndf: Auto` comes to, and what it was chosen by.
fn chosen(scene: &str) -> (String, serde_json::Value) {
    let folder = tempfile::tempdir().unwrap();
    let (path, out) = (folder.path().join("scene.ron"), folder.path().join("out"));
    std::fs::write(&path, scene.replace("steps: 300", "steps: 800")).unwrap();
    run(&path, &out, &[]);
    let metrics: serde_json::Value = serde_json::from_str(&text(out.join("metrics.json"))).unwrap();
    (text(out.join("fit/materials.ron")), metrics["ndf_tried"].clone())
}

#[test]
fn photographs_choose_the_distribution_of_normals() {
    let auto = SCENE.replace("Unknown(initial: 0.45), ndf: Ggx", "Unknown(initial: 0.45)");
    let (found, tried) = chosen(&auto);
    assert!(found.contains("ndf: Ggx") && (number(&found, "roughness:") - 0.3).abs() < 0.02, "{found}");
    assert!(tried["ggx"].as_f64() < tried["sg"].as_f64().map(|sg| 0.975 * sg), "{tried}");
    // Photographs of the Gaussian; coarse texels under a narrow light leave something to explain.
    let (found, tried) = chosen(&auto.replace("roughness: 0.3, ndf: Ggx", "roughness: 0.12"));
    assert!(found.contains("ndf: Sg"), "{found}");
    assert!(tried["ggx"].as_f64() > tried["sg"].as_f64(), "{tried}");
}
