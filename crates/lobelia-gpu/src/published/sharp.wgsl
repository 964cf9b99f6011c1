// E(λ, c) for sharpness λ ≥ 11 as a small change from H(λ, c): `lobelia_sg::published::sharp`.
//
// H = A + Bτ, A = π/λ, B = A·coth T, τ = tanh(Tc), T = t(λ)/2; the product with the cosine's SG has sharpness m = λ + h.
// E = (32.7080 − 31.7003)·H + 32.7080·(e^x H(m, c′) − H),  e^x H(m, c′) − H = A·α + B·(βτ′ + τ′ − τ)

// The formulas of this file hold for this sharpness and above.
const SHARP = 11.0;
// t(λ) = √λ·(1.6988 + (Pλ − Q)/(λ² + Bλ + C)).
const T_LIMIT = 1.6988;
const T_B = 6.2201;
const T_C = 10.2415;
const T_P = 10.8438 - 1.6988 * 6.2201;
const T_Q = 1.6988 * 10.2415;

// The terms of E that depend on the sharpness only.
struct SharpnessTerms {
    // 1/λ.
    inverse: f32,
    // 2kλ/(λ + k).
    slope: f32,
    // T and its first two derivatives.
    half_t: vec3<f32>,
    // 4e^−2T.
    tail: f32,
    // A = π/λ.
    even: f32,
    // B = A·coth T.
    odd: f32,
}

fn sharpness_terms(sharpness: f32, inverse: f32) -> SharpnessTerms {
    let k = COSINE_SHARPNESS;
    let slope = fma(inverse * (k * k) - k, inverse, 1.0) * (2.0 * k);
    // R = 1.6988 + N/D: its derivatives by Leibniz from (R − 1.6988)·D = N.
    let d_slope = sharpness * 2.0 + T_B;
    let over_d = 1.0 / fma(sharpness + T_B, sharpness, T_C);
    let excess = (sharpness * T_P - T_Q) * over_d;
    let r = excess + T_LIMIT;
    let r_1 = fma(-excess, d_slope, T_P) * over_d;
    let r_2 = fma(r_1, d_slope, excess) * over_d * -2.0;
    let half_root = sqrt(sharpness) * 0.5;
    let half_r = r * inverse * 0.5;
    let t_1 = half_root * (r_1 + half_r);
    let t_2 = half_root * fma(r_1 - half_r * 0.5, inverse, r_2);
    let half_t = half_root * r;
    let a = decay(half_t * -2.0);
    let even = inverse * PI;
    let odd = fma(fma(a, a, a) * 2.0, even, even);
    return SharpnessTerms(inverse, slope, vec3(half_t, t_1, t_2), a * 4.0, even, odd);
}

// The terms that the CPU has prepared.
fn prepared_terms(lobe: Lobe) -> SharpnessTerms {
    let a = lobe.terms[0];
    let b = lobe.terms[1];
    return SharpnessTerms(a.x, a.y, vec3(a.z, a.w, b.x), b.y, b.z, b.w);
}

// The product of the lobe with the cosine's lobe.
struct SharpProduct {
    // min(c − 1, 0).
    d: f32,
    // The logarithm of its amplitude.
    x: f32,
    // h, with m = λ + h.
    h: f32,
    // h/λ.
    step: f32,
    // 1/m.
    over_m: f32,
    // c′.
    cosine: f32,
    // c′ − c.
    cosine_change: f32,
    // T′ − T.
    t_change: f32,
}

fn sharp_product(sharpness: f32, terms: SharpnessTerms, c: f32) -> SharpProduct {
    let k = f32(COSINE_SHARPNESS);
    let inverse = terms.inverse;
    // x = S(√(1 + z) − 1) with S = λ + k, Sz = 2kλ(c − 1)/S, |z| ≤ 4k/λ.
    let d = min(c - 1.0, 0.0);
    let sz = terms.slope * d;
    let z = sz * inverse * (1.0 - k * inverse);
    let x = sz * fma(z * 0.0625 - 0.125, z, 0.5);
    let h = x + k;
    let step = h * inverse;
    let over_m = inverse * (1.0 - step + step * step);
    let cosine = fma(sharpness, c, k) * over_m;
    let t_change = h * fma(h * 0.5, terms.half_t.z, terms.half_t.y);
    return SharpProduct(d, x, h, step, over_m, cosine, fma(-h, c, k) * over_m, t_change);
}

