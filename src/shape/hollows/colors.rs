//! Small photographs in color, and at which depth behind a surface they agree with those around them.

use crate::error::stop::is_stopping;
use crate::math::color::srgb_from_linear;
use crate::math::ray::Ray;
use crate::mesh::bvh::TriangleBvh;
use crate::shape::shrunk::shrunk;
use crate::view::{Camera, Photograph, PixelWindow, StoredMask};
use glam::{Vec3, Vec3A};
use serde::{Deserialize, Serialize};

/// Angles in degrees between a view and those around it: less shows no depth, from more the same is seldom seen.
const ANGLES: (f32, f32) = (6.0, 50.0);
/// Most views around one.
const MOST_SOURCES: usize = 10;
/// Sine of the angle to a typical one.
const SINE: f32 = 0.3;
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
/// Views that must see a depth, and share of them whose colors must agree. From the others something may hide it that is not known
/// yet, such as the wall of a deep cup below its lid.
const LEAST_SOURCES: usize = 3;
const BEST_SHARE: f32 = 0.3;
/// How many times smaller the difference of colors must be than at the surface, and by how much.
const RATIO: f32 = 2.0;
const CLEAR: f32 = 0.06;

/// A photograph in color, with the curve of sRGB.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct ColorPicture {
    /// The camera of the small picture.
    pub camera: Camera,
    window: PixelWindow,
    /// The window's pixels; negative where the object is not alone.
    values: Vec<Vec3A>,
}

/// What a comparison found for each pixel of the window.
#[derive(Clone, Debug)]
pub struct DepthMap {
    /// Distance along the ray to what is seen; 0 if that is not known.
    pub depths: Vec<f32>,
    /// One pixel of a view around, along the ray, relative to the distance.
    pub step: f32,
}

impl ColorPicture {
    /// From a photograph, `factor` times smaller along each axis; `None` if the mask is empty.
    pub fn new(camera: &Camera, photograph: &Photograph, mask: &StoredMask, factor: u32) -> Option<Self> {
        let (small, window, pixels) = shrunk(camera, photograph, mask, factor)?;
        let encoded = |light: Vec3| light.clamp(Vec3::ZERO, Vec3::ONE).map(srgb_from_linear);
        let values = pixels.map(|light| Vec3A::from(light.map_or(Vec3::NEG_ONE, encoded))).collect();
        Some(Self { camera: small, window, values })
    }

    /// One pixel of a view around, along a ray, relative to the distance.
    pub fn step(&self) -> f32 {
        2.0 / ((self.camera.focal[0].abs() + self.camera.focal[1].abs()) * SINE)
    }

    /// How far the rays of the window's pixels go to the surface; infinitely where there is none or the object is not alone.
    pub fn cast(&self, bvh: &TriangleBvh) -> Vec<f32> {
        let far = |(at, pixel): (usize, usize)| {
            let alone = self.values[at].x >= 0.0 && !is_stopping();
            let hit = if alone { bvh.nearest(&self.camera.pixel_ray(pixel as u32), 0.0) } else { None };
            hit.map_or(f32::INFINITY, |hit| hit.distance)
        };
        self.window.pixels(self.camera.width).enumerate().map(far).collect()
    }

    /// The ray of a pixel of the window, and its color.
    #[inline]
    pub fn ray_and_color(&self, place: usize) -> (Ray, Vec3) {
        let (x, y) = (place as u32 % self.window.width, place as u32 / self.window.width);
        let pixel = (self.window.y + y) * self.camera.width + self.window.x + x;
        (self.camera.pixel_ray(pixel), self.values[place].into())
    }

    /// The window's pixel that shows a point, if it shows the object alone.
    pub fn place(&self, point: Vec3) -> Option<usize> {
        let (x, y, _) = self.camera.project(point)?;
        let (x, y) = (x - self.window.x as f32, y - self.window.y as f32);
        let inside = x >= 0.0 && y >= 0.0 && x < self.window.width as f32 && y < self.window.height as f32;
        let place = inside.then(|| y as usize * self.window.width as usize + x as usize)?;
        (self.values[place].x >= 0.0).then_some(place)
    }

