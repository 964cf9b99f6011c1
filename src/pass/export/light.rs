//! The light that an object is exported with, as environment maps.

use crate::error::Result;
use crate::light::convention::MapConvention;
use crate::light::light_frame::{LightFrame, OwnLightFrame};
use crate::light::lights::own_lobes;
use crate::light::{EnvironmentMap, LightLobe, render_lobes, rotate_lobes};
use crate::math::sg::sphere_integral;
use crate::pass::session::Session;
use crate::scene::{ExportPass, Light, Pass};
use crate::view::Placement;
use crate::view::{Camera, ViewName};
use glam::{Mat3, Quat};
use std::f32::consts::TAU;
use std::path::Path;

/// The light in the convention of glTF viewers built on three.js.
pub const LIGHT: &str = "light.hdr";
/// Turn of that map about +Y in degrees, from the convention of USD, which is that of this crate.
pub(crate) const LIGHT_TURN: f32 = 90.0;
/// The files of the light, with the conventions that they are in.
const MAPS: [(&str, MapConvention); 2] =
    [(LIGHT, MapConvention::ThreeJs), ("light_blender.hdr", MapConvention::BlenderYUp)];
/// The files of the light.
pub(crate) const FILES: [&str; MAPS.len()] = [MAPS[0].0, MAPS[1].0];
/// Width and height of the maps in texels.
const SIZE: [u32; 2] = [1024, 512];

/// Writes the light that the pass shows, turned as the object; false if there is none yet.
///
/// # Errors
/// If a file cannot be written.
pub(crate) fn write_light(
    session: &mut Session,
    pass: &ExportPass,
    turn: Quat,
    folder: &Path,
) -> Result<bool> {
    let Some(map) = environment(session, pass, turn) else { return Ok(false) };
    for (name, convention) in MAPS {
        convention.from_lobelia(map.clone()).write_hdr(&folder.join(name))?;
    }
    Ok(true)
}

/// The light as a map: the given one, or the lobes' radiance.
fn environment(session: &mut Session, pass: &ExportPass, turn: Quat) -> Option<EnvironmentMap> {
    let of_pass = session.lights.of_passes.get(pass.of.as_deref().unwrap_or_default());
    if let Some(light) = of_pass {
        return Some(match &light.map {
            Some(map) => turned_map(map.map(), turn),
            None => map_of_lobes(&light.lobes, turn),
        });
    }
    let fixed = matches!(session.scene.light, Light::Fixed(_));
    let given = session.lights.own.as_ref().filter(|_| fixed).and_then(|light| light.map.clone());
    let turn = turn * own_turn(session);
    match given {
        Some(map) => Some(turned_map(map.map(), turn)),
        None => is_found(session, pass).then(|| map_of_lobes(&own_lobes(&mut session.pipeline.world), turn)),
    }
}

/// Whether the scene's own light is known when the pass runs.
fn is_found(session: &Session, pass: &ExportPass) -> bool {
    let earlier = session.scene.passes.iter().take_while(|other| other.name() != pass.name);
    let mut fits = earlier.filter(|other| matches!(other, Pass::Fit(_) | Pass::Shape(_)));
    !matches!(session.scene.light, Light::Unknown(_)) || fits.next().is_some()
}

/// The rotation of the own light into the world. One that goes with the camera stands as the first view has it.
fn own_turn(session: &mut Session) -> Quat {
    let world = &mut session.pipeline.world;
    let frame = world.get_resource::<OwnLightFrame>().map(|own| own.0).unwrap_or_default();
    if frame == LightFrame::World {
        return Quat::IDENTITY;
    }
    // In the first placement.
    let mut views = world.query::<(&ViewName, &Camera, &Placement)>();
    let upright = views.iter(world).filter(|(_, _, placement)| placement.0 == 0);
    let first = upright.min_by(|a, b| a.0.0.cmp(&b.0.0));
    first.map_or(Quat::IDENTITY, |(_, camera, _)| {
        let axes = Mat3::from(camera.world_from_camera.matrix3);
        Quat::from_mat3(&frame.light_from_world(axes).transpose())
    })
}

fn turned_map(map: &EnvironmentMap, turn: Quat) -> EnvironmentMap {
    let map = if map.width > SIZE[0] { map.downsampled(SIZE[0], SIZE[1]) } else { map.clone() };
    if turn == Quat::IDENTITY { map } else { map.rotated(turn) }
}

