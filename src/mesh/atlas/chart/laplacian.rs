//! The cotangent Laplacian of a patch, and its solution by conjugate gradients.
//!
//! Weights: Pinkall, Polthier: "Computing discrete minimal surfaces and their conjugates", Experimental Mathematics 2 (1993). Solver:
//! Hestenes, Stiefel: "Methods of conjugate gradients for solving linear systems", 1952, with the diagonal as preconditioner.

use super::patch::{Patch, PlanarTriangle};
use glam::DVec2;

/// Bounds of an edge's weight: positive, so that the matrix is semidefinite, and finite at slivers.
const WEIGHTS: (f64, f64) = (0.02, 20.0);

/// A symmetric matrix with the sums of its rows zero, as rows of edges.
#[derive(Debug)]
pub struct Laplacian {
    /// Where each vertex's edges begin.
    begin: Vec<u32>,
    /// The other vertex and the weight of each edge.
    edges: Vec<(u32, f64)>,
    /// Sum of the weights of each vertex's edges.
    diagonal: Vec<f64>,
}

impl Laplacian {
    /// The matrix of a patch; half the quadratic form is the Dirichlet energy, but for bounds of the weights.
    pub fn new(patch: &Patch, shapes: &[PlanarTriangle]) -> Self {
        let mut rows: Vec<Vec<(u32, f64)>> = vec![Vec::with_capacity(8); patch.points.len()];
        let mut add = |from: u32, to: u32, weight: f64| {
            let row = &mut rows[from as usize];
            match row.iter_mut().find(|(other, _)| *other == to) {
                Some((_, sum)) => *sum += weight,
                None => row.push((to, weight)),
            }
        };
        for (triangle, shape) in patch.triangles.iter().zip(shapes) {
            let corners = [DVec2::ZERO, DVec2::new(shape.base, 0.0), shape.tip];
            for k in 0..3 {
                let [a, b] = [corners[(k + 1) % 3] - corners[k], corners[(k + 2) % 3] - corners[k]];
                let half_cotangent = 0.25 * a.dot(b) / shape.area;
                let (from, to) = (triangle[(k + 1) % 3], triangle[(k + 2) % 3]);
                add(from, to, half_cotangent);
                add(to, from, half_cotangent);
            }
        }
        let mut laplacian = Self { begin: vec![0], edges: Vec::new(), diagonal: Vec::new() };
        for row in rows {
            let bounded = row.into_iter().map(|(to, weight)| (to, weight.clamp(WEIGHTS.0, WEIGHTS.1)));
            let start = laplacian.edges.len();
            laplacian.edges.extend(bounded);
            laplacian.begin.push(laplacian.edges.len() as u32);
            laplacian.diagonal.push(laplacian.edges[start..].iter().map(|(_, weight)| weight).sum());
        }
        laplacian
    }

    /// The edges of a vertex: the other vertex, and the weight.
    pub fn edges(&self, vertex: usize) -> &[(u32, f64)] {
        &self.edges[self.begin[vertex] as usize..self.begin[vertex + 1] as usize]
    }

    fn row_times(&self, vertex: usize, x: &[DVec2]) -> DVec2 {
        let others: DVec2 = self.edges(vertex).iter().map(|(to, weight)| x[*to as usize] * *weight).sum();
        x[vertex] * self.diagonal[vertex] - others
    }

    /// About the solution of L x = `right`, whose sum is zero, from x = 0: until the residual has fallen to `tolerance` of the right side, or
    /// for `rounds`. If `right` is a gradient, −x is a direction of descent whatever the round.
    pub fn solve(&self, right: &[DVec2], tolerance: f64, rounds: usize) -> Vec<DVec2> {
        let mut x = vec![DVec2::ZERO; right.len()];
        let mut residual = right.to_vec();
        let mut direction = vec![DVec2::ZERO; right.len()];
        let mut image = direction.clone();
        let (mut before, mut first) = (0.0, 0.0);
        for round in 0..rounds {
            let weighted: f64 =
                residual.iter().zip(&self.diagonal).map(|(r, d)| r.length_squared() / d).sum();
            if round == 0 {
                first = weighted;
            }
            // Also where the right side is zero, or not a number.
            let open = weighted > tolerance * tolerance * first && weighted.is_normal();
            if !open {
                break;
            }
            let share = if before > 0.0 { weighted / before } else { 0.0 };
            before = weighted;
            for ((direction, residual), weight) in direction.iter_mut().zip(&residual).zip(&self.diagonal) {
                *direction = *residual / *weight + *direction * share;
            }
            image.iter_mut().enumerate().for_each(|(i, image)| *image = self.row_times(i, &direction));
            let curvature: f64 = direction.iter().zip(&image).map(|(d, i)| d.dot(*i)).sum();
            let convex = curvature > 0.0 && curvature.is_finite();
            if !convex {
                break;
            }
            let step = weighted / curvature;
            x.iter_mut().zip(&direction).for_each(|(x, direction)| *x += *direction * step);
            residual.iter_mut().zip(&image).for_each(|(residual, image)| *residual -= *image * step);
        }
        x
    }
}
