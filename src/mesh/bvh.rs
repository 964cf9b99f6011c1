//! Ray casting against triangles: a bounding volume hierarchy and a watertight triangle test.
//!
//! The test is that of Woop, Benthin and Wald, "Watertight Ray/Triangle Intersection" (JCGT 2013): corners are transformed to a ray-aligned
//! frame, where the sign of an edge is the same for both triangles that share it, so no ray passes between them.

use crate::math::ray::Ray;
use crate::mesh::triangles::Mesh;
use glam::{Mat3A, Vec3, Vec3A};
use obvhs::BvhBuildParams;
use obvhs::aabb::Aabb;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::reinsertion::ReinsertionOptimizer;
use obvhs::cwbvh::CwBvh;
use obvhs::cwbvh::bvh2_to_cwbvh::bvh2_to_cwbvh;
use obvhs::ploc::PlocBuilder;
use obvhs::ray::RayHit;

/// Boxes are enlarged by this fraction of the object's radius, so that rounding in the box test never misses a triangle.
const BOX_SLACK: f32 = 4e-6;
/// Largest radius of the object in units of the hierarchy; it is 64 to 128 units. (The wide hierarchy ignores boxes that end within 1e-4
/// of the ray origin: less than two millionths of the radius.)
const SCALED_RADIUS: f32 = 128.0;
/// At most this many triangles in a leaf of the wide hierarchy (its format's limit; fastest in trials with 1 and 3).
const TRIANGLES_PER_LEAF: u32 = 3;
/// The wide hierarchy's traversal has a stack of 32 entries, one per level.
const MAX_WIDE_DEPTH: usize = 31;
/// Rays that start farther away than this many radii are first moved to the object.
const FAR_AWAY: f32 = 4.0;

/// The hit of a ray on a triangle.
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
    hierarchy: Hierarchy,
    /// Units of the hierarchy per world unit, a power of two, so that scaling is exact.
    scale: f32,
    /// Corners in the order of the leaves.
    corners: Vec<[Vec3A; 3]>,
    /// Mesh triangle of each entry of `corners`.
    triangles: Vec<u32>,
    center: Vec3,
    radius: f32,
}

/// Eight children per node with SIMD traversal; for the few meshes for which it is too deep, two.
enum Hierarchy {
    Wide(CwBvh),
    Binary(Bvh2),
}

impl Hierarchy {
    /// Like the helpers of `obvhs`, but with a check of the depth instead of an assertion.
    fn new(boxes: &[Aabb]) -> Self {
        let binary = binary_hierarchy(boxes);
        let wide = bvh2_to_cwbvh(&binary, TRIANGLES_PER_LEAF, true, false);
        if depth(&wide) <= MAX_WIDE_DEPTH { Self::Wide(wide) } else { Self::Binary(binary) }
    }

    /// Box of each leaf entry.
    fn order(&self) -> &[u32] {
        match self {
            Self::Wide(bvh) => &bvh.primitive_indices,
            Self::Binary(bvh) => &bvh.primitive_indices,
        }
    }

    /// The entry with the smallest distance by `meet`, and that distance.
    #[inline(always)]
    fn nearest(
        &self,
        ray: obvhs::ray::Ray,
        meet: impl FnMut(&obvhs::ray::Ray, usize) -> f32,
    ) -> (usize, f32) {
        let mut hit = RayHit::none();
        match self {
            Self::Wide(bvh) => bvh.ray_traverse(ray, &mut hit, meet),
            Self::Binary(bvh) => bvh.ray_traverse(ray, &mut hit, meet),
        };
        (hit.primitive_id as usize, hit.t)
    }

    /// Whether `meet` returns a distance before the end of the ray for any entry.
    #[inline(always)]
    fn any(&self, ray: obvhs::ray::Ray, meet: impl FnMut(&obvhs::ray::Ray, usize) -> f32) -> bool {
        match self {
            Self::Wide(bvh) => !bvh.ray_traverse_miss(ray, meet),
            Self::Binary(bvh) => !bvh.ray_traverse_miss(ray, meet),
        }
    }

