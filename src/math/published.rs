//! The published SG shading formulas (PhySG's `render_with_sg`), forward and adjoint, one point × one lobe at a time.
//!
//! Both outputs need only one scalar function of a lobe: the integral of an SG times the clamped cosine,
//! E(λ, c) ≈ ∫ exp(λ(ω·ξ − 1)) max(n·ω, 0) dω with c = ξ·n, in its published form 32.7080 H(SG × cosine SG) − 31.7003 H(SG).
//! A lobe's diffuse light is μ·E(λ, ξ·n); its specular light is μ·e^x·E(m, p·n), where light × warped NDF is the SG
//! with axis p, sharpness m and amplitude e^x. Rewritten from the paper's form so that sharp lobes keep their accuracy
//! in `f32`: with S = λ₁ + λ₂ and D = ξ₁·ξ₂ − 1, m = √(S² + 2λ₁λ₂D) and x = m − S = 2λ₁λ₂D/(m + S).

use super::brdf::{fresnel_power, shadowing_k};
use super::real::{Real, Vec3Of, add, dot, scale, sub};
use std::f64::consts::PI;

/// The published code divides by |x| + 1e-6 when it normalises, so its "unit" vectors have this length.
const SHRUNK: f64 = 1.0 / (1.0 + 1e-6);
/// What it adds to denominators.
const TINY: f64 = 1e-6;
/// Sharpness and amplitude of the SG that stands for the cosine, and the constant taken off again (PhySG supp.).
const COSINE_SHARPNESS: f64 = 0.0315;
const COSINE_AMPLITUDE: f64 = 32.7080;
const COSINE_OFFSET: f64 = 31.7003;

/// A function's value and its two partial derivatives.
#[derive(Clone, Copy)]
pub struct Dual<F> {
    /// The value.
    pub value: F,
    /// Derivative with respect to the sharpness.
    pub by_sharpness: F,
    /// Derivative with respect to the cosine.
    pub by_cosine: F,
}

/// s = ½ + ½ tanh(tc/2)/tanh(t/2): the hemisphere's share of a lobe (Meder and Brüderlin 2018, eq. 12, rewritten).
/// Returns s, ∂s/∂t and ∂s/∂c.
#[inline(always)]
fn hemisphere_share<F: Real>(t: F, c: F) -> (F, F, F) {
    let one = t.one();
    let abs_c = c.max(-c);
    let (a, e) = ((-t).exp(), (-(t * abs_c)).exp());
    let (tanh_t, tanh_c) = ((one - a) / (one + a), (one - e) / (one + e));
    // Both tanh cancel for small t; the ratio's series is good to 1e-9 below this bound.
    let bound = t.lit(0.05);
    let (t2, c2) = (t * t, c * c);
    let inverse = tanh_t.max(t.lit(1e-8)).recip();
    let slope_c = one - tanh_c * tanh_c;
    let slope_t = one - tanh_t * tanh_t;
    let ratio = tanh_c * inverse;
    let by_c = t.times(0.5) * slope_c * inverse;
    let by_t = (abs_c * slope_c - ratio * slope_t).times(0.5) * inverse;
    let ratio = t.select_lt(bound, abs_c * (one + t2 * (one - c2).times(1.0 / 12.0)), ratio);
    let by_c = t.select_lt(bound, one + t2 * (one - c2.times(3.0)).times(1.0 / 12.0), by_c);
    let by_t = t.select_lt(bound, abs_c * t * (one - c2).times(1.0 / 6.0), by_t);
    let half = t.lit(0.5);
    let signed = c.select_lt(c.zero(), -half, half);
    (half + signed * ratio, signed * by_t, half * by_c)
}

/// Polynomial with the highest power's coefficient first.
#[inline(always)]
fn polynomial<F: Real>(x: F, coefficients: [f64; 6]) -> F {
    let mut p = x.lit(coefficients[0]);
    for c in &coefficients[1..] {
        p = p.mul_add(x, x.lit(*c));
    }
    p
}

