//! The `Fit` pass: recovers the unknowns from the training views and writes the results.
//!
//! | module | holds |
//! | --- | --- |
//! | [`steps`] | its settings, its log, its steps with the geometry that moves, and what it chooses on its way: base materials and distribution of normals |

pub(crate) mod steps;

use crate::pass::save::{RGB, vector_channels, weight_channels, write_layers};
use crate::pass::view_report::{csv_entry, note_fit};
use crate::report::scores::ScaleFound;
use crate::scene::{FitPass, FitShading, Gloss, Tilt, Views};
use crate::{pass::export::carried_blends, pass::run::session::Session, spawn::initial_specular};
use bevy_ecs::prelude::{With, World};
use glam::{Vec2, Vec3, Vec3A};
use image::{Rgb, RgbImage};
use lobelia_geometry::error::{Error, Result, stop::finish_stopping, stop::is_stopping};
use lobelia_geometry::mesh::{Surface, atlas::TexelAtlas, atlas::address, atlas::fill_uncovered};
use lobelia_geometry::view::{Camera, Photograph, Split, ViewIndex, ViewName};
use lobelia_io::codec::file::{check_finite, write_bytes};
use lobelia_io::codec::tone::srgb8;
use lobelia_io::codec::{envmap::write_map_exr, npy::NpyConvention, npy::write_lobes, png_file::write_rgb8};
use lobelia_sg::{ray::TexelAddress, statistics::median};
use lobelia_solve::fit::cameras::{CameraFit, CameraPose, CameraUnknowns};
use lobelia_solve::fit::components::TexelSeen;
use lobelia_solve::fit::detail::{DetailOptions, finest_side, solve_detail, visited_pixels};
use lobelia_solve::fit::exposure::{ExposureChoice, Exposures};
use lobelia_solve::fit::roughness::{RoughnessPrior, TexelRoughness, attach_roughness};
use lobelia_solve::fit::run::{FitOptions, FitSummary, Initialize, optimizer_of_texel_roughness};
use lobelia_solve::fit::scale::{ScaleRule, means};
use lobelia_solve::fit::{groups::forget_visibility, guard::check_parameters, observe::release_pool};
use lobelia_solve::visibility::see_material;
use lobelia_world::light::{
    EnvironmentMap, LightLobe, groups::other_lights, lights::own_lobes, render_lobes,
};
use lobelia_world::material::material_source::RecoveredMaterial;
use lobelia_world::material::{
    DiffuseAlbedo, DiffuseSheen, DiffuseTilt, SpecularBlend, SpecularLobe, TexelIndex, recovered_albedo,
    recovered_materials, sheen::KnownAlong, sheen::has_sheen, sheen::write_albedo, texels_in_order,
};
use lobelia_world::pipeline::pool::{despawn_rows, read_column, write_column};
use lobelia_world::{material::tilt::has_tilt, pipeline::Phase, pipeline::Slot, sample::point::Scenery};
use serde_json::{Map, Value, json};
use std::fmt::Write as _;
use std::{path::Path, sync::Arc, time::Instant};
use steps::{begin_log, shader, take_log, take_steps_and_choose};
use tracing::info_span;

/// A picture of the light of the object that took its own photographs, as `environment.png` is of
/// the recovered one.
pub(crate) const TRUE_ENVIRONMENT: &str = "true_environment.png";

/// Size of the picture of the recovered light, in texels.
const ENVIRONMENT_SIZE: (u32, u32) = (512, 256);

