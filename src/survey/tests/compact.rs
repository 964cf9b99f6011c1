//! A compact object with a known mesh: whatever is wrong with it, silhouettes overlap for the most part.

use super::{camera, expect, joined, photographed, surveyed};
use crate::math::fibonacci::fibonacci_axes;
use crate::mesh::bvh::TriangleBvh;
use crate::mesh::primitive::{box_mesh, sphere_mesh};
use crate::mesh::triangles::Mesh;
use crate::survey::look::OpenView;
use crate::survey::{Severity, Survey};
use crate::view::Split;
use glam::Vec3;

fn ball() -> Mesh {
    sphere_mesh(Vec3::ZERO, 0.62).unwrap()
}

fn nose() -> Mesh {
    box_mesh(Vec3::new(-0.2, -0.1, 0.48), Vec3::new(0.35, 0.3, 0.4)).unwrap()
}

/// A ball with a knob and a nose.
fn compact() -> Mesh {
    joined([ball(), box_mesh(Vec3::new(0.36, 0.36, 0.15), Vec3::splat(0.3)).unwrap(), nose()])
}

fn moved(change: impl Fn(Vec3) -> Vec3) -> Mesh {
    let mut mesh = compact();
    mesh.positions.iter_mut().for_each(|position| *position = change(*position));
    mesh
}

/// Training views of it; view `i` gets the camera of view `from(i)`.
fn views(from: impl Fn(usize) -> usize) -> Vec<OpenView> {
    let bvh = TriangleBvh::new(&compact());
    let cameras: Vec<_> = fibonacci_axes(20).into_iter().map(camera).collect();
    let seen = |i: usize| {
        let mut view = photographed(&format!("v{i}"), Split::Train, cameras[i], &bvh);
        view.camera = cameras[from(i)];
        view
    };
    (0..cameras.len()).map(seen).collect()
}

/// The median overlap, which must be one that looks fine.
#[track_caller]
fn covers(survey: &Survey) {
    let mut all: Vec<f32> = survey.mesh_iou.iter().flatten().copied().collect();
    all.sort_by(f32::total_cmp);
    assert!(all[all.len() / 2] > 0.75, "{all:?}");
}

#[test]
fn right_views_and_those_of_a_slightly_other_mesh_are_fine() {
    assert_eq!(surveyed(&views(|i| i), Some(&compact())).findings, []);
    assert_eq!(surveyed(&views(|i| i), Some(&moved(|p| p * 1.01))).findings, []);
    let dented = moved(|p| Vec3::new(p.x.min(0.55), p.y, p.z));
    assert_eq!(surveyed(&views(|i| i), Some(&dented)).findings, []);
}

#[test]
fn other_axes_are_named_though_silhouettes_overlap() {
    let mut mirrored = views(|i| i);
    for view in &mut mirrored {
        let width = view.camera.width as usize;
        view.mask.as_mut().unwrap().coverage.chunks_mut(width).for_each(<[f32]>::reverse);
    }
    let survey = surveyed(&mirrored, Some(&compact()));
    covers(&survey);
    expect(&survey, "other-axes", &[], &["mirrored left to right"]);
    let survey = surveyed(&views(|i| i), Some(&moved(|p| Vec3::new(p.x, -p.z, p.y))));
    covers(&survey);
    expect(&survey, "other-axes", &[], &["the mesh has +Z up, the cameras have +Y up"]);
}

#[test]
fn another_order_is_named_though_silhouettes_overlap() {
    let survey = surveyed(&views(|i| 19 - i), Some(&compact()));
    covers(&survey);
    expect(&survey, "other-order", &[], &["in the reverse order of the cameras"]);
    let survey = surveyed(&views(|i| (i + 15) % 20), Some(&compact()));
    covers(&survey);
    expect(&survey, "other-order", &[], &["5 places before it"]);
}

#[test]
fn another_size_is_named_though_silhouettes_overlap() {
    for (factor, words) in [(1.1, "times too large"), (0.9, "times too small")] {
        let survey = surveyed(&views(|i| i), Some(&moved(|p| p * factor)));
        covers(&survey);
        let finding = &survey.findings[0];
        let names_size = finding.problem.contains("the mesh is 1.") && finding.problem.contains(words);
        assert!(names_size, "{finding:?}");
        assert_eq!(
            (survey.findings.len(), finding.severity),
            (1, Severity::Warning),
            "{:#?}",
            survey.findings
        );
    }
}

#[test]
fn two_exchanged_cameras_are_named_though_silhouettes_overlap() {
    let exchanged = |i: usize| match i {
        4 => 7,
        7 => 4,
        i => i,
    };
    let survey = surveyed(&views(exchanged), Some(&compact()));
    let finding = &survey.findings[0];
    let mut named = finding.views.clone();
    named.sort();
    assert_eq!((finding.name, named.join(" ")), ("stray-view", "v4 v7".to_owned()), "{:?}", survey.mesh_iou);
    let of_named =
        |view: &str| survey.looks.iter().position(|look| look.name == view).and_then(|i| survey.mesh_iou[i]);
    assert!(["v4", "v7"].iter().all(|view| of_named(view) > Some(0.75)), "{:?}", survey.mesh_iou);
}

#[test]
fn parts_that_only_one_of_both_has_are_named() {
    let without_knob = joined([ball(), nose()]);
    let survey = surveyed(&views(|i| i), Some(&without_knob));
    covers(&survey);
    let finding = &survey.findings[0];
    assert!(finding.name == "other-parts" && finding.views.len() >= 5, "{:#?}", survey.findings);
    assert!(finding.problem.starts_with("the mesh lacks parts"), "{finding:?}");
    let with_more = joined([compact(), box_mesh(Vec3::new(0.0, -0.7, 0.0), Vec3::splat(0.4)).unwrap()]);
    let survey = surveyed(&views(|i| i), Some(&with_more));
    covers(&survey);
    let finding = &survey.findings[0];
    assert_eq!(finding.name, "other-parts", "{:#?}", survey.findings);
    assert!(finding.problem.starts_with("the mesh has parts"), "{finding:?}");
}
