//! Culling of specular parts: the lobes whose specular part is not negligible at a point, packed into vectors.

use super::blocks::{limit_rows, load, record};
use crate::lanes::{Lanes, MAX_LANES, RECORD, Row};
use crate::lobe::Shape;
use crate::model::{PairModel, Reach};
use crate::real::{Real, Vec3Of, dot};
use fearless_simd::Simd;

/// Blocks of lobes that are selected from before what was selected is processed.
pub const BATCH: usize = 16;
/// Lobes that [`Picked`] holds; one vector may be written beyond the last.
const ROOM: usize = (BATCH + 1) * MAX_LANES;

/// Lobes of a vector whose specular part is not negligible, as bits, given their irradiance: those for the rule for all lobes, and
/// those for the rule for narrow ones.
#[inline(always)]
pub fn survivors<S: Simd, M: PairModel>(
    simd: S,
    model: M,
    terms: &M::Point<Lanes<S>>,
    reach: &Reach<Lanes<S>>,
    block: &[Row],
    at: usize,
    irradiance: Lanes<S>,
) -> [u64; 2] {
    let axis = [load(simd, &block[0], at), load(simd, &block[1], at), load(simd, &block[2], at)];
    let shape = Shape { axis, sharpness: load(simd, &block[3], at) };
    let [exponent_limit, least] = limit_rows::<M>(block);
    let least = load(simd, least, at);
    let narrow = reach.sharpness * shape.sharpness * (reach.sharpness + shape.sharpness).inverse();
    let exponent = narrow * (narrow.one() - dot(reach.axis, shape.axis));
    let light = reach.brightest * irradiance;
    let near = exponent.bits_below(load(simd, exponent_limit, at));
    if !M::HAS_NARROW {
        // e^x from below.
        let growth = exponent.mul_plus(exponent.mul_plus(exponent.times(1.0 / 6.0).plus(0.5), 1.0), 1.0);
        return [near & (least * growth).bits_below(light), 0];
    }
    let (narrowness, fading) = model.narrow(terms, &shape);
    let wide = narrowness.bits_below(narrowness.one());
    let bright = least.bits_below(light);
    let faded = (least * fading).bits_below(light);
    // The tail that the rule for narrow lobes reads may reach beyond the exponent's.
    [near & bright & wide, faded & !wide]
}

/// Lobes selected from the blocks.
pub struct Picked {
    /// Indices of the lobes, as numbers.
    index: [f32; ROOM],
    /// Number of lobes held.
    pub count: usize,
}

impl Picked {
    pub fn new() -> Self {
        Self { index: [0.0; ROOM], count: 0 }
    }

    /// Adds the lobes whose bits are set; `index` holds the indices of the lanes.
    ///
    /// Without a branch: which lobes survive cannot be predicted.
    #[inline(always)]
    pub fn push<S: Simd>(&mut self, index: Lanes<S>, bits: u64) {
        index.packed(bits).store(&mut self.index[self.count..self.count + Lanes::<S>::LEN]);
        self.count += bits.count_ones() as usize;
    }

    /// Indices of the lobes, two vectors after another two.
    #[inline(always)]
    pub fn vectors<S: Simd>(&self) -> std::slice::Chunks<'_, f32> {
        self.index[..self.count].chunks(2 * Lanes::<S>::LEN)
    }
}

/// A vector of selected lobes.
#[derive(Clone, Copy)]
pub struct Gathered<'a, S: Simd> {
    /// Axis, sharpness, amplitude; lanes beyond the last lobe have zero amplitude.
    columns: [Lanes<S>; RECORD],
    /// Indices of the lobes, as numbers.
    pub index: &'a [f32],
}

impl<'a, S: Simd> Gathered<'a, S> {
    /// The lobes with these indices, at most a vector.
    #[inline(always)]
    pub fn new<M: PairModel>(simd: S, lobes: &[Row], index: &'a [f32]) -> Self {
        let mut records = [[0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0]; MAX_LANES];
        for (to, lobe) in records.iter_mut().zip(index) {
            to.copy_from_slice(record::<M>(lobes, *lobe as usize));
        }
        Self { columns: Lanes::columns(simd, &records), index }
    }

    /// Their shape.
    #[inline(always)]
    pub fn shape(&self) -> Shape<Lanes<S>> {
        let [x, y, z, sharpness, ..] = self.columns;
        Shape { axis: [x, y, z], sharpness }
    }

    /// Their amplitude.
    #[inline(always)]
    pub fn amplitude(&self) -> Vec3Of<Lanes<S>> {
        let [.., r, g, b, _] = self.columns;
        [r, g, b]
    }
}
