//! The loops: points × vectors of lobes, generic over the SIMD level and the formulas.
//!
//! Lobes are regrouped into blocks of [`MAX_LANES`]: a block is one [`Row`] a column (axis, sharpness, amplitude, then
//! the model's terms), so that a lobe's values lie side by side whatever the number of lobes. Points are prepared
//! a vector at a time too.

use super::{LOBE_COLUMNS, Layers, LobeColumns, PointAdjoint, RadianceAdjoint, ShadePoint, SpecularValue};
use crate::math::lanes::{Lanes, MAX_LANES, Row};
use crate::math::model::{BOTH, DIFFUSE, PairModel, PointEnd, Reach, Response, SPECULAR, Shape, Terms};
use crate::math::real::{Real, Vec3Of, dot, scale};
use fearless_simd::Simd;
use std::f32::consts::PI;

/// What all points share.
pub struct Shared<'a, M> {
    pub model: M,
    pub specular: &'a SpecularValue,
    /// Blocks of [`block_rows`] rows.
    pub lobes: &'a [Row],
}

/// Rows of a block of prepared lobes: the lobes', the model's, and the exponent from which a specular part is left out.
const fn block_rows<M: PairModel>() -> usize {
    LOBE_COLUMNS + <M::Lobe<f32> as Terms<f32>>::LEN + 1
}

/// Light that culling may leave out, summed over all lobes in the worst case, as a part of the mean radiance.
const CULLED: f32 = 1e-2;

