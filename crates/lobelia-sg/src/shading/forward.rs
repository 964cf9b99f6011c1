//! Radiance of a chunk of points.

use super::blocks::{Chunk, LobeVector, Prepared, Shared, reaching, splat};
use super::cull::{Gathered, Picked};
use super::walk::{Visit, walk};
use crate::columns::{Layers, LobeVisibility, PointVisibility, ShadePoint};
use crate::lanes::Lanes;
use crate::model::{DIFFUSE, PairModel, Part, Response, SPECULAR, Terms};
use crate::real::{Real, Vec3Of};
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
        let terms = &splat::<S, M>(simd, &terms);
        let mut shading = Shading { simd, model: shared.model, terms, row, light: Light::zero(simd) };
        walk(simd, shared, terms, &mut picked, &mut shading);
        let light = shading.light.total();
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

/// Broadcasts a color to every lane.
#[inline(always)]
pub(super) fn splat3<S: Simd>(simd: S, v: Vec3Of<f32>) -> Vec3Of<Lanes<S>> {
    [Lanes::splat(simd, v[0]), Lanes::splat(simd, v[1]), Lanes::splat(simd, v[2])]
}

/// The light of all lobes at one point, per channel.
pub(super) struct Sums<M: PairModel> {
    pub(super) diffuse: Vec3Of<f32>,
    pub(super) specular: M::Specular<Vec3Of<f32>>,
}

/// [`Sums`] in lanes, while lobes are added.
pub(super) struct Light<S: Simd, M: PairModel> {
    diffuse: Vec3Of<Lanes<S>>,
    specular: M::Specular<Vec3Of<Lanes<S>>>,
}

impl<S: Simd, M: PairModel> Light<S, M> {
    #[inline(always)]
    pub(super) fn zero(simd: S) -> Self {
        let zero = [Lanes::splat(simd, 0.0); 3];
        Self { diffuse: zero, specular: Terms::from_fn(|_| zero) }
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
            let sum = self.specular.at_mut(b);
            *sum = mul_add3(amplitude, response.specular.at(b), *sum);
        }
    }

    /// The sums over lanes of diffuse light and of each specular term.
    #[inline(always)]
    pub(super) fn total(&self) -> Sums<M> {
        let mut specular: M::Specular<Vec3Of<f32>> = Terms::from_fn(|_| [0.0; 3]);
        for b in 0..M::Specular::<f32>::LEN {
            *specular.at_mut(b) = sum3(&self.specular.at(b));
        }
        Sums { diffuse: sum3(&self.diffuse), specular }
    }
}
