//! The pinhole camera: rays, projection, and construction of cameras by position or orbit. Its axes
//! are OpenCV's (x right, y down, z forward); places in the image are in pixels.
//!
//! ```
//! use glam::Vec3;
//! use lobelia_geometry::view::Camera;
//!
//! let camera = Camera::look_at(Vec3::new(0.0, 1.0, 4.0), Vec3::ZERO, Vec3::Y, 40.0, 64, 48)?;
//! let ray = camera.ray(10.0, 20.0);
//! let seen = camera.project(ray.origin + 2.0 * ray.direction);
//! assert!(seen.is_some_and(|(x, y, _)| (x - 10.0).abs() < 1e-3 && (y - 20.0).abs() < 1e-3));
//! # Ok::<(), lobelia_geometry::Error>(())
//! ```

use crate::{Error, Result};
use bevy_ecs::prelude::Component;
use glam::{Affine3A, Mat3A, Vec3, Vec3A};
use lobelia_sg::{fibonacci::fibonacci_axes, ray::Ray};
use serde::{Deserialize, Serialize};

/// A pinhole camera.
#[derive(Component, Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Camera {
    /// Image width in pixels.
    pub width: u32,
    /// Image height in pixels.
    pub height: u32,
    /// Focal lengths in pixels.
    pub focal: [f32; 2],
    /// Principal point in pixels.
    pub center: [f32; 2],
    /// Skew in pixels (0 for nearly every camera).
    pub skew: f32,
    /// Rigid transform from OpenCV camera axes to world space.
    pub world_from_camera: Affine3A,
    /// Offset of a pixel's center from its index (0.5; PhySG's own code uses 0).
    pub pixel_center: f32,
}

/// Focal lengths that rays can be computed with, as factors on an image's side: of the shorter one
/// at least, of the longer one at most.
const FOCAL_FACTORS: [f32; 2] = [1e-5, 1e6];
/// Largest principal point and skew, as a factor on an image's longer side.
const MOST_SHIFT: f32 = 1e4;
/// Largest distance of a camera from the origin along an axis, in world units: squares stay finite.
const FARTHEST: f32 = 1e9;

/// A circle of cameras around a point, all looking at it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CameraOrbit {
    /// The point that all cameras look at, in world units.
    pub target: Vec3,
    /// Distance of every camera from `target`, in world units, above 0.
    pub radius: f32,
    /// Height of the circle in degrees above the target's horizon, in `[-90, 90]`.
    pub elevation_degrees: f32,
    /// Where the circle starts, in degrees: 0 is in front (+Z for +Y up, −Y for +Z up), 90 to its
    /// right.
    pub start_degrees: f32,
    /// Number of cameras, evenly spaced over the whole turn; at least 1.
    pub frames: u32,
    /// The world's up direction; need not have unit length.
    pub up: Vec3,
    /// Vertical field of view in degrees, in `(0, 180)`.
    pub vertical_fov_degrees: f32,
    /// Image width in pixels.
    pub width: u32,
    /// Image height in pixels.
    pub height: u32,
}

impl Default for CameraOrbit {
    fn default() -> Self {
        Self {
            target: Vec3::ZERO,
            radius: 2.8,
            elevation_degrees: 20.0,
            start_degrees: 0.0,
            frames: 60,
            up: Vec3::Y,
            vertical_fov_degrees: 38.0,
            width: 512,
            height: 512,
        }
    }
}

impl Camera {
    /// The world ray through image position (`x`, `y`) in pixels, where pixel (i, j) spans
    /// `[i, i + 1) × [j, j + 1)`.
    pub fn ray(&self, x: f32, y: f32) -> Ray {
        let shift = self.pixel_center - 0.5;
        let y_camera = (y + shift - self.center[1]) / self.focal[1];
        let x_camera = (x + shift - self.center[0] - self.skew * y_camera) / self.focal[0];
        let direction = self.world_from_camera.transform_vector3(Vec3::new(x_camera, y_camera, 1.0));
        Ray { origin: self.world_from_camera.translation.into(), direction: direction.normalize() }
    }

