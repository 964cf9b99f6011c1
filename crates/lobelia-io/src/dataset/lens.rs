//! Lenses of camera files: intrinsics, their conversion to a camera for an image of a known size,
//! and lens distortion and its removal.
//!
//! A ray meets the plane at depth 1 in a point p. The lens shows it where a pinhole camera of the
//! same focal lengths shows another point of that plane, in three steps:
//!
//! 1. a fisheye lens shows the angle θ = atan ‖p‖ instead of its tangent;
//! 2. a quotient of polynomials in the squared length scales the result;
//! 3. tangential terms shift it.
//!
//! These are OpenCV's models (`calib3d`), and those of COLMAP (`sensor/models`) that photographs of
//! usual lenses have.
//!
//! Photographs are undistorted by resampling them to a pinhole camera of the same focal lengths,
//! over the largest upright rectangle that the photograph fills.

use crate::dataset::pose::check_matrix;
use glam::{Affine3A, DMat2, DVec2};
use lobelia_geometry::view::raster::{Tap, bilinear};
use lobelia_geometry::view::{Camera, Image, Mask};
use std::f64::consts::{FRAC_PI_2, PI};

/// Range of focal lengths, as multiples of the larger side of the image: fields of view between
/// 0.006° and 179°.
const FOCAL_RANGE: [f64; 2] = [0.005, 10_000.0];
/// How far outside the image the principal point may be, and how large the skew, in image sizes.
const FARTHEST_CENTER: f64 = 10.0;
/// Steps of the continuation from the image's center to a point, and Newton steps in each of them.
const CONTINUATION_STEPS: u32 = 8;
const NEWTON_STEPS: u32 = 12;
/// Points between the center and an image point where folds are looked for.
const FOLD_SAMPLES: u32 = 24;
/// Least determinant of the Jacobian where an image counts as not folded.
const LEAST_DETERMINANT: f64 = 1e-6;
/// Points of the plane farther out than this are as good as behind the camera (89.9°).
const FARTHEST: f64 = 1e3;
/// Fisheye polynomials are calibrated up to the rim of the image circle; beyond this angle in
/// radians a fold is that rim.
const RIM: f64 = 1.2;
/// Samples along each edge of a picture that determine its bounds.
const EDGE_SAMPLES: u32 = 64;
/// Halvings of the interval in which the size of the rectangle is searched for.
const BISECTIONS: u32 = 16;
/// How far outside the photograph the rectangle may be sampled, in pixels; the border is continued.
const OVERHANG: f64 = 1.0;

/// COLMAP's camera models that are read: number, name, count of focal lengths, and OpenCV's names
/// of the coefficients, in the order of COLMAP's `sensor/models`. Two numbers for the principal
/// point are between them.
pub(super) const MODELS: [(u32, &str, usize, &[&str]); 11] = [
    (0, "SIMPLE_PINHOLE", 1, &[]),
    (1, "PINHOLE", 2, &[]),
    (2, "SIMPLE_RADIAL", 1, &["k1"]),
    (3, "RADIAL", 1, &["k1", "k2"]),
    (4, "OPENCV", 2, &["k1", "k2", "p1", "p2"]),
    (5, "OPENCV_FISHEYE", 2, &["k1", "k2", "k3", "k4"]),
    (6, "FULL_OPENCV", 2, &["k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"]),
    (8, "SIMPLE_RADIAL_FISHEYE", 1, &["k1"]),
    (9, "RADIAL_FISHEYE", 1, &["k1", "k2"]),
    (14, "SIMPLE_FISHEYE", 1, &[]),
    (15, "FISHEYE", 2, &[]),
];

/// A problem of a camera, and its remedy.
pub(super) type Trouble = (String, &'static str);

/// An image size in whole pixels. `Err` says what is wrong, as a clause.
pub(super) fn whole_size([width, height]: [f64; 2]) -> Result<[u32; 2], String> {
    let is_size = |value: f64| value.fract() == 0.0 && (1.0..=f64::from(u32::MAX)).contains(&value);
    if is_size(width) && is_size(height) {
        return Ok([width as u32, height as u32]);
    }
    Err(format!("the image size {width}×{height} is not whole numbers above 0"))
}

/// A focal length, in either form.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Focal {
    /// In pixels.
    Pixels(f64),
    /// As the full field of view along its axis, in radians.
    Angle(f64),
}

