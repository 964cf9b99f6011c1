//! Smooth displacements of a mesh from votes that do not cover all of it: a thin plate, held and pulled at its vertices.

use crate::shape::vertex_graph::VertexGraph;
use glam::Vec3;
use rayon::prelude::*;

/// Iterations of conjugate gradients.
const ITERATIONS: usize = 200;
/// Vertices of a task.
const TASK: usize = 4096;

/// What acts on a vertex.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Plate {
    /// Stiffness of its spring, > 0.
    pub hold: f32,
    /// That stiffness times the displacement at which the spring rests.
    pub pull: f32,
}

/// Displacements t that minimize Σ hold·t² − 2 pull·t + `bending`·|L t|², L the mean over neighbors less the vertex's own value.
pub(crate) fn bent(graph: &VertexGraph, plates: &[Plate], bending: f32) -> Vec<f32> {
    let apply = |t: &[f32]| -> Vec<f32> {
        let curved = transposed(graph, &laplacian(graph, t));
        (0..t.len()).map(|i| plates[i].hold * t[i] + bending * curved[i]).collect()
    };
    // A row of LᵀL has about 1 + 1/6 on its diagonal.
    let scale: Vec<f32> = plates.iter().map(|plate| (plate.hold + 1.2 * bending).recip()).collect();
    let right: Vec<f32> = plates.iter().map(|plate| plate.pull).collect();
    conjugate_gradients(&apply, right, &scale)
}

/// Positions x that minimize Σ |x − `positions`|²/trust + `weight`·|L x|²: bumps that are shorter than a patch vanish where votes are
/// trusted; vertices without trust stay.
pub(crate) fn faired(graph: &VertexGraph, positions: &[Vec3], trust: &[f32], weight: f32) -> Vec<Vec3> {
    let axis = |axis: usize| {
        let along: Vec<f32> = positions.iter().map(|p| p[axis]).collect();
        let curved = transposed(graph, &laplacian(graph, &along));
        let plate = |(trust, curved): (&f32, f32)| Plate {
            hold: trust.clamp(1e-4, 1.0).recip(),
            pull: -weight * curved,
        };
        bent(graph, &trust.iter().zip(curved).map(plate).collect::<Vec<Plate>>(), weight)
    };
    let [x, y, z] = [axis(0), axis(1), axis(2)];
    (0..positions.len()).map(|i| positions[i] + Vec3::new(x[i], y[i], z[i])).collect()
}

/// The mean over neighbors less the own value.
fn laplacian(graph: &VertexGraph, x: &[f32]) -> Vec<f32> {
    let row = |i: usize| {
        let around = graph.around(i);
        let sum: f32 = around.iter().map(|&j| x[j as usize]).sum();
        if around.is_empty() { 0.0 } else { sum / around.len() as f32 - x[i] }
    };
    (0..x.len()).into_par_iter().with_min_len(TASK).map(row).collect()
}

/// The transpose of [`laplacian`].
fn transposed(graph: &VertexGraph, x: &[f32]) -> Vec<f32> {
    let row = |i: usize| {
        let around = graph.around(i);
        let share = |&j: &u32| x[j as usize] / graph.around(j as usize).len() as f32;
        if around.is_empty() { 0.0 } else { around.iter().map(share).sum::<f32>() - x[i] }
    };
    (0..x.len()).into_par_iter().with_min_len(TASK).map(row).collect()
}

/// Solves A x = b for a symmetric positive A, with a diagonal that scales residuals.
fn conjugate_gradients(apply: &dyn Fn(&[f32]) -> Vec<f32>, right: Vec<f32>, scale: &[f32]) -> Vec<f32> {
    let dot = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| f64::from(a * b)).sum::<f64>();
    let scaled = |r: &[f32]| r.iter().zip(scale).map(|(r, s)| r * s).collect::<Vec<f32>>();
    let (mut x, mut residual) = (vec![0.0; right.len()], right);
    let mut z = scaled(&residual);
    let mut along = z.clone();
    let mut size = dot(&residual, &z);
    let enough = 1e-7 * size;
    for _ in 0..ITERATIONS {
        if size <= enough {
            break;
        }
        let product = apply(&along);
        let step = (size / dot(&along, &product)) as f32;
        x.iter_mut().zip(&along).for_each(|(x, a)| *x += step * a);
        residual.iter_mut().zip(&product).for_each(|(r, p)| *r -= step * p);
        z = scaled(&residual);
        let next = dot(&residual, &z);
        let keep = (next / size) as f32;
        along.iter_mut().zip(&z).for_each(|(a, z)| *a = z + keep * *a);
        size = next;
    }
    x
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::primitive::sphere_mesh;

    fn sphere() -> (VertexGraph, Vec<Vec3>) {
        VertexGraph::new(&sphere_mesh(Vec3::ZERO, 1.0).unwrap())
    }

    #[test]
    fn transpose_is_the_transpose() {
        let (graph, positions) = sphere();
        let (a, b): (Vec<f32>, Vec<f32>) =
            positions.iter().map(|p| ((9.0 * p.x).sin(), (7.0 * p.y).cos())).unzip();
        let dot = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| f64::from(a * b)).sum::<f64>();
        let (left, right) = (dot(&laplacian(&graph, &a), &b), dot(&a, &transposed(&graph, &b)));
        assert!((left - right).abs() < 1e-4 * left.abs().max(1e-3), "{left} {right}");
    }

    #[test]
    fn a_plate_solves_its_equation_and_carries_votes_across_gaps() {
        let (graph, positions) = sphere();
        // Votes for the same displacement on a hemisphere; the other is all but free.
        let plate = |p: &Vec3| {
            if p.z > 0.0 { Plate { hold: 1.0, pull: 0.5 } } else { Plate { hold: 1e-5, pull: 0.0 } }
        };
        let plates: Vec<Plate> = positions.iter().map(plate).collect();
        let t = bent(&graph, &plates, 2.0);
        let curved = transposed(&graph, &laplacian(&graph, &t));
        let off = (0..t.len()).map(|i| (plates[i].hold * t[i] + 2.0 * curved[i] - plates[i].pull).abs());
        assert!(off.fold(0.0, f32::max) < 2e-2);
        let beyond = (0..t.len()).filter(|&i| (-0.04..0.0).contains(&positions[i].z));
        assert!(beyond.clone().count() > 10);
        assert!(beyond.map(|i| t[i]).all(|t| (0.3..0.55).contains(&t)));
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
        let fair = faired(&graph, &bumpy, &trust, 2.0);
        assert!(fair[trusted].length() < 1.035, "{}", fair[trusted].length());
        assert!((fair[other].length() - 1.05).abs() < 1e-3);
    }
}
