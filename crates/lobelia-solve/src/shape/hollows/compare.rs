//! At which depth behind a surface a photograph agrees with those around it.

use crate::shape::pictures::{ColorPicture, Seen, views_beside};
use glam::Vec3;
use lobelia_geometry::{error::stop::is_stopping, mesh::bvh::TriangleBvh};
use lobelia_sg::ray::Ray;

/// Angles in degrees between a view and those around it: less shows no depth, from more the same is
/// seldom seen.
const ANGLES: (f32, f32) = (6.0, 50.0);
const MOST_SOURCES: usize = 10;
/// Sine of the angle to a typical one.
pub(super) const SINE: f32 = 0.3;
/// Length of a step of the search, in pixels of a view around, and the most steps.
const STEP: f32 = 0.5;
const MOST_STEPS: usize = 200;
/// Steps before the surface, and behind it, at which what is seen is the surface.
const AT_SURFACE: usize = 3;
/// Steps after which the search leaves out the pixels whose rays have left the object.
const LOOK_AGAIN: usize = 8;
/// Half width of a patch in pixels, and share of it that both pictures must show.
const RADIUS: usize = 1;
const LEAST_PIXELS: f32 = 5.0;
/// Largest difference of colors (the sum of three channels in [0, 1]) that counts.
const MOST_DIFFERENCE: f32 = 0.6;
/// Stands for a difference that is not known.
const UNKNOWN: f32 = -1.0;
/// Views that must see a depth, and share of them whose colors must agree. From the others
/// something may hide it that is not known yet, such as the wall of a deep cup below its lid.
const LEAST_SOURCES: usize = 3;
const BEST_SHARE: f32 = 0.3;
/// How many times smaller the difference of colors must be than at the surface, and by how much.
const RATIO: f32 = 2.0;
const CLEAR: f32 = 0.06;

/// A view around another: its picture, and what its pixels see.
type Source<'a> = (&'a ColorPicture, &'a [Seen]);

/// The views around picture `of` as seen from `center`, from near to far, evenly chosen.
pub(super) fn around(pictures: &[ColorPicture], of: usize, center: Vec3) -> Vec<usize> {
    let near = views_beside(pictures, of, center, ANGLES.0..=ANGLES.1, |angle| angle);
    let stride = (near.len() as f32 / MOST_SOURCES as f32).max(1.0);
    let count = near.len().min(MOST_SOURCES);
    (0..count).map(|k| near[((k as f32 + 0.5) * stride) as usize]).collect()
}

/// How far along its rays a picture sees something: the surface, where they go to what is `seen`,
/// or what lies behind it; 0 where that is not known. `sources` are views around it.
pub fn compare(bvh: &TriangleBvh, picture: &ColorPicture, seen: &[Seen], sources: &[Source]) -> Vec<f32> {
    let mut depths = vec![0.0; seen.len()];
    if sources.len() < LEAST_SOURCES {
        return depths;
    }
    let mut search = Search::new(picture, seen, sources);
    let lasts = last_steps(bvh, picture, seen, search.step);
    // The least differences of colors at the surface, and those of all depths with their steps.
    let mut at_surface = vec![f32::INFINITY; seen.len()];
    let mut least = vec![(f32::INFINITY, 0); seen.len()];
    for k in 0..=lasts.iter().copied().max().unwrap_or(0) {
        if is_stopping() {
            return depths;
        }
        if k == 2 * AT_SURFACE + 1 {
            // Where colors agree so well at the surface, no other depth can be much better.
            search.ask_only(|at| at_surface[at] > CLEAR);
        } else if k > 2 * AT_SURFACE && k.is_multiple_of(LOOK_AGAIN) {
            search.ask_only(|at| k <= lasts[at]);
        }
        search.differences(shift_of(k), |at, difference| {
            if k <= lasts[at].max(2 * AT_SURFACE) && difference < least[at].0 {
                least[at] = (difference, k);
            }
            if k <= 2 * AT_SURFACE {
                at_surface[at] = at_surface[at].min(difference);
            }
        });
    }
    for (at, depth) in depths.iter_mut().enumerate() {
        let ((difference, k), surface) = (least[at], at_surface[at]);
        let limit = (surface - CLEAR).min(surface / RATIO);
        // Where nothing could be compared at the surface, nothing behind it is better.
        let is_shown = k <= 2 * AT_SURFACE || (surface.is_finite() && difference < limit);
        if difference.is_finite() && is_shown {
            *depth = seen[at].distance * (1.0 + shift_of(k) * search.step);
        }
    }
    depths
}

/// How far step `k` of the search moves the surface along the rays, in pixels of a view around.
fn shift_of(k: usize) -> f32 {
    (k as f32 - AT_SURFACE as f32) * STEP
}

