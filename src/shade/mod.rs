//! To come.

pub mod path_tracer;
pub mod sampling;
