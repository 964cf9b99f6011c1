//! Extraction of a mesh of the zero level of an SDF: naive surface nets (Gibson 1998), with vertices projected onto the level.

use crate::mesh::triangles::{Mesh, sorted_sides};
use crate::sdf::grid::SdfGrid;
use crate::sdf::manifold::{make_manifold, root};
use fast_surface_nets::ndshape::RuntimeShape;
use fast_surface_nets::{SurfaceNetsBuffer, surface_nets};
use glam::Vec3;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Newton steps that project a vertex onto the zero level.
const PROJECTIONS: usize = 3;

/// The zero level as a mesh with normals from the field; without triangles if there is no zero level.
///
/// The border of the grid closes the surface. Only the largest connected component is kept.
pub fn extract_mesh(grid: &SdfGrid) -> Mesh {
    extract_components(grid).into_iter().next().unwrap_or_default()
}

/// The connected components of the zero level, as [`extract_mesh`] has it, those with most triangles first.
pub fn extract_components(grid: &SdfGrid) -> Vec<Mesh> {
    let shape = RuntimeShape::<u32, 3>::new([grid.side; 3]);
    let mut values = grid.values.clone();
    let last = grid.side - 1;
    close_border(&mut values, grid.side as usize, 0.1 * grid.spacing);
    let mut buffer = SurfaceNetsBuffer::default();
    surface_nets(&values, &shape, [0; 3], [last; 3], &mut buffer);
    let in_world = |p: &[f32; 3]| grid.origin + Vec3::from(*p) * grid.spacing;
    let mut positions: Vec<Vec3> = buffer.positions.iter().map(in_world).collect();
    let mut triangles: Vec<[u32; 3]> = buffer.indices.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect();
    let parted = make_manifold(&mut positions, &mut triangles, |p| grid.value(p) < 0.0);
    let whole = positions.par_iter_mut().zip(&parted).filter(|(_, parted)| !**parted);
    whole.for_each(|(position, _)| *position = project(grid, *position));
    let normal = |p: &Vec3| grid.gradient(*p).try_normalize().unwrap_or(Vec3::Y);
    let normals = positions.par_iter().map(normal).collect();
    let mut mesh = Mesh { positions, normals, uvs: None, triangles };
    mesh.drop_degenerate_triangles();
    components(&mesh)
}

/// Raises the values on the border of a grid to at least `least`.
fn close_border(values: &mut [f32], side: usize, least: f32) {
    let last = side - 1;
    for (row, values) in values.chunks_exact_mut(side).enumerate() {
        let is_border = [row % side, row / side].iter().any(|at| *at == 0 || *at == last);
        let step = if is_border { 1 } else { last };
        values.iter_mut().step_by(step).for_each(|value| *value = value.max(least));
    }
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

/// The components, connected by edges (small parts may touch others at a vertex only), those with most triangles first.
fn components(mesh: &Mesh) -> Vec<Mesh> {
    let mut parent: Vec<u32> = (0..mesh.triangles.len() as u32).collect();
    for pair in sorted_sides(&mesh.triangles).windows(2).filter(|pair| pair[0].ends == pair[1].ends) {
        let (x, y) = (root(&mut parent, pair[0].triangle), root(&mut parent, pair[1].triangle));
        parent[x as usize] = y;
    }
    let mut of_root: BTreeMap<u32, Vec<usize>> = BTreeMap::new();
    for t in 0..mesh.triangles.len() {
        of_root.entry(root(&mut parent, t as u32)).or_default().push(t);
    }
    let mut rows: Vec<Vec<usize>> = of_root.into_values().collect();
    rows.sort_by_key(|rows| (std::cmp::Reverse(rows.len()), rows[0]));
    // The part that a vertex was put into last, and its place in it.
    let mut places = vec![(usize::MAX, 0); mesh.positions.len()];
    rows.iter().enumerate().map(|(number, rows)| part(mesh, rows, number, &mut places)).collect()
}

/// The mesh of some triangles, with the vertices that they use. `places` are those of vertices in parts with a lower number.
fn part(mesh: &Mesh, triangles: &[usize], number: usize, places: &mut [(usize, u32)]) -> Mesh {
    let mut kept = Mesh::default();
    for &t in triangles {
        let corners = mesh.triangles[t].map(|v| {
            let place = &mut places[v as usize];
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
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashMap;

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
        let mut counts: HashMap<[[u32; 3]; 2], u32> = HashMap::new();
        for t in &mesh.triangles {
            for k in 0..3 {
                let end = |k: usize| mesh.positions[t[k % 3] as usize].to_array().map(f32::to_bits);
                let mut ends = [end(k), end(k + 1)];
                ends.sort();
                *counts.entry(ends).or_default() += 1;
            }
        }
        assert!(mesh.triangles.len() > 2000);
        assert_eq!(counts.values().filter(|count| **count != 2).count(), 0);
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
        let volume: f32 = mesh
            .triangles
            .iter()
            .map(|t| {
                let [a, b, c] = t.map(|v| mesh.positions[v as usize]);
                a.dot(b.cross(c)) / 6.0
            })
            .sum();
        assert!((volume - 4.0 / 3.0 * std::f32::consts::PI * 0.216).abs() < 0.01, "{volume}");
    }
}
