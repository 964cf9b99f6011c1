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
use bevy_ecs::prelude::{IntoScheduleConfigs, Resource, Schedule, Schedules, SystemSet, World};
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

/// What is called after a run that failed.
#[derive(Resource, Default)]
struct MarkAfterFailure(Vec<fn(&mut World)>);

/// A world and its phases.
pub struct Pipeline {
    /// All entities, components, resources and schedules.
    pub world: World,
    /// The plugins that are being built, outermost first.
    building: Vec<TypeId>,
}

impl Default for Pipeline {
    fn default() -> Self {
        Self::new()
    }
}

impl Pipeline {
    /// A pipeline with an empty world and the built-in phases, without systems.
    pub fn new() -> Self {
        let mut pipeline = Self { world: World::new(), building: Vec::new() };
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

    /// Builds a plugin into the pipeline.
    pub fn add_plugin<P: Plugin>(&mut self, plugin: &P) -> &mut Self {
        self.building.push(TypeId::of::<P>());
        plugin.build(self);
        self.building.pop();
        self
    }

    /// Removes every system that a plugin of this type has added (and those of plugins that it added), then runs [`Plugin::cleanup`].
    /// Slots that it filled are empty afterward.
    pub fn remove_plugin<P: Plugin>(&mut self) -> &mut Self {
        let schedules = self.world.resource::<Schedules>();
        let phases: Vec<InternedScheduleLabel> = schedules.iter().map(|(_, s)| s.label()).collect();
        for phase in phases {
            self.remove_systems(phase, AddedBy(TypeId::of::<P>()).intern());
        }
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

    /// Has `mark` called after every run that fails. Conditions of skipped systems are evaluated all the same and then hold the changes
    /// they saw for dealt with: `mark` marks what such systems read as changed.
    pub fn mark_after_failure(&mut self, mark: fn(&mut World)) -> &mut Self {
        let marks = &mut self.world.get_resource_or_init::<MarkAfterFailure>().0;
        if !marks.iter().any(|known| std::ptr::fn_addr_eq(*known, mark)) {
            marks.push(mark);
        }
        self
    }

    fn after_failure(&mut self) {
        let marks = self.world.get_resource::<MarkAfterFailure>().map(|marks| marks.0.clone());
        marks.unwrap_or_default().into_iter().for_each(|mark| mark(&mut self.world));
    }

    /// Runs a phase once. As in an update of a bevy app, what was removed can be read (`RemovedComponents`) until the end of the
    /// next run but one.
    ///
    /// # Errors
    /// The first error of a system, from any thread; the systems after it are skipped.
    /// [`Error::Run`] if there is no such phase.
    pub fn run(&mut self, phase: impl ScheduleLabel) -> Result<()> {
        let label = phase.intern();
        let failure = Failure::watch(&mut self.world);
        self.world.try_run_schedule(label).map_err(|_| {
            Error::run("pipeline", format!("there is no phase {label:?}: add it with add_phase"))
        })?;
        // Otherwise the messages of every despawned sample's components pile up: some hundred bytes a sample of every picture.
        self.world.clear_trackers();
        match failure.first() {
            None => Ok(()),
            Some(error) => {
                self.after_failure();
                Err(error)
            }
        }
    }
}
