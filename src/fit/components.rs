//! Components and resources of a fit: gradients and moments of the parameters, and the state of the fit.

use crate::fit::adam::Moments;
use crate::fit::loss::{Loss, LossSums};
use crate::math::shading::{ChunkSums, SharedGradient, SpecularAdjoint};
use bevy_ecs::prelude::{Component, Resource};
use glam::Vec3;
use serde::{Deserialize, Serialize};

/// Gradient of the loss with respect to a texel's diffuse albedo.
#[derive(Component, Clone, Copy, Debug, Default, PartialEq)]
pub struct AlbedoGradient(pub Vec3);

/// Adam's moments of a texel.
#[derive(Component, Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct AlbedoMoments(pub Moments<3>);

/// Sum of the weights of a texel over all fitted pixels.
#[derive(Component, Clone, Copy, Debug, Default, PartialEq)]
pub struct TexelSeen(pub f32);

/// Adam's moments of a light lobe: axis (3), sharpness, amplitude (3).
#[derive(Component, Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LobeMoments(pub Moments<7>);

/// Gradient of the loss with respect to a light lobe, in the order of [`LobeMoments`].
#[derive(Component, Clone, Copy, Debug, Default, PartialEq)]
pub struct LobeGradient(pub [f32; 7]);

/// Adam's moments of a specular lobe: albedo (3), roughness.
#[derive(Component, Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SpecularMoments(pub Moments<4>);

/// Gradient of the loss with respect to a specular lobe, in the order of [`SpecularMoments`].
#[derive(Component, Clone, Copy, Debug, Default, PartialEq)]
pub struct SpecularGradient(pub [f32; 4]);

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
    /// The first base material may be a metal, and the others are dielectrics ([`metal`](crate::fit::metal)); only with several.
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
#[derive(Resource, Clone, Copy, Debug, PartialEq)]
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
    /// With one base material, what `shared` is the total of.
    pub chunks: ChunkSums,
}

impl StepGradient {
    /// With one base material, takes the total of its chunks.
    pub(super) fn take_total(&mut self) {
        self.chunks.total_into(&mut self.shared);
        self.specular.clear();
        self.specular.push(self.shared.specular);
    }
}
