//! Distant light: SG lobes, environment maps, and both as lights that can be sampled.
//!
//! | module | holds |
//! | --- | --- |
//! | [`convention`] | orientation of maps in other programs |
//! | [`envmap`] | the latitude-longitude grid: directions, solid angles, bilinear look-up, rotation |
//! | [`illuminate`] | [`Illuminate`](crate::ray::Illuminate) for a map and for lobes, both with importance sampling |
//! | [`lobe`] | [`LightLobe`], and lists of lobes: radiance, power, rotation, checks |

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
