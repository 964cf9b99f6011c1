//! A surface of two glosses: photographed, fitted, saved, opened again and exported.

use crate::common::{Outcome, command};
use lobelia::codec::exr::read_exr_layers;
use std::path::{Path, PathBuf};

/// A sphere whose one cap is rougher than the rest; the light is known, so that little decides well.
const SCENE: &str = r#"Scene(
    version: 1,
    surface: Sphere(radius: 0.9, texture_size: 48),
    views: Photographed(
        cameras: (count: 24, test: 1, size: 64),
        spp: 32,
        max_bounces: 1,
        truth: (
            albedo: Constant(0.4, 0.3, 0.2),
            specular: (albedo: (0.3, 0.3, 0.3), roughness: 0.25),
            edits: [Roughness(action: Set(0.5), region: Box(min: (-1, -1, -1), max: (1, 1, 0)))],
            light: Lobes(lobes: LIGHT),
        ),
    ),
    light: Fixed(Lobes(lobes: LIGHT)),
    material: (gloss: Blend(materials: 2)),
    passes: [
        Fit(name: "fit", steps: 400, batch: 2048),
        Render(name: "novel"),
        Save(name: "saved"),
        Export(name: "export"),
    ],
)
"#;
const LIGHT: &str = "[
    (axis: (0, 1, 0), sharpness: 0.7, amplitude: (0.35, 0.45, 0.6)),
    (axis: (0.5, 0.6, 0.62), sharpness: 60, amplitude: (6, 5, 4)),
    (axis: (-0.8, 0.3, -0.3), sharpness: 30, amplitude: (2, 3, 4)),
    (axis: (0.3, -0.5, -0.8), sharpness: 40, amplitude: (4, 4, 4)),
    (axis: (-0.5, -0.6, 0.6), sharpness: 40, amplitude: (4, 4, 4)),
]";

fn run(scene: &Path, out: &Path) -> Outcome {
    let mut command = command(&["run", "--quiet"]);
    command.arg(scene).arg("--out").arg(out);
    Outcome::of(&mut command).succeeded()
}

fn only_picture(pass: &Path) -> PathBuf {
    let files = std::fs::read_dir(pass).unwrap().map(|entry| entry.unwrap().path());
    files.into_iter().find(|path| path.extension().is_some_and(|e| e == "exr")).unwrap()
}

/// The roughnesses in `materials.ron`.
fn roughnesses(fit: &Path) -> Vec<f32> {
    let text = std::fs::read_to_string(fit.join("materials.ron")).unwrap();
    let values =
        text.split("roughness: ").skip(1).map(|rest| rest.split(',').next().unwrap().parse().unwrap());
    values.collect()
}

#[test]
fn two_glosses_are_told_apart_and_kept() {
    let folder = tempfile::tempdir().unwrap();
    let scene = folder.path().join("scene.ron");
    std::fs::write(&scene, SCENE.replace("LIGHT", LIGHT)).unwrap();
    let out = folder.path().join("out");
    run(&scene, &out);
    let found = roughnesses(&out.join("fit"));
    assert!((found[0] - 0.25).abs() < 0.03 && (found[1] - 0.5).abs() < 0.06, "{found:?}");
    // The back is rough, the front is not. Row y of the texture is at polar angle π(y + ½)/48, column x at azimuth 2π(x + ½)/48 − π/2.
    let weights = read_exr_layers(out.join("fit/blend.exr")).unwrap();
    let rough = &weights.channels["weight1"];
    let right = (0..48 * 48).filter(|i| {
        let phi = std::f32::consts::PI * ((i / 48) as f32 + 0.5) / 48.0;
        let azimuth = std::f32::consts::TAU * ((i % 48) as f32 + 0.5) / 48.0 - std::f32::consts::FRAC_PI_2;
        let z = azimuth.sin() * phi.sin();
        (rough[*i] > 0.5) == (z < 0.0)
    });
    let right = right.count();
    assert!(right > 48 * 48 * 9 / 10, "{right} of {} texels", 48 * 48);
    // The saved object renders the same bits.
    let again = folder.path().join("again");
    run(&out.join("saved/scene.ron"), &again);
    let [a, b] = [&out, &again].map(|out| std::fs::read(only_picture(&out.join("novel"))).unwrap());
    assert!(a == b, "the saved object looks different");
    // Scenes that were saved before a fit could choose the distribution say `Sg` beside the materials.
    let saved = out.join("saved/scene.ron");
    let text = std::fs::read_to_string(&saved).unwrap();
    let check = |ndf: &str| {
        let older = text.replace("ndf: Auto", ndf);
        assert!(older != text, "{text}");
        std::fs::write(out.join("saved/older.ron"), older).unwrap();
        Outcome::of(command(&["check"]).arg(out.join("saved/older.ron")))
    };
    check("ndf: Sg").succeeded();
    let refused = check("ndf: Ggx");
    assert!(refused.stderr.contains("says all about the specular material"), "{}", refused.stderr);
    // The export carries the roughness as a texture.
    let glb = std::fs::read(out.join("export/mesh.glb")).unwrap();
    assert!(String::from_utf8_lossy(&glb).contains("metallicRoughnessTexture"));
}

#[test]
fn each_texel_finds_its_roughness_and_keeps_it() {
    let folder = tempfile::tempdir().unwrap();
    let scene = folder.path().join("scene.ron");
    let text = SCENE.replace("LIGHT", LIGHT).replace("Blend(materials: 2)", "Texels(specular: true)");
    std::fs::write(&scene, text).unwrap();
    let out = folder.path().join("out");
    run(&scene, &out);
    let found = &read_exr_layers(out.join("fit/roughness.exr")).unwrap().channels["Y"];
    // The middle rows of the front (+Z) and of the back.
    let mean = |columns: std::ops::Range<usize>| {
        let texels = (20..28).flat_map(|y| columns.clone().map(move |x| found[y * 48 + x]));
        texels.sum::<f32>() / (8 * columns.len()) as f32
    };
    let (front, back) = (mean(16..32), (mean(0..8) + mean(40..48)) / 2.0);
    assert!((front - 0.25).abs() < 0.05 && (back - 0.5).abs() < 0.1, "{front} {back}");
    let again = folder.path().join("again");
    run(&out.join("saved/scene.ron"), &again);
    let [a, b] = [&out, &again].map(|out| std::fs::read(only_picture(&out.join("novel"))).unwrap());
    assert!(a == b, "the saved object looks different");
}

#[test]
fn blends_that_cannot_be_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let scene = folder.path().join("scene.ron");
    for (gloss, words) in [
        ("Blend(materials: 9)", ["materials is 9", "2 to 4"]),
        ("Texels(color_width: 0)", ["color_width", "0"]),
        ("Texels(smoothness: -1)", ["smoothness", "-1"]),
        ("Fixed(lobes: [], weights: \"none.exr\")", ["none.exr", "lobes"]),
    ] {
        let text = SCENE.replace("LIGHT", LIGHT).replace("Blend(materials: 2)", gloss);
        std::fs::write(&scene, text).unwrap();
        let outcome = Outcome::of(command(&["check"]).arg(&scene));
        assert_eq!(outcome.code, Some(2), "{}", outcome.stderr);
        words
            .into_iter()
            .for_each(|word| assert!(outcome.stderr.contains(word), "{word}: {}", outcome.stderr));
    }
}
