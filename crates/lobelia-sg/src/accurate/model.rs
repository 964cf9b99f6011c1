//! The accurate integrals as a [`PairModel`].

use super::adjoint::{pull_back_diffuse, pull_back_nodes, pull_back_specular};
use super::diffuse::{prepared_cosine_integral, sharpness_terms};
use super::ggx::{GGX_TERMS, GgxSgs};
use super::narrow::{MOST_SGS, mirror, narrowness};
use super::pair::{evaluate_specular, place_sgs, sum_nodes};
use super::placement::{GGX, LocalLight, Placement, SG, place, place_two};
use super::point;
use super::point::{
    Mixture, NdfTerms, OneSg, PointDerivatives, PointSums, PointTerms, prepare_with_ndf, pull_back_point,
};
use super::smooth::{Ring, broadness, pull_back_smooth, smooth_light, smoothness};
use crate::brdf::{SpecularAdjoint, SpecularValue};
use crate::model::{
    DIFFUSE, NARROW, PairAdjoint, PairModel, Part, PointEnd, PulledBack, Reach, Response, SMOOTH, SPECULAR,
};
use crate::real::{Real, Vec3Of, add, dot};
use crate::sg::{Dual, Shape};
use crate::{model, two::Two};

/// The accurate integrals with `ALONG` × `ACROSS` nodes for the specular part (2 to 4, 1 to 3) of
/// each of the SGs of an NDF. `NDF` is 1 for one SG; for several, one more than there are, for the
/// distribution itself.
///
/// Specular parts of negligible pairs are left out. By half-vector geometry ∠(ω, r) ≤ 2∠(h, n), so
/// |ω − r| ≤ 2|X| and the NDF e^(−L|X|²/2) is below an SG of sharpness L/4 around the mirror
/// direction r; its product with the light's SG is at most e^(−aλ/(a + λ)·(1 − r·ξ)) with a = L/4.
/// The broadest of several SGs bounds all of them. Independently, the specular light is at most the
/// irradiance times the BRDF's largest value.
#[derive(Clone, Copy, Debug, Default)]
pub struct Accurate<D, const NDF: usize, const ALONG: usize, const ACROSS: usize>(D);

/// [`Quality::Default`](super::Quality::Default).
pub const ACCURATE_DEFAULT: Accurate<OneSg, 1, 3, 2> = Accurate(OneSg);
/// [`Quality::High`](super::Quality::High).
pub const ACCURATE_HIGH: Accurate<OneSg, 1, 4, 3> = Accurate(OneSg);
/// [`Quality::Default`](super::Quality::Default) with GGX for the NDF.
pub const GGX_DEFAULT: Accurate<GgxSgs, GGX_TERMS, 3, 2> = Accurate(GgxSgs);
/// [`Quality::High`](super::Quality::High) with GGX for the NDF.
pub const GGX_HIGH: Accurate<GgxSgs, GGX_TERMS, 4, 3> = Accurate(GgxSgs);

/// Nodes of the sum for the specular part of a pair.
#[derive(Clone, Copy)]
pub enum Placed<F> {
    /// Nodes around the peak.
    Peak(Placement<F>),
    /// Nodes around the peak of each SG.
    Peaks,
    /// Directions around the lobe, and the irradiance from it.
    Smooth(Ring<F>, Dual<F>),
}

impl<F: Copy> Placed<F> {
    #[inline(always)]
    fn peak(self) -> Option<Placement<F>> {
        if let Self::Peak(placement) = self { Some(placement) } else { None }
    }
}

/// [`PointTerms`] as numbers: sharpness, start and scale of each SG come last.
type PointNumbers<F, const NDF: usize> = ([F; 12], [[F; 3]; NDF]);
/// [`PointSums`] as numbers.
type SumNumbers<F, const NDF: usize> = ([F; 3], [[F; 2]; NDF]);

