//! Results of a fit beside the material: the scale between light and albedo, the frame in which the
//! light stands still, turns of the object between rounds of photographs, lights of several rooms;
//! and maps of the user's own that help it.

use crate::common::*;
use glam::{EulerRot, Quat};
use lobelia::codec::npy::{NpyConvention, read_lobes};
use lobelia::{
    codec::exr_frame::read_frame, codec::gltf::export::write_glb, light::lobes_radiance, prelude::*,
};
use serde_json::Value;

/// A ball of two colors under one lamp at the side and a sky.
const SCENE: &str = r#"Scene(
    version: 1,
    surface: Sphere(radius: 0.9, texture_size: 32),
    views: Photographed(
        cameras: (count: 12, test: 2, size: 40),
        spp: 16,
        max_bounces: 1,
        truth: (
            albedo: Waves(colors: ((0.7, 0.3, 0.2), (0.2, 0.35, 0.6)), size: 0.9),
            specular: (albedo: (0.3, 0.3, 0.3), roughness: 0.3),
            TRUTH
            light: Lobes(lobes: [
                (axis: (0, 1, 0), sharpness: 0.7, amplitude: (0.4, 0.4, 0.4)),
                (axis: (0.8, 0.5, 0.4), sharpness: 20, amplitude: (4, 4, 4)),
            ]),
        ),
    ),
    light: Unknown(lobes: 32),
    ASSUMED
    passes: [
        Fit(name: "fit", steps: 200, batch: 1024),
        Render(name: "novel"),
        Evaluate(name: "scores", scores: [(pass: "novel", truth: Photographs)]),
        Save(name: "saved"),
    ],
)
"#;

/// The scene with these words about what is true and what is assumed, and with other words
/// replaced.
pub fn lamp(truth: &str, assumed: &str, words: &[(&str, &str)]) -> String {
    let text = words.iter().fold(SCENE.to_owned(), |text, (word, by)| changed(&text, word, by));
    text.replace("TRUTH", truth).replace("ASSUMED", assumed)
}

/// Runs it into `out`, in place of what was there.
fn fit(data: &Data, scene: &str) {
    data.run(scene, "out", &["--quiet", "--force"]).succeeded();
}

const FIT: &str = r#"Fit(name: "fit", steps: 60, batch: 512), "#;

fn numbers(list: &Value) -> [f64; 3] {
    [0, 1, 2].map(|c| list[c].as_f64().unwrap())
}

/// A reddish sphere in bluish light.
const REDDISH: [(&str, &str); 3] = [
    ("Waves(colors: ((0.7, 0.3, 0.2), (0.2, 0.35, 0.6)), size: 0.9)", "Constant(0.6, 0.35, 0.25)"),
    ("amplitude: (0.4, 0.4, 0.4)", "amplitude: (0.4, 0.45, 0.6)"),
    (
        "(axis: (0.8, 0.5, 0.4), sharpness: 20, amplitude: (4, 4, 4))",
        "(axis: (0.5, 0.6, 0.62), sharpness: 40, amplitude: (5, 6, 8)),
                (axis: (-0.8, 0.3, -0.3), sharpness: 30, amplitude: (2.5, 3, 4))",
    ),
];

#[test]
fn rules_hold_what_they_say_and_highlights_find_the_color() {
    let data = Data::bare();
    // Mean light and mean albedo that a fit ends with.
    let means = |scale: &str, steps: &str| {
        let words = [&REDDISH[..], &[("test: 2", "test: 1"), ("steps: 200", steps)]].concat();
        fit(&data, &lamp("", &format!("scale: {scale},"), &words));
        assert!(data.text("out/fit/materials.ron").contains("Scale "));
        let metrics = data.metrics("out");
        ["mean_light", "mean_albedo"].map(|name| numbers(&metrics["scale"][name]))
    };
    // What a rule fixes needs no long fit.
    let [light, _] = means("WhiteLight", "steps: 100");
    assert!((light[0] / light[2] - 1.0).abs() < 1e-3, "{light:?}");
    let [_, albedo] = means("MeanAlbedo(0.5, 0.3, 0.2)", "steps: 100");
    assert!((albedo[0] - 0.5).abs() < 1e-2 && (albedo[2] - 0.2).abs() < 1e-2, "{albedo:?}");
    // The truth: red over blue is 2.4 in the albedo.
    let [free, highlights] = ["Free", "Highlights()"].map(|scale| {
        let [_, albedo] = means(scale, "steps: 300");
        (albedo[0] / albedo[2] / 2.4).ln().abs()
    });
    assert!(highlights < 0.75 * free, "{highlights} {free}");
}

