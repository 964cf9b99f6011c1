//! Extraction of a mesh of the zero level of an SDF: naive surface nets (Gibson 1998), with
//! vertices projected onto the level.
//!
//! A net has one vertex per cell. Where two sheets pass through one cell they share it, and the
//! mesh is not a manifold there (Schaefer, Ju and Warren, "Manifold Dual Contouring", 2007). Here
//! the triangles around such a vertex are grouped into fans, and each fan gets a vertex of its own,
//! moved a little into the fan. Where fans meet along an edge, its four triangles are paired around
//! the inside or the outside, depending on the sign of the field at the midpoint. An edge whose
//! pairs belong to one fan at both ends, as around a hole in a thin wall, is split in two, with a
//! separate midpoint for each pair.
//!
//! ```
//! use glam::Vec3;
//! use lobelia_geometry::sdf::{SdfGrid, extract::extract_mesh};
//!
//! let ball = SdfGrid::from_fn(Vec3::ZERO, 1.0, 24, |point| point.length() - 0.6);
//! let mesh = extract_mesh(&ball);
//! assert!(mesh.triangles.len() > 500);
//! assert!(mesh.positions.iter().all(|point| (point.length() - 0.6).abs() < 0.01));
//! ```

use crate::mesh::triangles::{DisjointSets, Mesh, Side, sorted_sides};
use crate::{parallel, sdf::SdfGrid};
use fast_surface_nets::{SurfaceNetsBuffer, ndshape::RuntimeShape, surface_nets};
use glam::Vec3;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Newton steps that project a vertex onto the zero level.
const PROJECTIONS: usize = 3;

/// The zero level as a mesh with normals from the field; without triangles if there is no zero
/// level.
///
/// The border of the grid closes the surface. Only the largest connected component is kept.
pub fn extract_mesh(grid: &SdfGrid) -> Mesh {
    extract_components(grid).into_iter().next().unwrap_or_default()
}

/// The connected components of the zero level, as [`extract_mesh`] has it, those with most
/// triangles first.
pub fn extract_components(grid: &SdfGrid) -> Vec<Mesh> {
    let shape = RuntimeShape::<u32, 3>::new([grid.side; 3]);
    let (mut values, side, last) = (grid.values.clone(), grid.side as usize, grid.side - 1);
    // The border of the grid is raised to outside.
    for (row, values) in values.chunks_exact_mut(side).enumerate() {
        let is_border = [row % side, row / side].iter().any(|at| *at == 0 || *at == side - 1);
        let step = if is_border { 1 } else { side - 1 };
        values.iter_mut().step_by(step).for_each(|value| *value = value.max(0.1 * grid.spacing));
    }
    let mut buffer = SurfaceNetsBuffer::default();
    surface_nets(&values, &shape, [0; 3], [last; 3], &mut buffer);
    let in_world = |p: &[f32; 3]| grid.origin + Vec3::from(*p) * grid.spacing;
    let positions = buffer.positions.iter().map(in_world).collect();
    let triangles = buffer.indices.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect();
    let mut mesh = Mesh { positions, triangles, ..Mesh::default() };
    let parted = make_manifold(&mut mesh, |p| grid.value(p) < 0.0);
    parallel::for_each_row((&mut *mesh.positions, &*parted), 1024, |(position, parted)| {
        if !parted {
            *position = project(grid, *position);
        }
    });
    let normal = |p: &Vec3| grid.gradient(*p).try_normalize().unwrap_or(Vec3::Y);
    mesh.normals = parallel::map_slice(&mesh.positions, 1024, normal);
    mesh.drop_degenerate_triangles();
    components(&mesh)
}

/// A point projected onto the zero level, at most one cell away.
fn project(grid: &SdfGrid, start: Vec3) -> Vec3 {
    let mut point = start;
    for _ in 0..PROJECTIONS {
        let gradient = grid.gradient(point);
        point -= gradient * (grid.value(point) / gradient.length_squared().max(1e-6));
    }
    if point.distance_squared(start) < grid.spacing * grid.spacing { point } else { start }
}

