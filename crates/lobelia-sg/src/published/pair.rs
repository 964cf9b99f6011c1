//! One point × one lobe: its two integrals, those of a/π and of F·G·D / (4 (n·ωo)(n·ωi)) (PhySG
//! supp. eqs. 1–7) times the lobe and the cosine, and their adjoints. The NDF (eq. 4) is warped to
//! incident directions (Wang et al. 2009); its product with the lobe is one SG.

use super::integral::cosine_integral;
use super::point::{PointTerms, SHRUNK, prepare_point};
use super::sharp::{self, SHARP, SharpnessTerms, sharpness_terms};
use crate::real::{Real, Vec3Of, dot, scale, sub};
use crate::sg::{Dual, Lobe, Shape};
use std::f64::consts::PI;

/// E(λ, c) for any sharpness: from `terms` where λ ≥ [`SHARP`], by the unmodified formulas for
/// smaller λ.
///
/// The choice is made per lane.
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
    /// e^x E(m, p·n), without M and the amplitude of the NDF.
    pub specular: F,
    integral: Dual<F>,
    amplitude: F,
    product: Product<F>,
}

/// Evaluates one point × lobe by the published formulas without series.
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
    let own = sharpness_terms(product.m, product.inverse_m);
    let integral = either_integral(product.m, product.c, &own);
    Pair::new(diffuse, integral, product)
}

/// The product of the light's SG and the warped NDF, itself an SG: sharpness m, cosine c with the
/// normal, amplitude e^x.
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
    /// With respect to the terms of the point; for the normal, through ξ·n only.
    pub point: PointTerms<F>,
}

/// Propagates the adjoints of `pair.diffuse` and `pair.specular` back to their inputs.
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

/// Diffuse and specular radiance of one point under one lobe, before the clamp at zero (for tables
/// and tests).
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
