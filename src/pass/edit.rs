//! From a scene file's edits to changes of the material columns.

use crate::codec::texture::{read_texture, read_texture_mask};
use crate::error::Result;
use crate::material::edit::{ColorChange, MaterialChange, MaterialState, ScalarChange, apply_edit};
use crate::material::{DiffuseAlbedo, SpecularBlend, SpecularLobe};
use crate::mesh::Surface;
use crate::mesh::atlas::TexelAtlas;
use crate::scene::passes::{ColorAction, DiffuseAction, Edit, Region, ScalarAction};
use bevy_ecs::prelude::{Entity, With, World};
use glam::Vec3;

/// Copies the material out of a world.
pub fn take_material(world: &mut World) -> MaterialState {
    MaterialState {
        albedo: world.query::<&DiffuseAlbedo>().iter(world).copied().collect(),
        blends: world.query::<&SpecularBlend>().iter(world).copied().collect(),
        lobes: world.query::<&SpecularLobe>().iter(world).copied().collect(),
    }
}

/// Puts a material into a world, which may have had fewer or more specular lobes.
pub fn put_material(world: &mut World, state: &MaterialState) {
    for (mut albedo, value) in world.query::<&mut DiffuseAlbedo>().iter_mut(world).zip(&state.albedo) {
        *albedo = *value;
    }
    for (mut blend, value) in world.query::<&mut SpecularBlend>().iter_mut(world).zip(&state.blends) {
        *blend = *value;
    }
    let old: Vec<Entity> = world.query_filtered::<Entity, With<SpecularLobe>>().iter(world).collect();
    if old.len() == state.lobes.len() {
        for (entity, value) in old.into_iter().zip(&state.lobes) {
            world.entity_mut(entity).insert(*value);
        }
        return;
    }
    // All anew: were some to keep the components that a fit gave them, they would lie in another table than the rest,
    // and the order in which queries visit tables, by which blend weights name lobes, is not that of the lobes.
    for entity in old {
        world.despawn(entity);
    }
    world.spawn_batch(state.lobes.clone());
}

/// Applies a scene file's edits in order.
///
/// # Errors
/// If an image cannot be read or there would be too many specular lobes.
pub fn apply_edits(state: &mut MaterialState, edits: &[Edit], surface: &Surface) -> Result<()> {
    for edit in edits {
        let region = region_weights(edit.region(), surface.atlas())?;
        apply_edit(state, &material_change(edit, surface.atlas())?, region.as_deref())?;
    }
    Ok(())
}

fn material_change(edit: &Edit, atlas: &TexelAtlas) -> Result<MaterialChange> {
    Ok(match edit {
        Edit::Diffuse { action, .. } => MaterialChange::Diffuse(match action {
            DiffuseAction::Set(color) => ColorChange::Set(*color),
            DiffuseAction::Scale(factor) => ColorChange::Scale(*factor),
            DiffuseAction::Blend { color, weight } => ColorChange::Blend(*color, *weight),
            DiffuseAction::Texture(path) => {
                ColorChange::PerTexel(read_texture(path, atlas.width, atlas.height)?)
            }
        }),
        Edit::Specular { action, .. } => MaterialChange::Specular(match action {
            ColorAction::Set(color) => ColorChange::Set(*color),
            ColorAction::Scale(factor) => ColorChange::Scale(*factor),
            ColorAction::Blend { color, weight } => ColorChange::Blend(*color, *weight),
        }),
        Edit::Roughness { action, .. } => MaterialChange::Roughness(match action {
            ScalarAction::Set(value) => ScalarChange::Set(*value),
            ScalarAction::Scale(factor) => ScalarChange::Scale(*factor),
            ScalarAction::Blend { value, weight } => ScalarChange::Blend(*value, *weight),
        }),
    })
}

/// The numbers of the edits, from 0, whose region holds no texel of the surface.
///
/// # Errors
/// If a mask cannot be read.
pub fn edits_of_nothing(edits: &[Edit], surface: &Surface) -> Result<Vec<usize>> {
    let atlas = surface.atlas();
    let mut numbers = Vec::new();
    for (number, edit) in edits.iter().enumerate() {
        let Some(weights) = region_weights(edit.region(), atlas)? else { continue };
        if !weights.iter().zip(&atlas.covered).any(|(weight, covered)| *covered && *weight > 0.0) {
            numbers.push(number);
        }
    }
    Ok(numbers)
}

/// The weight of each texel; `None` is everywhere.
fn region_weights(region: &Region, atlas: &TexelAtlas) -> Result<Option<Vec<f32>>> {
    let each = |depth: &dyn Fn(Vec3) -> f32, falloff: f32| {
        Some(atlas.position.iter().map(|p| weight_at(depth(*p), falloff)).collect::<Vec<f32>>())
    };
    Ok(match region {
        Region::All => None,
        Region::Box { min, max, falloff } => {
            each(&|p| (p - *min).min_element().min((*max - p).min_element()), *falloff)
        }
        Region::Sphere { center, radius, falloff } => each(&|p| radius - p.distance(*center), *falloff),
        Region::Mask(path) => Some(read_texture_mask(path, atlas.width, atlas.height)?),
    })
}

/// The weight at a depth below the region's wall: 0 outside, 1 from `falloff` on, smooth between.
fn weight_at(depth: f32, falloff: f32) -> f32 {
    if depth < 0.0 {
        return 0.0;
    }
    let t = if depth < falloff { depth / falloff } else { 1.0 };
    t * t * (3.0 - 2.0 * t)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_region_sets_in_over_its_falloff() {
        assert_eq!([-0.1, 0.0, 0.2].map(|depth| weight_at(depth, 0.0)), [0.0, 1.0, 1.0]);
        assert_eq!([-0.1, 0.0, 0.1, 0.2].map(|depth| weight_at(depth, 0.2)), [0.0, 0.0, 0.5, 1.0]);
    }
}
