//! E(λ, c), the published cosine-weighted integral of a lobe, for sharpness λ ≥ 11: the same
//! function as [`super::integral::cosine_integral`] with much less arithmetic.
//!
//! E = 32.7080 e^x H(m, c′) − 31.7003 H(λ, c) subtracts two nearly equal numbers, so that
//! straightforward `f32` loses 60 times its rounding error; and two evaluations of H double the
//! cost. With H = A + Bτ, A = π/λ, B = A·coth T, τ = tanh(Tc), T = t(λ)/2, everything at the
//! product's sharpness m is taken as a small *change* from λ: h = m − λ = k + x with |h| ≤ k =
//! 0.0315, and series in h/λ ≤ 0.003 replace roots, exponentials and divisions:
//!
//! E = (32.7080 − 31.7003)·H + 32.7080·(e^x H(m, c′) − H), e^x H(m, c′) − H = A·α + B·(βτ′ + τ′ −
//! τ)
//!
//! where 1 + α and 1 + β are the ratios of e^x A and e^x B at m to A and B at λ. The terms that
//! depend on λ only are [`SharpnessTerms`]: they are computed once per lobe for the diffuse light,
//! once per pair for the specular light. Terms in e^−λ and the 1e-6 that the published code adds to
//! λ are left out.
//!
//! Largest measured errors of E and of λ∂E/∂λ, both in units of 2π/λ, against the published form in
//! `f64`: these series 8e-6 and 6e-5 at λ = 11, 1e-6 and 1e-5 from 16 on, in vectors of `f32`; the
//! published form 2e-5 and 4e-5.

use super::integral::{COSINE_AMPLITUDE, COSINE_OFFSET, COSINE_SHARPNESS};
use crate::{real::Real, sg::Dual};
use std::f64::consts::PI;

/// The formulas of this file hold for this sharpness and above.
pub const SHARP: f64 = 11.0;

/// t(λ) = √λ·(1.6988 + (Pλ − Q)/(λ² + Bλ + C)): the rational function of the hemisphere integral,
/// with its limit as a separate term.
const LIMIT: f64 = 1.6988;
const B: f64 = 6.2201;
const C: f64 = 10.2415;
const P: f64 = 10.8438 - LIMIT * B;
const Q: f64 = LIMIT * C;

/// The terms of E that depend on the sharpness λ ≥ [`SHARP`] only: 1/λ; 2kλ/(λ + k), which times c
/// − 1 is nearly x; T = t(λ)/2 and its first two derivatives; 4e^−2T; A = π/λ; B = A·coth T.
pub type SharpnessTerms<F> = [F; 8];

/// [`SharpnessTerms`] from λ and its reciprocal.
#[inline(always)]
pub fn sharpness_terms<F: Real>(sharpness: F, inverse: F) -> SharpnessTerms<F> {
    let k = COSINE_SHARPNESS;
    let slope = inverse.times(k * k).plus(-k).mul_plus(inverse, 1.0).times(2.0 * k);
    // T = ½√λ·R with R = 1.6988 + N/D: R's derivatives by Leibniz from (R − 1.6988)·D = N.
    let d_slope = sharpness.times(2.0).plus(B);
    let over_d = sharpness.plus(B).mul_plus(sharpness, C).inverse();
    let excess = sharpness.times(P).plus(-Q) * over_d;
    let r = excess.plus(LIMIT);
    let r_1 = (-excess).mul_plus(d_slope, P) * over_d;
    let r_2 = r_1.mul_add(d_slope, excess) * over_d.times(-2.0);
    let half_root = sharpness.sqrt().times(0.5);
    let half_r = r * inverse.times(0.5);
    let t_1 = half_root * (r_1 + half_r);
    let t_2 = half_root * (r_1 - half_r.times(0.5)).mul_add(inverse, r_2);
    let half_t = half_root * r;
    let a = half_t.times(-2.0).decay();
    let even = inverse.times(PI);
    let odd = (a.mul_add(a, a).times(2.0)).mul_add(even, even);
    [inverse, slope, half_t, t_1, t_2, a.times(4.0), even, odd]
}

/// e^x − 1 for |x| ≤ 0.07, to 1e-8.
#[inline(always)]
fn exp_m1<F: Real>(x: F) -> F {
    let p = x.times(1.0 / 24.0).plus(1.0 / 6.0).mul_plus(x, 0.5).mul_plus(x, 1.0);
    p * x
}

/// tanh y and its derivative.
#[inline(always)]
fn tanh<F: Real>(y: F) -> (F, F) {
    let e = y.abs().times(-2.0).decay();
    let inverse = e.plus(1.0).inverse();
    let value = ((e.one() - e) * inverse).copysign(y);
    (value, (-value).mul_add(value, e.one()))
}

