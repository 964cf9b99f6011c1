//! The `Fit` pass: recovers the unknowns from the training views and writes the results.

use crate::codec::exr::ExrLayers;
use crate::codec::exr_frame::write_channels;
use crate::codec::file::write_bytes;
use crate::codec::finite::check_finite;
use crate::codec::npy::{NpyConvention, write_lobes};
use crate::codec::png_file::write_rgb8;
use crate::error::stop::{finish_stopping, is_stopping};
use crate::error::{Error, Result};
use crate::fit::components::TexelSeen;
use crate::fit::guard::check_parameters;
use crate::fit::optimizer::optimizer_of_texel_roughness;
use crate::fit::roughness::texel::{RoughnessPrior, TexelRoughness, attach_roughness};
use crate::fit::run::{FitOptions, FitSummary, Initialize};
use crate::fit::scale::{ScaleRule, means};
use crate::light::groups::other_lights;
use crate::light::lights::own_lobes;
use crate::light::{EnvironmentMap, LightLobe, render_lobes};
use crate::material::sheen::{has_sheen, write_albedo};
use crate::material::tilt::has_tilt;
use crate::material::{DiffuseSheen, DiffuseTilt};
use crate::material::{
    MAX_SPECULAR_LOBES, SpecularBlend, SpecularLobe, TexelIndex, recovered_albedo, recovered_materials,
};
use crate::mesh::atlas::{TexelAtlas, fill_uncovered};
use crate::pass::detail::refine_texture;
use crate::pass::found_views;
use crate::pass::gloss::take_steps_and_choose;
use crate::pass::save::write_weights;
use crate::pass::session::Session;
use crate::pass::steps::{begin_log, take_log};
use crate::pass::view_report::note_fit;
use crate::pipeline::pool::{read_column, write_column};
use crate::pipeline::{Phase, Slot};
use crate::profile::stage;
use crate::report::scores::ScaleFound;
use crate::report::tone::srgb8;
use crate::scene::{FitPass, Gloss};
use crate::spawn::initial_specular;
use bevy_ecs::prelude::World;
use glam::Vec3;
use image::{Rgb, RgbImage};
use std::fmt::Write as _;
use std::path::Path;

/// A picture of the light of the object that took its own photographs, as `environment.png` is of the recovered one.
pub(crate) const TRUE_ENVIRONMENT: &str = "true_environment.png";

/// Size of the picture of the recovered light, in texels.
const ENVIRONMENT_SIZE: (u32, u32) = (512, 256);

/// Runs the pass.
///
/// # Errors
/// If there are no pixels to fit to, a system fails, or the results cannot be written; [`Error::Interrupted`] if the run is
/// stopped, once the results so far are written.
pub(crate) fn run(session: &mut Session, pass: &FitPass) -> Result<()> {
    // Created first, so that an unwritable folder is detected before the fit.
    let folder = session.folder(&pass.name);
    std::fs::create_dir_all(&folder).map_err(Error::io("create", &folder))?;
    give_texels_roughness(session);
    begin_log(&mut session.pipeline.world);
    let (mut summary, options) = take_steps_and_choose(session, pass)?;
    session.has_object = true;
    session.initialize = Initialize::NONE;
    session.report_light_frame(&pass.name);
    session.report_placements(&pass.name);
    let known = !options.unknowns.light || !options.unknowns.albedo;
    // Maps of the albedo may have replaced the scene's rule.
    let rule = session.pipeline.world.get_resource().copied().unwrap_or(options.scale);
    let rule = if known { "Known".to_owned() } else { ScaleRule::words(&rule) };
    let unseen = finish_texels(session, pass, &options, &mut summary)?;
    session.report_communication(&pass.name);
    let scale = scale_found(session, rule)?;
    let _writing = stage("results written");
    note_fit(session);
    report(session, &pass.name, &summary, unseen);
    write_results(&mut session.pipeline.world, session.surface.atlas(), &folder, &scale)?;
    if let Some(truth) = &session.truth {
        write_environment(&folder.join(TRUE_ENVIRONMENT), &environment(truth.lobes()))?;
    }
    write_bytes(&folder.join("log.csv"), take_log(&mut session.pipeline.world).as_bytes())?;
    session.scores.scale = Some(scale);
    found_views::write(session, &pass.name, pass.cameras)?;
    if summary.stopped { Err(Error::Interrupted) } else { Ok(()) }
}

