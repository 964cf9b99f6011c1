//! How cameras lie, and turntables.

use super::{camera, expect, good, looks, object, surveyed};
use crate::math::fibonacci::fibonacci_axes;
use crate::survey::cameras::{Arrangement, ArrangementKind};
use crate::survey::look::OpenView;
use crate::survey::turntable::{Background, is_turntable, sameness};
use crate::view::{Camera, Placement, Split};
use glam::Vec3;

fn seen(i: usize, direction: Vec3) -> OpenView {
    OpenView {
        name: format!("v{i}"),
        split: Split::Train,
        camera: camera(direction.normalize()),
        photograph: None,
        mask: None,
        placement: Placement::default(),
        negative: 0.0,
        exif: [1; 2],
    }
}

fn arrangement(directions: impl IntoIterator<Item = Vec3>) -> Arrangement {
    let views: Vec<OpenView> =
        directions.into_iter().enumerate().map(|(i, direction)| seen(i, direction)).collect();
    Arrangement::new(&looks(&views), None, Vec3::Y).unwrap()
}

fn ring(count: usize, height: f32) -> impl Iterator<Item = Vec3> {
    (0..count).map(move |i| {
        let (sin, cos) = (std::f32::consts::TAU * i as f32 / count as f32).sin_cos();
        Vec3::new(cos, height, sin)
    })
}

#[test]
fn arrangements_are_recognized() {
    let sphere = arrangement(fibonacci_axes(40));
    assert_eq!(sphere.kind, ArrangementKind::Sphere);
    assert!(sphere.target.length() < 0.2 && (sphere.distance[1] - 3.0).abs() < 0.2, "{sphere:?}");
    let hemisphere = arrangement(fibonacci_axes(80).into_iter().take(40));
    assert_eq!(hemisphere.kind, ArrangementKind::Hemisphere);
    assert!(
        hemisphere.elevation_degrees[0] > -5.0 && hemisphere.elevation_degrees[1] > 70.0,
        "{hemisphere:?}"
    );
    assert_eq!(arrangement(ring(24, 0.3)).kind, ArrangementKind::Rings(1));
    assert_eq!(arrangement(ring(24, 0.2).chain(ring(12, 0.9))).kind, ArrangementKind::Rings(2));
    let tilted = arrangement(ring(24, 0.3).map(|d| Vec3::new(d.y, d.x, d.z)));
    assert!(tilted.kind == ArrangementKind::Rings(1) && tilted.axis.x.abs() > 0.98, "{tilted:?}");
    let half = arrangement(fibonacci_axes(80).into_iter().filter(|axis| axis.z > 0.3));
    assert_eq!(half.kind, ArrangementKind::OneSide);
    assert!(half.azimuth_gap_degrees > 120.0 && half.words().contains("from one side"), "{half:?}");
    assert_eq!(
        arrangement(fibonacci_axes(80).into_iter().filter(|axis| axis.y.abs() < 0.3)).kind,
        ArrangementKind::Belt
    );
}

#[test]
fn up_is_where_the_pictures_have_their_tops() {
    let hemisphere = |up: Vec3, turn: fn(Vec3) -> Vec3| {
        let view = |direction: Vec3| {
            let camera = Camera::look_at(turn(direction) * 3.0, Vec3::ZERO, up, 38.0, 96, 96).unwrap();
            OpenView { camera, ..seen(0, direction) }
        };
        let views: Vec<OpenView> = fibonacci_axes(80).into_iter().take(40).skip(1).map(view).collect();
        Arrangement::new(&looks(&views), None, Vec3::Y).unwrap()
    };
    for (up, turn, words) in [
        (Vec3::Y, (|d| d) as fn(Vec3) -> Vec3, ""),
        (Vec3::Z, |d| Vec3::new(d.x, -d.z, d.y), "; up is +Z"),
        (Vec3::NEG_Y, |d| Vec3::new(d.x, -d.y, -d.z), "; up is -Y"),
        (Vec3::NEG_X, |d| Vec3::new(-d.y, d.x, d.z), "; up is -X"),
    ] {
        let found = hemisphere(up, turn);
        assert_eq!((found.kind, found.axis), (ArrangementKind::Hemisphere, up), "{found:?}");
        assert!(found.elevation_degrees[0] > -5.0 && found.azimuth_gap_degrees < 40.0, "{found:?}");
        let all = found.words();
        let tail = all.find(';').map_or("", |at| &all[at..]);
        assert_eq!(tail, words, "{all}");
    }
}

/// Backgrounds of `count` photographs, by pixel and number, with the object in the middle.
fn backgrounds(count: usize, value: impl Fn(f32, f32, usize) -> f32) -> Vec<Background> {
    let one = |k: usize| {
        let pixel = |i: u32| {
            let (x, y) = ((i % 32) as f32, (i / 32) as f32);
            let is_object = (x - 16.0).hypot(y - 16.0) < 9.0;
            (!is_object).then(|| value(x, y, k))
        };
        Background { size: [32, 32], values: (0..1024).map(pixel).collect() }
    };
    (0..count).map(one).collect()
}

#[test]
fn a_turntable_is_a_ring_before_the_same_background() {
    let shelf =
        |x: f32, y: f32, k: usize| 0.4 + 0.1 * (x * 0.4).sin() + 0.01 * y + 0.001 * ((k * 7) % 5) as f32;
    let same = sameness(&backgrounds(8, shelf));
    assert!(same.unwrap() > 0.95, "{same:?}");
    let ring = arrangement(ring(24, 0.3));
    assert!(is_turntable(Some(&ring), same));
    assert!(!is_turntable(Some(&arrangement(fibonacci_axes(40))), same), "cameras on a sphere");
    // A room that the camera went through.
    let room = |x: f32, _: f32, k: usize| 0.4 + 0.1 * (x * 0.4 + 2.1 * k as f32).sin();
    let other = sameness(&backgrounds(8, room));
    assert!(!is_turntable(Some(&ring), other), "{other:?}");
    // Plain paper says nothing.
    assert_eq!(sameness(&backgrounds(8, |x, _, _| 0.5 + 0.0002 * x)), None);
    assert_eq!(sameness(&backgrounds(2, shelf)), None);
    assert_eq!(sameness(&[]), None);
}

#[test]
fn one_camera_for_several_sides_of_the_object_is_named() {
    let mut fixed = good();
    let first = fixed[0].camera;
    fixed.iter_mut().for_each(|view| view.camera = first);
    for mesh in [None, Some(object())] {
        expect(&surveyed(&fixed, mesh.as_ref()), "same-cameras", &[], &["all 24 views", "turns before"]);
    }
    let mut twice = good();
    twice[3].camera = twice[2].camera;
    let survey = surveyed(&twice, None);
    let found = survey.findings.iter().find(|finding| finding.name == "same-cameras").unwrap();
    assert_eq!(found.views, ["v2", "v3"], "{:?}", survey.findings);
    // Two exposures from one place have the same mask.
    let mut bracketed = good();
    bracketed[3] = OpenView { name: "v3".to_owned(), ..bracketed[2].clone() };
    let survey = surveyed(&bracketed, None);
    assert!(survey.findings.iter().all(|finding| finding.name != "same-cameras"), "{:?}", survey.findings);
}
