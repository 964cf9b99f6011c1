//! The Loss, Gradient and Update stages.

pub(crate) mod adam;
pub mod cameras;
pub mod components;
pub mod exposure;
mod initialization;
pub mod loss;
pub mod observe;
pub mod roughness;
pub mod run;
pub mod scale;
pub mod systems;