/// H: integral over the hemisphere around n of a unit-amplitude SG whose axis makes the cosine `c` with n
/// (DESIGN "Hemisphere integral"; Meder and Brüderlin 2018).
#[inline(always)]
pub fn hemisphere_integral<F: Real>(sharpness: F, c: F) -> Dual<F> {
    let l = sharpness.plus(TINY);
    let one = l.one();
    let w = (-l).exp();
    let root = l.sqrt();
    // t = √λ·N/Q
    let numerator = l * (l.times(1.6988).plus(10.8438));
    let inverse_q = (l * l.plus(6.2201)).plus(10.2415).recip();
    let q_ratio = numerator * inverse_q;
    let t = root * q_ratio;
    let t_slope = q_ratio.times(0.5) / root
        + root * inverse_q * (l.times(2.0 * 1.6988).plus(10.8438) - q_ratio * l.times(2.0).plus(6.2201));
    let (s, s_by_t, s_by_c) = hemisphere_share(t, c);
    // g = (1 − w)/λ and its derivative, by series where they cancel.
    let small = l.lit(0.1);
    let g = (one - w) / l;
    let g_slope = (w - g) / l;
    let g_series = polynomial(l, [-1.0 / 720.0, 1.0 / 120.0, -1.0 / 24.0, 1.0 / 6.0, -0.5, 1.0]);
    let g_slope_series = polynomial(l, [1.0 / 840.0, -1.0 / 144.0, 1.0 / 30.0, -0.125, 1.0 / 3.0, -0.5]);
    let g = l.select_lt(small, g_series, g);
    let g_slope = l.select_lt(small, g_slope_series, g_slope);
    let share = s + (one - s) * w;
    let tau = 2.0 * PI;
    Dual {
        value: (g * share).times(tau),
        by_sharpness: (g_slope * share + g * ((one - w) * s_by_t * t_slope - (one - s) * w)).times(tau),
        by_cosine: (g * (one - w) * s_by_c).times(tau),
    }
}

/// E(λ, c): the published approximation of ∫ exp(λ(ω·ξ − 1)) max(n·ω, 0) dω with c = ξ·n.
#[inline(always)]
pub fn cosine_integral<F: Real>(sharpness: F, c: F) -> Dual<F> {
    let k = sharpness.lit(COSINE_SHARPNESS);
    let d = (c.plus(-1.0)).min(c.zero());
    let s = sharpness + k;
    let m = (s * s + (k * sharpness * d).times(2.0)).max(s * s.times(1e-12)).sqrt();
    let inverse_m = m.recip();
    let x = (k * sharpness * d).times(2.0) / (m + s);
    let x_by_l = (k * d - x) * inverse_m;
    let m_by_c = k * sharpness * inverse_m;
    let m_by_l = x_by_l.plus(1.0);
    let c_product = (k + sharpness * c) * inverse_m;
    let c_by_l = (c - c_product * m_by_l) * inverse_m;
    let c_by_c = (sharpness - c_product * m_by_c) * inverse_m;
    let product = hemisphere_integral(m, c_product);
    let plain = hemisphere_integral(sharpness, c);
    let amplitude = x.exp().times(COSINE_AMPLITUDE);
    let by = |dx: F, dm: F, dc: F| {
        amplitude * (product.value * dx + product.by_sharpness * dm + product.by_cosine * dc)
    };
    Dual {
        value: amplitude * product.value - plain.value.times(COSINE_OFFSET),
        by_sharpness: by(x_by_l, m_by_l, c_by_l) - plain.by_sharpness.times(COSINE_OFFSET),
        by_cosine: by(m_by_c, m_by_c, c_by_c) - plain.by_cosine.times(COSINE_OFFSET),
    }
}

