//! Distant light: SG lobes, environment maps, and both as lights that can be sampled.

pub mod convention;
pub mod envmap;
pub mod illuminate;
pub mod lobe;

pub use envmap::{EnvironmentMap, validate_map};
pub use illuminate::render_lobes;
pub use lobe::{
    LightLobe, MAX_RADIANCE, MAX_SHARPNESS, MOST_LOBES, lobes_in_use, lobes_power, lobes_radiance,
    rotate_lobes, scale_lobes, validate_lobes,
};
