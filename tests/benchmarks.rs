//! Public benchmarks of relighting, on look-alikes: TensoIR-Synthetic's layout and truths, and Stanford-ORB's by the example that prepares it.

use crate::common::{
    Data, Outcome, SIZE, TEST, TRAIN, camera, command, day, evening, save_png, shoot, studio, write_image,
    write_mask,
};
use glam::{Affine3A, Vec3};
use lobelia::codec::exr_frame::Frame;
use lobelia::light::LightLobe;
use lobelia::report::tone::srgb8;
use serde_json::{Value, json};
use std::f32::consts::{PI, TAU};
use std::path::Path;

#[path = "../examples/stanford_orb.rs"]
mod stanford_orb;

/// The usual field of view, in radians.
fn angle() -> f32 {
    2.0 * (SIZE as f32 / 2.0 / camera(TEST[0], SIZE).focal[0]).atan()
}

/// The pose of a camera with OpenGL axes.
fn opengl_pose(camera: &lobelia::view::Camera) -> Affine3A {
    let mut pose = camera.world_from_camera;
    (pose.matrix3.y_axis, pose.matrix3.z_axis) = (-pose.matrix3.y_axis, -pose.matrix3.z_axis);
    pose
}

/// Rows of a pose as a 4×4 matrix.
fn rows(pose: &Affine3A) -> [[f32; 4]; 4] {
    glam::Mat4::from(*pose).transpose().to_cols_array_2d()
}

fn metrics(out: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(out.join("metrics.json")).unwrap()).unwrap()
}

/// Writes an RGBA PNG of bytes of each pixel, by radiance and coverage.
fn write_rgba(path: &Path, frame: &Frame, color: impl Fn(usize) -> [u8; 3]) {
    let picture = image::RgbaImage::from_fn(SIZE, SIZE, |x, y| {
        let at = (y * SIZE + x) as usize;
        let [r, g, b] = color(at);
        image::Rgba([r, g, b, (255.0 * frame.alpha[at]).round() as u8])
    });
    save_png(path, &image::DynamicImage::ImageRgba8(picture));
}

/// A view as TensoIR-Synthetic has it: under two lights, with its layers.
fn write_view(folder: &Path, from: [f32; 3]) {
    let camera = camera(from, SIZE);
    let pose: Vec<String> = rows(&opengl_pose(&camera)).concat().iter().map(f32::to_string).collect();
    for (light, lobes) in [("sunset", day()), ("evening", evening())] {
        let frame = shoot(&mut studio(&lobes), camera);
        let straight = |at: usize| srgb8(frame.color[at] / frame.alpha[at].max(1e-6));
        write_rgba(&folder.join(format!("rgba_{light}.png")), &frame, straight);
        let byte = |value: f32| (255.0 * value).round() as u8;
        write_rgba(&folder.join("albedo.png"), &frame, |at| frame.albedo[at].to_array().map(byte));
        let code = |n: f32| (127.5 * (n + 1.0)).round() as u8;
        write_rgba(&folder.join("normal.png"), &frame, |at| frame.normal[at].to_array().map(code));
    }
    let camera =
        json!({"cam_transform_mat": pose.join(","), "cam_angle_x": angle(), "imw": SIZE, "imh": SIZE});
    std::fs::write(folder.join("metadata.json"), camera.to_string()).unwrap();
}

