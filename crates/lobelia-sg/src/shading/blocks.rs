//! Lobes regrouped into blocks of [`MAX_LANES`]: a block has one [`Row`] per column (axis,
//! sharpness, amplitude, then the terms of the model), so that the values of a lobe are close in
//! memory for any number of lobes.

use crate::columns::{LOBE_COLUMNS, LobeColumns, LobeVisibility, ShadePoint};
use crate::lanes::{Lanes, MAX_LANES, RECORD, Row, record_of, record_of_mut};
use crate::model::{PairModel, Terms};
use crate::{brdf::SpecularValue, real::Vec3Of, sg::Shape};
use fearless_simd::Simd;

/// Number of rows of a block of prepared lobes: columns of lobes, terms of the model, the
/// [`limit_rows`], and the columns of each lobe side by side ([`record`]).
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

/// Upper bound of the light that culling leaves out, summed over all lobes, as a fraction of the
/// mean radiance. Measured values are far lower: with 128 lobes and by the exponent alone, 0.07 %
/// of the specular light at R = 0.1, 0.03 % at R = 0.3, 0.004 % at R = 0.5.
const CULLED: f32 = 0.1;

/// The part of that bound for lobes that are left out because of their irradiance, most of them
/// below the horizon, where a rough surface would receive light from each of them otherwise.
pub const STRICTNESS: f32 = 0.01;

/// The exponent per lobe above which its specular part is negligible: e^(−exponent)·amplitude <
/// CULLED/lobes · mean radiance. A dim lobe counts as a lobe of mean amplitude, because the
/// gradient of its amplitude does not shrink with the amplitude.
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

/// The inputs that all points share; without a model, the formulas are not chosen yet.
#[derive(Clone, Copy)]
pub struct Shared<'a, M> {
    pub model: M,
    /// The specular material.
    pub specular: &'a SpecularValue,
    /// Blocks of [`block_rows`] rows.
    pub lobes: &'a [Row],
}

impl<'a> Shared<'a, ()> {
    pub(super) fn by<M>(self, model: M) -> Shared<'a, M> {
        Shared { model, specular: self.specular, lobes: self.lobes }
    }
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
        let (normal, to_viewer) = (three(0), three(3));
        simd.vectorize(
            #[inline(always)]
            || {
                let (terms, frozen) = shared.model.prepare_point(normal, to_viewer, roughness);
                Self { terms, frozen }
            },
        )
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