/// Intrinsics, with optional parts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Lens {
    /// Image size, if stated.
    pub size: Option<[u32; 2]>,
    pub focal_x: Focal,
    /// `focal_x` in pixels if not stated.
    pub focal_y: Option<Focal>,
    /// Principal point in pixels; the center of the image if not stated.
    pub center: [Option<f64>; 2],
    /// In pixels.
    pub skew: f64,
    /// Lens distortion; [`Lens::camera`] is the pinhole camera without it.
    pub distortion: Distortion,
    /// Whether `size` is only the reference size of the numbers; an image of another size is then a
    /// scaled version.
    pub resizable: bool,
}

impl Lens {
    /// A lens without distortion, of focal lengths and principal point in pixels, for an image of
    /// any size.
    pub fn pinhole(focal: [f64; 2], center: [Option<f64>; 2]) -> Self {
        Self {
            size: None,
            focal_x: Focal::Pixels(focal[0]),
            focal_y: Some(Focal::Pixels(focal[1])),
            center,
            skew: 0.0,
            distortion: Distortion::NONE,
            resizable: false,
        }
    }

    /// From a row-major 4×4 calibration matrix K (up to scale) and the image size. `Err` is a
    /// clause that follows "K".
    pub fn from_matrix(k: &[f64], size: [u32; 2]) -> Result<Self, String> {
        check_matrix(k)?;
        if let Some(row) = [0, 1, 2].iter().find(|row| k[5 * **row] == 0.0) {
            return Err(format!("is singular: 0 in row {}, column {}", row + 1, row + 1));
        }
        let value = |row: usize, column: usize| k[4 * row + column] / k[10];
        let off_form = [(1, 0), (2, 0), (2, 1), (0, 3), (1, 3), (2, 3)];
        if let Some((row, column)) = off_form.into_iter().find(|&(row, column)| value(row, column) != 0.0) {
            let (found, row, column) = (k[4 * row + column], row + 1, column + 1);
            return Err(format!(
                "is not a calibration matrix: row {row}, column {column} is {found}, not 0 (is it transposed?)"
            ));
        }
        let center = [Some(value(0, 2)), Some(value(1, 2))];
        let lens = Self::pinhole([value(0, 0), value(1, 1)], center);
        Ok(Self { size: Some(size), skew: value(0, 1), ..lens })
    }

    /// The lens of the same picture scaled to `size` pixels; unchanged if that is not possible.
    pub fn resized(&self, size: [u32; 2]) -> Self {
        let (Some(stated), true) = (self.size, self.resizable) else { return *self };
        let factor = f64::from(size[0]) / f64::from(stated[0]);
        let wanted = [0, 1].map(|k| (f64::from(stated[k]) * factor).round() as u32);
        if size != wanted {
            return *self;
        }
        let scaled = |focal| match focal {
            Focal::Pixels(pixels) => Focal::Pixels(pixels * factor),
            Focal::Angle(angle) => Focal::Angle(angle),
        };
        Self {
            size: Some(size),
            focal_x: scaled(self.focal_x),
            focal_y: self.focal_y.map(scaled),
            center: self.center.map(|center| center.map(|pixels| pixels * factor)),
            skew: self.skew * factor,
            ..*self
        }
    }

    /// The camera for an image of `size` pixels. `Err` says what is wrong, as a clause.
    pub fn camera(
        &self,
        size: [u32; 2],
        world_from_camera: Affine3A,
        pixel_center: f32,
    ) -> Result<Camera, String> {
        let [width, height] = size;
        if width == 0 || height == 0 {
            return Err(format!("the image size is {width}×{height}"));
        }
        let Distortion { radial, divisor, tangential, .. } = &self.distortion;
        let mut coefficients = radial.iter().chain(divisor).chain(tangential);
        if let Some(wrong) = coefficients.find(|value| !value.is_finite()) {
            return Err(format!("a coefficient of the lens distortion is {wrong}"));
        }
        let focal_x = focal_pixels(self.focal_x, width, size)?;
        let focal_y = self.focal_y.map_or(Ok(focal_x), |focal| focal_pixels(focal, height, size))?;
        let center @ [x, y] = [0, 1].map(|k| self.center[k].unwrap_or(f64::from(size[k]) / 2.0));
        if ![0, 1].iter().all(|&k| (center[k] / f64::from(size[k]) - 0.5).abs() <= FARTHEST_CENTER) {
            return Err(format!(
                "the principal point is ({x}, {y}) pixels, more than {FARTHEST_CENTER} image sizes from the image's middle"
            ));
        }
        if self.skew.is_nan() || self.skew.abs() > FARTHEST_CENTER * f64::from(width) {
            return Err(format!("the skew is {} pixels", self.skew));
        }
        let [focal, center] = [[focal_x, focal_y], center].map(|pair| pair.map(|value| value as f32));
        let skew = self.skew as f32;
        Ok(Camera { width, height, focal, center, skew, world_from_camera, pixel_center })
    }
}

