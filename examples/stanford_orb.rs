//! Stanford-ORB's relighting benchmark: one capture of an object is fitted, then relit by the
//! measured light of each test picture of its other captures, and scored by the benchmark's rule
//! (one factor per channel and picture, PSNR-H and PSNR-L).
//!
//! ```text
//! cargo run --release --example stanford_orb -- prepare ORB teapot_scene001 OUT
//! lobelia run OUT/scene.ron --data OUT --out OUT/run
//! cargo run --release --example stanford_orb -- mean OUT/run
//! ```
//!
//! `ORB` has the folders `blender_HDR` and `ground_truth`. `OUT` gets camera files that name the
//! photographs where they are, and a scene file with a `Relight` pass for each picture: a map of
//! `ground_truth` has the axes of its own camera.

use lobelia::dataset::{DatasetOptions, PlannedView, open_dataset};
use lobelia::glam::{EulerRot, Mat3, Quat, Vec3};
use lobelia::view::Split;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::{error::Error, fs, process::ExitCode};

type Result<T> = std::result::Result<T, Box<dyn Error>>;

/// By how much the photographs, 2048 pixels wide, are downscaled: the benchmark scores 512.
const DOWNSCALE: u32 = 4;

#[allow(dead_code, reason = "a test takes this file as a module")]
fn main() -> ExitCode {
    match carry_out() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}

#[allow(dead_code, reason = "a test takes this file as a module")]
fn carry_out() -> Result<()> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    match words.iter().map(String::as_str).collect::<Vec<_>>().as_slice() {
        ["prepare", orb, capture, out] => {
            let scene = prepare(Path::new(orb), capture, Path::new(out), DOWNSCALE)?;
            println!("lobelia run {} --data {out} --out {out}/run", scene.display());
        }
        ["mean", run] => {
            let [psnr_h, psnr_l, pictures] = mean(Path::new(run))?;
            println!("relit: PSNR-H {psnr_h:.2} dB, PSNR-L {psnr_l:.2} dB, {pictures} pictures");
        }
        _ => println!("stanford_orb prepare ORB CAPTURE OUT\nstanford_orb mean RUN"),
    }
    Ok(())
}

/// Writes the camera files of a capture and of the test pictures of the object's other captures,
/// and the scene file, whose path is returned.
pub fn prepare(orb: &Path, capture: &str, out: &Path, downscale: u32) -> Result<PathBuf> {
    let photographs = found(&orb.join("blender_HDR"))?;
    let of = |split: &str| frames(&photographs, capture, split);
    fs::create_dir_all(out)?;
    let test: Vec<Value> = [of("test")?, of("novel")?].concat();
    for (split, frames) in [("train", of("train")?), ("test", test)] {
        let text = serde_json::to_string_pretty(&json!({ "frames": frames }))?;
        fs::write(out.join(format!("transforms_{split}.json")), text)?;
    }
    let views = open_dataset(out, Split::Test, &DatasetOptions::default())?.views;
    let scene = out.join("scene.ron");
    fs::write(&scene, scene_of(&found(orb)?, capture, &views, downscale)?)?;
    Ok(scene)
}

/// The whole path of what must be there.
fn found(path: &Path) -> Result<PathBuf> {
    fs::canonicalize(path).map_err(|error| format!("{}: {error}", path.display()).into())
}

/// The frames of `transforms_<split>.json`, with photograph and mask where they are and their own
/// field of view.
fn frames(photographs: &Path, capture: &str, split: &str) -> Result<Vec<Value>> {
    let file = photographs.join(capture).join(format!("transforms_{split}.json"));
    let text = fs::read_to_string(&file).map_err(|error| format!("{}: {error}", file.display()))?;
    let cameras: Value = serde_json::from_str(&text)?;
    let frames = cameras["frames"].as_array().ok_or("there are no frames")?;
    frames.iter().map(|frame| found_frame(photographs, capture, &cameras, frame)).collect()
}

/// A frame of the file `cameras`.
fn found_frame(photographs: &Path, capture: &str, cameras: &Value, frame: &Value) -> Result<Value> {
    let scene = frame["scene_name"].as_str().unwrap_or(capture);
    let path = frame["file_path"].as_str().ok_or("a frame has no file_path")?;
    let (folder, name) = path.rsplit_once('/').ok_or("a file_path has no folder")?;
    let angle = frame.get("camera_angle_x").unwrap_or(&cameras["camera_angle_x"]);
    Ok(json!({
        "file_path": photographs.join(scene).join(folder).join(format!("{name}.exr")),
        "mask_path": photographs.join(scene).join(format!("{folder}_mask")).join(format!("{name}.png")),
        "camera_angle_x": angle,
        "transform_matrix": frame["transform_matrix"],
    }))
}

