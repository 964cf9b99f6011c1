//! A texture that is made as fine as the photographs, and solved for from all their pixels.

use crate::common::{Data, Outcome, camera, command, day, painted_studio, photographs_of, scene, studio};
use lobelia::codec::npy::{NpyConvention, write_lobes};
use lobelia::fit::components::TexelSeen;
use lobelia::fit::detail::{DetailOptions, solve_detail};
use lobelia::pipeline::pool::{read_column, write_column};
use lobelia::prelude::*;
use lobelia::view::Camera;

/// Photographs of stripes as wide as three pixels, for texels that are several pixels wide.
fn stripes() -> Data {
    let data = Data::new();
    let color = |at: &Vec3| {
        if (at.y / 0.05).rem_euclid(2.0) < 1.0 { Vec3::new(0.7, 0.2, 0.2) } else { Vec3::new(0.2, 0.3, 0.7) }
    };
    data.photograph(&mut painted_studio(&day(), 256, color), 120);
    write_lobes(data.path("day.npy"), &day(), NpyConvention::Lobelia).unwrap();
    data
}

/// PSNR of the novel views, and the saved scene.
fn fitted(data: &Data, detail: bool) -> (f64, String) {
    let passes = format!(
        r#"Fit(name: "fit", steps: 100, batch: 2048, detail: {detail}), Render(name: "novel"),
           Evaluate(name: "scores", scores: [(pass: "novel", truth: Photographs)]), Save(name: "saved")"#
    );
    let scene =
        scene(&passes).replace("light: Unknown(lobes: 6)", r#"light: Fixed(Npy(path: "$DATA/day.npy"))"#);
    let out = format!("{detail}");
    data.run(&scene, &out, &["--quiet"]).succeeded();
    let read = |file: &str| std::fs::read_to_string(data.path(&out).join(file)).unwrap();
    let metrics: serde_json::Value = serde_json::from_str(&read("metrics.json")).unwrap();
    (metrics["passes"]["novel"]["psnr"].as_f64().unwrap(), read("saved/scene.ron"))
}

#[test]
fn a_finer_texture_shows_what_the_photographs_show() {
    let data = stripes();
    let (coarse, saved) = fitted(&data, false);
    assert!(saved.contains("texture_size: 16"), "{saved}");
    let (fine, saved) = fitted(&data, true);
    assert!(fine > coarse + 3.0, "{coarse} {fine}");
    assert!(!saved.contains("texture_size: 16,") && saved.contains("texture_size: "), "{saved}");
    // What was saved is rendered again from the finer texture.
    let again = data.path("again");
    let saved = data.path("true/saved/scene.ron");
    let run = ["run", "--quiet", "--allow-outside"];
    Outcome::of(command(&run).arg(saved).arg("--out").arg(&again)).succeeded();
    for name in ["rgb_000000.exr", "rgb_000001.exr"] {
        let read = |out: &str| std::fs::read(data.path(out).join("novel").join(name)).unwrap();
        assert!(read("true") == read("again"), "{name}");
    }
}

/// The studio with gray texels, and photographs of it with `albedo`, of which view 0 is `spoiled`.
fn gray_studio(albedo: Vec3, spoiled: impl Fn(Vec3) -> Vec3) -> Pipeline {
    let mut truth = studio(&day());
    let count = read_column::<TexelIndex, DiffuseAlbedo>(&mut truth.world).unwrap().len();
    write_column::<TexelIndex, DiffuseAlbedo>(&mut truth.world, &vec![DiffuseAlbedo(albedo); count]).unwrap();
    let mut pipeline = studio(&day());
    pipeline.add_plugin(&FitPlugin);
    let gray = vec![DiffuseAlbedo(Vec3::splat(0.4)); count];
    write_column::<TexelIndex, DiffuseAlbedo>(&mut pipeline.world, &gray).unwrap();
    for texel in lobelia::material::texels_in_order(&mut pipeline.world) {
        pipeline.world.entity_mut(texel).insert(TexelSeen::default());
    }
    let spoil = |number: usize, frame: &mut Frame| {
        if number == 0 {
            frame.color.iter_mut().for_each(|color| *color = spoiled(*color));
        }
    };
    let views = photographs_of(&mut truth, 12, 48, spoil);
    spawn_views(&mut pipeline.world, views);
    pipeline
}

/// The albedo of the texels that are well seen; those that no view sees stay as they were.
fn solved(mut pipeline: Pipeline) -> Vec<Vec3> {
    let options = DetailOptions { form: ClosedForm::default(), visibility: false, tilt: false, metal: false };
    let mut done = 0.0;
    solve_detail(&mut pipeline, options, &mut |part| done = part).unwrap();
    assert_eq!(done, 1.0);
    let albedo = read_column::<TexelIndex, DiffuseAlbedo>(&mut pipeline.world).unwrap();
    let seen = read_column::<TexelIndex, TexelSeen>(&mut pipeline.world).unwrap();
    for (albedo, _) in albedo.iter().zip(&seen).filter(|(_, seen)| seen.0 == 0.0) {
        assert_eq!(albedo.0, Vec3::splat(0.4), "a texel that no view sees");
    }
    albedo.iter().zip(&seen).filter(|(_, seen)| seen.0 > 4.0).map(|(albedo, _)| albedo.0).collect()
}

#[test]
fn the_albedo_is_that_of_the_photographs() {
    for truth in [Vec3::new(0.7, 0.3, 0.1), Vec3::ONE, Vec3::ZERO] {
        let found = solved(gray_studio(truth, |color| color));
        assert!(found.len() > 100, "{}", found.len());
        let off = found.iter().map(|found| (*found - truth).abs().max_element()).fold(0.0, f32::max);
        assert!(off < 0.02, "{truth}: off by {off}");
    }
}

#[test]
fn a_photograph_that_disagrees_with_the_others_counts_less() {
    let truth = Vec3::new(0.5, 0.3, 0.2);
    let spoiled = solved(gray_studio(truth, |color| color + 4.0));
    let mean = |found: &[Vec3]| found.iter().sum::<Vec3>() / found.len() as f32;
    // The plain mean of some four photographs of a texel is off by a quarter of what one of them is off.
    assert!((mean(&spoiled) - truth).length() < 0.04, "{}", mean(&spoiled));
}

#[test]
fn a_camera_that_sees_nothing_is_no_error() {
    let mut pipeline = gray_studio(Vec3::splat(0.6), |color| color);
    let mut cameras = pipeline.world.query::<&mut Camera>();
    for mut seen in cameras.iter_mut(&mut pipeline.world) {
        *seen = camera([0.0, 0.0, 1.0], 48);
    }
    assert!(solved(pipeline).iter().all(|albedo| albedo.is_finite()));
}
