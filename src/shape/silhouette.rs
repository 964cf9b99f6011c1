//! The silhouette of a view: the signed distance to the boundary of its mask, and the distance of points of space from its cone.

use crate::sdf::silhouette::signed_distance;
use crate::view::{Camera, Mask, ViewIndex};
use glam::{Vec2, Vec3};

/// Pixels from the border of a frame within which a view abstains, and the same as a share of the frame's shorter side:
/// masks are often trimmed there.
const BORDER: f32 = 2.0;
const BORDER_SHARE: f32 = 0.02;
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
    /// Signed distance in pixels from each pixel's center to the boundary of the mask, negative inside.
    pub(super) distance: Vec<f32>,
    /// The mask's coverage.
    pub(super) coverage: Vec<f32>,
    /// The ray through the middle of the mask, and the tangent of the angle around it that holds all of the mask.
    pub(super) middle: Vec3,
    pub(super) spread: f32,
}

impl Silhouette {
    /// From a view's name, camera and mask; `None` if the mask is empty.
    pub fn new(name: &str, camera: &Camera, mask: &Mask) -> Option<Self> {
        let (width, height) = (mask.width as usize, mask.height as usize);
        let inside = || {
            let pixels = mask.coverage.iter().enumerate().filter(|(_, coverage)| **coverage >= 0.5);
            pixels.map(|(i, _)| ((i % width) as f32 + 0.5, (i / width) as f32 + 0.5))
        };
        let rays: Vec<Vec3> = inside().map(|(x, y)| camera.ray(x, y).direction).collect();
        let middle = rays.iter().sum::<Vec3>().try_normalize()?;
        let spread =
            rays.iter().map(|ray| middle.cross(*ray).length() / middle.dot(*ray)).fold(0.0, f32::max);
        Some(Self {
            view: ViewIndex::default(),
            name: name.to_owned(),
            camera: *camera,
            distance: signed_distance(&mask.coverage, width, height),
            coverage: mask.coverage.clone(),
            middle,
            spread,
        })
    }

    /// The same as that of another view.
    pub(super) fn of_view(self, view: ViewIndex) -> Self {
        Self { view, ..self }
    }

    /// Image position of a pixel's centre.
    pub(super) fn center(&self, pixel: usize) -> (f32, f32) {
        let width = self.camera.width as usize;
        ((pixel % width) as f32 + 0.5, (pixel / width) as f32 + 0.5)
    }

    /// Gradient of the distance in the image at a pixel, per pixel.
    pub(super) fn slope(&self, pixel: usize) -> Vec2 {
        let (x, y) = self.center(pixel);
        let across = self.pixels(x + 1.0, y) - self.pixels(x - 1.0, y);
        0.5 * Vec2::new(across, self.pixels(x, y + 1.0) - self.pixels(x, y - 1.0))
    }

    /// World distance of a point outside the silhouette's cone (negative inside); `None` if the view abstains.
    pub(super) fn world_distance(&self, point: Vec3) -> Option<f32> {
        let (x, y, depth) = self.camera.project(point)?;
        is_inner(&self.camera, x, y).then(|| self.pixels(x, y) * depth * pixel_size(&self.camera))
    }

    /// The bilinear distance in pixels at an image position.
    fn pixels(&self, x: f32, y: f32) -> f32 {
        let (width, height) = (self.camera.width as usize, self.camera.height as usize);
        let (x, y) = ((x - 0.5).clamp(0.0, (width - 1) as f32), (y - 0.5).clamp(0.0, (height - 1) as f32));
        let (x0, y0) = (x as usize, y as usize);
        let (x1, y1) = ((x0 + 1).min(width - 1), (y0 + 1).min(height - 1));
        let (tx, ty) = (x - x0 as f32, y - y0 as f32);
        let row = |y: usize| self.distance[y * width + x0] * (1.0 - tx) + self.distance[y * width + x1] * tx;
        row(y0) * (1.0 - ty) + row(y1) * ty
    }
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

/// The hull's signed distance at a point, with this share of the views forgiven; `outside` if too few see it.
pub(super) fn hull_distance(silhouettes: &[Silhouette], point: Vec3, forgiven: f32, outside: f32) -> f32 {
    let mut seen: Vec<f32> = silhouettes.iter().filter_map(|s| s.world_distance(point)).collect();
    if seen.len() < MIN_VIEWS {
        return outside;
    }
    let forgiven = (forgiven * seen.len() as f32).floor() as usize;
    let (_, kth, _) = seen.select_nth_unstable_by(forgiven, |a, b| b.total_cmp(a));
    *kth
}
