// The integral of an SG times the clamped cosine, in closed form (Tokuyoshi, Ikeda, Kulkarni and Harada 2024):
// `lobelia_sg::accurate::diffuse`.

// e^(x²)·erfc(x) for x ≥ 0: s·P((1 − px)/(1 + px)) with s = 1/(1 + px), p = 0.36.
fn scaled_erfc(x: f32) -> f32 {
    let s = 1.0 / (x * 0.36 + 1.0);
    let z = s * 2.0 - 1.0;
    var p = fma(7.47882407367e-05, z, 0.000106820557434);
    p = fma(p, z, -0.000670684595379);
    p = fma(p, z, -0.00195151911803);
    p = fma(p, z, 0.00238949866222);
    p = fma(p, z, 0.0272801696181);
    p = fma(p, z, 0.0898987791954);
    p = fma(p, z, 0.192277455528);
    p = fma(p, z, 0.306753512712);
    p = fma(p, z, 0.383841213067);
    return p * s;
}

// (1 − e^(−z))/z for small z ≥ 0 (below 0.5: error 1e-8).
fn mean_exponential(z: f32) -> f32 {
    var p = fma(1.0 / 5040.0, z, -1.0 / 720.0);
    p = fma(p, z, 1.0 / 120.0);
    p = fma(p, z, -1.0 / 24.0);
    p = fma(p, z, 1.0 / 6.0);
    p = fma(p, z, -0.5);
    return fma(p, z, 1.0);
}

// ∫ exp(λ(ω·ξ − 1)) max(n·ω, 0) dω for c = ξ·n, with its two derivatives. The terms of a lobe are t, t′, the integral over 2π for
// an axis along the normal and its derivative; the same against it, e^(−t²), and that times e^(t²)·erfc(t).
fn cosine_integral(lobe: Lobe, cosine: f32) -> Dual {
    let c = clamp(cosine, -1.0, 1.0);
    let first = lobe.terms[0];
    let second = lobe.terms[1];
    let t = first.x;
    let tc = t * c;
    let edge = fading_exp(-(tc * tc));
    // erfc(−tc), and (e^(−t²) − e^(−t²c²))/(2√π·t²), by series where the difference cancels.
    let tail = edge * scaled_erfc(abs(tc));
    let share = select(2.0 - tail, tail, tc < 0.0);
    let square = (1.0 - c) * (1.0 + c);
    let z = t * t * square;
    let mean = select((edge - second.z) / max(z, 0.5), edge * mean_exponential(z), z < 0.5);
    let difference = -mean * square * 0.28209479177387814;
    let blend = clamp((c * share + second.w) * 0.5 - difference * t, 0.0, 1.0);
    let span = first.z - second.x;
    let by_sharpness = fma(first.w - second.y, blend, second.y) + span * difference * first.y;
    return Dual(fma(span, blend, second.x) * 2.0 * PI, by_sharpness * 2.0 * PI, span * share * PI);
}
