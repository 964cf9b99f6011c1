//! Files that are named by files that a scene names: they are inputs like the others, and a confined scene reads none outside its folders.

use crate::common::{Data, Outcome, save_png, scene};
use crate::trust::{Meddler, check_and_run, confined, flat, run_in};
use serde_json::json;
use std::path::Path;

/// Whether each of `check` and `run` refuses what is outside, and names it by these words.
#[track_caller]
fn refused(data: &Data, scene: &Path, arguments: &[&str], words: &str) {
    for outcome in check_and_run(data, scene, arguments) {
        let said = flat(&outcome.stderr);
        assert!(outcome.code == Some(2) && said.contains(words), "no {words:?} in {said}");
        assert!(said.contains("is outside the folder of the scene file"), "{said}");
    }
}

#[track_caller]
fn accepted(data: &Data, scene: &Path, arguments: &[&str]) {
    for outcome in check_and_run(data, scene, arguments) {
        outcome.succeeded();
    }
}

/// A `.gltf` of one triangle, whose buffer and image are these.
fn write_gltf(path: &Path, buffer: &str, image: &str) {
    let document = json!({
        "asset": {"version": "2.0"},
        "buffers": [{"byteLength": 36, "uri": buffer}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "images": [{"uri": image}],
        "nodes": [{"mesh": 0}], "scenes": [{"nodes": [0]}],
    });
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    std::fs::write(path, document.to_string()).unwrap();
}

fn write_triangle(path: &Path) {
    let corners = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0f32];
    let bytes: Vec<u8> = corners.iter().flat_map(|x| x.to_le_bytes()).collect();
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    std::fs::write(path, bytes).unwrap();
}

#[test]
fn a_mesh_within_that_names_buffers_or_images_outside_is_refused() {
    let data = Data::new();
    write_triangle(&data.path("elsewhere/a.bin"));
    write_triangle(&data.path("mine/a.bin"));
    let scene = confined(&data, "mesh.gltf");
    let absolute = data.path("elsewhere/a.bin").to_str().unwrap().replace('\\', "/");
    for outside in ["../elsewhere/a.bin", "%2e%2e/elsewhere/a.bin", &absolute] {
        write_gltf(&data.path("mine/mesh.gltf"), outside, "a.bin");
        refused(&data, &scene, &[], "a.bin, which");
        accepted(&data, &scene, &["--allow-outside"]);
        write_gltf(&data.path("mine/mesh.gltf"), "a.bin", outside);
        refused(&data, &scene, &[], "a.bin, which");
    }
    write_gltf(&data.path("mine/mesh.gltf"), "a.bin", "none.png");
    accepted(&data, &scene, &[]);
}

#[test]
fn what_a_mesh_names_is_never_written_over() {
    let data = Data::new();
    write_triangle(&data.path("mine/out/novel/a.png"));
    write_gltf(&data.path("mine/mesh.gltf"), "out/novel/a.png", "none.png");
    let scene = confined(&data, "mesh.gltf");
    let mut run = crate::common::command(&["run", "--quiet", "--force"]);
    let outcome = Outcome::of(run.arg(scene).arg("--out").arg(data.path("mine/out")));
    let said = flat(&outcome.stderr);
    assert!(outcome.code == Some(2) && said.contains("pass novel would replace"), "{said}");
    assert_eq!(std::fs::read(data.path("mine/out/novel/a.png")).unwrap().len(), 36);
}

#[test]
fn what_a_true_mesh_names_is_watched() {
    let data = Data::new();
    write_triangle(&data.path("true/a.bin"));
    write_gltf(&data.path("true/mesh.gltf"), "a.bin", "none.png");
    let passes = r#"Fit(name: "fit", steps: 30, batch: 256), Render(name: "novel"),
        Evaluate(scores: [(pass: "novel", truth: Photographs)], mesh: "$DATA/true/mesh.gltf"), "#;
    let buffer = data.path("true/a.bin");
    let meddler = Meddler("fit", move || std::fs::write(&buffer, [0; 48]).unwrap());
    let error = run_in(&data, &scene(passes), false, &meddler).unwrap_err();
    assert!(error.to_string().contains("a.bin: the file has changed since the run began"), "{error}");
}

/// A scene in the folder `mine` that photographs its own object under this light.
fn photographed(data: &Data, light: &str) -> std::path::PathBuf {
    let path = data.path("mine/scene.ron");
    std::fs::create_dir_all(data.path("mine")).unwrap();
    let text = format!(
        r#"Scene(version: 1, surface: Sphere(radius: 0.8, texture_size: 16),
        views: Photographed(cameras: (count: 2, test: 1, size: 8), spp: 1, truth: (albedo: Constant(0.5, 0.5, 0.5),
            specular: (albedo: (0.2, 0.2, 0.2), roughness: 0.3), light: {light})),
        light: Unknown(lobes: 4), passes: [Fit(name: "fit", steps: 2)])"#
    );
    std::fs::write(&path, text).unwrap();
    path
}

