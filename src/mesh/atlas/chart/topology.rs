//! The triangles of a mesh and their neighbors.

use crate::mesh::triangles::Mesh;
use glam::DVec3;

/// No triangle.
pub(crate) const NONE: u32 = u32::MAX;

/// Triangles, their corners welded by position, and what lies across each of their edges.
///
/// Edge k of a triangle goes from its corner k to the next one. Two triangles are neighbors across an edge if no third one has it and
/// if they run along it in opposite directions. Degenerate triangles have no neighbors.
#[derive(Debug)]
pub(crate) struct Topology {
    /// World position of each vertex of the mesh.
    pub points: Vec<DVec3>,
    /// Three vertices for each triangle; of those at one position, the first.
    pub triangles: Vec<[u32; 3]>,
    /// The triangle across each edge, or [`NONE`].
    pub neighbors: Vec<[u32; 3]>,
    /// Area times unit normal of each triangle, squared world units; zero where it is degenerate.
    pub area_vectors: Vec<DVec3>,
}

impl Topology {
    /// The neighborhoods of a mesh whose indices are in range.
    pub fn new(mesh: &Mesh) -> Self {
        let weld = mesh.welded_vertices();
        let points: Vec<DVec3> = mesh.positions.iter().map(|p| p.as_dvec3()).collect();
        let triangles: Vec<[u32; 3]> = mesh.triangles.iter().map(|t| t.map(|v| weld[v as usize])).collect();
        let area_vector = |t: usize| {
            let [a, b, c] = triangles[t].map(|v| points[v as usize]);
            if mesh.is_degenerate(t) { DVec3::ZERO } else { 0.5 * (b - a).cross(c - a) }
        };
        let area_vectors: Vec<DVec3> = (0..triangles.len()).map(area_vector).collect();
        let neighbors = neighbors(&triangles, &area_vectors);
        Self { points, triangles, neighbors, area_vectors }
    }

    /// Whether the triangle has area.
    pub fn has_area(&self, triangle: u32) -> bool {
        self.area_vectors[triangle as usize] != DVec3::ZERO
    }

    /// World positions of the triangle's corners.
    pub fn corners(&self, triangle: u32) -> [DVec3; 3] {
        self.triangles[triangle as usize].map(|vertex| self.points[vertex as usize])
    }

    /// Length of edge k of a triangle, world units.
    pub fn edge_length(&self, triangle: u32, k: usize) -> f64 {
        let corners = self.corners(triangle);
        corners[k].distance(corners[(k + 1) % 3])
    }
}

/// The triangle across each edge of those with area.
fn neighbors(triangles: &[[u32; 3]], area_vectors: &[DVec3]) -> Vec<[u32; 3]> {
    // The two ends in order, whether they were swapped, and the half edge.
    let mut edges: Vec<(u64, bool, u32)> = Vec::with_capacity(3 * triangles.len());
    for (t, corners) in triangles.iter().enumerate().filter(|(t, _)| area_vectors[*t] != DVec3::ZERO) {
        for k in 0..3 {
            let (from, to) = (corners[k], corners[(k + 1) % 3]);
            let ends = u64::from(from.min(to)) << 32 | u64::from(from.max(to));
            edges.push((ends, from > to, (3 * t + k) as u32));
        }
    }
    edges.sort_unstable();
    let mut found = vec![[NONE; 3]; triangles.len()];
    for same in edges.chunk_by(|a, b| a.0 == b.0) {
        if let [(_, false, a), (_, true, b)] = *same {
            found[a as usize / 3][a as usize % 3] = b / 3;
            found[b as usize / 3][b as usize % 3] = a / 3;
        }
    }
    found
}
