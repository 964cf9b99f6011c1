//! Lobes that are narrow against GGX: where its tail or its peak varies little over a lobe, one set
//! of nodes reads GGX itself, which is three times as fast as a set for each of three SGs, and has
//! no error of their fit.
//!
//! In the chart of half vectors the light's curvature is 4λ(v·h)² = 2λ(1 + v·ξ) at the half vector
//! of its axis, and GGX varies over √(1/β + |X|²), with 4|X|² ≥ |ξ − r|² for the mirror direction
//! r. The lobe is narrow if it has at least [`NARROWNESS`] times the curvature 4/(1/β + |X|²) of
//! GGX, the latter not taken to be below 4β/[`FLATTEST`].

use super::placement::{GGX, Tail};
use super::{ggx::GGX_LOBES, point::PointTerms};
use crate::real::{Real, Vec3Of, add, dot, scale};
use std::ops::Range;

/// Least ratio of curvatures.
const NARROWNESS: f64 = 2.0;
/// Most that the tail's flatness counts: beyond, a light's own tail at the peak of GGX would be
/// missed.
const FLATTEST: f64 = 32.0;

/// Most SGs of a distribution of normals: three for GGX.
pub(super) const MOST_SGS: usize = GGX_LOBES;

/// The distributions of a point that one rule reads: of several, the last is GGX, and those before
/// it are its SGs.
#[inline(always)]
pub(super) const fn parts<const NDF: usize, const TAIL: Tail>() -> Range<usize> {
    match (NDF, TAIL) {
        (1, _) => 0..1,
        (_, GGX) => NDF - 1..NDF,
        _ => 0..NDF - 1,
    }
}

/// Ratio of curvatures relative to what it must be at least, and (1 + u)², by which GGX at the
/// lobe's axis is below its peak.
#[inline(always)]
pub(super) fn narrowness<F: Real, const NDF: usize>(
    point: &PointTerms<F, NDF>,
    axis: Vec3Of<F>,
    sharpness: F,
) -> (F, F) {
    let [tangent, _, normal] = point.frame;
    let (along, up) = (dot(tangent, axis) * point.view[0], dot(normal, axis) * point.view[1]);
    // v·ξ = along + up and r·ξ = up − along.
    let fading = (along - up).plus(1.0).relu();
    let ggx = point.ndf[NDF - 1].sharpness;
    let spread = (ggx * fading).times(0.125).plus(1.0);
    let light = sharpness * (along + up).plus(1.0);
    let flatness = spread * (spread.plus(FLATTEST) * ggx).inverse();
    (light * flatness.times(2.0 * FLATTEST / NARROWNESS), spread * spread)
}

/// Whether a lobe is for the rule that reads GGX.
#[inline(always)]
pub(super) fn is_narrow<F: Real, const NDF: usize>(
    point: &PointTerms<F, NDF>,
    axis: Vec3Of<F>,
    sharpness: F,
) -> bool {
    NDF > 1 && !narrowness(point, axis, sharpness).0.any_lt(sharpness.one())
}

/// The mirrored view direction.
#[inline(always)]
pub(super) fn mirror<F: Real, const NDF: usize>(point: &PointTerms<F, NDF>) -> Vec3Of<F> {
    add(scale(point.frame[0], -point.view[0]), scale(point.frame[2], point.view[1]))
}
