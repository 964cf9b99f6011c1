//! Rays against surfaces, compared with brute force and with formulas.

use super::*;
use primitive::{box_mesh, sphere_mesh};
use rand::{RngExt, SeedableRng, rngs::StdRng};
use std::{collections::HashMap, f32::consts::TAU};

fn unit_vector(rng: &mut StdRng) -> Vec3 {
    let z = rng.random_range(-1.0f32..1.0);
    let angle = rng.random_range(0.0..TAU);
    let r = (1.0 - z * z).max(0.0).sqrt();
    Vec3::new(r * angle.cos(), r * angle.sin(), z).normalize()
}

/// Random triangles floating about.
fn triangle_soup(rng: &mut StdRng, count: u32) -> Mesh {
    let mut mesh = Mesh { uvs: Some(Vec::new()), ..Mesh::default() };
    for k in 0..count {
        let middle = unit_vector(rng) * rng.random_range(0.0..1.0f32);
        for _ in 0..3 {
            mesh.positions.push(middle + unit_vector(rng) * 0.1);
            mesh.uvs.as_mut().unwrap().push(Vec2::new(rng.random(), rng.random()));
        }
        mesh.triangles.push([3 * k, 3 * k + 1, 3 * k + 2]);
    }
    mesh.repair_normals();
    mesh
}

/// The nearest distance and triangle, by Möller–Trumbore in f64 over all of them.
fn brute_force(mesh: &Mesh, ray: &Ray, min_distance: f64) -> Option<(f64, usize)> {
    let (origin, direction) = (ray.origin.as_dvec3(), ray.direction.as_dvec3());
    let hit = |t: usize| {
        let [a, b, c] = mesh.corners(t).map(|p| p.as_dvec3());
        let p = direction.cross(c - a);
        let determinant = (b - a).dot(p);
        let u = (origin - a).dot(p) / determinant;
        let q = (origin - a).cross(b - a);
        let v = direction.dot(q) / determinant;
        let distance = (c - a).dot(q) / determinant;
        (u >= 0.0 && v >= 0.0 && u + v <= 1.0 && distance > min_distance).then_some((distance, t))
    };
    (0..mesh.triangles.len()).filter_map(hit).min_by(|a, b| a.0.total_cmp(&b.0))
}

#[test]
fn rays_agree_with_brute_force() {
    let mut rng = StdRng::seed_from_u64(1);
    let soup = triangle_soup(&mut rng, 400);
    let surface = Surface::new(soup.clone(), 16).unwrap();
    let (mut hits, mut doubtful) = (0, 0);
    for k in 0..5_000 {
        // From outside, from inside, and from far away.
        let origin = unit_vector(&mut rng) * [3.0, 0.5, 50.0][k % 3];
        let target = unit_vector(&mut rng) * rng.random_range(0.0..1.2f32);
        let ray = Ray { origin, direction: (target - origin).normalize() };
        let min_distance = if k % 2 == 0 { 0.0 } else { 0.3 };
        let expected = brute_force(&soup, &ray, f64::from(min_distance));
        match (surface.intersect(&ray, min_distance), expected) {
            (None, None) => assert!(!surface.occluded(&ray, min_distance, f32::INFINITY)),
            (Some(hit), Some((distance, triangle)))
                if (f64::from(hit.distance) - distance).abs() < 2e-5 * (1.0 + distance) =>
            {
                hits += 1;
                let off = hit.position.distance(ray.origin + ray.direction * hit.distance);
                assert!(off < 2e-5 * (1.0 + hit.distance));
                assert_eq!(hit.geometric_normal, soup.geometric_normal(triangle));
                assert!(surface.occluded(&ray, min_distance, hit.distance * 1.001));
                if hit.distance > min_distance * 1.01 + 0.01 {
                    assert!(!surface.occluded(&ray, min_distance, hit.distance * 0.999));
                }
            }
            // Grazing an edge, f32 and f64 may differ.
            _ => doubtful += 1,
        }
    }
    assert!(hits > 1_500, "{hits}");
    assert!(doubtful <= 5, "{doubtful}");
}

