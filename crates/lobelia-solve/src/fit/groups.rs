//! Lights that take turns: photographs of several [groups](lobelia_world::light::groups), each
//! under a light of its own.
//!
//! A step visits the photographs of one group. Before it, the values of the scene's own light and
//! of the group's are exchanged, with their moments and shadows, and after it they are exchanged
//! back; systems know of one light alone. Groups have turns in proportion to their pixels. Albedo
//! and materials are common to all, and so is the scale between light and albedo.

use crate::fit::run::{entities, remove_from};
use crate::{fit::components::LobeMoments, visibility::ObjectVisibility};
use bevy_ecs::prelude::{Component, Entity, With, Without, World};
use lobelia_geometry::view::{ByView, Placement, ViewIndex};
use lobelia_world::light::LightLobe;
use lobelia_world::light::groups::{group_light, light_groups};
use lobelia_world::light::lights::{LobeOf, LobesOf};
use lobelia_world::light::placement::{LightGroup, Placements};
use lobelia_world::sample::{Observation, ObservationIndex};
use std::ops::Range;

/// Least share of the steps that a group has, relative to an equal share.
const LEAST_SHARE: f64 = 0.25;

/// The shadows under the light of a group, while another one shines.
#[derive(Component)]
struct GroupVisibility(ObjectVisibility);

/// Exchanges the scene's own light and that of a group: lobes, moments and shadows. Twice is as
/// before. Nothing changes for the first group.
pub(crate) fn exchange_light(world: &mut World, group: LightGroup) {
    let Some(light) = group_light(world, group) else { return };
    let of_group = world.get::<LobesOf>(light).map(|of| of.entities().to_vec()).unwrap_or_default();
    for (own, of_group) in entities::<(With<LightLobe>, Without<LobeOf>)>(world).into_iter().zip(of_group) {
        exchange::<LightLobe>(world, [own, of_group]);
        exchange::<LobeMoments>(world, [own, of_group]);
    }
    // Shadows of another surface, or of another state of it, are found anew.
    let kept = world.entity_mut(light).take::<GroupVisibility>();
    if let Some(now) = world.remove_resource::<ObjectVisibility>() {
        let kept = kept.map(|kept| kept.0).filter(|kept| kept.is_traced_as(&now));
        world.insert_resource(kept.unwrap_or_else(|| now.unlit()));
        world.entity_mut(light).insert(GroupVisibility(now));
    }
}

/// Exchanges a component that both entities have.
fn exchange<T: Component + Copy>(world: &mut World, entities: [Entity; 2]) {
    if let [Some(a), Some(b)] = entities.map(|entity| world.get::<T>(entity).copied()) {
        world.insert_batch(entities.into_iter().zip([b, a]));
    }
}

/// Forgets what was traced of the surface, for all groups.
pub fn forget_visibility(world: &mut World) {
    world.remove_resource::<ObjectVisibility>();
    forget_group_shadows(world);
}

/// Makes all groups find shadows and reflected light anew.
pub fn forget_group_shadows(world: &mut World) {
    remove_from::<With<LightGroup>, GroupVisibility>(world);
}

/// The group of each view.
pub(crate) fn groups_of_views(world: &mut World) -> ByView<LightGroup> {
    let placements = world.get_resource::<Placements>().cloned().unwrap_or_default();
    let mut views = world.query::<(&ViewIndex, &Placement)>();
    views.iter(world).map(|(view, placement)| (*view, placements.light(*placement))).collect()
}

/// The light of each view, by its index; empty if all have the same.
pub(super) fn lights_of_views(world: &mut World) -> Vec<LightGroup> {
    if light_groups(world) == 1 {
        return Vec::new();
    }
    let groups = groups_of_views(world);
    let views = world.query::<&ViewIndex>().iter(world).map(|view| view.0 + 1).max().unwrap_or(0);
    (0..views).map(|view| groups.get(ViewIndex(view)).copied().unwrap_or_default()).collect()
}

/// Which group each step of a fit visits, and which of its pixels.
#[derive(Clone)]
pub(super) struct Turns {
    groups: Vec<GroupTurns>,
    batch: StepPixels,
    /// Steps between two updates of shadows.
    refresh_every: u32,
    step: u32,
}

