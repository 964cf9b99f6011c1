//! Stages, schedules and plugins: how a capability joins the pipeline, how one system is swapped for another, and
//! how a system's error reaches the caller.
//!
//! A [`Pipeline`] owns the [`World`] and three schedules ([`Phase`]); each runs its [`Stage`]s in order. A capability is a
//! [`Plugin`] whose `build` names every system it adds. Systems that can be exchanged sit in a [`Slot`]:
//! [`Pipeline::swap`] removes what is in the slot and puts another system there, between runs.

use crate::error::{Error, Result};
use bevy_ecs::error::{BevyError, ErrorContext, FallbackErrorHandler};
use bevy_ecs::prelude::{IntoScheduleConfigs, Schedule, SystemSet, World};
use bevy_ecs::schedule::{InternedSystemSet, ScheduleCleanupPolicy, ScheduleConfigs, ScheduleLabel};
use bevy_ecs::system::ScheduleSystem;
use std::cell::RefCell;
use std::collections::BTreeMap;

/// The stages of a phase, in the order they run.
#[derive(SystemSet, Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Stage {
    /// Chooses pixel samples and their rays.
    Sample,
    /// Finds the surface point of each ray.
    Trace,
    /// Collects what shading reads: albedo at each point, the light, the material.
    Gather,
    /// Writes outgoing radiance.
    Shade,
    /// Compares with the photographs and writes the adjoint of radiance.
    Loss,
    /// Pulls that adjoint back to every parameter.
    Gradient,
    /// Moves the parameters.
    Update,
    /// Gathers samples into pixels.
    Resolve,
    /// Hands finished images over.
    Write,
}

impl Stage {
    const ORDER: [Self; 9] = [
        Self::Sample,
        Self::Trace,
        Self::Gather,
        Self::Shade,
        Self::Loss,
        Self::Gradient,
        Self::Update,
        Self::Resolve,
        Self::Write,
    ];
}

/// The schedules of a pipeline.
#[derive(ScheduleLabel, Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Phase {
    /// Makes the pool of observed pixels a fit visits, once.
    Prepare,
    /// One step of a fit.
    FitStep,
    /// One tile of a picture.
    Frame,
}

impl Phase {
    /// Every phase.
    pub const ALL: [Self; 3] = [Self::Prepare, Self::FitStep, Self::Frame];
}

/// Places for exactly one exchangeable system, each inside its stage.
#[derive(SystemSet, Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Slot {
    /// What the light is: SG lobes or an environment map (in [`Stage::Gather`]).
    Light,
    /// What the object hides from itself (in [`Stage::Gather`], after the light and the points).
    Visibility,
    /// How points are shaded: SG formulas or path tracing (in [`Stage::Shade`]).
    Shading,
    /// How light and material move (in [`Stage::Update`]).
    Optimizer,
    /// The samples' rays, through cameras that move (in [`Stage::Trace`]).
    Recast,
    /// Where the samples' rays meet the surface, if one of them moves (in [`Stage::Trace`], after that).
    Retrace,
    /// How the samples' adjoints reach a surface that moves (in [`Stage::Gradient`], at its end).
    ShapeGradient,
    /// How the surface moves (in [`Stage::Update`]).
    ShapeUpdate,
    /// What the samples say of the cameras (in [`Stage::Gradient`]).
    CameraGradient,
    /// How the cameras move (in [`Stage::Update`]).
    CameraUpdate,
}

impl Slot {
    fn stage(self) -> Stage {
        match self {
            Self::Light | Self::Visibility => Stage::Gather,
            Self::Shading => Stage::Shade,
            Self::Recast | Self::Retrace => Stage::Trace,
            Self::ShapeGradient | Self::CameraGradient => Stage::Gradient,
            Self::Optimizer | Self::ShapeUpdate | Self::CameraUpdate => Stage::Update,
        }
    }
}

