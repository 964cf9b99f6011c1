//! Where a pixel sample's ray meets the surface.

use crate::math::ray::{Hit, TexelAddress};
use bevy_ecs::prelude::Component;
use glam::Vec3;

/// The surface point of a sample.
#[derive(Component, Clone, Copy, Debug, PartialEq)]
pub struct SurfacePoint {
    /// World position.
    pub position: Vec3,
    /// Interpolated unit normal, world space; zero if the ray met nothing.
    pub normal: Vec3,
    /// Unit normal of the flat triangle.
    pub geometric_normal: Vec3,
    /// Distance along the ray in world units; infinite if the ray met nothing.
    pub distance: f32,
    /// Texels blended here.
    pub texels: TexelAddress,
}

impl Default for SurfacePoint {
    fn default() -> Self {
        Self {
            position: Vec3::ZERO,
            normal: Vec3::ZERO,
            geometric_normal: Vec3::ZERO,
            distance: f32::INFINITY,
            texels: TexelAddress::default(),
        }
    }
}

impl SurfacePoint {
    /// Whether the ray met the surface.
    pub fn is_hit(&self) -> bool {
        self.distance.is_finite()
    }
}

impl From<Option<Hit>> for SurfacePoint {
    fn from(hit: Option<Hit>) -> Self {
        hit.map_or_else(Self::default, |hit| Self {
            position: hit.position,
            normal: hit.normal,
            geometric_normal: hit.geometric_normal,
            distance: hit.distance,
            texels: hit.texels,
        })
    }
}