#[test]
fn tensoir_synthetic_is_fitted_relit_and_scored() {
    let data = Data::new();
    let root = data.path("tensoir");
    for (split, views) in [("train", TRAIN.as_slice()), ("test", &TEST)] {
        views
            .iter()
            .enumerate()
            .for_each(|(i, from)| write_view(&root.join(format!("{split}_{i:03}")), *from));
    }
    let scene = r#"Scene(
        version: 1,
        surface: Mesh(path: "$DATA/mesh.glb", texture_size: 32),
        views: Dataset(path: "$DATA/tensoir"),
        light: Unknown(lobes: 24),
        passes: [
            Fit(steps: 300),
            Render(name: "novel"),
            Relight(name: "evening", light: Npy(path: "$DATA/evening.npy")),
            Evaluate(
                scores: [
                    (pass: "novel", truth: Photographs),
                    (pass: "evening", truth: Files(folder: "$DATA/tensoir", file: "{view}/rgba_evening.png"), scale: PerChannel),
                ],
                albedo: Files(folder: "$DATA/tensoir", file: "{view}/albedo.png"),
                normal: Files(folder: "$DATA/tensoir", file: "{view}/normal.png"),
            ),
        ],
    )"#;
    data.run(scene, "out", &["--quiet"]).succeeded();
    let scores = metrics(&data.path("out"));
    let value = |pointer: &str| {
        scores.pointer(pointer).and_then(Value::as_f64).unwrap_or_else(|| panic!("{pointer}: {scores}"))
    };
    assert!(value("/passes/novel/srgb/psnr_mask") > 28.0, "{scores}");
    assert!(
        value("/passes/evening/srgb/psnr_white") > 24.0 && value("/passes/evening/srgb/ssim_white") > 0.9,
        "{scores}"
    );
    assert!(
        value("/albedo_psnr") > 20.0 && value("/normal_deg") < 1.0 && value("/normal_pixels") > 200.0,
        "{scores}"
    );

    // Truths that a run would write over are refused, whichever folder names them.
    let own = scene
        .replace("$DATA/tensoir\", file: \"{view}/rgba_evening.png", "$DATA\", file: \"out/novel/{view}.exr");
    let refused = data.run(&own, "out", &["--quiet", "--force"]);
    assert_eq!(refused.code, Some(2), "{}", refused.stderr);
    assert!(
        refused.stderr.contains("novel") && data.path("out/novel/test_000.exr").exists(),
        "{}",
        refused.stderr
    );
    let inputs = std::fs::read_to_string(data.path("out/run.json")).unwrap();
    assert!(
        inputs.contains("test_001/rgba_evening.png") && !inputs.contains("test_001/rgba_none.png"),
        "{inputs}"
    );

    // One file for all views, and one elsewhere, are refused before anything runs.
    for (wrong, words) in [("normal.png", "`{view}`"), ("../{view}.png", "does not lie in `folder`")] {
        let refused = data.run(&scene.replace("{view}/normal.png", wrong), "none", &["--quiet"]);
        assert_eq!(refused.code, Some(2), "{}", refused.stderr);
        assert!(refused.stderr.contains(words), "{}", refused.stderr);
    }
    std::fs::remove_file(root.join("test_001/albedo.png")).unwrap();
    let refused = data.run(scene, "none", &["--quiet"]);
    assert_eq!(refused.code, Some(2), "{}", refused.stderr);
    assert!(refused.stderr.contains("test_001/albedo.png"), "{}", refused.stderr);
    assert!(!data.path("none").exists());
}

/// Writes pictures and masks of a capture, and its camera files; of the test views also the map of the light, in the axes of their cameras.
fn write_capture(orb: &Path, capture: &str, lobes: &[LightLobe], others: &[Value]) -> Vec<Value> {
    let folder = orb.join("blender_HDR").join(capture);
    let mut studio = studio(lobes);
    let mut novel = Vec::new();
    for (split, views) in [("train", TRAIN.as_slice()), ("test", &TEST)] {
        let mut frames = Vec::new();
        for (i, from) in views.iter().enumerate() {
            let (camera, name) = (camera(*from, SIZE), format!("{i:04}"));
            let frame = shoot(&mut studio, camera);
            write_image(&folder.join(format!("{split}/{name}.exr")), &frame.color, frame.width);
            write_mask(&folder.join(format!("{split}_mask/{name}.png")), &frame);
            let pose = opengl_pose(&camera);
            frames.push(json!({"file_path": format!("{split}/{name}"), "transform_matrix": rows(&pose)}));
            if split == "test" {
                let map = orb.join(format!("ground_truth/{capture}/env_map/{name}.exr"));
                write_image(&map, &map_of(lobes, &pose), 128);
                let mut frame = frames[i].clone();
                (frame["scene_name"], frame["camera_angle_x"]) = (json!(capture), json!(angle()));
                novel.push(frame);
            }
        }
        let cameras = json!({"camera_angle_x": angle(), "frames": frames});
        std::fs::write(folder.join(format!("transforms_{split}.json")), cameras.to_string()).unwrap();
    }
    std::fs::write(folder.join("transforms_novel.json"), json!({ "frames": others }).to_string()).unwrap();
    novel
}