/// The scene: what `scenes/photos.ron` does, and a pass for each picture of another capture.
fn scene_of(orb: &Path, capture: &str, views: &[PlannedView], downscale: u32) -> Result<String> {
    let mut own = Vec::new();
    let (mut relights, mut scores) = (String::new(), String::new());
    for view in views {
        let (scene, file) = place_of(view)?;
        if scene == capture {
            own.push(format!("{:?}", view.plan.name));
            continue;
        }
        let map = orb.join("ground_truth").join(&scene).join("env_map").join(file);
        let ([x, y, z], name) = (turn_of(view).to_array(), &view.plan.name);
        relights += &format!(
            "        Relight(name: \"relit_{name}\", light: Map(path: {map:?}, rotation_degrees: ({x}, {y}, {z})), \
             render: (views: Named([\"{name}\"]))),\n"
        );
        scores += &format!("            (pass: \"relit_{name}\", truth: Photographs, scale: PerView),\n");
    }
    let novel = own.join(", ");
    Ok(format!(
        "// Stanford-ORB, {capture}: fitted, and relit by the measured light of other captures.\n\
         Scene(\n    version: 1,\n    surface: Unknown(),\n    up: (0, 0, 1),\n    \
         views: Dataset(path: \"$DATA\", layout: Nerf, downscale: {downscale}),\n    passes: [\n        \
         Shape(),\n        Fit(vertices: true, detail: true, steps: 1200, rates: (albedo: 0.02, light: 0.02, specular: 0.01)),\n        \
         Render(name: \"novel\", render: (views: Named([{novel}]))),\n{relights}        \
         Evaluate(scores: [\n            (pass: \"novel\", truth: Photographs, scale: PerView),\n{scores}        ]),\n        \
         Save(),\n    ],\n)\n"
    ))
}

/// The capture that a photograph is of, and the name of its file.
fn place_of(view: &PlannedView) -> Result<(String, PathBuf)> {
    let image = view.plan.image.as_deref().ok_or("a view has no photograph")?;
    let scene = image.ancestors().nth(2).and_then(Path::file_name).ok_or("a photograph is in no capture")?;
    Ok((scene.to_string_lossy().into_owned(), image.file_name().unwrap_or_default().into()))
}

/// How a measured map is turned, in degrees about the world's x, then y, then z. Its middle is the
/// direction in which its camera looks, ¾ are to the right of it and the top is above
/// (`orb/utils/env_map.py`); those of a map of Lobelia's are +Z, −X and +Y.
fn turn_of(view: &PlannedView) -> Vec3 {
    let camera = Mat3::from(view.world_from_camera().matrix3);
    let (right, down, forward) = (camera.x_axis, camera.y_axis, camera.z_axis);
    let world_from_map = Mat3::from_cols(-right, -down, forward);
    let (z, y, x) = Quat::from_mat3(&world_from_map).to_euler(EulerRot::ZYX);
    Vec3::new(x, y, z).map(f32::to_degrees)
}

/// Mean PSNR-H and PSNR-L of the relit pictures of a run, and how many there are.
pub fn mean(run: &Path) -> Result<[f64; 3]> {
    let metrics: Value = serde_json::from_slice(&fs::read(found(&run.join("metrics.json"))?)?)?;
    let passes = metrics["passes"].as_object().ok_or("metrics.json has no passes")?;
    let relit = passes.iter().filter(|(name, _)| name.starts_with("relit_"));
    let mut sums = [0.0; 3];
    for (name, scores) in relit {
        for (sum, key) in sums.iter_mut().zip(["psnr_hdr", "psnr_ldr"]) {
            let score = scores["stanford_orb"][key].as_f64();
            *sum += score.ok_or_else(|| format!("{name} has no {key}: is its mask empty?"))?;
        }
        sums[2] += 1.0;
    }
    let [psnr_h, psnr_l, count] = sums;
    if count == 0.0 {
        return Err(format!("no pass of {} is called relit_…", run.display()).into());
    }
    Ok([psnr_h / count, psnr_l / count, count])
}
