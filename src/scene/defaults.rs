//! Defaults that several fields of a scene file share.

use glam::Vec3;

pub(super) fn y_axis() -> Vec3 {
    Vec3::Y
}

pub(super) fn fov_degrees() -> f32 {
    38.0
}
