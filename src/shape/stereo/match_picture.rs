//! Photographs for matching: small, gray, with the object alone.

use crate::math::color::{luminance, srgb_from_linear};
use crate::shape::shrunk::shrunk;
use crate::view::numbers::packed;
use crate::view::{Camera, Photograph, PixelWindow, StoredMask};
use glam::Vec3;
use serde::{Deserialize, Serialize};

/// Angles in degrees between a view and its neighbors: less shows no depth, more does not look alike.
const ANGLES: (f32, f32) = (6.0, 35.0);
/// The angle at which a neighbor is most useful, degrees.
const BEST_ANGLE: f32 = 14.0;
/// Most neighbors of a view.
const MOST_NEIGHBORS: usize = 4;
/// Least angle in degrees between two neighbors of a view, as seen from the object.
const APART: f32 = 7.0;

/// A photograph for matching.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct MatchPicture {
    /// The camera of the small picture.
    pub camera: Camera,
    /// The part of the small picture that shows the object.
    pub window: PixelWindow,
    /// Luminance of the window's pixels with the curve of sRGB, in 1/65535; 0 where the object is not alone.
    #[serde(with = "packed")]
    values: Vec<u16>,
}

impl MatchPicture {
    /// From a photograph, `factor` times smaller along each axis; `None` if the mask is empty.
    pub fn new(camera: &Camera, photograph: &Photograph, mask: &StoredMask, factor: u32) -> Option<Self> {
        let (small, window, pixels) = shrunk(camera, photograph, mask, factor)?;
        let encoded = |light: Vec3| {
            let value = srgb_from_linear(luminance(light).clamp(0.0, 1.0));
            (1.0 + value * 65534.0) as u16
        };
        let values = pixels.map(|light| light.map_or(0, encoded)).collect();
        Some(Self { camera: small, window, values })
    }

    /// The value of a pixel of the window, in [0, 1]; `None` where the object is not alone.
    #[inline]
    pub fn pixel(&self, at: usize) -> Option<f32> {
        let value = self.values[at];
        (value > 0).then(|| f32::from(value) / 65535.0)
    }

    /// The bilinear value at an image position, as in [`Camera::project`], with the place of its nearest pixel in the window; `None` if
    /// a pixel around it does not show the object alone.
    #[inline]
    pub fn at(&self, x: f32, y: f32) -> Option<(f32, usize)> {
        let (x, y) = (x - 0.5 - self.window.x as f32, y - 0.5 - self.window.y as f32);
        let (width, height) = (self.window.width as usize, self.window.height as usize);
        if !(x >= 0.0 && y >= 0.0 && x < (width - 1) as f32 && y < (height - 1) as f32) {
            return None;
        }
        let (left, top) = (x as usize, y as usize);
        let (tx, ty) = (x - left as f32, y - top as f32);
        let first = top * width + left;
        let [a, b, c, d] = [first, first + 1, first + width, first + width + 1].map(|i| self.values[i]);
        if a == 0 || b == 0 || c == 0 || d == 0 {
            return None;
        }
        let mix = |a: u16, b: u16, t: f32| f32::from(a) + t * (f32::from(b) - f32::from(a));
        let upper = mix(a, b, tx);
        let value = upper + ty * (mix(c, d, tx) - upper);
        let nearest = first + usize::from(tx >= 0.5) + if ty >= 0.5 { width } else { 0 };
        Some((value / 65535.0, nearest))
    }

    /// Whether a point in the frame lies more than about a pixel beside the object; `false` out of the frame, where nothing is known.
    pub fn misses(&self, point: Vec3) -> bool {
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

    /// Whether the object or the window ends `pixels` beside a pixel or nearer, seen along rows, columns and diagonals.
    pub fn near_rim(&self, at: usize, pixels: usize) -> bool {
        let (width, height) = (self.window.width as usize, self.window.height as usize);
        let (x, y) = (at % width, at / width);
        if x < pixels || y < pixels || x + pixels >= width || y + pixels >= height {
            return true;
        }
        let rows = [at - pixels * width, at, at + pixels * width];
        rows.iter().any(|row| [row - pixels, *row, row + pixels].iter().any(|&i| self.values[i] == 0))
    }

    /// The direction from a point to the camera.
    pub fn direction_from(&self, point: Vec3) -> Vec3 {
        (self.camera.position() - point).normalize_or_zero()
    }
}

/// The neighbors of picture `of`: views from 6 to 35° beside it as seen from `center`, the most useful first, spread around it.
pub fn neighbors(pictures: &[MatchPicture], of: usize, center: Vec3) -> Vec<usize> {
    let own = pictures[of].direction_from(center);
    let angle_to = |i: usize| pictures[i].direction_from(center).angle_between(own).to_degrees();
    let mut candidates: Vec<(f32, usize)> = (0..pictures.len())
        .filter(|&i| i != of)
        .map(|i| (angle_to(i), i))
        .filter(|(angle, _)| (ANGLES.0..=ANGLES.1).contains(angle))
        .map(|(angle, i)| ((angle - BEST_ANGLE).abs(), i))
        .collect();
    candidates.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let mut chosen: Vec<usize> = Vec::new();
    for (_, i) in candidates {
        let direction = pictures[i].direction_from(center);
        let apart =
            |j: &usize| pictures[*j].direction_from(center).angle_between(direction).to_degrees() >= APART;
        if chosen.len() < MOST_NEIGHBORS && chosen.iter().all(apart) {
            chosen.push(i);
        }
    }
    chosen
}
