//! Gradients and moments of what a fit moves, attached to texels, lobes and base materials.

use crate::fit::components::{
    AlbedoGradient, AlbedoMoments, LobeGradient, LobeMoments, SpecularGradient, SpecularMoments, TexelSeen,
};
use crate::fit::roughness::blend::{BlendGradient, BlendMoments};
use crate::fit::sheen::{SheenGradient, SheenMoments};
use crate::light::LightLobe;
use crate::light::lights::LobeOf;
use crate::material::{SpecularLobe, TexelIndex, texels_in_order};
use bevy_ecs::prelude::{Bundle, Component, Entity, With, Without, World};
use bevy_ecs::query::QueryFilter;

/// The lobes of the scene's own light.
pub type OwnLobes = (With<LightLobe>, Without<LobeOf>);

/// Gives texels, lobes and base materials zero gradients.
pub(super) fn attach_gradients(world: &mut World, sheen: bool) {
    let blended = are_blended(world);
    for texel in texels_in_order(world) {
        world.entity_mut(texel).insert((AlbedoGradient::default(), TexelSeen::default()));
        if sheen {
            world.entity_mut(texel).insert(SheenGradient::default());
        }
        if blended {
            world.entity_mut(texel).insert(BlendGradient::default());
        }
    }
    insert_into::<OwnLobes, _>(world, LobeGradient::default());
    insert_into::<With<SpecularLobe>, _>(world, SpecularGradient::default());
}

/// Gives them zero moments.
pub(super) fn attach_moments(world: &mut World, sheen: bool) {
    let blended = are_blended(world);
    for texel in texels_in_order(world) {
        world.entity_mut(texel).insert(AlbedoMoments::default());
        if sheen {
            world.entity_mut(texel).insert(SheenMoments::default());
        }
        if blended {
            world.entity_mut(texel).insert(BlendMoments::default());
        }
    }
    insert_into::<OwnLobes, _>(world, LobeMoments::default());
    insert_into::<With<SpecularLobe>, _>(world, SpecularMoments::default());
}

/// Takes gradients and moments away again.
pub(super) fn detach(world: &mut World) {
    type OfTexel = (AlbedoGradient, TexelSeen, SheenGradient, BlendGradient);
    remove_from::<With<TexelIndex>, (OfTexel, AlbedoMoments, SheenMoments, BlendMoments)>(world);
    remove_from::<With<LightLobe>, (LobeGradient, LobeMoments)>(world);
    remove_from::<With<SpecularLobe>, (SpecularGradient, SpecularMoments)>(world);
}

/// Whether there are several base materials.
fn are_blended(world: &mut World) -> bool {
    world.query::<&SpecularLobe>().iter(world).len() > 1
}

/// Gives a component to all entities that a filter selects.
fn insert_into<F: QueryFilter, T: Component + Clone>(world: &mut World, value: T) {
    let selected: Vec<Entity> = world.query_filtered::<Entity, F>().iter(world).collect();
    world.insert_batch(selected.into_iter().map(|entity| (entity, value.clone())).collect::<Vec<_>>());
}

/// Takes components from all entities that a filter selects, as far as they have them.
fn remove_from<F: QueryFilter, T: Bundle>(world: &mut World) {
    let selected: Vec<Entity> = world.query_filtered::<Entity, F>().iter(world).collect();
    for entity in selected {
        world.entity_mut(entity).remove::<T>();
    }
}
