//! Adjoint of a chunk of points: like [`super::forward`], with the response of every pair computed
//! again.

use super::blocks::{Chunk, LobeVector, Prepared, Shared, reaching, splat};
use super::cull::{Gathered, Picked};
use super::forward::{Light, mul_add3, splat3};
use super::walk::{Visit, walk};
use crate::brdf::SpecularAdjoint;
use crate::columns::{
    LOBE_COLUMNS, Layers, LobeVisibility, PointAdjoint, PointVisibility, RadianceAdjoint, RadianceColumns,
    ShadePoint,
};
use crate::lanes::{Lanes, MAX_LANES, RECORD, Row, record_of, record_of_mut};
use crate::model::{DIFFUSE, PairAdjoint, PairModel, Part, PointEnd, Response, SPECULAR, Terms};
use crate::real::{Real, Vec3Of, dot, scale};
use fearless_simd::Simd;
use std::f32::consts::PI;

/// Adjoint of one point's radiance, per channel, zero in channels that are clamped to zero: of the
/// diffuse layer, of the specular layer, and of the light in each layer.
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
        around: &PointVisibility,
        frozen: &M::Frozen<f32>,
        shaded: &Layers,
        adjoint: &RadianceAdjoint,
    ) -> Self {
        // A channel that is clamped to zero has zero derivatives.
        let live = |value: f32, adjoint: f32| if value > 0.0 { adjoint } else { 0.0 };
        let diffuse: Vec3Of<f32> = std::array::from_fn(|c| live(shaded.diffuse[c], adjoint.0[c]));
        let specular: Vec3Of<f32> =
            std::array::from_fn(|c| live(shaded.specular[c], adjoint.0[c]) * around.specular[c]);
        let weights = shared.model.specular_weights(frozen, shared.specular);
        Self {
            diffuse,
            specular,
            diffuse_light: std::array::from_fn(|c| diffuse[c] * point.albedo[c] / PI),
            specular_light: Terms::from_fn(|b| std::array::from_fn(|c| specular[c] * weights.at(b)[c])),
        }
    }
}

/// Adjoint of a chunk of points; adds the adjoints of shared parameters to `partial`:
/// [`LOBE_COLUMNS`] rows for each block of lobes, and a last row for the specular material (albedo,
/// roughness).
#[inline(always)]
pub fn adjoint_chunk<S: Simd, M: PairModel>(
    simd: S,
    shared: &Shared<'_, M>,
    Chunk { points, visibility }: Chunk<'_>,
    RadianceColumns { shaded, adjoint }: RadianceColumns<'_>,
    out: &mut [PointAdjoint],
    partial: &mut [Row],
) {
    let (lobe_gradient, specular_row) = partial.split_at_mut(partial.len() - 1);
    let mut gradient = SpecularAdjoint::default();
    let mut prepared = None;
    let mut picked = Picked::none();
    // Selected lobes are anywhere, so that the gradient of each stays together until the end.
    let mut records =
        vec![Row::ZERO; if M::CULLS { lobe_gradient.len().div_ceil(LOBE_COLUMNS) * RECORD } else { 0 }];
    for (i, point) in points.iter().enumerate() {
        let lane = i % Lanes::<S>::LEN;
        if lane == 0 {
            prepared = Some(Prepared::<S, M>::new(simd, shared, &points[i..]));
        }
        out[i] = PointAdjoint::default();
        let Some(prepared) = prepared.as_ref().filter(|_| !point.is_missed()) else { continue };
        let (terms, frozen) = &prepared.point(lane);
        let (row, around) = LobeVisibility::point(visibility, i, shared.stride());
        let weights = Weights::new(shared, point, &around, frozen, &shaded[i], &adjoint[i]);
        let wide = splat::<S, M>(simd, terms);
        let zero = Lanes::splat(simd, 0.0);
        let mut back = PullBack {
            simd,
            model: shared.model,
            terms: &wide,
            row,
            kd: splat3(simd, weights.diffuse_light),
            ks: Terms::from_fn(|b| splat3(simd, weights.specular_light.at(b))),
            light: Light::zero(simd),
            sums: Terms::from_fn(|_| zero),
            rows: lobe_gradient,
            records: &mut records,
        };
        walk(simd, shared, &wide, &mut picked, &mut back);
        let light = back.light.total();
        let mut sums: M::Sums<f32> = Terms::from_fn(|_| 0.0);
        for i in 0..M::Sums::<f32>::LEN {
            *sums.at_mut(i) = back.sums.at(i).sum();
        }
        out[i].albedo =
            std::array::from_fn(|c| weights.diffuse[c] / PI * (light.diffuse[c] + around.indirect[c]));
        // Per specular term and channel: adjoint of the specular layer times the light.
        let specular_light =
            &Terms::from_fn(|b| std::array::from_fn(|c| weights.specular[c] * light.specular.at(b)[c]));
        let end = PointEnd { point, specular: shared.specular, terms, frozen, sums: &sums, specular_light };
        out[i].normal = shared.model.pull_back_point(&end, &mut gradient);
    }
    add_records(&records, lobe_gradient);
    let [r, g, b] = gradient.albedo;
    specular_row[0].0[..4].copy_from_slice(&[r, g, b, gradient.roughness]);
}

