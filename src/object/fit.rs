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

use crate::object::{Chosen, Object, initialized, replace_surface, show::apply_edits, view_report::note_fit};
use crate::progress::{Progress, Step};
use crate::report::scores::{MaterialsTried, NdfTried, ScaleFound, given_up_words};
use crate::scene::{FitPass, FitShading, Gloss, NdfChoice, Sheen, SpecularAlbedo, Tilt, uses_published};
use crate::spawn::{initial_lobes, initial_specular, several_materials};
use bevy_ecs::prelude::{Resource, With, World};
use glam::{Vec2, Vec3};
use lobelia_geometry::error::stop::{finish_stopping, is_stopping, stop_this_work};
use lobelia_geometry::error::{Error, Result};
use lobelia_geometry::mesh::{Surface, atlas::address, atlas::fill_uncovered};
use lobelia_geometry::view::{Camera, Photograph, Split};
use lobelia_sg::{accurate::Quality, brdf::Ndf, ray::TexelAddress, shading::ClosedForm, statistics::median};
use lobelia_solve::fit::detail::{DetailOptions, finest_side, solve_detail, visited_pixels};
use lobelia_solve::fit::observe::{PixelChoice, release_pool};
use lobelia_solve::fit::roughness::{RoughnessPrior, TexelPlaces, TexelRoughness, attach_roughness};
use lobelia_solve::fit::run::{
    Done, EARLY, FitOptions, FitProgress, FitSummary, Initialize, may_pause, optimizer_of_texel_roughness,
    run_fit,
};
use lobelia_solve::fit::scale::{ScaleRule, means};
use lobelia_solve::fit::systems::closed_form_shader;
use lobelia_solve::fit::{
    cameras::CameraUnknowns, components::TexelSeen, guard::check_numbers, guard::check_parameters,
};
use lobelia_solve::shape::{run::training_silhouettes, vertices::MovingMesh};
use lobelia_solve::visibility::{ObjectVisibility, see_recovered, see_recovered_of_step};
use lobelia_world::checkpoint::{self, Span, is_due, keep_part, keep_resource, resume_part};
use lobelia_world::light::groups::{entities_of_group, light_groups};
use lobelia_world::light::{light_frame::OwnLightFrame, placement::LightGroup};
use lobelia_world::material::diffuse::{Diffuse, KnownAlong, has_sheen, has_tilt, write_albedo};
use lobelia_world::material::{
    BaseMaterial, MAX_SPECULAR_LOBES, SpecularBlend, SpecularLobe, TexelIndex, first_material,
    recovered_materials, replace_materials, shown::recovered_material, texels_in_order,
};
use lobelia_world::pipeline::pool::{despawn_rows, read_column, with_columns, write_column};
use lobelia_world::pipeline::{Phase, Shader, Slot};
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

impl Object {
    /// Finds what is unknown of light and material from the training photographs. Returns the steps
    /// and findings of the fit.
    ///
    /// # Errors
    /// If there are no pixels to fit to, or a system fails. A fit that is stopped leaves what it
    /// has found until then.
    pub(crate) fn find(&mut self, pass: &FitPass) -> Result<FitSummary> {
        if let Gloss::Texels { smoothness, color_width, specular } = self.scene().material.gloss {
            let first = initial_specular(&self.scene().material.specular).roughness;
            let prior = RoughnessPrior::new(self.surface().atlas(), smoothness, color_width, specular);
            self.pipeline.world.insert_resource(prior);
            attach_roughness(&mut self.pipeline.world, first, specular);
            self.pipeline.swap(Phase::FitStep, Slot::Optimizer, optimizer_of_texel_roughness());
        }
        begin_log(&mut self.pipeline.world);
        let taken = take_steps_and_choose(self, pass);
        // All parts of the fit and its trials visit the same pixels, made once.
        release_pool(&mut self.pipeline.world);
        let (mut summary, options) = taken?;
        self.found().has_object = true;
        self.found().initialize = Initialize::NONE;
        self.report_light_frame(&pass.name);
        self.report_placements(&pass.name);
        let known = !options.unknowns.light || !options.unknowns.albedo;
        // Maps of the albedo may have replaced the scene's rule.
        let rule = self.pipeline.world.get_resource().copied().unwrap_or(options.scale);
        let rule = if known { "Known".to_owned() } else { ScaleRule::words(&rule) };
        let mut unseen = fill_texels(self)?;
        if pass.detail && options.unknowns.albedo && !summary.stopped {
            // What was solved for until a stop stays.
            match refine_texture(self, pass, &options) {
                Err(Error::Interrupted) | Ok(()) => {}
                failed => failed?,
            }
            summary.stopped = is_stopping();
            finish_stopping();
            check_parameters(&mut self.pipeline.world)?;
            unseen = fill_texels(self)?;
        }
        let [mean_light, mean_albedo] = means(&mut self.pipeline.world)?.map(|mean| mean.to_array());
        self.scores().add_fit_secs(summary.elapsed_secs);
        self.scores().scale = Some(ScaleFound { rule, mean_light, mean_albedo });
        note_fit(self);
        report(self, &pass.name, &summary, unseen);
        Ok(summary)
    }
}

