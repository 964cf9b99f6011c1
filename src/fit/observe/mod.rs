//! The Prepare phase: every usable foreground pixel of the training views becomes one row of the pool of observed pixels, traced once.
//! Each step then takes some of them into the samples.

use crate::error::stop::check_interrupted;
use crate::error::{Error, Result};
use crate::fit::components::TexelSeen;
use crate::light::placement::{LightGroup, Placements};
use crate::material::{TexelIndex, Texels};
use crate::math::ray::{Intersect, Ray};
use crate::pipeline::{Phase, Pipeline, SystemResult};
use crate::sample::Samples;
use crate::sample::bundle::{FitSample, despawn_pool};
use crate::sample::observation::{
    Observation, ObservationIndex, Observations, ObservedWindow, despawn_observations,
};
use crate::sample::pixel::{Observed, PixelOf, SATURATION, SampleIndex, ViewRay};
use crate::sample::point::{Scenery, SurfacePoint};
use crate::view::glare::glare_limit;
use crate::view::{
    ByView, Camera, Photograph, PixelWindow, Placement, Split, StoredMask, ViewIndex, ViewMask,
};
use bevy_ecs::prelude::{Query, Res, ResMut, Resource, With, World};
use bevy_ecs::system::SystemState;
use glam::Vec3;
use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng, rngs::SmallRng};
use rayon::prelude::*;
use shares::{NO_TEXEL, kept_evenly};
use std::sync::Arc;

mod shares;

#[cfg(test)]
mod tests;

/// The selection of pixels for a fit.
#[derive(Resource, Clone, Copy, Debug, PartialEq, Eq)]
pub struct PixelChoice {
    /// Seed of the order, and of the selection if there are too many.
    pub seed: u64,
    /// Most pixels; of more, a random subset is used.
    pub max_pixels: usize,
    /// Whether each texel gets its share where `max_pixels` are few for the texels.
    pub evenly: bool,
}

/// Pixels a texel from which chance gives each enough: shares then make the light slightly worse (`docs/src/ablation.md`).
const ENOUGH_PER_TEXEL: usize = 4;
/// Pixels that are drawn and traced for each that is chosen, where texels get their shares.
const DRAWN: usize = 2;

/// A pixel of a training photograph, before it is traced.
#[derive(Clone, Copy, Default)]
pub(super) struct Candidate {
    /// The pixel.
    pub pixel: PixelOf,
    /// Its radiance.
    pub observed: Observed,
}

/// What the pool of observed pixels was made of.
#[derive(Resource)]
struct PoolMade {
    choice: PixelChoice,
    cameras: Vec<(ViewIndex, Camera)>,
    scenery: Arc<dyn Intersect>,
    rows: usize,
}

/// Pixels that are chosen and not yet traced.
#[derive(Resource, Default)]
pub struct Candidates(Vec<Candidate>);

/// Least coverage of a pixel that is used: partly covered pixels contain background as well.
pub(crate) const FULL_COVERAGE: f32 = 0.999;
/// Most usable pixels whose order is shuffled; of more, the chosen ones are drawn one by one.
const MOST_SHUFFLED: usize = 1 << 26;

/// Rays that are traced at once.
const TRACED_AT_ONCE: usize = 1 << 16;

/// A training view with a photograph.
struct ObservedView<'a> {
    index: ViewIndex,
    camera: &'a Camera,
    photograph: &'a Photograph,
    mask: Option<&'a StoredMask>,
    /// The greatest radiance of a pixel that is not broken.
    limit: f32,
}

/// The columns of a view with a photograph.
type ViewColumns =
    (&'static ViewIndex, &'static Camera, &'static Photograph, Option<&'static ViewMask>, &'static Split);

/// A row of [`ViewColumns`].
type ViewRow<'a> = (&'a ViewIndex, &'a Camera, &'a Photograph, Option<&'a ViewMask>, &'a Split);

/// The training views among these, in the order of their indices.
fn training_views<'a>(views: impl Iterator<Item = ViewRow<'a>>) -> Vec<ObservedView<'a>> {
    let training: Vec<ViewRow<'a>> = views.filter(|(.., split)| **split == Split::Train).collect();
    let limit = glare_limit(training.iter().map(|(_, _, photograph, ..)| photograph.highest()));
    let observed = |(index, camera, photograph, mask, _): ViewRow<'a>| ObservedView {
        index: *index,
        camera,
        photograph,
        mask: mask.map(|mask| &mask.0),
        limit,
    };
    let mut training: Vec<_> = training.into_iter().map(observed).collect();
    training.sort_by_key(|view| view.index);
    training
}

/// The training views in order, and the number of usable foreground pixels of each.
pub(super) fn usable_by_view(world: &mut World) -> Vec<(ViewIndex, usize)> {
    let mut views = world.query::<ViewColumns>();
    let training = training_views(views.iter(world));
    training.par_iter().map(|view| (view.index, view.usable().count())).collect()
}

