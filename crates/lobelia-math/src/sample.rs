//! A surface sample as the kernels read and write it: the point, its radiance, and the adjoints of both.

use crate::real::Vec3Of;

/// A surface point as the kernels read it; a zero normal marks a ray without a hit, whose radiance is zero.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "ecs", derive(bevy_ecs::component::Component))]
pub struct ShadePoint {
    /// Unit normal.
    pub normal: Vec3Of<f32>,
    /// Unit direction from the point to the viewer.
    pub to_viewer: Vec3Of<f32>,
    /// Diffuse albedo.
    pub albedo: Vec3Of<f32>,
}

impl ShadePoint {
    /// Whether this marks a ray without a hit.
    pub fn is_missed(&self) -> bool {
        self.normal == [0.0; 3]
    }
}

/// Outgoing radiance, as a diffuse and a specular layer.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "ecs", derive(bevy_ecs::component::Component))]
pub struct Layers {
    /// Diffusely reflected radiance.
    pub diffuse: Vec3Of<f32>,
    /// Specularly reflected radiance.
    pub specular: Vec3Of<f32>,
}

/// Adjoint of the outgoing radiance of a point, the sum of its layers.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "ecs", derive(bevy_ecs::component::Component))]
pub struct RadianceAdjoint(pub Vec3Of<f32>);

/// Adjoints of the inputs of one point.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "ecs", derive(bevy_ecs::component::Component))]
pub struct PointAdjoint {
    /// With respect to the diffuse albedo.
    pub albedo: Vec3Of<f32>,
    /// With respect to the normal (along its tangent plane).
    pub normal: Vec3Of<f32>,
}

/// The radiance of many points and its adjoint, the input of the adjoint kernel. Both have one value per point.
#[derive(Clone, Copy, Debug)]
pub struct RadianceColumns<'a> {
    /// Result of the forward kernel; where a channel is zero, its adjoint is dropped.
    pub shaded: &'a [Layers],
    /// Adjoint of the sum of its layers.
    pub adjoint: &'a [RadianceAdjoint],
}
