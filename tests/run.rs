//! A whole run on small data: every pass, every file, the same bytes again, stopping it, and the other commands.

use crate::common::{Data, Outcome, SIZE, command, files_below, is_temporary};
use lobelia::codec::exr::read_exr_layers;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// Everything at once. The gloss edit is on the half with x ≥ 0 only.
const ALL: &str = r#"Scene(
    version: 1,
    seed: 3,
    surface: Mesh(path: "$DATA/mesh.glb", texture_size: 32),
    views: Dataset(path: "$DATA"),
    light: Unknown(lobes: 12),
    passes: [
        Fit(name: "fit", steps: 100, batch: 512),
        Render(name: "novel"),
        Edit(name: "gloss", edits: [
            Roughness(action: Set(0.08), region: Box(min: (0, -2, -2), max: (2, 2, 2))),
            Specular(action: Set(0.9, 0.6, 0.3), region: Box(min: (0, -2, -2), max: (2, 2, 2))),
        ]),
        Render(name: "after"),
        Relight(name: "relit", light: Npy(path: "$DATA/evening.npy")),
        Render(name: "traced", render: (views: Named(["rgb_000001"]), shading: PathTraced(spp: 4))),
        Evaluate(
            name: "scores",
            scores: [
                (pass: "novel", truth: Photographs),
                (pass: "relit", truth: Folder("$DATA/test/gt/relit"), scale: PerChannel),
                (pass: "gloss", truth: Photographs, scale: PerLayer),
            ],
            albedo: Folder("$DATA/test/gt"),
            normal: Folder("$DATA/test/gt"),
            mesh: "$DATA/mesh.glb",
        ),
        Save(name: "saved"),
        Export(name: "export"),
    ],
)
"#;

const CHANNELS: [&str; 17] = [
    "A",
    "B",
    "G",
    "R",
    "albedo.B",
    "albedo.G",
    "albedo.R",
    "depth.Z",
    "diffuse.B",
    "diffuse.G",
    "diffuse.R",
    "normal.X",
    "normal.Y",
    "normal.Z",
    "specular.B",
    "specular.G",
    "specular.R",
];

