//! The published SG shading formulas (PhySG's `render_with_sg`), forward and adjoint, one point ×
//! one lobe at a time.
//!
//! Both outputs need one scalar function of a lobe: the integral of an SG times the clamped cosine,
//! E(λ, c) ≈ ∫ exp(λ(ω·ξ − 1)) max(n·ω, 0) dω with c = ξ·n, in its published form 32.7080 H(SG ×
//! cosine SG) − 31.7003 H(SG). A lobe's diffuse light is μ·E(λ, ξ·n); its specular light is
//! μ·e^x·E(m, p·n), where light × warped NDF is the SG with axis p, sharpness m and amplitude e^x.
//! Rewritten from the paper's form so that sharp lobes keep their accuracy in `f32`: with S = λ₁ +
//! λ₂ and D = ξ₁·ξ₂ − 1, m = √(S² + 2λ₁λ₂D) and x = m − S = 2λ₁λ₂D/(m + S).

mod integral;
mod model;
mod pair;
mod point;
pub mod sharp;

pub use crate::sg::Lobe;
pub use integral::{cosine_integral, hemisphere_integral};
pub use model::Published;
pub use pair::{Pair, PairAdjoint, evaluate_pair, evaluate_prepared, pull_back_pair, shade_pair};
pub use point::{FrozenBrdf, PointTerms, prepare_point, pull_back_normal};
