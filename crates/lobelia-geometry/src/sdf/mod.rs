//! A signed distance field on a regular grid: look-up, gradient, tracing of rays, mesh extraction,
//! and texels. Distances are in world units at the vertices, negative inside, and trilinear in
//! between.
//!
//! ```
//! use glam::Vec3;
//! use lobelia_geometry::sdf::SdfGrid;
//! use lobelia_sg::ray::Ray;
//!
//! let ball = SdfGrid::from_fn(Vec3::ZERO, 1.0, 32, |point| point.length() - 0.6);
//! assert!((ball.value(Vec3::X) - 0.4).abs() < 1e-5);
//! let ray = Ray { origin: Vec3::new(0.0, 0.0, 3.0), direction: Vec3::NEG_Z };
//! assert!(ball.first_crossing(&ray, 0.0).is_some_and(|distance| (distance - 2.4).abs() < 0.01));
//! ```

pub mod extract;
mod redistance;
pub mod volume;

use crate::parallel;
use glam::{UVec3, Vec3};
use lobelia_sg::ray::Ray;
use serde::{Deserialize, Serialize};

/// Vertices of a block along each axis.
const BLOCK: u32 = 8;
/// Step length relative to the distance: values between vertices are interpolated and may be too
/// large.
const STEP: f32 = 0.9;
/// Least step, in cells. A thinner part could be stepped over, but the grid cannot represent one.
const MIN_STEP: f32 = 0.25;
/// Rounds of root finding (Illinois, Dowell and Jarratt 1971) in a bracket of at most a few cells.
const REFINEMENTS: usize = 4;

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
    /// A grid of `cells` cells per side over the cube around `center`, filled by `value` at each
    /// vertex's position.
    pub fn from_fn(center: Vec3, half_side: f32, cells: u32, value: impl Fn(Vec3) -> f32 + Sync) -> Self {
        let side = cells + 1;
        let spacing = 2.0 * half_side / cells as f32;
        let mut grid = Self { side, origin: center - Vec3::splat(half_side), spacing, values: Vec::new() };
        let at = |i: usize| value(grid.position(grid.vertex(i)));
        grid.values = parallel::map(side as usize * (side * side) as usize, 1024, at);
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

    /// The trilinear distance at a point; outside the grid, the distance at the nearest point of
    /// the grid.
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

    /// The vertices' central differences, interpolated: continuous, unlike the gradient of the
    /// trilinear value.
    pub fn gradient(&self, point: Vec3) -> Vec3 {
        let (cell, _) = self.cell(point);
        let interior = cell.min_element() > 0 && cell.max_element() + 2 < self.side;
        let at_vertex = |row: usize| {
            if !interior {
                return self.vertex_gradient(self.vertex(row));
            }
            let (side, v) = (self.side as usize, &self.values);
            let difference = |stride: usize| v[row + stride] - v[row - stride];
            Vec3::new(difference(1), difference(side), difference(side * side)) * (0.5 / self.spacing)
        };
        self.corners(point).into_iter().map(|(row, weight)| at_vertex(row) * weight).sum()
    }

    /// The values, replaced by `value` of their indices. `most` gets the center and the radius of
    /// the ball around a block: where it gives a number, the block keeps its values, but none above
    /// that number.
    pub fn replaced_in_blocks(
        &self,
        most: impl Fn(Vec3, f32) -> Option<f32> + Sync,
        value: impl Fn(usize) -> f32 + Sync,
    ) -> Vec<f32> {
        let plane = (self.side * self.side) as usize;
        let mut values = self.values.clone();
        let layers = values.chunks_mut(plane * BLOCK as usize).enumerate();
        parallel::for_each(layers, |(layer, part)| {
            let (first, count) = (layer * BLOCK as usize * plane, self.side.div_ceil(BLOCK));
            for i in 0..count * count {
                let low = BLOCK * UVec3::new(i % count, i / count, layer as u32);
                let end = (low + BLOCK).min(UVec3::splat(self.side));
                let (near, far) = (self.position(low), self.position(end - UVec3::ONE));
                let most = most(0.5 * (near + far), 0.5 * near.distance(far));
                for (y, z) in (low.z..end.z).flat_map(|z| (low.y..end.y).map(move |y| (y, z))) {
                    let line = self.index(UVec3::new(low.x, y, z));
                    for row in line..line + (end.x - low.x) as usize {
                        part[row - first] =
                            most.map_or_else(|| value(row), |most| self.values[row].min(most));
                    }
                }
            }
        });
        values
    }
}

/// The least distance of a ray to the surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LeastDistance {
    /// Distance along the ray, world units.
    pub distance: f32,
    /// The SDF's value there; negative inside.
    pub value: f32,
}

/// Rays against the zero level: sphere tracing (Hart 1996) to a bracket, then bracketed root
/// finding.
impl SdfGrid {
    /// The interval of the ray inside the cube of the grid; `None` if it is empty beyond
    /// `min_distance`.
    fn span(&self, ray: &Ray, min_distance: f32) -> Option<(f32, f32)> {
        let high = self.position(UVec3::splat(self.side - 1));
        let inverse = ray.direction.recip();
        let (a, b) = ((self.origin - ray.origin) * inverse, (high - ray.origin) * inverse);
        // A ray along a face gives 0 · ∞ = NaN; min and max then return the other operand.
        let (near, far) = (a.min(b).max_element().max(min_distance), a.max(b).min_element());
        (near < far).then_some((near, far))
    }

