//! What a ray meets of the triangles of a leaf: a watertight test of all of them at once.
//!
//! The test is that of Woop, Benthin and Wald, "Watertight Ray/Triangle Intersection" (JCGT 2013): corners are transformed to a ray-aligned
//! frame, where the sign of an edge is the same for both triangles that share it, so no ray passes between them.

use crate::mesh::wide_bvh::{BoxCorners, Leaf, LeafVisitor, WIDTH};
use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x8};
use glam::{Vec3, Vec3A};

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
pub(super) struct RayFrame {
    origin: Vec3A,
    /// Which axis of the world is x, y and z; z is that along which the ray goes most.
    axes: [usize; 3],
    /// What is taken from x and from y for each unit of z, and the distance for each unit of z.
    shear: [f32; 3],
}

/// What a ray meets of the triangles of a leaf.
pub(super) struct LeafHits {
    /// A bit for each triangle that the line of the ray meets.
    pub met: u64,
    /// Distances along the ray.
    pub distances: [f32; WIDTH],
    weights: [[f32; WIDTH]; 3],
}

impl RayFrame {
    pub fn new(origin: Vec3, direction: Vec3) -> Self {
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
    pub fn meet<S: Simd>(&self, simd: S, leaf: &Leaf) -> Option<LeafHits> {
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
        for lane in (0..WIDTH).filter(|lane| on_edge >> lane & 1 == 1) {
            if let Some((distance, weights)) = self.meet_edge(leaf.corners_of(lane)) {
                hits.met |= 1 << lane;
                hits.distances[lane] = distance;
                hits.weights.iter_mut().zip(weights).for_each(|(each, weight)| each[lane] = weight);
            }
        }
    }

    fn meet_edge(&self, corners: [Vec3A; 3]) -> Option<(f32, [f32; 3])> {
        let [x, y, z] = self.axes;
        let [a, b, c] = corners.map(|corner| {
            let from_origin = corner - self.origin;
            let depth = from_origin[z];
            let sheared = [from_origin[x] - depth * self.shear[0], from_origin[y] - depth * self.shear[1]];
            Vec3A::new(sheared[0], sheared[1], depth * self.shear[2])
        });
        let cross =
            |p: Vec3A, q: Vec3A| (f64::from(p.x) * f64::from(q.y) - f64::from(p.y) * f64::from(q.x)) as f32;
        let (u, v, w) = (cross(c, b), cross(a, c), cross(b, a));
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

/// Finds the nearest triangle beyond `low`.
pub(super) struct Nearest {
    pub frame: RayFrame,
    pub low: f32,
    pub found: Option<TriangleHit>,
}

impl LeafVisitor for Nearest {
    /// One ray is tested against the children of a node, and that is all.
    #[inline(always)]
    fn enters<S: Simd>(&mut self, _simd: S, _around: &BoxCorners) -> bool {
        true
    }

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
