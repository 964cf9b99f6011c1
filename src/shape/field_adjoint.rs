//! Adjoints of the values of an SDF: from normals, from positions along rays, and from silhouettes.
//!
//! A sample's normal is that of the interpolated central differences, so its adjoint is propagated to the gradients at eight
//! vertices first, and from there by one divergence stencil to the values. The position moves along its ray as the values change
//! (implicit differentiation; IDR eq. 3, Niemeyer et al. 2020): dx/dφ = −d / (∇φ·d).

use crate::checkpoint::packed::sparse;
use crate::sdf::SdfGrid;
use glam::{UVec3, Vec3};
use serde::{Deserialize, Serialize};

/// Lower bound of |∇φ·d| in the adjoint of a position, because the derivative is unbounded at grazing rays.
const LEAST_DERIVATIVE: f32 = 0.15;

/// Adjoints at the vertices of an SDF.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct FieldAdjoint {
    /// Adjoint of the values.
    #[serde(with = "sparse")]
    pub value: Vec<f32>,
    /// Adjoint of the central differences at the vertices.
    #[serde(with = "sparse")]
    pub gradient: Vec<Vec3>,
}

/// Adjoints of the field at a sample's surface point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SampleAdjoint {
    position: Vec3,
    /// Adjoint of the interpolated central differences.
    gradient: Vec3,
    /// Adjoint of the value.
    value: f32,
}

impl SampleAdjoint {
    /// From the adjoints of the unit normal at `position` and of the position itself, where a ray of direction `direction` meets the surface.
    pub fn new(grid: &SdfGrid, position: Vec3, direction: Vec3, by_normal: Vec3, by_position: Vec3) -> Self {
        let gradient = grid.gradient(position);
        let length = gradient.length().max(1e-3);
        let normal = gradient / length;
        let derivative = gradient.dot(direction).min(-LEAST_DERIVATIVE);
        Self {
            position,
            gradient: (by_normal - normal * normal.dot(by_normal)) / length,
            value: -by_position.dot(direction) / derivative,
        }
    }
}

impl FieldAdjoint {
    /// Zeros for every vertex of `grid`.
    pub fn zeros(grid: &SdfGrid) -> Self {
        Self { value: vec![0.0; grid.values.len()], gradient: vec![Vec3::ZERO; grid.values.len()] }
    }

    /// Adds the adjoints of a sample.
    pub fn add(&mut self, grid: &SdfGrid, sample: &SampleAdjoint) {
        for (row, weight) in grid.corners(sample.position) {
            self.gradient[row] += sample.gradient * weight;
            self.value[row] += sample.value * weight;
        }
    }

    /// Adds the adjoint of the value at `position`.
    pub fn add_value(&mut self, grid: &SdfGrid, position: Vec3, value_adjoint: f32) {
        for (row, weight) in grid.corners(position) {
            self.value[row] += value_adjoint * weight;
        }
    }

    /// The adjoint of the value at index `row`, central differences included. `interior` means that the vertex is at least
    /// two vertices away from the border, so that no difference is one-sided.
    #[inline]
    pub fn of_row(&self, grid: &SdfGrid, row: usize, interior: bool) -> f32 {
        if !interior {
            return self.at_border(grid, grid.vertex(row));
        }
        let (side, g) = (grid.side as usize, &self.gradient);
        let x = g[row - 1].x - g[row + 1].x;
        let y = g[row - side].y - g[row + side].y;
        let z = g[row - side * side].z - g[row + side * side].z;
        self.value[row] + (x + y + z) * (0.5 / grid.spacing)
    }

