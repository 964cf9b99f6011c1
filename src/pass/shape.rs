//! The `Shape` pass: recovers an unknown surface from photographs and masks, and replaces the visual hull by it.

use crate::error::stop::{finish_stopping, is_stopping};
use crate::error::{Error, Result};
use crate::fit::components::Unknowns;
use crate::fit::exposure::{ExposureChoice, Exposures};
use crate::fit::groups::forget_visibility;
use crate::fit::guard::{check_numbers, check_parameters};
use crate::fit::observe::PixelChoice;
use crate::fit::roughness::blend::TexelPlaces;
use crate::fit::run::{Done, FitOptions, Initialize};
use crate::fit::scale::{ScaleRule, start_scale};
use crate::material::recovered_albedo;
use crate::math::accurate::Quality;
use crate::mesh::Surface;
use crate::mesh::atlas::unwrap_mesh;
use crate::mesh::triangles::Mesh;
use crate::pass::found_views;
use crate::pass::inspect::ShapeInspector;
use crate::pass::live::Snapshot;
use crate::pass::progress::{Bar, Moment, Progress};
use crate::pass::renew::renew;
use crate::pass::session::{Placed, Session};
use crate::pass::steps::closed_form;
use crate::profile::stage;
use crate::sample::point::Scenery;
use crate::scene::Surface as SurfaceSpec;
use crate::scene::{GridLevel, ShapePass};
use crate::sdf::volume::SdfSurface;
use crate::shape::field::{ModelError, SdfField};
use crate::shape::mirror::rounds as mirror_rounds;
use crate::shape::run::refine::{refine_by_mirror, refine_by_outlines, refine_by_stereo};
use crate::shape::run::{
    HullReport, ShapeLevel, ShapeOptions, ShapeProgress, fit_shape, mesh_of_parts, replace_texels,
};
use crate::shape::stereo::ROUNDS as STEREO_ROUNDS;
use crate::shape::systems::ShapeSchedule;
use crate::spawn::insert_known_along;
use crate::view::AlbedoMap;
use crate::view::Camera;
use bevy_ecs::prelude::World;
use glam::Vec3;
use std::ops::ControlFlow;
use std::sync::Arc;
use std::time::Instant;

/// Steps between two redistancings.
const REDISTANCE_EVERY: u32 = 40;
/// Part of the surface that follows stereo from which on a fit does not move vertices: photographs that agree place them better than shading.
const STEREO_HOLDS: f32 = 0.3;

/// Most texels a side that a texture is made wider to.
const MOST_TEXELS: u32 = 4096;

/// Runs the pass.
///
/// # Errors
/// If the surface of the scene is not unknown, the masks have no hull, or a fit fails.
pub(crate) fn run(session: &mut Session, pass: &ShapePass) -> Result<()> {
    let SurfaceSpec::Unknown { texture_size, .. } = session.scene.surface else {
        return Err(Error::run(
            &pass.name,
            "the surface is given: a `Shape` pass needs `surface: Unknown()`",
        ));
    };
    let start = Instant::now();
    // Base materials have equal weights until the shape is recovered.
    session.pipeline.world.insert_resource(TexelPlaces::default());
    let (surface, mut stopped) = fit(session, pass)?;
    if stopped {
        finish_stopping();
    }
    session.report_light_frame(&pass.name);
    session.report_placements(&pass.name);
    session.report_communication(&pass.name);
    if !stopped {
        // The pools of the fit would be there beside the photographs as stereo compares them.
        renew(session)?;
    }
    stopped |= take_over(session, pass, surface, texture_size, stopped)?;
    let elapsed = start.elapsed().as_secs_f64();
    session.scores.fit_secs = Some(session.scores.fit_secs.unwrap_or(0.0) + elapsed);
    let triangles = session.surface.mesh().triangles.len();
    session.progress.print(&format!("{}: {triangles} triangles in {elapsed:.1} s", pass.name));
    found_views::write(session, &pass.name, pass.cameras)?;
    if stopped { Err(Error::Interrupted) } else { Ok(()) }
}

