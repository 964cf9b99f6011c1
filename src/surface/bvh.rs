//! Ray casting against triangles: a bounding volume hierarchy and a watertight triangle test.
//!
//! The test is that of Woop, Benthin and Wald, "Watertight Ray/Triangle Intersection" (JCGT 2013): corners are moved into a ray-aligned
//! frame, where the sign of an edge is the same for both triangles that share it, so no ray slips between them.

use super::mesh::Mesh;
use crate::math::ray::Ray;
use glam::{Mat3A, Vec3, Vec3A};
use obvhs::BvhBuildParams;
use obvhs::aabb::Aabb;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::builder::build_bvh2;
use obvhs::ray::RayHit;
use std::time::Duration;

/// Boxes are grown by this part of the object's radius, so that rounding in the box test never hides a triangle.
const BOX_SLACK: f32 = 4e-6;
/// Rays that start farther away than this many radii are first moved near the object.
const FAR_AWAY: f32 = 4.0;

/// A triangle met by a ray.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TriangleHit {
    /// Index into the mesh's triangles.
    pub triangle: u32,
    /// Distance along the ray, world units.
    pub distance: f32,
    /// Weights of the three corners, summing to one.
    pub weights: [f32; 3],
}

/// A hierarchy over the triangles of a mesh.
pub struct TriangleBvh {
    bvh: Bvh2,
    /// Corners in the order of the leaves.
    corners: Vec<[Vec3A; 3]>,
    /// Mesh triangle of each entry of `corners`.
    triangles: Vec<u32>,
    center: Vec3,
    radius: f32,
}

/// The ray's frame: rows of the matrix are x and y sheared along the ray, and z scaled to distance.
struct RayFrame {
    origin: Vec3A,
    matrix: Mat3A,
}

impl RayFrame {
    fn new(origin: Vec3, direction: Vec3) -> Self {
        let d = direction.to_array();
        let z = (0..3).fold(0, |best, k| if d[k].abs() > d[best].abs() { k } else { best });
        let (x, y) = ((z + 1) % 3, (z + 2) % 3);
        let mut rows = [Vec3::ZERO; 3];
        rows[0][x] = 1.0;
        rows[0][z] = -d[x] / d[z];
        rows[1][y] = 1.0;
        rows[1][z] = -d[y] / d[z];
        rows[2][z] = 1.0 / d[z];
        let matrix = Mat3A::from_cols(rows[0].into(), rows[1].into(), rows[2].into()).transpose();
        Self { origin: origin.into(), matrix }
    }

    /// Distance along the ray and corner weights, if the line meets the triangle (borders included).
    #[inline(always)]
    fn meet(&self, corners: &[Vec3A; 3]) -> Option<(f32, [f32; 3])> {
        let [a, b, c] = corners.map(|corner| self.matrix * (corner - self.origin));
        let (mut u, mut v, mut w) = (c.x * b.y - c.y * b.x, a.x * c.y - a.y * c.x, b.x * a.y - b.y * a.x);
        if u == 0.0 || v == 0.0 || w == 0.0 {
            // On an edge as far as f32 can tell: products of two f32 are exact in f64.
            let cross = |p: Vec3A, q: Vec3A| {
                (f64::from(p.x) * f64::from(q.y) - f64::from(p.y) * f64::from(q.x)) as f32
            };
            (u, v, w) = (cross(c, b), cross(a, c), cross(b, a));
        }
        if (u < 0.0 || v < 0.0 || w < 0.0) && (u > 0.0 || v > 0.0 || w > 0.0) {
            return None;
        }
        let determinant = u + v + w;
        if determinant == 0.0 {
            return None;
        }
        let weights = [u / determinant, v / determinant, w / determinant];
        Some((weights[0] * a.z + weights[1] * b.z + weights[2] * c.z, weights))
    }
}

