//! The `Render`, `Edit` and `Relight` passes: they render the material, light and shading that `show` swaps in.

use crate::codec::animation::{write_apng, write_gif};
use crate::codec::exr_frame::{Frame, write_frame_rows_with};
use crate::codec::file::file_stems;
use crate::codec::film::{Film, FilmRecorder};
use crate::codec::video::has_frames_of;
use crate::error::Result;
use crate::error::stop::check_interrupted;
use crate::light::lights::IncidentLight;
use crate::light::placement::PicturePlacement;
use crate::math::color::srgb_from_linear;
use crate::math::ray::Illuminate;
use crate::pass::film;
use crate::pass::placements::show_placement;
use crate::pass::progress::Bar;
use crate::pass::session::Session;
use crate::pass::shading::camera_rays;
use crate::pass::show::show;
use crate::pipeline::Pipeline;
use crate::profile::stage;
use crate::report::tone::{Backdrop, Look, Picture, write_png_rows};
use crate::sample::bundle::despawn_pool;
use crate::scene::{Orbit, OrbitFormat, Pass, RenderSettings, Shading, ViewChoice};
use crate::shade::adaptive::render_adaptive;
use crate::shade::frame::{band_rows, render_bands, render_denoised};
use crate::view::camera::Camera;
use crate::view::{Split, ViewName};
use bevy_ecs::prelude::{Entity, World};
use glam::Vec3;
use image::RgbImage;
use rayon::prelude::*;
use std::collections::HashMap;
use std::path::Path;

/// Stem of the files of a film.
const FILM: &str = "orbit";
/// The film as a video.
const FILM_MP4: &str = "orbit.mp4";
/// What a picture whose noise is filtered away says in its file.
const DENOISED: &str = "Denoised: the noise of path tracing is filtered away, at the price of a small bias.";
/// The folder of a film's frames, where they stay.
pub(crate) const FRAMES: &str = "orbit_frames";

/// Runs one of the three passes.
///
/// # Errors
/// If an edit's image cannot be read, a system fails, or a picture cannot be written.
pub(crate) fn run(session: &mut Session, pass: &Pass, settings: &RenderSettings) -> Result<()> {
    show(session, pass, settings)?;
    render_all(session, pass, settings)
}

fn render_all(session: &mut Session, pass: &Pass, settings: &RenderSettings) -> Result<()> {
    let name = pass.name();
    let folder = session.folder(name);
    let views = chosen_views(&mut session.pipeline.world, settings);
    let orbit = settings.orbit.as_ref().map(|orbit| film::cameras(session, orbit)).transpose()?;
    let frames = orbit.as_ref().map_or(0, Vec::len);
    let bar = session.progress.bar(name, (views.len() + frames) as u64);
    for view in &views {
        check_interrupted()?;
        show_placement(&mut session.pipeline.world, view.entity);
        let written = write_view(&mut session.pipeline, &folder, view, settings);
        session.pipeline.world.remove_resource::<PicturePlacement>();
        written?;
        session.last_picture = Some(folder.join(format!("{}.png", view.stem)));
        bar.inc(1);
    }
    if let (Some(orbit), Some(cameras)) = (&settings.orbit, &orbit) {
        let rendered = render_film(session, pass, settings, cameras, &*bar);
        film::sweep_material(&mut session.pipeline.world, name, []);
        despawn_pool(&mut session.pipeline.world);
        let _writing = stage("film written");
        write_film(&folder, orbit, rendered?)?;
    }
    bar.finish_and_clear();
    let film = if frames > 0 { format!(", {frames} film frames") } else { String::new() };
    let filtered =
        if settings.is_denoised() { ", denoised (noise filtered away, slightly biased)" } else { "" };
    session.progress.print(&format!("{name}: {} views{film}{filtered}", views.len()));
    Ok(())
}

/// Renders the frames of a film, which are written meanwhile.
fn render_film(
    session: &mut Session,
    pass: &Pass,
    settings: &RenderSettings,
    cameras: &[Camera],
    bar: &dyn Bar,
) -> Result<Film> {
    let orbit = settings.orbit.clone().unwrap_or_default();
    let folder = session.folder(pass.name());
    let mut film = match orbit.format {
        OrbitFormat::Gif | OrbitFormat::Apng => FilmRecorder::new(&folder)?,
        OrbitFormat::Frames => FilmRecorder::kept(folder.join(FRAMES), orbit.rendered().start as usize),
        OrbitFormat::Mp4 => FilmRecorder::without_files(),
    };
    if let Some(comment) = comment_on(settings) {
        film = film.with_comment(comment);
    }
    if orbit.part.is_some() {
        // Its frames are of a film that is joined later.
    } else if has_frames_of(orbit.sides()) {
        film = film.with_video(orbit.fps);
    } else {
        session.progress.note("no MP4 has frames as large as these, so there is no orbit.mp4");
    }
    for (frame, camera) in orbit.rendered().zip(cameras) {
        check_interrupted()?;
        film::show_moment(session, pass, settings, &orbit, frame);
        film.push(film_frame(&mut session.pipeline, *camera, settings)?)?;
        bar.inc(1);
    }
    film.finish()
}

