//! The silhouette of a view: the signed distance to the boundary of its mask, the distance of
//! points of space from its cone, and the loss of pixels near it.
//!
//! The loss compares the coverage of a pixel with the least distance of its ray to the surface.
//! Coverage is c = clamp(½ − φ/(w ρ), 0, 1), where φ is the least signed distance along the ray, ρ
//! the size of a pixel there and w a width in pixels. The loss is Huber's of c minus the coverage
//! of the mask; its gradient acts on the surface at the point where the ray is nearest.

use crate::fit::cameras::AlignedRow;
use crate::shape::{flood, neighbors};
use bevy_ecs::prelude::Resource;
use glam::{Vec2, Vec3};
use half::f16;
use lobelia_geometry::view::{Camera, StoredMask, ViewIndex};
use lobelia_geometry::{sdf::LeastDistance, sdf::SdfGrid, view::PixelWindow, view::raster::signed_distance};
use lobelia_sg::ray::Ray;
use lobelia_world::sample::pixel::PixelOf;

/// Pixels from the border of a frame within which a view abstains, and the same as a share of the
/// frame's shorter side: masks are often trimmed there.
const BORDER: f32 = 2.0;
const BORDER_SHARE: f32 = 0.02;
/// Pixels around the mask for which the distance is kept.
const MARGIN: u32 = 16;
/// Views that must see a point for it to be inside.
pub(super) const MIN_VIEWS: usize = 3;
/// Residual at which the Huber loss changes from quadratic to linear, which limits the influence of
/// wrong masks.
const HUBER: f32 = 0.25;
/// Distance from a silhouette, in pixels, within which it is used for camera alignment.
const ALIGNED_REACH: f32 = 3.0;

/// A mask with its camera.
#[derive(Clone, Debug)]
pub struct Silhouette {
    pub(super) view: ViewIndex,
    pub(super) name: String,
    pub(super) camera: Camera,
    pub(super) mask: StoredMask,
    /// Where `near` lies in the frame.
    window: PixelWindow,
    /// Signed distance in pixels from the center of each pixel of the window to the boundary of the
    /// mask, negative inside.
    near: Vec<f16>,
    /// The ray through the middle of the mask, and the tangent of the angle around it that holds
    /// all of the mask.
    pub(super) middle: Vec3,
    pub(super) spread: f32,
    /// For each pixel of the mask's window, whether the mask carves alone there; `None` if it is
    /// not trusted ([`hull`](crate::shape::hull)).
    pub(super) carves: Option<Vec<bool>>,
}

/// A point as a view sees it.
pub(super) struct Sighting {
    pub x: f32,
    pub y: f32,
    /// Signed distance in pixels to the boundary of the mask, negative inside.
    pub pixels: f32,
    /// World size of a pixel at the point.
    pub pixel_size: f32,
}

impl Silhouette {
    /// From a view's name, camera and mask; `None` if the mask is empty.
    pub fn new(name: &str, camera: &Camera, mask: &StoredMask) -> Option<Self> {
        let [width, height] = mask.size();
        let rays = || {
            let inside = mask.window().pixels(width).filter(|i| mask.coverage(*i) >= 0.5);
            inside.map(|i| camera.pixel_ray(i as u32).direction)
        };
        let middle = rays().sum::<Vec3>().try_normalize()?;
        let spread = rays().map(|ray| middle.cross(ray).length() / middle.dot(ray)).fold(0.0, f32::max);
        // The mask's window with more pixels on each side, as far as the frame goes.
        let inner = mask.window();
        let (x, y) = (inner.x.saturating_sub(MARGIN), inner.y.saturating_sub(MARGIN));
        let right = (inner.x + inner.width + MARGIN).min(width);
        let bottom = (inner.y + inner.height + MARGIN).min(height);
        let window = PixelWindow { x, y, width: right - x, height: bottom - y };
        let coverage: Vec<f32> = window.pixels(width).map(|i| mask.coverage(i)).collect();
        let distance = signed_distance(&coverage, window.width as usize, window.height as usize);
        let near = distance.into_iter().map(f16::from_f32).collect();
        Some(Self {
            view: ViewIndex::default(),
            name: name.to_owned(),
            camera: *camera,
            mask: mask.clone(),
            window,
            near,
            middle,
            spread,
            carves: None,
        })
    }

    /// The background around the mask, without the mask's holes: for each pixel of the mask's
    /// window, whether it is background that reaches the window's border.
    pub(super) fn outside(&self) -> Vec<bool> {
        let window = self.mask.window();
        let (width, height) = (window.width as usize, window.height as usize);
        let pixels = window.pixels(self.camera.width);
        let mut open: Vec<bool> = pixels.map(|i| self.mask.coverage(i) < 0.5).collect();
        let mut reached = vec![false; open.len()];
        let is_rim =
            |i: &usize| [0, width - 1].contains(&(i % width)) || [0, height - 1].contains(&(i / width));
        let rim = (0..open.len()).filter(is_rim);
        flood(rim, &mut open, |i| neighbors(i, [width, height, 1]), |i| reached[i] = true);
        reached
    }

