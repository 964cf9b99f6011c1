//! Faults of masks.

use super::{expect, good, object, surveyed};
use crate::survey::look::OpenView;
use crate::survey::{Severity, Subject, examine};
use crate::view::Mask;
use glam::Vec3;

fn change(views: &mut [OpenView], change: impl Fn(f32) -> f32) {
    let masks = views.iter_mut().filter_map(|view| view.mask.as_mut());
    masks.for_each(|mask| mask.coverage.iter_mut().for_each(|coverage| *coverage = change(*coverage)));
}

#[test]
fn inverted_masks_are_named() {
    let mut views = good();
    change(&mut views, |coverage| 1.0 - coverage);
    for mesh in [Some(object()), None] {
        let survey = surveyed(&views, mesh.as_ref());
        let finding = survey.findings.iter().find(|finding| finding.name == "inverted-masks").unwrap();
        assert_eq!((finding.severity, finding.views.len()), (Severity::Error, views.len()), "{finding:?}");
        assert!(finding.help.contains("invert it"), "{finding:?}");
        assert_eq!(survey.findings.iter().filter(|finding| finding.severity == Severity::Error).count(), 1);
    }
    let mut one = good();
    change(&mut one[8..9], |coverage| 1.0 - coverage);
    let survey = surveyed(&one, Some(&object()));
    let finding = survey.findings.iter().find(|finding| finding.name == "inverted-masks").unwrap();
    assert_eq!((finding.severity, finding.views.as_slice()), (Severity::Error, &["v8".to_owned()][..]));
}

#[test]
fn masks_that_are_white_everywhere_are_named() {
    let mesh = object();
    let mut views = good();
    change(&mut views[..3], |_| 1.0);
    let survey = surveyed(&views, Some(&mesh));
    let named = survey.findings.iter().find(|finding| finding.name == "white-masks").unwrap();
    assert_eq!((named.severity, named.views.join(" ")), (Severity::Warning, "v0 v1 v2".to_owned()));
    assert_eq!(survey.findings_of(Severity::Error).count(), 0, "{:?}", survey.findings);
    change(&mut views, |_| 1.0);
    let survey = surveyed(&views, Some(&mesh));
    let first = &survey.findings[0];
    assert_eq!((first.name, first.severity), ("white-masks", Severity::Error), "{first:?}");
    assert!(first.problem.contains("no silhouette"), "{first:?}");
    assert_eq!(survey.findings_of(Severity::Error).count(), 1, "{:?}", survey.findings);
}

#[test]
fn masks_that_are_never_white_are_named() {
    let mut views = good();
    change(&mut views, |coverage| 127.0 / 255.0 * coverage);
    let survey = surveyed(&views, Some(&object()));
    let finding = &survey.findings[0];
    assert_eq!((finding.name, finding.severity), ("dim-masks", Severity::Error), "{finding:?}");
    assert!(finding.problem.contains("the highest value is 127 of 255"), "{finding:?}");
}

#[test]
fn soft_masks_are_warned_of_and_cannot_be_scored() {
    let mut views = good();
    let test = &mut views[22..23];
    change(test, |coverage| 0.95 * coverage);
    let survey = surveyed(&views, Some(&object()));
    let error = survey.findings_of(Severity::Error).next().unwrap();
    assert_eq!(
        (error.name, error.views.as_slice()),
        ("unscorable-masks", &["t2".to_owned()][..]),
        "{error:?}"
    );
    assert!(survey.findings_of(Severity::Warning).any(|warning| warning.name == "soft-masks"));
    // Nothing is scored: no error.
    let mesh = object();
    let subject =
        Subject { mesh: Some(&mesh), up: Vec3::Y, texture_size: 128, refined: false, scored: false };
    let survey = examine(super::looks(&views), &subject, &[]);
    assert_eq!(survey.findings_of(Severity::Error).count(), 0, "{:?}", survey.findings);
}

#[test]
fn missing_masks_are_named() {
    let mut views = good();
    views[23].mask = None;
    expect(
        &surveyed(&views, Some(&object())),
        "missing-masks",
        &["t3"],
        &["view `t3` (1 view of the test split)"],
    );
    views.iter_mut().for_each(|view| view.mask = None);
    let beside_mesh = surveyed(&views, Some(&object()));
    expect(&beside_mesh, "missing-masks", &[], &["no view has a mask"]);
    assert_eq!(beside_mesh.findings[0].severity, Severity::Warning, "a mesh needs no masks");
    let survey = surveyed(&views, None);
    expect(&survey, "masks", &[], &["at least three views with masks", "there are 0"]);
}

#[test]
fn an_object_that_most_frames_cut_is_warned_of() {
    let mut views = good();
    for view in &mut views {
        // A third of every frame is gone.
        let (width, height) = (view.camera.width, view.camera.height / 3);
        let keep = (width * height) as usize;
        view.camera.height = height;
        view.camera.center[1] -= height as f32;
        let cropped = |mask: &Mask| Mask { width, height, coverage: mask.coverage[keep..2 * keep].to_vec() };
        view.mask = view.mask.as_ref().map(cropped);
        let photograph = view.photograph.as_mut().unwrap();
        photograph.image.pixels = photograph.image.pixels[keep..2 * keep].to_vec();
        photograph.image.height = height;
        photograph.saturated.truncate(keep);
    }
    let survey = surveyed(&views, Some(&object()));
    expect(
        &survey,
        "cut",
        &survey.findings[0].views.iter().map(String::as_str).collect::<Vec<_>>(),
        &["the frame cuts the object"],
    );
    let without = surveyed(&views, None);
    assert!(without.findings.iter().any(|finding| finding.name == "cut" || finding.name == "masks"));
}

#[test]
fn a_mask_of_another_view_is_named_without_a_mesh_too() {
    let mut views = good();
    let width = views[9].camera.width;
    let spot = |i: u32| f32::from(u8::from((i % width) < 6 && i / width < 6));
    views[9].mask.as_mut().unwrap().coverage = (0..width * width).map(spot).collect();
    let survey = surveyed(&views, None);
    let finding = survey.findings.iter().find(|finding| finding.name == "masks").unwrap();
    assert!(finding.problem.contains("`v9`") && finding.severity == Severity::Error, "{finding:?}");
}

#[test]
fn a_texture_too_small_for_the_photographs_is_named() {
    let mesh = object();
    let subject = Subject { mesh: Some(&mesh), up: Vec3::Y, texture_size: 8, refined: false, scored: true };
    let survey = examine(super::looks(&good()), &subject, &[]);
    expect(&survey, "coarse-texture", &[], &["a texel of 8²", "texture_size: 1", "detail: true"]);
    let survey = examine(super::looks(&good()), &Subject { refined: true, ..subject }, &[]);
    assert!(survey.findings.iter().all(|finding| finding.name != "coarse-texture"), "the fit makes it finer");
}
