//! Damaged and senseless data: one clear message that names the file, exit code 2, and nothing written; never a panic.

use crate::common::{Data, Outcome, files_below, save_png};
use image::{DynamicImage, GrayImage, Luma};
use lobelia::codec::exr::read_exr_layers;
use serde_json::json;

const MESH: &str = r#"Mesh(path: "$DATA/mesh.glb", texture_size: 16)"#;
const LIGHT: &str = "light: Unknown(lobes: 4),";

/// A scene that is right for [`Data`].
fn right() -> String {
    format!(
        r#"Scene(
    version: 1,
    surface: {MESH},
    views: Dataset(path: "$DATA"),
    {LIGHT}
    passes: [Fit(name: "fit", steps: 4, batch: 256), Render(name: "novel")],
)
"#
    )
}

/// The right scene with `from` replaced by `to`.
fn scene(from: &str, to: &str) -> String {
    assert_eq!(right().matches(from).count(), 1, "{from:?} must be there once");
    right().replace(from, to)
}

/// Expects that `scene` with this data is refused before anything is written, with all `words`.
#[track_caller]
fn refused_scene(data: &Data, scene: &str, words: &[&str]) {
    let outcome = data.run(scene, "out", &["--quiet"]);
    refused_outcome(&outcome, words);
    assert!(!data.path("out").exists(), "something was written: {:?}", files_below(&data.path("out")));
}

/// Expects exit code 2 and one short message.
#[track_caller]
fn refused_outcome(outcome: &Outcome, words: &[&str]) {
    let stderr = &outcome.stderr;
    assert_eq!(outcome.code, Some(2), "{stderr}{}", outcome.stdout);
    assert!(!stderr.contains("panicked") && !stderr.contains("RUST_BACKTRACE"), "{stderr}");
    for word in words {
        assert!(stderr.contains(word), "no {word:?} in\n{stderr}");
    }
    let is_report = stderr.contains("scene.ron:");
    let errors = stderr.lines().filter(|line| line.starts_with("error: ")).count();
    assert_eq!(errors, 1, "one message, not:\n{stderr}");
    let most = if is_report { 16 } else { 3 };
    assert!(stderr.lines().count() <= most, "a short message, not:\n{stderr}");
}

/// Breaks sound data and expects that the right scene is refused.
#[track_caller]
fn refused(damage: impl FnOnce(&Data), words: &[&str]) {
    let data = Data::new();
    damage(&data);
    refused_scene(&data, &right(), words);
}

/// Cuts a file to the given part of its length.
fn cut(data: &Data, file: &str, part: f64) {
    let bytes = std::fs::read(data.path(file)).unwrap();
    std::fs::write(data.path(file), &bytes[..(bytes.len() as f64 * part) as usize]).unwrap();
}

fn flat_mask(width: u32, height: u32, value: u8) -> DynamicImage {
    DynamicImage::ImageLuma8(GrayImage::from_pixel(width, height, Luma([value])))
}

/// Without this, the refusals below could have any reason.
#[test]
fn sound_data_is_taken() {
    let data = Data::new();
    let outcome = data.run(&right(), "out", &[]).succeeded();
    assert!(!outcome.stderr.contains("NaN"), "{}", outcome.stderr);
    let files = files_below(&data.path("out"));
    for file in ["metrics.json", "fit/light.npy", "novel/rgb_000000.exr", "novel/rgb_000001.png"] {
        assert!(files.iter().any(|f| f == file), "no {file} in {files:?}");
    }
}

#[test]
fn a_truncated_exr() {
    for part in [0.0, 0.02, 0.5, 0.99] {
        refused(|data| cut(data, "train/image/rgb_000001.exr", part), &["rgb_000001.exr"]);
    }
}

#[test]
fn a_truncated_mask() {
    refused(|data| cut(data, "train/mask/rgb_000003.png", 0.5), &["rgb_000003.png"]);
}

#[test]
fn a_missing_mask() {
    let damage = |data: &Data| std::fs::remove_file(data.path("train/mask/rgb_000002.png")).unwrap();
    refused(damage, &["rgb_000002", "missing"]);
    let damage = |data: &Data| std::fs::remove_dir_all(data.path("test/mask")).unwrap();
    refused(damage, &["rgb_000000", "has no mask"]);
}

#[test]
fn a_missing_image() {
    let damage = |data: &Data| std::fs::remove_file(data.path("test/image/rgb_000001.exr")).unwrap();
    refused(damage, &["rgb_000001.exr", "missing"]);
}

#[test]
fn a_mask_of_another_size() {
    refused(
        |data| save_png(&data.path("train/mask/rgb_000001.png"), &flat_mask(8, 24, 255)),
        &["rgb_000001.png", "8×24", "24×24"],
    );
}

