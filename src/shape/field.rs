//! The SDF as parameters: bricks of 8 × 8 × 8 values near the surface are entities, the whole field a resource.

use crate::checkpoint::packed::{array, from_bytes, sparse, to_bytes};
use crate::checkpoint::{Span, keep_pool, keep_resource, keep_with};
use crate::error::{Error, Result};
use crate::pipeline::pool::pool_index;
use crate::sdf::SdfGrid;
use crate::sdf::volume::SdfSurface;
use crate::shape::field_adjoint::FieldAdjoint;
use bevy_ecs::prelude::{Component, Resource, World};
use glam::{UVec3, Vec3, Vec4};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Vertices per side of a brick.
pub(crate) const BRICK_SIDE: u32 = 8;
/// Vertices of a brick.
pub(crate) const BRICK_LEN: usize = 512;
/// Distance from the zero level, in cells, within which values are optimized.
pub(crate) const BAND_CELLS: f32 = 3.0;

pool_index! {
    /// Row of a brick.
    BrickIndex("brick");
}

/// Lowest vertex of a brick.
#[derive(Component, Clone, Copy, Debug, PartialEq, Eq)]
pub struct BrickAt(pub UVec3);

/// A brick's values, world units; those outside the grid are not used.
#[derive(Component, Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct BrickValues(#[serde(with = "array")] pub [f32; BRICK_LEN]);

/// Gradient of the loss with respect to a brick's values.
#[derive(Component, Clone, Copy, Debug, PartialEq)]
pub struct BrickGradient(pub [f32; BRICK_LEN]);

/// Running mean of a brick's gradient.
#[derive(Component, Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct BrickMoments(#[serde(with = "array")] pub [f32; BRICK_LEN]);

/// The field as the Trace stage reads it, and its adjoints.
#[derive(Resource, Clone, Debug)]
pub struct SdfField {
    /// Distances and texels.
    pub surface: SdfSurface,
    /// Adjoints at the vertices.
    pub adjoint: FieldAdjoint,
    /// Two values per vertex, for smoothing; 0 at those that no brick holds.
    pub scratch: [Vec<f32>; 2],
    /// Running mean square of the gradient.
    pub mean_square: f32,
}

impl SdfField {
    /// A field without adjoints.
    pub fn new(surface: SdfSurface) -> Self {
        let adjoint = FieldAdjoint::zeros(&surface.grid);
        let blank = vec![0.0; surface.grid.values.len()];
        Self { surface, adjoint, scratch: [blank.clone(), blank], mean_square: 0.0 }
    }
}

/// The squared error of the model, summed at the vertices of a grid around the surface points of samples. Errors are of luminance with
/// the curve of sRGB, as patches of photographs are compared.
#[derive(Resource, Clone, Debug, Serialize, Deserialize)]
pub struct ModelError {
    /// The grid, without its values.
    pub grid: SdfGrid,
    /// Sums of weighted squared errors and of weights.
    #[serde(with = "sparse")]
    pub sums: Vec<[f32; 2]>,
}

impl ModelError {
    /// Without samples.
    pub fn new(grid: &SdfGrid) -> Self {
        let lattice = SdfGrid { values: Vec::new(), ..*grid };
        Self { grid: lattice, sums: vec![[0.0; 2]; grid.values.len()] }
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

/// What of a field changes during a level: its texels lie still, and the scratch is written before it is read, but for zeros beside bricks. Values; adjoints, of which
/// bricks clear their own at every step, and read those beside them; the mean square.
type FieldState<V, A> = (V, A, f32);

/// Registers the field and its bricks as state.
pub(super) fn keep_field(world: &mut World) {
    keep_pool::<BrickIndex, BrickValues>(world, Span::Pass);
    keep_pool::<BrickIndex, BrickMoments>(world, Span::Pass);
    keep_resource::<ModelError>(world, Span::Pass);
    keep_with(world, "field", Span::Pass, save_field, load_field);
}

fn save_field(world: &mut World) -> Result<Option<Vec<u8>>> {
    let Some(SdfField { surface, adjoint, mean_square, .. }) = world.get_resource::<SdfField>() else {
        return Ok(None);
    };
    let state: FieldState<&Vec<f32>, &FieldAdjoint> = (&surface.grid.values, adjoint, *mean_square);
    to_bytes(&state).map(Some)
}

fn load_field(world: &mut World, bytes: &[u8]) -> Result<()> {
    let (values, adjoint, mean_square): FieldState<Vec<f32>, FieldAdjoint> = from_bytes(bytes)?;
    let field = world.get_resource_mut::<SdfField>();
    let field = field.filter(|field| field.surface.grid.values.len() == values.len());
    let mut field = field.ok_or_else(|| Error::run("resuming", "the checkpoint is of another field"))?;
    field.surface.grid.values = values;
    (field.adjoint, field.mean_square) = (adjoint, mean_square);
    Ok(())
}

/// The bricks with a value near the zero level, lowest first.
pub(crate) fn bricks_near_surface(grid: &SdfGrid) -> Vec<BrickAt> {
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

/// Hands each run of each brick its part of `dense`, which has one element per vertex of the grid. Bricks come lowest first, as
/// [`bricks_near_surface`] has them: those of one layer are written beside those of others.
pub(super) fn write_runs<T: Send>(
    grid: &SdfGrid,
    at: &[BrickAt],
    dense: &mut [T],
    write: impl Fn(usize, VertexRun, &mut [T]) + Sync,
) {
    let plane = (grid.side * grid.side) as usize;
    let layers = dense.par_chunks_mut(plane * BRICK_SIDE as usize).enumerate();
    layers.for_each(|(layer, part)| {
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

impl BrickValues {
    /// The brick's part of the grid.
    pub fn of(grid: &SdfGrid, at: BrickAt) -> Self {
        let mut values = [0.0; BRICK_LEN];
        for run in at.runs(grid) {
            values[run.places()].copy_from_slice(&grid.values[run.rows()]);
        }
        Self(values)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bricks_hold_every_value_near_the_surface_once() {
        let grid = SdfGrid::from_fn(Vec3::ZERO, 1.0, 36, |p| p.length() - 0.95);
        let mut seen = vec![0; grid.values.len()];
        for at in bricks_near_surface(&grid) {
            let values = BrickValues::of(&grid, at);
            for run in at.runs(&grid) {
                for (place, row) in run.places().zip(run.rows()) {
                    seen[row] += 1;
                    assert_eq!(values.0[place], grid.values[row]);
                    let vertex = grid.vertex(row);
                    let inner = vertex.min_element() >= 2 && vertex.max_element() + 2 < grid.side;
                    assert!(inner || !run.interior);
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
}
