//! The components of texels and base materials: those of the recovered material, and those of the shown one.

use crate::math::brdf::{Facets, Ndf};
use crate::pipeline::pool::{Pool, pool_index};
use bevy_ecs::prelude::Component;
use glam::Vec3;
use serde::{Deserialize, Serialize};

/// The albedo of what is unknown: each channel of a usual surface, where a fit starts.
pub const USUAL_ALBEDO: f32 = 0.4;

pool_index! {
    /// Number of a texel in the atlas, `y * width + x`.
    TexelIndex("texel");
}

/// The texels as a system parameter: columns `D` in the order of [`TexelIndex`].
pub type Texels<'w, 's, D> = Pool<'w, 's, TexelIndex, D>;

/// Number of a base material, the index of its weight in [`SpecularBlend`]: 0 to [`MAX_SPECULAR_LOBES`] − 1, each at most once.
#[derive(
    Component, Clone, Copy, Debug, Default, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize,
)]
pub struct BaseMaterial(pub u32);

/// The specular part of a base material.
#[derive(Component, Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[require(BaseMaterial, ShownSpecular)]
pub struct SpecularLobe {
    /// Specular albedo (reflectance at normal incidence), linear RGB in `[0, 1]`.
    pub albedo: Vec3,
    /// The paper's roughness R in `[0.03, 1]`; GGX's α is R².
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

    /// Whether its reflections have edges that photographs can be compared by (R < 0.5) and are brighter than those of plastic, glaze
    /// and varnish (specular albedo 0.04 to 0.08), as those of metal are. They are seen at other depths than the surface.
    pub fn is_mirror_like(&self) -> bool {
        self.roughness < 0.5 && self.albedo.max_element() > 0.1
    }

    /// Its distribution of microfacet normals.
    pub fn facets(&self) -> Facets<f32> {
        Facets { ndf: self.ndf, roughness: self.roughness }
    }
}

/// Diffuse albedo of a material texel, linear RGB in `[0, 1]`.
#[derive(Component, Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[require(SpecularBlend, DiffuseSheen, DiffuseTilt, ShownAlbedo)]
pub struct DiffuseAlbedo(pub Vec3);

/// Difference s between a texel's diffuse albedo along the surface and straight on, linear RGB in [−1, 1]; the sum with
/// [`DiffuseAlbedo`] is in [0, 1]. See [`sheen`](super::sheen).
#[derive(Component, Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[require(ShownSheen)]
pub struct DiffuseSheen(pub Vec3);

/// How much brighter a texel's diffuse albedo is toward one side: a vector in the object's axes, at most
/// 0.9 long. See [`tilt`](super::tilt).
#[derive(Component, Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[require(ShownTilt)]
pub struct DiffuseTilt(pub Vec3);

/// Most specular lobes an object may have.
pub const MAX_SPECULAR_LOBES: usize = 8;

/// Blend weights of the base materials at a texel; they sum to at most one; the remainder has no specular light.
#[derive(Component, Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[require(ShownBlend)]
pub struct SpecularBlend(pub [f32; MAX_SPECULAR_LOBES]);

impl SpecularBlend {
    /// The mean roughness of base materials (with their numbers) with these weights; 1 if all weights are zero.
    pub fn roughness<'a>(&self, materials: impl IntoIterator<Item = (usize, &'a SpecularLobe)>) -> f32 {
        let weighted = |(sum, total): (f32, f32), (k, lobe): (usize, &SpecularLobe)| {
            (sum + lobe.roughness * self.0[k], total + self.0[k])
        };
        let (sum, total) = materials.into_iter().fold((0.0, 0.0), weighted);
        if total > 0.0 { sum / total } else { 1.0 }
    }

    /// Equal weights of the first `count` lobes (1 to [`MAX_SPECULAR_LOBES`]).
    pub fn even(count: usize) -> Self {
        Self(std::array::from_fn(|k| if k < count { 1.0 / count as f32 } else { 0.0 }))
    }
}

impl Default for SpecularBlend {
    /// Weight 1 of base material 0.
    fn default() -> Self {
        let mut weights = [0.0; MAX_SPECULAR_LOBES];
        weights[0] = 1.0;
        Self(weights)
    }
}

/// Diffuse albedo that a texel shows, linear RGB in `[0, 1]`.
#[derive(Component, Clone, Copy, Debug, Default, PartialEq)]
pub struct ShownAlbedo(pub Vec3);

/// Sheen that a texel shows.
#[derive(Component, Clone, Copy, Debug, Default, PartialEq)]
pub struct ShownSheen(pub Vec3);

/// Tilt that a texel shows.
#[derive(Component, Clone, Copy, Debug, Default, PartialEq)]
pub struct ShownTilt(pub Vec3);

/// Blend weights that a texel shows.
#[derive(Component, Clone, Copy, Debug, Default, PartialEq)]
pub struct ShownBlend(pub SpecularBlend);

/// Specular lobe that a base material shows. Edits of a region add base materials that exist only in the shown material; these have no [`SpecularLobe`].
#[derive(Component, Clone, Copy, Debug, PartialEq)]
#[require(BaseMaterial)]
pub struct ShownSpecular(pub SpecularLobe);

impl Default for ShownSpecular {
    /// A placeholder, until [`Slot::Material`](crate::pipeline::Slot::Material) has run.
    fn default() -> Self {
        Self(SpecularLobe { albedo: Vec3::ZERO, roughness: 1.0, ndf: Ndf::default() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn metal_mirrors_and_varnish_does_not() {
        assert!(SpecularLobe::new(Vec3::new(0.9, 0.7, 0.3), 0.2).is_mirror_like());
        assert!(!SpecularLobe::new(Vec3::splat(0.04), 0.1).is_mirror_like(), "varnish");
        assert!(!SpecularLobe::new(Vec3::splat(0.2), 0.8).is_mirror_like(), "reflections without edges");
    }
}
