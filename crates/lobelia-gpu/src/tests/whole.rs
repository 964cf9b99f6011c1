//! A model of `lobelia-sg` whose pairs are all evaluated, as on the GPU.

use lobelia_sg::brdf::{SpecularAdjoint, SpecularValue};
use lobelia_sg::model::{PairAdjoint, PairModel, Part, PointEnd, PulledBack, Reach, Response};
use lobelia_sg::real::{Real, Vec3Of};
use lobelia_sg::sg::Dual;
use lobelia_sg::sg::Shape;

/// The formulas of `M`, without what the kernels may skip.
#[derive(Clone, Copy)]
pub struct Whole<M>(pub M);

impl<M: PairModel> PairModel for Whole<M> {
    const CULLS: bool = false;
    type Point<F: Copy> = M::Point<F>;
    type Frozen<F: Copy> = M::Frozen<F>;
    type Lobe<F: Copy> = M::Lobe<F>;
    type Placed<F: Copy> = M::Placed<F>;
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
    fn reach<F: Real>(&self, point: &M::Point<F>) -> Reach<F> {
        self.0.reach(point)
    }

    #[inline(always)]
    fn irradiance<F: Real>(&self, point: &M::Point<F>, shape: &Shape<F>, lobe: &M::Lobe<F>) -> Dual<F> {
        self.0.irradiance(point, shape, lobe)
    }

    #[inline(always)]
    fn place_smooth<F: Real>(
        &self,
        point: &M::Point<F>,
        shape: &Shape<F>,
        width: F,
        irradiance: Dual<F>,
    ) -> M::Placed<F> {
        self.0.place_smooth(point, shape, width, irradiance)
    }

    #[inline(always)]
    fn place_two_smooth<F: Real>(
        &self,
        point: &M::Point<F>,
        shapes: [&Shape<F>; 2],
        widths: [F; 2],
        irradiances: [Dual<F>; 2],
    ) -> [M::Placed<F>; 2] {
        self.0.place_two_smooth(point, shapes, widths, irradiances)
    }

    #[inline(always)]
    fn place<F: Real, const PART: Part>(&self, point: &M::Point<F>, shape: &Shape<F>) -> M::Placed<F> {
        self.0.place::<F, PART>(point, shape)
    }

    #[inline(always)]
    fn place_two<F: Real, const PART: Part>(
        &self,
        point: &M::Point<F>,
        shapes: [&Shape<F>; 2],
    ) -> [M::Placed<F>; 2] {
        self.0.place_two::<F, PART>(point, shapes)
    }

    #[inline(always)]
    fn specular<F: Real, const PART: Part>(
        &self,
        point: &M::Point<F>,
        shape: &Shape<F>,
        placed: &M::Placed<F>,
    ) -> M::Specular<F> {
        self.0.specular::<F, PART>(point, shape, placed)
    }

    #[inline(always)]
    fn pull_back_specular<F: Real, const PART: Part>(
        &self,
        point: &M::Point<F>,
        shape: &Shape<F>,
        placed: &M::Placed<F>,
        adjoint: &M::Specular<F>,
    ) -> (M::Specular<F>, PairAdjoint<F, M::Sums<F>>) {
        self.0.pull_back_specular::<F, PART>(point, shape, placed, adjoint)
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
