//! Radiance of a chunk of points.

use super::blocks::{LobeVector, reaching};
use super::cull::{Gathered, Picked, PickedByRule};
use super::light::{Light, Sums};
use super::prepared::{Chunk, Prepared, Shared, splat};
use super::walk::{Visit, walk};
use crate::lanes::Lanes;
use crate::lighting::{LobeVisibility, PointVisibility};
use crate::model::{PairModel, Part, Response, SPECULAR, Terms};
use crate::real::Vec3Of;
use crate::sample::{Layers, ShadePoint};
use fearless_simd::Simd;
use std::f32::consts::PI;

/// Radiance of a chunk of points.
#[inline(always)]
pub fn shade_chunk<S: Simd, M: PairModel>(
    simd: S,
    shared: &Shared<'_, M>,
    Chunk { points, visibility }: Chunk<'_>,
    out: &mut [Layers],
) {
    let mut prepared = None;
    let mut picked = Picked::none();
    for (i, (point, out)) in points.iter().zip(out).enumerate() {
        let lane = i % Lanes::<S>::LEN;
        if lane == 0 {
            prepared = Some(Prepared::<S, M>::new(simd, shared, &points[i..]));
        }
        *out = Layers::default();
        let Some(prepared) = prepared.as_ref().filter(|_| !point.is_missed()) else { continue };
        let (terms, frozen) = prepared.point(lane);
        let (row, around) = LobeVisibility::point(visibility, i, shared.stride());
        let light = light_of(simd, shared, &splat::<S, M>(simd, &terms), row, &mut picked);
        let weights = shared.model.specular_weights(&frozen, shared.specular);
        *out = layers::<M>(point, &around, &light, &weights);
    }
}

/// Radiance from the sums over the lobes.
#[inline(always)]
fn layers<M: PairModel>(
    point: &ShadePoint,
    around: &PointVisibility,
    light: &Sums<M>,
    weights: &M::Specular<Vec3Of<f32>>,
) -> Layers {
    let specular = |c: usize| -> f32 {
        (0..M::Specular::<f32>::LEN).map(|b| light.specular.at(b)[c] * weights.at(b)[c]).sum()
    };
    Layers {
        diffuse: std::array::from_fn(|c| {
            ((light.diffuse[c] + around.indirect[c]) * point.albedo[c] / PI).max(0.0)
        }),
        specular: std::array::from_fn(|c| (specular(c) * around.specular[c]).max(0.0)),
    }
}

/// The light of all lobes at one point.
#[inline(always)]
fn light_of<S: Simd, M: PairModel>(
    simd: S,
    shared: &Shared<'_, M>,
    terms: &M::Point<Lanes<S>>,
    row: Option<&[u8]>,
    picked: &mut PickedByRule,
) -> Sums<M> {
    let mut shading = Shading { simd, model: shared.model, terms, row, light: Light::zero(simd) };
    walk(simd, shared, terms, picked, &mut shading);
    shading.light.total()
}

/// The state of the loop over lobes for one point.
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
    fn picked<const PART: Part>(&mut self, lobes: &Gathered<'_, S>, placed: &M::Placed<Lanes<S>>) {
        let specular = self.model.specular::<_, PART>(self.terms, &lobes.shape(), placed);
        let response = Response { diffuse: Lanes::splat(self.simd, 0.0), specular };
        self.light.add::<SPECULAR>(lobes.amplitude(), &response);
    }
}
