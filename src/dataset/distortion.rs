//! Lens distortion: its model, its inverse, and undistortion of photographs.
//!
//! The model is OpenCV's, of which COLMAP's are special cases: a radial polynomial and tangential terms, on the image plane
//! at depth 1. A photograph is resampled to a pinhole camera of the same focal lengths, over the largest upright
//! rectangle that the photograph fills.

use crate::view::raster::{Tap, bilinear};
use crate::view::{Camera, Image, Mask};
use glam::{DMat2, DVec2};

/// Most Newton steps to invert the distortion; a few are enough where it is invertible.
const NEWTON_STEPS: usize = 40;
/// Samples along each edge of the photograph that determine the bounds of the undistorted one.
const EDGE_SAMPLES: u32 = 64;

/// OpenCV's coefficients.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Distortion {
    /// k₁, k₂, k₃ of 1 + k₁r² + k₂r⁴ + k₃r⁶.
    pub radial: [f64; 3],
    /// p₁, p₂.
    pub tangential: [f64; 2],
}

impl Distortion {
    pub const NONE: Self = Self { radial: [0.0; 3], tangential: [0.0; 2] };

    /// k₁, k₂, k₃ of 1 + k₁r² + k₂r⁴ + k₃r⁶, and OpenCV's p₁, p₂.
    pub fn brown_conrady(radial: [f64; 3], tangential: [f64; 2]) -> Self {
        Self { radial, tangential }
    }

    /// The image point of the ray through `p`.
    pub fn distort(&self, p: DVec2) -> DVec2 {
        let r2 = p.length_squared();
        let [k1, k2, k3] = self.radial;
        let [p1, p2] = self.tangential;
        let tangential = DVec2::new(
            2.0 * p1 * p.x * p.y + p2 * (r2 + 2.0 * p.x * p.x),
            p1 * (r2 + 2.0 * p.y * p.y) + 2.0 * p2 * p.x * p.y,
        );
        p * (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))) + tangential
    }

    fn jacobian(&self, p: DVec2) -> DMat2 {
        let r2 = p.length_squared();
        let [k1, k2, k3] = self.radial;
        let [p1, p2] = self.tangential;
        let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
        let slope = 2.0 * (k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3));
        let across = slope * p.x * p.y + 2.0 * (p1 * p.x + p2 * p.y);
        let xx = radial + slope * p.x * p.x + 2.0 * p1 * p.y + 6.0 * p2 * p.x;
        let yy = radial + slope * p.y * p.y + 6.0 * p1 * p.y + 2.0 * p2 * p.x;
        DMat2::from_cols(DVec2::new(xx, across), DVec2::new(across, yy))
    }

    /// The ray with image point `target`; `None` where the distortion is not invertible.
    pub fn undistort(&self, target: DVec2) -> Option<DVec2> {
        let mut p = target;
        for _ in 0..NEWTON_STEPS {
            let jacobian = self.jacobian(p);
            let sound = jacobian.determinant() > 1e-6 && p.is_finite();
            if !sound {
                return None;
            }
            let miss = self.distort(p) - target;
            if miss.length() < 1e-12 {
                return Some(p);
            }
            p -= jacobian.inverse() * miss;
        }
        ((self.distort(p) - target).length() < 1e-9).then_some(p)
    }
}

/// Resampling of a distorted photograph to an undistorted one.
pub(super) struct Straightening {
    distortion: Distortion,
    bent: Camera,
    /// The pinhole camera of the undistorted photograph.
    pub camera: Camera,
}

impl Straightening {
    /// The resampling for photographs of the camera `bent`. `Err` says what is wrong with the coefficients, as a clause.
    pub fn new(distortion: Distortion, bent: &Camera) -> Result<Self, String> {
        let [x, y] = straight_bounds(&distortion, bent).ok_or_else(|| {
            format!(
                "the lens distortion {:?}, {:?} folds the image over",
                distortion.radial, distortion.tangential
            )
        })?;
        let sides = [x, y].map(|[first, last]| (last - first + 1).max(0) as u32);
        if sides[0] < bent.width.div_ceil(4) || sides[1] < bent.height.div_ceil(4) {
            return Err(format!("the lens distortion leaves {}×{} pixels of the image", sides[0], sides[1]));
        }
        let [width, height] = sides;
        let center = [bent.center[0] - x[0] as f32, bent.center[1] - y[0] as f32];
        Ok(Self { distortion, bent: *bent, camera: Camera { width, height, center, ..*bent } })
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
            let p = self.distortion.distort(on_plane(straight, f64::from(x), f64::from(y)));
            let at = in_pixels(bent, p);
            bilinear(bent.width, bent.height, at.x as f32, at.y as f32)
        })
    }
}

