//! The silhouette of a view: the signed distance to the boundary of its mask, and the distance of points of space from its cone.

use crate::sdf::SdfGrid;
use crate::sdf::distance_transform::signed_distance;
use crate::view::{Camera, PixelWindow, StoredMask, ViewIndex};
use glam::{Vec2, Vec3};
use half::f16;

/// Pixels from the border of a frame within which a view abstains, and the same as a share of the frame's shorter side:
/// masks are often trimmed there.
const BORDER: f32 = 2.0;
const BORDER_SHARE: f32 = 0.02;
/// Pixels around the mask for which the distance is kept.
const MARGIN: u32 = 16;
/// Views that must see a point for it to be inside.
pub(super) const MIN_VIEWS: usize = 3;

/// A mask with its camera.
#[derive(Clone, Debug)]
pub struct Silhouette {
    /// The view.
    pub(super) view: ViewIndex,
    /// The view's name.
    pub(super) name: String,
    pub(super) camera: Camera,
    pub(super) mask: StoredMask,
    /// Where `near` lies in the frame.
    window: PixelWindow,
    /// Signed distance in pixels from the center of each pixel of the window to the boundary of the mask, negative inside.
    near: Vec<f16>,
    /// The ray through the middle of the mask, and the tangent of the angle around it that holds all of the mask.
    pub(super) middle: Vec3,
    pub(super) spread: f32,
    /// Where the mask carves alone; `None` if it is not trusted ([`trust`](crate::shape::trust)).
    pub(super) carves: Option<Outside>,
}

/// A point as a view sees it.
pub(super) struct Sighting {
    /// Image position.
    pub x: f32,
    pub y: f32,
    /// Signed distance in pixels to the boundary of the mask, negative inside.
    pub pixels: f32,
    /// World size of a pixel at the point.
    pub pixel_size: f32,
}

impl Sighting {
    /// World distance of the point outside the silhouette's cone, negative inside.
    pub fn world_distance(&self) -> f32 {
        self.pixels * self.pixel_size
    }
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
        let window = with_margin(mask.window(), [width, height]);
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

    /// The same as that of another view.
    pub(super) fn of_view(self, view: ViewIndex) -> Self {
        Self { view, ..self }
    }

    /// Number of pixels of the frame.
    pub(super) fn pixel_count(&self) -> usize {
        self.camera.width as usize * self.camera.height as usize
    }

    /// Signed distance in pixels from a pixel's center to the boundary of the mask, negative inside.
    pub(super) fn distance(&self, pixel: usize) -> f32 {
        let width = self.camera.width as usize;
        self.distance_at(pixel % width, pixel / width)
    }

    /// The same by column and row. Beyond the window it is continued from the window's nearest pixel.
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

    /// Width in pixels of a cell in the middle of a grid.
    pub(super) fn cell_pixels(&self, grid: &SdfGrid) -> f32 {
        let middle = grid.origin + Vec3::splat(0.5 * grid.spacing * (grid.side - 1) as f32);
        grid.spacing / (pixel_size(&self.camera) * self.camera.position().distance(middle))
    }

    /// Image position of a pixel's center.
    pub(super) fn center(&self, pixel: usize) -> (f32, f32) {
        let width = self.camera.width as usize;
        ((pixel % width) as f32 + 0.5, (pixel / width) as f32 + 0.5)
    }

    /// Gradient of the distance in the image at a pixel, per pixel.
    pub(super) fn slope(&self, pixel: usize) -> Vec2 {
        let (x, y) = self.center(pixel);
        self.slope_at(x, y)
    }

    /// The same at an image position.
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

    /// World distance of a point outside the silhouette's cone (negative inside); `None` if the view abstains.
    pub(super) fn world_distance(&self, point: Vec3) -> Option<f32> {
        self.look(point).map(|sighting| sighting.world_distance())
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

/// A finite half-precision number, without the call that the conversion by an instruction takes where a program must not rely on it.
#[inline]
fn widened(half: f16) -> f32 {
    /// 2¹¹²: the difference between the biases of both exponents.
    const SCALE: f32 = f32::from_bits(0x7780_0000);
    let bits = u32::from(half.to_bits());
    let size = f32::from_bits((bits & 0x7fff) << 13) * SCALE;
    f32::from_bits(size.to_bits() | (bits & 0x8000) << 16)
}

/// The background around a mask, without the mask's holes.
#[derive(Clone, Debug)]
pub(super) struct Outside {
    window: PixelWindow,
    /// For each pixel of the window, whether it is background that reaches the window's border.
    reached: Vec<bool>,
}

impl Outside {
    /// That of a silhouette.
    pub(super) fn of(silhouette: &Silhouette) -> Self {
        let window = silhouette.mask.window();
        let (width, height) = (window.width as usize, window.height as usize);
        let pixels: Vec<usize> = window.pixels(silhouette.camera.width).collect();
        let mut reached = vec![false; pixels.len()];
        let is_rim =
            |i: &usize| [0, width - 1].contains(&(i % width)) || [0, height - 1].contains(&(i / width));
        let mut open: Vec<usize> = (0..pixels.len()).filter(is_rim).collect();
        while let Some(i) = open.pop() {
            if reached[i] || silhouette.mask.coverage(pixels[i]) >= 0.5 {
                continue;
            }
            reached[i] = true;
            let (x, y) = (i % width, i / width);
            open.extend((x > 0).then(|| i - 1));
            open.extend((x + 1 < width).then_some(i + 1));
            open.extend((y > 0).then(|| i - width));
            open.extend((y + 1 < height).then_some(i + width));
        }
        Self { window, reached }
    }

    /// Whether an image position is outside.
    pub(super) fn contains(&self, x: f32, y: f32) -> bool {
        let (column, row) = (x as i64 - i64::from(self.window.x), y as i64 - i64::from(self.window.y));
        let (width, height) = (i64::from(self.window.width), i64::from(self.window.height));
        let in_window = (0..width).contains(&column) && (0..height).contains(&row);
        !in_window || self.reached[(row * width + column) as usize]
    }
}

/// A window with [`MARGIN`] pixels more on each side, as far as the frame goes.
fn with_margin(window: PixelWindow, size: [u32; 2]) -> PixelWindow {
    let (x, y) = (window.x.saturating_sub(MARGIN), window.y.saturating_sub(MARGIN));
    let right = (window.x + window.width + MARGIN).min(size[0]);
    let bottom = (window.y + window.height + MARGIN).min(size[1]);
    PixelWindow { x, y, width: right - x, height: bottom - y }
}

/// Whether an image position is far enough from the frame's border for the mask to be reliable.
pub(super) fn is_inner(camera: &Camera, x: f32, y: f32) -> bool {
    let (width, height) = (camera.width as f32, camera.height as f32);
    let border = BORDER.max(BORDER_SHARE * width.min(height));
    x >= border && x <= width - border && y >= border && y <= height - border
}

/// Size of a pixel at distance 1.
pub(super) fn pixel_size(camera: &Camera) -> f32 {
    2.0 / (camera.focal[0] + camera.focal[1])
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
        let mask = StoredMask::new(&crate::view::Mask { width, height, coverage });
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
}
