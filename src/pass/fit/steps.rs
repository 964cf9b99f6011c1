//! The steps of a `Fit`: its settings, its log, the geometry that moves with it, and the choices
//! that it makes on its way: whether the surface has one base material or several, where the scene
//! leaves that to the photographs ([`Gloss::Auto`]), and whether one base material has spherical
//! Gaussians or GGX as its distribution of microfacet normals ([`NdfChoice::Auto`]). Measured in
//! `docs/research/fit.md`.
//!
//! A pixel's error is measured before a step moves anything, and of two hundred photographs or of
//! large ones most pixels are visited for the first time in the steps of a trial: both materials
//! are judged by what they have not been fitted to. A trial that is hopeless ends early, and the
//! fit goes on with what was tried only if its error is clearly less; else as if nothing had been
//! tried.
//!
//! *Several materials.* The fit begins with one. If that explains the photographs badly after the
//! first of [`TRIED`] steps, two are tried, a dielectric and one that may be metal
//! ([`metal`](lobelia_solve::fit::metal)), for as many steps over the same pixels; light and albedo
//! then begin from an initialization as far as they are unknown, because what one material made of
//! them is wrong. After a `Shape` one material begins with a light and an albedo that were fitted
//! with it, and several begin anew. So where several are better after a hundred steps, but not
//! clearly, they are tried again for more steps: a copper kettle with a black handle has 0.97 of
//! the error after 100 steps and 0.67 after 300, a chair 0.97 and 0.98.
//!
//! *GGX.* After [`NDF_TRIED`] steps with the spherical Gaussian the fit takes as many with GGX in
//! its place, from the same light and albedo; then it goes back and takes the same steps as it is.
//! Where cameras or vertices are fitted too, they move in the second half of the comparison only.

use crate::pass::run::session::{Chosen, Session};
use crate::pass::{run::progress::Moment, run::resume::keep, run::resume::resume_part, show::apply_edits};
use crate::report::scores::{MaterialsTried, NdfTried, given_up_words};
use crate::scene::{
    Albedo, FitPass, FitShading, Gloss, Light, NdfChoice, Sheen, SpecularAlbedo, uses_published,
};
use crate::spawn::{initial_lobes, several_materials};
use bevy_ecs::prelude::{Entity, Resource, With, World};
use glam::Vec3;
use lobelia_geometry::error::{Error, Result, stop::finish_stopping, stop::is_stopping};
use lobelia_sg::{accurate::Quality, brdf::Ndf, shading::ClosedForm};
use lobelia_solve::fit::{
    cameras::CameraUnknowns, groups::forget_group_shadows, groups::forget_visibility, guard::check_numbers,
    guard::check_parameters, roughness::TexelPlaces, run::Done, run::EARLY, run::FitOptions,
    run::FitProgress, run::FitSummary, run::Initialize, run::may_pause, run::run_fit,
};
use lobelia_solve::shape::{run::training_silhouettes, vertices::MovingMesh};
use lobelia_solve::visibility::{ObjectVisibility, see_material_of_step};
use lobelia_solve::{fit::observe::PixelChoice, fit::systems::closed_form_shader};
use lobelia_world::light::{LightLobe, groups::FittedLobe, light_frame::OwnLightFrame};
use lobelia_world::material::{
    BaseMaterial, SpecularBlend, SpecularLobe, TexelIndex, first_material, recovered_materials,
    replace_materials, sheen::write_albedo, shown::recovered_material,
};
use lobelia_world::pipeline::{Phase, Shader};
use lobelia_world::{checkpoint, checkpoint::Span, checkpoint::is_due, checkpoint::keep_resource};
use serde::{Deserialize, Serialize};
use std::fmt::Write as _;
use std::{ops::ControlFlow, sync::Arc, time::Instant};
use tracing::info_span;

/// Steps with one material before a choice, and with several for it; the second choice is made only
/// if the first was close.
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
/// Steps of the first trial after which it ends if its error is so many times that of one. Several
/// begin anew: where they are better in the end, their error first rises to 1.3 times that of one;
/// where they are worse, to 1.8 (a sphere) or 3.3 times (`cheburashka`).
const HOPELESS: (u32, f64) = (20, 2.2);

