//! Phases, stages, slots and plugins: adding capabilities to the pipeline, swapping systems,
//! access to pools of entities as slices, and propagation of errors to the caller.
//!
//! A [`Pipeline`] is a [`World`] with one schedule for each [`Phase`]; a phase runs its [`Stage`]s
//! in order. A capability is a [`Plugin`] whose `build` adds all its systems, once and for good;
//! those that are needed only sometimes have a run condition. A system with alternatives is in a
//! [`Slot`]: [`Pipeline::swap`] replaces it by another system, between runs.
//!
//! A phase is a schedule, a stage is an ordered set in it, a slot is a set for one exchangeable
//! system. Phases are open: any [`ScheduleLabel`] can be one ([`Pipeline::add_phase`]). The
//! schedules are in the world's [`Schedules`] resource, which bevy's tools use. [`pool`] gives
//! kernels the columns of many entities as slices.
//!
//! ```
//! use bevy_ecs::prelude::{ResMut, Resource};
//! use lobelia_world::pipeline::{Phase, Pipeline, Slot, Stage};
//!
//! #[derive(Resource, Default)]
//! struct Trail(Vec<&'static str>);
//!
//! let mut pipeline = Pipeline::new();
//! pipeline.world.init_resource::<Trail>();
//! pipeline
//!     .add_systems(Phase::Frame, Stage::Write, |mut trail: ResMut<Trail>| trail.0.push("write"))
//!     .swap(Phase::Frame, Slot::Shading, |mut trail: ResMut<Trail>| trail.0.push("shade"));
//! pipeline.run(Phase::Frame)?;
//! assert_eq!(pipeline.world.resource::<Trail>().0, ["shade", "write"]);
//! # Ok::<(), lobelia_geometry::Error>(())
//! ```

pub mod pool;

#[cfg(test)]
mod tests;

use crate::material::shown::mark_material_changed;
use bevy_ecs::error::{BevyError, ErrorContext, FallbackErrorHandler};
use bevy_ecs::prelude::{IntoScheduleConfigs, Resource, Schedule, Schedules, SystemSet, World};
use bevy_ecs::schedule::{
    InternedSystemSet, ScheduleCleanupPolicy, ScheduleConfigs, ScheduleLabel, SingleThreadedExecutor,
};
use bevy_ecs::system::ScheduleSystem;
use lobelia_geometry::{Error, Result};
use lobelia_sg::shading::ClosedForm;
use std::{any::TypeId, cell::RefCell, collections::HashSet};

/// The stages of a phase, in the order they run.
#[derive(SystemSet, Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Stage {
    /// Selects pixel samples and their rays.
    Sample,
    /// Finds the surface point of each ray.
    Trace,
    /// Collects the inputs of shading: light, material, albedo at each point, visibility.
    Gather,
    /// Writes outgoing radiance.
    Shade,
    /// Compares with the photographs and writes the adjoint of radiance.
    Loss,
    /// Propagates that adjoint back to every parameter.
    Gradient,
    /// Updates the parameters.
    Update,
    /// Sums samples into pixels.
    Resolve,
    /// Outputs finished images. The built-in plugins leave it empty.
    Write,
}

/// The built-in phases.
#[derive(ScheduleLabel, Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Phase {
    /// Builds the pool of observed pixels of a fit, once.
    Prepare,
    /// One step of a fit.
    FitStep,
    /// Some pixels of the training photographs, which say what is left to change of their texels.
    Detail,
    /// The material and light that a picture shows, before its tiles.
    Compose,
    /// One tile of a picture.
    Frame,
}