#[test]
fn an_image_of_another_size_than_its_camera() {
    refused(
        |data| data.change_camera("train", "rgb_000004.exr", |c| c["img_size"] = json!([12, 24])),
        &["rgb_000004.exr", "24×24", "12×24", "cam_dict_norm.json"],
    );
}

#[test]
fn an_empty_mask() {
    refused(
        |data| save_png(&data.path("train/mask/rgb_000000.png"), &flat_mask(24, 24, 0)),
        &["rgb_000000.png", "empty"],
    );
}

#[test]
fn nan_and_infinite_pixels_are_repaired_counted_and_reported() {
    let data = Data::new();
    data.change_image("train/image/rgb_000001.exr", |image| {
        let red = image.channels.get_mut("R").unwrap();
        (red[300], red[301]) = (f32::NAN, f32::INFINITY);
    });
    data.change_image("test/image/rgb_000000.exr", |image| {
        image.channels.get_mut("B").unwrap()[290] = f32::NEG_INFINITY;
    });
    let outcome = data.run(&right(), "out", &[]).succeeded();
    for words in ["3 NaN or infinite pixels", "rgb_000001: 2", "rgb_000000: 1"] {
        assert!(outcome.stderr.contains(words), "no {words:?} in\n{}", outcome.stderr);
    }
    for view in ["rgb_000000", "rgb_000001"] {
        let picture = read_exr_layers(data.path(&format!("out/novel/{view}.exr"))).unwrap();
        assert!(picture.channels.values().flatten().all(|v| v.is_finite()));
        assert!(picture.channels["R"].iter().any(|v| *v > 0.05), "the object is there");
    }
}

#[test]
fn only_nan_pixels() {
    let damage = |image: &mut lobelia::codec::exr::ExrLayers| {
        image.channels.values_mut().for_each(|channel| channel.fill(f32::NAN));
    };
    refused(
        |data| data.change_image("train/image/rgb_000005.exr", damage),
        &["rgb_000005.exr", "every pixel is NaN or infinite"],
    );
}

#[test]
fn a_camera_inside_the_object() {
    let identity = json!([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0.1, 0, 0, 0, 1]);
    refused(
        |data| data.change_camera("train", "rgb_000003.exr", |c| c["W2C"] = identity),
        &["rgb_000003", "inside the object"],
    );
}

#[test]
fn a_singular_camera() {
    let flat = json!([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 3, 0, 0, 0, 1]);
    refused(
        |data| data.change_camera("train", "rgb_000002.exr", |c| c["W2C"] = flat),
        &["cam_dict_norm.json", "rgb_000002.exr", "W2C is singular"],
    );
    refused(
        |data| data.change_camera("test", "rgb_000001.exr", |c| c["K"][0] = json!(0)),
        &["cam_dict_norm.json", "rgb_000001.exr", "K "],
    );
    refused(
        |data| data.change_camera("test", "rgb_000001.exr", |c| c["W2C"] = json!([1, 2])),
        &["cam_dict_norm.json", "rgb_000001.exr", "2 numbers, not 16"],
    );
}

/// Runs with `mesh.gltf` of this text as the surface.
#[track_caller]
fn refused_mesh(gltf: &serde_json::Value, words: &[&str]) {
    let data = Data::new();
    std::fs::write(data.path("mesh.gltf"), gltf.to_string()).unwrap();
    let words = [&["mesh.gltf"], words].concat();
    refused_scene(&data, &scene("mesh.glb", "mesh.gltf"), &words);
}

#[test]
fn a_mesh_without_triangles() {
    refused_mesh(
        &json!({ "asset": { "version": "2.0" }, "scene": 0, "scenes": [{ "nodes": [0] }], "nodes": [{}] }),
        &["triangle"],
    );
}

#[test]
fn a_gltf_with_a_cycle_of_nodes() {
    refused_mesh(
        &json!({
            "asset": { "version": "2.0" },
            "scenes": [{ "nodes": [0] }],
            "nodes": [{ "children": [1] }, { "children": [2] }, { "children": [1] }],
        }),
        &["node"],
    );
    refused_mesh(
        &json!({
            "asset": { "version": "2.0" },
            "scenes": [{ "nodes": [0] }],
            "nodes": [{ "children": [1] }, { "children": [0] }],
        }),
        &["node", "cyclic"],
    );
}

#[test]
fn a_gltf_whose_buffer_is_missing() {
    refused_mesh(
        &json!({
            "asset": { "version": "2.0" },
            "scenes": [{ "nodes": [0] }],
            "nodes": [{ "mesh": 0 }],
            "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0 } }] }],
            "accessors": [{ "bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3",
                            "min": [0, 0, 0], "max": [1, 1, 0] }],
            "bufferViews": [{ "buffer": 0, "byteLength": 36 }],
            "buffers": [{ "uri": "nowhere.bin", "byteLength": 36 }],
        }),
        &["nowhere.bin"],
    );
}

