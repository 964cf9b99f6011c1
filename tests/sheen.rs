//! A surface whose diffuse albedo depends on the angle of view: shown alike by both kinds of shading, found by a fit if the
//! photographs say so, saved and opened again.

use crate::common::{Outcome, camera, command, day, photographs_of, shoot, studio};
use lobelia::codec::exr::read_exr_layers;
use lobelia::fit::components::{TexelSeen, Unknowns};
use lobelia::fit::run::Initialize;
use lobelia::material::sheen::{KnownAlong, write_albedo};
use lobelia::pipeline::pool::{read_column, write_column};
use lobelia::prelude::*;
use std::ops::ControlFlow;

/// Red along the surface.
const SHEEN: DiffuseSheen = DiffuseSheen(Vec3::new(0.35, -0.1, -0.1));

/// The studio, with a sheen or without, and hardly any specular light.
fn cloth(sheen: DiffuseSheen) -> Pipeline {
    let mut pipeline = studio(&day());
    let count = read_column::<TexelIndex, DiffuseAlbedo>(&mut pipeline.world).unwrap().len();
    write_column::<TexelIndex, DiffuseSheen>(&mut pipeline.world, &vec![sheen; count]).unwrap();
    pipeline
}

/// A fit of the albedo of twelve photographs under the known light; returns the mean sheen of the texels that were seen.
fn found(truth: DiffuseSheen) -> Vec3 {
    let mut truth = cloth(truth);
    let mut pipeline = studio(&day());
    pipeline.add_plugin(&FitPlugin);
    let views = photographs_of(&mut truth, 12, 48, |_, _| {});
    spawn_views(&mut pipeline.world, views);
    let unknowns = Unknowns { light: false, specular_albedo: false, roughness: false, ..Unknowns::default() };
    let options =
        FitOptions { steps: 240, batch: 1024, unknowns, looks_for_sheen: true, ..FitOptions::default() };
    run_fit(&mut pipeline, &options, &mut |_, _| ControlFlow::Continue(())).unwrap();
    let sheen = read_column::<TexelIndex, DiffuseSheen>(&mut pipeline.world).unwrap();
    let moved: Vec<Vec3> = sheen.iter().map(|sheen| sheen.0).filter(|sheen| *sheen != Vec3::ZERO).collect();
    moved.iter().sum::<Vec3>() / moved.len().max(1) as f32
}

#[test]
fn a_fit_finds_a_sheen_and_none_where_there_is_none() {
    let red = found(SHEEN);
    assert!((red - SHEEN.0).length() < 0.15, "{red}");
    assert_eq!(found(DiffuseSheen::default()), Vec3::ZERO);
}

#[test]
fn closed_form_and_path_tracer_show_the_same_sheen() {
    let mut pipeline = cloth(SHEEN);
    let view = camera([0.2, 0.3, 1.0], 24);
    let closed = shoot(&mut pipeline, view);
    let plain = shoot(&mut cloth(DiffuseSheen::default()), view);
    let paths = PathTracing { paths_per_sample: 64, max_bounces: 1, seed: 1, samples_per_pixel: 4 };
    pipeline.swap(Phase::Frame, Slot::Shading, shade_path_traced(paths));
    let traced = shoot(&mut pipeline, view);
    let total = |frame: &[Vec3]| frame.iter().map(|color| color.element_sum()).sum::<f32>();
    let red = |frame: &[Vec3]| frame.iter().map(|color| color.x).sum::<f32>();
    assert!((total(&closed.color) / total(&traced.color) - 1.0).abs() < 0.03);
    assert!((red(&closed.color) / red(&traced.color) - 1.0).abs() < 0.03);
    assert!(red(&closed.color) > 1.1 * red(&plain.color));
}

const SCENE: &str = r#"Scene(
    version: 1,
    surface: Sphere(radius: 0.9, texture_size: 32),
    views: Cameras([(name: "front", eye: (0, 0.5, 3), fov_degrees: 38, width: 32, height: 32)]),
    light: Fixed(Lobes(lobes: [(axis: (0, 0.6, 0.8), sharpness: 1, amplitude: (1, 1, 1))])),
    material: (
        albedo: Fixed(Constant(0.2, 0.3, 0.4)),
        sheen: Fixed(Constant(0.7, 0.3, 0.1)),
        specular: (albedo: Fixed(0.05, 0.05, 0.05), roughness: Fixed(0.5)),
    ),
    passes: [Render(name: "novel"), Save(name: "saved")],
)
"#;