/// A set for one exchangeable system (or chain of systems, or several of which run conditions choose
/// one), inside a stage.
#[derive(SystemSet, Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Slot {
    /// The shown material: the recovered one, edited or unchanged (in [`Stage::Gather`], first).
    Material,
    /// The active light: lobes of one light, or an environment map (in [`Stage::Gather`], after the
    /// material).
    Light,
    /// Shadows and interreflection of the object (in [`Stage::Gather`], last).
    Visibility,
    /// Shading of points: a closed form or path tracing (in [`Stage::Shade`]).
    Shading,
    /// The adjoint of shading (in [`Stage::Gradient`], first).
    ShadingAdjoint,
    /// Optimizer of light and material (in [`Stage::Update`]).
    Optimizer,
    /// The rays of silhouettes, if cameras are optimized (in [`Stage::Trace`]).
    Recast,
    /// The surface points of samples, if rays or surface change (in [`Stage::Trace`], after
    /// [`Slot::Recast`]).
    Retrace,
    /// The adjoint of a surface that is optimized (in [`Stage::Gradient`], last).
    ShapeGradient,
    /// Optimizer of the surface (in [`Stage::Update`]).
    ShapeUpdate,
    /// The normal equations of the cameras (in [`Stage::Gradient`]).
    CameraGradient,
    /// Optimizer of the cameras (in [`Stage::Update`]).
    CameraUpdate,
}

impl Slot {
    /// All slots, in order, with their stages.
    const STAGES: [(Self, Stage); 12] = [
        (Self::Material, Stage::Gather),
        (Self::Light, Stage::Gather),
        (Self::Visibility, Stage::Gather),
        (Self::Shading, Stage::Shade),
        (Self::ShadingAdjoint, Stage::Gradient),
        (Self::Optimizer, Stage::Update),
        (Self::Recast, Stage::Trace),
        (Self::Retrace, Stage::Trace),
        (Self::ShapeGradient, Stage::Gradient),
        (Self::ShapeUpdate, Stage::Update),
        (Self::CameraGradient, Stage::Gradient),
        (Self::CameraUpdate, Stage::Update),
    ];

    /// The stage that it belongs to.
    pub fn stage(self) -> Stage {
        Self::STAGES[self as usize].1
    }
}

/// The systems of the Gather stage between its slots: interpolation of texels at surface points,
/// base materials in columns.
#[derive(SystemSet, Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct GatherPoints;

/// The systems of the Gradient stage between [`Slot::ShadingAdjoint`] and [`Slot::ShapeGradient`]:
/// sums of the adjoints of samples per texel, lobe and base material.
#[derive(SystemSet, Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct ScatterAdjoints;

/// A capability: adds its systems, resources and components to a pipeline.
pub trait Plugin: 'static {
    /// Adds every system, set and resource of the capability.
    fn build(&self, pipeline: &mut Pipeline);
}

/// A shader: the system that shades, and its adjoint, which a fit needs.
pub struct Shader {
    /// Writes the radiance of samples, for [`Slot::Shading`].
    pub forward: ScheduleConfigs<ScheduleSystem>,
    /// Pulls the adjoint of radiance back to samples, light and material, for
    /// [`Slot::ShadingAdjoint`].
    pub adjoint: Option<ScheduleConfigs<ScheduleSystem>>,
    /// The closed form that it is, or that is nearest to it: a fit needs one beside its steps, as
    /// where it initializes.
    pub form: ClosedForm,
}

impl Shader {
    /// A shader without adjoint, for pictures.
    pub fn new<M>(forward: impl IntoScheduleConfigs<ScheduleSystem, M>) -> Self {
        Self { forward: forward.into_configs(), adjoint: None, form: ClosedForm::default() }
    }

    /// The shader with an adjoint, for fits.
    pub fn with_adjoint<M>(self, adjoint: impl IntoScheduleConfigs<ScheduleSystem, M>) -> Self {
        Self { adjoint: Some(adjoint.into_configs()), ..self }
    }
}

/// [`Shader::form`] of the shader in [`Phase::FitStep`].
#[derive(Resource, Clone, Copy, Debug, Default, PartialEq)]
pub struct FitForm(pub ClosedForm);

/// The return type of a fallible system; `?` converts the crate's [`Error`].
pub type SystemResult = std::result::Result<(), BevyError>;