impl<F: Copy, const NDF: usize> PointTerms<F, NDF> {
    #[inline(always)]
    fn to_numbers(self) -> PointNumbers<F, NDF> {
        let [[a, b, c], [d, e, f], [g, h, i]] = self.frame;
        let [v, w] = self.view;
        let first = self.ndf[0];
        let mut ndf = [[first.sharpness, first.start, first.scale]; NDF];
        for (numbers, n) in ndf.iter_mut().zip(self.ndf) {
            *numbers = [n.sharpness, n.start, n.scale];
        }
        ([a, b, c, d, e, f, g, h, i, v, w, self.shadowing], ndf)
    }

    #[inline(always)]
    fn from_numbers(([a, b, c, d, e, f, g, h, i, v, w, shadowing], ndf): PointNumbers<F, NDF>) -> Self {
        let frame = [[a, b, c], [d, e, f], [g, h, i]];
        let [sharpness, start, scale] = ndf[0];
        let mut terms = [NdfTerms { sharpness, start, scale }; NDF];
        for (terms, [sharpness, start, scale]) in terms.iter_mut().zip(ndf) {
            *terms = NdfTerms { sharpness, start, scale };
        }
        Self { frame, view: [v, w], shadowing, ndf: terms }
    }
}

impl<F: Copy, const NDF: usize> PointSums<F, NDF> {
    #[inline(always)]
    fn to_numbers(self) -> SumNumbers<F, NDF> {
        let [n0, n1] = self.normal;
        ([n0, n1, self.shadowing], self.ndf)
    }

    #[inline(always)]
    fn from_numbers(([n0, n1, shadowing], ndf): SumNumbers<F, NDF>) -> Self {
        Self { normal: [n0, n1], shadowing, ndf }
    }
}

impl<F: Real, const NDF: usize> PairAdjoint<F, SumNumbers<F, NDF>> {
    #[inline(always)]
    fn new(back: point::PairAdjoint<F, NDF>) -> Self {
        let shape = Shape { axis: back.axis, sharpness: back.sharpness };
        Self { shape, point: back.point.to_numbers() }
    }

    #[inline(always)]
    fn add(&mut self, other: &Self) {
        self.shape.axis = add(self.shape.axis, other.shape.axis);
        self.shape.sharpness += other.shape.sharpness;
        for i in 0..3 {
            self.point.0[i] += other.point.0[i];
        }
        for m in 0..NDF {
            self.point.1[m][0] += other.point.1[m][0];
            self.point.1[m][1] += other.point.1[m][1];
        }
    }
}

