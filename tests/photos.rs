//! A whole run on photographs and masks alone: at any place and scale, in every layout, and what it refuses.

use crate::common::{Data, SIZE, command, files_below, save_png, write_image};
use glam::Vec3;
use image::{DynamicImage, GrayImage, Luma};
use lobelia::codec::exr::read_exr_layers;
use lobelia::codec::gltf::import::read_mesh_with_report;
use serde_json::{Value, json};
use std::path::Path;

const SCENE: &str = r#"Scene(
    version: 1,
    surface: Unknown(cells: 32, texture_size: 256),
    views: Dataset(path: "$DATA"),
    light: Unknown(lobes: 12),
    passes: [
        Fit(name: "fit", steps: 100, batch: 512),
        Render(name: "novel"),
        Evaluate(name: "scores", scores: [(pass: "novel", truth: Photographs)]),
        Export(name: "export"),
    ],
)
"#;

/// A run's novel PSNR and mask IoU, and the bounds of its exported mesh.
struct Found {
    psnr: f64,
    iou: f64,
    low: Vec3,
    high: Vec3,
}

/// Black pixels added on every side of the photographs, so that no frame cuts close to the object.
const MARGIN: u32 = 6;
const WIDE: u32 = SIZE + 2 * MARGIN;

/// The usual data with wider frames.
pub fn photographs() -> Data {
    let data = Data::new();
    for split in ["train", "test"] {
        let path = data.path(split).join("cam_dict_norm.json");
        let mut cameras: Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
        for (name, camera) in cameras.as_object_mut().unwrap() {
            for i in [2, 6] {
                camera["K"][i] = json!(camera["K"][i].as_f64().unwrap() + f64::from(MARGIN));
            }
            camera["img_size"] = json!([WIDE, WIDE]);
            widen(&data.path(split), name);
        }
        std::fs::write(path, cameras.to_string()).unwrap();
    }
    data
}

/// Widens a photograph and its mask.
fn widen(folder: &Path, name: &str) {
    let image = folder.join("image").join(name);
    let layers = read_exr_layers(&image).unwrap();
    let mask_path = folder.join("mask").join(name.replace("exr", "png"));
    let mask = image::open(&mask_path).unwrap().to_luma8();
    let inner = |x: u32, y: u32| {
        let (x, y) = (x.checked_sub(MARGIN)?, y.checked_sub(MARGIN)?);
        (x < SIZE && y < SIZE).then_some((x, y))
    };
    let color = |i: u32| {
        let at = inner(i % WIDE, i / WIDE).map(|(x, y)| (y * SIZE + x) as usize);
        at.map_or(Vec3::ZERO, |at| Vec3::from(["R", "G", "B"].map(|name| layers.channels[name][at])))
    };
    write_image(&image, &(0..WIDE * WIDE).map(color).collect::<Vec<_>>(), WIDE as usize);
    let wide =
        GrayImage::from_fn(WIDE, WIDE, |x, y| inner(x, y).map_or(Luma([0]), |(x, y)| *mask.get_pixel(x, y)));
    save_png(&mask_path, &DynamicImage::ImageLuma8(wide));
}

fn run(data: &Data) -> Found {
    run_scene(data, SCENE, &["--quiet"])
}

fn run_scene(data: &Data, scene: &str, arguments: &[&str]) -> Found {
    data.run(scene, "out", arguments).succeeded();
    let text = std::fs::read_to_string(data.path("out/metrics.json")).unwrap();
    let metrics: Value = serde_json::from_str(&text).unwrap();
    let (low, high) = read_mesh_with_report(&data.path("out/export/mesh.glb")).unwrap().0.bounds().unwrap();
    let number = |value: &Value| value.as_f64().unwrap();
    Found { psnr: number(&metrics["passes"]["novel"]["psnr"]), iou: number(&metrics["mask_iou"]), low, high }
}

/// Changes every camera as if the world were scaled, then shifted.
fn transform(data: &Data, scale: f64, shift: [f64; 3]) {
    for split in ["train", "test"] {
        let path = data.path(split).join("cam_dict_norm.json");
        let mut cameras: Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
        for camera in cameras.as_object_mut().unwrap().values_mut() {
            let w2c = camera["W2C"].as_array_mut().unwrap();
            for row in 0..3 {
                let number = |i: usize| w2c[4 * row + i].as_f64().unwrap();
                let shifted: f64 = (0..3).map(|i| number(i) * shift[i]).sum();
                w2c[4 * row + 3] = json!(scale * number(3) - shifted);
            }
        }
        std::fs::write(path, cameras.to_string()).unwrap();
    }
}

