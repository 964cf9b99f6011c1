//! All columns of a pixel sample.

use crate::math::ray::Ray;
use crate::math::shading::{Layers, PointAdjoint, PointVisibility, RadianceAdjoint, ShadePoint};
use crate::sample::pixel::{Observed, PixelOf, SampleIndex, ViewRay};
use crate::sample::point::{PointBlend, SurfacePoint};
use bevy_ecs::prelude::{Bundle, Entity, With, World};

/// The columns of a sample that is rendered.
#[derive(Bundle, Clone, Copy)]
pub struct FrameSample {
    /// Its row in the pool.
    pub index: SampleIndex,
    /// Which pixel it belongs to.
    pub pixel: PixelOf,
    /// Its camera ray.
    pub ray: ViewRay,
    /// Where that meets the surface.
    pub point: SurfacePoint,
    /// What the shading kernel reads.
    pub gathered: ShadePoint,
    /// How the specular lobes blend there.
    pub blend: PointBlend,
    /// What other parts of the object hide from it and send it.
    pub visibility: PointVisibility,
    /// What the shading kernel wrote.
    pub shaded: Layers,
}

impl FrameSample {
    /// A sample of no pixel yet; `ray` only holds the place.
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
    /// What is rendered.
    pub frame: FrameSample,
    /// What the photograph shows.
    pub observed: Observed,
    /// Adjoint of the radiance.
    pub adjoint: RadianceAdjoint,
    /// Adjoint of the point's inputs.
    pub back: PointAdjoint,
}

/// Removes the pool, whatever its columns.
pub fn despawn_pool(world: &mut World) {
    let samples: Vec<Entity> = world.query_filtered::<Entity, With<SampleIndex>>().iter(world).collect();
    for sample in samples {
        world.despawn(sample);
    }
}
