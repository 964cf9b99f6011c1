//! The names of phases, stages and slots: the public sets that systems are put into and ordered against.
//!
//! A phase is a schedule, a stage an ordered set in it, a slot a set for one exchangeable system. All three are open: any
//! [`ScheduleLabel`] can be a phase ([`Pipeline::add_phase`](super::Pipeline::add_phase)), any [`SystemSet`] a slot
//! ([`SlotLabel`]).

use bevy_ecs::prelude::{IntoScheduleConfigs, Schedule, SystemSet};
use bevy_ecs::schedule::ScheduleLabel;

/// The stages of a phase, in the order they run.
#[derive(SystemSet, Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
#[non_exhaustive]
pub enum Stage {
    /// Chooses pixel samples and their rays.
    Sample,
    /// Finds the surface point of each ray.
    Trace,
    /// Collects what shading reads: light, material, albedo at each point, visibility.
    Gather,
    /// Writes outgoing radiance.
    Shade,
    /// Compares with the photographs and writes the adjoint of radiance.
    Loss,
    /// Pulls that adjoint back to every parameter.
    Gradient,
    /// Moves the parameters.
    Update,
    /// Sums samples into pixels.
    Resolve,
    /// Hands finished images over. The built-in plugins leave it empty.
    Write,
}

impl Stage {
    /// All stages, in order.
    pub const ORDER: [Self; 9] = [
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

/// The built-in phases.
#[derive(ScheduleLabel, Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
#[non_exhaustive]
pub enum Phase {
    /// Makes the pool of observed pixels that a fit visits, once.
    Prepare,
    /// One step of a fit.
    FitStep,
    /// One tile of a picture.
    Frame,
}

impl Phase {
    /// Every built-in phase.
    pub const ALL: [Self; 3] = [Self::Prepare, Self::FitStep, Self::Frame];
}

/// A set for one exchangeable system (or chain of systems), inside a stage.
pub trait SlotLabel: SystemSet + Clone {
    /// The stage it belongs to.
    fn stage(&self) -> Stage;
}

/// The built-in slots.
#[derive(SystemSet, Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
#[non_exhaustive]
pub enum Slot {
    /// The material that is shown, made of the recovered one: an edit, or the recovered one as it is (in [`Stage::Gather`], first).
    Material,
    /// What the light is: lobes of one light, or an environment map (in [`Stage::Gather`], after the material).
    Light,
    /// What the object hides from itself (in [`Stage::Gather`], last).
    Visibility,
    /// How points are shaded: a closed form or path tracing (in [`Stage::Shade`]).
    Shading,
    /// The adjoint of shading (in [`Stage::Gradient`], first).
    ShadingAdjoint,
    /// How light and material move (in [`Stage::Update`]).
    Optimizer,
    /// The samples' rays, through cameras that move (in [`Stage::Trace`]).
    Recast,
    /// Where the samples' rays meet the surface, if one of them moves (in [`Stage::Trace`], after that).
    Retrace,
    /// How the samples' adjoints reach a surface that moves (in [`Stage::Gradient`], last).
    ShapeGradient,
    /// How the surface moves (in [`Stage::Update`]).
    ShapeUpdate,
    /// What the samples say of the cameras (in [`Stage::Gradient`]).
    CameraGradient,
    /// How the cameras move (in [`Stage::Update`]).
    CameraUpdate,
}

impl Slot {
    const ALL: [Self; 12] = [
        Self::Material,
        Self::Light,
        Self::Visibility,
        Self::Shading,
        Self::ShadingAdjoint,
        Self::Optimizer,
        Self::Recast,
        Self::Retrace,
        Self::ShapeGradient,
        Self::ShapeUpdate,
        Self::CameraGradient,
        Self::CameraUpdate,
    ];
}

impl SlotLabel for Slot {
    fn stage(&self) -> Stage {
        match self {
            Self::Material | Self::Light | Self::Visibility => Stage::Gather,
            Self::Shading => Stage::Shade,
            Self::Recast | Self::Retrace => Stage::Trace,
            Self::ShadingAdjoint | Self::ShapeGradient | Self::CameraGradient => Stage::Gradient,
            Self::Optimizer | Self::ShapeUpdate | Self::CameraUpdate => Stage::Update,
        }
    }
}

/// What the Gather stage does between its slots: texels blended at surface points, base materials in columns.
#[derive(SystemSet, Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct GatherPoints;

/// What the Gradient stage does between [`Slot::ShadingAdjoint`] and [`Slot::ShapeGradient`]: adjoints of samples summed onto
/// texels, lobes and base materials.
#[derive(SystemSet, Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct ScatterAdjoints;

/// Puts the stages and slots of a phase in order.
pub(super) fn configure(schedule: &mut Schedule) {
    for stage in Stage::ORDER {
        schedule.configure_sets(stage);
    }
    for pair in Stage::ORDER.windows(2) {
        schedule.configure_sets(pair[0].before(pair[1]));
    }
    for slot in Slot::ALL {
        schedule.configure_sets(slot.in_set(slot.stage()));
    }
    schedule.configure_sets((
        (Slot::Material, Slot::Light, GatherPoints.in_set(Stage::Gather), Slot::Visibility).chain(),
        (Slot::Recast, Slot::Retrace).chain(),
        (Slot::ShadingAdjoint, ScatterAdjoints.in_set(Stage::Gradient), Slot::ShapeGradient).chain(),
    ));
}
