//! The loop over all lobes for one point, one vector at a time.

use super::blocks::{LobeVector, block_rows, load_lobes};
use super::cull::{BATCH, Gathered, Picked, survivors};
use super::prepared::{Prepared, Shared, splat};
use crate::lanes::{Lanes, MAX_LANES};
use crate::model::{BOTH, DIFFUSE, NARROW, PairModel, Part, SPECULAR};
use crate::sample::ShadePoint;
use fearless_simd::Simd;

/// Work on the lobes of one point, one vector at a time. This is a trait, because vector arithmetic in a closure
/// is compiled without the selected instruction set.
pub(super) trait Visit<S: Simd, M: PairModel> {
    /// Processes the part `PART` of the lobes at position `at` of block `b`; returns their irradiance before visibility, for unit
    /// amplitude.
    fn block<const PART: Part>(&mut self, b: usize, at: usize, lobe: &LobeVector<S, M>) -> Lanes<S>;
    /// Processes the specular part `PART` of a vector of selected lobes.
    fn picked<const PART: Part>(&mut self, lobes: &Gathered<'_, S>, placed: &M::Placed<Lanes<S>>);
}

/// Passes all lobes to a visitor; for a model that culls, only the specular parts that are not negligible.
#[inline(always)]
pub(super) fn walk<S: Simd, M: PairModel>(
    simd: S,
    shared: &Shared<'_, M>,
    terms: &M::Point<Lanes<S>>,
    picked: &mut [Picked; 2],
    visitor: &mut impl Visit<S, M>,
) {
    if !M::CULLS {
        for (b, block) in shared.lobes.chunks_exact(block_rows::<M>()).enumerate() {
            for at in (0..MAX_LANES).step_by(Lanes::<S>::LEN) {
                visitor.block::<BOTH>(b, at, &load_lobes::<S, M>(simd, block, at));
            }
        }
        return;
    }
    let reach = shared.model.reach(terms);
    let mut index = Lanes::counting(simd);
    for (batch, lobes) in shared.lobes.chunks(BATCH * block_rows::<M>()).enumerate() {
        for (b, block) in lobes.chunks_exact(block_rows::<M>()).enumerate() {
            for at in (0..MAX_LANES).step_by(Lanes::<S>::LEN) {
                let lobe = load_lobes::<S, M>(simd, block, at);
                let irradiance = visitor.block::<DIFFUSE>(batch * BATCH + b, at, &lobe);
                let [wide, narrow] =
                    survivors::<S, M>(simd, shared.model, terms, &reach, block, at, irradiance);
                picked[0].push(index, wide);
                if M::HAS_NARROW {
                    picked[1].push(index, narrow);
                }
                index += Lanes::splat(simd, Lanes::<S>::LEN as f32);
            }
        }
        process::<S, M, SPECULAR>(simd, shared, terms, &mut picked[0], visitor);
        if M::HAS_NARROW {
            process::<S, M, NARROW>(simd, shared, terms, &mut picked[1], visitor);
        }
    }
}

/// Passes the selected lobes to a visitor, and selects none.
///
/// Placing nodes is one chain of dependent operations, so it is done for two vectors together.
#[inline(always)]
fn process<S: Simd, M: PairModel, const PART: Part>(
    simd: S,
    shared: &Shared<'_, M>,
    terms: &M::Point<Lanes<S>>,
    picked: &mut Picked,
    visitor: &mut impl Visit<S, M>,
) {
    let model = shared.model;
    for indices in picked.vectors::<S>() {
        let (one, two) = indices.split_at(indices.len().min(Lanes::<S>::LEN));
        let mut lobes = [Gathered::new::<M>(simd, shared.lobes, one); 2];
        let placed = if two.is_empty() {
            let only = model.place::<_, PART>(terms, &lobes[0].shape());
            [only, only]
        } else {
            lobes[1] = Gathered::new::<M>(simd, shared.lobes, two);
            model.place_two::<_, PART>(terms, [&lobes[0].shape(), &lobes[1].shape()])
        };
        // A loop, so that there is one copy of the code.
        for (lobes, placed) in lobes.iter().zip(&placed).take(if two.is_empty() { 1 } else { 2 }) {
            visitor.picked::<PART>(lobes, placed);
        }
    }
    picked.count = 0;
}

/// Number of pairs whose specular part a model that culls evaluates.
#[inline(always)]
pub fn count_kept<S: Simd, M: PairModel>(simd: S, shared: &Shared<'_, M>, points: &[ShadePoint]) -> usize {
    let mut kept = 0;
    for point in points.iter().filter(|point| !point.is_missed()) {
        let (terms, _) = Prepared::<S, M>::new(simd, shared, std::slice::from_ref(point)).point(0);
        let terms = splat::<S, M>(simd, &terms);
        let reach = shared.model.reach(&terms);
        for block in shared.lobes.chunks_exact(block_rows::<M>()) {
            for at in (0..MAX_LANES).step_by(Lanes::<S>::LEN) {
                let lobe = load_lobes::<S, M>(simd, block, at);
                let response = shared.model.evaluate::<_, DIFFUSE>(&terms, &lobe.shape, &lobe.terms);
                let [wide, narrow] =
                    survivors::<S, M>(simd, shared.model, &terms, &reach, block, at, response.diffuse);
                kept += (wide | narrow).count_ones() as usize;
            }
        }
    }
    kept
}
