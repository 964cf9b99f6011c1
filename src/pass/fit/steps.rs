//! The steps of a `Fit`: its settings, its log, and the geometry that moves with it.

use crate::pass::run::{progress::Moment, session::Session};
use crate::scene::{FitPass, FitShading, Sheen};
use bevy_ecs::prelude::{Resource, World};
use glam::Vec3;
use lobelia_geometry::error::{Result, stop::finish_stopping, stop::is_stopping};
use lobelia_sg::{accurate::Quality, shading::ClosedForm};
use lobelia_solve::fit::cameras::{CameraPlugin, CameraUnknowns};
use lobelia_solve::fit::groups::{forget_group_shadows, forget_visibility};
use lobelia_solve::fit::guard::{check_numbers, check_parameters};
use lobelia_solve::fit::run::{Done, EARLY, FitOptions, FitProgress, FitSummary, may_pause, run_fit};
use lobelia_solve::shape::{run::training_silhouettes, vertices::MovingMesh, vertices::VertexPlugin};
use lobelia_solve::{fit::observe::PixelChoice, fit::roughness::TexelPlaces, visibility::ObjectVisibility};
use lobelia_world::checkpoint::{Span, is_due, keep_resource};
use serde::{Deserialize, Serialize};
use std::fmt::Write as _;
use std::{ops::ControlFlow, sync::Arc};

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

/// The closed form for the settings of a scene file.
pub fn closed_form(shading: FitShading, quality: Quality) -> ClosedForm {
    match shading {
        FitShading::Accurate => ClosedForm::Accurate(quality),
        FitShading::Published => ClosedForm::Published,
    }
}

/// The settings of a fit that goes on from `done`.
pub(super) fn options(session: &mut Session, pass: &FitPass, done: Done) -> Result<FitOptions> {
    Ok(FitOptions {
        loss: pass.loss,
        form: closed_form(pass.shading, pass.quality),
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
        // The published formulas are for comparison and include neither shadows nor interreflection.
        visibility: pass.shading == FitShading::Accurate && session.has_visibility()?,
        looks_for_sheen: session.scene.material.sheen == Sheen::Auto,
        exposure: pass.exposure,
        measures: true,
        scale: session.scene.scale,
        light_frame: session.light_frame(),
    })
}

/// Why steps of a fit ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Ended {
    /// All are done, or the run is stopped.
    Done,
    /// Too little is explained at the step that was asked about.
    Doubted,
    /// A checkpoint is due.
    Paused,
}

/// The result of some steps of a fit.
pub(super) struct Steps {
    pub summary: FitSummary,
    /// Mean absolute error of radiance over the last of them.
    pub error: f64,
    /// PSNR of linear radiance over the last of them, in dB.
    pub psnr: f64,
    pub ended: Ended,
}

/// Takes steps of a fit; ends at the step that is `asked` about if the PSNR is below the given one there, and where a
/// checkpoint is due, if cameras and vertices stand still. What it has found is checked, and kept also if it is stopped.
pub(super) fn take_steps(
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
    // The systems that optimize cameras and vertices, if the pass enables them.
    let moves_cameras = pass.cameras != CameraUnknowns::Given;
    let moves_vertices = pass.vertices && !session.kept.placed.normals && !session.kept.placed.by_stereo;
    if moves_cameras {
        session.pipeline.add_plugin(&CameraPlugin(pass.cameras));
    }
    if moves_vertices {
        let (surface, steps) = (session.surface.clone(), pass.steps);
        // Silhouettes are seen by the cameras as they are now.
        let seen = if moves_cameras { Vec::new() } else { training_silhouettes(&mut session.pipeline.world) };
        session.pipeline.add_plugin(&VertexPlugin { surface, steps, silhouettes: seen.into() });
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
    session.pipeline.remove_plugin::<CameraPlugin>();
    let moved = session.pipeline.world.get_resource::<MovingMesh>().map(|mesh| mesh.surface.clone());
    session.pipeline.remove_plugin::<VertexPlugin>();
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

/// The mean absolute error of radiance over the last steps of a trial, and after how many it was given up, if it was.
pub(super) type Tried = (f64, Option<u32>);

/// Takes steps on trial, without a log and with geometry as it is. It is given up when it is `hopeless` by their number, and by the
/// error over enough pixels.
pub(super) fn error_after(
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

/// Makes the next step find shadows and reflected light anew, as one that goes on from a checkpoint does.
pub(super) fn forget_shadows(world: &mut World) {
    if let Some(traced) = world.get_resource::<ObjectVisibility>() {
        let unlit = traced.unlit();
        world.insert_resource(unlit);
    }
    forget_group_shadows(world);
}

/// Adds a line to a log: `step` of a `Fit` or `Shape`.
pub(crate) fn log_line(log: &mut String, step: u32, at: &FitProgress) {
    let s = at.specular;
    // Writing to a String cannot fail.
    let _ = writeln!(
        log,
        "{step},{:.3},{:.6},{:.3},{:.4},{:.4},{:.4},{:.4},{}",
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
