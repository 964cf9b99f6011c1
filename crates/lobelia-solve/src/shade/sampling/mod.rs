//! Sampling for paths: scattered directions, SG light, and the combination of both.
//!
//! Generic over the float, so that the path tracer runs in `f32` and tests run in `f64` with the same code.

pub mod sobol;

use glam::Vec3;
use lobelia_sg::brdf::{Facets, Ndf, fresnel_power, ndf_sharpness, normal_distribution, specular_affine};
use lobelia_sg::ray::{Illuminate, LightSample};
use lobelia_sg::real::{Real, Vec3Of, add, dot, scale, sub};
use lobelia_sg::sg;
use lobelia_world::light::LightLobe;
use std::f64::consts::PI;

/// A scalar type for sampling of directions.
pub trait SampleReal: Real + PartialOrd {
    /// A number in `[0, 1)` from a 32-bit fixed-point fraction.
    fn from_bits(bits: u32) -> Self;
    /// Whether `self` is above zero; false for NaN.
    #[inline(always)]
    fn above_zero(self) -> bool {
        self > self.zero()
    }
    /// ln(1 + self).
    fn ln_1p(self) -> Self;
    /// e to the power of `self`, minus one.
    fn exp_m1(self) -> Self;
    /// Sine and cosine of `self` radians.
    fn sin_cos(self) -> (Self, Self);
}

impl SampleReal for f32 {
    #[inline(always)]
    fn from_bits(bits: u32) -> Self {
        // 24 bits, so that the result stays below one.
        (bits >> 8) as f32 * (1.0 / 16_777_216.0)
    }
    #[inline(always)]
    fn ln_1p(self) -> Self {
        self.ln_1p()
    }
    #[inline(always)]
    fn exp_m1(self) -> Self {
        self.exp_m1()
    }
    #[inline(always)]
    fn sin_cos(self) -> (Self, Self) {
        self.sin_cos()
    }
}

impl SampleReal for f64 {
    #[inline(always)]
    fn from_bits(bits: u32) -> Self {
        (f64::from(bits) + 0.5) * (1.0 / 4_294_967_296.0)
    }
    #[inline(always)]
    fn ln_1p(self) -> Self {
        self.ln_1p()
    }
    #[inline(always)]
    fn exp_m1(self) -> Self {
        self.exp_m1()
    }
    #[inline(always)]
    fn sin_cos(self) -> (Self, Self) {
        self.sin_cos()
    }
}

/// Three orthonormal axes; the third is the normal.
#[derive(Clone, Copy, Debug)]
pub struct TangentFrame<F> {
    tangent: Vec3Of<F>,
    bitangent: Vec3Of<F>,
    normal: Vec3Of<F>,
}

impl<F: SampleReal> TangentFrame<F> {
    /// Axes around a unit normal (Duff et al., "Building an Orthonormal Basis, Revisited", JCGT 6(1), 2017).
    #[inline]
    pub fn new(normal: Vec3Of<F>) -> Self {
        let [x, y, z] = normal;
        let sign = z.select_lt(z.zero(), -z.one(), z.one());
        let a = -(sign + z).recip();
        let b = x * y * a;
        Self {
            tangent: [sign * x * x * a + z.one(), sign * b, -(sign * x)],
            bitangent: [b, sign + y * y * a, -y],
            normal,
        }
    }

    /// The world-space vector with these local coordinates.
    #[inline]
    pub fn world(&self, x: F, y: F, z: F) -> Vec3Of<F> {
        add(add(scale(self.tangent, x), scale(self.bitangent, y)), scale(self.normal, z))
    }
}

/// Least sharpness; below it, sampling is practically uniform over the sphere.
const LEAST_SHARPNESS: f64 = 1e-6;

/// Density per steradian at `direction` of directions distributed as the SG around `axis`, over the whole sphere.
#[inline]
pub fn sg_pdf<F: SampleReal>(direction: Vec3Of<F>, axis: Vec3Of<F>, sharpness: F) -> F {
    let sharpness = sharpness.max(sharpness.lit(LEAST_SHARPNESS));
    let norm = -(sharpness.times(-2.0)).exp_m1().times(2.0 * PI);
    sg::evaluate(direction, axis, sharpness) * sharpness / norm
}

/// Draws a direction distributed exactly as an SG around the frame's normal, over the whole sphere.
#[inline]
pub fn sample_sg<F: SampleReal>(frame: &TangentFrame<F>, sharpness: F, u: [F; 2]) -> Vec3Of<F> {
    let sharpness = sharpness.max(sharpness.lit(LEAST_SHARPNESS));
    // 1 − cos θ rather than cos θ: sharp lobes keep their accuracy in f32.
    let fall = (-(u[0] * sharpness.times(-2.0).exp_m1()).ln_1p() / sharpness).relu();
    let fall = fall.min(fall.lit(2.0));
    let sine = (fall * (fall.lit(2.0) - fall)).sqrt();
    let (s, c) = u[1].times(2.0 * PI).sin_cos();
    frame.world(sine * c, sine * s, fall.one() - fall)
}

