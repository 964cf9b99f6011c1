//! Charts: parts of a surface that lie in a plane with little distortion.
//!
//! [`segment`] makes a tree of regions; from its roots, a region that can be flattened
//! ([`flatten`](mod@flatten)) is a chart, any other falls into its two halves. A single triangle
//! always can. Then small charts join a neighbor where the two together are still flat enough.

mod flatten;
mod segment;

use crate::mesh::triangles::{DisjointSets, Mesh, sorted_sides};
use crate::{Result, error::stop::check_interrupted, parallel};
use flatten::{Tolerance, flatten};
use glam::{DVec2, DVec3};
use segment::{RegionNode, RegionTree};
use std::collections::BTreeMap;

/// So many times a region is tried before its halves; deeper in the tree only regions of at most so
/// many triangles are tried.
const LEVELS: (usize, u32) = (24, 256);
/// Distortion limits of a chart.
const USUAL: Tolerance = Tolerance { mean: 4.5, uneven: 0.01 };
/// Distortion limits of a chart that has taken in a small one.
const JOINED: Tolerance = Tolerance { mean: 4.7, uneven: 0.03 };
/// A chart of at most this part of the mean chart's area is small.
const SMALL: f64 = 0.1;
/// Most neighbors that a small chart tries to join.
const MOST_TRIES: usize = 3;
/// Triangles that may be flattened to join small charts, for each of the mesh.
const MOST_WORK: usize = 8;

/// A part of the surface in the plane.
#[derive(Clone, Debug)]
pub struct Chart {
    /// Triangles of the mesh, ascending.
    pub faces: Vec<u32>,
    /// Three places of `places` for each.
    pub triangles: Vec<[u32; 3]>,
    /// Places in the plane, world units: triangles are counter-clockwise and, all together, as
    /// large as in the world.
    pub places: Vec<DVec2>,
}

impl Chart {
    /// Area, squared world units.
    pub fn area(&self) -> f64 {
        area_in_plane(&self.triangles, &self.places)
    }
}

fn area_in_plane(triangles: &[[u32; 3]], places: &[DVec2]) -> f64 {
    let doubled = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|v| places[v as usize]);
        (b - a).perp_dot(c - a)
    };
    0.5 * triangles.iter().map(doubled).sum::<f64>()
}

/// Charts of all triangles of a mesh that have area, each in one of them. Indices of the mesh are
/// in range. Deterministic.
///
/// # Errors
/// [`Error::Interrupted`](crate::Error::Interrupted) if the work is to stop: of a million triangles
/// it takes ten seconds.
pub fn charts(mesh: &Mesh) -> Result<Vec<Chart>> {
    let topology = Topology::new(mesh);
    let tree = RegionTree::new(&topology);
    let mut found = Vec::new();
    let (mut open, mut level) = (tree.roots.clone(), 0);
    while !open.is_empty() {
        let flat = |node: &u32| -> Result<Option<Chart>> {
            check_interrupted()?;
            let try_whole = level < LEVELS.0 || tree.counts[*node as usize] <= LEVELS.1;
            Ok(try_whole.then(|| chart_of(&topology, tree.triangles(*node), &USUAL)).flatten())
        };
        let tried: Vec<Result<Option<Chart>>> = parallel::map_slice(&open, 1, flat);
        let tried = tried.into_iter().collect::<Result<Vec<_>>>()?;
        level += 1;
        for (node, chart) in std::mem::take(&mut open).into_iter().zip(tried) {
            match (chart, tree.nodes[node as usize]) {
                (Some(chart), _) => found.push(chart),
                (None, RegionNode::Pair(a, b)) => open.extend([a, b]),
                (None, RegionNode::Triangle(face)) => {
                    let places = PlanarTriangle::new(topology.corners(face)).corners().to_vec();
                    found.push(Chart { faces: vec![face], triangles: vec![[0, 1, 2]], places });
                }
            }
        }
    }
    join_small(&topology, found)
}