/// The components, connected by edges (small parts may touch others at a vertex only), those with
/// most triangles first.
fn components(mesh: &Mesh) -> Vec<Mesh> {
    let mut parts = DisjointSets::new(mesh.triangles.len());
    for pair in sorted_sides(&mesh.triangles).windows(2).filter(|pair| pair[0].ends == pair[1].ends) {
        parts.join(pair[0].triangle, pair[1].triangle);
    }
    let mut of_root: BTreeMap<u32, Vec<usize>> = BTreeMap::new();
    for t in 0..mesh.triangles.len() {
        of_root.entry(parts.root(t as u32)).or_default().push(t);
    }
    let mut rows: Vec<Vec<usize>> = of_root.into_values().collect();
    rows.sort_by_key(|rows| (std::cmp::Reverse(rows.len()), rows[0]));
    // The component that a vertex was put into last, and its number in it.
    let mut placed = vec![(usize::MAX, 0); mesh.positions.len()];
    let component = |(number, triangles): (usize, Vec<usize>)| {
        let mut kept = Mesh::default();
        for t in triangles {
            let corners = mesh.triangles[t].map(|v| {
                let place = &mut placed[v as usize];
                if place.0 != number {
                    *place = (number, kept.positions.len() as u32);
                    kept.positions.push(mesh.positions[v as usize]);
                    kept.normals.push(mesh.normals[v as usize]);
                }
                place.1
            });
            kept.triangles.push(corners);
        }
        kept
    };
    rows.into_iter().enumerate().map(component).collect()
}

/// Fraction of the way to the center of its fan that a new vertex moves.
const APART: f32 = 0.25;

/// Rounds of edge splits: a round splits at most one edge per triangle.
const CUTS: usize = 6;

/// Makes a closed mesh a manifold. `is_solid` returns whether a point is inside.
///
/// Returns which vertices are new or moved. Triangles keep their winding; unsplit triangles keep
/// their order.
fn make_manifold(mesh: &mut Mesh, is_solid: impl Fn(Vec3) -> bool) -> Vec<bool> {
    let mut changed = part_fans(mesh, &is_solid);
    for _ in 0..CUTS {
        if !cut_edges(mesh, &is_solid) {
            break;
        }
    }
    changed.resize(mesh.positions.len(), true);
    changed
}

/// The edges in order, each with its triangles.
fn edges(sides: &[Side]) -> impl Iterator<Item = ([u32; 2], Vec<u32>)> {
    let same = sides.chunk_by(|a, b| a.ends == b.ends);
    same.map(|same| (same[0].ends, same.iter().map(|side| side.triangle).collect()))
}