/// Fits the shape, with a bar and a look at it now and then. Returns the surface that was found, and whether the run was stopped before the end.
fn fit(session: &mut Session, pass: &ShapePass) -> Result<(SdfSurface, bool)> {
    let options = options(session, pass);
    // How many levels there are is known once the hull is.
    let bar = session.progress.bar(&pass.name, 0);
    bar.set_message("hull".into());
    let inspector = session.debug_every.map(|every| inspector(session, &pass.name, every));
    let (mut failure, mut stopped, mut told) = (None, false, HullReport::default());
    let (hull, up, progress) = (session.surface.clone(), session.scene.up, session.progress);
    let surface =
        fit_shape(&mut session.pipeline, &options, &mut |at: &ShapeProgress, world: &mut World| {
            tell_of_hull(progress, &pass.name, &mut told, at.hull);
            let step = show_step(&*bar, pass, at);
            let moment = Moment::Step { level: [at.level, at.levels], step, fit: at.fit };
            progress.look(moment, &mut |before| Snapshot::copy(world, &hull, up, before));
            if let Some(inspector) =
                inspector.as_ref().filter(|inspector| at.fit.step.is_multiple_of(inspector.every))
            {
                failure = inspector.look(&world.resource::<SdfField>().surface, step[0]).err();
            }
            stopped |= failure.is_some() || is_stopping();
            if stopped { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        })?;
    bar.finish_and_clear();
    failure.map_or(Ok(()), Err)?;
    Ok((surface, stopped))
}

/// Shows a step of the fit on the bar; returns its number among those of all levels, and how many these are.
fn show_step(bar: &dyn Bar, pass: &ShapePass, at: &ShapeProgress) -> [u32; 2] {
    let steps = |levels: &[GridLevel]| -> u32 { levels.iter().map(|level| level.steps).sum() };
    let (step, all) = (steps(&pass.levels[..at.level]) + at.fit.step, steps(&pass.levels[..at.levels]));
    bar.set_length(u64::from(all));
    bar.set_position(u64::from(step));
    if at.fit.step.is_multiple_of(20) {
        bar.set_message(format!("{:.1} dB", at.fit.sums.psnr()));
    }
    [step, all]
}

/// Replaces the hull by the surface that was found. What was found is put in place even if the run is `stopped`; returns whether it is by
/// now.
fn take_over(
    session: &mut Session,
    pass: &ShapePass,
    mut found: SdfSurface,
    texture_size: u32,
    stopped: bool,
) -> Result<bool> {
    let initialized = std::mem::replace(&mut session.initialize, Initialize::NONE);
    session.placed = Placed::default();
    check_parameters(&mut session.pipeline.world)?;
    check_numbers("the value of the field at point", found.grid.values.iter().copied())?;
    if !stopped {
        match_outlines(session, &pass.name, &mut found)?;
    }
    let mesh = found_mesh(session, pass, &found, stopped)?;
    check_numbers("the surface's coordinate", mesh.positions.iter().flat_map(|at| at.to_array()))?;
    let stopped = is_stopping();
    finish_stopping();
    put_in_place(session, &found, &mesh, texture_size)?;
    if session.placed.normals {
        // With them highlights are sharper than light and lobe are by now: a fit finds these anew.
        session.initialize = initialized;
    } else if initialized.light && initialized.albedo && !AlbedoMap::are_in(&mut session.pipeline.world) {
        // The light still has the color from the initialization with gray albedo.
        start_scale(&mut session.pipeline.world, session.scene.scale)?;
    }
    Ok(stopped)
}

/// The mesh of the surface that was found, moved by stereo and with the normals of what it mirrors, as far as that is wanted and the run was not stopped.
fn found_mesh(session: &mut Session, pass: &ShapePass, surface: &SdfSurface, stopped: bool) -> Result<Mesh> {
    let mut mesh = mesh_of_parts(&mut session.pipeline.world, &surface.grid);
    if pass.stereo && !stopped && !is_stopping() {
        session.placed.by_stereo = match_views(session, &pass.name, &mut mesh)?;
    } else {
        session.pipeline.world.remove_resource::<ModelError>();
    }
    // Colors of different exposures, or lights, are no reflections.
    let differ = exposures_differ(session) || !session.scene.views.other_lights().is_empty();
    if pass.normals && !differ && !stopped && !is_stopping() {
        session.placed.normals = match_reflections(session, &pass.name, &mut mesh)?;
    }
    Ok(mesh)
}

/// Whether photographs have exposures of their own, as far as it is known by now.
fn exposures_differ(session: &Session) -> bool {
    session.pipeline.world.get_resource::<Exposures>().is_some_and(Exposures::are_unknown)
}

/// An inspector with the camera of the first view.
fn inspector(session: &mut Session, name: &str, every: u32) -> ShapeInspector {
    let folder = session.folder(name).join("debug");
    let world = &mut session.pipeline.world;
    let camera = world.query::<&Camera>().iter(world).next().copied();
    ShapeInspector { every, folder, camera }
}

fn options(session: &Session, pass: &ShapePass) -> ShapeOptions {
    ShapeOptions {
        levels: pass.levels.iter().map(|level| shape_level(pass, level)).collect(),
        fit: FitOptions {
            loss: pass.loss,
            form: closed_form(pass.shading, Quality::Default),
            steps: 1,
            done: Done::default(),
            asked_after: None,
            batch: pass.batch as usize,
            early: 1.0,
            rates: [pass.rates.albedo, pass.rates.light, pass.rates.specular],
            milestones: vec![0.6, 0.85],
            decay: 0.4,
            // While the surface moves, its normals would take part in a sheen.
            unknowns: Unknowns { sheen: false, ..session.unknowns() },
            pixels: PixelChoice {
                seed: session.scene.seed,
                max_pixels: pass.max_pixels as usize,
                evenly: false,
            },
            keeps_pool: false,
            initialize: session.initialize,
            // Visibility of a moving surface would have to be traced at every step.
            visibility: false,
            looks_for_sheen: false,
            exposure: pass.exposure,
            measures: false,
            // Without shadows, dark regions would bias the color of the highlights.
            scale: ScaleRule::Free,
            light_frame: session.light_frame(),
        },
        cameras: pass.cameras,
        // Colors of different exposures tell nothing of depth.
        hollows: pass.hollows && matches!(pass.exposure, ExposureChoice::Auto | ExposureChoice::Equal),
        spans_unseen: pass.spans_unseen,
    }
}

fn shape_level(pass: &ShapePass, level: &GridLevel) -> ShapeLevel {
    ShapeLevel {
        cells: level.cells,
        texel_cells: level.texel_cells,
        least_pixels: level.pixels,
        schedule: ShapeSchedule {
            steps: level.steps,
            hold: level.hold,
            rates: level.rates,
            silhouette: pass.silhouette,
            silhouette_batch: pass.silhouette_batch as usize,
            smoothness: pass.smoothness,
            blur: pass.blur,
            redistance_every: REDISTANCE_EVERY,
        },
    }
}

/// Says how much was removed from the hull since it was `told`, where that can be seen; then all of it is `told`.
fn tell_of_hull(progress: &dyn Progress, name: &str, told: &mut HullReport, now: HullReport) {
    let before = std::mem::replace(told, now);
    if before == now {
        return;
    }
    let shares = |parts: &[(f32, &str)]| {
        let seen = parts.iter().filter(|(share, _)| *share >= 0.0005);
        let words: Vec<String> =
            seen.map(|(share, what)| format!("{:.1} % that {what}", 100.0 * share)).collect();
        (!words.is_empty()).then(|| words.join(", and "))
    };
    const THROUGH: &str = "photographs look through";
    if before.opened_again != now.opened_again {
        if let Some(share) = shares(&[(now.opened_again, THROUGH)]) {
            progress.print(&format!("{name}: first level without {share}"));
        }
    } else if let Some(shares) = shares(&[(now.opened, THROUGH), (now.spanned, "no photograph sees")]) {
        progress.print(&format!("{name}: hull without {shares}"));
    }
}

/// Moves the contours of the field to the outlines of the masks, and says what came of it.
fn match_outlines(session: &mut Session, name: &str, surface: &mut SdfSurface) -> Result<()> {
    let start = Instant::now();
    let _matching = stage("outlines");
    let bar = session.progress.bar(name, 0);
    bar.set_message("outlines".into());
    let report = refine_by_outlines(&mut session.pipeline.world, surface)?;
    let seconds = start.elapsed().as_secs_f64();
    let found = format!("{:.2} pixels off before, {:.2} after", report.before, report.after);
    bar.finish_and_clear();
    session.progress.print(&format!("{name}: outlines in {seconds:.1} s, {found}"));
    Ok(())
}

/// Moves the mesh to where neighboring photographs agree; says what came of it and returns whether vertices then stay there.
fn match_views(session: &mut Session, name: &str, mesh: &mut Mesh) -> Result<bool> {
    let start = Instant::now();
    let _matching = stage("stereo");
    let bar = session.progress.bar(name, STEREO_ROUNDS.len() as u64);
    let report = refine_by_stereo(&mut session.pipeline.world, mesh, |round| {
        bar.set_position(round as u64);
        bar.set_message("stereo".into());
        if is_stopping() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    })?;
    bar.finish_and_clear();
    if is_stopping() {
        return Ok(false);
    }
    let seconds = start.elapsed().as_secs_f64();
    let holds = report.moved > 0.0 && report.trusted >= STEREO_HOLDS;
    let held = if holds { "; from here on vertices do not move" } else { "" };
    let found = if report.moved > 0.0 {
        format!("{:.0} % of the surface follows it{held}", 100.0 * report.trusted)
    } else {
        "it adds nothing to the shading here".into()
    };
    session.progress.print(&format!("{name}: stereo in {seconds:.1} s, {found}"));
    Ok(holds)
}

/// Gives the vertices the normals that explain what they mirror, if that is worth it; says what came of it and returns whether it was.
fn match_reflections(session: &mut Session, name: &str, mesh: &mut Mesh) -> Result<bool> {
    let start = Instant::now();
    let _matching = stage("normals");
    let bar = session.progress.bar(name, mirror_rounds() as u64);
    let report = refine_by_mirror(&mut session.pipeline.world, mesh, |round| {
        bar.set_position(round as u64);
        bar.set_message("normals".into());
        if is_stopping() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    })?;
    bar.finish_and_clear();
    if is_stopping() {
        return Ok(false);
    }
    let is_used = report.turned_degrees > 0.0;
    let found = match report.error.map(|error| 100.0 * error) {
        Some(error) if is_used => format!(
            "turned by {:.1}° (median), {error:.0} % of the error in photographs kept aside; from here on vertices do not move",
            report.turned_degrees
        ),
        Some(error) => {
            format!("those of the mesh are kept: {error:.0} % of the error in photographs kept aside")
        }
        None => format!("those of the mesh explain {:.0} %", 100.0 * (1.0 - report.unexplained)),
    };
    let seconds = start.elapsed().as_secs_f64();
    session.progress.print(&format!("{name}: normals by reflections in {seconds:.1} s, {found}"));
    Ok(is_used)
}

/// Gives the mesh texture coordinates for `texture_size` texels a side, or for more if its charts do not fit: what was found is not lost
/// for that.
///
/// # Errors
/// If they do not fit the largest texture either.
fn unwrap_within(mesh: &Mesh, texture_size: u32) -> Result<(Mesh, u32)> {
    unwrap_by(texture_size, |size| unwrap_mesh(mesh, size).map(|unwrapped| unwrapped.mesh))
}

fn unwrap_by(texture_size: u32, mut unwrap: impl FnMut(u32) -> Result<Mesh>) -> Result<(Mesh, u32)> {
    let mut size = texture_size;
    loop {
        match unwrap(size) {
            Ok(mesh) => return Ok((mesh, size)),
            // What was found is not lost for a signal.
            Err(Error::Interrupted) if is_stopping() => finish_stopping(),
            // No other error goes away with a larger texture.
            Err(Error::Usage { .. }) if 2 * size <= MOST_TEXELS => size *= 2,
            Err(error) => return Err(error),
        }
    }
}

/// Gives the mesh an atlas, and transfers the texels.
fn put_in_place(session: &mut Session, found: &SdfSurface, mesh: &Mesh, texture_size: u32) -> Result<()> {
    let _placing = stage("mesh unwrapped");
    let (mesh, wider) = unwrap_within(mesh, texture_size)?;
    if wider > texture_size {
        session.progress.note(&format!(
            "the surface that was found does not fit a texture of {texture_size}² texels: it gets {wider}²"
        ));
    }
    let surface = Arc::new(Surface::new(mesh, wider)?);
    let world = &mut session.pipeline.world;
    let volume = recovered_albedo(world)?;
    let atlas = surface.atlas();
    let carried = |(at, covered): (&Vec3, &bool)| {
        let address = covered.then(|| found.volume.nearest_address(*at)).flatten();
        address.map_or(Vec3::splat(0.4), |address| address.blend(&volume))
    };
    let albedo: Vec<Vec3> = atlas.position.iter().zip(&atlas.covered).map(carried).collect();
    insert_known_along(world, &session.scene.material.sheen, &surface)?;
    replace_texels(world, &albedo);
    world.insert_resource(Scenery(surface.clone()));
    forget_visibility(world);
    session.surface = surface;
    (session.surface_found, session.has_object) = (true, true);
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::primitive::box_mesh;

    #[test]
    fn a_texture_that_is_too_small_for_what_was_found_is_made_wider() {
        // Every box is a chart at least, and no chart takes less than a texel.
        let mut mesh = Mesh::default();
        for i in 0..60 {
            let part = box_mesh(3.0 * Vec3::X * i as f32, Vec3::ONE).unwrap();
            let first = mesh.positions.len() as u32;
            mesh.triangles.extend(part.triangles.iter().map(|corners| corners.map(|corner| corner + first)));
            mesh.positions.extend(part.positions);
            mesh.normals.extend(part.normals);
        }
        assert!(unwrap_mesh(&mesh, 8).is_err());
        let (unwrapped, size) = unwrap_within(&mesh, 8).unwrap();
        assert!(size > 8 && size <= 512 && unwrapped.uvs.is_some(), "{size}");
        assert_eq!(unwrap_within(&box_mesh(Vec3::ZERO, Vec3::ONE).unwrap(), 64).unwrap().1, 64);
    }

    #[test]
    fn an_error_that_no_texture_mends_is_told_as_it_is() {
        let mut mesh = box_mesh(Vec3::ZERO, Vec3::ONE).unwrap();
        mesh.uvs = None;
        mesh.positions[3].x = f32::NAN;
        let mut tried = Vec::new();
        let error = unwrap_by(64, |size| {
            tried.push(size);
            unwrap_mesh(&mesh, size).map(|unwrapped| unwrapped.mesh)
        });
        assert!(error.unwrap_err().to_string().contains("vertex 3 is not finite"));
        assert_eq!(tried, [64]);
    }
}
