//! The inputs that all points of a call share, and the terms of points, computed one vector of points at a time.

use super::blocks::{block_rows, load};
use crate::brdf::SpecularValue;
use crate::lanes::{Lanes, MAX_LANES, Row};
use crate::lighting::LobeVisibility;
use crate::model::{PairModel, Terms};
use crate::sample::ShadePoint;
use fearless_simd::Simd;

/// The inputs that all points share.
pub struct Shared<'a, M> {
    pub model: M,
    pub specular: &'a SpecularValue,
    /// Blocks of [`block_rows`] rows.
    pub lobes: &'a [Row],
}

impl<M: PairModel> Shared<'_, M> {
    /// Number of lobes, padding included.
    pub(super) fn stride(&self) -> usize {
        self.lobes.len() / block_rows::<M>() * MAX_LANES
    }
}

/// Consecutive points of a call.
#[derive(Clone, Copy)]
pub struct Chunk<'a> {
    pub points: &'a [ShadePoint],
    /// Visibility of the lobes at these points; if `None`, all light reaches them.
    pub visibility: Option<LobeVisibility<'a>>,
}

/// The terms of a group of up to [`Lanes::LEN`] points, one point per lane.
pub(super) struct Prepared<S: Simd, M: PairModel> {
    terms: M::Point<Lanes<S>>,
    frozen: M::Frozen<Lanes<S>>,
}

impl<S: Simd, M: PairModel> Prepared<S, M> {
    /// The terms of the first of these points, as many as there are lanes.
    #[inline(always)]
    pub(super) fn new(simd: S, shared: &Shared<'_, M>, points: &[ShadePoint]) -> Self {
        // A lane without a point has zeros; its results are not read.
        let mut inputs = [Row::ZERO; 6];
        for (i, point) in points.iter().take(Lanes::<S>::LEN).enumerate() {
            for c in 0..3 {
                inputs[c].0[i] = point.normal[c];
                inputs[3 + c].0[i] = point.to_viewer[c];
            }
        }
        let three = |first: usize| std::array::from_fn(|c| load(simd, &inputs[first + c], 0));
        let roughness = Lanes::splat(simd, shared.specular.roughness);
        let (terms, frozen) = shared.model.prepare_point(three(0), three(3), roughness);
        Self { terms, frozen }
    }

    /// The terms of one point.
    #[inline(always)]
    pub(super) fn point(&self, lane: usize) -> (M::Point<f32>, M::Frozen<f32>) {
        (Terms::from_fn(|c| self.terms.at(c).lane(lane)), Terms::from_fn(|c| self.frozen.at(c).lane(lane)))
    }
}

/// A point's terms with the same value in every lane.
#[inline(always)]
pub(super) fn splat<S: Simd, M: PairModel>(simd: S, terms: &M::Point<f32>) -> M::Point<Lanes<S>> {
    Terms::from_fn(|c| Lanes::splat(simd, terms.at(c)))
}
