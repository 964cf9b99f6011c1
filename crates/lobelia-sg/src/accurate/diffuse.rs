//! The integral of an SG times the clamped cosine, in closed form, and the complementary error
//! function it needs. The integral is the irradiance under a lobe of unit amplitude.
//!
//! ```
//! use lobelia_sg::accurate::diffuse::cosine_integral;
//! use std::f64::consts::PI;
//!
//! // Of sharpness 0, a lobe is a sky of radiance one. A sharp one is a lamp: 2π c/λ.
//! let (sky, lamp) = (cosine_integral(0.0_f64, 0.3), cosine_integral(1e4_f64, 0.5));
//! assert!((sky.value - PI).abs() < 1e-6);
//! assert!((lamp.value / (2.0 * PI * 0.5 / 1e4) - 1.0).abs() < 0.01);
//! ```

use crate::real::{Real, polynomial};
use crate::sg::Dual;
use std::f64::consts::PI;

/// e^(x²)·erfc(x) for x ≥ 0: s·P((1 − px)/(1 + px)) with s = 1/(1 + px), p = 0.36; relative error
/// below 6e-8 (1e-6 in `f32`).
const SCALED_ERFC: [f64; 10] = [
    0.383841213067,
    0.306753512712,
    0.192277455528,
    0.0898987791954,
    0.0272801696181,
    0.00238949866222,
    -0.00195151911803,
    -0.000670684595379,
    0.000106820557434,
    7.47882407367e-05,
];

/// The scaled complementary error function e^(x²)·erfc(x) for x ≥ 0.
#[inline(always)]
pub fn scaled_erfc<F: Real>(x: F) -> F {
    let s = x.times(0.36).plus(1.0).inverse();
    polynomial(s.times(2.0).plus(-1.0), &SCALED_ERFC) * s
}

/// Coefficients of (1 − e^(−z))/z for small z ≥ 0 (below 0.5: error 1e-8).
const MEAN_EXPONENTIAL: [f64; 7] =
    [1.0, -0.5, 1.0 / 6.0, -1.0 / 24.0, 1.0 / 120.0, -1.0 / 720.0, 1.0 / 5040.0];

/// e^x for x ≤ 0, at least 1e-26: later factors reduce it further, and subnormal numbers are slow.
#[inline(always)]
pub(super) fn fading_exp<F: Real>(x: F) -> F {
    x.max(x.lit(-60.0)).exp()
}

/// A function of the sharpness and its derivative.
type WithDerivative<F> = (F, F);

/// Tokuyoshi's t(λ) = λ√(½N/D), which controls the interpolation between the two extreme
/// orientations.
#[inline(always)]
fn steepness<F: Real>(l: F) -> WithDerivative<F> {
    let n = l.plus(2.736_083_16).mul_add(l, l.lit(17.021_297_8));
    let d = l.plus(4.010_082_67).mul_add(l, l.lit(15.219_156_3)).mul_add(l, l.lit(76.087_896_3));
    let inverse = d.inverse();
    let ratio = (n * inverse).times(0.5);
    let root = ratio.sqrt();
    let n_prime = l.times(2.0).plus(2.736_083_16);
    let d_prime = l.times(3.0).plus(2.0 * 4.010_082_67).mul_add(l, l.lit(15.219_156_3));
    let ratio_prime = (n_prime.times(0.5) - ratio * d_prime) * inverse;
    (l * root, root + (l * ratio_prime).times(0.5) * root.inverse())
}

