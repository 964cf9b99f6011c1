//! The SDF as parameters: all its values, and bricks of 8 × 8 × 8 of them near the surface, which
//! move.
//!
//! A sample's normal is that of the interpolated central differences, so its adjoint is propagated
//! to the gradients at eight vertices first, and from there by one divergence stencil to the
//! values. The position moves along its ray as the values change (implicit differentiation; IDR eq.
//! 3, Niemeyer et al. 2020): dx/dφ = −d / (∇φ·d).

use bevy_ecs::prelude::Resource;
use glam::{UVec3, Vec3, Vec4};
use lobelia_geometry::parallel;
use lobelia_geometry::sdf::{SdfGrid, volume::SdfSurface};

pub(crate) const BRICK_SIDE: u32 = 8;
pub(crate) const BRICK_LEN: usize = 512;
/// Distance from the zero level, in cells, within which values are optimized.
pub(crate) const BAND_CELLS: f32 = 3.0;
/// Lower bound of |∇φ·d| in the adjoint of a position, because the derivative is unbounded at
/// grazing rays.
const LEAST_DERIVATIVE: f32 = 0.15;

/// Lowest vertex of a brick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BrickAt(pub UVec3);

/// The field as the Trace stage reads it, and its adjoints.
#[derive(Resource, Clone, Debug)]
pub struct SdfField {
    /// Distances and texels.
    pub surface: SdfSurface,
    /// Adjoints at the vertices.
    pub adjoint: FieldAdjoint,
    /// Two values per vertex, for smoothing; the second is the gradient of a step; 0 at those that
    /// no brick holds.
    pub scratch: [Vec<f32>; 2],
    /// Running mean square of the gradient.
    pub mean_square: f32,
    /// The bricks, lowest first.
    pub bricks: Vec<BrickAt>,
    /// Running means of their gradients.
    pub moments: Vec<[f32; BRICK_LEN]>,
}

impl SdfField {
    /// A field without adjoints.
    pub fn new(surface: SdfSurface) -> Self {
        let adjoint = FieldAdjoint::zeros(&surface.grid);
        let blank = vec![0.0; surface.grid.values.len()];
        let bricks = bricks_near_surface(&surface.grid);
        let moments = vec![[0.0; BRICK_LEN]; bricks.len()];
        Self { surface, adjoint, scratch: [blank.clone(), blank], mean_square: 0.0, bricks, moments }
    }
}

/// The squared error of the model, summed at the vertices of a grid around the surface points of
/// samples. Errors are of luminance with the curve of sRGB, as patches of photographs are compared.
#[derive(Resource, Clone, Debug)]
pub struct ModelError {
    /// The grid, without its values.
    pub grid: SdfGrid,
    /// Sums of weighted squared errors and of weights.
    pub sums: Vec<[f32; 2]>,
}

/// The sums of a [`ModelError`] that are not zero, with their vertices.
pub(super) type ErrorRows = Vec<(u32, [f32; 2])>;

impl ModelError {
    /// Without samples.
    pub fn new(grid: &SdfGrid) -> Self {
        let lattice = SdfGrid { values: Vec::new(), ..*grid };
        Self { grid: lattice, sums: vec![[0.0; 2]; grid.values.len()] }
    }

    /// The sums that are not zero, with their vertices: few, for a checkpoint.
    pub(super) fn rows(&self) -> ErrorRows {
        (0..).zip(self.sums.iter().copied()).filter(|(_, sum)| *sum != [0.0; 2]).collect()
    }

    /// The sums of a grid that were kept as [rows](Self::rows); those beyond it are left out.
    pub(super) fn of_rows(grid: &SdfGrid, rows: ErrorRows) -> Self {
        let mut error = Self::new(grid);
        for (row, sum) in rows {
            error.sums.get_mut(row as usize).into_iter().for_each(|kept| *kept = sum);
        }
        error
    }

    /// Adds a sample.
    pub fn add(&mut self, point: Vec3, squared: f32) {
        for (row, weight) in self.grid.corners(point) {
            let sum = &mut self.sums[row];
            *sum = [sum[0] + weight * squared, sum[1] + weight];
        }
    }

    /// The sums of squared errors and of weights around a point.
    pub fn around(&self, point: Vec3) -> (f32, f32) {
        let corners = self.grid.corners(point).into_iter();
        corners.fold((0.0, 0.0), |(error, count), (row, weight)| {
            (error + weight * self.sums[row][0], count + weight * self.sums[row][1])
        })
    }
}

