//! The pixel of a sample. In a fit it has the radiance of the photograph, which a clipped channel
//! only bounds from below.
//!
//! ```
//! use glam::Vec3;
//! use lobelia_world::sample::pixel::Observed;
//!
//! let observed = Observed { radiance: Vec3::new(1.0, 0.5, 0.25), saturated: true };
//! let predicted = Vec3::new(3.0, 0.75, 0.25);
//! assert_eq!(observed.differences(predicted), Vec3::new(0.0, 0.25, 0.0));
//! assert_eq!(observed.target(predicted), Vec3::new(3.0, 0.5, 0.25));
//! ```

use crate::pipeline::pool::pool_index;
use bevy_ecs::prelude::{Component, Resource};
use glam::{Vec2, Vec3};
use lobelia_geometry::view::ViewIndex;
use lobelia_sg::ray::Ray;
use serde::{Deserialize, Serialize};
use std::ops::Range;

pool_index! {
    /// Row of a pixel sample in its pool, in the order in which a fit or a frame visits them.
    SampleIndex("pixel sample");
}

/// The pixel that a sample belongs to.
#[derive(Component, Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct PixelOf {
    /// The view.
    pub view: ViewIndex,
    /// `y * width + x`.
    pub pixel: u32,
}

/// Linear radiance of the photograph there.
#[derive(Component, Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Observed {
    /// The stored value.
    pub radiance: Vec3,
    /// Whether a channel is at the largest storable value: the stored value is then a lower bound
    /// of that channel.
    pub saturated: bool,
}

/// How the mean radiance of the photograph changes there along x and y, per pixel; `None` where a
/// neighbor is not fully covered by the object, or saturated.
#[derive(Component, Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ImageGradient(pub Option<Vec2>);

/// A channel of a saturated pixel with at least this value is clipped.
pub const SATURATION: f32 = 0.999;

impl Observed {
    /// Residual of a prediction in a channel. A clipped channel is a lower bound: the residual is
    /// zero for brighter predictions.
    #[inline]
    pub fn difference(&self, channel: usize, predicted: f32) -> f32 {
        let observed = self.radiance[channel];
        let difference = predicted - observed;
        if self.saturated && observed >= SATURATION { difference.min(0.0) } else { difference }
    }

    /// Residuals of a prediction in all channels.
    #[inline]
    pub fn differences(&self, predicted: Vec3) -> Vec3 {
        Vec3::from_array(std::array::from_fn(|c| self.difference(c, predicted[c])))
    }

    /// Target of a prediction: the observation, or the prediction itself where it exceeds a clipped
    /// channel. Least squares solved repeatedly with these targets have the residuals of
    /// [`Observed::difference`].
    #[inline]
    pub fn target(&self, predicted: Vec3) -> Vec3 {
        predicted - self.differences(predicted)
    }
}

/// The sample's camera ray, world space.
#[derive(Component, Clone, Copy, Debug, PartialEq)]
pub struct ViewRay(pub Ray);

impl Default for ViewRay {
    /// A placeholder.
    fn default() -> Self {
        Self(Ray { origin: Vec3::ZERO, direction: Vec3::NEG_Z })
    }
}

/// Rows of the pixel pool that the systems of this run process.
#[derive(Resource, Clone, Debug, Default, PartialEq, Eq)]
pub struct Window(pub Range<usize>);
