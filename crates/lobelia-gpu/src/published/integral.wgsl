// E(λ, c), the published approximation of the integral of an SG times the clamped cosine, and the hemisphere integral H:
// `lobelia_sg::published::integral`.

// Sharpness and amplitude of the SG that approximates the clamped cosine, and the constant subtracted from it.
const COSINE_SHARPNESS = 0.0315;
const COSINE_AMPLITUDE = 32.7080;
const COSINE_OFFSET = 31.7003;

// s = ½ + ½ tanh(tc/2)/tanh(t/2), ∂s/∂t and ∂s/∂c (Meder and Brüderlin 2018, eq. 12, rewritten).
fn hemisphere_share(t: f32, c: f32) -> vec3<f32> {
    let abs_c = abs(c);
    let a = decay(-t);
    let e = decay(-(t * abs_c));
    let tanh_t = (1.0 - a) / (1.0 + a);
    let tanh_c = (1.0 - e) / (1.0 + e);
    let inverse = 1.0 / max(tanh_t, 1e-8);
    let tanh_c_prime = fma(-tanh_c, tanh_c, 1.0);
    let tanh_t_prime = fma(-tanh_t, tanh_t, 1.0);
    var ratio = tanh_c * inverse;
    var by_c = t * 0.5 * tanh_c_prime * inverse;
    var by_t = fma(abs_c, tanh_c_prime, -(ratio * tanh_t_prime)) * 0.5 * inverse;
    // Both tanh vanish for small t: the series of the ratio.
    if (t < 0.05) {
        let t2 = t * t;
        let c2 = c * c;
        ratio = abs_c * fma(t2 / 12.0, 1.0 - c2, 1.0);
        by_c = fma(t2, 1.0 / 12.0 - c2 * 0.25, 1.0);
        by_t = abs_c * t * (1.0 - c2) / 6.0;
    }
    let signed_half = copysign(0.5, c);
    return vec3(fma(signed_half, ratio, 0.5), signed_half * by_t, 0.5 * by_c);
}

// H: integral over the hemisphere around n of a unit-amplitude SG whose axis makes the cosine c with n (Meder and Brüderlin 2018).
fn hemisphere_integral(sharpness: f32, c: f32) -> Dual {
    let l = sharpness + TINY;
    let w = decay(-l);
    let root = sqrt(l);
    // t = √λ·N/Q
    let inverse_l = 1.0 / l;
    let inverse_q = 1.0 / fma(l, l + 6.2201, 10.2415);
    let q_ratio = l * fma(l, 1.6988, 10.8438) * inverse_q;
    let t = root * q_ratio;
    let q_prime = fma(-q_ratio, l * 2.0 + 6.2201, l * 2.0 * 1.6988 + 10.8438);
    let t_prime = root * fma(q_prime, inverse_q, q_ratio * 0.5 * inverse_l);
    let s = hemisphere_share(t, c);
    // g = (1 − w)/λ and its derivative, by series where they cancel.
    var g = (1.0 - w) * inverse_l;
    var g_prime = (w - g) * inverse_l;
    if (l < 0.1) {
        g = fma(fma(fma(fma(fma(-1.0 / 720.0, l, 1.0 / 120.0), l, -1.0 / 24.0), l, 1.0 / 6.0), l, -0.5), l, 1.0);
        g_prime = fma(fma(fma(fma(fma(1.0 / 840.0, l, -1.0 / 144.0), l, 1.0 / 30.0), l, -0.125), l, 1.0 / 3.0), l, -0.5);
    }
    let share = fma(1.0 - s.x, w, s.x);
    let share_by_l = fma((1.0 - w) * s.y, t_prime, (s.x - 1.0) * w);
    let tau = 2.0 * PI;
    return Dual(g * share * tau, fma(g_prime, share, g * share_by_l) * tau, g * (1.0 - w) * s.z * tau);
}

// E(λ, c) ≈ ∫ exp(λ(ω·ξ − 1)) max(n·ω, 0) dω with c = ξ·n: 32.7080 H(SG × cosine SG) − 31.7003 H(SG).
fn broad_integral(sharpness: f32, c: f32) -> Dual {
    let k = f32(COSINE_SHARPNESS);
    let d = min(c - 1.0, 0.0);
    let s = sharpness + k;
    let twice = k * sharpness * d * 2.0;
    let m = sqrt(max(fma(s, s, twice), s * s * 1e-12));
    let inverse_m = 1.0 / m;
    let x = twice / (m + s);
    let x_by_l = fma(k, d, -x) * inverse_m;
    let m_by_c = k * sharpness * inverse_m;
    let m_by_l = x_by_l + 1.0;
    let c_product = fma(sharpness, c, k) * inverse_m;
    let c_by_l = fma(-c_product, m_by_l, c) * inverse_m;
    let c_by_c = fma(-c_product, m_by_c, sharpness) * inverse_m;
    let product = hemisphere_integral(m, c_product);
    let plain = hemisphere_integral(sharpness, c);
    let amplitude = decay(x) * COSINE_AMPLITUDE;
    let by_l = fma(product.value, x_by_l, fma(product.by_sharpness, m_by_l, product.by_cosine * c_by_l));
    let by_c = fma(product.value, m_by_c, fma(product.by_sharpness, m_by_c, product.by_cosine * c_by_c));
    return Dual(
        amplitude * product.value - plain.value * COSINE_OFFSET,
        amplitude * by_l - plain.by_sharpness * COSINE_OFFSET,
        amplitude * by_c - plain.by_cosine * COSINE_OFFSET,
    );
}
