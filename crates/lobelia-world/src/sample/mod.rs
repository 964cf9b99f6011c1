//! Pixel samples: the entities that are traced, shaded and compared, and the observed pixels that a
//! fit takes them from.
//!
//! The pool of observed pixels holds all pixels that a fit may visit; the pool of samples holds
//! those of one step.

pub mod pixel;
pub mod point;

use crate::material::{Diffuse, SpecularLobe, TexelIndex, spawn_materials};
use crate::pipeline::pool::{Columns, Pool, despawn_rows, pool_index};
use crate::{light::LightLobe, light::lights::IncidentLight, light::placement::PlacedFrame};
use bevy_ecs::prelude::{Bundle, Component, Entity, Query, Res, Resource, With, World};
use bevy_ecs::system::SystemParam;
use glam::{Mat3, Vec3};
use lobelia_geometry::view::{ByView, Camera, Photograph, Placement, ViewIndex};
use lobelia_geometry::{Result, mesh::Surface};
use lobelia_sg::shading::{Layers, PointAdjoint, PointVisibility, RadianceAdjoint, ShadePoint};
use pixel::{ImageGradient, Observed, PixelOf, SampleIndex, ViewRay, Window};
use point::{PointBlend, Scenery, SurfacePoint};
use std::{ops::Range, sync::Arc};

/// The columns of a sample that is rendered.
#[derive(Bundle, Clone, Copy, Default)]
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

/// The columns of a sample that is fitted.
#[derive(Bundle, Clone, Copy, Default)]
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

/// Removes the pool of samples.
pub fn despawn_pool(world: &mut World) {
    let samples: Vec<Entity> = world.query_filtered::<Entity, With<SampleIndex>>().iter(world).collect();
    samples.into_iter().for_each(|sample| _ = world.despawn(sample));
}

pool_index! {
    /// Row of an observed pixel in its pool, in the order in which a fit visits them.
    ObservationIndex("observed pixel");
}

/// A pixel of a photograph that shows the object.
#[derive(Component, Clone, Copy, Debug, Default, PartialEq)]
pub struct Observation {
    /// The pixel.
    pub pixel: PixelOf,
    /// The radiance in the photograph.
    pub observed: Observed,
    /// The surface point of its ray when the fit began.
    pub point: SurfacePoint,
}

/// How the photograph changes around an observed pixel; only in the pool of a fit that moves
/// cameras.
#[derive(Component, Clone, Copy, Debug, Default, PartialEq)]
pub struct ObservedGradient(pub ImageGradient);

/// The observed pixels, as a system parameter.
pub type Observations<'w, 's> = Pool<'w, 's, ObservationIndex, &'static Observation>;

/// Rows of the pool of observed pixels that the present step of a fit visits.
#[derive(Resource, Clone, Debug, Default, PartialEq, Eq)]
pub struct ObservedWindow(pub Range<usize>);

/// Removes the pool of observed pixels.
pub fn despawn_observations(world: &mut World) {
    let rows: Vec<Entity> = world.query_filtered::<Entity, With<ObservationIndex>>().iter(world).collect();
    despawn_rows(world, &rows);
}

/// The samples of the current [`Window`], as a system parameter: columns `D`, one row per sample,
/// in the order of [`SampleIndex`].
#[derive(SystemParam)]
pub struct Samples<'w, 's, D: Columns + 'static> {
    window: Res<'w, Window>,
    pool: Pool<'w, 's, SampleIndex, D>,
}

impl<'w, 's, D: Columns + 'static> Samples<'w, 's, D> {
    /// The window's columns. Writing does not mark them as changed, because every run recomputes
    /// them.
    ///
    /// # Errors
    /// If the pool does not have all samples of the window.
    pub fn columns(self) -> Result<D::Slices<'w>> {
        self.pool.rows(self.window.0.clone())
    }
}

/// Spawns an object: its surface, the albedo of each texel of the surface's atlas, base materials
/// with the numbers 0, 1, … (texels show the first), and the lobes of its light.
pub fn spawn_object(
    world: &mut World,
    surface: &Arc<Surface>,
    albedo: &[Vec3],
    materials: &[SpecularLobe],
    light: &[LightLobe],
) {
    world.insert_resource(Scenery(surface.clone()));
    let texels = (0..).map(TexelIndex).zip(albedo.iter().copied().map(Diffuse::of_albedo));
    world.spawn_batch(texels.collect::<Vec<_>>());
    spawn_materials(world, materials);
    world.spawn_batch(light.to_vec());
}

/// The rotation of each photograph into the light's frame, as a system parameter.
#[derive(SystemParam)]
pub struct LightRotations<'w, 's> {
    light: Res<'w, IncidentLight>,
    views: Query<'w, 's, (&'static ViewIndex, &'static Camera, Option<&'static Placement>), With<Photograph>>,
}

impl LightRotations<'_, '_> {
    /// The rotations for the light of this run.
    pub fn by_view(&self) -> ByView<Mat3> {
        let view = |(index, camera, placement): (&ViewIndex, &Camera, Option<&Placement>)| {
            (*index, *camera, placement.copied().unwrap_or_default())
        };
        light_rotations(&self.light.frame, self.views.iter().map(view))
    }
}

/// The rotation from the world into the light's frame of each view, which has a placement of the
/// object; none if the light stands still in the world.
pub fn light_rotations(
    frame: &PlacedFrame,
    views: impl Iterator<Item = (ViewIndex, Camera, Placement)>,
) -> ByView<Mat3> {
    if frame.is_still() {
        return ByView::default();
    }
    let rotation = |(index, camera, placement): (ViewIndex, Camera, Placement)| {
        (index, frame.light_from_world(camera.world_from_camera.matrix3.into(), placement))
    };
    views.map(rotation).collect()
}
