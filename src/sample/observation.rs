//! Observed pixels: what a fit compares with. Their pool holds all pixels that a fit may visit; the pool of samples holds those of one step.

use crate::pipeline::pool::{Pool, despawn_rows, pool_index};
use crate::sample::pixel::{ImageGradient, Observed, PixelOf};
use crate::sample::point::SurfacePoint;
use bevy_ecs::prelude::{Component, Entity, Resource, With, World};
use std::ops::Range;

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

/// How the photograph changes around an observed pixel; only in the pool of a fit that moves cameras.
#[derive(Component, Clone, Copy, Debug, Default, PartialEq)]
pub struct ObservedGradient(pub ImageGradient);

/// The observed pixels, as a system parameter.
pub type Observations<'w, 's> = Pool<'w, 's, ObservationIndex, &'static Observation>;

/// Rows of the pool of observed pixels that the present step of a fit visits.
#[derive(Resource, Clone, Debug, Default, PartialEq, Eq)]
pub struct ObservedWindow(pub Range<usize>);

/// Removes the pool.
pub fn despawn_observations(world: &mut World) {
    let rows: Vec<Entity> = world.query_filtered::<Entity, With<ObservationIndex>>().iter(world).collect();
    despawn_rows(world, &rows);
}
