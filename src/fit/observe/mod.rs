//! The Prepare phase: every usable foreground pixel of the training views becomes one row of the pool of observed pixels, traced once.
//! Each step then takes some of them into the samples.

use crate::error::stop::check_interrupted;
use crate::error::{Error, Result};
use crate::fit::components::TexelSeen;
use crate::material::Texels;
use crate::math::ray::{Intersect, Ray};
use crate::pipeline::pool::Pool;
use crate::pipeline::{Phase, Pipeline, SystemResult};
use crate::sample::Samples;
use crate::sample::bundle::{FitSample, despawn_pool};
use crate::sample::observation::{
    Observation, ObservationIndex, Observations, ObservedGradient, ObservedWindow, despawn_observations,
};
use crate::sample::pixel::{ImageGradient, Observed, PixelOf, SampleIndex, ViewRay};
use crate::sample::point::{Scenery, SurfacePoint};
use crate::view::{ByView, Camera, Photograph, ViewIndex};
use bevy_ecs::prelude::{Query, Res, Resource, With, World};
use bevy_ecs::system::SystemState;
use glam::Vec3;
use rayon::prelude::*;
use shares::{NO_TEXEL, kept_evenly};
use std::sync::Arc;
use views::{ObservedView, ViewColumns, training_views, usable_counts};

pub(in crate::fit) use candidate::Candidate;
pub use candidate::{Candidates, GradientsNeeded, PixelChoice};
pub use choice::choose_pixels;

mod candidate;
mod choice;
mod shares;
mod views;

#[cfg(test)]
mod tests;

/// What the pool of observed pixels was made of.
#[derive(Resource)]
struct PoolMade {
    choice: PixelChoice,
    cameras: Vec<(ViewIndex, Camera)>,
    scenery: Arc<dyn Intersect>,
    /// Whether pixels have gradients.
    gradients: bool,
    rows: usize,
}

/// Rays that are traced at once.
const TRACED_AT_ONCE: usize = 1 << 16;

/// A training view, and how many usable foreground pixels it has.
#[derive(Clone, Copy, Debug)]
pub(super) struct UsableView {
    pub view: ViewIndex,
    pub pixels: usize,
    /// The process that keeps its photograph, if only one does.
    pub keeper: Option<u32>,
}

/// The training views in order.
///
/// # Errors
/// If another process is gone.
pub(super) fn usable_by_view(world: &mut World) -> Result<Vec<UsableView>> {
    let mut views = world.query::<ViewColumns>();
    let training = training_views(views.iter(world), world.get_resource());
    let counted = training.items.iter().zip(usable_counts(&training)?);
    let usable = |(of, pixels): (&ObservedView, usize)| UsableView {
        view: of.index,
        pixels,
        keeper: of.photograph.keeper(),
    };
    Ok(counted.map(usable).collect())
}

/// Every n-th usable foreground pixel of a training view whose photograph is here, row by row.
pub(super) fn usable_pixels(world: &mut World, of: ViewIndex, every: usize) -> Vec<Candidate> {
    let mut views = world.query::<ViewColumns>();
    let training = training_views(views.iter(world), None);
    let chosen = training.items.iter().filter(|view| view.index == of);
    chosen.flat_map(|view| view.usable().step_by(every).map(|pixel| view.candidate(pixel, false))).collect()
}

/// Runs Prepare, unless the pool that it would make of the photographs is there; returns the number of pixels.
///
/// # Errors
/// If there is no pixel to fit to.
pub(super) fn make_pool(pipeline: &mut Pipeline) -> Result<usize> {
    if pool_holds(&mut pipeline.world) {
        // A part of a fit begins with texels that nobody has seen.
        let mut state = SystemState::<(Observations, Texels<&mut TexelSeen>)>::new(&mut pipeline.world);
        let columns = state.get_mut(&mut pipeline.world);
        let (observations, texels) = columns.map_err(|error| Error::run("fit", error.to_string()))?;
        count_seen(observations, texels)?;
    } else {
        pipeline.run(Phase::Prepare)?;
    }
    Ok(pipeline.world.resource::<ObservedWindow>().0.len())
}

