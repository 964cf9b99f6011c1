//! The published SG shading formulas (PhySG's `render_with_sg`), forward and adjoint, one point × one lobe at a time.
//!
//! Both outputs need only one scalar function of a lobe: the integral of an SG times the clamped cosine,
//! E(λ, c) ≈ ∫ exp(λ(ω·ξ − 1)) max(n·ω, 0) dω with c = ξ·n, in its published form 32.7080 H(SG × cosine SG) − 31.7003 H(SG).
//! A lobe's diffuse light is μ·E(λ, ξ·n); its specular light is μ·e^x·E(m, p·n), where light × warped NDF is the SG
//! with axis p, sharpness m and amplitude e^x. Rewritten from the paper's form so that sharp lobes keep their accuracy
//! in `f32`: with S = λ₁ + λ₂ and D = ξ₁·ξ₂ − 1, m = √(S² + 2λ₁λ₂D) and x = m − S = 2λ₁λ₂D/(m + S).

mod model;
pub mod sharp;

pub use model::Published;

use super::brdf::{fresnel_power, shadowing_k};
use super::model::Shape;
use super::real::{Real, Vec3Of, add, dot, scale, sub};
use sharp::{SHARP, SharpnessTerms};
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
    let abs_c = c.abs();
    let (a, e) = ((-t).decay(), (-(t * abs_c)).decay());
    let tanh_t = (one - a) * (one + a).inverse();
    let tanh_c = (one - e) * (one + e).inverse();
    // Both tanh cancel for small t; the ratio's series is good to 1e-9 below this bound.
    let bound = t.lit(0.05);
    let (t2, c2) = (t * t, c * c);
    let inverse = tanh_t.max(t.lit(1e-8)).inverse();
    let slope_c = (-tanh_c).mul_add(tanh_c, one);
    let slope_t = (-tanh_t).mul_add(tanh_t, one);
    let ratio = tanh_c * inverse;
    let by_c = t.times(0.5) * slope_c * inverse;
    let by_t = abs_c.mul_add(slope_c, -(ratio * slope_t)).times(0.5) * inverse;
    let ratio = t.select_lt(bound, abs_c * t2.times(1.0 / 12.0).mul_add(one - c2, one), ratio);
    let by_c = t.select_lt(bound, t2.mul_add(c2.times(-0.25).plus(1.0 / 12.0), one), by_c);
    let by_t = t.select_lt(bound, abs_c * t * (one - c2).times(1.0 / 6.0), by_t);
    let half = t.lit(0.5);
    let signed = half.copysign(c);
    (signed.mul_add(ratio, half), signed * by_t, half * by_c)
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
    let w = (-l).decay();
    let root = l.sqrt();
    // t = √λ·N/Q
    let inverse_l = l.inverse();
    let numerator = l * l.times(1.6988).plus(10.8438);
    let inverse_q = l.mul_plus(l.plus(6.2201), 10.2415).inverse();
    let q_ratio = numerator * inverse_q;
    let t = root * q_ratio;
    let q_slope = (-q_ratio).mul_add(l.times(2.0).plus(6.2201), l.times(2.0 * 1.6988).plus(10.8438));
    let t_slope = root * q_slope.mul_add(inverse_q, q_ratio.times(0.5) * inverse_l);
    let (s, s_by_t, s_by_c) = hemisphere_share(t, c);
    // g = (1 − w)/λ and its derivative, by series where they cancel.
    let small = l.lit(0.1);
    let g = (one - w) * inverse_l;
    let g_slope = (w - g) * inverse_l;
    let g_series = polynomial(l, [-1.0 / 720.0, 1.0 / 120.0, -1.0 / 24.0, 1.0 / 6.0, -0.5, 1.0]);
    let g_slope_series = polynomial(l, [1.0 / 840.0, -1.0 / 144.0, 1.0 / 30.0, -0.125, 1.0 / 3.0, -0.5]);
    let g = l.select_lt(small, g_series, g);
    let g_slope = l.select_lt(small, g_slope_series, g_slope);
    let share = (one - s).mul_add(w, s);
    let tau = 2.0 * PI;
    let share_by_l = ((one - w) * s_by_t).mul_add(t_slope, (s - one) * w);
    Dual {
        value: (g * share).times(tau),
        by_sharpness: g_slope.mul_add(share, g * share_by_l).times(tau),
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

/// A light lobe as the kernel reads it.
#[derive(Clone, Copy, Debug)]
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

/// One factor of G, c/(c(1 − k) + k + 1e-6), with its derivatives with respect to c and, given dk/dR, to R.
#[inline(always)]
fn shadowing_factor<F: Real>(c: F, k: F, k_slope: F) -> (F, F, F) {
    let inverse = (c * (c.one() - k) + k).plus(TINY).recip();
    let value = c * inverse;
    (value, (k.plus(TINY)) * inverse * inverse, -(value * inverse) * (c.one() - c) * k_slope)
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
    let (g1, g1_by_c, g1_by_r) = shadowing_factor(nr, k, k_slope);
    let (g2, g2_by_c, g2_by_r) = shadowing_factor(nv, k, k_slope);
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

/// E(λ, c) for any sharpness: from `terms` where λ ≥ [`SHARP`], by the formulas as they stand where it is less.
///
/// Every lane gets what its own sharpness asks for, whatever its neighbours are.
#[inline(always)]
fn either_integral<F: Real>(sharpness: F, c: F, terms: &SharpnessTerms<F>) -> Dual<F> {
    let sharp = sharp::cosine_integral(sharpness, terms, c);
    let bound = sharpness.lit(SHARP);
    if !sharpness.any_lt(bound) {
        return sharp;
    }
    let broad = cosine_integral(sharpness, c);
    let pick = |broad: F, sharp: F| sharpness.select_lt(bound, broad, sharp);
    Dual {
        value: pick(broad.value, sharp.value),
        by_sharpness: pick(broad.by_sharpness, sharp.by_sharpness),
        by_cosine: pick(broad.by_cosine, sharp.by_cosine),
    }
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
    product: Product<F>,
}

/// Evaluates one point × lobe by the published formulas as they stand.
#[inline(always)]
pub fn evaluate_pair<F: Real>(point: &PointTerms<F>, axis: Vec3Of<F>, sharpness: F) -> Pair<F> {
    let product = Product::new(point, &Shape { axis, sharpness });
    let diffuse = cosine_integral(sharpness, product.xn);
    let integral = cosine_integral(product.m, product.c);
    Pair::new(diffuse, integral, product)
}

/// Evaluates one point × lobe given the lobe's prepared terms.
#[inline(always)]
pub fn evaluate_prepared<F: Real>(
    point: &PointTerms<F>,
    lobe: &Shape<F>,
    terms: &SharpnessTerms<F>,
) -> Pair<F> {
    let product = Product::new(point, lobe);
    let diffuse = either_integral(lobe.sharpness, product.xn, terms);
    let own = SharpnessTerms::new(product.m, product.inverse_m);
    let integral = either_integral(product.m, product.c, &own);
    Pair::new(diffuse, integral, product)
}

/// The SG that is light × warped NDF: sharpness m, cosine c with the normal, amplitude e^x.
#[derive(Clone, Copy)]
struct Product<F> {
    xn: F,
    separation: Vec3Of<F>,
    d: F,
    m: F,
    inverse_m: F,
    x: F,
    c: F,
}

impl<F: Real> Product<F> {
    #[inline(always)]
    fn new(point: &PointTerms<F>, lobe: &Shape<F>) -> Self {
        let sharpness = lobe.sharpness;
        let xn = dot(lobe.axis, point.normal).times(SHRUNK);
        let l = point.warp_sharpness;
        let separation = sub(lobe.axis, point.mirror);
        // ξ·r − 1 for axes that are both shrunk by κ: κ²(û·r̂ − 1) − (1 − κ²).
        let d = dot(separation, separation).times(-0.5 * SHRUNK * SHRUNK).plus(SHRUNK * SHRUNK - 1.0);
        let s = sharpness + l;
        let twice = (sharpness * l * d).times(2.0);
        let m = s.mul_add(s, twice).max(s * s.times(1e-12)).sqrt();
        let x = twice * (m + s).inverse();
        let inverse_m = m.inverse();
        let c = sharpness.mul_add(xn, l * point.mirror_cosine) * inverse_m;
        Self { xn, separation, d, m, inverse_m, x, c }
    }
}

impl<F: Real> Pair<F> {
    #[inline(always)]
    fn new(diffuse: Dual<F>, integral: Dual<F>, product: Product<F>) -> Self {
        let amplitude = product.x.decay();
        Self { diffuse, specular: amplitude * integral.value, integral, amplitude, product }
    }
}

/// Adjoints of one pair with respect to the lobe's shape and to the point's terms.
#[derive(Clone, Copy)]
pub struct PairAdjoint<F> {
    /// With respect to the lobe's axis.
    pub axis: Vec3Of<F>,
    /// With respect to the lobe's sharpness.
    pub sharpness: F,
    /// With respect to the point's terms; that of the normal through ξ·n alone.
    pub point: PointTerms<F>,
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
    let Product { xn, separation, d, inverse_m, x, c, .. } = pair.product;
    let weight = specular_adjoint * pair.amplitude;
    let x_adjoint = specular_adjoint * pair.specular;
    let c_adjoint = weight * pair.integral.by_cosine * inverse_m;
    // m appears in E, in c = (…)/m, and in x = m − S.
    let m_adjoint = weight.mul_add(pair.integral.by_sharpness, -(c_adjoint * c));
    let both = m_adjoint + x_adjoint;
    let x_by_l1 = l.mul_add(d, -x) * inverse_m;
    let x_by_l2 = sharpness.mul_add(d, -x) * inverse_m;
    let d_adjoint = both * sharpness * l * inverse_m;
    let toward = d_adjoint.times(SHRUNK * SHRUNK);
    let xn_adjoint = diffuse_adjoint.mul_add(pair.diffuse.by_cosine, c_adjoint * sharpness).times(SHRUNK);
    let pull = scale(separation, toward);
    let n = point.normal;
    let turn = |i: usize| xn_adjoint.mul_add(n[i], -pull[i]);
    let through_diffuse = diffuse_adjoint.mul_add(pair.diffuse.by_sharpness, m_adjoint);
    PairAdjoint {
        axis: [turn(0), turn(1), turn(2)],
        sharpness: both.mul_add(x_by_l1, c_adjoint.mul_add(xn, through_diffuse)),
        point: PointTerms {
            normal: scale(axis, xn_adjoint),
            mirror: pull,
            mirror_cosine: c_adjoint * l,
            warp_sharpness: both.mul_add(x_by_l2, c_adjoint.mul_add(point.mirror_cosine, m_adjoint)),
        },
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
pub(crate) mod tests;