#[test]
fn the_frame_of_the_light_is_found_and_saved() {
    let data = Data::bare();
    for frame in ["World", "Camera", "Turntable(0, 1, 0)"] {
        fit(&data, &lamp(&format!("light_frame: {frame},"), "", &[]));
        let kind = frame.split('(').next().unwrap();
        let found = data.metrics("out")["light_frame"].as_str().unwrap().to_owned();
        assert!(found.starts_with(kind), "{frame}: {found}");
        assert!(data.text("out/saved/scene.ron").contains(&format!("light_frame: {kind}")));
        let least = if kind == "Turntable" { 0.0 } else { 32.0 };
        assert!(data.novel("out") > least, "{frame}: {}", data.novel("out"));
    }
    data.reopens("out");
}

#[test]
fn the_specular_lobe_starts_as_the_surface_looks() {
    let data = Data::bare();
    // Specular albedo and roughness after one step.
    let start = |lobe: &str| {
        let words = [("albedo: (0.3, 0.3, 0.3), roughness: 0.3", lobe), ("steps: 200", "steps: 1")];
        fit(&data, &lamp("", "", &words));
        let found = data.text("out/fit/materials.ron");
        ["(albedo: (", "roughness: "].map(|word| -> f64 {
            let (_, after) = found.split_once(word).unwrap();
            after.split([',', ')']).next().unwrap().parse().unwrap()
        })
    };
    let matte = start("albedo: (0.04, 0.04, 0.04), roughness: 0.8");
    assert!(matte[0] < 0.1 && matte[1] > 0.7, "{matte:?}");
    let glossy = start("albedo: (0.3, 0.3, 0.3), roughness: 0.3");
    assert!(glossy[0] > 0.2 && glossy[1] < 0.5, "{glossy:?}");
}

// Several rounds of photographs.

/// The scene in two rounds of photographs, with a mat ball and other colors of its light.
fn two_rounds(truth: &str) -> String {
    let words = [
        ("radius: 0.9", "radius: 0.8"),
        ("count: 12, test: 2, size: 40", "count: 24, test: 2, size: 48"),
        ("albedo: (0.3, 0.3, 0.3), roughness: 0.3", "albedo: (0.1, 0.1, 0.1), roughness: 0.4"),
        ("amplitude: (0.4, 0.4, 0.4)", "amplitude: (0.4, 0.45, 0.5)"),
        ("amplitude: (4, 4, 4)", "amplitude: (4, 4, 3)"),
        ("steps: 200", "steps: 300"),
    ];
    lamp(truth, "", &words)
}

fn turn(degrees: [f64; 3]) -> Quat {
    let [x, y, z] = degrees.map(|angle| (angle as f32).to_radians());
    Quat::from_euler(EulerRot::XYZEx, x, y, z)
}

#[test]
fn an_object_that_was_turned_over_is_found_to_be() {
    let data = Data::bare();
    let said = data.run(&two_rounds("placements: [(100, 20, 0)],"), "out", &[]).succeeded().stdout;
    assert!(said.contains("`round 2` shows the object turned by"), "{said}");
    let found = turn(numbers(&data.metrics("out")["placements"][0]["turned_degrees"]));
    let apart = found.angle_between(turn([100.0, 20.0, 0.0])).to_degrees();
    assert!(apart < 2.0, "{apart}°");
    assert!(data.novel("out") > 30.0, "{}", data.novel("out"));
}

/// A lamp at the right in one round, and a blue one at the left in another.
const OTHER_LIGHT: &str = r#"
            other_lights: [Lobes(lobes: [
                (axis: (0, 1, 0), sharpness: 0.7, amplitude: (0.3, 0.3, 0.3)),
                (axis: (-0.8, 0.2, 0.4), sharpness: 20, amplitude: (2, 3, 5)),
            ])],"#;

#[test]
fn photographs_of_two_rooms_have_two_lights_and_one_albedo() {
    let data = Data::bare();
    fit(&data, &changed(&two_rounds(OTHER_LIGHT), "Photographs)]", "Photographs)], albedo: SelfMade"));
    // Radiance toward both lamps.
    let [own, other] = ["light.npy", "light_2.npy"].map(|file| {
        let lobes = read_lobes(data.path("out/fit").join(file), NpyConvention::Lobelia).unwrap();
        let lamps = [Vec3::new(0.8, 0.5, 0.4), Vec3::new(-0.8, 0.2, 0.4)];
        lamps.map(|axis| lobes_radiance(&lobes, axis.normalize()))
    });
    assert!(own[0].x > 2.5 && own[1].x < 1.0, "{own:?}");
    assert!(other[1].z > 2.5 && other[0].x < 1.0 && other[1].z > 1.3 * other[1].x, "{other:?}");
    assert!(data.path("out/fit/environment_2.png").is_file());
    // Views of both rounds are held out.
    let albedo = data.metrics("out")["albedo_psnr"].as_f64().unwrap();
    assert!(data.novel("out") > 33.0 && albedo > 28.0, "{} {albedo}", data.novel("out"));
    assert!(data.text("out/report.html").contains("recovered light 2"));
}