/// Runs the pass.
///
/// # Errors
/// If there are no pixels to fit to, a system fails, or the results cannot be written;
/// [`Error::Interrupted`] if the run is stopped, once the results so far are written.
pub(crate) fn run(session: &mut Session, pass: &FitPass) -> Result<()> {
    // Created first, so that an unwritable folder is detected before the fit.
    let folder = session.out.join(&pass.name);
    std::fs::create_dir_all(&folder).map_err(Error::io("create", &folder))?;
    if let Gloss::Texels { smoothness, color_width, specular } = session.scene.material.gloss {
        let first = initial_specular(&session.scene.material.specular).roughness;
        let prior = RoughnessPrior::new(session.surface.atlas(), smoothness, color_width, specular);
        session.pipeline.world.insert_resource(prior);
        attach_roughness(&mut session.pipeline.world, first, specular);
        session.pipeline.swap(Phase::FitStep, Slot::Optimizer, optimizer_of_texel_roughness());
    }
    begin_log(&mut session.pipeline.world);
    let taken = take_steps_and_choose(session, pass);
    // All parts of the fit and its trials visit the same pixels, made once.
    release_pool(&mut session.pipeline.world);
    let (mut summary, options) = taken?;
    session.kept.has_object = true;
    session.kept.initialize = Initialize::NONE;
    session.report_light_frame(&pass.name);
    session.report_placements(&pass.name);
    let known = !options.unknowns.light || !options.unknowns.albedo;
    // Maps of the albedo may have replaced the scene's rule.
    let rule = session.pipeline.world.get_resource().copied().unwrap_or(options.scale);
    let rule = if known { "Known".to_owned() } else { ScaleRule::words(&rule) };
    let mut unseen = fill_texels(session)?;
    if pass.detail && options.unknowns.albedo && !summary.stopped {
        // What was solved for until a stop is written.
        match refine_texture(session, pass, &options) {
            Err(Error::Interrupted) | Ok(()) => {}
            failed => failed?,
        }
        summary.stopped = is_stopping();
        finish_stopping();
        check_parameters(&mut session.pipeline.world)?;
        unseen = fill_texels(session)?;
    }
    // The scale between light and albedo, the same in all outputs.
    let [mean_light, mean_albedo] = means(&mut session.pipeline.world)?.map(|mean| mean.to_array());
    let scale = ScaleFound { rule, mean_light, mean_albedo };
    let _writing = info_span!("results written").entered();
    note_fit(session);
    report(session, &pass.name, &summary, unseen);
    write_results(&mut session.pipeline.world, session.surface.atlas(), &folder, &scale)?;
    if let Some(truth) = &session.truth {
        write_environment(&folder.join(TRUE_ENVIRONMENT), &truth.lights[0].lobes)?;
    }
    write_bytes(&folder.join("log.csv"), take_log(&mut session.pipeline.world).as_bytes())?;
    session.scores.scale = Some(scale);
    write_views(session, &pass.name, pass.cameras)?;
    if summary.stopped { Err(Error::Interrupted) } else { Ok(()) }
}

/// Fills the texels that no view sees from their neighbors; returns the number of covered texels
/// among them.
fn fill_texels(session: &mut Session) -> Result<usize> {
    let unknowns = session.unknowns();
    let world = &mut session.pipeline.world;
    let seen: Vec<bool> = read_column::<TexelIndex, TexelSeen>(world)?.iter().map(|s| s.0 > 1e-3).collect();
    let atlas = session.surface.atlas();
    if seen.len() != atlas.covered.len() || !seen.contains(&true) {
        return Ok(0);
    }
    let fill = |mut values: Vec<Vec3>| {
        fill_uncovered(&mut values, &seen, atlas);
        values
    };
    if unknowns.albedo {
        let albedo = recovered_albedo(world)?;
        let sheen = read_column::<TexelIndex, DiffuseSheen>(world)?;
        let tilt = read_column::<TexelIndex, DiffuseTilt>(world)?;
        let filled = fill(albedo.clone());
        if has_sheen(&sheen) {
            // Their albedo along the surface is that of their neighbors.
            let along = fill(albedo.iter().zip(&sheen).map(|(albedo, sheen)| *albedo + sheen.0).collect());
            let sheen = along.iter().zip(&filled).map(|(along, straight)| DiffuseSheen(*along - *straight));
            write_column::<TexelIndex, DiffuseSheen>(world, &sheen.collect::<Vec<_>>())?;
        }
        if has_tilt(&tilt) {
            let tilt = fill(tilt.iter().map(|tilt| tilt.0).collect()).into_iter().map(DiffuseTilt);
            write_column::<TexelIndex, DiffuseTilt>(world, &tilt.collect::<Vec<_>>())?;
        }
        write_albedo(world, filled)?;
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

fn report(session: &mut Session, name: &str, summary: &FitSummary, unseen: usize) {
    let total = session.scores.fit_secs.unwrap_or(0.0) + summary.elapsed_secs;
    session.scores.fit_secs = Some(total);
    let world = &mut session.pipeline.world;
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
        let of = "of the squared error of views kept aside";
        session.progress.print(&format!("{name}: {words}: it explains {part:.1} % {of}"));
    }
    session.scores.determined = summary.determined;
    if let Some(words) = summary.determined.and_then(|found| found.words()) {
        session.progress.print(&format!("{name}: determined by the photographs: {words}"));
    }
    if unseen > 0 {
        session.progress.note(&format!("{unseen} texels that no view sees are filled from their neighbors"));
    }
}

/// Writes the light, the albedo texture and the material (with blend weights, if it has several
/// base materials).
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
    // The blend weights of several base materials, and the resulting roughness.
    if materials.len() > 1 {
        let blends = read_column::<TexelIndex, SpecularBlend>(world)?;
        let numbers = materials.iter().map(|(number, _)| *number);
        write_layers(&folder.join("blend.exr"), atlas, weight_channels(&blends, numbers))?;
        let shown: Vec<Vec3> = blends.iter().map(|blend| Vec3::from_slice(&blend.0)).collect();
        write_rgb8(folder.join("blend.png"), &preview(&shown, atlas.width, atlas.height))?;
        let by_number = || materials.iter().map(|(number, lobe)| (*number, lobe));
        let roughness: Vec<f32> = blends.iter().map(|blend| blend.roughness(by_number())).collect();
        let shown: Vec<Vec3> = roughness.iter().map(|r| Vec3::splat(*r)).collect();
        write_rgb8(folder.join("roughness.png"), &preview(&shown, atlas.width, atlas.height))?;
        write_layers(&folder.join("roughness.exr"), atlas, [("Y".to_owned(), roughness)])?;
    }
    write_bytes(&folder.join("materials.ron"), materials_ron(&materials, scale).as_bytes())
}