    /// The bilinear color where a point is seen, with the nearest pixel of the window; `None` if a pixel around it does not show the object alone.
    #[inline]
    fn at(&self, point: Vec3) -> Option<(Vec3A, usize)> {
        let (x, y, _) = self.camera.project(point)?;
        let (x, y) = (x - 0.5 - self.window.x as f32, y - 0.5 - self.window.y as f32);
        let (width, height) = (self.window.width as usize, self.window.height as usize);
        if !(x >= 0.0 && y >= 0.0 && x < (width - 1) as f32 && y < (height - 1) as f32) {
            return None;
        }
        let (left, top) = (x as usize, y as usize);
        let (tx, ty) = (x - left as f32, y - top as f32);
        let first = top * width + left;
        let [a, b, c, d] = [first, first + 1, first + width, first + width + 1].map(|i| self.values[i]);
        if a.x.min(b.x).min(c.x).min(d.x) < 0.0 {
            return None;
        }
        let nearest = first + usize::from(tx >= 0.5) + if ty >= 0.5 { width } else { 0 };
        Some((a.lerp(b, tx).lerp(c.lerp(d, tx), ty), nearest))
    }
}

/// The views around picture `of` as seen from `center`, from near to far, evenly chosen.
pub fn around(pictures: &[ColorPicture], of: usize, center: Vec3) -> Vec<usize> {
    let direction = |i: usize| (pictures[i].camera.position() - center).normalize_or_zero();
    let angle = |i: usize| direction(i).angle_between(direction(of)).to_degrees();
    let all = (0..pictures.len()).filter(|i| *i != of).map(|i| (angle(i), i));
    let mut near: Vec<(f32, usize)> =
        all.filter(|(angle, _)| (ANGLES.0..=ANGLES.1).contains(angle)).collect();
    near.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let stride = (near.len() as f32 / MOST_SOURCES as f32).max(1.0);
    let count = near.len().min(MOST_SOURCES);
    (0..count).map(|k| near[((k as f32 + 0.5) * stride) as usize].1).collect()
}

/// Finds what a picture sees: the surface, whose distances are `seen`, or what lies behind it. `sources` are views around it with the same
/// distances of their own.
pub fn compare(
    bvh: &TriangleBvh,
    picture: &ColorPicture,
    seen: &[f32],
    sources: &[(&ColorPicture, &[f32])],
) -> DepthMap {
    let step = picture.step();
    let mut compared = DepthMap { depths: vec![0.0; seen.len()], step };
    if sources.len() < LEAST_SOURCES {
        return compared;
    }
    let mut search = Search::new(picture, seen, sources, step);
    let mut least = LeastDifferences::new(last_steps(bvh, picture, seen, step));
    let steps = least.lasts.iter().copied().max().unwrap_or(0);
    for k in 0..=steps {
        if is_stopping() {
            return compared;
        }
        least.narrow(&mut search, k);
        search.differences(shift_of(k), |at, difference| least.note(at, k, difference));
    }
    for (at, depth) in compared.depths.iter_mut().enumerate() {
        if let Some(k) = least.best_step(at) {
            *depth = seen[at] * (1.0 + shift_of(k) * step);
        }
    }
    compared
}

/// How far step `k` of the search moves the surface along the rays, in pixels of a view around.
fn shift_of(k: usize) -> f32 {
    (k as f32 - AT_SURFACE as f32) * STEP
}

/// The last step of each pixel's search, where its ray leaves the surface for good; 0 where it meets none.
fn last_steps(bvh: &TriangleBvh, picture: &ColorPicture, seen: &[f32], step: f32) -> Vec<usize> {
    let far = far_sides(bvh, picture, seen);
    let last = |at: usize| {
        (((far[at] / seen[at] - 1.0) / (STEP * step)).ceil() as usize + AT_SURFACE).min(MOST_STEPS)
    };
    (0..seen.len()).map(|at| if seen[at].is_finite() { last(at) } else { 0 }).collect()
}

/// The least differences of colors that a search has met, pixel by pixel.
struct LeastDifferences {
    /// The last step of each pixel's search.
    lasts: Vec<usize>,
    /// The least at the surface.
    surface: Vec<f32>,
    /// The least of all depths, with its step.
    all: Vec<(f32, usize)>,
}

impl LeastDifferences {
    /// Before the first step, when no difference is known.
    fn new(lasts: Vec<usize>) -> Self {
        let (surface, all) = (vec![f32::INFINITY; lasts.len()], vec![(f32::INFINITY, 0); lasts.len()]);
        Self { lasts, surface, all }
    }