    /// Calls `visit` for every entry whose box the ray intersects.
    fn each(&self, ray: obvhs::ray::Ray, visit: impl FnMut(&obvhs::ray::Ray, usize)) {
        match self {
            Self::Wide(bvh) => bvh.ray_traverse_anyhit(ray, visit),
            Self::Binary(bvh) => bvh.ray_traverse_anyhit(ray, visit),
        }
    }
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

/// Levels of inner nodes.
fn depth(bvh: &CwBvh) -> usize {
    let mut open: Vec<(usize, usize)> = if bvh.nodes.is_empty() { Vec::new() } else { vec![(0, 1)] };
    let mut deepest = 0;
    while let Some((index, level)) = open.pop() {
        deepest = deepest.max(level);
        let node = &bvh.nodes[index];
        let first = node.child_base_idx as usize;
        open.extend((first..first + node.imask.count_ones() as usize).map(|child| (child, level + 1)));
    }
    deepest
}

/// The box of a triangle in units of the hierarchy, enlarged by one to two times `slack`.
///
/// For boxes of equal size the builder pairs them one at a time, in quadratic time and depth. A different enlargement of each box,
/// by a hash of its index, avoids these ties.
fn leaf_box(index: usize, corners: [Vec3; 3], scale: f32, slack: f32) -> Aabb {
    let [a, b, c] = corners.map(Vec3A::from);
    let hash = (index as u32).wrapping_mul(0x9e37_79b9).rotate_left(15).wrapping_mul(0x85eb_ca6b) >> 8;
    let slack = slack * (1.0 + hash as f32 / (1 << 24) as f32);
    Aabb::new((a.min(b).min(c) - slack) * scale, (a.max(b).max(c) + slack) * scale)
}

/// The boxes of all triangles, `scale` units per world unit, for a mesh within `radius` of `center`.
pub(super) fn leaf_boxes(mesh: &Mesh, center: Vec3, radius: f32, scale: f32) -> Vec<Aabb> {
    let slack = BOX_SLACK * (radius + center.abs().max_element());
    (0..mesh.triangles.len()).map(|t| leaf_box(t, mesh.corners(t), scale, slack)).collect()
}

/// Center of the box around the triangles, and the greatest distance of a corner from it.
pub(super) fn bounding_sphere(mesh: &Mesh) -> (Vec3, f32) {
    let (low, high) = mesh.bounds().unwrap_or_default();
    let center = low.midpoint(high);
    let used = mesh.triangles.iter().flatten().map(|&vertex| mesh.positions[vertex as usize]);
    (center, used.fold(0.0f32, |r, p| r.max(p.distance(center))))
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

    /// Distance along the ray and corner weights, if the line intersects the triangle (borders included).
    #[inline(always)]
    fn meet(&self, corners: &[Vec3A; 3]) -> Option<(f32, [f32; 3])> {
        let [a, b, c] = corners.map(|corner| self.matrix * (corner - self.origin));
        let (mut u, mut v, mut w) = (c.x * b.y - c.y * b.x, a.x * c.y - a.y * c.x, b.x * a.y - b.y * a.x);
        if u == 0.0 || v == 0.0 || w == 0.0 {
            // On an edge up to f32 precision: products of two f32 are exact in f64.
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
        let (center, radius) = bounding_sphere(mesh);
        let scale = (SCALED_RADIUS / radius).log2().floor().clamp(-100.0, 100.0).exp2();
        let boxes = leaf_boxes(mesh, center, radius, scale);
        let hierarchy = Hierarchy::new(&boxes);
        let triangles = hierarchy.order().to_vec();
        let corners = triangles.iter().map(|&t| mesh.corners(t as usize).map(Vec3A::from)).collect();
        Self { hierarchy, scale, corners, triangles, center, radius }
    }

    /// Center and radius of a sphere around all triangles, world units.
    pub fn bounding_sphere(&self) -> (Vec3, f32) {
        (self.center, self.radius)
    }

    /// The nearest triangle at a distance in `(min_distance, ∞)`, from either side; none for a ray that is not finite.
    pub fn nearest(&self, ray: &Ray, min_distance: f32) -> Option<TriangleHit> {
        let (frame, query, skipped) = self.prepare(ray, f32::INFINITY)?;
        let (low, mut best, mut weights) = (min_distance - skipped, f32::INFINITY, [0.0; 3]);
        let (entry, _) = self.hierarchy.nearest(query, |_, entry| match frame.meet(&self.corners[entry]) {
            Some((distance, found)) if distance > low && distance < best => {
                (best, weights) = (distance, found);
                distance * self.scale
            }
            _ => f32::INFINITY,
        });
        let triangle = *self.triangles.get(entry)?;
        let distance = (best + skipped).max(min_distance.next_up());
        Some(TriangleHit { triangle, distance, weights })
    }

    /// Whether any triangle is met at a distance in `(min_distance, max_distance)`.
    pub fn any(&self, ray: &Ray, min_distance: f32, max_distance: f32) -> bool {
        let Some((frame, query, skipped)) = self.prepare(ray, max_distance) else { return false };
        let low = min_distance - skipped;
        self.hierarchy.any(query, |_, entry| match frame.meet(&self.corners[entry]) {
            Some((distance, _)) if distance > low => distance * self.scale,
            _ => f32::INFINITY,
        })
    }

    /// How many triangles the ray crosses (a ray exactly through a shared edge crosses both triangles).
    pub fn count_crossings(&self, ray: &Ray) -> usize {
        let Some((frame, query, skipped)) = self.prepare(ray, f32::INFINITY) else { return 0 };
        let mut crossings = 0;
        self.hierarchy.each(query, |_, entry| {
            let met = frame.meet(&self.corners[entry]);
            crossings += usize::from(met.is_some_and(|(distance, _)| distance > -skipped));
        });
        crossings
    }

    /// The ray in the two forms for traversal, moved forward by the returned distance if it starts far away.
    fn prepare(&self, ray: &Ray, max_distance: f32) -> Option<(RayFrame, obvhs::ray::Ray, f32)> {
        let usable = ray.origin.is_finite() && ray.direction.is_finite() && ray.direction != Vec3::ZERO;
        if !usable || max_distance.is_nan() {
            return None;
        }
        // Near the object, rounding is relative to the object's size, not to the camera's distance.
        let to_entry = (self.center - ray.origin).dot(ray.direction) - 2.0 * self.radius;
        let skipped = if to_entry > FAR_AWAY * self.radius { to_entry } else { 0.0 };
        let origin = ray.origin + ray.direction * skipped;
        let (scaled_origin, limit) = (origin * self.scale, (max_distance - skipped) * self.scale);
        if !scaled_origin.is_finite() {
            return None;
        }
        // Without negative zeros, of which the box test takes the inverse to be negative and the order of children does not.
        let direction = ray.direction + Vec3::ZERO;
        let query = obvhs::ray::Ray::new(scaled_origin.into(), direction.into(), 0.0, limit);
        Some((RayFrame::new(origin, ray.direction), query, skipped))
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
    fn a_mesh_that_makes_the_wide_hierarchy_too_deep_is_traced_all_the_same() {
        // Triangles in a corner, each nine tenths of the one before, one in front of the other.
        let nested = |k: i32| {
            let size = 0.9f32.powi(k);
            [Vec3::new(0.0, 0.0, size), Vec3::new(size, 0.0, size), Vec3::new(0.0, size, size)]
        };
        let bvh = TriangleBvh::new(&mesh_of((0..20_000).map(|k| nested(k % 600))));
        assert!(matches!(bvh.hierarchy, Hierarchy::Binary(_)));
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
    fn the_usual_mesh_gets_the_wide_hierarchy_and_always_the_same() {
        let mesh = crate::mesh::primitive::sphere_mesh(Vec3::ZERO, 1.0).unwrap();
        let (a, b) = (TriangleBvh::new(&mesh), TriangleBvh::new(&mesh));
        assert!(matches!((&a.hierarchy, &b.hierarchy), (Hierarchy::Wide(a), Hierarchy::Wide(b)) if a == b));
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