#[test]
fn a_damaged_mesh() {
    for part in [0.0, 0.001, 0.5] {
        refused(|data| cut(data, "mesh.glb", part), &["mesh.glb"]);
    }
}

#[test]
fn no_lobes() {
    let data = Data::new();
    refused_scene(&data, &scene(LIGHT, "light: Unknown(lobes: 0),"), &["lobes is 0", "from 1 to 2048"]);
    refused_scene(
        &data,
        &scene(LIGHT, "light: Initial(Lobes(lobes: [])),"),
        &["lobes is 0", "from 1 to 2048"],
    );
    std::fs::write(data.path("none.npy"), npy_header("(0, 7)")).unwrap();
    let light = r#"light: Initial(Npy(path: "$DATA/none.npy")),"#;
    refused_scene(&data, &scene(LIGHT, light), &["none.npy", "lobe"]);
}

/// An `.npy` file of 32-bit floats without values.
fn npy_header(shape: &str) -> Vec<u8> {
    let mut text = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': {shape}, }}");
    while (10 + text.len() + 1) % 64 != 0 {
        text.push(' ');
    }
    text.push('\n');
    [b"\x93NUMPY\x01\x00", &(text.len() as u16).to_le_bytes()[..], text.as_bytes()].concat()
}

#[test]
fn a_damaged_light() {
    let data = Data::new();
    let light = r#"light: Initial(Npy(path: "$DATA/evening.npy")),"#;
    data.run(&scene(LIGHT, light), "sound", &["--quiet"]).succeeded();
    cut(&data, "evening.npy", 0.8);
    refused_scene(&data, &scene(LIGHT, light), &["evening.npy"]);
}

#[test]
fn roughness_zero() {
    let data = Data::new();
    let material = format!("{LIGHT} material: (specular: (roughness: Fixed(0))),");
    refused_scene(&data, &scene(LIGHT, &material), &["roughness is 0", "from 0.03 to 1"]);
    let edit = r#"Edit(name: "novel", edits: [Roughness(action: Set(0))])"#;
    refused_scene(&data, &scene(r#"Render(name: "novel")"#, edit), &["from 0.03 to 1"]);
}

/// What comes late is only found late; what is finished stays, but nothing is half written.
#[test]
fn a_light_that_is_damaged_in_a_later_pass() {
    let data = Data::new();
    cut(&data, "evening.npy", 0.8);
    let relight = r#"Relight(name: "novel", light: Npy(path: "$DATA/evening.npy"))"#;
    let outcome = data.run(&scene(r#"Render(name: "novel")"#, relight), "out", &["--quiet"]);
    refused_outcome(&outcome, &["evening.npy"]);
    let files = files_below(&data.path("out"));
    assert!(!files.iter().any(|f| f.starts_with("novel/") || crate::common::is_temporary(f)), "{files:?}");
}

#[test]
fn truths_that_do_not_fit() {
    let evaluate =
        r#"Render(name: "novel"), Evaluate(scores: [(pass: "novel", truth: Folder("$DATA/test/gt/relit"))])"#;
    let scene = scene(r#"Render(name: "novel")"#, evaluate);
    let data = Data::new();
    data.run(&scene, "sound", &["--quiet"]).succeeded();
    cut(&data, "test/gt/relit/rgb_000001.exr", 0.7);
    refused_outcome(&data.run(&scene, "out", &["--quiet"]), &["rgb_000001.exr"]);
    std::fs::remove_file(data.path("test/gt/relit/rgb_000001.exr")).unwrap();
    refused_outcome(&data.run(&scene, "out2", &["--quiet"]), &["rgb_000001.exr"]);
    crate::common::write_image(
        &data.path("test/gt/relit/rgb_000001.exr"),
        &vec![glam::Vec3::ONE; 16 * 36],
        16,
    );
    refused_outcome(&data.run(&scene, "out3", &["--quiet"]), &["rgb_000001.exr", "16×36", "24×24"]);
}

#[test]
fn images_that_cannot_be_compared() {
    let data = Data::new();
    let eval = |prediction: &str, truth: &str| {
        let mut command = crate::common::command(&["eval"]);
        Outcome::of(command.arg(data.path(prediction)).arg(data.path(truth)))
    };
    eval("test/image", "test/gt/relit").succeeded();
    refused_outcome(&eval("test/nothing", "test/image"), &["nothing"]);
    refused_outcome(&eval("test/image/rgb_000000.exr", "test/image"), &["test"]);
    cut(&data, "test/image/rgb_000001.exr", 0.5);
    refused_outcome(&eval("test/image", "test/gt/relit"), &["rgb_000001.exr"]);
}
