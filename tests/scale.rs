//! The scale between light and albedo is as the scene file says, in all outputs.

use crate::common::{Outcome, command};
use std::path::Path;

/// A reddish sphere in bluish light; both unknown.
const SCENE: &str = r#"Scene(
    version: 1,
    surface: Sphere(radius: 0.9, texture_size: 32),
    scale: SCALE,
    views: Photographed(
        cameras: (count: 16, test: 1, size: 48),
        spp: 32,
        max_bounces: 1,
        truth: (
            albedo: Constant(0.6, 0.35, 0.25),
            specular: (albedo: (0.3, 0.3, 0.3), roughness: 0.3),
            light: Lobes(lobes: [
                (axis: (0, 1, 0), sharpness: 0.7, amplitude: (0.4, 0.45, 0.6)),
                (axis: (0.5, 0.6, 0.62), sharpness: 40, amplitude: (5, 6, 8)),
                (axis: (-0.8, 0.3, -0.3), sharpness: 30, amplitude: (2.5, 3, 4)),
            ]),
        ),
    ),
    light: Unknown(lobes: 32),
    passes: [Fit(name: "fit", steps: 300, batch: 2048)],
)
"#;

/// Mean light and mean albedo that a fit ends with.
fn means(folder: &Path, scale: &str) -> [[f64; 3]; 2] {
    let scene = folder.join("scene.ron");
    std::fs::write(&scene, SCENE.replace("SCALE", scale)).unwrap();
    let out = folder.join("out");
    Outcome::of(command(&["run", "--quiet", "--force"]).arg(&scene).arg("--out").arg(&out)).succeeded();
    let text = std::fs::read_to_string(out.join("metrics.json")).unwrap();
    let json: serde_json::Value = serde_json::from_str(&text).unwrap();
    let materials = std::fs::read_to_string(out.join("fit/materials.ron")).unwrap();
    assert!(materials.contains("Scale "), "{materials}");
    ["mean_light", "mean_albedo"].map(|name| [0, 1, 2].map(|c| json["scale"][name][c].as_f64().unwrap()))
}

#[test]
fn rules_hold_what_they_say_and_highlights_find_the_color() {
    let folder = tempfile::tempdir().unwrap();
    let [light, _] = means(folder.path(), "WhiteLight");
    assert!((light[0] / light[2] - 1.0).abs() < 1e-3, "{light:?}");
    let [_, albedo] = means(folder.path(), "MeanAlbedo(0.5, 0.3, 0.2)");
    assert!((albedo[0] - 0.5).abs() < 1e-2 && (albedo[2] - 0.2).abs() < 1e-2, "{albedo:?}");
    // The truth: red over blue is 2.4 in the albedo.
    let apart = |scale: &str| {
        let [_, albedo] = means(folder.path(), scale);
        (albedo[0] / albedo[2] / 2.4).ln().abs()
    };
    let (free, highlights) = (apart("Free"), apart("Highlights()"));
    assert!(highlights < 0.75 * free, "{highlights} {free}");
}

#[test]
fn scales_that_cannot_be_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let scene = folder.path().join("scene.ron");
    for (scale, word) in
        [("MeanAlbedo(0.5, 0, 0.2)", "above 0"), ("Highlights(white_light: -1)", "0 or more")]
    {
        std::fs::write(&scene, SCENE.replace("SCALE", scale)).unwrap();
        let outcome = Outcome::of(command(&["check"]).arg(&scene));
        assert_eq!(outcome.code, Some(2), "{}", outcome.stderr);
        assert!(outcome.stderr.contains("scale") && outcome.stderr.contains(word), "{}", outcome.stderr);
    }
}