#[test]
fn a_hit_carries_interpolated_attributes() {
    let (center, radius) = (Vec3::new(3.0, -1.0, 0.5), 2.0);
    let surface = Surface::new(sphere_mesh(center, radius).unwrap(), 64).unwrap();
    let mut rng = StdRng::seed_from_u64(2);
    for k in 0..2_000 {
        let outward = unit_vector(&mut rng);
        // Radial rays from outside and from the center: the normal is the outer one in both.
        let ray = if k % 2 == 0 {
            Ray { origin: center + outward * 10.0, direction: -outward }
        } else {
            Ray { origin: center, direction: outward }
        };
        let hit = surface.intersect(&ray, 0.0).unwrap();
        let distance = if k % 2 == 0 { 10.0 - radius } else { radius };
        assert!((hit.distance - distance).abs() < 2e-3);
        assert!((hit.normal - outward).length() < 2e-3 && hit.normal.is_normalized());
        assert!(hit.geometric_normal.dot(outward) > 0.999);
        let phi = outward.y.acos() / std::f32::consts::PI;
        assert!((hit.uv.y - phi).abs() < 2e-3, "{} {phi}", hit.uv.y);
        let weights: f32 = hit.texels.weights.iter().sum();
        assert!((weights - 1.0).abs() < 1e-6);
        assert_eq!(hit.texels, address(hit.uv, 64, 64));
    }
}

#[test]
fn no_ray_slips_between_triangles_at_edges_and_corners() {
    let mut rng = StdRng::seed_from_u64(4);
    for (count, scale) in [(1, 1.0), (8, 1.0), (4, 1e-4), (2, 1e4)] {
        let mut mesh = ball(count, 0.0);
        mesh.uvs = Some(mesh.positions.iter().map(|p| p.truncate() * 0.2 + 0.5).collect());
        mesh.positions.iter_mut().for_each(|p| *p = *p * scale + Vec3::new(0.1, -0.2, 0.3) * scale);
        let surface = Surface::new(mesh.clone(), 8).unwrap();
        for k in 0..25_000 {
            let t =
                mesh.triangles[rng.random_range(0..mesh.triangles.len())].map(|v| mesh.positions[v as usize]);
            let part = [0.0, 0.5, rng.random_range(0.0..1.0f32)][k % 3];
            let target = t[0].lerp(t[1], part);
            let center = surface.bounding_sphere().0;
            // Towards the edge from where it is not a silhouette: within 30° of the outward
            // direction.
            let outward = (target - center).normalize();
            let origin = target
                + (outward + unit_vector(&mut rng) * 0.5).normalize() * scale * [0.01, 2.0, 9.0][k / 3 % 3];
            let ray = Ray { origin, direction: (target - origin).normalize() };
            let hit = surface.intersect(&ray, 0.0).unwrap_or_else(|| panic!("slipped through at {target}"));
            let miss_by = (hit.distance - target.distance(origin)).abs();
            assert!(miss_by < 1e-4 * scale, "{miss_by} at scale {scale}");
            assert!(surface.occluded(&ray, 0.0, f32::INFINITY));
        }
    }
}