/// In pixels, of an axis of `extent` pixels.
fn focal_pixels(focal: Focal, extent: u32, size: [u32; 2]) -> Result<f64, String> {
    let pixels = match focal {
        Focal::Pixels(pixels) if pixels > 0.0 && pixels.is_finite() => pixels,
        Focal::Pixels(of) => return Err(format!("a focal length is {of} pixels; it must be above 0")),
        Focal::Angle(angle) if angle > 0.0 && angle < PI => 0.5 * f64::from(extent) / (0.5 * angle).tan(),
        Focal::Angle(of) => {
            return Err(format!("a field of view is {of} radians; it must lie between 0 and π"));
        }
    };
    let [width, height] = size;
    let [least, most] = FOCAL_RANGE.map(|factor| factor * f64::from(width.max(height)));
    if (least..=most).contains(&pixels) {
        return Ok(pixels);
    }
    Err(format!(
        "a focal length is {pixels:e} pixels; for an image of {width}×{height} it must lie between {least} and {most}"
    ))
}

/// Why no point of the plane at depth 1 is seen at an image point.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Unseen {
    /// The ray leads backward, or so far to the side that a pinhole camera does not show it.
    Behind,
    /// The distortion folds the image over before that point.
    Folded,
}

/// atan(r) / r for r = √`r2`.
fn arc(r2: f64) -> f64 {
    match r2 {
        r2 if r2 < 1e-4 => 1.0 - r2 * (1.0 / 3.0 - r2 * (1.0 / 5.0 - r2 / 7.0)),
        r2 => r2.sqrt().atan() / r2.sqrt(),
    }
}

/// 1 + c₁x + c₂x² + …, and its derivative.
fn polynomial(coefficients: &[f64], x: f64) -> (f64, f64) {
    let terms = coefficients.iter().rev().copied().chain([1.0]);
    terms.fold((0.0, 0.0), |(value, slope), c| (value * x + c, slope * x + value))
}

/// A lens model without focal lengths and principal point. All coefficients are 0 in
/// [`Distortion::NONE`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Distortion {
    pub is_fisheye: bool,
    /// k₁, k₂, … of 1 + k₁r² + k₂r⁴ + ….
    pub radial: [f64; 4],
    /// Coefficients of its divisor, in the same form.
    pub divisor: [f64; 3],
    /// OpenCV's p₁, p₂.
    pub tangential: [f64; 2],
}

impl Distortion {
    pub const NONE: Self =
        Self { is_fisheye: false, radial: [0.0; 4], divisor: [0.0; 3], tangential: [0.0; 2] };

    /// Of a camera model's name and its coefficients by the names that OpenCV has for them.
    pub fn of_model(model: &str, coefficient: impl Fn(&str) -> f64) -> Self {
        let [k1, k2, k3, k4, k5, k6] = ["k1", "k2", "k3", "k4", "k5", "k6"].map(&coefficient);
        let is_fisheye = model.ends_with("FISHEYE");
        let (radial, divisor) = match model {
            "FULL_OPENCV" => ([k1, k2, k3, 0.0], [k4, k5, k6]),
            _ => ([k1, k2, k3, k4], [0.0; 3]),
        };
        Self { is_fisheye, radial, divisor, tangential: ["p1", "p2"].map(coefficient) }
    }

    /// The image point of the ray through `p`, relative to a pinhole camera; NaN where the lens has
    /// no image.
    pub fn distort(&self, p: DVec2) -> DVec2 {
        self.warp(self.project(p)).0
    }

