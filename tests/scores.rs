//! Scores: in sRGB, of normals, of public benchmarks, and those of small scenes to a hundredth of a
//! decibel, so that each change of them is seen and explained.

use crate::common::{self, *};
use glam::{Affine3A, Vec3};
use lobelia::{codec::tone::srgb8, light::LightLobe, view::Frame};
use serde::Deserialize;
use serde_json::{Value, json};
use std::f32::consts::{PI, TAU};
use std::{collections::BTreeMap, fmt::Write as _, path::Path};

#[path = "../examples/stanford_orb.rs"]
mod stanford_orb;

/// Scores of a gray sphere under the other light, and `more` passes.
fn gray(more: &str) -> String {
    let passes = r#"Render(name: "novel"), Relight(name: "relit", light: Npy(path: "$DATA/evening.npy")),
        Evaluate(
            scores: [
                (pass: "novel", truth: Photographs, scale: PerChannel),
                (pass: "relit", truth: Folder("$DATA/test/gt/relit")),
            ],
            normal: Folder("$DATA/test/gt"),
        ),"#;
    known_scene(&[passes, more].concat())
}

#[test]
fn normals_of_pngs_are_scored_where_they_are_positive() {
    let data = Data::new();
    data.run(&gray(""), "out", &["--quiet"]).succeeded();
    let whole = data.metrics("out");
    for view in ["000000", "000001"] {
        let exr = format!("test/gt/normal_{view}.exr");
        let normals = data.exr(&exr);
        let png = image::RgbImage::from_fn(SIZE, SIZE, |x, y| {
            let at = |c: &str| normals.channels[c][(y * SIZE + x) as usize].max(0.0);
            image::Rgb(srgb8(Vec3::from(["R", "G", "B"].map(at))))
        });
        let path = data.path(format!("test/gt/rgb_{view}_normal.png"));
        save_png(&path, &image::DynamicImage::ImageRgb8(png));
        std::fs::remove_file(data.path(exr)).unwrap();
    }
    data.run(&gray(""), "png", &["--quiet"]).succeeded();
    let positive = data.metrics("png");
    let value = |metrics: &Value, key: &str| metrics[key].as_f64().unwrap();
    // Pictures are rounded to 8 bits.
    for (metrics, most) in [(&whole, 0.1), (&positive, 0.5)] {
        let off = ["normal_deg", "normal_median_deg"].map(|key| value(metrics, key));
        assert!(off[0] < most && off[1] < most, "{metrics}");
    }
    let (all, known) = (value(&whole, "normal_pixels"), value(&positive, "normal_pixels"));
    assert!(known > 20.0 && known < 0.6 * all, "{known} of {all}");
    std::fs::remove_file(data.path("test/gt/rgb_000001_normal.png")).unwrap();
    data.run(&gray(""), "none", &["--quiet"]).refused(&["rgb_000001_normal.png"]);
}

/// Rows of a `views.csv`.
fn rows(data: &Data, table: &str) -> Vec<Vec<String>> {
    data.text(table).lines().skip(1).map(|row| row.split(',').map(str::to_owned).collect()).collect()
}

