//! Splitting of non-manifold edges (with four triangles) and non-manifold vertices (where sheets touch) of a surface net.
//!
//! A net has one vertex per cell. Where two sheets pass through one cell they share it, and the mesh is not a manifold there (Schaefer, Ju
//! and Warren, "Manifold Dual Contouring", 2007). Here the triangles around such a vertex are grouped into fans, and each fan gets
//! a vertex of its own, moved a little into the fan. Where fans meet along an edge, its four triangles are paired
//! around the inside or the outside, depending on the sign of the field at the midpoint. An edge whose pairs belong to one fan at both
//! ends, as around a hole in a thin wall, is split in two, with a separate midpoint for each pair.

use crate::mesh::triangles::{Side, sorted_sides};
use glam::Vec3;
use rayon::prelude::*;

/// Fraction of the way to the center of its fan that a new vertex moves.
const APART: f32 = 0.25;

/// Rounds of edge splits: a round splits at most one edge per triangle.
const CUTS: usize = 6;

/// Makes a closed mesh a manifold. `is_solid` returns whether a point is inside.
///
/// Returns which vertices are new or moved. Triangles keep their winding; unsplit triangles keep their order.
pub fn make_manifold(
    positions: &mut Vec<Vec3>,
    triangles: &mut Vec<[u32; 3]>,
    is_solid: impl Fn(Vec3) -> bool,
) -> Vec<bool> {
    let mut changed = part_fans(positions, triangles, &is_solid);
    for _ in 0..CUTS {
        if cut_edges(positions, triangles, &is_solid) == 0 {
            break;
        }
    }
    changed.resize(positions.len(), true);
    changed
}

/// The edges in order, each with its triangles.
fn edges(sides: &[Side]) -> impl Iterator<Item = ([u32; 2], Vec<u32>)> {
    let same = sides.chunk_by(|a, b| a.ends == b.ends);
    same.map(|same| (same[0].ends, same.iter().map(|side| side.triangle).collect()))
}

/// Splits edges with more than two triangles, at most one per triangle; returns the number of splits.
fn cut_edges(
    positions: &mut Vec<Vec3>,
    triangles: &mut Vec<[u32; 3]>,
    is_solid: &impl Fn(Vec3) -> bool,
) -> usize {
    let mut touched = vec![false; triangles.len()];
    let mut cuts = 0;
    for (edge, around) in edges(&sorted_sides(triangles)) {
        if around.len() < 3 || around.iter().any(|t| touched[*t as usize]) {
            continue;
        }
        around.iter().for_each(|t| touched[*t as usize] = true);
        cuts += 1;
        let middle = 0.5 * (positions[edge[0] as usize] + positions[edge[1] as usize]);
        for (a, b) in pairs(positions, triangles, edge, &around, is_solid) {
            let opposite = |t: u32| triangles[t as usize].iter().find(|v| !edge.contains(v));
            let beside: Vec<Vec3> =
                [a, b].into_iter().filter_map(opposite).map(|v| positions[*v as usize]).collect();
            let new = positions.len() as u32;
            positions.push(middle.lerp(beside.iter().sum::<Vec3>() / beside.len().max(1) as f32, APART));
            for t in [a, b] {
                let whole = triangles[t as usize];
                triangles[t as usize] = whole.map(|v| if v == edge[1] { new } else { v });
                triangles.push(whole.map(|v| if v == edge[0] { new } else { v }));
            }
        }
    }
    cuts
}

/// Gives every fan of triangles around a vertex its own vertex.
fn part_fans(
    positions: &mut Vec<Vec3>,
    triangles: &mut [[u32; 3]],
    is_solid: &impl Fn(Vec3) -> bool,
) -> Vec<bool> {
    // Groups of connected triangle corners: 3 t + k.
    let mut groups: Vec<u32> = (0..3 * triangles.len() as u32).collect();
    for (edge, around) in edges(&sorted_sides(triangles)) {
        for (a, b) in pairs(positions, triangles, edge, &around, is_solid) {
            for vertex in edge {
                let (x, y) = (corner(triangles, a, vertex), corner(triangles, b, vertex));
                let (x, y) = (root(&mut groups, x), root(&mut groups, y));
                groups[x.max(y) as usize] = x.min(y);
            }
        }
    }
    part(positions, triangles, &mut groups)
}

/// The corner of a triangle that is at a vertex.
fn corner(triangles: &[[u32; 3]], triangle: u32, vertex: u32) -> u32 {
    let k = triangles[triangle as usize].iter().position(|v| *v == vertex);
    3 * triangle + k.expect("an edge's triangle has its ends") as u32
}

/// The root of the group of item `i`; `groups[i]` is another item of its group, or `i` itself for the root.
pub(super) fn root(groups: &mut [u32], mut i: u32) -> u32 {
    while groups[i as usize] != i {
        groups[i as usize] = groups[groups[i as usize] as usize];
        i = groups[i as usize];
    }
    i
}

/// The pairs of triangles at an edge.
fn pairs(
    positions: &[Vec3],
    triangles: &[[u32; 3]],
    edge: [u32; 2],
    around: &[u32],
    is_solid: &impl Fn(Vec3) -> bool,
) -> Vec<(u32, u32)> {
    if let [a, b] = *around {
        return vec![(a, b)];
    }
    let ends = edge.map(|v| positions[v as usize]);
    let (middle, axis) = (0.5 * (ends[0] + ends[1]), (ends[1] - ends[0]).normalize_or_zero());
    let first = axis.any_orthonormal_vector();
    let second = axis.cross(first);
    let mut turned: Vec<(f32, u32, bool)> = around
        .iter()
        .map(|&t| {
            let [a, b, c] = triangles[t as usize].map(|v| positions[v as usize]);
            let (out, normal) = ((a + b + c) / 3.0 - middle, (b - a).cross(c - a));
            // Whether the next sector around the edge is on the inside of this triangle.
            (out.dot(second).atan2(out.dot(first)), t, normal.dot(axis.cross(out)) < 0.0)
        })
        .collect();
    turned.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    // If the midpoint is inside, sheets are paired around the outside, which keeps the solid connected.
    let around_solid = !is_solid(middle);
    let n = turned.len();
    let start = (0..n).find(|&i| turned[i].2 == around_solid).unwrap_or(0);
    (0..n / 2).map(|i| (turned[(start + 2 * i) % n].1, turned[(start + 2 * i + 1) % n].1)).collect()
}