/// Triangles of the surface as a chart, if they lie flat.
fn chart_of(topology: &Topology, faces: Vec<u32>, tolerance: &Tolerance) -> Option<Chart> {
    let patch = Patch::new(topology, faces);
    let places = flatten(&patch, tolerance)?;
    Some(Chart { faces: patch.faces, triangles: patch.triangles, places })
}

/// Small charts join the neighbor with which they share most of their border, if the two lie flat
/// together; from the smallest up.
fn join_small(topology: &Topology, charts: Vec<Chart>) -> Result<Vec<Chart>> {
    let mut chart_of_face = vec![NONE; topology.triangles.len()];
    let areas: Vec<f64> = charts.iter().map(Chart::area).collect();
    for (i, chart) in charts.iter().enumerate() {
        chart.faces.iter().for_each(|face| chart_of_face[*face as usize] = i as u32);
    }
    let largest = SMALL * areas.iter().sum::<f64>() / areas.len().max(1) as f64;
    let mut charts: Vec<Option<Chart>> = charts.into_iter().map(Some).collect();
    let mut order: Vec<usize> = (0..charts.len()).filter(|&i| areas[i] <= largest).collect();
    order.sort_by(|a, b| areas[*a].total_cmp(&areas[*b]).then(a.cmp(b)));
    let mut work = MOST_WORK * topology.triangles.len();
    for small in order {
        check_interrupted()?;
        let Some(chart) = &charts[small] else { continue };
        let around = neighbors(topology, &chart_of_face, &chart.faces);
        let joined = around.into_iter().take(MOST_TRIES).find_map(|neighbor| {
            let other = charts[neighbor].as_ref()?;
            let mut faces = [&chart.faces[..], &other.faces].concat();
            work = work.checked_sub(faces.len())?;
            faces.sort_unstable();
            Some((neighbor, chart_of(topology, faces, &JOINED)?))
        });
        if let Some((neighbor, joined)) = joined {
            chart.faces.iter().for_each(|face| chart_of_face[*face as usize] = neighbor as u32);
            charts[neighbor] = Some(joined);
            charts[small] = None;
        }
    }
    Ok(charts.into_iter().flatten().collect())
}

/// The charts around some faces, that with the longest common border first.
fn neighbors(topology: &Topology, chart_of_face: &[u32], faces: &[u32]) -> Vec<usize> {
    let own = chart_of_face[faces[0] as usize];
    let mut shared: BTreeMap<u32, f64> = BTreeMap::new();
    for &face in faces {
        for k in 0..3 {
            let across = topology.neighbors[face as usize][k];
            if across != NONE && chart_of_face[across as usize] != own {
                *shared.entry(chart_of_face[across as usize]).or_default() += topology.edge_length(face, k);
            }
        }
    }
    let mut found: Vec<(u32, f64)> = shared.into_iter().collect();
    found.sort_by(|a, b| b.1.total_cmp(&a.1));
    found.into_iter().map(|(chart, _)| chart as usize).collect()
}

/// No triangle.
const NONE: u32 = u32::MAX;

/// Triangles, their corners welded by position, and what lies across each of their edges.
///
/// Edge k of a triangle goes from its corner k to the next one. Two triangles are neighbors across
/// an edge if no third one has it and if they run along it in opposite directions. Degenerate
/// triangles have no neighbors.
#[derive(Debug)]
struct Topology {
    /// World position of each vertex of the mesh.
    points: Vec<DVec3>,
    /// Three vertices for each triangle; of those at one position, the first.
    triangles: Vec<[u32; 3]>,
    /// The triangle across each edge, or [`NONE`].
    neighbors: Vec<[u32; 3]>,
    /// Area times unit normal of each triangle, squared world units; zero where it is degenerate.
    area_vectors: Vec<DVec3>,
}

