//! Phases, stages, slots and plugins: adding capabilities to the pipeline, swapping systems,
//! access to pools of entities as slices, and propagation of errors to the caller.
//!
//! A [`Pipeline`] is a [`World`] with one schedule for each [`Phase`]; a phase runs its [`Stage`]s in order. A capability is a
//! [`Plugin`] whose `build` adds all its systems; it can be removed again. A system with alternatives is in a
//! slot: [`Pipeline::swap`] replaces it by another system, between runs.
//!
//! The schedules are in the world's [`Schedules`] resource, which bevy's tools use.
//!
//! | module | holds |
//! | --- | --- |
//! | [`stage`] | [`Phase`], [`Stage`], [`Slot`], [`SlotLabel`], and the sets between the slots |
//! | [`pool`] | [`Pool`](pool::Pool): many entities whose columns kernels read as slices |

mod failure;
pub mod pool;
pub mod stage;

#[cfg(test)]
mod tests;

pub use stage::{GatherPoints, Phase, ScatterAdjoints, Slot, SlotLabel, Stage};

use crate::error::{Error, Result};
use bevy_ecs::error::BevyError;
use bevy_ecs::prelude::{IntoScheduleConfigs, Schedule, Schedules, SystemCondition, SystemSet, World};
use bevy_ecs::schedule::{
    InternedScheduleLabel, InternedSystemSet, ScheduleCleanupPolicy, ScheduleLabel, SingleThreadedExecutor,
};
use bevy_ecs::system::ScheduleSystem;
use failure::{Failure, nothing_failed};
use std::any::TypeId;

/// A capability: adds its systems, resources and components to a pipeline.
pub trait Plugin: 'static {
    /// Adds every system, set and resource of the capability.
    fn build(&self, pipeline: &mut Pipeline);

    /// Removes from the world what `build` inserted, after the systems are removed.
    fn cleanup(_world: &mut World)
    where
        Self: Sized,
    {
    }
}

/// The return type of a fallible system; `?` converts the crate's [`Error`].
pub type SystemResult = std::result::Result<(), BevyError>;

/// The set of all systems of a plugin, by the type of the plugin.
#[derive(SystemSet, Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct AddedBy(TypeId);

/// A function that is called after a run that failed.
struct MarkAfterFailure {
    mark: fn(&mut World),
    /// The plugins that were being built when it was given.
    of: Vec<TypeId>,
}

/// A plugin that is in the pipeline.
struct Added {
    plugin: TypeId,
    /// The plugins that added it, outermost first.
    inside: Vec<TypeId>,
    cleanup: fn(&mut World),
}

/// A set around a stage, for one condition of that type. A stage itself keeps none: in `bevy_ecs`, conditions that are added to a set
/// which has some, after a run, are lost.
#[derive(SystemSet, Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct StageIf(Stage, TypeId);

/// A world and its phases.
pub struct Pipeline {
    /// All entities, components, resources and schedules.
    pub world: World,
    /// The plugins that are being built, outermost first.
    building: Vec<TypeId>,
    /// The plugins that were added and not removed, in the order in which they were.
    added: Vec<Added>,
    marks: Vec<MarkAfterFailure>,
    /// The conditions of stages, by phase.
    conditions: Vec<(InternedScheduleLabel, StageIf)>,
}

impl Default for Pipeline {
    fn default() -> Self {
        Self::new()
    }
}

impl Pipeline {
    /// A pipeline with an empty world and the built-in phases, without systems.
    pub fn new() -> Self {
        let mut pipeline = Self {
            world: World::new(),
            building: Vec::new(),
            added: Vec::new(),
            marks: Vec::new(),
            conditions: Vec::new(),
        };
        for phase in Phase::ALL {
            pipeline.add_phase(phase);
        }
        pipeline
    }

    /// Adds a custom phase with all stages and slots. Its systems run one after another on the calling thread (they are
    /// parallel inside, over slices); [`Self::schedule_mut`] can give it another executor.
    pub fn add_phase(&mut self, phase: impl ScheduleLabel) -> &mut Self {
        let mut schedule = Schedule::new(phase);
        schedule.set_executor(SingleThreadedExecutor::new());
        stage::configure(&mut schedule);
        self.world.get_resource_or_init::<Schedules>().insert(schedule);
        self
    }

    /// The schedule of a phase, for ordering custom sets or changing the executor.
    ///
    /// # Panics
    /// If there is no such phase.
    pub fn schedule_mut(&mut self, phase: impl ScheduleLabel) -> &mut Schedule {
        let label = phase.intern();
        let schedules = self.world.resource_mut::<Schedules>().into_inner();
        schedules
            .get_mut(label)
            .unwrap_or_else(|| panic!("there is no phase {label:?}: add it with add_phase"))
    }

    /// Builds a plugin into the pipeline. One of the same type that is there already is removed first, so that no system runs twice; what it
    /// brought is from then on the new one's, also if another plugin had added the first.
    pub fn add_plugin<P: Plugin>(&mut self, plugin: &P) -> &mut Self {
        let own = TypeId::of::<P>();
        if self.added.iter().any(|added| added.plugin == own) {
            self.remove_plugin::<P>();
        }
        self.added.push(Added { plugin: own, inside: self.building.clone(), cleanup: P::cleanup });
        self.building.push(own);
        plugin.build(self);
        self.building.pop();
        self
    }