thread_local! {
    /// The first error of the innermost run on this thread. bevy's error handler is a function
    /// pointer without access to the world or the run; but all systems of a phase run on the thread
    /// that runs the phase.
    static FIRST_ERROR: RefCell<Option<Error>> = const { RefCell::new(None) };
}

/// The error handler of a run: notes the first error.
fn note_error(error: BevyError, context: ErrorContext) {
    let ours = error.downcast_ref::<Error>().cloned();
    let error = ours.unwrap_or_else(|| Error::run(context.name().to_string(), error.to_string()));
    FIRST_ERROR.with_borrow_mut(|first| _ = first.get_or_insert(error));
}

/// Run condition of every system: no system has failed in this run.
fn nothing_failed() -> bool {
    FIRST_ERROR.with_borrow(Option::is_none)
}

/// A world and its phases.
pub struct Pipeline {
    /// All entities, components, resources and schedules.
    pub world: World,
    /// The plugins that were added.
    plugins: HashSet<TypeId>,
}

impl Default for Pipeline {
    fn default() -> Self {
        Self::new()
    }
}

impl Pipeline {
    /// A pipeline with an empty world and the built-in phases, without systems.
    pub fn new() -> Self {
        let mut pipeline = Self { world: World::new(), plugins: HashSet::new() };
        for phase in [Phase::Prepare, Phase::FitStep, Phase::Detail, Phase::Compose, Phase::Frame] {
            pipeline.add_phase(phase);
        }
        pipeline
    }

    /// Adds a custom phase with all stages and slots. Its systems run one after another on the
    /// calling thread; they are parallel inside, over slices.
    pub fn add_phase(&mut self, phase: impl ScheduleLabel) -> &mut Self {
        use Stage::*;
        let mut schedule = Schedule::new(phase);
        schedule.set_executor(SingleThreadedExecutor::new());
        schedule
            .configure_sets((Sample, Trace, Gather, Shade, Loss, Gradient, Update, Resolve, Write).chain());
        for (slot, stage) in Slot::STAGES {
            schedule.configure_sets(slot.in_set(stage));
        }
        schedule.configure_sets((
            (Slot::Material, Slot::Light, GatherPoints.in_set(Gather), Slot::Visibility).chain(),
            (Slot::Recast, Slot::Retrace).chain(),
            (Slot::ShadingAdjoint, ScatterAdjoints.in_set(Gradient), Slot::ShapeGradient).chain(),
        ));
        self.world.get_resource_or_init::<Schedules>().insert(schedule);
        self
    }

    /// Builds a plugin into the pipeline, unless one of its type is there already: no system runs
    /// twice.
    pub fn add_plugin<P: Plugin>(&mut self, plugin: &P) -> &mut Self {
        if self.plugins.insert(TypeId::of::<P>()) {
            plugin.build(self);
        }
        self
    }

    /// Adds systems to a stage of a phase.
    ///
    /// # Panics
    /// If there is no such phase.
    pub fn add_systems<M>(
        &mut self,
        phase: impl ScheduleLabel,
        stage: Stage,
        systems: impl IntoScheduleConfigs<ScheduleSystem, M>,
    ) -> &mut Self {
        self.schedule(phase).add_systems(systems.in_set(stage).distributive_run_if(nothing_failed));
        self
    }

    /// Configures sets of a phase, such as a run condition of a stage. `bevy_ecs` loses conditions
    /// that are added to a set which has some, after a run.
    ///
    /// # Panics
    /// If there is no such phase.
    pub fn configure_sets<M>(
        &mut self,
        phase: impl ScheduleLabel,
        sets: impl IntoScheduleConfigs<InternedSystemSet, M>,
    ) -> &mut Self {
        self.schedule(phase).configure_sets(sets);
        self
    }

    fn schedule(&mut self, phase: impl ScheduleLabel) -> &mut Schedule {
        let label = phase.intern();
        let schedule = self.world.resource_mut::<Schedules>().into_inner().get_mut(label);
        schedule.unwrap_or_else(|| panic!("there is no phase {label:?}: add it with add_phase"))
    }

