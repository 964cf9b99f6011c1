//! Material: diffuse albedo and blend weights of texels, base materials, and edits.
//!
//! A texel has a [`TexelIndex`], its number in the atlas. A base material is an entity with a
//! [`SpecularLobe`] and a number ([`BaseMaterial`]); weight k of a texel's [`SpecularBlend`]
//! belongs to base material k, independently of the order of entities.
//!
//! The result of a fit is the *recovered* material. The system in
//! [`Slot::Material`](crate::pipeline::Slot::Material) computes the *shown* material from it, in
//! separate components ([`Shown`]).

pub mod diffuse;
pub mod edit;
pub mod material_source;
pub mod shown;

pub use diffuse::Diffuse;

use crate::pipeline::pool::{Pool, pool_index, with_columns, write_column};
use bevy_ecs::prelude::{Component, Entity, With, World};
use glam::Vec3;
use lobelia_geometry::Result;
use lobelia_sg::brdf::{Facets, Ndf};
use serde::{Deserialize, Serialize};

/// The albedo of what is unknown: each channel of a usual surface, where a fit starts.
pub const USUAL_ALBEDO: f32 = 0.4;

pool_index! {
    /// Number of a texel in the atlas, `y * width + x`.
    TexelIndex("texel");
}

/// The texels as a system parameter: columns `D` in the order of [`TexelIndex`].
pub type Texels<'w, 's, D> = Pool<'w, 's, TexelIndex, D>;

/// Number of a base material, the index of its weight in [`SpecularBlend`]: 0 to
/// [`MAX_SPECULAR_LOBES`] − 1, each at most once.
#[derive(Component, Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct BaseMaterial(pub u32);

/// The specular part of a base material.
#[derive(Component, Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[require(BaseMaterial, Shown<SpecularLobe>)]
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

    /// Whether its reflections have edges that photographs can be compared by (R < 0.5) and are
    /// brighter than those of plastic, glaze and varnish (specular albedo 0.04 to 0.08), as those
    /// of metal are. They are seen at other depths than the surface.
    pub fn is_mirror_like(&self) -> bool {
        self.roughness < 0.5 && self.albedo.max_element() > 0.1
    }

    /// Its distribution of microfacet normals.
    pub fn facets(&self) -> Facets<f32> {
        Facets { ndf: self.ndf, roughness: self.roughness }
    }
}

impl Default for SpecularLobe {
    /// Black and matte.
    fn default() -> Self {
        Self::new(Vec3::ZERO, 1.0)
    }
}

/// Most specular lobes an object may have.
pub const MAX_SPECULAR_LOBES: usize = 8;

/// Blend weights of the base materials at a texel; they sum to at most one; the remainder has no
/// specular light.
#[derive(Component, Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[require(Shown<SpecularBlend>)]
pub struct SpecularBlend(pub [f32; MAX_SPECULAR_LOBES]);

impl SpecularBlend {
    /// The mean roughness of base materials (with their numbers) with these weights; 1 if all
    /// weights are zero.
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
        Self::even(1)
    }
}

/// What a texel or base material shows in place of a component of the recovered material. Edits of
/// a region add base materials that exist only in the shown material.
#[derive(Component, Clone, Copy, Debug, Default, PartialEq)]
pub struct Shown<T: Send + Sync + 'static>(pub T);

/// Spawns the texels of an atlas, in order; both lists have one entry per texel.
pub fn spawn_texels(world: &mut World, diffuse: &[Diffuse], blends: &[SpecularBlend]) {
    let texels = (0..).map(TexelIndex).zip(diffuse).zip(blends);
    let texels = texels.map(|((index, diffuse), blend)| (index, *diffuse, *blend));
    world.spawn_batch(texels.collect::<Vec<_>>());
}

/// Spawns base materials with the numbers 0, 1, ….
pub fn spawn_materials(world: &mut World, lobes: &[SpecularLobe]) {
    let materials: Vec<_> = (0..).zip(lobes).map(|(k, lobe)| (BaseMaterial(k), *lobe)).collect();
    world.spawn_batch(materials);
}

/// Replaces all base materials by others, with the numbers 0, 1, …, and the blend of every texel by
/// `blend`.
///
/// # Errors
/// If the pool of texels is incomplete.
pub fn replace_materials(world: &mut World, lobes: &[SpecularLobe], blend: SpecularBlend) -> Result<()> {
    let mut query = world.query_filtered::<Entity, With<BaseMaterial>>();
    let old: Vec<Entity> = query.iter(world).collect();
    old.into_iter().for_each(|material| _ = world.despawn(material));
    spawn_materials(world, lobes);
    let texels = world.query::<&TexelIndex>().iter(world).len();
    write_column::<TexelIndex, SpecularBlend>(world, &vec![blend; texels])
}

/// The recovered albedo of all texels.
///
/// # Errors
/// If the pool of texels is incomplete.
pub fn recovered_albedo(world: &mut World) -> Result<Vec<Vec3>> {
    with_columns::<TexelIndex, &Diffuse, _>(world, |texels| {
        Ok(texels.iter().map(|texel| texel.albedo).collect())
    })
}

/// The recovered base materials by number, without unused numbers.
pub fn recovered_materials(world: &mut World) -> Vec<(usize, SpecularLobe)> {
    let mut query = world.query::<(&BaseMaterial, &SpecularLobe)>();
    let mut materials: Vec<_> = query.iter(world).map(|(number, lobe)| (number.0 as usize, *lobe)).collect();
    materials.sort_by_key(|(number, _)| *number);
    materials
}

/// The first recovered base material; black and matte if there is none.
pub fn first_material(world: &mut World) -> SpecularLobe {
    recovered_materials(world).first().map(|(_, lobe)| *lobe).unwrap_or_default()
}

/// The entities of the texels in the order of [`TexelIndex`]. Insert components in this order, so
/// that tables keep it.
pub fn texels_in_order(world: &mut World) -> Vec<Entity> {
    let mut query = world.query::<(Entity, &TexelIndex)>();
    let mut texels: Vec<(TexelIndex, Entity)> = query.iter(world).map(|(e, index)| (*index, e)).collect();
    texels.sort_unstable();
    texels.into_iter().map(|(_, texel)| texel).collect()
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