    /// The world ray through the center of pixel `y * width + x`.
    pub fn pixel_ray(&self, pixel: u32) -> Ray {
        self.ray((pixel % self.width) as f32 + 0.5, (pixel / self.width) as f32 + 0.5)
    }

    /// Projection of a world point: (x, y) in pixels, in the coordinates of [`Camera::ray`], and
    /// its depth along the camera's axis in world units. `None` if the point is not in front of the
    /// camera. The position may lie outside the image.
    pub fn project(&self, world: Vec3) -> Option<(f32, f32, f32)> {
        let offset = Vec3A::from(world) - self.world_from_camera.translation;
        // The transform is rigid, so its transpose is its inverse.
        let point = self.world_from_camera.matrix3.transpose() * offset;
        if point.z.is_nan() || point.z <= f32::MIN_POSITIVE {
            return None;
        }
        let shift = self.pixel_center - 0.5;
        let (x_camera, y_camera) = (point.x / point.z, point.y / point.z);
        let x = self.focal[0] * x_camera + self.skew * y_camera + self.center[0] - shift;
        let y = self.focal[1] * y_camera + self.center[1] - shift;
        Some((x, y, point.z))
    }

    /// Checks that rays through the camera can be computed.
    ///
    /// # Errors
    /// A clause that says which of its numbers is not usable: no pixels, a focal length that is not
    /// from 10⁻⁵ to 10⁶ times the image's side, a principal point or skew far outside the image, a
    /// place beyond 10⁹, anything that is not finite.
    pub fn check(&self) -> Result<(), String> {
        let (width, height) = (self.width, self.height);
        let [shorter, longer] = [width.min(height) as f32, width.max(height) as f32];
        if shorter == 0.0 {
            return Err(format!("its image has {width}×{height} pixels"));
        }
        let [least, most] = [FOCAL_FACTORS[0] * shorter, FOCAL_FACTORS[1] * longer];
        if let Some(focal) = self.focal.into_iter().find(|f| !(least..=most).contains(&f.abs())) {
            return Err(format!(
                "its focal length is {focal:e} pixels; for {width}×{height} pixels it is from {least:e} to {most:e}"
            ));
        }
        let [x, y] = self.center;
        let shifts = [x, y, self.skew, self.pixel_center];
        if !shifts.iter().all(|shift| shift.abs() <= MOST_SHIFT * longer) {
            return Err(format!(
                "its principal point ({x:e}, {y:e}) or skew {:e} is far outside {width}×{height} pixels",
                self.skew
            ));
        }
        let at = self.position();
        if !self.world_from_camera.is_finite() || at.abs().max_element() > FARTHEST {
            return Err(format!("its place ({:e}, {:e}, {:e}) or direction is not usable", at.x, at.y, at.z));
        }
        Ok(())
    }

    /// The position of the camera in the world.
    pub fn position(&self) -> Vec3 {
        self.world_from_camera.translation.into()
    }

    /// A camera at `eye` that looks at `target`, with square pixels, the principal point in the
    /// middle of the image and `up` pointing upward in it. `up` need not have unit length.
    ///
    /// # Errors
    /// [`Error::Usage`] if `eye` and `target` coincide, `up` points along the view, the field of
    /// view is not within (0, 180) degrees, the image is empty, or a number is not finite.
    pub fn look_at(
        eye: Vec3,
        target: Vec3,
        up: Vec3,
        vertical_fov_degrees: f32,
        width: u32,
        height: u32,
    ) -> Result<Self> {
        let forward = (target - eye).try_normalize().ok_or_else(|| {
            Error::usage(format!("a camera at {eye} cannot look at {target}"), "Move one of the two points.")
        })?;
        let right = up.try_normalize().map(|up| forward.cross(up)).filter(|right| right.length() > 1e-4);
        let right = right.ok_or_else(|| {
            let problem =
                format!("up = {up} does not determine the roll of a camera that looks along {forward}");
            Error::usage(problem, "Give an up direction of non-zero length that is not along the view.")
        })?;
        Self::from_axes(eye, forward, right.normalize(), vertical_fov_degrees, [width, height])
    }

