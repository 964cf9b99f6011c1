//! Mesh simplification: edges are collapsed where the surface changes least.
//!
//! Garland and Heckbert, "Surface Simplification Using Quadric Error Metrics" (SIGGRAPH 1997): a
//! vertex has the sum of the squared distances to the planes of the triangles that it represents;
//! an edge collapses to the point where the sum of both ends is smallest, cheapest edges first.
//! Collapses that change the topology or flip a triangle are not made, so that a closed manifold
//! stays one.
//!
//! ```
//! use glam::Vec3;
//! use lobelia_geometry::mesh::decimate::decimate;
//! use lobelia_geometry::sdf::{SdfGrid, extract::extract_mesh};
//!
//! let ball = SdfGrid::from_fn(Vec3::ZERO, 1.0, 16, |point| point.length() - 0.7);
//! let mesh = extract_mesh(&ball);
//! let small = decimate(&mesh, 100);
//! assert!(small.triangles.len() <= 100 && mesh.triangles.len() > 300);
//! assert!((small.area() / mesh.area() - 1.0).abs() < 0.1);
//! ```

use crate::mesh::triangles::{Mesh, Side, sorted_sides};
use glam::{DMat3, DVec3};
use std::{cmp::Reverse, collections::BinaryHeap};

/// Weight of the distance to the old vertices, relative to that of the old planes: it determines
/// the position in a plane or along an edge, and is negligible elsewhere.
const STAY: f64 = 1e-5;
/// Weight of the planes that preserve a border.
const BORDER: f64 = 10.0;
/// Least cosine between the normals of a triangle before and after a collapse.
const MIN_TURN: f64 = 0.2;
/// Least height of a triangle after a collapse, relative to its longest side.
const MIN_HEIGHT: f64 = 1e-3;

/// The mesh with about `target` triangles (or as few as possible), with merged vertices, smooth
/// normals and without texture coordinates. A mesh with at most `target` triangles only loses its
/// texture coordinates. Deterministic.
pub fn decimate(mesh: &Mesh, target: usize) -> Mesh {
    let mut collapser = Collapser::new(mesh);
    while collapser.alive > target && collapser.round(target) {}
    let Collapser { center, positions, triangles, around, .. } = collapser;
    let mut number = vec![u32::MAX; positions.len()];
    let mut mesh = Mesh::default();
    for vertex in (0..positions.len()).filter(|&vertex| !around[vertex].is_empty()) {
        number[vertex] = mesh.positions.len() as u32;
        mesh.positions.push((positions[vertex] + center).as_vec3());
    }
    let stays = |(t, [first, ..]): &(u32, [u32; 3])| around[*first as usize].contains(t);
    let kept = (0..).zip(triangles).filter(stays);
    mesh.triangles = kept.map(|(_, triangle)| triangle.map(|vertex| number[vertex as usize])).collect();
    mesh.normals = mesh.smooth_normals();
    mesh
}

/// Weighted sum of squared distances to planes and points: p·Ap + 2b·p + c.
#[derive(Clone, Copy)]
struct Quadric {
    a: DMat3,
    b: DVec3,
    c: f64,
}

impl Quadric {
    const ZERO: Self = Self { a: DMat3::ZERO, b: DVec3::ZERO, c: 0.0 };

    fn plane(normal: DVec3, through: DVec3, weight: f64) -> Self {
        let d = -normal.dot(through);
        let a = DMat3::from_cols(normal * normal.x, normal * normal.y, normal * normal.z) * weight;
        Self { a, b: normal * (d * weight), c: d * d * weight }
    }

    fn point(at: DVec3, weight: f64) -> Self {
        Self { a: DMat3::IDENTITY * weight, b: -at * weight, c: at.length_squared() * weight }
    }

    fn plus(self, other: Self) -> Self {
        Self { a: self.a + other.a, b: self.b + other.b, c: self.c + other.c }
    }

    fn at(&self, p: DVec3) -> f64 {
        (p.dot(self.a * p) + 2.0 * self.b.dot(p) + self.c).max(0.0)
    }

    /// The minimum; every vertex has a [`STAY`] part, so that it is unique.
    fn least(&self) -> DVec3 {
        -(self.a.inverse() * self.b)
    }
}

/// An edge to collapse: cost (the bits of a non-negative number sort like the number), its ends,
/// and the sum of their stamps at insertion.
type Candidate = Reverse<(u64, u32, u32, u32)>;

struct Collapser {
    center: DVec3,
    positions: Vec<DVec3>,
    quadrics: Vec<Quadric>,
    triangles: Vec<[u32; 3]>,
    /// Triangles at each vertex.
    around: Vec<Vec<u32>>,
    /// Whether a vertex is on an edge that does not have exactly two triangles.
    border: Vec<bool>,
    /// Number of changes of each vertex, which identifies outdated candidates.
    stamps: Vec<u32>,
    /// Number of remaining triangles.
    alive: usize,
}

