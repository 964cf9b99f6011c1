//! Lobes over which the BRDF is smooth: the irradiance of the lobe, times the mean of the BRDF in
//! four directions.
//!
//! In Lambert's equal-area chart around the lobe's axis, |X|² = 2(1 − ω·ξ), the light e^(λ(ω·ξ −
//! 1)) is exactly the Gaussian e^(−λ|X|²/2), and n·ω is nearly linear in the part of X toward the
//! normal. The mean of the BRDF is then taken by two nodes of the clipped Gaussian along that
//! direction ([`ring::two_nodes`]) and two at ±1/√λ across it, which is exact up to degree 3. It
//! takes no search for a peak and a third fewer nodes than the rule for all lobes
//! (`accurate/placement.rs`), and its integral of light and cosine is that of the diffuse part
//! (`accurate/diffuse.rs`).
//!
//! A lobe is smooth if the light's curvature is at least [`ring::LEAST_SG`] or [`ring::LEAST_GGX`]
//! times that of the BRDF. With the chart of half vectors of `accurate/specular.rs` the light's is
//! 2λ(1 + v·ξ); the BRDF's is that of D, to which the square of its logarithm's slope is added, L(1 +
//! L|X|²/2) for an SG and L/(1 + L|X|²/4) for GGX, both with the bound 4|X|² ≥ |ξ − r|² for the
//! mirror direction r, plus [`ring::REST`] for all that is not D. A shadowing term of small k falls
//! steeply just above the horizon: where k√λ is small, all of the lobe must lie above it.

mod adjoint;
mod ring;
#[cfg(test)]
mod tests;

pub(super) use ring::{Ring, broadness, pair_smoothness, smooth_light, smoothness};

use super::placement::{GGX, LocalLight, SG};
use super::point::{PairAdjoint, PointTerms};
use crate::{real::Real, sg::Dual};

/// [`smooth_light`] and its adjoints.
#[inline(always)]
pub(super) fn pull_back_smooth<F: Real, const NDF: usize>(
    point: &PointTerms<F, NDF>,
    light: &LocalLight<F>,
    ring: &Ring<F>,
    irradiance: &Dual<F>,
    adjoint: [F; 2],
) -> ([F; 2], PairAdjoint<F, NDF>) {
    if NDF == 1 {
        adjoint::pull_back_of::<F, NDF, SG>(point, light, ring, irradiance, adjoint)
    } else {
        adjoint::pull_back_of::<F, NDF, GGX>(point, light, ring, irradiance, adjoint)
    }
}
