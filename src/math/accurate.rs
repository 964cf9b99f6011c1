//! Accurate SG shading: the integrals of light SG × BRDF × cosine themselves, not an approximation of the BRDF.
//!
//! Diffuse: a closed form good to about 0.1 % ([`diffuse::cosine_integral`]). Specular: a quadrature of 4, 6 or 12 nodes around
//! the product's peak in half-vector space (`accurate/specular.rs`), with M, D and the cosine of the PhySG supplement evaluated at
//! every node. Both take one point × one lobe at a time, like [`super::published`], and sum over lobes linearly.
//!
//! Accuracy against an adaptive cubature, and cost of diffuse + specular with 16 lanes of `f32` on one core (a run of the
//! published formulas beside it: 9.2 ns forward, 16.8 ns forward and adjoint). Errors of the specular light in %: energy-weighted,
//! median and 90th percentile over 195 lit cases with R in 0.1–0.9, λ in 1–800 (A); median, 90th percentile and mean over 1489 lit
//! cases with R in 0.03–1, λ in 1e-3–1e6, lights of equal flux and any n·v above 0.001 (B). Published on A: 8.1, 8.5, 50.
//!
//! | nodes | A energy | A median | A 90th | B median | B 90th | B mean | forward | with adjoint |
//! | --- | --- | --- | --- | --- | --- | --- | --- | --- |
//! | 2 × 2 | 0.60 | 0.20 | 2.7 | 0.009 | 7.9 | 2.0 | 15.2 ns | 18.4 ns |
//! | 3 × 2 (`Default`) | 0.36 | 0.11 | 1.6 | 0.007 | 2.7 | 0.75 | 18.6 ns | 22.2 ns |
//! | 3 × 3 | 0.30 | 0.05 | 1.6 | 0.002 | 2.2 | 0.60 | 21.7 ns | – |
//! | 4 × 3 (`High`) | 0.16 | 0.05 | 0.8 | 0.002 | 1.0 | 0.35 | 25.5 ns | 32.4 ns |
//!
//! Diffuse on A: 0.08, 0.02, 0.64 (published 0.78, 0.77, 5.0). A second Gauss–Newton step changes little (3 × 3 on A: energy
//! 0.30 to 0.31), so there is one. The largest errors, tens of percent, are lights far below the horizon on rough surfaces and n·v < 0.01.
//! `f32` agrees with `f64` to 1e-4 except for n·v < 0.005 with λ > 1e4 (1.6e-3).
//!
//! What the adjoint holds fixed: the specular nodes' world-space directions ω and their weights. Its result is exactly
//! the derivative of that frozen sum, and the derivative of the integral to the rule's own accuracy; how nodes would move
//! with the inputs is left out, because an exact rule would not notice. The diffuse adjoint is exact.

pub mod diffuse;
pub mod ggx;
mod model;
mod rule;
mod specular;

#[cfg(test)]
mod cubature;
#[cfg(test)]
mod tests;

pub use model::{ACCURATE_DEFAULT, ACCURATE_HIGH, Accurate, GGX_DEFAULT, GGX_HIGH};

use super::brdf::{Facets, Ndf, ndf_sharpness, shadowing_k};
use super::published::{Dual, Lobe};
use super::real::{Real, Vec3Of, add, dot, scale, sub};
use diffuse::cosine_integral;
use ggx::prepare_ggx_point;
use rule::across;
use serde::{Deserialize, Serialize};
use specular::{LocalLight, Node, PointTermsView, node, place};
use std::f64::consts::PI;

/// `for index in 0..count` for counts up to 4, written out so that every node's constants are constants.
macro_rules! unroll {
    ($index:ident < $count:expr, $body:block) => {
        unroll!(@ $index, $count, $body, 0 1 2 3)
    };
    (@ $index:ident, $count:expr, $body:block, $($i:literal)*) => {
        $(if $i < $count {
            let $index: usize = $i;
            $body
        })*
    };
}

