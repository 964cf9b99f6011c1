//! The loops of one closed form over a chunk of points, behind a trait object: threads and sums are compiled once, and
//! the loops of every form once per instruction set.

use super::adjoint::adjoint_chunk;
use super::blocks::{Chunk, Shared, prepare_lobes};
use super::forward::shade_chunk;
use super::respond::respond_chunk;
use crate::brdf::SpecularValue;
use crate::columns::{Layers, LobeColumns, PointAdjoint, RadianceColumns, ShadePoint};
use crate::lanes::{Row, dispatch};
use crate::model::PairModel;

/// The inputs that all points of a call share, without the formulas.
#[derive(Clone, Copy)]
pub(crate) struct Inputs<'a> {
    /// The specular material.
    pub specular: &'a SpecularValue,
    /// From [`Kernels::prepare_lobes`].
    pub lobes: &'a [Row],
}

/// The loops of one closed form.
pub(crate) trait Kernels: Sync {
    /// Regroups lobes into blocks and adds the terms that the formulas need for each lobe.
    fn prepare_lobes(&self, lobes: &LobeColumns, out: &mut Vec<Row>);
    /// Radiance of a chunk of points.
    fn shade(&self, inputs: Inputs<'_>, chunk: Chunk<'_>, out: &mut [Layers]);
    /// Adjoint of a chunk of points; adds the adjoints of shared parameters to `partial`.
    fn pull_back(
        &self,
        inputs: Inputs<'_>,
        chunk: Chunk<'_>,
        radiance: RadianceColumns<'_>,
        out: &mut [PointAdjoint],
        partial: &mut [Row],
    );
    /// Responses of points to each lobe of unit amplitude.
    fn respond(&self, inputs: Inputs<'_>, points: &[ShadePoint], out: &mut [f32]);
}

/// The loops over the formulas of a model.
pub(crate) struct Loops<M>(pub M);

impl<M: PairModel> Loops<M> {
    fn shared<'a>(&self, inputs: Inputs<'a>) -> Shared<'a, M> {
        Shared { model: self.0, specular: inputs.specular, lobes: inputs.lobes }
    }
}

impl<M: PairModel> Kernels for Loops<M> {
    fn prepare_lobes(&self, lobes: &LobeColumns, out: &mut Vec<Row>) {
        dispatch!(simd => prepare_lobes(simd, self.0, lobes, out));
    }

    fn shade(&self, inputs: Inputs<'_>, chunk: Chunk<'_>, out: &mut [Layers]) {
        let shared = self.shared(inputs);
        dispatch!(simd => shade_chunk(simd, &shared, chunk, out));
    }

    fn pull_back(
        &self,
        inputs: Inputs<'_>,
        chunk: Chunk<'_>,
        radiance: RadianceColumns<'_>,
        out: &mut [PointAdjoint],
        partial: &mut [Row],
    ) {
        let shared = self.shared(inputs);
        dispatch!(simd => adjoint_chunk(simd, &shared, chunk, radiance, out, partial));
    }

    fn respond(&self, inputs: Inputs<'_>, points: &[ShadePoint], out: &mut [f32]) {
        let shared = self.shared(inputs);
        dispatch!(simd => respond_chunk(simd, &shared, points, out));
    }
}

/// Radiance by the formulas of `fine`, adjoints and responses by those of `M`, which are compiled anyway: both models have
/// the same terms of a lobe, and differ in the number of nodes alone.
pub(crate) struct FineLoops<F, M> {
    /// Shades.
    pub fine: Loops<F>,
    /// Everything else.
    pub coarse: Loops<M>,
}

impl<F: PairModel, M: PairModel> Kernels for FineLoops<F, M> {
    fn prepare_lobes(&self, lobes: &LobeColumns, out: &mut Vec<Row>) {
        self.coarse.prepare_lobes(lobes, out);
    }

    fn shade(&self, inputs: Inputs<'_>, chunk: Chunk<'_>, out: &mut [Layers]) {
        self.fine.shade(inputs, chunk, out);
    }

    fn pull_back(
        &self,
        inputs: Inputs<'_>,
        chunk: Chunk<'_>,
        radiance: RadianceColumns<'_>,
        out: &mut [PointAdjoint],
        partial: &mut [Row],
    ) {
        self.coarse.pull_back(inputs, chunk, radiance, out, partial);
    }

    fn respond(&self, inputs: Inputs<'_>, points: &[ShadePoint], out: &mut [f32]) {
        self.coarse.respond(inputs, points, out);
    }
}
