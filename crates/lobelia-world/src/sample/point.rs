//! The surface point of a pixel sample. That of a ray without a hit is infinitely far away and has
//! no normal.
//!
//! ```
//! use glam::Vec3;
//! use lobelia_geometry::mesh::{Surface, primitive::box_mesh};
//! use lobelia_sg::ray::{Intersect, Ray};
//! use lobelia_world::sample::point::SurfacePoint;
//!
//! let surface = Surface::new(box_mesh(Vec3::ZERO, Vec3::ONE)?, 16)?;
//! let origin = Vec3::new(0.1, 0.2, 3.0);
//! let [hit, miss] = [Vec3::NEG_Z, Vec3::Z]
//!     .map(|direction| SurfacePoint::from(surface.intersect(&Ray { origin, direction }, 0.0)));
//! assert!(hit.is_hit() && hit.normal.z > 0.999);
//! assert!(!miss.is_hit() && miss.normal == Vec3::ZERO);
//! # Ok::<(), lobelia_geometry::Error>(())
//! ```

use crate::material::{MAX_SPECULAR_LOBES, SpecularBlend};
use bevy_ecs::prelude::{Component, Resource};
use glam::Vec3;
use lobelia_sg::ray::{Hit, Intersect, TexelAddress};
use std::sync::Arc;

/// The surface point of a sample.
#[derive(Component, Clone, Copy, Debug, PartialEq)]
pub struct SurfacePoint {
    /// World position.
    pub position: Vec3,
    /// Interpolated unit normal, world space; zero if the ray has no hit.
    pub normal: Vec3,
    /// Unit normal of the flat triangle.
    pub geometric_normal: Vec3,
    /// Distance along the ray in world units; infinite if the ray has no hit.
    pub distance: f32,
    /// The texels that are interpolated here.
    pub texels: TexelAddress,
}

impl Default for SurfacePoint {
    fn default() -> Self {
        let [position, normal, geometric_normal] = [Vec3::ZERO; 3];
        Self { position, normal, geometric_normal, distance: f32::INFINITY, texels: TexelAddress::default() }
    }
}

impl SurfacePoint {
    /// Whether the ray hits the surface.
    pub fn is_hit(&self) -> bool {
        self.distance.is_finite()
    }
}

impl From<Option<Hit>> for SurfacePoint {
    fn from(hit: Option<Hit>) -> Self {
        let Some(Hit { distance, position, normal, geometric_normal, texels, .. }) = hit else {
            return Self::default();
        };
        Self { position, normal, geometric_normal, distance, texels }
    }
}

/// The surface that rays are cast against.
#[derive(Resource, Clone)]
pub struct Scenery(pub Arc<dyn Intersect>);

/// Blend weights of the base materials at a sample's point; they sum to at most one; the remainder
/// has no specular light.
#[derive(Component, Clone, Copy, Debug, PartialEq)]
pub struct PointBlend(pub [f32; MAX_SPECULAR_LOBES]);

impl Default for PointBlend {
    fn default() -> Self {
        Self(SpecularBlend::default().0)
    }
}
