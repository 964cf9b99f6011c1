//! Lights of groups of photographs: an object that was photographed in several rooms, or on several
//! days.
//!
//! The first group is lit by the scene's own light. Each further one has a light entity with a
//! [`LightGroup`]; its lobes refer to it by [`LobeOf`] and are marked as [`GroupLobe`]. Which of
//! them shines, [`GroupInTurn`](super::placement::GroupInTurn) says.

use super::lights::{LightMap, LobeOf, LobesOf};
use super::{illuminate::MapLight, lobe::LightLobe, placement::LightGroup};
use bevy_ecs::prelude::{Component, Entity, Or, With, Without, World};
use std::sync::Arc;

/// A lobe of the light of a group other than the first.
#[derive(Component, Clone, Copy, Debug, Default)]
pub struct GroupLobe;

/// All lobes that a fit finds: those of the scene's own light, and those of the groups.
pub type FittedLobe = (With<LightLobe>, Or<(Without<LobeOf>, With<GroupLobe>)>);

/// The lobes of a light, and its map, if it has one.
pub type GroupLight = (Vec<LightLobe>, Option<Arc<MapLight>>);

/// Spawns the lights of the groups after the first.
pub fn spawn_group_lights(world: &mut World, lights: &[GroupLight]) {
    for ((lobes, map), number) in lights.iter().zip(1..) {
        let light = world.spawn((LightGroup(number), LobesOf::default())).id();
        if let Some(map) = map {
            world.entity_mut(light).insert(LightMap(map.clone()));
        }
        world.spawn_batch(lobes.iter().map(|lobe| (*lobe, LobeOf(light), GroupLobe)).collect::<Vec<_>>());
    }
}

/// The entities of the lobes of a group's light, in order; those of the scene's own for the first
/// group, and for one that is not there.
pub fn entities_of_group(world: &mut World, group: LightGroup) -> Vec<Entity> {
    let mut lights = world.query::<(&LightGroup, &LobesOf)>();
    if let Some((_, lobes)) = lights.iter(world).find(|(of, _)| **of == group) {
        return lobes.entities().to_vec();
    }
    world.query_filtered::<Entity, (With<LightLobe>, Without<LobeOf>)>().iter(world).collect()
}

/// The lobes of a group's light, in the order of [`entities_of_group`].
pub fn lobes_of_group(world: &mut World, group: LightGroup) -> Vec<LightLobe> {
    let entities = entities_of_group(world, group);
    entities.into_iter().filter_map(|lobe| world.get::<LightLobe>(lobe).copied()).collect()
}

/// The lobes of the lights of all groups; the first is the scene's own.
pub fn all_lights(world: &mut World) -> Vec<Vec<LightLobe>> {
    (0..light_groups(world) as u32).map(|number| lobes_of_group(world, LightGroup(number))).collect()
}

/// How many lights the photographs have.
pub fn light_groups(world: &mut World) -> usize {
    world.query::<&LightGroup>().iter(world).count() + 1
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::lights::own_lobes;

    #[test]
    fn each_group_has_the_lobes_of_its_light() {
        let mut world = World::new();
        world.spawn_batch(LightLobe::even(3));
        let lights = [2, 5].map(|count| (LightLobe::even(count), None));
        spawn_group_lights(&mut world, &lights);
        assert_eq!(all_lights(&mut world), [3, 2, 5].map(LightLobe::even));
        assert_eq!(own_lobes(&mut world), LightLobe::even(3));
        // Of a group that is not there, it is the scene's own.
        assert_eq!(lobes_of_group(&mut world, LightGroup(7)), LightLobe::even(3));
    }
}
