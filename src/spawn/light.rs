//! The light that a scene describes, ready to shade with.

use crate::codec::npy::read_lobes;
use crate::error::{Error, Result};
use crate::light::illuminate::MapLight;
use crate::light::map_fit::{MapFit, fit_map, target_of};
use crate::light::{EnvironmentMap, LightLobe, rotate_lobes, scale_lobes, validate_lobes, validate_map};
use crate::scene::{Light, LightSource};
use crate::spawn::light_file::{check_lit, inlined, rotation};
use glam::Vec3;
use std::sync::Arc;

/// A light ready to shade with: lobes for closed forms, and the thing itself for path tracing.
#[derive(Clone)]
pub struct LoadedLight {
    /// SG lobes, given or fitted.
    pub lobes: Vec<LightLobe>,
    /// The map, if that is what was given.
    pub map: Option<Arc<MapLight>>,
    /// What was repaired on reading.
    pub notes: Vec<String>,
}

/// Reads (and for a map, fits) a light.
///
/// # Errors
/// If a file is missing or wrong, or a lobe is.
pub fn load_light(source: &LightSource) -> Result<LoadedLight> {
    let turned = |lobes: &[LightLobe], scale: f32, degrees: Vec3| {
        rotate_lobes(&scale_lobes(lobes, Vec3::splat(scale)), rotation(degrees))
    };
    let light = match source {
        LightSource::Ron { path, scale, rotation_degrees } => {
            return load_light(&inlined(path, *scale, *rotation_degrees)?);
        }
        LightSource::Lobes { lobes, scale, rotation_degrees } => {
            let unit: Vec<LightLobe> =
                lobes.iter().map(|l| LightLobe { axis: l.axis.normalize_or(l.axis), ..*l }).collect();
            LoadedLight { lobes: turned(&unit, *scale, *rotation_degrees), map: None, notes: Vec::new() }
        }
        LightSource::Npy { path, convention, scale, rotation_degrees } => {
            let lobes = read_lobes(path, *convention)?;
            LoadedLight { lobes: turned(&lobes, *scale, *rotation_degrees), map: None, notes: Vec::new() }
        }
        LightSource::Map { path, scale, rotation_degrees, lobes, convention, upper_hemisphere, white } => {
            let (map, notes) = EnvironmentMap::read_with_notes(path)?;
            let options = MapFit { upper_hemisphere: *upper_hemisphere, white: *white, ..MapFit::default() };
            let map = target_of(&convention.to_lobelia(map), &options);
            check_lit(path, &map)?;
            let map = map.scaled(Vec3::splat(*scale));
            validate_map(&map).map_err(|problem| unusable(format!("{}: {problem}", path.display())))?;
            let fitted = fit_map(&map, *lobes as usize, &options)?.lobes;
            let turn = rotation(*rotation_degrees);
            let map = if *rotation_degrees == Vec3::ZERO { map } else { map.rotated(turn) };
            LoadedLight { lobes: rotate_lobes(&fitted, turn), map: Some(Arc::new(MapLight::new(map))), notes }
        }
    };
    validate_lobes(&light.lobes).map_err(unusable)?;
    Ok(light)
}

fn unusable(problem: String) -> Error {
    Error::usage(format!("the light cannot be used: {problem}"), "Correct its lobes or texels, and `scale`.")
}

/// The lobes that a fit starts from, or the known ones.
pub fn initial_lobes(light: &Light, loaded: Option<&LoadedLight>) -> Vec<LightLobe> {
    match (light, loaded) {
        (_, Some(loaded)) => loaded.lobes.clone(),
        (Light::Unknown(unknown), None) => LightLobe::even(unknown.lobes as usize),
        (Light::Initial(_) | Light::Fixed(_), None) => Vec::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scene_names_a_ron_light_and_turns_it_further() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("light.ron");
        let text = "Lobes(lobes: [(axis: (0, 0, 1), sharpness: 9, amplitude: (1, 2, 3))], scale: 2, rotation_degrees: (30, 40, 50))";
        std::fs::write(&path, text).unwrap();
        let source = LightSource::Ron {
            path: path.clone(),
            scale: 3.0,
            rotation_degrees: Vec3::new(-20.0, 70.0, 10.0),
        };
        let loaded = load_light(&source).unwrap().lobes[0];
        let axis = rotation(Vec3::new(-20.0, 70.0, 10.0)) * (rotation(Vec3::new(30.0, 40.0, 50.0)) * Vec3::Z);
        assert!(loaded.axis.distance(axis) < 1e-5, "{} {axis}", loaded.axis);
        assert!(loaded.amplitude.distance(Vec3::new(6.0, 12.0, 18.0)) < 1e-5);
        let bright = LightSource::Ron { path: path.clone(), scale: 1e30, rotation_degrees: Vec3::ZERO };
        let error = load_light(&bright).err().unwrap();
        assert!(error.to_string().contains("lobe 0: amplitude") && error.exit_code() == 2, "{error}");
        std::fs::write(&path, "Ron(path: \"other.ron\")").unwrap();
        let error = inlined(&path, 1.0, Vec3::ZERO).unwrap_err();
        assert!(error.to_string().contains("another RON file") && error.exit_code() == 2, "{error}");
    }
}