    /// Has the search ask from step `k` on only for pixels that may still have a better depth.
    fn narrow(&self, search: &mut Search, k: usize) {
        if k == 2 * AT_SURFACE + 1 {
            // Where colors agree so well at the surface, no other depth can be much better.
            search.ask_only(|at| self.surface[at] > CLEAR);
        } else if k > 2 * AT_SURFACE && k.is_multiple_of(LOOK_AGAIN) {
            search.ask_only(|at| k <= self.lasts[at]);
        }
    }

    /// Takes note of the difference of pixel `at` at step `k`.
    fn note(&mut self, at: usize, k: usize, difference: f32) {
        if k <= self.lasts[at].max(2 * AT_SURFACE) && difference < self.all[at].0 {
            self.all[at] = (difference, k);
        }
        if k <= 2 * AT_SURFACE {
            self.surface[at] = self.surface[at].min(difference);
        }
    }

    /// The step whose depth pixel `at` shows: one at the surface, or one behind it that is clearly better; `None` if neither is known.
    fn best_step(&self, at: usize) -> Option<usize> {
        let ((difference, k), surface) = (self.all[at], self.surface[at]);
        let limit = (surface - CLEAR).min(surface / RATIO);
        // Where nothing could be compared at the surface, nothing behind it is better.
        let is_shown = k <= 2 * AT_SURFACE || (surface.is_finite() && difference < limit);
        (difference.is_finite() && is_shown).then_some(k)
    }
}

/// Where each pixel's ray leaves the surface for good.
fn far_sides(bvh: &TriangleBvh, picture: &ColorPicture, seen: &[f32]) -> Vec<f32> {
    let (center, radius) = bvh.bounding_sphere();
    let beyond = picture.camera.position().distance(center) + 2.0 * radius;
    let far = |(at, pixel): (usize, usize)| {
        let ray = picture.camera.pixel_ray(pixel as u32);
        let back = Ray { origin: ray.origin + ray.direction * beyond, direction: -ray.direction };
        let hit = if seen[at].is_finite() { bvh.nearest(&back, 0.0) } else { None };
        hit.map_or(0.0, |hit| beyond - hit.distance)
    };
    picture.window.pixels(picture.camera.width).enumerate().map(far).collect()
}

struct Search<'a> {
    picture: &'a ColorPicture,
    seen: &'a [f32],
    sources: &'a [(&'a ColorPicture, &'a [f32])],
    rays: Vec<Vec3>,
    step: f32,
    /// Pixels that are asked, and those whose colors are looked up for their patches.
    asked: Vec<usize>,
    looked_up: Vec<usize>,
    /// Differences of colors between each pixel and the views around it.
    warped: Vec<[f32; MOST_SOURCES]>,
}

impl<'a> Search<'a> {
    fn new(
        picture: &'a ColorPicture,
        seen: &'a [f32],
        sources: &'a [(&'a ColorPicture, &'a [f32])],
        step: f32,
    ) -> Self {
        let camera = &picture.camera;
        let rays =
            picture.window.pixels(camera.width).map(|i| camera.pixel_ray(i as u32).direction).collect();
        let asked: Vec<usize> = (0..seen.len()).filter(|&at| seen[at].is_finite()).collect();
        let warped = vec![[UNKNOWN; MOST_SOURCES]; seen.len()];
        Self { picture, seen, sources, rays, step, looked_up: asked.clone(), asked, warped }
    }

    /// Asks only for pixels that may have a better depth.
    fn ask_only(&mut self, is_asked: impl Fn(usize) -> bool) {
        self.asked.retain(|&at| is_asked(at));
        let mut is_looked_up = vec![false; self.seen.len()];
        for &at in &self.asked {
            self.patch(at).for_each(|i| is_looked_up[i] = self.seen[i].is_finite());
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

    /// Hands out how much the best of the views around differ in each pixel's patch, if the surface is moved along the rays by `shift`
    /// pixels.
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

    /// Writes the differences of colors between each pixel that is looked up and the views around it.
    fn warp(&mut self, shift: f32) {
        let origin = self.picture.camera.position();
        for &at in &self.looked_up {
            let (distance, color) = (self.seen[at], self.picture.values[at]);
            let point = origin + self.rays[at] * (distance * (1.0 + shift * self.step));
            // A point well behind what the other view sees there is hidden from it.
            let slack = self.step * distance * (3.0 + 2.0 * shift.abs());
            for ((theirs, distances), warped) in self.sources.iter().zip(&mut self.warped[at]) {
                let is_seen = |place: usize| {
                    let limit = distances[place] + slack;
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
