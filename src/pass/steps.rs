//! The steps of a `Fit`: its settings, its log, and the geometry that moves with it.

use crate::checkpoint::{Span, keep_resource};
use crate::error::Result;
use crate::error::stop::{finish_stopping, is_stopping};
use crate::fit::cameras::{CameraPlugin, CameraUnknowns};
use crate::fit::groups::{forget_group_shadows, forget_visibility};
use crate::fit::guard::{check_numbers, check_parameters};
use crate::fit::observe::PixelChoice;
use crate::fit::roughness::blend::TexelPlaces;
use crate::fit::run::{Done, FitOptions, FitProgress, FitSummary, run_fit};
use crate::fit::schedule::EARLY;
use crate::math::accurate::Quality;
use crate::math::shading::ClosedForm;
use crate::pass::live::Snapshot;
use crate::pass::progress::Moment;
use crate::pass::session::Session;
use crate::scene::{FitPass, FitShading, Sheen};
use crate::shape::run::training::training_silhouettes;
use crate::shape::vertices::{MovingMesh, VertexPlugin};
use crate::visibility::ObjectVisibility;
use bevy_ecs::prelude::{Resource, World};
use glam::Vec3;
use serde::{Deserialize, Serialize};
use std::fmt::Write as _;
use std::ops::ControlFlow;
use std::sync::Arc;

/// Pixels of a step from which the error of twenty tells that a trial is hopeless.
const TELLING_PIXELS: f32 = 500.0;
/// Steps between two lines of the log.
const LOG_EVERY: u32 = 20;

/// The text of `log.csv`.
#[derive(Resource, Serialize, Deserialize)]
struct FitLog(String);

const COLUMNS: &str = "step,elapsed_secs,loss,psnr,specular_r,specular_g,specular_b,roughness,lobes\n";

/// Begins the log, also again: without the steps of what has been given up.
pub(super) fn begin_log(world: &mut World) {
    keep_resource::<FitLog>(world, Span::Pass);
    world.insert_resource(FitLog(COLUMNS.into()));
}

/// The text of the log, which is then gone.
pub(super) fn take_log(world: &mut World) -> String {
    world.remove_resource::<FitLog>().map_or_else(|| COLUMNS.into(), |log| log.0)
}

/// The closed form for the settings of a scene file.
pub fn closed_form(shading: FitShading, quality: Quality) -> ClosedForm {
    match shading {
        FitShading::Accurate => ClosedForm::Accurate(quality),
        FitShading::Published => ClosedForm::Published,
    }
}

/// The settings of a fit that goes on from `done`.
///
/// # Errors
/// If shadows would take too much memory, or it is stopped while they are traced.
pub(super) fn options(session: &mut Session, pass: &FitPass, done: Done) -> Result<FitOptions> {
    Ok(FitOptions {
        loss: pass.loss,
        form: closed_form(pass.shading, pass.quality),
        steps: pass.steps,
        done,
        asked_after: None,
        batch: pass.batch as usize,
        early: if pass.vertices { 1.0 } else { EARLY },
        rates: [pass.rates.albedo, pass.rates.light, pass.rates.specular],
        milestones: pass.milestones.clone(),
        decay: pass.decay,
        unknowns: session.unknowns(),
        pixels: PixelChoice { seed: session.scene.seed, max_pixels: pass.max_pixels as usize, evenly: true },
        keeps_pool: true,
        initialize: session.initialize,
        // The published formulas are for comparison and include neither shadows nor interreflection.
        visibility: pass.shading == FitShading::Accurate && session.has_visibility()?,
        looks_for_sheen: session.scene.material.sheen == Sheen::Auto,
        exposure: pass.exposure,
        measures: true,
        scale: session.scene.scale,
        light_frame: session.light_frame(),
    })
}

/// What steps of a fit have come to.
pub(super) struct Steps {
    /// Of these steps.
    pub summary: FitSummary,
    /// Mean absolute error of radiance over the last of them.
    pub error: f64,
    /// PSNR of linear radiance over the last of them, in dB.
    pub psnr: f64,
    /// Whether they ended at the step that was asked about, with too little explained there.
    pub doubted: bool,
}

