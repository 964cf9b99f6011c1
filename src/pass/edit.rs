//! From a scene file's edits to changes of the material columns.

use crate::error::Result;
use crate::material::edit::{ColorChange, MaterialChange, MaterialState, ScalarChange, apply_edit};
use crate::material::{DiffuseAlbedo, SpecularBlend, SpecularLobe};
use crate::scene::pass_types::{ColorAction, DiffuseAction, Edit, Region, ScalarAction};
use crate::scene::texture::{read_texture, read_texture_mask};
use crate::surface::Surface;
use crate::surface::atlas::TexelAtlas;
use bevy_ecs::prelude::{Entity, With, World};

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

/// The weight of each texel; `None` is everywhere.
fn region_weights(region: &Region, atlas: &TexelAtlas) -> Result<Option<Vec<f32>>> {
    let inside = |test: &dyn Fn(glam::Vec3) -> bool| {
        let weight = |p: &glam::Vec3| if test(*p) { 1.0 } else { 0.0 };
        atlas.position.iter().map(weight).collect::<Vec<f32>>()
    };
    Ok(match region {
        Region::All => None,
        Region::Box { min, max } => Some(inside(&|p| p.cmpge(*min).all() && p.cmple(*max).all())),
        Region::Sphere { center, radius } => {
            Some(inside(&|p| p.distance_squared(*center) <= radius * radius))
        }
        Region::Mask(path) => Some(read_texture_mask(path, atlas.width, atlas.height)?),
    })
}
