//! Labels of phases, stages and slots: the public sets that systems are added to and ordered against.
//!
//! A phase is a schedule, a stage is an ordered set in it, a slot is a set for one exchangeable system. Phases and slots are open: any
//! [`ScheduleLabel`] can be a phase ([`Pipeline::add_phase`](super::Pipeline::add_phase)), any [`SystemSet`] a slot
//! ([`SlotLabel`]).

use bevy_ecs::prelude::{IntoScheduleConfigs, Schedule, SystemSet};
use bevy_ecs::schedule::ScheduleLabel;

/// The stages of a phase, in the order they run.
#[derive(SystemSet, Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
#[non_exhaustive]
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
    /// Builds the pool of observed pixels of a fit, once.
    Prepare,
    /// One step of a fit.
    FitStep,
    /// Some pixels of the training photographs, which say what is left to change of their texels.
    Detail,
    /// One tile of a picture.
    Frame,
}

impl Phase {
    /// Every built-in phase.
    pub const ALL: [Self; 4] = [Self::Prepare, Self::FitStep, Self::Detail, Self::Frame];
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
    /// The shown material: the recovered one, edited or unchanged (in [`Stage::Gather`], first).
    Material,
    /// The active light: lobes of one light, or an environment map (in [`Stage::Gather`], after the material).
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
    /// The surface points of samples, if rays or surface change (in [`Stage::Trace`], after [`Slot::Recast`]).
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

/// The systems of the Gather stage between its slots: interpolation of texels at surface points, base materials in columns.
#[derive(SystemSet, Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct GatherPoints;

/// The systems of the Gradient stage between [`Slot::ShadingAdjoint`] and [`Slot::ShapeGradient`]: sums of the adjoints of samples per
/// texel, lobe and base material.
#[derive(SystemSet, Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct ScatterAdjoints;

/// Configures the order of the stages and slots of a phase.
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