fn report(object: &mut Object, name: &str, summary: &FitSummary, unseen: usize) {
    let world = &mut object.pipeline.world;
    // One or two base materials completely, of more the range of roughness of the texels.
    let lobes: Vec<SpecularLobe> = recovered_materials(world).into_iter().map(|(_, lobe)| lobe).collect();
    let gloss: Vec<f32> = world.query::<&TexelRoughness>().iter(world).map(|gloss| gloss.roughness).collect();
    let (low, high) = gloss.iter().fold((f32::INFINITY, 0f32), |(low, high), r| (low.min(*r), high.max(*r)));
    let words = |roughness: String, [r, g, b]: [f32; 3]| {
        format!("; roughness {roughness}, specular albedo ({r:.3}, {g:.3}, {b:.3})")
    };
    let material: String = match lobes.as_slice() {
        [first, ..] if !gloss.is_empty() => words(format!("{low:.3} to {high:.3}"), first.albedo.to_array()),
        all => all.iter().map(|l| words(format!("{:.3}", l.roughness), l.albedo.to_array())).collect(),
    };
    object.print(&format!(
        "{name}: {} steps over {} pixels in {:.1} s{material}{}",
        summary.steps,
        summary.pixels,
        summary.elapsed_secs,
        if summary.stopped { " (stopped early)" } else { "" }
    ));
    if let Some(part) = summary.explained_by_sheen.map(|part| 100.0 * part) {
        let world = &mut object.pipeline.world;
        let found = with_columns::<TexelIndex, &Diffuse, _>(world, |texels| Ok(has_sheen(&texels)));
        let words = if found.unwrap_or_default() { "a sheen" } else { "no sheen" };
        let of = "of the squared error of views kept aside";
        object.print(&format!("{name}: {words}: it explains {part:.1} % {of}"));
    }
    object.scores().determined = summary.determined;
    if let Some(words) = summary.determined.and_then(|found| found.words()) {
        object.print(&format!("{name}: determined by the photographs: {words}"));
    }
    if unseen > 0 {
        object.progress().note(&format!("{unseen} texels that no view sees are filled from their neighbors"));
    }
}

/// Settings and results of the steps so far.
type Taken = (FitSummary, FitOptions);