/// A light lobe as the kernel reads it.
#[derive(Clone, Copy)]
pub struct Lobe<F> {
    /// Unit axis.
    pub axis: Vec3Of<F>,
    /// Sharpness ≥ 0.
    pub sharpness: F,
    /// RGB amplitude.
    pub amplitude: Vec3Of<F>,
}

/// What a surface point and a specular lobe contribute to every lobe's integral.
#[derive(Clone, Copy)]
pub struct PointTerms<F> {
    /// Unit normal.
    pub normal: Vec3Of<F>,
    /// Mirror direction r = 2(n·v)₊n − v.
    pub mirror: Vec3Of<F>,
    /// r·n as the published code has it.
    pub mirror_cosine: F,
    /// Sharpness of the warped NDF.
    pub warp_sharpness: F,
}

/// M·N, the frozen BRDF factor times the NDF's amplitude, as `constant + slope · specular albedo`, with derivatives.
#[derive(Clone, Copy)]
pub struct FrozenBrdf<F> {
    /// Part that does not depend on the specular albedo.
    pub constant: F,
    /// Factor of the specular albedo.
    pub slope: F,
    /// Derivatives of `[constant, slope, warp_sharpness]` with respect to n·v.
    pub by_cosine: [F; 3],
    /// Derivatives of `[constant, slope, warp_sharpness]` with respect to the roughness.
    pub by_roughness: [F; 3],
}

/// Everything that depends on the point and the specular material but not on the light.
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

    // h = (r + v)/(|r + v| + 1e-6) with r + v = 2κ(n·v)n + (1 − κ)v.
    let epsilon = 1.0 - SHRUNK;
    let q = nv.times(2.0 * SHRUNK);
    let length = (q * q + (q * nv).times(2.0 * epsilon)).plus(epsilon * epsilon).sqrt();
    let length_slope = (q.times(SHRUNK * 2.0) + nv.times(4.0 * SHRUNK * epsilon)) / length;
    let inverse_length = length.plus(TINY).recip();
    let vh = (q * nv).plus(epsilon) * inverse_length;
    let vh_slope = (nv.times(4.0 * SHRUNK) - vh * length_slope) * inverse_length;
    let power = fresnel_power(vh);
    let power_slope =
        -(vh.times(2.0 * 5.55473).plus(6.8316)).times(std::f64::consts::LN_2) * power * vh_slope;

    // Q = G/(4 (n·r)(n·v) + 1e-6) with n·r = κ n·v, and the two factors of G.
    let k = shadowing_k(roughness);
    let k_slope = roughness.plus(1.0).times(0.25);
    let nr = nv.times(SHRUNK);
    let factor = |c: F| {
        let inverse = (c * (c.one() - k) + k).plus(TINY).recip();
        let value = c * inverse;
        (value, (k.plus(TINY)) * inverse * inverse, -(value * inverse) * (c.one() - c) * k_slope)
    };
    let (g1, g1_by_c, g1_by_r) = factor(nr);
    let (g2, g2_by_c, g2_by_r) = factor(nv);
    let inverse = (nr * nv).times(4.0).plus(TINY).recip();
    let quotient = g1 * g2 * inverse;
    let quotient_by_c =
        (g1_by_c.times(SHRUNK) * g2 + g1 * g2_by_c - quotient * nv.times(8.0 * SHRUNK)) * inverse;
    let quotient_by_r = (g1_by_r * g2 + g1 * g2_by_r) * inverse;

    let common = quotient * ndf_amplitude;
    let common_by_c = quotient_by_c * ndf_amplitude;
    let common_by_r = (quotient_by_r - quotient.times(4.0) / roughness) * ndf_amplitude;
    let rest = power.one() - power;
    let brdf = FrozenBrdf {
        constant: common * power,
        slope: common * rest,
        by_cosine: [
            common_by_c * power + common * power_slope,
            common_by_c * rest - common * power_slope,
            -(warp_sharpness * warp_denominator).times(4.0),
        ],
        by_roughness: [common_by_r * power, common_by_r * rest, -(warp_sharpness / roughness).times(4.0)],
    };
    (terms, brdf)
}

