//! The BRDF of the PhySG supplement (eqs. 1–7): f = a/π + M·D with M = F·G/(4 (n·ωo)(n·ωi)); D is
//! its SG or GGX. The specular part is affine in the specular albedo, and the same with viewer and
//! light exchanged.
//!
//! ```
//! use lobelia_sg::brdf::{Facets, specular_affine};
//!
//! let (normal, viewer, light) = ([0.0_f64, 0.0, 1.0], [0.6, 0.0, 0.8], [0.0, -0.6, 0.8]);
//! let (constant, slope) = specular_affine(normal, viewer, light, Facets::sg(0.5));
//! let (exchanged, _) = specular_affine(normal, light, viewer, Facets::sg(0.5));
//! assert!(constant > 0.0 && slope > constant);
//! assert!((constant / exchanged - 1.0).abs() < 1e-12);
//! ```

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
    /// GGX with α = R², which has the same peak and a longer tail; accurate shading approximates it
    /// by three SGs.
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
    /// Distribution of microfacet normals; [`Published`](crate::published::Published) shading
    /// always uses one SG.
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

/// Fresnel term (PhySG supp. eq. 6): F = s + (1 − s)·2^(−(5.55473 x + 6.8316) x) with x = ωo·h.
/// Returns the power of two.
///
/// The constant 6.8316 is the one in the paper and in the published code (Epic's original fit has
/// 6.98316).
#[inline(always)]
pub fn fresnel_power<F: Real>(cos_view_half: F) -> F {
    let exponent = -(cos_view_half.times(5.55473).plus(6.8316)) * cos_view_half;
    exponent.times(std::f64::consts::LN_2).exp()
}

/// One factor c/(c(1 − k) + k) of the shadowing term G (PhySG supp. eqs. 1–7) divided by c: 1/(c(1
/// − k) + k), with k of [`shadowing_k`].
#[inline(always)]
pub fn shadowing_over_cosine<F: Real>(cosine: F, k: F) -> F {
    (cosine * (k.one() - k) + k).recip()
}

/// k of the shadowing term G, and dk/dR: (R + 1)²/8 for the SG (PhySG supp. eqs. 1–7), 0.42 R³ for
/// GGX.
///
/// The second is fitted to the height-correlated term of Smith (Heitz 2014) with α = R² at mirror
/// directions: root mean square error of G 1.5 %, weighted by the cosine. The first is Epic's
/// choice for lamps without size and 19 % off; it darkens smooth surfaces. Seen at 70° to the
/// normal, a mirror of R = 0.25 keeps 53 % of its light with it, where Smith's term leaves 99 %.
#[inline(always)]
pub fn shadowing_k<F: Real>(facets: Facets<F>) -> [F; 2] {
    let r = facets.roughness;
    match facets.ndf {
        Ndf::Sg => {
            let s = r.plus(1.0);
            [s * s.lit(0.125) * s, s.times(0.25)]
        }
        Ndf::Ggx => [r * r * r.times(0.42), (r * r).times(1.26)],
    }
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
        // α²/(π((n·h)²(α² − 1) + 1)²) with α = R², above the horizon.
        Ndf::Ggx => {
            let square = facets.roughness * facets.roughness;
            let alpha2 = square * square;
            // 1 − (n·h)² is |n − h|²(1 − |n − h|²/4), without cancellation.
            let off = sub(half, normal);
            let distance2 = dot(off, off);
            let sine2 = distance2 * distance2.times(-0.25).plus(1.0);
            let spread = (alpha2.one() - alpha2).mul_add(sine2, alpha2);
            alpha2 / (spread * spread).times(PI)
        }
    }
}

/// The specular part f_s = M·D (PhySG supp. eqs. 1–7) at unit directions to the viewer and to the
/// light, for cosines above zero.
///
/// Returns `(constant, slope)` so that f_s = constant + slope·s for any channel's specular albedo
/// s: F is affine in s, so three channels cost no more than one.
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
    let [k, _] = shadowing_k(facets);
    // G / ((n·ωo)(n·ωi)): the cosines of G's numerators cancel those of the denominator.
    let g =
        shadowing_over_cosine(dot(normal, to_viewer), k) * shadowing_over_cosine(dot(normal, to_light), k);
    let common = g.times(0.25) * normal_distribution(normal, half, facets);
    (common * power, common * (power.one() - power))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// G2 of Heitz 2014, "Understanding the Masking-Shadowing Function in Microfacet-Based BRDFs",
    /// eq. 99, at two equal cosines.
    fn smith(alpha: f64, cosine: f64) -> f64 {
        cosine / (alpha * alpha + (1.0 - alpha * alpha) * cosine * cosine).sqrt()
    }

    /// Root mean square difference of G from Smith's over cosines, weighted by them, averaged over
    /// roughness.
    fn distance_to_smith(ndf: Ndf) -> f64 {
        let of_roughness = |i: u32| {
            let roughness = f64::from(i) / 40.0;
            let [k, _] = shadowing_k(Facets { ndf, roughness });
            let square = |j: u32| {
                let cosine = (f64::from(j) + 0.5) / 200.0;
                let ours = (cosine * shadowing_over_cosine(cosine, k)).powi(2);
                2.0 * cosine * (ours - smith(roughness * roughness, cosine)).powi(2) / 200.0
            };
            (0..200).map(square).sum::<f64>().sqrt() / 39.0
        };
        (2..=40).map(of_roughness).sum()
    }

    #[test]
    fn shadowing_of_ggx_is_close_to_smiths() {
        let [ggx, sg] = [Ndf::Ggx, Ndf::Sg].map(distance_to_smith);
        assert!(ggx < 0.016, "{ggx}");
        assert!((0.17..0.21).contains(&sg), "{sg}");
    }

    #[test]
    fn derivative_of_k_follows_k() {
        for ndf in [Ndf::Sg, Ndf::Ggx] {
            let k = |roughness: f64| shadowing_k(Facets { ndf, roughness });
            let difference = (k(0.4001)[0] - k(0.3999)[0]) / 0.0002;
            assert!((difference - k(0.4)[1]).abs() < 1e-6, "{difference}");
        }
    }
}
