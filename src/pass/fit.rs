//! The passes `Fit` and `Shape`: they recover what is unknown from the training views and write the
//! results.

use crate::object::fit::StepLog;
use crate::object::save::{RGB, vector_channels, weight_channels, write_layers};
use crate::object::view_report::csv_entry;
use crate::object::{Object, photograph::TrueObject};
use crate::progress::Step;
use crate::report::scores::ScaleFound;
use crate::scene::{FitPass, ShapePass, Views};
use bevy_ecs::prelude::{With, World};
use glam::{Vec3, Vec3A};
use image::{Rgb, RgbImage};
use lobelia_geometry::error::{Error, Result};
use lobelia_geometry::view::{Camera, Photograph, Split, ViewIndex, ViewName};
use lobelia_geometry::{mesh::atlas::TexelAtlas, parallel, sdf::extract::extract_mesh};
use lobelia_io::codec::file::{check_finite, write_bytes};
use lobelia_io::codec::tone::srgb8;
use lobelia_io::codec::{envmap::write_map_exr, gltf::export::write_glb, png_file::write_rgb8};
use lobelia_io::codec::{npy::NpyConvention, npy::write_lobes};
use lobelia_sg::{ray::Hit, ray::Intersect};
use lobelia_solve::fit::cameras::{CameraFit, CameraPose, CameraUnknowns};
use lobelia_solve::fit::components::TexelSeen;
use lobelia_solve::fit::exposure::{ExposureChoice, Exposures};
use lobelia_solve::shape::field::SdfField;
use lobelia_world::light::{EnvironmentMap, LightLobe, groups::all_lights, render_lobes};
use lobelia_world::material::diffuse::{Diffuse, has_sheen};
use lobelia_world::material::{SpecularBlend, SpecularLobe, TexelIndex, recovered_materials};
use lobelia_world::pipeline::pool::{read_column, with_columns};
use serde_json::{Map, Value, json};
use std::fmt::Write as _;
use std::path::Path;
use tracing::info_span;

/// A picture of the light of the object that took its own photographs, as `environment.png` is of
/// the recovered one.
pub(crate) const TRUE_ENVIRONMENT: &str = "true_environment.png";

/// Size of the picture of the recovered light, in texels.
const ENVIRONMENT_SIZE: (u32, u32) = (512, 256);

/// Runs a `Fit` pass.
///
/// # Errors
/// If there are no pixels to fit to, a system fails, or the results cannot be written;
/// [`Error::Interrupted`] if the run is stopped, once the results so far are written.
pub(crate) fn run(object: &mut Object, out: &Path, pass: &FitPass) -> Result<()> {
    // Created first, so that an unwritable folder is detected before the fit.
    let folder = out.join(&pass.name);
    std::fs::create_dir_all(&folder).map_err(Error::io("create", &folder))?;
    let summary = object.find(pass)?;
    let _writing = info_span!("results written").entered();
    let surface = object.surface();
    let scale = object.scores().scale.clone().unwrap_or_default();
    write_results(&mut object.pipeline.world, surface.atlas(), &folder, &scale)?;
    if let Some(truth) = object.pipeline.world.get_resource::<TrueObject>() {
        write_environment(&folder.join(TRUE_ENVIRONMENT), &truth.lights[0].lobes)?;
    }
    let StepLog(log) = object.pipeline.world.resource();
    write_bytes(&folder.join("log.csv"), log.as_bytes())?;
    write_views(object, out, &pass.name, pass.cameras)?;
    if summary.stopped { Err(Error::Interrupted) } else { Ok(()) }
}

/// Writes the light, the albedo texture and the material (with blend weights, if it has several
/// base materials).
fn write_results(world: &mut World, atlas: &TexelAtlas, folder: &Path, scale: &ScaleFound) -> Result<()> {
    for (number, lobes) in (1..).zip(all_lights(world)) {
        let [npy, exr, png] = light_files(number).map(|name| folder.join(name));
        write_lobes(npy, &lobes, NpyConvention::Lobelia)?;
        write_map_exr(&write_environment(&png, &lobes)?, exr)?;
    }
    let picture = |name: &str, texels: &[Vec3]| {
        write_rgb8(folder.join(name), &preview(texels, atlas.width, atlas.height))
    };
    with_columns::<TexelIndex, &Diffuse, _>(world, |texels| {
        let write = |name: &str, of: fn(&Diffuse) -> Vec3| {
            let colors: Vec<Vec3> = texels.iter().map(of).collect();
            picture(&format!("{name}.png"), &colors)?;
            write_layers(&folder.join(format!("{name}.exr")), atlas, vector_channels(RGB, &colors))
        };
        write("albedo", |texel| texel.albedo)?;
        if has_sheen(&texels) { write("albedo_along", Diffuse::along) } else { Ok(()) }
    })?;
    let gray = |values: &[f32]| values.iter().map(|value| Vec3::splat(*value)).collect::<Vec<_>>();
    let seen = read_column::<TexelIndex, TexelSeen>(world)?;
    let marks: Vec<f32> = seen.iter().map(|seen| if seen.0 > 1e-3 { 1.0 } else { 0.0 }).collect();
    picture("seen.png", &gray(&marks))?;
    let materials = recovered_materials(world);
    // The blend weights of several base materials, and the resulting roughness.
    if materials.len() > 1 {
        let blends = read_column::<TexelIndex, SpecularBlend>(world)?;
        let numbers = materials.iter().map(|(number, _)| *number);
        write_layers(&folder.join("blend.exr"), atlas, weight_channels(&blends, numbers))?;
        picture("blend.png", &blends.iter().map(|blend| Vec3::from_slice(&blend.0)).collect::<Vec<_>>())?;
        let by_number = || materials.iter().map(|(number, lobe)| (*number, lobe));
        let roughness: Vec<f32> = blends.iter().map(|blend| blend.roughness(by_number())).collect();
        picture("roughness.png", &gray(&roughness))?;
        write_layers(&folder.join("roughness.exr"), atlas, [("Y".to_owned(), roughness)])?;
    }
    write_bytes(&folder.join("materials.ron"), materials_ron(&materials, scale).as_bytes())
}