/// Steps before the trial, and of the trial.
const NDF_TRIED: u32 = 100;
/// A choice is made only in a fit of at least this many steps: vertices begin to move after a
/// quarter of them.
const NDF_LEAST_STEPS: u32 = 800;
/// PSNR of linear radiance, in dB, from which nothing is tried: there is little left to explain.
const NDF_EXPLAINED: f64 = 40.0;
/// Steps of the trial after which it ends if its error is so many times that of the spherical
/// Gaussian before it. After 20 steps it is 1.3 times that on spheres of GGX, and after 50 steps
/// 0.8 times; on `cheburashka`, which has none, 1.4 and 1.3 times, and on `spot` 2.2 times after
/// 20.
const NDF_HOPELESS: [(u32, f64); 2] = [(20, 1.6), (50, 1.15)];
/// Error with GGX relative to that of the spherical Gaussian below which it is chosen.
const NDF_CLEARLY: f64 = 0.975;

/// Settings and results of the steps so far.
type Taken = (FitSummary, FitOptions);

/// Takes the steps of a fit, and chooses on the way if that is open. Also returns its final
/// settings.
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

/// Takes the steps until the next pause, with a choice if the photographs are explained badly where
/// that is asked; what they have come to goes to `before`. Returns whether they were the last.
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

/// The steps after which several materials are tried again in a fit of `steps`; `None` if one was
/// as good, or if too few steps would be left.
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
    if !unsaid || !untried || !enough || uses_published(scene) {
        return Ok(false);
    }
    // The edits of all passes must have room for what they make of several base materials.
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
    let most = if session.kept.normals_found { CLEARLY_POLISHED } else { CLEARLY };
    session.kept.several = found.is_some_and(|(error, ended)| ended.is_none() && error < most * first.error);
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
    let several_chosen = session.kept.several;
    let again = asked_again(tried, pass.steps).filter(|_| !several_chosen && given_up.is_none());
    session.kept.chosen.again_after = again;
    let chosen = match (several_chosen, again) {
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

/// The error of several materials after the same steps, or those after which it was given up, for
/// it was [`HOPELESS`] beside that of `one`.
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
    set_shading(session, pass)?;
    let done = Done::default();
    let options = FitOptions { done, unknowns, initialize, light_frame, ..before.clone() };
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
    let tried = session.scores.ndf_tried.filter(|tried| tried.sg.is_none() && !session.kept.several);
    Some(tried?.steps)
}

/// Takes the steps of the trial with GGX from here, after those with the spherical Gaussian, and
/// goes back.
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
    let hopeless = |step, error| NDF_HOPELESS.iter().any(|(at, most)| step >= *at && error > most * sg.error);
    let tried = error_after(session, &options, &format!("{}, GGX", pass.name), NDF_TRIED, hopeless);
    let world = &mut session.pipeline.world;
    let found = first_material(world);
    checkpoint::load(world, &before)?;
    let (ggx, given_up) = tried?;
    if is_stopping() {
        return Err(Error::Interrupted);
    }
    let (ggx_albedo, ggx_roughness) = (found.albedo.to_array(), found.roughness);
    let steps = options.done.steps + NDF_TRIED;
    session.scores.ndf_tried = Some(NdfTried { ggx, sg: None, ggx_albedo, ggx_roughness, given_up, steps });
    Ok(())
}

/// Decides, after the same steps with the spherical Gaussian; GGX begins with the light and albedo
/// of these, and the lobe of the trial.
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

/// Pixels of a step from which the error of twenty tells that a trial is hopeless.
const TELLING_PIXELS: f32 = 500.0;
/// Steps between two lines of the log.
pub(crate) const LOG_EVERY: u32 = 20;

/// The text of `log.csv`.
#[derive(Resource, Serialize, Deserialize)]
struct FitLog(String);

/// The first line of the log.
pub(crate) const COLUMNS: &str =
    "step,elapsed_secs,loss,psnr,specular_r,specular_g,specular_b,roughness,lobes\n";

