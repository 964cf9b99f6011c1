//! Other axes, mirrored photographs, inverted poses, other units: the cause is named.

use super::{expect, good, object, surveyed};
use crate::math::fibonacci::fibonacci_axes;
use crate::mesh::bvh::TriangleBvh;
use crate::mesh::primitive::box_mesh;
use crate::mesh::triangles::Mesh;
use crate::survey::Severity;
use crate::survey::look::OpenView;
use crate::view::{Camera, Split};
use glam::{Affine3A, Mat3A, Vec3, Vec3A};

/// Cameras with other axes: the right ones are these columns of theirs.
fn with_axes(axes: Mat3A) -> Vec<OpenView> {
    let mut views = good();
    for view in &mut views {
        let pose = &mut view.camera.world_from_camera;
        pose.matrix3 *= axes.transpose();
    }
    views
}

fn inverted() -> Vec<OpenView> {
    let mut views = good();
    views.iter_mut().for_each(|view| {
        let pose: Affine3A = view.camera.world_from_camera.inverse();
        view.camera.world_from_camera = pose;
    });
    views
}

/// Photographs and masks mirrored left to right.
fn mirrored() -> Vec<OpenView> {
    let mut views = good();
    for view in &mut views {
        let width = view.camera.width as usize;
        view.mask.as_mut().unwrap().coverage.chunks_mut(width).for_each(<[f32]>::reverse);
        view.photograph.as_mut().unwrap().image.pixels.chunks_mut(width).for_each(<[Vec3]>::reverse);
    }
    views
}

/// Views through lenses whose middle is not that of the picture, each seen with its pixels at other places: `place` is that of a pixel
/// in the turned picture.
fn off_center(place: impl Fn(usize, usize) -> (usize, usize)) -> Vec<OpenView> {
    let bvh = TriangleBvh::new(&object());
    let seen = |(i, direction): (usize, Vec3)| {
        let mut camera = super::camera(direction);
        camera.center = [camera.center[0] + 11.0, camera.center[1] - 8.0];
        let mut view = super::photographed(&format!("v{i}"), Split::Train, camera, &bvh);
        let side = camera.width as usize;
        let (mask, photograph) = (view.mask.as_mut().unwrap(), view.photograph.as_mut().unwrap());
        let (coverage, pixels) = (mask.coverage.clone(), photograph.image.pixels.clone());
        for from in 0..side * side {
            let (x, y) = place(from % side, from / side);
            mask.coverage[y * side + x] = coverage[from];
            photograph.image.pixels[y * side + x] = pixels[from];
        }
        view
    };
    fibonacci_axes(20).into_iter().enumerate().map(seen).collect()
}

fn moved(change: impl Fn(Vec3) -> Vec3) -> Mesh {
    let mut mesh = object();
    mesh.positions.iter_mut().for_each(|position| *position = change(*position));
    mesh
}

const OPENGL: Mat3A = Mat3A::from_cols(Vec3A::X, Vec3A::NEG_Y, Vec3A::NEG_Z);

#[test]
fn confused_axes_are_named_with_a_mesh() {
    let mesh = object();
    let named =
        |views: &[OpenView], words: &[&str]| expect(&surveyed(views, Some(&mesh)), "other-axes", &[], words);
    named(&with_axes(OPENGL), &["y and z of the camera axes are negated", "OpenGL"]);
    named(&inverted(), &["camera_from_world is taken for world_from_camera"]);
    named(&mirrored(), &["mirrored left to right"]);
    let upside_down = Mat3A::from_diagonal(Vec3::new(-1.0, -1.0, 1.0));
    named(&with_axes(upside_down), &["upside down", "EXIF"]);
    let quarter = Mat3A::from_cols(Vec3A::Y, Vec3A::NEG_X, Vec3A::Z);
    named(&with_axes(quarter), &["turned by 90°"]);
    let llff = Mat3A::from_cols(Vec3A::Y, Vec3A::X, Vec3A::NEG_Z);
    named(&with_axes(llff), &["LLFF"]);
}

#[test]
fn confused_axes_are_named_without_a_mesh() {
    let named = |views: &[OpenView], words: &[&str]| expect(&surveyed(views, None), "other-axes", &[], words);
    named(&with_axes(OPENGL), &["y and z of the camera axes are negated"]);
    named(&inverted(), &["camera_from_world is taken for world_from_camera"]);
    named(&mirrored(), &["mirrored left to right"]);
}

#[test]
fn inverted_poses_of_cameras_that_look_at_the_origin_are_named() {
    // All inverted poses are at one point, apart from rounding.
    let bvh = TriangleBvh::new(&object());
    let seen = |(i, direction): (usize, Vec3)| {
        let up = if direction.y.abs() > 0.95 { Vec3::X } else { Vec3::Y };
        let camera =
            Camera::look_at(direction * 3.0, Vec3::ZERO, up, 38.0, super::SIDE, super::SIDE).unwrap();
        let mut view = super::photographed(&format!("v{i}"), Split::Train, camera, &bvh);
        view.camera.world_from_camera = camera.world_from_camera.inverse();
        view
    };
    let views: Vec<OpenView> = fibonacci_axes(20).into_iter().enumerate().map(seen).collect();
    for mesh in [Some(object()), None] {
        let words = ["camera_from_world is taken for world_from_camera", "invert each of them"];
        expect(&surveyed(&views, mesh.as_ref()), "other-axes", &[], &words);
    }
}