/// The turns of a group.
#[derive(Clone, Default)]
struct GroupTurns {
    /// Rows of the pool of observed pixels.
    pool: Range<usize>,
    /// The part of the steps that it has.
    share: f64,
    visits: u32,
    /// Pixels visited so far, those that are visited again included.
    visited: usize,
    /// Visits until the end of the fit.
    all_visits: u32,
    /// Whether its shadows are to be found anew.
    is_stale: bool,
}

/// How many pixels the steps of a fit visit.
#[derive(Clone, Copy)]
pub(super) struct StepPixels {
    /// Pixels of each of the first steps, and of each of the others.
    pub early: usize,
    pub late: usize,
    /// The part of all steps that are the first ones.
    pub until: f32,
    /// Number of all steps.
    pub steps: u32,
}

/// Visit of a step to a group.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Turn {
    pub group: LightGroup,
    /// Rows of the pool of observed pixels.
    pub rows: Range<usize>,
    /// Whether it finds shadows anew.
    pub refreshes: bool,
    /// Number of the visit to this group, from 1.
    pub visit: u32,
    /// Whether the visit is one of the last that visit each of its pixels once.
    pub is_last: bool,
}

impl Turns {
    /// Before the first step, for the pool of a world whose rows are in the order of their groups.
    pub fn new(world: &mut World, batch: StepPixels, refresh_every: u32) -> Self {
        let groups = groups_of_views(world);
        let mut counts = vec![0; light_groups(world)];
        let mut rows = world.query_filtered::<&Observation, With<ObservationIndex>>();
        for row in rows.iter(world) {
            counts[groups.get(row.pixel.view).map_or(0, |group| group.0 as usize)] += 1;
        }
        Self::of(&counts, batch, refresh_every)
    }

    fn of(counts: &[usize], batch: StepPixels, refresh_every: u32) -> Self {
        let total = counts.iter().sum::<usize>().max(1) as f64;
        let least = LEAST_SHARE / counts.len() as f64;
        let mut end = 0;
        let group = |count: &usize| {
            let pool = end..end + count;
            end = pool.end;
            let share = if pool.is_empty() { 0.0 } else { (pool.len() as f64 / total).max(least) };
            GroupTurns { pool, share, ..GroupTurns::default() }
        };
        Self { groups: counts.iter().map(group).collect(), batch, refresh_every, step: 0 }
    }

    /// Counts the visits of a fit of so many steps in advance.
    pub fn until(mut self, steps: u32) -> Self {
        if let [only] = self.groups.as_mut_slice() {
            only.all_visits = steps;
            return self;
        }
        let mut end = self.clone();
        (0..steps).for_each(|_| _ = end.next());
        self.groups.iter_mut().zip(end.groups).for_each(|(group, end)| group.all_visits = end.visits);
        self
    }