    fn at_border(&self, grid: &SdfGrid, vertex: UVec3) -> f32 {
        let last = grid.side - 1;
        let mut sum = self.value[grid.index(vertex)];
        for axis in 0..3 {
            // The vertex is part of the differences of its neighbors, and at the border of its own.
            let at = vertex[axis];
            let share = |from: u32, sign: f32| {
                let mut other = vertex;
                other[axis] = from;
                let steps = ((from + 1).min(last) - from.saturating_sub(1)) as f32;
                sign * self.gradient[grid.index(other)][axis] / (steps * grid.spacing)
            };
            sum += if at > 0 { share(at - 1, 1.0) } else { share(0, -1.0) };
            sum += if at < last { share(at + 1, -1.0) } else { share(last, 1.0) };
        }
        sum
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::ray::Ray;

    fn bumpy() -> SdfGrid {
        SdfGrid::from_fn(Vec3::ZERO, 1.0, 12, |p| {
            p.length() - 0.6 + 0.05 * (5.0 * p.x).sin() * (4.0 * p.y).cos()
        })
    }

    fn is_interior(grid: &SdfGrid, row: usize) -> bool {
        let vertex = grid.vertex(row);
        vertex.min_element() >= 2 && vertex.max_element() + 2 < grid.side
    }

    /// Compares every vertex's adjoint with central differences of `f` in that vertex's value.
    fn check(adjoint: &FieldAdjoint, f: impl Fn(&SdfGrid) -> f32, h: f32, tolerance: f32) {
        let grid = bumpy();
        let mut touched = 0;
        for i in 0..grid.values.len() {
            let found = adjoint.of_row(&grid, i, is_interior(&grid, i));
            let moved = |by: f32| {
                let mut moved = grid.clone();
                moved.values[i] += by;
                f(&moved)
            };
            let expected = (moved(h) - moved(-h)) / (2.0 * h);
            assert!((found - expected).abs() < tolerance, "vertex {i}: {found} {expected}");
            touched += usize::from(found != 0.0);
        }
        assert!(touched >= 8);
    }

    #[test]
    fn normals_pull_back_as_central_differences_say() {
        let (position, weight) = (Vec3::new(0.41, 0.33, -0.22), Vec3::new(0.3, -0.8, 0.5));
        let grid = bumpy();
        let mut adjoint = FieldAdjoint::zeros(&grid);
        adjoint.add(&grid, &SampleAdjoint::new(&grid, position, Vec3::Z, weight, Vec3::ZERO));
        check(&adjoint, |g| g.gradient(position).normalize().dot(weight), 1e-3, 2e-3);
    }

    #[test]
    fn normals_at_the_border_pull_back_too() {
        let (position, weight) = (Vec3::new(0.97, -0.96, 0.99), Vec3::new(0.3, -0.8, 0.5));
        let grid = bumpy();
        let mut adjoint = FieldAdjoint::zeros(&grid);
        adjoint.add(&grid, &SampleAdjoint::new(&grid, position, Vec3::Z, weight, Vec3::ZERO));
        check(&adjoint, |g| g.gradient(position).normalize().dot(weight), 1e-3, 2e-3);
    }

    #[test]
    fn positions_pull_back_along_the_ray() {
        let ray =
            Ray { origin: Vec3::new(0.2, 0.1, -3.0), direction: Vec3::new(0.02, 0.05, 1.0).normalize() };
        let meets = |g: &SdfGrid| ray.origin + ray.direction * g.first_crossing(&ray, 0.0).unwrap();
        let weight = Vec3::new(0.4, 0.7, -0.9);
        let grid = bumpy();
        let mut adjoint = FieldAdjoint::zeros(&grid);
        adjoint.add(&grid, &SampleAdjoint::new(&grid, meets(&grid), ray.direction, Vec3::ZERO, weight));
        // The gradient of the trilinear value and the interpolated differences are not the same number.
        check(&adjoint, |g| meets(g).dot(weight), 1e-3, 0.06);
    }

    #[test]
    fn the_least_distance_of_a_ray_pulls_back_to_where_it_is() {
        let ray = Ray { origin: Vec3::new(0.03, 0.76, -3.0), direction: Vec3::Z };
        let least = |g: &SdfGrid| g.least_distance(&ray, -1.0).unwrap();
        let grid = bumpy();
        let mut adjoint = FieldAdjoint::zeros(&grid);
        adjoint.add_value(&grid, ray.origin + ray.direction * least(&grid).distance, 1.0);
        check(&adjoint, |g| g.value(ray.origin + ray.direction * least(&grid).distance), 1e-3, 1e-3);
    }
}
