//! A small object photographed from all sides, with one fault at a time.

use crate::scene::{FitPass, LoadOptions, Pass, Scene, ShapePass, load::read};
use crate::survey::cameras::{Arrangement, Background, check_meeting, sameness};
use crate::survey::estimate::{Estimate, FIT_PAIR_NANOS, duration, estimate, memory};
use crate::survey::{MaskOrigin, Severity, Survey, ViewLook, examine, named, table};
use glam::{Mat3A, Vec3, Vec3A};
use lobelia_geometry::mesh::primitive::{box_mesh, sphere_mesh};
use lobelia_geometry::view::{Camera, Image, Mask, Photograph, Placement, Split, StoredMask, ViewRecord};
use lobelia_geometry::{mesh::bvh::TriangleBvh, mesh::triangles::Mesh};
use lobelia_sg::fibonacci::fibonacci_axes;
use std::{path::Path, sync::OnceLock};

/// Width and height of the photographs.
const SIDE: u32 = 96;
/// Distance of the cameras.
const DISTANCE: f32 = 3.0;
/// Training and test views.
const VIEWS: [usize; 2] = [20, 4];

/// Three boxes that no turn and no mirror maps to themselves.
fn object() -> Mesh {
    let boxes = [
        (Vec3::ZERO, Vec3::new(1.1, 0.6, 0.4)),
        (Vec3::new(0.4, 0.5, 0.1), Vec3::new(0.25, 0.5, 0.2)),
        (Vec3::new(-0.4, -0.1, 0.45), Vec3::new(0.2, 0.25, 0.6)),
    ];
    joined(boxes.map(|(center, size)| box_mesh(center, size).unwrap()))
}

/// One mesh of several.
fn joined(parts: impl IntoIterator<Item = Mesh>) -> Mesh {
    let mut mesh = Mesh { uvs: Some(Vec::new()), ..Mesh::default() };
    for part in parts {
        let first = mesh.positions.len() as u32;
        mesh.positions.extend(part.positions);
        mesh.normals.extend(part.normals);
        mesh.uvs.as_mut().unwrap().extend(part.uvs.unwrap());
        mesh.triangles.extend(part.triangles.iter().map(|triangle| triangle.map(|vertex| vertex + first)));
    }
    mesh
}

/// The object seen by a camera: a checkered texture, and a mask.
fn photographed(name: &str, split: Split, camera: Camera, bvh: &TriangleBvh) -> ViewRecord {
    let hit = |pixel: u32| {
        let ray = camera.pixel_ray(pixel);
        bvh.nearest(&ray, 0.0).map(|hit| ray.origin + ray.direction * hit.distance)
    };
    let hits: Vec<Option<Vec3>> = (0..camera.width * camera.height).map(hit).collect();
    let color = |hit: &Option<Vec3>| {
        let Some(at) = hit else { return Vec3::ZERO };
        let cell = ((*at + 10.013) / 0.09).floor();
        let dark = (cell.x + cell.y + cell.z).rem_euclid(2.0) < 1.0;
        Vec3::new(0.5, 0.4, 0.3) * if dark { 0.3 } else { 1.0 }
    };
    let (width, height) = (camera.width, camera.height);
    let image = Image { width, height, pixels: hits.iter().map(color).collect() };
    let coverage = hits.iter().map(|hit| f32::from(u8::from(hit.is_some()))).collect();
    ViewRecord {
        photograph: Some(Photograph::of_image(&image)),
        mask: Some(StoredMask::new(&Mask { width, height, coverage })),
        ..ViewRecord::of_camera(name.to_owned(), split, camera)
    }
}

fn camera(direction: Vec3) -> Camera {
    // Cameras look a little beside the origin, so that no transposed pose is also a right one.
    looking(direction * DISTANCE, Vec3::new(0.05, 0.08, -0.03))
}

fn looking(eye: Vec3, target: Vec3) -> Camera {
    let up = if (eye - target).normalize().y.abs() > 0.95 { Vec3::X } else { Vec3::Y };
    Camera::look_at(eye, target, up, 38.0, SIDE, SIDE).unwrap()
}

