//! Ray casting against triangles by a bounding volume hierarchy.

use crate::math::ray::Ray;
use crate::mesh::ray_packet::{PACKET, Packet, sides_of};
use crate::mesh::ray_triangle::{Nearest, RayFrame};
use crate::mesh::triangles::Mesh;
use crate::mesh::wide_bvh::{BoxCorners, BoxRay, Leaf, LeafVisitor, WIDTH, WideBvh};
use fearless_simd::{Level, Simd, dispatch};
use glam::{Vec3, Vec3A};
use obvhs::BvhBuildParams;
use obvhs::aabb::Aabb;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::reinsertion::ReinsertionOptimizer;
use obvhs::ploc::PlocBuilder;

pub use crate::mesh::ray_triangle::TriangleHit;

/// Boxes are enlarged by this fraction of the object's radius, so that rounding in the box test never misses a triangle.
const BOX_SLACK: f32 = 4e-6;
/// Rays that start farther away than this many radii are first moved to the object.
const FAR_AWAY: f32 = 4.0;

/// A hierarchy over the triangles of a mesh.
pub struct TriangleBvh {
    /// The instruction set of this machine, asked for once.
    level: Level,
    hierarchy: WideBvh,
    center: Vec3,
    radius: f32,
}

/// Two children per node; leaves are the indices of the boxes.
pub(super) fn binary_hierarchy(boxes: &[Aabb]) -> Bvh2 {
    let settings = BvhBuildParams::medium_build();
    let mut binary = PlocBuilder::with_capacity(boxes.len()).build(
        settings.ploc_search_distance,
        boxes,
        (0..boxes.len() as u32).collect(),
        settings.sort_precision,
        settings.search_depth_threshold,
    );
    ReinsertionOptimizer::default().run(&mut binary, settings.reinsertion_batch_ratio, None);
    binary
}

/// The box of a triangle, enlarged by one to two times `slack`.
///
/// For boxes of equal size the builder pairs them one at a time, in quadratic time and depth. A different enlargement of each box,
/// by a hash of its index, avoids these ties.
fn leaf_box(index: usize, corners: [Vec3; 3], slack: f32) -> Aabb {
    let [a, b, c] = corners.map(Vec3A::from);
    let hash = (index as u32).wrapping_mul(0x9e37_79b9).rotate_left(15).wrapping_mul(0x85eb_ca6b) >> 8;
    let slack = slack * (1.0 + hash as f32 / (1 << 24) as f32);
    Aabb::new(a.min(b).min(c) - slack, a.max(b).max(c) + slack)
}

/// The boxes of all triangles of a mesh within `radius` of `center`.
pub(super) fn leaf_boxes(mesh: &Mesh, center: Vec3, radius: f32) -> Vec<Aabb> {
    let slack = BOX_SLACK * (radius + center.abs().max_element());
    (0..mesh.triangles.len()).map(|t| leaf_box(t, mesh.corners(t), slack)).collect()
}

/// Center of the box around the triangles, and the greatest distance of a corner from it.
pub(super) fn bounding_sphere(mesh: &Mesh) -> (Vec3, f32) {
    let (low, high) = mesh.bounds().unwrap_or_default();
    let center = low.midpoint(high);
    let used = mesh.triangles.iter().flatten().map(|&vertex| mesh.positions[vertex as usize]);
    (center, used.fold(0.0f32, |r, p| r.max(p.distance(center))))
}

impl TriangleBvh {
    /// Builds the hierarchy; the same mesh gives the same hierarchy.
    pub fn new(mesh: &Mesh) -> Self {
        let (center, radius) = bounding_sphere(mesh);
        let binary = binary_hierarchy(&leaf_boxes(mesh, center, radius));
        let hierarchy = WideBvh::new(&binary, &|t| mesh.corners(t).map(Vec3A::from));
        Self { level: Level::new(), hierarchy, center, radius }
    }

    /// Center and radius of a sphere around all triangles, world units.
    pub fn bounding_sphere(&self) -> (Vec3, f32) {
        (self.center, self.radius)
    }

