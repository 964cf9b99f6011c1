//! Components and resources of a fit: gradients and moments of the parameters, and the state of the
//! fit; Adam (Kingma and Ba 2015) on small arrays, and the smooth reparameterization that keeps
//! parameters in their ranges.

use crate::fit::loss::{Loss, LossSums};
use crate::fit::roughness::PerMaterial;
use bevy_ecs::prelude::{Component, Resource};
use glam::Vec3;
use lobelia_sg::shading::{ChunkSums, SharedGradient, SpecularAdjoint};
use serde::{Deserialize, Serialize};

/// Gradient of the loss with respect to a texel's diffuse albedo.
#[derive(Component, Clone, Copy, Debug, Default, PartialEq)]
pub struct AlbedoGradient(pub Vec3);

/// Adam's moments of a texel.
#[derive(Component, Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct AlbedoMoments(pub Moments<3>);

/// Sum of the weights of a texel over all fitted pixels.
#[derive(Component, Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TexelSeen(pub f32);

/// Adam's moments of a light lobe: axis (3), sharpness, amplitude (3).
#[derive(Component, Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LobeMoments(pub Moments<7>);

/// Adam's moments of a specular lobe: albedo (3), roughness.
#[derive(Component, Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SpecularMoments(pub Moments<4>);

/// The parameters that a fit optimizes.
#[derive(Resource, Clone, Copy, Debug, PartialEq, Eq)]
pub struct Unknowns {
    /// Texel albedo.
    pub albedo: bool,
    /// Texel sheen; only together with `albedo`.
    pub sheen: bool,
    /// Light lobes.
    pub light: bool,
    /// Specular albedo.
    pub specular_albedo: bool,
    /// One gray specular albedo instead of three channels.
    pub mono_specular: bool,
    /// The first base material may be a metal, and the others are dielectrics
    /// ([`metal`](crate::fit::metal)); only with several.
    pub metal: bool,
    /// Roughness.
    pub roughness: bool,
    /// Blend weights of the base materials, per texel.
    pub blends: bool,
}

impl Default for Unknowns {
    /// All except sheen and blends; the specular albedo is gray.
    fn default() -> Self {
        Self {
            albedo: true,
            sheen: false,
            light: true,
            specular_albedo: true,
            mono_specular: true,
            metal: false,
            roughness: true,
            blends: false,
        }
    }
}

/// Adam's rates at the current step.
#[derive(Resource, Clone, Copy, Debug, Default, PartialEq)]
pub struct StepRates {
    /// Number of the step, from 1.
    pub step: u32,
    /// Number of the step among those that visit the photographs under the same light, from 1.
    pub visit: u32,
    /// Completed part of the fit, in [0, 1).
    pub progress: f32,
    /// Rate of the logit of texel albedo.
    pub albedo: f32,
    /// Rate of lobe axes, log sharpness and log amplitude.
    pub light: f32,
    /// Rate of the logits of specular albedo and roughness.
    pub specular: f32,
}

/// The loss, and its sums of the last step.
#[derive(Resource, Clone, Copy, Debug)]
pub struct LossState {
    /// The loss.
    pub loss: Loss,
    /// Sums over the last window.
    pub last: LossSums,
}

/// Gradient of the shared parameters, from the last step.
#[derive(Resource, Clone, Debug, Default)]
pub struct StepGradient {
    /// With respect to the light.
    pub shared: SharedGradient,
    /// With respect to each base material.
    pub specular: Vec<SpecularAdjoint>,
    /// With respect to the blend weights at each sample, with several base materials.
    pub blends: Vec<PerMaterial>,
    /// Sums over chunks with one base material, which these are the total of.
    pub(super) chunks: ChunkSums,
}

/// Decay rates of the two moments, and the constant that keeps the quotient finite.
const BETA_1: f32 = 0.9;
const BETA_2: f32 = 0.999;
const EPSILON: f32 = 1e-12;

/// First and second moments of `N` parameters.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(bound(serialize = "[f32; N]: Serialize", deserialize = "[f32; N]: Deserialize<'de>"))]
pub struct Moments<const N: usize> {
    first: [f32; N],
    second: [f32; N],
}

