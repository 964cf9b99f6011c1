//! The Prepare phase: every usable foreground pixel of the training views becomes one row of the
//! pool of observed pixels, traced once. Each step then takes some of them into the samples.

use crate::fit::{cameras::cameras_move, components::TexelSeen, groups::groups_of_views};
use bevy_ecs::prelude::{Query, Res, Resource, With, World};
use bevy_ecs::system::RunSystemOnce;
use glam::Vec2;
use lobelia_geometry::view::{ByView, Camera, Photograph, StoredMask, ViewIndex};
use lobelia_geometry::view::{PixelWindow, Split, ViewMask, glare_limit, raster::FULL_COVERAGE};
use lobelia_geometry::{Error, Result, error::stop::check_interrupted, parallel};
use lobelia_sg::ray::Intersect;
use lobelia_world::light::placement::Placements;
use lobelia_world::material::{TexelIndex, Texels};
use lobelia_world::pipeline::{Phase, Pipeline, SystemResult, pool::Pool};
use lobelia_world::sample::pixel::{ImageGradient, Observed, PixelOf, SATURATION, SampleIndex, ViewRay};
use lobelia_world::sample::point::{Scenery, SurfacePoint};
use lobelia_world::sample::{
    FitSample, FrameSample, Observation, ObservationIndex, Observations, ObservedGradient, ObservedWindow,
    Samples, despawn_observations, despawn_pool,
};
use rand::{RngExt, SeedableRng, rngs::SmallRng, seq::SliceRandom};
use std::ops::Range;
use std::sync::{Arc, OnceLock};

/// Inputs from which the pool of observed pixels was made.
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

/// The training views in order, each with the number of its usable foreground pixels.
pub(super) fn usable_by_view(world: &mut World) -> Vec<(ViewIndex, usize)> {
    let training = training_views(world);
    parallel::map_slice(&training, 1, |view| (view.index, view.usable().count()))
}

/// Every n-th usable foreground pixel of a training view, row by row.
pub(super) fn usable_pixels(world: &mut World, of: ViewIndex, every: usize) -> Vec<PixelOf> {
    let training = training_views(world);
    let chosen = training.iter().filter(|view| view.index == of);
    chosen.flat_map(|view| view.usable().step_by(every)).collect()
}

/// Runs Prepare, unless the pool that it would make of the photographs is there; returns the number
/// of pixels.
///
/// # Errors
/// If there is no pixel to fit to.
pub(super) fn make_pool(pipeline: &mut Pipeline) -> Result<usize> {
    if !pool_holds(&mut pipeline.world) {
        pipeline.run(Phase::Prepare)?;
    }
    // A part of a fit begins with texels that nobody has seen.
    let counted = pipeline.world.run_system_once(count_seen_texels);
    counted.map_err(|error| Error::run("fit", error.to_string()))??;
    Ok(pipeline.world.resource::<ObservedWindow>().0.len())
}

