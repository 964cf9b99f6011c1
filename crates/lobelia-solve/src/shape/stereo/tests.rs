use super::*;
use crate::shape::test_support::{Pictures, around, meets_ball};
use lobelia_geometry::{mesh::primitive::sphere_mesh, sdf::SdfGrid};
use std::ops::ControlFlow::Continue;

/// A sphere of radius 1 with a fine pattern, without shading, as cameras around it see it.
fn patterned() -> Pictures {
    pictures(60, |at, _| pattern(at))
}

/// A ball whose color depends on the place and on the direction in which a ray goes on from there.
fn pictures(views: usize, color: impl Fn(Vec3, Vec3) -> Vec3 + Sync) -> Pictures {
    Pictures::new(around(views, 3.5, 128), |_, ray| {
        let p = ray.origin + ray.direction * meets_ball(ray, Vec3::ZERO, 1.0)?;
        Some(color(p, ray.direction - p * (2.0 * p.dot(ray.direction))))
    })
}

fn pattern(p: Vec3) -> Vec3 {
    let waves = (31.0 * p.x).sin()
        + (27.0 * p.y + 1.0).sin()
        + (29.0 * p.z + 2.0).sin()
        + (17.0 * (p.x + p.y - p.z)).sin();
    Vec3::splat(0.3 + 0.06 * waves)
}

/// A sphere with bumps and dents of up to 3 % of its radius.
fn bumpy() -> Mesh {
    let mut mesh = sphere_mesh(Vec3::ZERO, 1.0).unwrap();
    mesh.uvs = None;
    for p in &mut mesh.positions {
        *p *= 1.0 + 0.03 * (4.0 * p.x).sin() * (3.0 * p.y + 1.0).cos();
    }
    mesh
}

fn error(squared: f32) -> ModelError {
    let mut error = ModelError::new(&SdfGrid::from_fn(Vec3::ZERO, 1.3, 24, |p| p.length() - 1.0));
    error.sums.fill([squared, 1.0]);
    error
}

fn off(mesh: &Mesh) -> f32 {
    mesh.positions.iter().map(|p| (p.length() - 1.0).abs()).sum::<f32>() / mesh.positions.len() as f32
}

fn refined(mesh: &mut Mesh, pictures: &Pictures, squared: f32) -> StereoReport {
    refine(mesh, &pictures.views(), &[], &error(squared), |_| Continue(()))
}

#[test]
fn a_mesh_moves_to_where_photographs_agree() {
    let (pictures, mut mesh) = (patterned(), bumpy());
    let (before, triangles) = (off(&mesh), mesh.triangles.clone());
    let report = refined(&mut mesh, &pictures, 0.01);
    assert!(off(&mesh) < 0.25 * before, "{before} {} {report:?}", off(&mesh));
    assert!(report.trusted > 0.5 && report.moved > 0.005);
    assert_eq!(mesh.triangles, triangles);
    assert!(mesh.normals.iter().all(|n| (n.length() - 1.0).abs() < 1e-4));
    let turned = mesh.normals.iter().zip(&mesh.positions).map(|(n, p)| n.angle_between(*p));
    assert!(turned.sum::<f32>() / (mesh.normals.len() as f32) < 0.1);
}

#[test]
fn a_mesh_stays_where_the_model_explains_the_photographs() {
    let (pictures, mut mesh) = (patterned(), bumpy());
    let before = mesh.clone();
    let report = refined(&mut mesh, &pictures, 1e-5);
    assert_eq!(report, StereoReport::default());
    assert_eq!(mesh, before);
}

#[test]
fn a_mesh_stays_where_only_a_spot_of_it_agrees() {
    // How many vertices are trusted in the first round, and how far all move.
    let moved = |above: f32| {
        let cap = |p: Vec3, _| if p.z > above { pattern(p) } else { Vec3::splat(0.3) };
        let (spotted, mut mesh) = (pictures(60, cap), bumpy());
        let (views, (relative, search)) = (spotted.views(), ROUNDS[0]);
        let small = MatchPicture::of_views(&views, relative * finest_factor(&mesh, &views).unwrap());
        let votes = all_votes(&TriangleBvh::new(&mesh), &Shell::new(&mesh), &small, search);
        let trusted = votes.iter().filter(|vote| vote.share() > TRUSTED).count();
        (trusted, refine(&mut mesh, &views, &[], &error(0.01), |_| Continue(())).moved)
    };
    let (spot, half) = (moved(0.985), moved(0.0));
    assert!(spot.0 > 0 && spot.1 == 0.0 && half.1 > 0.001, "{spot:?} {half:?}");
}

#[test]
fn bits_do_not_depend_on_the_number_of_threads() {
    let pictures = pictures(40, |at, _| pattern(at));
    let refined = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let mut mesh = bumpy();
        pool.install(|| refined(&mut mesh, &pictures, 0.01));
        mesh
    };
    let one = refined(1);
    assert!(one != bumpy(), "nothing moves");
    assert_eq!(one, refined(3));
}

#[test]
fn nothing_moves_without_views_or_when_stopped() {
    let (pictures, mut mesh) = (patterned(), bumpy());
    let before = mesh.clone();
    assert_eq!(refine(&mut mesh, &[], &[], &error(0.01), |_| Continue(())), StereoReport::default());
    let stopped = refine(&mut mesh, &pictures.views(), &[], &error(0.01), |_| ControlFlow::Break(()));
    assert_eq!(stopped.moved, 0.0);
    assert_eq!(mesh, before);
}

#[test]
fn votes_count_where_the_model_fails_and_views_agree() {
    // Errors, variances and spreads as measured on patterned fabric and on glossy paint.
    assert!(gate(0.005, 0.01, 0.03) > 0.6);
    assert!(gate(0.0003, 0.004, 0.03) < 0.1, "the model explains it");
    assert!(gate(0.005, 0.01, 1.0) < 0.05, "views contradict each other");
    assert_eq!(gate(0.0, 0.0, 0.0), 0.0);
    assert_eq!(object_gate(&[0.0, 0.0]), 0.0);
    assert_eq!(object_gate(&[0.0, 0.02, 0.03, 0.9]), 0.0);
    assert_eq!(object_gate(&[0.7, 0.8, 0.0]), 1.0);
}

#[test]
fn what_a_ball_mirrors_leaves_no_dents() {
    let mirroring = pictures(60, |_, to| pattern(0.4 * to));
    let mut mesh = sphere_mesh(Vec3::ZERO, 1.0).unwrap();
    mesh.uvs = None;
    let before = off(&mesh);
    refined(&mut mesh, &mirroring, 0.01);
    assert!(off(&mesh) < before + 5e-4, "{before} {}", off(&mesh));
}