/// Refines the texture if that is wanted, and fills the texels that no view sees; returns the number of covered texels among them.
fn finish_texels(
    session: &mut Session,
    pass: &FitPass,
    options: &FitOptions,
    summary: &mut FitSummary,
) -> Result<usize> {
    let unseen = fill_texels(session)?;
    if !pass.detail || !options.unknowns.albedo || summary.stopped {
        return Ok(unseen);
    }
    // What was solved for until a stop is written.
    match refine_texture(session, pass, options) {
        Err(Error::Interrupted) | Ok(()) => {}
        failed => failed?,
    }
    summary.stopped = is_stopping();
    finish_stopping();
    check_parameters(&mut session.pipeline.world)?;
    fill_texels(session)
}

/// If the scene has one roughness per texel, swaps in the systems that fit it.
fn give_texels_roughness(session: &mut Session) {
    let Gloss::Texels { smoothness, color_width, specular } = session.scene.material.gloss else { return };
    let first = initial_specular(&session.scene.material.specular).roughness;
    let prior = RoughnessPrior::new(session.surface.atlas(), smoothness, color_width, specular);
    session.pipeline.world.insert_resource(prior);
    attach_roughness(&mut session.pipeline.world, first, specular);
    session.pipeline.swap(Phase::FitStep, Slot::Optimizer, optimizer_of_texel_roughness());
}

/// Fills the texels that no view sees from their neighbors; returns the number of covered texels among them.
fn fill_texels(session: &mut Session) -> Result<usize> {
    let unknowns = session.unknowns();
    let world = &mut session.pipeline.world;
    let seen: Vec<bool> =
        read_column::<TexelIndex, TexelSeen>(world)?.iter().map(|seen| seen.0 > 1e-3).collect();
    let atlas = session.surface.atlas();
    if seen.len() != atlas.covered.len() || !seen.contains(&true) {
        return Ok(0);
    }
    if unknowns.albedo {
        let mut values = recovered_albedo(world)?;
        fill_sheen(world, &values, &seen, atlas)?;
        fill_tilt(world, &seen, atlas)?;
        fill_uncovered(&mut values, &seen, atlas);
        write_albedo(world, values)?;
    }
    if unknowns.blends {
        let mut blends = read_column::<TexelIndex, SpecularBlend>(world)?;
        fill_blends(&mut blends, &seen, atlas);
        write_column::<TexelIndex, SpecularBlend>(world, &blends)?;
    }
    let fitted = unknowns.albedo || unknowns.blends;
    let unseen = atlas.covered.iter().zip(&seen).filter(|(covered, seen)| **covered && !**seen);
    Ok(if fitted { unseen.count() } else { 0 })
}

/// Fills the sheen of texels that no view sees, so that their albedo along the surface is that of their neighbors.
fn fill_sheen(world: &mut World, albedo: &[Vec3], seen: &[bool], atlas: &TexelAtlas) -> Result<()> {
    let mut straight = albedo.to_vec();
    let sheen = read_column::<TexelIndex, DiffuseSheen>(world)?;
    if !has_sheen(&sheen) {
        return Ok(());
    }
    let mut along: Vec<Vec3> = albedo.iter().zip(&sheen).map(|(albedo, sheen)| *albedo + sheen.0).collect();
    fill_uncovered(&mut straight, seen, atlas);
    fill_uncovered(&mut along, seen, atlas);
    let filled = along.iter().zip(&straight).map(|(along, straight)| DiffuseSheen(*along - *straight));
    write_column::<TexelIndex, DiffuseSheen>(world, &filled.collect::<Vec<_>>())
}

/// Fills the tilt of texels that no view sees; without any tilt there stays none.
fn fill_tilt(world: &mut World, seen: &[bool], atlas: &TexelAtlas) -> Result<()> {
    let tilt = read_column::<TexelIndex, DiffuseTilt>(world)?;
    if !has_tilt(&tilt) {
        return Ok(());
    }
    let mut vectors: Vec<Vec3> = tilt.into_iter().map(|tilt| tilt.0).collect();
    fill_uncovered(&mut vectors, seen, atlas);
    let filled: Vec<DiffuseTilt> = vectors.into_iter().map(DiffuseTilt).collect();
    write_column::<TexelIndex, DiffuseTilt>(world, &filled)
}