/// Whether the pool holds the same choice of pixels, seen by the same cameras on the same surface.
/// Its whole is then the window.
fn pool_holds(world: &mut World) -> bool {
    let cameras = cameras_in_order(world);
    let (choice, scenery) = (*world.resource::<PixelChoice>(), world.resource::<Scenery>().0.clone());
    let needs_gradients = cameras_move(world);
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

/// Trace: casts the rays of pixels that it chooses; those that meet the front of the surface become
/// the pool of observed pixels.
pub fn trace_pixels(world: &mut World) -> SystemResult {
    let choice = *world.resource::<PixelChoice>();
    let chosen = choose_pixels(world, choice)?;
    let scenery = world.resource::<Scenery>().0.clone();
    let made_with = cameras_in_order(world);
    let cameras: ByView<Camera> = made_with.iter().copied().collect();
    let gradients = cameras_move(world);
    // The point of a pixel's ray, if it meets the front of the surface.
    let trace = |pixel: &PixelOf| -> Result<Option<SurfacePoint>> {
        let ray = cameras.of(pixel.view)?.pixel_ray(pixel.pixel);
        let point = SurfacePoint::from(scenery.intersect(&ray, 0.0));
        Ok((point.is_hit() && point.normal.dot(ray.direction) < 0.0).then_some(point))
    };
    let chosen = with_even_shares(chosen, choice.max_pixels, trace)?;
    release_pool(world);
    let mut rows = 0;
    // In parts: all points beside the pool would be half of it.
    for part in chosen.chunks(TRACED_AT_ONCE) {
        check_interrupted()?;
        let training: ByView<_> = training_views(world).into_iter().map(|view| (view.index, view)).collect();
        let observe = |pixel: &PixelOf| -> Result<Option<(Observation, ObservedGradient)>> {
            let (Some(point), view) = (trace(pixel)?, training.of(pixel.view)?) else { return Ok(None) };
            let gradient = if gradients { view.gradient(pixel.pixel as usize) } else { ImageGradient(None) };
            let observed = observed_in(view.photograph, pixel.pixel);
            Ok(Some((Observation { pixel: *pixel, observed, point }, ObservedGradient(gradient))))
        };
        let met = parallel::map_slice(part, 64, observe).into_iter().collect::<Result<Vec<Option<_>>>>()?;
        let observations: Vec<_> = (rows..).map(ObservationIndex).zip(met.into_iter().flatten()).collect();
        rows += observations.len() as u32;
        if gradients {
            world.spawn_batch(observations);
        } else {
            let alone = observations.into_iter().map(|(index, (observation, _))| (index, observation));
            world.spawn_batch(alone.collect::<Vec<_>>());
        }
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

/// The observation of a pixel in its photograph.
pub(super) fn observed_in(photograph: &Photograph, pixel: u32) -> Observed {
    let pixel = pixel as usize;
    Observed { radiance: photograph.radiance(pixel), saturated: photograph.is_saturated(pixel) }
}

/// Of more pixels than there is room for those that give each texel its share, in the same order.
fn with_even_shares(
    chosen: Vec<PixelOf>,
    most: usize,
    trace: impl Fn(&PixelOf) -> Result<Option<SurfacePoint>> + Sync,
) -> Result<Vec<PixelOf>> {
    if chosen.len() <= most {
        return Ok(chosen);
    }
    let mut texels = Vec::with_capacity(chosen.len());
    for part in chosen.chunks(TRACED_AT_ONCE) {
        check_interrupted()?;
        let texel = |pixel: &PixelOf| Ok(trace(pixel)?.map_or(NO_TEXEL, |point| point.texels.main()));
        let of_part = parallel::map_slice(part, 64, texel).into_iter();
        texels.append(&mut of_part.collect::<Result<Vec<u32>>>()?);
    }
    let kept = kept_evenly(&texels, most);
    Ok(chosen.into_iter().zip(kept).filter_map(|(pixel, kept)| kept.then_some(pixel)).collect())
}

/// Spawns the samples of a step of `batch` pixels.
pub(crate) fn spawn_samples(world: &mut World, batch: usize) {
    despawn_pool(world);
    let blank = |row| {
        let frame = FrameSample { index: SampleIndex(row), ..FrameSample::default() };
        FitSample { frame, ..FitSample::default() }
    };
    world.spawn_batch((0..batch as u32).map(blank).collect::<Vec<_>>());
}

/// Sample: takes the observed pixels of this step into the samples, with rays through the cameras
/// as they are now.
pub fn take_observations(
    taken: Res<ObservedWindow>,
    observations: Observations,
    views: Query<(&ViewIndex, &Camera), With<Photograph>>,
    samples: Samples<(&mut PixelOf, &mut Observed, &mut SurfacePoint, &mut ViewRay)>,
) -> SystemResult {
    let cameras: ByView<Camera> = views.iter().map(|(index, camera)| (*index, *camera)).collect();
    let observations = observations.rows(taken.0.clone())?;
    let (mut pixels, mut observed, mut points, mut rays) = samples.columns()?;
    let missing = OnceLock::new();
    let columns = (((&mut *pixels, &mut *observed), &mut *points), (&mut *rays, &*observations));
    parallel::for_each_row(columns, 1024, |(((pixel, observed), point), (ray, from))| {
        (*pixel, *observed, *point) = (from.pixel, from.observed, from.point);
        match cameras.of(from.pixel.view) {
            Ok(camera) => ray.0 = camera.pixel_ray(from.pixel.pixel),
            Err(error) => drop(missing.set(error)),
        }
    });
    missing.into_inner().map_or(Ok(()), |error| Err(error.into()))
}

/// Sample: takes their gradients, which they have if cameras are to be moved.
pub fn take_gradients(
    taken: Res<ObservedWindow>,
    observed: Pool<ObservationIndex, &'static ObservedGradient>,
    samples: Samples<&mut ImageGradient>,
) -> SystemResult {
    let (observed, mut gradients) = (observed.rows(taken.0.clone())?, samples.columns()?);
    gradients.iter_mut().zip(&*observed).for_each(|(gradient, from)| *gradient = from.0);
    Ok(())
}

/// Sums the weights of each texel over all observed pixels.
fn count_seen_texels(observations: Observations, texels: Texels<&mut TexelSeen>) -> Result<()> {
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

/// A training view with a photograph.
struct ObservedView<'a> {
    pub index: ViewIndex,
    pub camera: &'a Camera,
    pub photograph: &'a Photograph,
    pub mask: Option<&'a StoredMask>,
    /// The greatest radiance of a pixel that is not broken.
    pub limit: f32,
}

/// The training views with a photograph, in the order of their indices.
fn training_views(world: &mut World) -> Vec<ObservedView<'_>> {
    let mut views = world.query::<(&ViewIndex, &Camera, &Photograph, Option<&ViewMask>, &Split)>();
    let training = views.iter(world).filter(|(.., split)| **split == Split::Train);
    let observed = training.map(|(index, camera, photograph, mask, _)| ObservedView {
        index: *index,
        camera,
        photograph,
        mask: mask.map(|mask| &mask.0),
        limit: f32::INFINITY,
    });
    let mut training: Vec<ObservedView> = observed.collect();
    let limit = glare_limit(training.iter().map(|view| view.photograph.highest()));
    training.iter_mut().for_each(|view| view.limit = limit);
    training.sort_by_key(|view| view.index);
    training
}

impl ObservedView<'_> {
    /// Pixels that are fully covered and whose value says something.
    pub fn usable(&self) -> impl Iterator<Item = PixelOf> {
        let usable = self.window().pixels(self.camera.width).filter(|i| self.is_usable(*i));
        usable.map(|i| PixelOf { view: self.index, pixel: i as u32 })
    }

    /// The part of the picture with pixels of the object.
    pub fn window(&self) -> PixelWindow {
        self.mask.map_or(PixelWindow::whole(self.camera.width, self.camera.height), StoredMask::window)
    }

    #[inline]
    pub fn is_usable(&self, pixel: usize) -> bool {
        if self.mask.is_some_and(|mask| mask.coverage(pixel) < FULL_COVERAGE) {
            return false;
        }
        // A non-finite pixel is read as black, an average of saturated pixels has no information,
        // and no light glares in one view alone.
        let brightest = self.photograph.radiance(pixel).max_element();
        brightest <= self.limit && (brightest >= SATURATION || !self.photograph.is_saturated(pixel))
    }

    fn gradient(&self, pixel: usize) -> ImageGradient {
        let (width, height) = (self.camera.width as usize, self.camera.height as usize);
        let (x, y) = (pixel % width, pixel / width);
        if x == 0 || y == 0 || x + 1 == width || y + 1 == height {
            return ImageGradient(None);
        }
        let at = |i: usize| {
            let whole = self.mask.is_none_or(|mask| mask.coverage(i) >= FULL_COVERAGE);
            let known = whole && !self.photograph.is_saturated(i);
            known.then(|| self.photograph.radiance(i).element_sum() / 3.0)
        };
        let along = |step: usize| Some(0.5 * (at(pixel + step)? - at(pixel - step)?));
        ImageGradient(along(1).zip(along(width)).map(Vec2::from))
    }
}

/// Pixels a texel from which chance gives each enough: shares then make the light slightly worse
/// (`docs/research/fit.md`).
const ENOUGH_PER_TEXEL: usize = 4;
/// Pixels that are drawn and traced for each that is chosen, where texels get their shares.
const DRAWN: usize = 2;

/// Chooses usable foreground pixels of the training views, in an order shuffled by the seed.
fn choose_pixels(world: &mut World, choice: PixelChoice) -> Result<Vec<PixelOf>> {
    let texels = world.query_filtered::<(), With<TexelIndex>>().iter(world).len();
    let drawn = if choice.evenly && choice.max_pixels / ENOUGH_PER_TEXEL < texels { DRAWN } else { 1 };
    let choice = PixelChoice { max_pixels: choice.max_pixels.saturating_mul(drawn), ..choice };
    // Steps visit groups of photographs one at a time.
    let has_groups = world.get_resource::<Placements>().is_some_and(Placements::has_groups);
    let groups = has_groups.then(|| groups_of_views(world));
    let training = training_views(world);
    let mut chosen = scattered(&training, choice).map_or_else(|| any_of_all(&training, choice), Ok)?;
    if let Some(groups) = groups {
        chosen.sort_by_key(|pixel| groups.get(pixel.view).copied());
    }
    Ok(chosen)
}

/// Usable pixels in a random order, cut short; every pixel of every view is looked at.
fn any_of_all(training: &[ObservedView], choice: PixelChoice) -> Result<Vec<PixelOf>> {
    let by_view: Vec<Vec<PixelOf>> = parallel::map_slice(training, 1, |view| view.usable().collect());
    let mut usable = by_view.concat();
    if usable.is_empty() {
        let views = training.len();
        return Err(Error::run(
            "fit",
            format!("no usable foreground pixel in {views} training views (masked out, or all saturated)"),
        ));
    }
    usable.shuffle(&mut SmallRng::seed_from_u64(choice.seed));
    usable.truncate(choice.max_pixels);
    Ok(usable)
}

/// From so many times the pixels that may be chosen on, a part of them is looked at.
const SPARSE: usize = 16;
/// Strata that are tried first, to learn which part of the pixels is usable; and how many of them
/// must be.
const TRIED: usize = 1 << 16;
const LEAST_USABLE: usize = 256;

/// About as many usable pixels as may be chosen, in a random order: one at random of each of as
/// many equal strata as are needed, so that each view, and each part of it, has its share. `None`
/// if they are so few that all should be looked at.
///
/// Takes time by the number of chosen pixels, not of photographs.
fn scattered(training: &[ObservedView], choice: PixelChoice) -> Option<Vec<PixelOf>> {
    // The pixels of the windows of all views are numbered through, those of a view in this range.
    let mut total = 0;
    let number = |view: &ObservedView| {
        let first = total;
        total += view.window().len();
        first..total
    };
    let numbers: Vec<Range<usize>> = training.iter().map(number).collect();
    if total / SPARSE < choice.max_pixels.max(TRIED) {
        return None;
    }
    // The usable ones of one random pixel in each stratum, in the order of the strata.
    let draw = |strata: usize, seed: u64| -> Vec<PixelOf> {
        let edge = |stratum: usize| (stratum as u128 * total as u128 / strata as u128) as usize;
        let near = |number: usize| (number as u128 * strata as u128 / total as u128) as usize;
        let of_view = |i: usize| -> Vec<PixelOf> {
            let (view, numbers) = (&training[i], &numbers[i]);
            let window = view.window();
            // A stratum may begin or end in another view, where the pixel then mostly is.
            let some = near(numbers.start).saturating_sub(1)..(near(numbers.end) + 2).min(strata);
            let pixel_of = |stratum: usize| {
                let mut random = SmallRng::seed_from_u64(seed.wrapping_add(stratum as u64));
                let number = random.random_range(edge(stratum)..edge(stratum + 1));
                let place = numbers.contains(&number).then(|| number - numbers.start)?;
                let pixel = window.pixel(place, view.camera.width);
                view.is_usable(pixel).then_some(PixelOf { view: view.index, pixel: pixel as u32 })
            };
            some.filter_map(pixel_of).collect()
        };
        parallel::flat_map(training.len(), 1, of_view)
    };
    let mut random = SmallRng::seed_from_u64(choice.seed);
    let usable = draw(TRIED, random.random()).len();
    let strata = choice.max_pixels * TRIED / usable.max(1);
    if usable < LEAST_USABLE || strata > total / 2 {
        return None;
    }
    let mut chosen = draw(strata, random.random());
    chosen.shuffle(&mut random);
    chosen.truncate(choice.max_pixels);
    Some(chosen)
}

/// The texel of a pixel that shows none.
pub(super) const NO_TEXEL: u32 = u32::MAX;

/// Marks those of the pixels with these texels that are kept, at most `most`: of each texel the
/// first ones, up to a number that is the same for all texels, and one more of the first that have
/// more. Pixels of [`NO_TEXEL`] are not kept.
///
/// Takes time and memory by the number of pixels and the greatest texel.
pub(super) fn kept_evenly(texels: &[u32], most: usize) -> Vec<bool> {
    let mut counts =
        vec![0u32; texels.iter().filter(|t| **t != NO_TEXEL).max().map_or(0, |t| *t as usize + 1)];
    texels.iter().filter(|t| **t != NO_TEXEL).for_each(|t| counts[*t as usize] += 1);
    let (share, mut spare) = even_share(&counts, most);
    let mut kept = vec![0u32; counts.len()];
    let keep = |texel: &u32| {
        let Some(kept) = kept.get_mut(*texel as usize) else { return false };
        let is_extra = *kept == share && spare > 0;
        if *kept < share || is_extra {
            *kept += 1;
            spare -= usize::from(is_extra);
            return true;
        }
        false
    };
    texels.iter().map(keep).collect()
}

/// The greatest share for which no more than `most` are kept of so many of each texel, and what is
/// left then.
fn even_share(counts: &[u32], most: usize) -> (u32, usize) {
    let kept = |share: u32| counts.iter().map(|count| (*count).min(share) as usize).sum::<usize>();
    let (mut low, mut high) = (0, counts.iter().copied().max().unwrap_or(0));
    while low < high {
        let middle = low + (high - low).div_ceil(2);
        if kept(middle) <= most { low = middle } else { high = middle - 1 }
    }
    (low, most - kept(low))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shape::test_support::Wall;
    use glam::{Affine3A, Vec3};
    use lobelia_geometry::view::{Image, Mask, Split};
    use lobelia_world::pipeline::Stage;

    #[test]
    fn rare_texels_keep_all_and_the_others_an_even_share() {
        // Six of texel 0, three of texel 1, one of texel 3, and one that misses.
        let texels = [0, 0, 1, NO_TEXEL, 0, 1, 0, 3, 1, 0, 0];
        let of = |kept: &[bool], texel: u32| {
            texels.iter().zip(kept).filter(|(t, kept)| **t == texel && **kept).count()
        };
        for (most, expected) in
            [(10, [6, 3, 1]), (20, [6, 3, 1]), (7, [3, 3, 1]), (6, [3, 2, 1]), (2, [1, 1, 0]), (0, [0; 3])]
        {
            let kept = kept_evenly(&texels, most);
            assert_eq!([0, 1, 3].map(|texel| of(&kept, texel)), expected, "{most}");
            assert!(!kept[3]);
        }
        // The first ones of a texel.
        let kept = kept_evenly(&texels, 3);
        assert!((0..11).filter(|at| kept[*at]).eq([0, 2, 7]));
        assert!(kept_evenly(&[], 5).is_empty());
    }

    #[test]
    fn broken_pixels_of_one_photograph_are_not_fitted_to() {
        let mut world = World::new();
        for view in 0..5 {
            let mut pixels = vec![Vec3::splat(0.5); 16];
            // A highlight that all have, and one broken pixel.
            pixels[3] = Vec3::splat(30.0);
            if view == 2 {
                pixels[7] = Vec3::new(0.1, 1e5, 0.1);
            }
            let photograph = Photograph::of_image(&Image { width: 4, height: 4, pixels });
            let camera = Camera::look_at(Vec3::Z, Vec3::ZERO, Vec3::Y, 40.0, 4, 4).unwrap();
            world.spawn((ViewIndex(view), camera, photograph, Split::Train));
        }
        let counts: Vec<usize> = usable_by_view(&mut world).into_iter().map(|(_, pixels)| pixels).collect();
        assert_eq!(counts, [16, 16, 15, 16, 16]);
        let pixels = usable_pixels(&mut world, ViewIndex(2), 1);
        assert!(pixels.iter().all(|of| of.pixel != 7) && pixels.iter().any(|of| of.pixel == 3));
    }

    #[test]
    fn a_pool_is_made_once_for_the_same_pixels_cameras_and_surface() {
        let mut pipeline = Pipeline::new();
        let world = &mut pipeline.world;
        let camera = Camera::look_at(Vec3::ZERO, Vec3::Z, Vec3::Y, 40.0, 4, 4).unwrap();
        let gray = Photograph::of_image(&Image { width: 4, height: 4, pixels: vec![Vec3::splat(0.5); 16] });
        let view = world.spawn((ViewIndex(0), camera, gray, Split::Train)).id();
        world.insert_resource(Scenery(Arc::new(Wall(Vec3::Z))));
        world.insert_resource(PixelChoice { seed: 1, max_pixels: 10, evenly: false });
        world.spawn((TexelIndex(0), TexelSeen(0.0)));
        world.init_resource::<ObservedWindow>();
        pipeline.add_systems(Phase::Prepare, Stage::Trace, trace_pixels);
        assert_eq!(make_pool(&mut pipeline).unwrap(), 10);
        let seen = |world: &mut World| world.query::<&TexelSeen>().single(world).map(|seen| seen.0).unwrap();
        assert_eq!(seen(&mut pipeline.world), 10.0);
        // A step narrows the window, and the next part of the fit begins with all, and with texels
        // that nobody has seen.
        pipeline.world.resource_mut::<ObservedWindow>().0 = 3..5;
        pipeline.world.query::<&mut TexelSeen>().single_mut(&mut pipeline.world).unwrap().0 = 0.0;
        assert_eq!(make_pool(&mut pipeline).unwrap(), 10);
        assert_eq!(pipeline.world.resource::<ObservedWindow>().0, 0..10);
        assert_eq!(seen(&mut pipeline.world), 10.0);
        let turned = Camera::look_at(Vec3::ZERO, Vec3::Z, Vec3::X, 40.0, 4, 4).unwrap();
        pipeline.world.entity_mut(view).insert(turned);
        assert!(!pool_holds(&mut pipeline.world));
        assert_eq!(make_pool(&mut pipeline).unwrap(), 10);
        assert!(pool_holds(&mut pipeline.world));
        pipeline.world.insert_resource(Scenery(Arc::new(Wall(Vec3::Z))));
        assert!(!pool_holds(&mut pipeline.world));
        pipeline.world.insert_resource(PixelChoice { seed: 1, max_pixels: 12, evenly: false });
        assert_eq!(make_pool(&mut pipeline).unwrap(), 12);
        release_pool(&mut pipeline.world);
        assert!(!pool_holds(&mut pipeline.world));
        assert_eq!(pipeline.world.query::<&ObservationIndex>().iter(&pipeline.world).len(), 0);
    }

    const SIDE: u32 = 1200;

    /// A view of which a disc is covered; its pixels left of the middle are saturated.
    struct View(Camera, Photograph, StoredMask);

    impl View {
        fn observed(&self, index: u32) -> ObservedView<'_> {
            let Self(camera, photograph, mask) = self;
            ObservedView { index: ViewIndex(index), camera, photograph, mask: Some(mask), limit: f32::MAX }
        }
    }

    fn view() -> View {
        let count = (SIDE * SIDE) as usize;
        let at = |i: usize| Vec3::new((i % SIDE as usize) as f32, (i / SIDE as usize) as f32, 0.0);
        let inside = |i: usize| at(i).distance(Vec3::new(700.0, 500.0, 0.0)) < 400.0;
        let image = Image { width: SIDE, height: SIDE, pixels: (0..count).map(|i| at(i) / 1200.0).collect() };
        let saturated: Vec<bool> = (0..count).map(|i| i % (SIDE as usize) < 600).collect();
        let coverage = (0..count).map(|i| if inside(i) { 1.0 } else { 0.0 }).collect();
        let mask = StoredMask::new(&Mask { width: SIDE, height: SIDE, coverage });
        let photograph = Photograph::new(&image, &saturated, mask.window(), true).unwrap();
        let camera = Camera {
            width: SIDE,
            height: SIDE,
            focal: [1000.0; 2],
            center: [600.0; 2],
            skew: 0.0,
            world_from_camera: Affine3A::IDENTITY,
            pixel_center: 0.5,
        };
        View(camera, photograph, mask)
    }

    #[test]
    fn scattered_pixels_are_usable_and_each_view_has_its_share() {
        let view = view();
        let views: Vec<ObservedView> = (0..20).map(|index| view.observed(index)).collect();
        let choice = PixelChoice { seed: 3, max_pixels: 50_000, evenly: false };
        let chosen = scattered(&views, choice).unwrap();
        assert!((49_000..=50_000).contains(&chosen.len()), "{}", chosen.len());
        let distinct: std::collections::BTreeSet<(u32, u32)> =
            chosen.iter().map(|c| (c.view.0, c.pixel)).collect();
        assert_eq!(distinct.len(), chosen.len());
        let mut shares = [0; 20];
        for c in &chosen {
            assert!(views[0].is_usable(c.pixel as usize));
            shares[c.view.0 as usize] += 1;
        }
        assert!(shares.iter().all(|share| (2350..2650).contains(share)), "{shares:?}");
        // As often below as above the middle of the disc.
        let below = chosen.iter().filter(|c| c.pixel / SIDE > 500).count() as f64 / chosen.len() as f64;
        assert!((below - 0.5).abs() < 0.01, "{below}");
        assert!(scattered(&views[..1], choice).is_none(), "few enough to look at all");
    }

    #[test]
    fn gradients_are_those_of_the_picture_where_its_neighbors_are_usable() {
        let all = view();
        let view = all.observed(0);
        let at = |x: u32, y: u32| view.gradient((y * SIDE + x) as usize).0;
        // The mean of three channels is (x + y) / 3600, as half floats.
        let found = at(800, 500).unwrap();
        assert!((found * 3600.0 - Vec2::ONE).abs().max_element() < 0.3, "{found}");
        assert!(at(601, 500).is_some() && at(600, 500).is_none(), "beside saturated pixels");
        let edge = (0..SIDE).rfind(|x| all.2.coverage((500 * SIDE + x) as usize) > 0.0).unwrap();
        assert!(at(edge - 1, 500).is_some() && at(edge, 500).is_none(), "at the edge of the mask");
    }
}