/// The views without a fault.
fn good() -> Vec<ViewRecord> {
    static VIEWS_ONCE: OnceLock<Vec<ViewRecord>> = OnceLock::new();
    let views = || {
        let test = |d: Vec3| camera(Vec3::new(d.z, d.y, -d.x));
        let mut views = views_of(&object(), VIEWS[0], camera);
        for (i, mut view) in views_of(&object(), VIEWS[1], test).into_iter().enumerate() {
            (view.name, view.split) = (format!("t{i}"), Split::Test);
            views.push(view);
        }
        views
    };
    VIEWS_ONCE.get_or_init(views).clone()
}

/// Training views of an object from all sides, without a fault.
fn views_of(object: &Mesh, count: usize, camera: impl Fn(Vec3) -> Camera) -> Vec<ViewRecord> {
    let bvh = TriangleBvh::new(object);
    let view = |(i, d)| photographed(&format!("v{i}"), Split::Train, camera(d), &bvh);
    fibonacci_axes(count).into_iter().enumerate().map(view).collect()
}

/// Changes the pixels of a photograph.
fn paint(view: &mut ViewRecord, change: impl Fn(Vec3) -> Vec3) {
    let mut image = view.photograph.as_ref().unwrap().image();
    image.pixels.iter_mut().for_each(|pixel| *pixel = change(*pixel));
    view.photograph = Some(Photograph::of_image(&image));
}

/// Changes the coverage of every pixel of masks, by its column, row and coverage.
fn cover(views: &mut [ViewRecord], change: impl Fn(u32, u32, f32) -> f32) {
    for view in views {
        let mut mask = view.mask.as_ref().unwrap().mask();
        for (i, coverage) in (0..).zip(&mut mask.coverage) {
            *coverage = change(i % mask.width, i / mask.width, *coverage);
        }
        view.mask = Some(StoredMask::new(&mask));
    }
}

fn looks(views: &[ViewRecord]) -> Vec<ViewLook> {
    views.iter().map(|view| ViewLook::new(view, MaskOrigin::File)).collect()
}

/// A survey of views of a mesh, or of an unknown object.
fn surveyed(views: &[ViewRecord], mesh: Option<&Mesh>) -> Survey {
    examine(looks(views), mesh, Vec3::Y, &[])
}

/// A survey of views of the object, whose mesh is known.
fn of_object(views: &[ViewRecord]) -> Survey {
    surveyed(views, Some(&object()))
}

/// Expects one finding alone, named after its severity, with these views and all words.
#[track_caller]
fn expect(survey: &Survey, name: &str, views: &[&str], words: &[&str]) {
    let names = survey.findings.iter().map(|finding| format!("{:?} {}", finding.severity, finding.name));
    assert_eq!(names.collect::<Vec<_>>(), [name], "{:#?}", survey.findings);
    let finding = &survey.findings[0];
    assert_eq!(finding.views, views, "{finding:?}");
    let text = format!("{} | {}", finding.problem, finding.help);
    words.iter().for_each(|word| assert!(text.contains(word), "no `{word}` in: {text}"));
    assert!(!finding.help.is_empty());
}

/// Expects this error first, in these words.
#[track_caller]
fn first_is(survey: &Survey, name: &str, words: &str) {
    let finding = &survey.findings[0];
    assert_eq!((finding.name, finding.severity), (name, Severity::Error), "{finding:?}");
    assert!(format!("{} | {}", finding.problem, finding.help).contains(words), "{finding:?}");
}

#[test]
fn nothing_is_wrong_with_good_views_at_any_run() {
    for mesh in [Some(object()), None] {
        let survey = surveyed(&good(), mesh.as_ref());
        assert_eq!(survey.findings, []);
        let least = if mesh.is_some() { 0.99 } else { 0.93 };
        let found = |survey: Survey| -> Vec<_> {
            survey.looks.iter().map(|look| (look.overlap.unwrap(), look.stops)).collect()
        };
        let overlaps = found(survey);
        assert!(overlaps.iter().all(|(overlap, _)| *overlap > least), "{overlaps:?}");
        assert_eq!(overlaps, found(surveyed(&good(), mesh.as_ref())));
    }
}

// Photographs.

/// A survey of good views after a change of one photograph's pixels.
fn changed(view: usize, change: impl Fn(Vec3) -> Vec3) -> Survey {
    let mut views = good();
    paint(&mut views[view], change);
    of_object(&views)
}

#[test]
fn black_photographs_are_named() {
    let black = changed(4, |_| Vec3::ZERO);
    expect(&black, "Error black", &["v4"], &["black where the object is, in view `v4`", "select"]);
    assert_eq!(black.findings[0].to_error().exit_code(), 2);
    // A lens cap lets a little noise through.
    expect(&changed(4, |pixel| pixel * 1e-4), "Error black", &["v4"], &["`v4`"]);
}

