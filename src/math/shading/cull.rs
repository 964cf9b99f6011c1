//! Which specular parts do not show and are left out, and the lobes that remain, packed into vectors.

use super::kernels::{block_rows, load};
use super::{LOBE_COLUMNS, LobeColumns};
use crate::math::lanes::{Lanes, MAX_LANES, Row};
use crate::math::model::{PairModel, Reach, Shape};
use crate::math::real::{Real, Vec3Of, dot};
use fearless_simd::Simd;

/// Light that culling may leave out, summed over all lobes in the worst case, as a part of the mean radiance. The worst case is
/// far away: measured (128 lobes), it is 0.07 % of the specular light at R = 0.1, 0.03 % at R = 0.3, 0.004 % at R = 0.5.
const CULLED: f32 = 0.1;

/// Per lobe, the exponent from which its specular part is negligible: e^(−exponent)·amplitude < CULLED/lobes · mean radiance.
/// A dim lobe counts as one of mean amplitude: the gradient of its amplitude does not shrink with it.
pub fn exponent_limits(lobes: &LobeColumns) -> impl Fn(usize) -> f32 {
    let brightest = |i: usize| {
        let [r, g, b] = lobes.get(i).amplitude;
        r.max(g).max(b)
    };
    // The mean over the sphere of an SG is μ(1 − e^(−2λ))/2λ.
    let mean = |i: usize| {
        let l = f64::from(lobes.get(i).sharpness).max(1e-6);
        f64::from(brightest(i)) * -(-2.0 * l).exp_m1() / (2.0 * l)
    };
    let count = lobes.len().max(1) as f64;
    let total: f64 = (0..lobes.len()).map(mean).sum();
    let average = ((0..lobes.len()).map(|i| f64::from(brightest(i))).sum::<f64>() / count) as f32;
    let least = ((f64::from(CULLED) * total / count) as f32).max(f32::MIN_POSITIVE);
    move |i| {
        let padding = i >= lobes.len();
        if padding { f32::MIN } else { (brightest(i).max(average) / least).max(f32::MIN_POSITIVE).ln() }
    }
}

/// Lobes of a vector whose specular part counts, as bits.
#[inline(always)]
pub fn survivors<S: Simd, M: PairModel>(simd: S, reach: &Reach<Lanes<S>>, block: &[Row], at: usize) -> u64 {
    let axis = [load(simd, &block[0], at), load(simd, &block[1], at), load(simd, &block[2], at)];
    let sharpness = load(simd, &block[3], at);
    let narrow = reach.sharpness * sharpness * (reach.sharpness + sharpness).inverse();
    let exponent = narrow * (narrow.one() - dot(reach.axis, axis));
    exponent.bits_below(load(simd, &block[block_rows::<M>() - 1], at))
}

/// Lobes picked out of the blocks, one vector of them at a time.
pub struct Picked {
    /// Axis, sharpness, amplitude.
    rows: [Row; LOBE_COLUMNS],
    /// Their numbers.
    pub index: [usize; MAX_LANES],
    /// How many are held.
    pub count: usize,
}

impl Picked {
    #[inline(always)]
    pub fn new() -> Self {
        Self { rows: [Row::ZERO; LOBE_COLUMNS], index: [0; MAX_LANES], count: 0 }
    }

    /// Takes lane `lane` of `block`, whose first lobe has number `first`.
    #[inline(always)]
    pub fn push(&mut self, block: &[Row], first: usize, lane: usize) {
        for (row, column) in self.rows.iter_mut().zip(block) {
            row.0[self.count] = column.0[lane];
        }
        self.index[self.count] = first + lane;
        self.count += 1;
    }

    /// Shape and amplitude of the lobes, those beyond the last without light.
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
