//! The BRDF of the PhySG supplement (eqs. 1–7): f = a/π + M·D with M = F·G/(4 (n·ωo)(n·ωi)).

use super::real::{Real, Vec3Of, add, dot, scale};

/// Fresnel term (supp. eq. 6): F = s + (1 − s)·2^(−(5.55473 x + 6.8316) x) with x = ωo·h. Returns the power of two.
///
/// The constant 6.8316 is as printed and as in the published code (Epic's own fit has 6.98316).
#[inline(always)]
pub fn fresnel_power<F: Real>(cos_view_half: F) -> F {
    let exponent = -(cos_view_half.times(5.55473).plus(6.8316)) * cos_view_half;
    exponent.times(std::f64::consts::LN_2).exp()
}

/// One factor c/(c(1 − k) + k) of the shadowing term, divided by c: 1/(c(1 − k) + k), with k = (R + 1)²/8.
#[inline(always)]
pub fn shadowing_over_cosine<F: Real>(cosine: F, k: F) -> F {
    (cosine * (k.one() - k) + k).recip()
}

/// k = (R + 1)²/8 of the shadowing term.
#[inline(always)]
pub fn shadowing_k<F: Real>(roughness: F) -> F {
    let s = roughness.plus(1.0);
    s * s.lit(0.125) * s
}

/// Sharpness 2/R⁴ of the SG that is the distribution of microfacet normals (supp. eq. 4).
#[inline(always)]
pub fn ndf_sharpness<F: Real>(roughness: F) -> F {
    let r2 = roughness * roughness;
    (r2 * r2).recip().times(2.0)
}

/// D(h) (supp. eq. 4): the SG in h with axis n, sharpness 2/R⁴ and amplitude 1/(πR⁴).
#[inline(always)]
pub fn normal_distribution<F: Real>(normal: Vec3Of<F>, half: Vec3Of<F>, roughness: F) -> F {
    let sharpness = ndf_sharpness(roughness);
    super::sg::evaluate(half, normal, sharpness) * sharpness.times(0.5 / std::f64::consts::PI)
}

/// The specular part f_s at unit directions to the viewer and to the light, for cosines above zero.
///
/// Returns `(constant, slope)` so that f_s = constant + slope·s for any channel's specular albedo s:
/// F is affine in s, so three channels cost no more than one.
#[inline(always)]
pub fn specular_affine<F: Real>(
    normal: Vec3Of<F>,
    to_viewer: Vec3Of<F>,
    to_light: Vec3Of<F>,
    roughness: F,
) -> (F, F) {
    let half = add(to_viewer, to_light);
    let half = scale(half, dot(half, half).max(roughness.lit(1e-12)).sqrt().recip());
    let power = fresnel_power(dot(to_viewer, half).relu());
    let k = shadowing_k(roughness);
    // G / ((n·ωo)(n·ωi)): the cosines of G's numerators cancel those of the denominator.
    let g =
        shadowing_over_cosine(dot(normal, to_viewer), k) * shadowing_over_cosine(dot(normal, to_light), k);
    let common = g.times(0.25) * normal_distribution(normal, half, roughness);
    (common * power, common * (power.one() - power))
}
