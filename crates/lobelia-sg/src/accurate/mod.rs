//! Accurate SG shading: the integrals of light SG × BRDF × cosine themselves, without an
//! approximation of the BRDF.
//!
//! Diffuse: a closed form with an error of about 0.1 % ([`diffuse::cosine_integral`]). Specular: a
//! quadrature of 4, 6 or 12 nodes around the product's peak in half-vector space
//! (`accurate/specular.rs`), with M, D (PhySG supp. eqs. 1–7) and the cosine evaluated at every
//! node; where the BRDF is smooth over the lobe, the irradiance times the mean of the BRDF in four
//! directions (`accurate/smooth`). Both take one point × one lobe at a time, like
//! [`super::published`], and sum over lobes linearly.
//!
//! Accuracy against an adaptive cubature, and cost of diffuse + specular with 16 lanes of `f32` on
//! one core (the published formulas in the same run: 9.2 ns forward, 16.8 ns forward and adjoint).
//! Errors of the specular light in %: energy-weighted, median and 90th percentile over 195 lit
//! cases with R in 0.1–0.9, λ in 1–800 (A); median, 90th percentile and mean over 1489 lit cases
//! with R in 0.03–1, λ in 1e-3–1e6, lights of equal flux and any n·v above 0.001 (B). Published on
//! A: 8.1, 8.5, 50. All but the columns of A at 3 × 2 and 4 × 3 is without the rule for smooth
//! lobes, whose own errors are a median of 0.01 % and 0.16 % at the 90th percentile.
//!
//! | nodes | A energy | A median | A 90th | B median | B 90th | B mean | forward | with adjoint |
//! | --- | --- | --- | --- | --- | --- | --- | --- | --- |
//! | 2 × 2 | 0.60 | 0.20 | 2.7 | 0.009 | 7.9 | 2.0 | 15.2 ns | 18.4 ns |
//! | 3 × 2 (`Default`) | 0.35 | 0.09 | 1.8 | 0.007 | 2.7 | 0.75 | 18.6 ns | 22.2 ns |
//! | 3 × 3 | 0.30 | 0.05 | 1.6 | 0.002 | 2.2 | 0.60 | 21.7 ns | – |
//! | 4 × 3 (`High`) | 0.16 | 0.05 | 0.8 | 0.002 | 1.0 | 0.35 | 25.5 ns | 32.4 ns |
//!
//! Diffuse on A: 0.08, 0.02, 0.64 (published 0.78, 0.77, 5.0). A second Gauss–Newton step changes
//! little (3 × 3 on A: energy 0.30 to 0.31), so there is one. The largest errors, tens of percent,
//! occur for lights far below the horizon on rough surfaces and for n·v < 0.01. `f32` agrees with
//! `f64` to 1e-4 except for n·v < 0.005 with λ > 1e4 (1.6e-3).
//!
//! The adjoint holds the specular nodes' world-space directions ω and their weights fixed, but for
//! smooth lobes. Its result is exactly the derivative of the sum with fixed nodes, and the
//! derivative of the integral up to the accuracy of the rule. The motion of the nodes with the
//! inputs is left out, because the value of an exact rule does not depend on it. The diffuse
//! adjoint is exact.

mod adjoint;
pub mod diffuse;
pub mod ggx;
mod model;
mod narrow;
mod pair;
mod placement;
mod point;
mod rule;
mod smooth;
mod specular;

#[cfg(test)]
mod tests;

use serde::{Deserialize, Serialize};

pub use adjoint::{pull_back_diffuse, pull_back_pair, pull_back_specular};
pub use model::{ACCURATE_DEFAULT, ACCURATE_HIGH, Accurate, GGX_DEFAULT, GGX_HIGH};
pub use pair::{Pair, evaluate_pair, evaluate_specular, shade_pair};
pub use point::{
    NdfTerms, PairAdjoint, PointDerivatives, PointSums, PointTerms, prepare_point, prepare_with_ndf,
    pull_back_point,
};

/// Number of nodes of the specular quadrature.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Quality {
    /// 3 × 2 nodes.
    #[default]
    Default,
    /// 4 × 3 nodes for radiance; adjoints and responses are those of the default.
    High,
}
