//! All columns of a pixel sample.

use crate::math::ray::Ray;
use crate::math::shading::{Layers, PointAdjoint, PointVisibility, RadianceAdjoint, ShadePoint};
use crate::sample::pixel::{ImageGradient, Observed, PixelOf, SampleIndex, ViewRay};
use crate::sample::point::{PointBlend, SurfacePoint};
use bevy_ecs::prelude::{Bundle, Entity, With, World};

/// The columns of a sample that is rendered.
#[derive(Bundle, Clone, Copy)]
pub struct FrameSample {
    /// Its row in the pool.
    pub index: SampleIndex,
    /// The pixel that it belongs to.
    pub pixel: PixelOf,
    /// Its camera ray.
    pub ray: ViewRay,
    /// The surface point of that ray.
    pub point: SurfacePoint,
    /// The inputs of shading.
    pub gathered: ShadePoint,
    /// Blend weights of the base materials there.
    pub blend: PointBlend,
    /// Visibility and interreflection at the point.
    pub visibility: PointVisibility,
    /// The result of shading.
    pub shaded: Layers,
}

impl FrameSample {
    /// A sample without a pixel; `ray` is a placeholder.
    pub fn blank(index: SampleIndex, ray: Ray) -> Self {
        Self {
            index,
            pixel: PixelOf::default(),
            ray: ViewRay(ray),
            point: SurfacePoint::default(),
            gathered: ShadePoint::default(),
            blend: PointBlend::default(),
            visibility: PointVisibility::OPEN,
            shaded: Layers::default(),
        }
    }
}

/// The columns of a sample that is fitted.
#[derive(Bundle, Clone, Copy)]
pub struct FitSample {
    /// The columns of a rendered sample.
    pub frame: FrameSample,
    /// The radiance in the photograph.
    pub observed: Observed,
    /// How the photograph changes around it.
    pub gradient: ImageGradient,
    /// Adjoint of the radiance.
    pub adjoint: RadianceAdjoint,
    /// Adjoint of the point's inputs.
    pub back: PointAdjoint,
}

impl FitSample {
    /// A sample without a pixel; `ray` is a placeholder.
    pub fn blank(index: SampleIndex, ray: Ray) -> Self {
        Self {
            frame: FrameSample::blank(index, ray),
            observed: Observed::default(),
            gradient: ImageGradient::default(),
            adjoint: RadianceAdjoint::default(),
            back: PointAdjoint::default(),
        }
    }
}

/// Removes the pool.
pub fn despawn_pool(world: &mut World) {
    let samples: Vec<Entity> = world.query_filtered::<Entity, With<SampleIndex>>().iter(world).collect();
    for sample in samples {
        world.despawn(sample);
    }
}