impl<D: Mixture<NDF>, const NDF: usize, const ALONG: usize, const ACROSS: usize> PairModel
    for Accurate<D, NDF, ALONG, ACROSS>
{
    const CULLS: bool = true;
    const HAS_NARROW: bool = NDF > 1;
    const HAS_SMOOTH: bool = true;
    type Point<F: Copy> = PointNumbers<F, NDF>;
    type Frozen<F: Copy> = ([F; 1], [[F; 2]; NDF]);
    type Lobe<F: Copy> = [F; 8];
    type Placed<F: Copy> = Placed<F>;
    type Specular<F: Copy> = [F; 2];
    type Sums<F: Copy> = SumNumbers<F, NDF>;

    #[inline(always)]
    fn prepare_point<F: Real>(
        &self,
        normal: Vec3Of<F>,
        to_viewer: Vec3Of<F>,
        roughness: F,
    ) -> (Self::Point<F>, Self::Frozen<F>) {
        let (terms, derivatives) = prepare_with_ndf::<F, D, NDF>(normal, to_viewer, roughness);
        (terms.to_numbers(), ([derivatives.shadowing], derivatives.ndf))
    }

    #[inline(always)]
    fn prepare_lobe<F: Real>(&self, sharpness: F) -> [F; 8] {
        sharpness_terms(sharpness)
    }

    #[inline(always)]
    fn specular_weights(&self, _frozen: &Self::Frozen<f32>, specular: &SpecularValue) -> [Vec3Of<f32>; 2] {
        [[1.0; 3], specular.albedo]
    }

    #[inline(always)]
    fn reach<F: Real>(&self, point: &Self::Point<F>) -> Reach<F> {
        let point = PointTerms::from_numbers(*point);
        let mut broadest = point.ndf[0].sharpness;
        for ndf in &point.ndf[1..] {
            broadest = broadest.min(ndf.sharpness);
        }
        // F ≤ 1, and the light's factor of G over its cosine is at most 1/k.
        let brightest = (point.ndf[NDF - 1].scale * point.shadowing.inverse()).times(0.25);
        Reach { axis: mirror(&point), sharpness: broadest.times(0.25), brightest }
    }

    #[inline(always)]
    fn narrow<F: Real>(&self, point: &Self::Point<F>, shape: &Shape<F>) -> (F, F) {
        narrowness(&PointTerms::from_numbers(*point), shape.axis, shape.sharpness)
    }

    #[inline(always)]
    fn may_have_smooth<F: Real>(&self, point: &Self::Point<F>) -> bool {
        let broad = broadness(&PointTerms::from_numbers(*point));
        broad.zero().any_lt(broad)
    }

    #[inline(always)]
    fn smooth<F: Real>(&self, point: &Self::Point<F>, shape: &Shape<F>, mirrored: F) -> F {
        smoothness(&PointTerms::from_numbers(*point), shape.axis, shape.sharpness, mirrored)
    }

    #[inline(always)]
    fn irradiance<F: Real>(&self, point: &Self::Point<F>, shape: &Shape<F>, lobe: &[F; 8]) -> Dual<F> {
        let normal = PointTerms::from_numbers(*point).frame[2];
        prepared_cosine_integral(lobe, dot(normal, shape.axis))
    }

    #[inline(always)]
    fn place<F: Real, const PART: Part>(
        &self,
        point: &Self::Point<F>,
        shape: &Shape<F>,
        width: F,
        irradiance: Dual<F>,
    ) -> Self::Placed<F> {
        let point = PointTerms::from_numbers(*point);
        let light = LocalLight::new(&point, shape);
        match (PART, NDF) {
            (SMOOTH, _) => Placed::Smooth(Ring::new(&light, width), irradiance),
            (NARROW, _) => Placed::Peak(place::<F, GGX>(point.view, &point.ndf[NDF - 1], &light)),
            (_, 1) => Placed::Peak(place::<F, SG>(point.view, &point.ndf[0], &light)),
            _ => Placed::Peaks,
        }
    }

    #[inline(always)]
    fn place_two<F: Real, const PART: Part>(
        &self,
        point: &Self::Point<F>,
        [one, two]: [&Shape<F>; 2],
        [a, b]: [F; 2],
        [first, second]: [Dual<F>; 2],
    ) -> [Self::Placed<F>; 2] {
        let point = PointTerms::from_numbers(*point);
        let (ndf, view) = (&point.ndf[NDF - 1], point.view);
        let lights = [&LocalLight::new(&point, one), &LocalLight::new(&point, two)];
        let [one, two] = match (PART, NDF) {
            (SMOOTH, _) => {
                let [one, two] = Ring::new(&LocalLight::two(lights[0], lights[1]), Two(a, b)).split();
                return [Placed::Smooth(one, first), Placed::Smooth(two, second)];
            }
            (NARROW, _) => place_two::<F, GGX>(view, [ndf, ndf], lights),
            (_, 1) => place_two::<F, SG>(view, [ndf, ndf], lights),
            _ => return [Placed::Peaks; 2],
        };
        [Placed::Peak(one), Placed::Peak(two)]
    }

    #[inline(always)]
    fn specular<F: Real, const PART: Part>(
        &self,
        point: &Self::Point<F>,
        shape: &Shape<F>,
        placed: &Self::Placed<F>,
    ) -> [F; 2] {
        let point = PointTerms::from_numbers(*point);
        let light = LocalLight::new(&point, shape);
        match (PART, *placed) {
            (SMOOTH, Placed::Smooth(ring, irradiance)) => smooth_light(&point, &light, &ring, &irradiance),
            (NARROW, Placed::Peak(placed)) => {
                sum_nodes::<F, ALONG, ACROSS, NDF, GGX>(&point, &light, &[placed; MOST_SGS])
            }
            (_, placed) => {
                let placed = place_sgs(&point, &light, placed.peak());
                sum_nodes::<F, ALONG, ACROSS, NDF, SG>(&point, &light, &placed)
            }
        }
    }

    #[inline(always)]
    fn pull_back_specular<F: Real, const PART: Part>(
        &self,
        point: &Self::Point<F>,
        shape: &Shape<F>,
        placed: &Self::Placed<F>,
        adjoint: &[F; 2],
    ) -> ([F; 2], PairAdjoint<F, Self::Sums<F>>) {
        let point = PointTerms::from_numbers(*point);
        let light = LocalLight::new(&point, shape);
        let (value, back) = match (PART, *placed) {
            (SMOOTH, Placed::Smooth(ring, irradiance)) => {
                pull_back_smooth(&point, &light, &ring, &irradiance, *adjoint)
            }
            (NARROW, Placed::Peak(placed)) => {
                let placed = [placed; MOST_SGS];
                pull_back_nodes::<F, ALONG, ACROSS, NDF, GGX>(&point, &light, &placed, *adjoint)
            }
            (_, placed) => {
                let placed = place_sgs(&point, &light, placed.peak());
                pull_back_nodes::<F, ALONG, ACROSS, NDF, SG>(&point, &light, &placed, *adjoint)
            }
        };
        (value, PairAdjoint::new(back))
    }

    #[inline(always)]
    fn evaluate<F: Real, const PART: Part>(
        &self,
        numbers: &Self::Point<F>,
        shape: &Shape<F>,
        lobe: &[F; 8],
    ) -> Response<F, [F; 2]> {
        let zero = shape.sharpness.zero();
        let point = PointTerms::from_numbers(*numbers);
        let mut response = Response { diffuse: zero, specular: [zero; 2] };
        if PART & DIFFUSE != 0 {
            response.diffuse = self.irradiance(numbers, shape, lobe).value;
        }
        if PART & SPECULAR != 0 {
            let irradiance = self.irradiance(numbers, shape, lobe);
            response.specular =
                evaluate_specular::<F, ALONG, ACROSS, NDF>(&point, shape.axis, shape.sharpness, &irradiance);
        }
        response
    }

    #[inline(always)]
    fn pull_back<F: Real, const PART: Part>(
        &self,
        numbers: &Self::Point<F>,
        shape: &Shape<F>,
        lobe: &[F; 8],
        adjoint: &Response<F, [F; 2]>,
    ) -> PulledBack<F, Self> {
        let zero = shape.sharpness.zero();
        let point = PointTerms::from_numbers(*numbers);
        let irradiance = self.irradiance(numbers, shape, lobe);
        let mut response = Response { diffuse: zero, specular: [zero; 2] };
        let none = Shape { axis: [zero; 3], sharpness: zero };
        let mut back = PairAdjoint { shape: none, point: ([zero; 3], [[zero; 2]; NDF]) };
        if PART & DIFFUSE != 0 {
            response.diffuse = irradiance.value;
            back.add(&PairAdjoint::new(pull_back_diffuse(&point, shape.axis, &irradiance, adjoint.diffuse)));
        }
        if PART & SPECULAR != 0 {
            let (value, specular) = pull_back_specular::<F, ALONG, ACROSS, NDF>(
                &point,
                shape.axis,
                shape.sharpness,
                &irradiance,
                adjoint.specular,
            );
            response.specular = value;
            back.add(&PairAdjoint::new(specular));
        }
        (response, back)
    }

    #[inline(always)]
    fn pull_back_point(&self, end: &PointEnd<'_, Self>, gradient: &mut SpecularAdjoint) -> Vec3Of<f32> {
        let ([shadowing], ndf) = *end.frozen;
        let derivatives = PointDerivatives { ndf, shadowing };
        let terms = PointTerms::from_numbers(*end.terms);
        let (normal, roughness) = pull_back_point(&terms, &derivatives, &PointSums::from_numbers(*end.sums));
        gradient.roughness += roughness;
        for (sum, specular_light) in gradient.albedo.iter_mut().zip(model::Terms::at(end.specular_light, 1)) {
            *sum += specular_light;
        }
        normal
    }
}
