//! The vertices of a mesh as a graph: those at one position are one vertex. Smoothing by its Laplacian, and normals with their adjoint.

use crate::mesh::triangles::Mesh;
use glam::Vec3;
use rayon::prelude::*;

/// Iterations of conjugate gradients.
const ROUNDS: usize = 24;

/// The triangles and neighbors of merged vertices.
pub(crate) struct VertexGraph {
    /// The merged vertex of each vertex of the mesh.
    pub(crate) of: Vec<u32>,
    pub(crate) triangles: Vec<[u32; 3]>,
    /// Neighbors of vertex i: `neighbors[starts[i]..starts[i + 1]]`.
    starts: Vec<usize>,
    neighbors: Vec<u32>,
}

impl VertexGraph {
    /// The graph, and the vertices' positions.
    pub(crate) fn new(mesh: &Mesh) -> (Self, Vec<Vec3>) {
        let first = mesh.welded_vertices();
        let (mut of, mut positions) = (vec![0; first.len()], Vec::new());
        for (vertex, first) in first.iter().map(|v| *v as usize).enumerate() {
            if first == vertex {
                of[vertex] = positions.len() as u32;
                positions.push(mesh.positions[vertex]);
            } else {
                of[vertex] = of[first];
            }
        }
        let triangles: Vec<[u32; 3]> = mesh.triangles.iter().map(|t| t.map(|v| of[v as usize])).collect();
        let mut edges: Vec<(u32, u32)> = triangles
            .iter()
            .flat_map(|&[a, b, c]| [(a, b), (b, c), (c, a), (b, a), (c, b), (a, c)])
            .collect();
        edges.sort_unstable();
        edges.dedup();
        let starts = (0..=positions.len()).map(|v| edges.partition_point(|e| (e.0 as usize) < v)).collect();
        let neighbors = edges.into_iter().map(|e| e.1).collect();
        (Self { of, triangles, starts, neighbors }, positions)
    }

    /// How many merged vertices there are.
    pub(crate) fn merged(&self) -> usize {
        self.starts.len() - 1
    }

    pub(crate) fn around(&self, vertex: usize) -> &[u32] {
        &self.neighbors[self.starts[vertex]..self.starts[vertex + 1]]
    }

    /// (I + λL) x.
    pub(super) fn stiffened(&self, x: &[f32], lambda: f32) -> Vec<f32> {
        let row = |i: usize| {
            let around = self.around(i);
            let sum: f32 = around.iter().map(|&j| x[j as usize]).sum();
            x[i] + lambda * (around.len() as f32 * x[i] - sum)
        };
        (0..x.len()).into_par_iter().with_min_len(4096).map(row).collect()
    }

    /// (I + λL)⁻¹ b, by conjugate gradients.
    pub(crate) fn smoothed(&self, b: &[f32], lambda: f32) -> Vec<f32> {
        let dot = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| f64::from(a * b)).sum::<f64>();
        let (mut x, mut residual, mut along) = (vec![0.0; b.len()], b.to_vec(), b.to_vec());
        let mut size = dot(&residual, &residual);
        let enough = 1e-8 * size;
        for _ in 0..ROUNDS {
            if size <= enough {
                break;
            }
            let product = self.stiffened(&along, lambda);
            let step = (size / dot(&along, &product)) as f32;
            x.iter_mut().zip(&along).for_each(|(x, a)| *x += step * a);
            residual.iter_mut().zip(&product).for_each(|(r, p)| *r -= step * p);
            let next = dot(&residual, &residual);
            let keep = (next / size) as f32;
            along.iter_mut().zip(&residual).for_each(|(a, r)| *a = r + keep * *a);
            size = next;
        }
        x
    }

    /// Doubled area vectors of the triangles summed at each vertex.
    pub(crate) fn area_vectors(&self, positions: &[Vec3]) -> Vec<Vec3> {
        let mut sums = vec![Vec3::ZERO; positions.len()];
        for triangle in &self.triangles {
            let [a, b, c] = triangle.map(|v| positions[v as usize]);
            let area = (b - a).cross(c - a);
            triangle.iter().for_each(|&v| sums[v as usize] += area);
        }
        sums
    }

    /// Adjoints of positions from those of the vertices' unit normals.
    pub(super) fn pull_back_normals(&self, positions: &[Vec3], adjoint: &[Vec3]) -> Vec<Vec3> {
        let by_sum: Vec<Vec3> = self
            .area_vectors(positions)
            .iter()
            .zip(adjoint)
            .map(|(sum, adjoint)| pull_back_unit(*sum, *adjoint))
            .collect();
        let mut back = vec![Vec3::ZERO; positions.len()];
        for triangle in &self.triangles {
            let [a, b, c] = triangle.map(|v| positions[v as usize]);
            let by_area: Vec3 = triangle.iter().map(|&v| by_sum[v as usize]).sum();
            // Adjoints of e₁ × e₂ with e₁ = b − a, e₂ = c − a.
            let (by_first, by_second) = ((c - a).cross(by_area), by_area.cross(b - a));
            back[triangle[0] as usize] -= by_first + by_second;
            back[triangle[1] as usize] += by_first;
            back[triangle[2] as usize] += by_second;
        }
        back
    }

    /// Mean length of the edges.
    pub(crate) fn mean_edge(&self, positions: &[Vec3]) -> f32 {
        let length = |i: usize| {
            let lengths = self.around(i).iter().map(|&j| positions[i].distance(positions[j as usize]));
            f64::from(lengths.sum::<f32>())
        };
        ((0..positions.len()).map(length).sum::<f64>() / self.neighbors.len().max(1) as f64) as f32
    }
}

/// Adjoint of a vector, given the adjoint of its direction.
pub(super) fn pull_back_unit(vector: Vec3, adjoint: Vec3) -> Vec3 {
    let length = vector.length();
    if length < 1e-20 {
        return Vec3::ZERO;
    }
    let unit = vector / length;
    (adjoint - unit * unit.dot(adjoint)) / length
}