/// Begins the log, also again: without the steps of what has been given up.
pub(super) fn begin_log(world: &mut World) {
    keep_resource::<FitLog>(world, Span::Pass);
    world.insert_resource(FitLog(COLUMNS.into()));
}

/// The text of the log, which is then gone.
pub(super) fn take_log(world: &mut World) -> String {
    world.remove_resource::<FitLog>().map_or_else(|| COLUMNS.into(), |log| log.0)
}

/// The shader for the settings of a scene file.
pub(crate) fn shader(shading: FitShading, quality: Quality) -> Shader {
    closed_form_shader(match shading {
        FitShading::Accurate => ClosedForm::Accurate(quality),
        FitShading::Published => ClosedForm::Published,
    })
}

/// Puts in the shader and the shadows of a fit; those of geometry that has moved are traced again.
fn set_shading(session: &mut Session, pass: &FitPass) -> Result<()> {
    session.pipeline.set_shader(Phase::FitStep, shader(pass.shading, pass.quality));
    // The published formulas are for comparison and include neither shadows nor interreflection.
    session.set_shadows(Phase::FitStep, pass.shading == FitShading::Accurate, see_material_of_step())
}

/// The settings of a fit that goes on from `done`, with its shading put in.
fn options(session: &mut Session, pass: &FitPass, done: Done) -> Result<FitOptions> {
    set_shading(session, pass)?;
    Ok(FitOptions {
        loss: pass.loss,
        steps: pass.steps,
        done,
        batch: pass.batch as usize,
        early: if pass.vertices { 1.0 } else { EARLY },
        rates: [pass.rates.albedo, pass.rates.light, pass.rates.specular],
        milestones: pass.milestones.clone(),
        decay: pass.decay,
        unknowns: session.unknowns(),
        pixels: PixelChoice { seed: session.scene.seed, max_pixels: pass.max_pixels as usize, evenly: true },
        keeps_pool: true,
        initialize: session.kept.initialize,
        looks_for_sheen: session.scene.material.sheen == Sheen::Auto,
        exposure: pass.exposure,
        measures: true,
        scale: session.scene.scale,
        light_frame: session.scene.light_frame.frame(&session.scene.light),
    })
}

/// Why steps of a fit ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Ended {
    /// All are done, or the run is stopped.
    Done,
    /// Too little is explained at the step that was asked about.
    Doubted,
    /// A checkpoint is due.
    Paused,
}

/// The result of some steps of a fit.
struct Steps {
    pub summary: FitSummary,
    /// Mean absolute error of radiance over the last of them.
    pub error: f64,
    /// PSNR of linear radiance over the last of them, in dB.
    pub psnr: f64,
    pub ended: Ended,
}

