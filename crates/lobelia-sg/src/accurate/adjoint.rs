//! One point × one lobe: the adjoint of its integrals, with the specular nodes and weights held
//! fixed. The integrand is that of PhySG supp. eqs. 1–7, or has GGX in place of eq. 4; F (eq. 6)
//! enters through `constant` and `slope`, the parts of degree 0 and 1 in the specular albedo.

use super::diffuse::cosine_integral;
use super::narrow::{MOST_SGS, is_narrow, parts};
use super::pair::{Pair, Placements, place_sgs};
use super::placement::{GGX, LocalLight, Placement, SG, Tail, place};
use super::point::{NdfTerms, PairAdjoint, PointSums, PointTerms};
use super::smooth::{Ring, pair_smoothness, pull_back_smooth};
use super::specular::{Node, PointTermsView, node};
use crate::real::{Real, Vec3Of, add, dot, scale};
use crate::sg::Dual;

/// Evaluates a pair again and propagates the adjoints of its `diffuse`, `constant` and `slope` back
/// to its inputs.
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
        pull_back_specular::<F, ALONG, ACROSS, NDF>(point, axis, sharpness, &diffuse, adjoint);
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

/// The specular part of [`pull_back_pair`], given the integral of the diffuse part:
/// `[constant, slope]` and the adjoints.
///
/// Nodes and weights are held fixed in world space (see the module's documentation), but for smooth
/// lobes.
#[inline(always)]
pub fn pull_back_specular<F: Real, const ALONG: usize, const ACROSS: usize, const NDF: usize>(
    point: &PointTerms<F, NDF>,
    axis: Vec3Of<F>,
    sharpness: F,
    diffuse: &Dual<F>,
    adjoint: [F; 2],
) -> ([F; 2], PairAdjoint<F, NDF>) {
    let light = LocalLight { axis: point.in_frame(axis), sharpness };
    let rest = || pull_back_around_peak::<F, ALONG, ACROSS, NDF>(point, axis, &light, adjoint);
    let margin = pair_smoothness(point, axis, sharpness);
    let zero = margin.zero();
    if !zero.any_lt(margin) {
        return rest();
    }
    let ring = Ring::new(&light, sharpness.quick_rsqrt());
    let ((value, back), (other, other_back)) =
        (pull_back_smooth(point, &light, &ring, diffuse, adjoint), rest());
    let chosen = |a: F, b: F| zero.select_lt(margin, a, b);
    ([chosen(value[0], other[0]), chosen(value[1], other[1])], back.zip(&other_back, chosen))
}

/// [`pull_back_specular`] by the rules with nodes around the peak.
#[inline(always)]
fn pull_back_around_peak<F: Real, const ALONG: usize, const ACROSS: usize, const NDF: usize>(
    point: &PointTerms<F, NDF>,
    axis: Vec3Of<F>,
    light: &LocalLight<F>,
    adjoint: [F; 2],
) -> ([F; 2], PairAdjoint<F, NDF>) {
    if is_narrow(point, axis, light.sharpness) {
        let placed = place::<F, GGX>(point.view, &point.ndf[NDF - 1], light);
        return pull_back_nodes::<F, ALONG, ACROSS, NDF, GGX>(point, light, &[placed; MOST_SGS], adjoint);
    }
    let placed = place_sgs(point, light, None);
    pull_back_nodes::<F, ALONG, ACROSS, NDF, SG>(point, light, &placed, adjoint)
}

/// [`pull_back_specular`], given the placements of the nodes.
#[inline(always)]
pub(super) fn pull_back_nodes<
    F: Real,
    const ALONG: usize,
    const ACROSS: usize,
    const NDF: usize,
    const TAIL: Tail,
>(
    point: &PointTerms<F, NDF>,
    light: &LocalLight<F>,
    placed: &Placements<F>,
    [constant_adjoint, slope_adjoint]: [F; 2],
) -> ([F; 2], PairAdjoint<F, NDF>) {
    let view = PointTermsView::new(point);
    let zero = light.sharpness.zero();
    let (mut constant, mut total) = (zero, zero);
    let mut sums = NodeSums::new(zero);
    let mut out = PointSums::zero(zero);
    for (m, placement) in parts::<NDF, TAIL>().zip(placed) {
        let ndf = &point.ndf[m];
        let weights = [(constant_adjoint - slope_adjoint) * ndf.scale, slope_adjoint * ndf.scale];
        let before = sums.value;
        let part = add_nodes::<F, ALONG, ACROSS, TAIL>(&mut sums, &view, ndf, light, placement, weights);
        let value = sums.value - before;
        out.ndf[m] = [value / ndf.sharpness - part.drop, value];
        constant = part.powered.mul_add(ndf.scale, constant);
        total = part.plain.mul_add(ndf.scale, total);
    }
    out.normal = sums.normal;
    out.shadowing = -sums.shadowing;
    let axis = point.in_world(scale(sums.offset, light.sharpness));
    ([constant, total - constant], PairAdjoint { axis, sharpness: -sums.half_square, point: out })
}

/// Sums over the nodes of one SG of the distribution of normals, or of GGX.
struct PartSums<F> {
    /// The specular light with and without the Fresnel power, without the factors of the point.
    powered: F,
    plain: F,
    /// Of `half_drop`, each node weighted by its share of the objective.
    drop: F,
}

/// Adds the nodes of one placement to the sums over all of them; each is `weights` times with the
/// Fresnel power and without it.
#[inline(always)]
fn add_nodes<F: Real, const ALONG: usize, const ACROSS: usize, const TAIL: Tail>(
    sums: &mut NodeSums<F>,
    view: &PointTermsView<F>,
    ndf: &NdfTerms<F>,
    light: &LocalLight<F>,
    placement: &Placement<F>,
    weights: [F; 2],
) -> PartSums<F> {
    let zero = light.sharpness.zero();
    let mut part = PartSums { powered: zero, plain: zero, drop: zero };
    let nodes = placement.nodes::<ALONG, ACROSS>();
    for row in &nodes.rows {
        for column in &nodes.columns {
            let node = node::<F, TAIL>(view, ndf, light, placement, row, *column);
            let value = node.over_cosine * node.cosine;
            part.plain += value;
            part.powered = value.mul_add(node.fresnel, part.powered);
            sums.add(&node, weights, view.k, &mut part.drop);
        }
    }
    part
}

/// Sums over nodes for the adjoint; each node is weighted by its share of the objective.
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
    fn add(&mut self, node: &Node<F>, [powered, plain]: [F; 2], k: F, drop: &mut F) {
        let over_cosine = node.over_cosine * powered.mul_add(node.fresnel, plain);
        let value = over_cosine * node.cosine;
        self.value += value;
        for c in 0..3 {
            self.offset[c] = value.mul_add(node.offset[c], self.offset[c]);
        }
        self.half_square = value.mul_add(node.half_square, self.half_square);
        // Below the horizon the derivatives are 0; `value` is 0 there because of its cosine.
        let zero = k.zero();
        let turn = zero.select_lt(node.cosine, over_cosine * node.shadowing * k, zero);
        let tilt = value * node.toward;
        for c in 0..2 {
            let through_half = tilt.mul_add(node.half[c], self.normal[c]);
            self.normal[c] = turn.mul_add(node.direction[c], through_half);
        }
        self.shadowing = (value * node.shadowing).mul_add(k.one() - node.cosine, self.shadowing);
        *drop = value.mul_add(node.half_drop, *drop);
    }
}