/// A scene with these words about its photographs.
fn with_views(passes: &str, words: &str) -> String {
    scene(passes).replace(r#"Dataset(path: "$DATA")"#, &format!(r#"Dataset(path: "$DATA", {words})"#))
}

/// The scene of a data set whose first photograph of each split is of one placement, and the others
/// of another.
fn with_placements(second: &str, last: &str) -> String {
    let placements = format!(r#"placements: [(photographs: "rgb_000000"), (photographs: "rgb_", {second})]"#);
    with_views(&[FIT, NOVEL, last].concat(), &placements)
}

#[test]
fn a_saved_scene_shows_each_placement_and_each_light_as_it_was_found() {
    let data = Data::new();
    for second in ["turned_degrees: None", "turned_degrees: (0, 40, 0)", "light: Own"] {
        fit(&data, &with_placements(second, "Save()"));
        let saved = data.text("out/saved/scene.ron");
        if second == "light: Own" {
            assert!(saved.contains("light_2.npy"), "{saved}");
            data.reopens("out");
            continue;
        }
        let turned = ["turned_degrees: (", "turned_degrees: Some("].map(|words| saved.matches(words).count());
        assert_eq!(turned.iter().sum::<usize>(), 1, "{saved}");
        data.run_file("out/saved/scene.ron", "again", &["--quiet", "--force"]).succeeded();
        let apart = |view: usize| {
            let color = |out| read_frame(data.path(format!("{out}/novel/rgb_{view:06}.exr"))).unwrap().color;
            let (first, again): (Vec<Vec3>, Vec<Vec3>) = (color("out"), color("again"));
            first.iter().zip(&again).map(|(a, b)| a.distance(*b)).fold(0.0, f32::max)
        };
        // Angles that are written in degrees are rounded.
        assert!(apart(0) == 0.0 && apart(1) < 2e-3, "{} {}", apart(0), apart(1));
    }
}

#[test]
fn what_is_said_of_a_placement_holds() {
    let data = Data::new();
    // The photographs are of one placement.
    let [right, wrong] = ["(0, 0, 0)", "(0, 90, 0)"].map(|turned| {
        fit(&data, &with_placements(&format!("turned_degrees: {turned}"), SCORES));
        assert!(data.metrics("out")["placements"].is_null());
        data.novel("out")
    });
    assert!(right > wrong + 0.7, "{right} {wrong}");
}

#[test]
fn words_about_lights_and_placements_that_cannot_be_are_refused() {
    let data = Data::new();
    let assumed = |words: &str| lamp("", words, &[]);
    let (turned, own) = (with_placements("turned_degrees: None", ""), with_placements("light: Own", ""));
    let known = |word: &str| {
        format!("light: {word}(Lobes(lobes: [(axis: (0, 1, 0), sharpness: 1, amplitude: (1, 1, 1))]))")
    };
    let unknown = "light: Unknown(lobes: 6)";
    let first = |words: &str| format!(r#""rgb_000000", {words})"#);
    for (scene, words) in [
        (assumed("scale: MeanAlbedo(0.5, 0, 0.2),"), &["scale", "above 0"] as &[&str]),
        (assumed("scale: Highlights(white_light: -1),"), &["scale", "0 or more"]),
        (assumed("light_frame: Turntable(0, 0, 0),"), &["light_frame"]),
        (
            changed(&turned, r#"photographs: "rgb_","#, r#"photographs: "over_","#),
            &["`rgb_000001`", "none of the `placements`", "cam_dict_norm.json"],
        ),
        // All names begin with the first entry.
        (changed(&turned, "\"rgb_000000\"", "\"rgb\""), &["shows the placement `rgb_`"]),
        (
            changed(&turned, "\"rgb_000000\")", &first("turned_degrees: (1, 0, 0)")),
            &["turned_degrees is [1, 0, 0]", "relative to the first placement"],
        ),
        (changed(&own, "light: Own", &known("Fixed")), &["Own, as the scene's `light` is not known"]),
        (changed(&own, "\"rgb_000000\")", &first("light: Own")), &["the first placement is in"]),
        (changed(&own, unknown, &known("Initial")), &["Unknown(…) and not Initial(…)"]),
        (changed(&own, unknown, &known("Fixed")), &["Fixed(…), as the scene's `light` is known"]),
        (
            two_rounds(OTHER_LIGHT).replace("light: Unknown(lobes: 32)", &known("Fixed")),
            &["as there are `other_lights`"],
        ),
    ] {
        data.run(&scene, "out", &["--quiet"]).refused(words);
        assert!(!data.path("out").exists());
    }
}

// Prior maps of the user's own.

/// Maps of the training photographs: their albedo at `level` of the truth, and their normals in the
/// camera's axes.
fn write_maps(data: &Data, level: f32) {
    let mut studio = studio(&day());
    for (i, from) in TRAIN.into_iter().enumerate() {
        let camera = camera(from, SIZE);
        let frame = shoot(&mut studio, camera);
        let albedo: Vec<Vec3> = frame.albedo.iter().map(|albedo| *albedo * level).collect();
        write_image(&data.path(format!("albedo/rgb_{i:06}.exr")), &albedo, frame.width);
        let camera_from_world = camera.world_from_camera.matrix3.transpose();
        let axes = Vec3::new(1.0, -1.0, -1.0);
        let turn = |normal: &Vec3| (axes * (camera_from_world * *normal)).normalize_or_zero();
        let normals: Vec<Vec3> = frame.normal.iter().map(turn).collect();
        write_image(&data.path(format!("normals/rgb_{i:06}.exr")), &normals, frame.width);
    }
}

#[test]
fn a_fit_has_the_mean_color_of_the_albedo_maps_whatever_their_level() {
    let data = Data::new();
    // A fit that goes on keeps to the maps.
    let again = [FIT, &FIT.replace("\"fit\"", "\"again\"")].concat();
    let priors = r#"priors: (albedo: (folder: "$DATA/albedo"))"#;
    for (level, passes) in [(0.3, FIT), (1.0, &again)] {
        write_maps(&data, level);
        fit(&data, &with_views(passes, priors));
        let scale = &data.metrics("out")["scale"];
        assert!(scale["rule"].as_str().unwrap().starts_with("MeanAlbedo("), "{scale}");
        // Half the sphere is (0.6, 0.3, 0.2), half (0.2, 0.35, 0.5): the mean is (0.4, 0.325,
        // 0.35).
        let (mean, expected) = (numbers(&scale["mean_albedo"]), [0.4, 0.325, 0.35]);
        let gray = mean.iter().sum::<f64>() / 3.0;
        assert!((gray - 0.4).abs() < 0.01, "{mean:?}");
        for (mean, expected) in mean.into_iter().zip(expected) {
            assert!((mean / gray / (expected / 0.35833) - 1.0).abs() < 0.05, "{scale}");
        }
    }
    assert!(data.text("out/run.json").contains("albedo/rgb_000003.exr"), "maps are inputs");
    // A rule that the scene says goes before the maps.
    fit(&data, &with_views(FIT, priors).replace("light:", "scale: WhiteLight, light:"));
    assert_eq!(data.metrics("out")["scale"]["rule"], "WhiteLight");
}

#[test]
fn normals_smooth_a_mesh_whose_bumps_photographs_hardly_show() {
    let data = Data::new();
    let mut mesh = sphere_mesh(Vec3::ZERO, RADIUS).unwrap();
    let bump = |at: &Vec3| 1.0 + 0.01 * (14.0 * at.x).sin() * (14.0 * at.y).sin();
    mesh.positions.iter_mut().for_each(|at| *at *= bump(at));
    mesh.normals = mesh.smooth_normals();
    write_glb(&data.path("mesh.glb"), &mesh, None).unwrap();
    let passes = r#"Fit(name: "fit", steps: 150, batch: 512, vertices: true), Render(name: "novel"),
        Evaluate(name: "scores", scores: [(pass: "novel", truth: Photographs)], normal: Folder("$DATA/test/gt"))"#;
    let with = |words: &str| {
        with_views(passes, &format!(r#"priors: (normals: (folder: "$DATA/normals", {words}))"#))
    };
    data.run(&with(""), "none", &["--quiet"]).refused(&["normals: there is no such folder"]);
    write_maps(&data, 1.0);
    data.run(&with("axes: World, weight: -1"), "none", &["--quiet"]).refused(&["weight"]);
    let [free, held] = ["0", "1"].map(|weight| {
        fit(&data, &with(&format!("weight: {weight}")));
        data.metrics("out")["normal_deg"].as_f64().unwrap()
    });
    assert!(held < 0.8 * free, "{free} {held}");
}
