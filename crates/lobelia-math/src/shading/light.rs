//! Sums over lobes of the light at one point.

use crate::lanes::Lanes;
use crate::model::{DIFFUSE, PairModel, Part, Response, SPECULAR, Terms};
use crate::real::{Real, Vec3Of};
use fearless_simd::Simd;

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

/// The same color in every lane.
#[inline(always)]
pub(super) fn splat3<S: Simd>(simd: S, v: Vec3Of<f32>) -> Vec3Of<Lanes<S>> {
    [Lanes::splat(simd, v[0]), Lanes::splat(simd, v[1]), Lanes::splat(simd, v[2])]
}

/// The light of all lobes at one point, per channel.
pub(super) struct Sums<M: PairModel> {
    pub(super) diffuse: Vec3Of<f32>,
    pub(super) specular: M::Specular<Vec3Of<f32>>,
}

/// The same sums in lanes, while lobes are added.
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
