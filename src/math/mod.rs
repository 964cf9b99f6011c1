//! Pure kernels: no ECS, no input or output, nothing of the other rooms.

pub mod accurate;
pub mod brdf;
pub mod color;
pub mod lanes;
pub mod model;
pub mod published;
pub mod ray;
pub mod real;
pub mod sg;
pub mod shading;
