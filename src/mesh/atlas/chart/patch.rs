//! A part of the surface as a mesh of its own, open along its border.

use super::topology::{NONE, Topology};
use glam::{DVec2, DVec3};

/// Triangles of a surface with vertices of their own: two corners are one vertex only if a fan of the patch's triangles joins them.
#[derive(Debug)]
pub(crate) struct Patch {
    /// Triangles of the surface, ascending.
    pub faces: Vec<u32>,
    /// Three vertices of the patch for each.
    pub triangles: Vec<[u32; 3]>,
    /// World position of each vertex.
    pub points: Vec<DVec3>,
    /// The patch's border: half edges as pairs of vertices, in closed loops one after another, and where each loop begins.
    pub border: Vec<[u32; 2]>,
    /// Number of closed loops of the border.
    pub loops: usize,
    /// Sum of the area vectors, squared world units.
    pub area_vector: DVec3,
    /// Area, squared world units.
    pub area: f64,
    /// Number of edges.
    edges: usize,
}

impl Patch {
    /// The patch of these triangles of the surface, which have area and are ascending.
    pub fn new(topology: &Topology, faces: Vec<u32>) -> Self {
        let across = |i: usize, k: usize| {
            let neighbor = topology.neighbors[faces[i] as usize][k];
            if neighbor == NONE { None } else { faces.binary_search(&neighbor).ok() }
        };
        let inner: Vec<[Option<usize>; 3]> =
            (0..faces.len()).map(|i| [0, 1, 2].map(|k| across(i, k))).collect();
        let roots = joined_corners(topology, &faces, &inner);
        let mut vertex_of = vec![NONE; roots.len()];
        let (mut points, mut triangles) = (Vec::new(), Vec::with_capacity(faces.len()));
        for (i, &face) in faces.iter().enumerate() {
            let corners = topology.corners(face);
            triangles.push([0, 1, 2].map(|k| {
                let vertex = &mut vertex_of[roots[3 * i + k] as usize];
                if *vertex == NONE {
                    *vertex = points.len() as u32;
                    points.push(corners[k]);
                }
                *vertex
            }));
        }
        let (border, loops) = border(&triangles, &inner, points.len());
        let edges = (3 * faces.len() + border.len()) / 2;
        let vectors = || faces.iter().map(|&t| topology.area_vectors[t as usize]);
        Self {
            area_vector: vectors().sum(),
            area: vectors().map(|v| v.length()).sum(),
            faces,
            triangles,
            points,
            border,
            loops,
            edges,
        }
    }

    /// Whether the patch can lie in a plane: connected, it has a border and no handles (Euler's formula).
    pub fn is_planar(&self) -> bool {
        self.loops > 0 && self.points.len() + self.triangles.len() + self.loops == self.edges + 2
    }
}

/// For each corner, the lowest one of its vertex.
fn joined_corners(topology: &Topology, faces: &[u32], inner: &[[Option<usize>; 3]]) -> Vec<u32> {
    let mut parent: Vec<u32> = (0..3 * faces.len() as u32).collect();
    let find = |parent: &mut Vec<u32>, mut corner: u32| {
        while parent[corner as usize] != corner {
            parent[corner as usize] = parent[parent[corner as usize] as usize];
            corner = parent[corner as usize];
        }
        corner
    };
    for (i, others) in inner.iter().enumerate() {
        let here = topology.triangles[faces[i] as usize];
        for (k, other) in others.iter().enumerate() {
            let Some(j) = other.filter(|j| i < *j) else { continue };
            let there = topology.triangles[faces[j] as usize];
            for corner in [k, (k + 1) % 3] {
                let Some(l) = there.iter().position(|v| *v == here[corner]) else { continue };
                let a = find(&mut parent, (3 * i + corner) as u32);
                let b = find(&mut parent, (3 * j + l) as u32);
                parent[a.max(b) as usize] = a.min(b);
            }
        }
    }
    (0..parent.len() as u32).map(|corner| find(&mut parent, corner)).collect()
}

/// The half edges without an inner neighbor, loop by loop, and the number of loops.
fn border(triangles: &[[u32; 3]], inner: &[[Option<usize>; 3]], vertices: usize) -> (Vec<[u32; 2]>, usize) {
    // A vertex is one fan, so that at most one half edge of the border leaves it.
    let mut next = vec![NONE; vertices];
    for (triangle, others) in triangles.iter().zip(inner) {
        for k in 0..3 {
            if others[k].is_none() {
                next[triangle[k] as usize] = triangle[(k + 1) % 3];
            }
        }
    }
    let (mut border, mut loops) = (Vec::new(), 0);
    for first in 0..vertices {
        let mut at = first;
        loops += usize::from(next[first] != NONE);
        while next[at] != NONE {
            let to = std::mem::replace(&mut next[at], NONE);
            border.push([at as u32, to]);
            at = to as usize;
        }
    }
    (border, loops)
}

/// A triangle as it lies in its own plane: its first corner at the origin, the second on the x axis.
#[derive(Clone, Copy, Debug)]
pub struct PlanarTriangle {
    /// x of the second corner, world units.
    pub base: f64,
    /// The third corner.
    pub tip: DVec2,
    /// Area, squared world units.
    pub area: f64,
}

impl PlanarTriangle {
    /// The shape of a triangle with area.
    pub fn new(corners: [DVec3; 3]) -> Self {
        let [a, b, c] = corners;
        let base = (b - a).length();
        let along = (b - a) / base;
        let x = (c - a).dot(along);
        let y = ((c - a) - along * x).length();
        Self { base, tip: DVec2::new(x, y), area: 0.5 * base * y }
    }

    /// Derivatives of a map from the triangle's plane that takes its corners to `corners`: by x, and by y.
    pub fn jacobian(&self, corners: [DVec2; 3]) -> [DVec2; 2] {
        let by_x = (corners[1] - corners[0]) / self.base;
        [by_x, (corners[2] - corners[0] - by_x * self.tip.x) / self.tip.y]
    }

    /// Adjoints of the corners for the adjoint of [`Self::jacobian`].
    pub fn pull_back(&self, [by_x, by_y]: [DVec2; 2]) -> [DVec2; 3] {
        let third = by_y / self.tip.y;
        let second = (by_x - third * self.tip.x) / self.base;
        [-(second + third), second, third]
    }
}