impl Collapser {
    fn new(mesh: &Mesh) -> Self {
        let (low, high) = mesh.bounds().unwrap_or_default();
        let center = low.midpoint(high).as_dvec3();
        let weld = mesh.welded_vertices();
        let joined = mesh.triangles.iter().map(|t| t.map(|vertex| weld[vertex as usize]));
        let triangles: Vec<[u32; 3]> = joined.filter(|[a, b, c]| a != b && b != c && c != a).collect();
        let count = mesh.positions.len();
        let positions = mesh.positions.iter().map(|p| p.as_dvec3() - center).collect();
        let (quadrics, around) = (vec![Quadric::ZERO; count], vec![Vec::new(); count]);
        let (border, stamps, alive) = (vec![false; count], vec![0; count], triangles.len());
        let mut new = Self { center, positions, quadrics, triangles, around, border, stamps, alive };
        for (t, triangle) in new.triangles.iter().enumerate() {
            let corners = triangle.map(|vertex| new.positions[vertex as usize]);
            let doubled = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
            let area = 0.5 * doubled.length();
            let plane = Quadric::plane(doubled.normalize_or_zero(), corners[0], area);
            for (k, &vertex) in triangle.iter().enumerate() {
                let quadric = &mut new.quadrics[vertex as usize];
                *quadric = quadric.plus(plane).plus(Quadric::point(corners[k], area * STAY));
                new.around[vertex as usize].push(t as u32);
            }
        }
        for same in sorted_sides(&new.triangles).chunk_by(|a, b| a.ends == b.ends) {
            if same.len() == 2 {
                continue;
            }
            // The plane through a border edge perpendicular to its triangle.
            let Side { ends, triangle } = same[0];
            let [a, b, c] = new.triangles[triangle as usize].map(|vertex| new.positions[vertex as usize]);
            let [from, to] = ends.map(|end| new.positions[end as usize]);
            let upright = (to - from).cross((b - a).cross(c - a)).normalize_or_zero();
            let plane = Quadric::plane(upright, from, BORDER * (to - from).length_squared());
            for end in ends.map(|end| end as usize) {
                new.quadrics[end] = new.quadrics[end].plus(plane);
                new.border[end] = true;
            }
        }
        new
    }

    /// Collapses edges until `target` triangles are left or no collapse is allowed; returns whether
    /// any was made.
    fn round(&mut self, target: usize) -> bool {
        let mut heap = BinaryHeap::new();
        for from in 0..self.positions.len() as u32 {
            let beyond = self.neighbors(from).into_iter().filter(|&to| from < to);
            heap.extend(beyond.map(|to| self.candidate(from, to)));
        }
        let before = self.alive;
        while self.alive > target {
            let Some(Reverse((_, a, b, stamp))) = heap.pop() else { break };
            if stamp == self.stamps[a as usize] + self.stamps[b as usize] && self.collapse(a, b) {
                heap.extend(self.neighbors(a).into_iter().map(|other| self.candidate(a, other)));
            }
        }
        self.alive < before
    }

    fn candidate(&self, a: u32, b: u32) -> Candidate {
        let quadric = self.quadrics[a as usize].plus(self.quadrics[b as usize]);
        let cost = quadric.at(quadric.least());
        Reverse((cost.to_bits(), a, b, self.stamps[a as usize] + self.stamps[b as usize]))
    }

    /// The vertices that share a triangle with `vertex`, in order.
    fn neighbors(&self, vertex: u32) -> Vec<u32> {
        let triangles = self.around[vertex as usize].iter().map(|&t| self.triangles[t as usize]);
        let mut found: Vec<u32> = triangles.flatten().filter(|&other| other != vertex).collect();
        found.sort_unstable();
        found.dedup();
        found
    }

    /// Moves `a` to the best position for both and replaces `b` by it, if that is allowed.
    fn collapse(&mut self, a: u32, b: u32) -> bool {
        let (from, gone) = (a as usize, b as usize);
        let touches = |t: &u32| self.triangles[*t as usize].contains(&b);
        let shared: Vec<u32> = self.around[from].iter().copied().filter(touches).collect();
        let quadric = self.quadrics[from].plus(self.quadrics[gone]);
        let place = quadric.least();
        if !(place.is_finite() && self.keeps_topology(a, b, &shared) && self.keeps_sides(a, b, place)) {
            return false;
        }
        for &t in &shared {
            for vertex in self.triangles[t as usize] {
                self.around[vertex as usize].retain(|&other| other != t);
            }
        }
        for t in std::mem::take(&mut self.around[gone]) {
            for vertex in self.triangles[t as usize].iter_mut().filter(|vertex| **vertex == b) {
                *vertex = a;
            }
            self.around[from].push(t);
        }
        self.alive -= shared.len();
        self.positions[from] = place;
        self.quadrics[from] = quadric;
        self.border[from] |= self.border[gone];
        self.stamps[from] += 1;
        self.stamps[gone] += 1;
        true
    }

