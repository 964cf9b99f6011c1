//! Orientation conventions of latitude-longitude maps in other programs.
//!
//! All of them have up at the top and show the surroundings as seen from inside (not mirrored), so
//! each is a rotation of the convention of this crate. `docs/src/conventions.md` has a picture and
//! the sources.

use crate::light::EnvironmentMap;
use glam::{Mat3, Quat, Vec3};
use serde::{Deserialize, Serialize};
use std::f32::consts::FRAC_PI_2;

/// The program whose convention a map follows.
///
/// | name | up | left edge | ¼ | middle | ¾ |
/// | --- | --- | --- | --- | --- | --- |
/// | `Lobelia`, `Mitsuba` | +Y | −Z | +X | +Z | −X |
/// | `ThreeJs`, `BlenderYUp` | +Y | −X | −Z | +X | +Z |
/// | `Blender` | +Z | −X | +Y | +X | −Y |
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum MapConvention {
    /// The convention of this crate: direction (cos θ sin φ, cos φ, sin θ sin φ) of (u, v), with φ =
    /// πv and θ = 2πu − π/2.
    #[default]
    Lobelia,
    /// Mitsuba 3's `envmap` without a `to_world`: the same.
    Mitsuba,
    /// three.js, and viewers of glTF files that are built on it: u = ½ + atan2(z, x)/2π, that is θ =
    /// 2πu − π.
    ThreeJs,
    /// Blender's world, +Z up (objects in Blender's own coordinates, as in NeRF-synthetic sets): u =
    /// ½ − atan2(y, x)/2π, v = ½ − asin(z)/π.
    Blender,
    /// Blender's world for an object exported with "+Y up" (glTF's default), which maps (x, y, z)
    /// to (x, z, −y); the result is the same as in three.js.
    BlenderYUp,
}

impl MapConvention {
    /// The rotation from [`EnvironmentMap::direction`] of a position in the map to the direction in
    /// this convention.
    pub fn turn(self) -> Quat {
        match self {
            Self::Lobelia | Self::Mitsuba => Quat::IDENTITY,
            Self::ThreeJs | Self::BlenderYUp => Quat::from_rotation_y(FRAC_PI_2),
            Self::Blender => Quat::from_mat3(&Mat3::from_cols(Vec3::Y, Vec3::Z, Vec3::X)),
        }
    }

    /// The map in the convention of this crate. If that only shifts whole columns, texels keep
    /// their values; otherwise it is resampled bilinearly.
    pub fn to_lobelia(self, map: EnvironmentMap) -> EnvironmentMap {
        self.turned(map, 1, self.turn())
    }

    /// A map in the convention of this crate, converted to this one: inverse of
    /// [`Self::to_lobelia`].
    pub fn from_lobelia(self, map: EnvironmentMap) -> EnvironmentMap {
        self.turned(map, 3, self.turn().inverse())
    }

    /// The map with every row shifted by so many quarters, or else rotated.
    fn turned(self, mut map: EnvironmentMap, quarters: usize, rotation: Quat) -> EnvironmentMap {
        let width = map.width as usize;
        match self {
            Self::Lobelia | Self::Mitsuba => {}
            Self::ThreeJs | Self::BlenderYUp if width.is_multiple_of(4) => {
                map.radiance.chunks_exact_mut(width).for_each(|row| row.rotate_left(width / 4 * quarters));
            }
            _ => map = map.rotated(rotation),
        }
        map
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f32::consts::{PI, TAU};

    use MapConvention::{Blender, BlenderYUp, Lobelia, Mitsuba, ThreeJs};

    const ALL: [MapConvention; 5] = [Lobelia, Mitsuba, ThreeJs, Blender, BlenderYUp];

    /// Position of a direction in the map, v down, as each program computes it.
    fn place(convention: MapConvention, d: Vec3) -> (f32, f32) {
        let (u, height) = match convention {
            Lobelia => (d.z.atan2(d.x) / TAU + 0.25, d.y),
            Mitsuba => (d.x.atan2(-d.z) / TAU, d.y),
            ThreeJs => (d.z.atan2(d.x) / TAU + 0.5, d.y),
            Blender => (0.5 - d.y.atan2(d.x) / TAU, d.z),
            BlenderYUp => return place(Blender, Vec3::new(d.x, -d.z, d.y)),
        };
        (u.rem_euclid(1.0), 0.5 - height.asin() / PI)
    }

    #[test]
    fn turns_are_the_programs_formulas() {
        for convention in ALL {
            for d in crate::fibonacci::fibonacci_axes(60) {
                let (u, v) = place(convention, d);
                let shown = convention.turn() * EnvironmentMap::direction(f64::from(u), f64::from(v));
                assert!(shown.distance(d) < 1e-5, "{convention:?}: {shown} {d}");
            }
        }
    }

    #[test]
    fn a_bright_spot_shines_from_where_the_program_has_it() {
        let d = Vec3::new(0.36, 0.48, 0.8);
        for (convention, width) in ALL.into_iter().flat_map(|c| [(c, 128), (c, 130)]) {
            let (u, v) = place(convention, d);
            let spot = EnvironmentMap::direction(f64::from(u), f64::from(v));
            let map = EnvironmentMap::from_directions(width, width / 2, |omega| {
                Vec3::splat((60.0 * (omega.dot(spot) - 1.0)).exp())
            });
            let imported = convention.to_lobelia(map.clone());
            let brightest = crate::fibonacci::fibonacci_axes(4000)
                .into_iter()
                .max_by(|a, b| imported.sample_bilinear(*a).x.total_cmp(&imported.sample_bilinear(*b).x));
            assert!(brightest.is_some_and(|b| b.angle_between(d) < 0.06), "{convention:?} {brightest:?}");
            let back = convention.from_lobelia(imported);
            assert!(back.mean_squared_difference(&map).unwrap() < 1e-4, "{convention:?}");
        }
    }
}