#[test]
fn another_exposure_is_named_with_its_stops() {
    let survey = changed(5, |pixel| pixel * 8.0);
    expect(&survey, "Warning exposure", &["v5"], &["`v5` is 3.", "stops brighter", "exposure: Color"]);
    expect(&changed(5, |pixel| pixel / 8.0), "Warning exposure", &["v5"], &["stops darker"]);
    expect(&changed(5, |pixel| pixel * 1e5), "Warning exposure", &["v5"], &["stops brighter"]);
    assert_eq!(changed(5, |pixel| pixel * 1.3).findings, []);
}

#[test]
fn photographs_of_another_placement_are_in_another_light() {
    let mut views = good();
    for view in [2, 5, 8] {
        paint(&mut views[view], |pixel| pixel * 8.0);
    }
    assert!(!of_object(&views).findings.is_empty());
    for view in [2, 5, 8] {
        views[view].placement = Placement(1);
    }
    assert_eq!(of_object(&views).findings, []);
    // Beside those of its own placement one is too dark.
    paint(&mut views[5], |pixel| pixel * 1e-4);
    expect(&of_object(&views), "Error black", &["v5"], &["black where the object is"]);
}

#[test]
fn views_of_one_name_in_both_splits_are_told_apart() {
    let mut views = good();
    views[20].name = "v4".into();
    paint(&mut views[4], |_| Vec3::ZERO);
    expect(&of_object(&views), "Error black", &["train/v4"], &["view `train/v4`"]);
}

#[test]
fn few_views_are_not_compared_and_cameras_alone_have_no_light() {
    let mut views = good();
    paint(&mut views[1], |pixel| pixel * 8.0);
    let few = of_object(&views[..5]);
    assert!(few.findings.is_empty() && few.looks.iter().all(|look| look.stops.is_none()));
    views.iter_mut().for_each(|view| (view.photograph, view.mask) = (None, None));
    let bare = of_object(&views);
    assert!(bare.findings.is_empty() && bare.arrangement.is_some(), "{:?}", bare.findings);
}

// Masks.

#[test]
fn inverted_masks_are_named() {
    let mut views = good();
    cover(&mut views, |_, _, coverage| 1.0 - coverage);
    let all: Vec<&str> = views.iter().map(|view| view.name.as_str()).collect();
    for mesh in [Some(object()), None] {
        expect(&surveyed(&views, mesh.as_ref()), "Error inverted-masks", &all, &["invert it"]);
    }
    let mut one = good();
    cover(&mut one[8..9], |_, _, coverage| 1.0 - coverage);
    expect(&of_object(&one), "Warning inverted-masks", &["v8"], &["`v8`"]);
}

#[test]
fn masks_that_are_never_white_are_named() {
    let mut views = good();
    cover(&mut views, |_, _, coverage| 127.0 / 255.0 * coverage);
    let survey = of_object(&views);
    first_is(&survey, "dim-masks", "the highest value is 127 of 255");
}

#[test]
fn missing_masks_are_named() {
    let mut views = good();
    views[23].mask = None;
    let words = ["view `t3` (1 view of the test split)"];
    expect(&of_object(&views), "Warning missing-masks", &["t3"], &words);
    views.iter_mut().for_each(|view| view.mask = None);
    let beside_mesh = of_object(&views);
    expect(&beside_mesh, "Warning missing-masks", &[], &["no view has a mask"]);
    let words = ["at least three views with masks", "there are 0"];
    expect(&surveyed(&views, None), "Error masks", &[], &words);
}

// Cameras.

