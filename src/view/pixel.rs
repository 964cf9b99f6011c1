//! Pixel samples: the entities that are traced, shaded and compared.

use crate::math::ray::Ray;
use bevy_ecs::prelude::{Component, Resource};
use glam::Vec3;
use std::ops::Range;

/// Which pixel a sample belongs to.
#[derive(Component, Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PixelOf {
    /// Index of the view among those of the pool.
    pub view: u32,
    /// `y * width + x`.
    pub pixel: u32,
}

/// Linear radiance that the photograph shows there.
#[derive(Component, Clone, Copy, Debug, Default, PartialEq)]
pub struct Observed(pub Vec3);

/// The sample's camera ray, world space.
#[derive(Component, Clone, Copy, Debug, PartialEq)]
pub struct ViewRay(pub Ray);

/// Rows of the pixel pool that the systems of this run work on.
#[derive(Resource, Clone, Debug, Default, PartialEq, Eq)]
pub struct Window(pub Range<usize>);