/// Every n-th usable foreground pixel of a training view, row by row.
pub(super) fn usable_pixels(world: &mut World, of: ViewIndex, every: usize) -> Vec<Candidate> {
    let mut views = world.query::<ViewColumns>();
    let training = training_views(views.iter(world));
    let chosen = training.iter().filter(|view| view.index == of);
    chosen.flat_map(|view| view.usable().step_by(every).map(|pixel| view.candidate(pixel))).collect()
}

/// Sample: chooses the usable foreground pixels of the training views, in an order shuffled by the seed.
pub fn choose_pixels(
    choice: Res<PixelChoice>,
    views: Query<ViewColumns>,
    (placed, placements): (Query<(&ViewIndex, &Placement)>, Option<Res<Placements>>),
    texels: Query<(), With<TexelIndex>>,
    mut candidates: ResMut<Candidates>,
) -> SystemResult {
    let training = training_views(views.iter());
    let few = choice.max_pixels / ENOUGH_PER_TEXEL < texels.iter().len();
    let drawn = if choice.evenly && few { DRAWN } else { 1 };
    let choice = PixelChoice { max_pixels: choice.max_pixels.saturating_mul(drawn), ..*choice };
    candidates.0 = match Windows::new(&training).scattered(choice) {
        Some(scattered) => scattered,
        None => any_of_all(&training, choice)?,
    };
    // Steps visit groups of photographs one at a time.
    if let Some(placements) = placements.filter(|placements| placements.has_groups()) {
        let of_view = |(view, placement): (&ViewIndex, &Placement)| (*view, placements.light(*placement));
        let groups: ByView<LightGroup> = placed.iter().map(of_view).collect();
        candidates.0.sort_by_key(|candidate| groups.get(candidate.pixel.view).copied());
    }
    Ok(())
}

/// Usable pixels in a random order, cut short; every pixel of every view is looked at.
fn any_of_all(training: &[ObservedView], choice: PixelChoice) -> Result<Vec<Candidate>> {
    let counts: Vec<usize> = training.par_iter().map(|view| view.usable().count()).collect();
    let total: usize = counts.iter().sum();
    if total == 0 {
        let views = training.len();
        return Err(Error::run(
            "fit",
            format!("no usable foreground pixel in {views} training views (masked out, or all saturated)"),
        ));
    }
    Ok(candidates_of(training, &counts, &shuffled(total, choice)))
}

/// From so many times the pixels that may be chosen on, a part of them is looked at.
const SPARSE: usize = 16;
/// Strata that are tried first, to learn which part of the pixels is usable; and how many of them must be.
const TRIED: usize = 1 << 16;
const LEAST_USABLE: usize = 256;

/// The pixels of the windows of all views, numbered through.
struct Windows<'a> {
    views: &'a [ObservedView<'a>],
    /// The number of each view's first pixel.
    first: Vec<usize>,
    total: usize,
}

impl<'a> Windows<'a> {
    fn new(views: &'a [ObservedView<'a>]) -> Self {
        let mut total = 0;
        let mut first = Vec::with_capacity(views.len());
        for view in views {
            first.push(total);
            total += view.window().len();
        }
        Self { views, first, total }
    }

    /// About as many usable pixels as may be chosen, in a random order: one at random of each of as many equal strata as are needed, so that each
    /// view, and each part of it, has its share. `None` if they are so few that all should be looked at.
    ///
    /// Takes time by the number of chosen pixels, not of photographs.
    fn scattered(&self, choice: PixelChoice) -> Option<Vec<Candidate>> {
        if self.total / SPARSE < choice.max_pixels.max(TRIED) {
            return None;
        }
        let mut random = SmallRng::seed_from_u64(choice.seed);
        let usable = self.draw(TRIED, random.random()).len();
        let strata = choice.max_pixels * TRIED / usable.max(1);
        if usable < LEAST_USABLE || strata > self.total / 2 {
            return None;
        }
        let mut chosen = self.draw(strata, random.random());
        chosen.shuffle(&mut random);
        chosen.truncate(choice.max_pixels);
        Some(chosen)
    }

    /// The usable ones of one random pixel in each stratum, in the order of the strata.
    fn draw(&self, strata: usize, seed: u64) -> Vec<Candidate> {
        let edge = |stratum: usize| (stratum as u128 * self.total as u128 / strata as u128) as usize;
        let of_stratum = |stratum: usize| {
            let mut random = SmallRng::seed_from_u64(seed.wrapping_add(stratum as u64));
            self.candidate(random.random_range(edge(stratum)..edge(stratum + 1)))
        };
        (0..strata).into_par_iter().filter_map(of_stratum).collect()
    }

    /// The pixel of this number, if it is usable.
    fn candidate(&self, number: usize) -> Option<Candidate> {
        let at = self.first.partition_point(|first| *first <= number) - 1;
        let (view, place) = (&self.views[at], number - self.first[at]);
        let window = view.window();
        let (x, y) = (place % window.width as usize, place / window.width as usize);
        let pixel = (window.y as usize + y) * view.camera.width as usize + window.x as usize + x;
        view.is_usable(pixel).then(|| view.candidate(pixel))
    }
}

