//! Pixel samples: the entities that are traced, shaded and compared.

use crate::math::ray::Ray;
use crate::pipeline::pool::pool_index;
use crate::view::ViewIndex;
use bevy_ecs::prelude::{Component, Resource};
use glam::Vec3;
use std::ops::Range;

pool_index! {
    /// Row of a pixel sample in its pool, in the order in which a fit or a frame visits them.
    SampleIndex("pixel sample");
}

/// Which pixel a sample belongs to.
#[derive(Component, Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PixelOf {
    /// The view.
    pub view: ViewIndex,
    /// `y * width + x`.
    pub pixel: u32,
}

/// Linear radiance that the photograph shows there.
#[derive(Component, Clone, Copy, Debug, Default, PartialEq)]
pub struct Observed {
    /// What is stored.
    pub radiance: Vec3,
    /// Whether the brightest channels reach the end of what can be stored: the truth is that or more.
    pub saturated: bool,
}

/// A channel of a saturated pixel that is this bright is at the end of what can be stored.
pub const SATURATION: f32 = 0.999;

impl Observed {
    /// How far a prediction of a channel is off: a saturated channel may be any amount brighter.
    #[inline]
    pub fn difference(&self, channel: usize, predicted: f32) -> f32 {
        let observed = self.radiance[channel];
        let difference = predicted - observed;
        if self.saturated && observed >= SATURATION { difference.min(0.0) } else { difference }
    }
}

/// The sample's camera ray, world space.
#[derive(Component, Clone, Copy, Debug, PartialEq)]
pub struct ViewRay(pub Ray);

/// Rows of the pixel pool that the systems of this run work on.
#[derive(Resource, Clone, Debug, Default, PartialEq, Eq)]
pub struct Window(pub Range<usize>);
