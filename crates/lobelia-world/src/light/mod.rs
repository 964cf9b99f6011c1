//! Light: SG lobes, environment maps, and conversions between them.
//!
//! | module | holds |
//! | --- | --- |
//! | [`convention`] | orientation of maps in other programs |
//! | [`light_frame`] | the frame in which a light stands still: the world's, the camera's or a turntable's |
//! | [`envmap`] | the latitude-longitude grid: directions, solid angles, bilinear look-up, rotation |
//! | [`groups`] | lights of photographs that were taken in other rooms or on other days |
//! | [`illuminate`] | [`Illuminate`](lobelia_sg::ray::Illuminate) for a map and for lobes, both with importance sampling |
//! | [`placement`] | how an object lies that is turned over between two rounds of photographs |
//! | [`lobe`] | [`LightLobe`], and lists of lobes: radiance, power, rotation, checks |
//! | [`lights`] | lobes and named lights as entities, and the system in `Slot::Light` |
//! | [`map_fit`] | fit of lobes to a map (Levenberg–Marquardt; lobes are added and removed; suns get their own lobes first) |
//!
//! Lobes, maps and their fit are of [`math`](lobelia_sg), which knows no ECS; the rest is about the
//! lights of a world.

pub mod groups;
pub mod light_frame;
pub mod lights;
pub mod placement;

pub use lobelia_sg::light::*;
pub use lobelia_sg::map_fit;