#[test]
fn axis_parallel_rays_hit_flat_boxes() {
    let surface = Surface::new(box_mesh(Vec3::ZERO, Vec3::new(2.0, 2.0, 1e-3)).unwrap(), 16).unwrap();
    for x in -9..=9 {
        for y in -9..=9 {
            let origin = Vec3::new(x as f32 / 9.0, y as f32 / 9.0, 5.0);
            let hit = surface.intersect(&Ray { origin, direction: Vec3::NEG_Z }, 0.0).unwrap();
            assert!((hit.distance - 4.9995).abs() < 1e-5);
            assert_eq!(hit.normal, Vec3::Z);
        }
    }
    let beside = Ray { origin: Vec3::new(1.01, 0.0, 5.0), direction: Vec3::NEG_Z };
    assert!(surface.intersect(&beside, 0.0).is_none());
    // The far side, by starting beyond the near one.
    let through = Ray { origin: Vec3::new(0.2, 0.1, 5.0), direction: Vec3::NEG_Z };
    assert!((surface.intersect(&through, 4.9998).unwrap().distance - 5.0005).abs() < 1e-5);
    assert!(surface.intersect(&through, 6.0).is_none());
}

#[test]
fn inside_and_outside_are_told_apart() {
    let center = Vec3::new(-2.0, 1.0, 0.0);
    let surface = Surface::new(sphere_mesh(center, 1.5).unwrap(), 8).unwrap();
    let mut rng = StdRng::seed_from_u64(5);
    for _ in 0..500 {
        let direction = unit_vector(&mut rng);
        assert!(surface.is_inside(center + direction * rng.random_range(0.0..1.49f32)));
        assert!(!surface.is_inside(center + direction * rng.random_range(1.51..20.0f32)));
    }
    assert!(!surface.is_inside(Vec3::NAN));
}

#[test]
fn rays_that_are_no_rays_meet_nothing() {
    let surface = Surface::new(box_mesh(Vec3::ZERO, Vec3::ONE).unwrap(), 8).unwrap();
    for ray in [
        Ray { origin: Vec3::NAN, direction: Vec3::X },
        Ray { origin: Vec3::ZERO, direction: Vec3::ZERO },
        Ray { origin: Vec3::INFINITY, direction: Vec3::X },
        Ray { origin: Vec3::ZERO, direction: Vec3::NAN },
    ] {
        assert_eq!(surface.intersect(&ray, 0.0), None);
        assert!(!surface.occluded(&ray, 0.0, f32::INFINITY));
    }
    let good = Ray { origin: Vec3::X * 3.0, direction: Vec3::NEG_X };
    assert!(!surface.occluded(&good, 0.0, f32::NAN) && !surface.occluded(&good, 3.0, 1.0));
}

#[test]
fn unusable_meshes_are_refused() {
    let good = box_mesh(Vec3::ZERO, Vec3::ONE).unwrap();
    let changed = |change: &dyn Fn(&mut Mesh)| {
        let mut mesh = good.clone();
        change(&mut mesh);
        Surface::new(mesh, 8).err().map(|e| e.to_string()).unwrap_or_default()
    };
    assert!(changed(&|m| m.uvs = None).contains("no texture coordinates"));
    assert!(changed(&|m| m.triangles.clear()).contains("no triangles"));
    assert!(changed(&|m| m.triangles[2][1] = 99).contains("triangle 2 names a vertex beyond the 24"));
    assert!(changed(&|m| m.positions[5].x = f32::NAN).contains("vertex 5 is not finite"));
    assert!(changed(&|m| m.normals.truncate(3)).contains("must be equal"));
    assert!(changed(&|m| m.triangles[3] = [1, 1, 2]).contains("triangle 3 has no area"));
    assert!(changed(&|m| m.positions[5].x = 1e20).contains("vertex 5 is at"));
    for size in [0, MAX_TEXTURE_SIZE + 1] {
        assert!(matches!(Surface::new(good.clone(), size), Err(Error::Usage { .. })));
    }
}

