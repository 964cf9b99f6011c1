//! Many points by many lobes: chunks over the threads, and sums in a fixed order.

use super::blocks::{Chunk, Shared};
use super::loops::{Kernels, Loops};
use super::respond::RESPONSE_ROWS;
use crate::columns::{
    ChunkSums, Layers, Lighting, LobeColumns, PointAdjoint, RadianceColumns, ShadePoint, SharedGradient,
};
use crate::{brdf::SpecularValue, lanes::Row, model::PairModel};
use rayon::prelude::*;
use std::cell::Cell;

/// Points that a thread processes at a time; also the chunk size of the fixed-order sums.
pub const CHUNK: usize = 256;

thread_local! {
    /// Buffers kept between calls, so that a step of a fit allocates nothing. They are taken out
    /// while in use, because a thread that waits for its own call may execute work of another call.
    static SCRATCH: Cell<Vec<Row>> = const { Cell::new(Vec::new()) };
    static SUMS: Cell<ChunkSums> = Cell::default();
}

/// Shades `points` by the formulas of `model`; `out` has their length.
pub fn shade_with<M: PairModel>(
    model: M,
    points: &[ShadePoint],
    specular: &SpecularValue,
    lighting: Lighting<'_>,
    out: &mut [Layers],
) {
    shade(&Loops(model, model), points, specular, lighting, out);
}

/// Propagates the adjoint of the radiance of each point back to the points and to the shared
/// parameters (not to the visibility), by the formulas of `model`. Where a channel is clamped to
/// zero, its adjoint is dropped. Overwrites `gradient` and reuses its memory.
pub fn shade_adjoint_with<M: PairModel>(
    model: M,
    points: &[ShadePoint],
    specular: &SpecularValue,
    lighting: Lighting<'_>,
    radiance: RadianceColumns<'_>,
    point_adjoint: &mut [PointAdjoint],
    gradient: &mut SharedGradient,
) {
    shade_adjoint(&Loops(model, model), points, specular, lighting, radiance, point_adjoint, gradient);
}

/// [`shade_with`], given the loops of a model.
pub(crate) fn shade(
    kernels: &dyn Kernels,
    points: &[ShadePoint],
    specular: &SpecularValue,
    lighting: Lighting<'_>,
    out: &mut [Layers],
) {
    assert_eq!(points.len(), out.len(), "one output per point");
    lighting.check(points.len());
    let mut scratch = SCRATCH.take();
    kernels.prepare_lobes(lighting.lobes, &mut scratch);
    let shared = Shared { model: (), specular, lobes: &scratch };
    let chunks = points.par_chunks(CHUNK).zip(out.par_chunks_mut(CHUNK));
    chunks.enumerate().for_each(|(i, (points, out))| {
        kernels.shade(shared, Chunk { points, visibility: lighting.chunk(i, CHUNK) }, out);
    });
    SCRATCH.set(scratch);
}

/// [`shade_adjoint_with`], given the loops of a model.
pub(crate) fn shade_adjoint(
    kernels: &dyn Kernels,
    points: &[ShadePoint],
    specular: &SpecularValue,
    lighting: Lighting<'_>,
    radiance: RadianceColumns<'_>,
    point_adjoint: &mut [PointAdjoint],
    gradient: &mut SharedGradient,
) {
    let mut sums = SUMS.take();
    shade_adjoint_in_chunks(kernels, points, specular, lighting, radiance, point_adjoint, &mut sums);
    sums.total_into(gradient);
    SUMS.set(sums);
}

/// [`shade_adjoint`] with the sums over each chunk of points instead of their total.
pub(crate) fn shade_adjoint_in_chunks(
    kernels: &dyn Kernels,
    points: &[ShadePoint],
    specular: &SpecularValue,
    lighting: Lighting<'_>,
    radiance: RadianceColumns<'_>,
    point_adjoint: &mut [PointAdjoint],
    sums: &mut ChunkSums,
) {
    let RadianceColumns { shaded, adjoint } = radiance;
    assert!(points.len() == shaded.len() && points.len() == adjoint.len(), "one value per point");
    assert_eq!(points.len(), point_adjoint.len(), "one output per point");
    lighting.check(points.len());
    let mut lobes = SCRATCH.take();
    kernels.prepare_lobes(lighting.lobes, &mut lobes);
    let shared = Shared { model: (), specular, lobes: &lobes };
    sums.reset(points.len().div_ceil(CHUNK), lighting.lobes.len());
    let rows = sums.rows_of_chunk();
    points
        .par_chunks(CHUNK)
        .zip(shaded.par_chunks(CHUNK).zip(adjoint.par_chunks(CHUNK)))
        .zip(point_adjoint.par_chunks_mut(CHUNK).zip(sums.rows.par_chunks_mut(rows)))
        .enumerate()
        .for_each(|(i, ((points, (shaded, adjoint)), (out, partial)))| {
            let chunk = Chunk { points, visibility: lighting.chunk(i, CHUNK) };
            kernels.pull_back(shared, chunk, RadianceColumns { shaded, adjoint }, out, partial);
        });
    SCRATCH.set(lobes);
}

/// Responses of points to each lobe, on this thread alone; see
/// [`ClosedForm::respond`](super::ClosedForm::respond).
pub(crate) fn respond(
    kernels: &dyn Kernels,
    points: &[ShadePoint],
    specular: &SpecularValue,
    lobes: &LobeColumns,
    out: &mut [f32],
) {
    assert_eq!(points.len() * RESPONSE_ROWS * lobes.stride(), out.len(), "four rows of lobes per point");
    let mut scratch = SCRATCH.take();
    kernels.prepare_lobes(lobes, &mut scratch);
    kernels.respond(Shared { model: (), specular, lobes: &scratch }, points, out);
    SCRATCH.set(scratch);
}