#[test]
fn passes_are_scored_in_srgb_and_views_by_the_evaluation_that_scored_them() {
    let data = Data::new();
    // Training and test views have the same names, and nothing was fitted to the first.
    let again = r#"Evaluate(name: "again", scores: [(pass: "relit", truth: Folder("$DATA/test/gt/relit"))])"#;
    let table = data.run(&gray(again), "out", &[]).succeeded().stdout;
    let metrics = data.metrics("out");
    let passes = &metrics["passes"];
    for scores in [&passes["novel"]["srgb"], &passes["novel"]["views"][1]["srgb"]] {
        let value = |key: &str| scores[key].as_f64().unwrap_or_else(|| panic!("no {key} in {scores}"));
        // Around the object nothing is wrong; its outline is right, so the background makes no
        // difference to errors.
        assert!(value("psnr_mask") > 5.0 && value("psnr_mask") + 1.0 < value("psnr_white"), "{scores}");
        assert!((value("psnr_white") - value("psnr_black")).abs() < 0.5, "{scores}");
        let ssim = ["ssim_white", "ssim_black"].map(value);
        assert!(ssim.iter().all(|value| *value > 0.1 && *value < 1.0), "{scores}");
    }
    assert!(passes["relit"].get("srgb").is_none(), "{metrics}");
    let psnr = passes["novel"]["srgb"]["psnr_white"].as_f64().unwrap();
    assert!(table.contains("white dB") && table.contains(&format!("{psnr:.2}")), "{table}");
    for (pass, of) in [("novel", "scores"), ("relit", "again")] {
        let rows = rows(&data, &format!("out/{of}/views.csv"));
        let named: Vec<[&str; 2]> = rows.iter().map(|row| [row[0].as_str(), row[1].as_str()]).collect();
        assert_eq!(named, [["rgb_000000", "test"], ["rgb_000001", "test"]]);
        for (i, row) in rows.iter().enumerate() {
            let psnr = passes[pass]["views"][i]["psnr"].as_f64().unwrap();
            assert!((row[5].parse::<f64>().unwrap() - psnr).abs() < 1e-3, "{pass}: {row:?}, {psnr}");
        }
    }
    assert_eq!(metrics["views"].as_array().unwrap().len(), 2);
}

