//! How a fit starts where nothing is said, found from the photographs: the frame that the light stands still in, and albedo and roughness of the
//! specular lobe. The initialization is tried with each, without shadows, on a part of a surface of many pixels.
//!
//! Albedo takes up what of the shading does not depend on the view. In the wrong frame the light on a surface point should change from view
//! to view, or should not, where the photographs show the opposite; that is an error that no albedo takes up. So is a lobe that shines where
//! the surface is matte, and it hides the other: each frame is judged by the lobe that suits it.

use super::placements::{camera_axes, placements_are_open};
use super::{Known, least_rough, lobes_of, with_initialization};
use crate::error::stop::check_interrupted;
use crate::error::{Error, Result};
use crate::fit::components::Unknowns;
use crate::light::LightLobe;
use crate::light::light_frame::{LightFrame, OwnLightFrame, turning_axis};
use crate::light::placement::Placements;
use crate::material::{BaseMaterial, SpecularLobe, recovered_albedo, recovered_materials};
use crate::math::shading::ClosedForm;
use crate::profile::stage;
use crate::ranks::Ranks;
use crate::view::Placement;
use bevy_ecs::prelude::{Resource, With, World};
use glam::{Mat3, Vec3};
use serde::{Deserialize, Serialize};

/// Fewest views that tell frames apart.
const LEAST_VIEWS: usize = 6;
/// Largest error relative to that of the usual frame for another to be chosen.
const BETTER: f32 = 0.9;
/// Standard deviation of the sine of the cameras' tilt from which a turntable differs from a camera's frame.
const TILTED: f32 = 0.03;

/// Albedo and roughness of the specular lobes that are tried: bright or a plain dielectric, glossy or matte.
const LOBES: [(f32, f32); 4] = [(0.3, 0.4), (0.3, 0.2), (0.04, 0.4), (0.04, 0.8)];

/// Most lobes of an unknown light with which frames and specular lobes are tried: frames differ by what no light explains, and a solve for many lobes
/// costs the square of their number.
const MOST_TRIED: usize = 128;

/// What is to be found.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Find {
    /// The frame in which the light stands still.
    pub frame: bool,
    /// Where the specular lobe starts.
    pub specular: bool,
}

/// The initialization with one frame and one lobe.
struct Trial {
    frame: LightFrame,
    lobe: SpecularLobe,
    /// Mean absolute error of radiance.
    error: f32,
}

/// The frames that were tried, and the mean absolute error of radiance in each, with the lobe that suits it best.
#[derive(Resource, Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct FramesTried(pub Vec<(LightFrame, f32)>);

/// Present if the background of the photographs says that the object turned, and not the camera.
#[derive(Resource, Clone, Copy, Debug)]
pub struct ObjectTurned;

/// Whether the light turns around the object from view to view, as far as is known: a place then has other colors in each photograph,
/// most of all where it is glossy, and a search for hollows takes the difference for one.
pub(crate) fn light_turns(world: &World) -> bool {
    let turns = |own: &OwnLightFrame| own.0 != LightFrame::World;
    world.contains_resource::<ObjectTurned>()
        || world.get_resource::<OwnLightFrame>().is_some_and(turns)
        || world.get_resource::<Placements>().is_some_and(|placements| placements.0.len() > 1)
}

