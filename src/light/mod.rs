//! Light: SG lobes, environment maps, and one from the other.

use bevy_ecs::prelude::Component;
use glam::Vec3;
use serde::{Deserialize, Serialize};

/// One SG of distant light: radiance μ exp(λ(ω·ξ − 1)) from direction ω.
#[derive(Component, Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LightLobe {
    /// ξ, unit direction towards the light, world space.
    pub axis: Vec3,
    /// λ ≥ 0.
    pub sharpness: f32,
    /// μ ≥ 0, linear RGB radiance at the axis.
    pub amplitude: Vec3,
}

/// Radiance from every direction on a latitude-longitude grid.
///
/// Texel centres at ((i + ½)/W, (j + ½)/H); top row around +Y; left edge −Z, then +X at ¼, +Z at ½, −X at ¾:
/// direction of (u, v) = (cos θ sin φ, cos φ, sin θ sin φ), φ = πv, θ = 2πu − π/2.
#[derive(Clone, Debug, PartialEq)]
pub struct EnvironmentMap {
    /// Width in texels.
    pub width: u32,
    /// Height in texels.
    pub height: u32,
    /// `width * height` linear RGB radiances, row by row from the top left.
    pub radiance: Vec<Vec3>,
}