/// One lobe's two integrals at a point, for unit amplitude, with what their adjoint needs.
#[derive(Clone, Copy)]
pub struct Pair<F> {
    /// E(λ, ξ·n).
    pub diffuse: Dual<F>,
    /// e^x E(m, p·n), still without M and the NDF's amplitude.
    pub specular: F,
    integral: Dual<F>,
    amplitude: F,
    xn: F,
    separation: Vec3Of<F>,
    d: F,
    m: F,
    x: F,
    c: F,
}

/// Evaluates one point × lobe.
#[inline(always)]
pub fn evaluate_pair<F: Real>(point: &PointTerms<F>, axis: Vec3Of<F>, sharpness: F) -> Pair<F> {
    let xn = dot(axis, point.normal).times(SHRUNK);
    let diffuse = cosine_integral(sharpness, xn);
    let l = point.warp_sharpness;
    let separation = sub(axis, point.mirror);
    // ξ·r − 1 for axes that are both shrunk by κ: κ²(û·r̂ − 1) − (1 − κ²).
    let d = -(dot(separation, separation).times(0.5 * SHRUNK * SHRUNK)).plus(1.0 - SHRUNK * SHRUNK);
    let s = sharpness + l;
    let twice = (sharpness * l * d).times(2.0);
    let m = (s * s + twice).max(s * s.times(1e-12)).sqrt();
    let x = twice / (m + s);
    let c = (sharpness * xn + l * point.mirror_cosine) / m;
    let integral = cosine_integral(m, c);
    let amplitude = x.exp();
    Pair { diffuse, specular: amplitude * integral.value, integral, amplitude, xn, separation, d, m, x, c }
}

/// Adjoints of one pair with respect to the lobe's shape and to the point's terms.
#[derive(Clone, Copy)]
pub struct PairAdjoint<F> {
    /// With respect to the lobe's axis.
    pub axis: Vec3Of<F>,
    /// With respect to the lobe's sharpness.
    pub sharpness: F,
    /// With respect to the normal, through ξ·n alone.
    pub normal: Vec3Of<F>,
    /// With respect to the mirror direction.
    pub mirror: Vec3Of<F>,
    /// With respect to r·n.
    pub mirror_cosine: F,
    /// With respect to the warped NDF's sharpness.
    pub warp_sharpness: F,
}

/// Carries the adjoints of `pair.diffuse` and `pair.specular` back to their inputs.
#[inline(always)]
pub fn pull_back_pair<F: Real>(
    pair: &Pair<F>,
    point: &PointTerms<F>,
    axis: Vec3Of<F>,
    sharpness: F,
    diffuse_adjoint: F,
    specular_adjoint: F,
) -> PairAdjoint<F> {
    let l = point.warp_sharpness;
    let inverse_m = pair.m.recip();
    let weight = specular_adjoint * pair.amplitude;
    let x_adjoint = specular_adjoint * pair.specular;
    let c_adjoint = weight * pair.integral.by_cosine * inverse_m;
    // m appears in E, in c = (…)/m, and in x = m − S.
    let m_adjoint = weight * pair.integral.by_sharpness - c_adjoint * pair.c;
    let x_by_l1 = (l * pair.d - pair.x) * inverse_m;
    let x_by_l2 = (sharpness * pair.d - pair.x) * inverse_m;
    let d_adjoint = (m_adjoint + x_adjoint) * sharpness * l * inverse_m;
    let toward = d_adjoint.times(SHRUNK * SHRUNK);
    let xn_adjoint = (diffuse_adjoint * pair.diffuse.by_cosine + c_adjoint * sharpness).times(SHRUNK);
    let pull = scale(pair.separation, toward);
    PairAdjoint {
        axis: sub(scale(point.normal, xn_adjoint), pull),
        sharpness: diffuse_adjoint * pair.diffuse.by_sharpness
            + m_adjoint * x_by_l1.plus(1.0)
            + x_adjoint * x_by_l1
            + c_adjoint * pair.xn,
        normal: scale(axis, xn_adjoint),
        mirror: pull,
        mirror_cosine: c_adjoint * l,
        warp_sharpness: m_adjoint * x_by_l2.plus(1.0) + x_adjoint * x_by_l2 + c_adjoint * point.mirror_cosine,
    }
}