/// Fills the blend weights of texels that no view sees, three base materials at a time.
fn fill_blends(blends: &mut [SpecularBlend], seen: &[bool], atlas: &TexelAtlas) {
    for start in (0..MAX_SPECULAR_LOBES).step_by(3) {
        let three = start..MAX_SPECULAR_LOBES.min(start + 3);
        let triple = |blend: &SpecularBlend| {
            let at = |k: usize| blend.0.get(start + k).copied().unwrap_or(0.0);
            Vec3::new(at(0), at(1), at(2))
        };
        let mut values: Vec<Vec3> = blends.iter().map(triple).collect();
        fill_uncovered(&mut values, seen, atlas);
        for (blend, value) in blends.iter_mut().zip(&values) {
            blend.0[three.clone()].copy_from_slice(&value.to_array()[..three.len()]);
        }
    }
}

/// The scale between light and albedo, the same in all outputs.
fn scale_found(session: &mut Session, rule: String) -> Result<ScaleFound> {
    let [mean_light, mean_albedo] = means(&mut session.pipeline.world)?.map(|mean| mean.to_array());
    Ok(ScaleFound { rule, mean_light, mean_albedo })
}

/// A summary of the specular material: one or two base materials completely, of more the range of roughness of the texels.
fn material_words(world: &mut World) -> String {
    let lobes: Vec<SpecularLobe> = recovered_materials(world).into_iter().map(|(_, lobe)| lobe).collect();
    let gloss: Vec<f32> = world.query::<&TexelRoughness>().iter(world).map(|gloss| gloss.roughness).collect();
    let (low, high) =
        gloss.iter().fold((f32::INFINITY, 0.0f32), |(low, high), r| (low.min(*r), high.max(*r)));
    let words = |roughness: String, [r, g, b]: [f32; 3]| {
        format!("; roughness {roughness}, specular albedo ({r:.3}, {g:.3}, {b:.3})")
    };
    match lobes.as_slice() {
        [first, ..] if !gloss.is_empty() => words(format!("{low:.3} to {high:.3}"), first.albedo.to_array()),
        all => all.iter().map(|l| words(format!("{:.3}", l.roughness), l.albedo.to_array())).collect(),
    }
}

fn report(session: &mut Session, name: &str, summary: &FitSummary, unseen: usize) {
    let total = session.scores.fit_secs.unwrap_or(0.0) + summary.elapsed_secs;
    session.scores.fit_secs = Some(total);
    let world = &mut session.pipeline.world;
    let material = material_words(world);
    session.progress.print(&format!(
        "{name}: {} steps over {} pixels in {:.1} s{material}{}",
        summary.steps,
        summary.pixels,
        summary.elapsed_secs,
        if summary.stopped { " (stopped early)" } else { "" }
    ));
    if let Some(part) = summary.explained_by_sheen.map(|part| 100.0 * part) {
        let found = has_sheen(&read_column::<TexelIndex, DiffuseSheen>(world).unwrap_or_default());
        let words = if found { "a sheen" } else { "no sheen" };
        session.progress.print(&format!(
            "{name}: {words}: it explains {part:.1} % of the squared error of views kept aside"
        ));
    }
    session.scores.determined = summary.determined;
    if let Some(words) = summary.determined.and_then(|found| found.words()) {
        session.progress.print(&format!("{name}: determined by the photographs: {words}"));
    }
    if unseen > 0 {
        session.progress.note(&format!("{unseen} texels that no view sees are filled from their neighbors"));
    }
}

/// Writes the light, the albedo texture and the material (with blend weights, if it has several base materials).
fn write_results(world: &mut World, atlas: &TexelAtlas, folder: &Path, scale: &ScaleFound) -> Result<()> {
    write_light(&own_lobes(world), folder, "")?;
    for (number, (lobes, _)) in (2..).zip(other_lights(world)) {
        write_light(&lobes, folder, &format!("_{number}"))?;
    }
    let albedo = recovered_albedo(world)?;
    write_texture(&folder.join("albedo"), &albedo, atlas)?;
    let sheen = read_column::<TexelIndex, DiffuseSheen>(world)?;
    if has_sheen(&sheen) {
        let along: Vec<Vec3> = albedo.iter().zip(&sheen).map(|(albedo, sheen)| *albedo + sheen.0).collect();
        write_texture(&folder.join("albedo_along"), &along, atlas)?;
    }
    let seen = read_column::<TexelIndex, TexelSeen>(world)?;
    let marks: Vec<Vec3> = seen.iter().map(|s| Vec3::splat(if s.0 > 1e-3 { 1.0 } else { 0.0 })).collect();
    write_rgb8(folder.join("seen.png"), &preview(&marks, atlas.width, atlas.height))?;
    let materials = recovered_materials(world);
    if materials.len() > 1 {
        let blends = read_column::<TexelIndex, SpecularBlend>(world)?;
        write_roughness(&materials, &blends, atlas, folder)?;
    }
    let path = folder.join("materials.ron");
    let numbers =
        |(_, lobe): &(usize, SpecularLobe)| [lobe.albedo.to_array().as_slice(), &[lobe.roughness]].concat();
    let numbers: Vec<f32> = materials.iter().flat_map(numbers).collect();
    check_finite(&path, numbers, |at| format!("base material {} is not finite", at / 4))?;
    write_bytes(&path, materials_ron(&materials, scale).as_bytes())
}

