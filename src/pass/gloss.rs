//! The choices that a `Fit` makes on its way: whether the surface has one base material or several, where the scene leaves that to the photographs
//! ([`Gloss::Auto`]), and the distribution of normals of one ([`ndf`](crate::pass::ndf)).
//!
//! The fit begins with one. If that explains the photographs badly after the first of [`TRIED`] steps, two are tried, a dielectric and one that may be
//! metal ([`metal`](crate::fit::metal)), for as many steps over the same pixels; light and albedo then begin from an initialization as far as they are unknown, because what one
//! material made of them is wrong. A pixel's error is measured before a step moves anything, and of two hundred photographs or of large ones
//! most pixels are visited for the first time in these steps: both materials are judged by what they have not been fitted to. The fit goes on with
//! several only if their error is clearly less; else it goes on as if they had not been tried.
//!
//! After a `Shape` one material begins with a light and an albedo that were fitted with it, and several begin anew. So where several are better after
//! a hundred steps, but not clearly, the fit goes on with one, and several are tried again for more steps: a copper kettle with a black
//! handle has 0.97 of the error after 100 steps and 0.67 after 300, a chair 0.97 and 0.98.

use crate::checkpoint::{Carried, Span, carry, discard, restore};
use crate::error::stop::{finish_stopping, is_stopping};
use crate::error::{Error, Result};
use crate::fit::observe::release_pool;
use crate::fit::run::{Done, FitOptions, FitSummary, Initialize};
use crate::light::LightLobe;
use crate::light::groups::FittedLobe;
use crate::light::light_frame::OwnLightFrame;
use crate::material::sheen::write_albedo;
use crate::material::shown::recovered_material;
use crate::material::{SpecularBlend, SpecularLobe, TexelIndex, recovered_materials, replace_materials};
use crate::pass::edit::apply_edits;
use crate::pass::ndf;
use crate::pass::resume::{self, At};
use crate::pass::session::{Chosen, Session};
use crate::pass::steps::{Steps, begin_log, error_after, forget_shadows, options, take_steps};
use crate::profile::stage;
use crate::report::scores::{MaterialsTried, given_up_words};
use crate::scene::{Albedo, FitPass, Gloss, Light, SpecularAlbedo, uses_published};
use crate::spawn::{initial_lobes, several_materials};
use bevy_ecs::prelude::{Entity, World};
use glam::Vec3;
use std::time::Instant;

/// Steps with one material before a choice, and with several for it; the second choice is made only if the first was close.
const TRIED: [u32; 2] = [100, 300];
/// A choice is made only in a fit of at least this many times the steps before it.
const LEAST_STEPS: u32 = 3;
/// PSNR of linear radiance, in dB, from which one material is enough.
const EXPLAINED: f64 = 32.0;
/// Error of several relative to that of one below which they are chosen.
const CLEARLY: f64 = 0.9;
/// The same of a surface whose normals were found by what it mirrors: it is polished in parts at least. `head` at half size has 0.906 there, and
/// 0.5 dB more with two in the end.
const CLEARLY_POLISHED: f64 = 0.95;
/// Steps of the first trial after which it ends if its error is so many times that of one. Several begin anew: where they are better in the end, their error first
/// rises to 1.3 times that of one; where they are worse, to 1.8 (a sphere) or 3.3 times (`cheburashka`).
const HOPELESS: (u32, f64) = (20, 2.2);

/// Takes the steps of a fit, and chooses on the way if that is open. Returns also with what settings it ended.
///
/// # Errors
/// Those of [`take_steps`]; if a checkpoint is not one of this run.
pub(super) fn take_steps_and_choose(
    session: &mut Session,
    pass: &FitPass,
) -> Result<(FitSummary, FitOptions)> {
    let taken = choose_on_the_way(session, pass);
    // All parts of the fit and its trials visit the same pixels, made once.
    release_pool(&mut session.pipeline.world);
    taken
}

fn choose_on_the_way(session: &mut Session, pass: &FitPass) -> Result<(FitSummary, FitOptions)> {
    if resume::restore(session, At::Level)? {
        return go_on(session, pass);
    }
    session.chosen = Chosen::default();
    let is_open = is_open(session, pass)? || ndf::is_open(session, pass);
    take_steps_after(session, pass, Done::default(), is_open.then_some(TRIED[0]))
}

/// The steps after those that are `done`, with a choice if the photographs are explained badly where that is asked.
fn take_steps_after(
    session: &mut Session,
    pass: &FitPass,
    done: Done,
    asked_after: Option<u32>,
) -> Result<(FitSummary, FitOptions)> {
    let options = FitOptions { asked_after, ..options(session, pass, done)? };
    let first = take_steps(session, pass, &options, enough(session, pass))?;
    if !first.doubted {
        return Ok((first.summary, options));
    }
    let chosen = answer(session, pass, &options, &first).and_then(|()| go_on(session, pass));
    if matches!(chosen, Err(Error::Interrupted)) {
        // What was found until then is written.
        finish_stopping();
        return Ok((FitSummary { stopped: true, ..first.summary }, options));
    }
    chosen
}

/// The PSNR from which there is nothing to ask.
fn enough(session: &Session, pass: &FitPass) -> f64 {
    match ndf::decided_after(session) {
        Some(_) => f64::INFINITY,
        None if ndf::is_open(session, pass) => ndf::EXPLAINED,
        None => EXPLAINED,
    }
}

