//! The loop over all lobes for one point, one vector at a time.

use super::blocks::{LobeVector, block_rows, load_lobes};
use super::cull::{Picked, survivors};
use super::prepared::{Prepared, Shared, splat};
use crate::lanes::{Lanes, MAX_LANES};
use crate::lobe::Shape;
use crate::model::{BOTH, DIFFUSE, PairModel, Part};
use crate::real::Vec3Of;
use crate::sample::ShadePoint;
use fearless_simd::Simd;

/// Work on the lobes of one point, one vector at a time. This is a trait, because vector arithmetic in a closure
/// is compiled without the selected instruction set.
pub(super) trait Visit<S: Simd, M: PairModel> {
    /// Processes the part `PART` of the lobes at position `at` of block `b`.
    fn block<const PART: Part>(&mut self, b: usize, at: usize, lobe: &LobeVector<S, M>);
    /// Processes the specular part of lobes selected by index.
    fn picked(&mut self, index: &[usize], shape: &Shape<Lanes<S>>, amplitude: Vec3Of<Lanes<S>>);
}

/// Passes all lobes to a visitor; for a model that culls, only the specular parts that are not negligible.
#[inline(always)]
pub(super) fn walk<S: Simd, M: PairModel>(
    simd: S,
    shared: &Shared<'_, M>,
    terms: &M::Point<Lanes<S>>,
    visitor: &mut impl Visit<S, M>,
) {
    let blocks = shared.lobes.chunks_exact(block_rows::<M>());
    if !M::CULLS {
        for (b, block) in blocks.enumerate() {
            for at in (0..MAX_LANES).step_by(Lanes::<S>::LEN) {
                visitor.block::<BOTH>(b, at, &load_lobes::<S, M>(simd, block, at));
            }
        }
        return;
    }
    let reach = shared.model.reach(terms);
    let mut picked = Picked::new();
    let last = blocks.len();
    for (b, block) in blocks.enumerate() {
        for at in (0..MAX_LANES).step_by(Lanes::<S>::LEN) {
            visitor.block::<DIFFUSE>(b, at, &load_lobes::<S, M>(simd, block, at));
            let mut bits = survivors::<S, M>(simd, &reach, block, at);
            let ends = b + 1 == last && at + Lanes::<S>::LEN == MAX_LANES;
            loop {
                while bits != 0 && picked.count < Lanes::<S>::LEN {
                    picked.push(block, b * MAX_LANES, at + bits.trailing_zeros() as usize);
                    bits &= bits - 1;
                }
                let full = picked.count == Lanes::<S>::LEN;
                if !(full || ends && picked.count > 0) {
                    break;
                }
                let (shape, amplitude) = picked.vector(simd);
                visitor.picked(&picked.index[..picked.count], &shape, amplitude);
                picked.count = 0;
            }
        }
    }
}

/// Number of pairs whose specular part a model that culls evaluates.
#[inline(always)]
pub fn count_kept<S: Simd, M: PairModel>(simd: S, shared: &Shared<'_, M>, points: &[ShadePoint]) -> usize {
    let mut kept = 0;
    for point in points.iter().filter(|point| !point.is_missed()) {
        let (terms, _) = Prepared::<S, M>::new(simd, shared, std::slice::from_ref(point)).point(0);
        let reach = shared.model.reach(&splat::<S, M>(simd, &terms));
        for block in shared.lobes.chunks_exact(block_rows::<M>()) {
            for at in (0..MAX_LANES).step_by(Lanes::<S>::LEN) {
                kept += survivors::<S, M>(simd, &reach, block, at).count_ones() as usize;
            }
        }
    }
    kept
}