/// A vertex for every group of corners; the first group of a vertex keeps it.
fn part(positions: &mut Vec<Vec3>, triangles: &mut [[u32; 3]], groups: &mut [u32]) -> Vec<bool> {
    // Each corner after the first of its group, which is its root.
    let mut corners: Vec<[u32; 2]> = (0..groups.len() as u32).map(|c| [root(groups, c), c]).collect();
    corners.par_sort_unstable();
    let fans = || corners.chunk_by(|a, b| a[0] == b[0]);
    let vertex = |triangles: &[[u32; 3]], c: u32| triangles[c as usize / 3][c as usize % 3];
    let mut count = vec![0u32; positions.len()];
    fans().for_each(|fan| count[vertex(triangles, fan[0][0]) as usize] += 1);
    let (old, old_triangles) = (positions.clone(), triangles.to_vec());
    let mut kept = vec![false; positions.len()];
    let mut changed = vec![false; positions.len()];
    for fan in fans() {
        let from = vertex(&old_triangles, fan[0][0]) as usize;
        if count[from] < 2 {
            continue;
        }
        let corners = || fan.iter().map(|[_, corner]| *corner as usize);
        let others = corners().flat_map(|c| old_triangles[c / 3]);
        let around: Vec<Vec3> = others.filter(|v| *v as usize != from).map(|v| old[v as usize]).collect();
        let middle = around.iter().sum::<Vec3>() / around.len() as f32;
        let place = old[from].lerp(middle, APART);
        if kept[from] {
            corners().for_each(|c| triangles[c / 3][c % 3] = positions.len() as u32);
            positions.push(place);
            changed.push(true);
        } else {
            (kept[from], changed[from], positions[from]) = (true, true, place);
        }
    }
    changed
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;

    /// The twelve triangles of a unit cube at a lattice place, its corners by lattice place.
    fn cube(at: [i32; 3], index: &mut impl FnMut([i32; 3]) -> u32) -> Vec<[u32; 3]> {
        let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        let mut corner = |c: i32| index([at[0] + (c & 1), at[1] + (c >> 1 & 1), at[2] + (c >> 2)]);
        let triangles = |q: [i32; 4]| {
            let [a, b, c, d] = q.map(&mut corner);
            [[a, b, c], [a, c, d]]
        };
        quads.into_iter().flat_map(triangles).collect()
    }

    fn cubes(places: &[[i32; 3]]) -> (Vec<Vec3>, Vec<[u32; 3]>) {
        let mut lattice: Vec<[i32; 3]> = Vec::new();
        let mut index = |at: [i32; 3]| {
            lattice.iter().position(|l| *l == at).unwrap_or_else(|| {
                lattice.push(at);
                lattice.len() - 1
            }) as u32
        };
        let triangles = places.iter().flat_map(|at| cube(*at, &mut index)).collect();
        (lattice.iter().map(|at| Vec3::from(at.map(|x| x as f32))).collect(), triangles)
    }

    fn most_triangles_at_an_edge(positions: &[Vec3], triangles: &[[u32; 3]]) -> usize {
        let mut counts: BTreeMap<[[u32; 3]; 2], usize> = BTreeMap::new();
        for t in triangles {
            for k in 0..3 {
                let mut ends =
                    [t[k], t[(k + 1) % 3]].map(|v| positions[v as usize].to_array().map(f32::to_bits));
                ends.sort();
                *counts.entry(ends).or_default() += 1;
            }
        }
        counts.into_values().max().unwrap_or(0)
    }

    #[test]
    fn two_cubes_that_share_an_edge_are_parted_or_joined() {
        for solid in [false, true] {
            let (mut positions, mut triangles) = cubes(&[[0, 0, 0], [1, 1, 0]]);
            assert_eq!(most_triangles_at_an_edge(&positions, &triangles), 4);
            let changed = make_manifold(&mut positions, &mut triangles, |_| solid);
            // Apart, each end of the edge becomes two; joined, the edge gets two middles.
            assert_eq!((positions.len(), triangles.len()), if solid { (16, 28) } else { (16, 24) });
            assert_eq!(most_triangles_at_an_edge(&positions, &triangles), 2);
            assert_eq!(changed.iter().filter(|c| **c).count(), if solid { 2 } else { 4 });
        }
    }

    #[test]
    fn cubes_that_touch_in_a_corner_are_parted() {
        let (mut positions, mut triangles) = cubes(&[[0, 0, 0], [1, 1, 1]]);
        assert_eq!(positions.len(), 15);
        make_manifold(&mut positions, &mut triangles, |_| true);
        assert_eq!(positions.len(), 16);
        assert_eq!(positions.iter().filter(|p| p.fract() != Vec3::ZERO).count(), 2);
    }

    #[test]
    fn a_manifold_stays_as_it_is() {
        let (before, triangles) = cubes(&[[0, 0, 0]]);
        let (mut positions, mut after) = (before.clone(), triangles.clone());
        assert!(make_manifold(&mut positions, &mut after, |_| true).iter().all(|c| !c));
        assert_eq!((positions, after), (before, triangles));
    }
}
