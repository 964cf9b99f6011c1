//! An object that is turned over between two rounds of photographs: how it lies is found, or said, and kept. Rounds under another light have one of
//! their own.

use crate::common::{Data, Outcome, command, scene};
use glam::{EulerRot, Quat, Vec3};
use lobelia::codec::exr::read_exr_layers;
use lobelia::codec::npy::{NpyConvention, read_lobes};
use lobelia::light::lobes_radiance;
use serde_json::Value;
use std::path::Path;

/// A ball of two colors under one lamp at the side and a sky, in two placements.
const TURNED_OVER: &str = r#"Scene(
    version: 1,
    surface: Sphere(radius: 0.8, texture_size: 48),
    views: Photographed(
        cameras: (count: 24, test: 4, size: 48),
        spp: 32,
        max_bounces: 1,
        truth: (
            albedo: Waves(colors: ((0.7, 0.3, 0.2), (0.2, 0.35, 0.6)), size: 0.9),
            specular: (albedo: (0.1, 0.1, 0.1), roughness: 0.4),
            placements: [(100, 20, 0)],
            light: Lobes(lobes: [
                (axis: (0, 1, 0), sharpness: 0.7, amplitude: (0.4, 0.45, 0.5)),
                (axis: (0.8, 0.5, 0.4), sharpness: 20, amplitude: (4, 4, 3)),
            ]),
        ),
    ),
    light: Unknown(lobes: 32),
    passes: [
        Fit(name: "fit", steps: 300, batch: 2048),
        Render(name: "novel"),
        Evaluate(name: "scores", scores: [(pass: "novel", truth: Photographs)]),
    ],
)
"#;

/// A ball under a lamp at the right in one round and a blue one at the left in another.
const OTHER_LIGHT: &str = r#"
            other_lights: [Lobes(lobes: [
                (axis: (0, 1, 0), sharpness: 0.7, amplitude: (0.3, 0.3, 0.3)),
                (axis: (-0.8, 0.2, 0.4), sharpness: 20, amplitude: (2, 3, 5)),
            ])],"#;

fn metrics(folder: &Path) -> Value {
    serde_json::from_str(&std::fs::read_to_string(folder.join("metrics.json")).unwrap()).unwrap()
}

fn turn(degrees: [f64; 3]) -> Quat {
    let [x, y, z] = degrees.map(|angle| (angle as f32).to_radians());
    Quat::from_euler(EulerRot::XYZEx, x, y, z)
}

#[test]
fn an_object_that_was_turned_over_is_found_to_be() {
    let folder = tempfile::tempdir().unwrap();
    let (scene, out) = (folder.path().join("scene.ron"), folder.path().join("out"));
    std::fs::write(&scene, TURNED_OVER).unwrap();
    let run = Outcome::of(command(&["run"]).arg(&scene).arg("--out").arg(&out)).succeeded();
    assert!(run.stdout.contains("`round 2` shows the object turned by"), "{}", run.stdout);
    let metrics = metrics(&out);
    let found = &metrics["placements"][0]["turned_degrees"];
    let found = turn([0, 1, 2].map(|k| found[k].as_f64().unwrap()));
    let apart = found.angle_between(turn([100.0, 20.0, 0.0])).to_degrees();
    assert!(apart < 2.0, "{apart}°");
    let psnr = metrics["passes"]["novel"]["psnr"].as_f64().unwrap();
    assert!(psnr > 30.0, "{psnr}");
}

