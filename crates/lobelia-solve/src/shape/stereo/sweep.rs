//! The search for depths: along each ray of a view, at several depths around the mesh, patches of
//! the view are compared with those of its neighbors.
//!
//! At a shift of s steps the whole surface is moved along the view's rays by the same relative
//! depth, and each pixel is projected into the neighbors through the shifted surface. Patches are
//! then compared by zero-mean normalized cross-correlation (ZNCC) with box windows. The slant of
//! the surface is that of the mesh, so that no normals need a search.

use crate::shape::pictures::{MatchPicture, Seen, views_beside};
use glam::Vec3;
use lobelia_sg::statistics::median;

/// Angles in degrees between a view and its neighbors: less shows no depth, more does not look
/// alike.
const ANGLES: (f32, f32) = (6.0, 35.0);
/// The angle at which a neighbor is most useful, degrees.
const BEST_ANGLE: f32 = 14.0;
/// Most neighbors of a view.
const MOST_NEIGHBORS: usize = 4;
/// Least angle in degrees between two neighbors of a view, as seen from the object.
const APART: f32 = 7.0;

/// Half width of a patch in pixels.
const RADIUS: usize = 3;
/// Share of a patch that must show the object in both pictures.
const LEAST_SHARE: f32 = 0.5;
/// Variance of a patch (of values in [0, 1]) at which it counts half, and below which it says
/// nothing.
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

impl MatchPicture {
    /// Whether a point in the frame lies more than about a pixel beside the object; `false` out of
    /// the frame, where nothing is known.
    pub(super) fn misses(&self, point: Vec3) -> bool {
        let Some((x, y, _)) = self.camera.project(point) else { return false };
        if !(x >= 0.0 && y >= 0.0 && x < self.camera.width as f32 && y < self.camera.height as f32) {
            return false;
        }
        let (x, y) = (x as i64 - i64::from(self.window.x), y as i64 - i64::from(self.window.y));
        let (width, height) = (i64::from(self.window.width), i64::from(self.window.height));
        let shows = |x: i64, y: i64| {
            (0..width).contains(&x) && (0..height).contains(&y) && self.values[(y * width + x) as usize] > 0
        };
        !(-1..=1).any(|dy| (-1..=1).any(|dx| shows(x + dx, y + dy)))
    }

    /// Whether the object or the window ends `pixels` beside a pixel or nearer, seen along rows,
    /// columns and diagonals.
    pub(super) fn near_rim(&self, at: usize, pixels: usize) -> bool {
        let (width, height) = (self.window.width as usize, self.window.height as usize);
        let (x, y) = (at % width, at / width);
        if x < pixels || y < pixels || x + pixels >= width || y + pixels >= height {
            return true;
        }
        let rows = [at - pixels * width, at, at + pixels * width];
        rows.iter().any(|row| [row - pixels, *row, row + pixels].iter().any(|&i| self.values[i] == 0))
    }
}

/// The neighbors of picture `of`: views beside it as seen from `center`, the most useful first,
/// spread around it.
pub(super) fn neighbors(pictures: &[MatchPicture], of: usize, center: Vec3) -> Vec<usize> {
    let mut chosen: Vec<usize> = Vec::new();
    for i in views_beside(pictures, of, center, ANGLES.0..=ANGLES.1, |angle| (angle - BEST_ANGLE).abs()) {
        let direction = pictures[i].direction_from(center);
        let apart =
            |j: &usize| pictures[*j].direction_from(center).angle_between(direction).to_degrees() >= APART;
        if chosen.len() < MOST_NEIGHBORS && chosen.iter().all(apart) {
            chosen.push(i);
        }
    }
    chosen
}

/// A neighboring view: its picture, and what its pixels see.
pub(super) type Source<'a> = (&'a MatchPicture, &'a [Seen]);

#[derive(Clone, Copy)]
pub(super) struct Sweep {
    /// Steps toward the camera, and as many away from it.
    pub steps: u32,
    /// Length of a step, in pixels of a neighbor.
    pub step: f32,
}

/// Result of a search, for each pixel of the window.
pub(super) struct Matched {
    /// Distance along the pixel's ray, world units.
    pub distance: Vec<f32>,
    /// How much it is to be believed, in [0, 1].
    pub trust: Vec<f32>,
    /// Variance of its patches, the largest of all shifts, for values in [0, 1].
    pub variance: Vec<f32>,
    /// Step of the search, relative to the distance.
    pub step: f32,
}

/// Sums over a patch: weight, a, b, a², b², ab, of pixels that count in both pictures; two more are
/// unused, so that a vector holds all.
type Sums = [f32; 8];

