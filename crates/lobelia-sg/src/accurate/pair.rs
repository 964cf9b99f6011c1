//! One point × one lobe: the integrals.

use super::narrow::{MOST_SGS, is_narrow, parts};
use super::placement::{GGX, LocalLight, Placement, SG, Tail, place, place_two};
use super::point::{PointTerms, prepare_point};
use super::smooth::{Ring, pair_smoothness, smooth_light};
use super::specular::{PointTermsView, node};
use super::{Quality, diffuse::cosine_integral, ggx::prepare_ggx_point};
use crate::brdf::{Facets, Ndf};
use crate::real::{Real, Vec3Of, dot};
use crate::sg::{Dual, Lobe};
use std::f64::consts::PI;

/// One lobe's integrals at a point, for unit amplitude.
#[derive(Clone, Copy)]
pub struct Pair<F> {
    /// ∫ G·max(n·ω, 0): times albedo/π the diffuse light.
    pub diffuse: Dual<F>,
    /// Specular light for specular albedo s: `constant + slope·s`.
    pub constant: F,
    /// Coefficient of the specular albedo.
    pub slope: F,
}

/// Evaluates one point × lobe with `ALONG` × `ACROSS` nodes (2 to 4 along the clipped direction, 1
/// to 3 across).
#[inline(always)]
pub fn evaluate_pair<F: Real, const ALONG: usize, const ACROSS: usize, const NDF: usize>(
    point: &PointTerms<F, NDF>,
    axis: Vec3Of<F>,
    sharpness: F,
) -> Pair<F> {
    let diffuse = cosine_integral(sharpness, dot(point.frame[2], axis));
    let [constant, slope] = evaluate_specular::<F, ALONG, ACROSS, NDF>(point, axis, sharpness, &diffuse);
    Pair { diffuse, constant, slope }
}

/// The specular part of a pair, `[constant, slope]` of [`Pair`], given its diffuse part.
#[inline(always)]
pub fn evaluate_specular<F: Real, const ALONG: usize, const ACROSS: usize, const NDF: usize>(
    point: &PointTerms<F, NDF>,
    axis: Vec3Of<F>,
    sharpness: F,
    diffuse: &Dual<F>,
) -> [F; 2] {
    let light = LocalLight { axis: point.in_frame(axis), sharpness };
    let rest = || sum_around_peak::<F, ALONG, ACROSS, NDF>(point, axis, &light);
    let margin = pair_smoothness(point, axis, sharpness);
    let zero = margin.zero();
    if !zero.any_lt(margin) {
        return rest();
    }
    let ring = Ring::new(&light, sharpness.quick_rsqrt());
    let ([a, b], [c, d]) = (smooth_light(point, &light, &ring, diffuse), rest());
    [zero.select_lt(margin, a, c), zero.select_lt(margin, b, d)]
}

/// The specular part of a pair by the rules with nodes around the peak.
#[inline(always)]
fn sum_around_peak<F: Real, const ALONG: usize, const ACROSS: usize, const NDF: usize>(
    point: &PointTerms<F, NDF>,
    axis: Vec3Of<F>,
    light: &LocalLight<F>,
) -> [F; 2] {
    if is_narrow(point, axis, light.sharpness) {
        let placed = place::<F, GGX>(point.view, &point.ndf[NDF - 1], light);
        return sum_nodes::<F, ALONG, ACROSS, NDF, GGX>(point, light, &[placed; MOST_SGS]);
    }
    let placed = place_sgs(point, light, None);
    sum_nodes::<F, ALONG, ACROSS, NDF, SG>(point, light, &placed)
}

/// The placements of a pair's nodes for each SG of the distribution of normals, or first for GGX.
pub(super) type Placements<F> = [Placement<F>; MOST_SGS];

/// Places the nodes for the SGs, given those for the first if there are any yet.
#[inline(always)]
pub(super) fn place_sgs<F: Real, const NDF: usize>(
    point: &PointTerms<F, NDF>,
    light: &LocalLight<F>,
    first: Option<Placement<F>>,
) -> Placements<F> {
    if NDF == 1 {
        let only = match first {
            Some(first) => first,
            None => place::<F, SG>(point.view, &point.ndf[0], light),
        };
        return [only; MOST_SGS];
    }
    let [one, two] = place_two::<F, SG>(point.view, [&point.ndf[0], &point.ndf[1]], [light, light]);
    [one, two, place::<F, SG>(point.view, &point.ndf[2], light)]
}

/// The sum over nodes: `[constant, slope]`.
#[inline(always)]
pub(super) fn sum_nodes<
    F: Real,
    const ALONG: usize,
    const ACROSS: usize,
    const NDF: usize,
    const TAIL: Tail,
>(
    point: &PointTerms<F, NDF>,
    light: &LocalLight<F>,
    placed: &Placements<F>,
) -> [F; 2] {
    let view = PointTermsView::new(point);
    let (mut constant, mut total) = (light.sharpness.zero(), light.sharpness.zero());
    for (m, placement) in parts::<NDF, TAIL>().zip(placed) {
        let ndf = &point.ndf[m];
        let (mut powered, mut plain) = (light.sharpness.zero(), light.sharpness.zero());
        let nodes = placement.nodes::<ALONG, ACROSS>();
        for row in &nodes.rows {
            for column in &nodes.columns {
                let node = node::<F, TAIL>(&view, ndf, light, placement, row, *column);
                let value = node.over_cosine * node.cosine;
                plain += value;
                powered = value.mul_add(node.fresnel, powered);
            }
        }
        constant = powered.mul_add(ndf.scale, constant);
        total = plain.mul_add(ndf.scale, total);
    }
    [constant, total - constant]
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