/// Views of the cameras alone.
fn arrangement(directions: impl IntoIterator<Item = Vec3>) -> Arrangement {
    let view = |(i, direction): (usize, Vec3)| {
        ViewRecord::of_camera(format!("v{i}"), Split::Train, camera(direction.normalize()))
    };
    let views: Vec<ViewRecord> = directions.into_iter().enumerate().map(view).collect();
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
    let words = |arrangement: &Arrangement, start: &str| {
        assert!(arrangement.words().starts_with(start), "{}", arrangement.words());
    };
    let sphere = arrangement(fibonacci_axes(40));
    words(&sphere, "all around: elevation -");
    assert!(sphere.target.length() < 0.2 && (sphere.distance[1] - 3.0).abs() < 0.2, "{sphere:?}");
    let [low, high] = arrangement(fibonacci_axes(80).into_iter().take(40)).elevation_degrees;
    assert!(low > -5.0 && high > 70.0, "{low} {high}");
    words(&arrangement(ring(24, 0.3)), "one ring:");
    words(&arrangement(ring(24, 0.2).chain(ring(12, 0.9))), "2 rings:");
    let tilted = arrangement(ring(24, 0.3).map(|d| Vec3::new(d.y, d.x, d.z)));
    assert!(tilted.rings == Some(1) && tilted.axis.x.abs() > 0.98, "{tilted:?}");
    let half = arrangement(fibonacci_axes(80).into_iter().filter(|axis| axis.z > 0.3));
    words(&half, "from one side:");
    assert!(half.azimuth_gap_degrees > 120.0, "{half:?}");
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
    let is_turntable = |arrangement: Arrangement, background| {
        Survey { arrangement: Some(arrangement), background, ..Survey::default() }.is_turntable()
    };
    assert!(is_turntable(arrangement(ring(24, 0.3)), same));
    assert!(!is_turntable(arrangement(fibonacci_axes(40)), same), "cameras on a sphere");
    // A room that the camera went through.
    let room = |x: f32, _: f32, k: usize| 0.4 + 0.1 * (x * 0.4 + 2.1 * k as f32).sin();
    let other = sameness(&backgrounds(8, room));
    assert!(!is_turntable(arrangement(ring(24, 0.3)), other), "{other:?}");
    // Plain paper says nothing.
    for background in [backgrounds(8, |x, _, _| 0.5 + 0.0002 * x), backgrounds(2, shelf), Vec::new()] {
        assert_eq!(sameness(&background), None);
    }
}

/// Views of a ball of radius 1 around `center`.
fn ball(center: Vec3, count: usize) -> Vec<ViewRecord> {
    let view = |(i, axis): (usize, Vec3)| {
        let camera = looking(center + 4.0 * axis, center);
        ViewRecord {
            mask: Some(disk([48.0, 48.0], 33.0)),
            ..ViewRecord::of_camera(format!("v{i}"), Split::Train, camera)
        }
    };
    fibonacci_axes(count).into_iter().enumerate().map(view).collect()
}

fn disk(center: [f32; 2], radius: f32) -> StoredMask {
    let covered = |i: u32| {
        let (x, y) = ((i % SIDE) as f32 + 0.5 - center[0], (i / SIDE) as f32 + 0.5 - center[1]);
        f32::from(u8::from(x * x + y * y < radius * radius))
    };
    StoredMask::new(&Mask { width: SIDE, height: SIDE, coverage: (0..SIDE * SIDE).map(covered).collect() })
}

#[track_caller]
fn refused(views: &[ViewRecord], words: &[&str]) {
    let error = check_meeting(&looks(views)).unwrap_err();
    assert_eq!(error.exit_code(), 2);
    let text = format!("{error} | {}", error.help().unwrap());
    words.iter().for_each(|word| assert!(text.contains(word), "`{word}` is not in: {text}"));
}

#[test]
fn masks_that_say_nothing_are_named() {
    let mut views = ball(Vec3::ZERO, 12);
    cover(&mut views[5..6], |_, _, _| 1.0);
    refused(&views, &["`v5`", "all white", "select"]);
    refused(&views[..2], &["at least three views", "there are 2"]);
    views.iter_mut().skip(2).for_each(|view| view.mask = None);
    refused(&views, &["there are 2", "view `v2` has none", "white where the object is"]);
}

#[test]
fn an_object_cut_by_every_frame_is_refused() {
    let mut views = ball(Vec3::ZERO, 12);
    views.iter_mut().for_each(|view| view.mask = Some(disk([48.0, 75.0], 33.0)));
    refused(&views, &["every frame cuts", "`v0`", "move the camera back"]);
    views[3].mask = Some(disk([48.0, 48.0], 33.0));
    assert!(!check_meeting(&looks(&views)).is_err_and(|error| error.to_string().contains("cuts")));
}

