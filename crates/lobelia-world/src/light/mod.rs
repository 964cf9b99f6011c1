//! Light: SG lobes, environment maps, and conversions between them.
//!
//! Lobes, maps and their fit are of [`math`](lobelia_sg), which knows no ECS; the rest is about the
//! lights of a world.

pub mod groups;
pub mod light_frame;
pub mod lights;
pub mod placement;

pub use lobelia_sg::light::*;
pub use lobelia_sg::map_fit;
