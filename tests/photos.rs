//! A whole run on photographs and masks alone: at any place and scale.

use crate::common::{Data, SIZE, camera, day, files_below, studio};
use glam::Vec3;
use lobelia::{codec::gltf::import::read_mesh, view::Camera};
use serde_json::{Value, json};
use std::sync::LazyLock;

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
type Found = ([f64; 2], [Vec3; 2]);

/// The usual data with wider frames, so that none cuts close to the object.
pub fn photographs() -> Data {
    let data = Data::new();
    widen(&data);
    data
}

fn widen(data: &Data) {
    // Pixels that are added on every side.
    const MARGIN: u32 = 6;
    data.photograph(&mut studio(&day()), |from| {
        let camera = camera(from, SIZE);
        let center = camera.center.map(|at| at + MARGIN as f32);
        Camera { width: SIZE + 2 * MARGIN, height: SIZE + 2 * MARGIN, center, ..camera }
    });
}

/// A run on the masks alone into `out`, and one whose shape photographs refine into `refined`.
pub static CARVED: LazyLock<(Data, Found)> = LazyLock::new(|| {
    let data = Data::shared("carved");
    widen(&data);
    let found = run(&data);
    let levels = "Shape(levels: [(cells: 32, texel_cells: 16, steps: 60, hold: 10)], batch: 1024), Fit(name";
    let scene = SCENE.replace("Fit(name", levels);
    data.run(&scene, "refined", &["--quiet", "--debug-every", "30"]).succeeded();
    (data, found)
});

fn run(data: &Data) -> Found {
    data.run(SCENE, "out", &["--quiet"]).succeeded();
    let (low, high) = read_mesh(&data.path("out/export/mesh.glb")).unwrap().bounds().unwrap();
    ([data.novel("out"), data.metrics("out")["mask_iou"].as_f64().unwrap()], [low, high])
}

/// Changes every camera as if the world were scaled, then shifted.
fn transform(data: &Data, scale: f64, shift: [f64; 3]) {
    let change = |camera: &mut Value| {
        for row in 0..3 {
            let number = |i: usize| camera["W2C"][4 * row + i].as_f64().unwrap();
            let shifted: f64 = (0..3).map(|i| number(i) * shift[i]).sum();
            camera["W2C"][4 * row + 3] = json!(scale * number(3) - shifted);
        }
    };
    for split in ["train", "test"] {
        data.change_cameras(split, |of| of.as_object_mut().unwrap().values_mut().for_each(change));
    }
}

#[test]
fn the_same_object_is_found_at_any_place_and_scale() {
    let (_, (scores, bounds)) = &*CARVED;
    for (scale, shift) in [(1000.0, [50.0, -20.0, 30.0]), (1e-3, [0.05, -0.02, 0.03])] {
        let data = photographs();
        transform(&data, scale, shift);
        let (found, corners) = run(&data);
        let [psnr, iou] = [0, 1].map(|i| (found[i] - scores[i]).abs());
        assert!(psnr < 0.5 && iou < 0.01, "{scale}: {scores:?} {found:?}");
        let shift = Vec3::from(shift.map(|x| x as f32));
        for (corner, plain) in corners.into_iter().zip(bounds) {
            let back = (corner - shift) / scale as f32;
            assert!(back.distance(*plain) < 0.01, "{scale}: {back} {plain}");
        }
    }
}

/// Photographs refine what masks carved, and every so many steps show how far they are.
#[test]
fn a_shape_pass_can_be_watched() {
    let seen = files_below(&CARVED.0.path("refined/shape/debug"));
    for kind in ["normal_000030.png", "depth_000060.png", "mesh_000060.glb"] {
        assert!(seen.iter().any(|file| file.ends_with(kind)), "no {kind} in {seen:?}");
    }
}

/// Where cameras see the middle of the object, in pixels, by name.
fn middles(cameras: &Value) -> Vec<(String, [f64; 2])> {
    let middle = |(name, camera): (&String, &Value)| {
        let [k, w] = ["K", "W2C"].map(|key| move |i: usize| camera[key][i].as_f64().unwrap());
        let stem = name.trim_end_matches(".exr").to_owned();
        (stem, [k(0) * w(3) / w(11) + k(2), k(5) * w(7) / w(11) + k(6)])
    };
    cameras.as_object().unwrap().iter().map(middle).collect()
}

#[test]
fn a_camera_that_is_off_is_moved_back_and_written_down() {
    let data = photographs();
    let truth = middles(&data.json("train/cam_dict_norm.json"));
    data.change_cameras("train", |cameras| {
        let w2c = &mut cameras["rgb_000003.exr"]["W2C"];
        w2c[3] = json!(w2c[3].as_f64().unwrap() + 0.12);
    });
    let given = middles(&data.json("train/cam_dict_norm.json"));
    let shape = "Shape(levels: [(cells: 32, texel_cells: 16, steps: 300, hold: 10)], batch: 1024, cameras: Poses, \
                 exposure: Brightness), Fit(name";
    data.run(&SCENE.replace("Fit(name", shape), "out", &["--quiet"]).succeeded();
    let found = middles(&data.json("out/shape/cam_dict_norm.json"));
    assert_eq!(found.len(), truth.len());
    let off = |views: &[(String, [f64; 2])], i: usize| {
        let view = views.iter().find(|view| view.0 == truth[i].0).unwrap();
        (view.1[0] - truth[i].1[0]).hypot(view.1[1] - truth[i].1[1])
    };
    let wrong = (0..truth.len()).find(|&i| off(&given, i) > 0.5).expect("a camera was moved by a pixel");
    // So few views leave the shape free to go part of the way instead, and all cameras to share the
    // rest.
    assert!(off(&found, wrong) < 0.75 * off(&given, wrong), "{} {}", off(&found, wrong), off(&given, wrong));
    for right in (0..truth.len()).filter(|i| *i != wrong) {
        assert!(off(&found, right) < 0.5, "view {right}: {} pixels", off(&found, right));
    }
    let exposures = data.text("out/shape/exposures.csv");
    assert_eq!(exposures.lines().count(), truth.len() + 1);
    // The cameras can be put in place of those that were given.
    std::fs::copy(data.path("out/shape/cam_dict_norm.json"), data.path("train/cam_dict_norm.json")).unwrap();
    data.check(SCENE).succeeded();
}

/// Vertices that moved, and a focal length that was found, are saved, and the object looks the same
/// again.
#[test]
fn moved_vertices_and_a_found_focal_length_are_saved() {
    let data = photographs();
    let levels = "Shape(levels: [(cells: 32, texel_cells: 16, steps: 100, hold: 10)], batch: 512, cameras: PosesAndFocal), \
                  Fit(vertices: true, name";
    let scene = SCENE.replace("Fit(name", levels).replace("Export(name: \"export\")", "Save()");
    data.run(&scene, "out", &["--quiet"]).succeeded();
    let saved = data.text("out/saved/scene.ron");
    assert!(saved.contains("focal_scale: 1.0") || saved.contains("focal_scale: 0.9"), "{saved}");
    assert!(!saved.contains("focal_scale: 1.0,"), "the focal length did not move");
    data.reopens("out");
    assert!(data.novel("out") > 15.0, "{}", data.novel("out"));
}
