//! The light that a scene describes, ready to shade with; and a light in a file of its own: the RON
//! text that a scene has after `light: Fixed(`, `.npy` lobes, and maps.

use crate::scene::{Light, LightSource, ron_tree::options};
use glam::{EulerRot, Quat, Vec3};
use lobelia_geometry::error::{Error, Result, stop::is_stopping};
use lobelia_io::codec::npy::{NpyConvention, read_lobes, write_lobes};
use lobelia_io::codec::{envmap::read_map_with_notes, envmap::write_map_exr, file, file::check_finite};
use lobelia_world::light::map_fit::{MOST_FITTED, MapFit, fit_map_with, target_of};
use lobelia_world::light::{
    EnvironmentMap, LightLobe, convention::MapConvention, illuminate::MapLight, render_lobes, rotate_lobes,
    scale_lobes, validate_lobes, validate_map,
};
use std::fmt::Write as _;
use std::{path::Path, path::PathBuf, sync::Arc};

/// A light ready to shade with: lobes for closed forms, and the thing itself for path tracing.
#[derive(Clone)]
pub struct LoadedLight {
    /// SG lobes, given or fitted.
    pub lobes: Vec<LightLobe>,
    /// The map, if that is what was given.
    pub map: Option<Arc<MapLight>>,
    /// What says it; `None` of one that was made in memory.
    pub source: Option<LightSource>,
    /// Repairs made on reading.
    pub notes: Vec<String>,
}

impl LoadedLight {
    /// What says it: its source, or its lobes.
    pub(crate) fn said(self) -> LightSource {
        let (lobes, scale, rotation_degrees) = (self.lobes, 1.0, Vec3::ZERO);
        self.source.unwrap_or(LightSource::Lobes { lobes, scale, rotation_degrees })
    }

    /// A light of lobes.
    pub fn of_lobes(lobes: Vec<LightLobe>) -> Self {
        Self { lobes, map: None, source: None, notes: Vec::new() }
    }

    /// Reads an environment map, EXR or HDR, and fits lobes to it.
    ///
    /// # Errors
    /// If the file is missing or wrong.
    pub fn map(path: impl Into<PathBuf>) -> Result<Self> {
        load_light(&LightSource::map(path.into()))
    }
}

/// Reads (and for a map, fits) a light.
///
/// # Errors
/// If a file is missing or wrong, or a lobe is.
pub fn load_light(source: &LightSource) -> Result<LoadedLight> {
    let (scale, degrees) = source.scale_and_turn();
    let turn = rotation(degrees);
    let given = |lobes: &[LightLobe]| {
        let lobes = rotate_lobes(&scale_lobes(lobes, Vec3::splat(scale)), turn);
        LoadedLight::of_lobes(lobes)
    };
    let mut light = match source {
        LightSource::Ron { path, .. } => return load_light(&inlined(path, scale, degrees)?),
        LightSource::Lobes { lobes, .. } => {
            let unit = lobes.iter().map(|l| LightLobe { axis: l.axis.normalize_or(l.axis), ..*l });
            given(&unit.collect::<Vec<_>>())
        }
        LightSource::Npy { path, convention, .. } => given(&read_lobes(path, *convention)?),
        LightSource::Map { path, lobes, convention, upper_hemisphere, white, .. } => {
            let (map, notes) = read_map_with_notes(path)?;
            let options = MapFit { upper_hemisphere: *upper_hemisphere, white: *white, ..MapFit::default() };
            let map = target_of(&convention.to_lobelia(map), &options);
            check_lit(path, &map)?;
            let map = map.scaled(Vec3::splat(scale));
            validate_map(&map).map_err(|problem| unusable(format!("{}: {problem}", path.display())))?;
            let fitted = fit_map_with(&map, *lobes as usize, &options, &mut |_| {}, &is_stopping)?.lobes;
            let map = if degrees == Vec3::ZERO { map } else { map.rotated(turn) };
            let (lobes, map) = (rotate_lobes(&fitted, turn), Some(Arc::new(MapLight::new(map))));
            LoadedLight { lobes, map, source: None, notes }
        }
    };
    validate_lobes(&light.lobes).map_err(unusable)?;
    light.source = Some(source.clone());
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

/// Contents of a light file.
#[derive(Clone, Debug, PartialEq)]
pub enum LightFile {
    /// SG lobes.
    Lobes(Vec<LightLobe>),
    /// A latitude-longitude map.
    Map(EnvironmentMap),
}

/// How light files are to be understood.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LightConventions {
    /// Which way the axes of `.npy` lobes point.
    pub npy: NpyConvention,
    /// Which way EXR and HDR maps face.
    pub map: MapConvention,
}