#[test]
fn cameras_that_do_not_see_one_point_are_told() {
    let mut inside = ball(Vec3::new(5.0, 0.0, 0.0), 24);
    inside[7].camera.world_from_camera.translation = Vec3::new(5.3, 0.1, 0.0).into();
    refused(&inside, &["camera of view `v7` is inside the object", "select"]);
    let mut views = ball(Vec3::ZERO, 24);
    views[9].mask = Some(disk([12.0, 12.0], 7.0));
    refused(&views, &["1 of 24 views", "view `v9` is farthest off"]);
    let mut many = ball(Vec3::ZERO, 60);
    many[9].mask = Some(disk([12.0, 12.0], 7.0));
    check_meeting(&looks(&many)).unwrap();
    let mut views = ball(Vec3::ZERO, 24);
    for view in &mut views {
        let rotation = &mut view.camera.world_from_camera.matrix3;
        (rotation.y_axis, rotation.z_axis) = (-rotation.y_axis, -rotation.z_axis);
    }
    refused(&views, &["24 of 24 cameras look away", "camera axes"]);
    let same: Vec<ViewRecord> = vec![views[0].clone(); 5];
    refused(&same, &["along one line", "other sides", "turns before a fixed camera"]);
}

// Silhouettes.

const OPENGL: Mat3A = Mat3A::from_cols(Vec3A::X, Vec3A::NEG_Y, Vec3A::NEG_Z);

fn with_cameras(change: impl Fn(&mut Camera)) -> Vec<ViewRecord> {
    let mut views = good();
    views.iter_mut().for_each(|view| change(&mut view.camera));
    views
}

/// Views with other camera axes: the right ones are these columns of theirs.
fn with_axes(axes: Mat3A) -> Vec<ViewRecord> {
    with_cameras(|camera| camera.world_from_camera.matrix3 *= axes.transpose())
}

/// Masks mirrored left to right, of lenses whose middle is not that of the picture.
fn mirrored(object: &Mesh) -> Vec<ViewRecord> {
    let off_center = |direction: Vec3| {
        let camera = camera(direction);
        Camera { center: [camera.center[0] + 11.0, camera.center[1] - 8.0], ..camera }
    };
    let mut views = views_of(object, 20, off_center);
    for view in &mut views {
        let mut mask = view.mask.as_ref().unwrap().mask();
        mask.coverage.chunks_mut(SIDE as usize).for_each(<[f32]>::reverse);
        view.mask = Some(StoredMask::new(&mask));
        view.photograph = None;
    }
    views
}

fn moved(change: impl Fn(Vec3) -> Vec3) -> Mesh {
    let mut mesh = object();
    mesh.positions.iter_mut().for_each(|position| *position = change(*position));
    mesh
}

#[test]
fn confused_axes_are_named() {
    // All inverted poses of cameras that look at the origin are at one point, apart from rounding.
    let mut of_origin = views_of(&object(), 20, |direction| looking(3.0 * direction, Vec3::ZERO));
    for view in &mut of_origin {
        view.camera.world_from_camera = view.camera.world_from_camera.inverse();
    }
    for mesh in [Some(object()), None] {
        let said = |views: &[ViewRecord], words: &[&str]| {
            expect(&surveyed(views, mesh.as_ref()), "Error other-axes", &[], words);
        };
        said(&with_axes(OPENGL), &["y and z of the camera axes are negated", "OpenGL"]);
        let inverted = with_cameras(|camera| camera.world_from_camera = camera.world_from_camera.inverse());
        said(&inverted, &["camera_from_world is taken for world_from_camera"]);
        let words = ["camera_from_world is taken for world_from_camera", "invert each of them"];
        said(&of_origin, &words);
        said(&mirrored(&object()), &["mirrored left to right"]);
    }
    let upside_down = Mat3A::from_diagonal(Vec3::new(-1.0, -1.0, 1.0));
    let survey = of_object(&with_axes(upside_down));
    expect(&survey, "Error other-axes", &[], &["upside down", "EXIF"]);
}

/// A ball with a knob and a nose: whatever is wrong with it, silhouettes overlap for the most part.
#[test]
fn mistakes_with_a_compact_object_are_named() {
    let nose = box_mesh(Vec3::new(-0.2, -0.1, 0.48), Vec3::new(0.35, 0.3, 0.4)).unwrap();
    let knob = box_mesh(Vec3::new(0.36, 0.36, 0.15), Vec3::splat(0.3)).unwrap();
    let compact = joined([sphere_mesh(Vec3::ZERO, 0.62).unwrap(), knob, nose]);
    let survey = surveyed(&mirrored(&compact), Some(&compact));
    expect(&survey, "Error other-axes", &[], &["mirrored left to right"]);
    let mut larger = compact.clone();
    larger.positions.iter_mut().for_each(|position| *position *= 1.1);
    let views = views_of(&larger, 20, camera);
    assert_eq!(surveyed(&views, Some(&larger)).findings, []);
    let words = ["the mesh is 1.", "times too small"];
    expect(&surveyed(&views, Some(&compact)), "Warning other-place", &[], &words);
}