fn read(path: PathBuf) -> Vec<u8> {
    std::fs::read(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

fn metrics(out: &Path) -> Value {
    serde_json::from_slice(&read(out.join("metrics.json"))).unwrap()
}

/// Expects that two runs wrote the same files with the same bytes, but for times and memory.
#[track_caller]
fn same_bytes(a: &Path, b: &Path) {
    let files = files_below(a);
    assert_eq!(files, files_below(b));
    let timeless = |file: &&String| {
        // The contact sheet bears the name of the output folder, the saved scene the data's path, which is the same here.
        !["metrics.json", "run.json", "report.html", "fit/log.csv", "scores/contact_sheet.png"]
            .contains(&file.as_str())
    };
    let compared: Vec<&String> = files.iter().filter(timeless).collect();
    assert!(compared.iter().filter(|file| file.ends_with(".exr")).count() >= 9, "{compared:?}");
    for file in compared {
        assert!(read(a.join(file)) == read(b.join(file)), "{file} differs");
    }
    let (mut a, mut b) = (metrics(a), metrics(b));
    for metrics in [&mut a, &mut b] {
        metrics["fit_secs"] = json!(0);
        metrics["peak_rss_mib"] = json!(0);
    }
    assert_eq!(a, b);
}

#[test]
fn a_whole_run_writes_everything() {
    let data = Data::new();
    let outcome = data.run(ALL, "out", &["--threads", "2"]).succeeded();
    let out = data.path("out");
    let files = files_below(&out);
    assert!(!files.iter().any(|file| is_temporary(file)), "{files:?}");
    let mut expected: Vec<String> = [
        "export/light.hdr",
        "export/light_blender.hdr",
        "export/mesh.glb",
        "export/model-viewer.html",
        "fit/albedo.exr",
        "fit/albedo.png",
        "fit/environment.exr",
        "fit/environment.png",
        "fit/light.npy",
        "fit/log.csv",
        "fit/materials.ron",
        "fit/seen.png",
        "metrics.json",
        "report.html",
        "run.json",
        "saved/albedo.exr",
        "saved/light.npy",
        "saved/mesh.glb",
        "saved/scene.ron",
        "scores/contact_sheet.png",
        "scores/views.csv",
        "traced/test_rgb_000001.exr",
        "traced/test_rgb_000001.png",
        "traced/train_rgb_000001.exr",
        "traced/train_rgb_000001.png",
    ]
    .map(str::to_owned)
    .to_vec();
    for pass in ["after", "gloss", "novel", "relit"] {
        for view in ["rgb_000000", "rgb_000001"] {
            expected.extend(["exr", "png"].map(|kind| format!("{pass}/{view}.{kind}")));
            if pass != "after" {
                expected.extend(
                    ["truth", "render", "error"].map(|part| format!("scores/{pass}/{view}_{part}.jpg")),
                );
            }
        }
    }
    expected.sort();
    assert_eq!(files, expected);
    check_pictures(&out);
    check_metrics(&out, &outcome.stdout);
    check_log(&out);
    check_region(&data);
}

/// All layers, the right size, color as the sum of its parts, on black.
fn check_pictures(out: &Path) {
    for file in
        ["novel/rgb_000000.exr", "gloss/rgb_000001.exr", "relit/rgb_000000.exr", "traced/test_rgb_000001.exr"]
    {
        let picture = read_exr_layers(out.join(file)).unwrap();
        assert_eq!(picture.channels.keys().collect::<Vec<_>>(), CHANNELS, "{file}");
        assert_eq!([picture.width, picture.height], [SIZE; 2]);
        let at = |name: &str, i: usize| picture.channels[name][i];
        for i in 0..picture.channels["A"].len() {
            for c in ["R", "G", "B"] {
                let sum = at(&format!("diffuse.{c}"), i) + at(&format!("specular.{c}"), i);
                assert!((at(c, i) - sum).abs() <= 1e-5 * (1.0 + sum), "{file}: {c} of pixel {i}");
            }
            let normal = ["X", "Y", "Z"].map(|c| at(&format!("normal.{c}"), i));
            let length = normal.iter().map(|n| n * n).sum::<f32>().sqrt();
            if at("A", i) == 0.0 {
                assert!(at("R", i) == 0.0 && at("depth.Z", i) == 0.0 && length == 0.0, "{file}: pixel {i}");
            } else {
                let (near, far) = (crate::common::DISTANCE - crate::common::RADIUS, crate::common::DISTANCE);
                let depth = at("depth.Z", i);
                assert!((near - 1e-3..far).contains(&depth), "{file}: depth {depth} of pixel {i}");
                assert!((length - 1.0).abs() < 1e-4, "{file}: normal of pixel {i} is {length} long");
            }
        }
    }
}

fn check_metrics(out: &Path, table: &str) {
    let metrics = metrics(out);
    for pass in ["novel", "relit", "gloss"] {
        for key in ["psnr", "psnr_raw", "ssim"] {
            let value = metrics["passes"][pass][key].as_f64();
            assert!(value.is_some_and(f64::is_finite), "{pass} has no {key} in {metrics}");
        }
        assert!(table.contains(pass), "{table}");
    }
    for key in ["albedo_psnr", "normal_deg", "normal_median_deg", "normal_pixels", "fit_secs", "peak_rss_mib"]
    {
        assert!(metrics[key].as_f64().is_some_and(f64::is_finite), "no {key} in {metrics}");
    }
    let value = |key: &str| metrics[key].as_f64().unwrap();
    // The surface is the true one; pixels are the mean of four normals.
    assert!(value("normal_deg") < 0.1, "{metrics}");
    assert!(
        value("fit_secs") > 0.0 && value("peak_rss_mib") > 1.0 && value("peak_rss_mib") < 2048.0,
        "{metrics}"
    );
    // The photographs come from the model that is fitted, so unseen views are well predicted.
    assert!(metrics["passes"]["novel"]["psnr"].as_f64().unwrap() > 25.0, "{metrics}");
    assert!(value("albedo_psnr") > 18.0, "{metrics}");
    // Another light shows in the pictures: they are not the photographs under the old one.
    let raw = |pass: &str| metrics["passes"][pass]["psnr_raw"].as_f64().unwrap();
    assert!(raw("gloss") < raw("novel") - 1.0, "{metrics}");
}

/// The loss goes down.
fn check_log(out: &Path) {
    let log = String::from_utf8(read(out.join("fit/log.csv"))).unwrap();
    let mut lines = log.lines();
    assert_eq!(
        lines.next(),
        Some("step,elapsed_secs,loss,psnr,specular_r,specular_g,specular_b,roughness,lobes")
    );
    let rows: Vec<Vec<f64>> =
        lines.map(|line| line.split(',').map(|n| n.parse().unwrap()).collect()).collect();
    assert_eq!(rows.iter().map(|row| row[0]).collect::<Vec<_>>(), [20.0, 40.0, 60.0, 80.0, 100.0]);
    let (first, last) = (&rows[0], &rows[4]);
    assert!(last[2] < 0.9 * first[2] && last[3] > first[3], "the loss goes from {} to {}", first[2], last[2]);
}

/// The edit of one half changes that half and nothing else, and later passes see the material as it was.
fn check_region(data: &Data) {
    for (view, from) in [("rgb_000000", [0.7, 0.5, 0.8]), ("rgb_000001", [-0.5, 0.3, -0.9f32])] {
        let picture = |pass: &str| read_exr_layers(data.path(&format!("out/{pass}/{view}.exr"))).unwrap();
        let (novel, gloss, after) = (picture("novel"), picture("gloss"), picture("after"));
        assert_eq!(novel, after, "{view}");
        let camera = crate::common::camera(from, SIZE);
        let (mut inside, mut changed) = (0, 0);
        for i in 0..novel.channels["A"].len() {
            if novel.channels["A"][i] < 1.0 {
                continue;
            }
            let ray = camera.ray((i as u32 % SIZE) as f32 + 0.5, (i as u32 / SIZE) as f32 + 0.5);
            let x = (ray.origin + ray.direction * novel.channels["depth.Z"][i]).x;
            let difference = (novel.channels["specular.R"][i] - gloss.channels["specular.R"][i]).abs();
            assert_eq!(novel.channels["diffuse.R"][i], gloss.channels["diffuse.R"][i]);
            // A texel on the border is blended into its neighbors' pixels.
            if x < -0.25 {
                assert!(difference < 1e-5, "{view}: pixel {i} at x = {x:.2} changed by {difference}");
            } else if x > 0.25 {
                inside += 1;
                changed += usize::from(difference > 1e-3);
            }
        }
        assert!(inside >= 8 && changed > inside / 2, "{view}: {changed} of {inside} pixels changed");
    }
}

#[test]
fn the_same_seed_gives_the_same_bytes_at_any_thread_count() {
    let data = Data::new();
    data.run(ALL, "two", &["--threads", "2", "--quiet"]).succeeded();
    data.run(ALL, "again", &["--threads", "2", "--quiet"]).succeeded();
    data.run(ALL, "one", &["--threads", "1", "--quiet"]).succeeded();
    same_bytes(&data.path("two"), &data.path("again"));
    same_bytes(&data.path("two"), &data.path("one"));
    data.run(ALL, "other", &["--threads", "2", "--quiet", "--seed", "4"]).succeeded();
    let light = |out: &str| read(data.path(out).join("fit/light.npy"));
    assert_ne!(light("two"), light("other"), "another seed visits the pixels in another order");
}

#[test]
fn a_saved_object_opens_again_with_the_same_bits() {
    let data = Data::new();
    data.run(ALL, "out", &["--quiet"]).succeeded();
    let mut again = command(&["run", "--quiet", "--allow-outside"]);
    again.arg(data.path("out/saved/scene.ron")).arg("--out").arg(data.path("again"));
    Outcome::of(&mut again).succeeded();
    for file in
        ["novel/rgb_000000.exr", "novel/rgb_000001.exr", "after/rgb_000000.exr", "traced/test_rgb_000001.exr"]
    {
        let [a, b] = ["out", "again"].map(|out| read(data.path(out).join(file)));
        assert!(a == b, "{file} differs");
    }
    let saved = read(data.path("out/saved/scene.ron"));
    let saved = String::from_utf8(saved).unwrap();
    assert!(!saved.contains("Unknown") && !saved.contains("Fit("), "{saved}");
}

/// A short fit and a picture.
const SHORT: &str = r#"Scene(
    version: 1,
    surface: Mesh(path: "$DATA/mesh.glb", texture_size: 16),
    views: Dataset(path: "$DATA"),
    light: Unknown(lobes: 6),
    passes: [
        Fit(name: "fit", steps: 30, batch: 512),
        Render(name: "novel"),
        Evaluate(scores: [(pass: "novel", truth: Photographs)]),
    ],
)
"#;

#[test]
fn an_output_folder_is_not_overwritten_without_force() {
    let data = Data::new();
    data.run(SHORT, "out", &["--quiet"]).succeeded();
    let before = read(data.path("out/metrics.json"));
    std::fs::write(data.path("out/mine.txt"), "mine").unwrap();
    let refused = data.run(SHORT, "out", &["--seed", "9"]);
    assert_eq!(refused.code, Some(2), "{}", refused.stderr);
    assert!(refused.stderr.contains("not empty") && refused.stderr.contains("--force"), "{}", refused.stderr);
    assert_eq!(read(data.path("out/metrics.json")), before, "nothing was touched");
    data.run(SHORT, "out", &["--seed", "9", "--force"]).succeeded();
    assert_ne!(read(data.path("out/metrics.json")), before, "now it was written");
    assert_eq!(read(data.path("out/mine.txt")), b"mine", "other files stay");
}

/// The same photographs in NeRF's layout: RGBA PNGs in sRGB.
fn as_nerf(data: &Data, folder: &Path) {
    for split in ["train", "test"] {
        let text = read(data.path(split).join("cam_dict_norm.json"));
        let cameras: serde_json::Map<String, Value> = serde_json::from_slice(&text).unwrap();
        let mut frames = Vec::new();
        for (name, camera) in &cameras {
            let stem = name.trim_end_matches(".exr");
            let picture = read_exr_layers(data.path(&format!("{split}/image/{name}"))).unwrap();
            let mask = image::open(data.path(&format!("{split}/mask/{stem}.png"))).unwrap().into_luma8();
            let png = image::RgbaImage::from_fn(SIZE, SIZE, |x, y| {
                let i = (y * SIZE + x) as usize;
                let coverage = f32::from(mask.get_pixel(x, y).0[0]) / 255.0;
                let straight = |c: &str| picture.channels[c][i] / coverage.max(1e-6);
                let color = glam::Vec3::from(["R", "G", "B"].map(straight));
                let [r, g, b] = lobelia::report::tone::srgb8(color);
                image::Rgba([r, g, b, mask.get_pixel(x, y).0[0]])
            });
            let file = format!("{split}/{stem}.png");
            crate::common::save_png(&folder.join(&file), &image::DynamicImage::ImageRgba8(png));
            frames.push(json!({
                "file_path": format!("./{split}/{stem}"),
                "transform_matrix": opengl_world_from_camera(&camera["W2C"]),
            }));
        }
        // All cameras have the same square pixels and angle.
        let focal = cameras.values().next().unwrap()["K"][0].as_f64().unwrap();
        let angle = 2.0 * (f64::from(SIZE) / 2.0 / focal).atan();
        let transforms = json!({ "camera_angle_x": angle, "frames": frames });
        std::fs::write(folder.join(format!("transforms_{split}.json")), transforms.to_string()).unwrap();
    }
    std::fs::copy(data.path("mesh.glb"), folder.join("mesh.glb")).unwrap();
}

fn opengl_world_from_camera(w2c: &Value) -> Vec<Vec<f64>> {
    let rows: [f64; 16] = serde_json::from_value(w2c.clone()).unwrap();
    let world_from_camera = glam::DMat4::from_cols_array(&rows).transpose().inverse();
    let flip = glam::DMat4::from_diagonal(glam::DVec4::new(1.0, -1.0, -1.0, 1.0));
    let rows = (world_from_camera * flip).transpose();
    let mut rows: Vec<Vec<f64>> = (0..4).map(|i| rows.col(i).to_array().to_vec()).collect();
    // Exactly so, whatever the inversion rounded to.
    rows[3] = vec![0.0, 0.0, 0.0, 1.0];
    rows
}

#[test]
fn both_layouts_of_the_same_photographs_give_nearly_the_same_object() {
    let data = Data::new();
    let nerf = tempfile::tempdir().unwrap();
    as_nerf(&data, nerf.path());
    let told = data.run(SHORT, "out", &["--quiet"]).succeeded();
    assert_eq!((told.stdout.as_str(), told.stderr.as_str()), ("", ""), "quiet is silent");
    let mut run = command(&["run", "--quiet"]);
    run.arg(data.path("scene.ron")).arg("--data").arg(nerf.path()).arg("--out").arg(data.path("nerf"));
    Outcome::of(&mut run).succeeded();
    let psnr = |out: &str| metrics(&data.path(out))["passes"]["novel"]["psnr"].as_f64().unwrap();
    let (physg, nerf) = (psnr("out"), psnr("nerf"));
    assert!(physg > 21.0 && (physg - nerf).abs() < 1.0, "PSNR {physg} and {nerf}");
}

#[cfg(unix)]
#[test]
fn ctrl_c_ends_a_fit_cleanly_and_keeps_it() {
    use std::time::{Duration, Instant};
    let data = Data::new();
    let scene = SHORT.replace("steps: 30", "steps: 4000000000");
    std::fs::write(data.path("scene.ron"), scene).unwrap();
    let out = data.path("out");
    let mut run = command(&["run", "--checkpoint", "0s"]);
    run.arg(data.path("scene.ron")).arg("--data").arg(data.root()).arg("--out").arg(&out);
    run.stdout(std::process::Stdio::piped()).stderr(std::process::Stdio::piped());
    let mut child = run.spawn().unwrap();
    let start = Instant::now();
    let patience = Duration::from_secs(60);
    let wait = || std::thread::sleep(Duration::from_millis(20));
    // A step that is kept says that the fit is at work, however busy the machine is.
    let is_step = |file: &String| file.ends_with(".state") && !file.ends_with("-0.state");
    while !files_below(&out.join(".checkpoint")).iter().any(is_step) && start.elapsed() < patience {
        wait();
    }
    assert!(child.try_wait().unwrap().is_none(), "the fit goes on");
    let id = child.id().to_string();
    assert!(std::process::Command::new("kill").args(["-INT", &id]).status().unwrap().success());
    while child.try_wait().unwrap().is_none() {
        if start.elapsed() > patience {
            child.kill().unwrap();
            panic!("the fit did not end");
        }
        wait();
    }
    let outcome = child.wait_with_output().unwrap();
    let [stdout, stderr] = [outcome.stdout, outcome.stderr].map(|bytes| String::from_utf8(bytes).unwrap());
    assert_eq!(outcome.status.code(), Some(130), "{stderr}");
    assert!(!stderr.contains("panicked"), "{stderr}");
    assert!(stdout.contains("stopped early"), "{stdout}");
    let files = files_below(&out);
    assert!(!files.iter().any(|file| is_temporary(file)), "{files:?}");
    for file in ["fit/albedo.png", "fit/environment.exr", "fit/light.npy", "fit/log.csv", "fit/materials.ron"]
    {
        assert!(files.iter().any(|f| f == file), "no {file} in {files:?}");
    }
    assert!(!files.iter().any(|file| file.starts_with("novel/")), "no pass follows: {files:?}");
    let report = String::from_utf8(read(out.join("report.html"))).unwrap();
    assert!(report.contains("s-interrupted") && report.contains("fit: recovered light"), "what there is");
    let light = lobelia::codec::npy::read_lobes(out.join("fit/light.npy"), Default::default()).unwrap();
    assert_eq!(light.len(), 6);
}

#[test]
fn eval_compares_two_folders() {
    let data = Data::new();
    data.run(SHORT, "out", &["--quiet"]).succeeded();
    let eval = |prediction: &str, truth: &str| {
        let mut command = command(&["eval"]);
        Outcome::of(command.arg(data.path(prediction)).arg(data.path(truth))).succeeded().stdout
    };
    let table = eval("out/novel", "test/image");
    assert!(table.contains("rgb_000000") && table.contains("rgb_000001"), "{table}");
    assert!(table.contains("sRGB: mask "), "{table}");
    // The photographs bear no alpha, so the mask is the prediction's own, which is the true one here.
    let psnr = metrics(&data.path("out"))["passes"]["novel"]["psnr"].as_f64().unwrap();
    assert!(table.contains(&format!("{psnr:.2}")), "no {psnr:.2} in\n{table}");
    let other = eval("test/gt/relit", "test/image");
    assert!(!other.contains(&format!("{psnr:.2}")), "{other}");
}

#[test]
fn the_version_is_one_line_with_the_commit_if_there_is_one() {
    let outcome = Outcome::of(&mut command(&["--version"])).succeeded();
    let version = concat!("lobelia ", env!("CARGO_PKG_VERSION"));
    let rest = outcome.stdout.trim_end().strip_prefix(version).unwrap();
    assert!(rest.is_empty() || (rest.starts_with(" (") && rest.ends_with(')')), "{rest}");
}