    /// The ray that is seen at `target`, as its point on the plane at depth 1.
    pub fn undistort(&self, target: DVec2) -> Result<DVec2, Unseen> {
        let q = self.unwarp(target)?;
        let p = match q.length() {
            angle if self.is_fisheye && angle >= FRAC_PI_2 => return Err(Unseen::Behind),
            angle if self.is_fisheye && angle >= 1e-6 => q * (angle.tan() / angle),
            _ => q,
        };
        if p.length() < FARTHEST { Ok(p) } else { Err(Unseen::Behind) }
    }

    fn project(&self, p: DVec2) -> DVec2 {
        if self.is_fisheye { p * arc(p.length_squared()) } else { p }
    }

    /// Steps 2 and 3, and their derivative.
    fn warp(&self, q: DVec2) -> (DVec2, DMat2) {
        let r2 = q.length_squared();
        let (over, over_slope) = polynomial(&self.radial, r2);
        let (under, under_slope) = polynomial(&self.divisor, r2);
        let factor = over / under;
        let slope = (over_slope - factor * under_slope) / under;
        let ([p1, p2], DVec2 { x, y }) = (self.tangential, q);
        let shift = DVec2::new(
            2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            2.0 * p2 * x * y + p1 * (r2 + 2.0 * y * y),
        );
        let across = 2.0 * (p1 * x + p2 * y);
        let by_x = DVec2::new(2.0 * p1 * y + 6.0 * p2 * x, across);
        let by_y = DVec2::new(across, 6.0 * p1 * y + 2.0 * p2 * x);
        let by_scale =
            DMat2::from_diagonal(DVec2::splat(factor)) + DMat2::from_cols(q * q.x, q * q.y) * (2.0 * slope);
        (q * factor + shift, by_scale + DMat2::from_cols(by_x, by_y))
    }

    /// The inverse of [`Self::warp`] on the part of the image that hangs together with its center.
    fn unwarp(&self, target: DVec2) -> Result<DVec2, Unseen> {
        let mut q = DVec2::ZERO;
        for step in 1..=CONTINUATION_STEPS {
            let goal = target * (f64::from(step) / f64::from(CONTINUATION_STEPS));
            q = self.newton(q, goal).ok_or_else(|| self.fold_toward(target))?;
        }
        if self.is_unfolded(q) { Ok(q) } else { Err(self.fold_toward(target)) }
    }

    /// The reason why the image is folded over on the way to `target`.
    fn fold_toward(&self, target: DVec2) -> Unseen {
        let is_rim = self.is_fisheye && self.is_unfolded(target.normalize_or_zero() * RIM);
        if is_rim { Unseen::Behind } else { Unseen::Folded }
    }

    fn newton(&self, mut q: DVec2, goal: DVec2) -> Option<DVec2> {
        for _ in 0..NEWTON_STEPS {
            let (value, derivative) = self.warp(q);
            let miss = value - goal;
            if miss.length() < 1e-13 * (1.0 + goal.length()) {
                return Some(q);
            }
            let determinant = derivative.determinant();
            if determinant.is_nan() || determinant < LEAST_DETERMINANT {
                return None;
            }
            q -= derivative.inverse() * miss;
        }
        ((self.warp(q).0 - goal).length() < 1e-9).then_some(q)
    }

    fn is_unfolded(&self, q: DVec2) -> bool {
        (0..=FOLD_SAMPLES).all(|i| {
            let (value, derivative) = self.warp(q * (f64::from(i) / f64::from(FOLD_SAMPLES)));
            value.is_finite() && derivative.determinant() > LEAST_DETERMINANT
        })
    }
}

/// Resampling of a distorted photograph to an undistorted one.
pub(super) struct Straightening {
    distortion: Distortion,
    bent: Camera,
    /// The pinhole camera of the undistorted photograph.
    pub camera: Camera,
    /// Whether the photograph shows rays that the undistorted one leaves out because it would
    /// become too large, or infinite.
    pub is_cropped: bool,
}