/// How many nodes the specular quadrature has; the module's documentation tabulates accuracy and cost.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Quality {
    /// 3 × 2 nodes.
    #[default]
    Default,
    /// 4 × 3 nodes.
    High,
}

/// One SG of the distribution of normals, as a point's pairs read it.
#[derive(Clone, Copy)]
pub struct NdfTerms<F> {
    /// Sharpness L of the SG in h.
    pub sharpness: F,
    /// Where the NDF's own product with (n·ω)(v·h) peaks in the chart, along the tangent.
    start: F,
    /// Everything of the integrand that does not depend on ω; 0 for a viewer below the horizon.
    scale: F,
}

/// What a surface point and a specular lobe contribute to every lobe's integral.
#[derive(Clone, Copy)]
pub struct PointTerms<F, const NDF: usize = 1> {
    /// Tangent (in the plane of normal and view), bitangent and normal; unit vectors.
    frame: [Vec3Of<F>; 3],
    /// View direction along tangent and normal, the latter at least 0.
    view: [F; 2],
    /// k of the shadowing term.
    shadowing: F,
    ndf: [NdfTerms<F>; NDF],
}

/// The light-independent derivatives that [`pull_back_point`] needs.
#[derive(Clone, Copy)]
pub struct PointSlopes<F, const NDF: usize = 1> {
    /// d(sharpness)/dR and d(ln weight)/dR of each SG of the NDF.
    ndf: [[F; 2]; NDF],
    /// dk/dR.
    shadowing: F,
}

impl<F: Real, const NDF: usize> PointTerms<F, NDF> {
    /// The same terms in another number type, such as one value in every lane.
    #[inline(always)]
    pub fn map<G: Real>(&self, wide: impl Fn(F) -> G) -> PointTerms<G, NDF> {
        let three = |v: Vec3Of<F>| [wide(v[0]), wide(v[1]), wide(v[2])];
        PointTerms {
            frame: [three(self.frame[0]), three(self.frame[1]), three(self.frame[2])],
            view: [wide(self.view[0]), wide(self.view[1])],
            shadowing: wide(self.shadowing),
            ndf: self.ndf.map(|n| NdfTerms {
                sharpness: wide(n.sharpness),
                start: wide(n.start),
                scale: wide(n.scale),
            }),
        }
    }

    /// A world-space vector along tangent, bitangent and normal.
    #[inline(always)]
    fn in_frame(&self, v: Vec3Of<F>) -> Vec3Of<F> {
        [dot(self.frame[0], v), dot(self.frame[1], v), dot(self.frame[2], v)]
    }

    #[inline(always)]
    fn in_world(&self, v: Vec3Of<F>) -> Vec3Of<F> {
        let plane = add(scale(self.frame[0], v[0]), scale(self.frame[1], v[1]));
        add(plane, scale(self.frame[2], v[2]))
    }
}

/// The part of `v` across the normal.
#[inline(always)]
fn reject<F: Real>(normal: Vec3Of<F>, v: Vec3Of<F>) -> Vec3Of<F> {
    sub(v, scale(normal, dot(normal, v)))
}

/// Tangent, bitangent and normal with the view direction in the plane of the first and last.
#[inline(always)]
fn frame_towards<F: Real>(normal: Vec3Of<F>, to_viewer: Vec3Of<F>) -> [Vec3Of<F>; 3] {
    let one = normal[0].one();
    let zero = one.zero();
    let steep = (normal[0] * normal[0]).select_lt(one.times(0.5), one, zero);
    let other = reject(normal, [steep, one - steep, zero]);
    let along = reject(normal, to_viewer);
    let square = dot(along, along);
    // Seen from straight above any tangent will do; rejected twice, since a short rejection is not quite perpendicular.
    let bound = one.times(1e-8);
    let tangent = [
        square.select_lt(bound, other[0], along[0]),
        square.select_lt(bound, other[1], along[1]),
        square.select_lt(bound, other[2], along[2]),
    ];
    let tangent = reject(normal, scale(tangent, dot(tangent, tangent).sqrt().recip()));
    let tangent = scale(tangent, dot(tangent, tangent).sqrt().recip());
    let bitangent = [
        normal[1] * tangent[2] - normal[2] * tangent[1],
        normal[2] * tangent[0] - normal[0] * tangent[2],
        normal[0] * tangent[1] - normal[1] * tangent[0],
    ];
    [tangent, bitangent, normal]
}