    pub(super) fn pixel_count(&self) -> usize {
        self.camera.width as usize * self.camera.height as usize
    }

    /// Signed distance in pixels from a pixel's center to the boundary of the mask, negative
    /// inside.
    pub(super) fn distance(&self, pixel: usize) -> f32 {
        let width = self.camera.width as usize;
        self.distance_at(pixel % width, pixel / width)
    }

    /// The signed distance by column and row, continued beyond the window from its nearest pixel.
    fn distance_at(&self, x: usize, y: usize) -> f32 {
        let within =
            |at: usize, first: u32, count: u32| at.clamp(first as usize, (first + count - 1) as usize);
        let near_x = within(x, self.window.x, self.window.width);
        let near_y = within(y, self.window.y, self.window.height);
        let row = (near_y - self.window.y as usize) * self.window.width as usize;
        let near = widened(self.near[row + near_x - self.window.x as usize]);
        if (near_x, near_y) == (x, y) {
            return near;
        }
        near + (x.abs_diff(near_x) as f32).hypot(y.abs_diff(near_y) as f32)
    }

    pub(super) fn ray(&self, pixel: usize) -> Ray {
        self.camera.pixel_ray(pixel as u32)
    }

    /// Whether a pixel is far enough from the frame's border for the mask to be reliable.
    pub(super) fn is_inner(&self, pixel: usize) -> bool {
        let (x, y) = self.center(pixel);
        is_inner(&self.camera, x, y)
    }

    /// Whether the mask is reliable at a pixel, and its boundary more than `depth` pixels outside
    /// of that.
    pub(super) fn is_within(&self, pixel: usize, depth: f32) -> bool {
        self.distance(pixel) < -depth && self.is_inner(pixel)
    }

    /// Width in pixels of a cell in the middle of a grid.
    pub(super) fn cell_pixels(&self, grid: &SdfGrid) -> f32 {
        let middle = grid.origin + Vec3::splat(0.5 * grid.spacing * (grid.side - 1) as f32);
        grid.spacing / (pixel_size(&self.camera) * self.camera.position().distance(middle))
    }

    fn center(&self, pixel: usize) -> (f32, f32) {
        let width = self.camera.width as usize;
        ((pixel % width) as f32 + 0.5, (pixel / width) as f32 + 0.5)
    }

    /// The gradient of the distance at an image position, per pixel.
    pub(super) fn slope_at(&self, x: f32, y: f32) -> Vec2 {
        let across = self.pixels(x + 1.0, y) - self.pixels(x - 1.0, y);
        0.5 * Vec2::new(across, self.pixels(x, y + 1.0) - self.pixels(x, y - 1.0))
    }

    /// Where the view sees a point; `None` if it abstains.
    pub(super) fn look(&self, point: Vec3) -> Option<Sighting> {
        let (x, y, depth) = self.camera.project(point)?;
        let sighting =
            || Sighting { x, y, pixels: self.pixels(x, y), pixel_size: depth * pixel_size(&self.camera) };
        is_inner(&self.camera, x, y).then(sighting)
    }

    /// World distance of a point outside the silhouette's cone (negative inside); `None` if the
    /// view abstains.
    pub(super) fn world_distance(&self, point: Vec3) -> Option<f32> {
        self.look(point).map(|sighting| sighting.pixels * sighting.pixel_size)
    }

    /// The bilinear distance in pixels at an image position.
    pub(super) fn pixels(&self, x: f32, y: f32) -> f32 {
        let (width, height) = (self.camera.width as usize, self.camera.height as usize);
        let (x, y) = ((x - 0.5).clamp(0.0, (width - 1) as f32), (y - 0.5).clamp(0.0, (height - 1) as f32));
        let (x0, y0) = (x as usize, y as usize);
        let (x1, y1) = ((x0 + 1).min(width - 1), (y0 + 1).min(height - 1));
        let (tx, ty) = (x - x0 as f32, y - y0 as f32);
        let mixed =
            |[a, b, c, d]: [f32; 4]| (a * (1.0 - tx) + b * tx) * (1.0 - ty) + (c * (1.0 - tx) + d * tx) * ty;
        let PixelWindow { x: left, y: top, width: columns, height: rows } = self.window;
        let (column, line) = (x0.wrapping_sub(left as usize), y0.wrapping_sub(top as usize));
        let columns = columns as usize;
        if column < columns - 1 && line < rows as usize - 1 {
            let first = line * columns + column;
            return mixed(
                [first, first + 1, first + columns, first + columns + 1].map(|i| widened(self.near[i])),
            );
        }
        mixed([(x0, y0), (x1, y0), (x0, y1), (x1, y1)].map(|(x, y)| self.distance_at(x, y)))
    }
}

