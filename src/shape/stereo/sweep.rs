//! The search for depths: along each ray of a view, at several depths around the mesh, patches of the view are compared with those of
//! its neighbors.
//!
//! At a shift of s steps the whole surface is moved along the view's rays by the same relative depth, and each pixel is projected into
//! the neighbors through the shifted surface. Patches are then compared by zero-mean normalized cross-correlation (ZNCC)
//! with box windows. The slant of the surface is that of the mesh, so that no normals need a search.

use crate::mesh::bvh::TriangleBvh;
use crate::ranks::packed::PackedFloats;
use crate::shape::stereo::match_picture::MatchPicture;
use glam::Vec3;

/// Half width of a patch in pixels.
const RADIUS: usize = 3;
/// Share of a patch that must show the object in both pictures.
const LEAST_SHARE: f32 = 0.5;
/// Variance of a patch (of values in [0, 1]) at which it counts half, and below which it says nothing.
const HALF_VARIANCE: f32 = 0.0015;
const NO_VARIANCE: f32 = 2e-4;
/// ZNCC from which a match counts, and how much more counts fully.
const LEAST_AGREEMENT: f32 = 0.5;
const FULL_AGREEMENT: f32 = 0.4;
/// How much better than any other depth a match must be to count fully.
const CLEAR: f32 = 0.05;
/// Places of the shifted windows, in pixels from the middle.
const SHIFT: isize = 2;
/// Pixels from a mask's rim or a jump in depth within which nothing is trusted.
const EDGE: usize = 5;
/// Change of depth within that many pixels that is a jump, in pixels of a neighbor.
const JUMP: f32 = 12.0;
/// Neighbors that must agree; of more, the best are taken.
const AGREEING: usize = 2;

/// The range of a search.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sweep {
    /// Steps toward the camera, and as many away from it.
    pub steps: u32,
    /// Length of a step, in pixels of a neighbor.
    pub step: f32,
}

/// What a pixel sees of the mesh.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Seen {
    /// Distance along the ray, world units; infinite where there is no mesh or the object is not alone.
    pub distance: f32,
    /// The triangle there.
    triangle: u32,
}

impl PackedFloats<2> for Seen {
    fn to_floats(self) -> [f32; 2] {
        [self.distance, f32::from_bits(self.triangle)]
    }

    fn of_floats([distance, triangle]: [f32; 2]) -> Self {
        Self { distance, triangle: triangle.to_bits() }
    }
}

impl Seen {
    /// The triangle, if there is one.
    pub fn triangle(&self) -> Option<u32> {
        self.distance.is_finite().then_some(self.triangle)
    }
}

/// What the pixels of the window see.
pub fn cast(bvh: &TriangleBvh, picture: &MatchPicture) -> Vec<Seen> {
    let pixels = picture.window.pixels(picture.camera.width).enumerate();
    let seen = |(at, pixel): (usize, usize)| {
        picture.pixel(at)?;
        let hit = bvh.nearest(&picture.camera.pixel_ray(pixel as u32), 0.0)?;
        Some(Seen { distance: hit.distance, triangle: hit.triangle })
    };
    pixels.map(|pixel| seen(pixel).unwrap_or(Seen { distance: f32::INFINITY, triangle: 0 })).collect()
}

/// A neighboring view.
#[derive(Clone, Copy)]
pub struct Source<'a> {
    /// Its picture.
    pub picture: &'a MatchPicture,
    /// What its pixels see, by [`cast`].
    pub seen: &'a [Seen],
}

/// What a search found, for each pixel of the window.
#[derive(Clone, Debug)]
pub struct Matched {
    /// Distance along the pixel's ray, world units.
    pub distance: Vec<f32>,
    /// How much it is to be believed, in [0, 1].
    pub trust: Vec<f32>,
    /// Variance of its patches, the largest of all shifts, for values in [0, 1].
    pub variance: Vec<f32>,
    /// Step of the search, relative to the distance.
    pub step: f32,
}

/// Sums over a patch: weight, a, b, a², b², ab, of pixels that count in both pictures; two more are unused, so that a vector holds all.
type Sums = [f32; 8];

/// Searches for the depths of `reference`; `None` if it has fewer than two neighbors.
pub fn sweep(
    reference: &MatchPicture,
    seen: &[Seen],
    sources: &[Source],
    center: Vec3,
    search: Sweep,
) -> Option<Matched> {
    if sources.len() < AGREEING {
        return None;
    }
    let task = Task::new(reference, seen, sources, center);
    let steps = 2 * search.steps as usize + 1;
    let mut scores = vec![f32::NEG_INFINITY; steps * seen.len()];
    let mut variance = vec![0.0f32; seen.len()];
    let mut buffers = Buffers::new(seen.len());
    for step in 0..steps {
        let shift = (step as f32 - search.steps as f32) * search.step;
        let row = &mut scores[step * seen.len()..][..seen.len()];
        task.score(shift, row, &mut variance, &mut buffers);
    }
    Some(task.choose(&scores, variance, search))
}

