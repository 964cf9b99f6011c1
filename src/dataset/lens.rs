//! Intrinsic parameters in camera files, and their conversion to a camera for an image of a known size.

use crate::dataset::distortion::Distortion;
use crate::view::Camera;
use glam::Affine3A;

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
        })
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
        let focal_x = focal_pixels(self.focal_x, width)?;
        let focal_y = self.focal_y.map_or(Ok(focal_x), |focal| focal_pixels(focal, height))?;
        let center = [
            self.center[0].unwrap_or(f64::from(width) / 2.0),
            self.center[1].unwrap_or(f64::from(height) / 2.0),
        ];
        let center = center.map(|c| c as f32);
        if !center.iter().all(|c| c.is_finite()) {
            return Err(format!("the principal point is {center:?}"));
        }
        let focal = [focal_x as f32, focal_y as f32];
        let skew = self.skew as f32;
        Ok(Camera { width, height, focal, center, skew, world_from_camera, pixel_center })
    }
}

fn focal_pixels(focal: Focal, extent: u32) -> Result<f64, String> {
    match focal {
        Focal::Pixels(pixels) if pixels as f32 > 0.0 && (pixels as f32).is_finite() => Ok(pixels),
        Focal::Pixels(pixels) => Err(format!("a focal length is {pixels} pixels; it must be above 0")),
        Focal::Angle(angle) if angle > 1e-6 && angle < std::f64::consts::PI - 1e-6 => {
            Ok(0.5 * f64::from(extent) / (0.5 * angle).tan())
        }
        Focal::Angle(angle) => {
            Err(format!("a field of view is {angle} radians; it must lie between 0 and π"))
        }
    }
}
