//! Photographs with masks as small pictures of the object alone, in gray for stereo and in color
//! for hollows.

use crate::fit::loss::coded_luminance;
use crate::shape::silhouette::{Silhouette, pixel_size};
use glam::{Vec3, Vec3A};
use lobelia_geometry::view::{Camera, Photograph, PixelWindow, Placement, StoredMask, ViewIndex};
use lobelia_geometry::{error::stop::is_stopping, mesh::bvh::TriangleBvh, parallel};
use lobelia_sg::{color::srgb_from_linear, ray::Ray, statistics::median};
use std::ops::RangeInclusive;

/// Coverage of a block of pixels from which it shows the object alone.
const WHOLE: f32 = 0.95;

/// A training photograph with what is known of its view.
#[derive(Clone, Copy)]
pub(crate) struct TrainingView<'a> {
    pub index: ViewIndex,
    pub name: &'a str,
    pub camera: &'a Camera,
    /// Linear radiance.
    pub photograph: &'a Photograph,
    /// The pixels that show the object.
    pub mask: &'a StoredMask,
    /// How the object lies in it.
    pub placement: Placement,
}

impl TrainingView<'_> {
    /// The silhouette of the mask; `None` if it is empty.
    pub fn silhouette(&self) -> Option<Silhouette> {
        let mut silhouette = Silhouette::new(self.name, self.camera, self.mask)?;
        silhouette.view = self.index;
        Some(silhouette)
    }
}

/// What a small picture holds of a pixel, with the curve of sRGB.
pub(crate) trait PixelValue: Copy + Send + Sync {
    /// What is between pixels.
    type Blend;
    /// A pixel that does not show the object alone.
    const NONE: Self;

    fn of(light: Vec3) -> Self;

    fn is_alone(self) -> bool;

    /// The bilinear value between four pixels that do, row by row.
    fn blend(four: [Self; 4], across: f32, down: f32) -> Self::Blend;
}

/// Luminance in 1/65535.
impl PixelValue for u16 {
    type Blend = f32;
    const NONE: Self = 0;

    fn of(light: Vec3) -> Self {
        (1.0 + coded_luminance(light) * 65534.0) as Self
    }

    #[inline]
    fn is_alone(self) -> bool {
        self > 0
    }

    #[inline]
    fn blend(four: [Self; 4], across: f32, down: f32) -> f32 {
        let [a, b, c, d] = four.map(f32::from);
        let upper = a + across * (b - a);
        (upper + down * (c + across * (d - c) - upper)) / 65535.0
    }
}

impl PixelValue for Vec3A {
    type Blend = Self;
    const NONE: Self = Self::NEG_ONE;

    fn of(light: Vec3) -> Self {
        light.clamp(Vec3::ZERO, Vec3::ONE).map(srgb_from_linear).into()
    }

    #[inline]
    fn is_alone(self) -> bool {
        self.x >= 0.0
    }

    #[inline]
    fn blend([a, b, c, d]: [Self; 4], across: f32, down: f32) -> Self {
        a.lerp(b, across).lerp(c.lerp(d, across), down)
    }
}

/// The part of a photograph that its mask covers, made smaller.
pub(crate) struct SmallPicture<V> {
    pub camera: Camera,
    /// The part of the small picture that shows the object.
    pub window: PixelWindow,
    pub values: Vec<V>,
}

pub(crate) type MatchPicture = SmallPicture<u16>;
pub(crate) type ColorPicture = SmallPicture<Vec3A>;

/// Hit of a pixel's ray on a mesh.
pub(crate) struct Seen {
    /// Distance along the ray, world units; infinite where there is no mesh or the object is not
    /// alone.
    pub distance: f32,
    /// The triangle there; meaningless where there is none.
    pub triangle: u32,
}

impl<V: PixelValue> SmallPicture<V> {
    /// The photographs, `factor` times smaller along each axis; those with empty masks are left
    /// out.
    pub fn of_views(views: &[TrainingView], factor: u32) -> Vec<Self> {
        parallel::flat_map(views.len(), 1, |i| Self::new(&views[i], factor))
    }

    fn new(view: &TrainingView, factor: u32) -> Option<Self> {
        let (camera, whole) = (view.camera.scaled(factor), view.mask.window());
        let (x, y) = (whole.x / factor, whole.y / factor);
        let right = (whole.x + whole.width).div_ceil(factor).min(camera.width);
        let bottom = (whole.y + whole.height).div_ceil(factor).min(camera.height);
        if right <= x || bottom <= y {
            return None;
        }
        let window = PixelWindow { x, y, width: right - x, height: bottom - y };
        let block = |pixel: usize| {
            let (x, y) = (pixel as u32 % camera.width * factor, pixel as u32 / camera.width * factor);
            let pixels = (0..factor * factor).map(|k| (y + k / factor) * view.camera.width + x + k % factor);
            let (light, covered) = pixels.fold((Vec3::ZERO, 0.0), |(light, covered), i| {
                (light + view.photograph.radiance(i as usize), covered + view.mask.coverage(i as usize))
            });
            if covered >= WHOLE * (factor * factor) as f32 { V::of(light / covered) } else { V::NONE }
        };
        Some(Self { camera, window, values: window.pixels(camera.width).map(block).collect() })
    }

