//! Culling of specular parts: the lobes whose specular part is not negligible at a point, packed into vectors.

use super::blocks::{block_rows, load};
use crate::columns::LOBE_COLUMNS;
use crate::lanes::{Lanes, MAX_LANES, Row};
use crate::lobe::Shape;
use crate::model::{PairModel, Reach};
use crate::real::{Real, Vec3Of, dot};
use fearless_simd::Simd;

/// Lobes of a vector whose specular part is not negligible, as bits.
#[inline(always)]
pub fn survivors<S: Simd, M: PairModel>(simd: S, reach: &Reach<Lanes<S>>, block: &[Row], at: usize) -> u64 {
    let axis = [load(simd, &block[0], at), load(simd, &block[1], at), load(simd, &block[2], at)];
    let sharpness = load(simd, &block[3], at);
    let narrow = reach.sharpness * sharpness * (reach.sharpness + sharpness).inverse();
    let exponent = narrow * (narrow.one() - dot(reach.axis, axis));
    exponent.bits_below(load(simd, &block[block_rows::<M>() - 1], at))
}

/// Lobes selected from the blocks, one vector at a time.
pub struct Picked {
    /// Axis, sharpness, amplitude.
    rows: [Row; LOBE_COLUMNS],
    /// Indices of the lobes.
    pub index: [usize; MAX_LANES],
    /// Number of lobes held.
    pub count: usize,
}

impl Picked {
    #[inline(always)]
    pub fn new() -> Self {
        Self { rows: [Row::ZERO; LOBE_COLUMNS], index: [0; MAX_LANES], count: 0 }
    }

    /// Adds lane `lane` of `block`, whose first lobe has index `first`.
    #[inline(always)]
    pub fn push(&mut self, block: &[Row], first: usize, lane: usize) {
        for (row, column) in self.rows.iter_mut().zip(block) {
            row.0[self.count] = column.0[lane];
        }
        self.index[self.count] = first + lane;
        self.count += 1;
    }

    /// Shape and amplitude of the lobes; lanes beyond the last lobe have zero amplitude.
    #[inline(always)]
    pub fn vector<S: Simd>(&mut self, simd: S) -> (Shape<Lanes<S>>, Vec3Of<Lanes<S>>) {
        for i in self.count..Lanes::<S>::LEN {
            for (c, value) in [0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0].into_iter().enumerate() {
                self.rows[c].0[i] = value;
            }
        }
        let r = &self.rows;
        let axis = [load(simd, &r[0], 0), load(simd, &r[1], 0), load(simd, &r[2], 0)];
        let shape = Shape { axis, sharpness: load(simd, &r[3], 0) };
        (shape, [load(simd, &r[4], 0), load(simd, &r[5], 0), load(simd, &r[6], 0)])
    }
}