/// Per lobe, the exponent from which its specular part is negligible: e^(−exponent)·amplitude < CULLED/lobes · mean radiance.
fn exponent_limits(lobes: &LobeColumns) -> impl Fn(usize) -> f32 {
    let brightest = |i: usize| {
        let [r, g, b] = lobes.get(i).amplitude;
        r.max(g).max(b)
    };
    // The mean over the sphere of an SG is μ(1 − e^(−2λ))/2λ.
    let mean = |i: usize| {
        let l = f64::from(lobes.get(i).sharpness).max(1e-6);
        f64::from(brightest(i)) * -(-2.0 * l).exp_m1() / (2.0 * l)
    };
    let total: f64 = (0..lobes.len()).map(mean).sum();
    let least = (f64::from(CULLED) * total / lobes.len().max(1) as f64) as f32;
    move |i| (brightest(i) / least.max(f32::MIN_POSITIVE)).max(f32::MIN_POSITIVE).ln()
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
fn load<S: Simd>(simd: S, row: &Row, at: usize) -> Lanes<S> {
    Lanes::load(simd, &row.0[at..at + Lanes::<S>::LEN])
}

/// One vector of lobes.
struct LobeVector<S: Simd, M: PairModel> {
    shape: Shape<Lanes<S>>,
    amplitude: Vec3Of<Lanes<S>>,
    terms: M::Lobe<Lanes<S>>,
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

/// Lobes of a vector whose specular part counts, as bits.
#[inline(always)]
fn survivors<S: Simd, M: PairModel>(simd: S, reach: &Reach<Lanes<S>>, block: &[Row], at: usize) -> u64 {
    let column = |c: usize| load(simd, &block[c], at);
    let (axis, sharpness) = ([column(0), column(1), column(2)], column(3));
    let narrow = reach.sharpness * sharpness * (reach.sharpness + sharpness).inverse();
    let exponent = narrow * (narrow.one() - dot(reach.axis, axis));
    exponent.bits_below(column(block_rows::<M>() - 1))
}

/// Lobes picked out of the blocks, one vector of them at a time.
struct Picked {
    /// Axis, sharpness, amplitude.
    rows: [Row; LOBE_COLUMNS],
    index: [usize; MAX_LANES],
    count: usize,
}

impl Picked {
    #[inline(always)]
    fn new() -> Self {
        Self { rows: [Row::ZERO; LOBE_COLUMNS], index: [0; MAX_LANES], count: 0 }
    }

    /// Takes lane `lane` of `block`, whose first lobe has number `first`.
    #[inline(always)]
    fn push(&mut self, block: &[Row], first: usize, lane: usize) {
        for (row, column) in self.rows.iter_mut().zip(block) {
            row.0[self.count] = column.0[lane];
        }
        self.index[self.count] = first + lane;
        self.count += 1;
    }

    /// The lobes as a vector, those beyond the last without light; none are left.
    #[inline(always)]
    fn take<S: Simd>(&mut self, simd: S) -> (Shape<Lanes<S>>, Vec3Of<Lanes<S>>) {
        for i in self.count..Lanes::<S>::LEN {
            for (c, value) in [0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0].into_iter().enumerate() {
                self.rows[c].0[i] = value;
            }
        }
        self.count = 0;
        let column = |c: usize| load(simd, &self.rows[c], 0);
        let shape = Shape { axis: [column(0), column(1), column(2)], sharpness: column(3) };
        (shape, [column(4), column(5), column(6)])
    }
}

/// Walks the blocks of a model that culls: `diffuse` is called for each vector of lobes (block number, place in it, lobes),
/// `specular` for each vector of lobes whose specular part counts.
#[inline(always)]
fn walk_culled<S: Simd, M: PairModel, T>(
    simd: S,
    shared: &Shared<'_, M>,
    terms: &M::Point<Lanes<S>>,
    state: &mut T,
    diffuse: impl Fn(&mut T, usize, usize, &LobeVector<S, M>),
    specular: impl Fn(&mut T, &[usize], &Shape<Lanes<S>>, Vec3Of<Lanes<S>>),
) {
    let reach = shared.model.reach(terms);
    let mut picked = Picked::new();
    let flush = |picked: &mut Picked, state: &mut T| {
        let count = picked.count;
        let (shape, amplitude) = picked.take(simd);
        specular(state, &picked.index[..count], &shape, amplitude);
    };
    for (b, block) in shared.lobes.chunks_exact(block_rows::<M>()).enumerate() {
        for at in (0..MAX_LANES).step_by(Lanes::<S>::LEN) {
            diffuse(state, b, at, &load_lobes::<S, M>(simd, block, at));
            let mut bits = survivors::<S, M>(simd, &reach, block, at);
            while bits != 0 {
                picked.push(block, b * MAX_LANES, at + bits.trailing_zeros() as usize);
                bits &= bits - 1;
                if picked.count == Lanes::<S>::LEN {
                    flush(&mut picked, state);
                }
            }
        }
    }
    if picked.count > 0 {
        flush(&mut picked, state);
    }
}

/// Number of pairs whose specular part is not left out.
#[inline(always)]
pub fn count_kept<S: Simd, M: PairModel>(simd: S, shared: &Shared<'_, M>, points: &[ShadePoint]) -> usize {
    if !M::CULLS {
        return points.len() * shared.lobes.len() / block_rows::<M>() * MAX_LANES;
    }
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
struct Prepared<S: Simd, M: PairModel> {
    terms: M::Point<Lanes<S>>,
    frozen: M::Frozen<Lanes<S>>,
}

impl<S: Simd, M: PairModel> Prepared<S, M> {
    #[inline(always)]
    fn new(simd: S, shared: &Shared<'_, M>, points: &[ShadePoint]) -> Self {
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
    fn point(&self, lane: usize) -> (M::Point<f32>, M::Frozen<f32>) {
        (Terms::from_fn(|c| self.terms.at(c).lane(lane)), Terms::from_fn(|c| self.frozen.at(c).lane(lane)))
    }
}

/// A point's terms with the same value in every lane.
#[inline(always)]
fn splat<S: Simd, M: PairModel>(simd: S, terms: &M::Point<f32>) -> M::Point<Lanes<S>> {
    Terms::from_fn(|c| Lanes::splat(simd, terms.at(c)))
}

/// The sum over lanes of each channel.
#[inline(always)]
fn sum3<S: Simd>(v: &Vec3Of<Lanes<S>>) -> Vec3Of<f32> {
    [v[0].sum(), v[1].sum(), v[2].sum()]
}

/// `v * by + sum`, channel by channel.
#[inline(always)]
fn mul_add3<F: Real>(v: Vec3Of<F>, by: F, sum: Vec3Of<F>) -> Vec3Of<F> {
    [v[0].mul_add(by, sum[0]), v[1].mul_add(by, sum[1]), v[2].mul_add(by, sum[2])]
}

/// The same colour in every lane.
#[inline(always)]
fn splat3<S: Simd>(simd: S, v: Vec3Of<f32>) -> Vec3Of<Lanes<S>> {
    [Lanes::splat(simd, v[0]), Lanes::splat(simd, v[1]), Lanes::splat(simd, v[2])]
}

/// Sums over the lobes of a point's light, per channel.
struct Light<S: Simd, M: PairModel> {
    diffuse: Vec3Of<Lanes<S>>,
    glossy: M::Specular<Vec3Of<Lanes<S>>>,
}

impl<S: Simd, M: PairModel> Light<S, M> {
    #[inline(always)]
    fn zero(simd: S) -> Self {
        let zero = [Lanes::splat(simd, 0.0); 3];
        Self { diffuse: zero, glossy: Terms::from_fn(|_| zero) }
    }

    #[inline(always)]
    fn add(&mut self, amplitude: Vec3Of<Lanes<S>>, response: &Response<Lanes<S>, M::Specular<Lanes<S>>>) {
        self.diffuse = mul_add3(amplitude, response.diffuse, self.diffuse);
        self.add_specular(amplitude, &response.specular);
    }

    #[inline(always)]
    fn add_specular(&mut self, amplitude: Vec3Of<Lanes<S>>, specular: &M::Specular<Lanes<S>>) {
        self.glossy = Terms::from_fn(|b| mul_add3(amplitude, specular.at(b), self.glossy.at(b)));
    }

    /// The sums over lanes of diffuse light and of each specular term.
    #[inline(always)]
    fn total(&self) -> (Vec3Of<f32>, M::Specular<Vec3Of<f32>>) {
        (sum3(&self.diffuse), Terms::from_fn(|b| sum3(&self.glossy.at(b))))
    }
}

/// Radiance of a chunk of points.
#[inline(always)]
pub fn shade_chunk<S: Simd, M: PairModel>(
    simd: S,
    shared: &Shared<'_, M>,
    points: &[ShadePoint],
    out: &mut [Layers],
) {
    let groups = points.chunks(Lanes::<S>::LEN).zip(out.chunks_mut(Lanes::<S>::LEN));
    for (points, out) in groups {
        let prepared = Prepared::new(simd, shared, points);
        for (i, (point, out)) in points.iter().zip(out).enumerate() {
            *out = Layers::default();
            if !point.is_missed() {
                let (terms, frozen) = prepared.point(i);
                let (diffuse, glossy) = light_of(simd, shared, &splat::<S, M>(simd, &terms));
                let weights = shared.model.specular_weights(&frozen, shared.specular);
                for c in 0..3 {
                    let specular: f32 =
                        (0..M::Specular::<f32>::LEN).map(|b| glossy.at(b)[c] * weights.at(b)[c]).sum();
                    out.diffuse[c] = (diffuse[c] * point.albedo[c] / PI).max(0.0);
                    out.specular[c] = specular.max(0.0);
                }
            }
        }
    }
}

/// One point's light under all lobes.
#[inline(always)]
fn light_of<S: Simd, M: PairModel>(
    simd: S,
    shared: &Shared<'_, M>,
    terms: &M::Point<Lanes<S>>,
) -> (Vec3Of<f32>, M::Specular<Vec3Of<f32>>) {
    let mut light = Light::<S, M>::zero(simd);
    if M::CULLS {
        let model = shared.model;
        let unread: M::Lobe<Lanes<S>> = Terms::from_fn(|_| Lanes::splat(simd, 0.0));
        walk_culled(
            simd,
            shared,
            terms,
            &mut light,
            |light, _, _, lobe| {
                let response = model.evaluate::<_, DIFFUSE>(terms, &lobe.shape, &lobe.terms);
                light.diffuse = mul_add3(lobe.amplitude, response.diffuse, light.diffuse);
            },
            |light, _, shape, amplitude| {
                light.add_specular(amplitude, &model.evaluate::<_, SPECULAR>(terms, shape, &unread).specular);
            },
        );
        return light.total();
    }
    for block in shared.lobes.chunks_exact(block_rows::<M>()) {
        for at in (0..MAX_LANES).step_by(Lanes::<S>::LEN) {
            let lobe = load_lobes::<S, M>(simd, block, at);
            light.add(lobe.amplitude, &shared.model.evaluate::<_, BOTH>(terms, &lobe.shape, &lobe.terms));
        }
    }
    light.total()
}

/// Adjoint of one point's radiance, per channel and with the channels clamped to zero taken out: of the diffuse layer,
/// of the specular layer, and of the light that goes into them.
struct Weights<M: PairModel> {
    diffuse: Vec3Of<f32>,
    specular: Vec3Of<f32>,
    diffuse_light: Vec3Of<f32>,
    specular_light: M::Specular<Vec3Of<f32>>,
}

impl<M: PairModel> Weights<M> {
    #[inline(always)]
    fn new(
        shared: &Shared<'_, M>,
        point: &ShadePoint,
        frozen: &M::Frozen<f32>,
        (shaded, adjoint): (&Layers, &RadianceAdjoint),
    ) -> Self {
        // A channel that was clamped to zero does not move with its inputs.
        let live = |value: f32, adjoint: f32| if value > 0.0 { adjoint } else { 0.0 };
        let diffuse: Vec3Of<f32> = std::array::from_fn(|c| live(shaded.diffuse[c], adjoint.0[c]));
        let specular: Vec3Of<f32> = std::array::from_fn(|c| live(shaded.specular[c], adjoint.0[c]));
        let weights = shared.model.specular_weights(frozen, shared.specular);
        Self {
            diffuse,
            specular,
            diffuse_light: std::array::from_fn(|c| diffuse[c] * point.albedo[c] / PI),
            specular_light: Terms::from_fn(|b| std::array::from_fn(|c| specular[c] * weights.at(b)[c])),
        }
    }
}

/// Adjoint of a chunk of points; adds what they share onto `partial`: a block of [`LOBE_COLUMNS`] rows for each of the
/// lobes', and a last row for the specular material (albedo, roughness).
#[inline(always)]
pub fn adjoint_chunk<S: Simd, M: PairModel>(
    simd: S,
    shared: &Shared<'_, M>,
    points: &[ShadePoint],
    (shaded, adjoint): (&[Layers], &[RadianceAdjoint]),
    out: &mut [PointAdjoint],
    partial: &mut [Row],
) {
    let (lobe_gradient, specular_row) = partial.split_at_mut(partial.len() - 1);
    let mut gradient = SpecularValue::default();
    let mut prepared = None;
    for (i, point) in points.iter().enumerate() {
        let lane = i % Lanes::<S>::LEN;
        if lane == 0 {
            let end = points.len().min(i + Lanes::<S>::LEN);
            prepared = Some(Prepared::<S, M>::new(simd, shared, &points[i..end]));
        }
        out[i] = PointAdjoint::default();
        let Some(prepared) = prepared.as_ref().filter(|_| !point.is_missed()) else { continue };
        let (terms, frozen) = prepared.point(lane);
        let weights = Weights::new(shared, point, &frozen, (&shaded[i], &adjoint[i]));
        let wide = splat::<S, M>(simd, &terms);
        let (diffuse, glossy, sums) = pull_back_lobes(simd, shared, &wide, &weights, lobe_gradient);
        out[i].albedo = std::array::from_fn(|c| weights.diffuse[c] / PI * diffuse[c]);
        let end = PointEnd {
            point,
            specular: shared.specular,
            terms: &terms,
            frozen: &frozen,
            sums: &sums,
            glossy: &Terms::from_fn(|b| std::array::from_fn(|c| weights.specular[c] * glossy.at(b)[c])),
        };
        out[i].normal = shared.model.pull_back_point(&end, &mut gradient);
    }
    let [r, g, b] = gradient.albedo;
    specular_row[0].0[..4].copy_from_slice(&[r, g, b, gradient.roughness]);
}

/// Walks the lobes for one point: adds their gradient onto `gradient` and returns the point's own sums.
#[inline(always)]
#[expect(clippy::type_complexity, reason = "three sums of the model's own shapes")]
fn pull_back_lobes<S: Simd, M: PairModel>(
    simd: S,
    shared: &Shared<'_, M>,
    terms: &M::Point<Lanes<S>>,
    weights: &Weights<M>,
    gradient: &mut [Row],
) -> (Vec3Of<f32>, M::Specular<Vec3Of<f32>>, M::Sums<f32>) {
    let mut walk = PullBack::<S, M> {
        kd: splat3(simd, weights.diffuse_light),
        ks: Terms::from_fn(|b| splat3(simd, weights.specular_light.at(b))),
        light: Light::zero(simd),
        sums: Terms::from_fn(|_| Lanes::splat(simd, 0.0)),
        gradient,
    };
    let model = shared.model;
    if M::CULLS {
        let unread: M::Lobe<Lanes<S>> = Terms::from_fn(|_| Lanes::splat(simd, 0.0));
        walk_culled(
            simd,
            shared,
            terms,
            &mut walk,
            |walk, b, at, lobe| {
                let columns =
                    walk.pull_back::<DIFFUSE>(model, terms, lobe.amplitude, &lobe.shape, &lobe.terms);
                walk.add_block(b, at, columns);
            },
            |walk, index, shape, amplitude| {
                let columns = walk.pull_back::<SPECULAR>(model, terms, amplitude, shape, &unread);
                walk.scatter(index, columns);
            },
        );
    } else {
        for (b, block) in shared.lobes.chunks_exact(block_rows::<M>()).enumerate() {
            for at in (0..MAX_LANES).step_by(Lanes::<S>::LEN) {
                let lobe = load_lobes::<S, M>(simd, block, at);
                let columns = walk.pull_back::<BOTH>(model, terms, lobe.amplitude, &lobe.shape, &lobe.terms);
                walk.add_block(b, at, columns);
            }
        }
    }
    let (diffuse, glossy) = walk.light.total();
    (diffuse, glossy, Terms::from_fn(|i| walk.sums.at(i).sum()))
}

/// One point's adjoint under way over the lobes.
struct PullBack<'a, S: Simd, M: PairModel> {
    /// Adjoints of diffuse light and of each specular term, per channel.
    kd: Vec3Of<Lanes<S>>,
    ks: M::Specular<Vec3Of<Lanes<S>>>,
    light: Light<S, M>,
    sums: M::Sums<Lanes<S>>,
    gradient: &'a mut [Row],
}

impl<S: Simd, M: PairModel> PullBack<'_, S, M> {
    /// Pulls a vector of lobes back; returns the lobes' gradient in [`LOBE_COLUMNS`] columns.
    #[inline(always)]
    fn pull_back<const PART: u8>(
        &mut self,
        model: M,
        terms: &M::Point<Lanes<S>>,
        mu: Vec3Of<Lanes<S>>,
        shape: &Shape<Lanes<S>>,
        lobe: &M::Lobe<Lanes<S>>,
    ) -> [Lanes<S>; LOBE_COLUMNS] {
        let (kd, ks) = (self.kd, self.ks);
        let adjoint = Response { diffuse: dot(kd, mu), specular: Terms::from_fn(|b| dot(ks.at(b), mu)) };
        let (response, back) = model.pull_back::<_, PART>(terms, shape, lobe, &adjoint);
        let (axis, [mut r, mut g, mut b]) = (back.shape.axis, scale(kd, response.diffuse));
        for i in 0..M::Specular::<f32>::LEN {
            [r, g, b] = mul_add3(ks.at(i), response.specular.at(i), [r, g, b]);
        }
        self.light.add(mu, &response);
        self.sums = Terms::from_fn(|i| self.sums.at(i) + back.point.at(i));
        [axis[0], axis[1], axis[2], back.shape.sharpness, r, g, b]
    }

    /// Adds the gradient of the vector at place `at` of block `b`.
    #[inline(always)]
    fn add_block(&mut self, b: usize, at: usize, columns: [Lanes<S>; LOBE_COLUMNS]) {
        let rows = &mut self.gradient[b * LOBE_COLUMNS..(b + 1) * LOBE_COLUMNS];
        for (row, value) in rows.iter_mut().zip(columns) {
            value.add_to(&mut row.0[at..at + Lanes::<S>::LEN]);
        }
    }

    /// Adds the gradient of lobes by their numbers.
    #[inline(always)]
    fn scatter(&mut self, index: &[usize], columns: [Lanes<S>; LOBE_COLUMNS]) {
        let mut values = [Row::ZERO; LOBE_COLUMNS];
        for (row, value) in values.iter_mut().zip(columns) {
            value.store(&mut row.0[..Lanes::<S>::LEN]);
        }
        for (i, lobe) in index.iter().enumerate() {
            let rows = &mut self.gradient[lobe / MAX_LANES * LOBE_COLUMNS..][..LOBE_COLUMNS];
            for (row, value) in rows.iter_mut().zip(&values) {
                row.0[lobe % MAX_LANES] += value.0[i];
            }
        }
    }
}
