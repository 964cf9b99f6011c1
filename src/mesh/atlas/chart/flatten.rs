//! From a patch to a chart: its vertices in the plane.
//!
//! A patch is seen along its mean normal. If triangles face away, the view is unfolded until none does ([`super::rigid`]); then the map is
//! evened out ([`super::stretch`]). It counts if its distortion is small, and if it covers no point twice.

use super::laplacian::Laplacian;
use super::patch::{Patch, PlanarTriangle};
use super::rigid::unfold;
use super::simple::is_simple;
use super::stretch::{Descent, energy};
use glam::DVec2;

/// Largest part of the area that may face away from the view.
const MOST_HIDDEN: f64 = 0.3;
/// Rounds of unfolding.
const UNFOLDING_ROUNDS: usize = 4;
/// Rounds of moving vertices of the last turned triangles between their neighbors.
const UNTANGLING_ROUNDS: usize = 16;
/// Steps of evening out; the least part of the rest that a step must gain; an energy that is good enough.
const EVENING: (usize, f64, f64) = (16, 0.02, 4.02);

/// How much a chart may be distorted.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Tolerance {
    /// Largest mean energy ([`energy`]); 4 is rigid, 4.5 squares that become rectangles of 1 by 1.64.
    pub mean: f64,
    /// Largest part of the area whose triangles become more than twice as large, or less than half.
    pub uneven: f64,
}

/// The patch in the plane, as large as in the world and not mirrored: one place for each vertex, world units. `None` if it has no border, has
/// handles, or cannot lie flat within the tolerance without triangles that are turned over or parts that overlap.
pub fn flatten(patch: &Patch, tolerance: &Tolerance) -> Option<Vec<DVec2>> {
    if !patch.is_planar() {
        return None;
    }
    let shapes: Vec<PlanarTriangle> =
        patch.triangles.iter().map(|t| PlanarTriangle::new(t.map(|v| patch.points[v as usize]))).collect();
    let mut map = view(patch);
    let hidden = hidden_part(patch, &shapes, &map);
    if hidden > MOST_HIDDEN {
        return None;
    }
    let laplacian = Laplacian::new(patch, &shapes);
    for _ in 0..UNFOLDING_ROUNDS {
        if hidden_part(patch, &shapes, &map) == 0.0 {
            break;
        }
        unfold(patch, &shapes, &laplacian, &mut map);
    }
    untangle(patch, &laplacian, &shapes, &mut map);
    let descent = Descent::new(patch, &shapes, &laplacian);
    let found = descent.run(&mut map, EVENING.0, EVENING.1, EVENING.2);
    let grown = enlarge(patch, &mut map);
    (found <= tolerance.mean
        && grown
        && uneven_part(patch, &shapes, &map) <= tolerance.uneven
        && is_simple(&patch.border, &map))
    .then_some(map)
}

/// The vertices along the patch's mean normal.
fn view(patch: &Patch) -> Vec<DVec2> {
    let normal = patch.area_vector.try_normalize().unwrap_or(glam::DVec3::Z);
    let (right, up) = normal.any_orthonormal_pair();
    // Counter-clockwise triangles stay so: (right, up, normal) is right-handed.
    patch
        .points
        .iter()
        .map(|p| DVec2::new((*p - patch.points[0]).dot(right), (*p - patch.points[0]).dot(up)))
        .collect()
}

/// The part of the patch's area in triangles that are turned over, or have no area.
fn hidden_part(patch: &Patch, shapes: &[PlanarTriangle], map: &[DVec2]) -> f64 {
    let turned = |(t, shape): (&[u32; 3], &PlanarTriangle)| {
        let visible = energy(shape.jacobian(t.map(|v| map[v as usize]))).is_finite();
        if visible { 0.0 } else { shape.area }
    };
    patch.triangles.iter().zip(shapes).map(turned).sum::<f64>() / patch.area
}

/// Moves vertices of turned triangles to the middle of their neighbors, until there are none or the rounds are over.
fn untangle(patch: &Patch, laplacian: &Laplacian, shapes: &[PlanarTriangle], map: &mut [DVec2]) {
    for _ in 0..UNTANGLING_ROUNDS {
        let turned = |(t, shape): &(&[u32; 3], &PlanarTriangle)| {
            !energy(shape.jacobian(t.map(|v| map[v as usize]))).is_finite()
        };
        let of_turned = patch.triangles.iter().zip(shapes).filter(turned).flat_map(|(t, _)| *t);
        let mut vertices: Vec<u32> = of_turned.collect();
        if vertices.is_empty() {
            return;
        }
        vertices.sort_unstable();
        vertices.dedup();
        for vertex in vertices {
            let around = laplacian.edges(vertex as usize);
            let sum: DVec2 = around.iter().map(|(other, _)| map[*other as usize]).sum();
            map[vertex as usize] = sum / around.len() as f64;
        }
    }
}

/// Makes the map as large as the patch; false if that cannot be.
fn enlarge(patch: &Patch, map: &mut [DVec2]) -> bool {
    let doubled = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|v| map[v as usize]);
        (b - a).perp_dot(c - a)
    };
    let area: f64 = 0.5 * patch.triangles.iter().map(doubled).sum::<f64>();
    let factor = (patch.area / area).sqrt();
    map.iter_mut().for_each(|p| *p *= factor);
    factor.is_normal()
}

/// The part of the area whose triangles are more than twice as large in the map, or less than half.
fn uneven_part(patch: &Patch, shapes: &[PlanarTriangle], map: &[DVec2]) -> f64 {
    let uneven = |(t, shape): (&[u32; 3], &PlanarTriangle)| {
        let [by_x, by_y] = shape.jacobian(t.map(|v| map[v as usize]));
        let even = (0.5..=2.0).contains(&by_x.perp_dot(by_y));
        if even { 0.0 } else { shape.area }
    };
    patch.triangles.iter().zip(shapes).map(uneven).sum::<f64>() / patch.area
}
