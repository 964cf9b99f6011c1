//! What each frame of a film shows: its camera, the light turned, the material changed.

use crate::error::Result;
use crate::light::lights::provide_turned_light;
use crate::material::edit::{EditAction, EditName, EditOrder, EditTarget};
use crate::material::shown::show_edited;
use crate::pass::session::Session;
use crate::pass::show::chosen_light;
use crate::pipeline::{Phase, Slot};
use crate::scene::{Easing, LightSweep, MaterialSweep, Orbit, OrbitKey, Pass, RenderSettings};
use crate::view::camera::{self, Camera};
use bevy_ecs::prelude::{Component, Entity, With, World};
use glam::{Quat, Vec3};

/// The time of a frame, in two measures.
#[derive(Clone, Copy, Debug)]
struct Time {
    /// From 0 at the first frame to 1 at the last.
    done: f32,
    /// From 0 at the first frame to 1 one frame after the last: what turns evenly goes on without a break.
    turned: f32,
}

impl Time {
    fn of(frame: u32, frames: u32) -> Self {
        let part = |of: u32| frame as f32 / of.max(1) as f32;
        Self { done: part(frames.saturating_sub(1)), turned: part(frames) }
    }
}

/// The cameras of the frames of a film that are rendered.
///
/// # Errors
/// If a camera cannot be made.
pub fn cameras(session: &Session, orbit: &Orbit) -> Result<Vec<Camera>> {
    let (center, size) = session.surface.bounding_sphere();
    let [width, height] = orbit.sides();
    // A tenth more than the smallest distance at which the object fits, also into a picture that is higher than wide.
    let half_fov = (orbit.fov_degrees.to_radians() / 2.0).tan() * (width as f32 / height as f32).min(1.0);
    let fitting = 1.1 * size / half_fov.atan().sin();
    let base = camera::CameraOrbit {
        target: center,
        radius: orbit.radius.unwrap_or(fitting),
        elevation_degrees: orbit.elevation_degrees,
        frames: 1,
        up: session.scene.up,
        vertical_fov_degrees: orbit.fov_degrees,
        width,
        height,
        ..Default::default()
    };
    let each = |frame| Ok(Camera::orbit(&placed(base, orbit, Time::of(frame, orbit.frames)))?[0]);
    orbit.rendered().map(each).collect()
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

/// Swaps in the light of a frame, and edits the material, if the film changes them. [`sweep_material`] without factors ends it.
pub(crate) fn show_moment(
    session: &mut Session,
    pass: &Pass,
    settings: &RenderSettings,
    orbit: &Orbit,
    frame: u32,
) {
    let time = Time::of(frame, orbit.frames);
    if let Some(sweep) = &orbit.light {
        let (choice, by_map) = chosen_light(session, pass, settings.shading);
        let turn = light_turn(sweep, session.scene.up, time);
        session.pipeline.swap(Phase::Frame, Slot::Light, provide_turned_light(choice, by_map, turn));
    }
    if let Some(sweep) = &orbit.material {
        if frame == orbit.rendered().start {
            session.pipeline.swap(Phase::Frame, Slot::Material, show_edited(pass.name()));
        }
        sweep_material(&mut session.pipeline.world, pass.name(), factors(sweep, time));
    }
}

/// Marks the edits by which a film changes the material, until its next frame.
#[derive(Component)]
struct Swept;

/// Replaces the swept edits by `factors`, after all other edits of the pass; each has its own target, so that they need no order.
pub(crate) fn sweep_material(
    world: &mut World,
    pass: &str,
    factors: impl IntoIterator<Item = (EditTarget, EditAction)>,
) {
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

    fn key(at: f32, elevation: Option<f32>, angle: Option<f32>) -> OrbitKey {
        OrbitKey {
            at,
            elevation_degrees: elevation,
            angle_degrees: angle,
            easing: Easing::Linear,
            ..OrbitKey::default()
        }
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