#[test]
fn the_same_object_is_found_at_any_place_and_scale() {
    let plain = run(&photographs());
    assert!(plain.iou > 0.9 && plain.psnr > 20.0, "{} {}", plain.iou, plain.psnr);
    for (scale, shift) in
        [(1.0, [50.0, -20.0, 30.0]), (1000.0, [50.0, -20.0, 30.0]), (1e-3, [0.05, -0.02, 0.03])]
    {
        let data = photographs();
        transform(&data, scale, shift);
        let found = run(&data);
        let scores = format!("{scale}: {} {}, {} {}", plain.psnr, plain.iou, found.psnr, found.iou);
        assert!((found.psnr - plain.psnr).abs() < 0.5 && (found.iou - plain.iou).abs() < 0.01, "{scores}");
        let shift = Vec3::from(shift.map(|x| x as f32));
        let back = [found.low, found.high].map(|corner| (corner - shift) / scale as f32);
        for (a, b) in [(back[0], plain.low), (back[1], plain.high)] {
            assert!(a.distance(b) < 0.01, "{scale}: {a} {b}");
        }
    }
}

/// Photographs refine what masks carved, and every so many steps show how far they are.
#[test]
fn a_shape_pass_refines_the_hull_and_can_be_watched() {
    let data = photographs();
    let hull = run(&data);
    let levels = "Shape(levels: [(cells: 32, texel_cells: 16, steps: 60, hold: 10)], batch: 1024), Fit(name";
    let scene = SCENE.replace("Fit(name", levels);
    let found = run_scene(&data, &scene, &["--quiet", "--force", "--debug-every", "30"]);
    assert!(
        // A fit after a short shape goes on from its light; one of the hull begins anew.
        found.psnr > hull.psnr - 1.5 && found.iou > 0.9,
        "{} {}, {} {}",
        hull.psnr,
        hull.iou,
        found.psnr,
        found.iou
    );
    let seen = files_below(&data.path("out/shape/debug"));
    for kind in ["normal_000030.png", "depth_000060.png", "mesh_000060.glb"] {
        assert!(seen.iter().any(|file| file.ends_with(kind)), "no {kind} in {seen:?}");
    }
}

/// Where cameras see the middle of the object, in pixels, by name.
fn middles(cameras: &Path) -> Vec<(String, [f64; 2])> {
    let cameras: Value = serde_json::from_slice(&std::fs::read(cameras).unwrap()).unwrap();
    let middle = |(name, camera): (&String, &Value)| {
        let (k, w) =
            (|i: usize| camera["K"][i].as_f64().unwrap(), |i: usize| camera["W2C"][i].as_f64().unwrap());
        let stem = name.trim_end_matches(".exr").to_owned();
        (stem, [k(0) * w(3) / w(11) + k(2), k(5) * w(7) / w(11) + k(6)])
    };
    cameras.as_object().unwrap().iter().map(middle).collect()
}

#[test]
fn a_camera_that_is_off_is_moved_back_and_written_down() {
    let data = photographs();
    let truth = middles(&data.path("train/cam_dict_norm.json"));
    data.change_camera("train", "rgb_000003.exr", |camera| {
        camera["W2C"][3] = json!(camera["W2C"][3].as_f64().unwrap() + 0.12);
    });
    let given = middles(&data.path("train/cam_dict_norm.json"));
    let shape = "Shape(levels: [(cells: 32, texel_cells: 16, steps: 300, hold: 10)], batch: 1024, cameras: Poses, \
                 exposure: Brightness), Fit(name";
    run_scene(&data, &SCENE.replace("Fit(name", shape), &["--quiet"]);
    let found = middles(&data.path("out/shape/cam_dict_norm.json"));
    assert_eq!(found.len(), truth.len());
    let off = |views: &[(String, [f64; 2])], i: usize| {
        let view = views.iter().find(|view| view.0 == truth[i].0).unwrap();
        (view.1[0] - truth[i].1[0]).hypot(view.1[1] - truth[i].1[1])
    };
    let wrong = (0..truth.len()).find(|&i| off(&given, i) > 0.5).expect("a camera was moved by a pixel");
    // So few views leave the shape free to go part of the way instead, and all cameras to share the rest.
    assert!(off(&found, wrong) < 0.75 * off(&given, wrong), "{} {}", off(&found, wrong), off(&given, wrong));
    for right in (0..truth.len()).filter(|i| *i != wrong) {
        assert!(off(&found, right) < 0.5, "view {right}: {} pixels", off(&found, right));
    }
    let exposures = std::fs::read_to_string(data.path("out/shape/exposures.csv")).unwrap();
    assert_eq!(exposures.lines().count(), truth.len() + 1);
    // The cameras can be put in place of those that were given.
    std::fs::copy(data.path("out/shape/cam_dict_norm.json"), data.path("train/cam_dict_norm.json")).unwrap();
    run_scene(&data, SCENE, &["--quiet", "--force"]);
}