    pub fn rays(&self) -> impl Iterator<Item = Ray> {
        self.window.pixels(self.camera.width).map(|pixel| self.camera.pixel_ray(pixel as u32))
    }

    /// Casts the rays of the window's pixels onto a mesh. Once a run is stopping ([`is_stopping`])
    /// nothing is hit.
    pub fn cast(&self, bvh: &TriangleBvh) -> Vec<Seen> {
        let seen = |(ray, value): (Ray, &V)| {
            let hit = if value.is_alone() && !is_stopping() { bvh.nearest(&ray, 0.0) } else { None };
            let (distance, triangle) = hit.map_or((f32::INFINITY, 0), |hit| (hit.distance, hit.triangle));
            Seen { distance, triangle }
        };
        self.rays().zip(&self.values).map(seen).collect()
    }

    /// The bilinear value where a point is seen, with the nearest pixel of the window; `None` if a
    /// pixel around it does not show the object alone.
    #[inline]
    pub fn at(&self, point: Vec3) -> Option<(V::Blend, usize)> {
        let (x, y, _) = self.camera.project(point)?;
        let (x, y) = (x - 0.5 - self.window.x as f32, y - 0.5 - self.window.y as f32);
        let (width, height) = (self.window.width as usize, self.window.height as usize);
        if !(x >= 0.0 && y >= 0.0 && x < (width - 1) as f32 && y < (height - 1) as f32) {
            return None;
        }
        let (left, top) = (x as usize, y as usize);
        let (tx, ty) = (x - left as f32, y - top as f32);
        let first = top * width + left;
        let four = [first, first + 1, first + width, first + width + 1].map(|i| self.values[i]);
        if !four.iter().all(|value| value.is_alone()) {
            return None;
        }
        let nearest = first + usize::from(tx >= 0.5) + if ty >= 0.5 { width } else { 0 };
        Some((V::blend(four, tx, ty), nearest))
    }

    /// The window's pixel that shows a point, if it shows the object alone.
    pub fn place(&self, point: Vec3) -> Option<usize> {
        let (x, y, _) = self.camera.project(point)?;
        let (x, y) = (x - self.window.x as f32, y - self.window.y as f32);
        let inside = x >= 0.0 && y >= 0.0 && x < self.window.width as f32 && y < self.window.height as f32;
        let place = inside.then(|| y as usize * self.window.width as usize + x as usize)?;
        self.values[place].is_alone().then_some(place)
    }

    /// Step along a ray for one pixel of a view around, relative to the distance, if the angle to
    /// that view has this sine.
    pub fn step(&self, sine: f32) -> f32 {
        1.0 / (focal(&self.camera) * sine)
    }

    pub fn direction_from(&self, point: Vec3) -> Vec3 {
        (self.camera.position() - point).normalize_or_zero()
    }
}

/// The views whose angle beside picture `of`, in degrees as seen from `center`, is among these, by
/// rising `order` of the angle.
pub(crate) fn views_beside<V: PixelValue>(
    pictures: &[SmallPicture<V>],
    of: usize,
    center: Vec3,
    angles: RangeInclusive<f32>,
    order: impl Fn(f32) -> f32,
) -> Vec<usize> {
    let own = pictures[of].direction_from(center);
    let angle = |i: usize| pictures[i].direction_from(center).angle_between(own).to_degrees();
    let others = (0..pictures.len()).filter(|i| *i != of).map(|i| (angle(i), i));
    let beside = others.filter(|(angle, _)| angles.contains(angle));
    let mut beside: Vec<(f32, usize)> = beside.map(|(angle, i)| (order(angle), i)).collect();
    beside.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    beside.into_iter().map(|(_, i)| i).collect()
}

/// How many times smaller than the photographs pictures are that have so many `pixels` in a
/// `width`, world units, at `middle` in a typical view; `None` without views.
pub(crate) fn picture_factor(views: &[TrainingView], middle: Vec3, width: f32, pixels: f32) -> Option<u32> {
    let footprint = |v: &TrainingView| pixel_size(v.camera) * v.camera.position().distance(middle);
    let typical = median(&mut views.iter().map(footprint).collect::<Vec<f32>>())?;
    Some((width / (pixels * typical)).round().clamp(1.0, 1024.0) as u32)
}

pub(crate) fn focal(camera: &Camera) -> f32 {
    0.5 * (camera.focal[0].abs() + camera.focal[1].abs())
}