/// Draws a microfacet normal around the frame's normal in proportion to GGX's D·(n·h).
#[inline]
fn sample_ggx<F: SampleReal>(frame: &TangentFrame<F>, roughness: F, u: [F; 2]) -> Vec3Of<F> {
    let square = roughness * roughness;
    let alpha2 = square * square;
    let scaled = alpha2 * u[0];
    let sine2 = scaled / (u[0].one() - u[0] + scaled);
    let cosine = (sine2.one() - sine2).relu().sqrt();
    let (s, c) = u[1].times(2.0 * PI).sin_cos();
    let sine = sine2.sqrt();
    frame.world(sine * c, sine * s, cosine)
}

/// Scattering at a point for light from one direction: BRDF times cosine, in two parts, and the density of the direction.
#[derive(Clone, Copy, Debug)]
pub struct Scattered<F> {
    /// a/π · (n·ωi), per channel.
    pub diffuse: Vec3Of<F>,
    /// f_s · (n·ωi), per channel.
    pub specular: Vec3Of<F>,
    /// Density per steradian with which [`Scatterer::sample`] draws the direction.
    pub pdf: F,
}

/// A surface point seen from one side: evaluates and samples its BRDF.
///
/// The density is a mixture of the cosine around the normal and of mirror directions at microfacet normals drawn
/// exactly from the NDF's SG, for which f_s (n·ωi)/pdf = F·G·(ωo·h)/((n·ωo)·chance) is bounded. From GGX they are drawn in
/// proportion to D·(n·h), for which it is that over n·h: bounded as well, since n·h ≥ (n·ωo + n·ωi)/2.
#[derive(Clone, Copy, Debug)]
pub struct Scatterer<F> {
    frame: TangentFrame<F>,
    to_viewer: Vec3Of<F>,
    albedo: Vec3Of<F>,
    specular_albedo: Vec3Of<F>,
    facets: Facets<F>,
    /// Probability of sampling the specular part; zero if there is none.
    specular_chance: F,
}

impl<F: SampleReal> Scatterer<F> {
    /// A point with a unit shading `normal`, seen along the unit direction `to_viewer`; `specular` is (albedo, microfacets).
    ///
    /// `None` if the viewer is below the horizon of the shading normal, where the point scatters no light.
    #[inline]
    pub fn new(
        normal: Vec3Of<F>,
        to_viewer: Vec3Of<F>,
        albedo: Vec3Of<F>,
        specular: Option<(Vec3Of<F>, Facets<F>)>,
    ) -> Option<Self> {
        let cos_view = dot(normal, to_viewer);
        let zero = cos_view.zero();
        if !cos_view.above_zero() {
            return None;
        }
        let mean = |c: Vec3Of<F>| (c[0] + c[1] + c[2]).times(1.0 / 3.0);
        let (specular_albedo, facets, specular_chance) = match specular {
            None => ([zero; 3], Facets::sg(zero.one()), zero),
            Some((s, facets)) => {
                let power = fresnel_power(cos_view);
                let reflected = mean(s) * (power.one() - power) + power;
                let chance = reflected / (reflected + mean(albedo).max(zero.lit(1e-6)));
                (s, facets, chance.max(zero.lit(0.2)).min(zero.lit(0.8)))
            }
        };
        let frame = TangentFrame::new(normal);
        Some(Self { frame, to_viewer, albedo, specular_albedo, facets, specular_chance })
    }

    /// BRDF times cosine for light from the unit direction `to_light`, and the density of [`Self::sample`]; zero below the horizon.
    #[inline]
    pub fn evaluate(&self, to_light: Vec3Of<F>) -> Scattered<F> {
        let normal = self.frame.normal;
        let cosine = dot(normal, to_light);
        let zero = cosine.zero();
        if !cosine.above_zero() {
            return Scattered { diffuse: [zero; 3], specular: [zero; 3], pdf: zero };
        }
        let cosine_pdf = cosine.times(1.0 / PI);
        let diffuse = scale(self.albedo, cosine_pdf);
        if !self.specular_chance.above_zero() {
            return Scattered { diffuse, specular: [zero; 3], pdf: cosine_pdf };
        }
        let (constant, slope) = specular_affine(normal, self.to_viewer, to_light, self.facets);
        let specular = self.specular_albedo.map(|s| (slope * s + constant) * cosine);
        let pdf = cosine_pdf + self.specular_chance * (self.specular_pdf(to_light) - cosine_pdf);
        Scattered { diffuse, specular, pdf }
    }

