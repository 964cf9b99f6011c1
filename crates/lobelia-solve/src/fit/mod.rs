//! The Prepare phase, and the Loss, Gradient and Update stages.

pub mod cameras;
pub mod components;
pub mod detail;
pub mod determined;
pub mod exposure;
pub mod groups;
pub mod guard;
mod initialization;
pub mod loss;
pub mod metal;
pub mod observe;
pub mod placements;
pub mod priors;
pub mod roughness;
pub mod run;
pub mod scale;
pub mod sheen;
mod start;
pub mod systems;

pub(crate) use start::light_turns;
pub use start::{FramesTried, ObjectTurned};
