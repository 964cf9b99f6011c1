//! The merged vertices of a mesh: a graph with positions and normals, its smoothing, and thin
//! plates on it.

use glam::Vec3;
use lobelia_geometry::{mesh::triangles::Mesh, parallel};
use lobelia_sg::linear::conjugate_gradients;

/// Iterations of conjugate gradients for smoothing, and for plates.
const ROUNDS: usize = 24;
const PLATE_ROUNDS: usize = 200;
/// Vertices of a task.
const TASK: usize = 4096;

/// The vertices of a mesh as a graph: those at one position are one vertex.
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
        let both_ways = |&[a, b, c]: &[u32; 3]| [(a, b), (b, c), (c, a), (b, a), (c, b), (a, c)];
        let mut edges: Vec<(u32, u32)> = triangles.iter().flat_map(both_ways).collect();
        edges.sort_unstable();
        edges.dedup();
        let starts = (0..=positions.len()).map(|v| edges.partition_point(|e| (e.0 as usize) < v)).collect();
        let neighbors = edges.into_iter().map(|e| e.1).collect();
        (Self { of, triangles, starts, neighbors }, positions)
    }

    pub(crate) fn around(&self, vertex: usize) -> &[u32] {
        &self.neighbors[self.starts[vertex]..self.starts[vertex + 1]]
    }

    /// A value for each vertex, from it and its neighbors.
    fn each(&self, value: impl Fn(usize, &[u32]) -> f32 + Sync) -> Vec<f32> {
        let count = self.starts.len() - 1;
        parallel::map(count, TASK, |i| value(i, self.around(i)))
    }

    /// (I + λL)⁻¹ b.
    pub(crate) fn smoothed(&self, b: &[f32], lambda: f32) -> Vec<f32> {
        let apply =
            |x: &[f32]| self.each(|i, near| x[i] + lambda * (near.len() as f32 * x[i] - sum(x, near)));
        conjugate_gradients(apply, b.to_vec(), &vec![1.0; b.len()], 1e-8, ROUNDS)
    }

    /// The mean over neighbors less the own value, L x.
    fn laplacian(&self, x: &[f32]) -> Vec<f32> {
        self.each(|i, around| match around {
            [] => 0.0,
            around => sum(x, around) / around.len() as f32 - x[i],
        })
    }

    /// Lᵀ x.
    fn transposed(&self, x: &[f32]) -> Vec<f32> {
        let share = |&j: &u32| x[j as usize] / self.around(j as usize).len() as f32;
        self.each(|i, around| match around {
            [] => 0.0,
            around => around.iter().map(share).sum::<f32>() - x[i],
        })
    }

    /// Displacements t that minimize Σ hold·t² − 2 pull·t + `bending`·|L t|²: a thin plate, held
    /// and pulled at its vertices.
    pub(crate) fn bent(&self, plates: &[Plate], bending: f32) -> Vec<f32> {
        let apply = |t: &[f32]| -> Vec<f32> {
            let curved = self.transposed(&self.laplacian(t));
            (0..t.len()).map(|i| plates[i].hold * t[i] + bending * curved[i]).collect()
        };
        // A row of LᵀL has about 1 + 1/6 on its diagonal.
        let scale: Vec<f32> = plates.iter().map(|plate| (plate.hold + 1.2 * bending).recip()).collect();
        let right = plates.iter().map(|plate| plate.pull).collect();
        conjugate_gradients(apply, right, &scale, 1e-7, PLATE_ROUNDS)
    }

    /// Positions x that minimize Σ |x − `positions`|²/trust + `weight`·|L x|²: bumps that are
    /// shorter than a patch vanish where votes are trusted; vertices without trust stay.
    pub(crate) fn faired(&self, positions: &[Vec3], trust: &[f32], weight: f32) -> Vec<Vec3> {
        let steps = by_axis(|axis| {
            let along: Vec<f32> = positions.iter().map(|p| p[axis]).collect();
            let curved = self.transposed(&self.laplacian(&along));
            let plate = |(trust, curved): (&f32, f32)| Plate {
                hold: trust.clamp(1e-4, 1.0).recip(),
                pull: -weight * curved,
            };
            self.bent(&trust.iter().zip(curved).map(plate).collect::<Vec<Plate>>(), weight)
        });
        positions.iter().zip(steps).map(|(position, step)| *position + step).collect()
    }

    /// Doubled area vectors of the triangles summed at each vertex.
    pub(crate) fn area_vectors(&self, positions: &[Vec3]) -> Vec<Vec3> {
        let mut sums = vec![Vec3::ZERO; positions.len()];
        for triangle in &self.triangles {
            let area = area_vector(positions, triangle);
            triangle.iter().for_each(|&v| sums[v as usize] += area);
        }
        sums
    }

    /// Unit normals by area.
    pub(crate) fn normals(&self, positions: &[Vec3]) -> Vec<Vec3> {
        self.area_vectors(positions).iter().map(|sum| sum.normalize_or_zero()).collect()
    }

    /// Adjoints of positions from those of the vertices' unit normals.
    pub(super) fn pull_back_normals(&self, positions: &[Vec3], adjoint: &[Vec3]) -> Vec<Vec3> {
        let sums = self.area_vectors(positions).into_iter().zip(adjoint);
        let by_sum: Vec<Vec3> = sums.map(|(sum, adjoint)| pull_back_unit(sum, *adjoint)).collect();
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

    pub(crate) fn mean_edge(&self, positions: &[Vec3]) -> f32 {
        let length = |i: usize| {
            let lengths = self.around(i).iter().map(|&j| positions[i].distance(positions[j as usize]));
            f64::from(lengths.sum::<f32>())
        };
        ((0..positions.len()).map(length).sum::<f64>() / self.neighbors.len().max(1) as f64) as f32
    }
}

