//! Redistancing of a field: fast sweeping (Zhao 2005) outward from the zero level.
//!
//! Values beside the zero level are divided by the length of the gradient there, which preserves
//! the level to first order; all others are solved from |∇φ| = 1 by Gauss–Seidel sweeps in the
//! eight diagonal directions. Only vertices with a neighbor that has changed are solved again (Bak,
//! McLaughlin and Renzi, "Some Improvements for the Fast Sweeping Method", 2010).

use crate::{parallel, sdf::SdfGrid};
use std::sync::atomic::{AtomicBool, AtomicU8, AtomicU32, Ordering::Relaxed};

/// Bounds on the length of the gradient that a value is divided by: gradients at creases are
/// inaccurate.
const GRADIENT_RANGE: (f32, f32) = (0.3, 3.0);
/// Rounds of all eight sweeps; two are enough except for fields with long winding paths.
const ROUNDS: usize = 2;
/// How far from the zero level [`SdfGrid::redistance_near`] solves, in cells.
const NEAR_CELLS: f32 = 8.0;
/// Rows of a task at least.
const TASK_ROWS: usize = 8;
/// Vertices of a task at least.
const TASK_VERTICES: usize = 1024;

impl SdfGrid {
    /// Replaces the values by distances to their zero level, which is preserved.
    pub fn redistance(&mut self) {
        let far = 3f32.sqrt() * self.spacing * self.side as f32;
        let solved = self.solved_within(f32::INFINITY);
        parallel::for_each_row((&mut *self.values, &*solved), TASK_VERTICES, |(value, distance)| {
            *value = distance_of(distance).min(far).copysign(*value);
        });
    }

    /// Redistances up to 8 cells (`NEAR_CELLS`) from the zero level, with less work, for a field of
    /// distances whose zero level has moved. The values beyond are reduced by the largest
    /// correction, but not below 8 cells, so that they are no more than the distance.
    pub fn redistance_near(&mut self) {
        let reach = NEAR_CELLS * self.spacing;
        let solved = self.solved_within(reach);
        let change = |(values, solved): (&[f32], &[AtomicU32])| {
            let all = values.iter().zip(solved.iter().map(distance_of));
            let known = all.filter(|(_, distance)| distance.is_finite());
            known.map(|(value, distance)| (distance - value.abs()).abs()).fold(0.0, f32::max)
        };
        let chunks = self.values.chunks(TASK_VERTICES).zip(solved.chunks(TASK_VERTICES));
        let most = parallel::map_items(chunks, change).into_iter().fold(0.0, f32::max);
        parallel::for_each_row((&mut *self.values, &*solved), TASK_VERTICES, |(value, distance)| {
            let distance = distance_of(distance);
            let distance = if distance.is_finite() { distance } else { (value.abs() - most).max(reach) };
            *value = distance.copysign(*value);
        });
    }

    /// Bits of the distances of the vertices to the zero level, up to `reach` and a cell beyond it;
    /// infinite farther away.
    fn solved_within(&self, reach: f32) -> Vec<AtomicU32> {
        let sweeps = Sweeps::new(self, reach);
        let is_open = |_: &usize| sweeps.open_rows.iter().any(|row| row.load(Relaxed));
        (0..8 * ROUNDS).take_while(is_open).for_each(|round| sweeps.sweep(round % 8));
        sweeps.distance
    }

    /// Resamples the field on a grid of `cells` cells per side over the same cube.
    pub fn resampled(&self, cells: u32) -> Self {
        let half = 0.5 * self.spacing * (self.side - 1) as f32;
        let center = self.origin + glam::Vec3::splat(half);
        Self::from_fn(center, half, cells, |point| self.value(point))
    }
}

/// A vertex: its index and its place along each axis.
#[derive(Clone, Copy)]
struct GridVertex {
    i: usize,
    at: [usize; 3],
}

impl GridVertex {
    fn new(side: usize, at: [usize; 3]) -> Self {
        Self { i: at[0] + side * (at[1] + side * at[2]), at }
    }

    /// The neighbors along an axis.
    #[inline]
    fn along(self, side: usize, axis: usize) -> [Option<Self>; 2] {
        let stride = [1, side, side * side][axis];
        let moved = |i: usize, place: usize| {
            let mut at = self.at;
            at[axis] = place;
            Self { i, at }
        };
        let place = self.at[axis];
        [
            (place > 0).then(|| moved(self.i - stride, place - 1)),
            (place + 1 < side).then(|| moved(self.i + stride, place + 1)),
        ]
    }

    /// All neighbors.
    #[inline]
    fn neighbors(self, side: usize) -> impl Iterator<Item = Self> {
        (0..3).flat_map(move |axis| self.along(side, axis)).flatten()
    }
}

/// States of a vertex: solved for, to be solved as a neighbor has come nearer, and beside the zero
/// level, which no sweep changes.
const CLOSED: u8 = 0;
const OPEN: u8 = 1;
const FIXED: u8 = 2;

/// Distances that are being solved. Threads write rows along x of which none reads another.
struct Sweeps {
    side: usize,
    spacing: f32,
    /// Distance beyond which neighbors are not solved.
    reach: f32,
    /// Bits of the distances.
    distance: Vec<AtomicU32>,
    state: Vec<AtomicU8>,
    /// Whether a vertex of a row may be open.
    open_rows: Vec<AtomicBool>,
}

fn distance_of(bits: &AtomicU32) -> f32 {
    f32::from_bits(bits.load(Relaxed))
}

