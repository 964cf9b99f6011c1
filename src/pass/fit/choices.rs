//! The choices that a `Fit` makes on its way: whether the surface has one base material or several, where
//! the scene leaves that to the photographs ([`Gloss::Auto`]), and whether one base material has spherical
//! Gaussians or GGX as its distribution of microfacet normals ([`NdfChoice::Auto`]). Measured in
//! `docs/research/fit.md`.
//!
//! A pixel's error is measured before a step moves anything, and of two hundred photographs or of large
//! ones most pixels are visited for the first time in the steps of a trial: both materials are judged by
//! what they have not been fitted to. A trial that is hopeless ends early, and the fit goes on with
//! what was tried only if its error is clearly less; else it goes on as if nothing had been tried.
//!
//! *Several materials.* The fit begins with one. If that explains the photographs badly after the first of
//! [`TRIED`] steps, two are tried, a dielectric and one that may be metal
//! ([`metal`](lobelia_solve::fit::metal)), for as many steps over the same pixels; light and albedo then
//! begin from an initialization as far as they are unknown, because what one material made of them is
//! wrong. After a `Shape` one material begins with a light and an albedo that were fitted with it, and
//! several begin anew. So where several are better after a hundred steps, but not clearly, the fit goes on
//! with one, and several are tried again for more steps: a copper kettle with a black handle has 0.97 of
//! the error after 100 steps and 0.67 after 300, a chair 0.97 and 0.98.
//!
//! *GGX.* After [`NDF_TRIED`] steps with the spherical Gaussian the fit takes as many with GGX in its place,
//! which goes on from the same light and albedo; then it goes back and takes the same steps as it is. Where
//! cameras or vertices are fitted too, they move in the second half of the comparison only.

use crate::pass::fit::steps::{
    Ended, Steps, Tried, begin_log, error_after, forget_shadows, options, take_steps,
};
use crate::pass::run::{resume::keep, resume::resume_part, session::Chosen, session::Session};
use crate::report::scores::{MaterialsTried, NdfTried, given_up_words};
use crate::scene::{Albedo, FitPass, Gloss, Light, NdfChoice, SpecularAlbedo, uses_published};
use crate::{pass::show::apply_edits, spawn::initial_lobes, spawn::several_materials};
use bevy_ecs::prelude::{Entity, With, World};
use glam::Vec3;
use lobelia_geometry::error::{Error, Result, stop::finish_stopping, stop::is_stopping};
use lobelia_sg::brdf::Ndf;
use lobelia_solve::fit::run::{Done, FitOptions, FitSummary, Initialize};
use lobelia_world::light::{LightLobe, groups::FittedLobe, light_frame::OwnLightFrame};
use lobelia_world::material::{
    BaseMaterial, SpecularBlend, SpecularLobe, TexelIndex, first_material, recovered_materials,
    replace_materials, sheen::write_albedo, shown::recovered_material,
};
use lobelia_world::{checkpoint, checkpoint::Span};
use std::time::Instant;
use tracing::info_span;

/// Steps with one material before a choice, and with several for it; the second choice is made only if the first was close.
const TRIED: [u32; 2] = [100, 300];
/// A choice is made only in a fit of at least this many times the steps before it.
const LEAST_STEPS: u32 = 3;
/// PSNR of linear radiance, in dB, from which one material is enough.
const EXPLAINED: f64 = 32.0;
/// Error of several relative to that of one below which they are chosen.
const CLEARLY: f64 = 0.9;
/// [`CLEARLY`] for a surface whose normals were found from reflections: it is polished at least in
/// parts. `head` at half size has 0.906 there, and 0.5 dB more with two in the end.
const CLEARLY_POLISHED: f64 = 0.95;
/// Steps of the first trial after which it ends if its error is so many times that of one. Several begin anew: where they are better in the end, their error first
/// rises to 1.3 times that of one; where they are worse, to 1.8 (a sphere) or 3.3 times (`cheburashka`).
const HOPELESS: (u32, f64) = (20, 2.2);

/// Steps before the trial, and of the trial.
const NDF_TRIED: u32 = 100;
/// A choice is made only in a fit of at least this many steps: vertices begin to move after a quarter of them.
const NDF_LEAST_STEPS: u32 = 800;
/// PSNR of linear radiance, in dB, from which nothing is tried: there is little left to explain.
const NDF_EXPLAINED: f64 = 40.0;
/// Steps of the trial after which it ends if its error is so many times that of the spherical Gaussian before it. After 20 steps it is 1.3 times that on spheres of
/// GGX, and after 50 steps 0.8 times; on `cheburashka`, which has none, 1.4 and 1.3 times, and on `spot` 2.2 times after 20.
const NDF_HOPELESS: [(u32, f64); 2] = [(20, 1.6), (50, 1.15)];
/// Error with GGX relative to that of the spherical Gaussian below which it is chosen.
const NDF_CLEARLY: f64 = 0.975;