/// The bricks with a value near the zero level, lowest first.
fn bricks_near_surface(grid: &SdfGrid) -> Vec<BrickAt> {
    let bricks = grid.side.div_ceil(BRICK_SIDE);
    let reach = BAND_CELLS * grid.spacing;
    let near = |at: &BrickAt| {
        at.runs(grid).any(|run| grid.values[run.rows()].iter().any(|value| value.abs() < reach))
    };
    let all = (0..bricks * bricks * bricks)
        .map(|i| BrickAt(BRICK_SIDE * UVec3::new(i % bricks, i / bricks % bricks, i / (bricks * bricks))));
    all.filter(near).collect()
}

/// Vertices of a brick that are consecutive in the grid.
#[derive(Clone, Copy, Debug)]
pub struct VertexRun {
    /// Index of the first in the brick.
    pub place: usize,
    /// Index of the first in the grid.
    pub row: usize,
    /// Number of vertices.
    pub len: usize,
    /// Whether they are at least two vertices away from the grid's border.
    pub interior: bool,
}

impl VertexRun {
    /// The indices in the grid.
    pub fn rows(&self) -> std::ops::Range<usize> {
        self.row..self.row + self.len
    }

    /// The run's part of `dense`, which has one value per vertex of the grid.
    #[inline(always)]
    pub(super) fn of(&self, dense: &[f32]) -> RunValues {
        let part = &dense[self.rows()];
        if self.len == BRICK_SIDE as usize {
            return each(|half| Vec4::from_slice(&part[4 * half..]));
        }
        let at = |k: usize| part.get(k).copied().unwrap_or(0.0);
        each(|half| Vec4::from_array(std::array::from_fn(|k| at(4 * half + k))))
    }

    /// Writes values to the run's part of a slice.
    #[inline(always)]
    pub(super) fn write(&self, values: RunValues, part: &mut [f32]) {
        if self.len == BRICK_SIDE as usize {
            (0..2).for_each(|half| values[half].write_to_slice(&mut part[4 * half..]));
        } else {
            part.iter_mut().zip(values.iter().flat_map(Vec4::as_ref)).for_each(|(to, value)| *to = *value);
        }
    }

    /// The indices in the brick.
    pub fn places(&self) -> std::ops::Range<usize> {
        self.place..self.place + self.len
    }
}

/// A value for each vertex of a run, in two halves; those beyond its length mean nothing.
pub(super) type RunValues = [Vec4; 2];

/// A run's values, half by half.
#[inline]
pub(super) fn each(half: impl FnMut(usize) -> Vec4) -> RunValues {
    std::array::from_fn(half)
}

/// Hands each run of each brick its part of `dense`, which has one element per vertex of the grid.
/// Bricks come lowest first, as [`bricks_near_surface`] has them: those of one layer are written
/// beside those of others.
pub(super) fn write_runs<T: Send>(
    grid: &SdfGrid,
    at: &[BrickAt],
    dense: &mut [T],
    write: impl Fn(usize, VertexRun, &mut [T]) + Sync,
) {
    let plane = (grid.side * grid.side) as usize;
    let layers = dense.chunks_mut(plane * BRICK_SIDE as usize).enumerate();
    parallel::for_each(layers, |(layer, part)| {
        let lowest = layer as u32 * BRICK_SIDE;
        let first = at.partition_point(|brick| brick.0.z < lowest);
        for (brick, at) in at.iter().enumerate().skip(first).take_while(|(_, at)| at.0.z == lowest) {
            for run in at.runs(grid) {
                let start = run.row - lowest as usize * plane;
                write(brick, run, &mut part[start..start + run.len]);
            }
        }
    });
}

impl BrickAt {
    /// The brick's vertices that are in the grid.
    pub fn runs(self, grid: &SdfGrid) -> impl Iterator<Item = VertexRun> + use<> {
        let (side, first) = (grid.side, grid.index(self.0));
        let len = BRICK_SIDE.min(side - self.0.x) as usize;
        let interior = self.0.min_element() >= 2 && self.0.max_element() + BRICK_SIDE + 2 <= side;
        (0..BRICK_SIDE * BRICK_SIDE).filter_map(move |i| {
            let (y, z) = (i % BRICK_SIDE, i / BRICK_SIDE);
            let inside = self.0.y + y < side && self.0.z + z < side;
            let row = first + (side * (y + side * z)) as usize;
            inside.then_some(VertexRun { place: (BRICK_SIDE * i) as usize, row, len, interior })
        })
    }
}