/// A capability: adds its systems, resources and components to a pipeline.
pub trait Plugin {
    /// Names every system, stage and resource the capability adds.
    fn build(&self, pipeline: &mut Pipeline);
}

/// What a fallible system returns; `?` takes the crate's [`Error`].
pub type SystemResult = std::result::Result<(), BevyError>;

thread_local! {
    /// The first error of the schedule now running on this thread (systems run on the thread that runs the schedule).
    static FAILURE: RefCell<Option<Error>> = const { RefCell::new(None) };
}

/// Keeps the first error; later systems of the run are skipped.
fn record_failure(error: BevyError, context: ErrorContext) {
    let ours = error.downcast_ref::<Error>().cloned();
    let error = ours.unwrap_or_else(|| Error::run(context.name().to_string(), error.to_string()));
    FAILURE.with_borrow_mut(|first| {
        first.get_or_insert(error);
    });
}

fn nothing_failed() -> bool {
    FAILURE.with_borrow(Option::is_none)
}

/// A world and its schedules.
pub struct Pipeline {
    /// All entities, components and resources.
    pub world: World,
    schedules: BTreeMap<Phase, Schedule>,
}

impl Default for Pipeline {
    fn default() -> Self {
        Self::new()
    }
}

impl Pipeline {
    /// An empty world with empty schedules.
    pub fn new() -> Self {
        let mut world = World::new();
        world.insert_resource(FallbackErrorHandler(record_failure));
        let schedules = Phase::ALL.map(|phase| (phase, new_schedule(phase))).into_iter().collect();
        Self { world, schedules }
    }

    /// Builds a plugin into the pipeline.
    pub fn add_plugin(&mut self, plugin: &impl Plugin) -> &mut Self {
        plugin.build(self);
        self
    }

    /// Adds systems to a stage of a phase.
    pub fn add_systems<M>(
        &mut self,
        phase: Phase,
        stage: Stage,
        systems: impl IntoScheduleConfigs<ScheduleSystem, M>,
    ) -> &mut Self {
        self.add_to(phase, systems.in_set(stage))
    }

    /// Puts `system` into `slot`, in place of what was there before.
    pub fn swap<M>(
        &mut self,
        phase: Phase,
        slot: Slot,
        system: impl IntoScheduleConfigs<ScheduleSystem, M>,
    ) -> &mut Self {
        self.clear(phase, slot);
        self.add_to(phase, system.in_set(slot).in_set(slot.stage()))
    }

    /// Takes what is in `slot` out of it.
    pub fn clear(&mut self, phase: Phase, slot: Slot) -> &mut Self {
        let schedule = self.schedules.get_mut(&phase).expect("every phase has a schedule");
        // The graph must be built before it can be taken apart. An empty slot is not an error.
        let removed = schedule.initialize(&mut self.world).map(|_| {
            schedule.remove_systems_in_set(slot, &mut self.world, ScheduleCleanupPolicy::RemoveSystemsOnly)
        });
        debug_assert!(matches!(removed, Ok(Ok(_))), "slot {slot:?}: {removed:?}");
        self
    }

    fn add_to<M>(&mut self, phase: Phase, systems: impl IntoScheduleConfigs<ScheduleSystem, M>) -> &mut Self {
        let schedule = self.schedules.get_mut(&phase).expect("every phase has a schedule");
        schedule.add_systems(systems.distributive_run_if(nothing_failed));
        self
    }

    /// Runs a phase once.
    ///
    /// # Errors
    /// The first error any of its systems returned; the systems after it were skipped.
    pub fn run(&mut self, phase: Phase) -> Result<()> {
        FAILURE.set(None);
        self.schedules.get_mut(&phase).expect("every phase has a schedule").run(&mut self.world);
        FAILURE.take().map_or(Ok(()), Err)
    }
}