impl TriangleBvh {
    /// Builds the hierarchy; the same mesh gives the same hierarchy.
    pub fn new(mesh: &Mesh) -> Self {
        let (low, high) = mesh.bounds().unwrap_or_default();
        let center = low.midpoint(high);
        let used = mesh.triangles.iter().flatten().map(|&vertex| mesh.positions[vertex as usize]);
        let radius = used.fold(0.0f32, |r, p| r.max(p.distance(center)));
        let slack = Vec3A::splat(BOX_SLACK * (radius + center.abs().max_element()));
        let boxes: Vec<Aabb> = (0..mesh.triangles.len())
            .map(|t| {
                let [a, b, c] = mesh.corners(t).map(Vec3A::from);
                Aabb::new(a.min(b).min(c) - slack, a.max(b).max(c) + slack)
            })
            .collect();
        let bvh = build_bvh2(&boxes, BvhBuildParams::medium_build(), &mut Duration::default());
        let triangles = bvh.primitive_indices.clone();
        let corners = triangles.iter().map(|&t| mesh.corners(t as usize).map(Vec3A::from)).collect();
        Self { bvh, corners, triangles, center, radius }
    }

    /// Centre and radius of a sphere around all triangles, world units.
    pub fn bounding_sphere(&self) -> (Vec3, f32) {
        (self.center, self.radius)
    }

    /// The nearest triangle at a distance in `(min_distance, ∞)`, from either side; none for a ray that is not finite.
    pub fn nearest(&self, ray: &Ray, min_distance: f32) -> Option<TriangleHit> {
        let (frame, query, skipped) = self.prepare(ray, f32::INFINITY)?;
        let mut hit = RayHit::none();
        let mut weights = [0.0; 3];
        let (low, mut best) = (min_distance - skipped, f32::INFINITY);
        self.bvh.ray_traverse(query, &mut hit, |_, entry| match frame.meet(&self.corners[entry]) {
            Some((distance, found)) if distance > low && distance < best => {
                (best, weights) = (distance, found);
                distance
            }
            _ => f32::INFINITY,
        });
        let triangle = *self.triangles.get(hit.primitive_id as usize)?;
        let distance = (hit.t + skipped).max(min_distance.next_up());
        Some(TriangleHit { triangle, distance, weights })
    }

    /// Whether any triangle is met at a distance in `(min_distance, max_distance)`.
    pub fn any(&self, ray: &Ray, min_distance: f32, max_distance: f32) -> bool {
        let Some((frame, query, skipped)) = self.prepare(ray, max_distance) else { return false };
        let low = min_distance - skipped;
        !self.bvh.ray_traverse_miss(query, |_, entry| match frame.meet(&self.corners[entry]) {
            Some((distance, _)) if distance > low => distance,
            _ => f32::INFINITY,
        })
    }

    /// How many triangles the ray crosses (one that passes exactly through a shared edge counts both sides).
    pub fn count_crossings(&self, ray: &Ray) -> usize {
        let Some((frame, query, skipped)) = self.prepare(ray, f32::INFINITY) else { return 0 };
        let mut crossings = 0;
        self.bvh.ray_traverse_anyhit(query, |_, entry| {
            let met = frame.meet(&self.corners[entry]);
            crossings += usize::from(met.is_some_and(|(distance, _)| distance > -skipped));
        });
        crossings
    }

    /// The ray in the two forms that traversal needs, moved forward by the returned distance if it starts far away.
    fn prepare(&self, ray: &Ray, max_distance: f32) -> Option<(RayFrame, obvhs::ray::Ray, f32)> {
        let usable = ray.origin.is_finite() && ray.direction.is_finite() && ray.direction != Vec3::ZERO;
        if !usable || max_distance.is_nan() {
            return None;
        }
        // Near the object, rounding is relative to the object's size, not to the camera's distance.
        let to_entry = (self.center - ray.origin).dot(ray.direction) - 2.0 * self.radius;
        let skipped = if to_entry > FAR_AWAY * self.radius { to_entry } else { 0.0 };
        let origin = ray.origin + ray.direction * skipped;
        let limit = max_distance - skipped;
        if !origin.is_finite() {
            return None;
        }
        let query = obvhs::ray::Ray::new(origin.into(), ray.direction.into(), 0.0, limit);
        Some((RayFrame::new(origin, ray.direction), query, skipped))
    }
}