/// Vertices that moved, and a focal length that was found, are saved, and the object looks the same again.
#[test]
fn moved_vertices_and_a_found_focal_length_are_saved() {
    let data = photographs();
    let levels = "Shape(levels: [(cells: 32, texel_cells: 16, steps: 100, hold: 10)], batch: 1024, cameras: PosesAndFocal), \
                  Fit(vertices: true, name";
    let scene =
        SCENE.replace("Fit(name", levels).replace("Export(name: \"export\")", "Save(name: \"saved\")");
    let with_vertices = run_scene_without_export(&data, &scene);
    let mesh = |folder: &str| std::fs::read(data.path(folder).join("mesh.glb")).unwrap();
    let moved = mesh("out/saved");
    let saved = std::fs::read_to_string(data.path("out/saved/scene.ron")).unwrap();
    assert!(saved.contains("focal_scale: 1.0") || saved.contains("focal_scale: 0.9"), "{saved}");
    assert!(!saved.contains("focal_scale: 1.0,"), "the focal length did not move");
    let again = command(&["run", "--quiet"])
        .arg(data.path("out/saved/scene.ron"))
        .arg("--data")
        .arg(data.root())
        .arg("--out")
        .arg(data.path("again"))
        .output()
        .unwrap();
    assert!(again.status.success(), "{}", String::from_utf8_lossy(&again.stderr));
    for picture in ["novel/rgb_000000.exr", "novel/rgb_000001.exr"] {
        let bytes = |folder: &str| std::fs::read(data.path(folder).join(picture)).unwrap();
        assert!(bytes("out") == bytes("again"), "{picture} differs");
    }
    run_scene_without_export(&data, &scene.replace("vertices: true, ", ""));
    assert!(moved != mesh("out/saved"), "no vertex moved");
    assert!(with_vertices > 15.0, "{with_vertices}");
}

/// The novel PSNR of a run.
fn run_scene_without_export(data: &Data, scene: &str) -> f64 {
    data.run(scene, "out", &["--quiet", "--force"]).succeeded();
    let text = std::fs::read_to_string(data.path("out/metrics.json")).unwrap();
    serde_json::from_str::<Value>(&text).unwrap()["passes"]["novel"]["psnr"].as_f64().unwrap()
}

/// Writes the data set's training views as a COLMAP model, and runs that.
#[test]
fn a_colmap_folder_gives_the_same_object() {
    let data = photographs();
    let plain = run(&data);
    let cameras: Value =
        serde_json::from_slice(&std::fs::read(data.path("train/cam_dict_norm.json")).unwrap()).unwrap();
    let colmap = photographs();
    for split in ["train", "test"] {
        std::fs::remove_dir_all(colmap.path(split)).unwrap();
    }
    for folder in ["sparse/0", "images", "masks"] {
        std::fs::create_dir_all(colmap.path(folder)).unwrap();
    }
    let mut lines = String::new();
    for (i, (name, camera)) in cameras.as_object().unwrap().iter().enumerate() {
        let w = |row: usize, column: usize| camera["W2C"][4 * row + column].as_f64().unwrap() as f32;
        let axis = |column: usize| Vec3::new(w(0, column), w(1, column), w(2, column));
        let q = glam::Quat::from_mat3(&glam::Mat3::from_cols(axis(0), axis(1), axis(2)));
        let t = axis(3);
        lines += &format!("{i} {} {} {} {} {} {} {} 1 {name}\n\n", q.w, q.x, q.y, q.z, t.x, t.y, t.z);
        std::fs::copy(data.path("train/image").join(name), colmap.path("images").join(name)).unwrap();
        let mask = name.replace("exr", "png");
        std::fs::copy(data.path("train/mask").join(&mask), colmap.path("masks").join(mask)).unwrap();
    }
    std::fs::write(colmap.path("sparse/0/images.txt"), lines).unwrap();
    let k = &cameras.as_object().unwrap().values().next().unwrap()["K"];
    let camera = format!("1 PINHOLE {WIDE} {WIDE} {} {} {} {}", k[0], k[5], k[2], k[6]);
    std::fs::write(colmap.path("sparse/0/cameras.txt"), camera).unwrap();
    let found = run(&colmap);
    // Other views are held out, and fewer are left to carve with.
    assert!(found.iou > 0.85, "{}", found.iou);
    assert!(found.low.distance(plain.low) < 0.25 && found.high.distance(plain.high) < 0.25);
}

/// Expects exit code 2, one message with `words`, and nothing written.
#[track_caller]
fn refused(damage: impl FnOnce(&Data), words: &[&str]) {
    let data = photographs();
    damage(&data);
    let outcome = data.run(SCENE, "out", &["--quiet"]);
    assert_eq!(outcome.code, Some(2), "{}", outcome.stderr);
    for word in words {
        assert!(outcome.stderr.contains(word), "no {word:?} in\n{}", outcome.stderr);
    }
    assert!(!data.path("out").exists(), "something was written: {:?}", files_below(&data.path("out")));
}

#[test]
fn views_that_give_no_shape_are_refused_early() {
    let flat = |value: u8| DynamicImage::ImageLuma8(GrayImage::from_pixel(WIDE, WIDE, Luma([value])));
    let mask = "train/mask/rgb_000001.png";
    refused(|data| save_png(&data.path(mask), &flat(255)), &["rgb_000001", "all white", "select"]);
    refused(|data| save_png(&data.path(mask), &flat(0)), &["rgb_000001", "empty", "select"]);
    let inside = |data: &Data| {
        data.change_camera("train", "rgb_000001.exr", |camera| {
            for row in 0..3 {
                camera["W2C"][4 * row + 3] = json!(0.05);
            }
        });
    };
    refused(inside, &["rgb_000001", "inside the object"]);
}