const HELP: &str = "Give a .ron light, .npy lobes, or an .exr or .hdr map.";

/// Reads a light and says what was repaired: RON (`Lobes(…)`, `Npy(…)` or `Map(…)`, paths relative
/// to the file), `.npy` lobes, or a map told by its first bytes.
///
/// # Errors
/// [`Error::Input`] if the file is missing or wrong.
pub fn read_light(path: &Path, conventions: LightConventions) -> Result<(LightFile, Vec<String>)> {
    let (light, notes) = match extension(path).as_str() {
        "ron" => open(&inlined(path, 1.0, Vec3::ZERO)?),
        "npy" => Ok((LightFile::Lobes(read_lobes(path, conventions.npy)?), Vec::new())),
        _ => read_map(path, conventions.map).map(|(map, notes)| (LightFile::Map(map), notes)),
    }?;
    let valid = match &light {
        LightFile::Lobes(lobes) => validate_lobes(lobes),
        LightFile::Map(map) => validate_map(map),
    };
    valid.map_err(|problem| bad_ron(path, "", problem))?;
    Ok((light, notes))
}

/// Reads an EXR or HDR map that faces as `convention` says; the notes say what was repaired.
///
/// # Errors
/// As [`read_map_with_notes`].
pub fn read_map(path: &Path, convention: MapConvention) -> Result<(EnvironmentMap, Vec<String>)> {
    let (map, notes) = read_map_with_notes(path)?;
    Ok((convention.to_lobelia(map), notes))
}

fn extension(path: &Path) -> String {
    path.extension().unwrap_or_default().to_string_lossy().to_ascii_lowercase()
}

fn bad_ron(path: &Path, place: &str, problem: String) -> Error {
    let help = "A light file says what a scene has inside `light: Fixed(…)`, e.g. Lobes(lobes: […]).";
    Error::input(path, place, problem, help)
}

/// Refuses a map of which nothing is lit that a fit looks at: `target` is what the fit's options
/// leave of it.
///
/// # Errors
/// [`Error::Input`].
pub fn check_lit(path: &Path, target: &EnvironmentMap) -> Result<()> {
    if target.radiance.iter().any(|r| r.max_element() > 0.0) {
        return Ok(());
    }
    let problem = "the map gives no light from above the horizon, and only that is wanted";
    Err(Error::input(path, "", problem, "Leave `upper_hemisphere` out, or turn the map."))
}

/// Returns the light of a RON file, with paths from where that file is; then scaled and turned.
///
/// # Errors
/// [`Error::Input`] if the file is missing or wrong, or names another RON file.
pub(crate) fn inlined(path: &Path, scale: f32, rotation_degrees: Vec3) -> Result<LightSource> {
    let text = file::read_text(path, file::MOST_TEXT, |_| HELP.to_owned())?;
    let mut source: LightSource = options().from_str(&text).map_err(|error| {
        let at = error.span.start;
        bad_ron(path, &format!("line {}, column {}", at.line, at.col), error.code.to_string())
    })?;
    if let LightSource::Map { lobes, .. } = &source
        && !(1..=MOST_FITTED as u32).contains(lobes)
    {
        return Err(bad_ron(path, "", format!("lobes is {lobes}, not from 1 to {MOST_FITTED}")));
    }
    let (own_scale, own_degrees) = match &mut source {
        LightSource::Lobes { scale, rotation_degrees, .. } => (scale, rotation_degrees),
        LightSource::Npy { path: file, scale, rotation_degrees, .. }
        | LightSource::Map { path: file, scale, rotation_degrees, .. } => {
            *file = path.parent().unwrap_or(Path::new("")).join(&*file);
            (scale, rotation_degrees)
        }
        LightSource::Ron { .. } => {
            return Err(bad_ron(path, "", "names another RON file".to_owned()));
        }
    };
    if !(own_scale.is_finite() && *own_scale >= 0.0 && own_degrees.is_finite()) {
        let problem = "scale must be finite and not negative, rotation_degrees finite";
        return Err(bad_ron(path, "", problem.to_owned()));
    }
    *own_scale *= scale;
    *own_degrees = if *own_degrees == Vec3::ZERO || rotation_degrees == Vec3::ZERO {
        *own_degrees + rotation_degrees
    } else {
        angles(rotation(rotation_degrees) * rotation(*own_degrees))
    };
    Ok(source)
}

