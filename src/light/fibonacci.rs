//! Near-uniform directions.

pub use crate::math::fibonacci::{fibonacci_axes, spacing_sharpness};