// 1 − λ/m, and α and β: the ratios of e^x A and e^x B at m to A and B at λ, less one.
fn ratios(terms: SharpnessTerms, product: SharpProduct) -> vec3<f32> {
    let step = product.step;
    let shrink = step * (1.0 - step + step * step);
    // e^x − 1 for |x| ≤ 0.07.
    let x = product.x;
    let grown = x * fma(fma(fma(x, 1.0 / 24.0, 1.0 / 6.0), x, 0.5), x, 1.0);
    let even_change = fma(-grown, shrink, grown - shrink);
    let coth_change = -(terms.tail * product.t_change);
    return vec3(shrink, even_change, fma(coth_change, even_change, even_change + coth_change));
}

// tanh(Tc) and tanh(T′c′).
struct Tangents {
    // τ.
    tau: f32,
    // Derivative of τ with respect to Tc.
    sigma: f32,
    // τ′ − τ.
    change: f32,
    // τ′.
    product: f32,
    // Derivative of τ′ with respect to T′c′.
    product_sigma: f32,
}

// tanh at T′c′ = Tc + δ by Taylor: δ ≤ 0.008.
fn tangents(terms: SharpnessTerms, product: SharpProduct, c: f32) -> Tangents {
    let t = terms.half_t.x;
    let delta = fma(t, product.cosine_change, product.t_change * product.cosine);
    let e = decay(abs(t * c) * -2.0);
    let tau = copysign((1.0 - e) / (1.0 + e), c);
    let sigma = fma(-tau, tau, 1.0);
    let square = tau * tau;
    let change = sigma * delta * fma(fma(square - 1.0 / 3.0, delta, -tau), delta, 1.0);
    let product_sigma = sigma * fma(fma(square * 3.0 - 1.0, delta, tau * -2.0), delta, 1.0);
    return Tangents(tau, sigma, change, tau + change, product_sigma);
}

// Derivatives of e^x H(m, c′) with respect to x, m and c′.
fn partial_slopes(terms: SharpnessTerms, product: SharpProduct, ratio: vec3<f32>, tangent: Tangents) -> vec3<f32> {
    let tau = tangent.product;
    let odd = fma(ratio.z, terms.odd, terms.odd);
    let even = fma(ratio.y, terms.even, terms.even);
    let value = fma(odd, tau, even);
    let sigma = tangent.product_sigma;
    let t_1 = fma(product.h, terms.half_t.z, terms.half_t.y);
    let tail = terms.tail * (1.0 - product.t_change * 2.0);
    let by_t = odd * t_1 * fma(sigma, product.cosine, -(tail * tau));
    return vec3(value, fma(-value, product.over_m, by_t), odd * (terms.half_t.x + product.t_change) * sigma);
}

// E(λ, c) and its partial derivatives.
fn sharp_integral(sharpness: f32, terms: SharpnessTerms, c: f32) -> Dual {
    let k = f32(COSINE_SHARPNESS);
    let product = sharp_product(sharpness, terms, c);
    let tangent = tangents(terms, product, c);
    let ratio = ratios(terms, product);
    let gain = COSINE_AMPLITUDE - COSINE_OFFSET;
    let even_part = ratio.y * COSINE_AMPLITUDE + gain;
    let odd_part = fma(ratio.z, tangent.product, tangent.change) * COSINE_AMPLITUDE + tangent.tau * gain;
    // How x, m and c′ depend on λ and c.
    let x_by_c = k * (1.0 - ratio.x);
    let x_by_l = fma(k, product.d, -product.x) * product.over_m;
    let m_by_l = x_by_l + 1.0;
    let c_by_l = fma(-product.cosine, m_by_l, c) * product.over_m;
    let c_by_c = fma(-product.cosine, x_by_c, sharpness) * product.over_m;
    let by = partial_slopes(terms, product, ratio, tangent);
    let by_l = fma(by.x, x_by_l, fma(by.y, m_by_l, by.z * c_by_l));
    let by_c = fma(by.x, x_by_c, fma(by.y, x_by_c, by.z * c_by_c));
    // The derivatives of H(λ, c).
    let plain = fma(terms.odd, tangent.tau, terms.even);
    let plain_by_t = terms.odd * terms.half_t.y * fma(tangent.sigma, c, -(terms.tail * tangent.tau));
    let plain_by_l = fma(-plain, terms.inverse, plain_by_t);
    let plain_by_c = terms.odd * terms.half_t.x * tangent.sigma;
    return Dual(
        fma(terms.even, even_part, terms.odd * odd_part),
        by_l * COSINE_AMPLITUDE - plain_by_l * COSINE_OFFSET,
        by_c * COSINE_AMPLITUDE - plain_by_c * COSINE_OFFSET,
    );
}

// E(λ, c) for any sharpness.
fn cosine_integral(sharpness: f32, terms: SharpnessTerms, c: f32) -> Dual {
    if (sharpness < SHARP) {
        return broad_integral(sharpness, c);
    }
    return sharp_integral(sharpness, terms, c);
}