/// A map of 128 × 64 in a camera's axes, as `env_map_to_cam_to_world_by_convention` of the benchmark's code reads it: column (atan2(x, −z) + π)/2π, row arccos(y)/π of
/// a direction in OpenGL axes.
fn map_of(lobes: &[LightLobe], world_from_camera: &Affine3A) -> Vec<Vec3> {
    let radiance = |i: usize| {
        let (column, row) = ((i % 128) as f32 + 0.5, (i / 128) as f32 + 0.5);
        let (around, down) = (TAU * column / 128.0 - PI, PI * row / 64.0);
        let direction = Vec3::new(around.sin() * down.sin(), down.cos(), -around.cos() * down.sin());
        let direction = world_from_camera.transform_vector3(direction);
        lobes.iter().map(|lobe| lobe.radiance(direction)).sum()
    };
    (0..128 * 64).map(radiance).collect()
}

#[test]
fn stanford_orb_is_relit_by_the_maps_of_each_picture() {
    let data = Data::new();
    let orb = data.path("orb");
    let others = write_capture(&orb, "ball_scene002", &evening(), &[]);
    write_capture(&orb, "ball_scene001", &day(), &others);
    let out = data.path("prepared");
    let scene = stanford_orb::prepare(&orb, "ball_scene001", &out, 1).unwrap();
    // The object is small: its mesh is given, and the fit is short.
    std::fs::copy(data.path("mesh.glb"), out.join("mesh.glb")).unwrap();
    let text = std::fs::read_to_string(&scene).unwrap();
    assert_eq!(text.matches("Relight(").count(), 2, "{text}");
    let short = text
        .replace("surface: Unknown()", "surface: Mesh(path: \"$DATA/mesh.glb\", texture_size: 32)")
        .replace("Shape(),", "")
        .replace("vertices: true, detail: true, steps: 1200", "steps: 300");
    let run = |text: &str, name: &str| {
        std::fs::write(&scene, text).unwrap();
        let mut command = command(&["run", "--quiet", "--allow-outside"]);
        command.arg(&scene).arg("--data").arg(&out).arg("--out").arg(out.join(name));
        Outcome::of(&mut command).succeeded();
        stanford_orb::mean(&out.join(name)).unwrap()
    };
    let [psnr_h, psnr_l, pictures] = run(&short, "run");
    let novel = &metrics(&out.join("run"))["passes"]["novel"]["stanford_orb"]["psnr_ldr"];
    assert!(novel.as_f64().unwrap() > 28.0, "{novel}");
    assert_eq!(pictures, 2.0);
    assert!(psnr_h > 24.0 && psnr_l > 24.0, "{psnr_h} {psnr_l}");
    // The same maps as if they had the world's axes.
    let mut unturned = short.clone();
    while let Some(at) = unturned.find("rotation_degrees: (") {
        let end = at + unturned[at..].find(')').unwrap();
        unturned.replace_range(at..end, "scale: 1.0");
        unturned.replace_range(at + 10..=at + 10, "");
    }
    let [_, wrong, _] = run(&unturned, "unturned");
    assert!(wrong < psnr_l - 3.0, "{wrong} {psnr_l}");
}