struct Task<'a> {
    reference: &'a MatchPicture,
    seen: &'a [Seen],
    sources: &'a [Source<'a>],
    rays: Vec<Vec3>,
    /// Step along the ray for one pixel of a neighbor, relative to the distance.
    step: f32,
}

/// Working memory of a search.
struct Buffers {
    pixels: Vec<Sums>,
    along_rows: Vec<Sums>,
    agreement: Vec<[f32; AGREEING]>,
}

impl Buffers {
    fn new(count: usize) -> Self {
        Self {
            pixels: vec![[0.0; 8]; count],
            along_rows: vec![[0.0; 8]; count],
            agreement: vec![[f32::NEG_INFINITY; AGREEING]; count],
        }
    }
}

impl<'a> Task<'a> {
    fn new(reference: &'a MatchPicture, seen: &'a [Seen], sources: &'a [Source<'a>], center: Vec3) -> Self {
        let camera = &reference.camera;
        let rays =
            reference.window.pixels(camera.width).map(|i| camera.pixel_ray(i as u32).direction).collect();
        let own = reference.direction_from(center);
        let mut sines: Vec<f32> =
            sources.iter().map(|s| s.picture.direction_from(center).cross(own).length()).collect();
        sines.sort_by(f32::total_cmp);
        let sine = sines[sines.len() / 2].max(0.05);
        let focal = 0.5 * (camera.focal[0].abs() + camera.focal[1].abs());
        Self { reference, seen, sources, rays, step: 1.0 / (focal * sine) }
    }

    fn distance(&self, at: usize, shift: f32) -> f32 {
        self.seen[at].distance * (1.0 + shift * self.step)
    }

    /// The mean agreement with the best neighbors at one shift.
    fn score(&self, shift: f32, scores: &mut [f32], variance: &mut [f32], buffers: &mut Buffers) {
        let Buffers { pixels, along_rows, agreement } = buffers;
        agreement.fill([f32::NEG_INFINITY; AGREEING]);
        let width = self.reference.window.width as usize;
        for source in self.sources {
            self.warp(source, shift, pixels);
            box_sums(pixels, width, along_rows);
            for (at, sums) in pixels.iter().enumerate() {
                let Some((zncc, least)) = zncc(sums) else { continue };
                variance[at] = variance[at].max(least);
                let best = &mut agreement[at];
                if zncc > best[0] {
                    *best = [zncc, best[0]];
                } else if zncc > best[1] {
                    best[1] = zncc;
                }
            }
        }
        // Windows may be shifted, so that at an edge one of them shows one surface only.
        let centered = |at: usize| 0.5 * (agreement[at][0] + agreement[at][1]);
        let height = scores.len() / width;
        for (at, score) in scores.iter_mut().enumerate() {
            let (x, y) = (at % width, at / width);
            *score = f32::NEG_INFINITY;
            if !self.seen[at].distance.is_finite() {
                continue;
            }
            for dy in [-SHIFT, 0, SHIFT] {
                for dx in [-SHIFT, 0, SHIFT] {
                    let (Some(x), Some(y)) = (x.checked_add_signed(dx), y.checked_add_signed(dy)) else {
                        continue;
                    };
                    if x < width && y < height {
                        *score = score.max(centered(y * width + x));
                    }
                }
            }
        }
    }

    /// The products of reference and neighbor at each pixel, seen through the shifted surface.
    fn warp(&self, source: &Source, shift: f32, pixels: &mut [Sums]) {
        let origin = self.reference.camera.position();
        let eye = source.picture.camera.position();
        for (at, out) in pixels.iter_mut().enumerate() {
            *out = [0.0; 8];
            if !self.seen[at].distance.is_finite() {
                continue;
            }
            let Some(own) = self.reference.pixel(at) else { continue };
            let point = origin + self.rays[at] * self.distance(at, shift);
            let Some((x, y, _)) = source.picture.camera.project(point) else { continue };
            let Some((other, place)) = source.picture.at(x, y) else { continue };
            // A point well behind what the neighbor sees there is hidden from it.
            let slack = self.step * self.seen[at].distance * (3.0 + 2.0 * shift.abs());
            if eye.distance(point) > source.seen[place].distance + slack {
                continue;
            }
            *out = [1.0, own, other, own * own, other * other, own * other, 0.0, 0.0];
        }
    }

    /// Whether the object ends, or another part of it begins, within a patch: there patches show two depths.
    fn near_edge(&self, at: usize) -> bool {
        if self.reference.near_rim(at, EDGE) {
            return true;
        }
        // Only pixels that see the mesh ask, so that a neighbor without mesh is infinitely far away.
        let (width, own) = (self.reference.window.width as usize, self.seen[at].distance);
        let limit = JUMP * self.step * own;
        let jumps = |row: usize| {
            [at - EDGE, at, at + EDGE].iter().any(|i| {
                let other = self.seen[i + row * width - EDGE * width].distance;
                (other - own).abs() >= limit
            })
        };
        [0, EDGE, 2 * EDGE].into_iter().any(jumps)
    }

    /// The best depth of each pixel.
    fn choose(&self, scores: &[f32], variance: Vec<f32>, search: Sweep) -> Matched {
        let count = self.seen.len();
        let steps = scores.len() / count;
        let distance = self.seen.iter().map(|seen| seen.distance).collect();
        let mut matched = Matched { distance, trust: vec![0.0; count], variance, step: self.step };
        let mut along = vec![0.0; steps];
        for at in (0..count).filter(|&at| self.seen[at].distance.is_finite()) {
            if matched.variance[at] < NO_VARIANCE || self.near_edge(at) {
                continue;
            }
            along.iter_mut().enumerate().for_each(|(step, score)| *score = scores[step * count + at]);
            let Some((step, trust)) = peak(&along) else { continue };
            matched.distance[at] = self.distance(at, (step - search.steps as f32) * search.step);
            let squared = matched.variance[at].powi(2);
            matched.trust[at] = trust * squared / (squared + HALF_VARIANCE * HALF_VARIANCE);
        }
        matched
    }
}

