//! The loop over all lobes for one point, one vector at a time.

use super::blocks::{LobeVector, Shared, block_rows, load_lobes};
use super::cull::{BATCH, Gathered, Picked, PickedByRule, survivors};
use crate::lanes::{Lanes, MAX_LANES};
use crate::model::{BOTH, DIFFUSE, NARROW, PairModel, Part, RULES, SMOOTH, SPECULAR};
use crate::sg::Dual;
use fearless_simd::Simd;

/// Work on the lobes of one point, one vector at a time. This is a trait, because vector arithmetic
/// in a closure is compiled without the selected instruction set.
pub(super) trait Visit<S: Simd, M: PairModel> {
    /// Whether the visitor needs the derivatives of the irradiance.
    const ADJOINT: bool = false;
    /// Processes the part `PART` of the lobes at position `at` of block `b`.
    fn block<const PART: Part>(&mut self, b: usize, at: usize, lobe: &LobeVector<S, M>);
    /// Processes the specular part `PART` of a vector of selected lobes.
    fn picked<const PART: Part>(&mut self, lobes: &Gathered<'_, S>, placed: &M::Placed<Lanes<S>>);
}

/// Passes all lobes to a visitor; for a model that culls, only the specular parts that are not
/// negligible.
#[inline(always)]
pub(super) fn walk<S: Simd, M: PairModel, V: Visit<S, M>>(
    simd: S,
    shared: &Shared<'_, M>,
    terms: &M::Point<Lanes<S>>,
    picked: &mut PickedByRule,
    visitor: &mut V,
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
                visitor.block::<DIFFUSE>(batch * BATCH + b, at, &lobe);
                // The compiler takes this from what the visitor has computed.
                let irradiance = shared.model.irradiance(terms, &lobe.shape, &lobe.terms);
                let kept = survivors::<S, M>(simd, shared.model, terms, &reach, block, at, irradiance.value);
                push::<S, M>(picked, index, kept, &irradiance, V::ADJOINT);
                index += Lanes::splat(simd, Lanes::<S>::LEN as f32);
            }
        }
        if M::HAS_NARROW {
            process::<S, M, SPECULAR>(simd, shared, terms, &mut picked[0], visitor);
            process::<S, M, NARROW>(simd, shared, terms, &mut picked[1], visitor);
            process::<S, M, SMOOTH>(simd, shared, terms, &mut picked[2], visitor);
            continue;
        }
        // Functions of their own: LLVM takes several times as long for one function with all rules
        // in it. Not for several SGs, whose terms of a point would be copied at each call.
        simd.vectorize(
            #[inline(always)]
            || process::<S, M, SPECULAR>(simd, shared, terms, &mut picked[0], visitor),
        );
        if M::HAS_SMOOTH {
            simd.vectorize(
                #[inline(always)]
                || process::<S, M, SMOOTH>(simd, shared, terms, &mut picked[2], visitor),
            );
        }
    }
}

/// Selects the lobes of a vector for each rule.
#[inline(always)]
fn push<S: Simd, M: PairModel>(
    picked: &mut PickedByRule,
    index: Lanes<S>,
    [wide, narrow, smooth]: [u64; RULES.len()],
    irradiance: &Dual<Lanes<S>>,
    with_derivatives: bool,
) {
    picked[0].push(index, wide);
    if M::HAS_NARROW {
        picked[1].push(index, narrow);
    }
    // A glossy point has none, whatever the lobe, so that the branch costs nothing.
    if M::HAS_SMOOTH && smooth != 0 {
        picked[2].push_light(irradiance, smooth, with_derivatives);
        picked[2].push(index, smooth);
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
    for (i, indices) in picked.vectors::<S>().enumerate() {
        let (one, two) = indices.split_at(indices.len().min(Lanes::<S>::LEN));
        let at = 2 * i * Lanes::<S>::LEN;
        let mut lobes = [Gathered::new::<M>(simd, shared.lobes, one); 2];
        let placed = if two.is_empty() {
            let [lobes, _] = &lobes;
            let light = picked.light::<S, PART>(simd, at);
            [model.place::<_, PART>(terms, &lobes.shape(), lobes.width(), light); 2]
        } else {
            lobes[1] = Gathered::new::<M>(simd, shared.lobes, two);
            let [a, b] = &lobes;
            let shapes = [&a.shape(), &b.shape()];
            let next = at + Lanes::<S>::LEN;
            let light = [picked.light::<S, PART>(simd, at), picked.light::<S, PART>(simd, next)];
            model.place_two::<_, PART>(terms, shapes, [a.width(), b.width()], light)
        };
        // A loop, so that there is one copy of the code.
        for (lobes, placed) in lobes.iter().zip(&placed).take(if two.is_empty() { 1 } else { 2 }) {
            visitor.picked::<PART>(lobes, placed);
        }
    }
    picked.count = 0;
}