/// The lobes' radiance. One narrower than a texel is as wide as a texel, with the same power.
fn map_of_lobes(lobes: &[LightLobe], turn: Quat) -> EnvironmentMap {
    let finest = 2.0 * (SIZE[0] as f32 / TAU).powi(2);
    let widened = |lobe: &LightLobe| {
        let sharpness = lobe.sharpness.min(finest);
        let power = |sharpness: f32| sphere_integral(f64::from(sharpness));
        let dimmed = (power(lobe.sharpness) / power(sharpness)) as f32;
        LightLobe { sharpness, amplitude: lobe.amplitude * dimmed, ..*lobe }
    };
    let lobes: Vec<LightLobe> = lobes.iter().map(widened).collect();
    render_lobes(&rotate_lobes(&lobes, turn), SIZE[0], SIZE[1])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::{lobes_power, lobes_radiance};
    use crate::math::fibonacci::fibonacci_axes;
    use glam::Vec3;

    fn lobes() -> Vec<LightLobe> {
        let lobe =
            |axis: Vec3, sharpness, amplitude| LightLobe { axis: axis.normalize(), sharpness, amplitude };
        vec![
            lobe(Vec3::new(0.2, 0.9, -0.3), 0.5, Vec3::new(0.3, 0.4, 0.6)),
            lobe(Vec3::new(1.0, 0.2, 0.1), 30.0, Vec3::new(9.0, 4.0, 1.0)),
            lobe(Vec3::new(-0.4, -0.1, 0.8), 80.0, Vec3::new(1.0, 7.0, 2.0)),
        ]
    }

    #[test]
    fn each_file_has_the_lobes_where_its_program_looks_for_them() {
        let folder = tempfile::tempdir().unwrap();
        let turn = Quat::from_rotation_arc(Vec3::Z, Vec3::Y);
        let map = map_of_lobes(&lobes(), turn);
        for (name, convention) in MAPS {
            let path = folder.path().join(name);
            convention.from_lobelia(map.clone()).write_hdr(&path).unwrap();
            let read = EnvironmentMap::read(&path).unwrap();
            for direction in fibonacci_axes(300) {
                // As the program computes the place of a direction, by the formulas of its own sources.
                let d = direction;
                let (u, v) = match convention {
                    // Blender's importer turns (x, y, z) to (x, −z, y); there u = ½ − atan2(y, x)/2π, v = ½ − asin(z)/π.
                    MapConvention::BlenderYUp => {
                        let b = Vec3::new(d.x, -d.z, d.y);
                        (0.5 - b.y.atan2(b.x) / TAU, 0.5 - 2.0 * b.z.asin() / TAU)
                    }
                    _ => (0.5 + d.z.atan2(d.x) / TAU, 0.5 - 2.0 * d.y.asin() / TAU),
                };
                let found = read.bilinear_at(u.rem_euclid(1.0), v);
                let true_radiance = lobes_radiance(&lobes(), turn.inverse() * d);
                let error = (found - true_radiance).abs().max_element();
                assert!(
                    error < 0.02 * (1.0 + true_radiance.max_element()),
                    "{name} {d}: {found} {true_radiance}"
                );
            }
            let lobelia = convention.to_lobelia(read);
            let way = turn * lobes()[1].axis;
            assert!(lobelia.sample_bilinear(way).distance(map.sample_bilinear(way)) < 0.1, "{name}");
        }
    }

    #[test]
    fn a_lobe_between_texels_keeps_its_power() {
        let sun = LightLobe { axis: Vec3::new(0.6, 0.64, 0.48), sharpness: 1e7, amplitude: Vec3::splat(1e6) };
        let map = map_of_lobes(&[sun], Quat::IDENTITY);
        let (found, power) = (map.power().x, lobes_power(&[sun]).x);
        assert!((found / power - 1.0).abs() < 0.02, "{found} {power}");
    }

    #[test]
    fn a_given_map_is_turned_with_the_object() {
        let map = render_lobes(&lobes(), 256, 128);
        let turn = Quat::from_rotation_arc(Vec3::Z, Vec3::Y);
        assert_eq!(turned_map(&map, Quat::IDENTITY), map);
        let turned = turned_map(&map, turn);
        let axis = lobes()[1].axis;
        assert!((turned.sample_bilinear(turn * axis) - map.sample_bilinear(axis)).length() < 0.2);
        assert_eq!(turned_map(&render_lobes(&lobes(), 2048, 1024), Quat::IDENTITY).width, SIZE[0]);
    }
}
