//! Scores of pictures that need no fit: in sRGB, and of normals.

use crate::common::{Data, SIZE};
use lobelia::codec::exr::read_exr_layers;
use serde_json::Value;

/// A gray sphere under the other light.
const SCENE: &str = r#"Scene(
    version: 1,
    surface: Mesh(path: "$DATA/mesh.glb", texture_size: 16),
    views: Dataset(path: "$DATA"),
    light: Fixed(Npy(path: "$DATA/evening.npy")),
    material: (albedo: Fixed(Constant(0.4, 0.4, 0.4)), specular: (albedo: Fixed(0.2, 0.2, 0.2), roughness: Fixed(0.3))),
    passes: [
        Render(name: "novel"),
        Relight(name: "relit", light: Npy(path: "$DATA/evening.npy")),
        Evaluate(
            scores: [
                (pass: "novel", truth: Photographs, scale: PerChannel),
                (pass: "relit", truth: Folder("$DATA/test/gt/relit")),
            ],
            normal: Folder("$DATA/test/gt"),
        ),
    ],
)
"#;

fn metrics(data: &Data, out: &str) -> Value {
    serde_json::from_slice(&std::fs::read(data.path(out).join("metrics.json")).unwrap()).unwrap()
}

#[test]
fn passes_against_photographs_have_srgb_scores() {
    let data = Data::new();
    let table = data.run(SCENE, "out", &[]).succeeded().stdout;
    let metrics = metrics(&data, "out");
    let passes = &metrics["passes"];
    for scores in [&passes["novel"]["srgb"], &passes["novel"]["views"][1]["srgb"]] {
        let value = |key: &str| scores[key].as_f64().unwrap_or_else(|| panic!("no {key} in {scores}"));
        // Around the object nothing is wrong; its outline is right, so the background makes no difference to errors.
        assert!(value("psnr_mask") > 5.0 && value("psnr_mask") + 1.0 < value("psnr_white"), "{scores}");
        assert!((value("psnr_white") - value("psnr_black")).abs() < 0.5, "{scores}");
        assert!(
            ["ssim_white", "ssim_black"].iter().all(|key| value(key) > 0.1 && value(key) < 1.0),
            "{scores}"
        );
    }
    assert!(passes["relit"].get("srgb").is_none(), "{metrics}");
    let psnr = passes["novel"]["srgb"]["psnr_white"].as_f64().unwrap();
    assert!(table.contains("white dB") && table.contains(&format!("{psnr:.2}")), "{table}");
}

#[test]
fn normals_of_pngs_are_scored_where_they_are_positive() {
    let data = Data::new();
    data.run(SCENE, "out", &["--quiet"]).succeeded();
    let whole = metrics(&data, "out");
    for view in ["000000", "000001"] {
        let exr = data.path(&format!("test/gt/normal_{view}.exr"));
        let normals = read_exr_layers(&exr).unwrap();
        let png = image::RgbImage::from_fn(SIZE, SIZE, |x, y| {
            let at = |c: &str| normals.channels[c][(y * SIZE + x) as usize].max(0.0);
            image::Rgb(lobelia::report::tone::srgb8(glam::Vec3::from(["R", "G", "B"].map(at))))
        });
        let path = data.path(&format!("test/gt/rgb_{view}_normal.png"));
        crate::common::save_png(&path, &image::DynamicImage::ImageRgb8(png));
        std::fs::remove_file(exr).unwrap();
    }
    data.run(SCENE, "png", &["--quiet"]).succeeded();
    let positive = metrics(&data, "png");
    let value = |metrics: &Value, key: &str| metrics[key].as_f64().unwrap();
    assert!(value(&whole, "normal_deg") < 0.1 && value(&whole, "normal_median_deg") < 0.1, "{whole}");
    // Rounded to 8 bits.
    assert!(
        value(&positive, "normal_deg") < 0.5 && value(&positive, "normal_median_deg") < 0.5,
        "{positive}"
    );
    let (all, known) = (value(&whole, "normal_pixels"), value(&positive, "normal_pixels"));
    assert!(known > 20.0 && known < 0.6 * all, "{known} of {all}");
    std::fs::remove_file(data.path("test/gt/rgb_000001_normal.png")).unwrap();
    let refused = data.run(SCENE, "none", &["--quiet"]);
    assert_eq!(refused.code, Some(2), "{}", refused.stderr);
    assert!(refused.stderr.contains("rgb_000001_normal.png"), "{}", refused.stderr);
}

/// Rows of a `views.csv`.
fn rows(data: &Data, table: &str) -> Vec<csv::StringRecord> {
    let text = std::fs::read_to_string(data.path(table)).unwrap();
    csv::Reader::from_reader(text.as_bytes()).records().map(|row| row.unwrap()).collect()
}

#[test]
fn a_view_is_reported_as_itself_and_by_the_evaluation_that_scored_it() {
    let data = Data::new();
    // Training and test views have the same names, and nothing was fitted to the first.
    let second =
        r#"    Evaluate(name: "again", scores: [(pass: "relit", truth: Folder("$DATA/test/gt/relit"))]), ]"#;
    let scene = SCENE.replace("\n    ]", second);
    data.run(&scene, "out", &["--quiet"]).succeeded();
    let [first, again] = ["scores", "again"].map(|pass| rows(&data, &format!("out/{pass}/views.csv")));
    let named = |rows: &[csv::StringRecord]| -> Vec<[String; 2]> {
        rows.iter().map(|row| [row[0].to_owned(), row[1].to_owned()]).collect()
    };
    assert_eq!(named(&first), [["rgb_000000", "test"], ["rgb_000001", "test"]]);
    assert_eq!(named(&again), named(&first));
    let metrics = metrics(&data, "out");
    for (rows, pass) in [(first, "novel"), (again, "relit")] {
        for (i, row) in rows.iter().enumerate() {
            let psnr = metrics["passes"][pass]["views"][i]["psnr"].as_f64().unwrap();
            assert!((row[5].parse::<f64>().unwrap() - psnr).abs() < 1e-3, "{pass}: {row:?}, {psnr}");
        }
    }
    assert_eq!(metrics["views"].as_array().unwrap().len(), 2);
}

#[test]
fn outliers_are_those_of_the_picture_that_is_scored() {
    let data = Data::new();
    // The photographs are the object's own under a quarter of its light.
    let scene = |scale: &str| {
        let light = |scale: f32| format!(r#"Npy(path: "$DATA/evening.npy", scale: {scale})"#);
        format!(
            r#"Scene(version: 1, surface: Sphere(radius: 0.8, texture_size: 16),
            views: Photographed(cameras: (count: 2, test: 1, size: 24), spp: 64, truth: (albedo: Constant(0.4, 0.4, 0.4),
                specular: (albedo: (0.2, 0.2, 0.2), roughness: 0.3), light: {})),
            light: Fixed({}),
            material: (albedo: Fixed(Constant(0.4, 0.4, 0.4)), specular: (albedo: Fixed(0.2, 0.2, 0.2), roughness: Fixed(0.3))),
            passes: [Render(name: "novel"), Evaluate(scores: [(pass: "novel", truth: Photographs, scale: {scale})])])"#,
            light(0.25),
            light(1.0)
        )
    };
    for (scale, range) in [("None", 0.3..1.01), ("PerChannel", 0.0..0.1), ("PerLayer", 0.0..0.1)] {
        data.run(&scene(scale), scale, &["--quiet"]).succeeded();
        let outliers: f64 = rows(&data, &format!("{scale}/scores/views.csv"))[0][6].parse().unwrap();
        assert!(range.contains(&outliers), "{scale}: {outliers}");
    }
}
