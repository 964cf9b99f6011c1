//! Ray casting against triangles by a bounding volume hierarchy: one ray, or rays of one origin and
//! of similar directions together.
//!
//! All triangles of a leaf are tested at once, watertight: Woop, Benthin and Wald, "Watertight
//! Ray/Triangle Intersection" (JCGT 2013). Corners are transformed to a ray-aligned frame, where
//! the sign of an edge is the same for both triangles that share it, so no ray passes between them.
//!
//! The boxes of a node are tested against all rays of a packet at once, and only a box that they
//! then enter against each: Boulos, Wald and Shirley, "Geometric and Arithmetic Culling Methods for
//! Entire Ray Packets" (2006): interval arithmetic on the inverse directions, which have the same
//! signs.
//!
//! ```
//! use glam::Vec3;
//! use lobelia_geometry::mesh::{bvh::TriangleBvh, primitive::box_mesh};
//! use lobelia_sg::ray::Ray;
//!
//! let hierarchy = TriangleBvh::new(&box_mesh(Vec3::ZERO, Vec3::splat(2.0))?);
//! let ray = Ray { origin: Vec3::new(0.2, 0.3, 3.0), direction: Vec3::NEG_Z };
//! let [front, back] = [0.0, 2.5].map(|beyond| hierarchy.nearest(&ray, beyond));
//! assert!(front.is_some_and(|hit| (hit.distance - 2.0).abs() < 1e-5));
//! assert!(back.is_some_and(|hit| (hit.distance - 4.0).abs() < 1e-5));
//! assert!(hierarchy.any(&ray, 0.0, 3.0) && !hierarchy.any(&ray, 0.0, 1.5));
//! # Ok::<(), lobelia_geometry::Error>(())
//! ```

use crate::mesh::triangles::Mesh;
use crate::mesh::wide_bvh::{
    BoxCorners, BoxRay, BoxRays, Each, Leaf, LeafVisitor, ROUNDING, WIDTH, WideBvh, inverse,
};
use fearless_simd::{Level, Simd, f32x8, f32x16, prelude::*};
use glam::{Vec3, Vec3A};
use lobelia_sg::{dispatch, ray::Ray};
use obvhs::{
    BvhBuildParams, aabb::Aabb, bvh2::Bvh2, bvh2::reinsertion::ReinsertionOptimizer, ploc::PlocBuilder,
};

/// Most rays of a packet.
pub(super) const PACKET: usize = 16;
/// Boxes are enlarged by this fraction of the object's radius, so that rounding in the box test
/// never misses a triangle.
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

/// A hierarchy with two children per node, whose leaves are the triangles of a mesh; center of the
/// box around these, and the greatest distance of a corner from it.
///
/// For boxes of equal size the builder pairs them one at a time, in quadratic time and depth. A
/// different enlargement of each box by one to two times the slack, by a hash of its index, avoids
/// these ties.
pub(super) fn binary_hierarchy(mesh: &Mesh) -> (Bvh2, Vec3, f32) {
    let (low, high) = mesh.bounds().unwrap_or_default();
    let center = low.midpoint(high);
    let used = mesh.triangles.iter().flatten().map(|&vertex| mesh.positions[vertex as usize]);
    let radius = used.fold(0.0f32, |r, p| r.max(p.distance(center)));
    let slack = BOX_SLACK * (radius + center.abs().max_element());
    let enlarged = |index: usize| {
        let [a, b, c] = mesh.corners(index).map(Vec3A::from);
        let hash = (index as u32).wrapping_mul(0x9e37_79b9).rotate_left(15).wrapping_mul(0x85eb_ca6b) >> 8;
        let slack = slack * (1.0 + hash as f32 / (1 << 24) as f32);
        Aabb::new(a.min(b).min(c) - slack, a.max(b).max(c) + slack)
    };
    let boxes: Vec<Aabb> = (0..mesh.triangles.len()).map(enlarged).collect();
    let settings = BvhBuildParams::medium_build();
    let mut binary = PlocBuilder::with_capacity(boxes.len()).build(
        settings.ploc_search_distance,
        &boxes,
        (0..boxes.len() as u32).collect(),
        settings.sort_precision,
        settings.search_depth_threshold,
    );
    ReinsertionOptimizer::default().run(&mut binary, settings.reinsertion_batch_ratio, None);
    (binary, center, radius)
}

