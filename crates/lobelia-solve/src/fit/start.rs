//! How a fit starts where nothing is said, found from the photographs: the frame that the light
//! stands still in, and albedo and roughness of the specular lobe. The initialization is tried with
//! each, without shadows, on a part of a surface of many pixels.
//!
//! Albedo takes up what of the shading does not depend on the view. In the wrong frame the light on
//! a surface point should change from view to view, or should not, where the photographs show the
//! opposite; that is an error that no albedo takes up. So is a lobe that shines where the surface
//! is matte, and it hides the other: each frame is judged by the lobe that suits it.

use crate::fit::components::Unknowns;
use crate::fit::initialization::{Known, least_rough, with_initialization};
use crate::fit::placements::{camera_axes, placements_are_open};
use bevy_ecs::prelude::{Resource, With, World};
use glam::Vec3;
use lobelia_geometry::{Result, error::stop::check_interrupted, view::Placement};
use lobelia_sg::shading::ClosedForm;
use lobelia_world::light::light_frame::{LightFrame, OwnLightFrame, turning_axis};
use lobelia_world::light::{LightLobe, lights::own_lobes, placement::Placements};
use lobelia_world::material::{BaseMaterial, SpecularLobe, recovered_albedo, recovered_materials};
use serde::{Deserialize, Serialize};
use tracing::info_span;

/// Fewest views that tell frames apart.
const LEAST_VIEWS: usize = 6;
/// Largest error relative to that of the usual frame for another to be chosen.
const BETTER: f32 = 0.9;
/// Error relative to the least up to which a glossier lobe is taken: a fit that starts with a matte
/// one finds no highlights, because its light has none to show.
const ALIKE: f32 = 1.02;
/// Standard deviation of the sine of the cameras' tilt from which a turntable differs from a
/// camera's frame.
const TILTED: f32 = 0.03;

/// Albedo and roughness of the specular lobes that are tried: bright or a plain dielectric, glossy
/// or matte.
const LOBES: [(f32, f32); 4] = [(0.3, 0.4), (0.04, 0.8), (0.3, 0.2), (0.04, 0.4)];

/// Most lobes of an unknown light with which frames and specular lobes are tried: frames differ by
/// what no light explains, and a solve for many lobes costs the square of their number.
const MOST_TRIED: usize = 128;

/// The frames that were tried, and the mean absolute error of radiance in each, with the lobe of
/// those tried that suits it.
#[derive(Resource, Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct FramesTried(pub Vec<(LightFrame, f32)>);

/// Present if the background of the photographs says that the object turned, and not the camera.
#[derive(Resource, Clone, Copy, Debug)]
pub struct ObjectTurned;

/// Whether the light turns around the object from view to view, as far as is known: a place then
/// has other colors in each photograph, most of all where it is glossy, and a search for hollows
/// takes the difference for one.
pub(crate) fn light_turns(world: &World) -> bool {
    let turns = |own: &OwnLightFrame| own.0 != LightFrame::World;
    world.contains_resource::<ObjectTurned>()
        || world.get_resource::<OwnLightFrame>().is_some_and(turns)
        || world.get_resource::<Placements>().is_some_and(|placements| placements.0.len() > 1)
}

