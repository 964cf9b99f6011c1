//! Culling of specular parts: the lobes whose specular part is not negligible at a point, packed
//! into vectors.

use super::blocks::{limit_rows, load, record};
use crate::lanes::{Lanes, MAX_LANES, RECORD, Row};
use crate::model::{PairModel, Part, RULES, Reach, SMOOTH};
use crate::real::{Real, Vec3Of, dot};
use crate::sg::{Dual, Shape};
use fearless_simd::Simd;

/// Blocks of lobes that are selected from before what was selected is processed.
pub const BATCH: usize = 16;
/// Lobes that [`Picked`] holds; one vector may be written beyond the last.
const ROOM: usize = (BATCH + 1) * MAX_LANES;

/// Lobes of a vector whose specular part is not negligible, as bits for each of the [`RULES`],
/// given their irradiance.
#[inline(always)]
pub fn survivors<S: Simd, M: PairModel>(
    simd: S,
    model: M,
    terms: &M::Point<Lanes<S>>,
    reach: &Reach<Lanes<S>>,
    block: &[Row],
    at: usize,
    irradiance: Lanes<S>,
) -> [u64; RULES.len()] {
    let axis = [load(simd, &block[0], at), load(simd, &block[1], at), load(simd, &block[2], at)];
    let shape = Shape { axis, sharpness: load(simd, &block[3], at) };
    let [exponent_limit, least] = limit_rows::<M>(block);
    let least = load(simd, least, at);
    let narrow = reach.sharpness * shape.sharpness * (reach.sharpness + shape.sharpness).inverse();
    let reached = dot(reach.axis, shape.axis);
    let exponent = narrow * (narrow.one() - reached);
    let light = reach.brightest * irradiance;
    let near = exponent.bits_below(load(simd, exponent_limit, at));
    if !M::HAS_NARROW {
        // e^x from below.
        let growth = exponent.mul_plus(exponent.mul_plus(exponent.times(1.0 / 6.0).plus(0.5), 1.0), 1.0);
        let kept = near & (least * growth).bits_below(light);
        let smooth = kept & smooth_of(model, terms, &shape, reached);
        return [kept & !smooth, 0, smooth];
    }
    let (narrowness, fading) = model.narrow(terms, &shape);
    let wide = narrowness.bits_below(narrowness.one());
    let bright = least.bits_below(light);
    let faded = (least * fading).bits_below(light);
    // The tail that the rule for narrow lobes reads may reach beyond the exponent's.
    let tail = faded & !wide;
    let smooth = tail & smooth_of(model, terms, &shape, reached);
    [near & bright & wide, tail & !smooth, smooth]
}

/// Lobes over which the response of the point is smooth, as bits.
#[inline(always)]
fn smooth_of<S: Simd, M: PairModel>(
    model: M,
    terms: &M::Point<Lanes<S>>,
    shape: &Shape<Lanes<S>>,
    reached: Lanes<S>,
) -> u64 {
    // The same for all lobes.
    if !M::HAS_SMOOTH || !model.may_have_smooth(terms) {
        return 0;
    }
    let margin = model.smooth(terms, shape, reached);
    margin.zero().bits_below(margin)
}

/// Lobes selected for each of the [`RULES`].
pub type PickedByRule = [Picked; RULES.len()];

/// Lobes selected from the blocks.
pub struct Picked {
    /// Indices of the lobes, as numbers.
    index: [f32; ROOM],
    /// The irradiance from each and its derivatives with respect to sharpness and cosine, where
    /// [`Picked::push_light`] was called.
    light: [[f32; ROOM]; 3],
    /// Number of lobes held.
    pub count: usize,
}

impl Picked {
    /// None for any rule.
    pub fn none() -> PickedByRule {
        RULES.map(|_| Self { index: [0.0; ROOM], light: [[0.0; ROOM]; 3], count: 0 })
    }

    /// Adds the lobes whose bits are set; `index` holds the indices of the lanes.
    ///
    /// Without a branch: which lobes survive cannot be predicted.
    #[inline(always)]
    pub fn push<S: Simd>(&mut self, index: Lanes<S>, bits: u64) {
        index.packed(bits).store(&mut self.index[self.count..self.count + Lanes::<S>::LEN]);
        self.count += bits.count_ones() as usize;
    }

    /// The irradiance from the lobes that the next [`Picked::push`] adds, with its derivatives if
    /// they are asked for.
    #[inline(always)]
    pub fn push_light<S: Simd>(&mut self, light: &Dual<Lanes<S>>, bits: u64, derivatives: bool) {
        let range = self.count..self.count + Lanes::<S>::LEN;
        let columns = if derivatives { 3 } else { 1 };
        let values = [light.value, light.by_sharpness, light.by_cosine];
        for (column, value) in self.light[..columns].iter_mut().zip(values) {
            value.packed(bits).store(&mut column[range.clone()]);
        }
    }

    /// The irradiance from the lobes from position `at` on, which is noted for [`SMOOTH`] alone.
    #[inline(always)]
    pub fn light<S: Simd, const PART: Part>(&self, simd: S, at: usize) -> Dual<Lanes<S>> {
        if PART != SMOOTH {
            let zero = Lanes::splat(simd, 0.0);
            return Dual { value: zero, by_sharpness: zero, by_cosine: zero };
        }
        let range = at..at + Lanes::<S>::LEN;
        let [value, by_sharpness, by_cosine] = &self.light;
        Dual {
            value: Lanes::load(simd, &value[range.clone()]),
            by_sharpness: Lanes::load(simd, &by_sharpness[range.clone()]),
            by_cosine: Lanes::load(simd, &by_cosine[range]),
        }
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
    /// Axis, sharpness, amplitude and 1/√λ; lanes beyond the last lobe have zero amplitude.
    columns: [Lanes<S>; RECORD],
    /// Indices of the lobes, as numbers.
    pub index: &'a [f32],
}

impl<'a, S: Simd> Gathered<'a, S> {
    /// The lobes with these indices, at least one and at most a vector.
    #[inline(always)]
    pub fn new<M: PairModel>(simd: S, lobes: &[Row], index: &'a [f32]) -> Self {
        // Where no lobe is, one that has values at this point: 0 times NaN is NaN.
        let mut dark = [0.0; RECORD];
        dark.copy_from_slice(record::<M>(lobes, index[0] as usize));
        dark[4..7].fill(0.0);
        let mut records = [dark; MAX_LANES];
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

    /// 1/√λ of each.
    #[inline(always)]
    pub fn width(&self) -> Lanes<S> {
        self.columns[RECORD - 1]
    }

    /// Their amplitude.
    #[inline(always)]
    pub fn amplitude(&self) -> Vec3Of<Lanes<S>> {
        let [.., r, g, b, _] = self.columns;
        [r, g, b]
    }
}
