//! Checks of all passes before the first one runs, so that a wrong name or a missing ground truth is an error at the start,
//! not after a long fit. `lobelia check` makes the same checks.

use crate::codec::exr_frame::{FRAME_PIXEL_BYTES, Layer};
use crate::codec::file::{check_room, check_writable};
use crate::codec::gltf::import::read_mesh;
use crate::codec::image::Gamma;
use crate::codec::nearby::closest;
use crate::error::{Error, Result};
use crate::material::SpecularBlend;
use crate::material::shown::recovered_material;
use crate::pass::edit::{apply_edits, edits_of_nothing};
use crate::pass::render::{ChosenView, chosen_views};
use crate::pass::session::Session;
use crate::pass::truth_files::{ViewFiles, read_fitting};
use crate::scene::Gloss;
use crate::scene::{EvaluatePass, LayerTruth, Pass, RenderSettings, Scene, Truth, ViewChoice, Views};
use crate::shade::frame::{PixelSums, check_memory};
use crate::view::{Photograph, ViewName};
use bevy_ecs::prelude::World;
use rayon::prelude::*;
use std::path::Path;

/// Bytes of a rendered photograph's pixel: radiance and the mask.
const PHOTOGRAPH_PIXEL_BYTES: u64 = 12 + 2;
/// Room on the disk that any run takes.
const LEAST_ROOM: u64 = 16 << 20;

/// Checks every pass against the world before any of them runs.
///
/// # Errors
/// [`Error::Usage`] or [`Error::Input`] for a view that does not exist, a pass without views, an image of an edit that cannot be
/// read, or a missing ground truth.
pub(crate) fn check(session: &mut Session) -> Result<()> {
    let mut unedited = recovered_material(&mut session.pipeline.world)?;
    if matches!(session.scene.material.gloss, Gloss::Texels { .. }) {
        // Any texel may get any of the base materials.
        unedited.blends.fill(SpecularBlend::even(unedited.lobes.len()));
    }
    for pass in &session.scene.passes {
        if let Some(settings) = pass.render() {
            check_views(session, pass.name(), settings)?;
        }
        if !pass.edits().is_empty() {
            apply_edits(&mut unedited.clone(), pass.edits(), &session.surface)?;
            for number in edits_of_nothing(pass.edits(), &session.surface)? {
                let note = format!(
                    "pass {}: edit {} changes nothing: its region contains no texel",
                    pass.name(),
                    number + 1
                );
                session.progress.note(&note);
            }
        }
        if let Pass::Evaluate(pass) = pass {
            check_truths(session, pass)?;
        }
    }
    Ok(())
}

/// Checks what a scene says of its pictures: each takes memory that is known before anything is read.
///
/// # Errors
/// [`Error::Usage`] for photographs that take more than there may be.
pub fn check_sizes(scene: &Scene) -> Result<()> {
    // Views and films are rendered in bands of rows, and take little whatever their size.
    let Views::Photographed(spec) = &scene.views else { return Ok(()) };
    let ring = &spec.cameras;
    let (photographs, pixels) = (u64::from(ring.count) + u64::from(ring.test), u64::from(ring.size).pow(2));
    let frame = (size_of::<PixelSums>() + 4 * FRAME_PIXEL_BYTES) as u64;
    let bytes = pixels * (photographs * PHOTOGRAPH_PIXEL_BYTES + frame);
    check_memory(&format!("rendering {photographs} photographs"), ring.size, ring.size, bytes)
}

/// Checks before any work that the folders of all passes can be written into, and that the disk is not full.
///
/// # Errors
/// [`Error::Usage`] naming the folder.
pub(crate) fn check_output(scene: &Scene, out: &Path) -> Result<()> {
    check_folder(out)?;
    scene.passes.iter().try_for_each(|pass| check_writable(&out.join(pass.name())))
}

/// Checks before any work that a folder of results can be written into, and that its disk is not full.
///
/// # Errors
/// [`Error::Usage`] naming the folder.
pub fn check_folder(out: &Path) -> Result<()> {
    check_writable(out)?;
    check_room(out, LEAST_ROOM)
}

