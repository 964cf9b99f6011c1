//! The accurate integrals as a [`PairModel`].

use super::diffuse::{SharpnessTerms, prepared_cosine_integral};
use super::{
    NdfTerms, PointSlopes, PointSums, PointTerms, evaluate_specular, prepare_point, pull_back_diffuse,
    pull_back_point, pull_back_specular,
};
use crate::math::model::{
    self, DIFFUSE, PairAdjoint, PairModel, Part, PointEnd, Reach, Response, SPECULAR, Shape,
};
use crate::math::real::{Real, Vec3Of, add, dot, scale};
use crate::math::shading::SpecularValue;

/// The accurate integrals with `ALONG` × `ACROSS` nodes for the specular part (2 to 4, 1 to 3).
///
/// Specular parts of negligible pairs are left out. By half-vector geometry ∠(ω, r) ≤ 2∠(h, n), so |ω − r| ≤ 2|X| and the NDF
/// e^(−L|X|²/2) is below an SG of sharpness L/4 around the mirror direction r; its product with the light's SG is at most
/// e^(−aλ/(a + λ)·(1 − r·ξ)) with a = L/4.
#[derive(Clone, Copy, Debug, Default)]
pub struct Accurate<const ALONG: usize, const ACROSS: usize>;

/// [`super::Quality::Default`].
pub const ACCURATE_DEFAULT: Accurate<3, 2> = Accurate;
/// [`super::Quality::High`].
pub const ACCURATE_HIGH: Accurate<4, 3> = Accurate;

impl<F: Copy> PointTerms<F> {
    #[inline(always)]
    fn to_array(self) -> [F; 15] {
        let [[a, b, c], [d, e, f], [g, h, i]] = self.frame;
        let ([v, w], [n]) = (self.view, self.ndf);
        [a, b, c, d, e, f, g, h, i, v, w, self.shadowing, n.sharpness, n.start, n.scale]
    }

    #[inline(always)]
    fn from_array([a, b, c, d, e, f, g, h, i, v, w, shadowing, sharpness, start, scale]: [F; 15]) -> Self {
        let frame = [[a, b, c], [d, e, f], [g, h, i]];
        Self { frame, view: [v, w], shadowing, ndf: [NdfTerms { sharpness, start, scale }] }
    }
}

impl<F: Copy> PointSums<F> {
    #[inline(always)]
    fn to_array(self) -> [F; 5] {
        let ([n0, n1], [[l, w]]) = (self.normal, self.ndf);
        [n0, n1, self.shadowing, l, w]
    }

    #[inline(always)]
    fn from_array([n0, n1, shadowing, l, w]: [F; 5]) -> Self {
        Self { normal: [n0, n1], shadowing, ndf: [[l, w]] }
    }
}

impl<F: Real> PairAdjoint<F, [F; 5]> {
    #[inline(always)]
    fn new(back: super::PairAdjoint<F>) -> Self {
        let shape = Shape { axis: back.axis, sharpness: back.sharpness };
        Self { shape, point: back.point.to_array() }
    }

    #[inline(always)]
    fn add(&mut self, other: &Self) {
        self.shape.axis = add(self.shape.axis, other.shape.axis);
        self.shape.sharpness += other.shape.sharpness;
        for i in 0..5 {
            self.point[i] += other.point[i];
        }
    }
}

impl<const ALONG: usize, const ACROSS: usize> PairModel for Accurate<ALONG, ACROSS> {
    const CULLS: bool = true;
    type Point<F: Copy> = [F; 15];
    type Frozen<F: Copy> = [F; 3];
    type Lobe<F: Copy> = [F; 8];
    type Specular<F: Copy> = [F; 2];
    type Sums<F: Copy> = [F; 5];