/// Writes a texture as sRGB PNG and linear EXR.
fn write_texture(path: &Path, colors: &[Vec3], atlas: &TexelAtlas) -> Result<()> {
    write_rgb8(path.with_extension("png"), &preview(colors, atlas.width, atlas.height))?;
    write_layers(&path.with_extension("exr"), atlas, vector_channels(RGB, colors))
}

/// Writes a light to the files that [`light_files`] names.
fn write_light(lobes: &[LightLobe], folder: &Path, suffix: &str) -> Result<()> {
    let [npy, exr, png] = light_files(suffix).map(|name| folder.join(name));
    write_lobes(npy, lobes, NpyConvention::Lobelia)?;
    write_map_exr(&write_environment(&png, lobes)?, exr)
}

/// The files of a recovered light: its lobes, as a map, as a picture. Those of further groups of
/// photographs have a suffix: `_2`, `_3` …
pub(crate) fn light_files(suffix: &str) -> [String; 3] {
    [format!("light{suffix}.npy"), format!("environment{suffix}.exr"), format!("environment{suffix}.png")]
}

/// Writes a picture of a light; returns its map.
fn write_environment(path: &Path, lobes: &[LightLobe]) -> Result<EnvironmentMap> {
    let map = render_lobes(lobes, ENVIRONMENT_SIZE.0, ENVIRONMENT_SIZE.1);
    write_rgb8(path, &preview(&map.radiance, map.width, map.height))?;
    Ok(map)
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
        let SpecularLobe { roughness, ndf, .. } = lobe;
        let _ =
            writeln!(text, "    (albedo: ({r:?}, {g:?}, {b:?}), roughness: {roughness:?}, ndf: {ndf:?}),");
    }
    text.push_str("]\n");
    text
}

/// Writes `cam_dict_norm.json` (PhySG's layout, training views; in the convention of the input, for
/// images of the fitted size) if cameras moved, and `exposures.csv` if photographs have exposures
/// of their own, to the folder of a pass, and prints how far cameras moved.
pub(crate) fn write_views(session: &mut Session, name: &str, cameras: CameraUnknowns) -> Result<()> {
    let folder = session.out.join(name);
    if cameras != CameraUnknowns::Given {
        let world = &mut session.pipeline.world;
        let shifts = shifts_px(world, session.surface.bounding_sphere());
        let factor = world.resource::<CameraFit>().focal_factor();
        let mean = shifts.iter().sum::<f32>() / shifts.len().max(1) as f32;
        let most = shifts.iter().copied().fold(0.0, f32::max);
        session.progress.print(&format!(
            "{name}: cameras moved by {mean:.2} pixels on average, {most:.2} at most; focal lengths × {factor:.5}"
        ));
        let given = if let Views::Dataset(spec) = &session.scene.views { spec.focal_scale } else { 1.0 };
        write_cameras(world, &folder, given)?;
    }
    let exposures = session.pipeline.world.get_resource::<Exposures>();
    let Some(exposures) = exposures.filter(|exposures| exposures.are_unknown()) else { return Ok(()) };
    let found = exposures.factors.iter().filter(|factors| **factors != Vec3::ONE);
    let brightness = found.map(|factors| factors.element_product().cbrt());
    let (least, most) = brightness
        .fold((f32::INFINITY, 0.0f32), |(least, most), factor| (least.min(factor), most.max(factor)));
    let what =
        if exposures.used == ExposureChoice::Color { "exposure and white balance" } else { "exposure" };
    session.progress.print(&if least <= most {
        format!("{name}: photographs differ in {what}: factors of {least:.2} to {most:.2}")
    } else {
        format!("{name}: the {what} of photographs is not found: a fit of fewer steps than it takes")
    });
    write_exposures(&mut session.pipeline.world, &folder)
}