    /// Puts `system` into `slot` and removes the previous system, and with that of
    /// [`Slot::Shading`] its adjoint.
    pub fn swap<M>(
        &mut self,
        phase: impl ScheduleLabel,
        slot: Slot,
        system: impl IntoScheduleConfigs<ScheduleSystem, M>,
    ) -> &mut Self {
        let phase = phase.intern();
        if slot == Slot::Shading {
            self.clear(phase, Slot::ShadingAdjoint);
        }
        self.clear(phase, slot).add_systems(phase, slot.stage(), system.in_set(slot))
    }

    /// Puts a shader into [`Slot::Shading`] and, in a step of a fit, its adjoint into
    /// [`Slot::ShadingAdjoint`].
    pub fn set_shader(&mut self, phase: impl ScheduleLabel, shader: Shader) -> &mut Self {
        let phase = phase.intern();
        self.swap(phase, Slot::Shading, shader.forward);
        if phase == Phase::FitStep.intern() {
            self.world.insert_resource(FitForm(shader.form));
            if let Some(adjoint) = shader.adjoint {
                self.swap(phase, Slot::ShadingAdjoint, adjoint);
            }
        }
        self
    }

    /// Whether there is a system in a slot, or in another set.
    pub fn is_filled(&mut self, phase: impl ScheduleLabel, set: impl SystemSet) -> bool {
        let set = set.intern();
        let found = self.world.try_schedule_scope(phase, |world, schedule| {
            // The graph must be built before systems can be found.
            let is_built = schedule.initialize(world).is_ok();
            is_built && schedule.graph().systems_in_set(set).is_ok_and(|systems| !systems.is_empty())
        });
        found.unwrap_or(false)
    }

    /// Removes the system in a slot, or all systems of another set.
    pub fn clear(&mut self, phase: impl ScheduleLabel, set: impl SystemSet) -> &mut Self {
        let set = set.intern();
        let removed = self.world.try_schedule_scope(phase, |world, schedule| {
            // The graph must be built before systems can be removed. A set that is not in the graph
            // is not an error.
            schedule
                .initialize(world)
                .map(|_| schedule.remove_systems_in_set(set, world, ScheduleCleanupPolicy::RemoveSystemsOnly))
        });
        debug_assert!(matches!(removed, Ok(Ok(_))), "{set:?}: {removed:?}");
        self
    }

    /// Runs a phase once. As in an update of a bevy app, what was removed can be read
    /// (`RemovedComponents`) until the end of the next run but one. During the run the world's
    /// error handler is the pipeline's.
    ///
    /// # Errors
    /// The first error of a system; the systems after it are skipped. [`Error::Run`] if there is no
    /// such phase.
    pub fn run(&mut self, phase: impl ScheduleLabel) -> Result<()> {
        let phase = phase.intern();
        // A system may run another pipeline, or this one again.
        let of_outer_run = FIRST_ERROR.take();
        let handler_before = self.world.remove_resource::<FallbackErrorHandler>();
        self.world.insert_resource(FallbackErrorHandler(note_error));
        let ran = self.world.try_run_schedule(phase);
        self.world.remove_resource::<FallbackErrorHandler>();
        if let Some(handler) = handler_before {
            self.world.insert_resource(handler);
        }
        let failed = FIRST_ERROR.replace(of_outer_run);
        if ran.is_err() {
            let problem = format!("there is no phase {phase:?}: add it with add_phase");
            return Err(Error::run("pipeline", problem));
        }
        // Otherwise the messages of every despawned sample's components pile up: some hundred bytes
        // a sample of every picture.
        self.world.clear_trackers();
        let Some(error) = failed else { return Ok(()) };
        // Conditions of skipped systems have been evaluated all the same and hold the changes they
        // saw for dealt with.
        mark_material_changed(&mut self.world);
        Err(error)
    }
}
