//! Redistancing of a field: fast sweeping (Zhao 2005) outward from the zero level.
//!
//! Values beside the zero level are divided by the length of the gradient there, which preserves the level to
//! first order; all others are solved from |∇φ| = 1 by Gauss–Seidel sweeps in the eight diagonal directions.

use crate::sdf::grid::SdfGrid;
use rayon::prelude::*;

/// Bounds on the length of the gradient that a value is divided by: gradients at creases are inaccurate.
const GRADIENT_RANGE: (f32, f32) = (0.3, 3.0);
/// Rounds of all eight sweeps; two are enough except for fields with long winding paths.
const ROUNDS: usize = 2;

impl SdfGrid {
    /// Replaces the values by distances to their zero level, which is preserved.
    pub fn redistance(&mut self) {
        let h = self.spacing;
        let near: Vec<(usize, f32)> = (0..self.values.len())
            .into_par_iter()
            .filter_map(|i| self.is_beside_zero(i).then(|| (i, self.distance_beside_zero(i))))
            .collect();
        let mut distance = vec![f32::INFINITY; self.values.len()];
        let mut fixed = vec![false; self.values.len()];
        for &(i, value) in &near {
            distance[i] = value.abs().min(2.0 * h);
            fixed[i] = true;
        }
        for round in 0..8 * ROUNDS {
            sweep(self.side as usize, h, &fixed, &mut distance, round % 8);
        }
        let far = 3f32.sqrt() * h * self.side as f32;
        self.values.par_iter_mut().zip(distance).for_each(|(value, d)| *value = d.min(far).copysign(*value));
    }

    /// Whether a neighbor of the vertex has the other sign.
    fn is_beside_zero(&self, i: usize) -> bool {
        let vertex = self.vertex(i);
        let inside = self.values[i].is_sign_negative();
        let side = self.side as usize;
        [1, side, side * side].into_iter().enumerate().any(|(axis, stride)| {
            let differs = |j: usize| self.values[j].is_sign_negative() != inside;
            (vertex[axis] > 0 && differs(i - stride)) || (vertex[axis] + 1 < self.side && differs(i + stride))
        })
    }

    fn distance_beside_zero(&self, i: usize) -> f32 {
        let length = self.vertex_gradient(self.vertex(i)).length();
        self.values[i] / length.clamp(GRADIENT_RANGE.0, GRADIENT_RANGE.1)
    }

    /// The same field on a grid of `cells` cells per side over the same cube.
    pub fn resampled(&self, cells: u32) -> Self {
        let half = 0.5 * self.spacing * (self.side - 1) as f32;
        let center = self.origin + glam::Vec3::splat(half);
        Self::from_fn(center, half, cells, |point| self.value(point))
    }
}

/// One Gauss–Seidel sweep; the bits of `direction` select the axes that are traversed backward.
fn sweep(side: usize, h: f32, fixed: &[bool], distance: &mut [f32], direction: usize) {
    let run = |axis: usize, k: usize| if direction >> axis & 1 == 0 { k } else { side - 1 - k };
    for kz in 0..side {
        for ky in 0..side {
            for kx in 0..side {
                let at = [run(0, kx), run(1, ky), run(2, kz)];
                let i = at[0] + side * (at[1] + side * at[2]);
                if !fixed[i] {
                    let solved = eikonal(nearest_neighbors(side, distance, i, at), h);
                    distance[i] = distance[i].min(solved);
                }
            }
        }
    }
}

/// The smaller neighbor along each axis.
#[inline]
fn nearest_neighbors(side: usize, distance: &[f32], i: usize, at: [usize; 3]) -> [f32; 3] {
    let strides = [1, side, side * side];
    std::array::from_fn(|axis| {
        let low = if at[axis] > 0 { distance[i - strides[axis]] } else { f32::INFINITY };
        let high = if at[axis] + 1 < side { distance[i + strides[axis]] } else { f32::INFINITY };
        low.min(high)
    })
}

/// The solution of Σ max(x − aᵢ, 0)² = h².
#[inline]
fn eikonal(mut a: [f32; 3], h: f32) -> f32 {
    if a[0] > a[1] {
        a.swap(0, 1);
    }
    if a[1] > a[2] {
        a.swap(1, 2);
    }
    if a[0] > a[1] {
        a.swap(0, 1);
    }
    let one = a[0] + h;
    if one <= a[1] {
        return one;
    }
    let two = 0.5 * (a[0] + a[1] + (2.0 * h * h - (a[0] - a[1]) * (a[0] - a[1])).max(0.0).sqrt());
    if two <= a[2] {
        return two;
    }
    let sum = a[0] + a[1] + a[2];
    let squares = a[0] * a[0] + a[1] * a[1] + a[2] * a[2];
    (sum + (sum * sum - 3.0 * (squares - h * h)).max(0.0).sqrt()) / 3.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    #[test]
    fn a_distorted_ball_becomes_a_distance_and_stays_where_it_is() {
        let exact = |p: Vec3| p.length() - 0.6;
        let mut grid =
            SdfGrid::from_fn(Vec3::ZERO, 1.0, 48, |p| exact(p) * (1.5 + 0.8 * p.x) + exact(p).powi(3));
        grid.redistance();
        for (i, value) in grid.values.iter().enumerate() {
            let truth = exact(grid.position(grid.vertex(i)));
            let limit = if truth.abs() < 2.0 * grid.spacing { 0.1 * grid.spacing } else { grid.spacing };
            // At the center all directions are equally near: the sweeps smooth the singularity.
            if truth > -0.45 {
                assert!((value - truth).abs() < limit, "{value} {truth}");
            }
        }
    }

    #[test]
    fn a_distance_field_is_left_alone() {
        let mut grid = SdfGrid::from_fn(Vec3::ZERO, 1.0, 32, |p| p.dot(Vec3::new(0.6, 0.8, 0.0)) - 0.1);
        let before = grid.clone();
        grid.redistance();
        // Near the corners the nearest point of the plane lies outside the grid.
        let inner =
            (0..grid.values.len()).filter(|&i| grid.position(grid.vertex(i)).abs().max_element() < 0.4);
        let worst = inner.map(|i| (grid.values[i] - before.values[i]).abs()).fold(0.0, f32::max);
        assert!(worst < 0.3 * grid.spacing, "{worst}");
    }
}