impl Topology {
    /// The neighborhoods of a mesh whose indices are in range.
    fn new(mesh: &Mesh) -> Self {
        let weld = mesh.welded_vertices();
        let points: Vec<DVec3> = mesh.positions.iter().map(|p| p.as_dvec3()).collect();
        let triangles: Vec<[u32; 3]> = mesh.triangles.iter().map(|t| t.map(|v| weld[v as usize])).collect();
        let area_vector = |t: usize| {
            let [a, b, c] = triangles[t].map(|v| points[v as usize]);
            if mesh.is_degenerate(t) { DVec3::ZERO } else { 0.5 * (b - a).cross(c - a) }
        };
        let area_vectors: Vec<DVec3> = (0..triangles.len()).map(area_vector).collect();
        let mut neighbors = vec![[NONE; 3]; triangles.len()];
        for same in sorted_sides(&triangles).chunk_by(|a, b| a.ends == b.ends) {
            let mut there = same.iter().filter(|side| area_vectors[side.triangle as usize] != DVec3::ZERO);
            let (Some(a), Some(b), None) = (there.next(), there.next(), there.next()) else { continue };
            // The number of the edge in each triangle: one runs along it, the other against it.
            let [from, to] = a.ends;
            let edge = |triangle: u32, start: u32, end: u32| {
                let corners = triangles[triangle as usize];
                (0..3).find(|&k| corners[k] == start && corners[(k + 1) % 3] == end)
            };
            for (a, b) in [(a.triangle, b.triangle), (b.triangle, a.triangle)] {
                if let (Some(k), Some(l)) = (edge(a, from, to), edge(b, to, from)) {
                    neighbors[a as usize][k] = b;
                    neighbors[b as usize][l] = a;
                }
            }
        }
        Self { points, triangles, neighbors, area_vectors }
    }

    /// Whether the triangle has area.
    fn has_area(&self, triangle: u32) -> bool {
        self.area_vectors[triangle as usize] != DVec3::ZERO
    }

    /// World positions of the triangle's corners.
    fn corners(&self, triangle: u32) -> [DVec3; 3] {
        self.triangles[triangle as usize].map(|vertex| self.points[vertex as usize])
    }

    /// Length of edge k of a triangle, world units.
    fn edge_length(&self, triangle: u32, k: usize) -> f64 {
        let corners = self.corners(triangle);
        corners[k].distance(corners[(k + 1) % 3])
    }
}

/// Triangles of a surface with vertices of their own: two corners are one vertex only if a fan of
/// the patch's triangles joins them.
#[derive(Debug)]
struct Patch {
    /// Triangles of the surface, ascending.
    faces: Vec<u32>,
    /// Three vertices of the patch for each.
    triangles: Vec<[u32; 3]>,
    /// The shape of each.
    shapes: Vec<PlanarTriangle>,
    /// World position of each vertex.
    points: Vec<DVec3>,
    /// The patch's border: half edges as pairs of vertices, in closed loops one after another
    /// ([`loops`]).
    border: Vec<[u32; 2]>,
    /// Sum of the area vectors, squared world units.
    area_vector: DVec3,
    /// Area, squared world units.
    area: f64,
}

impl Patch {
    /// The patch of these triangles of the surface, which have area and are ascending.
    fn new(topology: &Topology, faces: Vec<u32>) -> Self {
        let across = |i: usize, k: usize| {
            let neighbor = topology.neighbors[faces[i] as usize][k];
            if neighbor == NONE { None } else { faces.binary_search(&neighbor).ok() }
        };
        let inner: Vec<_> = (0..faces.len()).map(|i| [0, 1, 2].map(|k| across(i, k))).collect();
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
        let vectors = || faces.iter().map(|&t| topology.area_vectors[t as usize]);
        let (area_vector, area) = (vectors().sum(), vectors().map(|v| v.length()).sum());
        let shapes = faces.iter().map(|&face| PlanarTriangle::new(topology.corners(face))).collect();
        let border = border(&triangles, &inner, points.len());
        Self { faces, triangles, shapes, points, border, area_vector, area }
    }