/// A schedule whose stages run in order, on the calling thread: systems are parallel inside, over slices.
fn new_schedule(phase: Phase) -> Schedule {
    let mut schedule = Schedule::new(phase);
    let sets: Vec<ScheduleConfigs<InternedSystemSet>> =
        Stage::ORDER.into_iter().map(IntoScheduleConfigs::into_configs).collect();
    for pair in Stage::ORDER.windows(2) {
        schedule.configure_sets(pair[0].before(pair[1]));
    }
    for set in sets {
        schedule.configure_sets(set);
    }
    schedule.configure_sets((
        Slot::Light.in_set(Stage::Gather),
        Slot::Visibility.in_set(Stage::Gather).after(Slot::Light),
        Slot::Shading.in_set(Stage::Shade),
        Slot::Optimizer.in_set(Stage::Update),
        Slot::Recast.in_set(Stage::Trace),
        Slot::Retrace.in_set(Stage::Trace).after(Slot::Recast),
        Slot::ShapeGradient.in_set(Stage::Gradient),
        Slot::ShapeUpdate.in_set(Stage::Update),
        Slot::CameraGradient.in_set(Stage::Gradient),
        Slot::CameraUpdate.in_set(Stage::Update),
    ));
    schedule
}

#[cfg(test)]
mod tests {
    use super::*;
    use bevy_ecs::prelude::{ResMut, Resource};

    #[derive(Resource, Default)]
    struct Trail(Vec<&'static str>);

    fn sample(mut trail: ResMut<Trail>) {
        trail.0.push("sample");
    }
    fn shade(mut trail: ResMut<Trail>) {
        trail.0.push("shade");
    }
    fn shade_otherwise(mut trail: ResMut<Trail>) {
        trail.0.push("otherwise");
    }
    fn write(mut trail: ResMut<Trail>) {
        trail.0.push("write");
    }
    fn fail() -> SystemResult {
        Err(Error::input("a.png", "pixel (3, 4)", "not finite", "mask it").into())
    }

    fn pipeline() -> Pipeline {
        let mut pipeline = Pipeline::new();
        pipeline.world.init_resource::<Trail>();
        pipeline.add_systems(Phase::Frame, Stage::Write, write).add_systems(
            Phase::Frame,
            Stage::Sample,
            sample,
        );
        pipeline.swap(Phase::Frame, Slot::Shading, shade);
        pipeline
    }

    #[test]
    fn stages_run_in_order_and_slots_can_be_swapped() -> Result<()> {
        let mut pipeline = pipeline();
        pipeline.run(Phase::Frame)?;
        pipeline.swap(Phase::Frame, Slot::Shading, shade_otherwise);
        pipeline.run(Phase::Frame)?;
        pipeline.swap(Phase::Frame, Slot::Shading, shade);
        pipeline.run(Phase::Frame)?;
        let trail = &pipeline.world.resource::<Trail>().0;
        assert_eq!(trail.join(" "), "sample shade write sample otherwise write sample shade write");
        Ok(())
    }

    #[test]
    fn a_system_error_stops_the_run_and_reaches_the_caller_whole() {
        let mut pipeline = pipeline();
        pipeline.swap(Phase::Frame, Slot::Shading, fail);
        let error = pipeline.run(Phase::Frame).expect_err("the system fails");
        assert_eq!(error.to_string(), "a.png, pixel (3, 4): not finite");
        assert_eq!(error.help(), Some("mask it"));
        assert_eq!(error.exit_code(), 2);
        assert_eq!(pipeline.world.resource::<Trail>().0, ["sample"]);
        pipeline.swap(Phase::Frame, Slot::Shading, shade);
        assert!(pipeline.run(Phase::Frame).is_ok(), "the pipeline goes on after the cause is gone");
    }

    #[test]
    fn a_missing_resource_is_an_error_not_a_panic() {
        let mut pipeline = Pipeline::new();
        pipeline.add_systems(Phase::Frame, Stage::Sample, sample);
        let error = pipeline.run(Phase::Frame).expect_err("there is no Trail");
        assert_eq!(error.exit_code(), 1);
        assert!(error.to_string().contains("sample"), "{error}");
    }
}