/// Everything that depends on the point and the specular material but not on the light, for the supplement's NDF (one SG).
///
/// `roughness` is the paper's R in [0.03, 1]; for n·v ≤ 0 the specular light is 0.
#[inline(always)]
pub fn prepare_point<F: Real>(
    normal: Vec3Of<F>,
    to_viewer: Vec3Of<F>,
    roughness: F,
) -> (PointTerms<F>, PointSlopes<F>) {
    let (ndf, slopes) = one_sg(roughness);
    prepare_with_ndf(normal, to_viewer, roughness, ndf, slopes)
}

/// The supplement's NDF as [L, w], and its slopes: what [`prepare_with_ndf`] takes.
#[inline(always)]
fn one_sg<F: Real>(roughness: F) -> ([[F; 2]; 1], [[F; 2]; 1]) {
    let sharpness = ndf_sharpness(roughness);
    let slope = -(sharpness / roughness).times(4.0);
    let zero = roughness.zero();
    ([[sharpness, zero.one()]], [[slope, zero]])
}

/// As [`prepare_point`] for an NDF Σ w·(L/2π)·e^{L(h·n − 1)}: `ndf` holds the pairs [L, w], `slopes` [dL/dR, d(ln w)/dR].
#[inline(always)]
pub fn prepare_with_ndf<F: Real, const NDF: usize>(
    normal: Vec3Of<F>,
    to_viewer: Vec3Of<F>,
    roughness: F,
    ndf: [[F; 2]; NDF],
    slopes: [[F; 2]; NDF],
) -> (PointTerms<F, NDF>, PointSlopes<F, NDF>) {
    let frame = frame_towards(normal, to_viewer);
    let up = dot(normal, to_viewer);
    let view = [dot(frame[0], to_viewer).relu(), up.relu()];
    let k = shadowing_k(roughness);
    let zero = up.zero();
    let masked = zero.select_lt(up, (view[1] * (k.one() - k) + k).recip(), zero).times(0.5 / PI);
    let nothing = NdfTerms { sharpness: zero, start: zero, scale: zero };
    let mut terms = [nothing; NDF];
    for (terms, [sharpness, weight]) in terms.iter_mut().zip(ndf) {
        // The maximum of 2 ln(v·h) − L|X|²/2 along the tangent, to first order in X.
        let steep = sharpness * view[1];
        let root = (steep * steep + (sharpness * view[0] * view[0]).times(8.0)).sqrt();
        // A viewer straight below leaves neither; any small number will do.
        let start = (view[0].times(4.0) / (steep + root).max(k.lit(1e-6))).min(k.one());
        *terms = NdfTerms { sharpness, start, scale: masked * sharpness * weight };
    }
    let slope = roughness.plus(1.0).times(0.25);
    (PointTerms { frame, view, shadowing: k, ndf: terms }, PointSlopes { ndf: slopes, shadowing: slope })
}

/// One lobe's integrals at a point, for unit amplitude.
#[derive(Clone, Copy)]
pub struct Pair<F> {
    /// ∫ G·max(n·ω, 0): times albedo/π the diffuse light.
    pub diffuse: Dual<F>,
    /// Specular light for specular albedo s: `constant + slope·s`.
    pub constant: F,
    /// Factor of the specular albedo.
    pub slope: F,
}