/// The scene of a data set whose first photograph of each split is of one placement, and the others of another.
fn with_placements(turned: &str) -> String {
    let placements = format!(
        r#"placements: [(photographs: "rgb_000000"), (photographs: "rgb_", turned_degrees: {turned})]"#
    );
    scene(r#"Fit(name: "fit", steps: 60, batch: 512), Render(name: "novel"), Save(name: "saved")"#)
        .replace(r#"Dataset(path: "$DATA")"#, &format!(r#"Dataset(path: "$DATA", {placements})"#))
}

/// The colors of the test views.
fn pictures(folder: &Path) -> [Vec<Vec3>; 2] {
    ["rgb_000000.exr", "rgb_000001.exr"].map(|name| {
        let layers = read_exr_layers(folder.join(name)).unwrap();
        let [r, g, b] = ["R", "G", "B"].map(|name| &layers.channels[name]);
        (0..r.len()).map(|i| Vec3::new(r[i], g[i], b[i])).collect()
    })
}

#[test]
fn a_saved_scene_shows_each_placement_as_it_was_found() {
    let data = Data::new();
    for turned in ["None", "(0, 40, 0)"] {
        data.run(&with_placements(turned), "out", &["--quiet", "--force"]).succeeded();
        let saved = std::fs::read_to_string(data.path("out/saved/scene.ron")).unwrap();
        assert_eq!(
            saved.matches("turned_degrees: (").count() + saved.matches("turned_degrees: Some(").count(),
            1,
            "{saved}"
        );
        let again = data.path("again");
        let saved = data.path("out/saved/scene.ron");
        let mut run = command(&["run", "--quiet", "--force"]);
        run.arg(saved).arg("--data").arg(data.root()).arg("--out").arg(&again);
        Outcome::of(&mut run).succeeded();
        let [first, second] = [data.path("out/novel"), again.join("novel")].map(|of| pictures(&of));
        let apart = |view: usize| {
            let pixels = first[view].iter().zip(&second[view]);
            pixels.map(|(a, b)| a.distance(*b)).fold(0.0, f32::max)
        };
        // Angles that are written in degrees are rounded.
        assert!(apart(0) == 0.0 && apart(1) < 2e-3, "{} {}", apart(0), apart(1));
    }
}

#[test]
fn what_is_said_of_a_placement_holds() {
    let data = Data::new();
    let psnr = |turned: &str| {
        let scored = r#"Evaluate(name: "scores", scores: [(pass: "novel", truth: Photographs)])"#;
        let scene = with_placements(turned).replace(r#"Save(name: "saved")"#, scored);
        data.run(&scene, "out", &["--quiet", "--force"]).succeeded();
        let metrics = metrics(&data.path("out"));
        assert!(metrics["placements"].is_null(), "{metrics}");
        metrics["passes"]["novel"]["psnr"].as_f64().unwrap()
    };
    // The photographs are of one placement.
    let [right, wrong] = ["(0, 0, 0)", "(0, 90, 0)"].map(psnr);
    assert!(right > wrong + 0.7, "{right} {wrong}");
}

#[test]
fn photographs_of_no_placement_are_refused_by_name() {
    let data = Data::new();
    let scene = with_placements("None").replace(r#"photographs: "rgb_","#, r#"photographs: "over_","#);
    let outcome = data.run(&scene, "out", &["--quiet"]);
    assert_eq!(outcome.code, Some(2), "{}", outcome.stderr);
    for words in ["`rgb_000001`", "none of the `placements`", "cam_dict_norm.json"] {
        assert!(outcome.stderr.contains(words), "{words}: {}", outcome.stderr);
    }
    assert!(!data.path("out").exists());
}

#[test]
fn a_placement_without_photographs_is_refused_by_name() {
    let data = Data::new();
    // All names begin with the first entry.
    let scene = with_placements("None").replace("\"rgb_000000\"", "\"rgb\"");
    let outcome = data.run(&scene, "out", &["--quiet"]);
    assert_eq!(outcome.code, Some(2), "{}", outcome.stderr);
    assert!(
        outcome.stderr.contains("no training photograph shows the placement `rgb_`"),
        "{}",
        outcome.stderr
    );
}

#[test]
fn the_first_placement_is_not_turned() {
    let data = Data::new();
    let scene =
        with_placements("None").replace(r#""rgb_000000")"#, r#""rgb_000000", turned_degrees: (1, 0, 0))"#);
    let outcome = data.run(&scene, "out", &["--quiet"]);
    assert_eq!(outcome.code, Some(2), "{}", outcome.stderr);
    assert!(outcome.stderr.contains("turned_degrees is [1, 0, 0]"), "{}", outcome.stderr);
    assert!(outcome.stderr.contains("relative to the first placement"), "{}", outcome.stderr);
}

/// The radiance of a recovered light toward both lamps.
fn toward_lamps(folder: &Path, file: &str) -> [Vec3; 2] {
    let lobes = read_lobes(folder.join("fit").join(file), NpyConvention::Lobelia).unwrap();
    [Vec3::new(0.8, 0.5, 0.4), Vec3::new(-0.8, 0.2, 0.4)].map(|axis| lobes_radiance(&lobes, axis.normalize()))
}

#[test]
fn photographs_of_two_rooms_have_two_lights_and_one_albedo() {
    let folder = tempfile::tempdir().unwrap();
    let (scene, out) = (folder.path().join("scene.ron"), folder.path().join("out"));
    let truth = TURNED_OVER.replace("placements: [(100, 20, 0)],", OTHER_LIGHT);
    let truth = truth.replace("truth: Photographs)]", "truth: Photographs)], albedo: SelfMade");
    std::fs::write(&scene, truth).unwrap();
    Outcome::of(command(&["run"]).arg(&scene).arg("--out").arg(&out)).succeeded();
    let [own, other] = ["light.npy", "light_2.npy"].map(|file| toward_lamps(&out, file));
    assert!(own[0].x > 2.5 && own[1].x < 1.0, "{own:?}");
    assert!(other[1].z > 2.5 && other[0].x < 1.0 && other[1].z > 1.3 * other[1].x, "{other:?}");
    assert!(out.join("fit/environment_2.png").is_file());
    let metrics = metrics(&out);
    // Views of both rounds are held out.
    let psnr = metrics["passes"]["novel"]["psnr"].as_f64().unwrap();
    let albedo = metrics["albedo_psnr"].as_f64().unwrap();
    assert!(psnr > 33.0 && albedo > 28.0, "{psnr} {albedo}");
    let report = std::fs::read_to_string(out.join("report.html")).unwrap();
    assert!(report.contains("recovered light 2"));
}

#[test]
fn a_saved_scene_has_the_light_of_each_room() {
    let data = Data::new();
    let scene = with_placements("None").replace("turned_degrees: None", "light: Own");
    data.run(&scene, "out", &["--quiet"]).succeeded();
    let saved = std::fs::read_to_string(data.path("out/saved/scene.ron")).unwrap();
    assert!(saved.contains("light_2.npy"), "{saved}");
    let again = data.path("again");
    let mut run = command(&["run", "--quiet"]);
    run.arg(data.path("out/saved/scene.ron")).arg("--data").arg(data.root()).arg("--out").arg(&again);
    Outcome::of(&mut run).succeeded();
    let [first, second] = [data.path("out/novel"), again.join("novel")].map(|of| pictures(&of));
    assert_eq!(first, second);
}

#[test]
fn lights_of_rooms_are_all_known_or_all_unknown() {
    let data = Data::new();
    let own = with_placements("None").replace("turned_degrees: None", "light: Own");
    let lobes = "Fixed(Lobes(lobes: [(axis: (0, 1, 0), sharpness: 1, amplitude: (1, 1, 1))]))";
    let refused = |scene: &str, words: &str| {
        let outcome = data.run(scene, "out", &["--quiet"]);
        assert_eq!(outcome.code, Some(2), "{}", outcome.stderr);
        assert!(outcome.stderr.contains(words), "{words}: {}", outcome.stderr);
        assert!(!data.path("out").exists());
    };
    refused(
        &own.replace("light: Own", &format!("light: {lobes}")),
        "Own, as the scene's `light` is not known",
    );
    refused(
        &own.replace(r#"photographs: "rgb_000000""#, r#"photographs: "rgb_000000", light: Own"#),
        "the first placement is in the scene's `light`",
    );
    let initial =
        own.replace("light: Unknown(lobes: 6)", &format!("light: {}", lobes.replace("Fixed", "Initial")));
    refused(&initial, "Unknown(…) and not Initial(…)");
    let made = TURNED_OVER.replace("placements: [(100, 20, 0)],", OTHER_LIGHT);
    refused(
        &made.replace("light: Unknown(lobes: 32)", &format!("light: {lobes}")),
        "as there are `other_lights`",
    );
    let known = own.replace("light: Unknown(lobes: 6)", &format!("light: {lobes}"));
    refused(&known, "Fixed(…), as the scene's `light` is known");
}
