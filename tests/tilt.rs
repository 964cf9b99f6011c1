//! A surface that is brighter from one side: shown alike by both kinds of shading, found from photographs, edited, saved and opened
//! again.

use crate::common::{Data, Outcome, camera, command, day, photographs_of, scene, shoot, studio};
use lobelia::codec::exr::read_exr_layers;
use lobelia::codec::npy::{NpyConvention, write_lobes};
use lobelia::fit::components::TexelSeen;
use lobelia::fit::detail::{DetailOptions, solve_detail};
use lobelia::material::edit::{EditRegion, apply_edit};
use lobelia::material::shown::recovered_material;
use lobelia::pipeline::pool::{read_column, write_column};
use lobelia::prelude::*;

/// Brighter from +X.
const TILT: DiffuseTilt = DiffuseTilt(Vec3::new(0.5, 0.0, 0.0));

/// The studio with one albedo and this tilt.
fn velvet(tilt: DiffuseTilt) -> Pipeline {
    let mut pipeline = studio(&day());
    let count = read_column::<TexelIndex, DiffuseAlbedo>(&mut pipeline.world).unwrap().len();
    let albedo = DiffuseAlbedo(Vec3::new(0.5, 0.4, 0.3));
    write_column::<TexelIndex, DiffuseAlbedo>(&mut pipeline.world, &vec![albedo; count]).unwrap();
    write_column::<TexelIndex, DiffuseTilt>(&mut pipeline.world, &vec![tilt; count]).unwrap();
    pipeline
}

fn total(frame: &Frame) -> f32 {
    frame.color.iter().map(|color| color.element_sum()).sum()
}

#[test]
fn closed_form_and_path_tracer_show_the_same_tilt() {
    for (eye, brighter) in [([1.0, 0.2, 0.4], true), ([-1.0, 0.2, 0.4], false)] {
        let (mut pipeline, view) = (velvet(TILT), camera(eye, 24));
        let closed = total(&shoot(&mut pipeline, view));
        let plain = total(&shoot(&mut velvet(DiffuseTilt::default()), view));
        let paths = PathTracing { paths_per_sample: 64, max_bounces: 1, seed: 1, samples_per_pixel: 4 };
        pipeline.swap(Phase::Frame, Slot::Shading, shade_path_traced(paths));
        let traced = total(&shoot(&mut pipeline, view));
        assert!((closed / traced - 1.0).abs() < 0.03, "{closed} {traced}");
        let factor = closed / plain;
        assert!(if brighter { factor > 1.03 } else { factor < 0.97 }, "{factor}");
    }
}

/// How much darker the surface is from one side than from the other, after its albedo is found from photographs.
fn darker_from_the_left(truth: DiffuseTilt, tilt: bool) -> f32 {
    let mut pipeline = velvet(DiffuseTilt::default());
    pipeline.add_plugin(&FitPlugin);
    for texel in lobelia::material::texels_in_order(&mut pipeline.world) {
        pipeline.world.entity_mut(texel).insert(TexelSeen::default());
    }
    let views = photographs_of(&mut velvet(truth), 40, 48, |_, _| {});
    spawn_views(&mut pipeline.world, views);
    let options = DetailOptions { form: ClosedForm::default(), visibility: false, tilt, metal: false };
    solve_detail(&mut pipeline, options, &mut |_| ()).unwrap();
    sides(&mut pipeline)
}

/// The light from the left over that from the right.
fn sides(pipeline: &mut Pipeline) -> f32 {
    let [left, right] = [-1.0, 1.0].map(|x| total(&shoot(pipeline, camera([x, 0.2, 0.4], 24))));
    left / right
}

