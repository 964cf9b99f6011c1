//! The SDF as parameters: bricks of 8 × 8 × 8 values near the surface are entities, the whole field a resource.

use super::adjoint::FieldAdjoint;
use crate::surface::sdf::SdfGrid;
use crate::surface::sdf::volume::SdfSurface;
use bevy_ecs::prelude::{Component, Resource};
use glam::UVec3;

/// Vertices a side of a brick.
pub const BRICK_SIDE: u32 = 8;
/// Vertices of a brick.
pub const BRICK_LEN: usize = 512;
/// Cells from the zero level within which values move.
pub const BAND_CELLS: f32 = 3.0;

/// Lowest vertex of a brick.
#[derive(Component, Clone, Copy, Debug, PartialEq, Eq)]
pub struct BrickAt(pub UVec3);

/// A brick's values, world units; those outside the grid are not used.
#[derive(Component, Clone, Copy, Debug, PartialEq)]
pub struct BrickValues(pub [f32; BRICK_LEN]);

/// Gradient of the loss with respect to a brick's values.
#[derive(Component, Clone, Copy, Debug, PartialEq)]
pub struct BrickGradient(pub [f32; BRICK_LEN]);

/// Running mean of a brick's gradient.
#[derive(Component, Clone, Copy, Debug, PartialEq)]
pub struct BrickMoments(pub [f32; BRICK_LEN]);

/// The field as the Trace stage reads it, and where adjoints are gathered.
#[derive(Resource, Clone, Debug)]
pub struct SdfField {
    /// Distances and texels.
    pub surface: SdfSurface,
    /// Adjoints at the vertices.
    pub adjoint: FieldAdjoint,
    /// A value a vertex, for smoothing.
    pub scratch: Vec<f32>,
    /// Running mean square of the gradient.
    pub mean_square: f32,
}

impl SdfField {
    /// A field without adjoints.
    pub fn new(surface: SdfSurface) -> Self {
        let adjoint = FieldAdjoint::zeros(&surface.grid);
        let scratch = vec![0.0; surface.grid.values.len()];
        Self { surface, adjoint, scratch, mean_square: 0.0 }
    }
}

/// The bricks that hold a value near the zero level, lowest first.
pub fn bricks_near_surface(grid: &SdfGrid) -> Vec<BrickAt> {
    let bricks = grid.side.div_ceil(BRICK_SIDE);
    let reach = BAND_CELLS * grid.spacing;
    let near = |at: &BrickAt| {
        vertices_of(grid, *at).any(|(_, vertex)| grid.values[grid.index(vertex)].abs() < reach)
    };
    let all = (0..bricks * bricks * bricks)
        .map(|i| BrickAt(BRICK_SIDE * UVec3::new(i % bricks, i / bricks % bricks, i / (bricks * bricks))));
    all.filter(near).collect()
}

/// The vertices of a brick that are in the grid, with their place in the brick.
pub fn vertices_of(grid: &SdfGrid, at: BrickAt) -> impl Iterator<Item = (usize, UVec3)> + use<> {
    let side = grid.side;
    (0..BRICK_LEN).filter_map(move |k| {
        let n = k as u32;
        let vertex = at.0 + UVec3::new(n % 8, n / 8 % 8, n / 64);
        (vertex.max_element() < side).then_some((k, vertex))
    })
}

impl BrickValues {
    /// The brick's part of the grid.
    pub fn of(grid: &SdfGrid, at: BrickAt) -> Self {
        let mut values = [0.0; BRICK_LEN];
        for (k, vertex) in vertices_of(grid, at) {
            values[k] = grid.values[grid.index(vertex)];
        }
        Self(values)
    }
}
