//! The frame in which a light stands still.
//!
//! A camera that goes around an object leaves the light where it is. Before a turntable the camera
//! stands still and the object turns: seen from the object, the light goes around with the camera.
//! Lobes keep their axes in the light's own frame, which is a rotation per view away from the
//! world: surface normals and view directions are rotated into it, and nothing else of shading
//! changes.

use bevy_ecs::prelude::{Component, Resource};
use glam::{Mat3, Quat, Vec3};
use serde::{Deserialize, Serialize};

/// The frame in which a light stands still: the world's, unless something else is said.
#[derive(Component, Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub enum LightFrame {
    /// The world: the object and the light do not move.
    #[default]
    World,
    /// The camera, with axes right, up and backward in the picture: lamps that move with it, or a
    /// turntable before one camera.
    Camera,
    /// The world turned about this axis so that the camera, which stands before a turntable at any
    /// height, is always on one side: `Turntable(0, 1, 0)`.
    Turntable(Vec3),
}

/// The frame of the scene's own light.
#[derive(Resource, Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct OwnLightFrame(pub LightFrame);

impl LightFrame {
    /// The rotation from the world into the light's frame for a view, given that from its camera's
    /// axes (right, down, forward) into the world.
    pub fn light_from_world(self, world_from_camera: Mat3) -> Mat3 {
        match self {
            Self::World => Mat3::IDENTITY,
            // Up and backward, so that a map of the light stands upright.
            Self::Camera => Mat3::from_diagonal(Vec3::new(1.0, -1.0, -1.0)) * world_from_camera.transpose(),
            Self::Turntable(axis) => {
                let axis = axis.normalize_or(Vec3::Y);
                let (side, front) = axis.any_orthonormal_pair();
                // The side of the picture that lies across the axis keeps its direction in a view
                // along the axis as well.
                let [x, y] = [world_from_camera.x_axis, world_from_camera.y_axis];
                let across = if x.dot(axis).abs() <= y.dot(axis).abs() { x } else { y };
                let angle = across.dot(side).atan2(across.dot(front));
                // The sense of rotation about the axis that brings a direction at a positive angle
                // back to `front`.
                let turn_back = -axis.dot(front.cross(side)).signum();
                Mat3::from_quat(Quat::from_axis_angle(axis, turn_back * angle))
            }
        }
    }

    /// The frame in words, as part of a sentence about the light.
    pub fn words(self) -> String {
        match self {
            Self::World => "stands still around the object".to_owned(),
            Self::Camera => "stands still before the camera, the object turns".to_owned(),
            Self::Turntable(Vec3 { x, y, z }) => {
                format!("goes around the object with the camera, about the axis ({x:.3}, {y:.3}, {z:.3})")
            }
        }
    }
}

/// Rotation from the axes of the camera of the picture that is rendered into the world.
#[derive(Resource, Clone, Copy, Debug, PartialEq)]
pub struct PictureRotation(pub Mat3);

/// The axis that a camera without roll turns about, relative to the object, from the views'
/// rotations (camera axes in the world): the direction across which all the cameras' right sides
/// lie. `None` if there is no such axis.
pub fn turning_axis(world_from_camera: &[Mat3]) -> Option<Vec3> {
    /// Largest mean squared cosine between the axis and the right sides.
    const LEVEL: f32 = 0.01;
    let count = world_from_camera.len().max(1) as f32;
    let outer =
        |r: &Mat3| Mat3::from_cols(r.x_axis * r.x_axis.x, r.x_axis * r.x_axis.y, r.x_axis * r.x_axis.z);
    let mean = world_from_camera.iter().map(outer).fold(Mat3::ZERO, |sum, m| sum + m) * (1.0 / count);
    // Its largest eigenvector is the smallest of `mean`, whose trace is 1.
    let rest = Mat3::IDENTITY - mean;
    let start = world_from_camera.iter().fold(Vec3::ZERO, |sum, r| sum - r.y_axis).try_normalize()?;
    let axis = (0..200).try_fold(start, |axis, _| (rest * axis).try_normalize())?;
    (axis.dot(mean * axis) < LEVEL).then_some(axis)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Camera axes at an azimuth and elevation around `up`, looking at the origin.
    fn camera(azimuth: f32, elevation: f32, up: Vec3) -> Mat3 {
        let (side, front) = up.any_orthonormal_pair();
        let out = (front * azimuth.cos() + side * azimuth.sin()) * elevation.cos() + up * elevation.sin();
        let right = up.cross(out).normalize();
        Mat3::from_cols(right, -out.cross(right), -out)
    }

    #[test]
    fn a_camera_sees_its_light_always_alike() {
        let lamp = Vec3::new(0.2, 0.9, 0.3).normalize();
        for azimuth in [0.0, 1.0, 4.0] {
            let view = camera(azimuth, 0.4, Vec3::Y);
            let world_from_light = LightFrame::Camera.light_from_world(view).transpose();
            let seen = view.transpose() * (world_from_light * lamp);
            assert!(seen.distance(Vec3::new(0.2, -0.9, -0.3).normalize()) < 1e-6);
        }
    }

    #[test]
    fn a_turntable_keeps_its_axis_and_the_camera_on_one_side() {
        let axis = Vec3::new(0.1, 0.9, -0.3).normalize();
        let seen = |azimuth: f32, elevation: f32| {
            let view = camera(azimuth, elevation, axis);
            let turn = LightFrame::Turntable(axis * 2.0).light_from_world(view);
            assert!((turn * axis).distance(axis) < 1e-6);
            let backward = turn * -view.z_axis;
            (backward - axis * axis.dot(backward)).normalize()
        };
        let first = seen(0.3, 0.2);
        for (azimuth, elevation) in [(1.0, 0.2), (2.5, 0.6), (4.0, -0.3), (6.0, 1.5)] {
            assert!(seen(azimuth, elevation).distance(first) < 1e-5);
        }
    }

    #[test]
    fn the_axis_of_a_turntable_is_found() {
        let up = Vec3::new(0.3, -0.5, 0.8).normalize();
        let views: Vec<Mat3> =
            (0..30).map(|i| camera(i as f32 * 0.4, if i < 15 { 0.2 } else { 0.7 }, up)).collect();
        assert!(turning_axis(&views).unwrap().distance(up) < 1e-3);
        let rolled: Vec<Mat3> =
            views.iter().enumerate().map(|(i, v)| *v * Mat3::from_rotation_z(i as f32)).collect();
        assert_eq!(turning_axis(&rolled), None);
    }
}