    /// The nearest triangle at a distance in `(min_distance, ∞)`, from either side; none for a ray that is not finite.
    pub fn nearest(&self, ray: &Ray, min_distance: f32) -> Option<TriangleHit> {
        let (frame, query, skipped) = self.prepare(ray)?;
        let mut nearest = Nearest { frame, low: min_distance - skipped, found: None };
        dispatch!(self.level, simd => self.hierarchy.walk(simd, &query, f32::INFINITY, &mut nearest));
        let found = nearest.found?;
        let distance = (found.distance + skipped).max(min_distance.next_up());
        Some(TriangleHit { distance, ..found })
    }

    /// [`Self::nearest`] of up to [`PACKET`] rays from one origin; faster than one after another if their directions are near each other. Where a ray meets
    /// two triangles at the same distance, it may find the other one.
    pub(super) fn nearest_of_packet(
        &self,
        origin: Vec3,
        directions: &[Vec3],
        min_distance: f32,
    ) -> [Option<TriangleHit>; PACKET] {
        let mut found = [None; PACKET];
        // From far away each ray is moved to the object first.
        let is_near = self.center.distance(origin) <= FAR_AWAY * self.radius;
        let (sides, alone) = sides_of(directions, is_near);
        for packet in sides.into_iter().filter(|bits| *bits != 0) {
            let mut rays = Packet::new(origin, directions, packet, min_distance);
            let query = rays.boxes();
            dispatch!(self.level, simd => self.hierarchy.walk(simd, &query, f32::INFINITY, &mut rays));
            rays.put(&mut found);
        }
        for i in (0..directions.len()).filter(|i| alone >> i & 1 == 1) {
            found[i] = self.nearest(&Ray { origin, direction: directions[i] }, min_distance);
        }
        found
    }

    /// Whether any triangle is met at a distance in `(min_distance, max_distance)`.
    pub fn any(&self, ray: &Ray, min_distance: f32, max_distance: f32) -> bool {
        let Some((frame, query, skipped)) = self.prepare(ray) else { return false };
        let (low, high) = (min_distance - skipped, max_distance - skipped);
        let mut found = Count { frame: &frame, low, high, most: 1, count: 0 };
        dispatch!(self.level, simd => self.hierarchy.walk(simd, &query, high, &mut found));
        found.count > 0
    }

    /// How many triangles the ray crosses (a ray exactly through a shared edge crosses both triangles).
    pub fn count_crossings(&self, ray: &Ray) -> usize {
        let Some((frame, query, skipped)) = self.prepare(ray) else { return 0 };
        let (low, high) = (-skipped, f32::INFINITY);
        let mut found = Count { frame: &frame, low, high, most: usize::MAX, count: 0 };
        dispatch!(self.level, simd => self.hierarchy.walk(simd, &query, high, &mut found));
        found.count
    }

    /// The ray in the two forms for traversal, moved forward by the returned distance if it starts far away.
    fn prepare(&self, ray: &Ray) -> Option<(RayFrame, BoxRay, f32)> {
        if !(ray.origin.is_finite() && ray.direction.is_finite() && ray.direction != Vec3::ZERO) {
            return None;
        }
        // Near the object, rounding is relative to the object's size, not to the camera's distance.
        let to_entry = (self.center - ray.origin).dot(ray.direction) - 2.0 * self.radius;
        let skipped = if to_entry > FAR_AWAY * self.radius { to_entry } else { 0.0 };
        let origin = ray.origin + ray.direction * skipped;
        let query = origin.is_finite().then(|| BoxRay::new(origin.into(), ray.direction.into()))?;
        Some((RayFrame::new(origin, ray.direction), query, skipped))
    }
}

/// Counts the triangles between `low` and `high`, up to `most`.
struct Count<'a> {
    frame: &'a RayFrame,
    low: f32,
    high: f32,
    most: usize,
    count: usize,
}

