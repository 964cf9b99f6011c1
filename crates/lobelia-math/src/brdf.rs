//! The BRDF of the PhySG supplement (eqs. 1–7): f = a/π + M·D with M = F·G/(4 (n·ωo)(n·ωi)); D is its SG or GGX.

use crate::real::{Real, Vec3Of, add, dot, scale, sub};
use crate::sg;
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;

/// The distribution D of microfacet normals; F and G are the supplement's with either.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Ndf {
    /// One SG, as in the PhySG supplement (eq. 4).
    #[default]
    Sg,
    /// GGX with α = R², which has the same peak and a longer tail; accurate shading approximates it by three SGs.
    Ggx,
}

/// A distribution of microfacet normals and its width.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Facets<F> {
    /// Which distribution.
    pub ndf: Ndf,
    /// The paper's roughness R in [0.03, 1].
    pub roughness: F,
}

impl<F> Facets<F> {
    /// The distribution of PhySG supp. eq. 4, one SG.
    pub const fn sg(roughness: F) -> Self {
        Self { ndf: Ndf::Sg, roughness }
    }
}

/// The specular material as the kernels read it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SpecularValue {
    /// Specular albedo.
    pub albedo: Vec3Of<f32>,
    /// Roughness R.
    pub roughness: f32,
    /// Distribution of microfacet normals; [`Published`](crate::published::Published) shading always uses one SG.
    pub ndf: Ndf,
}

/// Adjoints of the specular material.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SpecularAdjoint {
    /// With respect to the specular albedo.
    pub albedo: Vec3Of<f32>,
    /// With respect to the roughness.
    pub roughness: f32,
}

/// Fresnel term (PhySG supp. eq. 6): F = s + (1 − s)·2^(−(5.55473 x + 6.8316) x) with x = ωo·h. Returns the power of two.
///
/// The constant 6.8316 is the one in the paper and in the published code (Epic's original fit has 6.98316).
#[inline(always)]
pub fn fresnel_power<F: Real>(cos_view_half: F) -> F {
    let exponent = -(cos_view_half.times(5.55473).plus(6.8316)) * cos_view_half;
    exponent.times(std::f64::consts::LN_2).exp()
}

/// One factor c/(c(1 − k) + k) of the shadowing term G (PhySG supp. eqs. 1–7) divided by c: 1/(c(1 − k) + k), with k = (R + 1)²/8.
#[inline(always)]
pub fn shadowing_over_cosine<F: Real>(cosine: F, k: F) -> F {
    (cosine * (k.one() - k) + k).recip()
}

/// k = (R + 1)²/8 of the shadowing term G (PhySG supp. eqs. 1–7).
#[inline(always)]
pub fn shadowing_k<F: Real>(roughness: F) -> F {
    let s = roughness.plus(1.0);
    s * s.lit(0.125) * s
}

/// Sharpness 2/R⁴ of the SG that is the distribution of microfacet normals (PhySG supp. eq. 4).
#[inline(always)]
pub fn ndf_sharpness<F: Real>(roughness: F) -> F {
    let r2 = roughness * roughness;
    (r2 * r2).recip().times(2.0)
}

/// D(h): the SG in h with axis n, sharpness 2/R⁴ and amplitude 1/(πR⁴) (PhySG supp. eq. 4), or GGX.
#[inline(always)]
pub fn normal_distribution<F: Real>(normal: Vec3Of<F>, half: Vec3Of<F>, facets: Facets<F>) -> F {
    match facets.ndf {
        Ndf::Sg => {
            let sharpness = ndf_sharpness(facets.roughness);
            sg::evaluate(half, normal, sharpness) * sharpness.times(0.5 / PI)
        }
        Ndf::Ggx => ggx(normal, half, facets.roughness),
    }
}

/// α²/(π((n·h)²(α² − 1) + 1)²) with α = R², above the horizon. 1 − (n·h)² is |n − h|²(1 − |n − h|²/4), without cancellation.
#[inline(always)]
fn ggx<F: Real>(normal: Vec3Of<F>, half: Vec3Of<F>, roughness: F) -> F {
    let square = roughness * roughness;
    let alpha2 = square * square;
    let off = sub(half, normal);
    let distance2 = dot(off, off);
    let sine2 = distance2 * distance2.times(-0.25).plus(1.0);
    let spread = (alpha2.one() - alpha2).mul_add(sine2, alpha2);
    alpha2 / (spread * spread).times(PI)
}

/// The specular part f_s = M·D (PhySG supp. eqs. 1–7) at unit directions to the viewer and to the light, for cosines above zero.
///
/// Returns `(constant, slope)` so that f_s = constant + slope·s for any channel's specular albedo s:
/// F is affine in s, so three channels cost no more than one.
#[inline(always)]
pub fn specular_affine<F: Real>(
    normal: Vec3Of<F>,
    to_viewer: Vec3Of<F>,
    to_light: Vec3Of<F>,
    facets: Facets<F>,
) -> (F, F) {
    let half = add(to_viewer, to_light);
    let half = scale(half, dot(half, half).max(half[0].lit(1e-12)).sqrt().recip());
    let power = fresnel_power(dot(to_viewer, half).relu());
    let k = shadowing_k(facets.roughness);
    // G / ((n·ωo)(n·ωi)): the cosines of G's numerators cancel those of the denominator.
    let g =
        shadowing_over_cosine(dot(normal, to_viewer), k) * shadowing_over_cosine(dot(normal, to_light), k);
    let common = g.times(0.25) * normal_distribution(normal, half, facets);
    (common * power, common * (power.one() - power))
}