/// The point on the image plane of pixel coordinates (x, y), which may be fractional.
fn on_plane(camera: &Camera, x: f64, y: f64) -> DVec2 {
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

/// First and last column, first and last row of the rectangle that the undistorted photograph fills, in pixels of the distorted
/// one. It extends beyond the frame where the distortion moves edges inward, by at most half the size.
fn straight_bounds(distortion: &Distortion, bent: &Camera) -> Option<[[i64; 2]; 2]> {
    let last = [f64::from(bent.width - 1), f64::from(bent.height - 1)];
    let mut low = DVec2::NEG_INFINITY;
    let mut high = DVec2::INFINITY;
    for i in 0..=EDGE_SAMPLES {
        let t = f64::from(i) / f64::from(EDGE_SAMPLES);
        let straight =
            |x: f64, y: f64| distortion.undistort(on_plane(bent, x, y)).map(|p| in_pixels(bent, p));
        low.x = low.x.max(straight(0.0, t * last[1])?.x);
        high.x = high.x.min(straight(last[0], t * last[1])?.x);
        low.y = low.y.max(straight(t * last[0], 0.0)?.y);
        high.y = high.y.min(straight(t * last[0], last[1])?.y);
    }
    let (low, high) = (low.to_array(), high.to_array());
    Some([0, 1].map(|k| {
        let spare = 0.5 * last[k];
        // Rounding must not remove the pixels of an edge that does not move.
        [(low[k].max(-spare) - 1e-3).ceil() as i64, (high[k].min(last[k] + spare) + 1e-3).floor() as i64]
    }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{Affine3A, Vec3};
    use proptest::prelude::*;

    const BENT: Distortion = Distortion { radial: [-0.12, 0.03, 0.0], tangential: [0.004, -0.003] };

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

    proptest! {
        #[test]
        fn undistorting_undoes(x in -0.7f64..0.7, y in -0.7f64..0.7) {
            let p = DVec2::new(x, y);
            let back = BENT.undistort(BENT.distort(p)).unwrap();
            prop_assert!(back.distance(p) < 1e-9, "{back} {p}");
            let h = 1e-6;
            let slope = (BENT.distort(p + DVec2::new(h, 0.0)) - BENT.distort(p - DVec2::new(h, 0.0))) / (2.0 * h);
            prop_assert!(slope.distance(BENT.jacobian(p).x_axis) < 1e-8);
            let slope = (BENT.distort(p + DVec2::new(0.0, h)) - BENT.distort(p - DVec2::new(0.0, h))) / (2.0 * h);
            prop_assert!(slope.distance(BENT.jacobian(p).y_axis) < 1e-8);
        }
    }

    /// A smooth picture over the image plane.
    fn picture(p: DVec2) -> f32 {
        (0.5 + 0.3 * (6.0 * p.x).sin() * (5.0 * p.y).cos()) as f32
    }

    #[test]
    fn a_bent_photograph_becomes_what_the_pinhole_sees() {
        for k1 in [-0.12, 0.15] {
            let bent = camera();
            let distortion = Distortion { radial: [k1, 0.03, 0.0], ..BENT };
            let pixels = (0..80 * 60).map(|i| {
                let p = distortion.undistort(on_plane(&bent, f64::from(i % 80), f64::from(i / 80)));
                Vec3::splat(picture(p.unwrap()))
            });
            let photograph = Image { width: 80, height: 60, pixels: pixels.collect() };
            let way = Straightening::new(distortion, &bent).unwrap();
            let straight = way.image(&photograph);
            assert_eq!(k1 < 0.0, straight.width > 80, "barrels grow, pincushions shrink: {}", straight.width);
            for (i, pixel) in straight.pixels.iter().enumerate() {
                let (x, y) = (i as u32 % straight.width, i as u32 / straight.width);
                let direction = way.camera.ray(x as f32 + 0.5, y as f32 + 0.5).direction.as_dvec3();
                let expected = picture(direction.truncate() / direction.z);
                assert!((pixel.x - expected).abs() < 3e-3, "({x}, {y}): {} {expected}", pixel.x);
            }
        }
    }

    #[test]
    fn no_distortion_changes_nothing() {
        let way = Straightening::new(Distortion::NONE, &camera()).unwrap();
        assert_eq!(way.camera, camera());
        let flags: Vec<bool> = (0..80 * 60).map(|i| i % 7 == 0).collect();
        assert_eq!(way.flags(&flags), flags);
    }

    #[test]
    fn folding_coefficients_are_refused() {
        let wrong = |radial| {
            let distortion = Distortion { radial, tangential: [0.0; 2] };
            Straightening::new(distortion, &camera()).map(|way| way.camera).unwrap_err()
        };
        assert!(wrong([-3.0, 0.0, 0.0]).contains("folds"));
        assert!(wrong([f64::NAN, 0.0, 0.0]).contains("folds"));
        assert!(wrong([400.0, 0.0, 0.0]).contains("leaves"));
    }
}