#[test]
fn all_photographs_together_tell_the_tilt() {
    let [truth, plain] = [TILT, DiffuseTilt::default()].map(|tilt| sides(&mut velvet(tilt)));
    assert!(truth < 0.9 * plain, "{truth} {plain}");
    let tilted = darker_from_the_left(TILT, true);
    assert!((tilted / truth - 1.0).abs() < 0.03, "{tilted} {truth}");
    let none = darker_from_the_left(DiffuseTilt::default(), true);
    assert!((none / plain - 1.0).abs() < 0.01, "{none} {plain}");
    let unasked = darker_from_the_left(TILT, false);
    assert!(unasked > 1.05 * truth, "{unasked} {truth}");
}

#[test]
fn an_edit_of_the_color_leaves_as_much_tilt_as_it_leaves_color() {
    let material = recovered_material(&mut velvet(TILT).world).unwrap();
    let after = |action: EditAction| {
        let mut state = material.clone();
        apply_edit(&mut state, EditTarget::Diffuse, &action, &EditRegion(None)).unwrap();
        state.tilt[7].0
    };
    assert_eq!(after(EditAction::Scale(Vec3::splat(0.5))), TILT.0);
    assert_eq!(after(EditAction::Blend { value: Vec3::ONE, weight: 0.75 }), 0.25 * TILT.0);
    assert_eq!(after(EditAction::Set(Vec3::X)), Vec3::ZERO);
}

/// A fit with `detail` to photographs of a tilted surface; the text of what it saves.
fn fitted(data: &Data, tilt: &str) -> String {
    let passes = r#"Fit(name: "fit", steps: 60, batch: 1024, detail: true), Render(name: "novel"), Save(name: "saved")"#;
    let scene = scene(passes)
        .replace("light: Unknown(lobes: 6)", r#"light: Fixed(Npy(path: "$DATA/day.npy"))"#)
        .replace("passes:", &format!("material: (tilt: {tilt}), passes:"));
    data.run(&scene, tilt, &["--quiet"]).succeeded();
    std::fs::read_to_string(data.path(tilt).join("saved/scene.ron")).unwrap()
}

#[test]
fn a_saved_tilt_opens_with_the_same_bits_and_none_is_saved_where_none_is_wanted() {
    let data = Data::new();
    data.photograph(&mut velvet(TILT), 48);
    write_lobes(data.path("day.npy"), &day(), NpyConvention::Lobelia).unwrap();
    let saved = fitted(&data, "Unknown");
    assert!(saved.contains(r#"tilt: Fixed("albedo_tilt.exr")"#), "{saved}");
    let vectors = read_exr_layers(data.path("Unknown/saved/albedo_tilt.exr")).unwrap();
    assert!(vectors.channels["X"].iter().any(|x| *x > 0.2));
    let run = ["run", "--quiet", "--allow-outside"];
    let (scene, again) = (data.path("Unknown/saved/scene.ron"), data.path("again"));
    Outcome::of(command(&run).arg(&scene).arg("--out").arg(&again)).succeeded();
    let read = |out: &str| std::fs::read(data.path(out).join("novel/rgb_000000.exr")).unwrap();
    assert!(read("Unknown") == read("again"), "the saved object looks different");
    // A file of another kind is named.
    std::fs::copy(data.path("Unknown/saved/albedo.exr"), data.path("Unknown/saved/albedo_tilt.exr")).unwrap();
    let outcome = Outcome::of(command(&run).arg(&scene).arg("--out").arg(data.path("bad")));
    assert_eq!(outcome.code, Some(2));
    assert!(outcome.stderr.contains("albedo_tilt.exr") && outcome.stderr.contains("has no channel X"));
    assert!(!fitted(&data, "None").contains("albedo_tilt.exr"));
}

#[test]
fn a_known_tilt_beside_an_unknown_albedo_is_refused() {
    let data = Data::new();
    let text =
        scene(r#"Fit(name: "fit")"#).replace("passes:", r#"material: (tilt: Fixed("t.exr")), passes:"#);
    let path = data.path("scene.ron");
    std::fs::write(&path, text).unwrap();
    let outcome = Outcome::of(command(&["check"]).arg(&path));
    assert_eq!(outcome.code, Some(2));
    assert!(outcome.stderr.contains("the tilt is said to be known"), "{}", outcome.stderr);
}
