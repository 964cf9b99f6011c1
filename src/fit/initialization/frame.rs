//! Which frame the light stands still in, found from the photographs: the initialization is tried in each, without shadows, on a part of a
//! surface of many pixels.
//!
//! Albedo takes up what of the shading does not depend on the view. In the wrong frame the light on a surface point should change from view
//! to view, or should not, where the photographs show the opposite; that is an error that no albedo takes up.

use super::{Known, least_rough, lobes_of, with_initialization};
use crate::error::Result;
use crate::fit::components::Unknowns;
use crate::light::frame::{LightFrame, OwnLightFrame, turning_axis};
use crate::material::recovered_albedo;
use crate::math::shading::ClosedForm;
use crate::view::{Camera, Photograph};
use bevy_ecs::prelude::{Resource, With, World};
use glam::{Mat3, Vec3};
use serde::{Deserialize, Serialize};

/// Fewest views that tell frames apart.
const LEAST_VIEWS: usize = 6;
/// Largest error relative to that of the usual frame for another to be chosen.
const BETTER: f32 = 0.9;
/// Standard deviation of the sine of the cameras' tilt from which a turntable differs from a camera's frame.
const TILTED: f32 = 0.03;

/// The frames that were tried, and the mean absolute error of radiance in each.
#[derive(Resource, Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct FramesTried(pub Vec<(LightFrame, f32)>);

/// Present if the background of the photographs says that the object turned, and not the camera.
#[derive(Resource, Clone, Copy, Debug)]
pub struct ObjectTurned;

/// Sets the resource [`OwnLightFrame`] to the frame in which an initialization explains the photographs best. The usual frame is kept unless
/// another is clearly better: the world's, or one that turns if the [`ObjectTurned`].
///
/// # Errors
/// If a pool is incomplete.
pub fn find_light_frame(world: &mut World, unknowns: Unknowns, form: ClosedForm) -> Result<()> {
    let candidates = candidates(world);
    let (specular, texels) = (least_rough(world), recovered_albedo(world)?);
    let lobes = lobes_of(world).1;
    let mut tried = Vec::new();
    for &frame in candidates.iter().filter(|_| candidates.len() > 1) {
        world.insert_resource(OwnLightFrame(frame));
        let (mut lobes, mut texels) = (lobes.clone(), texels.clone());
        let known = Known { form, specular, unknowns, object: None, in_part: true };
        let error = with_initialization(world, known, |problem| {
            problem.alternate(&mut lobes, &mut texels)?;
            problem.error(&lobes, &texels)
        })?;
        tried.push((frame, error));
    }
    let turned = world.contains_resource::<ObjectTurned>();
    world.insert_resource(OwnLightFrame(best(&tried, turned)));
    if !tried.is_empty() {
        world.insert_resource(FramesTried(tried));
    }
    Ok(())
}

/// The frame of least error; the usual one, unless another is clearly better.
fn best(tried: &[(LightFrame, f32)], object_turned: bool) -> LightFrame {
    let is_usual = |frame: LightFrame| (frame == LightFrame::World) != object_turned;
    let least = |usual: bool| {
        let some = tried.iter().filter(|(frame, _)| is_usual(*frame) == usual);
        some.min_by(|a, b| a.1.total_cmp(&b.1)).copied()
    };
    match (least(true), least(false)) {
        (Some((_, error)), Some((other, less))) if less < BETTER * error => other,
        (usual, other) => usual.or(other).map_or(LightFrame::World, |(frame, _)| frame),
    }
}

/// The frames that the views tell apart, the world's first.
fn candidates(world: &mut World) -> Vec<LightFrame> {
    let mut views = world.query_filtered::<&Camera, With<Photograph>>();
    let turns: Vec<Mat3> =
        views.iter(world).map(|camera| Mat3::from(camera.world_from_camera.matrix3)).collect();
    let mut frames = vec![LightFrame::World];
    if turns.len() < LEAST_VIEWS {
        return frames;
    }
    frames.push(LightFrame::Camera);
    if let Some(axis) = turning_axis(&turns).filter(|axis| tilts(&turns, *axis) > TILTED) {
        frames.push(LightFrame::Turntable(axis));
    }
    frames
}

/// Standard deviation over the views of the sine of the angle between the line of sight and the plane across `axis`.
fn tilts(world_from_camera: &[Mat3], axis: Vec3) -> f32 {
    let sines: Vec<f32> = world_from_camera.iter().map(|turn| turn.z_axis.dot(axis)).collect();
    let mean = sines.iter().sum::<f32>() / sines.len() as f32;
    (sines.iter().map(|sine| (sine - mean).powi(2)).sum::<f32>() / sines.len() as f32).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn another_frame_must_be_clearly_better() {
        let tried = |camera: f32| vec![(LightFrame::World, 0.1), (LightFrame::Camera, camera)];
        assert_eq!(best(&tried(0.095), false), LightFrame::World);
        assert_eq!(best(&tried(0.05), false), LightFrame::Camera);
        assert_eq!(best(&tried(0.105), true), LightFrame::Camera);
        assert_eq!(best(&tried(0.2), true), LightFrame::World);
        assert_eq!(best(&[], true), LightFrame::World);
    }
}