/// Motion of the image of an object around `center`, in pixels, for each training view.
fn shifts_px(world: &mut World, (center, radius): (Vec3, f32)) -> Vec<f32> {
    let around = [Vec3::X, Vec3::Y, Vec3::Z].map(|axis| radius * axis);
    let points = [center, center + around[0], center + around[1], center + around[2]];
    let mut views = world.query::<(&Camera, &CameraPose, &Split)>();
    let train = views.iter(world).filter(|(.., split)| **split == Split::Train);
    let shift = |(camera, pose, _): (&Camera, &CameraPose, &Split)| {
        let apart = points.iter().filter_map(|point| {
            let (from, to) = (pose.given.project(*point)?, camera.project(*point)?);
            Some((from.0 - to.0).hypot(from.1 - to.1))
        });
        apart.sum::<f32>() / points.len() as f32
    };
    train.map(shift).collect()
}

/// Writes the cameras of the training views in PhySG's format.
fn write_cameras(world: &mut World, folder: &Path, focal_scale: f32) -> Result<()> {
    let mut cameras: Map<String, Value> = Map::new();
    let mut views = world.query::<(&ViewName, &Camera, &CameraPose, &Split)>();
    for (name, camera, pose, split) in views.iter(world) {
        let camera = Camera { focal: pose.given.focal.map(|focal| focal / focal_scale), ..*camera };
        let wrong = |problem| Error::run("optimizing cameras", format!("view {}: {problem}", name.0));
        camera.check().map_err(wrong)?;
        if *split == Split::Train {
            let [fx, fy] = camera.focal.map(f64::from);
            let [cx, cy] = camera.center.map(f64::from);
            let skew = f64::from(camera.skew);
            let k = [fx, skew, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0];
            let pose = camera.world_from_camera;
            let position = Vec3::from(pose.translation).as_dvec3();
            // The transform is rigid: its inverse has the camera's axes as rows.
            let row = |axis: Vec3A| {
                let axis = Vec3::from(axis).as_dvec3();
                [axis.x, axis.y, axis.z, -axis.dot(position)]
            };
            let matrix = pose.matrix3;
            let rows = [row(matrix.x_axis), row(matrix.y_axis), row(matrix.z_axis), [0.0, 0.0, 0.0, 1.0]];
            let size = [camera.width, camera.height];
            let camera = json!({ "K": k, "W2C": rows.as_flattened(), "img_size": size });
            cameras.insert(name.0.clone(), camera);
        }
    }
    let text = serde_json::to_string_pretty(&cameras).map_err(|e| Error::run("cameras", e.to_string()))?;
    write_bytes(&folder.join("cam_dict_norm.json"), text.as_bytes())
}

fn write_exposures(world: &mut World, folder: &Path) -> Result<()> {
    let mut text = String::from("view,red,green,blue,exposure\n");
    let mut query = world.query_filtered::<(&ViewIndex, &ViewName, &Split), With<Photograph>>();
    let mut train: Vec<(ViewIndex, String)> = query
        .iter(world)
        .filter(|(.., split)| **split == Split::Train)
        .map(|(index, name, _)| (*index, name.0.clone()))
        .collect();
    train.sort_unstable();
    let exposures = world.resource::<Exposures>();
    let path = folder.join("exposures.csv");
    let brightness = |view: &ViewIndex| exposures.factor(*view).element_product().cbrt();
    let factors = train.iter().map(|(view, _)| brightness(view));
    check_finite(&path, factors, |at| format!("the exposure of view {} is not finite", train[at].1))?;
    for (view, name) in &train {
        // Writing to a String cannot fail.
        let Vec3 { x: red, y: green, z: blue } = exposures.factor(*view);
        let (name, exposure) = (csv_entry(name), brightness(view));
        let _ = writeln!(text, "{name},{red:.5},{green:.5},{blue:.5},{exposure:.5}");
    }
    write_bytes(&path, text.as_bytes())
}

