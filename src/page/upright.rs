//! Which way is up in the page.

use crate::page::PageCamera;
use glam::Vec3;

/// Least length of the mean of the cameras' upward directions for which they agree on one.
const AGREED: f32 = 0.3;
/// Cosine from which a direction is taken for an axis: 20°.
const NEAR_AXIS: f32 = 0.94;

/// The direction that is up in most photographs, or that of the scene if they do not agree: data sets have their own axes. It is an axis of
/// the world if one is near.
pub fn upright(cameras: &[PageCamera], scene_up: Vec3) -> Vec3 {
    let up = |camera: &PageCamera| Vec3::from(-camera.camera.world_from_camera.matrix3.y_axis);
    let mean = cameras.iter().map(up).sum::<Vec3>() / cameras.len().max(1) as f32;
    if mean.length() < AGREED {
        return scene_up;
    }
    let mean = mean.normalize();
    let axes = [Vec3::X, Vec3::Y, Vec3::Z].into_iter().flat_map(|axis| [axis, -axis]);
    axes.into_iter().find(|axis| axis.dot(mean) > NEAR_AXIS).unwrap_or(mean)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::view::{Camera, Split};

    fn looking_from(eye: Vec3, up: Vec3) -> PageCamera {
        let camera = Camera::look_at(eye, Vec3::ZERO, up, 40.0, 64, 64).unwrap();
        PageCamera { name: String::new(), split: Split::Test, camera, photograph: None }
    }

    #[test]
    fn the_photographs_say_what_is_up() {
        let ring = |up: Vec3, from: usize| -> Vec<PageCamera> {
            let eyes =
                (0..12).map(|i| f32::to_radians(30.0 * i as f32)).map(|t| Vec3::new(t.cos(), t.sin(), 0.6));
            eyes.skip(from).map(|eye| looking_from(eye, up)).collect()
        };
        assert_eq!(upright(&ring(Vec3::Z, 0), Vec3::Y), Vec3::Z);
        assert_eq!(upright(&ring(-Vec3::Z, 0), Vec3::Y), -Vec3::Z);
        assert_eq!(upright(&[], Vec3::Y), Vec3::Y);
        let both = [ring(Vec3::Z, 0), ring(-Vec3::Z, 0)].concat();
        assert_eq!(upright(&both, Vec3::Y), Vec3::Y);
    }
}