    /// p(h)/(4 ωo·h): density of the mirror direction at a microfacet normal h drawn from the NDF.
    #[inline]
    fn specular_pdf(&self, to_light: Vec3Of<F>) -> F {
        let half = add(self.to_viewer, to_light);
        let length = dot(half, half).sqrt();
        let half = scale(half, length.max(length.lit(1e-12)).recip());
        let cos_half = dot(self.to_viewer, half);
        if !cos_half.above_zero() {
            return cos_half.zero();
        }
        let density = normal_distribution(self.frame.normal, half, self.facets);
        let share = match self.facets.ndf {
            Ndf::Sg => -ndf_sharpness(self.facets.roughness).times(-2.0).exp_m1().recip(),
            Ndf::Ggx => dot(self.frame.normal, half),
        };
        density * share / cos_half.times(4.0)
    }

    /// Draws a microfacet normal: from the SG over the whole sphere, from GGX in proportion to D·(n·h).
    #[inline]
    fn sample_facet(&self, u: [F; 2]) -> Vec3Of<F> {
        match self.facets.ndf {
            Ndf::Sg => sample_sg(&self.frame, ndf_sharpness(self.facets.roughness), u),
            Ndf::Ggx => sample_ggx(&self.frame, self.facets.roughness, u),
        }
    }

    /// Samples a direction; `None` if it is below the horizon (a valid sample of value zero).
    #[inline]
    pub fn sample(&self, u: [F; 3]) -> Option<Vec3Of<F>> {
        let direction = if u[0] < self.specular_chance {
            let half = self.sample_facet([u[1], u[2]]);
            let cos_half = dot(self.to_viewer, half);
            if !cos_half.above_zero() {
                return None;
            }
            sub(scale(half, cos_half.times(2.0)), self.to_viewer)
        } else {
            let radius = u[1].sqrt();
            let (s, c) = u[2].times(2.0 * PI).sin_cos();
            self.frame.world(radius * c, radius * s, (u[1].one() - u[1]).relu().sqrt())
        };
        let direction = scale(direction, dot(direction, direction).sqrt().recip());
        dot(direction, self.frame.normal).above_zero().then_some(direction)
    }
}

/// Sampling strategy for incident light; all three have the same expected value.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Strategy {
    /// Both, weighted by the power heuristic (Veach and Guibas 1995): for rendering.
    #[default]
    Combined,
    /// Directions drawn from the light only: for checking.
    LightOnly,
    /// Directions drawn from the BRDF only: for checking.
    BrdfOnly,
}

impl Strategy {
    /// Weight of a direction drawn from the light with density `light`, which the BRDF would draw with density `brdf`.
    #[inline]
    pub fn light_weight<F: SampleReal>(self, light: F, brdf: F) -> F {
        match self {
            Self::Combined => power_heuristic(light, brdf),
            Self::LightOnly => light.one(),
            Self::BrdfOnly => light.zero(),
        }
    }

    /// Weight of a direction drawn from the BRDF with density `brdf`, which the light would draw with density `light`.
    #[inline]
    pub fn brdf_weight<F: SampleReal>(self, light: F, brdf: F) -> F {
        match self {
            Self::Combined => power_heuristic(brdf, light),
            Self::LightOnly => light.zero(),
            Self::BrdfOnly => light.one(),
        }
    }
}

/// own²/(own² + other²), computed from the ratio so that no square overflows; `own` > 0.
#[inline]
fn power_heuristic<F: SampleReal>(own: F, other: F) -> F {
    if other > own {
        let ratio = own / other;
        ratio * ratio / (ratio * ratio + own.one())
    } else {
        let ratio = other / own;
        (ratio * ratio + own.one()).recip()
    }
}

/// One SG as the only light, with exact sampling.
#[derive(Clone, Copy, Debug)]
pub struct SingleLobe {
    lobe: LightLobe,
    frame: TangentFrame<f32>,
}

impl SingleLobe {
    /// The light of `lobe`, whose axis has unit length.
    pub fn new(lobe: LightLobe) -> Self {
        Self { lobe, frame: TangentFrame::new(lobe.axis.to_array()) }
    }
}

impl Illuminate for SingleLobe {
    fn radiance(&self, direction: Vec3) -> Vec3 {
        let axis = self.lobe.axis.to_array();
        self.lobe.amplitude * sg::evaluate(direction.to_array(), axis, self.lobe.sharpness)
    }

    fn sample(&self, uniform: [f32; 3]) -> LightSample {
        let direction =
            Vec3::from(sample_sg(&self.frame, self.lobe.sharpness, [uniform[1], uniform[2]])).normalize();
        LightSample { direction, radiance: self.radiance(direction), pdf: self.pdf(direction) }
    }