#[test]
fn a_turned_mesh_and_another_unit_or_place_are_named() {
    for (mesh, name, words) in [
        (
            moved(|p| Vec3::new(p.x, -p.z, p.y)),
            "Error other-axes",
            ["the mesh has +Z up, the cameras have +Y up", "as (x, z, -y)."],
        ),
        (moved(|p| Vec3::new(p.y, p.z, p.x)), "Error other-axes", ["the mesh is turned", "as (z, x, y)."]),
        (
            moved(|p| p * 0.001),
            "Error other-place",
            ["1000 times too small (as between meters and millimeters)", "as 1000 · (x, y, z)."],
        ),
        (moved(|p| p * 1000.0), "Error other-place", ["1000 times too large", "as 0.001 · (x, y, z)."]),
        (
            moved(|p| p + Vec3::new(0.9, 0.0, 0.3)),
            "Error other-place",
            ["the mesh is in another place", "(x, y, z) + (-0.9"],
        ),
        (
            moved(|p| Vec3::new(p.x, -p.z, p.y) * 0.01),
            "Error other-place",
            [
                "the mesh has +Z up, the cameras have +Y up; the mesh is 100 times too small",
                "as 100 · (x, z, -y).",
            ],
        ),
    ] {
        expect(&surveyed(&good(), Some(&mesh)), name, &[], &words);
    }
}

#[test]
fn without_a_mistake_that_explains_it_there_is_no_recipe() {
    let rod = box_mesh(Vec3::new(0.0, -0.5, 0.0), Vec3::new(0.02, 0.02, 1.5)).unwrap();
    let survey = surveyed(&good(), Some(&rod));
    first_is(&survey, "mesh-misses-masks", "None of the usual mistakes explains it (tried: camera axes of");
    // A mesh that is only a little off is no reason to stop.
    let survey = surveyed(&good(), Some(&moved(|p| p * Vec3::new(1.0, 1.0, 1.25))));
    assert!(survey.findings_of(Severity::Error).next().is_none(), "{:?}", survey.findings);
    // Photographs in no order at all.
    let (all, mut views) = (good(), good());
    for (i, view) in views.iter_mut().take(VIEWS[0]).enumerate() {
        view.camera = all[(7 * i + 3) % VIEWS[0]].camera;
    }
    let survey = surveyed(&views, None);
    let finding = &survey.findings[0];
    assert_eq!((survey.findings.len(), finding.severity), (1, Severity::Error), "{:#?}", survey.findings);
}

#[test]
fn one_view_that_does_not_agree_is_named() {
    let mut views = good();
    views[12].mask = views[3].mask.clone();
    for mesh in [Some(object()), None] {
        let words = ["does not agree with the", "in view `v12`", "exchanged"];
        expect(&surveyed(&views, mesh.as_ref()), "Warning stray-view", &["v12"], &words);
    }
    // Without a mesh, a mask that is far off.
    let mut views = good();
    cover(&mut views[9..10], |x, y, _| f32::from(u8::from(x < 6 && y < 6)));
    let survey = surveyed(&views, None);
    let finding = survey.findings.iter().find(|finding| finding.name == "masks").unwrap();
    assert!(finding.problem.contains("`v9`") && finding.severity == Severity::Error, "{finding:?}");
}

#[test]
fn thin_parts_are_no_error() {
    let bar = |axis: usize, a: f32, b: f32| {
        let mut center = Vec3::ZERO;
        (center[(axis + 1) % 3], center[(axis + 2) % 3]) = (a, b);
        let mut size = Vec3::splat(0.05);
        size[axis] = 1.0;
        box_mesh(center, size).unwrap()
    };
    let bars = (0..3)
        .flat_map(|axis| [(-0.5, -0.5), (-0.5, 0.5), (0.5, -0.5), (0.5, 0.5)].map(|(a, b)| bar(axis, a, b)));
    // Cells and pixels make the hull of bars as thin as a pixel thinner: that is no reason to stop.
    let survey = surveyed(&views_of(&joined(bars), 24, camera), None);
    assert_eq!(survey.findings_of(Severity::Error).count(), 0, "{:?}", survey.findings);
}

