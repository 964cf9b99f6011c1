//! Material: diffuse albedo on texels, specular lobes, and edits of both.

use bevy_ecs::prelude::Component;
use glam::Vec3;
use serde::{Deserialize, Serialize};

/// One specular base material, shared by the whole object.
#[derive(Component, Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SpecularLobe {
    /// Specular albedo (reflectance at normal incidence), linear RGB in `[0, 1]`.
    pub albedo: Vec3,
    /// The paper's roughness R in `(0, 1]`; GGX's α is R².
    pub roughness: f32,
}

/// Diffuse albedo of a material texel, linear RGB in `[0, 1]`.
#[derive(Component, Clone, Copy, Debug, Default, PartialEq)]
pub struct DiffuseAlbedo(pub Vec3);