    /// Distance along the ray to the first point where it enters the surface, beyond
    /// `min_distance`.
    pub fn first_crossing(&self, ray: &Ray, min_distance: f32) -> Option<f32> {
        let (near, far) = self.span(ray, min_distance)?;
        let at = |t: f32| self.value(ray.origin + ray.direction * t);
        let least = MIN_STEP * self.spacing;
        let (mut t, mut value) = (near, at(near));
        while t < far {
            let next = t + (STEP * value.abs()).max(least);
            let next_value = at(next);
            if value > 0.0 && next_value <= 0.0 {
                return Some(root(at, (t, value), (next, next_value)));
            }
            (t, value) = (next, next_value);
        }
        None
    }

    /// The point of the ray with the least value, up to the first local minimum below `enough` or
    /// the exit from the grid.
    pub fn least_distance(&self, ray: &Ray, enough: f32) -> Option<LeastDistance> {
        let (near, far) = self.span(ray, 0.0)?;
        let least_step = MIN_STEP * self.spacing;
        let mut least = LeastDistance { distance: near, value: f32::INFINITY };
        let mut t = near;
        while t < far {
            let value = self.value(ray.origin + ray.direction * t);
            if value < least.value {
                least = LeastDistance { distance: t, value };
            } else if least.value < 0.0 {
                break;
            }
            if least.value < enough {
                break;
            }
            t += (STEP * value).max(least_step);
        }
        Some(least)
    }
}

/// The root of `at` between a positive and a non-positive value.
fn root(at: impl Fn(f32) -> f32, mut outside: (f32, f32), mut inside: (f32, f32)) -> f32 {
    let secant = |a: (f32, f32), b: (f32, f32)| a.0 + (b.0 - a.0) * (a.1 / (a.1 - b.1)).clamp(0.0, 1.0);
    for _ in 0..REFINEMENTS {
        let t = secant(outside, inside);
        let value = at(t);
        if value > 0.0 {
            outside = (t, value);
            inside.1 *= 0.5;
        } else {
            inside = (t, value);
            outside.1 *= 0.5;
        }
    }
    secant(outside, inside)
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

    #[test]
    fn every_value_outside_the_blocks_that_stay_is_replaced() {
        let grid = SdfGrid::from_fn(Vec3::ZERO, 1.0, 20, |p| p.length() - 0.6);
        let all = grid.replaced_in_blocks(|_, _| None, |row| row as f32);
        assert!(all.iter().enumerate().all(|(row, value)| *value == row as f32));
        let far = grid.replaced_in_blocks(|middle, radius| (middle.x - radius > 0.0).then_some(0.3), |_| 7.0);
        for (row, value) in far.iter().enumerate() {
            let point = grid.position(grid.vertex(row));
            assert!(*value == 7.0 || (*value == grid.values[row].min(0.3) && point.x > 0.0), "{point}");
        }
        assert!(far.contains(&0.3) && far.iter().any(|value| *value < 0.3));
    }

    fn ball() -> SdfGrid {
        SdfGrid::from_fn(Vec3::ZERO, 1.0, 64, |p| p.length() - 0.7)
    }

    #[test]
    fn a_ray_meets_a_ball_where_it_should() {
        let grid = ball();
        for (x, y) in [(0.0, 0.0), (0.3, 0.2), (0.5, -0.4), (0.0, 0.69)] {
            let ray = Ray { origin: Vec3::new(x, y, -5.0), direction: Vec3::Z };
            let exact = 5.0 - f32::sqrt(0.49 - x * x - y * y);
            let found = grid.first_crossing(&ray, 0.0).unwrap();
            assert!((found - exact).abs() < 4e-3, "{found} {exact}");
            assert!(grid.value(ray.origin + found * ray.direction).abs() < 1e-5);
        }
        let past = Ray { origin: Vec3::new(0.8, 0.0, -5.0), direction: Vec3::Z };
        assert_eq!(grid.first_crossing(&past, 0.0), None);
        let away = Ray { origin: Vec3::new(0.0, 0.0, -5.0), direction: -Vec3::Z };
        assert_eq!(grid.first_crossing(&away, 0.0), None);
    }

    #[test]
    fn a_sheet_two_cells_thick_is_met_from_any_side() {
        let grid = SdfGrid::from_fn(Vec3::ZERO, 1.0, 64, |p| (p.y - 0.3).abs() - 1.0 / 32.0);
        for i in 0..200 {
            let angle = i as f32 * 0.0314;
            let origin = Vec3::new(2.0 * angle.cos(), 3.0 - 0.01 * i as f32, 2.0 * angle.sin());
            let ray = Ray { origin, direction: (Vec3::new(0.01, 0.29, 0.0) - origin).normalize() };
            assert!(grid.first_crossing(&ray, 0.0).is_some(), "{i}");
        }
    }

    #[test]
    fn the_least_distance_is_that_of_the_nearest_point() {
        let grid = ball();
        for height in [0.6, 0.68, 0.75, 0.9] {
            let ray = Ray { origin: Vec3::new(0.0, height, -5.0), direction: Vec3::Z };
            let least = grid.least_distance(&ray, -0.5).unwrap();
            assert!((least.value - (height - 0.7)).abs() < 3e-3, "{height}: {least:?}");
            assert!((least.distance - 5.0).abs() < 0.1, "{height}: {least:?}");
        }
    }
}
