//! Lobes regrouped into blocks of [`MAX_LANES`]: a block has one [`Row`] per column (axis, sharpness, amplitude, then the
//! terms of the model), so that the values of a lobe are close in memory for any number of lobes.

use super::limits::{STRICTNESS, exponent_limits};
use crate::columns::{LOBE_COLUMNS, LobeColumns};
use crate::lanes::{Lanes, MAX_LANES, RECORD, Row, record_of, record_of_mut};
use crate::lobe::Shape;
use crate::model::{PairModel, Terms};
use crate::real::Vec3Of;
use fearless_simd::Simd;

/// Number of rows of a block of prepared lobes: columns of lobes, terms of the model, the [`limit_rows`], and the columns of each lobe
/// side by side ([`record`]).
pub const fn block_rows<M: PairModel>() -> usize {
    limits_at::<M>() + 2 + RECORD
}

/// Where the [`limit_rows`] begin.
const fn limits_at<M: PairModel>() -> usize {
    LOBE_COLUMNS + <M::Lobe<f32> as Terms<f32>>::LEN
}

/// Axis, sharpness and amplitude of a lobe, and 1 over the square root of its sharpness.
#[inline(always)]
pub fn record<M: PairModel>(lobes: &[Row], lobe: usize) -> &[f32] {
    let (block, lane) = (lobe / MAX_LANES, lobe % MAX_LANES);
    record_of(&lobes[block * block_rows::<M>() + limits_at::<M>() + 2..], lane)
}

/// The exponent above which a specular part is skipped, and the response below which it is.
#[inline(always)]
pub fn limit_rows<M: PairModel>(block: &[Row]) -> [&Row; 2] {
    [&block[limits_at::<M>()], &block[limits_at::<M>() + 1]]
}

/// Regroups lobes into blocks and adds the terms of the model.
#[inline(always)]
pub fn prepare_lobes<S: Simd, M: PairModel>(simd: S, model: M, lobes: &LobeColumns, out: &mut Vec<Row>) {
    out.clear();
    out.resize(lobes.blocks() * block_rows::<M>(), Row::ZERO);
    let limit = exponent_limits(lobes);
    for (b, block) in out.chunks_exact_mut(block_rows::<M>()).enumerate() {
        for (c, row) in block[..LOBE_COLUMNS].iter_mut().enumerate() {
            row.0.copy_from_slice(lobes.block(c, b));
        }
        for at in (0..MAX_LANES).step_by(Lanes::<S>::LEN) {
            let terms = model.prepare_lobe(load(simd, &block[3], at));
            for c in 0..M::Lobe::<Lanes<S>>::LEN {
                terms.at(c).store(&mut block[LOBE_COLUMNS + c].0[at..at + Lanes::<S>::LEN]);
            }
        }
        let (columns, rest) = block.split_at_mut(limits_at::<M>());
        for i in 0..MAX_LANES {
            let exponent = limit(b * MAX_LANES + i);
            rest[0].0[i] = exponent;
            rest[1].0[i] = STRICTNESS * (-exponent).exp();
            let record = record_of_mut(&mut rest[2..], i);
            for (value, column) in record.iter_mut().zip(&columns[..LOBE_COLUMNS]) {
                *value = column.0[i];
            }
            record[LOBE_COLUMNS] = columns[3].0[i].max(f32::MIN_POSITIVE).sqrt().recip();
        }
    }
}

/// One vector of a row.
#[inline(always)]
pub fn load<S: Simd>(simd: S, row: &Row, at: usize) -> Lanes<S> {
    Lanes::load(simd, &row.0[at..at + Lanes::<S>::LEN])
}

/// The visibility of a vector of lobes at a point.
#[inline(always)]
pub(super) fn reaching<S: Simd>(simd: S, row: Option<&[u8]>, b: usize, at: usize) -> Lanes<S> {
    match row {
        Some(row) => Lanes::parts(simd, &row[b * MAX_LANES + at..][..Lanes::<S>::LEN]),
        None => Lanes::splat(simd, 1.0),
    }
}

/// One vector of lobes.
pub(super) struct LobeVector<S: Simd, M: PairModel> {
    pub(super) shape: Shape<Lanes<S>>,
    pub(super) amplitude: Vec3Of<Lanes<S>>,
    pub(super) terms: M::Lobe<Lanes<S>>,
}

#[inline(always)]
pub(super) fn load_lobes<S: Simd, M: PairModel>(simd: S, block: &[Row], at: usize) -> LobeVector<S, M> {
    assert_eq!(block.len(), block_rows::<M>(), "one block");
    let column = |c: usize| load(simd, &block[c], at);
    LobeVector {
        shape: Shape { axis: [column(0), column(1), column(2)], sharpness: column(3) },
        amplitude: [column(4), column(5), column(6)],
        terms: Terms::from_fn(|c| column(LOBE_COLUMNS + c)),
    }
}