#[test]
fn a_saved_sheen_opens_with_the_same_bits() {
    let folder = tempfile::tempdir().unwrap();
    let (scene, out, again) =
        (folder.path().join("scene.ron"), folder.path().join("out"), folder.path().join("again"));
    std::fs::write(&scene, SCENE).unwrap();
    for (scene, out) in [(&scene, &out), (&out.join("saved/scene.ron"), &again)] {
        Outcome::of(command(&["run", "--quiet"]).arg(scene).arg("--out").arg(out)).succeeded();
    }
    let along = read_exr_layers(out.join("saved/albedo_along.exr")).unwrap();
    assert!((along.channels["R"][40] - 0.7).abs() < 1e-6);
    let pictures = [&out, &again].map(|out| {
        let mut files = std::fs::read_dir(out.join("novel")).unwrap().map(|entry| entry.unwrap().path());
        std::fs::read(files.find(|path| path.extension().is_some_and(|e| e == "exr")).unwrap()).unwrap()
    });
    assert!(pictures[0] == pictures[1], "the saved object looks different");
}

#[test]
fn an_unknown_sheen_beside_a_known_albedo_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let scene = folder.path().join("scene.ron");
    std::fs::write(&scene, SCENE.replace("sheen: Fixed(Constant(0.7, 0.3, 0.1))", "sheen: Unknown")).unwrap();
    let outcome = Outcome::of(command(&["check"]).arg(&scene));
    assert_eq!(outcome.code, Some(2));
    assert!(
        outcome.stderr.contains("sheen: Unknown") && outcome.stderr.contains("a fit finds both together")
    );
}

#[test]
fn an_unknown_albedo_is_fitted_beside_a_known_one_along_the_surface() {
    let mut truth = cloth(SHEEN);
    let mut pipeline = studio(&day());
    pipeline.add_plugin(&FitPlugin);
    let views = photographs_of(&mut truth, 12, 48, |_, _| {});
    spawn_views(&mut pipeline.world, views);
    let world = &mut pipeline.world;
    let albedo = read_column::<TexelIndex, DiffuseAlbedo>(world).unwrap();
    let along: Vec<Vec3> = albedo.iter().map(|albedo| albedo.0 + SHEEN.0).collect();
    world.insert_resource(KnownAlong::Texels(along.clone()));
    write_albedo(world, vec![Vec3::splat(0.4); albedo.len()]).unwrap();
    let unknowns = Unknowns { light: false, specular_albedo: false, roughness: false, ..Unknowns::default() };
    let options = FitOptions {
        steps: 240,
        batch: 1024,
        unknowns,
        initialize: Initialize { light: false, albedo: true, specular: false },
        ..FitOptions::default()
    };
    run_fit(&mut pipeline, &options, &mut |_, _| ControlFlow::Continue(())).unwrap();
    let world = &mut pipeline.world;
    let found = read_column::<TexelIndex, DiffuseAlbedo>(world).unwrap();
    let sheen = read_column::<TexelIndex, DiffuseSheen>(world).unwrap();
    assert!((0..along.len()).all(|i| (found[i].0 + sheen[i].0).abs_diff_eq(along[i], 1e-6)));
    let seen = read_column::<TexelIndex, TexelSeen>(world).unwrap();
    let off: Vec<f32> = (0..along.len())
        .filter(|i| seen[*i].0 > 1.0)
        .map(|i| (found[i].0 - albedo[i].0).abs().max_element())
        .collect();
    let mean = off.iter().sum::<f32>() / off.len() as f32;
    assert!(off.len() > 100 && mean < 0.03, "{mean} over {}", off.len());
}

#[test]
fn a_fit_of_a_scene_keeps_a_known_albedo_along_the_surface() {
    let folder = tempfile::tempdir().unwrap();
    let scene = folder.path().join("scene.ron");
    let text = r#"Scene(version: 1, surface: Sphere(radius: 0.9, texture_size: 32),
        views: Photographed(cameras: (count: 4, test: 1, size: 24), spp: 4, truth: (albedo: Constant(0.2, 0.3, 0.4),
            specular: (albedo: (0.05, 0.05, 0.05), roughness: 0.5),
            light: Lobes(lobes: [(axis: (0, 0.6, 0.8), sharpness: 1, amplitude: (1, 1, 1))]))),
        light: Unknown(lobes: 6), material: (sheen: Fixed(Constant(0.7, 0.3, 0.1))), passes: [Fit(name: "fit", steps: 30, batch: 256)])"#;
    std::fs::write(&scene, text).unwrap();
    let out = folder.path().join("out");
    Outcome::of(command(&["run", "--quiet"]).arg(&scene).arg("--out").arg(&out)).succeeded();
    let along = read_exr_layers(out.join("fit/albedo_along.exr")).unwrap();
    for (channel, expected) in [("R", 0.7), ("G", 0.3), ("B", 0.1)] {
        let off = along.channels[channel].iter().map(|found| (found - expected).abs()).fold(0.0, f32::max);
        assert!(off < 1e-3, "{channel}: off by {off}");
    }
}
