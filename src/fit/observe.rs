//! The Prepare phase: every usable foreground pixel of the training views becomes one sample of the pool, traced once.

use crate::error::Error;
use crate::fit::components::TexelSeen;
use crate::material::Texels;
use crate::pipeline::SystemResult;
use crate::sample::Samples;
use crate::sample::bundle::{FitSample, FrameSample, despawn_pool};
use crate::sample::pixel::{Observed, PixelOf, SATURATION, SampleIndex, ViewRay, Window};
use crate::sample::point::{Scenery, SurfacePoint};
use crate::view::{Camera, Photograph, Split, ViewIndex, ViewMask};
use bevy_ecs::prelude::{Commands, Query, Res, ResMut, Resource, World};
use glam::Vec3;
use rand::seq::SliceRandom;
use rand::{SeedableRng, rngs::SmallRng};
use rayon::prelude::*;

/// The selection of pixels for a fit.
#[derive(Resource, Clone, Copy, Debug, PartialEq, Eq)]
pub struct PixelChoice {
    /// Seed of the order, and of the selection if there are too many.
    pub seed: u64,
    /// Most pixels; of more, a random subset is used.
    pub max_pixels: usize,
}

/// A pixel before it is traced.
#[derive(Clone, Copy)]
struct Candidate {
    pixel: PixelOf,
    ray: ViewRay,
    observed: Observed,
}

/// Pixels that are chosen and not yet traced.
#[derive(Resource, Default)]
pub struct Candidates(Vec<Candidate>);

/// Least coverage of a pixel that is used: partly covered pixels contain background as well.
pub const FULL_COVERAGE: f32 = 0.999;

/// Sample: chooses the usable foreground pixels of the training views, in an order shuffled by the seed.
pub fn choose_pixels(
    choice: Res<PixelChoice>,
    views: Query<(&ViewIndex, &Camera, &Photograph, Option<&ViewMask>, &Split)>,
    mut candidates: ResMut<Candidates>,
) -> SystemResult {
    candidates.0.clear();
    let mut training = 0;
    let mut in_order: Vec<_> = views.iter().collect();
    in_order.sort_by_key(|(index, ..)| **index);
    for (index, camera, photograph, mask, split) in in_order {
        if *split == Split::Train {
            training += 1;
            let coverage = mask.map(|m| m.0.coverage.as_slice());
            candidates.0.extend(usable_pixels(*index, camera, photograph, coverage));
        }
    }
    if candidates.0.is_empty() {
        return Err(Error::run(
            "fit",
            format!("no usable foreground pixel in {training} training views (masked out, or all saturated)"),
        )
        .into());
    }
    candidates.0.shuffle(&mut SmallRng::seed_from_u64(choice.seed));
    candidates.0.truncate(choice.max_pixels);
    Ok(())
}

fn usable_pixels<'a>(
    view: ViewIndex,
    camera: &'a Camera,
    photograph: &'a Photograph,
    coverage: Option<&'a [f32]>,
) -> impl Iterator<Item = Candidate> + 'a {
    let covered = move |i: usize| coverage.is_none_or(|c| c[i] >= FULL_COVERAGE);
    // A non-finite pixel is read as black, and an average of saturated pixels has no information.
    let readable =
        move |i: usize| !photograph.saturated[i] || photograph.image.pixels[i].max_element() >= SATURATION;
    (0..photograph.image.pixels.len()).filter(move |&i| covered(i) && readable(i)).map(move |i| Candidate {
        pixel: PixelOf { view, pixel: i as u32 },
        ray: ViewRay(camera.pixel_ray(i as u32)),
        observed: Observed { radiance: photograph.image.pixels[i], saturated: photograph.saturated[i] },
    })
}

/// Trace: casts the chosen pixels' rays; those that meet the front of the surface become the pool.
pub fn trace_pixels(
    scenery: Res<Scenery>,
    mut candidates: ResMut<Candidates>,
    mut window: ResMut<Window>,
    mut commands: Commands,
) -> SystemResult {
    let chosen = std::mem::take(&mut candidates.0);
    let points: Vec<SurfacePoint> =
        chosen.par_iter().map(|c| scenery.0.intersect(&c.ray.0, 0.0).into()).collect();
    let samples: Vec<FitSample> = chosen
        .iter()
        .zip(&points)
        .filter(|(c, p)| p.is_hit() && p.normal.dot(c.ray.0.direction) < 0.0)
        .zip(0..)
        .map(|((c, p), row)| FitSample {
            frame: FrameSample { pixel: c.pixel, point: *p, ..FrameSample::blank(SampleIndex(row), c.ray.0) },
            observed: c.observed,
            adjoint: Default::default(),
            back: Default::default(),
        })
        .collect();
    if samples.is_empty() {
        return Err(Error::usage(
            format!("fit: the rays of all {} foreground pixels miss the surface", chosen.len()),
            "Do the cameras and the mesh share one coordinate system? Does the mesh's outside face the cameras?",
        )
        .into());
    }
    window.0 = 0..samples.len();
    commands.queue(move |world: &mut World| {
        despawn_pool(world);
        world.spawn_batch(samples);
    });
    Ok(())
}

/// Gather: sums the weights of each texel over all samples.
pub fn count_seen_texels(
    samples: Samples<(&SurfacePoint, &Observed)>,
    texels: Texels<&mut TexelSeen>,
) -> SystemResult {
    let (points, _) = samples.columns()?;
    let mut seen = texels.columns()?.quiet();
    seen.fill(TexelSeen(0.0));
    for point in &*points {
        for i in 0..4 {
            seen[point.texels.indices[i] as usize].0 += point.texels.weights[i];
        }
    }
    Ok(())
}

/// Mean radiance of the pool, the scale of the initialization.
pub fn mean_radiance(observed: &[Observed]) -> Vec3 {
    let sum = observed.iter().fold(glam::DVec3::ZERO, |sum, o| sum + o.radiance.as_dvec3());
    (sum / observed.len().max(1) as f64).as_vec3()
}
