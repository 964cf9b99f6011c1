//! A whole run on small data: every pass, every file, the same bytes again, stopping it, and the
//! other commands.

use crate::common::{DISTANCE, Data, RADIUS, SIZE, TEST, camera, files_below, is_temporary, scene};
use serde_json::{Value, json};
use std::sync::LazyLock;

/// Everything at once. The gloss edit is on the half with x ≥ 0 only.
const PASSES: &str = r#"
        Fit(name: "fit", steps: 100, batch: 512),
        Render(name: "novel"),
        Edit(name: "gloss", edits: [
            Roughness(action: Set(0.08), region: Box(min: (0, -2, -2), max: (2, 2, 2))),
            Specular(action: Set(0.9, 0.6, 0.3), region: Box(min: (0, -2, -2), max: (2, 2, 2))),
        ]),
        Render(name: "after"),
        Render(name: "published", render: (shading: Published)),
        Relight(name: "relit", light: Npy(path: "$DATA/evening.npy")),
        Render(name: "traced", render: (views: Named(["rgb_000001"]), shading: PathTraced(spp: 4))),
        Evaluate(name: "scores", scores: [
            (pass: "novel", truth: Photographs),
            (pass: "relit", truth: Folder("$DATA/test/gt/relit"), scale: PerChannel),
            (pass: "gloss", truth: Photographs, scale: PerLayer),
            (pass: "published", truth: Photographs),
        ], albedo: Folder("$DATA/test/gt"), normal: Folder("$DATA/test/gt"), mesh: "$DATA/mesh.glb"),
        Save(name: "saved"),
        Export(name: "export"),
    "#;

const CHANNELS: &str = "A B G R albedo.B albedo.G albedo.R depth.Z diffuse.B diffuse.G diffuse.R \
    normal.X normal.Y normal.Z specular.B specular.G specular.R";
/// The files of its run, besides those of the passes that show all test views.
const FILES: &str = "
    export/light.hdr export/light_blender.hdr export/mesh.glb export/model-viewer.html
    fit/albedo.exr fit/albedo.png fit/environment.exr fit/environment.png fit/light.npy fit/log.csv
    fit/materials.ron fit/seen.png metrics.json report.html run.json
    saved/albedo.exr saved/light.npy saved/mesh.glb saved/scene.ron scores/contact_sheet.png scores/views.csv
    traced/test_rgb_000001.exr traced/test_rgb_000001.png traced/train_rgb_000001.exr traced/train_rgb_000001.png";

/// Expects that two runs wrote the same files with the same bytes, but for times and memory.
#[track_caller]
fn same_bytes(data: &Data, a: &str, b: &str) {
    let files = files_below(&data.path(a));
    assert_eq!(files, files_below(&data.path(b)));
    // The contact sheet bears the name of the output folder, the saved scene the data's path, which
    // is the same here.
    let timed = ["metrics.json", "run.json", "report.html", "fit/log.csv", "scores/contact_sheet.png"];
    for file in files.iter().filter(|file| !timed.contains(&file.as_str())) {
        assert!(data.bytes(format!("{a}/{file}")) == data.bytes(format!("{b}/{file}")), "{file} differs");
    }
    let [a, b] = [a, b].map(|out| {
        let mut metrics = data.metrics(out);
        (metrics["fit_secs"], metrics["peak_rss_mib"]) = (json!(0), json!(0));
        metrics
    });
    assert_eq!(a, b);
}

/// The run of everything into `out` with two threads, and what it said. Its scene file stays as it
/// is.
pub static WHOLE: LazyLock<(Data, String)> = LazyLock::new(|| {
    let data = Data::shared("whole");
    let scene = scene(PASSES).replace("size: 16", "size: 32").replace("lobes: 6", "lobes: 12");
    let said = data.run(&scene.replace("version: 1,", "version: 1, seed: 3,"), "out", &["--threads", "2"]);
    (data, said.succeeded().stdout)
});

#[test]
fn a_whole_run_writes_everything() {
    let (data, said) = &*WHOLE;
    let out = data.path("out");
    let files = files_below(&out);
    assert!(!files.iter().any(|file| is_temporary(file)), "{files:?}");
    let mut expected: Vec<String> = FILES.split_whitespace().map(str::to_owned).collect();
    for pass in ["after", "gloss", "novel", "published", "relit"] {
        for view in ["rgb_000000", "rgb_000001"] {
            expected.extend(["exr", "png"].map(|kind| format!("{pass}/{view}.{kind}")));
            if pass != "after" {
                let parts = ["truth", "render", "error"];
                expected.extend(parts.map(|part| format!("scores/{pass}/{view}_{part}.jpg")));
            }
        }
    }
    expected.sort();
    assert_eq!(files, expected);
    check_pictures(data);
    check_metrics(&data.metrics("out"), said);
    check_log(&data.text("out/fit/log.csv"));
    check_region(data);
}