/// Takes the steps of a fit, and chooses on the way if that is open. Also returns its final
/// settings.
pub(super) fn take_steps_and_choose(object: &mut Object, pass: &FitPass) -> Result<Taken> {
    if !resume_part(&mut object.pipeline.world)? {
        let is_open = is_open(object, pass)? || ndf_is_open(object, pass);
        object.found().chosen = Chosen { asked_after: is_open.then_some(TRIED[0]), ..Chosen::default() };
    }
    let mut before = None;
    loop {
        match (take_steps_to_pause(object, pass, &mut before), before.clone()) {
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
        object.found().initialize = Initialize::NONE;
        keep_part(&mut object.pipeline.world)?;
    }
}

/// Takes the steps until the next pause, with a choice if the photographs are explained badly where
/// that is asked; what they have come to goes to `before`. Returns whether they were the last.
fn take_steps_to_pause(object: &mut Object, pass: &FitPass, before: &mut Option<Taken>) -> Result<bool> {
    let done = object.found().chosen.done;
    let options = options(object, pass, done)?;
    if let Some(summary) = object.found().chosen.finished {
        *before = Some((summary, options));
        return Ok(true);
    }
    // The PSNR from which there is nothing to ask.
    let enough = match decided_after(object) {
        Some(_) => f64::INFINITY,
        None if ndf_is_open(object, pass) => NDF_EXPLAINED,
        None => EXPLAINED,
    };
    let asked = object.found().chosen.asked_after.map(|step| (step, enough));
    let taken = take_steps(object, pass, &options, asked)?;
    let FitSummary { steps, elapsed_secs: secs, stopped, .. } = taken.summary;
    *before = Some((taken.summary, options.clone()));
    match taken.ended {
        Ended::Done if pass.detail && options.unknowns.albedo && !stopped => {
            object.found().chosen.finished = Some(taken.summary);
            keep_part(&mut object.pipeline.world)?;
        }
        Ended::Done => {}
        Ended::Paused => object.found().chosen.done = Done { steps, secs, is_pause: true },
        Ended::Doubted => answer(object, pass, &options, &taken)?,
    }
    Ok(taken.ended == Ended::Done)
}

/// Makes the choices that are due after these steps.
fn answer(object: &mut Object, pass: &FitPass, options: &FitOptions, first: &Steps) -> Result<()> {
    let start = Instant::now();
    if decided_after(object).is_some() {
        decide(object, pass, first);
    } else {
        let is_again = object.found().chosen.again_after.take().is_some();
        if first.psnr < EXPLAINED && (is_again || is_open(object, pass)?) {
            choose(object, pass, options, first)?;
        }
        if ndf_is_open(object, pass) {
            try_ggx(object, pass, first)?;
        }
    }
    let secs = first.summary.elapsed_secs + start.elapsed().as_secs_f64();
    object.found().chosen.done = Done { steps: first.summary.steps, secs, is_pause: false };
    let decided = decided_after(object);
    let mut found = object.found();
    found.chosen.asked_after = decided.or(found.chosen.again_after);
    forget_shadows(&mut object.pipeline.world);
    Ok(())
}

/// The steps after which several materials are tried again in a fit of `steps`; `None` if one was
/// as good, or if too few steps would be left.
fn asked_again(tried: MaterialsTried, steps: u32) -> Option<u32> {
    let next = TRIED.into_iter().find(|&next| next > tried.steps);
    next.filter(|next| tried.several < tried.one && steps >= LEAST_STEPS * next)
}

/// Whether the photographs decide about gloss in this fit.
fn is_open(object: &mut Object, pass: &FitPass) -> Result<bool> {
    let scene = object.scene();
    let material = &scene.material;
    let gray = matches!(material.specular.albedo, SpecularAlbedo::Unknown { mono: true, .. });
    let unsaid = material.gloss == Gloss::Auto && material.specular.is_open() && gray;
    let untried = object.scores().materials_tried.is_none() && scene.own_material().is_none();
    let enough = pass.steps >= LEAST_STEPS * TRIED[0] && object.unknowns().albedo;
    if !unsaid || !untried || !enough || uses_published(&scene) {
        return Ok(false);
    }
    // The edits of all passes must have room for what they make of several base materials.
    let mut unedited = recovered_material(&mut object.pipeline.world)?;
    let (lobes, blend) = several_materials();
    unedited.lobes = lobes.into_iter().map(Some).collect();
    unedited.blends.fill(blend);
    let surface = object.surface();
    let mut edits = scene.passes.iter().map(|pass| pass.edits()).filter(|edits| !edits.is_empty());
    Ok(edits.all(|edits| apply_edits(&mut unedited.clone(), edits, &surface).is_ok()))
}

/// Tries several materials and keeps what explains more.
fn choose(object: &mut Object, pass: &FitPass, options: &FitOptions, first: &Steps) -> Result<()> {
    let start = Instant::now();
    let saved = checkpoint::save(&mut object.pipeline.world, Span::Pass)?;
    let tried = try_several(object, pass, options, first);
    let found = tried.as_ref().ok().copied().filter(|_| !is_stopping());
    let most = if object.found().normals_found { CLEARLY_POLISHED } else { CLEARLY };
    let several_chosen = found.is_some_and(|(error, ended)| ended.is_none() && error < most * first.error);
    if several_chosen {
        begin_log(&mut object.pipeline.world);
    } else {
        checkpoint::load(&mut object.pipeline.world, &saved)?;
    }
    tried?;
    let Some((several, given_up)) = found else { return Err(Error::Interrupted) };
    let steps = first.summary.steps;
    let seconds = start.elapsed().as_secs_f64();
    let tried = MaterialsTried { one: first.error, several, steps, given_up, seconds };
    let again = asked_again(tried, pass.steps).filter(|_| !several_chosen && given_up.is_none());
    object.found().chosen.again_after = again;
    let chosen = match (several_chosen, again) {
        (true, _) => "several base materials are chosen".to_owned(),
        (false, None) => "one base material is chosen".to_owned(),
        (false, Some(steps)) => format!("one base material is kept until step {steps}"),
    };
    object.print(&format!(
        "{}: {chosen}: error {several:.4} with several{}, {:.4} with one, after {steps} steps",
        pass.name,
        given_up_words(given_up),
        first.error
    ));
    object.scores().materials_tried = Some(tried);
    Ok(())
}

/// The error of several materials after the same steps, or those after which it was given up, for
/// it was [`HOPELESS`] beside that of `one`.
fn try_several(object: &mut Object, pass: &FitPass, before: &FitOptions, one: &Steps) -> Result<Tried> {
    let _trying = info_span!("several materials tried").entered();
    let scene = object.scene();
    let world = &mut object.pipeline.world;
    let (lobes, blend) = several_materials();
    replace_materials(world, &lobes, blend)?;
    let initialize = initialized(&scene, false);
    if initialize.light {
        // All lights begin alike.
        let first = initial_lobes(&scene.light, None);
        for group in (0..light_groups(world) as u32).map(LightGroup) {
            let mut entities = entities_of_group(world, group);
            entities.sort();
            world.insert_batch(entities.into_iter().zip(first.iter().copied().cycle()));
        }
    }
    if initialize.albedo {
        let texels = world.query::<&TexelIndex>().iter(world).len();
        write_albedo(world, &vec![Vec3::splat(0.4); texels])?;
    }
    let light_frame = world.get_resource::<OwnLightFrame>().map(|own| own.0);
    object.found().several = true;
    let unknowns = object.unknowns();
    set_shading(object, pass)?;
    let done = Done::default();
    let options = FitOptions { done, unknowns, initialize, light_frame, ..before.clone() };
    let steps = one.summary.steps;
    let (from, most) = HOPELESS;
    let hopeless = |step, error| steps == TRIED[0] && step >= from && error > most * one.error;
    error_after(object, &options, &format!("{}, several base materials", pass.name), steps, hopeless)
}

/// Whether the photographs decide about the distribution of normals in this fit.
fn ndf_is_open(object: &mut Object, pass: &FitPass) -> bool {
    let scene = object.scene();
    let unknowns = object.unknowns();
    let unsaid = scene.material.specular.ndf == NdfChoice::Auto && scene.own_material().is_none();
    let is_one = matches!(scene.material.gloss, Gloss::Auto | Gloss::One) && !object.found().several;
    let moves = unknowns.roughness || unknowns.specular_albedo;
    let untried = object.scores().ndf_tried.is_none();
    unsaid && is_one && moves && untried && pass.steps >= NDF_LEAST_STEPS && !uses_published(&scene)
}

/// The step after which the trial that has begun is decided.
fn decided_after(object: &mut Object) -> Option<u32> {
    let is_one = !object.found().several;
    let tried = object.scores().ndf_tried.filter(|tried| tried.sg.is_none() && is_one);
    Some(tried?.steps)
}

/// Takes the steps of the trial with GGX from here, after those with the spherical Gaussian, and
/// goes back.
fn try_ggx(object: &mut Object, pass: &FitPass, sg: &Steps) -> Result<()> {
    let _trying = info_span!("ggx tried").entered();
    let options = FitOptions {
        initialize: Initialize::NONE,
        ..options(object, pass, Done { steps: sg.summary.steps, ..Done::default() })?
    };
    let world = &mut object.pipeline.world;
    let before = checkpoint::save(world, Span::Pass)?;
    let first = first_material(world);
    put_lobe(world, SpecularLobe { ndf: Ndf::Ggx, ..first });
    let hopeless = |step, error| NDF_HOPELESS.iter().any(|(at, most)| step >= *at && error > most * sg.error);
    let tried = error_after(object, &options, &format!("{}, GGX", pass.name), NDF_TRIED, hopeless);
    let world = &mut object.pipeline.world;
    let found = first_material(world);
    checkpoint::load(world, &before)?;
    let (ggx, given_up) = tried?;
    if is_stopping() {
        return Err(Error::Interrupted);
    }
    let (ggx_albedo, ggx_roughness) = (found.albedo.to_array(), found.roughness);
    let steps = options.done.steps + NDF_TRIED;
    object.scores().ndf_tried = Some(NdfTried { ggx, sg: None, ggx_albedo, ggx_roughness, given_up, steps });
    Ok(())
}

/// Decides, after the same steps with the spherical Gaussian; GGX begins with the light and albedo
/// of these, and the lobe of the trial.
fn decide(object: &mut Object, pass: &FitPass, sg: &Steps) {
    let Some(mut tried) = object.scores().ndf_tried else { return };
    tried.sg = Some(sg.error);
    object.scores().ndf_tried = Some(tried);
    let is_better = tried.given_up.is_none() && tried.ggx < NDF_CLEARLY * sg.error;
    if is_better {
        let (albedo, roughness) = (Vec3::from(tried.ggx_albedo), tried.ggx_roughness);
        put_lobe(&mut object.pipeline.world, SpecularLobe { albedo, roughness, ndf: Ndf::Ggx });
    }
    let NdfTried { ggx, given_up, steps, .. } = tried;
    let early = given_up_words(given_up);
    let chosen = if is_better { "GGX is chosen" } else { "the spherical Gaussian is kept" };
    object.print(&format!(
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
const LOG_EVERY: u32 = 20;

/// The log of the `Fit` or `Shape` at work: the text of `log.csv`.
#[derive(Resource, Serialize, Deserialize)]
pub(crate) struct StepLog(pub String);

/// Begins the log, also again: without the steps of what has been given up.
pub(super) fn begin_log(world: &mut World) {
    keep_resource::<StepLog>(world, Span::Pass);
    let columns = "step,elapsed_secs,loss,psnr,specular_r,specular_g,specular_b,roughness,lobes\n";
    world.insert_resource(StepLog(columns.into()));
}

/// The shader for the settings of a scene file.
pub(super) fn shader(shading: FitShading, quality: Quality) -> Shader {
    closed_form_shader(match shading {
        FitShading::Accurate => ClosedForm::Accurate(quality),
        FitShading::Published => ClosedForm::Published,
    })
}

/// Puts in the shader and the shadows of a fit; those of geometry that has moved are traced again.
fn set_shading(object: &mut Object, pass: &FitPass) -> Result<()> {
    object.pipeline.set_shader(Phase::FitStep, shader(pass.shading, pass.quality));
    // The published formulas are for comparison and include neither shadows nor interreflection.
    object.set_shadows(Phase::FitStep, pass.shading == FitShading::Accurate, see_recovered_of_step())
}

/// The settings of a fit that goes on from `done`, with its shading put in.
fn options(object: &mut Object, pass: &FitPass, done: Done) -> Result<FitOptions> {
    let scene = object.scene();
    set_shading(object, pass)?;
    Ok(FitOptions {
        loss: pass.loss,
        steps: pass.steps,
        done,
        batch: pass.batch as usize,
        early: if pass.vertices { 1.0 } else { EARLY },
        rates: [pass.rates.albedo, pass.rates.light, pass.rates.specular],
        milestones: pass.milestones.clone(),
        decay: pass.decay,
        unknowns: object.unknowns(),
        pixels: PixelChoice { seed: scene.seed, max_pixels: pass.max_pixels as usize, evenly: true },
        keeps_pool: true,
        initialize: object.found().initialize,
        looks_for_sheen: scene.material.sheen == Sheen::Auto,
        exposure: pass.exposure,
        measures: true,
        scale: scene.scale,
        light_frame: scene.light_frame.frame(&scene.light),
    })
}

/// Triplets of values that hold the blend weights of a texel.
const WEIGHT_TRIPLETS: usize = MAX_SPECULAR_LOBES.div_ceil(3);

/// Blend weights as `carried` changes triplets of values, or carries them from one atlas to
/// another.
pub(crate) fn carried_blends(
    of: &[SpecularBlend],
    carried: &dyn Fn(&[Vec3]) -> Vec<Vec3>,
) -> Vec<SpecularBlend> {
    let weight = |blend: &SpecularBlend, k: usize| blend.0.get(k).copied().unwrap_or(0.0);
    let triplets: [Vec<Vec3>; WEIGHT_TRIPLETS] = std::array::from_fn(|t| {
        let triplet = |blend: &SpecularBlend| Vec3::from_array([0, 1, 2].map(|c| weight(blend, 3 * t + c)));
        carried(&of.iter().map(triplet).collect::<Vec<_>>())
    });
    let count = triplets[0].len();
    (0..count).map(|i| SpecularBlend(std::array::from_fn(|k| triplets[k / 3][i][k % 3]))).collect()
}

/// Fills the texels that no view sees from their neighbors; returns the number of covered texels
/// among them.
fn fill_texels(object: &mut Object) -> Result<usize> {
    let (unknowns, surface) = (object.unknowns(), object.surface());
    let (world, atlas) = (&mut object.pipeline.world, surface.atlas());
    let seen: Vec<bool> = read_column::<TexelIndex, TexelSeen>(world)?.iter().map(|s| s.0 > 1e-3).collect();
    if seen.len() != atlas.covered.len() || !seen.contains(&true) {
        return Ok(0);
    }
    let fill = |mut values: Vec<Vec3>| {
        fill_uncovered(&mut values, &seen, atlas);
        values
    };
    if unknowns.albedo {
        let albedo = with_columns::<TexelIndex, &mut Diffuse, _>(world, |mut texels| {
            let filled = |of: fn(&Diffuse) -> Vec3| fill(texels.iter().map(of).collect());
            let albedo = filled(|texel| texel.albedo);
            // Their albedo along the surface is that of their neighbors.
            let along = has_sheen(&texels).then(|| filled(Diffuse::along));
            let tilt = has_tilt(&texels).then(|| filled(|texel| texel.tilt));
            for (i, texel) in texels.iter_mut().enumerate() {
                texel.sheen = along.as_ref().map_or(texel.sheen, |along| along[i] - albedo[i]);
                texel.tilt = tilt.as_ref().map_or(texel.tilt, |tilt| tilt[i]);
            }
            Ok(albedo)
        })?;
        write_albedo(world, &albedo)?;
    }
    if unknowns.blends {
        let blends = read_column::<TexelIndex, SpecularBlend>(world)?;
        let filled = carried_blends(&blends, &|values| fill(values.to_vec()));
        write_column::<TexelIndex, SpecularBlend>(world, &filled)?;
    }
    let fitted = unknowns.albedo || unknowns.blends;
    let unseen = atlas.covered.iter().zip(&seen).filter(|(covered, seen)| **covered && !**seen);
    Ok(if fitted { unseen.count() } else { 0 })
}

/// Makes the texture as fine as the photographs, if it is not, and solves for its albedo, sheen and
/// tilt.
fn refine_texture(object: &mut Object, pass: &FitPass, options: &FitOptions) -> Result<()> {
    let _detail = info_span!("texture").entered();
    let start = Instant::now();
    let factor = factor_for(object);
    if factor > 1 {
        // Divides each texel into `factor`² texels of the same material.
        let coarse = object.surface();
        let (width, height) = (coarse.atlas().width, coarse.atlas().height);
        let surface = Arc::new(Surface::new(coarse.mesh().clone(), width * factor)?);
        let fine = [surface.atlas().width, surface.atlas().height];
        let center = |i: u32, size: u32| (i as f32 + 0.5) / size as f32;
        let place = |i: u32| Vec2::new(center(i % fine[0], fine[0]), center(i / fine[0], fine[1]));
        let from = (0..fine[0] * fine[1]).map(|i| address(place(i), width, height));
        divide_texels(&mut object.pipeline.world, &from.collect::<Vec<_>>())?;
        replace_surface(&mut object.pipeline.world, surface);
    }
    object.pipeline.set_shader(Phase::Detail, shader(pass.shading, pass.quality));
    let shadows = see_recovered();
    object.set_shadows(Phase::Detail, pass.shading == FitShading::Accurate, shadows)?;
    let tilt = object.scene().material.tilt == Tilt::Unknown;
    let bar = object.progress().bar(&pass.name, 100);
    bar.set_message("texture".into());
    let settings = DetailOptions { tilt, metal: options.unknowns.metal };
    solve_detail(&mut object.pipeline, settings, &mut |done| bar.set_position((100.0 * done) as u64))?;
    drop(bar);
    let (side, seconds) = (object.surface().atlas().width, start.elapsed().as_secs_f64());
    object.print(&format!("{}: texture of {side}² texels from all pixels in {seconds:.1} s", pass.name));
    object.scores().add_fit_secs(seconds);
    Ok(())
}

/// The whole factor that makes a texel about a pixel wide in the median training photograph, as far
/// as [`finest_side`] lets it.
fn factor_for(object: &mut Object) -> u32 {
    let (middle, _) = object.surface().bounding_sphere();
    let world = &mut object.pipeline.world;
    let mut views = world.query_filtered::<(&Camera, &Split), With<Photograph>>();
    let training = views.iter(world).filter(|(_, split)| **split == Split::Train);
    let pixel = |(camera, _): (&Camera, _)| camera.position().distance(middle) / camera.focal[0];
    let mut pixels: Vec<f32> = training.map(pixel).collect();
    let Some(pixel) = median(&mut pixels) else { return 1 };
    let pixels = visited_pixels(world);
    let surface = object.surface();
    let atlas = surface.atlas();
    let side = atlas.width.max(atlas.height).max(1);
    let most = finest_side(pixels as f64) as u32 / side;
    // A cast of what is not a number is 0.
    ((atlas.texel_size() / pixel).round() as u32).min(most).max(1)
}

/// Replaces the texels by texels whose material is that of the old ones at these places: diffuse
/// between them, the rest of the nearest.
fn divide_texels(world: &mut World, from: &[TexelAddress]) -> Result<()> {
    let diffuse = read_column::<TexelIndex, Diffuse>(world)?;
    let blends = read_column::<TexelIndex, SpecularBlend>(world)?;
    let seen = read_column::<TexelIndex, TexelSeen>(world)?;
    let gloss = read_column::<TexelIndex, TexelRoughness>(world).ok();
    let nearest = |address: &TexelAddress| {
        let most = (0..4).max_by(|a, b| address.weights[*a].total_cmp(&address.weights[*b])).unwrap_or(0);
        address.indices[most] as usize
    };
    if let Some(known) = world.get_resource::<KnownAlong>().map(|known| known.divided(from)) {
        world.insert_resource(known);
    }
    let old = texels_in_order(world);
    despawn_rows(world, &old);
    // With all their components at once: bevy would keep the room of a table that they leave.
    world.spawn_batch((0..).map(TexelIndex).zip(from).map(|(index, at)| {
        let diffuse = Diffuse::mixed(at, |texel| diffuse[texel]);
        (index, diffuse, blends[nearest(at)], seen[nearest(at)])
    }));
    if let Some(gloss) = gloss.filter(|gloss| !gloss.is_empty()) {
        for (texel, at) in texels_in_order(world).into_iter().zip(from) {
            world.entity_mut(texel).insert(gloss[nearest(at)]);
        }
    }
    Ok(())
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
    object: &mut Object,
    pass: &FitPass,
    options: &FitOptions,
    asked: Option<(u32, f64)>,
) -> Result<Steps> {
    let bar = object.progress().bar(&pass.name, 0);
    bar.set_message("first guess".into());
    // Where the texels are.
    let surface = object.surface();
    let atlas = surface.atlas();
    let place = |(at, covered): (&Vec3, &bool)| if *covered { *at } else { Vec3::NAN };
    let positions = atlas.position.iter().zip(&atlas.covered).map(place).collect();
    let places = TexelPlaces { positions, neighbors: atlas.neighbors(), progress: 0.0 };
    object.pipeline.world.insert_resource(places);
    let moves_cameras = pass.cameras != CameraUnknowns::Given;
    let moves_vertices = pass.vertices && !object.found().normals_found && !object.found().by_stereo;
    let world = &mut object.pipeline.world;
    world.insert_resource(pass.cameras);
    if moves_vertices {
        // Silhouettes are seen by the cameras as they are now.
        let seen = if moves_cameras { Vec::new() } else { training_silhouettes(world) };
        world.insert_resource(MovingMesh::new(surface.clone(), pass.steps, seen));
    }
    let is_still = !moves_cameras && !moves_vertices;
    let (mut error, mut psnr, mut ended) = (0.0, 0.0, Ended::Done);
    let (progress, mut told) = (object.progress(), Ok(()));
    let summary = run_fit(&mut object.pipeline, options, &mut |at, world| {
        bar.set_length(u64::from(at.steps));
        bar.set_position(u64::from(at.step));
        if at.step % LOG_EVERY == 0 || at.step == at.steps {
            bar.set_message(format!("{:.1} dB", at.sums.psnr()));
        }
        told = tell(&*progress, &pass.name, [at.step, at.steps], at, world);
        (error, psnr) = (at.sums.mean(), at.sums.psnr());
        if asked.is_some_and(|(step, enough)| step == at.step && psnr < enough) {
            ended = Ended::Doubted;
        } else if is_still && at.step < at.steps && may_pause(world, at.step) && is_due(world) {
            ended = Ended::Paused;
        }
        let is_over = ended != Ended::Done || is_stopping() || told.is_err();
        if is_over { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    });
    object.pipeline.world.remove_resource::<CameraUnknowns>();
    let moved = object.pipeline.world.remove_resource::<MovingMesh>().map(|mesh| mesh.surface);
    if let Some(moved) = moved.filter(|moved| !Arc::ptr_eq(moved, &object.surface())) {
        replace_surface(&mut object.pipeline.world, moved);
    }
    told?;
    let summary = summary?;
    // A stop leaves nothing to choose.
    if is_stopping() {
        ended = Ended::Done;
    }
    // The results so far are written.
    finish_stopping();
    check_parameters(&mut object.pipeline.world)?;
    let surface = object.surface();
    check_numbers("the surface's coordinate", surface.mesh().positions.iter().flat_map(|at| at.to_array()))?;
    Ok(Steps { summary, error, psnr, ended })
}

/// The mean absolute error of radiance over the last steps of a trial, and after how many it was
/// given up, if it was.
type Tried = (f64, Option<u32>);

/// Takes steps on trial, without a log and with geometry as it is. It is given up when it is
/// `hopeless` by their number, and by the error over enough pixels.
fn error_after(
    object: &mut Object,
    options: &FitOptions,
    title: &str,
    steps: u32,
    hopeless: impl Fn(u32, f64) -> bool,
) -> Result<Tried> {
    let (mut error, mut given_up) = (f64::INFINITY, None);
    let tells = options.early * options.batch as f32 >= TELLING_PIXELS;
    forget_shadows(&mut object.pipeline.world);
    let bar = object.progress().bar(title, 0);
    bar.set_message("first guess".into());
    run_fit(&mut object.pipeline, options, &mut |at: &FitProgress, _| {
        let step = at.step - options.done.steps;
        bar.set_length(u64::from(steps));
        bar.set_position(u64::from(step));
        error = at.sums.mean();
        given_up = (tells && step < steps && hopeless(step, error)).then_some(step);
        let is_over = step == steps || given_up.is_some() || is_stopping();
        if is_over { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    })?;
    Ok((error, given_up))
}

/// Makes the next step find shadows and reflected light anew, as one that goes on from a checkpoint
/// does.
fn forget_shadows(world: &mut World) {
    if let Some(traced) = world.get_resource::<ObjectVisibility>() {
        let unlit = traced.unlit();
        world.insert_resource(unlit);
    }
}

/// Logs and tells of a step, and asks the work of this thread to stop if that is the answer.
pub(super) fn tell(
    to: &dyn Progress,
    pass: &str,
    [step, steps]: [u32; 2],
    fit: &FitProgress,
    world: &mut World,
) -> Result<()> {
    log_step(world, [step, steps], fit);
    if to.step(&Step { pass, step, steps, fit }, world)?.is_break() {
        stop_this_work();
    }
    Ok(())
}

/// Adds a line to the log, if one is due after a step.
fn log_step(world: &mut World, [step, steps]: [u32; 2], at: &FitProgress) {
    if !step.is_multiple_of(LOG_EVERY) && step != steps {
        return;
    }
    let Vec3 { x: r, y: g, z: b } = at.specular.albedo;
    let (secs, loss, psnr) = (at.elapsed_secs, at.sums.mean(), at.sums.psnr());
    // Writing to a String cannot fail.
    let _ = writeln!(
        world.resource_mut::<StepLog>().0,
        "{step},{secs:.3},{loss:.6},{psnr:.3},{r:.4},{g:.4},{b:.4},{:.4},{}",
        at.specular.roughness,
        at.lobes
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
