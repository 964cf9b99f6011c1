//! The shape of an object: recovers an unknown surface from photographs and masks, and replaces the
//! visual hull by it.

use crate::object::{Object, fit::begin_log, fit::shader, fit::tell, replace_surface};
use crate::progress::Progress;
use crate::scene::{GridLevel, ShapePass, Surface as SurfaceSpec};
use crate::spawn::insert_known_along;
use bevy_ecs::prelude::World;
use glam::Vec3;
use lobelia_geometry::error::{
    Error, Result, stop::finish_stopping, stop::is_stopping, stop::was_asked_to_stop,
};
use lobelia_geometry::mesh::{Surface, atlas::unwrap_mesh, triangles::Mesh};
use lobelia_geometry::{sdf::volume::SdfSurface, view::AlbedoMap};
use lobelia_sg::accurate::Quality;
use lobelia_solve::fit::exposure::{ExposureChoice, Exposures};
use lobelia_solve::fit::guard::{check_numbers, check_parameters};
use lobelia_solve::fit::run::{FitOptions, Initialize};
use lobelia_solve::fit::scale::{ScaleRule, start_scale};
use lobelia_solve::fit::{observe::PixelChoice, roughness::TexelPlaces};
use lobelia_solve::shape::{
    field::ModelError, mirror::rounds as mirror_rounds, run::HullReport, run::ShapeLevel, run::ShapeOptions,
    run::ShapeProgress, run::fit_shape, run::refine_by_mirror, run::refine_by_outlines,
    run::refine_by_stereo, run::replace_texels, run::training_silhouettes, stereo::rounds as stereo_rounds,
};
use lobelia_solve::{fit::components::Unknowns, shape::hull::extract_parts, shape::systems::ShapeSchedule};
use lobelia_world::material::recovered_albedo;
use lobelia_world::pipeline::{Phase, Slot};
use std::{ops::ControlFlow, sync::Arc, time::Instant};
use tracing::info_span;

/// Steps between two redistancings.
const REDISTANCE_EVERY: u32 = 40;
/// Part of the surface that follows stereo from which on a fit does not move vertices: photographs
/// that agree place them better than shading.
const STEREO_HOLDS: f32 = 0.3;

/// Most texels a side that a texture is made wider to.
const MOST_TEXELS: u32 = 4096;

impl Object {
    /// Finds the surface, which takes the place of the visual hull, with light and material beside
    /// it. Returns whether it was stopped: what was found until then is kept, and refined no more.
    ///
    /// # Errors
    /// If the surface is not unknown, the masks have no hull, or a fit fails.
    pub(crate) fn find_shape(&mut self, pass: &ShapePass) -> Result<bool> {
        let (name, scene) = (&pass.name, self.scene());
        let SurfaceSpec::Unknown { texture_size, .. } = scene.surface else {
            return Err(Error::run(name, "the surface is given: a `Shape` pass needs `surface: Unknown()`"));
        };
        let start = Instant::now();
        begin_log(&mut self.pipeline.world);
        // Base materials have equal weights until the shape is recovered.
        self.pipeline.world.insert_resource(TexelPlaces::default());
        let (mut found, mut stopped) = fit(self, pass)?;
        if stopped {
            finish_stopping();
        }
        self.report_light_frame(name);
        self.report_placements(name);
        let mut kept = self.found();
        let initialized = std::mem::replace(&mut kept.initialize, Initialize::NONE);
        (kept.normals_found, kept.by_stereo) = (false, false);
        check_parameters(&mut self.pipeline.world)?;
        check_numbers("the value of the field at point", found.grid.values.iter().copied())?;
        if !stopped {
            // Moves the contours of the field to the outlines of the masks.
            let (report, seconds) =
                refined(self, name, "outlines", 0, |world, _| refine_by_outlines(world, &mut found));
            self.print(&format!(
                "{name}: outlines in {seconds:.1} s, {:.2} pixels off before, {:.2} after",
                report.before, report.after
            ));
        }
        let masks = training_silhouettes(&mut self.pipeline.world);
        let mut mesh = extract_parts(&found.grid, &masks);
        if pass.stereo && !stopped && !is_stopping() {
            let holds = match_views(self, name, &mut mesh);
            self.found().by_stereo = holds;
        } else {
            self.pipeline.world.remove_resource::<ModelError>();
        }
        // Colors of different exposures, or lights, are no reflections.
        let given = self.pipeline.world.get_resource::<Exposures>();
        let differ = given.is_some_and(Exposures::are_unknown) || !scene.views.other_lights().is_empty();
        if pass.normals && !differ && !stopped && !is_stopping() {
            let are_found = match_reflections(self, name, &mut mesh);
            self.found().normals_found = are_found;
        }
        check_numbers("the surface's coordinate", mesh.positions.iter().flat_map(|at| at.to_array()))?;
        stopped |= is_stopping();
        finish_stopping();
        put_in_place(self, &found, &mesh, texture_size)?;
        if self.found().normals_found {
            // With them highlights are sharper than light and lobe are by now: a fit finds these
            // anew.
            self.found().initialize = initialized;
        } else if initialized.light && initialized.albedo && !AlbedoMap::are_in(&mut self.pipeline.world) {
            // The light still has the color from the initialization with gray albedo.
            start_scale(&mut self.pipeline.world, scene.scale)?;
        }
        let elapsed = start.elapsed().as_secs_f64();
        self.scores().add_fit_secs(elapsed);
        let triangles = self.surface().mesh().triangles.len();
        self.print(&format!("{name}: {triangles} triangles in {elapsed:.1} s"));
        Ok(stopped || was_asked_to_stop())
    }
}