/// Makes the texture as fine as the photographs, if it is not, and solves for its albedo, sheen and
/// tilt.
fn refine_texture(session: &mut Session, pass: &FitPass, options: &FitOptions) -> Result<()> {
    let _detail = info_span!("texture").entered();
    let start = Instant::now();
    let factor = factor_for(session);
    if factor > 1 {
        // Divides each texel into `factor`² texels of the same material.
        let atlas = session.surface.atlas();
        let (width, height) = (atlas.width, atlas.height);
        let surface = Arc::new(Surface::new(session.surface.mesh().clone(), width * factor)?);
        let fine = [surface.atlas().width, surface.atlas().height];
        let center = |i: u32, size: u32| (i as f32 + 0.5) / size as f32;
        let place = |i: u32| Vec2::new(center(i % fine[0], fine[0]), center(i / fine[0], fine[1]));
        let from = (0..fine[0] * fine[1]).map(|i| address(place(i), width, height));
        divide_texels(&mut session.pipeline.world, &from.collect::<Vec<_>>())?;
        session.pipeline.world.insert_resource(Scenery(surface.clone()));
        forget_visibility(&mut session.pipeline.world);
        (session.surface, session.surface_found) = (surface, true);
    }
    session.pipeline.set_shader(Phase::Detail, shader(pass.shading, pass.quality));
    let shadows = see_material::<RecoveredMaterial>();
    session.set_shadows(Phase::Detail, pass.shading == FitShading::Accurate, shadows)?;
    let tilt = session.scene.material.tilt == Tilt::Unknown;
    let bar = session.progress.bar(&pass.name, 100);
    bar.set_message("texture".into());
    let settings = DetailOptions { tilt, metal: options.unknowns.metal };
    solve_detail(&mut session.pipeline, settings, &mut |done| bar.set_position((100.0 * done) as u64))?;
    bar.finish_and_clear();
    let (side, seconds) = (session.surface.atlas().width, start.elapsed().as_secs_f64());
    session
        .progress
        .print(&format!("{}: texture of {side}² texels from all pixels in {seconds:.1} s", pass.name));
    session.scores.fit_secs = Some(session.scores.fit_secs.unwrap_or(0.0) + seconds);
    Ok(())
}

/// The whole factor that makes a texel about a pixel wide in the median training photograph, as far
/// as [`finest_side`] lets it.
fn factor_for(session: &mut Session) -> u32 {
    let (middle, _) = session.surface.bounding_sphere();
    let world = &mut session.pipeline.world;
    let mut views = world.query_filtered::<(&Camera, &Split), With<Photograph>>();
    let training = views.iter(world).filter(|(_, split)| **split == Split::Train);
    let pixel = |(camera, _): (&Camera, _)| camera.position().distance(middle) / camera.focal[0];
    let mut pixels: Vec<f32> = training.map(pixel).collect();
    let Some(pixel) = median(&mut pixels) else { return 1 };
    let pixels = visited_pixels(world);
    let atlas = session.surface.atlas();
    let side = atlas.width.max(atlas.height).max(1);
    let most = finest_side(pixels as f64) as u32 / side;
    // A cast of what is not a number is 0.
    ((atlas.texel_size() / pixel).round() as u32).min(most).max(1)
}

/// Replaces the texels by texels whose material is that of the old ones at these places: albedo and
/// sheen between them, the rest of the nearest.
fn divide_texels(world: &mut World, from: &[TexelAddress]) -> Result<()> {
    let albedo: Vec<Vec3> = recovered_albedo(world)?;
    let sheen = read_column::<TexelIndex, DiffuseSheen>(world)?;
    let sheen: Vec<Vec3> = sheen.into_iter().map(|sheen| sheen.0).collect();
    let tilt = read_column::<TexelIndex, DiffuseTilt>(world)?;
    let tilt: Vec<Vec3> = tilt.into_iter().map(|tilt| tilt.0).collect();
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
        let (sheen, tilt) = (DiffuseSheen(at.blend(&sheen)), DiffuseTilt(at.blend(&tilt)));
        (index, DiffuseAlbedo(at.blend(&albedo)), sheen, tilt, blends[nearest(at)], seen[nearest(at)])
    }));
    if let Some(gloss) = gloss.filter(|gloss| !gloss.is_empty()) {
        for (texel, at) in texels_in_order(world).into_iter().zip(from) {
            world.entity_mut(texel).insert(gloss[nearest(at)]);
        }
    }
    Ok(())
}
