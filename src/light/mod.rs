//! Light: SG lobes, environment maps, and conversions between them.
//!
//! | module | holds |
//! | --- | --- |
//! | [`convention`] | orientation of maps in other programs |
//! | [`light_frame`] | the frame in which a light stands still: the world's, the camera's or a turntable's |
//! | [`envmap`] | the latitude-longitude grid: directions, solid angles, bilinear look-up, rotation |
//! | [`groups`] | lights of photographs that were taken in other rooms or on other days |
//! | [`illuminate`] | [`Illuminate`](crate::math::ray::Illuminate) for a map and for lobes, both with importance sampling |
//! | [`placement`] | how an object lies that is turned over between two rounds of photographs |
//! | `lobe` | [`LightLobe`], and lists of lobes: radiance, power, rotation, checks |
//! | [`lights`] | lobes and named lights as entities, and the system in `Slot::Light` |
//! | [`map_fit`] | fit of lobes to a map (Levenberg–Marquardt; lobes are added and removed; suns get their own lobes first) |
//!
//! [`codec::envmap`](crate::codec::envmap) and [`codec::npy`](crate::codec::npy) read and write files.
//!
//! # Parameters of a lobe
//! | name | type | unit | default | meaning |
//! | --- | --- | --- | --- | --- |
//! | `axis` | `Vec3` | unit vector, world | none | ξ, toward the light |
//! | `sharpness` | `f32` ≥ 0 | 1 / (1 − cos) | none | λ; half-width is about √(1.39 / λ) radians |
//! | `amplitude` | `Vec3` ≥ 0 | linear RGB radiance | none | μ, the radiance at the axis |
//!
//! # Parameters of a fit ([`map_fit::MapFit`])
//! | name | type | unit | default | meaning |
//! | --- | --- | --- | --- | --- |
//! | `working_width` | `u32` | texels | 256 | width of the averaged map that lobes are first placed on |
//! | `polish_width` | `u32` | texels | 512 | largest width of the map for relocation and final optimization |
//! | `iterations` | `usize` | steps | 16 | Levenberg–Marquardt steps once all lobes are placed |
//! | `relocations` | `usize` | rounds | 12 | rounds of placing lobes at the largest residuals and removing the least useful |
//! | `polish_iterations` | `usize` | steps | 16 | Levenberg–Marquardt steps at the end |
//! | `max_sharpness` | `f32` | 1 / (1 − cos) | 2 (W / 2π)² | largest sharpness; by default a standard deviation of 0.7 texels of the map fitted |
//! | `upper_hemisphere` | `bool` | | false | light from above only: the map is black below the horizon, no axis points there |
//! | `white` | `bool` | | false | gray lobes, fitted to the map's luminance |

pub mod convention;
pub mod envmap;
pub mod groups;
pub mod illuminate;
pub mod light_frame;
pub mod lights;
mod lobe;
pub mod map_fit;
pub mod placement;

pub use envmap::{EnvironmentMap, validate_map};
pub use illuminate::render_lobes;
pub(crate) use lobe::kernel_lobe;
pub use lobe::{
    LightLobe, MAX_RADIANCE, MAX_SHARPNESS, MOST_LOBES, lobes_in_use, lobes_power, lobes_radiance,
    rotate_lobes, scale_lobes, validate_lobes,
};
