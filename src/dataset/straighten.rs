//! Undistortion of photographs: resampling to a pinhole camera of the same focal lengths, over the largest upright rectangle that the
//! photograph fills.

use crate::dataset::distortion::{Distortion, Unseen};
use crate::view::raster::{Tap, bilinear};
use crate::view::{Camera, Image, Mask};
use glam::DVec2;

/// Samples along each edge of a picture that determine its bounds.
const EDGE_SAMPLES: u32 = 64;
/// Halvings of the interval in which the size of the rectangle is searched for.
const BISECTIONS: u32 = 16;
/// How far outside the photograph the rectangle may be sampled, in pixels; the border is continued.
const OVERHANG: f64 = 1.0;

/// Resampling of a distorted photograph to an undistorted one.
pub(super) struct Straightening {
    distortion: Distortion,
    bent: Camera,
    /// The pinhole camera of the undistorted photograph.
    pub camera: Camera,
    /// Whether the photograph shows rays that the undistorted one leaves out because it would become too large, or infinite.
    pub is_cropped: bool,
}

impl Straightening {
    /// The resampling for photographs of the camera `bent`. `Err` says what is wrong with the coefficients, as a clause.
    pub fn new(distortion: Distortion, bent: &Camera) -> Result<Self, String> {
        let (bounds, is_cropped) = straight_bounds(&distortion, bent)?;
        let [x, y] = bounds;
        let sides = [x, y].map(|[first, last]| (last - first + 1).max(0) as u32);
        if sides[0] < bent.width.div_ceil(4) || sides[1] < bent.height.div_ceil(4) {
            let [width, height] = sides;
            return Err(format!(
                "the lens distortion ({distortion}) leaves {width}×{height} pixels of the image"
            ));
        }
        let [width, height] = sides;
        let center = [bent.center[0] - x[0] as f32, bent.center[1] - y[0] as f32];
        Ok(Self { distortion, bent: *bent, camera: Camera { width, height, center, ..*bent }, is_cropped })
    }

    pub fn image(&self, image: &Image) -> Image {
        let pixels = self.taps().map(|taps| taps.iter().map(|tap| image.pixels[tap.0] * tap.1).sum());
        Image { width: self.camera.width, height: self.camera.height, pixels: pixels.collect() }
    }

    pub fn mask(&self, mask: &Mask) -> Mask {
        let coverage = self.taps().map(|taps| taps.iter().map(|tap| mask.coverage[tap.0] * tap.1).sum());
        Mask { width: self.camera.width, height: self.camera.height, coverage: coverage.collect() }
    }

    /// For each undistorted pixel, whether a flag of its source pixels is set.
    pub fn flags(&self, flags: &[bool]) -> Vec<bool> {
        self.taps().map(|taps| taps.iter().any(|tap| tap.1 > 1e-3 && flags[tap.0])).collect()
    }

    /// For each undistorted pixel, the distorted pixels that it is interpolated from, with their weights.
    fn taps(&self) -> impl Iterator<Item = [Tap; 4]> + '_ {
        let (bent, straight) = (&self.bent, &self.camera);
        let pixels = (0..straight.height).flat_map(|y| (0..straight.width).map(move |x| (x, y)));
        pixels.map(move |(x, y)| {
            let at = self.source(DVec2::new(f64::from(x), f64::from(y)));
            bilinear(bent.width, bent.height, at.x as f32, at.y as f32)
        })
    }

    /// Where in the distorted photograph a place of the undistorted one is, in pixels; (0, 0) is the center of the first of either.
    pub fn source(&self, at: DVec2) -> DVec2 {
        in_pixels(&self.bent, self.distortion.distort(on_plane(&self.camera, at.x, at.y)))
    }

    /// The full horizontal and vertical field of view of the undistorted photograph, in degrees.
    pub fn field_degrees(&self) -> [f64; 2] {
        let last = DVec2::new(f64::from(self.camera.width), f64::from(self.camera.height)) - 0.5;
        let (low, high) = (on_plane(&self.camera, -0.5, -0.5), on_plane(&self.camera, last.x, last.y));
        [high.x.atan() - low.x.atan(), high.y.atan() - low.y.atan()].map(f64::to_degrees)
    }
}

/// The point on the image plane of pixel coordinates (x, y), which may be fractional.
pub(super) fn on_plane(camera: &Camera, x: f64, y: f64) -> DVec2 {
    let [fx, fy] = camera.focal.map(f64::from);
    let [cx, cy] = camera.center.map(|c| f64::from(c - camera.pixel_center));
    let y_plane = (y - cy) / fy;
    DVec2::new((x - cx - f64::from(camera.skew) * y_plane) / fx, y_plane)
}