/// The place of the best score between its neighbors, and how clear it is; `None` if it lies at an end or says nothing.
fn peak(scores: &[f32]) -> Option<(f32, f32)> {
    let best = (0..scores.len()).max_by(|&a, &b| scores[a].total_cmp(&scores[b]))?;
    if best == 0 || best + 1 == scores.len() {
        return None;
    }
    let [left, top, right] = [scores[best - 1], scores[best], scores[best + 1]];
    if !(left.is_finite() && right.is_finite()) || top < LEAST_AGREEMENT {
        return None;
    }
    let far = |i: &usize| i.abs_diff(best) > 1;
    let second = (0..scores.len()).filter(far).map(|i| scores[i]).fold(f32::NEG_INFINITY, f32::max);
    let curvature = 2.0 * top - left - right;
    let offset = if curvature > 1e-6 { (0.5 * (right - left) / curvature).clamp(-0.5, 0.5) } else { 0.0 };
    let agreement = ((top - LEAST_AGREEMENT) / FULL_AGREEMENT).clamp(0.0, 1.0);
    let clear = ((top - second) / CLEAR).clamp(0.0, 1.0);
    Some((best as f32 + offset, agreement * clear))
}

/// Zero-mean normalized cross-correlation of a patch, and the smaller of its two variances.
#[inline]
fn zncc([weight, a, b, aa, bb, ab, ..]: &Sums) -> Option<(f32, f32)> {
    const PATCH: f32 = ((2 * RADIUS + 1) * (2 * RADIUS + 1)) as f32;
    if *weight < LEAST_SHARE * PATCH {
        return None;
    }
    let per = weight.recip();
    let (mean_a, mean_b) = (a * per, b * per);
    let (variance_a, variance_b) = (aa * per - mean_a * mean_a, bb * per - mean_b * mean_b);
    let least = variance_a.min(variance_b);
    let covariance = ab * per - mean_a * mean_b;
    (least > 1e-6).then(|| (covariance / (variance_a * variance_b).sqrt(), least))
}

/// Replaces each pixel by the sum over its patch; pixels beyond the window count as empty.
fn box_sums(pixels: &mut [Sums], width: usize, along_rows: &mut [Sums]) {
    let height = pixels.len() / width;
    for (row, out) in pixels.chunks_exact(width).zip(along_rows.chunks_exact_mut(width)) {
        running_sums(width, |x| row[x], |x, sum| out[x] = sum);
    }
    // Column sums run downward, all columns of a row side by side.
    let mut sums = vec![[0.0f32; 8]; width];
    for y in 0..height + RADIUS {
        if y < height {
            add(&mut sums, &along_rows[y * width..][..width], 1.0);
        }
        if y > 2 * RADIUS {
            add(&mut sums, &along_rows[(y - 2 * RADIUS - 1) * width..][..width], -1.0);
        }
        if y >= RADIUS {
            pixels[(y - RADIUS) * width..][..width].copy_from_slice(&sums);
        }
    }
}

fn add(sums: &mut [Sums], row: &[Sums], sign: f32) {
    for (sum, value) in sums.iter_mut().zip(row) {
        for k in 0..8 {
            sum[k] += sign * value[k];
        }
    }
}

/// Sums over 2·[`RADIUS`] + 1 entries around each of `count`.
fn running_sums(count: usize, value: impl Fn(usize) -> Sums, mut out: impl FnMut(usize, Sums)) {
    let mut sum = [0.0f32; 8];
    for x in 0..count + RADIUS {
        if x < count {
            let entering = value(x);
            (0..8).for_each(|k| sum[k] += entering[k]);
        }
        if x > 2 * RADIUS {
            let leaving = value(x - 2 * RADIUS - 1);
            (0..8).for_each(|k| sum[k] -= leaving[k]);
        }
        if x >= RADIUS {
            out(x - RADIUS, sum);
        }
    }
}
