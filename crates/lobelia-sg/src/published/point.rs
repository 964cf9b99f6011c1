//! The terms of a surface point and its specular material: the mirror direction, the warped NDF,
//! the frozen BRDF factor.

use super::integral::TINY;
use crate::brdf::{Facets, fresnel_power, shadowing_k};
use crate::real::{Real, Vec3Of, add, dot, scale, sub};
use std::f64::consts::PI;

/// The published code divides by |x| + 1e-6 when it normalizes, so its "unit" vectors have this
/// length.
pub(super) const SHRUNK: f64 = 1.0 / (1.0 + 1e-6);

/// The terms of a surface point and its specular lobe that the integral of every light lobe reads.
#[derive(Clone, Copy)]
pub struct PointTerms<F> {
    /// Unit normal.
    pub normal: Vec3Of<F>,
    /// Mirror direction r = 2(n·v)₊n − v.
    pub mirror: Vec3Of<F>,
    /// r·n as the published code computes it.
    pub mirror_cosine: F,
    /// Sharpness of the NDF (PhySG supp. eq. 4) warped to incident directions: (2/R⁴)/(4 n·v) (Wang
    /// et al. 2009).
    pub warp_sharpness: F,
}

/// M·N, the BRDF factor M (PhySG supp. eqs. 1–7) frozen at the mirror direction, times the NDF's
/// amplitude 1/(πR⁴), as `constant + slope · specular albedo`, with derivatives.
#[derive(Clone, Copy)]
pub struct FrozenBrdf<F> {
    /// Part that does not depend on the specular albedo.
    pub constant: F,
    /// Coefficient of the specular albedo.
    pub slope: F,
    /// Derivatives of `[constant, slope, warp_sharpness]` with respect to n·v.
    pub by_cosine: [F; 3],
    /// Derivatives of `[constant, slope, warp_sharpness]` with respect to the roughness.
    pub by_roughness: [F; 3],
}

/// One factor of G (PhySG supp. eqs. 1–7), c/(c(1 − k) + k + 1e-6), with its derivatives with
/// respect to c and, given dk/dR, with respect to R.
#[inline(always)]
fn shadowing_factor<F: Real>(c: F, k: F, k_prime: F) -> (F, F, F) {
    let inverse = (c * (c.one() - k) + k).plus(TINY).recip();
    let value = c * inverse;
    (value, (k.plus(TINY)) * inverse * inverse, -(value * inverse) * (c.one() - c) * k_prime)
}

/// F of PhySG supp. eq. 6 without the specular albedo, at the mirror direction, and its derivative
/// with respect to n·v.
#[inline(always)]
fn mirror_fresnel<F: Real>(nv: F) -> (F, F) {
    // h = (r + v)/(|r + v| + 1e-6) with r + v = 2κ(n·v)n + (1 − κ)v.
    let epsilon = 1.0 - SHRUNK;
    let q = nv.times(2.0 * SHRUNK);
    let length = (q * q + (q * nv).times(2.0 * epsilon)).plus(epsilon * epsilon).sqrt();
    let length_prime = (q.times(SHRUNK * 2.0) + nv.times(4.0 * SHRUNK * epsilon)) / length;
    let inverse_length = length.plus(TINY).recip();
    let vh = (q * nv).plus(epsilon) * inverse_length;
    let vh_prime = (nv.times(4.0 * SHRUNK) - vh * length_prime) * inverse_length;
    let power = fresnel_power(vh);
    let power_prime =
        -(vh.times(2.0 * 5.55473).plus(6.8316)).times(std::f64::consts::LN_2) * power * vh_prime;
    (power, power_prime)
}

/// Q = G/(4 (n·r)(n·v) + 1e-6) with n·r = κ n·v, and its derivatives with respect to n·v and to the
/// roughness.
#[inline(always)]
fn shadowing_quotient<F: Real>(nv: F, roughness: F) -> [F; 3] {
    let [k, k_prime] = shadowing_k(Facets::sg(roughness));
    let nr = nv.times(SHRUNK);
    let (g1, g1_by_c, g1_by_r) = shadowing_factor(nr, k, k_prime);
    let (g2, g2_by_c, g2_by_r) = shadowing_factor(nv, k, k_prime);
    let inverse = (nr * nv).times(4.0).plus(TINY).recip();
    let quotient = g1 * g2 * inverse;
    let quotient_by_c =
        (g1_by_c.times(SHRUNK) * g2 + g1 * g2_by_c - quotient * nv.times(8.0 * SHRUNK)) * inverse;
    let quotient_by_r = (g1_by_r * g2 + g1 * g2_by_r) * inverse;
    [quotient, quotient_by_c, quotient_by_r]
}

/// Computes the terms that depend on the point and the specular material but not on the light.
#[inline(always)]
pub fn prepare_point<F: Real>(
    normal: Vec3Of<F>,
    to_viewer: Vec3Of<F>,
    roughness: F,
) -> (PointTerms<F>, FrozenBrdf<F>) {
    let nv = dot(normal, to_viewer).relu();
    let mirror = sub(scale(normal, nv.times(2.0)), to_viewer);
    let r2 = roughness * roughness;
    let ndf_amplitude = (r2 * r2).recip().times(1.0 / PI);
    let warp_denominator = nv.times(4.0).plus(TINY).recip();
    let warp_sharpness = ndf_amplitude.times(2.0 * PI) * warp_denominator;
    let terms = PointTerms { normal, mirror, mirror_cosine: nv.times(SHRUNK), warp_sharpness };

    let (power, power_prime) = mirror_fresnel(nv);
    let [quotient, quotient_by_c, quotient_by_r] = shadowing_quotient(nv, roughness);
    let common = quotient * ndf_amplitude;
    let common_by_c = quotient_by_c * ndf_amplitude;
    let common_by_r = (quotient_by_r - quotient.times(4.0) / roughness) * ndf_amplitude;
    let rest = power.one() - power;
    let brdf = FrozenBrdf {
        constant: common * power,
        slope: common * rest,
        by_cosine: [
            common_by_c * power + common * power_prime,
            common_by_c * rest - common * power_prime,
            -(warp_sharpness * warp_denominator).times(4.0),
        ],
        by_roughness: [common_by_r * power, common_by_r * rest, -(warp_sharpness / roughness).times(4.0)],
    };
    (terms, brdf)
}

/// Adjoint of the normal of a point, given the adjoints of its mirror direction and of n·v.
#[inline(always)]
pub fn pull_back_normal<F: Real>(
    normal: Vec3Of<F>,
    to_viewer: Vec3Of<F>,
    mirror_adjoint: Vec3Of<F>,
    cosine_adjoint: F,
) -> Vec3Of<F> {
    let nv = dot(normal, to_viewer);
    let zero = nv.zero();
    let along = nv.select_lt(zero, zero, dot(mirror_adjoint, normal).times(2.0) + cosine_adjoint);
    add(scale(to_viewer, along), scale(mirror_adjoint, nv.relu().times(2.0)))
}