/// A finite half-precision number, without the call that the conversion by an instruction takes
/// where a program must not rely on it.
#[inline]
fn widened(half: f16) -> f32 {
    /// 2¹¹²: the difference between the biases of both exponents.
    const SCALE: f32 = f32::from_bits(0x7780_0000);
    let bits = u32::from(half.to_bits());
    let size = f32::from_bits((bits & 0x7fff) << 13) * SCALE;
    f32::from_bits(size.to_bits() | (bits & 0x8000) << 16)
}

/// Whether an image position is far enough from the frame's border for the mask to be reliable.
fn is_inner(camera: &Camera, x: f32, y: f32) -> bool {
    let (width, height) = (camera.width as f32, camera.height as f32);
    let border = BORDER.max(BORDER_SHARE * width.min(height));
    x >= border && x <= width - border && y >= border && y <= height - border
}

/// Size of a pixel at distance 1.
pub(super) fn pixel_size(camera: &Camera) -> f32 {
    2.0 / (camera.focal[0] + camera.focal[1])
}

/// The pixels near silhouettes, in the order in which a fit visits them.
#[derive(Resource)]
pub struct SilhouetteSamples(pub Vec<SilhouetteSample>);

/// A pixel near a silhouette.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SilhouetteSample {
    /// The pixel.
    pub pixel: PixelOf,
    /// Its camera ray, world space.
    pub ray: Ray,
    /// Signed distance to the silhouette of the mask in pixels, negative inside.
    pub distance: f32,
    /// Gradient of that distance in the image, per pixel.
    pub distance_gradient: Vec2,
    /// Coverage of the pixel, in [0, 1].
    pub coverage: f32,
    /// Size of a pixel at distance 1.
    pub pixel_size: f32,
}

impl SilhouetteSample {
    pub(super) fn new(silhouette: &Silhouette, pixel: u32) -> Self {
        let (camera, i) = (&silhouette.camera, pixel as usize);
        let (x, y) = silhouette.center(i);
        Self {
            pixel: PixelOf { view: silhouette.view, pixel },
            ray: camera.pixel_ray(pixel),
            distance: silhouette.distance(i),
            distance_gradient: silhouette.slope_at(x, y),
            coverage: silhouette.mask.coverage(i),
            pixel_size: pixel_size(camera),
        }
    }
}

/// Where the ray of a sample comes nearest to the surface; what is more than this `width` in pixels
/// inside is enough.
fn least_distance(grid: &SdfGrid, sample: &SilhouetteSample, width: f32) -> Option<LeastDistance> {
    let far = (grid.origin - sample.ray.origin).length() + grid.spacing * grid.side as f32;
    grid.least_distance(&sample.ray, -width * sample.pixel_size * far)
}

/// The point where the ray of a sample is nearest, and the derivative of the loss with respect to
/// the distance there.
pub(super) fn loss_derivative(grid: &SdfGrid, sample: &SilhouetteSample, width: f32) -> Option<(Vec3, f32)> {
    let least = least_distance(grid, sample, width)?;
    let scale = width * sample.pixel_size * least.distance;
    let coverage = (0.5 - least.value / scale).clamp(0.0, 1.0);
    let residual = coverage - sample.coverage;
    // A wrong pixel keeps its derivative where coverage is clamped, so that a missing part can grow
    // back.
    let right = residual == 0.0 || least.value.abs() > 8.0 * scale.max(grid.spacing);
    (!right).then(|| {
        let position = sample.ray.origin + sample.ray.direction * least.distance;
        (position, -residual.clamp(-HUBER, HUBER) / scale)
    })
}