/// The files that a light is read from: its own, and the one that a RON file names. One that cannot
/// be read names none.
pub fn files_of(path: &Path) -> Vec<PathBuf> {
    let named = match extension(path).as_str() {
        "ron" => inlined(path, 1.0, Vec3::ZERO).ok(),
        _ => None,
    };
    let named = named.and_then(|source| match source {
        LightSource::Npy { path, .. } | LightSource::Map { path, .. } => Some(path),
        LightSource::Lobes { .. } | LightSource::Ron { .. } => None,
    });
    std::iter::once(path.to_owned()).chain(named).collect()
}

/// Turn about the world's x, then y, then z axis.
pub fn rotation(degrees: Vec3) -> Quat {
    let radians = degrees * (std::f32::consts::PI / 180.0);
    Quat::from_euler(EulerRot::XYZEx, radians.x, radians.y, radians.z)
}

/// The angles in degrees of which [`rotation`] makes a turn.
pub fn angles(turn: Quat) -> Vec3 {
    let (x, y, z) = turn.to_euler(EulerRot::XYZEx);
    Vec3::new(x, y, z) * (180.0 / std::f32::consts::PI)
}

/// The light of a source.
fn open(source: &LightSource) -> Result<(LightFile, Vec<String>)> {
    let (scale, degrees) = source.scale_and_turn();
    let (light, notes) = match source {
        LightSource::Lobes { lobes, .. } => {
            (LightFile::Lobes(lobes.iter().map(with_unit_axis).collect()), Vec::new())
        }
        LightSource::Npy { path, convention: of, .. } => {
            (LightFile::Lobes(read_lobes(path, *of)?), Vec::new())
        }
        LightSource::Map { path, convention, .. } => {
            let (map, notes) = read_map(path, *convention)?;
            (LightFile::Map(map), notes)
        }
        LightSource::Ron { path, .. } => return open(&inlined(path, scale, degrees)?),
    };
    let light = match light {
        LightFile::Lobes(lobes) => LightFile::Lobes(scale_lobes(&lobes, Vec3::splat(scale))),
        LightFile::Map(map) => LightFile::Map(map.scaled(Vec3::splat(scale))),
    };
    Ok((if degrees == Vec3::ZERO { light } else { light.rotated(rotation(degrees)) }, notes))
}

/// An axis within 10⁻⁶ of unit length keeps its bits, so that lights come back as they were
/// written.
fn with_unit_axis(lobe: &LightLobe) -> LightLobe {
    if (lobe.axis.length() - 1.0).abs() <= 1e-6 {
        return *lobe;
    }
    LightLobe { axis: lobe.axis.normalize_or_zero(), ..*lobe }
}

impl LightFile {
    /// The light turned: what came from direction d now comes from `turn * d`.
    pub fn rotated(self, turn: Quat) -> Self {
        match self {
            Self::Lobes(lobes) => Self::Lobes(rotate_lobes(&lobes, turn)),
            Self::Map(map) => Self::Map(map.rotated(turn)),
        }
    }

    /// The light as a map of `width` × `height` texels (at least 1): lobes are evaluated at texel
    /// centers; a map is averaged down where it is larger and blended where it is smaller.
    pub fn to_map(&self, width: u32, height: u32) -> EnvironmentMap {
        match self {
            Self::Lobes(lobes) => render_lobes(lobes, width, height),
            Self::Map(map) => {
                let less = map.downsampled(width.min(map.width), height.min(map.height));
                if (less.width, less.height) == (width, height) {
                    return less;
                }
                EnvironmentMap::from_directions(width, height, |omega| less.sample_bilinear(omega))
            }
        }
    }

