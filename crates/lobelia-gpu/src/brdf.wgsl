// The BRDF of the PhySG supplement (eqs. 1–7), as in `lobelia_sg::brdf`.

// Fresnel term (PhySG supp. eq. 6): F = s + (1 − s)·2^(−(5.55473 x + 6.8316) x) with x = ωo·h; the power of two.
fn fresnel_power(cos_view_half: f32) -> f32 {
    return exp2(-fma(5.55473, cos_view_half, 6.8316) * cos_view_half);
}

// k = (R + 1)²/8 of the shadowing term G (PhySG supp. eqs. 1–7), and dk/dR.
fn shadowing_k(roughness: f32) -> vec2<f32> {
    let s = roughness + 1.0;
    return vec2(s * s * 0.125, s * 0.25);
}

// Sharpness 2/R⁴ of the SG that is the distribution of microfacet normals (PhySG supp. eq. 4).
fn ndf_sharpness(roughness: f32) -> f32 {
    let square = roughness * roughness;
    return 2.0 / (square * square);
}