/// Writes a texture as sRGB PNG and linear EXR.
fn write_texture(path: &Path, colors: &[Vec3], atlas: &TexelAtlas) -> Result<()> {
    write_rgb8(path.with_extension("png"), &preview(colors, atlas.width, atlas.height))?;
    let mut linear = ExrLayers { width: atlas.width, height: atlas.height, ..ExrLayers::default() };
    linear.insert_triple(["R", "G", "B"], colors);
    write_channels(path.with_extension("exr"), &linear)
}

/// Writes a light to the files that [`light_files`] names.
fn write_light(lobes: &[LightLobe], folder: &Path, suffix: &str) -> Result<()> {
    let [npy, exr, png] = light_files(suffix).map(|name| folder.join(name));
    write_lobes(npy, lobes, NpyConvention::Lobelia)?;
    let environment = environment(lobes);
    environment.write_exr(exr)?;
    write_environment(&png, &environment)
}

/// The files of a recovered light: its lobes, as a map, as a picture. Those of further groups of photographs have a suffix: `_2`, `_3` …
pub(crate) fn light_files(suffix: &str) -> [String; 3] {
    [format!("light{suffix}.npy"), format!("environment{suffix}.exr"), format!("environment{suffix}.png")]
}

fn environment(lobes: &[LightLobe]) -> EnvironmentMap {
    render_lobes(lobes, ENVIRONMENT_SIZE.0, ENVIRONMENT_SIZE.1)
}

fn write_environment(path: &Path, map: &EnvironmentMap) -> Result<()> {
    write_rgb8(path, &preview(&map.radiance, map.width, map.height))
}

/// Writes the blend weights of several base materials, and the resulting roughness.
fn write_roughness(
    materials: &[(usize, SpecularLobe)],
    blends: &[SpecularBlend],
    atlas: &TexelAtlas,
    folder: &Path,
) -> Result<()> {
    let (width, height) = (atlas.width, atlas.height);
    let numbers: Vec<usize> = materials.iter().map(|(number, _)| *number).collect();
    write_weights(&folder.join("blend.exr"), blends, &numbers, width, height)?;
    let shown: Vec<Vec3> = blends.iter().map(|blend| Vec3::from_slice(&blend.0)).collect();
    write_rgb8(folder.join("blend.png"), &preview(&shown, width, height))?;
    let by_number = || materials.iter().map(|(number, lobe)| (*number, lobe));
    let roughness: Vec<f32> = blends.iter().map(|blend| blend.roughness(by_number())).collect();
    let shown: Vec<Vec3> = roughness.iter().map(|r| Vec3::splat(*r)).collect();
    write_rgb8(folder.join("roughness.png"), &preview(&shown, width, height))?;
    let mut map = ExrLayers { width, height, ..ExrLayers::default() };
    map.channels.insert("Y".to_owned(), roughness);
    write_channels(folder.join("roughness.exr"), &map)
}

fn preview(pixels: &[Vec3], width: u32, height: u32) -> RgbImage {
    RgbImage::from_fn(width, height, |x, y| Rgb(srgb8(pixels[(y * width + x) as usize])))
}

/// The specular lobes as a RON list, in the syntax of a scene file.
fn materials_ron(materials: &[(usize, SpecularLobe)], scale: &ScaleFound) -> String {
    let mut text = String::from(
        "// Specular lobes: albedo (linear RGB), the paper's roughness R, distribution of normals.\n",
    );
    let ScaleFound { rule, mean_light, mean_albedo } = scale;
    let _ = writeln!(text, "// Scale {rule}: mean light {mean_light:?}, mean albedo {mean_albedo:?}.\n[");
    for (_, lobe) in materials {
        let [r, g, b] = lobe.albedo.to_array();
        let _ = writeln!(
            text,
            "    (albedo: ({r:?}, {g:?}, {b:?}), roughness: {:?}, ndf: {:?}),",
            lobe.roughness, lobe.ndf
        );
    }
    text.push_str("]\n");
    text
}