    /// Writes the light: lobes as `.ron` or `.npy`, a map as `.exr`.
    ///
    /// # Errors
    /// [`Error::Usage`] for another extension; [`Error::Run`] for a number that is not finite;
    /// [`Error::Io`] when the system refuses.
    pub fn write(&self, path: &Path, conventions: LightConventions) -> Result<()> {
        match (self, extension(path).as_str()) {
            (Self::Lobes(lobes), "ron") => {
                let values = lobes.iter().flat_map(|l| {
                    l.axis.to_array().into_iter().chain([l.sharpness]).chain(l.amplitude.to_array())
                });
                check_finite(path, values, |at| format!("lobe {} is not finite", at / 7))?;
                file::write_bytes(path, to_ron(lobes).as_bytes())
            }
            (Self::Lobes(lobes), "npy") => write_lobes(path, lobes, conventions.npy),
            (Self::Map(map), "exr") => write_map_exr(&conventions.map.from_lobelia(map.clone()), path),
            (Self::Lobes(_), _) => Err(refused(path, "lobes are written as .ron or .npy")),
            (Self::Map(_), _) => Err(refused(path, "a map is written as .exr")),
        }
    }
}

fn refused(path: &Path, what: &str) -> Error {
    let help = "Name the output accordingly; `env fit` makes lobes of a map, `env render` a map of lobes.";
    Error::usage(format!("{}: {what}", path.display()), help)
}

/// Lobes as a RON [`LightSource::Lobes`], one a line; every number comes back bit for bit.
pub(crate) fn to_ron(lobes: &[LightLobe]) -> String {
    let mut text =
        String::from("// For a scene: light: Fixed(…) or Initial(…) around this.\nLobes(lobes: [\n");
    let three = |v: Vec3| format!("({:?}, {:?}, {:?})", v.x, v.y, v.z);
    for lobe in lobes {
        let (axis, color) = (three(lobe.axis), three(lobe.amplitude));
        // Writing to a `String` cannot fail.
        let _ = writeln!(text, "    (axis: {axis}, sharpness: {:?}, amplitude: {color}),", lobe.sharpness);
    }
    text + "])\n"
}

#[cfg(test)]
mod tests {
    use super::*;
    use lobelia_sg::fibonacci::fibonacci_axes;

