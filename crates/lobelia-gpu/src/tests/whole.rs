//! A model of `lobelia-sg` whose pairs are all evaluated, as on the GPU.

use lobelia_sg::brdf::{SpecularAdjoint, SpecularValue};
use lobelia_sg::model::{PairModel, Part, PointEnd, PulledBack, Response};
use lobelia_sg::real::{Real, Vec3Of};
use lobelia_sg::sg::Shape;

/// The formulas of `M`, without what the kernels may skip.
#[derive(Clone, Copy)]
pub struct Whole<M>(pub M);

impl<M: PairModel> PairModel for Whole<M> {
    const CULLS: bool = false;
    type Point<F: Copy> = M::Point<F>;
    type Frozen<F: Copy> = M::Frozen<F>;
    type Lobe<F: Copy> = M::Lobe<F>;
    type Placed<F: Copy> = ();
    type Specular<F: Copy> = M::Specular<F>;
    type Sums<F: Copy> = M::Sums<F>;

    #[inline(always)]
    fn prepare_point<F: Real>(
        &self,
        normal: Vec3Of<F>,
        to_viewer: Vec3Of<F>,
        roughness: F,
    ) -> (M::Point<F>, M::Frozen<F>) {
        self.0.prepare_point(normal, to_viewer, roughness)
    }

    #[inline(always)]
    fn prepare_lobe<F: Real>(&self, sharpness: F) -> M::Lobe<F> {
        self.0.prepare_lobe(sharpness)
    }

    #[inline(always)]
    fn specular_weights(
        &self,
        frozen: &M::Frozen<f32>,
        specular: &SpecularValue,
    ) -> M::Specular<Vec3Of<f32>> {
        self.0.specular_weights(frozen, specular)
    }

    #[inline(always)]
    fn evaluate<F: Real, const PART: Part>(
        &self,
        point: &M::Point<F>,
        shape: &Shape<F>,
        lobe: &M::Lobe<F>,
    ) -> Response<F, M::Specular<F>> {
        self.0.evaluate::<F, PART>(point, shape, lobe)
    }

    #[inline(always)]
    fn pull_back<F: Real, const PART: Part>(
        &self,
        point: &M::Point<F>,
        shape: &Shape<F>,
        lobe: &M::Lobe<F>,
        adjoint: &Response<F, M::Specular<F>>,
    ) -> PulledBack<F, Self> {
        self.0.pull_back::<F, PART>(point, shape, lobe, adjoint)
    }

    fn pull_back_point(&self, end: &PointEnd<'_, Self>, gradient: &mut SpecularAdjoint) -> Vec3Of<f32> {
        let PointEnd { point, specular, terms, frozen, sums, specular_light } = *end;
        let end = PointEnd { point, specular, terms, frozen, sums, specular_light };
        self.0.pull_back_point(&end, gradient)
    }
}
