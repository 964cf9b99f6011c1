//! The `Render`, `Edit` and `Relight` passes: they render the material, light and shading that
//! `show` swaps in, as views and as films, in which camera, light and material change.

use crate::object::show::{camera_rays, show_placement};
use crate::scene::{
    Easing, LightSweep, MaterialSweep, Orbit, OrbitKey, Pass, RenderSettings, Shading, ViewChoice,
};
use crate::{object::Object, progress::Bar};
use bevy_ecs::prelude::{Component, Entity, With, World};
use glam::{Quat, Vec3};
use image::RgbImage;
use lobelia_geometry::error::{Error, Result, stop::check_interrupted};
use lobelia_geometry::parallel;
use lobelia_geometry::view::{Frame, Split, ViewName, camera, camera::Camera};
use lobelia_io::codec::film::{FFMPEG, write_film};
use lobelia_io::codec::tone::{Backdrop, Look, Picture, write_png_rows};
use lobelia_io::codec::{exr_frame::write_frame_rows, file::file_stems, png_file::write_rgb8};
use lobelia_sg::color::srgb_from_linear;
use lobelia_solve::shade::{adaptive::render_adaptive, frame::band_rows, frame::render_bands};
use lobelia_world::light::lights::{IncidentLight, LightChoice, provide_turned_light};
use lobelia_world::light::placement::{GroupInTurn, PicturePlacement};
use lobelia_world::material::edit::{EditAction, EditName, EditOrder, EditTarget};
use lobelia_world::pipeline::{Phase, Pipeline, Slot};
use lobelia_world::{material::shown::show_edited, sample::despawn_pool};
use std::{collections::HashMap, path::Path, path::PathBuf, sync::mpsc::sync_channel};
use tracing::info_span;

/// Stem of the files of a film.
const FILM: &str = "orbit";
/// The folder of a film's frames, where they stay.
const FRAMES: &str = "orbit_frames";

/// Runs one of the three passes.
pub(crate) fn run(object: &mut Object, out: &Path, pass: &Pass, settings: &RenderSettings) -> Result<()> {
    let mut shown = object.shown_by(Some(pass.name()));
    shown.swap_in()?;
    let (light, object) = (shown.chosen_light(), &mut *shown.object);
    let name = pass.name();
    let folder = out.join(name);
    let views = chosen_views(&mut object.pipeline.world, settings);
    let cameras = settings.orbit.as_ref().map_or(Ok(Vec::new()), |orbit| cameras(object, orbit))?;
    let bar = object.progress().bar(name, (views.len() + cameras.len()) as u64);
    for view in &views {
        check_interrupted()?;
        show_placement(&mut object.pipeline.world, view.entity);
        let path = |ending: &str| folder.join(format!("{}.{ending}", view.stem));
        let (camera, size) = (view.camera, [view.camera.width, view.camera.height]);
        // Both band by band.
        let written = write_frame_rows(path("exr"), size.map(|side| side as usize), |layers| {
            write_png_rows(path("png"), size, !settings.backdrop, |colors| {
                let pipeline = &mut object.pipeline;
                bands(pipeline, camera, settings, Backdrop::Transparent, &mut |frame, samples| {
                    layers.push(frame)?;
                    colors.push(samples)
                })
            })
        });
        object.pipeline.world.remove_resource::<PicturePlacement>();
        object.pipeline.world.remove_resource::<GroupInTurn>();
        written?;
        bar.inc(1);
    }
    if let Some(orbit) = &settings.orbit {
        let rendered = render_film(object, &folder.join(FRAMES), name, settings, &cameras, &light, &*bar);
        sweep_material(&mut object.pipeline.world, name, Vec::new());
        despawn_pool(&mut object.pipeline.world);
        let _writing = info_span!("film written").entered();
        let film = write_film(&folder.join(FILM), &rendered?, orbit.fps)?;
        if film.extension() == Some("gif".as_ref()) {
            let note = format!("the film is a GIF; with `{FFMPEG}` on the PATH it is an MP4");
            object.progress().note(&note);
        }
    }
    drop(bar);
    let film = match cameras.len() {
        0 => String::new(),
        frames => format!(", {frames} film frames"),
    };
    object.print(&format!("{name}: {} views{film}", views.len()));
    Ok(())
}

