//! The loops: points × vectors of lobes, generic over the SIMD level and the formulas.
//!
//! Lobes are regrouped into blocks of [`MAX_LANES`]: a block is one [`Row`] a column (axis, sharpness, amplitude, then
//! the model's terms), so that a lobe's values lie side by side whatever the number of lobes. Points are prepared
//! a vector at a time too.
//!
//! Vector arithmetic belongs into `#[inline(always)]` functions and loops, not into closures of any size: one that the
//! compiler does not inline is compiled without the level's instructions and is ten times slower.

use super::cull::{Picked, exponent_limits, survivors};
use super::{LOBE_COLUMNS, Layers, LobeColumns, PointVisibility, ShadePoint, SpecularValue, Visibility};
use crate::math::lanes::{Lanes, MAX_LANES, Row};
use crate::math::model::{BOTH, DIFFUSE, PairModel, Part, Response, SPECULAR, Shape, Terms};
use crate::math::real::{Real, Vec3Of};
use fearless_simd::Simd;
use std::f32::consts::PI;

/// What all points share.
pub struct Shared<'a, M> {
    pub model: M,
    pub specular: &'a SpecularValue,
    /// Blocks of [`block_rows`] rows.
    pub lobes: &'a [Row],
}

impl<M: PairModel> Shared<'_, M> {
    /// Lobes, with the padding.
    pub(super) fn stride(&self) -> usize {
        self.lobes.len() / block_rows::<M>() * MAX_LANES
    }
}

/// Rows of a block of prepared lobes: the lobes', the model's, and the exponent from which a specular part is left out.
pub const fn block_rows<M: PairModel>() -> usize {
    LOBE_COLUMNS + <M::Lobe<f32> as Terms<f32>>::LEN + 1
}

/// Regroups lobes into blocks and adds the model's terms.
#[inline(always)]
pub fn prepare_lobes<S: Simd, M: PairModel>(simd: S, model: M, lobes: &LobeColumns, out: &mut Vec<Row>) {
    out.clear();
    out.resize(lobes.blocks() * block_rows::<M>(), Row::ZERO);
    let limit = exponent_limits(lobes);
    for (b, block) in out.chunks_exact_mut(block_rows::<M>()).enumerate() {
        for (c, row) in block[..LOBE_COLUMNS].iter_mut().enumerate() {
            row.0.copy_from_slice(&lobes.data[c * lobes.stride + b * MAX_LANES..][..MAX_LANES]);
        }
        for at in (0..MAX_LANES).step_by(Lanes::<S>::LEN) {
            let terms = model.prepare_lobe(load(simd, &block[3], at));
            for c in 0..M::Lobe::<Lanes<S>>::LEN {
                terms.at(c).store(&mut block[LOBE_COLUMNS + c].0[at..at + Lanes::<S>::LEN]);
            }
        }
        for (i, value) in block[block_rows::<M>() - 1].0.iter_mut().enumerate() {
            *value = limit(b * MAX_LANES + i);
        }
    }
}

#[inline(always)]
pub fn load<S: Simd>(simd: S, row: &Row, at: usize) -> Lanes<S> {
    Lanes::load(simd, &row.0[at..at + Lanes::<S>::LEN])
}

/// The part of a vector of lobes' light that reaches a point.
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
fn load_lobes<S: Simd, M: PairModel>(simd: S, block: &[Row], at: usize) -> LobeVector<S, M> {
    assert_eq!(block.len(), block_rows::<M>(), "a whole block");
    let column = |c: usize| load(simd, &block[c], at);
    LobeVector {
        shape: Shape { axis: [column(0), column(1), column(2)], sharpness: column(3) },
        amplitude: [column(4), column(5), column(6)],
        terms: Terms::from_fn(|c| column(LOBE_COLUMNS + c)),
    }
}