/// The integral over 2π for an axis along the normal, (1 − g)/λ, and against it, e(g − e)/λ, with e =
/// e^(−λ), g = (1 − e)/λ.
#[inline(always)]
fn extremes<F: Real>(l: F) -> (WithDerivative<F>, WithDerivative<F>) {
    let bound = l.lit(0.5);
    let e = fading_exp(-l);
    let inverse = l.max(bound).inverse();
    let g = (l.one() - e) * inverse;
    let g_prime = (e - g) * inverse;
    let up = (l.one() - g) * inverse;
    let q = (g - e) * inverse;
    let closed = [up, -(g_prime + up) * inverse, q, (g_prime + e - q) * inverse];
    let series = [
        polynomial(
            l,
            &[0.5, -1.0 / 6.0, 1.0 / 24.0, -1.0 / 120.0, 1.0 / 720.0, -1.0 / 5040.0, 1.0 / 40320.0],
        ),
        polynomial(l, &[-1.0 / 6.0, 1.0 / 12.0, -1.0 / 40.0, 1.0 / 180.0, -1.0 / 1008.0, 1.0 / 6720.0, 0.0]),
        polynomial(l, &[0.5, -1.0 / 3.0, 0.125, -1.0 / 30.0, 1.0 / 144.0, -1.0 / 840.0, 1.0 / 5760.0]),
        polynomial(l, &[-1.0 / 3.0, 0.25, -0.1, 1.0 / 36.0, -1.0 / 168.0, 1.0 / 960.0, 0.0]),
    ];
    let either = |i: usize| l.select_lt(bound, series[i], closed[i]);
    let (up, up_prime, q, q_prime) = (either(0), either(1), either(2), either(3));
    ((up, up_prime), (e * q, e * (q_prime - q)))
}

/// The terms of the diffuse integral that depend on a lobe's sharpness only: t(λ), the integrals
/// over 2π for an axis along the normal and against it, each with its derivative; e^(−t²), and
/// e^(−t²) times the scaled complementary error function of t.
pub type SharpnessTerms<F> = [F; 8];

/// [`SharpnessTerms`] for λ ≥ 0.
#[inline(always)]
pub fn sharpness_terms<F: Real>(sharpness: F) -> SharpnessTerms<F> {
    let (t, t_prime) = steepness(sharpness);
    let axis = fading_exp(-(t * t));
    let ((up, up_prime), (low, low_prime)) = extremes(sharpness);
    [t, t_prime, up, up_prime, low, low_prime, axis, axis * scaled_erfc(t)]
}

/// ∫ exp(λ(ω·ξ − 1)) max(n·ω, 0) dω for λ ≥ 0 and c = ξ·n, with its two derivatives.
///
/// Tokuyoshi, Ikeda, Kulkarni and Harada, "Hierarchical Light Sampling with Accurate Spherical
/// Gaussian Lighting" (2024). Relative error of the formula about 0.1 % where the lobe is well
/// above the horizon; it grows in the tail of a sharp lobe below it. Always in [0, π].
#[inline(always)]
pub fn cosine_integral<F: Real>(sharpness: F, c: F) -> Dual<F> {
    prepared_cosine_integral(&sharpness_terms(sharpness), c)
}

/// [`cosine_integral`] with precomputed terms of the sharpness.
#[inline(always)]
pub fn prepared_cosine_integral<F: Real>(terms: &SharpnessTerms<F>, c: F) -> Dual<F> {
    let (zero, one) = (c.zero(), c.one());
    let c = c.max(-one).min(one);
    let [t, t_prime, up, up_prime, low, low_prime, axis, axis_tail] = *terms;
    let tc = t * c;
    let (t_squared, tc_abs) = (t * t, tc.max(-tc));
    let edge = fading_exp(-(tc * tc));
    // erfc(−tc), and (e^(−t²) − e^(−t²c²))/(2√π·t²), by series where the difference cancels.
    let tail = edge * scaled_erfc(tc_abs);
    let share = tc.select_lt(zero, tail, one + one - tail);
    let z = t_squared * ((one - c) * (one + c));
    let bound = c.lit(0.5);
    let mean =
        z.select_lt(bound, edge * polynomial(z, &MEAN_EXPONENTIAL), (edge - axis) * z.max(bound).inverse());
    let difference = -(mean * (one - c) * (one + c)).times(0.5 / PI.sqrt());
    let blend = (c * share + axis_tail).times(0.5) - difference * t;
    let blend = blend.max(zero).min(one);
    let span = up - low;
    let by_sharpness = (up_prime - low_prime).mul_add(blend, low_prime) + span * difference * t_prime;
    Dual {
        value: span.mul_add(blend, low).times(2.0 * PI),
        by_sharpness: by_sharpness.times(2.0 * PI),
        by_cosine: (span * share).times(PI),
    }
}
