//! Where the nodes of the specular integral lie: around the peak of the product of one light SG and
//! one SG of half vectors, in the chart of `accurate/specular.rs`.
//!
//! 1. Initialization between the half vector of the light's axis and the peak of the NDF, weighted
//!    by their curvatures.
//! 2. One Gauss–Newton step: the light's exponent −λ|ω − ξ|²/2 is a sum of squares, so its Hessian
//!    is positive without a lower bound; ln(v·h) and the curvature of n·ω are added to it, and n·ω
//!    itself stays a separate linear factor.
//! 3. Along the direction in which n·ω changes, the rest is a Gaussian clipped by the horizon:
//!    nodes from [`Clipped`]. Across it: Gauss–Hermite.

use super::point::{NdfTerms, PointTerms};
use super::rule::Clipped;
use crate::real::{Real, Vec3Of};
use crate::{sg::Shape, two::Two};

/// Two reals: a point or a vector of the chart, or the parts of a direction along tangent and
/// normal.
pub(super) type Vec2Of<F> = [F; 2];

/// Lower bound of n·ω and v·h in the Hessian, which keeps their logarithms bounded near the
/// horizon.
const COSINE_FLOOR: f64 = 0.05;
const HALF_FLOOR: f64 = 1e-3;
/// For a light below the horizon the initial point lies at least 1/(λ + 1/LIFT) above it.
const LIFT: f64 = 0.3;
/// Largest |X|² at which the integrand is expanded; the horizon lies within |X|² < 2, the chart
/// ends at 4.
const CHART_LIMIT: f64 = 3.0;

/// A light lobe in a point's frame.
#[derive(Clone, Copy)]
pub struct LocalLight<F> {
    /// Axis along tangent, bitangent and normal.
    pub axis: Vec3Of<F>,
    /// λ.
    pub sharpness: F,
}

impl<F: Real> LocalLight<F> {
    #[inline(always)]
    pub(super) fn new<const NDF: usize>(point: &PointTerms<F, NDF>, shape: &Shape<F>) -> Self {
        Self { axis: point.in_frame(shape.axis), sharpness: shape.sharpness }
    }
}

impl<F: Real> LocalLight<Two<F>> {
    /// Two lobes as one.
    #[inline(always)]
    pub(super) fn two(one: &LocalLight<F>, other: &LocalLight<F>) -> Self {
        let ([x, y, z], [u, v, w]) = (one.axis, other.axis);
        Self { axis: [Two(x, u), Two(y, v), Two(z, w)], sharpness: Two(one.sharpness, other.sharpness) }
    }
}

/// The Gaussian, cut by the horizon, that nodes are placed on.
#[derive(Clone, Copy)]
pub struct Placement<F> {
    /// Peak of the integrand in the chart.
    pub(super) peak: Vec2Of<F>,
    /// Width along the clipped direction.
    pub(super) along: Vec2Of<F>,
    /// Standard deviation across it.
    pub(super) across: Vec2Of<F>,
    pub(super) clipped: Clipped<F>,
    /// The Gaussian's mass.
    pub(super) weight: F,
}

impl<F: Copy> Placement<Two<F>> {
    /// The first and the second.
    #[inline(always)]
    fn split(self) -> [Placement<F>; 2] {
        [self.each(|two| two.0), self.each(|two| two.1)]
    }

    #[inline(always)]
    fn each(&self, one: impl Fn(Two<F>) -> F) -> Placement<F> {
        let pair = |[x, y]: Vec2Of<Two<F>>| [one(x), one(y)];
        Placement {
            peak: pair(self.peak),
            along: pair(self.along),
            across: pair(self.across),
            clipped: self.clipped.each(&one),
            weight: one(self.weight),
        }
    }
}

/// The shape of a distribution of normals, for a constant parameter of the functions here.
pub(super) type Tail = bool;
/// e^(−Ld), with d = 1 − h·n.
pub(super) const SG: Tail = false;
/// (1 + Ld(2 − d)/4)⁻², which is GGX for L = 4(1/α² − 1): the same curvature at the peak.
pub(super) const GGX: Tail = true;

/// Dot product in the chart.
#[inline(always)]
pub(super) fn dot2<F: Real>(a: Vec2Of<F>, b: Vec2Of<F>) -> F {
    a[0].mul_add(b[0], a[1] * b[1])
}

/// `a·x + b·y`, component by component.
#[inline(always)]
fn combine<F: Real>(a: F, x: Vec2Of<F>, b: F, y: Vec2Of<F>) -> Vec2Of<F> {
    [a.mul_add(x[0], b * y[0]), a.mul_add(x[1], b * y[1])]
}