/// A view that a pass renders.
#[derive(Clone, Debug)]
pub(crate) struct ChosenView {
    /// Stem of its output files: the name of the view, prefixed by its split if both splits have a view with that name.
    pub stem: String,
    /// The name of the view.
    pub name: String,
    /// The view.
    pub entity: Entity,
    /// Its camera.
    pub camera: Camera,
}

/// The chosen views, by the stems of their files.
pub(crate) fn chosen_views(world: &mut World, settings: &RenderSettings) -> Vec<ChosenView> {
    let mut query = world.query::<(Entity, &ViewName, &Camera, &Split)>();
    let all: Vec<_> = query.iter(world).collect();
    let names: Vec<(&str, Split)> =
        all.iter().map(|(_, name, _, split)| (name.0.as_str(), **split)).collect();
    let chosen = chosen_stems(&names, settings).into_iter().map(|(i, stem)| {
        let (entity, name, camera, _) = all[i];
        ChosenView { stem, name: name.0.clone(), entity, camera: *camera }
    });
    chosen.collect()
}

/// Which of these views are chosen, with the stems of their files, by these. The one place that makes names of files of names of views.
pub fn chosen_stems(views: &[(&str, Split)], settings: &RenderSettings) -> Vec<(usize, String)> {
    let is_wanted = |(name, split): (&str, Split)| match &settings.views {
        ViewChoice::Test => split == Split::Test,
        ViewChoice::Train => split == Split::Train,
        ViewChoice::All => true,
        ViewChoice::Named(names) => names.iter().any(|n| n == name),
    };
    let mut chosen: Vec<usize> = (0..views.len()).filter(|&i| is_wanted(views[i])).collect();
    let mut uses: HashMap<&str, usize> = HashMap::new();
    chosen.iter().for_each(|&i| *uses.entry(views[i].0).or_default() += 1);
    let named = |i: usize| {
        let (name, split) = views[i];
        let part = if split == Split::Train { "train" } else { "test" };
        if uses[name] > 1 { format!("{part}_{name}") } else { name.to_owned() }
    };
    chosen.sort_by_cached_key(|&i| named(i));
    let names: Vec<String> = chosen.iter().map(|&i| named(i)).collect();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    // The film lies beside the views.
    let taken: &[&str] = if settings.orbit.is_some() { &[FILM] } else { &[] };
    let mut stems: Vec<(usize, String)> = chosen.into_iter().zip(file_stems(&names, taken)).collect();
    stems.sort_by(|a, b| a.1.cmp(&b.1));
    stems
}

/// Renders a view and writes it as EXR and PNG, both band by band.
fn write_view(
    pipeline: &mut Pipeline,
    folder: &Path,
    view: &ChosenView,
    settings: &RenderSettings,
) -> Result<()> {
    let path = |ending: &str| folder.join(format!("{}.{ending}", view.stem));
    let camera = view.camera;
    let size = [camera.width, camera.height];
    let comment = comment_on(settings);
    write_frame_rows_with(path("exr"), size.map(|side| side as usize), comment, |layers| {
        write_png_rows(path("png"), size, !settings.backdrop, comment, |colors| {
            bands(pipeline, camera, settings, Backdrop::Transparent, &mut |frame, samples| {
                layers.push(frame)?;
                colors.push(samples)
            })
        })
    })
}

/// A frame of a film.
fn film_frame(pipeline: &mut Pipeline, camera: Camera, settings: &RenderSettings) -> Result<RgbImage> {
    let mut picture = Vec::with_capacity(3 * camera.width as usize * camera.height as usize);
    // Animations have no alpha: the backdrop is dark gray.
    let gray = Backdrop::Solid(Vec3::splat(0.02));
    if matches!(settings.shading, Shading::PathTraced { .. }) {
        bands(pipeline, camera, settings, gray, &mut |_, samples| {
            picture.extend_from_slice(samples);
            Ok(())
        })?;
    } else {
        let (look, rows) = (look_of(settings), band_rows([camera.width, camera.height]));
        let shown = |radiance: Vec3| look.develop(radiance).map(srgb_from_linear);
        render_adaptive(pipeline, camera, camera_rays(settings), &shown, rows, &mut |world, band| {
            check_interrupted()?;
            let (width, height) = (camera.width as usize, band.alpha.len() / camera.width as usize);
            let shown = Picture { width, height, color: &band.color, alpha: &band.alpha };
            picture.extend_from_slice(&encoded(world, &camera, settings, gray, band.first_row, &shown)?);
            Ok(())
        })?;
    }
    Ok(RgbImage::from_raw(camera.width, camera.height, picture).expect("its bands have all rows"))
}

