//! E(λ, c), the published approximation of the integral of an SG times the clamped cosine, and the
//! hemisphere integral H.

use crate::real::{Real, polynomial};
use crate::sg::Dual;
use std::f64::consts::PI;

/// The constant that the published code adds to denominators.
pub(super) const TINY: f64 = 1e-6;
/// Sharpness and amplitude of the SG that approximates the clamped cosine, and the constant
/// subtracted from it.
pub(super) const COSINE_SHARPNESS: f64 = 0.0315;
pub(super) const COSINE_AMPLITUDE: f64 = 32.7080;
pub(super) const COSINE_OFFSET: f64 = 31.7003;

/// s = ½ + ½ tanh(tc/2)/tanh(t/2): the fraction of a lobe that is in the hemisphere (Meder and
/// Brüderlin 2018, eq. 12, rewritten). Returns s, ∂s/∂t and ∂s/∂c.
#[inline(always)]
fn hemisphere_share<F: Real>(t: F, c: F) -> (F, F, F) {
    let one = t.one();
    let abs_c = c.abs();
    let (a, e) = ((-t).decay(), (-(t * abs_c)).decay());
    let tanh_t = (one - a) * (one + a).inverse();
    let tanh_c = (one - e) * (one + e).inverse();
    // Both tanh vanish for small t; below this bound the series of the ratio has an error below
    // 1e-9.
    let bound = t.lit(0.05);
    let (t2, c2) = (t * t, c * c);
    let inverse = tanh_t.max(t.lit(1e-8)).inverse();
    let tanh_c_prime = (-tanh_c).mul_add(tanh_c, one);
    let tanh_t_prime = (-tanh_t).mul_add(tanh_t, one);
    let ratio = tanh_c * inverse;
    let by_c = t.times(0.5) * tanh_c_prime * inverse;
    let by_t = abs_c.mul_add(tanh_c_prime, -(ratio * tanh_t_prime)).times(0.5) * inverse;
    let ratio = t.select_lt(bound, abs_c * t2.times(1.0 / 12.0).mul_add(one - c2, one), ratio);
    let by_c = t.select_lt(bound, t2.mul_add(c2.times(-0.25).plus(1.0 / 12.0), one), by_c);
    let by_t = t.select_lt(bound, abs_c * t * (one - c2).times(1.0 / 6.0), by_t);
    let half = t.lit(0.5);
    let signed = half.copysign(c);
    (signed.mul_add(ratio, half), signed * by_t, half * by_c)
}

/// H: integral over the hemisphere around n of a unit-amplitude SG whose axis makes the cosine `c`
/// with n (Meder and Brüderlin 2018).
#[inline(always)]
pub fn hemisphere_integral<F: Real>(sharpness: F, c: F) -> Dual<F> {
    let l = sharpness.plus(TINY);
    let one = l.one();
    let w = (-l).decay();
    let root = l.sqrt();
    // t = √λ·N/Q
    let inverse_l = l.inverse();
    let numerator = l * l.times(1.6988).plus(10.8438);
    let inverse_q = l.mul_plus(l.plus(6.2201), 10.2415).inverse();
    let q_ratio = numerator * inverse_q;
    let t = root * q_ratio;
    let q_prime = (-q_ratio).mul_add(l.times(2.0).plus(6.2201), l.times(2.0 * 1.6988).plus(10.8438));
    let t_prime = root * q_prime.mul_add(inverse_q, q_ratio.times(0.5) * inverse_l);
    let (s, s_by_t, s_by_c) = hemisphere_share(t, c);
    // g = (1 − w)/λ and its derivative, by series where they cancel.
    let small = l.lit(0.1);
    let g = (one - w) * inverse_l;
    let g_prime = (w - g) * inverse_l;
    let g_series = polynomial(l, &[1.0, -0.5, 1.0 / 6.0, -1.0 / 24.0, 1.0 / 120.0, -1.0 / 720.0]);
    let g_prime_series = polynomial(l, &[-0.5, 1.0 / 3.0, -0.125, 1.0 / 30.0, -1.0 / 144.0, 1.0 / 840.0]);
    let g = l.select_lt(small, g_series, g);
    let g_prime = l.select_lt(small, g_prime_series, g_prime);
    let share = (one - s).mul_add(w, s);
    let tau = 2.0 * PI;
    let share_by_l = ((one - w) * s_by_t).mul_add(t_prime, (s - one) * w);
    Dual {
        value: (g * share).times(tau),
        by_sharpness: g_prime.mul_add(share, g * share_by_l).times(tau),
        by_cosine: (g * (one - w) * s_by_c).times(tau),
    }
}

/// E(λ, c): the published approximation of ∫ exp(λ(ω·ξ − 1)) max(n·ω, 0) dω with c = ξ·n.
#[inline(always)]
pub fn cosine_integral<F: Real>(sharpness: F, c: F) -> Dual<F> {
    let k = sharpness.lit(COSINE_SHARPNESS);
    let d = (c.plus(-1.0)).min(c.zero());
    let s = sharpness + k;
    let twice = (k * sharpness * d).times(2.0);
    let m = s.mul_add(s, twice).max(s * s.times(1e-12)).sqrt();
    let inverse_m = m.inverse();
    let x = twice * (m + s).inverse();
    let x_by_l = k.mul_add(d, -x) * inverse_m;
    let m_by_c = k * sharpness * inverse_m;
    let m_by_l = x_by_l.plus(1.0);
    let c_product = sharpness.mul_add(c, k) * inverse_m;
    let c_by_l = (-c_product).mul_add(m_by_l, c) * inverse_m;
    let c_by_c = (-c_product).mul_add(m_by_c, sharpness) * inverse_m;
    let product = hemisphere_integral(m, c_product);
    let plain = hemisphere_integral(sharpness, c);
    let amplitude = x.decay().times(COSINE_AMPLITUDE);
    let by = |dx: F, dm: F, dc: F| {
        amplitude * product.value.mul_add(dx, product.by_sharpness.mul_add(dm, product.by_cosine * dc))
    };
    Dual {
        value: amplitude * product.value - plain.value.times(COSINE_OFFSET),
        by_sharpness: by(x_by_l, m_by_l, c_by_l) - plain.by_sharpness.times(COSINE_OFFSET),
        by_cosine: by(m_by_c, m_by_c, c_by_c) - plain.by_cosine.times(COSINE_OFFSET),
    }
}
