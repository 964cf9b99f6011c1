//! How a fit starts where nothing is said, found from the photographs: the frame that the light stands still in, and albedo and roughness of the
//! specular lobe. The initialization is tried with each, without shadows, on a part of a surface of many pixels. A frame that is far worse than another with a
//! shining and with a matte lobe is tried with no other.
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
/// Lobes that each frame is tried with: the scene's own and the first other. By default one shines and one is matte; each alone may hide the right frame.
const FIRST: usize = 2;
/// Error with these, relative to the least of all frames, above which a frame is tried with no other. The others lower the error of a frame by 6 % at most (`spot`,
/// `sphere`, `cheburashka`, `skull`, `head`).
const FAR: f32 = 1.4;
/// Standard deviation of the sine of the cameras' tilt from which a turntable differs from a camera's frame.
const TILTED: f32 = 0.03;

/// Albedo and roughness of the specular lobes that are tried: bright or a plain dielectric, glossy or matte. The first two differ most.
const LOBES: [(f32, f32); 4] = [(0.3, 0.4), (0.04, 0.8), (0.3, 0.2), (0.04, 0.4)];

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

/// The frames that were tried, and the mean absolute error of radiance in each, with the lobe that suits it best of those tried in it.
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

/// Tries each frame with the first lobes, and the others in the frames that are not far worse than another.
fn all_trials(
    world: &mut World,
    frames: &[LightFrame],
    specular: &[SpecularLobe],
    unknowns: Unknowns,
    form: ClosedForm,
) -> Result<Vec<Trial>> {
    let first = if frames.len() > 1 { specular.len().min(FIRST) } else { specular.len() };
    let mut trials = untried(frames, &specular[..first]);
    run_trials(world, &mut trials, unknowns, form)?;
    let mut more = untried(&near(frames, &trials), &specular[first..]);
    if !more.is_empty() {
        run_trials(world, &mut more, unknowns, form)?;
    }
    trials.extend(more);
    Ok(trials)
}

/// Each frame with each lobe.
fn untried(frames: &[LightFrame], specular: &[SpecularLobe]) -> Vec<Trial> {
    let pairs = frames.iter().flat_map(|frame| specular.iter().map(move |lobe| (*frame, *lobe)));
    pairs.map(|(frame, lobe)| Trial { frame, lobe, error: 0.0 }).collect()
}

/// The frames that are not far worse than another.
fn near(frames: &[LightFrame], trials: &[Trial]) -> Vec<LightFrame> {
    let least = |of: Option<LightFrame>| {
        let some = trials.iter().filter(|trial| of.is_none_or(|frame| trial.frame == frame));
        some.map(|trial| trial.error).fold(f32::INFINITY, f32::min)
    };
    let is_far = |frame: LightFrame| least(Some(frame)) > FAR * least(None);
    frames.iter().copied().filter(|frame| !is_far(*frame)).collect()
}

/// Finds the errors of trials, those of a frame one after another; several processes each take a share of them.
fn run_trials(world: &mut World, trials: &mut [Trial], unknowns: Unknowns, form: ClosedForm) -> Result<()> {
    let ranks = world.get_resource::<Ranks>().cloned();
    let (own, texels) = (lobes_of(world).1, recovered_albedo(world)?);
    let spread = unknowns.light && own.len() > MOST_TRIED;
    let lobes = if spread { LightLobe::even(MOST_TRIED) } else { own };
    // How the object lies in others is found by the frame and the light of the first.
    let first = placements_are_open(world).then_some(Placement(0));
    let mut try_all = |of_frame: &mut [Trial]| {
        let Trial { frame, lobe: specular, .. } = of_frame[0];
        world.insert_resource(OwnLightFrame(frame));
        let known = Known { form, specular, unknowns, object: None, in_part: true, placement: first };
        with_initialization(world, known, |problem| {
            for trial in of_frame {
                let (mut lobes, mut texels) = (lobes.clone(), texels.clone());
                problem.specular = trial.lobe;
                problem.alternate(&mut lobes, &mut texels)?;
                trial.error = problem.error(&lobes, &texels)?;
            }
            Ok(())
        })
    };
    let share = ranks.as_ref().map_or(0..trials.len(), |ranks| ranks.share(trials.len(), 1));
    for of_frame in trials[share].chunk_by_mut(|a, b| a.frame == b.frame) {
        match try_all(of_frame) {
            // All processes stop together, below.
            Err(Error::Interrupted) if ranks.is_some() => break,
            tried => tried?,
        }
    }
    ranks.map_or(Ok(()), |ranks| complete_errors(trials, &ranks))
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
    fn a_frame_is_far_only_if_no_lobe_makes_it_near() {
        let trial = |frame, error| Trial { frame, lobe: SpecularLobe::new(Vec3::ZERO, 1.0), error };
        let (world, camera) = (LightFrame::World, LightFrame::Camera);
        let of = |errors: [f32; 4]| {
            let [a, b, c, d] = errors;
            near(&[world, camera], &[trial(world, a), trial(world, b), trial(camera, c), trial(camera, d)])
        };
        assert_eq!(of([0.3, 0.1, 0.13, 0.5]), [world, camera]);
        assert_eq!(of([0.3, 0.1, 0.15, 0.5]), [world]);
        assert_eq!(of([0.3, f32::NAN, 0.15, 0.1]), [camera]);
        assert_eq!(of([f32::NAN; 4]), [world, camera]);
    }

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