/// The last step of each pixel's search, where its ray leaves the surface for good; 0 where it
/// meets none.
fn last_steps(bvh: &TriangleBvh, picture: &ColorPicture, seen: &[Seen], step: f32) -> Vec<usize> {
    let (center, radius) = bvh.bounding_sphere();
    let beyond = picture.camera.position().distance(center) + 2.0 * radius;
    let last = |(ray, seen): (Ray, &Seen)| {
        if seen.distance.is_infinite() {
            return 0;
        }
        let back = Ray { origin: ray.origin + ray.direction * beyond, direction: -ray.direction };
        let far = bvh.nearest(&back, 0.0).map_or(0.0, |hit| beyond - hit.distance);
        (((far / seen.distance - 1.0) / (STEP * step)).ceil() as usize + AT_SURFACE).min(MOST_STEPS)
    };
    picture.rays().zip(seen).map(last).collect()
}

struct Search<'a> {
    picture: &'a ColorPicture,
    seen: &'a [Seen],
    sources: &'a [Source<'a>],
    rays: Vec<Vec3>,
    /// One pixel of a view around, along a ray, relative to the distance.
    step: f32,
    /// Pixels that are asked, and those whose colors are looked up for their patches.
    asked: Vec<usize>,
    looked_up: Vec<usize>,
    /// Differences of colors between each pixel and the views around it.
    warped: Vec<[f32; MOST_SOURCES]>,
}

impl<'a> Search<'a> {
    fn new(picture: &'a ColorPicture, seen: &'a [Seen], sources: &'a [Source<'a>]) -> Self {
        let rays = picture.rays().map(|ray| ray.direction).collect();
        let asked: Vec<usize> = (0..seen.len()).filter(|&at| seen[at].distance.is_finite()).collect();
        let warped = vec![[UNKNOWN; MOST_SOURCES]; seen.len()];
        let (step, looked_up) = (picture.step(SINE), asked.clone());
        Self { picture, seen, sources, rays, step, asked, looked_up, warped }
    }

    /// Asks only for pixels that may have a better depth.
    fn ask_only(&mut self, is_asked: impl Fn(usize) -> bool) {
        self.asked.retain(|&at| is_asked(at));
        let mut is_looked_up = vec![false; self.seen.len()];
        for &at in &self.asked {
            self.patch(at).for_each(|i| is_looked_up[i] = self.seen[i].distance.is_finite());
        }
        self.looked_up.retain(|&at| is_looked_up[at]);
        self.warped.fill([UNKNOWN; MOST_SOURCES]);
    }

    /// The pixels of the patch around one.
    fn patch(&self, at: usize) -> impl Iterator<Item = usize> + use<> {
        let (width, height) = (self.picture.window.width as usize, self.picture.window.height as usize);
        let (x, y) = (at % width, at / width);
        let rows = y.saturating_sub(RADIUS)..(y + RADIUS + 1).min(height);
        let columns = x.saturating_sub(RADIUS)..(x + RADIUS + 1).min(width);
        rows.flat_map(move |y| columns.clone().map(move |x| y * width + x))
    }

    /// Hands out how much the best of the views around differ in each pixel's patch, if the surface
    /// is moved along the rays by `shift` pixels.
    fn differences(&mut self, shift: f32, mut found: impl FnMut(usize, f32)) {
        self.warp(shift);
        for &at in &self.asked {
            let (mut sums, mut counts) = ([0.0; MOST_SOURCES], [0.0; MOST_SOURCES]);
            for i in self.patch(at) {
                for (difference, (sum, count)) in self.warped[i].iter().zip(sums.iter_mut().zip(&mut counts))
                {
                    let is_known = f32::from(u8::from(*difference >= 0.0));
                    *sum += is_known * difference;
                    *count += is_known;
                }
            }
            let (mut all, mut many) = ([f32::INFINITY; MOST_SOURCES], 0);
            for (sum, count) in sums.into_iter().zip(counts).filter(|(_, count)| *count >= LEAST_PIXELS) {
                all[many] = sum / count;
                many += 1;
            }
            if many >= LEAST_SOURCES {
                all.sort_unstable_by(f32::total_cmp);
                let best = ((BEST_SHARE * many as f32).round() as usize).max(2);
                found(at, all[..best].iter().sum::<f32>() / best as f32);
            }
        }
    }

    /// Writes the differences of colors between each pixel that is looked up and the views around
    /// it.
    fn warp(&mut self, shift: f32) {
        let origin = self.picture.camera.position();
        for &at in &self.looked_up {
            let (distance, color) = (self.seen[at].distance, self.picture.values[at]);
            let point = origin + self.rays[at] * (distance * (1.0 + shift * self.step));
            // A point well behind what the other view sees there is hidden from it.
            let slack = self.step * distance * (3.0 + 2.0 * shift.abs());
            for ((theirs, seen), warped) in self.sources.iter().zip(&mut self.warped[at]) {
                let is_seen = |place: usize| {
                    let limit = seen[place].distance + slack;
                    theirs.camera.position().distance_squared(point) <= limit * limit
                };
                *warped = match theirs.at(point) {
                    Some((other, place)) if is_seen(place) => {
                        (other - color).abs().element_sum().min(MOST_DIFFERENCE)
                    }
                    _ => UNKNOWN,
                };
            }
        }
    }
}