impl<const N: usize> Default for Moments<N> {
    fn default() -> Self {
        Self { first: [0.0; N], second: [0.0; N] }
    }
}

/// The rate of a step, with the bias corrections of the moments.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AdamStep {
    rate: f32,
    first_correction: f32,
    second_correction: f32,
}

impl AdamStep {
    /// Step number `step` (from 1) with this rate.
    pub fn new(rate: f32, step: u32) -> Self {
        let power = |beta: f32| 1.0 / (1.0 - f64::from(beta).powi(step.max(1) as i32)) as f32;
        Self { rate, first_correction: power(BETA_1), second_correction: power(BETA_2) }
    }

    /// Adds the gradient to the moments and returns the step of each parameter, to be subtracted.
    #[inline]
    pub fn advance<const N: usize>(&self, moments: &mut Moments<N>, gradient: &[f32; N]) -> [f32; N] {
        std::array::from_fn(|i| {
            let g = gradient[i];
            moments.first[i] = BETA_1 * moments.first[i] + (1.0 - BETA_1) * g;
            moments.second[i] = BETA_2 * moments.second[i] + (1.0 - BETA_2) * g * g;
            let first = moments.first[i] * self.first_correction;
            let second = moments.second[i] * self.second_correction;
            self.rate * first / (second.sqrt() + EPSILON)
        })
    }
}

/// A parameter with bounds: a logistic function maps an unbounded parameter to the range, and steps
/// are taken in the unbounded one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounded {
    /// Lower end of the range.
    pub low: f32,
    /// Upper end of the range.
    pub high: f32,
}

impl Bounded {
    /// The unit interval, for albedos.
    pub const UNIT: Self = Self { low: 0.0, high: 1.0 };

    /// Smallest distance (relative to the range) from an end, so that values near an end can still
    /// move.
    const MARGIN: f32 = 1e-4;

    fn fraction(self, value: f32) -> f32 {
        ((value - self.low) / (self.high - self.low)).clamp(Self::MARGIN, 1.0 - Self::MARGIN)
    }

    /// Derivative of the value with respect to the unbounded parameter.
    #[inline]
    pub fn derivative(self, value: f32) -> f32 {
        let p = self.fraction(value);
        p * (1.0 - p) * (self.high - self.low)
    }

    /// The value after the unbounded parameter has moved by `step`.
    #[inline]
    pub fn move_by(self, value: f32, step: f32) -> f32 {
        let p = self.fraction(value);
        // 1/(1 + odds against): an infinite exponential gives 0, where ∞/∞ gives NaN.
        let against = (1.0 - p) / p * (-step).exp();
        self.low + (self.high - self.low) * (1.0 / (1.0 + against)).clamp(Self::MARGIN, 1.0 - Self::MARGIN)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn adam_finds_the_bottom_of_a_bowl() {
        let (mut x, mut moments) = ([3.0, -2.0], Moments::default());
        for step in 1..=2000 {
            let gradient = [2.0 * (x[0] - 1.0), 20.0 * (x[1] - 0.5)];
            let delta = AdamStep::new(0.01, step).advance(&mut moments, &gradient);
            x = [x[0] - delta[0], x[1] - delta[1]];
        }
        assert!((x[0] - 1.0).abs() < 1e-3 && (x[1] - 0.5).abs() < 1e-3, "{x:?}");
    }

    #[test]
    fn bounded_values_stay_inside_and_their_derivative_is_exact() {
        let bounded = Bounded { low: 0.03, high: 1.0 };
        for value in [0.05, 0.3, 0.9] {
            let h = 1e-2;
            let difference = (bounded.move_by(value, h) - bounded.move_by(value, -h)) / (2.0 * h);
            assert!((difference - bounded.derivative(value)).abs() < 1e-4);
        }
        assert!(bounded.move_by(0.5, 100.0) < 1.0 && bounded.move_by(0.5, -100.0) > 0.03);
    }
}
