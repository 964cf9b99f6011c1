//! The Prepare phase, and the Loss, Gradient and Update stages.
//!
//! | module | holds |
//! | --- | --- |
//! | [`run`] | a whole fit: settings, plugin, loop |
//! | [`observe`] | the Prepare phase: the pool of observed pixels |
//! | `initialization` | amplitudes and albedo before the first step, by linear least squares; the frame in which the light stands still, and the specular lobe to begin with |
//! | [`systems`], [`loss`], [`adam`], [`optimizer`] | the systems of the stages, the image loss, Adam, and what moves in which order |
//! | `schedule` | rates and pixels of a step |
//! | [`roughness`] | roughness that varies over the surface |
//! | [`metal`] | metal beside a dielectric: no diffuse light beneath it |
//! | [`detail`] | albedo, sheen and tilt of a finer texture, from all pixels |
//! | [`scale`], [`exposure`], [`cameras`], [`placements`] | further unknowns: the scale between light and albedo, exposures, cameras, how an object lies that was turned over |
//! | `groups` | lights of several groups of photographs, which take turns |
//! | [`priors`] | what somebody else says of albedo and normals |
//! | [`guard`], [`by_view`] | steps that are not finite and are not taken; how each photograph is explained |
//! | [`share`] | one fit on several processes |
//! | [`components`], `attach` | gradients, moments and state, and who has them |

pub mod adam;
pub(crate) mod attach;
pub mod by_view;
pub mod cameras;
pub mod components;
pub mod detail;
pub mod determined;
pub mod exposure;
pub(crate) mod groups;
pub mod guard;
mod initialization;
mod kept_state;
pub mod loss;
pub mod metal;
pub mod observe;
pub mod optimizer;
pub mod placements;
pub mod priors;
pub mod roughness;
pub mod run;
pub mod scale;
pub(crate) mod schedule;
pub mod share;
pub mod sheen;
pub mod systems;

pub(crate) use initialization::start::light_turns;
pub use initialization::start::{FramesTried, ObjectTurned};