    fn pdf(&self, direction: Vec3) -> f32 {
        sg_pdf(direction.to_array(), self.lobe.axis.to_array(), self.lobe.sharpness)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shade::sampling::sobol::Sequence;

    /// Midpoint rule over the sphere.
    fn integrate(rings: usize, f: impl Fn([f64; 3]) -> f64) -> f64 {
        let sectors = 2 * rings;
        let mut sum = 0.0;
        for i in 0..rings {
            let z = -1.0 + 2.0 * (i as f64 + 0.5) / rings as f64;
            let r = (1.0 - z * z).sqrt();
            for j in 0..sectors {
                let (s, c) = (2.0 * PI * (j as f64 + 0.5) / sectors as f64).sin_cos();
                sum += f([r * c, r * s, z]);
            }
        }
        sum * 4.0 * PI / (rings * sectors) as f64
    }

    #[test]
    fn frame_is_orthonormal() {
        for normal in [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [0.6, 0.0, 0.8], [0.36, -0.48, -0.8]] {
            let frame: TangentFrame<f64> = TangentFrame::new(normal);
            let axes = [frame.tangent, frame.bitangent, frame.normal];
            for i in 0..3 {
                for j in 0..3 {
                    let expected = if i == j { 1.0 } else { 0.0 };
                    assert!((dot(axes[i], axes[j]) - expected).abs() < 1e-12);
                }
            }
        }
    }

    /// Sample means of x, z and z² agree with those of the density, so draws and density are of one distribution.
    #[test]
    fn sg_draws_follow_their_density() {
        let axis = [0.36, -0.48, -0.8];
        for sharpness in [0.0, 0.5, 8.0] {
            let total = integrate(400, |w| sg_pdf(w, axis, sharpness));
            assert!((total - 1.0).abs() < 1e-4, "density integrates to {total}");
            let frame = TangentFrame::new(axis);
            for power in [1, 2] {
                let expected = integrate(400, |w| w[2].powi(power) * sg_pdf(w, axis, sharpness));
                let drawn: f64 = (0..4096)
                    .map(|i| {
                        let u: [f64; 3] = Sequence::new(1, 0, i).group(0);
                        sample_sg(&frame, sharpness, [u[1], u[2]])[2].powi(power)
                    })
                    .sum();
                assert!((drawn / 4096.0 - expected).abs() < 2e-3, "{sharpness} {power}");
            }
        }
    }

    /// The scatterer's density integrates to the fraction of draws that are above the horizon, and the moments agree.
    #[test]
    fn scattered_draws_follow_their_density() {
        let normal = [0.0, 0.0, 1.0];
        let cases = [(0.3, 0.3f64), (0.5, 1.2), (0.9, 0.8)];
        let each = cases.into_iter().flat_map(|case| [(Ndf::Sg, case), (Ndf::Ggx, case)]);
        for (ndf, (roughness, slant)) in each {
            let to_viewer = [slant.sin(), 0.0, slant.cos()];
            let specular = Some(([0.3; 3], Facets { ndf, roughness }));
            let point = Scatterer::new(normal, to_viewer, [0.5; 3], specular).unwrap();
            let count = 1 << 14;
            for moment in 0..3 {
                let value = |w: [f64; 3]| [1.0, w[0], w[2] * w[2]][moment];
                let expected = integrate(500, |w| value(w) * point.evaluate(w).pdf);
                let drawn: f64 =
                    (0..count).filter_map(|i| point.sample(Sequence::new(2, 0, i).group(0))).map(value).sum();
                let drawn = drawn / f64::from(count);
                let off = (drawn - expected).abs();
                assert!(off < 2e-3, "{ndf:?} {roughness} {slant} {moment}: {drawn} {expected}");
            }
        }
    }

    #[test]
    fn heuristic_weights_sum_to_one() {
        for (a, b) in [(1.0, 2.0), (1e-200, 1e-190), (3.0, 0.0), (1e200, 1e180)] {
            let light: f64 = Strategy::Combined.light_weight(a, b);
            let brdf = if b > 0.0 { Strategy::Combined.brdf_weight(a, b) } else { 0.0 };
            assert!((0.0..=1.0).contains(&light), "{light}");
            assert!((light + brdf - 1.0).abs() < 1e-12, "{light} {brdf}");
        }
    }

    #[test]
    fn a_viewer_below_the_horizon_sees_nothing() {
        let normal = [0.0f32, 0.0, 1.0];
        assert!(Scatterer::new(normal, [0.6, 0.0, -0.8], [0.5; 3], None).is_none());
        assert!(Scatterer::new(normal, [1.0, 0.0, 0.0], [0.5; 3], None).is_none());
        assert!(Scatterer::new([f32::NAN; 3], [0.0, 0.0, 1.0], [0.5; 3], None).is_none());
    }
}
