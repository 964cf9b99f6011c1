//! Faults of single photographs.

use super::{expect, good, looks, object, surveyed};
use crate::survey::look::OpenView;
use crate::survey::photographs::compare;
use crate::survey::sharpness::Sharpness;
use crate::survey::{Severity, Survey};
use crate::view::Placement;
use glam::Vec3;

/// A survey of good views after a change of one photograph's pixels.
fn changed(view: usize, change: impl Fn(Vec3) -> Vec3) -> Survey {
    let mut views = good();
    pixels(&mut views[view]).iter_mut().for_each(|pixel| *pixel = change(*pixel));
    surveyed(&views, Some(&object()))
}

fn pixels(view: &mut OpenView) -> &mut Vec<Vec3> {
    &mut view.photograph.as_mut().unwrap().image.pixels
}

#[test]
fn photographs_without_light_or_with_too_much_are_named() {
    let black = changed(4, |_| Vec3::ZERO);
    expect(&black, "black", &["v4"], &["black where the object is, in view `v4`", "select"]);
    assert_eq!(black.findings[0].severity, Severity::Error);
    assert!(black.findings[0].to_error().exit_code() == 2);
    // A lens cap lets a little noise through.
    expect(&changed(4, |pixel| pixel * 1e-4), "black", &["v4"], &["`v4`"]);
}

#[test]
fn a_whole_photograph_in_another_unit_is_absurdly_bright() {
    let survey = changed(9, |pixel| pixel * 1e5);
    assert_eq!(survey.findings[0].name, "absurdly-bright");
    assert_eq!(survey.findings[0].views, ["v9"]);
}

#[test]
fn a_few_pixels_that_outshine_all_others_are_named() {
    let mut views = good();
    let side = views[4].camera.width as usize;
    let middle = side * (side / 2) + side / 2;
    pixels(&mut views[4])[middle..middle + 6].fill(Vec3::splat(1e5));
    let survey = surveyed(&views, Some(&object()));
    expect(&survey, "glaring-pixels", &["v4"], &["times brighter", "select"]);
    assert_eq!(survey.findings[0].severity, Severity::Warning);
}

#[test]
fn another_exposure_is_named_with_its_stops() {
    let survey = changed(5, |pixel| pixel * 8.0);
    expect(&survey, "exposure", &["v5"], &["`v5` is 3.", "stops brighter", "exposure: Color"]);
    assert_eq!(survey.findings[0].severity, Severity::Warning);
    expect(&changed(5, |pixel| pixel / 8.0), "exposure", &["v5"], &["stops darker"]);
    assert_eq!(changed(5, |pixel| pixel * 1.3).findings, []);
}

#[test]
fn photographs_of_another_placement_are_in_another_light() {
    let mut views = good();
    for view in [2, 5, 8] {
        pixels(&mut views[view]).iter_mut().for_each(|pixel| *pixel *= 8.0);
    }
    assert!(!surveyed(&views, Some(&object())).findings.is_empty());
    for view in [2, 5, 8] {
        views[view].placement = Placement(1);
    }
    assert_eq!(surveyed(&views, Some(&object())).findings, []);
    // Beside those of its own placement one is too dark.
    pixels(&mut views[5]).iter_mut().for_each(|pixel| *pixel *= 1e-4);
    expect(&surveyed(&views, Some(&object())), "black", &["v5"], &["black where the object is"]);
}

/// Good views, of which that of index 11 is the mean of itself moved by each step.
fn blurred(steps: &[[i64; 2]]) -> Survey {
    let mut views = good();
    let side = i64::from(views[11].camera.width);
    let sharp = pixels(&mut views[11]).clone();
    let mean = |i: usize| {
        let (x, y) = (i as i64 % side, i as i64 / side);
        let tap = |[dx, dy]: [i64; 2]| {
            let (x, y) = ((x + dx).clamp(0, side - 1), (y + dy).clamp(0, side - 1));
            sharp[(y * side + x) as usize]
        };
        steps.iter().map(|step| tap(*step)).sum::<Vec3>() / steps.len() as f32
    };
    *pixels(&mut views[11]) = (0..sharp.len()).map(mean).collect();
    surveyed(&views, Some(&object()))
}