#[test]
fn outliers_are_those_of_the_picture_that_is_scored() {
    let data = Data::new();
    // The photographs are the object's own under a quarter of its light.
    let views = r#"Photographed(cameras: (count: 2, test: 1, size: 24), spp: 64, truth: (albedo: Constant(0.4, 0.4, 0.4),
        specular: (albedo: (0.2, 0.2, 0.2), roughness: 0.3), light: Npy(path: "$DATA/evening.npy", scale: 0.25)))"#;
    for (scale, range) in [("None", 0.3..1.01), ("PerChannel", 0.0..0.1), ("PerLayer", 0.0..0.1)] {
        let passes =
            format!(r#"{NOVEL}Evaluate(scores: [(pass: "novel", truth: Photographs, scale: {scale})])"#);
        let scene = known_scene(&passes).replace(r#"Dataset(path: "$DATA")"#, views);
        data.run(&scene, scale, &["--quiet"]).succeeded();
        let outliers: f64 = rows(&data, &format!("{scale}/scores/views.csv"))[0][6].parse().unwrap();
        assert!(range.contains(&outliers), "{scale}: {outliers}");
    }
}

// The table. `LOBELIA_BLESS=1` writes it again.

const TABLE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/scores.ron");
const HEAD: &str = "\
// Scores of the runs that `tests/scores.rs` names. The same instruction set gives the same bits;
// others may differ by 0.15 dB or degrees, or 0.0015 of what has no unit. Write the table again
// with `LOBELIA_BLESS=1 cargo test scores_are_those`, and say why it changed.
";

#[derive(Deserialize)]
struct Table {
    instruction_set: String,
    scores: BTreeMap<String, f64>,
}

#[test]
fn scores_are_those_of_the_table() {
    let mut scores = BTreeMap::new();
    let (whole, _) = &*crate::run::WHOLE;
    let mut add = |data: &Data, out: &str, pointers: &[(&str, &str)]| {
        let metrics = data.metrics(out);
        for (name, pointer) in pointers {
            let value = metrics.pointer(pointer).and_then(Value::as_f64);
            scores.insert((*name).to_owned(), value.unwrap_or_else(|| panic!("no {pointer} in {metrics}")));
        }
    };
    let known_mesh = [
        ("known mesh: novel views, dB", "/passes/novel/psnr"),
        ("known mesh: novel views, SSIM", "/passes/novel/ssim"),
        ("known mesh: published formulas, dB", "/passes/published/psnr"),
        ("known mesh: another light, dB", "/passes/relit/psnr"),
        ("known mesh: edited gloss, dB", "/passes/gloss/psnr"),
        ("known mesh: albedo, dB", "/albedo_psnr"),
        ("known mesh: normals, degrees", "/normal_deg"),
    ];
    add(whole, "out", &known_mesh);
    let (carved, _) = &*crate::photos::CARVED;
    for (name, out) in [("visual hull", "out"), ("refined shape", "refined")] {
        let [psnr, iou] = ["novel views, dB", "masks, IoU"].map(|score| format!("{name}: {score}"));
        add(carved, out, &[(&psnr, "/passes/novel/psnr"), (&iou, "/mask_iou")]);
    }
    add(&crate::materials::GGX, "out", &[("GGX: novel views, dB", "/passes/novel/psnr")]);

    let step = |name: &str| if name.ends_with("dB") || name.ends_with("degrees") { 0.01 } else { 0.0001 };
    let own = whole.json("out/run.json")["machine"]["simd"].as_str().unwrap().to_owned();
    if std::env::var_os("LOBELIA_BLESS").is_some() {
        let mut text = format!("{HEAD}(\n    instruction_set: {own:?},\n    scores: {{\n");
        for (name, score) in &scores {
            let digits = if step(name) == 0.01 { 2 } else { 4 };
            let _ = writeln!(text, "        {name:?}: {score:.digits$},");
        }
        std::fs::write(TABLE, text + "    },\n)\n").unwrap();
    }
    let text = std::fs::read_to_string(TABLE).expect("LOBELIA_BLESS=1 writes the table");
    let table: Table = ron::from_str(&text).unwrap();
    assert!(scores.keys().eq(table.scores.keys()), "{scores:?}");
    let steps = if table.instruction_set == own { 0.5 } else { 15.5 };
    let differs =
        |(name, score): &(&String, &f64)| (table.scores[*name] - **score).abs() > (steps + 1e-3) * step(name);
    let was = |(name, score): (&String, &f64)| format!("{name}: {score} was {}", table.scores[name]);
    let changed: Vec<String> = scores.iter().filter(differs).map(was).collect();
    assert!(changed.is_empty(), "{own}: {changed:#?}");
}

// Public benchmarks of relighting, on look-alikes: TensoIR-Synthetic's layout and truths, and
// Stanford-ORB's by the example that prepares it.

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
fn matrix(pose: &Affine3A) -> [[f32; 4]; 4] {
    glam::Mat4::from(*pose).transpose().to_cols_array_2d()
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
    let pose: Vec<String> = matrix(&opengl_pose(&camera)).concat().iter().map(f32::to_string).collect();
    for (light, lobes) in [("sunset", day()), ("evening", evening())] {
        let frame = shoot(&mut studio(&lobes), camera);
        let straight = |at: usize| srgb8(frame.color[at] / frame.alpha[at].max(1e-6));
        write_rgba(&folder.join(format!("rgba_{light}.png")), &frame, straight);
        let byte = |value: f32| (255.0 * value).round() as u8;
        write_rgba(&folder.join("albedo.png"), &frame, |at| frame.albedo[at].to_array().map(byte));
        let code = |n: f32| (127.5 * (n + 1.0)).round() as u8;
        write_rgba(&folder.join("normal.png"), &frame, |at| frame.normal[at].to_array().map(code));
    }
    let text = json!({"cam_transform_mat": pose.join(","), "cam_angle_x": angle(), "imw": SIZE, "imh": SIZE});
    std::fs::write(folder.join("metadata.json"), text.to_string()).unwrap();
}

#[test]
fn tensoir_synthetic_is_fitted_relit_and_scored() {
    let data = Data::new();
    let root = data.path("tensoir");
    for (split, views) in [("train", TRAIN.as_slice()), ("test", &TEST)] {
        for (i, from) in views.iter().enumerate() {
            write_view(&root.join(format!("{split}_{i:03}")), *from);
        }
    }
    let passes = r#"Fit(steps: 300, batch: 1024), Render(name: "novel"),
        Relight(name: "evening", light: Npy(path: "$DATA/evening.npy")),
        Evaluate(
            scores: [
                (pass: "novel", truth: Photographs),
                (pass: "evening", truth: Files(folder: "$DATA/tensoir", file: "{view}/rgba_evening.png"), scale: PerChannel),
            ],
            albedo: Files(folder: "$DATA/tensoir", file: "{view}/albedo.png"),
            normal: Files(folder: "$DATA/tensoir", file: "{view}/normal.png"),
        ),"#;
    let scene = [
        ("texture_size: 16", "texture_size: 32"),
        ("lobes: 6", "lobes: 24"),
        (r#"Dataset(path: "$DATA")"#, r#"Dataset(path: "$DATA/tensoir")"#),
    ];
    let scene = scene.iter().fold(common::scene(passes), |text, (word, by)| changed(&text, word, by));
    data.run(&scene, "out", &["--quiet"]).succeeded();
    let scores = data.metrics("out");
    let value = |pointer: &str| {
        scores.pointer(pointer).and_then(Value::as_f64).unwrap_or_else(|| panic!("{pointer}: {scores}"))
    };
    for (pointer, least) in [
        ("/passes/novel/srgb/psnr_mask", 28.0),
        ("/passes/evening/srgb/psnr_white", 24.0),
        ("/passes/evening/srgb/ssim_white", 0.9),
        ("/albedo_psnr", 20.0),
        ("/normal_pixels", 200.0),
    ] {
        assert!(value(pointer) > least, "{pointer}: {scores}");
    }
    assert!(value("/normal_deg") < 1.0, "{scores}");

    // Truths that a run would write over are refused, whichever folder names them.
    let own = scene
        .replace("$DATA/tensoir\", file: \"{view}/rgba_evening.png", "$DATA\", file: \"out/novel/{view}.exr");
    data.run(&own, "out", &["--quiet", "--force"]).refused(&["novel"]);
    assert!(data.path("out/novel/test_000.exr").exists());
    let inputs = data.text("out/run.json");
    assert!(inputs.contains("test_001/rgba_evening.png"), "{inputs}");
    // One file for all views, and one elsewhere, are refused before anything runs.
    for (wrong, words) in [("normal.png", "`{view}`"), ("../{view}.png", "does not lie in `folder`")] {
        data.run(&scene.replace("{view}/normal.png", wrong), "none", &["--quiet"]).refused(&[words]);
    }
    std::fs::remove_file(root.join("test_001/albedo.png")).unwrap();
    data.run(&scene, "none", &["--quiet"]).refused(&["test_001/albedo.png"]);
    assert!(!data.path("none").exists());
}

/// Writes pictures and masks of a capture, and its camera files; of the test views also the map of
/// the light, in the axes of their cameras.
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
            frames.push(json!({"file_path": format!("{split}/{name}"), "transform_matrix": matrix(&pose)}));
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

/// A map of 128 × 64 in a camera's axes, as `env_map_to_cam_to_world_by_convention` of the
/// benchmark's code reads it: column (atan2(x, −z) + π)/2π, row arccos(y)/π of a direction in
/// OpenGL axes.
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
        .replace("rotation_degrees:", "lobes: 24, rotation_degrees:")
        .replace("vertices: true, detail: true, steps: 1200", "steps: 150, batch: 512");
    let run = |text: &str, name: &str| {
        data.write("prepared/scene.ron", text);
        let into = format!("prepared/{name}");
        let run = ["run", "prepared/scene.ron", "--data", "prepared", "--out", &into, "--quiet"];
        data.lobelia(&run).succeeded();
        stanford_orb::mean(&data.path(into)).unwrap()
    };
    let [psnr_h, psnr_l, pictures] = run(&short, "run");
    let novel = &data.metrics("prepared/run")["passes"]["novel"]["stanford_orb"]["psnr_ldr"];
    assert!(novel.as_f64().unwrap() > 28.0, "{novel}");
    assert_eq!(pictures, 2.0);
    assert!(psnr_h > 24.0 && psnr_l > 24.0, "{psnr_h} {psnr_l}");
    // The same maps as if they had the world's axes.
    let mut parts = short.split("rotation_degrees: (");
    let unturned = parts.next().unwrap().to_owned();
    let unturned = parts.fold(unturned, |text, part| text + "scale: 1.0" + part.split_once(')').unwrap().1);
    let [_, wrong, _] = run(&unturned, "unturned");
    assert!(wrong < psnr_l - 3.0, "{wrong} {psnr_l}");
}