impl TriangleBvh {
    /// Builds the hierarchy; the same mesh gives the same hierarchy.
    pub fn new(mesh: &Mesh) -> Self {
        let (binary, center, radius) = binary_hierarchy(mesh);
        Self { level: Level::new(), hierarchy: WideBvh::new(&binary, mesh), center, radius }
    }

    /// Center and radius of a sphere around all triangles, world units.
    pub fn bounding_sphere(&self) -> (Vec3, f32) {
        (self.center, self.radius)
    }

    /// The nearest triangle at a distance in `(min_distance, ∞)`, from either side; none for a ray
    /// that is not finite.
    pub fn nearest(&self, ray: &Ray, min_distance: f32) -> Option<TriangleHit> {
        let (frame, query, skipped) = self.prepare(ray)?;
        let mut nearest = Nearest { frame, low: min_distance - skipped, found: None };
        dispatch!(self.level, simd => self.hierarchy.walk(simd, &query, f32::INFINITY, &mut nearest));
        let found = nearest.found?;
        let distance = (found.distance + skipped).max(min_distance.next_up());
        Some(TriangleHit { distance, ..found })
    }

    /// [`Self::nearest`] of up to [`PACKET`] rays from one origin; faster than one after another if
    /// their directions are near each other. Where a ray meets two triangles at the same distance,
    /// it may find the other one.
    pub(super) fn nearest_of_packet(
        &self,
        origin: Vec3,
        directions: &[Vec3],
        min_distance: f32,
    ) -> [Option<TriangleHit>; PACKET] {
        let mut found = [None; PACKET];
        // From far away each ray is moved to the object first.
        let is_near = self.center.distance(origin) <= FAR_AWAY * self.radius;
        // The directions, as bits, by the signs of their components.
        let mut sides = [0u32; 8];
        for (i, &direction) in directions.iter().enumerate() {
            if is_near && direction.is_finite() && direction != Vec3::ZERO {
                sides[direction.signum().cmplt(Vec3::ZERO).bitmask() as usize] |= 1 << i;
            } else {
                found[i] = self.nearest(&Ray { origin, direction }, min_distance);
            }
        }
        for packet in sides.into_iter().filter(|bits| *bits != 0) {
            let mut rays = Packet::new(origin, directions, packet, min_distance);
            let of = |fold: fn(f32, f32) -> f32| {
                rays.inverse.map(|each| each.into_iter().reduce(fold).unwrap_or(0.0))
            };
            let query = BoxPacket { origin: rays.origin, least: of(f32::min), most: of(f32::max) };
            dispatch!(self.level, simd => self.hierarchy.walk(simd, &query, f32::INFINITY, &mut rays));
            for (ray, number) in rays.rays.into_iter().zip(rays.numbers).take(rays.count) {
                let beyond = |hit: TriangleHit| hit.distance.max(ray.low.next_up());
                found[number] = ray.found.map(|hit| TriangleHit { distance: beyond(hit), ..hit });
            }
        }
        found
    }

    /// Whether any triangle is met at a distance in `(min_distance, max_distance)`.
    pub fn any(&self, ray: &Ray, min_distance: f32, max_distance: f32) -> bool {
        self.count(ray, min_distance, max_distance, 1) > 0
    }

    /// How many triangles are met at a distance in `(min_distance, max_distance)`; once they are
    /// `most`, no more are looked for. A ray exactly through a shared edge meets both triangles.
    pub(super) fn count(&self, ray: &Ray, min_distance: f32, max_distance: f32, most: usize) -> usize {
        let Some((frame, query, skipped)) = self.prepare(ray) else { return 0 };
        let (low, high) = (min_distance - skipped, max_distance - skipped);
        let mut found = Count { frame: &frame, low, high, most, count: 0 };
        dispatch!(self.level, simd => self.hierarchy.walk(simd, &query, high, &mut found));
        found.count
    }