/// A symmetric 2×2 matrix: xx, xy, yy.
#[derive(Clone, Copy)]
struct Symmetric<F>([F; 3]);

impl<F: Real> Symmetric<F> {
    /// `s·I + a·ggᵀ + b·xxᵀ + c·(gxᵀ + xgᵀ)/2`.
    #[inline(always)]
    fn new(s: F, a: F, g: Vec2Of<F>, b: F, x: Vec2Of<F>, c: F) -> Self {
        let (ag, bx) = (
            combine(a, g, c.times(0.5), x), // a·g + c/2·x, so that outer products with g and x share it
            combine(b, x, c.times(0.5), g),
        );
        Self([
            ag[0].mul_add(g[0], bx[0].mul_add(x[0], s)),
            ag[0].mul_add(g[1], bx[0] * x[1]),
            ag[1].mul_add(g[1], bx[1].mul_add(x[1], s)),
        ])
    }

    /// 1/determinant; the determinant has a lower bound so that rounding cannot change its sign.
    #[inline(always)]
    fn inverse_determinant(&self) -> F {
        let [xx, xy, yy] = self.0;
        let diagonal = xx * yy;
        (diagonal - xy * xy).max(diagonal.times(1e-4)).inverse()
    }

    /// The adjugate times `v`: the inverse times `v`, up to the determinant.
    #[inline(always)]
    fn adjugate_times(&self, v: Vec2Of<F>) -> Vec2Of<F> {
        let [xx, xy, yy] = self.0;
        [yy.mul_add(v[0], -(xy * v[1])), xx.mul_add(v[1], -(xy * v[0]))]
    }
}

/// The viewer's side of the chart: v·h and its gradient at X, with q = √(1 − |X|²/4).
#[inline(always)]
fn view_half_gradient<F: Real>(view: Vec2Of<F>, x: Vec2Of<F>, q: F, quarter: F) -> Vec2Of<F> {
    let pull = (view[0] * x[0]).mul_add(quarter, view[1]);
    [view[0].mul_add(q, -(pull * x[0])), -(pull * x[1])]
}

/// Initialization of the peak: the half vector of the light and the peak of the NDF, weighted by
/// their curvatures.
#[inline(always)]
fn start<F: Real, const TAIL: Tail>(
    point_view: Vec2Of<F>,
    ndf: &NdfTerms<F>,
    light: &LocalLight<F>,
) -> Vec2Of<F> {
    let l = light.sharpness;
    let up = light.axis[2].max(l.plus(1.0 / LIFT).inverse());
    let sum = [point_view[0] + light.axis[0], light.axis[1], point_view[1] + up];
    let square = dot2([sum[0], sum[1]], [sum[0], sum[1]]) + sum[2] * sum[2];
    let inverse = square.max(l.lit(1e-12)).rough_rsqrt();
    let half = [sum[0] * inverse, sum[1] * inverse, sum[2] * inverse];
    // q = cos(θ/2), and X = h_xy/q.
    let q2 = half[2].plus(1.0).times(0.5);
    let inverse_q = q2.rough_rsqrt();
    let q = q2 * inverse_q;
    let x = [half[0] * inverse_q, half[1] * inverse_q];
    let gradient = view_half_gradient(point_view, x, q, inverse_q.times(0.25));
    let view_half = point_view[0].mul_add(half[0], point_view[1] * half[2]).relu();
    // x + H⁻¹·L(NDF's peak − x) with H = αI + 4λggᵀ, inverted by Sherman and Morrison's formula.
    let four = l.times(4.0);
    let mut toward = ndf.sharpness;
    if TAIL == GGX {
        toward = toward * half[2] * spread(ndf, sine2_of(dot2(x, x))).inverse();
    }
    let alpha = (four * view_half).mul_add(view_half, toward);
    let pull = [ndf.start - x[0], -x[1]];
    let beta = dot2(gradient, gradient).mul_add(four, alpha);
    let inverse = (alpha * beta).inverse() * toward;
    let along = -(four * inverse * dot2(gradient, pull));
    let plain = inverse * beta;
    [
        along.mul_add(gradient[0], plain.mul_add(pull[0], x[0])),
        along.mul_add(gradient[1], plain.mul_add(pull[1], x[1])),
    ]
}

/// 1 + L·sin²/4 of GGX at the square of the sine between h and n.
#[inline(always)]
pub(super) fn spread<F: Real>(ndf: &NdfTerms<F>, sine2: F) -> F {
    (ndf.sharpness.times(0.25)).mul_add(sine2, sine2.one())
}