    /// Whether the patch can lie in a plane: connected, it has a border and no handles (Euler's
    /// formula).
    fn is_planar(&self) -> bool {
        let edges = (3 * self.triangles.len() + self.border.len()) / 2;
        let loops = loops(&self.border).count();
        loops > 0 && self.points.len() + self.triangles.len() + loops == edges + 2
    }
}

/// For each corner, the lowest one of its vertex.
fn joined_corners(topology: &Topology, faces: &[u32], inner: &[[Option<usize>; 3]]) -> Vec<u32> {
    let mut corners = DisjointSets::new(3 * faces.len());
    for (i, others) in inner.iter().enumerate() {
        let here = topology.triangles[faces[i] as usize];
        for (k, other) in others.iter().enumerate() {
            let Some(j) = other.filter(|j| i < *j) else { continue };
            let there = topology.triangles[faces[j] as usize];
            for corner in [k, (k + 1) % 3] {
                let Some(l) = there.iter().position(|v| *v == here[corner]) else { continue };
                corners.join((3 * i + corner) as u32, (3 * j + l) as u32);
            }
        }
    }
    (0..3 * faces.len() as u32).map(|corner| corners.root(corner)).collect()
}

/// The half edges without an inner neighbor, loop by loop.
fn border(triangles: &[[u32; 3]], inner: &[[Option<usize>; 3]], vertices: usize) -> Vec<[u32; 2]> {
    // A vertex is one fan, so that at most one half edge of the border leaves it.
    let mut next = vec![NONE; vertices];
    for (triangle, others) in triangles.iter().zip(inner) {
        for k in 0..3 {
            if others[k].is_none() {
                next[triangle[k] as usize] = triangle[(k + 1) % 3];
            }
        }
    }
    let mut border = Vec::new();
    for first in 0..vertices {
        let mut at = first;
        while next[at] != NONE {
            let to = std::mem::replace(&mut next[at], NONE);
            border.push([at as u32, to]);
            at = to as usize;
        }
    }
    border
}

/// The loops of a border.
fn loops(border: &[[u32; 2]]) -> impl Iterator<Item = &[[u32; 2]]> {
    border.chunk_by(|before, next| before[1] == next[0])
}

/// A triangle as it lies in its own plane: its first corner at the origin, the second on the x
/// axis.
#[derive(Clone, Copy, Debug)]
struct PlanarTriangle {
    /// x of the second corner, world units.
    base: f64,
    /// The third corner.
    tip: DVec2,
    /// Area, squared world units.
    area: f64,
}

impl PlanarTriangle {
    /// The shape of a triangle with area.
    fn new(corners: [DVec3; 3]) -> Self {
        let [a, b, c] = corners;
        let base = (b - a).length();
        let along = (b - a) / base;
        let x = (c - a).dot(along);
        let y = ((c - a) - along * x).length();
        Self { base, tip: DVec2::new(x, y), area: 0.5 * base * y }
    }

    /// Its corners in its plane.
    fn corners(&self) -> [DVec2; 3] {
        [DVec2::ZERO, DVec2::new(self.base, 0.0), self.tip]
    }

    /// Derivatives of a map from the triangle's plane that takes its corners to `corners`: by x,
    /// and by y.
    fn jacobian(&self, corners: [DVec2; 3]) -> [DVec2; 2] {
        let by_x = (corners[1] - corners[0]) / self.base;
        [by_x, (corners[2] - corners[0] - by_x * self.tip.x) / self.tip.y]
    }

    /// Adjoints of the corners for the adjoint of [`Self::jacobian`].
    fn pull_back(&self, [by_x, by_y]: [DVec2; 2]) -> [DVec2; 3] {
        let third = by_y / self.tip.y;
        let second = (by_x - third * self.tip.x) / self.base;
        [-(second + third), second, third]
    }
}

#[cfg(test)]
mod tests;
