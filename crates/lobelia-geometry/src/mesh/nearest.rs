//! The point of a mesh that is nearest to a given point, exactly, and the Chamfer distance between
//! two surfaces. Both search a hierarchy of boxes around the triangles.
//!
//! ```
//! use glam::Vec3;
//! use lobelia_geometry::mesh::{nearest::NearestTriangle, primitive::box_mesh};
//!
//! let cube = box_mesh(Vec3::ZERO, Vec3::splat(2.0))?;
//! // The nearest point is (1, 1, 0), on an edge.
//! let found = NearestTriangle::new(&cube).nearest(Vec3::new(4.0, 5.0, 0.0));
//! assert!(found.is_some_and(|found| (found.distance - 5.0).abs() < 1e-5));
//! # Ok::<(), lobelia_geometry::Error>(())
//! ```

use crate::mesh::bvh::{TriangleHit, binary_hierarchy};
use crate::{mesh::triangles::Mesh, parallel};
use glam::{Vec3, Vec3A};
use obvhs::{aabb::Aabb, bvh2::Bvh2};
use rand::{RngExt, SeedableRng, rngs::SmallRng};

/// A hierarchy over the triangles of a mesh, for nearest-point queries.
pub struct NearestTriangle {
    bvh: Bvh2,
    corners: Vec<[Vec3A; 3]>,
}

impl NearestTriangle {
    /// Builds the hierarchy; the same mesh gives the same one.
    pub fn new(mesh: &Mesh) -> Self {
        let (bvh, ..) = binary_hierarchy(mesh);
        let corners = (0..mesh.triangles.len()).map(|t| mesh.corners(t).map(Vec3A::from)).collect();
        Self { bvh, corners }
    }

    /// The nearest triangle, the weights of its nearest point, and the distance; `None` without
    /// triangles.
    pub fn nearest(&self, point: Vec3) -> Option<TriangleHit> {
        let point = Vec3A::from(point);
        let mut found = None;
        let mut best = f32::INFINITY;
        let mut open = Vec::with_capacity(64);
        open.extend((!self.corners.is_empty()).then_some((0.0, 0)));
        while let Some((bound, index)) = open.pop() {
            if bound >= best {
                continue;
            }
            let node = &self.bvh.nodes[index];
            let first = node.first_index as usize;
            if node.is_leaf() {
                for &triangle in &self.bvh.primitive_indices[first..first + node.prim_count as usize] {
                    let (squared, weights) = nearest_in_triangle(&self.corners[triangle as usize], point);
                    if squared < best {
                        best = squared;
                        found = Some(TriangleHit { triangle, distance: squared.sqrt(), weights });
                    }
                }
                continue;
            }
            let [a, b] = [first, first + 1].map(|i| (squared_distance(self.bvh.nodes[i].aabb(), point), i));
            // The nearer child is visited first.
            open.extend(if a.0 < b.0 { [b, a] } else { [a, b] });
        }
        found
    }
}

fn squared_distance(bounds: &Aabb, point: Vec3A) -> f32 {
    (point - point.clamp(bounds.min, bounds.max)).length_squared()
}

/// Squared distance and corner weights of the triangle's point nearest to `point` (Ericson,
/// "Real-Time Collision Detection", 5.1.5).
fn nearest_in_triangle(&[a, b, c]: &[Vec3A; 3], point: Vec3A) -> (f32, [f32; 3]) {
    let (ab, ac) = (b - a, c - a);
    let seen_from = |corner: Vec3A| (ab.dot(point - corner), ac.dot(point - corner));
    let [(d1, d2), (d3, d4), (d5, d6)] = [a, b, c].map(seen_from);
    let (va, vb, vc) = (d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2);
    let weights = if d1 <= 0.0 && d2 <= 0.0 {
        [1.0, 0.0, 0.0]
    } else if d3 >= 0.0 && d4 <= d3 {
        [0.0, 1.0, 0.0]
    } else if d6 >= 0.0 && d5 <= d6 {
        [0.0, 0.0, 1.0]
    } else if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        let t = d1 / (d1 - d3);
        [1.0 - t, t, 0.0]
    } else if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        let t = d2 / (d2 - d6);
        [1.0 - t, 0.0, t]
    } else if va <= 0.0 && d4 >= d3 && d5 >= d6 {
        let t = (d4 - d3) / ((d4 - d3) + (d5 - d6));
        [0.0, 1.0 - t, t]
    } else {
        let sum = va + vb + vc;
        [va / sum, vb / sum, vc / sum]
    };
    let nearest = a * weights[0] + b * weights[1] + c * weights[2];
    (nearest.distance_squared(point), weights)
}