    /// The cameras of an orbit, in order, counterclockwise seen from above.
    ///
    /// # Errors
    /// [`Error::Usage`] if a field is outside its range (see [`CameraOrbit`]).
    pub fn orbit(orbit: &CameraOrbit) -> Result<Vec<Self>> {
        let wrong = |problem: String, help: &str| Err(Error::usage(format!("an orbit with {problem}"), help));
        if !(orbit.radius > 0.0 && orbit.radius.is_finite()) {
            return wrong(format!("a radius of {}", orbit.radius), "Give a distance above 0.");
        }
        if !(-90.0..=90.0).contains(&orbit.elevation_degrees) {
            let problem = format!("an elevation of {} degrees", orbit.elevation_degrees);
            return wrong(problem, "Give an angle between -90 (from below) and 90 (from above).");
        }
        if orbit.frames == 0 {
            return wrong("no frames".into(), "Give `frames: 1` or more.");
        }
        let Some(up) = orbit.up.try_normalize() else {
            return wrong(format!("up = {}", orbit.up), "Give a direction of non-zero length.");
        };
        let front_hint = if up.z.abs() < 0.9 { Vec3::Z } else { Vec3::NEG_Y };
        let front = (front_hint - up * up.dot(front_hint)).normalize();
        let side = up.cross(front);
        let (sin_elevation, cos_elevation) = orbit.elevation_degrees.to_radians().sin_cos();
        let step = 360.0 / orbit.frames as f32;
        let camera = |frame: u32| {
            let (sin, cos) = (orbit.start_degrees + step * frame as f32).to_radians().sin_cos();
            let outward = cos_elevation * (cos * front + sin * side) + sin_elevation * up;
            // The tangent of the circle is the right axis of the camera, also directly above the
            // target.
            let right = cos * side - sin * front;
            let eye = orbit.target + orbit.radius * outward;
            Self::from_axes(eye, -outward, right, orbit.vertical_fov_degrees, [orbit.width, orbit.height])
        };
        (0..orbit.frames).map(camera).collect()
    }

    /// `count` cameras distributed uniformly over a sphere of this radius around the origin,
    /// looking at the origin; images are square.
    ///
    /// # Errors
    /// [`Error::Usage`] if a field is outside its range (see [`Self::look_at`]).
    pub fn around(count: usize, radius: f32, vertical_fov_degrees: f32, size: u32) -> Result<Vec<Self>> {
        let camera = |axis: Vec3| {
            let up = if axis.y.abs() > 0.99 { Vec3::Z } else { Vec3::Y };
            Self::look_at(axis * radius, Vec3::ZERO, up, vertical_fov_degrees, size, size)
        };
        fibonacci_axes(count).into_iter().map(camera).collect()
    }

    /// Returns the camera of an image that is `factor` times smaller along each axis; remaining
    /// pixels at the right and bottom edge are dropped. A `factor` of 0 counts as 1.
    pub fn scaled(&self, factor: u32) -> Self {
        let factor = factor.max(1);
        let scale = 1.0 / factor as f32;
        let shift = self.pixel_center - 0.5;
        let (focal, skew) = (self.focal.map(|f| f * scale), self.skew * scale);
        // Positions scale about the image's corner; `center` is counted from the `pixel_center` of
        // pixel 0.
        let center = self.center.map(|c| (c - shift) * scale + shift);
        Self { width: self.width / factor, height: self.height / factor, focal, center, skew, ..*self }
    }