/// Renders the frames of a film, of these cameras and the light that turns, into a folder; a thread
/// writes each as a PNG file while the next one is rendered. Returns the files.
fn render_film(
    object: &mut Object,
    folder: &Path,
    pass: &str,
    settings: &RenderSettings,
    cameras: &[Camera],
    light: &(LightChoice, bool),
    bar: &dyn Bar,
) -> Result<Vec<PathBuf>> {
    let Some(orbit) = &settings.orbit else { return Ok(Vec::new()) };
    let files: Vec<PathBuf> = (0..cameras.len()).map(|i| folder.join(format!("{i:06}.png"))).collect();
    let failed = |what: &str| Error::run("making a film", what);
    std::thread::scope(|scope| {
        let (sender, ready) = sync_channel::<(&PathBuf, RgbImage)>(1);
        let write = |(file, frame): (&PathBuf, RgbImage)| write_rgb8(file, &frame);
        let writer = scope.spawn(move || ready.into_iter().try_for_each(write));
        let rendered = (0..).zip(cameras).zip(&files).try_for_each(|((frame, camera), file)| {
            check_interrupted()?;
            // Swaps in the light of the frame, and edits the material, if the film changes them.
            let time = Time::of(frame, orbit.frames);
            if let Some(sweep) = &orbit.light {
                let (choice, by_map) = light.clone();
                let light = provide_turned_light(choice, by_map, light_turn(sweep, object.scene().up, time));
                object.pipeline.swap(Phase::Compose, Slot::Light, light);
            }
            if let Some(sweep) = &orbit.material {
                if frame == 0 {
                    object.pipeline.swap(Phase::Compose, Slot::Material, show_edited(pass));
                }
                sweep_material(&mut object.pipeline.world, pass, factors(sweep, time));
            }
            let frame = film_frame(&mut object.pipeline, *camera, settings)?;
            bar.inc(1);
            // A writer that has failed says why below.
            sender.send((file, frame)).map_err(|_| failed("a frame could not be written"))
        });
        drop(sender);
        let written = writer.join().unwrap_or_else(|_| Err(failed("its thread has failed")));
        written.and(rendered)
    })?;
    Ok(files)
}

/// A view that a pass renders.
#[derive(Clone, Debug)]
pub(crate) struct ChosenView {
    /// Stem of its output files: the name of the view, prefixed by its split if both splits have a
    /// view with that name.
    pub stem: String,
    pub name: String,
    pub entity: Entity,
    pub camera: Camera,
}

/// The chosen views, by the stems of their files.
pub(crate) fn chosen_views(world: &mut World, settings: &RenderSettings) -> Vec<ChosenView> {
    let mut query = world.query::<(Entity, &ViewName, &Camera, &Split)>();
    let all: Vec<_> = query.iter(world).collect();
    let names: Vec<(&str, Split)> = all.iter().map(|(_, name, _, split)| (&*name.0, **split)).collect();
    let chosen = chosen_stems(&names, settings).into_iter().map(|(i, stem)| {
        let (entity, name, camera, _) = all[i];
        ChosenView { stem, name: name.0.clone(), entity, camera: *camera }
    });
    chosen.collect()
}

/// Which of these views are chosen, with the stems of their files, by these. The one place that
/// makes names of files of names of views.
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

