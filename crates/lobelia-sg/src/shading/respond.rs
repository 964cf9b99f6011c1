//! The response of each point to each lobe of unit amplitude, for the linear systems of the light.

use super::blocks::{LobeVector, Prepared, Shared, splat};
use super::cull::{Gathered, Picked};
use super::walk::{Visit, walk};
use crate::lanes::{Lanes, MAX_LANES};
use crate::model::{DIFFUSE, PairModel, Part, SPECULAR, Terms};
use crate::{columns::ShadePoint, real::Vec3Of};
use fearless_simd::Simd;

/// Rows of a point's response: irradiance, and specular radiance in red, green and blue.
pub const RESPONSE_ROWS: usize = 4;

/// Responses of a chunk of points, [`RESPONSE_ROWS`] rows of a value per lobe each.
#[inline(always)]
pub fn respond_chunk<S: Simd, M: PairModel>(
    simd: S,
    shared: &Shared<'_, M>,
    points: &[ShadePoint],
    out: &mut [f32],
) {
    let stride = shared.stride();
    let mut prepared = None;
    let mut picked = Picked::none();
    let mut rows = vec![0.0; (1 + M::Specular::<f32>::LEN) * stride];
    for (i, (point, out)) in points.iter().zip(out.chunks_exact_mut(RESPONSE_ROWS * stride)).enumerate() {
        let lane = i % Lanes::<S>::LEN;
        if lane == 0 {
            prepared = Some(Prepared::<S, M>::new(simd, shared, &points[i..]));
        }
        out.fill(0.0);
        let Some(prepared) = prepared.as_ref().filter(|_| !point.is_missed()) else { continue };
        let (terms, frozen) = prepared.point(lane);
        let terms = splat::<S, M>(simd, &terms);
        rows.fill(0.0);
        let mut responding = Responding { model: shared.model, terms: &terms, stride, rows: &mut rows };
        walk(simd, shared, &terms, &mut picked, &mut responding);
        combine::<M>(&rows, &shared.model.specular_weights(&frozen, shared.specular), stride, out);
    }
}

/// Weighs the specular terms of each channel; nothing is negative.
#[inline(always)]
fn combine<M: PairModel>(rows: &[f32], weights: &M::Specular<Vec3Of<f32>>, stride: usize, out: &mut [f32]) {
    let (irradiance, specular) = out.split_at_mut(stride);
    irradiance.iter_mut().zip(rows).for_each(|(out, value)| *out = value.max(0.0));
    for (c, out) in specular.chunks_exact_mut(stride).enumerate() {
        for b in 0..M::Specular::<f32>::LEN {
            let (weight, row) = (weights.at(b)[c], &rows[(1 + b) * stride..][..stride]);
            out.iter_mut().zip(row).for_each(|(sum, value)| *sum += weight * value);
        }
        out.iter_mut().for_each(|sum| *sum = sum.max(0.0));
    }
}

/// The state of the loop over lobes for one point.
struct Responding<'a, S: Simd, M: PairModel> {
    model: M,
    terms: &'a M::Point<Lanes<S>>,
    stride: usize,
    /// Irradiance, then each specular term.
    rows: &'a mut [f32],
}

impl<S: Simd, M: PairModel> Visit<S, M> for Responding<'_, S, M> {
    #[inline(always)]
    fn block<const PART: Part>(&mut self, b: usize, at: usize, lobe: &LobeVector<S, M>) {
        let response = self.model.evaluate::<_, PART>(self.terms, &lobe.shape, &lobe.terms);
        let first = b * MAX_LANES + at;
        if PART & DIFFUSE != 0 {
            response.diffuse.store(&mut self.rows[first..first + Lanes::<S>::LEN]);
        }
        if PART & SPECULAR != 0 {
            for k in 0..M::Specular::<f32>::LEN {
                let first = (1 + k) * self.stride + first;
                response.specular.at(k).store(&mut self.rows[first..first + Lanes::<S>::LEN]);
            }
        }
    }

    #[inline(always)]
    fn picked<const PART: Part>(&mut self, lobes: &Gathered<'_, S>, placed: &M::Placed<Lanes<S>>) {
        let specular = self.model.specular::<_, PART>(self.terms, &lobes.shape(), placed);
        for k in 0..M::Specular::<f32>::LEN {
            let mut values = [0.0; MAX_LANES];
            specular.at(k).store(&mut values[..Lanes::<S>::LEN]);
            for (lobe, value) in lobes.index.iter().zip(values) {
                self.rows[(1 + k) * self.stride + *lobe as usize] = value;
            }
        }
    }
}
