//! The recovered material in a world: spawned, replaced, read.

use super::components::{
    BaseMaterial, DiffuseAlbedo, DiffuseSheen, DiffuseTilt, SpecularBlend, SpecularLobe, TexelIndex,
};
use crate::error::Result;
use crate::pipeline::pool::{read_column, write_column};
use bevy_ecs::prelude::{Entity, With, World};
use glam::Vec3;

/// Spawns the texels of an atlas, in order; all lists have one entry per texel.
pub fn spawn_texels(
    world: &mut World,
    albedo: &[Vec3],
    sheen: &[DiffuseSheen],
    tilt: &[DiffuseTilt],
    blends: &[SpecularBlend],
) {
    let colors = albedo.iter().zip(sheen).zip(tilt).zip(blends);
    let texels = (0..).map(TexelIndex).zip(colors);
    let texels = texels.map(|(index, (((albedo, sheen), tilt), blend))| {
        (index, DiffuseAlbedo(*albedo), *sheen, *tilt, *blend)
    });
    world.spawn_batch(texels.collect::<Vec<_>>());
}

/// Spawns base materials with the numbers 0, 1, ….
pub fn spawn_materials(world: &mut World, lobes: &[SpecularLobe]) {
    let materials: Vec<_> = (0..).zip(lobes).map(|(k, lobe)| (BaseMaterial(k), *lobe)).collect();
    world.spawn_batch(materials);
}

/// Replaces all base materials by others, with the numbers 0, 1, …, and the blend of every texel by `blend`.
///
/// # Errors
/// If the pool of texels is incomplete.
pub fn replace_materials(world: &mut World, lobes: &[SpecularLobe], blend: SpecularBlend) -> Result<()> {
    let mut query = world.query_filtered::<Entity, With<BaseMaterial>>();
    let old: Vec<Entity> = query.iter(world).collect();
    for material in old {
        world.despawn(material);
    }
    spawn_materials(world, lobes);
    let texels = world.query::<&TexelIndex>().iter(world).len();
    write_column::<TexelIndex, SpecularBlend>(world, &vec![blend; texels])
}

/// The recovered albedo of all texels.
///
/// # Errors
/// If the pool of texels is incomplete.
pub fn recovered_albedo(world: &mut World) -> Result<Vec<Vec3>> {
    Ok(read_column::<TexelIndex, DiffuseAlbedo>(world)?.into_iter().map(|albedo| albedo.0).collect())
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
    recovered_materials(world).first().map_or(SpecularLobe::new(Vec3::ZERO, 1.0), |(_, lobe)| *lobe)
}

/// The entities of the texels in the order of [`TexelIndex`]. Insert components in this order, so that tables keep it.
pub fn texels_in_order(world: &mut World) -> Vec<Entity> {
    let mut query = world.query::<(Entity, &TexelIndex)>();
    let mut texels: Vec<(TexelIndex, Entity)> = query.iter(world).map(|(e, index)| (*index, e)).collect();
    texels.sort_unstable();
    texels.into_iter().map(|(_, texel)| texel).collect()
}