/// Checks that a scene file can name the data, if a pass writes one: RON is UTF-8.
///
/// # Errors
/// [`Error::Usage`] naming the folder of the data; [`Error::Io`] if the current folder cannot be found.
pub fn check_paths(scene: &Scene) -> Result<()> {
    let (Views::Dataset(data), true) =
        (&scene.views, scene.passes.iter().any(|p| matches!(p, Pass::Save(_))))
    else {
        return Ok(());
    };
    let path = std::path::absolute(&data.path).map_err(Error::io("find", &data.path))?;
    if path.to_str().is_some() {
        return Ok(());
    }
    let problem = format!("a scene file cannot name {}, which is not UTF-8", path.display());
    Err(Error::usage(problem, "Rename the folder, or leave out the `Save` pass."))
}

/// Checks that the views of a pass exist, and that there is something to render.
fn check_views(session: &mut Session, pass: &str, settings: &RenderSettings) -> Result<()> {
    let world = &mut session.pipeline.world;
    if let ViewChoice::Named(wanted) = &settings.views {
        let names: Vec<String> = world.query::<&ViewName>().iter(world).map(|n| n.0.clone()).collect();
        if let Some(missing) = wanted.iter().find(|name| !names.contains(name)) {
            let near = closest(missing, names.iter().map(String::as_str)).join(", ");
            let help = match (near.is_empty(), names.first(), names.last()) {
                (false, ..) => format!("Near it: {near}."),
                (true, Some(first), Some(last)) => format!("There are {}, {first} to {last}.", names.len()),
                _ => "There are no views.".to_owned(),
            };
            return Err(Error::usage(format!("pass {pass}: there is no view {missing}"), help));
        }
    }
    if settings.orbit.is_none() && chosen_views(world, settings).is_empty() {
        let problem = format!("pass {pass} renders nothing: no view matches");
        let help = "Use `render: (views: All)`, or give it an `orbit`.";
        return Err(Error::usage(problem, help));
    }
    Ok(())
}

/// Checks that every scored view has its ground truth, and the surface, too.
fn check_truths(session: &mut Session, pass: &EvaluatePass) -> Result<()> {
    if let Some(path) = &pass.mesh {
        read_mesh(path)?;
    }
    for (i, score) in pass.scores.iter().enumerate() {
        let settings = session.scene.passes.iter().find(|p| p.name() == score.pass).and_then(Pass::render);
        let Some(settings) = settings else { continue };
        let views = chosen_views(&mut session.pipeline.world, settings);
        let world = &session.pipeline.world;
        views.par_iter().try_for_each(|view| check_image(world, &score.pass, &score.truth, view))?;
        // Layers are scored on the views of the first score.
        for (truth, layer) in [(&pass.albedo, Layer::Albedo), (&pass.normal, Layer::Normal)] {
            if let (0, Some(files)) = (i, truth.as_ref().and_then(LayerTruth::files)) {
                let files = ViewFiles::of(files);
                views.par_iter().try_for_each(|view| {
                    files.read_layer(layer, [&view.stem, &view.name], &view.camera).map(|_| ())
                })?;
            }
        }
    }
    Ok(())
}

fn check_image(world: &World, pass: &str, truth: &Truth, view: &ChosenView) -> Result<()> {
    match truth {
        Truth::Photographs if world.get::<Photograph>(view.entity).is_none() => Err(Error::usage(
            format!("pass {pass} is scored against photographs, but view {} has none", view.stem),
            "Score only views with photographs: choose them with `render: (views: …)`.",
        )),
        _ => truth.files().map_or(Ok(()), |files| {
            read_fitting(&ViewFiles::of(files).image(&view.name), Gamma::Srgb, &view.camera).map(|_| ())
        }),
    }
}

#[cfg(test)]
mod tests {
    #[cfg(unix)]
    #[test]
    fn data_that_no_scene_file_can_name_is_refused_if_one_is_to_be_written() {
        use super::{Views, check_paths};
        use crate::scene::{LoadOptions, load};
        use std::os::unix::ffi::OsStrExt;
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scene.ron");
        let scene = |passes: &str| {
            let text =
                format!("(version: 1, surface: Sphere(), views: Dataset(path: \".\"), passes: [{passes}])");
            std::fs::write(&path, text).unwrap();
            let mut scene = load(&path, &LoadOptions::default()).unwrap().scene;
            let name = std::ffi::OsStr::from_bytes(b"/data/\xff");
            let Views::Dataset(data) = &mut scene.views else { panic!() };
            data.path = name.into();
            scene
        };
        let error = check_paths(&scene("Fit(), Save()")).unwrap_err();
        assert!(error.to_string().contains("which is not UTF-8") && error.exit_code() == 2, "{error}");
        check_paths(&scene("Fit(), Export()")).unwrap();
    }
}
