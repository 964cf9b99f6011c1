//! The closed forms of `lobelia-sg` on a GPU, forward and adjoint: loops over points × light lobes
//! in WGSL, run by `wgpu`.
//!
//! [`Gpu`] is a device of [`PairLoops`](lobelia_sg::shading::PairLoops), in `f32`. Its results
//! differ from those of the CPU by rounding, and it evaluates the specular part of every pair,
//! where accurate shading on the CPU leaves out what it takes for negligible: up to 0.15 % of the
//! brightest specular radiance of [`Workload`](lobelia_sg::workload::Workload) with 128 lobes, and
//! more where broad and sharp lobes mix. Sums have a fixed order: on one device, the same call has
//! the same result every time.
//!
//! | module | holds |
//! | --- | --- |
//! | `shade` | the calls: batches of points, what they read and write |
//! | `kernels` | the WGSL of a kernel, and pipelines kept between calls |
//! | `buffers` | buffers kept between calls |
//! | `device` | adapters, the device and its failures |
//!
//! The files `*.wgsl` have the names of the files of `lobelia-sg` that they follow.

mod buffers;
mod device;
mod kernels;
mod shade;

#[cfg(test)]
mod tests;

pub use device::Gpu;
