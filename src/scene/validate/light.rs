//! Whether lights make sense.

use crate::scene::light::{Light, LightSource};
use crate::scene::validate::checks::Checks;

pub(super) fn light(checks: &mut Checks, light: &Light) {
    match light {
        Light::Unknown(unknown) => checks.count("light.lobes", unknown.lobes, 1..=512),
        Light::Initial(source) | Light::Fixed(source) => light_source(checks, "light", source),
    }
}

/// A light at `path`.
pub(super) fn light_source(checks: &mut Checks, path: &str, source: &LightSource) {
    let at = |field: &str| format!("{path}.{field}");
    let (scale, rotation) = match source {
        LightSource::Lobes { lobes, scale, rotation_degrees } => {
            let count = u32::try_from(lobes.len()).unwrap_or(u32::MAX);
            checks.count(&at("lobes"), count, 1..=512);
            for (index, lobe) in lobes.iter().enumerate() {
                let at = |field: &str| format!("{path}.lobes.{index}.{field}");
                checks.direction(&at("axis"), lobe.axis);
                checks.not_negative(&at("sharpness"), lobe.sharpness);
                checks.factors(&at("amplitude"), lobe.amplitude);
            }
            (scale, rotation_degrees)
        }
        LightSource::Npy { scale, rotation_degrees, .. }
        | LightSource::Ron { scale, rotation_degrees, .. } => (scale, rotation_degrees),
        LightSource::Map { scale, rotation_degrees, lobes, .. } => {
            checks.count(&at("lobes"), *lobes, 1..=512);
            (scale, rotation_degrees)
        }
    };
    checks.not_negative(&at("scale"), *scale);
    checks.finite(&at("rotation_degrees"), *rotation);
}