/// Whether the pool holds the same choice of pixels, seen by the same cameras on the same surface. Its whole is then the window.
fn pool_holds(world: &mut World) -> bool {
    let cameras = cameras_in_order(world);
    let (choice, scenery) = (*world.resource::<PixelChoice>(), world.resource::<Scenery>().0.clone());
    let needs_gradients = world.contains_resource::<GradientsNeeded>();
    let holds = |made: &&PoolMade| {
        let is_seen_alike = made.cameras == cameras && Arc::ptr_eq(&made.scenery, &scenery);
        made.choice == choice && is_seen_alike && (made.gradients || !needs_gradients)
    };
    let Some(rows) = world.get_resource().filter(holds).map(|made| made.rows) else { return false };
    world.resource_mut::<ObservedWindow>().0 = 0..rows;
    true
}

/// Removes the pool of observed pixels.
pub fn release_pool(world: &mut World) {
    despawn_observations(world);
    world.remove_resource::<PoolMade>();
}

/// The cameras of the views with a photograph.
fn cameras_in_order(world: &mut World) -> Vec<(ViewIndex, Camera)> {
    let mut views = world.query_filtered::<(&ViewIndex, &Camera), With<Photograph>>();
    let mut cameras: Vec<_> = views.iter(world).map(|(index, camera)| (*index, *camera)).collect();
    cameras.sort_by_key(|(index, _)| *index);
    cameras
}

/// Trace: casts the chosen pixels' rays; those that meet the front of the surface become the pool of observed pixels.
pub fn trace_pixels(world: &mut World) -> SystemResult {
    let chosen = std::mem::take(&mut world.resource_mut::<Candidates>().0);
    let scenery = world.resource::<Scenery>().0.clone();
    let made_with = cameras_in_order(world);
    let cameras: ByView<Camera> = made_with.iter().copied().collect();
    let choice = *world.resource::<PixelChoice>();
    let gradients = world.contains_resource::<GradientsNeeded>();
    let chosen = with_even_shares(chosen, choice, &cameras, scenery.as_ref())?;
    release_pool(world);
    let mut rows = 0;
    // In parts: all points beside the pool would be half of it.
    for part in chosen.chunks(TRACED_AT_ONCE) {
        check_interrupted()?;
        let trace = |candidate: &Candidate| candidate.trace(&cameras, scenery.as_ref());
        let traced: Vec<Option<Observation>> = part.par_iter().map(trace).collect::<Result<_>>()?;
        let met = part
            .iter()
            .zip(traced)
            .filter_map(|(of, observation)| Some((observation?, ObservedGradient(of.gradient))));
        let observations: Vec<(ObservationIndex, (Observation, ObservedGradient))> =
            (rows..).map(ObservationIndex).zip(met).collect();
        rows += observations.len() as u32;
        spawn_observations(world, observations, gradients);
    }
    if rows == 0 {
        return Err(Error::usage(
            format!("fit: the rays of all {} foreground pixels miss the surface", chosen.len()),
            "Do the cameras and the mesh share one coordinate system? Does the mesh's outside face the cameras?",
        )
        .into());
    }
    let rows = rows as usize;
    world.resource_mut::<ObservedWindow>().0 = 0..rows;
    world.insert_resource(PoolMade { choice, cameras: made_with, scenery, gradients, rows });
    Ok(())
}

/// Spawns observed pixels, with their gradients or without.
fn spawn_observations(
    world: &mut World,
    observations: Vec<(ObservationIndex, (Observation, ObservedGradient))>,
    gradients: bool,
) {
    if gradients {
        world.spawn_batch(observations);
    } else {
        let alone = observations.into_iter().map(|(index, (observation, _))| (index, observation));
        world.spawn_batch(alone.collect::<Vec<_>>());
    }
}

/// Of more pixels than there is room for those that give each texel its share, in the same order.
fn with_even_shares(
    chosen: Vec<Candidate>,
    choice: PixelChoice,
    cameras: &ByView<Camera>,
    scenery: &dyn Intersect,
) -> Result<Vec<Candidate>> {
    if chosen.len() <= choice.max_pixels {
        return Ok(chosen);
    }
    let mut texels = Vec::with_capacity(chosen.len());
    for part in chosen.chunks(TRACED_AT_ONCE) {
        check_interrupted()?;
        let texel =
            |candidate: &Candidate| Ok(candidate.trace(cameras, scenery)?.map_or(NO_TEXEL, nearest_texel));
        texels.append(&mut part.par_iter().map(texel).collect::<Result<Vec<u32>>>()?);
    }
    let kept = kept_evenly(&texels, choice.max_pixels);
    Ok(chosen.into_iter().zip(kept).filter_map(|(candidate, kept)| kept.then_some(candidate)).collect())
}

