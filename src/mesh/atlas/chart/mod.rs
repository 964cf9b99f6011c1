//! Charts: parts of a surface that lie in a plane with little distortion.
//!
//! [`segment`] makes a tree of regions; from its roots, a region that can be flattened ([`flatten`]) is a chart, any other falls into its two
//! halves. A single triangle always can. Then small charts join a neighbor where the two together are still flat enough.

mod flatten;
mod laplacian;
mod patch;
mod rigid;
mod segment;
mod simple;
mod stretch;
mod topology;

use crate::error::Result;
use crate::error::stop::check_interrupted;
use crate::mesh::triangles::Mesh;
use flatten::{Tolerance, flatten};
use glam::DVec2;
use patch::{Patch, PlanarTriangle};
use rayon::prelude::*;
use segment::{RegionNode, RegionTree};
use std::collections::BTreeMap;
use topology::{NONE, Topology};

/// So many times a region is tried before its halves; deeper in the tree only regions of at most so many triangles are tried.
const LEVELS: (usize, u32) = (24, 256);
/// What a chart may be distorted.
const USUAL: Tolerance = Tolerance { mean: 4.5, uneven: 0.01 };
/// What a chart may be distorted that has taken in a small one.
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
    /// Places in the plane, world units: triangles are counter-clockwise and, all together, as large as in the world.
    pub places: Vec<DVec2>,
}

impl Chart {
    /// Area, squared world units.
    pub fn area(&self) -> f64 {
        let doubled = |t: &[u32; 3]| {
            let [a, b, c] = t.map(|v| self.places[v as usize]);
            (b - a).perp_dot(c - a)
        };
        0.5 * self.triangles.iter().map(doubled).sum::<f64>()
    }
}

/// Charts of all triangles of a mesh that have area, each in one of them. Indices of the mesh are in range. Deterministic.
///
/// # Errors
/// [`Error::Interrupted`](crate::Error::Interrupted) if the work is to stop: of a million triangles it takes ten seconds.
pub fn charts(mesh: &Mesh) -> Result<Vec<Chart>> {
    let topology = Topology::new(mesh);
    let tree = RegionTree::new(&topology);
    let mut found = Vec::new();
    let mut open = tree.roots.clone();
    for level in 0.. {
        if open.is_empty() {
            break;
        }
        let try_whole = |node: &u32| level < LEVELS.0 || tree.counts[*node as usize] <= LEVELS.1;
        let flat = |node: &u32| {
            try_whole(node).then(|| chart_of(&topology, tree.triangles(*node), &USUAL)).flatten()
        };
        let tried: Vec<(u32, Option<Chart>)> = open
            .par_iter()
            .map(|node| check_interrupted().map(|()| (*node, flat(node))))
            .collect::<Result<_>>()?;
        open.clear();
        for (node, chart) in tried {
            match (chart, tree.nodes[node as usize]) {
                (Some(chart), _) => found.push(chart),
                (None, RegionNode::Pair(a, b)) => open.extend([a, b]),
                (None, RegionNode::Triangle(face)) => found.push(single(&topology, face)),
            }
        }
    }
    join_small(&topology, found)
}

/// The chart of one triangle.
fn single(topology: &Topology, face: u32) -> Chart {
    let shape = PlanarTriangle::new(topology.corners(face));
    Chart {
        faces: vec![face],
        triangles: vec![[0, 1, 2]],
        places: vec![DVec2::ZERO, DVec2::new(shape.base, 0.0), shape.tip],
    }
}

/// Triangles of the surface as a chart, if they lie flat.
fn chart_of(topology: &Topology, faces: Vec<u32>, tolerance: &Tolerance) -> Option<Chart> {
    let patch = Patch::new(topology, faces);
    let places = flatten(&patch, tolerance)?;
    Some(Chart { faces: patch.faces, triangles: patch.triangles, places })
}

/// Small charts join the neighbor with which they share most of their border, if the two lie flat together; from the smallest up.
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

#[cfg(test)]
mod tests;