/// Settings and results of the steps so far.
type Taken = (FitSummary, FitOptions);

/// Takes the steps of a fit, and chooses on the way if that is open. Also returns its final settings.
pub(super) fn take_steps_and_choose(session: &mut Session, pass: &FitPass) -> Result<Taken> {
    if !resume_part(session)? {
        let is_open = is_open(session, pass)? || ndf_is_open(session, pass);
        session.kept.chosen = Chosen { asked_after: is_open.then_some(TRIED[0]), ..Chosen::default() };
    }
    let mut before = None;
    loop {
        match (take_steps_to_pause(session, pass, &mut before), before.clone()) {
            (Err(Error::Interrupted), Some((summary, options))) => {
                // What was found until then is written.
                finish_stopping();
                return Ok((FitSummary { stopped: true, ..summary }, options));
            }
            (taken, before) => {
                if let (true, Some(taken)) = (taken?, before) {
                    return Ok(taken);
                }
            }
        }
        session.kept.initialize = Initialize::NONE;
        keep(session, None)?;
    }
}

/// Takes the steps until the next pause, with a choice if the photographs are explained badly where that is asked; what they
/// have come to goes to `before`. Returns whether they were the last.
fn take_steps_to_pause(session: &mut Session, pass: &FitPass, before: &mut Option<Taken>) -> Result<bool> {
    let options = options(session, pass, session.kept.chosen.done)?;
    if let Some(summary) = session.kept.chosen.finished {
        *before = Some((summary, options));
        return Ok(true);
    }
    // The PSNR from which there is nothing to ask.
    let enough = match decided_after(session) {
        Some(_) => f64::INFINITY,
        None if ndf_is_open(session, pass) => NDF_EXPLAINED,
        None => EXPLAINED,
    };
    let asked = session.kept.chosen.asked_after.map(|step| (step, enough));
    let taken = take_steps(session, pass, &options, asked)?;
    let FitSummary { steps, elapsed_secs: secs, stopped, .. } = taken.summary;
    *before = Some((taken.summary, options.clone()));
    match taken.ended {
        Ended::Done if pass.detail && options.unknowns.albedo && !stopped => {
            session.kept.chosen.finished = Some(taken.summary);
            keep(session, None)?;
        }
        Ended::Done => {}
        Ended::Paused => session.kept.chosen.done = Done { steps, secs, is_pause: true },
        Ended::Doubted => answer(session, pass, &options, &taken)?,
    }
    Ok(taken.ended == Ended::Done)
}

/// Makes the choices that are due after these steps.
fn answer(session: &mut Session, pass: &FitPass, options: &FitOptions, first: &Steps) -> Result<()> {
    let start = Instant::now();
    if decided_after(session).is_some() {
        decide(session, pass, first);
    } else {
        let is_again = session.kept.chosen.again_after.take().is_some();
        if first.psnr < EXPLAINED && (is_again || is_open(session, pass)?) {
            choose(session, pass, options, first)?;
        }
        if ndf_is_open(session, pass) {
            try_ggx(session, pass, first)?;
        }
    }
    let secs = first.summary.elapsed_secs + start.elapsed().as_secs_f64();
    session.kept.chosen.done = Done { steps: first.summary.steps, secs, is_pause: false };
    session.kept.chosen.asked_after = decided_after(session).or(session.kept.chosen.again_after);
    forget_shadows(&mut session.pipeline.world);
    Ok(())
}

/// The steps after which several materials are tried again in a fit of `steps`; `None` if one was as good, or if too few steps would be left.
fn asked_again(tried: MaterialsTried, steps: u32) -> Option<u32> {
    let next = TRIED.into_iter().find(|&next| next > tried.steps);
    next.filter(|next| tried.several < tried.one && steps >= LEAST_STEPS * next)
}

/// Whether the photographs decide about gloss in this fit.
fn is_open(session: &mut Session, pass: &FitPass) -> Result<bool> {
    let scene = session.scene;
    let material = &scene.material;
    let gray = matches!(material.specular.albedo, SpecularAlbedo::Unknown { mono: true, .. });
    let unsaid = material.gloss == Gloss::Auto && material.specular.is_open() && gray;
    let untried = session.scores.materials_tried.is_none() && scene.own_material().is_none();
    let enough = pass.steps >= LEAST_STEPS * TRIED[0] && session.unknowns().albedo;
    Ok(unsaid && untried && enough && !uses_published(scene) && has_room(session)?)
}