/// Searches for the depths of `reference`; `None` if it has fewer than two neighbors.
pub(super) fn sweep(
    reference: &MatchPicture,
    seen: &[Seen],
    sources: &[Source],
    center: Vec3,
    search: Sweep,
) -> Option<Matched> {
    if sources.len() < AGREEING {
        return None;
    }
    let own = reference.direction_from(center);
    let sine = |(picture, _): &Source| picture.direction_from(center).cross(own).length();
    let sine = median(&mut sources.iter().map(sine).collect::<Vec<f32>>()).unwrap_or(0.0).max(0.05);
    let rays = reference.rays().map(|ray| ray.direction).collect();
    let task = Task { reference, seen, sources, rays, step: reference.step(sine) };
    let (count, steps) = (seen.len(), 2 * search.steps as usize + 1);
    let shift_of = |step: f32| (step - search.steps as f32) * search.step;
    let mut scores = vec![f32::NEG_INFINITY; steps * count];
    let mut variance = vec![0.0f32; count];
    for step in 0..steps {
        task.score(shift_of(step as f32), &mut scores[step * count..][..count], &mut variance);
    }
    // The best depth of each pixel.
    let distance = seen.iter().map(|seen| seen.distance).collect();
    let mut matched = Matched { distance, trust: vec![0.0; count], variance, step: task.step };
    let mut along = Vec::with_capacity(steps);
    for at in (0..count).filter(|&at| seen[at].distance.is_finite()) {
        if matched.variance[at] < NO_VARIANCE || task.near_edge(at) {
            continue;
        }
        along.clear();
        along.extend(scores[at..].iter().step_by(count));
        let Some((step, trust)) = peak(&along) else { continue };
        matched.distance[at] = task.distance(at, shift_of(step));
        let squared = matched.variance[at].powi(2);
        matched.trust[at] = trust * squared / (squared + HALF_VARIANCE * HALF_VARIANCE);
    }
    Some(matched)
}

struct Task<'a> {
    reference: &'a MatchPicture,
    seen: &'a [Seen],
    sources: &'a [Source<'a>],
    /// Directions of the pixels' rays.
    rays: Vec<Vec3>,
    /// Step along the ray for one pixel of a neighbor, relative to the distance.
    step: f32,
}

impl Task<'_> {
    fn distance(&self, at: usize, shift: f32) -> f32 {
        self.seen[at].distance * (1.0 + shift * self.step)
    }

    /// The mean agreement with the best neighbors at one shift.
    fn score(&self, shift: f32, scores: &mut [f32], variance: &mut [f32]) {
        let mut pixels = vec![[0.0; 8]; scores.len()];
        let mut along_rows = pixels.clone();
        let mut agreement = vec![[f32::NEG_INFINITY; AGREEING]; scores.len()];
        let width = self.reference.window.width as usize;
        for source in self.sources {
            self.warp(source, shift, &mut pixels);
            box_sums(&mut pixels, width, &mut along_rows);
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
    fn warp(&self, (picture, theirs): &Source, shift: f32, pixels: &mut [Sums]) {
        let origin = self.reference.camera.position();
        let eye = picture.camera.position();
        for (at, out) in pixels.iter_mut().enumerate() {
            *out = [0.0; 8];
            if !self.seen[at].distance.is_finite() {
                continue;
            }
            // Pixels that see the mesh show the object alone.
            let own = f32::from(self.reference.values[at]) / 65535.0;
            let point = origin + self.rays[at] * self.distance(at, shift);
            let Some((other, place)) = picture.at(point) else { continue };
            // A point well behind what the neighbor sees there is hidden from it.
            let slack = self.step * self.seen[at].distance * (3.0 + 2.0 * shift.abs());
            if eye.distance(point) > theirs[place].distance + slack {
                continue;
            }
            *out = [1.0, own, other, own * own, other * other, own * other, 0.0, 0.0];
        }
    }

    /// Whether the object ends, or another part of it begins, within a patch: there patches show
    /// two depths.
    fn near_edge(&self, at: usize) -> bool {
        if self.reference.near_rim(at, EDGE) {
            return true;
        }
        // Only pixels that see the mesh ask, so that a neighbor without mesh is infinitely far
        // away.
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
}

/// The place of the best score between its neighbors, and how clear it is; `None` if it lies at an
/// end or says nothing.
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
        let mut sum = [[0.0f32; 8]];
        for x in 0..width + RADIUS {
            if x < width {
                add(&mut sum, &row[x..=x], 1.0);
            }
            if x > 2 * RADIUS {
                add(&mut sum, &row[x - 2 * RADIUS - 1..][..1], -1.0);
            }
            if x >= RADIUS {
                out[x - RADIUS] = sum[0];
            }
        }
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

#[inline]
fn add(sums: &mut [Sums], row: &[Sums], sign: f32) {
    for (sum, value) in sums.iter_mut().zip(row) {
        for k in 0..8 {
            sum[k] += sign * value[k];
        }
    }
}
