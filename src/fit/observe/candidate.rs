//! Pixels that a fit may visit, before they are traced, and how they are chosen.

use crate::sample::pixel::{ImageGradient, Observed, PixelOf};
use bevy_ecs::prelude::Resource;
use serde::{Deserialize, Serialize};

/// The selection of pixels for a fit.
#[derive(Resource, Clone, Copy, Debug, PartialEq, Eq)]
pub struct PixelChoice {
    /// Seed of the order, and of the selection if there are too many.
    pub seed: u64,
    /// Most pixels; of more, a random subset is used.
    pub max_pixels: usize,
    /// Whether each texel gets its share where `max_pixels` are few for the texels.
    pub evenly: bool,
}

/// There if each observed pixel is to have its [`ImageGradient`], by which cameras are moved.
#[derive(Resource, Clone, Copy, Debug, Default)]
pub struct GradientsNeeded;

/// A pixel of a training photograph, before it is traced.
#[derive(Clone, Copy, Default, Serialize, Deserialize)]
pub(in crate::fit) struct Candidate {
    /// The pixel.
    pub pixel: PixelOf,
    /// Its radiance.
    pub observed: Observed,
    /// How that changes around it.
    pub gradient: ImageGradient,
}

/// Pixels that are chosen and not yet traced.
#[derive(Resource, Default)]
pub struct Candidates(pub(super) Vec<Candidate>);