/// Evaluates one point × lobe with `ALONG` × `ACROSS` nodes (2 to 4 along the clipped direction, 1 to 3 across).
#[inline(always)]
pub fn evaluate_pair<F: Real, const ALONG: usize, const ACROSS: usize, const NDF: usize>(
    point: &PointTerms<F, NDF>,
    axis: Vec3Of<F>,
    sharpness: F,
) -> Pair<F> {
    let diffuse = cosine_integral(sharpness, dot(point.frame[2], axis));
    let [constant, slope] = evaluate_specular::<F, ALONG, ACROSS, NDF>(point, axis, sharpness);
    Pair { diffuse, constant, slope }
}

/// The specular part of a pair: `[constant, slope]` of [`Pair`].
#[inline(always)]
pub fn evaluate_specular<F: Real, const ALONG: usize, const ACROSS: usize, const NDF: usize>(
    point: &PointTerms<F, NDF>,
    axis: Vec3Of<F>,
    sharpness: F,
) -> [F; 2] {
    let light = LocalLight { axis: point.in_frame(axis), sharpness };
    let view = PointTermsView::new(point);
    let (mut constant, mut total) = (sharpness.zero(), sharpness.zero());
    for ndf in &point.ndf {
        let placement = place(point.view, ndf, &light);
        let (mut powered, mut plain) = (sharpness.zero(), sharpness.zero());
        unroll!(i < ALONG, {
            let row = placement.row(ALONG, i);
            unroll!(j < ACROSS, {
                let node = node(&view, ndf, &light, &placement, &row, across(ACROSS, j));
                let value = node.over_cosine * node.cosine;
                plain += value;
                powered = value.mul_add(node.fresnel, powered);
            });
        });
        constant = powered.mul_add(ndf.scale, constant);
        total = plain.mul_add(ndf.scale, total);
    }
    [constant, total - constant]
}

/// Adjoints of one pair; everything but the axis may be summed over lobes in the point's own frame.
#[derive(Clone, Copy)]
pub struct PairAdjoint<F, const NDF: usize = 1> {
    /// With respect to the lobe's axis (world space).
    pub axis: Vec3Of<F>,
    /// With respect to the lobe's sharpness.
    pub sharpness: F,
    /// With respect to the point.
    pub point: PointSums<F, NDF>,
}

/// Adjoints of a point's terms, to be summed over lobes and handed to [`pull_back_point`].
#[derive(Clone, Copy)]
pub struct PointSums<F, const NDF: usize = 1> {
    /// With respect to the normal, along tangent and bitangent, at fixed n·v.
    pub normal: [F; 2],
    /// With respect to k of the shadowing term, through n·ω alone.
    pub shadowing: F,
    /// With respect to the sharpness and the logarithm of the weight of each SG of the NDF.
    pub ndf: [[F; 2]; NDF],
}

impl<F: Real, const NDF: usize> PointSums<F, NDF> {
    /// All zero, in the lanes of `like`.
    #[inline(always)]
    pub fn zero(like: F) -> Self {
        let zero = like.zero();
        Self { normal: [zero; 2], shadowing: zero, ndf: [[zero; 2]; NDF] }
    }

    /// Adds another lobe's.
    #[inline(always)]
    pub fn add(&mut self, other: &Self) {
        self.normal[0] += other.normal[0];
        self.normal[1] += other.normal[1];
        self.shadowing += other.shadowing;
        for m in 0..NDF {
            self.ndf[m][0] += other.ndf[m][0];
            self.ndf[m][1] += other.ndf[m][1];
        }
    }

    /// The same sums in another number type, such as a sum over lanes.
    #[inline(always)]
    pub fn map<G: Real>(&self, narrow: impl Fn(F) -> G) -> PointSums<G, NDF> {
        PointSums {
            normal: [narrow(self.normal[0]), narrow(self.normal[1])],
            shadowing: narrow(self.shadowing),
            ndf: self.ndf.map(|n| [narrow(n[0]), narrow(n[1])]),
        }
    }
}