    /// Removes every system that a plugin of this type has added (and those of plugins that it added), then runs [`Plugin::cleanup`], that
    /// of inner plugins first. Slots that it filled are empty afterward.
    pub fn remove_plugin<P: Plugin>(&mut self) -> &mut Self {
        let own = TypeId::of::<P>();
        let schedules = self.world.resource::<Schedules>();
        let phases: Vec<InternedScheduleLabel> = schedules.iter().map(|(_, s)| s.label()).collect();
        for phase in phases {
            self.remove_systems(phase, AddedBy(own).intern());
        }
        self.marks.retain(|mark| !mark.of.contains(&own));
        let is_removed = |added: &mut Added| added.plugin == own || added.inside.contains(&own);
        let removed: Vec<Added> = self.added.extract_if(.., is_removed).collect();
        let inner = removed.iter().rev().filter(|removed| removed.plugin != own);
        inner.for_each(|inner| (inner.cleanup)(&mut self.world));
        P::cleanup(&mut self.world);
        self
    }

    /// Adds systems to a stage of a phase.
    pub fn add_systems<M>(
        &mut self,
        phase: impl ScheduleLabel,
        stage: Stage,
        systems: impl IntoScheduleConfigs<ScheduleSystem, M>,
    ) -> &mut Self {
        let mut systems = systems.in_set(stage);
        for plugin in &self.building {
            systems = systems.in_set(AddedBy(*plugin));
        }
        self.schedule_mut(phase).add_systems(systems.distributive_run_if(nothing_failed));
        self
    }

    /// Puts `system` into `slot` and removes the previous system.
    pub fn swap<M>(
        &mut self,
        phase: impl ScheduleLabel,
        slot: impl SlotLabel,
        system: impl IntoScheduleConfigs<ScheduleSystem, M>,
    ) -> &mut Self {
        let phase = phase.intern();
        self.clear(phase, slot.clone());
        let stage = slot.stage();
        self.add_systems(phase, stage, system.in_set(slot))
    }

    /// Removes the system in `slot`.
    pub fn clear(&mut self, phase: impl ScheduleLabel, slot: impl SlotLabel) -> &mut Self {
        self.remove_systems(phase.intern(), slot.intern());
        self
    }

    /// Removes the systems of a set, if any.
    fn remove_systems(&mut self, phase: InternedScheduleLabel, set: InternedSystemSet) {
        let removed = self.world.try_schedule_scope(phase, |world, schedule| {
            // The graph must be built before systems can be removed. A set that is not in the graph is not an error.
            schedule
                .initialize(world)
                .map(|_| schedule.remove_systems_in_set(set, world, ScheduleCleanupPolicy::RemoveSystemsOnly))
        });
        debug_assert!(matches!(removed, Ok(Ok(_))), "{phase:?} {set:?}: {removed:?}");
    }

    /// Lets a stage of a phase run only if `condition` holds, also what other plugins put into that stage. A stage has each condition
    /// once, however often it is given one, and keeps it: `condition` must hold where the plugin that gave it is removed.
    ///
    /// # Panics
    /// If there is no such phase.
    pub fn run_stage_if<M, C: SystemCondition<M> + 'static>(
        &mut self,
        phase: impl ScheduleLabel,
        stage: Stage,
        condition: C,
    ) -> &mut Self {
        let (phase, around) = (phase.intern(), StageIf(stage, TypeId::of::<C>()));
        if !self.conditions.contains(&(phase, around)) {
            self.schedule_mut(phase).configure_sets((around.run_if(condition), stage.in_set(around)));
            self.conditions.push((phase, around));
        }
        self
    }

    /// Has `mark` called after every run that fails, until the plugin that is being built is removed. Conditions of skipped systems are
    /// evaluated all the same and then hold the changes they saw for dealt with: `mark` marks what such systems read as changed.
    pub fn mark_after_failure(&mut self, mark: fn(&mut World)) -> &mut Self {
        self.marks.push(MarkAfterFailure { mark, of: self.building.clone() });
        self
    }

    fn after_failure(&mut self) {
        let mut called: Vec<fn(&mut World)> = Vec::new();
        for MarkAfterFailure { mark, .. } in &self.marks {
            if !called.iter().any(|known| std::ptr::fn_addr_eq(*known, *mark)) {
                called.push(*mark);
                mark(&mut self.world);
            }
        }
    }

    /// Runs a phase once. As in an update of a bevy app, what was removed can be read (`RemovedComponents`) until the end of the
    /// next run but one.
    ///
    /// During the run the world's error handler is the pipeline's; afterward it is again what it was before. At most 16 runs of a
    /// process go on at once, others wait for one of them to end. A run that a system starts inside another one counts as well: 16 runs
    /// that each start one inside at the same time wait for each other forever.
    ///
    /// # Errors
    /// The first error of a system, from any thread; the systems after it are skipped.
    /// [`Error::Run`] if there is no such phase.
    pub fn run(&mut self, phase: impl ScheduleLabel) -> Result<()> {
        match self.run_watched(phase.intern())? {
            None => Ok(()),
            Some(error) => {
                self.after_failure();
                Err(error)
            }
        }
    }

    /// Runs a phase once; returns the first error of a system.
    fn run_watched(&mut self, phase: InternedScheduleLabel) -> Result<Option<Error>> {
        let failure = Failure::watch(&mut self.world);
        failure.world.try_run_schedule(phase).map_err(|_| {
            Error::run("pipeline", format!("there is no phase {phase:?}: add it with add_phase"))
        })?;
        // Otherwise the messages of every despawned sample's components pile up: some hundred bytes a sample of every picture.
        failure.world.clear_trackers();
        Ok(failure.first())
    }
}
