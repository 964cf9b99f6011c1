use super::*;
use crate::light::light_frame::LightFrame;
use crate::light::placement::{PlacedFrame, Placements};
use crate::math::fibonacci::fibonacci_axes;
use crate::mesh::primitive::sphere_mesh;
use crate::shape::stereo::everybodys_views;
use crate::view::{Camera, Image, Mask, Photograph, StoredMask};

/// Width and height of the photographs.
const SIDE: u32 = 160;

/// A normal of a hammered ball.
fn hammered(at: Vec3) -> Vec3 {
    let wave =
        |phase: f32| (9.0 * at.x + phase).sin() * (9.0 * at.y - phase).cos() * (9.0 * at.z + 0.5).sin();
    (at.normalize() + 0.25 * Vec3::new(wave(0.3), wave(1.4), wave(2.9))).normalize()
}

/// Radiance of a room with windows, lamps and dark corners, blurred.
fn room(direction: Vec3) -> Vec3 {
    let axes = fibonacci_axes(30).into_iter().enumerate();
    let lamp = |(i, axis): (usize, Vec3)| {
        let color = Vec3::new((i % 3) as f32, (i % 4) as f32, (i % 5) as f32);
        color * (40.0 * (axis.dot(direction) - 1.0)).exp()
    };
    Vec3::splat(0.1) + axes.map(lamp).sum::<Vec3>()
}

/// Cameras on rings around the origin, what they show of a ball with these normals, and masks. A share `gloss` is mirrored.
fn photographed(
    normal: fn(Vec3) -> Vec3,
    gloss: f32,
    frame: LightFrame,
) -> Vec<(Camera, Photograph, StoredMask)> {
    let axes = fibonacci_axes(40).into_iter();
    let shoot = |axis: Vec3| {
        let up = if axis.y.abs() > 0.9 { Vec3::X } else { Vec3::Y };
        let camera = Camera::look_at(4.0 * axis, Vec3::ZERO, up, 32.0, SIDE, SIDE).unwrap();
        let light_from_world = frame.light_from_world(camera.world_from_camera.matrix3.into());
        let mut image = Image { width: SIDE, height: SIDE, pixels: Vec::new() };
        let mut coverage = Vec::new();
        for pixel in 0..SIDE * SIDE {
            let ray = camera.pixel_ray(pixel);
            let (b, c) = (ray.origin.dot(ray.direction), ray.origin.length_squared() - 1.0);
            let root = b * b - c;
            coverage.push(f32::from(u8::from(root > 0.0)));
            if root <= 0.0 {
                image.pixels.push(Vec3::ZERO);
                continue;
            }
            let at = ray.origin + ray.direction * (-b - root.sqrt());
            let (n, v) = (light_from_world * normal(at), light_from_world * -ray.direction);
            let albedo = Vec3::new(0.4, 0.3, 0.2) * if at.x > 0.0 { 1.0 } else { 0.4 };
            let diffuse = albedo * (0.6 + 0.4 * n.y);
            image.pixels.push(diffuse + gloss * room(2.0 * n.dot(v) * n - v));
        }
        let mask = StoredMask::new(&Mask { width: SIDE, height: SIDE, coverage });
        (camera, Photograph::of_image(&image), mask)
    };
    axes.map(shoot).collect()
}

/// The photographs as views of which each process has all.
fn views_of(shot: &[(Camera, Photograph, StoredMask)]) -> TrainingViews<'_> {
    everybodys_views(shot.iter().map(|(camera, photograph, mask)| (camera, photograph, mask)))
}

/// Refines the normals of a ball; returns the report, and mean angles to `truth` before and after, in degrees.
fn refined(normal: fn(Vec3) -> Vec3, gloss: f32, frame: LightFrame) -> (NormalReport, [f32; 2]) {
    let shot = photographed(normal, gloss, frame);
    let views = views_of(&shot);
    let mut mesh = sphere_mesh(Vec3::ZERO, 1.0).unwrap();
    let off = |mesh: &Mesh| {
        let angle = |(at, n): (&Vec3, &Vec3)| n.angle_between(normal(*at)).to_degrees();
        mesh.positions.iter().zip(&mesh.normals).map(angle).sum::<f32>() / mesh.positions.len() as f32
    };
    let before = off(&mesh);
    let placed = PlacedFrame { frame, placements: Placements::default() };
    let report = refine_normals(&mut mesh, &views, &placed, |_| ControlFlow::Continue(())).unwrap();
    assert!(mesh.normals.iter().all(|n| n.is_normalized()));
    (report, [before, off(&mesh)])
}

#[test]
fn dents_of_a_glossy_ball_are_found_by_what_they_mirror() {
    for frame in [LightFrame::World, LightFrame::Camera] {
        let (report, [before, after]) = refined(hammered, 0.3, frame);
        assert!(
            report.error.unwrap() < 0.8 && after < 0.7 * before,
            "{frame:?}: {report:?}, {before}° {after}°"
        );
    }
}

#[test]
fn a_smooth_ball_keeps_its_normals() {
    let (report, [before, after]) = refined(Vec3::normalize, 0.3, LightFrame::World);
    // It explains nearly all, so nothing is searched.
    assert!(report.unexplained < 0.1 && report.error.is_none(), "{report:?}");
    assert!(report.turned_degrees == 0.0 && before == after, "{report:?}, {before}° {after}°");
}

#[test]
fn a_search_that_is_stopped_changes_nothing() {
    let shot = photographed(hammered, 0.3, LightFrame::World);
    let views = views_of(&shot);
    let mut mesh = sphere_mesh(Vec3::ZERO, 1.0).unwrap();
    let given = mesh.normals.clone();
    for last in [0, 1, rounds() - 1] {
        let stop = |round| if round == last { ControlFlow::Break(()) } else { ControlFlow::Continue(()) };
        let report = refine_normals(&mut mesh, &views, &PlacedFrame::default(), stop).unwrap();
        assert_eq!(report.turned_degrees, 0.0);
        assert_eq!(mesh.normals, given);
    }
}