/// The files of a recovered light: its lobes, as a map, as a picture. Those of further groups of
/// photographs, from 2, have their number at the end.
pub(crate) fn light_files(number: usize) -> [String; 3] {
    let suffix = if number == 1 { String::new() } else { format!("_{number}") };
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
pub(crate) fn write_views(
    object: &mut Object,
    out: &Path,
    name: &str,
    cameras: CameraUnknowns,
) -> Result<()> {
    let folder = out.join(name);
    if cameras != CameraUnknowns::Given {
        let (scene, sphere) = (object.scene(), object.surface().bounding_sphere());
        let world = &mut object.pipeline.world;
        let shifts = shifts_px(world, sphere);
        let factor = world.resource::<CameraFit>().focal_factor();
        let mean = shifts.iter().sum::<f32>() / shifts.len().max(1) as f32;
        let most = shifts.iter().copied().fold(0.0, f32::max);
        object.print(&format!(
            "{name}: cameras moved by {mean:.2} pixels on average, {most:.2} at most; focal lengths × {factor:.5}"
        ));
        let given = if let Views::Dataset(spec) = &scene.views { spec.focal_scale } else { 1.0 };
        write_cameras(&mut object.pipeline.world, &folder, given)?;
    }
    let exposures = object.pipeline.world.get_resource::<Exposures>();
    let Some(exposures) = exposures.filter(|exposures| exposures.are_unknown()) else { return Ok(()) };
    let found = exposures.factors.iter().filter(|factors| **factors != Vec3::ONE);
    let brightness = found.map(|factors| factors.element_product().cbrt());
    let (least, most) = brightness
        .fold((f32::INFINITY, 0.0f32), |(least, most), factor| (least.min(factor), most.max(factor)));
    let what =
        if exposures.used == ExposureChoice::Color { "exposure and white balance" } else { "exposure" };
    object.print(&if least <= most {
        format!("{name}: photographs differ in {what}: factors of {least:.2} to {most:.2}")
    } else {
        format!("{name}: the {what} of photographs is not found: a fit of fewer steps than it takes")
    });
    write_exposures(&mut object.pipeline.world, &folder)
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

/// Runs a `Shape` pass.
///
/// # Errors
/// If the surface of the scene is not unknown, the masks have no hull, or a fit fails.
pub(crate) fn run_shape(object: &mut Object, out: &Path, pass: &ShapePass) -> Result<()> {
    let stopped = object.find_shape(pass)?;
    write_views(object, out, &pass.name, pass.cameras)?;
    if stopped { Err(Error::Interrupted) } else { Ok(()) }
}

/// Writes what a shape is at a step (`--debug-every`) as `normal_STEP.png`, `depth_STEP.png` and
/// `mesh_STEP.glb` into the folder of its pass; without a camera only the mesh.
pub(super) fn look(out: &Path, at: &Step, world: &mut World) -> Result<()> {
    let camera = world.query::<&Camera>().iter(world).next().copied();
    let Some(SdfField { surface, .. }) = world.get_resource() else { return Ok(()) };
    let (folder, step) = (out.join(at.pass).join("debug"), at.step);
    std::fs::create_dir_all(&folder).map_err(Error::io("create", &folder))?;
    let path = |kind: &str, ending: &str| folder.join(format!("{kind}_{step:06}.{ending}"));
    if let Some(camera) = camera {
        let hit = |pixel: usize| surface.intersect(&camera.pixel_ray(pixel as u32), 0.0);
        let hits: Vec<_> = parallel::map((camera.width * camera.height) as usize, 1024, hit);
        let picture = |color: &dyn Fn(&Hit) -> [u8; 3]| {
            let pixel = |x: u32, y: u32| hits[(y * camera.width + x) as usize].as_ref().map_or([0; 3], color);
            RgbImage::from_fn(camera.width, camera.height, |x, y| Rgb(pixel(x, y)))
        };
        // World normals, from [-1, 1] to [0, 255].
        let byte = |x: f32| (127.5 * (x + 1.0)).round() as u8;
        write_rgb8(path("normal", "png"), &picture(&|hit| hit.normal.to_array().map(byte)))?;
        // Distance along the ray: the nearest point white, the farthest dark gray, nothing black.
        let distances = || hits.iter().flatten().map(|hit| hit.distance);
        let (near, far) = (distances().fold(f32::INFINITY, f32::min), distances().fold(0.0, f32::max));
        let gray = |distance: f32| (255.0 - 200.0 * (distance - near) / (far - near).max(1e-12)) as u8;
        write_rgb8(path("depth", "png"), &picture(&|hit| [gray(hit.distance); 3]))?;
    }
    write_glb(&path("mesh", "glb"), &extract_mesh(&surface.grid), None)
}