/// 1 − (h·n)² at |X|² = 2(1 − h·n).
#[inline(always)]
fn sine2_of<F: Real>(radius2: F) -> F {
    radius2 * radius2.mul_add(radius2.lit(-0.25), radius2.one())
}

/// The NDF pulls toward the normal with Λx, and has the curvature ΛI − h·xxᵀ: Λ and h, which is
/// Λ²/2 + L/(1 + u) for GGX.
#[inline(always)]
fn pull_of_ndf<F: Real, const TAIL: Tail>(ndf: &NdfTerms<F>, radius2: F, up: F) -> (F, F) {
    if TAIL == SG {
        return (ndf.sharpness, up.zero());
    }
    let fading = ndf.sharpness * spread(ndf, sine2_of(radius2)).inverse();
    let pulls = fading * up.relu();
    (pulls, (pulls * pulls).mul_add(up.lit(0.5), fading))
}

/// A point X of the chart.
struct ChartPoint<F> {
    x: Vec2Of<F>,
    /// |X|², at most [`CHART_LIMIT`].
    radius2: F,
    /// q² = 1 − |X|²/4.
    q2: F,
    q: F,
    inverse_q: F,
    /// 1/(4q).
    quarter: F,
    /// h·n.
    up: F,
}

impl<F: Real> ChartPoint<F> {
    #[inline(always)]
    fn new(x: Vec2Of<F>) -> Self {
        let radius2 = dot2(x, x).min(x[0].lit(CHART_LIMIT));
        let q2 = radius2.times(-0.25).plus(1.0);
        let inverse_q = q2.quick_rsqrt();
        let (q, quarter) = (q2 * inverse_q, inverse_q.times(0.25));
        let up = radius2.times(-0.5).plus(1.0);
        Self { x, radius2, q2, q, inverse_q, quarter, up }
    }

    /// ξ·h for a direction ξ, and its gradient.
    #[inline(always)]
    fn axis_half(&self, axis: Vec3Of<F>) -> (F, Vec2Of<F>) {
        let (x, q) = (self.x, self.q);
        let side = axis[0].mul_add(x[0], axis[1] * x[1]);
        let value = q.mul_add(side, axis[2] * self.up);
        let pull = side.mul_add(self.quarter, axis[2]);
        (value, [q.mul_add(axis[0], -(pull * x[0])), q.mul_add(axis[1], -(pull * x[1]))])
    }
}

/// v·h and n·ω at a point of the chart.
struct Cosines<F> {
    /// v·h, at least [`HALF_FLOOR`].
    view_half: F,
    /// ∇(v·h).
    view_gradient: Vec2Of<F>,
    /// n·ω.
    cosine: F,
    /// n·ω, at least [`COSINE_FLOOR`].
    floored: F,
    /// 1/(v·h).
    over_half: F,
    /// 4/(n·ω), of the one that has a lower bound.
    over_cosine: F,
}

impl<F: Real> Cosines<F> {
    #[inline(always)]
    fn new(view: Vec2Of<F>, at: &ChartPoint<F>) -> Self {
        let ChartPoint { x, q, quarter, up, .. } = *at;
        let view_half = (q * view[0]).mul_add(x[0], view[1] * up).max(q.lit(HALF_FLOOR));
        let view_gradient = view_half_gradient(view, x, q, quarter);
        let cosine = (view_half * up).times(2.0) - view[1];
        let floored = cosine.max(q.lit(COSINE_FLOOR));
        let inverse = (view_half * floored).inverse();
        let (over_half, over_cosine) = (inverse * floored, (inverse * view_half).times(4.0));
        Self { view_half, view_gradient, cosine, floored, over_half, over_cosine }
    }
}