    /// The turn of the next step. Every few steps all groups find their shadows anew, each in its
    /// next turn.
    pub fn next(&mut self) -> Turn {
        if self.step.is_multiple_of(self.refresh_every) {
            self.groups.iter_mut().for_each(|group| group.is_stale = true);
        }
        let StepPixels { early, until, late, steps } = self.batch;
        let batch = if self.step as f32 / (steps as f32) < until { early } else { late };
        self.step += 1;
        let due = |number: &usize| f64::from(self.groups[*number].visits + 1) / self.groups[*number].share;
        let with_pixels = (0..self.groups.len()).filter(|number| self.groups[*number].share > 0.0);
        let number = with_pixels.min_by(|a, b| due(a).total_cmp(&due(b))).unwrap_or(0);
        let GroupTurns { pool, visits, visited, all_visits, is_stale, .. } = &mut self.groups[number];
        *visits += 1;
        // Contiguous windows of the shuffled pool, in turn; the last one of a pass through the pool
        // may be shorter.
        let start = *visited % pool.len().max(1);
        let end = (start + batch.max(1)).min(pool.len());
        *visited += end - start;
        Turn {
            group: LightGroup(number as u32),
            rows: pool.start + start..pool.start + end,
            refreshes: std::mem::take(is_stale),
            visit: *visits,
            is_last: *visits + pool.len().div_ceil(late.max(1)) as u32 > *all_visits,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::components::{AdamStep, Moments};
    use lobelia_world::light::groups::{lobes_of_group, spawn_group_lights};
    use lobelia_world::light::lights::own_lobes;

    /// As many pixels in each step.
    fn always(pixels: usize) -> StepPixels {
        StepPixels { early: pixels, late: pixels, until: 0.0, steps: 1 }
    }

    #[test]
    fn groups_have_turns_in_proportion_to_their_pixels() {
        let mut turns = Turns::of(&[6000, 0, 2000], always(1000), 50);
        let taken = [(); 8].map(|()| turns.next());
        let of = |group: u32| taken.iter().filter(|turn| turn.group == LightGroup(group)).collect::<Vec<_>>();
        assert_eq!((of(0).len(), of(1).len(), of(2).len()), (6, 0, 2));
        let rows: Vec<_> = of(0).iter().map(|turn| turn.rows.start).collect();
        assert_eq!(rows, [0, 1000, 2000, 3000, 4000, 5000]);
        assert_eq!(of(2)[1].rows, 7000..8000);
        // Each group sums up its last visit to all of its pixels.
        let mut turns = Turns::of(&[6000, 0, 2000], always(1000), 50).until(20);
        let last: Vec<Turn> = (0..20).map(|_| turns.next()).filter(|turn| turn.is_last).collect();
        let of = |group: u32| -> Vec<u32> {
            last.iter().filter(|turn| turn.group == LightGroup(group)).map(|turn| turn.visit).collect()
        };
        assert_eq!((of(0), of(2)), (vec![10, 11, 12, 13, 14, 15], vec![4, 5]));
        // A few pixels have some turns.
        let mut turns = Turns::of(&[990, 10], always(100), 50);
        let few: Vec<Turn> =
            (0..80).map(|_| turns.next()).filter(|turn| turn.group == LightGroup(1)).collect();
        assert!((8..=12).contains(&few.len()) && few.iter().all(|turn| turn.rows == (990..1000)), "{few:?}");
        // Each group finds its shadows anew once.
        let mut turns = Turns::of(&[500, 500], always(100), 4);
        let refreshes = [(); 6].map(|()| turns.next().refreshes);
        assert_eq!(refreshes, [true, true, false, false, true, true]);
    }

    #[test]
    fn one_group_visits_the_pool_in_windows() {
        let mut turns = Turns::of(&[250], always(100), 50);
        let rows = [(); 4].map(|()| turns.next().rows);
        assert_eq!(rows, [0..100, 100..200, 200..250, 0..100]);
        // The first three steps visit half as many.
        let grows = StepPixels { early: 50, late: 100, until: 0.3, steps: 10 };
        let mut turns = Turns::of(&[250], grows, 50).until(7);
        let taken = [(); 7].map(|()| turns.next());
        let rows = taken.each_ref().map(|turn| turn.rows.clone());
        assert_eq!(rows, [0..50, 50..100, 100..150, 150..250, 0..100, 100..200, 200..250]);
        assert_eq!(taken.iter().position(|turn| turn.is_last), Some(4));
    }

    #[test]
    fn an_exchange_takes_moments_along_and_twice_is_as_before() {
        let mut world = World::new();
        let moments = |gradient: f32| {
            let mut moments = Moments::default();
            AdamStep::new(1.0, 1).advance(&mut moments, &[gradient; 7]);
            LobeMoments(moments)
        };
        LightLobe::even(4).into_iter().for_each(|lobe| _ = world.spawn((lobe, moments(1.0))));
        let other = LightLobe::even(3);
        spawn_group_lights(&mut world, &[(other.clone(), None)]);
        let of_group: Vec<Entity> = world.query_filtered::<Entity, With<LobeOf>>().iter(&world).collect();
        of_group.into_iter().for_each(|lobe| _ = world.entity_mut(lobe).insert(moments(2.0)));
        let before = own_lobes(&mut world);
        exchange_light(&mut world, LightGroup(1));
        assert_eq!(own_lobes(&mut world)[..3], other);
        assert_eq!(lobes_of_group(&mut world, LightGroup(1)), before);
        let own = |world: &mut World| -> Vec<LobeMoments> {
            world.query_filtered::<&LobeMoments, Without<LobeOf>>().iter(world).copied().collect()
        };
        assert_eq!(own(&mut world), [moments(2.0); 4]);
        exchange_light(&mut world, LightGroup(1));
        assert_eq!((own_lobes(&mut world), own(&mut world)), (before.clone(), vec![moments(1.0); 4]));
        exchange_light(&mut world, LightGroup::OWN);
        assert_eq!(own_lobes(&mut world), before);
    }
}