/// Points taken on each surface.
const SAMPLES: usize = 100_000;

/// The mean of the two directed mean distances, in the unit of the meshes: exact distances from
/// points distributed uniformly over each surface to the nearest point of the other mesh.
///
/// Equal meshes and seeds give equal bits. `None` if a mesh has zero area.
pub fn chamfer_distance(a: &Mesh, b: &Mesh, seed: u64) -> Option<f64> {
    Some(0.5 * (directed(a, b, seed)? + directed(b, a, seed.wrapping_add(1))?))
}

fn directed(from: &Mesh, onto: &Mesh, seed: u64) -> Option<f64> {
    let nearest = NearestTriangle::new(onto);
    let points = spread_points(from, SAMPLES, seed)?;
    let distance = |&point: &Vec3| nearest.nearest(point).map(|found| found.distance);
    let distances = parallel::map_slice(&points, 64, distance).into_iter().collect::<Option<Vec<f32>>>();
    Some(distances?.into_iter().map(f64::from).sum::<f64>() / SAMPLES as f64)
}

/// `count` points on the surface, one at random in each of `count` parts of equal area; `None` if
/// the area is zero.
fn spread_points(mesh: &Mesh, count: usize, seed: u64) -> Option<Vec<Vec3>> {
    let total = mesh.area();
    if !(total > 0.0 && total.is_finite()) {
        return None;
    }
    let mut rng = SmallRng::seed_from_u64(seed);
    let area = |t: usize| 0.5 * mesh.doubled_area_vector(t).length();
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
    use rand::{RngExt, SeedableRng, rngs::SmallRng};

    fn random_point(rng: &mut SmallRng) -> Vec3 {
        Vec3::from_array(std::array::from_fn(|_| rng.random_range(-2.0..2.0)))
    }

    #[test]
    fn the_hierarchy_agrees_with_trying_all_triangles() {
        let mut rng = SmallRng::seed_from_u64(5);
        let soup: Vec<Vec3> = (0..900).map(|_| random_point(&mut rng)).collect();
        let triangles = (0..300).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
        let mesh = Mesh { normals: vec![Vec3::Y; 900], positions: soup, uvs: None, triangles };
        let nearest = NearestTriangle::new(&mesh);
        for _ in 0..500 {
            let point = random_point(&mut rng);
            let each = |t: usize| nearest_in_triangle(&mesh.corners(t).map(Vec3A::from), point.into()).0;
            let best = (0..300).map(each).fold(f32::INFINITY, f32::min).sqrt();
            let found = nearest.nearest(point).unwrap();
            assert!((found.distance - best).abs() < 1e-6, "{point}: {found:?} {best}");
            let corners = mesh.corners(found.triangle as usize);
            let at: Vec3 = (0..3).map(|k| corners[k] * found.weights[k]).sum();
            assert!((at.distance(point) - best).abs() < 1e-5 && found.weights.iter().all(|w| *w >= 0.0));
        }
    }

    #[test]
    fn distances_to_solids_are_those_of_geometry() {
        let mut rng = SmallRng::seed_from_u64(6);
        let cube = NearestTriangle::new(&box_mesh(Vec3::ZERO, Vec3::splat(2.0)).unwrap());
        let ball = NearestTriangle::new(&sphere_mesh(Vec3::ZERO, 1.0).unwrap());
        for _ in 0..500 {
            let point = random_point(&mut rng);
            let outside = (point.abs() - 1.0).max(Vec3::ZERO).length();
            let inside = (1.0 - point.abs().max_element()).max(0.0);
            assert!((cube.nearest(point).unwrap().distance - outside.max(inside)).abs() < 1e-5);
            assert!((ball.nearest(point).unwrap().distance - (point.length() - 1.0).abs()).abs() < 4e-4);
        }
        assert_eq!(NearestTriangle::new(&Mesh::default()).nearest(Vec3::ZERO), None);
    }

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