/// Makes the choices that are due after these steps, and keeps them.
fn answer(session: &mut Session, pass: &FitPass, options: &FitOptions, first: &Steps) -> Result<()> {
    let start = Instant::now();
    if ndf::decided_after(session).is_some() {
        ndf::decide(session, pass, first);
    } else {
        let is_again = session.chosen.again_after.take().is_some();
        if first.psnr < EXPLAINED && (is_again || is_open(session, pass)?) {
            choose(session, pass, options, first)?;
        }
        if ndf::is_open(session, pass) {
            ndf::try_ggx(session, pass, first)?;
        }
    }
    session.initialize = Initialize::NONE;
    let steps = first.summary.steps;
    let secs = first.summary.elapsed_secs + start.elapsed().as_secs_f64();
    session.chosen.done = Done { steps, secs };
    forget_shadows(&mut session.pipeline.world);
    resume::keep_level(session, steps / TRIED[0])
}

/// The steps after a choice.
fn go_on(session: &mut Session, pass: &FitPass) -> Result<(FitSummary, FitOptions)> {
    let asked_after = ndf::decided_after(session).or(session.chosen.again_after);
    take_steps_after(session, pass, session.chosen.done, asked_after)
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
    let carried = carry(world, Span::Pass)?;
    let tried = try_several(session, pass, options, first.error);
    let found = tried.as_ref().ok().copied().filter(|_| !is_stopping());
    let enough = if session.placed.normals { CLEARLY_POLISHED } else { CLEARLY };
    session.several =
        found.is_some_and(|(error, given_up)| given_up.is_none() && error < enough * first.error);
    keep_one_or_several(&mut session.pipeline.world, session.several, &lobes, carried)?;
    tried?;
    let Some((several, given_up)) = found else { return Err(Error::Interrupted) };
    let steps = options.asked_after.unwrap_or_default();
    let seconds = start.elapsed().as_secs_f64();
    let tried = MaterialsTried { one: first.error, several, steps, given_up, seconds };
    let again = if session.several || given_up.is_some() { None } else { asked_again(tried, pass.steps) };
    session.chosen.again_after = again;
    session.progress.print(&words(&pass.name, session.several, tried, again));
    session.scores.materials_tried = Some(tried);
    Ok(())
}

/// What a choice has come to, in a line; `again` are the steps after which it is made again.
fn words(pass: &str, chose_several: bool, tried: MaterialsTried, again: Option<u32>) -> String {
    let chosen = match (chose_several, again) {
        (true, _) => "several base materials are chosen".to_owned(),
        (false, None) => "one base material is chosen".to_owned(),
        (false, Some(steps)) => format!("one base material is kept until step {steps}"),
    };
    let MaterialsTried { one, several, steps, given_up, .. } = tried;
    let early = given_up_words(given_up);
    format!(
        "{pass}: {chosen}: error {several:.4} with several{early}, {one:.4} with one, after {steps} steps"
    )
}

fn keep_one_or_several(
    world: &mut World,
    several: bool,
    one: &[SpecularLobe],
    carried: Carried,
) -> Result<()> {
    if several {
        begin_log(world);
        discard(world, carried);
        return Ok(());
    }
    replace_materials(world, one, SpecularBlend::default())?;
    restore(world, carried)
}

/// The error of several materials after the same steps, or those after which it was given up, for it was [`HOPELESS`] beside that of `one`.
fn try_several(
    session: &mut Session,
    pass: &FitPass,
    before: &FitOptions,
    one: f64,
) -> Result<(f64, Option<u32>)> {
    let _trying = stage("several materials tried");
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
        begin_light(world, &initial_lobes(&scene.light, None));
    }
    if initialize.albedo {
        let texels = world.query::<&TexelIndex>().iter(world).len();
        write_albedo(world, vec![Vec3::splat(0.4); texels])?;
    }
    let light_frame = world.get_resource::<OwnLightFrame>().map(|own| own.0);
    session.several = true;
    let unknowns = session.unknowns();
    // Shadows of geometry that has moved are traced again first.
    let visibility = before.visibility && session.has_visibility()?;
    let done = Done::default();
    let options = FitOptions { done, unknowns, initialize, visibility, light_frame, ..before.clone() };
    let steps = before.asked_after.unwrap_or_default();
    let hopeless =
        |step: u32, error: f64| steps == TRIED[0] && step >= HOPELESS.0 && error > HOPELESS.1 * one;
    error_after(session, &options, &format!("{}, several base materials", pass.name), steps, hopeless)
}

/// Puts the lobes of the light where a fit begins.
fn begin_light(world: &mut World, lobes: &[LightLobe]) {
    let mut query = world.query_filtered::<(Entity, &mut LightLobe), FittedLobe>();
    let mut own: Vec<_> = query.iter_mut(world).collect();
    own.sort_by_key(|(entity, _)| *entity);
    // All lights begin alike.
    own.into_iter().zip(lobes.iter().cycle()).for_each(|((_, mut lobe), first)| *lobe = *first);
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
        assert!(words("fit", false, tried, Some(300)).contains("kept until step 300: error 0.0306"));
        assert!(words("fit", false, tried, None).contains("one base material is chosen"));
        assert!(words("fit", true, tried, None).contains("several base materials are chosen"));
        let given_up = MaterialsTried { several: 0.09, given_up: Some(20), ..tried };
        assert!(
            words("fit", false, given_up, None)
                .contains("0.0900 with several (given up after 20 steps), 0.0317")
        );
    }
}
