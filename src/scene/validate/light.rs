//! Whether lights make sense.

use crate::light::map_fit::MOST_FITTED;
use crate::light::{MAX_RADIANCE, MAX_SHARPNESS, MOST_LOBES};
use crate::scene::light::{Light, LightFrameChoice, LightSource};
use crate::scene::validate::checks::Checks;
use crate::scene::views::{PlacementLight, PlacementSpec, Views};

/// The frame of a light at `path`.
pub(super) fn light_frame(checks: &mut Checks, path: &str, frame: LightFrameChoice) {
    if let LightFrameChoice::Turntable(axis) = frame {
        checks.direction(path, axis);
    }
}

pub(super) fn light(checks: &mut Checks, light: &Light) {
    match light {
        Light::Unknown(unknown) => checks.count("light.lobes", unknown.lobes, 1..=MOST_LOBES as u32),
        Light::Initial(source) | Light::Fixed(source) => light_source(checks, "light", source),
    }
}

/// Lights of photographs beside the scene's own.
pub(super) fn other_lights(checks: &mut Checks, views: &Views, own: &Light) {
    match views {
        Views::Dataset(data) => placement_lights(checks, &data.placements, own),
        Views::Photographed(made) if !made.truth.other_lights.is_empty() => {
            let ok = matches!(own, Light::Unknown(_));
            let expected = "Unknown(…), as there are `other_lights`, which a fit is to find as well";
            checks.require(ok, "light", said(own), expected);
        }
        Views::Photographed(_) | Views::Cameras(_) => {}
    }
}

fn said(light: &Light) -> &'static str {
    match light {
        Light::Unknown(_) => "Unknown(…)",
        Light::Initial(_) => "Initial(…)",
        Light::Fixed(_) => "Fixed(…)",
    }
}

fn placement_lights(checks: &mut Checks, placements: &[PlacementSpec], own: &Light) {
    let is_known = matches!(own, Light::Fixed(_));
    for (i, placement) in placements.iter().enumerate() {
        let path = format!("views.placements.{i}.light");
        let (value, suits, expected) = match &placement.light {
            PlacementLight::Same => continue,
            _ if i == 0 => ("said", false, "nothing: the first placement is in the scene's `light`"),
            PlacementLight::Own if is_known => {
                ("Own", false, "Fixed(…), as the scene's `light` is known, or Same")
            }
            PlacementLight::Own => {
                let unknown = matches!(own, Light::Unknown(_));
                ("Own", unknown, "Same, or a scene's `light` that is Unknown(…) and not Initial(…)")
            }
            PlacementLight::Fixed(source) => {
                light_source(checks, &path, source);
                ("Fixed(…)", is_known, "Own, as the scene's `light` is not known, or Same")
            }
        };
        checks.require(suits, &path, value, expected);
    }
}

/// A light at `path`.
pub(super) fn light_source(checks: &mut Checks, path: &str, source: &LightSource) {
    let at = |field: &str| format!("{path}.{field}");
    let (scale, rotation) = match source {
        LightSource::Lobes { lobes, scale, rotation_degrees } => {
            let count = u32::try_from(lobes.len()).unwrap_or(u32::MAX);
            checks.count(&at("lobes"), count, 1..=MOST_LOBES as u32);
            for (index, lobe) in lobes.iter().enumerate() {
                let at = |field: &str| format!("{path}.lobes.{index}.{field}");
                checks.direction(&at("axis"), lobe.axis);
                checks.number(&at("sharpness"), lobe.sharpness, 0.0..=MAX_SHARPNESS);
                let usable = |channel: &f32| (0.0..=MAX_RADIANCE).contains(channel);
                let expected = format!("three numbers from 0 to {MAX_RADIANCE:e}");
                let ok = lobe.amplitude.to_array().iter().all(usable);
                checks.require(ok, &at("amplitude"), lobe.amplitude, &expected);
            }
            (scale, rotation_degrees)
        }
        LightSource::Npy { scale, rotation_degrees, .. }
        | LightSource::Ron { scale, rotation_degrees, .. } => (scale, rotation_degrees),
        LightSource::Map { scale, rotation_degrees, lobes, .. } => {
            checks.count(&at("lobes"), *lobes, 1..=MOST_FITTED as u32);
            (scale, rotation_degrees)
        }
    };
    checks.not_negative(&at("scale"), *scale);
    checks.finite(&at("rotation_degrees"), *rotation);
}