/// Evaluates a pair again and carries the adjoints of its `diffuse`, `constant` and `slope` back to its inputs.
#[inline(always)]
pub fn pull_back_pair<F: Real, const ALONG: usize, const ACROSS: usize, const NDF: usize>(
    point: &PointTerms<F, NDF>,
    axis: Vec3Of<F>,
    sharpness: F,
    [diffuse_adjoint, constant_adjoint, slope_adjoint]: [F; 3],
) -> (Pair<F>, PairAdjoint<F, NDF>) {
    let diffuse = cosine_integral(sharpness, dot(point.frame[2], axis));
    let under = pull_back_diffuse(point, axis, &diffuse, diffuse_adjoint);
    let adjoint = [constant_adjoint, slope_adjoint];
    let ([constant, slope], mut back) =
        pull_back_specular::<F, ALONG, ACROSS, NDF>(point, axis, sharpness, adjoint);
    back.axis = add(back.axis, under.axis);
    back.sharpness += under.sharpness;
    back.point.add(&under.point);
    (Pair { diffuse, constant, slope }, back)
}

/// The diffuse part of [`pull_back_pair`], given the integral.
#[inline(always)]
pub fn pull_back_diffuse<F: Real, const NDF: usize>(
    point: &PointTerms<F, NDF>,
    axis: Vec3Of<F>,
    diffuse: &Dual<F>,
    adjoint: F,
) -> PairAdjoint<F, NDF> {
    let tilt = adjoint * diffuse.by_cosine;
    let mut sums = PointSums::zero(adjoint);
    sums.normal = [tilt * dot(point.frame[0], axis), tilt * dot(point.frame[1], axis)];
    PairAdjoint { axis: scale(point.frame[2], tilt), sharpness: adjoint * diffuse.by_sharpness, point: sums }
}

/// The specular part of [`pull_back_pair`]: `[constant, slope]` and the adjoints.
///
/// Nodes and weights are held fixed in world space (see the module's documentation).
#[inline(always)]
pub fn pull_back_specular<F: Real, const ALONG: usize, const ACROSS: usize, const NDF: usize>(
    point: &PointTerms<F, NDF>,
    axis: Vec3Of<F>,
    sharpness: F,
    [constant_adjoint, slope_adjoint]: [F; 2],
) -> ([F; 2], PairAdjoint<F, NDF>) {
    let light = LocalLight { axis: point.in_frame(axis), sharpness };
    let view = PointTermsView::new(point);
    let zero = sharpness.zero();
    let (mut constant, mut total) = (zero, zero);
    let mut sums = NodeSums::new(zero);
    let mut out = PointSums::zero(zero);
    for (m, ndf) in point.ndf.iter().enumerate() {
        let placement = place(point.view, ndf, &light);
        let (mut powered, mut plain) = (zero, zero);
        let weights = [(constant_adjoint - slope_adjoint) * ndf.scale, slope_adjoint * ndf.scale];
        let before = sums.value;
        let mut drop = zero;
        unroll!(i < ALONG, {
            let row = placement.row(ALONG, i);
            unroll!(j < ACROSS, {
                let node = node(&view, ndf, &light, &placement, &row, across(ACROSS, j));
                let value = node.over_cosine * node.cosine;
                plain += value;
                powered = value.mul_add(node.fresnel, powered);
                sums.add(&node, weights, ndf.sharpness, point.shadowing, &mut drop);
            });
        });
        let value = sums.value - before;
        out.ndf[m] = [value / ndf.sharpness - drop, value];
        constant = powered.mul_add(ndf.scale, constant);
        total = plain.mul_add(ndf.scale, total);
    }
    out.normal = sums.normal;
    out.shadowing = -sums.shadowing;
    let axis = point.in_world(scale(sums.offset, sharpness));
    ([constant, total - constant], PairAdjoint { axis, sharpness: -sums.half_square, point: out })
}

/// Sums over nodes that the adjoint needs, each node weighted by its share of the objective.
struct NodeSums<F> {
    value: F,
    offset: Vec3Of<F>,
    half_square: F,
    normal: [F; 2],
    shadowing: F,
}

impl<F: Real> NodeSums<F> {
    #[inline(always)]
    fn new(zero: F) -> Self {
        Self { value: zero, offset: [zero; 3], half_square: zero, normal: [zero; 2], shadowing: zero }
    }

