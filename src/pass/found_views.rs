//! Output files of a fit about the views: optimized cameras, and exposures.

use crate::codec::file::write_bytes;
use crate::codec::finite::check_finite;
use crate::error::{Error, Result};
use crate::fit::cameras::{CameraFit, CameraPose, CameraUnknowns};
use crate::fit::exposure::{ExposureChoice, Exposures};
use crate::pass::session::Session;
use crate::scene::Views;
use crate::view::{Camera, Photograph, Split, ViewIndex, ViewName};
use bevy_ecs::prelude::{With, World};
use glam::{Vec3, Vec3A};
use serde_json::{Map, Value, json};
use std::fmt::Write as _;
use std::path::Path;

/// Writes `cam_dict_norm.json` (PhySG's layout, training views; in the convention of the input, for images of
/// the fitted size) if cameras moved, and `exposures.csv` if photographs have exposures of their own,
/// to the folder of a pass, and prints how far cameras moved.
///
/// # Errors
/// [`Error::Io`] if a file cannot be written.
pub fn write(session: &mut Session, name: &str, cameras: CameraUnknowns) -> Result<()> {
    let folder = session.folder(name);
    if cameras != CameraUnknowns::Given {
        let (center, radius) = session.surface.bounding_sphere();
        let world = &mut session.pipeline.world;
        let (shifts, factor) =
            (shifts_px(world, center, radius), world.resource::<CameraFit>().focal_factor());
        let mean = shifts.iter().sum::<f32>() / shifts.len().max(1) as f32;
        let most = shifts.iter().copied().fold(0.0, f32::max);
        session.progress.print(&format!(
            "{name}: cameras moved by {mean:.2} pixels on average, {most:.2} at most; focal lengths × {factor:.5}"
        ));
        let given = if let Views::Dataset(spec) = &session.scene.views { spec.focal_scale } else { 1.0 };
        write_cameras(&mut session.pipeline.world, &folder, given)?;
    }
    match session.pipeline.world.get_resource::<Exposures>().filter(|exposures| exposures.are_unknown()) {
        Some(exposures) => {
            session.progress.print(&format!("{name}: {}", words(exposures)));
            write_exposures(&mut session.pipeline.world, &folder)
        }
        None => Ok(()),
    }
}

/// Motion of the image of an object around `center`, in pixels, for each training view.
fn shifts_px(world: &mut World, center: Vec3, radius: f32) -> Vec<f32> {
    let around = [Vec3::X, Vec3::Y, Vec3::Z].map(|axis| radius * axis);
    let points = [center, center + around[0], center + around[1], center + around[2]];
    let mut views = world.query::<(&Camera, &CameraPose, &Split)>();
    let train = views.iter(world).filter(|(_, _, split)| **split == Split::Train);
    let shift = |(camera, pose): (&Camera, &CameraPose)| {
        let apart = points.iter().filter_map(|point| {
            let (from, to) = (pose.given.project(*point)?, camera.project(*point)?);
            Some((from.0 - to.0).hypot(from.1 - to.1))
        });
        apart.sum::<f32>() / points.len() as f32
    };
    train.map(|(camera, pose, _)| shift((camera, pose))).collect()
}

fn write_cameras(world: &mut World, folder: &Path, focal_scale: f32) -> Result<()> {
    let mut views = world.query::<(&ViewName, &Camera, &CameraPose, &Split)>();
    let train = views.iter(world).filter(|(_, _, _, split)| **split == Split::Train);
    let as_given = |camera: &Camera, pose: &CameraPose| Camera {
        focal: pose.given.focal.map(|focal| focal / focal_scale),
        ..*camera
    };
    let cameras: Map<String, Value> =
        train.map(|(name, camera, pose, _)| (name.0.clone(), in_json(&as_given(camera, pose)))).collect();
    let path = folder.join("cam_dict_norm.json");
    for (name, camera, pose, _) in views.iter(world) {
        as_given(camera, pose)
            .check()
            .map_err(|problem| Error::run("optimizing cameras", format!("view {}: {problem}", name.0)))?;
    }
    let text = serde_json::to_string_pretty(&cameras).map_err(|e| Error::run("cameras", e.to_string()))?;
    write_bytes(&path, text.as_bytes())
}

/// A camera in PhySG's format.
fn in_json(camera: &Camera) -> Value {
    let [fx, fy] = camera.focal.map(f64::from);
    let [cx, cy] = camera.center.map(f64::from);
    let k = [fx, f64::from(camera.skew), cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0];
    let pose = camera.world_from_camera;
    let position = Vec3::from(pose.translation).as_dvec3();
    // The transform is rigid: its inverse has the camera's axes as rows.
    let row = |axis: Vec3A| {
        let axis = Vec3::from(axis).as_dvec3();
        [axis.x, axis.y, axis.z, -axis.dot(position)]
    };
    let matrix = pose.matrix3;
    let rows = [row(matrix.x_axis), row(matrix.y_axis), row(matrix.z_axis), [0.0, 0.0, 0.0, 1.0]];
    let w2c = rows.as_flattened();
    json!({ "K": k, "W2C": w2c, "img_size": [camera.width, camera.height] })
}

/// How much photographs differ, as far as that was found.
fn words(exposures: &Exposures) -> String {
    let found = exposures.factors.iter().filter(|factors| **factors != Vec3::ONE);
    let brightness = found.map(|factors| factors.element_product().cbrt());
    let range = brightness.fold(None, |range: Option<(f32, f32)>, factor| {
        let (least, most) = range.unwrap_or((factor, factor));
        Some((least.min(factor), most.max(factor)))
    });
    let what =
        if exposures.used == ExposureChoice::Color { "exposure and white balance" } else { "exposure" };
    match range {
        Some((least, most)) => format!("photographs differ in {what}: factors of {least:.2} to {most:.2}"),
        None => format!("the {what} of photographs is not found: a fit of fewer steps than it takes"),
    }
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
        let _ = writeln!(text, "{name},{red:.5},{green:.5},{blue:.5},{:.5}", brightness(view));
    }
    write_bytes(&path, text.as_bytes())
}
