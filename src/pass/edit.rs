//! Conversion of the edits of a scene file to edit entities.

use crate::codec::texture::{read_texture, read_texture_mask};
use crate::error::Result;
use crate::material::edit::{
    EditAction, EditName, EditOrder, EditRegion, EditTarget, MaterialState, apply_edit,
};
use crate::mesh::Surface;
use crate::mesh::atlas::TexelAtlas;
use crate::scene::{ColorAction, DiffuseAction, Edit, Region, ScalarAction};
use bevy_ecs::prelude::{Entity, World};
use glam::Vec3;

/// One edit, evaluated for the texels of a surface.
type ResolvedEdit = (EditTarget, EditAction, EditRegion);

/// Spawns edits with a name; replaces the edits that have it already.
///
/// # Errors
/// If an image cannot be read.
pub fn spawn_edits(world: &mut World, name: &str, edits: &[Edit], surface: &Surface) -> Result<()> {
    let resolved = resolved(edits, surface)?;
    let mut query = world.query::<(Entity, &EditName)>();
    let old: Vec<Entity> = query.iter(world).filter(|(_, of)| of.0 == name).map(|(edit, _)| edit).collect();
    old.into_iter().for_each(|edit| _ = world.despawn(edit));
    for ((target, action, region), order) in resolved.into_iter().zip(0..) {
        world.spawn((EditName(name.to_owned()), EditOrder(order), target, action, region));
    }
    Ok(())
}

/// Applies a scene file's edits in order.
///
/// # Errors
/// If an image cannot be read or there would be too many base materials.
pub fn apply_edits(state: &mut MaterialState, edits: &[Edit], surface: &Surface) -> Result<()> {
    let mut resolved = resolved(edits, surface)?.into_iter();
    resolved.try_for_each(|(target, action, region)| apply_edit(state, target, &action, &region))
}

fn resolved(edits: &[Edit], surface: &Surface) -> Result<Vec<ResolvedEdit>> {
    edits.iter().map(|edit| resolve(edit, surface.atlas())).collect()
}

fn resolve(edit: &Edit, atlas: &TexelAtlas) -> Result<ResolvedEdit> {
    let region = EditRegion(region_weights(edit.region(), atlas)?.map(Into::into));
    let (target, action) = match edit {
        Edit::Diffuse { action, .. } => (EditTarget::Diffuse, diffuse_action(action, atlas)?),
        Edit::Specular { action, .. } => (EditTarget::Specular, color_action(action)),
        Edit::Roughness { action, .. } => (EditTarget::Roughness, scalar_action(action)),
    };
    Ok((target, action, region))
}

fn diffuse_action(action: &DiffuseAction, atlas: &TexelAtlas) -> Result<EditAction> {
    Ok(match action {
        DiffuseAction::Set(color) => EditAction::Set(*color),
        DiffuseAction::Scale(factor) => EditAction::Scale(*factor),
        DiffuseAction::Blend { color, weight } => EditAction::Blend { value: *color, weight: *weight },
        DiffuseAction::Texture(path) => {
            EditAction::PerTexel(read_texture(path, atlas.width, atlas.height)?.into())
        }
    })
}

fn color_action(action: &ColorAction) -> EditAction {
    match action {
        ColorAction::Set(color) => EditAction::Set(*color),
        ColorAction::Scale(factor) => EditAction::Scale(*factor),
        ColorAction::Blend { color, weight } => EditAction::Blend { value: *color, weight: *weight },
    }
}

fn scalar_action(action: &ScalarAction) -> EditAction {
    match action {
        ScalarAction::Set(value) => EditAction::Set(Vec3::splat(*value)),
        ScalarAction::Scale(factor) => EditAction::Scale(Vec3::splat(*factor)),
        ScalarAction::Blend { value, weight } => {
            EditAction::Blend { value: Vec3::splat(*value), weight: *weight }
        }
    }
}

/// The indices of the edits, from 0, whose region contains no texel of the surface.
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

/// The weight of each texel; `None` means 1 everywhere.
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

/// The weight at a depth inside the boundary of the region: 0 outside, 1 from `falloff` on, smooth between.
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