/// Whether the edits of all passes have room for what they make of several base materials.
fn has_room(session: &mut Session) -> Result<bool> {
    let mut unedited = recovered_material(&mut session.pipeline.world)?;
    let (lobes, blend) = several_materials();
    unedited.lobes = lobes.into_iter().map(Some).collect();
    unedited.blends.fill(blend);
    let mut edits = session.scene.passes.iter().map(|pass| pass.edits()).filter(|edits| !edits.is_empty());
    Ok(edits.all(|edits| apply_edits(&mut unedited.clone(), edits, &session.surface).is_ok()))
}

/// Tries several materials and keeps what explains more.
fn choose(session: &mut Session, pass: &FitPass, options: &FitOptions, first: &Steps) -> Result<()> {
    let start = Instant::now();
    let world = &mut session.pipeline.world;
    let lobes: Vec<_> = recovered_materials(world).into_iter().map(|(_, lobe)| lobe).collect();
    let saved = checkpoint::save(world, Span::Pass)?;
    let tried = try_several(session, pass, options, first);
    let found = tried.as_ref().ok().copied().filter(|_| !is_stopping());
    let enough = if session.kept.placed.normals { CLEARLY_POLISHED } else { CLEARLY };
    session.kept.several =
        found.is_some_and(|(error, ended)| ended.is_none() && error < enough * first.error);
    if session.kept.several {
        begin_log(&mut session.pipeline.world);
    } else {
        replace_materials(&mut session.pipeline.world, &lobes, SpecularBlend::default())?;
        checkpoint::load(&mut session.pipeline.world, &saved)?;
    }
    tried?;
    let Some((several, given_up)) = found else { return Err(Error::Interrupted) };
    let steps = first.summary.steps;
    let seconds = start.elapsed().as_secs_f64();
    let tried = MaterialsTried { one: first.error, several, steps, given_up, seconds };
    let again =
        if session.kept.several || given_up.is_some() { None } else { asked_again(tried, pass.steps) };
    session.kept.chosen.again_after = again;
    let chosen = match (session.kept.several, again) {
        (true, _) => "several base materials are chosen".to_owned(),
        (false, None) => "one base material is chosen".to_owned(),
        (false, Some(steps)) => format!("one base material is kept until step {steps}"),
    };
    session.progress.print(&format!(
        "{}: {chosen}: error {several:.4} with several{}, {:.4} with one, after {steps} steps",
        pass.name,
        given_up_words(given_up),
        first.error
    ));
    session.scores.materials_tried = Some(tried);
    Ok(())
}

/// The error of several materials after the same steps, or those after which it was given up, for it was [`HOPELESS`] beside that of `one`.
fn try_several(session: &mut Session, pass: &FitPass, before: &FitOptions, one: &Steps) -> Result<Tried> {
    let _trying = info_span!("several materials tried").entered();
    let scene = session.scene;
    let world = &mut session.pipeline.world;
    let (lobes, blend) = several_materials();
    replace_materials(world, &lobes, blend)?;
    let initialize = Initialize {
        light: matches!(scene.light, Light::Unknown(_)),
        albedo: matches!(scene.material.albedo, Albedo::Unknown),
        specular: false,
    };
    if initialize.light {
        // All lights begin alike.
        let first = initial_lobes(&scene.light, None);
        let mut query = world.query_filtered::<(Entity, &mut LightLobe), FittedLobe>();
        let mut lobes: Vec<_> = query.iter_mut(world).collect();
        lobes.sort_by_key(|(entity, _)| *entity);
        lobes.into_iter().zip(first.iter().cycle()).for_each(|((_, mut lobe), first)| *lobe = *first);
    }
    if initialize.albedo {
        let texels = world.query::<&TexelIndex>().iter(world).len();
        write_albedo(world, vec![Vec3::splat(0.4); texels])?;
    }
    let light_frame = world.get_resource::<OwnLightFrame>().map(|own| own.0);
    session.kept.several = true;
    let unknowns = session.unknowns();
    // Shadows of geometry that has moved are traced again first.
    let visibility = before.visibility && session.has_visibility()?;
    let done = Done::default();
    let options = FitOptions { done, unknowns, initialize, visibility, light_frame, ..before.clone() };
    let steps = one.summary.steps;
    let (from, most) = HOPELESS;
    let hopeless = |step, error| steps == TRIED[0] && step >= from && error > most * one.error;
    error_after(session, &options, &format!("{}, several base materials", pass.name), steps, hopeless)
}

