//! What a scene file says about shadows and reflections.

use serde::{Deserialize, Serialize};

/// What closed-form shading knows of shadows and reflections between parts of the object. (Path tracing knows both.)
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum Visibility {
    /// Nothing: every point sees all light.
    None,
    /// Rays from every texel find out.
    Traced {
        /// Directions over the sphere that texels look in, 64 to 4096, rounded up to a multiple of 64. Default 512.
        #[serde(default = "directions")]
        directions: u32,
        /// Reflections from one part of the object onto another, 0 (shadows alone) to 8. Default 2.
        #[serde(default = "bounces")]
        bounces: u32,
        /// Steps of a fit after which shadows and reflections are recomputed ≥ 1. Default 50.
        #[serde(default = "refresh_every")]
        refresh_every: u32,
    },
}

impl Default for Visibility {
    fn default() -> Self {
        Self::Traced { directions: directions(), bounces: bounces(), refresh_every: refresh_every() }
    }
}

fn directions() -> u32 {
    512
}

fn bounces() -> u32 {
    2
}

fn refresh_every() -> u32 {
    50
}