/// A grid of vertices, `columns` × `rows`, closed along x, along both, or open; two triangles for
/// each square.
fn grid(columns: u32, rows: u32, closed: [bool; 2], place: impl Fn(f32, f32) -> Vec3) -> Mesh {
    let squares = |count: u32, closed: bool| if closed { count } else { count - 1 };
    let (across, along) = (squares(columns, closed[0]), squares(rows, closed[1]));
    let mut mesh = Mesh::default();
    for (x, y) in (0..rows).flat_map(|y| (0..columns).map(move |x| (x, y))) {
        mesh.positions.push(place(x as f32 / across as f32, y as f32 / along as f32));
    }
    for (x, y) in (0..along).flat_map(|y| (0..across).map(move |x| (x, y))) {
        let at = |x: u32, y: u32| (y % rows) * columns + x % columns;
        let [a, b, c, d] = [at(x, y), at(x + 1, y), at(x + 1, y + 1), at(x, y + 1)];
        mesh.triangles.extend([[a, b, c], [a, c, d]]);
    }
    mesh.repair_normals();
    mesh
}

/// A flat square from −1 to 1 in x and y, of `count`² squares.
pub(crate) fn plate(count: u32) -> Mesh {
    grid(count + 1, count + 1, [false; 2], |x, y| Vec3::new(2.0 * x - 1.0, 2.0 * y - 1.0, 0.0))
}

/// A tube of radius 1 and length 3 around z, open at both ends.
pub(crate) fn tube(around: u32, along: u32) -> Mesh {
    grid(around, along, [true, false], |x, y| Vec3::new((TAU * x).cos(), (TAU * x).sin(), 3.0 * y))
}

/// A torus of radii 1 and 0.4 around z.
pub(crate) fn torus(around: u32, across: u32) -> Mesh {
    grid(around, across, [true; 2], |x, y| {
        let radius = 1.0 + 0.4 * (TAU * y).cos();
        Vec3::new(radius * (TAU * x).cos(), radius * (TAU * x).sin(), 0.4 * (TAU * y).sin())
    })
}

/// A closed ball of radius 1, made of a cube with `count`² squares a face; each vertex is moved by
/// at most `noise` outward or inward.
pub(crate) fn ball(count: u32, noise: f32) -> Mesh {
    let mut mesh = Mesh::default();
    for axis in 0..3 {
        for sign in [-1.0, 1.0] {
            let face = plate(count);
            let first = mesh.positions.len() as u32;
            // The same bits on both sides of an edge of the cube.
            let even = |c: f32| (c * count as f32).round() / count as f32;
            let place = |p: &Vec3| {
                let mut at = [sign, even(p.x) * sign, even(p.y)];
                at.rotate_right(axis);
                let on_ball = Vec3::from(at).normalize();
                // Of the place alone, so that vertices of two faces stay together.
                let wild = (on_ball.dot(Vec3::new(127.1, 311.7, 74.7)) * 43.7).sin();
                on_ball * (1.0 + noise * wild)
            };
            mesh.positions.extend(face.positions.iter().map(place));
            mesh.triangles.extend(face.triangles.iter().map(|t| t.map(|v| v + first)));
        }
    }
    mesh.repair_normals();
    mesh
}

/// Triangles apart from each other.
pub(crate) fn scattered(count: u32) -> Mesh {
    let mut mesh = Mesh::default();
    for k in 0..count {
        let p = Vec3::new(k as f32, 0.0, 0.0);
        mesh.positions.extend([p, p + Vec3::X * 0.5, p + Vec3::Y]);
        mesh.triangles.push([3 * k, 3 * k + 1, 3 * k + 2]);
    }
    mesh.repair_normals();
    mesh
}

/// Whether each edge has one triangle on either side; vertices at one position are one.
pub(crate) fn is_closed(mesh: &Mesh) -> bool {
    let weld = mesh.welded_vertices();
    // How many triangles run along each edge in each direction.
    let mut edges = HashMap::new();
    for triangle in &mesh.triangles {
        let [a, b, c] = triangle.map(|v| weld[v as usize]);
        [[a, b], [b, c], [c, a]].into_iter().for_each(|edge| *edges.entry(edge).or_insert(0) += 1);
    }
    edges.iter().all(|([a, b], count)| *count == 1 && edges.get(&[*b, *a]) == Some(&1))
}