/// Adjoint of a point's normal given those of its mirror direction and of n·v.
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

/// Diffuse and specular radiance of one point under one lobe, before the clamp at zero (for tables and tests).
pub fn shade_pair<F: Real>(
    normal: Vec3Of<F>,
    to_viewer: Vec3Of<F>,
    lobe: &Lobe<F>,
    albedo: Vec3Of<F>,
    specular_albedo: Vec3Of<F>,
    roughness: F,
) -> (Vec3Of<F>, Vec3Of<F>) {
    let (terms, brdf) = prepare_point(normal, to_viewer, roughness);
    let pair = evaluate_pair(&terms, lobe.axis, lobe.sharpness);
    let channel = |c: usize| {
        let m = brdf.constant + brdf.slope * specular_albedo[c];
        (
            lobe.amplitude[c] * albedo[c].times(1.0 / PI) * pair.diffuse.value,
            lobe.amplitude[c] * m * pair.specular,
        )
    };
    let (r, g, b) = (channel(0), channel(1), channel(2));
    ([r.0, g.0, b.0], [r.1, g.1, b.1])
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng, rngs::SmallRng};

    /// One case: normal, view, lobe, albedo, specular albedo, roughness.
    #[derive(Clone, Copy, Debug)]
    pub(crate) struct Case {
        pub normal: [f64; 3],
        pub to_viewer: [f64; 3],
        pub axis: [f64; 3],
        pub sharpness: f64,
        pub amplitude: [f64; 3],
        pub albedo: [f64; 3],
        pub specular: [f64; 3],
        pub roughness: f64,
    }

    pub(crate) fn unit(v: [f64; 3]) -> [f64; 3] {
        scale(v, dot(v, v).sqrt().recip())
    }

    pub(crate) fn random_case(rng: &mut SmallRng) -> Case {
        let mut direction = || unit(std::array::from_fn(|_| rng.random_range(-1.0..1.0)));
        let (normal, mut to_viewer, mut axis) = (direction(), direction(), direction());
        if dot(normal, to_viewer) < 0.05 {
            to_viewer = unit(add(scale(normal, 0.2 - dot(normal, to_viewer)), to_viewer));
        }
        if rng.random_bool(0.5) {
            // Half of the cases look near the highlight, where the specular part is large.
            let mirror = sub(scale(normal, 2.0 * dot(normal, to_viewer)), to_viewer);
            axis = unit(add(mirror, scale(axis, 0.3)));
        }
        let mut color = || std::array::from_fn(|_| rng.random_range(0.1..0.9));
        let (amplitude, albedo, specular) = (color(), color(), color());
        Case {
            normal,
            to_viewer,
            axis,
            sharpness: 10f64.powf(rng.random_range(-1.5..3.0)),
            amplitude,
            albedo,
            specular,
            roughness: rng.random_range(0.1..0.9),
        }
    }

    pub(crate) fn forward(case: &Case) -> ([f64; 3], [f64; 3]) {
        let lobe = Lobe { axis: case.axis, sharpness: case.sharpness, amplitude: case.amplitude };
        shade_pair(case.normal, case.to_viewer, &lobe, case.albedo, case.specular, case.roughness)
    }

    /// The gradient of Σ w·(diffuse, specular) by the same steps as the slice kernel.
    pub(crate) fn gradient(case: &Case, wd: [f64; 3], ws: [f64; 3]) -> Case {
        let (terms, brdf) = prepare_point(case.normal, case.to_viewer, case.roughness);
        let pair = evaluate_pair(&terms, case.axis, case.sharpness);
        let m: [f64; 3] = case.specular.map(|s| brdf.constant + brdf.slope * s);
        let kd: [f64; 3] = std::array::from_fn(|c| wd[c] * case.albedo[c] / PI);
        let ks: [f64; 3] = std::array::from_fn(|c| ws[c] * m[c]);
        let (ed, es) = (dot(kd, case.amplitude), dot(ks, case.amplitude));
        let back = pull_back_pair(&pair, &terms, case.axis, case.sharpness, ed, es);
        let glossy: [f64; 3] = std::array::from_fn(|c| ws[c] * case.amplitude[c] * pair.specular);
        let constant: f64 = glossy.iter().sum();
        let slope = dot(glossy, case.specular);
        let chain = |by: &[f64; 3]| constant * by[0] + slope * by[1] + back.warp_sharpness * by[2];
        let cosine = chain(&brdf.by_cosine) + back.mirror_cosine;
        Case {
            normal: add(back.normal, pull_back_normal(case.normal, case.to_viewer, back.mirror, cosine)),
            to_viewer: [0.0; 3],
            axis: back.axis,
            sharpness: back.sharpness,
            amplitude: std::array::from_fn(|c| kd[c] * pair.diffuse.value + ks[c] * pair.specular),
            albedo: std::array::from_fn(|c| wd[c] / PI * case.amplitude[c] * pair.diffuse.value),
            specular: glossy.map(|g| g * brdf.slope),
            roughness: chain(&brdf.by_roughness),
        }
    }

    fn weighted(case: &Case, wd: [f64; 3], ws: [f64; 3]) -> f64 {
        let (d, s) = forward(case);
        dot(d, wd) + dot(s, ws)
    }

    /// Central difference along a change of the case, compared with the gradient's prediction.
    fn check(name: &str, case: &Case, step: f64, predicted: f64, at: impl Fn(f64) -> Case) {
        let (wd, ws) = ([0.7, -0.4, 0.5], [0.3, 0.9, -0.2]);
        let difference = (weighted(&at(step), wd, ws) - weighted(&at(-step), wd, ws)) / (2.0 * step);
        let size = weighted(case, [1.0; 3], [1.0; 3]).abs().max(1e-6);
        let error = (difference - predicted).abs() / (difference.abs() + 1e-2 * size + 2e-6);
        assert!(error < 1e-4, "{name}: difference {difference}, adjoint {predicted}, case {case:?}");
    }

    #[test]
    fn every_adjoint_agrees_with_central_differences() {
        let mut rng = SmallRng::seed_from_u64(7);
        let (wd, ws) = ([0.7, -0.4, 0.5], [0.3, 0.9, -0.2]);
        for _ in 0..400 {
            let case = random_case(&mut rng);
            let g = gradient(&case, wd, ws);
            let h = 1e-5;
            check("sharpness", &case, h * case.sharpness, g.sharpness, |e| Case {
                sharpness: case.sharpness + e,
                ..case
            });
            check("roughness", &case, 1e-6, g.roughness, |e| Case { roughness: case.roughness + e, ..case });
            for c in 0..3 {
                let moved = |v: [f64; 3], e: f64| {
                    let mut v = v;
                    v[c] += e;
                    v
                };
                check("amplitude", &case, h, g.amplitude[c], |e| Case {
                    amplitude: moved(case.amplitude, e),
                    ..case
                });
                check("albedo", &case, h, g.albedo[c], |e| Case { albedo: moved(case.albedo, e), ..case });
                check("specular", &case, h, g.specular[c], |e| Case {
                    specular: moved(case.specular, e),
                    ..case
                });
                check("axis", &case, 1e-6, g.axis[c], |e| Case { axis: moved(case.axis, e), ..case });
            }
            // A unit normal moves along its tangent plane only.
            let helper = if case.normal[0].abs() < 0.6 { [1.0, 0.0, 0.0] } else { [0.0, 1.0, 0.0] };
            let tangent = unit(sub(helper, scale(case.normal, dot(helper, case.normal))));
            check("normal", &case, 1e-6, dot(g.normal, tangent), |e| Case {
                normal: unit(add(case.normal, scale(tangent, e))),
                ..case
            });
        }
    }

    /// The formulas exactly as DESIGN.md writes them, without any of the rewriting above.
    fn reference(case: &Case) -> ([f64; 3], [f64; 3]) {
        let shrink = |v: [f64; 3]| scale(v, 1.0 / (dot(v, v).sqrt() + 1e-6));
        let product = |l1: f64, x1: [f64; 3], l2: f64, x2: [f64; 3]| {
            let q = l1 / l2;
            let t = (q * q + 1.0 + 2.0 * q * dot(x1, x2)).sqrt().min(q + 1.0);
            (l2 * t, scale(add(scale(x1, q), x2), 1.0 / t), (l2 * (t - q - 1.0)).exp())
        };
        let hemisphere = |l: f64, c: f64| {
            let l = l + 1e-6;
            let t = l.sqrt() * (1.6988 * l * l + 10.8438 * l) / (l * l + 6.2201 * l + 10.2415);
            let s = (1.0 - (-t).exp() * (-t * c).exp()) / ((1.0 - (-t).exp()) * (1.0 + (-t * c).exp()));
            2.0 * PI / l * (1.0 - (-l).exp()) * (s + (1.0 - s) * (-l).exp())
        };
        let (n, v) = (case.normal, case.to_viewer);
        let lit = |l: f64, x: [f64; 3]| {
            let (m, axis, factor) = product(0.0315, n, l, x);
            32.7080 * factor * hemisphere(m, dot(axis, n)) - 31.7003 * hemisphere(l, dot(x, n))
        };
        let axis = shrink(case.axis);
        let nv = dot(n, v).max(0.0);
        let r4 = case.roughness.powi(4);
        let r = shrink(sub(scale(n, 2.0 * nv), v));
        let warped = 2.0 / r4 / (4.0 * nv + 1e-6);
        let vh = dot(v, shrink(add(r, v))).max(0.0);
        let k = (case.roughness + 1.0).powi(2) / 8.0;
        let nr = dot(n, r).max(0.0);
        let g = nr / (nr * (1.0 - k) + k + 1e-6) * (nv / (nv * (1.0 - k) + k + 1e-6));
        let power = (-(5.55473 * vh + 6.8316) * vh).exp2();
        let (m, p, factor) = product(case.sharpness, axis, warped, r);
        let (e, p_lit) = (lit(case.sharpness, axis), factor * lit(m, p));
        let diffuse = std::array::from_fn(|c| case.amplitude[c] * case.albedo[c] / PI * e);
        let specular = std::array::from_fn(|c| {
            let f = case.specular[c] + (1.0 - case.specular[c]) * power;
            case.amplitude[c] * f * g / (4.0 * nr * nv + 1e-6) / (PI * r4) * p_lit
        });
        (diffuse, specular)
    }

    #[test]
    fn rewritten_formulas_equal_the_published_ones() {
        let mut rng = SmallRng::seed_from_u64(3);
        for _ in 0..2000 {
            let case = random_case(&mut rng);
            let ((d, s), (rd, rs)) = (forward(&case), reference(&case));
            for c in 0..3 {
                assert!((d[c] - rd[c]).abs() <= 1e-5 * rd[c].abs() + 1e-9, "{} {} {case:?}", d[c], rd[c]);
                assert!((s[c] - rs[c]).abs() <= 1e-4 * rs[c].abs() + 1e-8, "{} {} {case:?}", s[c], rs[c]);
            }
        }
    }
}
