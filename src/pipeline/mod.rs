//! Phases, stages, slots and plugins: how a capability joins the pipeline, how one system is exchanged for another, how
//! systems see pools of entities as slices, and how a system's error reaches the caller.
//!
//! A [`Pipeline`] is a [`World`] with one schedule for each [`Phase`]; a phase runs its [`Stage`]s in order. A capability is a
//! [`Plugin`] whose `build` names every system it adds; it can be removed again. What is one of several choices sits in a
//! slot: [`Pipeline::swap`] takes out what is there and puts another system in, between runs.
//!
//! The schedules lie in the world's [`Schedules`] resource, where bevy's own tools find them.
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
use bevy_ecs::prelude::{IntoScheduleConfigs, Schedule, Schedules, SystemSet, World};
use bevy_ecs::schedule::{
    InternedScheduleLabel, InternedSystemSet, ScheduleCleanupPolicy, ScheduleLabel, SingleThreadedExecutor,
};
use bevy_ecs::system::ScheduleSystem;
use failure::{Failure, nothing_failed};
use std::any::TypeId;

/// A capability: adds its systems, resources and components to a pipeline.
pub trait Plugin: 'static {
    /// Names every system, set and resource the capability adds.
    fn build(&self, pipeline: &mut Pipeline);

    /// Takes out of the world what `build` put there, once the systems are gone.
    fn cleanup(_world: &mut World)
    where
        Self: Sized,
    {
    }
}

/// What a fallible system returns; `?` takes the crate's [`Error`].
pub type SystemResult = std::result::Result<(), BevyError>;

/// The set of all systems that a plugin has added, by the plugin's type.
#[derive(SystemSet, Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct AddedBy(TypeId);

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
    /// An empty world with the built-in phases, empty.
    pub fn new() -> Self {
        let mut pipeline = Self { world: World::new(), building: Vec::new() };
        for phase in Phase::ALL {
            pipeline.add_phase(phase);
        }
        pipeline
    }

    /// Adds a phase of one's own with all stages and slots. Its systems run one after another on the calling thread (they are
    /// parallel inside, over slices); [`Self::schedule_mut`] can give it another executor.
    pub fn add_phase(&mut self, phase: impl ScheduleLabel) -> &mut Self {
        let mut schedule = Schedule::new(phase);
        schedule.set_executor(SingleThreadedExecutor::new());
        stage::configure(&mut schedule);
        self.world.get_resource_or_init::<Schedules>().insert(schedule);
        self
    }

    /// The schedule of a phase: to order sets of one's own, or to exchange its executor.
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

    /// Removes every system that a plugin of this type has added (those of plugins that it added, too), then what it put into the world.
    /// Slots that it filled are empty afterwards.
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

    /// Puts `system` into `slot`, in place of what was there before.
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

    /// Takes what is in `slot` out of it.
    pub fn clear(&mut self, phase: impl ScheduleLabel, slot: impl SlotLabel) -> &mut Self {
        self.remove_systems(phase.intern(), slot.intern());
        self
    }

    /// Removes the systems of a set, if there are any.
    fn remove_systems(&mut self, phase: InternedScheduleLabel, set: InternedSystemSet) {
        let removed = self.world.try_schedule_scope(phase, |world, schedule| {
            // The graph is built before it can be taken apart. That the set is not in it is no error.
            schedule
                .initialize(world)
                .map(|_| schedule.remove_systems_in_set(set, world, ScheduleCleanupPolicy::RemoveSystemsOnly))
        });
        debug_assert!(matches!(removed, Ok(Ok(_))), "{phase:?} {set:?}: {removed:?}");
    }

    /// Runs a phase once. As in an update of a bevy app, what was removed can be read (`RemovedComponents`) until the end of the
    /// next run but one.
    ///
    /// # Errors
    /// The first error any of its systems returned, on whichever thread; the systems after it are skipped.
    /// [`Error::Run`] if there is no such phase.
    pub fn run(&mut self, phase: impl ScheduleLabel) -> Result<()> {
        let label = phase.intern();
        let failure = Failure::watch(&mut self.world);
        self.world.try_run_schedule(label).map_err(|_| {
            Error::run("pipeline", format!("there is no phase {label:?}: add it with add_phase"))
        })?;
        // Otherwise the messages of every despawned sample's components pile up: some hundred bytes a sample of every picture.
        self.world.clear_trackers();
        failure.first().map_or(Ok(()), Err)
    }
}