#[test]
fn the_light_of_photographs_that_a_scene_takes_is_an_input() {
    let data = Data::new();
    std::fs::create_dir_all(data.path("mine")).unwrap();
    std::fs::write(data.path("mine/light.ron"), r#"Npy(path: "../evening.npy")"#).unwrap();
    let scene = photographed(&data, r#"Ron(path: "light.ron")"#);
    refused(&data, &scene, &[], "evening.npy, a light of the scene");
    accepted(&data, &scene, &["--allow-outside"]);
    // Nor is it written over.
    std::fs::create_dir_all(data.path("mine/out/fit")).unwrap();
    std::fs::copy(data.path("evening.npy"), data.path("mine/out/fit/light.npy")).unwrap();
    std::fs::write(data.path("mine/light.ron"), r#"Npy(path: "out/fit/light.npy")"#).unwrap();
    let mut run = crate::common::command(&["run", "--quiet", "--force"]);
    let outcome = Outcome::of(run.arg(scene).arg("--out").arg(data.path("mine/out")));
    assert!(flat(&outcome.stderr).contains("pass fit would replace"), "{}", outcome.stderr);
}

#[cfg(unix)]
#[test]
fn a_light_file_that_names_a_link_that_leads_outside_is_refused() {
    let data = Data::new();
    let scene = photographed(&data, r#"Ron(path: "light.ron")"#);
    std::os::unix::fs::symlink(data.path("evening.npy"), data.path("mine/link.npy")).unwrap();
    std::fs::write(data.path("mine/light.ron"), r#"Npy(path: "link.npy")"#).unwrap();
    refused(&data, &scene, &[], "link.npy, a light of the scene");
    accepted(&data, &scene, &["--allow-outside"]);
    std::fs::remove_file(data.path("mine/link.npy")).unwrap();
    std::fs::copy(data.path("evening.npy"), data.path("mine/evening.npy")).unwrap();
    std::os::unix::fs::symlink("evening.npy", data.path("mine/link.npy")).unwrap();
    accepted(&data, &scene, &[]);
}

/// A scene of the data set in `mine/set`, with this light.
fn of_set(data: &Data, light: &str) -> std::path::PathBuf {
    let scene = data.path("mine/scene.ron");
    let text = format!(
        r#"Scene(version: 1, surface: Sphere(radius: 0.8, texture_size: 16), views: Dataset(path: "set", hold_out: 0),
        light: {light}, passes: [Fit(name: "fit", steps: 2)])"#
    );
    std::fs::create_dir_all(data.path("mine/set")).unwrap();
    std::fs::write(&scene, text).unwrap();
    scene
}

#[test]
fn not_even_the_header_of_a_photograph_outside_is_read() {
    let data = Data::new();
    let scene = of_set(&data, "Unknown(lobes: 4)");
    let picture = image::RgbImage::from_pixel(8, 8, image::Rgb([90, 120, 60]));
    save_png(&data.path("mine/set/images/b.png"), &image::DynamicImage::ImageRgb8(picture));
    std::fs::create_dir_all(data.path("elsewhere")).unwrap();
    std::fs::write(data.path("elsewhere/a.png"), "a secret").unwrap();
    let cameras =
        "#name,x,y,alt,heading,pitch,roll,f\n../../../elsewhere/a.png,0,0,5,0,0,0,18\nb.png,0,0,5,0,0,0,18\n";
    std::fs::write(data.path("mine/set/cameras.csv"), cameras).unwrap();
    refused(&data, &scene, &[], "a.png, a photograph");
    for outcome in check_and_run(&data, &scene, &["--allow-outside"]) {
        assert!(flat(&outcome.stderr).contains("neither PNG, JPEG"), "{}", outcome.stderr);
    }
    // Nor are files looked into that only might be meant.
    std::fs::remove_file(data.path("mine/set/cameras.csv")).unwrap();
    std::fs::write(data.path("elsewhere/a.heic"), "a secret").unwrap();
    std::fs::remove_file(data.path("elsewhere/a.png")).unwrap();
    let cameras = r#"{"fl_x": 10, "fl_y": 10, "cx": 4, "cy": 4, "w": 8, "h": 8, "frames": [{"file_path": "../../elsewhere/a",
        "transform_matrix": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 3], [0, 0, 0, 1]]}]}"#;
    std::fs::write(data.path("mine/set/transforms.json"), cameras).unwrap();
    for outcome in check_and_run(&data, &scene, &[]) {
        let said = flat(&outcome.stderr);
        assert!(outcome.code == Some(2) && said.contains("is missing"), "{said}");
    }
}

#[test]
fn a_check_without_data_is_confined_as_well() {
    let data = Data::new();
    let scene = of_set(&data, r#"Fixed(Npy(path: "$DATA/evening.npy"))"#);
    let picture = image::RgbaImage::from_pixel(8, 8, image::Rgba([90, 120, 60, 255]));
    save_png(&data.path("elsewhere/a.png"), &image::DynamicImage::ImageRgba8(picture));
    let cameras = r#"{"fl_x": 10, "fl_y": 10, "cx": 4, "cy": 4, "w": 8, "h": 8, "frames": [{"file_path": "../../elsewhere/a.png",
        "transform_matrix": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 3], [0, 0, 0, 1]]}]}"#;
    std::fs::write(data.path("mine/set/transforms.json"), cameras).unwrap();
    let check = Outcome::of(crate::common::command(&["check"]).arg(&scene));
    let said = flat(&check.stderr);
    assert!(check.code == Some(2) && said.contains("a.png, a photograph, is outside"), "{said}");
}
