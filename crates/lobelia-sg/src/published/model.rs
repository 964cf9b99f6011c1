//! The published formulas (BRDF: PhySG supp. eqs. 1–7; integrals: [`integral`](super::integral)) as
//! a [`PairModel`].

use super::pair::{Pair, evaluate_prepared, pull_back_pair};
use super::point::{FrozenBrdf, PointTerms, prepare_point, pull_back_normal};
use super::sharp::{SharpnessTerms, sharpness_terms};
use crate::brdf::{SpecularAdjoint, SpecularValue};
use crate::model::{PairAdjoint, PairModel, Part, PointEnd, PulledBack, Response};
use crate::real::{Real, Vec3Of, dot};
use crate::sg::Shape;

/// The published SG shading formulas (PhySG's `render_with_sg`), always with one SG for the NDF,
/// whatever the NDF of the material. Every pair is evaluated; no pair is skipped.
#[derive(Clone, Copy, Debug, Default)]
pub struct Published;

impl<F: Copy> PointTerms<F> {
    #[inline(always)]
    fn to_array(self) -> [F; 8] {
        let ([a, b, c], [d, e, f]) = (self.normal, self.mirror);
        [a, b, c, d, e, f, self.mirror_cosine, self.warp_sharpness]
    }

    #[inline(always)]
    fn from_array([a, b, c, d, e, f, mirror_cosine, warp_sharpness]: [F; 8]) -> Self {
        Self { normal: [a, b, c], mirror: [d, e, f], mirror_cosine, warp_sharpness }
    }
}

impl<F: Copy> FrozenBrdf<F> {
    #[inline(always)]
    fn to_array(self) -> [F; 8] {
        let ([a, b, c], [d, e, f]) = (self.by_cosine, self.by_roughness);
        [self.constant, self.slope, a, b, c, d, e, f]
    }

    #[inline(always)]
    fn from_array([constant, slope, a, b, c, d, e, f]: [F; 8]) -> Self {
        Self { constant, slope, by_cosine: [a, b, c], by_roughness: [d, e, f] }
    }
}

#[inline(always)]
fn response<F: Real>(pair: &Pair<F>) -> Response<F, [F; 1]> {
    Response { diffuse: pair.diffuse.value, specular: [pair.specular] }
}

impl PairModel for Published {
    const CULLS: bool = false;
    type Point<F: Copy> = [F; 8];
    type Frozen<F: Copy> = [F; 8];
    type Lobe<F: Copy> = SharpnessTerms<F>;
    type Placed<F: Copy> = ();
    type Specular<F: Copy> = [F; 1];
    type Sums<F: Copy> = [F; 8];

    #[inline(always)]
    fn prepare_point<F: Real>(
        &self,
        normal: Vec3Of<F>,
        to_viewer: Vec3Of<F>,
        roughness: F,
    ) -> ([F; 8], [F; 8]) {
        let (terms, brdf) = prepare_point(normal, to_viewer, roughness);
        (terms.to_array(), brdf.to_array())
    }

    #[inline(always)]
    fn prepare_lobe<F: Real>(&self, sharpness: F) -> SharpnessTerms<F> {
        // Below the bound the terms are not used, but they must be finite.
        let sharpness = sharpness.max(sharpness.one());
        sharpness_terms(sharpness, sharpness.inverse())
    }

    #[inline(always)]
    fn specular_weights(&self, frozen: &[f32; 8], specular: &SpecularValue) -> [Vec3Of<f32>; 1] {
        let brdf = FrozenBrdf::from_array(*frozen);
        [specular.albedo.map(|s| brdf.constant + brdf.slope * s)]
    }

    #[inline(always)]
    fn evaluate<F: Real, const PART: Part>(
        &self,
        point: &[F; 8],
        shape: &Shape<F>,
        lobe: &SharpnessTerms<F>,
    ) -> Response<F, [F; 1]> {
        let point = PointTerms::from_array(*point);
        response(&evaluate_prepared(&point, shape, lobe))
    }

    #[inline(always)]
    fn pull_back<F: Real, const PART: Part>(
        &self,
        point: &[F; 8],
        shape: &Shape<F>,
        lobe: &SharpnessTerms<F>,
        adjoint: &Response<F, [F; 1]>,
    ) -> PulledBack<F, Self> {
        let point = PointTerms::from_array(*point);
        let pair = evaluate_prepared(&point, shape, lobe);
        let (diffuse, [specular]) = (adjoint.diffuse, adjoint.specular);
        let back = pull_back_pair(&pair, &point, shape.axis, shape.sharpness, diffuse, specular);
        let shape = Shape { axis: back.axis, sharpness: back.sharpness };
        (response(&pair), PairAdjoint { shape, point: back.point.to_array() })
    }

    #[inline(always)]
    fn pull_back_point(&self, end: &PointEnd<'_, Self>, gradient: &mut SpecularAdjoint) -> Vec3Of<f32> {
        let brdf = FrozenBrdf::from_array(*end.frozen);
        let sums = PointTerms::from_array(*end.sums);
        let [specular_light] = *end.specular_light;
        let constant = specular_light[0] + specular_light[1] + specular_light[2];
        let slope = dot(specular_light, end.specular.albedo);
        for (sum, specular_light) in gradient.albedo.iter_mut().zip(specular_light) {
            *sum += specular_light * brdf.slope;
        }
        let chain = |by: &[f32; 3]| constant * by[0] + slope * by[1] + sums.warp_sharpness * by[2];
        gradient.roughness += chain(&brdf.by_roughness);
        let cosine = chain(&brdf.by_cosine) + sums.mirror_cosine;
        let through_view = pull_back_normal(end.point.normal, end.point.to_viewer, sums.mirror, cosine);
        std::array::from_fn(|i| sums.normal[i] + through_view[i])
    }
}