/// Numbers from 0 to `total` in a random order, cut short.
fn shuffled(total: usize, choice: PixelChoice) -> Vec<u32> {
    let mut random = SmallRng::seed_from_u64(choice.seed);
    if total > MOST_SHUFFLED {
        let drawn = rand::seq::index::sample(&mut random, total, choice.max_pixels.min(total));
        return drawn.into_iter().map(|i| i as u32).collect();
    }
    let mut order: Vec<u32> = (0..total as u32).collect();
    order.shuffle(&mut random);
    order.truncate(choice.max_pixels);
    order.shrink_to_fit();
    order
}

/// The pixels with these numbers, counted over the usable pixels of all views.
fn candidates_of(views: &[ObservedView], counts: &[usize], chosen: &[u32]) -> Vec<Candidate> {
    let mut by_number: Vec<(u32, u32)> =
        chosen.iter().zip(0..).map(|(number, place)| (*number, place)).collect();
    by_number.par_sort_unstable();
    let mut rest = by_number.as_slice();
    let mut first = 0;
    let mut parts = Vec::new();
    for (view, count) in views.iter().zip(counts) {
        let (of_view, others) =
            rest.split_at(rest.partition_point(|(number, _)| (*number as usize) < first + count));
        parts.push((view, first, of_view));
        (rest, first) = (others, first + count);
    }
    let of_view =
        |(view, first, numbers): (&ObservedView, usize, &[(u32, u32)])| view.candidates(first, numbers);
    let found: Vec<Vec<Candidate>> = parts.into_par_iter().map(of_view).collect();
    let mut candidates = vec![Candidate::default(); chosen.len()];
    for ((_, place), candidate) in by_number.iter().zip(found.into_iter().flatten()) {
        candidates[*place as usize] = candidate;
    }
    candidates
}

impl ObservedView<'_> {
    /// Pixels that are fully covered and whose value says something.
    fn usable(&self) -> impl Iterator<Item = usize> {
        self.window().pixels(self.camera.width).filter(|i| self.is_usable(*i))
    }

    /// The part of the picture with pixels of the object.
    fn window(&self) -> PixelWindow {
        self.mask.map_or(PixelWindow::whole(self.camera.width, self.camera.height), StoredMask::window)
    }

    #[inline]
    fn is_usable(&self, pixel: usize) -> bool {
        if self.mask.is_some_and(|mask| mask.coverage(pixel) < FULL_COVERAGE) {
            return false;
        }
        // A non-finite pixel is read as black, an average of saturated pixels has no information, and no light glares in one view alone.
        let brightest = self.photograph.radiance(pixel).max_element();
        brightest <= self.limit && (brightest >= SATURATION || !self.photograph.is_saturated(pixel))
    }

    /// The usable pixels with these numbers, in rising order, of which the first has number `first`.
    fn candidates(&self, first: usize, numbers: &[(u32, u32)]) -> Vec<Candidate> {
        let mut wanted = numbers.iter().map(|(number, _)| *number as usize - first).peekable();
        let is_wanted = |(number, _): &(usize, usize)| wanted.next_if_eq(number).is_some();
        self.usable().enumerate().filter(is_wanted).map(|(_, pixel)| self.candidate(pixel)).collect()
    }

    fn candidate(&self, pixel: usize) -> Candidate {
        let (radiance, saturated) = (self.photograph.radiance(pixel), self.photograph.is_saturated(pixel));
        Candidate {
            pixel: PixelOf { view: self.index, pixel: pixel as u32 },
            observed: Observed { radiance, saturated },
        }
    }
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
    let holds = |made: &&PoolMade| {
        made.choice == choice && made.cameras == cameras && Arc::ptr_eq(&made.scenery, &scenery)
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
    let chosen = with_even_shares(chosen, choice, &cameras, scenery.as_ref())?;
    release_pool(world);
    let mut rows = 0;
    // In parts: all points beside the pool would be half of it.
    for part in chosen.chunks(TRACED_AT_ONCE) {
        check_interrupted()?;
        let trace = |candidate: &Candidate| candidate.trace(&cameras, scenery.as_ref());
        let traced: Vec<Option<Observation>> = part.par_iter().map(trace).collect::<Result<_>>()?;
        let observations: Vec<(ObservationIndex, Observation)> =
            (rows..).map(ObservationIndex).zip(traced.into_iter().flatten()).collect();
        rows += observations.len() as u32;
        world.spawn_batch(observations);
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
    world.insert_resource(PoolMade { choice, cameras: made_with, scenery, rows });
    Ok(())
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