/// Whether the photographs decide about the distribution of normals in this fit.
fn ndf_is_open(session: &Session, pass: &FitPass) -> bool {
    let scene = session.scene;
    let unknowns = session.unknowns();
    let unsaid = scene.material.specular.ndf == NdfChoice::Auto && scene.own_material().is_none();
    let is_one = matches!(scene.material.gloss, Gloss::Auto | Gloss::One) && !session.kept.several;
    let moves = unknowns.roughness || unknowns.specular_albedo;
    let untried = session.scores.ndf_tried.is_none();
    unsaid && is_one && moves && untried && pass.steps >= NDF_LEAST_STEPS && !uses_published(scene)
}

/// The step after which the trial that has begun is decided.
fn decided_after(session: &Session) -> Option<u32> {
    session
        .scores
        .ndf_tried
        .filter(|tried| tried.sg.is_none() && !session.kept.several)
        .map(|tried| tried.steps)
}

/// Takes the steps of the trial with GGX from here, after those with the spherical Gaussian, and goes back.
fn try_ggx(session: &mut Session, pass: &FitPass, sg: &Steps) -> Result<()> {
    let _trying = info_span!("ggx tried").entered();
    let options = FitOptions {
        initialize: Initialize::NONE,
        ..options(session, pass, Done { steps: sg.summary.steps, ..Done::default() })?
    };
    let world = &mut session.pipeline.world;
    let before = checkpoint::save(world, Span::Pass)?;
    let first = first_material(world);
    put_lobe(world, SpecularLobe { ndf: Ndf::Ggx, ..first });
    let hopeless = |step: u32, error: f64| {
        NDF_HOPELESS.iter().any(|(from, most)| step >= *from && error > most * sg.error)
    };
    let tried = error_after(session, &options, &format!("{}, GGX", pass.name), NDF_TRIED, hopeless);
    let world = &mut session.pipeline.world;
    let found = first_material(world);
    checkpoint::load(world, &before)?;
    let (ggx, given_up) = tried?;
    if is_stopping() {
        return Err(Error::Interrupted);
    }
    let (ggx_albedo, ggx_roughness) = (found.albedo.to_array(), found.roughness);
    session.scores.ndf_tried = Some(NdfTried {
        ggx,
        sg: None,
        ggx_albedo,
        ggx_roughness,
        given_up,
        steps: options.done.steps + NDF_TRIED,
    });
    Ok(())
}

/// Decides, after the same steps with the spherical Gaussian; GGX begins with the light and albedo of these, and the lobe of the trial.
fn decide(session: &mut Session, pass: &FitPass, sg: &Steps) {
    let Some(mut tried) = session.scores.ndf_tried else { return };
    tried.sg = Some(sg.error);
    session.scores.ndf_tried = Some(tried);
    let is_better = tried.given_up.is_none() && tried.ggx < NDF_CLEARLY * sg.error;
    if is_better {
        let (albedo, roughness) = (Vec3::from(tried.ggx_albedo), tried.ggx_roughness);
        put_lobe(&mut session.pipeline.world, SpecularLobe { albedo, roughness, ndf: Ndf::Ggx });
    }
    let NdfTried { ggx, given_up, steps, .. } = tried;
    let early = given_up_words(given_up);
    let chosen = if is_better { "GGX is chosen" } else { "the spherical Gaussian is kept" };
    session.progress.print(&format!(
        "{}: distribution of normals: {chosen}: error {ggx:.4} with GGX{early}, {:.4} with the Gaussian, after {steps} steps",
        pass.name, sg.error
    ));
}

/// Gives the only base material this lobe; its optimizer's moments stay.
fn put_lobe(world: &mut World, lobe: SpecularLobe) {
    let mut materials = world.query_filtered::<&mut SpecularLobe, With<BaseMaterial>>();
    materials.iter_mut(world).for_each(|mut own| *own = lobe);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_close_choice_is_made_again_once() {
        let tried = MaterialsTried { one: 0.0317, several: 0.0306, steps: 100, given_up: None, seconds: 1.0 };
        assert_eq!(asked_again(tried, 1200), Some(300));
        // Too few steps would be left.
        assert_eq!(asked_again(tried, 899), None);
        // One is better.
        assert_eq!(asked_again(MaterialsTried { several: 0.0318, ..tried }, 1200), None);
        assert_eq!(asked_again(MaterialsTried { steps: 300, ..tried }, 1200), None);
    }
}