/// E(λ, c) and its partial derivatives.
#[inline(always)]
pub fn cosine_integral<F: Real>(sharpness: F, terms: &SharpnessTerms<F>, c: F) -> Dual<F> {
    let [inverse, slope, t, t_1, t_2, tail, even, odd] = *terms;
    let (k, one) = (c.lit(COSINE_SHARPNESS), c.one());
    // The product of the lobe with the cosine's lobe, whose sharpness is m = λ + h, whose cosine is
    // c′, and the logarithm of whose amplitude is x = S(√(1 + z) − 1) with S = λ + k, Sz = 2kλ(c −
    // 1)/S, |z| ≤ 4k/λ.
    let d = c.plus(-1.0).min(c.zero());
    let sz = slope * d;
    let z = sz * inverse * (one - k * inverse);
    let x = sz * z.times(0.0625).plus(-0.125).mul_plus(z, 0.5);
    let h = x + k;
    let step = h * inverse;
    let over_m = inverse * (one - step + step * step);
    let cosine = sharpness.mul_add(c, k) * over_m;
    let cosine_change = (-h).mul_add(c, k) * over_m;
    let t_change = h * (h.times(0.5)).mul_add(t_2, t_1);
    // τ = tanh(Tc) and its derivative σ, and tanh at T′c′ = Tc + δ by Taylor: δ ≤ 0.008.
    let delta = t.mul_add(cosine_change, t_change * cosine);
    let (tau, sigma) = tanh(t * c);
    let curve = ((tau * tau).plus(-1.0 / 3.0)).mul_add(delta, -tau);
    let tau_change = sigma * delta * curve.mul_add(delta, one);
    let tau_product = tau + tau_change;
    // 1 − λ/m, α and β.
    let shrink = step * (one - step + step * step);
    let grown = exp_m1(x);
    let even_change = (-grown).mul_add(shrink, grown - shrink);
    let coth_change = -(tail * t_change);
    let odd_change = coth_change.mul_add(even_change, even_change + coth_change);
    let gain = COSINE_AMPLITUDE - COSINE_OFFSET;
    let even_part = even_change.times(COSINE_AMPLITUDE).plus(gain);
    let odd_part = odd_change.mul_add(tau_product, tau_change).times(COSINE_AMPLITUDE) + tau.times(gain);
    let value = even.mul_add(even_part, odd * odd_part);

    // Derivatives of x, m and c′ with respect to sharpness and cosine.
    let x_by_c = k * (one - shrink);
    let x_by_l = k.mul_add(d, -x) * over_m;
    let m_by_l = x_by_l + one;
    let c_by_c = (-cosine).mul_add(x_by_c, sharpness) * over_m;
    let c_by_l = (-cosine).mul_add(m_by_l, c) * over_m;
    // Derivatives of e^x H(m, c′) with respect to x, m and c′.
    let odd_product = odd_change.mul_add(odd, odd);
    let by_x = odd_product.mul_add(tau_product, even_change.mul_add(even, even));
    let curve = ((tau * tau).times(3.0).plus(-1.0)).mul_add(delta, tau.times(-2.0));
    let sigma_product = sigma * curve.mul_add(delta, one);
    let tail_product = tail * t_change.times(-2.0).plus(1.0);
    let turned = sigma_product.mul_add(cosine, -(tail_product * tau_product));
    let by_t = odd_product * h.mul_add(t_2, t_1) * turned;
    let by_m = (-by_x).mul_add(over_m, by_t);
    let by_cosine = odd_product * (t + t_change) * sigma_product;
    // Derivatives of H(λ, c) with respect to sharpness and cosine.
    let plain = odd.mul_add(tau, even);
    let plain_by_t = odd * t_1 * sigma.mul_add(c, -(tail * tau));
    let plain_by_l = (-plain).mul_add(inverse, plain_by_t);
    let plain_by_c = odd * t * sigma;
    let both = |x: F, m: F, cosine: F, plain: F| {
        let product = by_x.mul_add(x, by_m.mul_add(m, by_cosine * cosine));
        product.times(COSINE_AMPLITUDE) - plain.times(COSINE_OFFSET)
    };
    Dual {
        value,
        by_sharpness: both(x_by_l, m_by_l, c_by_l, plain_by_l),
        by_cosine: both(x_by_c, x_by_c, c_by_c, plain_by_c),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{dispatch, lanes::Lanes, published::integral::cosine_integral as as_published};
    use fearless_simd::Simd;

    /// Sharpness from the bound upward, and cosines over the whole sphere, many of them near the
    /// horizon.
    fn cases() -> impl Iterator<Item = (f64, f64)> {
        let sharpness = (0..60).map(|i| SHARP * 1e4f64.powf(f64::from(i) / 59.0));
        let cosines = (0..201).flat_map(|i| {
            let c = f64::from(i) / 100.0 - 1.0;
            [c, c * c * c]
        });
        sharpness.flat_map(move |l| cosines.clone().map(move |c| (l, c)))
    }

    fn close(name: &str, (l, c): (f64, f64), found: Dual<f64>, bounds: [f64; 3]) {
        let exact = as_published(l, c);
        let size = 2.0 * PI / l;
        let errors = [
            (found.value - exact.value) / size,
            (found.by_sharpness - exact.by_sharpness) / (size / l),
            (found.by_cosine - exact.by_cosine) / (size * l.sqrt()),
        ];
        for (error, bound) in errors.iter().zip(bounds) {
            assert!(error.abs() <= bound, "{name}, λ = {l}, c = {c}: errors {errors:?}");
        }
    }

    #[inline(always)]
    fn in_lanes<S: Simd>(simd: S, l: f32, c: f32) -> Dual<f64> {
        let (l, c) = (Lanes::splat(simd, l), Lanes::splat(simd, c));
        let dual = cosine_integral(l, &sharpness_terms(l, l.inverse()), c);
        let first = |x: Lanes<S>| f64::from(x.lane(0));
        Dual {
            value: first(dual.value),
            by_sharpness: first(dual.by_sharpness),
            by_cosine: first(dual.by_cosine),
        }
    }

    #[test]
    fn series_are_within_their_stated_error() {
        for (l, c) in cases() {
            let terms = sharpness_terms(l, 1.0 / l);
            close("f64", (l, c), cosine_integral(l, &terms, c), [1e-5, 1e-4, 2e-5]);
            let (l, c) = (l as f32, c as f32);
            let found = dispatch!(simd => in_lanes(simd, l, c));
            close("f32", (f64::from(l), f64::from(c)), found, [1e-5, 1e-4, 2e-5]);
        }
    }
}