// Text, JSON and the estimate.

fn scene(passes: &str) -> Scene {
    let text = format!(
        "Scene(version: 1, surface: Sphere(texture_size: 256), light: Unknown(lobes: 64), \
         views: Dataset(path: \".\"), passes: [{passes}])"
    );
    read(text, Path::new("scene.ron"), &LoadOptions::default()).unwrap().scene
}

#[test]
fn the_table_says_what_there_is() {
    let survey = of_object(&good());
    let rows = table::rows(&survey);
    let has = |label: &str, words: &str| {
        let text = &rows.iter().find(|row| row.0 == label).unwrap().1;
        assert!(text.contains(words), "{text}");
    };
    has("data", "20 training views of 96×96, 4 test views of 96×96");
    has("masks", "files of 24 views; the object covers");
    has("cameras", "all around: elevation -");
    has("overlap", "with the mesh to 1.000");
    has("light", "clipped 0.00 %");
    let said = |survey: &Survey| (table::verdict(Some(survey), 0), table::findings(survey));
    assert_eq!(said(&survey), ("fine".to_owned(), String::new()));
    // The first error is what the program ends with.
    assert_eq!(said(&changed(4, |_| Vec3::ZERO)), ("1 error".to_owned(), String::new()));
    assert_eq!(table::verdict(None, 1), "1 error");
    let views: Vec<String> = (0..7).map(|i| format!("v{i}")).collect();
    assert_eq!(named(&views[..1]), "view `v0`");
    assert_eq!(named(&views), "views `v0`, `v1`, `v2`, `v3`, `v4` and 2 more");
}

#[test]
fn more_work_takes_more_time_and_memory() {
    let survey = of_object(&good());
    let render = "Render(name: \"novel\")";
    let of = |passes: &str, threads| estimate(&survey.looks, &scene(passes), threads);
    let short = of(&format!("Fit(steps: 100), {render}"), 2);
    let long = of(&format!("Fit(steps: 1000), {render}"), 2);
    assert!(long.seconds() > short.seconds() && long.bytes() == short.bytes());
    assert!(of("Fit(steps: 1000)", 4).seconds() < long.seconds());
    assert!(of("Fit()", 2).bytes() > of("", 2).bytes());
    let names: Vec<&str> = long.parts.iter().map(|part| part.what.as_str()).collect();
    assert_eq!(names, ["photographs", "texels", "shadows", "fit", "novel"]);
    // Everything is linear in what it says it is: half of the steps, before the first milestone,
    // visit half of the pixels.
    let pairs = f64::from(FitPass::default().batch) * 900.0 * 0.75 * 64.0;
    let fit = |estimate: &Estimate| estimate.parts.iter().find(|part| part.what == "fit").unwrap().seconds;
    let longer = fit(&long) - fit(&short);
    assert!((longer - 0.5e-9 * pairs * FIT_PAIR_NANOS).abs() < 1e-6);
    // What comes before the first step takes time as well.
    assert!(fit(&short) > longer / 9.0);
    assert!(long.words().contains("on 2 threads"), "{}", long.words());
    assert_eq!([memory(850.0 * 1048576.0), memory(2.5 * 1073741824.0)], ["850 MiB", "2.5 GiB"]);
    assert_eq!([duration(1.2), duration(300.0), duration(7200.0)], ["2 s", "5 min", "2.0 h"]);
}

#[test]
fn levels_that_photographs_do_not_resolve_take_nothing() {
    let mut survey = surveyed(&good(), None);
    let of = |survey: &Survey, levels: usize| {
        let mut shape = ShapePass::default();
        shape.levels.truncate(levels);
        let scene = Scene { passes: vec![Pass::Shape(shape)], ..scene("") };
        let estimate = estimate(&survey.looks, &scene, 2);
        let part = estimate.parts.into_iter().find(|part| part.what == "shape").unwrap();
        [part.seconds, part.bytes]
    };
    assert_eq!(of(&survey, 2), of(&survey, 3));
    survey.looks.iter_mut().for_each(|look| look.size = [2048; 2]);
    let (two, three) = (of(&survey, 2), of(&survey, 3));
    assert!(two[0] < three[0] && two[1] < three[1]);
}