impl Sweeps {
    /// Begins with the vertices beside the zero level.
    fn new(grid: &SdfGrid, reach: f32) -> Self {
        let (side, spacing) = (grid.side as usize, grid.spacing);
        let count = grid.values.len();
        let distance = (0..count).map(|_| AtomicU32::new(f32::INFINITY.to_bits())).collect();
        let state = (0..count).map(|_| AtomicU8::new(CLOSED)).collect();
        let open_rows = (0..side * side).map(|_| AtomicBool::new(false)).collect();
        let sweeps = Self { side, spacing, reach, distance, state, open_rows };
        // A neighbor has the other sign.
        let is_beside_zero = |place: &GridVertex| {
            let inside = grid.values[place.i].is_sign_negative();
            place.neighbors(side).any(|other| grid.values[other.i].is_sign_negative() != inside)
        };
        let row = |row: usize| {
            let places = (0..side).map(move |x| GridVertex::new(side, [x, row % side, row / side]));
            places.filter(is_beside_zero)
        };
        let near: Vec<GridVertex> = parallel::flat_map(side * side, TASK_ROWS, row);
        parallel::for_each_row(&*near, TASK_VERTICES, |place| {
            let length = grid.vertex_gradient(grid.vertex(place.i)).length();
            let distance = grid.values[place.i].abs() / length.clamp(GRADIENT_RANGE.0, GRADIENT_RANGE.1);
            let distance = distance.min(2.0 * spacing);
            sweeps.distance[place.i].store(distance.to_bits(), Relaxed);
            sweeps.state[place.i].store(FIXED, Relaxed);
        });
        parallel::for_each_row(&*near, TASK_VERTICES, |place| {
            sweeps.open_around(*place, sweeps.of(place.i));
        });
        sweeps
    }

    /// One Gauss–Seidel sweep; the bits of `direction` select the axes that are traversed backward.
    /// Rows whose places along y and z have the same sum do not read each other: they are solved at
    /// the same time.
    fn sweep(&self, direction: usize) {
        let side = self.side;
        let run = |axis: usize, k: usize| if direction >> axis & 1 == 0 { k } else { side - 1 - k };
        for wave in 0..2 * side - 1 {
            let places = wave.saturating_sub(side - 1)..side.min(wave + 1);
            let rows = places.map(|ky| [run(1, ky), run(2, wave - ky)]);
            let is_open = |[y, z]: &[usize; 2]| self.open_rows[y + side * z].swap(false, Relaxed);
            let rows: Vec<[usize; 2]> = rows.filter(is_open).collect();
            parallel::for_each_row(&*rows, TASK_ROWS, |[y, z]| {
                (0..side).for_each(|kx| self.solve(GridVertex::new(side, [run(0, kx), *y, *z])));
            });
        }
    }

    fn of(&self, i: usize) -> f32 {
        distance_of(&self.distance[i])
    }

    /// Solves for a vertex, if it is open.
    #[inline]
    fn solve(&self, place: GridVertex) {
        if self.state[place.i].load(Relaxed) != OPEN {
            return;
        }
        self.state[place.i].store(CLOSED, Relaxed);
        let nearest = |axis: usize| {
            let [low, high] =
                place.along(self.side, axis).map(|other| other.map_or(f32::INFINITY, |o| self.of(o.i)));
            low.min(high)
        };
        let solved = eikonal([nearest(0), nearest(1), nearest(2)], self.spacing);
        if solved < self.of(place.i) {
            self.distance[place.i].store(solved.to_bits(), Relaxed);
            self.open_around(place, solved);
        }
    }

    /// Opens the neighbors of a vertex that are farther than its distance.
    #[inline]
    fn open_around(&self, place: GridVertex, distance: f32) {
        if distance > self.reach {
            return;
        }
        for other in place.neighbors(self.side) {
            if self.of(other.i) > distance && self.state[other.i].load(Relaxed) == CLOSED {
                self.state[other.i].store(OPEN, Relaxed);
                self.open_rows[other.at[1] + self.side * other.at[2]].store(true, Relaxed);
            }
        }
    }
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

    /// A ball whose surface has moved by two cells; values farther away are as before.
    fn grown_ball() -> SdfGrid {
        let mut grid = SdfGrid::from_fn(Vec3::new(0.1, 0.0, 0.0), 1.0, 60, |p| p.length() - 0.5);
        let h = grid.spacing;
        grid.values.iter_mut().for_each(|value| *value -= 2.0 * h * (1.0 - value.abs() / (4.0 * h)).max(0.0));
        grid
    }

    #[test]
    fn near_the_surface_less_work_gives_the_same_and_beyond_no_more() {
        let (mut near, mut whole) = (grown_ball(), grown_ball());
        near.redistance_near();
        whole.redistance();
        let reach = NEAR_CELLS * near.spacing;
        let mut beyond = 0;
        for (value, whole) in near.values.iter().zip(&whole.values) {
            assert_eq!(value.is_sign_negative(), whole.is_sign_negative());
            if whole.abs() < reach {
                assert!((value - whole).abs() < 1e-6, "{value} {whole}");
            } else {
                assert!(value.abs() >= reach && value.abs() <= whole.abs() + 1e-6, "{value} {whole}");
                beyond += 1;
            }
        }
        assert!(beyond > 1000);
    }

    #[test]
    fn bits_do_not_depend_on_the_number_of_threads() {
        let solved = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let mut grid = grown_ball();
            pool.install(|| grid.redistance());
            grid
        };
        assert_eq!(solved(1), solved(3));
    }
}
