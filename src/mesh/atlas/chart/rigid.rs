//! Unfolding: a map that keeps each triangle's shape, by turns of triangles and one linear system.
//!
//! Liu, Zhang, Xu, Gotsman, Gortler: "A local/global approach to mesh parameterization", SGP 2008 (ARAP).

use super::laplacian::Laplacian;
use super::patch::{Patch, PlanarTriangle};
use glam::DVec2;

/// Accuracy and most rounds of the linear system.
const ACCURACY: (f64, usize) = (0.05, 40);

/// One round: turns each triangle to fit the map as it is, and moves the vertices to where these turned triangles meet best.
pub(crate) fn unfold(patch: &Patch, shapes: &[PlanarTriangle], laplacian: &Laplacian, map: &mut [DVec2]) {
    let mut force = vec![DVec2::ZERO; map.len()];
    for (triangle, shape) in patch.triangles.iter().zip(shapes) {
        let [by_x, by_y] = shape.jacobian(triangle.map(|v| map[v as usize]));
        // The turn nearest to J has its first column along (J₀₀ + J₁₁, J₁₀ − J₀₁).
        let turn = DVec2::new(by_x.x + by_y.y, by_x.y - by_y.x).try_normalize().unwrap_or(DVec2::X);
        let off = [turn - by_x, turn.perp() - by_y];
        let corners = shape.pull_back(off.map(|column| column * shape.area));
        triangle.iter().zip(corners).for_each(|(v, corner)| force[*v as usize] += corner);
    }
    let moves = laplacian.solve(&force, ACCURACY.0, ACCURACY.1);
    map.iter_mut().zip(moves).for_each(|(place, by)| *place += by);
}