    #[inline(always)]
    fn add(&mut self, node: &Node<F>, [powered, plain]: [F; 2], ndf_sharpness: F, k: F, drop: &mut F) {
        let over_cosine = node.over_cosine * powered.mul_add(node.fresnel, plain);
        let value = over_cosine * node.cosine;
        self.value += value;
        for c in 0..3 {
            self.offset[c] = value.mul_add(node.offset[c], self.offset[c]);
        }
        self.half_square = value.mul_add(node.half_square, self.half_square);
        // Below the horizon nothing moves; `value` is 0 there by its cosine.
        let zero = k.zero();
        let turn = zero.select_lt(node.cosine, over_cosine * node.shadowing * k, zero);
        let tilt = value * ndf_sharpness;
        for c in 0..2 {
            let through_half = tilt.mul_add(node.half[c], self.normal[c]);
            self.normal[c] = turn.mul_add(node.direction[c], through_half);
        }
        self.shadowing = (value * node.shadowing).mul_add(k.one() - node.cosine, self.shadowing);
        *drop = value.mul_add(node.half_drop, *drop);
    }
}

/// Adjoints of a point's normal (along its tangent plane) and roughness, given the sums over lobes.
#[inline(always)]
pub fn pull_back_point<F: Real, const NDF: usize>(
    point: &PointTerms<F, NDF>,
    slopes: &PointSlopes<F, NDF>,
    sums: &PointSums<F, NDF>,
) -> (Vec3Of<F>, F) {
    let k = point.shadowing;
    let mut value = k.zero();
    let mut roughness = k.zero();
    for m in 0..NDF {
        value += sums.ndf[m][1];
        roughness += sums.ndf[m][0] * slopes.ndf[m][0] + sums.ndf[m][1] * slopes.ndf[m][1];
    }
    // The viewer's own factor 1/(n·v(1 − k) + k).
    let view = point.view[1];
    let inverse = value / (view * (k.one() - k) + k);
    roughness += (sums.shadowing - inverse * (k.one() - view)) * slopes.shadowing;
    let along = sums.normal[0] - inverse * (k.one() - k) * point.view[0];
    (add(scale(point.frame[0], along), scale(point.frame[1], sums.normal[1])), roughness)
}

fn pair_of_quality<F: Real, const NDF: usize>(
    quality: Quality,
    point: &PointTerms<F, NDF>,
    lobe: &Lobe<F>,
) -> Pair<F> {
    match quality {
        Quality::Default => evaluate_pair::<F, 3, 2, NDF>(point, lobe.axis, lobe.sharpness),
        Quality::High => evaluate_pair::<F, 4, 3, NDF>(point, lobe.axis, lobe.sharpness),
    }
}

/// Diffuse and specular radiance of one point under one lobe (for tables and tests).
pub fn shade_pair<F: Real>(
    quality: Quality,
    normal: Vec3Of<F>,
    to_viewer: Vec3Of<F>,
    lobe: &Lobe<F>,
    albedo: Vec3Of<F>,
    specular_albedo: Vec3Of<F>,
    facets: Facets<F>,
) -> (Vec3Of<F>, Vec3Of<F>) {
    let pair = match facets.ndf {
        Ndf::Sg => pair_of_quality(quality, &prepare_point(normal, to_viewer, facets.roughness).0, lobe),
        Ndf::Ggx => pair_of_quality(quality, &prepare_ggx_point(normal, to_viewer, facets.roughness).0, lobe),
    };
    let channel = |c: usize| {
        let diffuse = lobe.amplitude[c] * albedo[c].times(1.0 / PI) * pair.diffuse.value;
        let specular = lobe.amplitude[c] * (pair.constant + pair.slope * specular_albedo[c]);
        (diffuse, specular)
    };
    let (r, g, b) = (channel(0), channel(1), channel(2));
    ([r.0, g.0, b.0], [r.1, g.1, b.1])
}
