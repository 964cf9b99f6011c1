//! Material: diffuse albedo on texels, specular lobes, and edits of both.

pub mod edit;

use crate::math::brdf::{Facets, Ndf};
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
    /// Distribution of microfacet normals, `Sg` or `Ggx`. Default `Sg`, the paper's.
    #[serde(default)]
    pub ndf: Ndf,
}

impl SpecularLobe {
    /// A lobe with the paper's distribution of normals.
    pub const fn new(albedo: Vec3, roughness: f32) -> Self {
        Self { albedo, roughness, ndf: Ndf::Sg }
    }

    /// Its microfacets.
    pub fn facets(&self) -> Facets<f32> {
        Facets { ndf: self.ndf, roughness: self.roughness }
    }
}

/// Diffuse albedo of a material texel, linear RGB in `[0, 1]`.
#[derive(Component, Clone, Copy, Debug, Default, PartialEq)]
pub struct DiffuseAlbedo(pub Vec3);

/// Most specular lobes an object may have.
pub const MAX_SPECULAR_LOBES: usize = 8;

/// Blend weights of the specular lobes at a material texel; they sum to at most one, and what is missing has no gloss.
#[derive(Component, Clone, Copy, Debug, PartialEq)]
pub struct SpecularBlend(pub [f32; MAX_SPECULAR_LOBES]);

impl SpecularBlend {
    /// The mean roughness of `lobes` by these weights; 1 where there is no gloss.
    pub fn roughness(&self, lobes: &[SpecularLobe]) -> f32 {
        let parts = lobes.iter().zip(&self.0);
        let (sum, total) = parts.fold((0.0, 0.0), |(sum, total), (l, w)| (sum + l.roughness * w, total + w));
        if total > 0.0 { sum / total } else { 1.0 }
    }

    /// The same of each of the first `count` lobes (1 to [`MAX_SPECULAR_LOBES`]).
    pub fn even(count: usize) -> Self {
        Self(std::array::from_fn(|k| if k < count { 1.0 / count as f32 } else { 0.0 }))
    }
}

impl Default for SpecularBlend {
    /// All of the first lobe.
    fn default() -> Self {
        let mut weights = [0.0; MAX_SPECULAR_LOBES];
        weights[0] = 1.0;
        Self(weights)
    }
}