impl LeafVisitor for Count<'_> {
    /// One ray is tested against the children of a node, and that is all.
    #[inline(always)]
    fn enters<S: Simd>(&mut self, _simd: S, _around: &BoxCorners) -> bool {
        true
    }

    #[inline(always)]
    fn visit<S: Simd>(&mut self, simd: S, leaf: &Leaf, limit: f32) -> f32 {
        let Some(hits) = self.frame.meet(simd, leaf) else { return limit };
        let mut met = hits.met;
        while met != 0 {
            let distance = hits.distances[met.trailing_zeros() as usize % WIDTH];
            met &= met - 1;
            self.count += usize::from(distance > self.low && distance < self.high);
        }
        if self.count < self.most { limit } else { f32::NEG_INFINITY }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mesh_of(triangles: impl Iterator<Item = [Vec3; 3]>) -> Mesh {
        let mut mesh = Mesh::default();
        for corners in triangles {
            let first = mesh.positions.len() as u32;
            mesh.positions.extend(corners);
            mesh.triangles.push([first, first + 1, first + 2]);
        }
        mesh
    }

    #[test]
    fn a_deep_hierarchy_is_traced_all_the_same() {
        // Triangles in a corner, each nine tenths of the one before, one in front of the other.
        let nested = |k: i32| {
            let size = 0.9f32.powi(k);
            [Vec3::new(0.0, 0.0, size), Vec3::new(size, 0.0, size), Vec3::new(0.0, size, size)]
        };
        let bvh = TriangleBvh::new(&mesh_of((0..20_000).map(|k| nested(k % 600))));
        for k in 0..60 {
            let size = 0.9f32.powi(k);
            // Beyond the slope of the next smaller triangle, so that only this one and larger ones are in the way.
            let through = Vec3::new(0.48, 0.48, 0.0) * size;
            let below = Ray { origin: through, direction: Vec3::Z };
            let hit = bvh.nearest(&below, 0.0).unwrap();
            assert!((hit.distance - size).abs() < 1e-6, "{k}: {hit:?}");
            assert!(bvh.any(&below, 0.0, size * 1.01) && !bvh.any(&below, 0.0, size * 0.99));
        }
    }

    #[test]
    fn many_equal_triangles_neither_hang_nor_overflow() {
        let same = [Vec3::ZERO, Vec3::X, Vec3::Y];
        let bvh = TriangleBvh::new(&mesh_of((0..20_000).map(|_| same)));
        let ray = Ray { origin: Vec3::new(0.2, 0.2, 1.0), direction: Vec3::NEG_Z };
        assert!((bvh.nearest(&ray, 0.0).unwrap().distance - 1.0).abs() < 1e-6);
        assert_eq!(bvh.count_crossings(&ray), 20_000);
    }

    #[test]
    fn a_mesh_always_gets_the_same_hierarchy() {
        let mesh = crate::mesh::primitive::sphere_mesh(Vec3::ZERO, 1.0).unwrap();
        let (a, b) = (TriangleBvh::new(&mesh), TriangleBvh::new(&mesh));
        assert!(a.hierarchy == b.hierarchy);
    }

    #[test]
    fn rays_with_negative_zeros_meet_what_lies_ahead() {
        let at = |z: f32| [Vec3::new(-1.0, -1.0, z), Vec3::new(1.0, -1.0, z), Vec3::new(0.0, 1.0, z)];
        let bvh = TriangleBvh::new(&mesh_of([at(0.0), at(-1.0)].into_iter()));
        for direction in [Vec3::new(0.0, 0.0, -1.0), Vec3::new(-0.0, -0.0, -1.0)] {
            let ray = Ray { origin: Vec3::new(0.1, 0.2, 1.0), direction };
            assert_eq!(bvh.nearest(&ray, 0.0).map(|hit| hit.distance), Some(1.0));
        }
    }

    #[test]
    fn nothing_is_met_without_triangles() {
        let bvh = TriangleBvh::new(&Mesh::default());
        let ray = Ray { origin: Vec3::ZERO, direction: Vec3::X };
        assert_eq!(bvh.nearest(&ray, 0.0), None);
        assert!(!bvh.any(&ray, 0.0, f32::INFINITY));
    }
}