/// Sets the resource [`OwnLightFrame`] to the frame in which an initialization explains the
/// photographs best, if `frame` is to be found, and the only base material to the `specular` lobe
/// that suits it, the glossiest of those that are about as good, if that is, and unknown. The usual frame is kept unless another is clearly
/// better: the world's, or one that turns if the [`ObjectTurned`].
pub(crate) fn find_start(
    world: &mut World,
    frame: bool,
    specular: bool,
    unknowns: Unknowns,
    form: ClosedForm,
) -> Result<()> {
    // The glossiest lobe that the surface has, and, if it is unknown, others beside it.
    let own = least_rough(world);
    let mut lobes = vec![own];
    if unknowns.specular_albedo && unknowns.roughness {
        let other = |(albedo, roughness)| SpecularLobe { albedo: Vec3::splat(albedo), roughness, ..own };
        lobes.extend(LOBES.map(other).into_iter().filter(|other| *other != own));
    }
    let specular = specular && lobes.len() > 1 && recovered_materials(world).len() == 1;
    let own = world.get_resource::<OwnLightFrame>().map(|own| own.0).unwrap_or_default();
    let frames = if frame { candidates(world) } else { vec![own] };
    if frames.len() == 1 && !specular {
        world.insert_resource(OwnLightFrame(frames[0]));
        return Ok(());
    }
    let _finding = info_span!("start").entered();
    let errors = errors(world, &frames, &lobes, unknowns, form)?;
    let suits: Vec<usize> = errors.iter().map(|errors| glossiest(&lobes, errors)).collect();
    let tried: Vec<_> = (0..frames.len()).map(|at| (frames[at], errors[at][suits[at]])).collect();
    let frame = best(&tried, world.contains_resource::<ObjectTurned>());
    world.insert_resource(OwnLightFrame(frame));
    if let Some(at) = frames.iter().position(|other| *other == frame).filter(|_| specular) {
        let mut materials = world.query_filtered::<&mut SpecularLobe, With<BaseMaterial>>();
        let suited = lobes[suits[at]];
        materials.iter_mut(world).for_each(|mut lobe| *lobe = SpecularLobe { ndf: lobe.ndf, ..suited });
    }
    if frames.len() > 1 {
        world.insert_resource(FramesTried(tried));
    }
    Ok(())
}

/// Mean absolute errors of radiance of the initialization in each frame, with each lobe.
fn errors(
    world: &mut World,
    frames: &[LightFrame],
    specular: &[SpecularLobe],
    unknowns: Unknowns,
    form: ClosedForm,
) -> Result<Vec<Vec<f32>>> {
    let (own, texels) = (own_lobes(world), recovered_albedo(world)?);
    let spread = unknowns.light && own.len() > MOST_TRIED;
    let lobes = if spread { LightLobe::even(MOST_TRIED) } else { own };
    // How the object lies in others is found by the frame and the light of the first.
    let placement = placements_are_open(world).then_some(Placement(0));
    let mut errors = vec![Vec::new(); frames.len()];
    for (frame, errors) in frames.iter().zip(&mut errors) {
        world.insert_resource(OwnLightFrame(*frame));
        let known = Known { form, specular: specular[0], unknowns, object: None, in_part: true, placement };
        with_initialization(world, known, |problems| {
            let problem = &mut problems[0];
            for lobe in specular {
                let (mut lobes, mut texels) = (lobes.clone(), texels.clone());
                problem.known.specular = *lobe;
                problem.alternate(&mut lobes, &mut texels)?;
                errors.push(problem.error(&lobes, &texels)?);
            }
            Ok(())
        })?;
    }
    check_interrupted()?;
    Ok(errors)
}

/// The glossiest lobe of those whose errors are about the least.
fn glossiest(lobes: &[SpecularLobe], errors: &[f32]) -> usize {
    let least = errors.iter().copied().fold(f32::INFINITY, f32::min);
    let alike = (0..errors.len()).filter(|i| errors[*i] <= ALIKE * least);
    let glossier = |a: &usize, b: &usize| {
        let by_error = errors[*a].total_cmp(&errors[*b]);
        lobes[*a].roughness.total_cmp(&lobes[*b].roughness).then(by_error)
    };
    alike.min_by(glossier).unwrap_or(0)
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
    // Standard deviation over the views of the sine of the angle between the line of sight and the
    // plane across the axis.
    let tilts = |axis: Vec3| {
        let sines: Vec<f32> = turns.iter().map(|turn| turn.z_axis.dot(axis)).collect();
        let mean = sines.iter().sum::<f32>() / sines.len() as f32;
        (sines.iter().map(|sine| (sine - mean).powi(2)).sum::<f32>() / sines.len() as f32).sqrt()
    };
    if let Some(axis) = turning_axis(&turns).filter(|axis| tilts(*axis) > TILTED) {
        frames.push(LightFrame::Turntable(axis));
    }
    frames
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_lobes_that_fit_alike_the_glossiest_is_taken() {
        let lobes = [0.4, 0.8, 0.2, 0.4].map(|roughness| SpecularLobe::new(Vec3::splat(0.04), roughness));
        assert_eq!(glossiest(&lobes, &[0.3, 0.1, 0.2, 0.101]), 3);
        assert_eq!(glossiest(&lobes, &[0.3, 0.1, f32::NAN, 0.11]), 1);
        assert_eq!(glossiest(&lobes, &[f32::NAN; 4]), 0);
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
