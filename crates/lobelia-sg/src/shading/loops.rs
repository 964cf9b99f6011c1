//! The loops of one closed form over a chunk of points, behind a trait object: threads and sums are
//! compiled once, and the loops of every form once per instruction set.

use super::blocks::{Chunk, Shared, prepare_lobes};
use super::{adjoint::adjoint_chunk, forward::shade_chunk, respond::respond_chunk};
use crate::columns::{Layers, LobeColumns, PointAdjoint, RadianceColumns, ShadePoint};
use crate::{dispatch, lanes::Row, model::PairModel};

/// The loops of one closed form.
pub(crate) trait Kernels: Sync {
    /// Regroups lobes into blocks and adds the terms that the formulas need for each lobe.
    fn prepare_lobes(&self, lobes: &LobeColumns, out: &mut Vec<Row>);
    /// Radiance of a chunk of points.
    fn shade(&self, shared: Shared<'_, ()>, chunk: Chunk<'_>, out: &mut [Layers]);
    /// Adjoint of a chunk of points; adds the adjoints of shared parameters to `partial`.
    fn pull_back(
        &self,
        shared: Shared<'_, ()>,
        chunk: Chunk<'_>,
        radiance: RadianceColumns<'_>,
        out: &mut [PointAdjoint],
        partial: &mut [Row],
    );
    /// Responses of points to each lobe of unit amplitude.
    fn respond(&self, shared: Shared<'_, ()>, points: &[ShadePoint], out: &mut [f32]);
}

/// Radiance by the formulas of the first model, adjoints and responses by those of the second: the
/// same one, or one that has the same terms of a lobe, differs in the number of nodes alone, and is
/// compiled anyway.
pub(crate) struct Loops<F, M>(pub F, pub M);

impl<F: PairModel, M: PairModel> Kernels for Loops<F, M> {
    fn prepare_lobes(&self, lobes: &LobeColumns, out: &mut Vec<Row>) {
        prepare_all(self.1, lobes, out);
    }

    fn shade(&self, shared: Shared<'_, ()>, chunk: Chunk<'_>, out: &mut [Layers]) {
        let shared = shared.by(self.0);
        dispatch!(simd => shade_chunk(simd, &shared, chunk, out));
    }

    fn pull_back(
        &self,
        shared: Shared<'_, ()>,
        chunk: Chunk<'_>,
        radiance: RadianceColumns<'_>,
        out: &mut [PointAdjoint],
        partial: &mut [Row],
    ) {
        pull_back(&shared.by(self.1), chunk, radiance, out, partial);
    }

    fn respond(&self, shared: Shared<'_, ()>, points: &[ShadePoint], out: &mut [f32]) {
        respond(&shared.by(self.1), points, out);
    }
}

// Functions of the second model alone, so that they are compiled once for it.

#[inline(never)]
fn prepare_all<M: PairModel>(model: M, lobes: &LobeColumns, out: &mut Vec<Row>) {
    dispatch!(simd => prepare_lobes(simd, model, lobes, out));
}

#[inline(never)]
fn pull_back<M: PairModel>(
    shared: &Shared<'_, M>,
    chunk: Chunk<'_>,
    radiance: RadianceColumns<'_>,
    out: &mut [PointAdjoint],
    partial: &mut [Row],
) {
    dispatch!(simd => adjoint_chunk(simd, shared, chunk, radiance, out, partial));
}

#[inline(never)]
fn respond<M: PairModel>(shared: &Shared<'_, M>, points: &[ShadePoint], out: &mut [f32]) {
    dispatch!(simd => respond_chunk(simd, shared, points, out));
}