/// The negative Hessian of the logarithm of the integrand, given λ and the two of [`pull_of_ndf`]:
/// of the light, its metric 4(∇(v·h)∇(v·h)ᵀ + (v·h)²·g) with the chart's g = q²I + (1 +
/// q²)/(4q²)·XXᵀ; and −∇² of ln(v·h), ln(n·ω).
#[inline(always)]
fn hessian<F: Real, const TAIL: Tail>(
    l: F,
    at: &ChartPoint<F>,
    cosines: &Cosines<F>,
    pulls: F,
    hollow: F,
) -> Symmetric<F> {
    let ChartPoint { x, radius2, q2, inverse_q, quarter, up, .. } = *at;
    let Cosines { view_half, view_gradient, cosine, floored, over_half, over_cosine } = *cosines;
    let four = l.times(4.0);
    let spread = four * view_half * view_half;
    let mut rounding = spread * (q2.plus(1.0)) * inverse_q * quarter;
    let isotropic = spread.mul_add(q2, pulls) + (view_half * up.relu() * over_cosine).plus(1.0);
    if TAIL == GGX {
        let most = isotropic.times(0.2) * radius2.max(l.lit(1e-6)).inverse();
        rounding = rounding - hollow.min(most);
    }
    // The curvature of n·ω is indefinite, by up to |g − x|²/4 of its factor; it is limited so that
    // a quarter of the isotropic part remains.
    let apart = [view_gradient[0] - x[0], view_gradient[1] - x[1]];
    let most = isotropic.times(3.0) * dot2(apart, apart).max(l.lit(1e-6)).inverse();
    let mixed = cosine.select_lt(floored, l.zero(), over_cosine).min(most);
    let radial = over_half.mul_add(over_half, four);
    Symmetric::new(isotropic, radial, view_gradient, rounding, x, mixed)
}

/// Places the rule for one light and one SG of the NDF.
#[inline(always)]
pub(super) fn place<F: Real, const TAIL: Tail>(
    view: Vec2Of<F>,
    ndf: &NdfTerms<F>,
    light: &LocalLight<F>,
) -> Placement<F> {
    let x = start::<F, TAIL>(view, ndf, light);
    // The logarithm of the integrand to second order there, without n·ω.
    let at = ChartPoint::new(x);
    let cosines = Cosines::new(view, &at);
    let Cosines { view_half, view_gradient, over_half, .. } = cosines;
    let (axis_half, axis_gradient) = at.axis_half(light.axis);
    let double = light.sharpness.times(2.0);
    let gradient =
        combine(double * view_half, axis_gradient, double.mul_add(axis_half, over_half), view_gradient);
    let (pulls, hollow) = pull_of_ndf::<F, TAIL>(ndf, at.radius2, at.up);
    let gradient = [(-pulls).mul_add(x[0], gradient[0]), (-pulls).mul_add(x[1], gradient[1])];
    let hessian = hessian::<F, TAIL>(light.sharpness, &at, &cosines, pulls, hollow);
    let zero = x[0].zero();
    let mut g = combine(at.up.times(2.0), view_gradient, -(view_half.times(2.0)), x);
    // At the pole of n·ω any direction is valid; the step keeps the sign of g, which it would
    // otherwise cancel.
    let apart = g[0].select_lt(zero, zero.lit(-1e-4), zero.lit(1e-4));
    g[0] += dot2(g, g).select_lt(zero.lit(1e-8), apart, zero);
    let inverse = hessian.inverse_determinant();
    let steepest = hessian.adjugate_times(g);
    let step = hessian.adjugate_times(gradient);
    let inverse_root = inverse * inverse.quick_rsqrt();
    // Scale s of n·ω per unit standard deviation: s² = gᵀH⁻¹g.
    let inverse_scale = (dot2(g, steepest) * inverse).max(zero.lit(1e-20)).quick_rsqrt();
    let t = (dot2(g, step).mul_add(inverse, cosines.cosine)) * inverse_scale;
    let clipped = Clipped::new(t);
    let unit = inverse * inverse_scale;
    let center = [inverse.mul_add(step[0], x[0]), inverse.mul_add(step[1], x[1])];
    let to_peak = unit * clipped.shift;
    let wide = unit * clipped.width;
    let turn = inverse_scale * inverse_root;
    Placement {
        peak: [to_peak.mul_add(steepest[0], center[0]), to_peak.mul_add(steepest[1], center[1])],
        along: [wide * steepest[0], wide * steepest[1]],
        across: [-(turn * g[1]), turn * g[0]],
        clipped,
        weight: (inverse_root * clipped.mass * clipped.width).times(2.0 * std::f64::consts::PI),
    }
}

/// Places the rules for two lights or two SGs together.
#[inline(always)]
pub(super) fn place_two<F: Real, const TAIL: Tail>(
    view: Vec2Of<F>,
    [n, m]: [&NdfTerms<F>; 2],
    [l, k]: [&LocalLight<F>; 2],
) -> [Placement<F>; 2] {
    let ndf = NdfTerms {
        sharpness: Two(n.sharpness, m.sharpness),
        start: Two(n.start, m.start),
        scale: Two(n.scale, m.scale),
    };
    let light = LocalLight::two(l, k);
    place::<_, TAIL>([Two(view[0], view[0]), Two(view[1], view[1])], &ndf, &light).split()
}
