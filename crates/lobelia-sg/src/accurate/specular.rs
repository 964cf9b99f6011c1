//! The specular integral of one light SG over an SG of half vectors: a small quadrature placed
//! around the product's peak (`accurate/placement.rs`).
//!
//! In half-vector space the integral is ∫ F·G₁(n·ω)·G₁(n·v)·(n·ω)·(v·h) · (L/2π)e^{L(h·n − 1)} ·
//! e^{λ(ω·ξ − 1)} dh with ω = 2(v·h)h − v (dω = 4(v·h)dh cancels the BRDF's 4(n·ω)(n·v), and G₁(c) =
//! 1/(c(1 − k) + k)). The half vector is given in Lambert's equal-area chart around the normal,
//! |X|² = 2(1 − h·n): there dh = dX and the NDF is exactly e^(−L|X|²/2), however broad, and the
//! singularities of ω-space at the horizon do not occur.
//!
//! At every node the integrand itself is evaluated (one exp) and divided by the weight that the
//! rule assumes.

use super::placement::{LocalLight, Placement, SG, Tail, Vec2Of, dot2, spread};
use super::point::{NdfTerms, PointTerms};
use super::{diffuse::fading_exp, rule::across};
use crate::real::{Real, Vec3Of, sub};

/// A row of nodes: those at the same position along the clipped direction.
#[derive(Clone, Copy)]
pub(super) struct Row<F> {
    base: Vec2Of<F>,
    exponent: F,
    weight: F,
}

/// Nodes in rows and columns: a loop over them is compiled once, and its constants lie ready.
pub(super) struct Nodes<F, const ALONG: usize, const ACROSS: usize> {
    pub(super) rows: [Row<F>; ALONG],
    /// Position in standard deviations across the clipped direction, and weight in the row.
    pub(super) columns: [[F; 2]; ACROSS],
}

impl<F: Real> Placement<F> {
    #[inline(always)]
    pub(super) fn nodes<const ALONG: usize, const ACROSS: usize>(&self) -> Nodes<F, ALONG, ACROSS> {
        let mut nodes = Nodes { rows: [self.row(ALONG, 0); ALONG], columns: [[self.weight; 2]; ACROSS] };
        for i in 1..ALONG {
            nodes.rows[i] = self.row(ALONG, i);
        }
        for j in 0..ACROSS {
            let (w, weight) = across(ACROSS, j);
            nodes.columns[j] = [self.weight.lit(w), self.weight.lit(weight)];
        }
        nodes
    }

    #[inline(always)]
    fn row(&self, count: usize, index: usize) -> Row<F> {
        let clipped = &self.clipped;
        let node = clipped.along(count, index);
        let along = clipped.width * node.offset;
        // The weight that the rule assumes is divided out: v and e^(−u²/2), both relative to the
        // peak.
        let relative = clipped.share.mul_add(node.offset, node.offset.one());
        Row {
            base: [
                node.offset.mul_add(self.along[0], self.peak[0]),
                node.offset.mul_add(self.along[1], self.peak[1]),
            ],
            exponent: along * along.mul_add(along.lit(0.5), clipped.shift),
            weight: self.weight * node.weight * relative.inverse(),
        }
    }
}

/// The integrand at one node, times the node's weight.
#[derive(Clone, Copy)]
pub(super) struct Node<F> {
    /// ω − ξ.
    pub offset: Vec3Of<F>,
    /// ω along tangent and bitangent.
    pub direction: Vec2Of<F>,
    /// h along tangent and bitangent.
    pub half: Vec2Of<F>,
    /// −d(ln D)/dL: 1 − h·n for an SG.
    pub half_drop: F,
    /// d(ln D)/d(h·n): L for an SG.
    pub toward: F,
    /// |ω − ξ|²/2.
    pub half_square: F,
    /// n·ω, 0 below the horizon.
    pub cosine: F,
    /// 1/(n·ω(1 − k) + k).
    pub shadowing: F,
    /// The integrand divided by n·ω, without the factors of the point and without F; not meaningful
    /// below the horizon.
    pub over_cosine: F,
    /// 2^(−(5.55473 v·h + 6.8316) v·h).
    pub fresnel: F,
}

/// The half vector at a point of the chart, and the direction that it mirrors the view to.
struct Mirrored<F> {
    /// 1 − h·n.
    drop: F,
    /// h·n.
    up: F,
    /// h along tangent and bitangent.
    half: Vec2Of<F>,
    /// v·h, at least 0.
    view_half: F,
    /// ω.
    direction: Vec3Of<F>,
}

impl<F: Real> Mirrored<F> {
    #[inline(always)]
    fn new(view: Vec2Of<F>, x: Vec2Of<F>) -> Self {
        let drop = dot2(x, x).times(0.5);
        let q = root_of_half_drop(drop.min(drop.one()));
        let half = [q * x[0], q * x[1]];
        let up = drop.one() - drop;
        let view_half = view[0].mul_add(half[0], view[1] * up).relu();
        let double = view_half.times(2.0);
        let direction = [double.mul_add(half[0], -view[0]), double * half[1], double.mul_add(up, -view[1])];
        Self { drop, up, half, view_half, direction }
    }
}