fn sum(x: &[f32], of: &[u32]) -> f32 {
    of.iter().map(|&j| x[j as usize]).sum()
}

/// Vectors from their coordinates along each axis.
pub(super) fn by_axis(coordinates: impl Fn(usize) -> Vec<f32>) -> impl Iterator<Item = Vec3> {
    let [x, y, z] = [0, 1, 2].map(coordinates);
    x.into_iter().zip(y).zip(z).map(|((x, y), z)| Vec3::new(x, y, z))
}

/// The normal of a triangle, twice its area long.
pub(super) fn area_vector(positions: &[Vec3], triangle: &[u32; 3]) -> Vec3 {
    let [a, b, c] = triangle.map(|v| positions[v as usize]);
    (b - a).cross(c - a)
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

/// Spring at a vertex.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Plate {
    /// Stiffness of its spring, > 0.
    pub(crate) hold: f32,
    /// Stiffness times the displacement at which the spring rests.
    pub(crate) pull: f32,
}

/// The merged vertices of a mesh with positions and normals.
pub(crate) struct Shell {
    pub(crate) graph: VertexGraph,
    pub(crate) positions: Vec<Vec3>,
    /// Unit normals by area.
    pub(crate) normals: Vec<Vec3>,
}

impl Shell {
    pub(crate) fn new(mesh: &Mesh) -> Self {
        Self::moved(VertexGraph::new(mesh).0, mesh)
    }

    /// Of a mesh whose vertices have moved since they were merged.
    pub(crate) fn moved(graph: VertexGraph, mesh: &Mesh) -> Self {
        let mut positions = vec![Vec3::ZERO; graph.starts.len() - 1];
        graph.of.iter().zip(&mesh.positions).for_each(|(of, at)| positions[*of as usize] = *at);
        Self { normals: graph.normals(&positions), graph, positions }
    }

    pub(crate) fn move_to(&mut self, positions: Vec<Vec3>) {
        self.normals = self.graph.normals(&positions);
        self.positions = positions;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use lobelia_geometry::mesh::primitive::sphere_mesh;

    fn sphere() -> (VertexGraph, Vec<Vec3>) {
        VertexGraph::new(&sphere_mesh(Vec3::ZERO, 1.0).unwrap())
    }

    #[test]
    fn a_plate_solves_its_equation_and_carries_votes_across_gaps() {
        let (graph, positions) = sphere();
        // Votes for the same displacement on a hemisphere; the other is all but free.
        let plate = |p: &Vec3| {
            if p.z > 0.0 { Plate { hold: 1.0, pull: 0.5 } } else { Plate { hold: 1e-5, pull: 0.0 } }
        };
        let plates: Vec<Plate> = positions.iter().map(plate).collect();
        let t = graph.bent(&plates, 2.0);
        let curved = graph.transposed(&graph.laplacian(&t));
        let off = (0..t.len()).map(|i| (plates[i].hold * t[i] + 2.0 * curved[i] - plates[i].pull).abs());
        assert!(off.fold(0.0, f32::max) < 2e-2);
        let beyond = (0..t.len()).filter(|&i| (-0.04..0.0).contains(&positions[i].z));
        assert!(beyond.clone().count() > 10);
        assert!(beyond.map(|i| t[i]).all(|t| (0.3..0.55).contains(&t)));
        let (a, b): (Vec<f32>, Vec<f32>) =
            positions.iter().map(|p| ((9.0 * p.x).sin(), (7.0 * p.y).cos())).unzip();
        let dot = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| f64::from(a * b)).sum::<f64>();
        let (left, right) = (dot(&graph.laplacian(&a), &b), dot(&a, &graph.transposed(&b)));
        assert!((left - right).abs() < 1e-4 * left.abs().max(1e-3), "{left} {right}");
    }

    #[test]
    fn fairing_flattens_bumps_where_votes_are_trusted_only() {
        let (graph, positions) = sphere();
        let mut bumpy = positions.clone();
        let (trusted, other) = (10, positions.len() - 10);
        for i in [trusted, other] {
            bumpy[i] *= 1.05;
        }
        let trust: Vec<f32> =
            positions.iter().map(|p| if p.dot(positions[trusted]) > 0.5 { 1.0 } else { 0.0 }).collect();
        let fair = graph.faired(&bumpy, &trust, 2.0);
        assert!(fair[trusted].length() < 1.035, "{}", fair[trusted].length());
        assert!((fair[other].length() - 1.05).abs() < 1e-3);
    }
}
