//! Intrinsic parameters in camera files, and their conversion to a camera for an image of a known size.

use crate::dataset::distortion::Distortion;
use crate::dataset::straighten::Straightening;
use crate::view::Camera;
use glam::Affine3A;

/// Range of focal lengths, as multiples of the larger side of the image: fields of view between 0.006° and 179°.
const FOCAL_RANGE: [f64; 2] = [0.005, 10_000.0];
/// How far outside the image the principal point may be, and how large the skew, in image sizes.
const FARTHEST_CENTER: f64 = 10.0;

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
    /// Whether `size` is only the reference size of the numbers; an image of another size is then a scaled version.
    pub resizable: bool,
    /// Whether lengths are in units of the longer side of an image whose size is not stated, and the principal point is its distance from
    /// the image's middle.
    pub by_side: bool,
}

impl Lens {
    /// A lens without distortion, of focal lengths and principal point in pixels, for an image of any size.
    pub fn pinhole(focal: [f64; 2], center: [Option<f64>; 2]) -> Self {
        Self {
            size: None,
            focal_x: Focal::Pixels(focal[0]),
            focal_y: Some(Focal::Pixels(focal[1])),
            center,
            skew: 0.0,
            distortion: Distortion::NONE,
            resizable: false,
            by_side: false,
        }
    }

    /// From a row-major 4×4 calibration matrix K (up to scale) and the image size. `Err` is a clause that follows "K".
    pub fn from_matrix(k: &[f64; 16], size: [u32; 2]) -> Result<Self, String> {
        if let Some(i) = k.iter().position(|value| !(*value as f32).is_finite()) {
            return Err(format!("has a NaN or infinite value in row {}, column {}", i / 4 + 1, i % 4 + 1));
        }
        if k[10] == 0.0 {
            return Err("is singular: row 3, column 3 is 0".into());
        }
        let value = |row: usize, column: usize| k[4 * row + column] / k[10];
        if value(0, 0) == 0.0 || value(1, 1) == 0.0 {
            return Err(format!("is singular: its focal lengths are {} and {}", value(0, 0), value(1, 1)));
        }
        let off_form = [(1, 0), (2, 0), (2, 1), (0, 3), (1, 3), (2, 3)];
        if let Some((row, column)) = off_form.into_iter().find(|&(row, column)| value(row, column) != 0.0) {
            return Err(format!(
                "is not a calibration matrix: row {}, column {} is {}, not 0 (is it transposed?)",
                row + 1,
                column + 1,
                k[4 * row + column]
            ));
        }
        Ok(Self {
            size: Some(size),
            focal_x: Focal::Pixels(value(0, 0)),
            focal_y: Some(Focal::Pixels(value(1, 1))),
            center: [Some(value(0, 2)), Some(value(1, 2))],
            skew: value(0, 1),
            distortion: Distortion::NONE,
            resizable: false,
            by_side: false,
        })
    }

    /// The lens in pixels of an image of this size.
    pub fn measured(&self, size: [u32; 2]) -> Self {
        if !self.by_side {
            return *self;
        }
        let longer = f64::from(size[0].max(size[1]));
        let measured = |focal| match focal {
            Focal::Pixels(sides) => Focal::Pixels(sides * longer),
            Focal::Angle(angle) => Focal::Angle(angle),
        };
        let center = |k: usize| self.center[k].map(|sides| 0.5 * f64::from(size[k]) + sides * longer);
        Self {
            size: Some(size),
            focal_x: measured(self.focal_x),
            focal_y: self.focal_y.map(measured),
            center: [center(0), center(1)],
            skew: self.skew * longer,
            by_side: false,
            ..*self
        }
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

    /// The field of view in degrees that is left by undistortion, if it leaves out what the photograph shows.
    fn cropped_field(&self) -> Option<[f64; 2]> {
        if self.distortion == Distortion::NONE {
            return None;
        }
        let bent = self.camera(self.size?, Affine3A::IDENTITY, 0.5).ok()?;
        let way = Straightening::new(self.distortion, &bent).ok()?;
        way.is_cropped.then(|| way.field_degrees())
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
        self.distortion.check()?;
        let focal_x = focal_pixels(self.focal_x, width, size)?;
        let focal_y = self.focal_y.map_or(Ok(focal_x), |focal| focal_pixels(focal, height, size))?;
        let center = [
            self.center[0].unwrap_or(f64::from(width) / 2.0),
            self.center[1].unwrap_or(f64::from(height) / 2.0),
        ];
        let [sizes_x, sizes_y] = [0, 1].map(|k| center[k] / f64::from(size[k]) - 0.5);
        if !(sizes_x.abs() <= FARTHEST_CENTER && sizes_y.abs() <= FARTHEST_CENTER) {
            return Err(format!(
                "the principal point is ({}, {}) pixels, more than {FARTHEST_CENTER} image sizes from the image's middle",
                center[0], center[1]
            ));
        }
        if self.skew.is_nan() || self.skew.abs() > FARTHEST_CENTER * f64::from(width) {
            return Err(format!("the skew is {} pixels", self.skew));
        }
        let center = center.map(|c| c as f32);
        let focal = [focal_x as f32, focal_y as f32];
        let skew = self.skew as f32;
        Ok(Camera { width, height, focal, center, skew, world_from_camera, pixel_center })
    }
}

/// In pixels, of an axis of `extent` pixels.
fn focal_pixels(focal: Focal, extent: u32, size: [u32; 2]) -> Result<f64, String> {
    let pixels = match focal {
        Focal::Pixels(pixels) if pixels > 0.0 && pixels.is_finite() => pixels,
        Focal::Pixels(pixels) => {
            return Err(format!("a focal length is {pixels} pixels; it must be above 0"));
        }
        Focal::Angle(angle) if angle > 0.0 && angle < std::f64::consts::PI => {
            0.5 * f64::from(extent) / (0.5 * angle).tan()
        }
        Focal::Angle(angle) => {
            return Err(format!("a field of view is {angle} radians; it must lie between 0 and π"));
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

/// A note on photographs whose edges undistortion leaves out. Lenses without a stated size are not looked at.
pub(super) fn crop_note<'a>(lenses: impl Iterator<Item = &'a Lens>) -> Option<String> {
    let mut fields: Vec<[f64; 2]> = Vec::new();
    let mut last: Option<(&Lens, Option<[f64; 2]>)> = None;
    for lens in lenses {
        let field = match last {
            Some((same, field)) if same == lens => field,
            _ => lens.cropped_field(),
        };
        fields.extend(field);
        last = Some((lens, field));
    }
    let [width, height] = *fields.first()?;
    Some(format!(
        "{} photographs show more than a pinhole camera can; undistorted they are cropped to {width:.0}° × {height:.0}°",
        fields.len()
    ))
}
