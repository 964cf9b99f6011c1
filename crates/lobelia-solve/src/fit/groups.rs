//! Lights that take turns: photographs of several [groups](lobelia_world::light::groups), each
//! under a light of its own.
//!
//! A step visits the photographs of one group, the [`GroupInTurn`], whose light is that of the step.
//! Groups have turns in proportion to their pixels. Albedo and materials are common to all, and so
//! is the scale between light and albedo.

use crate::visibility::ObjectVisibility;
use bevy_ecs::prelude::{With, World};
use lobelia_geometry::view::{ByView, Placement, ViewIndex};
use lobelia_world::light::groups::light_groups;
use lobelia_world::light::placement::{GroupInTurn, LightGroup, Placements};
use lobelia_world::sample::{Observation, ObservationIndex};
use std::ops::Range;

/// Least share of the steps that a group has, relative to an equal share.
const LEAST_SHARE: f64 = 0.25;

/// Lets the scene's own light shine again, and forgets shadows and reflected light under those of
/// groups.
pub(super) fn end_turns(world: &mut World) {
    world.remove_resource::<GroupInTurn>();
    if let Some(mut object) = world.get_resource_mut::<ObjectVisibility>() {
        object.forget_turns();
    }
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
}