#[test]
fn another_focal_length_is_named_beside_the_size_of_the_mesh() {
    let mut views = good();
    views.iter_mut().for_each(|view| view.camera.focal = view.camera.focal.map(|focal| focal * 0.6));
    let survey = surveyed(&views, Some(&object()));
    let finding = &survey.findings[0];
    assert_eq!((survey.findings.len(), finding.severity), (1, Severity::Error), "{:#?}", survey.findings);
    assert!(finding.problem.contains("the focal lengths are 1.67 times too short"), "{finding:?}");
    assert!(finding.help.contains("multiply the focal lengths by 1.67"), "{finding:?}");
    // The other way around, the size of the mesh is the cause, and the focal length is named if it explains as much.
    let survey = surveyed(&good(), Some(&moved(|p| p * 0.6)));
    let finding = &survey.findings[0];
    assert!(finding.name == "other-place" && finding.problem.contains("times too small"), "{finding:?}");
}

#[test]
fn eroded_masks_are_named() {
    let mut views = good();
    for view in &mut views {
        view.mask = view.mask.as_ref().map(|mask| mask.eroded(6));
    }
    let survey = surveyed(&views, Some(&object()));
    let finding = &survey.findings[0];
    let words = "the masks are smaller than the silhouettes of the mesh by about";
    assert!(finding.problem.contains(words) && finding.help.contains("eroded"), "{finding:?}");
    // A square of 6 pixels reaches farther along diagonals.
    assert!(
        ["about 6 pixels", "about 7 pixels"].iter().any(|width| finding.problem.contains(width)),
        "{finding:?}"
    );
    assert_eq!((finding.name, finding.severity), ("other-outline", Severity::Error), "{finding:?}");
}

#[test]
fn turned_pictures_are_named_with_the_principal_point_off_the_middle() {
    let last = super::SIDE as usize - 1;
    let mesh = object();
    let named = |views: &[OpenView], mesh: Option<&Mesh>, word: &str| {
        expect(&surveyed(views, mesh), "other-axes", &[], &[word]);
    };
    named(&off_center(|x, y| (last - x, y)), Some(&mesh), "mirrored left to right");
    named(&off_center(|x, y| (x, last - y)), None, "mirrored top to bottom");
    named(&off_center(|x, y| (last - x, last - y)), Some(&mesh), "upside down");
    named(&off_center(|x, y| (y, last - x)), None, "turned by 90° counterclockwise");
    named(&off_center(|x, y| (last - y, x)), Some(&mesh), "turned by 90° clockwise");
    assert_eq!(surveyed(&off_center(|x, y| (x, y)), Some(&mesh)).findings, []);
}

#[test]
fn a_turned_or_mirrored_mesh_is_named() {
    let named =
        |mesh: &Mesh, words: &[&str]| expect(&surveyed(&good(), Some(mesh)), "other-axes", &[], words);
    named(
        &moved(|p| Vec3::new(p.x, -p.z, p.y)),
        &["the mesh has +Z up, the cameras have +Y up", "(x, z, -y)"],
    );
    named(
        &moved(|p| Vec3::new(p.x, p.z, -p.y)),
        &["the mesh has +Y up, the cameras have +Z up", "(x, -z, y)"],
    );
    named(&moved(|p| Vec3::new(p.y, p.z, p.x)), &["the mesh is turned", "(z, x, y)"]);
    named(&moved(|p| Vec3::new(-p.x, p.y, p.z)), &["the mesh is mirrored", "(-x, y, z)"]);
}

#[test]
fn another_unit_or_place_is_named() {
    let named =
        |mesh: &Mesh, words: &[&str]| expect(&surveyed(&good(), Some(mesh)), "other-place", &[], words);
    named(
        &moved(|p| p * 0.001),
        &["1000 times too small", "meters and millimeters", "multiply them by 1000."],
    );
    named(&moved(|p| p * 1000.0), &["1000 times too large", "multiply them by 0.001."]);
    named(&moved(|p| p + Vec3::new(0.9, 0.0, 0.3)), &["in another place"]);
    named(&moved(|p| Vec3::new(p.x, -p.z, p.y) * 0.01), &["turned", "100 times too small"]);
}

#[test]
fn a_mesh_of_something_else_misses_the_masks() {
    let rod = box_mesh(Vec3::new(0.0, -0.5, 0.0), Vec3::new(0.02, 0.02, 1.5)).unwrap();
    let survey = surveyed(&good(), Some(&rod));
    let finding = &survey.findings[0];
    assert_eq!((finding.name, finding.severity), ("mesh-misses-masks", Severity::Error), "{finding:?}");
    assert!(finding.problem.contains("the mesh does not cover the masks"), "{finding:?}");
    // A mesh that is only a little off is no reason to stop.
    let thick = moved(|p| p * Vec3::new(1.0, 1.0, 1.25));
    let survey = surveyed(&good(), Some(&thick));
    assert!(survey.findings_of(Severity::Error).next().is_none(), "{:?}", survey.findings);
}

#[test]
fn one_view_that_does_not_agree_is_named() {
    let mut views = good();
    let other = views[3].mask.clone();
    views[12].mask = other;
    expect(
        &surveyed(&views, Some(&object())),
        "stray-view",
        &["v12"],
        &["does not agree with the mesh in view `v12`"],
    );
}