    #[inline(always)]
    fn prepare_point<F: Real>(
        &self,
        normal: Vec3Of<F>,
        to_viewer: Vec3Of<F>,
        roughness: F,
    ) -> ([F; 15], [F; 3]) {
        let (terms, slopes) = prepare_point(normal, to_viewer, roughness);
        let [[sharpness, weight]] = slopes.ndf;
        (terms.to_array(), [sharpness, weight, slopes.shadowing])
    }

    #[inline(always)]
    fn prepare_lobe<F: Real>(&self, sharpness: F) -> [F; 8] {
        SharpnessTerms::new(sharpness).to_array()
    }

    #[inline(always)]
    fn specular_weights(&self, _frozen: &[f32; 3], specular: &SpecularValue) -> [Vec3Of<f32>; 2] {
        [[1.0; 3], specular.albedo]
    }

    #[inline(always)]
    fn reach<F: Real>(&self, point: &[F; 15]) -> Reach<F> {
        let point = PointTerms::from_array(*point);
        let [along, up] = point.view;
        let axis = add(scale(point.frame[0], -along), scale(point.frame[2], up));
        Reach { axis, sharpness: point.ndf[0].sharpness.times(0.25) }
    }

    #[inline(always)]
    fn evaluate<F: Real, const PART: Part>(
        &self,
        point: &[F; 15],
        shape: &Shape<F>,
        lobe: &[F; 8],
    ) -> Response<F, [F; 2]> {
        let zero = shape.sharpness.zero();
        let point = PointTerms::from_array(*point);
        let mut response = Response { diffuse: zero, specular: [zero; 2] };
        if PART & DIFFUSE != 0 {
            let terms = SharpnessTerms::from_array(*lobe);
            response.diffuse = prepared_cosine_integral(&terms, dot(point.frame[2], shape.axis)).value;
        }
        if PART & SPECULAR != 0 {
            response.specular = evaluate_specular::<F, ALONG, ACROSS, 1>(&point, shape.axis, shape.sharpness);
        }
        response
    }

    #[inline(always)]
    fn pull_back<F: Real, const PART: Part>(
        &self,
        point: &[F; 15],
        shape: &Shape<F>,
        lobe: &[F; 8],
        adjoint: &Response<F, [F; 2]>,
    ) -> (Response<F, [F; 2]>, PairAdjoint<F, [F; 5]>) {
        let zero = shape.sharpness.zero();
        let point = PointTerms::from_array(*point);
        let mut response = Response { diffuse: zero, specular: [zero; 2] };
        let none = Shape { axis: [zero; 3], sharpness: zero };
        let mut back = PairAdjoint { shape: none, point: [zero; 5] };
        if PART & DIFFUSE != 0 {
            let terms = SharpnessTerms::from_array(*lobe);
            let diffuse = prepared_cosine_integral(&terms, dot(point.frame[2], shape.axis));
            response.diffuse = diffuse.value;
            back.add(&PairAdjoint::new(pull_back_diffuse(&point, shape.axis, &diffuse, adjoint.diffuse)));
        }
        if PART & SPECULAR != 0 {
            let (value, specular) = pull_back_specular::<F, ALONG, ACROSS, 1>(
                &point,
                shape.axis,
                shape.sharpness,
                adjoint.specular,
            );
            response.specular = value;
            back.add(&PairAdjoint::new(specular));
        }
        (response, back)
    }

    #[inline(always)]
    fn pull_back_point(&self, end: &PointEnd<'_, Self>, gradient: &mut SpecularValue) -> Vec3Of<f32> {
        let [sharpness, weight, shadowing] = *end.frozen;
        let slopes = PointSlopes { ndf: [[sharpness, weight]], shadowing };
        let terms = PointTerms::from_array(*end.terms);
        let (normal, roughness) = pull_back_point(&terms, &slopes, &PointSums::from_array(*end.sums));
        gradient.roughness += roughness;
        for (sum, glossy) in gradient.albedo.iter_mut().zip(model::Terms::at(end.glossy, 1)) {
            *sum += glossy;
        }
        normal
    }
}
