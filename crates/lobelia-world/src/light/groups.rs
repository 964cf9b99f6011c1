//! Lights of groups of photographs: an object that was photographed in several rooms, or on several
//! days.
//!
//! The first group is lit by the scene's own light. Each further one has a light entity with a
//! [`LightGroup`]; its lobes refer to it by [`LobeOf`] and are marked as [`GroupLobe`]. All lights
//! have the same number of lobes, so that they can take turns as the scene's own: a fit exchanges
//! their values, and no kernel knows of more than one light.

use super::illuminate::MapLight;
use super::lights::{FillingLobe, LightMap, LobeOf, LobesOf};
use super::lobe::LightLobe;
use super::placement::LightGroup;
use bevy_ecs::prelude::{Component, Entity, Or, With, Without, World};
use glam::Vec3;
use std::sync::Arc;

/// A lobe of the light of a group other than the first.
#[derive(Component, Clone, Copy, Debug, Default)]
pub struct GroupLobe;

/// All lobes that a fit finds: those of the scene's own light, and those of the groups.
pub type FittedLobe = (With<LightLobe>, Or<(Without<LobeOf>, With<GroupLobe>)>);

/// The lobes of a light, and its map, if it has one.
pub type GroupLight = (Vec<LightLobe>, Option<Arc<MapLight>>);

/// Spawns the lights of the groups after the first. All lights get as many lobes as the largest
/// has, by lobes without radiance.
pub fn spawn_group_lights(world: &mut World, lights: &[GroupLight]) {
    let own = world.query_filtered::<&LightLobe, Without<LobeOf>>().iter(world).count();
    let most = lights.iter().map(|(lobes, _)| lobes.len()).fold(own, usize::max);
    if lights.is_empty() {
        return;
    }
    let dark = LightLobe { axis: Vec3::Y, sharpness: 1.0, amplitude: Vec3::ZERO };
    world.spawn_batch(vec![(dark, FillingLobe); most - own]);
    for ((lobes, map), number) in lights.iter().zip(1..) {
        let light = world.spawn((LightGroup(number), LobesOf::default())).id();
        if let Some(map) = map {
            world.entity_mut(light).insert(LightMap(map.clone()));
        }
        let all = lobes.iter().copied().chain(std::iter::repeat_n(dark, most - lobes.len()));
        world.spawn_batch(all.map(|lobe| (lobe, LobeOf(light), GroupLobe)).collect::<Vec<_>>());
    }
}

/// The entity of the light of a group; `None` for the scene's own and those that are not there.
pub fn group_light(world: &mut World, group: LightGroup) -> Option<Entity> {
    world.query::<(Entity, &LightGroup)>().iter(world).find(|(_, of)| **of == group).map(|(light, _)| light)
}

/// The lobes of the light of a group, without those that have no radiance and only fill it up.
pub fn lobes_of_group(world: &mut World, group: LightGroup) -> Vec<LightLobe> {
    let Some(light) = group_light(world, group) else { return Vec::new() };
    let entities = world.get::<LobesOf>(light).map(|of| of.entities().to_vec()).unwrap_or_default();
    let lobes = entities.into_iter().filter_map(|lobe| world.get::<LightLobe>(lobe).copied());
    lobes.filter(|lobe| lobe.amplitude != Vec3::ZERO).collect()
}

/// The lights of the groups after the first, without their maps.
pub fn other_lights(world: &mut World) -> Vec<GroupLight> {
    let numbers = 1..light_groups(world) as u32;
    numbers.map(|number| (lobes_of_group(world, LightGroup(number)), None)).collect()
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
    fn all_lights_get_as_many_lobes_as_the_largest() {
        let mut world = World::new();
        world.spawn_batch(LightLobe::even(3));
        let lights = [2, 5].map(|count| (LightLobe::even(count), None));
        spawn_group_lights(&mut world, &lights);
        assert_eq!((light_groups(&mut world), world.query::<&FillingLobe>().iter(&world).count()), (3, 2));
        assert_eq!(own_lobes(&mut world), LightLobe::even(3));
        for (number, (lobes, _)) in (1..).zip(&lights) {
            assert_eq!(lobes_of_group(&mut world, LightGroup(number)), *lobes);
            let light = group_light(&mut world, LightGroup(number)).unwrap();
            assert_eq!(world.get::<LobesOf>(light).unwrap().entities().len(), 5);
        }
        assert_eq!(group_light(&mut world, LightGroup::OWN), None);
    }
}