/// Splits edges with more than two triangles, at most one per triangle; whether there are any.
fn cut_edges(mesh: &mut Mesh, is_solid: &impl Fn(Vec3) -> bool) -> bool {
    let mut touched = vec![false; mesh.triangles.len()];
    let mut any = false;
    for (edge, around) in edges(&sorted_sides(&mesh.triangles)) {
        if around.len() < 3 || around.iter().any(|t| touched[*t as usize]) {
            continue;
        }
        around.iter().for_each(|t| touched[*t as usize] = true);
        any = true;
        let pairs = pairs(mesh, edge, &around, is_solid);
        let Mesh { positions, triangles, .. } = &mut *mesh;
        let middle = 0.5 * (positions[edge[0] as usize] + positions[edge[1] as usize]);
        for (a, b) in pairs {
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
    any
}

/// Gives every fan of triangles around a vertex its own vertex: a group of connected corners; the
/// first group of a vertex keeps it.
fn part_fans(mesh: &mut Mesh, is_solid: &impl Fn(Vec3) -> bool) -> Vec<bool> {
    // Groups of corners 3 t + k.
    let corner = |t: u32, vertex: u32| {
        let k = mesh.triangles[t as usize].iter().position(|v| *v == vertex);
        3 * t + k.expect("an edge's triangle has its ends") as u32
    };
    let mut groups = DisjointSets::new(3 * mesh.triangles.len());
    for (edge, around) in edges(&sorted_sides(&mesh.triangles)) {
        for (a, b) in pairs(mesh, edge, &around, is_solid) {
            for vertex in edge {
                groups.join(corner(a, vertex), corner(b, vertex));
            }
        }
    }
    let Mesh { positions, triangles, .. } = mesh;
    // Each corner after the first of its group, which is its root.
    let mut corners: Vec<[u32; 2]> = (0..3 * triangles.len() as u32).map(|c| [groups.root(c), c]).collect();
    corners.par_sort_unstable();
    let fans = || corners.chunk_by(|a, b| a[0] == b[0]);
    let (old, old_triangles) = (positions.clone(), triangles.clone());
    let vertex = |fan: &[[u32; 2]]| old_triangles[fan[0][0] as usize / 3][fan[0][0] as usize % 3] as usize;
    let mut count = vec![0u32; positions.len()];
    fans().for_each(|fan| count[vertex(fan)] += 1);
    let mut changed = vec![false; positions.len()];
    for fan in fans() {
        let from = vertex(fan);
        if count[from] < 2 {
            continue;
        }
        let corners = || fan.iter().map(|[_, corner]| *corner as usize);
        let others = corners().flat_map(|c| old_triangles[c / 3]);
        let around: Vec<Vec3> = others.filter(|v| *v as usize != from).map(|v| old[v as usize]).collect();
        let middle = around.iter().sum::<Vec3>() / around.len() as f32;
        let place = old[from].lerp(middle, APART);
        if changed[from] {
            corners().for_each(|c| triangles[c / 3][c % 3] = positions.len() as u32);
            positions.push(place);
            changed.push(true);
        } else {
            (changed[from], positions[from]) = (true, place);
        }
    }
    changed
}

/// The pairs of triangles at an edge.
fn pairs(mesh: &Mesh, edge: [u32; 2], around: &[u32], is_solid: &impl Fn(Vec3) -> bool) -> Vec<(u32, u32)> {
    if let [a, b] = *around {
        return vec![(a, b)];
    }
    let ends = edge.map(|v| mesh.positions[v as usize]);
    let (middle, axis) = (0.5 * (ends[0] + ends[1]), (ends[1] - ends[0]).normalize_or_zero());
    let first = axis.any_orthonormal_vector();
    let second = axis.cross(first);
    let turn = |&t: &u32| {
        let [a, b, c] = mesh.corners(t as usize);
        let (out, normal) = ((a + b + c) / 3.0 - middle, (b - a).cross(c - a));
        // Whether the next sector around the edge is on the inside of this triangle.
        (out.dot(second).atan2(out.dot(first)), t, normal.dot(axis.cross(out)) < 0.0)
    };
    let mut turned: Vec<(f32, u32, bool)> = around.iter().map(turn).collect();
    turned.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    // If the midpoint is inside, sheets are paired around the outside, which keeps the solid
    // connected.
    let around_solid = !is_solid(middle);
    let n = turned.len();
    let start = (0..n).find(|&i| turned[i].2 == around_solid).unwrap_or(0);
    (0..n / 2).map(|i| (turned[(start + 2 * i) % n].1, turned[(start + 2 * i + 1) % n].1)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::tests::is_closed;

    #[test]
    fn what_hangs_on_by_a_corner_is_another_component() {
        let positions: Vec<Vec3> = (0..6).map(|i| Vec3::splat(i as f32)).collect();
        let triangles = vec![[3, 4, 5], [0, 1, 2], [2, 1, 3]];
        let mesh = Mesh { normals: positions.clone(), positions, uvs: None, triangles };
        let found = components(&mesh);
        assert_eq!(found[0].triangles, [[0, 1, 2], [2, 1, 3]]);
        assert_eq!(found[0].positions, (0..4).map(|i| Vec3::splat(i as f32)).collect::<Vec<_>>());
        assert_eq!((found.len(), found[1].positions[0]), (2, Vec3::splat(3.0)));
        assert!(components(&Mesh::default()).is_empty());
    }

    #[test]
    fn every_edge_has_two_triangles_however_rough_the_field() {
        // Noise of about one cell: many cells contain several sheets.
        let noise = |p: Vec3| ((41.0 * p.x).sin() + (37.0 * p.y).sin() + (43.0 * p.z).sin()) * 0.04;
        let mesh = extract_mesh(&SdfGrid::from_fn(Vec3::ZERO, 1.0, 40, |p| p.length() - 0.6 + noise(p)));
        assert!(is_closed(&mesh) && mesh.triangles.len() > 2000);
    }

    #[test]
    fn a_ball_comes_back_as_a_closed_mesh_without_the_floater() {
        let field = |p: Vec3| (p.length() - 0.6).min((p - Vec3::splat(0.8)).length() - 0.1);
        let grid = SdfGrid::from_fn(Vec3::ZERO, 1.0, 40, field);
        let mesh = extract_mesh(&grid);
        assert_eq!(extract_components(&grid).len(), 2);
        assert!(mesh.triangles.len() > 500);
        for (p, n) in mesh.positions.iter().zip(&mesh.normals) {
            assert!((p.length() - 0.6).abs() < 2e-3, "{p}");
            assert!(n.dot(p.normalize()) > 0.99);
        }
        // Closed and oriented outward: the sum of position · face normal gives the volume.
        let part = |[a, b, c]: [Vec3; 3]| a.dot(b.cross(c)) / 6.0;
        let volume: f32 = (0..mesh.triangles.len()).map(|t| part(mesh.corners(t))).sum();
        assert!((volume - 4.0 / 3.0 * std::f32::consts::PI * 0.216).abs() < 0.01, "{volume}");
    }

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

    /// Cubes at these places; they share vertices.
    fn cubes(places: &[[i32; 3]]) -> Mesh {
        let mut lattice: Vec<[i32; 3]> = Vec::new();
        let mut index = |at: [i32; 3]| {
            lattice.iter().position(|l| *l == at).unwrap_or_else(|| {
                lattice.push(at);
                lattice.len() - 1
            }) as u32
        };
        let triangles = places.iter().flat_map(|at| cube(*at, &mut index)).collect();
        let positions = lattice.iter().map(|at| Vec3::from(at.map(|x| x as f32))).collect();
        Mesh { positions, triangles, ..Mesh::default() }
    }

    #[test]
    fn two_cubes_that_share_an_edge_are_parted_or_joined() {
        for solid in [false, true] {
            let mut mesh = cubes(&[[0, 0, 0], [1, 1, 0]]);
            assert!(!is_closed(&mesh));
            let changed = make_manifold(&mut mesh, |_| solid);
            // Apart, each end of the edge becomes two; joined, the edge gets two middles.
            assert_eq!((mesh.positions.len(), mesh.triangles.len()), if solid { (16, 28) } else { (16, 24) });
            assert!(is_closed(&mesh));
            assert_eq!(changed.iter().filter(|c| **c).count(), if solid { 2 } else { 4 });
        }
    }

    #[test]
    fn cubes_that_touch_in_a_corner_are_parted() {
        let mut mesh = cubes(&[[0, 0, 0], [1, 1, 1]]);
        assert_eq!(mesh.positions.len(), 15);
        make_manifold(&mut mesh, |_| true);
        assert_eq!(mesh.positions.len(), 16);
        assert_eq!(mesh.positions.iter().filter(|p| p.fract() != Vec3::ZERO).count(), 2);
    }

    #[test]
    fn a_manifold_stays_as_it_is() {
        let before = cubes(&[[0, 0, 0]]);
        let mut after = before.clone();
        assert!(make_manifold(&mut after, |_| true).iter().all(|c| !c));
        assert_eq!(after, before);
    }
}