/// Adjoints at the vertices of an SDF.
#[derive(Clone, Debug, Default)]
pub struct FieldAdjoint {
    /// Adjoint of the values.
    pub value: Vec<f32>,
    /// Adjoint of the central differences at the vertices.
    pub gradient: Vec<Vec3>,
}

/// Adjoints of the field at a sample's surface point.
pub struct SampleAdjoint {
    position: Vec3,
    /// Adjoint of the interpolated central differences.
    gradient: Vec3,
    value: f32,
}

impl SampleAdjoint {
    /// From the adjoints of the unit normal at `position` and of the position itself, where a ray
    /// of direction `direction` meets the surface.
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

    /// The adjoint of the value at index `row`, central differences included. `interior` means that
    /// the vertex is at least two vertices away from the border, so that no difference is
    /// one-sided.
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
    use lobelia_sg::ray::Ray;

    fn is_interior(grid: &SdfGrid, row: usize) -> bool {
        let vertex = grid.vertex(row);
        vertex.min_element() >= 2 && vertex.max_element() + 2 < grid.side
    }

    #[test]
    fn bricks_hold_every_value_near_the_surface_once() {
        let grid = SdfGrid::from_fn(Vec3::ZERO, 1.0, 36, |p| p.length() - 0.95);
        let mut seen = vec![0; grid.values.len()];
        for at in bricks_near_surface(&grid) {
            let mut places = [false; BRICK_LEN];
            for run in at.runs(&grid) {
                for (place, row) in run.places().zip(run.rows()) {
                    seen[row] += 1;
                    assert!(!std::mem::replace(&mut places[place], true));
                    assert!(is_interior(&grid, row) || !run.interior);
                }
            }
        }
        let reach = BAND_CELLS * grid.spacing;
        assert!((0..seen.len()).all(|i| seen[i] == 1 || (seen[i] == 0 && grid.values[i].abs() >= reach)));
    }

    #[test]
    fn runs_are_read_and_written_as_they_lie() {
        let grid = SdfGrid::from_fn(Vec3::ZERO, 1.0, 20, |p| p.length() - 0.95);
        let at = bricks_near_surface(&grid);
        let mut copied = vec![f32::NAN; grid.values.len()];
        write_runs(&grid, &at, &mut copied, |brick, run, part| {
            assert!(at[brick].runs(&grid).any(|own| own.row == run.row));
            run.write(run.of(&grid.values), part);
        });
        let mut held = vec![false; grid.values.len()];
        at.iter().flat_map(|at| at.runs(&grid)).for_each(|run| held[run.rows()].fill(true));
        for (row, value) in copied.iter().enumerate() {
            assert!(if held[row] { *value == grid.values[row] } else { value.is_nan() });
        }
        assert!(held.contains(&true));
    }

    fn bumpy() -> SdfGrid {
        SdfGrid::from_fn(Vec3::ZERO, 1.0, 12, |p| {
            p.length() - 0.6 + 0.05 * (5.0 * p.x).sin() * (4.0 * p.y).cos()
        })
    }

    /// Compares every vertex's adjoint with central differences of `f` in that vertex's value.
    fn check(adjoint: &FieldAdjoint, f: impl Fn(&SdfGrid) -> f32, tolerance: f32) {
        let h = 1e-3;
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
        let (weight, grid) = (Vec3::new(0.3, -0.8, 0.5), bumpy());
        // Well inside, and at the border.
        for position in [Vec3::new(0.41, 0.33, -0.22), Vec3::new(0.97, -0.96, 0.99)] {
            let mut adjoint = FieldAdjoint::zeros(&grid);
            adjoint.add(&grid, &SampleAdjoint::new(&grid, position, Vec3::Z, weight, Vec3::ZERO));
            check(&adjoint, |g| g.gradient(position).normalize().dot(weight), 2e-3);
        }
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
        // The gradient of the trilinear value and the interpolated differences are not the same
        // number.
        check(&adjoint, |g| meets(g).dot(weight), 0.06);
    }
}
