//! [`SdfGrid`]: signed distances at the vertices of a grid, their interpolation and gradient.

use glam::{UVec3, Vec3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// Signed distances at the vertices of a cubic grid, negative inside.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SdfGrid {
    /// Vertices per side, ≥ 2.
    pub side: u32,
    /// World position of vertex (0, 0, 0).
    pub origin: Vec3,
    /// World distance between neighboring vertices.
    pub spacing: f32,
    /// Distances in world units; x varies fastest, then y, then z.
    pub values: Vec<f32>,
}

impl SdfGrid {
    /// A grid of `cells` cells per side over the cube around `center`, filled by `value` at each vertex's position.
    pub fn from_fn(center: Vec3, half_side: f32, cells: u32, value: impl Fn(Vec3) -> f32 + Sync) -> Self {
        Self::from_fn_in_layers(center, half_side, cells, 0..cells + 1, value)
    }

    /// The same in some layers along z alone; all other values are zero.
    pub(crate) fn from_fn_in_layers(
        center: Vec3,
        half_side: f32,
        cells: u32,
        layers: Range<u32>,
        value: impl Fn(Vec3) -> f32 + Sync,
    ) -> Self {
        let side = cells + 1;
        let spacing = 2.0 * half_side / cells as f32;
        let mut grid = Self { side, origin: center - Vec3::splat(half_side), spacing, values: Vec::new() };
        let slab = (side * side) as usize;
        let mut values = vec![0.0; slab * side as usize];
        let in_layers =
            values.par_chunks_mut(slab).enumerate().filter(|(z, _)| layers.contains(&(*z as u32)));
        in_layers.for_each(|(z, slab)| {
            for (i, out) in slab.iter_mut().enumerate() {
                let (x, y) = (i as u32 % side, i as u32 / side);
                *out = value(grid.position(UVec3::new(x, y, z as u32)));
            }
        });
        grid.values = values;
        grid
    }

    /// Index of a vertex.
    pub fn index(&self, vertex: UVec3) -> usize {
        let side = self.side as usize;
        vertex.x as usize + side * (vertex.y as usize + side * vertex.z as usize)
    }

    /// The vertex of an index.
    pub fn vertex(&self, index: usize) -> UVec3 {
        let (side, index) = (self.side, index as u32);
        UVec3::new(index % side, index / side % side, index / (side * side))
    }

    /// World position of a vertex.
    pub fn position(&self, vertex: UVec3) -> Vec3 {
        self.origin + vertex.as_vec3() * self.spacing
    }

    /// The cell that contains a point, clamped to the grid, and the position in it, in [0, 1]³.
    #[inline]
    fn cell(&self, point: Vec3) -> (UVec3, Vec3) {
        let last = Vec3::splat((self.side - 1) as f32);
        let at = ((point - self.origin) * self.spacing.recip()).clamp(Vec3::ZERO, last);
        // Truncation equals the floor of non-negative numbers, and is faster.
        let cell = at.as_uvec3().min(UVec3::splat(self.side - 2));
        (cell, at - cell.as_vec3())
    }

    /// Indices of the eight vertices around a point, with their trilinear weights.
    #[inline]
    pub fn corners(&self, point: Vec3) -> [(usize, f32); 8] {
        let (cell, t) = self.cell(point);
        self.corners_of(cell, t)
    }

    #[inline]
    fn corners_of(&self, cell: UVec3, t: Vec3) -> [(usize, f32); 8] {
        let (first, side) = (self.index(cell), self.side as usize);
        let s = Vec3::ONE - t;
        let (low, high) = (s.y * s.z, t.y * s.z);
        let (far_low, far_high) = (s.y * t.z, t.y * t.z);
        let (up, back) = (side, side * side);
        [
            (first, s.x * low),
            (first + 1, t.x * low),
            (first + up, s.x * high),
            (first + up + 1, t.x * high),
            (first + back, s.x * far_low),
            (first + back + 1, t.x * far_low),
            (first + back + up, s.x * far_high),
            (first + back + up + 1, t.x * far_high),
        ]
    }

    /// The trilinear distance at a point; outside the grid, the distance at the nearest point of the grid.
    #[inline]
    pub fn value(&self, point: Vec3) -> f32 {
        let (cell, t) = self.cell(point);
        let (first, side) = (self.index(cell), self.side as usize);
        let along_x = |row: usize| {
            let pair = &self.values[row..row + 2];
            pair[0] + t.x * (pair[1] - pair[0])
        };
        let along_y = |row: usize| {
            let low = along_x(row);
            low + t.y * (along_x(row + side) - low)
        };
        let low = along_y(first);
        low + t.z * (along_y(first + side * side) - low)
    }

    /// Central differences at a vertex (one-sided at the border).
    pub fn vertex_gradient(&self, vertex: UVec3) -> Vec3 {
        let last = self.side - 1;
        Vec3::from(std::array::from_fn(|axis| {
            let (mut low, mut high) = (vertex, vertex);
            low[axis] = low[axis].saturating_sub(1);
            high[axis] = (high[axis] + 1).min(last);
            let steps = (high[axis] - low[axis]) as f32 * self.spacing;
            (self.values[self.index(high)] - self.values[self.index(low)]) / steps
        }))
    }

    /// The vertices' central differences, interpolated: continuous, unlike the gradient of the trilinear value.
    pub fn gradient(&self, point: Vec3) -> Vec3 {
        let (cell, t) = self.cell(point);
        let corners = self.corners_of(cell, t);
        let interior = cell.min_element() > 0 && cell.max_element() + 2 < self.side;
        let at_vertex = |row: usize| {
            if !interior {
                return self.vertex_gradient(self.vertex(row));
            }
            let (side, v) = (self.side as usize, &self.values);
            let difference = |stride: usize| v[row + stride] - v[row - stride];
            Vec3::new(difference(1), difference(side), difference(side * side)) * (0.5 / self.spacing)
        };
        corners.iter().map(|(row, weight)| at_vertex(*row) * *weight).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_linear_field_is_read_back_exactly() {
        let slope = Vec3::new(0.3, -0.7, 0.2);
        let grid = SdfGrid::from_fn(Vec3::new(0.1, 0.2, 0.3), 1.0, 8, |p| p.dot(slope) - 0.1);
        for point in [Vec3::ZERO, Vec3::new(0.5, -0.4, 0.9), Vec3::new(1.1, 1.2, 1.3)] {
            assert!((grid.value(point) - (point.dot(slope) - 0.1)).abs() < 1e-5);
            assert!((grid.gradient(point) - slope).length() < 1e-4);
        }
    }
}