/// The distance between the silhouettes of the mask and of the surface, and its derivatives with
/// respect to the camera, and to the object around `center`.
pub(super) fn aligned_silhouette(
    grid: &SdfGrid,
    camera: &Camera,
    center: Vec3,
    sample: &SilhouetteSample,
) -> Option<AlignedRow> {
    if sample.distance.abs() > ALIGNED_REACH {
        return None;
    }
    let least = least_distance(grid, sample, 2.0 * ALIGNED_REACH)?;
    let pixels = least.value / (sample.pixel_size * least.distance);
    let point = sample.ray.origin + sample.ray.direction * least.distance;
    let row = AlignedRow::new(camera, point, center, sample.distance_gradient, sample.distance - pixels);
    row.filter(|_| pixels.abs() < ALIGNED_REACH)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_finite_half_is_widened_exactly() {
        for half in (0..=u16::MAX).map(f16::from_bits).filter(|half| half.is_finite()) {
            assert_eq!(widened(half).to_bits(), half.to_f32().to_bits(), "{half}");
        }
    }

    #[test]
    fn distances_are_those_of_the_whole_frame() {
        let (width, height) = (90, 70);
        let camera = Camera::look_at(Vec3::Z * 4.0, Vec3::ZERO, Vec3::Y, 40.0, width, height).unwrap();
        let covered = |i: u32| {
            let offset = Vec2::new((i % width) as f32 - 52.0, (i / width) as f32 - 30.0);
            (14.5 - offset.length()).clamp(0.0, 1.0)
        };
        let coverage: Vec<f32> = (0..width * height).map(covered).collect();
        let whole = signed_distance(&coverage, width as usize, height as usize);
        let mask = StoredMask::new(&lobelia_geometry::view::Mask { width, height, coverage });
        let silhouette = Silhouette::new("disc", &camera, &mask).unwrap();
        for i in silhouette.window.pixels(width) {
            let (found, expected) = (silhouette.distance(i), whole[i]);
            assert!((found - expected).abs() < 1e-3 * (1.0 + expected.abs()), "{i}: {found} {expected}");
        }
        // Between pixels, within the window and straight beyond it.
        for (x, y) in [(40.3, 20.6), (48.0, 30.2), (60.2, 41.9), (89.4, 30.6)] {
            let expected = (Vec2::new(x, y) - Vec2::new(52.5, 30.5)).length() - 14.0;
            let found = silhouette.pixels(x, y);
            assert!((found - expected).abs() < 1.5, "{x} {y}: {found} {expected}");
        }
    }

    const WIDTH: f32 = 2.0;
    /// Size of a pixel at distance 1; the camera is 3 away.
    const PIXEL: f32 = 0.02;
    const EDGE: f32 = 0.6;

    /// A square plate across the z axis, of half the thickness `half`.
    fn plate(half: f32, edge: f32) -> SdfGrid {
        SdfGrid::from_fn(Vec3::ZERO, 1.0, 80, |p| {
            let out = p.abs() - Vec3::new(edge, edge, half);
            out.max(Vec3::ZERO).length() + out.max_element().min(0.0)
        })
    }

    fn in_mask(x: f32) -> f32 {
        if x < EDGE { 1.0 } else { 0.0 }
    }

    /// A ray down on the plate, at `x`; the edge of the mask is at [`EDGE`].
    fn sample(x: f32) -> SilhouetteSample {
        SilhouetteSample {
            pixel: PixelOf { view: ViewIndex(0), pixel: 0 },
            ray: Ray { origin: Vec3::new(x, 0.013, 3.0), direction: -Vec3::Z },
            distance: (x - EDGE) / (3.0 * PIXEL),
            distance_gradient: Vec2::X,
            coverage: in_mask(x),
            pixel_size: PIXEL,
        }
    }

    #[test]
    fn what_a_mask_shows_and_the_surface_lacks_pulls_outward_and_the_reverse_inward() {
        let pull = |grid: &SdfGrid, x: f32| {
            loss_derivative(grid, &sample(x), WIDTH).map(|(_, derivative)| derivative)
        };
        assert!(pull(&plate(0.02, 0.45), 0.55).unwrap() > 0.0);
        assert!(pull(&plate(0.02, 0.75), 0.65).unwrap() < 0.0);
        assert!(pull(&plate(0.2, 0.75), 0.65).unwrap() < 0.0);
    }

    #[test]
    fn the_derivative_is_that_of_the_loss() {
        let loss = |grid: &SdfGrid, x: f32| {
            let least = grid.least_distance(&sample(x).ray, -1.0).unwrap();
            let scale = WIDTH * PIXEL * least.distance;
            let residual = ((0.5 - least.value / scale).clamp(0.0, 1.0) - in_mask(x)).abs();
            if residual < HUBER { 0.5 * residual * residual } else { HUBER * (residual - 0.5 * HUBER) }
        };
        // The surface is outside of the mask's edge, and inside.
        for (radius, x) in [(0.62, 0.61), (0.66, 0.63), (0.58, 0.61)] {
            let ball = |by: f32| SdfGrid::from_fn(Vec3::ZERO, 1.0, 80, |p| p.length() - radius + by);
            let moved = |by: f32| f64::from(loss(&ball(by), x));
            let expected = (moved(1e-3) - moved(-1e-3)) / 2e-3;
            let found = f64::from(loss_derivative(&ball(0.0), &sample(x), WIDTH).unwrap().1);
            assert!((found - expected).abs() < 0.05 * expected.abs() + 1e-3, "{found} {expected}");
        }
    }
}