/// What pictures of a pass say about themselves.
fn comment_on(settings: &RenderSettings) -> Option<&'static str> {
    settings.is_denoised().then_some(DENOISED)
}

fn look_of(settings: &RenderSettings) -> Look {
    Look { exposure: settings.exposure, tone: settings.tone }
}

/// The 8-bit colors of rows of a picture, before the light if the pass shows it, or else before `plain`.
fn encoded(
    world: &World,
    camera: &Camera,
    settings: &RenderSettings,
    plain: Backdrop,
    first_row: u32,
    rows: &Picture,
) -> Result<Vec<u8>> {
    let _writing = stage("pixels encoded");
    let behind = settings.backdrop.then(|| backdrop(world, camera, first_row, rows.height as u32));
    rows.samples8(&look_of(settings), behind.as_deref().map_or(plain, Backdrop::Radiance))
}

/// Renders a picture; `take` gets each band and its 8-bit colors before the light, if the pass shows it, or else before `plain`.
fn bands(
    pipeline: &mut Pipeline,
    camera: Camera,
    settings: &RenderSettings,
    plain: Backdrop,
    take: &mut dyn FnMut(&Frame, &[u8]) -> Result<()>,
) -> Result<()> {
    let (rays, rows) = (camera_rays(settings), band_rows([camera.width, camera.height]));
    let mut hand_on = |world: &World, first_row: u32, frame: &Frame| {
        check_interrupted()?;
        take(frame, &encoded(world, &camera, settings, plain, first_row, &Picture::of(frame))?)
    };
    if !settings.is_denoised() {
        return render_bands(pipeline, camera, rays, rows, &mut hand_on);
    }
    // The filter reaches far, and needs the whole picture.
    let frame = render_denoised(pipeline, camera, rays)?;
    (0..camera.height).step_by(rows as usize).try_for_each(|first| {
        let end = first.saturating_add(rows).min(camera.height);
        hand_on(&pipeline.world, first, &frame.band(first as usize..end as usize))
    })
}

/// The radiance of the light behind each pixel of some rows.
fn backdrop(world: &World, camera: &Camera, first_row: u32, rows: u32) -> Vec<Vec3> {
    let light = world.get_resource::<IncidentLight>().and_then(|light| light.distant.clone());
    let radiance = |x: u32, y: u32| {
        let ray = camera.ray(x as f32 + 0.5, y as f32 + 0.5);
        light
            .as_ref()
            .map_or(Vec3::ZERO, |light: &std::sync::Arc<dyn Illuminate>| light.radiance(ray.direction))
    };
    let pixels = u64::from(rows) * u64::from(camera.width);
    let place = |at: u64| (at % u64::from(camera.width), at / u64::from(camera.width));
    let places = (0..pixels).into_par_iter().map(place);
    places.map(|(x, y)| radiance(x as u32, first_row + y as u32)).collect()
}

/// The files of a film; one that ends with `/` is a folder.
pub(crate) fn film_files(format: OrbitFormat) -> Vec<String> {
    match format {
        OrbitFormat::Gif => vec![format!("{FILM}.gif"), FILM_MP4.to_owned()],
        OrbitFormat::Apng => vec![format!("{FILM}.png"), FILM_MP4.to_owned()],
        OrbitFormat::Mp4 => vec![FILM_MP4.to_owned()],
        OrbitFormat::Frames => vec![FILM_MP4.to_owned(), format!("{FRAMES}/")],
    }
}

fn write_film(folder: &Path, orbit: &Orbit, mut film: Film) -> Result<()> {
    let (fps, path) = (orbit.fps as f32, |ending: &str| folder.join(format!("{FILM}.{ending}")));
    match orbit.format {
        OrbitFormat::Gif => write_gif(path("gif"), &film, fps)?,
        OrbitFormat::Apng => write_apng(path("png"), &film, fps)?,
        OrbitFormat::Mp4 | OrbitFormat::Frames => {}
    }
    film.take_video().map_or(Ok(()), |video| video.write(&folder.join(FILM_MP4)))
}
