//! The Chamfer distance between two surfaces.

use crate::mesh::nearest::NearestTriangle;
use crate::mesh::triangles::Mesh;
use glam::Vec3;
use rand::{RngExt, SeedableRng, rngs::SmallRng};
use rayon::prelude::*;

/// Points taken on each surface.
const SAMPLES: usize = 100_000;

/// The mean of the two directed mean distances, in the unit of the meshes: exact distances from points distributed uniformly over each
/// surface to the nearest point of the other mesh.
///
/// The same meshes and seed give the same bits. `None` if a mesh has zero area.
pub fn chamfer_distance(a: &Mesh, b: &Mesh, seed: u64) -> Option<f64> {
    Some(0.5 * (directed(a, b, seed)? + directed(b, a, seed.wrapping_add(1))?))
}

fn directed(from: &Mesh, onto: &Mesh, seed: u64) -> Option<f64> {
    let nearest = NearestTriangle::new(onto);
    let points = spread_points(from, SAMPLES, seed)?;
    let distances: Option<Vec<f32>> =
        points.par_iter().map(|&point| nearest.nearest(point).map(|found| found.distance)).collect();
    Some(distances?.into_iter().map(f64::from).sum::<f64>() / SAMPLES as f64)
}

/// `count` points on the surface, one at random in each of `count` parts of equal area; `None` if the area is zero.
fn spread_points(mesh: &Mesh, count: usize, seed: u64) -> Option<Vec<Vec3>> {
    let total = mesh.area();
    if !(total > 0.0 && total.is_finite()) {
        return None;
    }
    let mut rng = SmallRng::seed_from_u64(seed);
    let area = |t: usize| {
        let [a, b, c] = mesh.corners(t).map(|corner| corner.as_dvec3());
        0.5 * (b - a).cross(c - a).length()
    };
    let (mut triangle, mut reached) = (0, area(0));
    let mut points = Vec::with_capacity(count);
    for part in 0..count {
        let target = (part as f64 + rng.random::<f64>()) / count as f64 * total;
        while reached < target && triangle + 1 < mesh.triangles.len() {
            triangle += 1;
            reached += area(triangle);
        }
        let [a, b, c] = mesh.corners(triangle);
        let (u, v): (f32, f32) = (rng.random(), rng.random());
        let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
        points.push(a + (b - a) * u + (c - a) * v);
    }
    Some(points)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::primitive::{box_mesh, sphere_mesh};

    #[test]
    fn known_distances_are_found() {
        let sphere = |radius| sphere_mesh(Vec3::new(0.3, 0.2, 0.1), radius).unwrap();
        assert!(chamfer_distance(&sphere(0.9), &sphere(0.9), 1).unwrap() < 1e-7);
        let shell = chamfer_distance(&sphere(0.9), &sphere(0.91), 1).unwrap();
        assert!((shell - 0.01).abs() < 1e-5, "{shell}");
        assert_eq!(chamfer_distance(&sphere(0.9), &sphere(0.91), 1), Some(shell), "not the same bits");
        let slab = |low: Vec3, size: Vec3| box_mesh(low + size / 2.0, size).unwrap();
        let (near, far) = (slab(Vec3::ZERO, Vec3::ONE), slab(Vec3::new(0.0, 5.0, 0.0), Vec3::ONE));
        let apart = chamfer_distance(&near, &far, 3).unwrap();
        // Of the faces of a unit cube one is 4 away, one 5, and the sides 4 to 5.
        assert!((apart - 4.5).abs() < 1e-3, "{apart}");
        assert_eq!(chamfer_distance(&near, &Mesh::default(), 0), None);
    }

    #[test]
    fn points_are_spread_by_area() {
        // Top and bottom of a slab ten times as wide as high are 200 of 240 parts of its surface.
        let mesh = box_mesh(Vec3::ZERO, Vec3::new(10.0, 1.0, 10.0)).unwrap();
        let points = spread_points(&mesh, 24_000, 0).unwrap();
        let on_top = points.iter().filter(|p| p.y.abs() > 0.499_999).count();
        assert!((on_top as f64 / 24_000.0 - 200.0 / 240.0).abs() < 1e-3, "{on_top}");
        let middle = points.iter().sum::<Vec3>() / 24_000.0;
        assert!(middle.length() < 0.1, "{middle}");
    }
}