/// The inverse of [`on_plane`].
fn in_pixels(camera: &Camera, p: DVec2) -> DVec2 {
    let [fx, fy] = camera.focal.map(f64::from);
    let [cx, cy] = camera.center.map(|c| f64::from(c - camera.pixel_center));
    DVec2::new(fx * p.x + f64::from(camera.skew) * p.y + cx, fy * p.y + cy)
}

/// The last pixel of a camera's picture.
fn last_pixel(camera: &Camera) -> DVec2 {
    DVec2::new(f64::from(camera.width - 1), f64::from(camera.height - 1))
}

/// Points along the four edges of a rectangle: left, right, top, bottom.
fn edges(low: DVec2, high: DVec2) -> [impl Iterator<Item = DVec2>; 4] {
    let corners = [low, DVec2::new(low.x, high.y), DVec2::new(high.x, low.y), high];
    [(0, 1), (2, 3), (0, 2), (1, 3)].map(|(start, end)| {
        let (start, end) = (corners[start], corners[end]);
        (0..=EDGE_SAMPLES).map(move |i| start.lerp(end, f64::from(i) / f64::from(EDGE_SAMPLES)))
    })
}

/// First and last column, first and last row of the rectangle that the undistorted photograph fills, in pixels of the distorted
/// one, and whether it leaves out what the photograph shows. It extends beyond the frame where the distortion moves edges inward,
/// by at most half the size.
fn straight_bounds(distortion: &Distortion, bent: &Camera) -> Result<([[i64; 2]; 2], bool), String> {
    let last = last_pixel(bent);
    let (mut low, mut high) = (DVec2::NEG_INFINITY, DVec2::INFINITY);
    let mut is_cropped = false;
    for (side, edge) in edges(DVec2::ZERO, last).into_iter().enumerate() {
        let mut folded = 0;
        for at in edge {
            match distortion.undistort(on_plane(bent, at.x, at.y)).map(|p| in_pixels(bent, p)) {
                Ok(straight) if side == 0 => low.x = low.x.max(straight.x),
                Ok(straight) if side == 1 => high.x = high.x.min(straight.x),
                Ok(straight) if side == 2 => low.y = low.y.max(straight.y),
                Ok(straight) => high.y = high.y.min(straight.y),
                Err(Unseen::Behind) => is_cropped = true,
                Err(Unseen::Folded) => folded += 1,
            }
        }
        // Few calibrations are good up to the corners of the image; the rectangle need not reach them.
        if 2 * folded > EDGE_SAMPLES {
            return Err(format!("the lens distortion ({distortion}) folds the image over"));
        }
    }
    let spare = 0.5 * last;
    is_cropped |= low.cmplt(-spare).any() || high.cmpgt(last + spare).any();
    let (low, high) = filled(distortion, bent, low.max(-spare), high.min(last + spare));
    // Rounding must not remove the pixels of an edge that does not move.
    let (low, high) = ((low - 1e-3).ceil(), (high + 1e-3).floor());
    Ok(([[low.x as i64, high.x as i64], [low.y as i64, high.y as i64]], is_cropped))
}

/// The rectangle, or the largest smaller one toward the principal point that the photograph fills.
fn filled(distortion: &Distortion, bent: &Camera, low: DVec2, high: DVec2) -> (DVec2, DVec2) {
    let last = last_pixel(bent);
    let is_filled = |low: DVec2, high: DVec2| {
        edges(low, high).into_iter().flatten().all(|at| {
            let p = on_plane(bent, at.x, at.y);
            let seen = in_pixels(bent, distortion.distort(p));
            let is_inside = seen.cmpge(DVec2::splat(-OVERHANG)).all() && seen.cmple(last + OVERHANG).all();
            is_inside && distortion.reaches(p)
        })
    };
    if low.cmpge(high).any() || is_filled(low, high) {
        return (low, high);
    }
    let anchor = in_pixels(bent, DVec2::ZERO).clamp(low, high);
    let part = |share: f64| (anchor.lerp(low, share), anchor.lerp(high, share));
    let (mut good, mut bad) = (0.0, 1.0);
    for _ in 0..BISECTIONS {
        let share = 0.5 * (good + bad);
        let (low, high) = part(share);
        (good, bad) = if is_filled(low, high) { (share, bad) } else { (good, share) };
    }
    part(good)
}