/// The node in this row and column of [`Nodes`].
#[inline(always)]
pub(super) fn node<F: Real, const TAIL: Tail>(
    point: &PointTermsView<F>,
    ndf: &NdfTerms<F>,
    light: &LocalLight<F>,
    placement: &Placement<F>,
    row: &Row<F>,
    [w, weight]: [F; 2],
) -> Node<F> {
    let x = [placement.across[0].mul_add(w, row.base[0]), placement.across[1].mul_add(w, row.base[1])];
    let Mirrored { drop, up, half, view_half, direction } = Mirrored::new(point.view, x);
    let offset = sub(direction, light.axis);
    let half_square =
        (dot2([offset[0], offset[1]], [offset[0], offset[1]]) + offset[2] * offset[2]).times(0.5);
    let mut exponent = row.exponent - light.sharpness * half_square;
    if TAIL == SG {
        exponent = (-ndf.sharpness).mul_add(drop, exponent);
    }
    let [along, aside, cosine] = direction;
    let (direction, cosine) = ([along, aside], cosine.relu());
    let Factors { distribution, shadowing, half_drop, toward } = factors::<F, TAIL>(
        ndf,
        [drop * (-drop).plus(2.0), drop, up],
        cosine.mul_add(point.one_minus_k, point.k),
    );
    let over_cosine = fading_exp(exponent) * view_half * distribution * (row.weight * weight);
    let fresnel = fresnel(view_half);
    Node { offset, direction, half, half_drop, toward, half_square, cosine, shadowing, over_cosine, fresnel }
}

/// Factors of the integrand at a node.
pub(super) struct Factors<F> {
    /// `shadowing`, times D/D(n) of GGX; that of an SG is in the exponent.
    pub distribution: F,
    pub shadowing: F,
    pub half_drop: F,
    pub toward: F,
}

/// The factors at 1 − (h·n)², d = 1 − h·n and `up` = h·n, given n·ω(1 − k) + k.
#[inline(always)]
pub(super) fn factors<F: Real, const TAIL: Tail>(
    ndf: &NdfTerms<F>,
    [sine2, drop, up]: [F; 3],
    blocked: F,
) -> Factors<F> {
    if TAIL == SG {
        let shadowing = blocked.inverse();
        return Factors { distribution: shadowing, shadowing, half_drop: drop, toward: ndf.sharpness };
    }
    let spread = spread(ndf, sine2);
    let fading = blocked * spread;
    let distribution = (fading * spread).inverse();
    let inverse = distribution * fading;
    Factors {
        distribution,
        shadowing: distribution * spread * spread,
        half_drop: sine2.times(0.5) * inverse,
        toward: ndf.sharpness * up * inverse,
    }
}

/// √(1 − d/2) for d in [0, 1]; relative error 1.3e-6, less near 0 (beyond 1 a half vector is below
/// the horizon).
#[inline(always)]
fn root_of_half_drop<F: Real>(drop: F) -> F {
    let mut p = drop.lit(-0.003_517_036_7);
    for c in [0.001_450_428_2, -0.010_088_099, -0.030_694_04, -0.250_043_54, 1.0] {
        p = p.mul_add(drop, drop.lit(c));
    }
    p
}

/// The part of a point that nodes read.
pub(super) struct PointTermsView<F> {
    pub(super) view: Vec2Of<F>,
    /// k of the shadowing term.
    pub(super) k: F,
    pub(super) one_minus_k: F,
}

impl<F: Real> PointTermsView<F> {
    #[inline(always)]
    pub(super) fn new<const NDF: usize>(point: &PointTerms<F, NDF>) -> Self {
        Self { view: point.view, k: point.shadowing, one_minus_k: point.shadowing.one() - point.shadowing }
    }
}

/// The eighth root of the Fresnel power on [0, 1]; relative error 3e-7 (2e-6 of the power).
const FRESNEL_ROOT: [f64; 7] = [
    1.000_000_247_592_828_5,
    -0.591_937_313_147_202_8,
    -0.305_694_491_472_843_44,
    0.247_657_207_196_190_67,
    0.045_321_249_978_281_9,
    -0.068_163_095_712_073_99,
    0.014_730_967_252_205_766,
];

/// 2^(−(5.55473 x + 6.8316) x) for x in [0, 1] (PhySG supp. eq. 6), without an exp.
#[inline(always)]
pub(super) fn fresnel<F: Real>(x: F) -> F {
    let mut p = x.lit(FRESNEL_ROOT[6]);
    let mut i = 6;
    while i > 0 {
        i -= 1;
        p = p.mul_add(x, x.lit(FRESNEL_ROOT[i]));
    }
    let square = p * p;
    let fourth = square * square;
    fourth * fourth
}
