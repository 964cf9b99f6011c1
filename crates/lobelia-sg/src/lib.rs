//! The kernels of Lobelia: plain functions over numbers and slices that know no ECS and no files.
//!
//! With the feature `ecs` the inputs and outputs of shading are components of a bevy_ecs world.
//!
//! Imports go one way, from top to bottom of this table:
//!
//! | module | holds |
//! | --- | --- |
//! | [`map_fit`] | lobes fitted to an environment map |
//! | [`light`] | light lobes, environment maps, and both as lights to sample |
//! | [`linear`], [`statistics`] | solvers of linear systems, order statistics |
//! | [`workload`] | a batch to measure and test kernels with |
//! | [`shading`] | the slice kernels: many points × many lobes, forward and adjoint, and the closed forms to choose from |
//! | [`accurate`], [`published`] | the formulas of the closed forms: one point × one lobe |
//! | [`model`] | the interface between a closed form and the slice kernels |
//! | [`columns`] | inputs and outputs of the slice kernels |
//! | [`reflectance`] | what the specular parts of this BRDF and of glTF's reflect in all |
//! | [`brdf`], [`sg`], [`ray`], [`color`], [`fibonacci`] | shared terms |
//! | [`two`], [`lanes`], [`real`] | numbers: scalars, SIMD vectors, two of these |

pub mod accurate;
pub mod brdf;
pub mod color;
pub mod columns;
pub mod fibonacci;
pub mod lanes;
pub mod light;
pub mod linear;
pub mod map_fit;
pub mod model;
pub mod published;
pub mod ray;
pub mod real;
pub mod reflectance;
pub mod sg;
pub mod shading;
pub mod statistics;
pub mod two;
pub mod workload;

#[cfg(test)]
#[path = "../tests/shading/cases.rs"]
mod cases;