/// Takes steps of a fit; ends at the step that [`FitOptions::asked_after`] names if the PSNR is below `enough` there. What it has found is
/// checked, and kept also if it is stopped.
///
/// # Errors
/// If there are no pixels to fit to, or a system fails.
pub(super) fn take_steps(
    session: &mut Session,
    pass: &FitPass,
    options: &FitOptions,
    enough: f64,
) -> Result<Steps> {
    let bar = session.progress.bar(&pass.name, 0);
    bar.set_message("first guess".into());
    place_texels(session);
    let_geometry_move(session, pass);
    let (mut error, mut psnr, mut doubted) = (0.0, 0.0, false);
    let (surface, up, progress) = (session.surface.clone(), session.scene.up, session.progress);
    let summary = run_fit(&mut session.pipeline, options, &mut |at, world| {
        bar.set_length(u64::from(at.steps));
        bar.set_position(u64::from(at.step));
        if at.step % LOG_EVERY == 0 || at.step == at.steps {
            bar.set_message(format!("{:.1} dB", at.sums.psnr()));
            log_line(&mut world.resource_mut::<FitLog>().0, at);
        }
        let moment = Moment::Step { level: [0, 1], step: [at.step, at.steps], fit: at };
        progress.look(moment, &mut |before| Snapshot::copy(world, &surface, up, before));
        (error, psnr) = (at.sums.mean(), at.sums.psnr());
        doubted = options.asked_after == Some(at.step) && psnr < enough;
        if doubted || is_stopping() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    });
    hold_geometry(session);
    let summary = summary?;
    // A stop leaves nothing to choose.
    doubted &= !is_stopping();
    // The results so far are written.
    finish_stopping();
    check_parameters(&mut session.pipeline.world)?;
    check_numbers(
        "the surface's coordinate",
        session.surface.mesh().positions.iter().flat_map(|at| at.to_array()),
    )?;
    bar.finish_and_clear();
    Ok(Steps { summary, error, psnr, doubted })
}

/// Takes steps on trial, without a log and with geometry as it is; returns the mean absolute error of radiance over the last of them, and after how
/// many the trial was given up, if it was: it is when it is `hopeless` by their number, and by that error over enough pixels.
///
/// # Errors
/// Those of [`run_fit`].
pub(super) fn error_after(
    session: &mut Session,
    options: &FitOptions,
    title: &str,
    steps: u32,
    hopeless: impl Fn(u32, f64) -> bool,
) -> Result<(f64, Option<u32>)> {
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

/// Makes the next step find shadows and reflected light anew, as one that goes on from a checkpoint does.
pub(super) fn forget_shadows(world: &mut World) {
    if let Some(traced) = world.get_resource::<ObjectVisibility>() {
        let unlit = traced.unlit();
        world.insert_resource(unlit);
    }
    forget_group_shadows(world);
}

/// Tells the fit where the texels are.
fn place_texels(session: &mut Session) {
    let atlas = session.surface.atlas();
    let place = |(at, covered): (&Vec3, &bool)| if *covered { *at } else { Vec3::NAN };
    let positions = atlas.position.iter().zip(&atlas.covered).map(place).collect();
    session.pipeline.world.insert_resource(TexelPlaces { positions, progress: 0.0 });
}

/// Swaps in the systems that optimize cameras and vertices, if the pass enables them.
fn let_geometry_move(session: &mut Session, pass: &FitPass) {
    if pass.cameras != CameraUnknowns::Given {
        session.pipeline.add_plugin(&CameraPlugin(pass.cameras));
    }
    if pass.vertices && !session.placed.holds_vertices() {
        let (surface, steps) = (session.surface.clone(), pass.steps);
        // Silhouettes are seen by the cameras as they are now.
        let still = pass.cameras == CameraUnknowns::Given;
        let silhouettes =
            if still { training_silhouettes(&mut session.pipeline.world) } else { Vec::new() }.into();
        session.pipeline.add_plugin(&VertexPlugin { surface, steps, silhouettes });
    }
}

/// Removes them again, and keeps the resulting mesh.
fn hold_geometry(session: &mut Session) {
    let pipeline = &mut session.pipeline;
    pipeline.remove_plugin::<CameraPlugin>();
    let moved = pipeline.world.get_resource::<MovingMesh>().map(|mesh| mesh.surface.clone());
    pipeline.remove_plugin::<VertexPlugin>();
    if let Some(moved) = moved.filter(|moved| !Arc::ptr_eq(moved, &session.surface)) {
        session.surface = moved;
        session.surface_found = true;
        // Visibility of the changed mesh is traced again when it is needed.
        forget_visibility(&mut session.pipeline.world);
    }
}

fn log_line(log: &mut String, at: &FitProgress) {
    let s = at.specular;
    // Writing to a String cannot fail.
    let _ = writeln!(
        log,
        "{},{:.3},{:.6},{:.3},{:.4},{:.4},{:.4},{:.4},{}",
        at.step,
        at.elapsed_secs,
        at.sums.mean(),
        at.sums.psnr(),
        s.albedo.x,
        s.albedo.y,
        s.albedo.z,
        s.roughness,
        at.lobes
    );
}