impl Straightening {
    /// The resampling for photographs of the camera `bent`. `Err` says what is wrong with the
    /// coefficients, as a clause.
    pub fn new(distortion: Distortion, bent: &Camera) -> Result<Self, String> {
        let (bounds, is_cropped) = straight_bounds(&distortion, bent)?;
        let [x, y] = bounds;
        let sides = [x, y].map(|[first, last]| (last - first + 1).max(0) as u32);
        if sides[0] < bent.width.div_ceil(4) || sides[1] < bent.height.div_ceil(4) {
            let [width, height] = sides;
            return Err(format!(
                "the lens distortion ({distortion:?}) leaves {width}×{height} pixels of the image"
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

    /// For each undistorted pixel, the distorted pixels that it is interpolated from, with their
    /// weights.
    fn taps(&self) -> impl Iterator<Item = [Tap; 4]> + '_ {
        let (bent, straight) = (&self.bent, &self.camera);
        let pixels = (0..straight.height).flat_map(|y| (0..straight.width).map(move |x| (x, y)));
        pixels.map(move |(x, y)| {
            let at = self.source(DVec2::new(f64::from(x), f64::from(y)));
            bilinear(bent.width, bent.height, at.x as f32, at.y as f32)
        })
    }

    /// Where in the distorted photograph a place of the undistorted one is, in pixels; (0, 0) is
    /// the center of the first of either.
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

/// First and last column, first and last row of the rectangle that the undistorted photograph
/// fills, in pixels of the distorted one, and whether it leaves out what the photograph shows. It
/// extends beyond the frame where the distortion moves edges inward, by at most half the size.
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
        // Few calibrations are good up to the corners of the image; the rectangle need not reach
        // them.
        if 2 * folded > EDGE_SAMPLES {
            return Err(format!("the lens distortion ({distortion:?}) folds the image over"));
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
            is_inside && distortion.is_unfolded(distortion.project(p))
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

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;
    use proptest::prelude::*;

    const BENT: Distortion =
        Distortion { radial: [-0.12, 0.03, 0.0, 0.0], tangential: [0.004, -0.003], ..Distortion::NONE };

    fn brown([k1, k2, k3]: [f64; 3], tangential: [f64; 2]) -> Distortion {
        Distortion { radial: [k1, k2, k3, 0.0], tangential, ..Distortion::NONE }
    }

    fn fisheye(radial: [f64; 4]) -> Distortion {
        Distortion { is_fisheye: true, radial, ..Distortion::NONE }
    }

    /// One lens of every kind, with moderate coefficients.
    fn lenses() -> [Distortion; 7] {
        let bent_fisheye = fisheye([-0.03, 0.01, -0.004, 0.0006]);
        [
            Distortion::NONE,
            BENT,
            Distortion { divisor: [0.2, -0.05, 0.01], radial: [0.25, 0.1, -0.02, 0.0], ..BENT },
            Distortion { radial: [-0.1, 0.02, -0.003, 0.0004], ..BENT },
            fisheye([0.0; 4]),
            bent_fisheye,
            Distortion { tangential: [0.002, -0.001], ..bent_fisheye },
        ]
    }

    proptest! {
        #[test]
        fn undistorting_undoes(x in -1.2f64..1.2, y in -1.2f64..1.2) {
            let p = DVec2::new(x, y);
            for lens in lenses() {
                let back = lens.undistort(lens.distort(p));
                prop_assert!(back.is_ok_and(|back| back.distance(p) < 1e-8), "{lens:?}: {back:?} {p}");
            }
        }

        #[test]
        fn fisheye_lenses_are_undone_far_out(angle in 0.0f64..1.5, around in 0.0f64..6.2) {
            let p = DVec2::from_angle(around) * angle.tan();
            for lens in lenses().into_iter().filter(|lens| lens.is_fisheye) {
                let back = lens.undistort(lens.distort(p));
                let slack = 1e-8 * (1.0 + p.length_squared());
                prop_assert!(back.is_ok_and(|back| back.distance(p) < slack), "{lens:?}: {back:?} {p}");
            }
        }

        /// Newton's steps are exact: the image of a shifted point differs by the derivative, to
        /// second order.
        #[test]
        fn images_move_as_the_derivative_says(x in -1.1f64..1.1, y in -1.1f64..1.1) {
            let (p, h) = (DVec2::new(x, y), 1e-5);
            for lens in lenses() {
                for axis in [DVec2::X, DVec2::Y] {
                    let slope = (lens.warp(p + axis * h).0 - lens.warp(p - axis * h).0) / (2.0 * h);
                    let error = lens.warp(p).1 * axis - slope;
                    prop_assert!(error.length() < 1e-8, "{lens:?} at {p}: {error}");
                }
            }
        }
    }

    /// Values by the formulas of COLMAP's `sensor/models` and OpenCV's `calib3d`, written out term
    /// by term in another language.
    #[test]
    fn known_values() {
        let opencv = brown([-0.2, 0.05, -0.01], [0.003, -0.002]);
        let full = Distortion { divisor: [0.1, -0.03, 0.02], ..opencv };
        for (lens, x, y) in [
            (opencv, 0.3793275, -0.284120625),
            (full, 0.3705980152671757, -0.2775735114503817),
            (fisheye([0.05, -0.01, 0.002, -0.0003]), 0.3747406078916136, -0.2810554559187101),
        ] {
            let found = lens.distort(DVec2::new(0.4, -0.3));
            assert!(found.distance(DVec2::new(x, y)) < 1e-12, "{lens:?}: {found:?}");
        }
    }

    #[test]
    fn coefficients_have_the_order_of_colmap() {
        let full = Distortion { divisor: [6.0, 7.0, 8.0], ..brown([1.0, 2.0, 5.0], [3.0, 4.0]) };
        for (model, lens) in [
            ("PINHOLE", Distortion::NONE),
            ("RADIAL", brown([1.0, 2.0, 0.0], [0.0; 2])),
            ("OPENCV", brown([1.0, 2.0, 0.0], [3.0, 4.0])),
            ("FULL_OPENCV", full),
            ("FISHEYE", fisheye([0.0; 4])),
            ("OPENCV_FISHEYE", fisheye([1.0, 2.0, 3.0, 4.0])),
        ] {
            let names = MODELS.iter().find(|known| known.1 == model).unwrap().3;
            let number = |name: &str| names.iter().position(|known| *known == name).map_or(0, |n| n + 1);
            assert_eq!(Distortion::of_model(model, |name| number(name) as f64), lens, "{model}");
        }
    }

    #[test]
    fn rays_to_the_side_and_behind_have_no_point_on_the_plane() {
        let at = |lens: Distortion, r: f64| lens.undistort(DVec2::new(0.0, r));
        assert!((at(fisheye([0.0; 4]), 1.5).unwrap().y - 1.5f64.tan()).abs() < 1e-9);
        assert_eq!(at(fisheye([0.0; 4]), 1.58), Err(Unseen::Behind));
        // The polynomial ends at 1.3 rad, as calibrations of image circles do; at 0.5 rad it is
        // wrong.
        for (end, unseen) in [(1.3, Unseen::Behind), (0.5, Unseen::Folded)] {
            assert_eq!(at(fisheye([-1.0 / (3.0 * end * end), 0.0, 0.0, 0.0]), 1.0), Err(unseen));
        }
    }

    /// Of a picture of 80×60 pixels.
    fn camera() -> Camera {
        Camera {
            width: 80,
            height: 60,
            focal: [70.0, 72.0],
            center: [41.0, 29.5],
            skew: 0.0,
            world_from_camera: Affine3A::IDENTITY,
            pixel_center: 0.5,
        }
    }

    /// Photographs a smooth picture over the image plane through a lens, straightens it, and
    /// compares with what the pinhole sees.
    fn straightened(lens: Distortion, bent: Camera) -> Straightening {
        let picture = |p: DVec2| (0.5 + 0.3 * (6.0 * p.x).sin() * (5.0 * p.y).cos()) as f32;
        let (width, height) = (bent.width, bent.height);
        let pixels = (0..width * height).map(|i| {
            let p = lens.undistort(on_plane(&bent, f64::from(i % width), f64::from(i / width)));
            Vec3::splat(p.map_or(9.0, picture))
        });
        let photograph = Image { width, height, pixels: pixels.collect() };
        let way = Straightening::new(lens, &bent).unwrap();
        let straight = way.image(&photograph);
        // Where pixels are coarse compared with the picture, interpolation is not exact.
        let tolerance = 0.25 * 36.0 / bent.focal[0].powi(2);
        for (i, pixel) in straight.pixels.iter().enumerate() {
            let (x, y) = (i as u32 % straight.width, i as u32 / straight.width);
            let direction = way.camera.ray(x as f32 + 0.5, y as f32 + 0.5).direction.as_dvec3();
            let p = direction.truncate() / direction.z;
            let (expected, slack) = (picture(p), tolerance * (1.0 + p.length_squared() as f32).powi(2));
            assert!((pixel.x - expected).abs() < slack, "{lens:?} ({x}, {y}): {} {expected}", pixel.x);
        }
        way
    }

    #[test]
    fn a_bent_photograph_becomes_what_the_pinhole_sees() {
        for k1 in [-0.12, 0.15] {
            let way = straightened(brown([k1, 0.03, 0.0], BENT.tangential), camera());
            let width = way.camera.width;
            assert_eq!(k1 < 0.0, width > 80, "barrels grow, pincushions shrink: {width}");
            assert!(!way.is_cropped);
        }
        for lens in lenses() {
            let way = straightened(lens, camera());
            let width = way.camera.width;
            assert!((60..=120).contains(&width) && !way.is_cropped, "{lens:?}: {width}");
        }
        let wide = Camera { width: 160, height: 120, focal: [60.0; 2], center: [82.0, 60.0], ..camera() };
        straightened(fisheye([0.01, 0.0, 0.0, 0.0]), wide);
        // A barrel whose polynomial ends just before the corners: the rectangle lies inside.
        let bent = Camera { focal: [60.0; 2], center: [40.0, 30.0], ..camera() };
        let lens = brown([-0.24, 0.0, 0.0], [0.0; 2]);
        assert_eq!(lens.undistort(on_plane(&bent, 0.0, 0.0)), Err(Unseen::Folded));
        let way = straightened(lens, bent);
        assert!(way.camera.width >= 80 && way.camera.height >= 60, "{:?}", way.camera);
    }

    /// Fields of view of 120°, 180° and 220° over a frame of 120×90 pixels, corners beyond it.
    #[test]
    fn wide_fisheye_photographs_are_cropped_to_what_a_pinhole_shows() {
        for (degrees, is_cropped) in [(90.0f32, false), (150.0, true), (180.0, true), (220.0, true)] {
            let focal = [120.0 / degrees.to_radians(); 2];
            let bent = Camera { width: 120, height: 90, focal, center: [60.0, 45.0], ..camera() };
            let way = Straightening::new(fisheye([0.0; 4]), &bent).unwrap();
            assert_eq!(way.is_cropped, is_cropped, "{degrees}");
            let [width, height] = way.field_degrees();
            assert!(width > 60.0 && width < 160.0 && height > 60.0, "{degrees}: {width} {height}");
            assert!(way.camera.width <= 240 && way.camera.height <= 180);
        }
    }

    #[test]
    fn folding_coefficients_are_refused() {
        for (lens, words) in [
            (brown([-3.0, 0.0, 0.0], [0.0; 2]), "folds the image over"),
            (brown([f64::NAN, 0.0, 0.0], [0.0; 2]), "folds"),
            // It unfolds again farther out.
            (brown([-30.0, 400.0, 0.0], [0.0; 2]), "folds"),
            (brown([400.0, 0.0, 0.0], [0.0; 2]), "leaves"),
            (fisheye([-3.0, 0.0, 0.0, 0.0]), "is_fisheye: true"),
        ] {
            let problem = Straightening::new(lens, &camera()).map(|way| way.camera).unwrap_err();
            assert!(problem.contains(words), "{problem}");
        }
    }

    #[test]
    fn focal_lengths_and_principal_points_have_bounds() {
        let good = Lens { size: Some([80, 60]), focal_y: None, ..Lens::pinhole([70.0; 2], [None; 2]) };
        let focal = |focal_x| Lens { focal_x, ..good };
        let pixels = |pixels| focal(Focal::Pixels(pixels));
        let center = |x| Lens { center: [Some(x), None], ..good };
        let camera = |lens: Lens| lens.camera([80, 60], Affine3A::IDENTITY, 0.5);
        assert_eq!(camera(good).unwrap().focal, [70.0; 2]);
        for lens in [pixels(0.5), pixels(700_000.0), center(-700.0), center(800.0)] {
            assert!(camera(lens).is_ok(), "{lens:?}");
        }
        for (lens, words) in [
            (pixels(900_000.0), "must lie between 0.4 and 800000"),
            (pixels(f64::INFINITY), "it must be above 0"),
            (Lens { focal_y: Some(Focal::Pixels(1e-40)), ..good }, "1e-40"),
            (focal(Focal::Angle(std::f64::consts::PI)), "must lie between"),
            (focal(Focal::Angle(1e-9)), "must lie between"),
            (center(-900.0), "the principal point is (-900, 30) pixels, more than 10 image sizes"),
            (Lens { skew: f64::NAN, ..good }, "skew"),
        ] {
            let problem = camera(lens).unwrap_err();
            assert!(problem.contains(words), "{problem}");
        }
    }
}