/// Fits the shape, with a bar and a look at it now and then. Returns the surface that was found,
/// and whether the run was stopped before the end.
fn fit(object: &mut Object, pass: &ShapePass) -> Result<(SdfSurface, bool)> {
    let level = |level: &GridLevel| ShapeLevel {
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
    };
    let max_pixels = pass.max_pixels as usize;
    let scene = object.scene();
    let options = ShapeOptions {
        levels: pass.levels.iter().map(level).collect(),
        fit: FitOptions {
            loss: pass.loss,
            batch: pass.batch as usize,
            rates: [pass.rates.albedo, pass.rates.light, pass.rates.specular],
            milestones: vec![0.6, 0.85],
            // While the surface moves, its normals would take part in a sheen.
            unknowns: Unknowns { sheen: false, ..object.unknowns() },
            pixels: PixelChoice { seed: scene.seed, max_pixels, evenly: false },
            initialize: object.found().initialize,
            exposure: pass.exposure,
            // Without shadows, which would have to be traced at every step, dark regions would bias
            // the color of the highlights.
            scale: ScaleRule::Free,
            light_frame: scene.light_frame.frame(&scene.light),
            ..FitOptions::default()
        },
        cameras: pass.cameras,
        // Colors of different exposures tell nothing of depth.
        hollows: pass.hollows && matches!(pass.exposure, ExposureChoice::Auto | ExposureChoice::Equal),
        spans_unseen: pass.spans_unseen,
    };
    object.pipeline.set_shader(Phase::FitStep, shader(pass.shading, Quality::Default));
    // Shadows would have to be traced at every step.
    object.pipeline.clear(Phase::FitStep, Slot::Visibility);
    // How many levels there are is known once the hull is.
    let bar = object.progress().bar(&pass.name, 0);
    bar.set_message("hull".into());
    let steps = |levels: &[GridLevel]| -> u32 { levels.iter().map(|level| level.steps).sum() };
    let (mut failure, mut stopped, mut told) = (None, false, HullReport::default());
    let progress = object.progress();
    let surface = fit_shape(&mut object.pipeline, &options, &mut |at: &ShapeProgress, world: &mut World| {
        tell_of_hull(&*progress, &pass.name, &mut told, at.hull);
        // Counted over all levels.
        let step = steps(&pass.levels[..at.level]) + at.fit.step;
        let all = steps(&pass.levels[..at.levels]);
        bar.set_length(u64::from(all));
        bar.set_position(u64::from(step));
        if at.fit.step.is_multiple_of(20) {
            bar.set_message(format!("{:.1} dB", at.fit.sums.psnr()));
        }
        failure = tell(&*progress, &pass.name, [step, all], at.fit, world).err();
        stopped |= failure.is_some() || is_stopping();
        if stopped { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    })?;
    failure.map_or(Ok(()), Err)?;
    Ok((surface, stopped))
}

/// Says how much was removed from the hull since it was `told`, where that can be seen; then all of
/// it is `told`.
fn tell_of_hull(progress: &dyn Progress, name: &str, told: &mut HullReport, now: HullReport) {
    let before = std::mem::replace(told, now);
    if before == now {
        return;
    }
    let shares = |parts: &[(f32, &str)]| {
        let seen = parts.iter().filter(|(share, _)| *share >= 0.0005);
        let words: Vec<_> = seen.map(|(share, what)| format!("{:.1} % that {what}", 100.0 * share)).collect();
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

/// Does a part of the work on what was found, with a bar of so many rounds until the run is
/// stopped. Also returns its seconds.
fn refined<T>(
    object: &mut Object,
    name: &str,
    part: &'static str,
    rounds: usize,
    work: impl FnOnce(&mut World, &mut dyn FnMut(usize) -> ControlFlow<()>) -> T,
) -> (T, f64) {
    let start = Instant::now();
    let _refining = info_span!("refined", name = %part).entered();
    let bar = object.progress().bar(name, rounds as u64);
    bar.set_message(part.into());
    let done = work(&mut object.pipeline.world, &mut |round| {
        bar.set_position(round as u64);
        bar.set_message(part.into());
        if is_stopping() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    });
    (done, start.elapsed().as_secs_f64())
}

/// Moves the mesh to where neighboring photographs agree; says what came of it and returns whether
/// vertices then stay there.
fn match_views(object: &mut Object, name: &str, mesh: &mut Mesh) -> bool {
    let (report, seconds) =
        refined(object, name, "stereo", stereo_rounds(), |world, round| refine_by_stereo(world, mesh, round));
    if is_stopping() {
        return false;
    }
    let holds = report.moved > 0.0 && report.trusted >= STEREO_HOLDS;
    let held = if holds { "; from here on vertices do not move" } else { "" };
    let found = if report.moved > 0.0 {
        format!("{:.0} % of the surface follows it{held}", 100.0 * report.trusted)
    } else {
        "it adds nothing to the shading here".into()
    };
    object.print(&format!("{name}: stereo in {seconds:.1} s, {found}"));
    holds
}

/// Gives the vertices the normals that explain what they mirror, if that is worth it; says what
/// came of it and returns whether it was.
fn match_reflections(object: &mut Object, name: &str, mesh: &mut Mesh) -> bool {
    let (report, seconds) = refined(object, name, "normals", mirror_rounds(), |world, round| {
        refine_by_mirror(world, mesh, round)
    });
    if is_stopping() {
        return false;
    }
    let is_used = report.turned_degrees > 0.0;
    let found = match report.error.map(|error| 100.0 * error) {
        Some(error) if is_used => format!(
            "turned by {:.1}° (median), {error:.0} % of the error in photographs kept aside; from here on vertices do not move",
            report.turned_degrees
        ),
        Some(of) => format!("those of the mesh are kept: {of:.0} % of the error in photographs kept aside"),
        None => format!("those of the mesh explain {:.0} %", 100.0 * (1.0 - report.unexplained)),
    };
    object.print(&format!("{name}: normals by reflections in {seconds:.1} s, {found}"));
    is_used
}

/// Gives a mesh texture coordinates for `size` texels a side, or for more if its charts do not fit:
/// what was found is not lost for that.
fn unwrap_by(mut size: u32, mesh: &Mesh) -> Result<(Mesh, u32)> {
    loop {
        match unwrap_mesh(mesh, size) {
            Ok(unwrapped) => return Ok((unwrapped.mesh, size)),
            // Nor for a signal.
            Err(Error::Interrupted) if is_stopping() => finish_stopping(),
            // No other error goes away with a larger texture.
            Err(Error::Usage { .. }) if 2 * size <= MOST_TEXELS => size *= 2,
            Err(error) => return Err(error),
        }
    }
}

/// Gives the mesh an atlas, and transfers the texels.
fn put_in_place(object: &mut Object, found: &SdfSurface, mesh: &Mesh, texture_size: u32) -> Result<()> {
    let _placing = info_span!("mesh unwrapped").entered();
    let (mesh, wider) = unwrap_by(texture_size, mesh)?;
    if wider > texture_size {
        object.progress().note(&format!(
            "the surface that was found does not fit a texture of {texture_size}² texels: it gets {wider}²"
        ));
    }
    let (surface, scene) = (Arc::new(Surface::new(mesh, wider)?), object.scene());
    let world = &mut object.pipeline.world;
    let volume = recovered_albedo(world)?;
    let atlas = surface.atlas();
    let carried = |(at, covered): (&Vec3, &bool)| {
        let address = covered.then(|| found.volume.nearest_address(*at)).flatten();
        address.map_or(Vec3::splat(0.4), |address| address.blend(&volume))
    };
    let albedo: Vec<Vec3> = atlas.position.iter().zip(&atlas.covered).map(carried).collect();
    insert_known_along(world, &scene.material.sheen, &surface)?;
    replace_texels(world, &albedo);
    replace_surface(world, surface);
    object.found().has_object = true;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use lobelia_geometry::mesh::primitive::box_mesh;

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
        let (unwrapped, size) = unwrap_by(8, &mesh).unwrap();
        assert!(size > 8 && size <= 512 && unwrapped.uvs.is_some(), "{size}");
        // An error that no texture mends is told as it is.
        mesh.positions[3].x = f32::NAN;
        assert!(unwrap_by(64, &mesh).unwrap_err().to_string().contains("vertex 3 is not finite"));
    }
}
