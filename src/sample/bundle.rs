//! The pool of pixel samples: one table, one slice a column, a row is an index.

use crate::error::{Error, Result};
use crate::math::ray::Ray;
use crate::math::shading::{Layers, PointAdjoint, PointVisibility, RadianceAdjoint, ShadePoint};
use crate::sample::pixel::{Observed, PixelOf, ViewRay};
use crate::sample::point::SurfacePoint;
use crate::shade::PointBlend;
use bevy_ecs::prelude::{Bundle, Entity, With, World};

/// The columns of a sample that is rendered.
#[derive(Bundle, Clone, Copy)]
pub struct FrameSample {
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
    pub fn blank(ray: Ray) -> Self {
        Self {
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
    let samples: Vec<Entity> = world.query_filtered::<Entity, With<PixelOf>>().iter(world).collect();
    for sample in samples {
        world.despawn(sample);
    }
}

/// The one non-empty table among a query's contiguous chunks.
///
/// # Errors
/// If there is more than one: a row would no longer be an index.
pub fn only_table<T>(
    chunks: impl Iterator<Item = T>,
    rows: impl Fn(&T) -> usize,
    pool: &str,
) -> Result<Option<T>> {
    let mut tables = chunks.filter(|chunk| rows(chunk) > 0);
    let first = tables.next();
    if tables.next().is_some() {
        return Err(Error::run(
            format!("the {pool} pool"),
            "its entities lie in several tables, so that rows are no longer indices; \
             give all of them the same components",
        ));
    }
    Ok(first)
}
