//! The `Render`, `Edit` and `Relight` passes: they render the material, light and shading that [`show`] swaps in.

use crate::codec::animation::{Mp4, write_apng, write_gif, write_mp4};
use crate::codec::frame::{Frame, write_frame};
use crate::error::Result;
use crate::light::lights::IncidentLight;
use crate::math::ray::Illuminate;
use crate::pass::interrupt::check_interrupted;
use crate::pass::session::Session;
use crate::pass::shading::camera_rays;
use crate::pass::show::show;
use crate::pipeline::Pipeline;
use crate::report::tone::{Backdrop, Look, Picture, write_png};
use crate::scene::{Orbit, OrbitFormat, Pass, RenderSettings, ViewChoice};
use crate::shade::frame::{render_frame, resolve};
use crate::view::camera;
use crate::view::camera::Camera;
use crate::view::{Split, ViewName};
use bevy_ecs::prelude::{Entity, World};
use glam::Vec3;
use image::RgbImage;
use std::path::Path;

/// Runs one of the three passes.
///
/// # Errors
/// If an edit's image cannot be read, a system fails, or a picture cannot be written.
pub fn run(session: &mut Session, pass: &Pass, settings: &RenderSettings) -> Result<()> {
    show(session, pass, settings)?;
    render_all(session, pass.name(), settings)
}

fn render_all(session: &mut Session, name: &str, settings: &RenderSettings) -> Result<()> {
    let folder = session.folder(name);
    let views = chosen_views(&mut session.pipeline.world, &settings.views);
    let orbit = settings.orbit.as_ref().map(|orbit| orbit_cameras(session, orbit)).transpose()?;
    let frames = orbit.as_ref().map_or(0, Vec::len);
    let bar = session.progress.bar(name, (views.len() + frames) as u64);
    let look = Look { exposure: settings.exposure, tone: settings.tone };
    for ChosenView { stem, camera, .. } in &views {
        check_interrupted()?;
        let frame = picture(&mut session.pipeline, *camera, settings)?;
        write_frame(folder.join(format!("{stem}.exr")), &frame)?;
        let behind = settings.backdrop.then(|| backdrop(&session.pipeline.world, camera));
        let developed = Picture::of(&frame);
        let behind = behind.as_deref().map_or(Backdrop::Transparent, Backdrop::Radiance);
        write_png(folder.join(format!("{stem}.png")), &developed, &look, behind)?;
        bar.inc(1);
    }
    if let (Some(orbit), Some(cameras)) = (&settings.orbit, &orbit) {
        let mut film = Vec::new();
        for camera in cameras {
            check_interrupted()?;
            film.push(film_frame(session, *camera, settings, &look)?);
            bar.inc(1);
        }
        write_film(session, &folder, orbit, &film)?;
    }
    bar.finish_and_clear();
    let film = if frames > 0 { format!(", {frames} film frames") } else { String::new() };
    session.progress.print(&format!("{name}: {} views{film}", views.len()));
    Ok(())
}

/// A view that a pass renders.
#[derive(Clone, Debug)]
pub struct ChosenView {
    /// Stem of its output files: the name of the view, prefixed by its split if both splits have a view with that name.
    pub stem: String,
    /// The view.
    pub entity: Entity,
    /// Its camera.
    pub camera: Camera,
}

/// The chosen views, by name.
pub fn chosen_views(world: &mut World, choice: &ViewChoice) -> Vec<ChosenView> {
    let wanted = |name: &str, split: Split| match choice {
        ViewChoice::Test => split == Split::Test,
        ViewChoice::Train => split == Split::Train,
        ViewChoice::All => true,
        ViewChoice::Named(names) => names.iter().any(|n| n == name),
    };
    let mut query = world.query::<(Entity, &ViewName, &Camera, &Split)>();
    let chosen: Vec<_> = query.iter(world).filter(|(_, name, _, split)| wanted(&name.0, **split)).collect();
    let mut views: Vec<ChosenView> = chosen
        .iter()
        .map(|(entity, name, camera, split)| {
            let shared = chosen.iter().filter(|other| other.1 == *name).count() > 1;
            let part = if **split == Split::Train { "train" } else { "test" };
            let stem = if shared { format!("{part}_{}", name.0) } else { name.0.clone() };
            ChosenView { stem, entity: *entity, camera: **camera }
        })
        .collect();
    views.sort_by(|a, b| a.stem.cmp(&b.stem));
    views
}

/// Renders one picture with the systems in the slots.
///
/// # Errors
/// If a system fails.
pub fn picture(pipeline: &mut Pipeline, camera: Camera, settings: &RenderSettings) -> Result<Frame> {
    Ok(resolve(&render_frame(pipeline, camera, camera_rays(settings))?))
}

/// The radiance of the light behind each pixel.
fn backdrop(world: &World, camera: &Camera) -> Vec<Vec3> {
    let light = world.get_resource::<IncidentLight>().and_then(|light| light.distant.clone());
    let radiance = |x: u32, y: u32| {
        let ray = camera.ray(x as f32 + 0.5, y as f32 + 0.5);
        light
            .as_ref()
            .map_or(Vec3::ZERO, |light: &std::sync::Arc<dyn Illuminate>| light.radiance(ray.direction))
    };
    (0..camera.height)
        .flat_map(|y| (0..camera.width).map(move |x| (x, y)))
        .map(|(x, y)| radiance(x, y))
        .collect()
}

fn orbit_cameras(session: &Session, orbit: &Orbit) -> Result<Vec<Camera>> {
    let (center, radius) = session.surface.bounding_sphere();
    // A tenth more than the smallest distance at which the object fits.
    let fitting = 1.1 * radius / (orbit.fov_degrees.to_radians() / 2.0).sin();
    Camera::orbit(&camera::Orbit {
        target: center,
        radius: orbit.radius.unwrap_or(fitting),
        elevation_degrees: orbit.elevation_degrees,
        frames: orbit.frames,
        up: session.scene.up,
        vertical_fov_degrees: orbit.fov_degrees,
        width: orbit.size,
        height: orbit.size,
        ..Default::default()
    })
}

fn film_frame(
    session: &mut Session,
    camera: Camera,
    settings: &RenderSettings,
    look: &Look,
) -> Result<RgbImage> {
    let frame = picture(&mut session.pipeline, camera, settings)?;
    let behind = settings.backdrop.then(|| backdrop(&session.pipeline.world, &camera));
    // Animations have no alpha: the backdrop is dark gray.
    let behind = behind.as_deref().map_or(Backdrop::Solid(Vec3::splat(0.02)), Backdrop::Radiance);
    Picture::of(&frame).rgb8(look, behind)
}

fn write_film(session: &Session, folder: &Path, orbit: &Orbit, film: &[RgbImage]) -> Result<()> {
    let fps = orbit.fps as f32;
    match orbit.format {
        OrbitFormat::Gif => write_gif(folder.join("orbit.gif"), film, fps)?,
        OrbitFormat::Apng => write_apng(folder.join("orbit.png"), film, fps)?,
    }
    if write_mp4(folder.join("orbit.mp4"), film, fps)? == Mp4::NoFfmpeg {
        session.progress.note("no ffmpeg on the PATH, so there is no orbit.mp4");
    }
    Ok(())
}
