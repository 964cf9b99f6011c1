//! The Prepare phase, and the Loss, Gradient and Update stages.
//!
//! | module | holds |
//! | --- | --- |
//! | [`run`] | a whole fit: settings, rates of a step, plugin, loop |
//! | [`observe`] | the Prepare phase: the pool of observed pixels |
//! | `start` | the frame in which the light stands still, and the specular lobe to begin with |
//! | `initialization` | amplitudes and albedo before the first step, by linear least squares |
//! | [`systems`], [`loss`] | the systems of the stages; the image loss, and how each photograph is explained |
//! | [`roughness`] | roughness that varies over the surface |
//! | [`sheen`], [`metal`] | sheen of a texel; metal beside a dielectric: no diffuse light beneath it |
//! | [`detail`] | albedo, sheen and tilt of a finer texture, from all pixels |
//! | [`scale`], [`exposure`], [`cameras`], [`placements`] | further unknowns: the scale between light and albedo, exposures, cameras, how an object lies that was turned over |
//! | `groups` | lights of several groups of photographs, which take turns |
//! | `neighbors` | the prior of the albedo: neighboring texels have the same paint, but at edges |
//! | [`priors`] | what somebody else says of albedo and normals |
//! | [`guard`] | steps that are not finite and are not taken |
//! | [`determined`] | how well the photographs determine what was found |
//! | [`components`] | gradients, moments and state |

pub mod cameras;
pub mod components;
pub mod detail;
pub mod determined;
mod elimination;
pub mod exposure;
pub mod groups;
pub mod guard;
mod initialization;
pub mod loss;
pub mod metal;
mod neighbors;
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