fn film_frame(pipeline: &mut Pipeline, camera: Camera, settings: &RenderSettings) -> Result<RgbImage> {
    let mut picture = Vec::with_capacity(3 * camera.width as usize * camera.height as usize);
    // Films have no alpha: the backdrop is dark gray.
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

fn look_of(settings: &RenderSettings) -> Look {
    Look { exposure: settings.exposure, tone: settings.tone }
}

/// The 8-bit colors of rows of a picture, before the light if the pass shows it, or else before
/// `plain`.
fn encoded(
    world: &World,
    camera: &Camera,
    settings: &RenderSettings,
    plain: Backdrop,
    first_row: u32,
    rows: &Picture,
) -> Result<Vec<u8>> {
    let _writing = info_span!("pixels encoded").entered();
    // The radiance of the light behind each pixel.
    let light = world.get_resource::<IncidentLight>().and_then(|light| light.distant.clone());
    let width = camera.width as usize;
    let radiance = |at: usize| {
        let (x, y) = ((at % width) as u32, first_row + (at / width) as u32);
        let ray = camera.ray(x as f32 + 0.5, y as f32 + 0.5);
        light.as_ref().map_or(Vec3::ZERO, |light| light.radiance(ray.direction))
    };
    let all = || parallel::map(rows.height * width, 1024, radiance);
    let behind = settings.backdrop.then(all);
    rows.samples8(&look_of(settings), behind.as_deref().map_or(plain, Backdrop::Radiance))
}

/// Renders a picture; `take` gets each band and its 8-bit colors before the light, if the pass
/// shows it, or else before `plain`.
fn bands(
    pipeline: &mut Pipeline,
    camera: Camera,
    settings: &RenderSettings,
    plain: Backdrop,
    take: &mut dyn FnMut(&Frame, &[u8]) -> Result<()>,
) -> Result<()> {
    let (rays, rows) = (camera_rays(settings), band_rows([camera.width, camera.height]));
    render_bands(pipeline, camera, rays, rows, &mut |world, first_row, frame| {
        check_interrupted()?;
        take(frame, &encoded(world, &camera, settings, plain, first_row, &Picture::of(frame))?)
    })
}

/// The files that a film may have; one that ends with `/` is a folder.
pub(crate) const FILM_FILES: [&str; 3] = ["orbit.mp4", "orbit.gif", "orbit_frames/"];

/// The time of a frame, in two measures.
#[derive(Clone, Copy, Debug)]
struct Time {
    /// From 0 at the first frame to 1 at the last.
    done: f32,
    /// From 0 at the first frame to 1 one frame after the last: what turns evenly goes on without a
    /// break.
    turned: f32,
}

impl Time {
    fn of(frame: u32, frames: u32) -> Self {
        let part = |of: u32| frame as f32 / of.max(1) as f32;
        Self { done: part(frames.saturating_sub(1)), turned: part(frames) }
    }
}

/// The cameras of the frames of a film.
fn cameras(object: &Object, orbit: &Orbit) -> Result<Vec<Camera>> {
    let (center, size) = object.surface().bounding_sphere();
    let [width, height] = orbit.sides();
    // A tenth more than the smallest distance at which the object fits, also into a picture that is
    // higher than wide.
    let half_fov = (orbit.fov_degrees.to_radians() / 2.0).tan() * (width as f32 / height as f32).min(1.0);
    let fitting = 1.1 * size / half_fov.atan().sin();
    let base = camera::CameraOrbit {
        target: center,
        radius: orbit.radius.unwrap_or(fitting),
        elevation_degrees: orbit.elevation_degrees,
        frames: 1,
        up: object.scene().up,
        vertical_fov_degrees: orbit.fov_degrees,
        width,
        height,
        ..Default::default()
    };
    let each = |frame| Ok(Camera::orbit(&placed(base, orbit, Time::of(frame, orbit.frames)))?[0]);
    (0..orbit.frames).map(each).collect()
}

/// The orbit of one camera at a time.
fn placed(base: camera::CameraOrbit, orbit: &Orbit, time: Time) -> camera::CameraOrbit {
    let value = |pick: fn(&OrbitKey) -> Option<f32>| between_keys(&orbit.keys, pick, time.done);
    camera::CameraOrbit {
        start_degrees: value(|key| key.angle_degrees).unwrap_or(360.0 * time.turned),
        elevation_degrees: value(|key| key.elevation_degrees).unwrap_or(base.elevation_degrees),
        radius: value(|key| key.radius).unwrap_or(base.radius),
        ..base
    }
}

/// The value at a time, between the keys that give it; `None` if none does.
fn between_keys(keys: &[OrbitKey], pick: impl Fn(&OrbitKey) -> Option<f32>, time: f32) -> Option<f32> {
    let given: Vec<(&OrbitKey, f32)> = keys.iter().filter_map(|key| Some((key, pick(key)?))).collect();
    let next = given.iter().position(|(key, _)| key.at > time);
    match next {
        None => given.last().map(|(_, value)| *value),
        Some(0) => Some(given[0].1),
        Some(next) => {
            let ((from, start), (to, end)) = (given[next - 1], given[next]);
            let part = to.easing.at((time - from.at) / (to.at - from.at));
            Some(start + (end - start) * part)
        }
    }
}

/// Marks the edits by which a film changes the material, until its next frame.
#[derive(Component)]
struct Swept;

/// Replaces the swept edits by `factors`, after all other edits of the pass; without any the sweep
/// ends. Each has its own target, so that they need no order.
fn sweep_material(world: &mut World, pass: &str, factors: Vec<(EditTarget, EditAction)>) {
    let mut query = world.query_filtered::<Entity, With<Swept>>();
    let old: Vec<Entity> = query.iter(world).collect();
    old.into_iter().for_each(|edit| _ = world.despawn(edit));
    for (target, action) in factors {
        world.spawn((Swept, EditName(pass.to_owned()), EditOrder(u32::MAX), target, action));
    }
}

fn light_turn(sweep: &LightSweep, up: Vec3, time: Time) -> Quat {
    let axis = sweep.axis.unwrap_or(up).normalize_or(Vec3::Y);
    // A jump is made at the last frame: one frame later nobody would see it.
    let part = sweep.easing.at(if sweep.easing == Easing::Hold { time.done } else { time.turned });
    let degrees = sweep.from_degrees + (sweep.to_degrees - sweep.from_degrees) * part;
    Quat::from_axis_angle(axis, degrees.to_radians())
}

/// The factors at a time, as edits of the whole object.
fn factors(sweep: &MaterialSweep, time: Time) -> Vec<(EditTarget, EditAction)> {
    let part = sweep.easing.at(time.done);
    let scale = |(from, to): (f32, f32)| EditAction::Scale(Vec3::splat(from + (to - from) * part));
    vec![
        (EditTarget::Diffuse, scale(sweep.albedo)),
        (EditTarget::Specular, scale(sweep.specular)),
        (EditTarget::Roughness, scale(sweep.roughness)),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn key(at: f32, elevation_degrees: Option<f32>, angle_degrees: Option<f32>) -> OrbitKey {
        OrbitKey { at, elevation_degrees, angle_degrees, easing: Easing::Linear, ..OrbitKey::default() }
    }

    #[test]
    fn each_value_goes_between_the_keys_that_give_it() {
        let keys = [key(0.2, Some(10.0), None), key(0.5, None, Some(90.0)), key(0.6, Some(50.0), None)];
        let elevation = |time| between_keys(&keys, |key| key.elevation_degrees, time).unwrap();
        assert_eq!([0.0, 0.2, 1.0].map(elevation), [10.0, 10.0, 50.0]);
        assert!((elevation(0.3) - 20.0).abs() < 1e-4);
        assert_eq!(between_keys(&keys, |key| key.angle_degrees, 0.9), Some(90.0));
        assert_eq!(between_keys(&keys, |key| key.radius, 0.9), None);
        let jump = [key(0.5, Some(1.0), None), key(0.5, Some(2.0), None)];
        assert_eq!(between_keys(&jump, |key| key.elevation_degrees, 0.5), Some(2.0));
    }

    #[test]
    fn without_keys_a_film_is_one_even_turn() {
        let base = camera::CameraOrbit { elevation_degrees: 20.0, radius: 3.0, ..Default::default() };
        let orbit = Orbit { frames: 8, ..Orbit::default() };
        let at = |frame| placed(base, &orbit, Time::of(frame, 8));
        assert_eq!((at(0).start_degrees, at(2).start_degrees, at(7).start_degrees), (0.0, 90.0, 315.0));
        assert_eq!((at(3).elevation_degrees, at(3).radius), (20.0, 3.0));
        let keyed = Orbit { keys: vec![key(0.0, Some(0.0), Some(5.0)), key(1.0, Some(70.0), None)], ..orbit };
        let last = placed(base, &keyed, Time::of(7, 8));
        assert_eq!((last.start_degrees, last.elevation_degrees), (5.0, 70.0));
    }

    #[test]
    fn light_and_material_go_from_their_first_to_their_last_values() {
        let sweep = LightSweep::default();
        let quarter = light_turn(&sweep, Vec3::Y * 2.0, Time::of(15, 60));
        assert!((quarter * Vec3::Z).distance(Vec3::X) < 1e-5);
        let held = LightSweep { to_degrees: 90.0, easing: Easing::Hold, ..sweep };
        let turned = |frame| light_turn(&held, Vec3::Y, Time::of(frame, 60)) * Vec3::Z;
        assert!(turned(58) == Vec3::Z && turned(59).distance(Vec3::X) < 1e-5, "{}", turned(59));
        let sweep = MaterialSweep { roughness: (0.5, 2.0), ..MaterialSweep::default() };
        let at = |frame| factors(&sweep, Time::of(frame, 4))[2].1.clone();
        assert_eq!(at(0), EditAction::Scale(Vec3::splat(0.5)));
        assert_eq!(at(3), EditAction::Scale(Vec3::splat(2.0)));
    }

    #[test]
    fn swept_edits_replace_each_other_and_leave_the_passes_own() {
        let mut world = World::new();
        let scale = |factor| (EditTarget::Roughness, EditAction::Scale(Vec3::splat(factor)));
        world.spawn((EditName("aged".into()), EditOrder(0), EditTarget::Roughness, scale(0.5).1));
        let mut after = |factors: Vec<(EditTarget, EditAction)>| {
            sweep_material(&mut world, "aged", factors);
            let mut query = world.query::<(&EditName, &EditOrder, &EditAction)>();
            let mut edits: Vec<_> = query.iter(&world).filter(|(name, ..)| name.0 == "aged").collect();
            edits.sort_by_key(|(_, order, _)| **order);
            edits.into_iter().map(|(.., action)| action.clone()).collect::<Vec<_>>()
        };
        assert_eq!(after(vec![scale(2.0)]), [scale(0.5).1, scale(2.0).1]);
        assert_eq!(after(vec![scale(3.0)]), [scale(0.5).1, scale(3.0).1]);
        assert_eq!(after(Vec::new()), [scale(0.5).1]);
    }
}
