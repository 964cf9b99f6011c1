use super::*;
use crate::shape::test_support::{Pictures, meets_ball};
use lobelia_geometry::{mesh::primitive::sphere_mesh, view::Camera};
use lobelia_sg::fibonacci::fibonacci_axes;
use lobelia_world::light::{light_frame::LightFrame, placement::Placements};

const PIXELS: u32 = 160;

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

/// Photographs of a ball with these normals, of which a share `gloss` is mirrored.
fn photographed(normal: fn(Vec3) -> Vec3, gloss: f32, frame: LightFrame) -> Pictures {
    Pictures::new(Camera::around(40, 4.0, 32.0, PIXELS).unwrap(), |camera, ray| {
        let at = ray.origin + ray.direction * meets_ball(ray, Vec3::ZERO, 1.0)?;
        let light_from_world = frame.light_from_world(camera.world_from_camera.matrix3.into());
        let (n, v) = (light_from_world * normal(at), light_from_world * -ray.direction);
        let albedo = Vec3::new(0.4, 0.3, 0.2) * if at.x > 0.0 { 1.0 } else { 0.4 };
        Some(albedo * (0.6 + 0.4 * n.y) + gloss * room(2.0 * n.dot(v) * n - v))
    })
}

/// Refines the normals of a ball; returns the report, and mean angles to `truth` before and after,
/// in degrees.
fn refined(normal: fn(Vec3) -> Vec3, gloss: f32, frame: LightFrame) -> (NormalReport, [f32; 2]) {
    let shot = photographed(normal, gloss, frame);
    let views = shot.views();
    let mut mesh = sphere_mesh(Vec3::ZERO, 1.0).unwrap();
    let off = |mesh: &Mesh| {
        let angle = |(at, n): (&Vec3, &Vec3)| n.angle_between(normal(*at)).to_degrees();
        mesh.positions.iter().zip(&mesh.normals).map(angle).sum::<f32>() / mesh.positions.len() as f32
    };
    let before = off(&mesh);
    let placed = PlacedFrame { frame, placements: Placements::default() };
    let report = refine_normals(&mut mesh, &views, &placed, |_| ControlFlow::Continue(()));
    assert!(mesh.normals.iter().all(|n| n.is_normalized()));
    (report, [before, off(&mesh)])
}

#[test]
fn dents_of_a_glossy_ball_are_found_by_what_they_mirror() {
    for frame in [LightFrame::World, LightFrame::Camera] {
        let (report, [before, after]) = refined(hammered, 0.3, frame);
        let is_better = report.error.unwrap() < 0.8 && after < 0.7 * before;
        assert!(is_better, "{frame:?}: {report:?}, {before}° {after}°");
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
    let views = shot.views();
    let mut mesh = sphere_mesh(Vec3::ZERO, 1.0).unwrap();
    let given = mesh.normals.clone();
    for last in [0, 1, rounds() - 1] {
        let stop = |round| if round == last { ControlFlow::Break(()) } else { ControlFlow::Continue(()) };
        let report = refine_normals(&mut mesh, &views, &PlacedFrame::default(), stop);
        assert_eq!(report.turned_degrees, 0.0);
        assert_eq!(mesh.normals, given);
    }
}

#[test]
fn colors_are_those_with_the_least_error() {
    let mut sums = ProductSums::default();
    let truth = VertexColors { diffuse: Vec3::new(0.2, 0.0, 0.5), mirrored: Vec3::new(0.1, 0.7, 0.0) };
    for i in 0..40 {
        let (e, m) = (Vec3::splat(0.5 + 0.02 * i as f32), Vec3::splat(if i % 9 == 0 { 5.0 } else { 0.1 }));
        let l = truth.diffuse * e + truth.mirrored * m;
        sums.add(1.0 / (0.1 + l.element_sum()), e, m, l);
    }
    let found = sums.colors();
    assert!((found.diffuse - truth.diffuse).abs().max_element() < 0.01, "{found:?}");
    assert!((found.mirrored - truth.mirrored).abs().max_element() < 0.01, "{found:?}");
    let least = sums.error(&found);
    for c in 0..3 {
        for change in [-0.05, 0.05] {
            let mut other = found;
            other.diffuse[c] = (other.diffuse[c] + change).max(0.0);
            assert!(sums.error(&other) >= least - 1e-5, "{c} {change}");
        }
    }
}

#[test]
fn a_table_is_found_from_products() {
    let truth = |axis: Vec3| Vec3::new(1.0 + axis.x, 0.5, 1.0 - axis.y);
    let mut sums = vec![CellSums::default(); SIDE * SIDE];
    for (i, axis) in fibonacci_axes(20_000).into_iter().enumerate() {
        let factor = Vec3::splat(0.2 + 0.1 * (i % 7) as f32);
        sums[cell(axis)].add(1.0, factor, factor * truth(axis));
    }
    for share in [None, Some(0.05)] {
        let table = DirectionTable::of_sums(&sums, 200.0, share);
        let off = fibonacci_axes(300).into_iter().map(|axis| table.at(axis) - truth(axis));
        assert!(off.map(|off| off.abs().max_element()).fold(0.0, f32::max) < 0.08);
    }
}

#[test]
fn where_nothing_is_seen_the_surroundings_count() {
    let mut sums = vec![CellSums::default(); SIDE * SIDE];
    sums[cell(Vec3::Z)].add(1.0, Vec3::ONE, Vec3::splat(2.0));
    let table = DirectionTable::of_sums(&sums, 60.0, Some(0.05));
    assert!((table.at(Vec3::Z) - 2.0).abs().max_element() < 1e-3);
    assert!((table.at(Vec3::X) - 2.0).abs().max_element() < 0.1, "{}", table.at(Vec3::X));
}