#[test]
fn a_blurred_view_is_named() {
    let square: Vec<[i64; 2]> = (-2..=2).flat_map(|dy| (-2..=2).map(move |dx| [dx, dy])).collect();
    let motion: Vec<[i64; 2]> = (-4..=4).map(|dx| [dx, 0]).collect();
    for steps in [square, motion] {
        expect(&blurred(&steps), "blurred", &["v11"], &["looks blurred", "view `v11`"]);
    }
}

fn evenly(sharpness: f32) -> Sharpness {
    Sharpness { everywhere: sharpness, least: sharpness }
}

#[test]
fn a_blurred_view_is_named_among_few_that_differ_much() {
    let mut looks = looks(&good()[..16]);
    let directions: Vec<Vec3> = (0..16u8)
        .map(|i| {
            let (s, c) = (f32::from(i) * std::f32::consts::TAU / 16.0).sin_cos();
            Vec3::new(s, c, 0.0)
        })
        .collect();
    for (i, look) in looks.iter_mut().enumerate() {
        look.light.as_mut().unwrap().sharpness = Some(evenly(if i % 2 == 0 { 1.0 } else { 2.2 }));
    }
    let blurred = |looks: &[crate::survey::ViewLook]| {
        let (_, findings) = compare(looks, &directions, &[false; 16]);
        findings.into_iter().find(|finding| finding.name == "blurred").map(|finding| finding.views)
    };
    assert_eq!(blurred(&looks), None);
    looks[5].light.as_mut().unwrap().sharpness = Some(evenly(0.11));
    assert_eq!(blurred(&looks), Some(vec!["v5".to_owned()]));
    // One of several that differ more and more is not apart.
    looks[12].light.as_mut().unwrap().sharpness = Some(evenly(0.6));
    assert_eq!(blurred(&looks).map(|views| views.len()), Some(1));
    looks[12].light.as_mut().unwrap().sharpness = Some(evenly(0.46));
    assert_eq!(blurred(&looks), None);
}

#[test]
fn clipped_and_negative_pixels_are_warned_of() {
    let mut views = good();
    views[2].photograph.as_mut().unwrap().saturated.fill(true);
    expect(&surveyed(&views, Some(&object())), "clipped", &["v2"], &["clipped in view `v2`"]);
    let mut views = good();
    views[2].negative = 0.05;
    expect(
        &surveyed(&views, Some(&object())),
        "negative-pixels",
        &["v2"],
        &["are negative, and set to 0, in view `v2`"],
    );
}

#[test]
fn the_same_photograph_twice_is_named() {
    let mut views = good();
    let mut copy = views[6].clone();
    copy.name = "t9".into();
    copy.split = views[21].split;
    views.push(copy);
    expect(
        &surveyed(&views, Some(&object())),
        "duplicates",
        &["v6", "t9"],
        &["the same photograph", "`v6`, `t9`"],
    );
}

#[test]
fn views_of_one_name_in_both_splits_are_told_apart() {
    let mut views = good();
    views[20].name = "v4".into();
    pixels(&mut views[4]).fill(Vec3::ZERO);
    let survey = surveyed(&views, Some(&object()));
    expect(&survey, "black", &["train/v4"], &["view `train/v4`"]);
    assert_eq!((survey.flags("test/v4").len(), survey.flags("train/v4").len()), (0, 1));
}

#[test]
fn few_views_are_not_compared_and_cameras_alone_have_no_light() {
    let mut views = good();
    pixels(&mut views[1]).iter_mut().for_each(|pixel| *pixel *= 8.0);
    let few = surveyed(&views[..5], Some(&object()));
    assert!(few.findings.is_empty() && few.compared.iter().all(|compared| compared.stops.is_none()));
    views.iter_mut().for_each(|view| (view.photograph, view.mask) = (None, None));
    let bare = surveyed(&views, Some(&object()));
    assert!(bare.findings.is_empty() && bare.arrangement.is_some(), "{:?}", bare.findings);
}

#[test]
fn an_orientation_that_is_ignored_is_warned_of() {
    let mut views = good();
    views[3].exif = [3, 1];
    views[7].exif = [6, 6];
    let survey = surveyed(&views, Some(&object()));
    expect(&survey, "exif-orientation", &["v3", "v7"], &["`v3`, `v7`; 1 of their masks", "auto-orient"]);
    assert_eq!(survey.findings[0].severity, Severity::Warning);
}