/// What is done with the lobes of one point, a vector at a time. A trait and not closures: vector arithmetic in a closure
/// is compiled without the instruction set that was chosen.
pub(super) trait Visit<S: Simd, M: PairModel> {
    /// The part `PART` of the lobes at place `at` of block `b`.
    fn block<const PART: Part>(&mut self, b: usize, at: usize, lobe: &LobeVector<S, M>);
    /// The specular part of lobes picked by their numbers.
    fn picked(&mut self, index: &[usize], shape: &Shape<Lanes<S>>, amplitude: Vec3Of<Lanes<S>>);
}

/// Shows all lobes to a visitor; of a model that culls, the specular parts of those alone that count.
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

/// Number of pairs whose specular part a model that culls does not leave out.
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

/// The terms of a group of up to [`Lanes::LEN`] points, one point a lane.
pub(super) struct Prepared<S: Simd, M: PairModel> {
    terms: M::Point<Lanes<S>>,
    frozen: M::Frozen<Lanes<S>>,
}

impl<S: Simd, M: PairModel> Prepared<S, M> {
    #[inline(always)]
    pub(super) fn new(simd: S, shared: &Shared<'_, M>, points: &[ShadePoint]) -> Self {
        // A lane without a point has zeros, of which nothing is read.
        let mut inputs = [Row::ZERO; 6];
        for (i, point) in points.iter().enumerate() {
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

/// The sum over lanes of each channel.
#[inline(always)]
pub(super) fn sum3<S: Simd>(v: &Vec3Of<Lanes<S>>) -> Vec3Of<f32> {
    [v[0].sum(), v[1].sum(), v[2].sum()]
}

/// `v * by + sum`, channel by channel.
#[inline(always)]
pub(super) fn mul_add3<F: Real>(v: Vec3Of<F>, by: F, sum: Vec3Of<F>) -> Vec3Of<F> {
    [v[0].mul_add(by, sum[0]), v[1].mul_add(by, sum[1]), v[2].mul_add(by, sum[2])]
}

/// The same colour in every lane.
#[inline(always)]
pub(super) fn splat3<S: Simd>(simd: S, v: Vec3Of<f32>) -> Vec3Of<Lanes<S>> {
    [Lanes::splat(simd, v[0]), Lanes::splat(simd, v[1]), Lanes::splat(simd, v[2])]
}

/// Sums over the lobes of a point's light, per channel.
pub(super) struct Light<S: Simd, M: PairModel> {
    diffuse: Vec3Of<Lanes<S>>,
    glossy: M::Specular<Vec3Of<Lanes<S>>>,
}

impl<S: Simd, M: PairModel> Light<S, M> {
    #[inline(always)]
    pub(super) fn zero(simd: S) -> Self {
        let zero = [Lanes::splat(simd, 0.0); 3];
        Self { diffuse: zero, glossy: Terms::from_fn(|_| zero) }
    }

    #[inline(always)]
    pub(super) fn add<const PART: Part>(
        &mut self,
        amplitude: Vec3Of<Lanes<S>>,
        response: &Response<Lanes<S>, M::Specular<Lanes<S>>>,
    ) {
        if PART & DIFFUSE != 0 {
            self.diffuse = mul_add3(amplitude, response.diffuse, self.diffuse);
        }
        if PART & SPECULAR == 0 {
            return;
        }
        for b in 0..M::Specular::<f32>::LEN {
            let sum = self.glossy.at_mut(b);
            *sum = mul_add3(amplitude, response.specular.at(b), *sum);
        }
    }

    /// The sums over lanes of diffuse light and of each specular term.
    #[inline(always)]
    pub(super) fn total(&self) -> (Vec3Of<f32>, M::Specular<Vec3Of<f32>>) {
        let mut glossy: M::Specular<Vec3Of<f32>> = Terms::from_fn(|_| [0.0; 3]);
        for b in 0..M::Specular::<f32>::LEN {
            *glossy.at_mut(b) = sum3(&self.glossy.at(b));
        }
        (sum3(&self.diffuse), glossy)
    }
}

/// Radiance of a chunk of points.
#[inline(always)]
pub fn shade_chunk<S: Simd, M: PairModel>(
    simd: S,
    shared: &Shared<'_, M>,
    points: &[ShadePoint],
    visibility: Option<Visibility<'_>>,
    out: &mut [Layers],
) {
    let mut prepared = None;
    for (i, (point, out)) in points.iter().zip(out).enumerate() {
        let lane = i % Lanes::<S>::LEN;
        if lane == 0 {
            let end = points.len().min(i + Lanes::<S>::LEN);
            prepared = Some(Prepared::<S, M>::new(simd, shared, &points[i..end]));
        }
        *out = Layers::default();
        let Some(prepared) = prepared.as_ref().filter(|_| !point.is_missed()) else { continue };
        let (terms, frozen) = prepared.point(lane);
        let (row, around) = Visibility::point(visibility, i, shared.stride());
        let (diffuse, glossy) = light_of(simd, shared, &splat::<S, M>(simd, &terms), row);
        let weights = shared.model.specular_weights(&frozen, shared.specular);
        *out = layers::<M>(point, &around, &diffuse, &glossy, &weights);
    }
}

/// Radiance from the sums over the lobes.
#[inline(always)]
fn layers<M: PairModel>(
    point: &ShadePoint,
    around: &PointVisibility,
    diffuse: &Vec3Of<f32>,
    glossy: &M::Specular<Vec3Of<f32>>,
    weights: &M::Specular<Vec3Of<f32>>,
) -> Layers {
    let specular =
        |c: usize| -> f32 { (0..M::Specular::<f32>::LEN).map(|b| glossy.at(b)[c] * weights.at(b)[c]).sum() };
    Layers {
        diffuse: std::array::from_fn(|c| ((diffuse[c] + around.indirect[c]) * point.albedo[c] / PI).max(0.0)),
        specular: std::array::from_fn(|c| (specular(c) * around.specular[c]).max(0.0)),
    }
}

/// One point's light under all lobes.
#[inline(always)]
fn light_of<S: Simd, M: PairModel>(
    simd: S,
    shared: &Shared<'_, M>,
    terms: &M::Point<Lanes<S>>,
    row: Option<&[u8]>,
) -> (Vec3Of<f32>, M::Specular<Vec3Of<f32>>) {
    let mut shading = Shading { simd, model: shared.model, terms, row, light: Light::zero(simd) };
    walk(simd, shared, terms, &mut shading);
    shading.light.total()
}

/// One point's radiance under way over the lobes.
struct Shading<'a, S: Simd, M: PairModel> {
    simd: S,
    model: M,
    terms: &'a M::Point<Lanes<S>>,
    /// Visibility of the lobes.
    row: Option<&'a [u8]>,
    light: Light<S, M>,
}

impl<S: Simd, M: PairModel> Visit<S, M> for Shading<'_, S, M> {
    #[inline(always)]
    fn block<const PART: Part>(&mut self, b: usize, at: usize, lobe: &LobeVector<S, M>) {
        let mut response = self.model.evaluate::<_, PART>(self.terms, &lobe.shape, &lobe.terms);
        response.diffuse = response.diffuse * reaching(self.simd, self.row, b, at);
        self.light.add::<PART>(lobe.amplitude, &response);
    }

    #[inline(always)]
    fn picked(&mut self, _index: &[usize], shape: &Shape<Lanes<S>>, amplitude: Vec3Of<Lanes<S>>) {
        let zero = Lanes::splat(self.simd, 0.0);
        let unread: M::Lobe<Lanes<S>> = Terms::from_fn(|_| zero);
        let response = self.model.evaluate::<_, SPECULAR>(self.terms, shape, &unread);
        self.light.add::<SPECULAR>(amplitude, &response);
    }
}