/// Takes steps of a fit; ends at the step that is `asked` about if the PSNR is below the given one
/// there, and where a checkpoint is due, if cameras and vertices stand still. What it has found is
/// checked, and kept also if it is stopped.
fn take_steps(
    session: &mut Session,
    pass: &FitPass,
    options: &FitOptions,
    asked: Option<(u32, f64)>,
) -> Result<Steps> {
    let bar = session.progress.bar(&pass.name, 0);
    bar.set_message("first guess".into());
    // Where the texels are.
    let atlas = session.surface.atlas();
    let place = |(at, covered): (&Vec3, &bool)| if *covered { *at } else { Vec3::NAN };
    let positions = atlas.position.iter().zip(&atlas.covered).map(place).collect();
    session.pipeline.world.insert_resource(TexelPlaces { positions, progress: 0.0 });
    let moves_cameras = pass.cameras != CameraUnknowns::Given;
    let moves_vertices = pass.vertices && !session.kept.normals_found && !session.kept.by_stereo;
    let world = &mut session.pipeline.world;
    world.insert_resource(pass.cameras);
    if moves_vertices {
        // Silhouettes are seen by the cameras as they are now.
        let seen = if moves_cameras { Vec::new() } else { training_silhouettes(world) };
        world.insert_resource(MovingMesh::new(session.surface.clone(), pass.steps, seen));
    }
    let is_still = !moves_cameras && !moves_vertices;
    let (mut error, mut psnr, mut ended) = (0.0, 0.0, Ended::Done);
    let (progress, report, out) = (session.progress, &mut session.report, &session.out);
    let summary = run_fit(&mut session.pipeline, options, &mut |at, world| {
        bar.set_length(u64::from(at.steps));
        bar.set_position(u64::from(at.step));
        if at.step % LOG_EVERY == 0 || at.step == at.steps {
            bar.set_message(format!("{:.1} dB", at.sums.psnr()));
            log_line(&mut world.resource_mut::<FitLog>().0, at.step, at);
        }
        progress.moment(Moment::Step { step: at.step, steps: at.steps, fit: at });
        report.step(out, &pass.name, at.step, at, world);
        (error, psnr) = (at.sums.mean(), at.sums.psnr());
        if asked.is_some_and(|(step, enough)| step == at.step && psnr < enough) {
            ended = Ended::Doubted;
        } else if is_still && at.step < at.steps && may_pause(world, at.step) && is_due(world) {
            ended = Ended::Paused;
        }
        if ended != Ended::Done || is_stopping() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    });
    session.pipeline.world.remove_resource::<CameraUnknowns>();
    let moved = session.pipeline.world.remove_resource::<MovingMesh>().map(|mesh| mesh.surface);
    if let Some(moved) = moved.filter(|moved| !Arc::ptr_eq(moved, &session.surface)) {
        (session.surface, session.surface_found) = (moved, true);
        // Visibility of the changed mesh is traced again when it is needed.
        forget_visibility(&mut session.pipeline.world);
    }
    let summary = summary?;
    // A stop leaves nothing to choose.
    if is_stopping() {
        ended = Ended::Done;
    }
    // The results so far are written.
    finish_stopping();
    check_parameters(&mut session.pipeline.world)?;
    let positions = &session.surface.mesh().positions;
    check_numbers("the surface's coordinate", positions.iter().flat_map(|at| at.to_array()))?;
    bar.finish_and_clear();
    Ok(Steps { summary, error, psnr, ended })
}

/// The mean absolute error of radiance over the last steps of a trial, and after how many it was
/// given up, if it was.
type Tried = (f64, Option<u32>);

/// Takes steps on trial, without a log and with geometry as it is. It is given up when it is
/// `hopeless` by their number, and by the error over enough pixels.
fn error_after(
    session: &mut Session,
    options: &FitOptions,
    title: &str,
    steps: u32,
    hopeless: impl Fn(u32, f64) -> bool,
) -> Result<Tried> {
    let (mut error, mut given_up) = (f64::INFINITY, None);
    let tells = options.early * options.batch as f32 >= TELLING_PIXELS;
    forget_shadows(&mut session.pipeline.world);
    let bar = session.progress.bar(title, 0);
    bar.set_message("first guess".into());
    run_fit(&mut session.pipeline, options, &mut |at: &FitProgress, _| {
        let step = at.step - options.done.steps;
        bar.set_length(u64::from(steps));
        bar.set_position(u64::from(step));
        error = at.sums.mean();
        given_up = (tells && step < steps && hopeless(step, error)).then_some(step);
        let is_over = step == steps || given_up.is_some() || is_stopping();
        if is_over { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    })?;
    bar.finish_and_clear();
    Ok((error, given_up))
}

/// Makes the next step find shadows and reflected light anew, as one that goes on from a checkpoint
/// does.
fn forget_shadows(world: &mut World) {
    if let Some(traced) = world.get_resource::<ObjectVisibility>() {
        let unlit = traced.unlit();
        world.insert_resource(unlit);
    }
    forget_group_shadows(world);
}

/// Adds a line to a log: `step` of a `Fit` or `Shape`.
pub(crate) fn log_line(log: &mut String, step: u32, at: &FitProgress) {
    let Vec3 { x: r, y: g, z: b } = at.specular.albedo;
    let (secs, loss, psnr) = (at.elapsed_secs, at.sums.mean(), at.sums.psnr());
    // Writing to a String cannot fail.
    let _ = writeln!(
        log,
        "{step},{secs:.3},{loss:.6},{psnr:.3},{r:.4},{g:.4},{b:.4},{:.4},{}",
        at.specular.roughness, at.lobes
    );
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
