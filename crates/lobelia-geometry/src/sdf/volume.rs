//! Texels in space: one at each vertex of a lattice near the surface, blended in tetrahedra.
//!
//! A cell is cut into the six tetrahedra of Kuhn's triangulation, so that a point interpolates four
//! texels, as in an atlas, and code for texel addresses also works here.

use crate::sdf::SdfGrid;
use glam::{UVec3, Vec2, Vec3};
use lobelia_sg::ray::{Hit, Intersect, Ray, TexelAddress};
use serde::{Deserialize, Serialize};

/// Marks a vertex without texel.
const NONE: u32 = u32::MAX;

/// The texels around a surface.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct TexelVolume {
    side: u32,
    origin: Vec3,
    spacing: f32,
    /// Index of the texel of each lattice vertex.
    rows: Vec<u32>,
    /// Lattice position of each texel.
    texels: Vec<UVec3>,
}

impl TexelVolume {
    /// Texels at the vertices of a lattice of `cells` cells per side over the grid's cube that are
    /// within `reach` (world units) of the zero level.
    pub fn new(grid: &SdfGrid, cells: u32, reach: f32) -> Self {
        let side = cells + 1;
        let spacing = grid.spacing * (grid.side - 1) as f32 / cells as f32;
        let mut volume = Self { side, origin: grid.origin, spacing, rows: Vec::new(), texels: Vec::new() };
        let count = side * side * side;
        volume.rows = vec![NONE; count as usize];
        for i in 0..count {
            let at = UVec3::new(i % side, i / side % side, i / (side * side));
            if grid.value(volume.position(at)).abs() < reach {
                volume.rows[i as usize] = volume.texels.len() as u32;
                volume.texels.push(at);
            }
        }
        volume
    }

    /// Number of texels.
    pub fn len(&self) -> usize {
        self.texels.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.texels.is_empty()
    }

    /// World positions of the texels, by row.
    pub fn positions(&self) -> impl Iterator<Item = Vec3> + '_ {
        self.texels.iter().map(|at| self.position(*at))
    }

    fn position(&self, at: UVec3) -> Vec3 {
        self.origin + at.as_vec3() * self.spacing
    }

    /// The four texels around a point, from the cell's lowest corner to its highest; `None` if one
    /// is missing.
    pub fn address(&self, point: Vec3) -> Option<TexelAddress> {
        let (indices, weights) = self.tetrahedron(point);
        (!indices.contains(&NONE)).then_some(TexelAddress { indices, weights })
    }

    /// [`TexelVolume::address`], with the nearest texel of the cell in place of those that are
    /// missing.
    pub fn nearest_address(&self, point: Vec3) -> Option<TexelAddress> {
        let (rows, weights) = self.tetrahedron(point);
        let heaviest =
            (0..4).filter(|&k| rows[k] != NONE).max_by(|&a, &b| weights[a].total_cmp(&weights[b]))?;
        Some(TexelAddress { indices: rows.map(|r| if r == NONE { rows[heaviest] } else { r }), weights })
    }

    /// The cell that contains a point, clamped to the lattice, and the position in it, in [0, 1]³.
    fn cell(&self, point: Vec3) -> (UVec3, Vec3) {
        let last = (self.side - 1) as f32;
        let at = ((point - self.origin) / self.spacing).clamp(Vec3::ZERO, Vec3::splat(last));
        let cell = at.floor().as_uvec3().min(UVec3::splat(self.side - 2));
        (cell, at - cell.as_vec3())
    }

    /// The texels around a point, [`NONE`] where there is none, and their weights.
    fn tetrahedron(&self, point: Vec3) -> ([u32; 4], [f32; 4]) {
        let (cell, t) = self.cell(point);
        let order = descending(t);
        let mut corners = [cell; 4];
        for k in 0..3 {
            corners[k + 1] = corners[k];
            corners[k + 1][order[k]] += 1;
        }
        let [a, b, c] = order.map(|axis| t[axis]);
        let row = |at: UVec3| self.rows[(at.x + self.side * (at.y + self.side * at.z)) as usize];
        (corners.map(row), [1.0 - a, a - b, b - c, c])
    }

    /// Gradient in space of an interpolated value, given the value of each texel (such as a
    /// weighted sum of channels).
    pub fn gradient(&self, point: Vec3, address: &TexelAddress, value: impl Fn(u32) -> f32) -> Vec3 {
        let order = descending(self.cell(point).1);
        let mut gradient = Vec3::ZERO;
        for k in 0..3 {
            gradient[order[k]] = (value(address.indices[k + 1]) - value(address.indices[k])) / self.spacing;
        }
        gradient
    }
}

/// The axes from the largest component to the smallest.
fn descending(t: Vec3) -> [usize; 3] {
    let mut order = [0, 1, 2];
    order.sort_by(|&a, &b| t[b].total_cmp(&t[a]));
    order
}

/// An SDF with its texels, as a surface that rays can be cast against.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct SdfSurface {
    /// The distances.
    pub grid: SdfGrid,
    /// The texels near the zero level.
    pub volume: TexelVolume,
    /// Lower bounds of the distances, where photographs show that space is empty.
    pub empty: Option<SdfGrid>,
}

impl Intersect for SdfSurface {
    fn intersect(&self, ray: &Ray, min_distance: f32) -> Option<Hit> {
        let distance = self.grid.first_crossing(ray, min_distance)?;
        let position = ray.origin + ray.direction * distance;
        let normal = self.grid.gradient(position).try_normalize()?;
        let texels = self.volume.nearest_address(position)?;
        Some(Hit { distance, position, normal, geometric_normal: normal, uv: Vec2::ZERO, texels })
    }

    fn occluded(&self, ray: &Ray, min_distance: f32, max_distance: f32) -> bool {
        self.grid.first_crossing(ray, min_distance).is_some_and(|distance| distance < max_distance)
    }

    fn radius(&self) -> f32 {
        0.5 * self.grid.spacing * (self.grid.side - 1) as f32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_linear_color_is_blended_exactly_and_its_gradient_is_known() {
        let grid = SdfGrid::from_fn(Vec3::ZERO, 1.0, 24, |p| p.length() - 0.6);
        let volume = TexelVolume::new(&grid, 16, 0.3);
        let gradient = Vec3::new(0.2, -0.5, 0.9);
        let values: Vec<f32> = volume.positions().map(|p| p.dot(gradient)).collect();
        for i in 0..60 {
            let angle = i as f32 * 0.37;
            let point = 0.6 * Vec3::new(angle.cos(), 0.3 * (2.0 * angle).sin(), angle.sin()).normalize();
            let address = volume.address(point).unwrap();
            let blended: f32 = (0..4).map(|k| address.weights[k] * values[address.indices[k] as usize]).sum();
            assert!((blended - point.dot(gradient)).abs() < 1e-5);
            let found = volume.gradient(point, &address, |row| values[row as usize]);
            assert!((found - gradient).length() < 1e-3, "{found}");
        }
        assert!(volume.address(Vec3::ZERO).is_none());
    }
}