/// Adds the gradients in records of lobes to their rows.
fn add_records(records: &[Row], rows: &mut [Row]) {
    for (block, rows) in rows.chunks_exact_mut(LOBE_COLUMNS).enumerate().take(records.len() / RECORD) {
        for lane in 0..MAX_LANES {
            let record = record_of(records, block * MAX_LANES + lane);
            rows.iter_mut().zip(record).for_each(|(row, value)| row.0[lane] += value);
        }
    }
}

/// The state of the loop over lobes in the adjoint of one point.
struct PullBack<'a, S: Simd, M: PairModel> {
    simd: S,
    model: M,
    terms: &'a M::Point<Lanes<S>>,
    /// Visibility of the lobes.
    row: Option<&'a [u8]>,
    /// Adjoints of diffuse light and of each specular term, per channel.
    kd: Vec3Of<Lanes<S>>,
    ks: M::Specular<Vec3Of<Lanes<S>>>,
    light: Light<S, M>,
    sums: M::Sums<Lanes<S>>,
    /// The gradient of the lobes so far: [`LOBE_COLUMNS`] rows for each block of lobes.
    rows: &'a mut [Row],
    /// Gradients of selected lobes, to be added to `rows`; a record for each lobe.
    records: &'a mut [Row],
}

impl<S: Simd, M: PairModel> PullBack<'_, S, M> {
    /// Adjoint of a response to a vector of lobes.
    #[inline(always)]
    fn adjoint_of(&self, mu: Vec3Of<Lanes<S>>) -> Response<Lanes<S>, M::Specular<Lanes<S>>> {
        Response { diffuse: dot(self.kd, mu), specular: Terms::from_fn(|b| dot(self.ks.at(b), mu)) }
    }

    /// Adds what one vector of lobes contributes to the point; returns the gradient of the lobes in
    /// columns.
    #[inline(always)]
    fn take<const PART: Part>(
        &mut self,
        mu: Vec3Of<Lanes<S>>,
        response: &Response<Lanes<S>, M::Specular<Lanes<S>>>,
        back: &PairAdjoint<Lanes<S>, M::Sums<Lanes<S>>>,
    ) -> [Lanes<S>; LOBE_COLUMNS] {
        let mut color = [Lanes::splat(self.simd, 0.0); 3];
        if PART & DIFFUSE != 0 {
            color = scale(self.kd, response.diffuse);
        }
        if PART & SPECULAR != 0 {
            for i in 0..M::Specular::<f32>::LEN {
                color = mul_add3(self.ks.at(i), response.specular.at(i), color);
            }
        }
        self.light.add::<PART>(mu, response);
        for i in 0..M::Sums::<f32>::LEN {
            *self.sums.at_mut(i) += back.point.at(i);
        }
        let ([x, y, z], [r, g, b]) = (back.shape.axis, color);
        [x, y, z, back.shape.sharpness, r, g, b]
    }
}

impl<S: Simd, M: PairModel> Visit<S, M> for PullBack<'_, S, M> {
    const ADJOINT: bool = true;

    #[inline(always)]
    fn block<const PART: Part>(&mut self, b: usize, at: usize, lobe: &LobeVector<S, M>) {
        let reaching = reaching(self.simd, self.row, b, at);
        let mut adjoint = self.adjoint_of(lobe.amplitude);
        adjoint.diffuse = adjoint.diffuse * reaching;
        let (mut response, back) =
            self.model.pull_back::<_, PART>(self.terms, &lobe.shape, &lobe.terms, &adjoint);
        response.diffuse = response.diffuse * reaching;
        let columns = self.take::<PART>(lobe.amplitude, &response, &back);
        let rows = &mut self.rows[b * LOBE_COLUMNS..(b + 1) * LOBE_COLUMNS];
        for (row, value) in rows.iter_mut().zip(columns) {
            value.add_to(&mut row.0[at..at + Lanes::<S>::LEN]);
        }
    }

    #[inline(always)]
    fn picked<const PART: Part>(&mut self, lobes: &Gathered<'_, S>, placed: &M::Placed<Lanes<S>>) {
        let (shape, mu) = (lobes.shape(), lobes.amplitude());
        let adjoint = self.adjoint_of(mu);
        let (specular, back) =
            self.model.pull_back_specular::<_, PART>(self.terms, &shape, placed, &adjoint.specular);
        let response = Response { diffuse: adjoint.diffuse, specular };
        scatter(self.take::<SPECULAR>(mu, &response, &back), lobes.index, self.records);
    }
}

/// Adds the gradient of a vector of selected lobes to their records.
#[inline(always)]
fn scatter<S: Simd>([a, b, c, d, e, f, g]: [Lanes<S>; LOBE_COLUMNS], index: &[f32], records: &mut [Row]) {
    let values = Lanes::records([a, b, c, d, e, f, g, a.zero()]);
    for (lane, lobe) in index.iter().enumerate() {
        let record = record_of_mut(records, *lobe as usize);
        for (sum, value) in record.iter_mut().zip(record_of(&values, lane)) {
            *sum += value;
        }
    }
}