/// All layers, the right size, color as the sum of its parts, on black.
fn check_pictures(data: &Data) {
    for file in ["novel/rgb_000000", "gloss/rgb_000001", "relit/rgb_000000", "traced/test_rgb_000001"] {
        let picture = data.exr(format!("out/{file}.exr"));
        assert!(picture.channels.keys().eq(CHANNELS.split_whitespace().collect::<Vec<_>>()), "{file}");
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
                let depth = at("depth.Z", i);
                let near = DISTANCE - RADIUS - 1e-3;
                assert!((near..DISTANCE).contains(&depth), "{file}: depth {depth} of pixel {i}");
                assert!((length - 1.0).abs() < 1e-4, "{file}: normal of pixel {i} is {length} long");
            }
        }
    }
}

/// How high the scores are is in the table of scores.
fn check_metrics(metrics: &Value, table: &str) {
    let value = |key: &str| {
        metrics.pointer(key).and_then(Value::as_f64).unwrap_or_else(|| panic!("{key}: {metrics}"))
    };
    for pass in ["novel", "relit", "gloss"] {
        for key in ["psnr", "psnr_raw", "ssim"] {
            value(&format!("/passes/{pass}/{key}"));
        }
        assert!(table.contains(pass), "{table}");
    }
    for key in ["/albedo_psnr", "/normal_median_deg", "/normal_pixels"] {
        value(key);
    }
    assert!(value("/fit_secs") > 0.0 && (1.0..2048.0).contains(&value("/peak_rss_mib")), "{metrics}");
    // The surface is the true one; pixels are the mean of four normals.
    assert!(value("/normal_deg") < 0.1, "{metrics}");
    // Another light shows in the pictures: they are not the photographs under the old one.
    assert!(value("/passes/gloss/psnr_raw") < value("/passes/novel/psnr_raw") - 1.0, "{metrics}");
}

/// The loss goes down.
fn check_log(log: &str) {
    let (head, lines) = log.split_once('\n').unwrap();
    assert_eq!(head, "step,elapsed_secs,loss,psnr,specular_r,specular_g,specular_b,roughness,lobes");
    let row = |line: &str| -> Vec<f64> { line.split(',').map(|n| n.parse().unwrap()).collect() };
    let rows: Vec<Vec<f64>> = lines.lines().map(row).collect();
    assert_eq!(rows.iter().map(|row| row[0]).collect::<Vec<_>>(), [20.0, 40.0, 60.0, 80.0, 100.0]);
    let (first, last) = (&rows[0], &rows[4]);
    assert!(last[2] < 0.9 * first[2] && last[3] > first[3], "the loss goes from {} to {}", first[2], last[2]);
}

/// The edit of one half changes that half and nothing else, and later passes see the material as it
/// was.
fn check_region(data: &Data) {
    for (view, from) in ["rgb_000000", "rgb_000001"].into_iter().zip(TEST) {
        let picture = |pass: &str| data.exr(format!("out/{pass}/{view}.exr"));
        let (novel, gloss, after) = (picture("novel"), picture("gloss"), picture("after"));
        assert_eq!(novel, after, "{view}");
        let camera = camera(from, SIZE);
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
    let (data, _) = &*WHOLE;
    let told = data.run_file("scene.ron", "one", &["--threads", "1", "--quiet", "--force"]).succeeded();
    assert_eq!((told.stdout.as_str(), told.stderr.as_str()), ("", ""), "quiet is silent");
    same_bytes(data, "out", "one");
    let fit = r#"passes=[Fit(name: "fit", steps: 100, batch: 512)]"#;
    data.run_file("scene.ron", "other", &["--set", fit, "--quiet", "--seed", "4"]).succeeded();
    let light = |out: &str| data.bytes(format!("{out}/fit/light.npy"));
    assert_ne!(light("out"), light("other"), "another seed visits the pixels in another order");
}

#[test]
fn a_saved_object_opens_again_with_the_same_bits() {
    let (data, _) = &*WHOLE;
    data.reopens("out");
    data.same_pictures("out/after", "again/after");
    data.same_pictures("out/traced", "again/traced");
    let saved = data.text("out/saved/scene.ron");
    assert!(!saved.contains("Unknown") && !saved.contains("Fit("), "{saved}");
}

#[test]
fn eval_compares_two_folders() {
    let (data, _) = &*WHOLE;
    let eval = |prediction: &str, truth: &str| data.lobelia(&["eval", prediction, truth]).succeeded().stdout;
    let table = eval("out/novel", "test/image");
    assert!(table.contains("rgb_000000") && table.contains("rgb_000001"), "{table}");
    assert!(table.contains("sRGB: mask "), "{table}");
    // The photographs bear no alpha, so the mask is the prediction's own, which is the true one
    // here.
    let psnr = data.novel("out");
    assert!(table.contains(&format!("{psnr:.2}")), "no {psnr:.2} in\n{table}");
    let other = eval("test/gt/relit", "test/image");
    assert!(!other.contains(&format!("{psnr:.2}")), "{other}");
}

#[test]
fn the_version_is_one_line_with_the_commit_if_there_is_one() {
    let said = Data::bare().lobelia(&["--version"]).succeeded().stdout;
    let version = concat!("lobelia ", env!("CARGO_PKG_VERSION"));
    let rest = said.trim_end().strip_prefix(version).unwrap();
    assert!(rest.is_empty() || (rest.starts_with(" (") && rest.ends_with(')')), "{rest}");
}
