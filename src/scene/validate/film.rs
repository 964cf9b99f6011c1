//! Whether what a film changes over time makes sense.

use crate::scene::film::OrbitKey;
use crate::scene::render::Orbit;
use crate::scene::validate::checks::Checks;

/// Checks the keys and sweeps of an orbit.
pub(super) fn film(checks: &mut Checks, at: &str, orbit: &Orbit) {
    for (i, key) in orbit.keys.iter().enumerate() {
        self::key(checks, &format!("{at}.keys.{i}"), key, orbit.keys[..i].last());
    }
    if let Some(sweep) = &orbit.light {
        let path = |field: &str| format!("{at}.light.{field}");
        if let Some(axis) = sweep.axis {
            checks.direction(&path("axis"), axis);
        }
        checks.number(&path("from_degrees"), sweep.from_degrees, -36_000.0..=36_000.0);
        checks.number(&path("to_degrees"), sweep.to_degrees, -36_000.0..=36_000.0);
    }
    if let Some(sweep) = &orbit.material {
        let pairs = [("roughness", sweep.roughness), ("albedo", sweep.albedo), ("specular", sweep.specular)];
        for (field, (from, to)) in pairs {
            checks.not_negative(&format!("{at}.material.{field}"), from);
            checks.not_negative(&format!("{at}.material.{field}"), to);
        }
    }
}

fn key(checks: &mut Checks, at: &str, key: &OrbitKey, before: Option<&OrbitKey>) {
    let path = |field: &str| format!("{at}.{field}");
    checks.number(&path("at"), key.at, before.map_or(0.0, |before| before.at)..=1.0);
    if let Some(angle) = key.angle_degrees {
        checks.number(&path("angle_degrees"), angle, -36_000.0..=36_000.0);
    }
    if let Some(elevation) = key.elevation_degrees {
        checks.number(&path("elevation_degrees"), elevation, -89.0..=89.0);
    }
    if let Some(radius) = key.radius {
        checks.distance(&path("radius"), radius);
    }
    if [key.angle_degrees, key.elevation_degrees, key.radius].iter().all(Option::is_none) {
        let expected = "expected some of `angle_degrees`, `elevation_degrees` and `radius`";
        checks.fail(at, "this key gives no value", expected, "");
    }
}
