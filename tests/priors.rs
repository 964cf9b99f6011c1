//! Prior maps of the user's own: an albedo that a fit begins from, normals that hold a surface that moves.

use crate::common::{Data, RADIUS, SIZE, TRAIN, camera, day, scene, shoot, studio, write_image};
use glam::Vec3;
use lobelia::codec::gltf::export::write_glb;
use lobelia::mesh::primitive::sphere_mesh;
use serde_json::Value;

const FIT: &str = r#"Fit(name: "fit", steps: 60, batch: 512)"#;

/// Maps of the training photographs: their albedo at `level` of the truth, and their normals as `seen`, in the camera's axes.
fn write_maps(data: &Data, level: f32, seen: fn(Vec3) -> Vec3) {
    let mut studio = studio(&day());
    for (i, from) in TRAIN.into_iter().enumerate() {
        let camera = camera(from, SIZE);
        let frame = shoot(&mut studio, camera);
        let albedo: Vec<Vec3> = frame.albedo.iter().map(|albedo| *albedo * level).collect();
        write_image(&data.path(&format!("albedo/rgb_{i:06}.exr")), &albedo, frame.width);
        let camera_from_world = camera.world_from_camera.matrix3.transpose();
        let turn = |normal: &Vec3| {
            let normal = (camera_from_world * seen(*normal)) * Vec3::new(1.0, -1.0, -1.0);
            normal.normalize_or_zero()
        };
        let normals: Vec<Vec3> = frame.normal.iter().map(turn).collect();
        write_image(&data.path(&format!("normals/rgb_{i:06}.exr")), &normals, frame.width);
    }
}

/// The scene with these priors.
fn with_priors(scene: &str, priors: &str) -> String {
    scene.replace(r#"Dataset(path: "$DATA")"#, &format!(r#"Dataset(path: "$DATA", priors: ({priors}))"#))
}

/// What `metrics.json` says after a run.
fn metrics(data: &Data, scene: &str) -> Value {
    data.run(scene, "out", &["--quiet", "--force"]).succeeded();
    serde_json::from_str(&std::fs::read_to_string(data.path("out/metrics.json")).unwrap()).unwrap()
}

#[test]
fn a_fit_has_the_mean_color_of_the_albedo_maps_whatever_their_level() {
    let data = Data::new();
    let albedo = r#"albedo: (folder: "$DATA/albedo")"#;
    let found = [0.3, 1.0].map(|level| {
        write_maps(&data, level, |normal| normal);
        let metrics = metrics(&data, &with_priors(&scene(FIT), albedo));
        assert!(
            metrics["scale"]["rule"].as_str().unwrap().starts_with("MeanAlbedo("),
            "{}",
            metrics["scale"]
        );
        [0, 1, 2].map(|c| metrics["scale"]["mean_albedo"][c].as_f64().unwrap())
    });
    // Half the sphere is (0.6, 0.3, 0.2), half (0.2, 0.35, 0.5): the mean is (0.4, 0.325, 0.35), of 0.4 over the channels 0.447 in red.
    for mean in found {
        let (gray, expected) = (mean.iter().sum::<f64>() / 3.0, [0.4, 0.325, 0.35]);
        assert!((gray - 0.4).abs() < 0.01, "{mean:?}");
        for (mean, expected) in mean.into_iter().zip(expected) {
            assert!((mean / gray / (expected / 0.35833) - 1.0).abs() < 0.05, "{found:?}");
        }
    }
    let manifest: Value =
        serde_json::from_str(&std::fs::read_to_string(data.path("out/run.json")).unwrap()).unwrap();
    assert!(manifest.to_string().contains("rgb_000003.exr"), "maps are inputs: {manifest}");
}

#[test]
fn a_fit_that_goes_on_keeps_to_the_color_of_the_maps() {
    let data = Data::new();
    write_maps(&data, 1.0, |normal| normal);
    let both = scene(&format!("{FIT}, {}", FIT.replace("\"fit\"", "\"again\"")));
    let metrics = metrics(&data, &with_priors(&both, r#"albedo: (folder: "$DATA/albedo")"#));
    assert!(metrics["scale"]["rule"].as_str().unwrap().starts_with("MeanAlbedo("), "{}", metrics["scale"]);
}

#[test]
fn a_rule_for_the_scale_that_the_scene_says_goes_before_the_maps() {
    let data = Data::new();
    write_maps(&data, 1.0, |normal| normal);
    let scene = with_priors(&scene(FIT), r#"albedo: (folder: "$DATA/albedo")"#);
    let metrics = metrics(&data, &scene.replace("light:", "scale: WhiteLight, light:"));
    assert_eq!(metrics["scale"]["rule"], "WhiteLight");
}

#[test]
fn normals_smooth_a_mesh_whose_bumps_photographs_hardly_show() {
    let data = Data::new();
    let mut mesh = sphere_mesh(Vec3::ZERO, RADIUS).unwrap();
    let bump = |at: &Vec3| 1.0 + 0.01 * (14.0 * at.x).sin() * (14.0 * at.y).sin();
    mesh.positions.iter_mut().for_each(|at| *at *= bump(at));
    mesh.normals = mesh.smooth_normals();
    write_glb(&data.path("mesh.glb"), &mesh, None).unwrap();
    write_maps(&data, 1.0, |normal| normal);
    let passes = r#"Fit(name: "fit", steps: 150, batch: 512, vertices: true), Render(name: "novel"),
        Evaluate(name: "scores", scores: [(pass: "novel", truth: Photographs)], normal: Folder("$DATA/test/gt"))"#;
    let [free, held] = ["0", "1"].map(|weight| {
        let normals = format!(r#"normals: (folder: "$DATA/normals", weight: {weight})"#);
        metrics(&data, &with_priors(&scene(passes), &normals))["normal_deg"].as_f64().unwrap()
    });
    assert!(held < 0.8 * free, "{free} {held}");
}

#[test]
fn a_missing_folder_and_a_weight_below_zero_are_refused() {
    let data = Data::new();
    let missing = with_priors(&scene(FIT), r#"normals: (folder: "$DATA/normals")"#);
    let outcome = data.run(&missing, "out", &["--quiet"]);
    assert_eq!(outcome.code, Some(2));
    assert!(outcome.stderr.contains("normals: there is no such folder"), "{}", outcome.stderr);
    write_maps(&data, 1.0, |normal| normal);
    let wrong = with_priors(&scene(FIT), r#"normals: (folder: "$DATA/normals", axes: World, weight: -1)"#);
    let outcome = data.run(&wrong, "out", &["--quiet"]);
    assert!(outcome.stderr.contains("weight") && outcome.code == Some(2), "{}", outcome.stderr);
}