/// The texel of most weight at a point.
fn nearest_texel(observation: Observation) -> u32 {
    let texels = observation.point.texels;
    let most = (0..4).max_by(|a, b| texels.weights[*a].total_cmp(&texels.weights[*b]));
    texels.indices[most.unwrap_or(0)]
}

impl Candidate {
    /// The observation, if its ray meets the front of the surface.
    fn trace(&self, cameras: &ByView<Camera>, scenery: &dyn Intersect) -> Result<Option<Observation>> {
        let ray = cameras.of(self.pixel.view)?.pixel_ray(self.pixel.pixel);
        let point = SurfacePoint::from(scenery.intersect(&ray, 0.0));
        let is_front = point.is_hit() && point.normal.dot(ray.direction) < 0.0;
        Ok(is_front.then_some(Observation { pixel: self.pixel, observed: self.observed, point }))
    }
}

/// Spawns the samples of a step of `batch` pixels.
pub(crate) fn spawn_samples(world: &mut World, batch: usize) {
    despawn_pool(world);
    let nowhere = Ray { origin: Vec3::ZERO, direction: Vec3::NEG_Z };
    let blank = |row| FitSample::blank(SampleIndex(row), nowhere);
    world.spawn_batch((0..batch as u32).map(blank).collect::<Vec<_>>());
}

/// The columns of a sample that say what it is a sample of.
type TakenColumns =
    (&'static mut PixelOf, &'static mut Observed, &'static mut SurfacePoint, &'static mut ViewRay);

/// Sample: takes the observed pixels of this step into the samples, with rays through the cameras as they are now.
pub fn take_observations(
    taken: Res<ObservedWindow>,
    observations: Observations,
    views: Query<(&ViewIndex, &Camera), With<Photograph>>,
    samples: Samples<TakenColumns>,
) -> SystemResult {
    let cameras: ByView<Camera> = views.iter().map(|(index, camera)| (*index, *camera)).collect();
    let observations = observations.rows(taken.0.clone())?;
    let (mut pixels, mut observed, mut points, mut rays) = samples.columns()?;
    let columns = pixels.par_iter_mut().zip(&mut *observed).zip(&mut *points).zip(&mut *rays);
    let take = |((((pixel, observed), point), ray), from): (
        (((&mut _, &mut _), &mut _), &mut ViewRay),
        &Observation,
    )| {
        (*pixel, *observed, *point) = (from.pixel, from.observed, from.point);
        ray.0 = cameras.of(from.pixel.view)?.pixel_ray(from.pixel.pixel);
        Ok(())
    };
    columns.zip(&*observations).with_min_len(1024).try_for_each(take).map_err(|error: Error| error.into())
}

/// Sample: takes their gradients, which they have if cameras are to be moved ([`GradientsNeeded`]).
pub fn take_gradients(
    taken: Res<ObservedWindow>,
    observed: Pool<ObservationIndex, &'static ObservedGradient>,
    samples: Samples<&mut ImageGradient>,
) -> SystemResult {
    let (observed, mut gradients) = (observed.rows(taken.0.clone())?, samples.columns()?);
    gradients.iter_mut().zip(&*observed).for_each(|(gradient, from)| *gradient = from.0);
    Ok(())
}

/// Gather: sums the weights of each texel over all observed pixels.
pub fn count_seen_texels(observations: Observations, texels: Texels<&mut TexelSeen>) -> SystemResult {
    Ok(count_seen(observations, texels)?)
}

fn count_seen(observations: Observations, texels: Texels<&mut TexelSeen>) -> Result<()> {
    let observations = observations.columns()?;
    let mut seen = texels.columns()?.quiet();
    seen.fill(TexelSeen(0.0));
    for Observation { point, .. } in &*observations {
        for i in 0..4 {
            seen[point.texels.indices[i] as usize].0 += point.texels.weights[i];
        }
    }
    Ok(())
}
