//! Gradients and moments of what a fit moves, attached to texels, lobes and base materials.

use crate::fit::components::{
    AlbedoGradient, AlbedoMoments, LobeGradient, LobeMoments, SpecularGradient, SpecularMoments, TexelSeen,
};
use crate::fit::roughness::blend::{BlendGradient, BlendMoments};
use crate::fit::sheen::{SheenGradient, SheenMoments};
use crate::light::LightLobe;
use crate::light::groups::FittedLobe;
use crate::light::lights::LobeOf;
use crate::material::{SpecularLobe, TexelIndex, texels_in_order};
use bevy_ecs::prelude::{Bundle, Component, Entity, With, Without, World};
use bevy_ecs::query::QueryFilter;

/// The lobes of the scene's own light.
pub(crate) type OwnLobes = (With<LightLobe>, Without<LobeOf>);

/// Gives texels, lobes and base materials zero gradients, and zero moments as well where a fit begins; one that goes on has kept its own.
pub(super) fn attach(world: &mut World, sheen: bool, begins: bool) {
    let blended = are_blended(world);
    let seen = (AlbedoGradient::default(), TexelSeen::default());
    let (of_sheen, of_blend) = (SheenGradient::default(), BlendGradient::default());
    insert_into::<OwnLobes, _>(world, LobeGradient::default());
    insert_into::<With<SpecularLobe>, _>(world, SpecularGradient::default());
    if !begins {
        return insert_into_texels(world, seen, sheen.then_some(of_sheen), blended.then_some(of_blend));
    }
    let of_sheen = (of_sheen, SheenMoments::default());
    let of_blend = (of_blend, BlendMoments::default());
    let always = (seen, AlbedoMoments::default());
    insert_into_texels(world, always, sheen.then_some(of_sheen), blended.then_some(of_blend));
    insert_into::<FittedLobe, _>(world, LobeMoments::default());
    insert_into::<With<SpecularLobe>, _>(world, SpecularMoments::default());
}

/// Gives components to all texels, all at once: each table that they leave keeps its memory.
fn insert_into_texels<A, S, B>(world: &mut World, always: A, of_sheen: Option<S>, of_blend: Option<B>)
where
    A: Bundle + Clone,
    S: Bundle + Clone,
    B: Bundle + Clone,
{
    for texel in texels_in_order(world) {
        let mut texel = world.entity_mut(texel);
        let always = always.clone();
        match (of_sheen.clone(), of_blend.clone()) {
            (None, None) => texel.insert(always),
            (Some(of_sheen), None) => texel.insert((always, of_sheen)),
            (None, Some(of_blend)) => texel.insert((always, of_blend)),
            (Some(of_sheen), Some(of_blend)) => texel.insert((always, of_sheen, of_blend)),
        };
    }
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
