//! Spherical Gaussians: G(ω; ξ, λ, μ) = μ exp(λ(ω·ξ − 1)) with axis ξ, sharpness λ and amplitude μ.
//! The product of two is a third one, and the integral over the sphere has a closed form.
//!
//! ```
//! use lobelia_sg::sg::{evaluate, sphere_integral};
//! use std::f64::consts::PI;
//!
//! let (axis, aside) = ([0.0_f64, 0.0, 1.0], [0.6, 0.0, 0.8]);
//! assert_eq!(evaluate(axis, axis, 10.0), 1.0);
//! assert!((evaluate(aside, axis, 10.0) - (-2.0_f64).exp()).abs() < 1e-12);
//! assert_eq!(sphere_integral(0.0), 4.0 * PI);
//! ```

use crate::real::{Real, Vec3Of, dot, sub};

/// Value at the unit direction `omega` of a unit-amplitude SG with unit `axis` and `sharpness` ≥ 0.
///
/// λ(ω·ξ − 1) is computed as −λ|ω − ξ|²/2, which keeps its accuracy for sharp lobes in `f32`.
#[inline(always)]
pub fn evaluate<F: Real>(omega: Vec3Of<F>, axis: Vec3Of<F>, sharpness: F) -> F {
    let d = sub(omega, axis);
    (-(sharpness.times(0.5)) * dot(d, d)).exp()
}

/// Integral of a unit-amplitude SG over the whole sphere: 2π(1 − e^(−2λ))/λ.
pub fn sphere_integral(sharpness: f64) -> f64 {
    if sharpness < 1e-6 {
        4.0 * std::f64::consts::PI
    } else {
        2.0 * std::f64::consts::PI * (-(-2.0 * sharpness).exp_m1()) / sharpness
    }
}

/// A light lobe as the kernel reads it.
#[derive(Clone, Copy, Debug)]
pub struct Lobe<F> {
    /// Unit axis.
    pub axis: Vec3Of<F>,
    /// Sharpness ≥ 0.
    pub sharpness: F,
    /// RGB amplitude.
    pub amplitude: Vec3Of<F>,
}

/// The shape of a lobe: axis and sharpness, without the amplitude.
#[derive(Clone, Copy)]
pub struct Shape<F> {
    /// Unit axis.
    pub axis: Vec3Of<F>,
    /// Sharpness ≥ 0.
    pub sharpness: F,
}

/// A function's value and its two partial derivatives.
#[derive(Clone, Copy)]
pub struct Dual<F> {
    /// The value.
    pub value: F,
    /// Derivative with respect to the sharpness.
    pub by_sharpness: F,
    /// Derivative with respect to the cosine.
    pub by_cosine: F,
}