    /// The ray in the two forms for traversal, moved forward by the returned distance if it starts
    /// far away.
    fn prepare(&self, ray: &Ray) -> Option<(RayFrame, BoxRay, f32)> {
        if !(ray.origin.is_finite() && ray.direction.is_finite() && ray.direction != Vec3::ZERO) {
            return None;
        }
        // Near the object, rounding is relative to the object's size, not to the camera's distance.
        let to_entry = (self.center - ray.origin).dot(ray.direction) - 2.0 * self.radius;
        let skipped = if to_entry > FAR_AWAY * self.radius { to_entry } else { 0.0 };
        let origin = ray.origin + ray.direction * skipped;
        let query = BoxRay { origin: origin.to_array(), inverse: ray.direction.to_array().map(inverse) };
        origin.is_finite().then(|| (RayFrame::new(origin, ray.direction), query, skipped))
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

/// The ray's frame: x and y sheared along the ray, and z scaled to distance.
struct RayFrame {
    origin: Vec3A,
    /// World axes taken as x, y and z; the ray's direction is largest along z.
    axes: [usize; 3],
    /// Shear of x and of y per unit of z, and distance per unit of z.
    shear: [f32; 3],
}

/// Hits of a ray on the triangles of a leaf.
struct LeafHits {
    /// A bit for each triangle that the line of the ray meets.
    met: u64,
    /// Distances along the ray.
    distances: [f32; WIDTH],
    weights: [[f32; WIDTH]; 3],
}

impl RayFrame {
    fn new(origin: Vec3, direction: Vec3) -> Self {
        let d = direction.to_array();
        let z = (0..3).fold(0, |best, k| if d[k].abs() > d[best].abs() { k } else { best });
        let (x, y) = ((z + 1) % 3, (z + 2) % 3);
        Self { origin: origin.into(), axes: [x, y, z], shear: [d[x] / d[z], d[y] / d[z], 1.0 / d[z]] }
    }

    /// One corner of each triangle of a leaf in this frame.
    #[inline(always)]
    fn sheared<S: Simd>(&self, simd: S, corner: &[[f32; WIDTH]; 3]) -> (f32x8<S>, f32x8<S>, f32x8<S>) {
        let [x, y, z] = self.axes;
        let depth = f32x8::from_slice(simd, &corner[z]) - f32x8::splat(simd, self.origin[z]);
        let x = f32x8::from_slice(simd, &corner[x]) - f32x8::splat(simd, self.origin[x]);
        let y = f32x8::from_slice(simd, &corner[y]) - f32x8::splat(simd, self.origin[y]);
        let x = x - depth * f32x8::splat(simd, self.shear[0]);
        let y = y - depth * f32x8::splat(simd, self.shear[1]);
        (x, y, depth * f32x8::splat(simd, self.shear[2]))
    }

    /// The triangles of a leaf, borders included; `None` if none is met.
    #[inline(always)]
    fn meet<S: Simd>(&self, simd: S, leaf: &Leaf) -> Option<LeafHits> {
        let (ax, ay, az) = self.sheared(simd, &leaf.corners[0]);
        let (bx, by, bz) = self.sheared(simd, &leaf.corners[1]);
        let (cx, cy, cz) = self.sheared(simd, &leaf.corners[2]);
        let (u, v, w) = (cx * by - cy * bx, ax * cy - ay * cx, bx * ay - by * ax);
        let zero = f32x8::splat(simd, 0.0);
        let (least, most) = (u.min(v).min(w), u.max(v).max(w));
        let there = (1u64 << leaf.count) - 1;
        // On an edge up to f32 precision.
        let on_edge = there & u.abs().min(v.abs()).min(w.abs()).simd_eq(zero).to_bitmask();
        let outside = least.simd_lt(zero).to_bitmask() & most.simd_gt(zero).to_bitmask();
        let met = there & !on_edge & !outside;
        if met | on_edge == 0 {
            return None;
        }
        let sum = u + v + w;
        let (u, v, w) = (u / sum, v / sum, w / sum);
        let mut hits = LeafHits { met, distances: [0.0; WIDTH], weights: [[0.0; WIDTH]; 3] };
        (u * az + v * bz + w * cz).store_slice(&mut hits.distances);
        u.store_slice(&mut hits.weights[0]);
        v.store_slice(&mut hits.weights[1]);
        w.store_slice(&mut hits.weights[2]);
        if on_edge != 0 {
            self.meet_edges(leaf, on_edge, &mut hits);
        }
        Some(hits)
    }

    /// The triangles of these bits, in f64, where products of two f32 are exact.
    #[cold]
    fn meet_edges(&self, leaf: &Leaf, on_edge: u64, hits: &mut LeafHits) {
        let [x, y, z] = self.axes;
        let cross =
            |p: Vec3A, q: Vec3A| (f64::from(p.x) * f64::from(q.y) - f64::from(p.y) * f64::from(q.x)) as f32;
        for lane in (0..WIDTH).filter(|lane| on_edge >> lane & 1 == 1) {
            let [a, b, c] = leaf.corners.map(|corner| {
                let from_origin = Vec3A::from_array(corner.map(|each| each[lane])) - self.origin;
                let depth = from_origin[z];
                let [x, y] = [from_origin[x] - depth * self.shear[0], from_origin[y] - depth * self.shear[1]];
                Vec3A::new(x, y, depth * self.shear[2])
            });
            let (u, v, w) = (cross(c, b), cross(a, c), cross(b, a));
            let is_beside = (u < 0.0 || v < 0.0 || w < 0.0) && (u > 0.0 || v > 0.0 || w > 0.0);
            let determinant = u + v + w;
            if is_beside || determinant == 0.0 {
                continue;
            }
            let weights = [u / determinant, v / determinant, w / determinant];
            hits.met |= 1 << lane;
            hits.distances[lane] = weights[0] * a.z + weights[1] * b.z + weights[2] * c.z;
            hits.weights.iter_mut().zip(weights).for_each(|(each, weight)| each[lane] = weight);
        }
    }
}

/// Finds the nearest triangle beyond `low`.
struct Nearest {
    frame: RayFrame,
    low: f32,
    found: Option<TriangleHit>,
}

impl LeafVisitor for Nearest {
    #[inline(always)]
    fn visit<S: Simd>(&mut self, simd: S, leaf: &Leaf, mut limit: f32) -> f32 {
        let Some(hits) = self.frame.meet(simd, leaf) else { return limit };
        let mut met = hits.met;
        while met != 0 {
            let lane = met.trailing_zeros() as usize % WIDTH;
            met &= met - 1;
            let distance = hits.distances[lane];
            if distance > self.low && distance < limit {
                limit = distance;
                let weights = [hits.weights[0][lane], hits.weights[1][lane], hits.weights[2][lane]];
                self.found = Some(TriangleHit { triangle: leaf.triangles[lane], distance, weights });
            }
        }
        limit
    }
}

/// Rays whose directions have the same signs.
struct Packet {
    origin: [f32; 3],
    /// Inverse components of the directions, by axis; missing rays repeat the first.
    inverse: [[f32; PACKET]; 3],
    /// Distances to what the rays meet; missing rays have none.
    limits: [f32; PACKET],
    rays: [Nearest; PACKET],
    /// The number of each ray.
    numbers: [usize; PACKET],
    count: usize,
    /// A bit for each ray that enters the last box.
    entering: u64,
}

impl Packet {
    /// The rays in these of the `directions`, of which at least one is set.
    fn new(origin: Vec3, directions: &[Vec3], bits: u32, min_distance: f32) -> Self {
        let (mut numbers, mut count) = ([bits.trailing_zeros() as usize; PACKET], 0);
        for i in (0..directions.len()).filter(|i| bits >> i & 1 == 1) {
            numbers[count] = i;
            count += 1;
        }
        let inverse = std::array::from_fn(|axis| numbers.map(|i| inverse(directions[i][axis])));
        let limits = std::array::from_fn(|i| if i < count { f32::INFINITY } else { f32::NEG_INFINITY });
        let frames = numbers.map(|i| RayFrame::new(origin, directions[i]));
        let rays = frames.map(|frame| Nearest { frame, low: min_distance, found: None });
        Self { origin: origin.to_array(), inverse, limits, rays, numbers, count, entering: 0 }
    }

    /// A bit for each ray that enters a box before it meets what it has met.
    #[inline(always)]
    fn entering<S: Simd>(&self, simd: S, around: &BoxCorners) -> u64 {
        let (near_x, far_x) = self.planes(simd, around, 0);
        let (near_y, far_y) = self.planes(simd, around, 1);
        let (near_z, far_z) = self.planes(simd, around, 2);
        let entry = near_x.max(near_y).max(near_z.max(f32x16::splat(simd, 0.0)));
        let exit = far_x.min(far_y).min(far_z) * f32x16::splat(simd, ROUNDING);
        entry.simd_le(exit.min(f32x16::from_slice(simd, &self.limits))).to_bitmask()
    }

    /// Distances at which each ray meets the nearer and the farther plane of a box along an axis.
    #[inline(always)]
    fn planes<S: Simd>(&self, simd: S, around: &BoxCorners, axis: usize) -> (f32x16<S>, f32x16<S>) {
        let inverse = f32x16::from_slice(simd, &self.inverse[axis]);
        let near = usize::from(self.inverse[axis][0] < 0.0);
        let low = f32x16::splat(simd, around[near][axis] - self.origin[axis]);
        let high = f32x16::splat(simd, around[1 - near][axis] - self.origin[axis]);
        (low * inverse, high * inverse)
    }
}

impl LeafVisitor for Packet {
    #[inline(always)]
    fn enters<S: Simd>(&mut self, simd: S, around: &BoxCorners) -> bool {
        self.entering = self.entering(simd, around);
        self.entering != 0
    }

    #[inline(always)]
    fn visit<S: Simd>(&mut self, simd: S, leaf: &Leaf, _limit: f32) -> f32 {
        let mut entering = self.entering;
        while entering != 0 {
            let i = entering.trailing_zeros() as usize % PACKET;
            entering &= entering - 1;
            self.limits[i] = self.rays[i].visit(simd, leaf, self.limits[i]);
        }
        f32x16::from_slice(simd, &self.limits).reduce_max()
    }
}

/// The directions of a packet as ranges of their inverse components.
struct BoxPacket {
    origin: [f32; 3],
    least: [f32; 3],
    most: [f32; 3],
}

impl BoxRays for BoxPacket {
    #[inline(always)]
    fn planes<S: Simd>(&self, simd: S, bounds: &[[Each; 3]; 2], axis: usize) -> (f32x8<S>, f32x8<S>) {
        let origin = f32x8::splat(simd, self.origin[axis]);
        let least = f32x8::splat(simd, self.least[axis]);
        let most = f32x8::splat(simd, self.most[axis]);
        let near = usize::from(self.least[axis] < 0.0);
        let low = f32x8::from_slice(simd, &bounds[near][axis]) - origin;
        let high = f32x8::from_slice(simd, &bounds[1 - near][axis]) - origin;
        ((low * least).min(low * most), (high * least).max(high * most))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::primitive::ball_over_plate;
    use lobelia_sg::fibonacci::fibonacci_axes;

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
            // Beyond the slope of the next smaller triangle, so that only this one and larger ones
            // are in the way.
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
        assert_eq!(bvh.count(&ray, 0.0, f32::INFINITY, usize::MAX), 20_000);
    }

    #[test]
    fn a_mesh_always_gets_the_same_hierarchy() {
        let mesh = crate::mesh::primitive::sphere_mesh(Vec3::ZERO, 1.0).unwrap();
        let (a, b) = (TriangleBvh::new(&mesh), TriangleBvh::new(&mesh));
        assert!(a.hierarchy == b.hierarchy);
    }

    #[test]
    fn rays_of_a_packet_meet_what_each_meets_alone() {
        let bvh = TriangleBvh::new(&ball_over_plate(0.02, 1.01, 0.3));
        let mut hits = 0;
        // From between the ball and the plate, from within the ball, from outside and from far
        // away; near directions and all kinds of them.
        for origin in [Vec3::new(0.1, 0.4, 0.2), Vec3::Y, Vec3::new(3.0, 2.0, 1.0), Vec3::splat(500.0)] {
            let toward = (Vec3::Y * 0.5 - origin).normalize();
            let all = fibonacci_axes(400);
            let near = all.iter().map(|d| (toward + 0.2 * *d).normalize());
            let directions: Vec<Vec3> = near.chain(all.iter().copied()).collect();
            for directions in directions.chunks(PACKET).chain(directions.chunks(PACKET - 5)) {
                let found = bvh.nearest_of_packet(origin, directions, 1e-4);
                for (direction, found) in directions.iter().zip(found) {
                    let ray = Ray { origin, direction: *direction };
                    assert_eq!(found, bvh.nearest(&ray, 1e-4), "{ray:?}");
                    hits += usize::from(found.is_some());
                }
            }
        }
        assert!(hits > 1600, "{hits}");
    }

    #[test]
    fn directions_along_axes_and_such_as_are_none_are_traced_too() {
        let bvh = TriangleBvh::new(&ball_over_plate(0.02, 1.01, 0.3));
        let directions = [Vec3::Y, Vec3::NEG_Y, Vec3::new(-0.0, -1.0, -0.0), Vec3::ZERO, Vec3::NAN];
        let origin = Vec3::new(0.01, 0.5, 0.02);
        let found = bvh.nearest_of_packet(origin, &directions, 0.0);
        assert_eq!(found.map(|hit| hit.is_some())[..5], [true, true, true, false, false]);
        for (direction, found) in directions.into_iter().zip(found) {
            assert_eq!(found, bvh.nearest(&Ray { origin, direction }, 0.0));
        }
        assert_eq!(found[5..], [None; PACKET - 5]);
        let empty = TriangleBvh::new(&Mesh::default());
        assert_eq!(empty.nearest(&Ray { origin, direction: Vec3::X }, 0.0), None);
    }
}