    fn from_axes(eye: Vec3, forward: Vec3, right: Vec3, fov_degrees: f32, size: [u32; 2]) -> Result<Self> {
        let [width, height] = size;
        if !(fov_degrees > 0.0 && fov_degrees < 180.0) {
            let problem = format!("a vertical field of view of {fov_degrees} degrees");
            return Err(Error::usage(problem, "Give an angle between 0 and 180 degrees, e.g. 38."));
        }
        let down = forward.cross(right).normalize();
        let focal = 0.5 * height as f32 / (0.5 * fov_degrees.to_radians()).tan();
        let rotation = Mat3A::from_cols(right.into(), down.into(), forward.into());
        let world_from_camera = Affine3A { matrix3: rotation, translation: eye.into() };
        let (focal, center) = ([focal; 2], [0.5 * width as f32, 0.5 * height as f32]);
        let camera = Self { width, height, focal, center, skew: 0.0, world_from_camera, pixel_center: 0.5 };
        camera.check().map(|()| camera).map_err(|problem| {
            let problem = format!("a camera cannot be used: {problem}");
            Error::usage(problem, "Correct its image size, field of view and place.")
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Quat;
    use proptest::prelude::*;

    fn skewed(pixel_center: f32) -> Camera {
        Camera {
            width: 64,
            height: 48,
            focal: [90.0, 80.0],
            center: [30.5, 25.25],
            skew: 3.0,
            world_from_camera: Affine3A::from_rotation_translation(
                Quat::from_euler(glam::EulerRot::XYZ, 0.3, -1.1, 0.7),
                Vec3::new(0.4, -2.0, 1.5),
            ),
            pixel_center,
        }
    }

    proptest! {
        #[test]
        fn project_inverts_ray(x in 0.0f32..64.0, y in 0.0f32..48.0, t in 0.1f32..20.0, pixel_center in prop::sample::select(vec![0.0f32, 0.5])) {
            let camera = skewed(pixel_center);
            let ray = camera.ray(x, y);
            let (px, py, depth) = camera.project(ray.origin + t * ray.direction).unwrap();
            prop_assert!((px - x).abs() < 2e-3 && (py - y).abs() < 2e-3, "{px} {py} against {x} {y}");
            let axis: Vec3 = camera.world_from_camera.matrix3.z_axis.into();
            prop_assert!((depth - t * ray.direction.dot(axis)).abs() < 1e-4 * t.max(1.0));
        }

        #[test]
        fn scaled_cameras_see_the_same_ray(x in 0.0f32..64.0, y in 0.0f32..48.0, pixel_center in prop::sample::select(vec![0.0f32, 0.5])) {
            let camera = skewed(pixel_center);
            let (full, half) = (camera.ray(x, y), camera.scaled(4).ray(x / 4.0, y / 4.0));
            prop_assert!(full.direction.distance(half.direction) < 1e-5);
        }
    }

    #[test]
    fn known_points_are_projected_where_they_should() {
        let (a, b) = (skewed(0.5), skewed(0.0));
        assert!(a.ray(10.0, 20.0).direction.distance(b.ray(10.5, 20.5).direction) < 1e-6);
        let camera =
            Camera::look_at(Vec3::new(0.0, 0.0, 3.0), Vec3::ZERO, Vec3::Y * 7.0, 90.0, 20, 10).unwrap();
        for behind in [Vec3::new(0.0, 0.0, 4.0), camera.position(), Vec3::NAN] {
            assert_eq!(camera.project(behind), None);
        }
        let (x, y, depth) = camera.project(Vec3::ZERO).unwrap();
        assert!((x - 10.0).abs() < 1e-4 && (y - 5.0).abs() < 1e-4 && (depth - 3.0).abs() < 1e-5);
        let (_, top, _) = camera.project(Vec3::new(0.0, 3.0, 0.0)).unwrap();
        assert!(top.abs() < 1e-4, "45 degrees up is the top edge, got {top}");
        assert!(camera.project(Vec3::new(1.0, 0.0, 0.0)).unwrap().0 > 10.0);
    }

    #[test]
    fn impossible_cameras_are_usage_errors() {
        let at = |eye, up, fov, width| Camera::look_at(eye, Vec3::ZERO, up, fov, width, 8);
        for (eye, up, fov, width) in [
            (Vec3::ZERO, Vec3::Y, 40.0, 8),
            (Vec3::Y, Vec3::Y, 40.0, 8),
            (Vec3::X, Vec3::ZERO, 40.0, 8),
            (Vec3::NAN, Vec3::Y, 40.0, 8),
            (Vec3::X, Vec3::Y, 0.0, 8),
            (Vec3::X, Vec3::Y, f32::NAN, 8),
            (Vec3::X, Vec3::Y, 180.0, 8),
            (Vec3::X, Vec3::Y, 40.0, 0),
            (Vec3::X * 1e30, Vec3::Y, 40.0, 8),
        ] {
            assert!(at(eye, up, fov, width).is_err(), "{eye} {up} {fov} {width}");
        }
        assert!(at(Vec3::X, Vec3::Y, 1e-40, 8).unwrap_err().to_string().contains("focal length"));
        for wrong in [
            CameraOrbit { radius: 0.0, ..CameraOrbit::default() },
            CameraOrbit { radius: f32::INFINITY, ..CameraOrbit::default() },
            CameraOrbit { elevation_degrees: 91.0, ..CameraOrbit::default() },
            CameraOrbit { elevation_degrees: f32::NAN, ..CameraOrbit::default() },
            CameraOrbit { start_degrees: f32::NAN, ..CameraOrbit::default() },
            CameraOrbit { frames: 0, ..CameraOrbit::default() },
            CameraOrbit { up: Vec3::ZERO, ..CameraOrbit::default() },
            CameraOrbit { width: 0, ..CameraOrbit::default() },
        ] {
            let error = Camera::orbit(&wrong).unwrap_err();
            assert!(matches!(error, Error::Usage { .. }), "{error}");
        }
    }

    #[test]
    fn numbers_that_rays_cannot_be_computed_with_are_named() {
        let good = skewed(0.5);
        assert_eq!(good.check(), Ok(()));
        for focal in [1e-40, 1e30, 0.0, f32::NAN, f32::INFINITY] {
            for focal in [[focal, 80.0], [90.0, focal]] {
                assert!(Camera { focal, ..good }.check().unwrap_err().contains("focal length"));
            }
        }
        for far in [1e30, f32::NAN, f32::NEG_INFINITY] {
            assert!(Camera { center: [30.0, far], ..good }.check().unwrap_err().contains("principal point"));
            assert!(Camera { skew: far, ..good }.check().unwrap_err().contains("skew"));
            let mut moved = good;
            moved.world_from_camera.translation.y = far;
            assert!(moved.check().unwrap_err().contains("place"));
        }
        assert!(Camera { height: 0, ..good }.check().unwrap_err().contains("64×0"));
    }

    #[test]
    fn orbits_circle_the_target_from_the_front_to_the_right() {
        let orbit = CameraOrbit { frames: 4, radius: 2.0, ..CameraOrbit::default() };
        let target = Vec3::new(0.1, 0.2, 0.3);
        for up in [Vec3::Y, Vec3::Z, Vec3::new(1.0, 2.0, -0.5)] {
            for elevation_degrees in [-90.0, 0.0, 30.0, 90.0] {
                let cameras = Camera::orbit(&CameraOrbit { target, elevation_degrees, up, ..orbit }).unwrap();
                assert_eq!(cameras.len(), 4);
                for camera in cameras {
                    let (x, y, depth) = camera.project(target).unwrap();
                    assert!((x - 256.0).hypot(y - 256.0) < 0.02 && (depth - 2.0).abs() < 1e-4);
                    let height = (camera.position() - target).dot(up.normalize());
                    assert!((height - 2.0 * elevation_degrees.to_radians().sin()).abs() < 1e-4);
                    assert!((camera.world_from_camera.matrix3.determinant() - 1.0).abs() < 1e-5);
                    let image_up: Vec3 = (-camera.world_from_camera.matrix3.y_axis).into();
                    assert!(image_up.dot(up) > -1e-5);
                }
            }
        }
        let level = CameraOrbit { elevation_degrees: 0.0, ..orbit };
        let at = |up, i: usize| Camera::orbit(&CameraOrbit { up, ..level }).unwrap()[i].position();
        for (up, i, expected) in [(Vec3::Y, 0, Vec3::Z), (Vec3::Y, 1, Vec3::X), (Vec3::Z, 0, Vec3::NEG_Y)] {
            assert!(at(up, i).distance(2.0 * expected) < 1e-5, "{up} {i}");
        }
    }
}