    /// The link condition: the ends have no more common neighbors than the edge has triangles, one
    /// or two, and no third corner loses triangles that it needs.
    fn keeps_topology(&self, a: u32, b: u32, shared: &[u32]) -> bool {
        let on_border = shared.len() == 1;
        let both = self.border[a as usize] && self.border[b as usize];
        if shared.is_empty() || shared.len() > 2 || (both && !on_border) {
            return false;
        }
        let others = self.neighbors(b);
        let common: Vec<u32> =
            self.neighbors(a).into_iter().filter(|other| others.binary_search(other).is_ok()).collect();
        let needs = |vertex: u32| if self.border[vertex as usize] { 1 } else { 3 };
        common.len() == shared.len() && common.iter().all(|&v| self.around[v as usize].len() > needs(v))
    }

    /// Whether the remaining triangles keep their orientation and some height when `a` and `b` move
    /// to `place`.
    fn keeps_sides(&self, a: u32, b: u32, place: DVec3) -> bool {
        let staying = self.around[a as usize].iter().chain(&self.around[b as usize]);
        staying.map(|&t| self.triangles[t as usize]).all(|triangle| {
            if triangle.contains(&a) && triangle.contains(&b) {
                return true;
            }
            let old = triangle.map(|vertex| self.positions[vertex as usize]);
            let new: [DVec3; 3] =
                std::array::from_fn(|k| if triangle[k] == a || triangle[k] == b { place } else { old[k] });
            let doubled = |[a, b, c]: [DVec3; 3]| (b - a).cross(c - a);
            let (before, after) = (doubled(old), doubled(new));
            let longest = (0..3).map(|k| new[k].distance_squared(new[(k + 1) % 3])).fold(0.0, f64::max);
            after.length() > MIN_HEIGHT * longest
                && before.dot(after) > MIN_TURN * before.length() * after.length()
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::primitive::{box_mesh, sphere_mesh};
    use crate::{
        mesh::nearest::chamfer_distance,
        mesh::tests::{is_closed, plate},
    };
    use glam::Vec3;

    /// Checks that the mesh is closed; returns the Euler characteristic.
    #[track_caller]
    fn check_closed(mesh: &Mesh) -> i64 {
        assert!(is_closed(mesh));
        mesh.positions.len() as i64 - mesh.triangles.len() as i64 / 2
    }

    #[test]
    fn a_sphere_of_a_tenth_stays_closed_and_near() {
        let full = sphere_mesh(Vec3::new(3.0, -2.0, 1.0), 1.0).unwrap();
        for part in [10, 100, 2000] {
            let target = full.triangles.len() / part;
            let small = decimate(&full, target);
            assert!(small.triangles.len() <= target && small.triangles.len() + 2 >= target);
            assert_eq!(check_closed(&small), 2);
            let distance = chamfer_distance(&full, &small, 0).unwrap();
            // The flat triangles of an even mesh of n would be about 1.2 / n away.
            assert!(distance < 3.0 / target as f64 + 1e-4, "{part}: {distance}");
            assert!((0..small.triangles.len()).all(|t| !small.is_degenerate(t)));
            assert_eq!(small, decimate(&full, target), "not deterministic");
        }
    }

    #[test]
    fn corners_and_flat_faces_are_kept() {
        let solid = box_mesh(Vec3::ZERO, Vec3::ONE).unwrap();
        // Every triangle in four, three times.
        let mut fine = Mesh { uvs: None, ..solid };
        for _ in 0..3 {
            let mut next = Mesh::default();
            for t in 0..fine.triangles.len() {
                let [a, b, c] = fine.corners(t);
                let [ab, bc, ca] = [a.midpoint(b), b.midpoint(c), c.midpoint(a)];
                for corners in [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]] {
                    let first = next.positions.len() as u32;
                    next.positions.extend(corners);
                    next.triangles.push([first, first + 1, first + 2]);
                }
            }
            fine = next;
        }
        let small = decimate(&fine, 12);
        assert_eq!((small.triangles.len(), check_closed(&small)), (12, 2));
        assert!(small.positions.iter().all(|p| (p.abs() - 0.5).length() < 1e-4), "{:?}", small.positions);
    }

    #[test]
    fn a_border_stays_where_it_is() {
        let small = decimate(&plate(20), 8);
        assert!(small.triangles.len() <= 8 && (small.area() - 4.0).abs() < 4e-3, "{}", small.area());
        assert!(small.normals.iter().all(|n| n.z > 0.999));
    }

    #[test]
    fn a_solid_does_not_vanish() {
        let small = decimate(&sphere_mesh(Vec3::ZERO, 1.0).unwrap(), 0);
        assert!(small.triangles.len() <= 20 && check_closed(&small) == 2, "{}", small.triangles.len());
        assert_eq!(decimate(&Mesh::default(), 5), Mesh::default());
    }
}