/// Sets the resource [`OwnLightFrame`] to the frame in which an initialization explains the photographs best, and the only base material to
/// the lobe that suits it best, as far as they are to be found and unknown. The usual frame is kept unless another is clearly better: the
/// world's, or one that turns if the [`ObjectTurned`].
///
/// # Errors
/// If a pool is incomplete.
pub(crate) fn find_start(world: &mut World, find: Find, unknowns: Unknowns, form: ClosedForm) -> Result<()> {
    let lobes = lobes_to_try(world, unknowns);
    let find =
        Find { specular: find.specular && lobes.len() > 1 && recovered_materials(world).len() == 1, ..find };
    let own = world.get_resource::<OwnLightFrame>().map(|own| own.0).unwrap_or_default();
    let frames = if find.frame { candidates(world) } else { vec![own] };
    if frames.len() == 1 && !find.specular {
        world.insert_resource(OwnLightFrame(frames[0]));
        return Ok(());
    }
    let _finding = stage("start");
    let trials = all_trials(world, &frames, &lobes, unknowns, form)?;
    let suits = |frame: LightFrame| {
        let of_frame = trials.iter().filter(move |trial| trial.frame == frame);
        of_frame.min_by(|a, b| a.error.total_cmp(&b.error))
    };
    let tried: Vec<_> = frames.iter().filter_map(|frame| Some((*frame, suits(*frame)?.error))).collect();
    let frame = best(&tried, world.contains_resource::<ObjectTurned>());
    world.insert_resource(OwnLightFrame(frame));
    if let Some(trial) = suits(frame).filter(|_| find.specular) {
        let mut materials = world.query_filtered::<&mut SpecularLobe, With<BaseMaterial>>();
        materials.iter_mut(world).for_each(|mut lobe| *lobe = SpecularLobe { ndf: lobe.ndf, ..trial.lobe });
    }
    if frames.len() > 1 {
        world.insert_resource(FramesTried(tried));
    }
    Ok(())
}

/// The glossiest lobe that the surface has, and, if it is unknown, [`LOBES`] beside it.
fn lobes_to_try(world: &mut World, unknowns: Unknowns) -> Vec<SpecularLobe> {
    let own = least_rough(world);
    let mut lobes = vec![own];
    if unknowns.specular_albedo && unknowns.roughness {
        let other = |(albedo, roughness)| SpecularLobe { albedo: Vec3::splat(albedo), roughness, ..own };
        lobes.extend(LOBES.map(other).into_iter().filter(|other| *other != own));
    }
    lobes
}

fn all_trials(
    world: &mut World,
    frames: &[LightFrame],
    specular: &[SpecularLobe],
    unknowns: Unknowns,
    form: ClosedForm,
) -> Result<Vec<Trial>> {
    let ranks = world.get_resource::<Ranks>().cloned();
    let (own, texels) = (lobes_of(world).1, recovered_albedo(world)?);
    let spread = unknowns.light && own.len() > MOST_TRIED;
    let lobes = if spread { LightLobe::even(MOST_TRIED) } else { own };
    // How the object lies in others is found by the frame and the light of the first.
    let first = placements_are_open(world).then_some(Placement(0));
    let pairs = frames.iter().flat_map(|frame| specular.iter().map(move |lobe| (*frame, *lobe)));
    let mut trials: Vec<Trial> = pairs.map(|(frame, lobe)| Trial { frame, lobe, error: 0.0 }).collect();
    let mut try_one = |trial: &Trial| -> Result<f32> {
        world.insert_resource(OwnLightFrame(trial.frame));
        let (mut lobes, mut texels) = (lobes.clone(), texels.clone());
        let specular = trial.lobe;
        let known = Known { form, specular, unknowns, object: None, in_part: true, placement: first };
        with_initialization(world, known, |problem| {
            problem.alternate(&mut lobes, &mut texels)?;
            problem.error(&lobes, &texels)
        })
    };
    let share = ranks.as_ref().map_or(0..trials.len(), |ranks| ranks.share(trials.len(), 1));
    for trial in &mut trials[share] {
        match try_one(trial) {
            Ok(error) => trial.error = error,
            // All processes stop together, below.
            Err(Error::Interrupted) if ranks.is_some() => break,
            Err(error) => return Err(error),
        }
    }
    if let Some(ranks) = ranks {
        complete_errors(&mut trials, &ranks)?;
    }
    Ok(trials)
}

/// Exchanges the errors of trials, of which each process has its share; an error on all if one is to stop.
fn complete_errors(trials: &mut [Trial], ranks: &Ranks) -> Result<()> {
    let mut errors: Vec<f32> = trials.iter().map(|trial| trial.error).collect();
    ranks.complete(&mut errors, 1)?;
    trials.iter_mut().zip(errors).for_each(|(trial, error)| trial.error = error);
    check_interrupted()
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
    let turns = camera_axes(world, Placement(0));
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