    #[test]
    fn a_scene_names_a_ron_light_and_turns_it_further() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("light.ron");
        let text = "Lobes(lobes: [(axis: (0, 0, 1), sharpness: 9, amplitude: (1, 2, 3))], scale: 2, rotation_degrees: (30, 40, 50))";
        std::fs::write(&path, text).unwrap();
        let rotation_degrees = Vec3::new(-20.0, 70.0, 10.0);
        let source = LightSource::Ron { path: path.clone(), scale: 3.0, rotation_degrees };
        let loaded = load_light(&source).unwrap().lobes[0];
        let axis = rotation(rotation_degrees) * (rotation(Vec3::new(30.0, 40.0, 50.0)) * Vec3::Z);
        assert!(loaded.axis.distance(axis) < 1e-5, "{} {axis}", loaded.axis);
        assert!(loaded.amplitude.distance(Vec3::new(6.0, 12.0, 18.0)) < 1e-5);
        let bright = LightSource::Ron { path: path.clone(), scale: 1e30, rotation_degrees: Vec3::ZERO };
        let error = load_light(&bright).err().unwrap();
        assert!(error.to_string().contains("lobe 0: amplitude") && error.exit_code() == 2, "{error}");
        std::fs::write(&path, "Ron(path: \"other.ron\")").unwrap();
        let error = inlined(&path, 1.0, Vec3::ZERO).unwrap_err();
        assert!(error.to_string().contains("another RON file") && error.exit_code() == 2, "{error}");
    }

    fn lobes() -> Vec<LightLobe> {
        let lobe =
            |(i, axis)| LightLobe { axis, sharpness: 0.7 + i as f32, amplitude: Vec3::new(1e-7, 0.3, 1e5) };
        fibonacci_axes(9).into_iter().enumerate().map(lobe).collect()
    }

    #[test]
    fn lights_come_back_in_every_format() {
        let folder = tempfile::tempdir().unwrap();
        let conventions = LightConventions { npy: NpyConvention::PhySgFit, map: MapConvention::ThreeJs };
        let map = LightFile::Map(render_lobes(&lobes(), 32, 16));
        for (name, light) in
            [("l.ron", LightFile::Lobes(lobes())), ("l.npy", LightFile::Lobes(lobes())), ("l.exr", map)]
        {
            let path = folder.path().join(name);
            light.write(&path, conventions).unwrap();
            let (back, notes) = read_light(&path, conventions).unwrap();
            assert!(notes.is_empty());
            assert_eq!(back, light);
        }
        let refused = LightFile::Lobes(lobes()).write(&folder.path().join("l.exr"), conventions);
        assert_eq!(refused.unwrap_err().exit_code(), 2);
    }

    #[test]
    fn ron_lights_are_turned_and_scaled_and_name_files_beside_them() {
        let folder = tempfile::tempdir().unwrap();
        write_map_exr(&render_lobes(&lobes(), 32, 16), folder.path().join("sky.exr")).unwrap();
        let path = folder.path().join("light.ron");
        let text = r#"Map(path: "sky.exr", scale: 2, rotation_degrees: (0, 90, 0), convention: Lobelia)"#;
        std::fs::write(&path, text).unwrap();
        let (light, _) = read_light(&path, LightConventions::default()).unwrap();
        let turn = Quat::from_rotation_y(std::f32::consts::FRAC_PI_2);
        let expected = render_lobes(&scale_lobes(&rotate_lobes(&lobes(), turn), Vec3::splat(2.0)), 32, 16);
        let difference = light.to_map(32, 16).mean_squared_difference(&expected).unwrap();
        let black = expected.mean_squared_difference(&expected.scaled(Vec3::ZERO)).unwrap();
        assert!(difference < 1e-2 * black, "{difference} of {black}");
    }

    #[test]
    fn wrong_ron_lights_are_refused_with_their_place() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("light.ron");
        let refused = |text: &str, word: &str| {
            std::fs::write(&path, text).unwrap();
            let error = read_light(&path, LightConventions::default()).expect_err("a bad light");
            assert_eq!(error.exit_code(), 2);
            assert!(error.to_string().contains(word), "{error} should say {word}");
        };
        refused("Lobes(lobes: [\n(axis: (0, 1), sharpness: 1, amplitude: (1, 1, 1))])", "line 2");
        refused("Lobes(lobes: [])", "no light lobes");
        refused("Lobes(lobes: [(axis: (0, 0, 0), sharpness: 1, amplitude: (1, 1, 1))])", "lobe 0");
        refused("Lobes(lobes: [(axis: (0, 1, 0), sharpness: 1, amplitude: (1, 1, 1))], scale: -1)", "scale");
        refused("Map(path: \"none.exr\")", "none.exr");
        let one = |sharpness: &str, amplitude: &str, scale: &str| {
            format!(
                "Lobes(lobes: [(axis: (0, 1, 0), sharpness: {sharpness}, amplitude: ({amplitude}, 1, 1))], scale: {scale})"
            )
        };
        refused(&one("1e38", "1", "1"), "sharpness 1e38");
        refused(&one("1", "1e38", "1"), "amplitude 1e38");
        refused(&one("1", "inf", "1"), "amplitude inf");
        refused(&one("1", "NaN", "1"), "amplitude NaN");
        refused(&one("1", "1e14", "1e30"), "lobe 0: amplitude inf");
        let lobe = "(axis: (0, 1, 0), sharpness: 1, amplitude: (1, 1, 1)),";
        refused(&format!("Lobes(lobes: [{}])", lobe.repeat(2049)), "at most 2048");
        write_map_exr(&render_lobes(&lobes(), 32, 16), folder.path().join("sky.exr")).unwrap();
        refused("Map(path: \"sky.exr\", lobes: 4000000000)", "lobes is 4000000000");
        refused("Map(path: \"sky.exr\", scale: 1e30)", "has radiance");
        refused(&"(".repeat(100_000), "line 1");
        std::fs::File::create(&path).unwrap().set_len(file::MOST_TEXT + 1).unwrap();
        let error = read_light(&path, LightConventions::default()).unwrap_err();
        assert!(error.to_string().contains("at most 16.0 MiB are read"), "{error}");
    }

    #[test]
    fn lights_that_are_not_finite_are_not_written() {
        let folder = tempfile::tempdir().unwrap();
        let mut broken = lobes();
        broken[4].sharpness = f32::INFINITY;
        for name in ["l.ron", "l.npy"] {
            let path = folder.path().join(name);
            let error =
                LightFile::Lobes(broken.clone()).write(&path, LightConventions::default()).unwrap_err();
            assert!(error.to_string().contains("lobe 4 is not finite") && !path.exists(), "{error}");
        }
    }
}
