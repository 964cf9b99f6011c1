//! Without a mesh: single cameras that are wrong, and photographs in another order.

use super::{VIEWS, expect, good, looks, surveyed, views_of};
use crate::math::statistics::median;
use crate::mesh::primitive::box_mesh;
use crate::mesh::triangles::Mesh;
use crate::survey::Severity;
use crate::survey::look::{OpenView, SmallMask};
use crate::survey::mask_hull::{CELLS, FINE_CELLS, FORGIVEN, uncovered};
use glam::{Affine3A, Mat3A, Quat, Vec3};

/// The views with the cameras of others: training view `i` gets that of `from(i)`.
fn with_cameras_of(from: impl Fn(usize) -> usize) -> Vec<OpenView> {
    let (all, mut views) = (good(), good());
    for (i, view) in views.iter_mut().enumerate().take(VIEWS[0]) {
        view.camera = all[from(i)].camera;
    }
    views
}

fn swapped(i: usize, pairs: &[[usize; 2]]) -> usize {
    let other = pairs.iter().find_map(|[a, b]| if *a == i { Some(*b) } else { (*b == i).then_some(*a) });
    other.unwrap_or(i)
}

#[test]
fn two_exchanged_photographs_are_named() {
    let survey = surveyed(&with_cameras_of(|i| swapped(i, &[[3, 12]])), None);
    let finding = &survey.findings[0];
    let mut views = finding.views.clone();
    views.sort();
    assert_eq!(
        (finding.name, views.join(" ")),
        ("stray-view", "v12 v3".to_owned()),
        "{:#?}",
        survey.findings
    );
    assert_eq!((survey.findings.len(), finding.severity), (1, Severity::Warning), "{:#?}", survey.findings);
    assert!(finding.help.contains("exchanged"), "{finding:?}");
}

#[test]
fn more_than_a_few_exchanged_photographs_are_an_error() {
    let pairs = [[3, 12], [5, 16]];
    let survey = surveyed(&with_cameras_of(|i| swapped(i, &pairs)), None);
    let finding = &survey.findings[0];
    assert_eq!((finding.name, finding.severity), ("stray-view", Severity::Error), "{:#?}", survey.findings);
    let mut views = finding.views.clone();
    views.sort();
    assert_eq!(views.join(" "), "v12 v16 v3 v5");
}

#[test]
fn a_camera_that_is_moved_around_the_object_is_named() {
    let mut views = good();
    let turn = Affine3A::from_mat3(Mat3A::from_rotation_y(40f32.to_radians()).into());
    let pose = &mut views[7].camera.world_from_camera;
    *pose = turn * *pose;
    expect(&surveyed(&views, None), "stray-view", &["v7"], &["disagrees with the other views in view `v7`"]);
}

#[test]
fn another_order_of_the_photographs_is_named() {
    let count = VIEWS[0];
    let named = |views: &[OpenView], word: &str| {
        expect(&surveyed(views, None), "other-order", &[], &[word, "the n-th camera"]);
    };
    named(&with_cameras_of(|i| count - 1 - i), "in the reverse order of the cameras");
    named(&with_cameras_of(|i| (i + count - 2) % count), "has the camera of the one 2 places before it");
    named(&with_cameras_of(|i| (i + 1) % count), "has the camera of the one 1 place after it");
}

#[test]
fn photographs_in_no_order_at_all_are_an_error() {
    let survey = surveyed(&with_cameras_of(|i| (7 * i + 3) % VIEWS[0]), None);
    let finding = &survey.findings[0];
    assert_eq!(
        (finding.name, finding.severity),
        ("inconsistent-masks", Severity::Error),
        "{:#?}",
        survey.findings
    );
    assert!(finding.problem.contains("the cameras do not fit the photographs"), "{finding:?}");
}

/// A plate that is tilted about two axes.
fn plate(tilt: f32, thickness: f32) -> Mesh {
    let mut mesh = box_mesh(Vec3::ZERO, Vec3::new(1.5, thickness, 1.4)).unwrap();
    let turn = Quat::from_rotation_x(tilt) * Quat::from_rotation_z(0.7 * tilt);
    mesh.positions.iter_mut().chain(&mut mesh.normals).for_each(|vector| *vector = turn * *vector);
    mesh
}

#[test]
fn a_plate_thinner_than_coarse_cells_is_sound() {
    let views = views_of(&plate(0.4, 0.04));
    let masks: Vec<SmallMask> = looks(&views).into_iter().map(|look| look.mask.unwrap().small).collect();
    let middle = |cells| median(&mut uncovered(&masks, &vec![true; masks.len()], FORGIVEN, cells)).unwrap();
    assert!(middle(CELLS) > 0.01 && middle(FINE_CELLS) < 0.002, "{} {}", middle(CELLS), middle(FINE_CELLS));
    assert_eq!(surveyed(&views, None).findings, []);
}

/// Few views, so that a part of the object that one mask lacks is taken from all.
fn few() -> Vec<OpenView> {
    let views = good().into_iter().enumerate().filter(|(i, _)| i % 3 != 2);
    views.map(|(_, view)| view).collect()
}

#[test]
fn one_mask_that_lacks_half_of_the_object_is_named_alone() {
    assert_eq!(surveyed(&few(), None).findings, []);
    let mut views = few();
    let at = views.iter().position(|view| view.name == "v7").unwrap();
    let mask = views[at].mask.as_mut().unwrap();
    let half = mask.coverage.len() / 2;
    mask.coverage[half..].fill(0.0);
    let survey = surveyed(&views, None);
    expect(
        &survey,
        "stray-view",
        &["v7"],
        &["disagrees with the other views in view `v7`", "outside the mask"],
    );
    assert_eq!(survey.findings[0].severity, Severity::Error);
    assert!(survey.mask_uncovered.iter().all(|share| share.unwrap() < 0.02), "{:?}", survey.mask_uncovered);
}

#[test]
fn one_mask_of_a_few_pixels_is_named_alone() {
    let mut views = few();
    let at = views.iter().position(|view| view.name == "v7").unwrap();
    let mask = views[at].mask.as_mut().unwrap();
    let (width, middle) = (mask.width as usize, mask.coverage.len() / 2 + mask.width as usize / 2);
    mask.coverage.fill(0.0);
    [0, 1, width, width + 1].into_iter().for_each(|beyond| mask.coverage[middle + beyond] = 1.0);
    let survey = surveyed(&views, None);
    let errors: Vec<_> = survey.findings_of(Severity::Error).collect();
    assert!(
        !errors.is_empty() && errors.iter().all(|error| error.problem.contains("view `v7`")),
        "{errors:#?}"
    );
}
