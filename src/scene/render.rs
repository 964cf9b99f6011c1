//! How a pass renders: which views and shading, how the pictures look, films, and edits of the
//! material.

use crate::{scene::number, scene::yes};
use glam::Vec3;
use lobelia_geometry::{Error, Result};
use lobelia_io::codec::tone::Tone;
use lobelia_sg::{accurate::Quality, color::linear_from_srgb};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Which pictures are rendered, and how.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RenderSettings {
    /// Which views. Default `Test`.
    pub views: ViewChoice,
    /// How light is computed. Default `Accurate`.
    pub shading: Shading,
    /// Nodes of `Accurate` shading: `Default`, or `High` for final renders. Default `Default`.
    pub quality: Quality,
    /// Camera rays per pixel, 1 to 1024 (the path tracer uses its `spp`); in a film in closed form
    /// at edges and patterns only. Default 4.
    pub samples_per_pixel: u32,
    /// Brightness of the PNGs in stops, −20 to 20 (EXRs are as they are). Default 0.
    pub exposure: f32,
    /// Tone curve of the PNGs. Default `Srgb`.
    pub tone: Tone,
    /// Show the light behind the object in the PNGs. Default false.
    pub backdrop: bool,
    /// A turn around the object as a short film, besides the views. Default none.
    pub orbit: Option<Orbit>,
}

impl Default for RenderSettings {
    fn default() -> Self {
        Self {
            views: ViewChoice::Test,
            shading: Shading::Accurate,
            quality: Quality::Default,
            samples_per_pixel: 4,
            exposure: 0.0,
            tone: Tone::Srgb,
            backdrop: false,
            orbit: None,
        }
    }
}

/// Which views are rendered.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum ViewChoice {
    /// The held-out views.
    #[default]
    Test,
    /// The views that a fit sees.
    Train,
    /// All views.
    All,
    /// These views, by name; `Named([])`: no view (only the orbit).
    Named(Vec<String>),
}

/// How light is computed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum Shading {
    /// Accurate integrals of light SG × BRDF × cosine, with shadows and interreflection as far as
    /// `visibility` finds them.
    #[default]
    Accurate,
    /// PhySG's published approximation of them, without shadows and interreflection.
    Published,
    /// An unbiased path tracer with the same BRDF: shadows and interreflection.
    PathTraced {
        /// Paths per pixel, 1 to 65536. Default 64.
        #[serde(default = "number::<64>")]
        spp: u32,
        /// Most surface hits of a path, 1 to 64. Default 4.
        #[serde(default = "number::<4>")]
        max_bounces: u32,
        /// Where the light is a map, trace against the map itself and not against the lobes fitted
        /// to it. Default true.
        #[serde(default = "yes")]
        map: bool,
    },
}

/// A camera's turn around the object.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Orbit {
    /// Frames of the full turn, 1 to 10000. Default 60.
    pub frames: u32,
    /// Height of the camera over the horizon in degrees, −89 to 89. Default 20.
    pub elevation_degrees: f32,
    /// Distance from the object's center > 0. Default: far enough that the object fills the
    /// picture.
    pub radius: Option<f32>,
    /// Field of view in degrees, 0.001 to 170. Default 38.
    pub fov_degrees: f32,
    /// Width and height in pixels where they are not said, 1 to 16384. Default 256.
    pub size: u32,
    /// Width in pixels, 1 to 16384. Default: `size`.
    pub width: Option<u32>,
    /// Height in pixels, 1 to 16384. Default: `size`.
    pub height: Option<u32>,
    /// Frames per second, 1 to 100. Default 20.
    pub fps: u32,
    /// Where the camera is over time, in the order of time, instead of one even turn at one height
    /// and distance. Default [].
    pub keys: Vec<OrbitKey>,
    /// The light turns over the frames. Default: it stands still.
    pub light: Option<LightSweep>,
    /// The material changes over the frames. Default: it stays as it is.
    pub material: Option<MaterialSweep>,
}

impl Default for Orbit {
    fn default() -> Self {
        Self {
            frames: 60,
            elevation_degrees: 20.0,
            radius: None,
            fov_degrees: 38.0,
            size: 256,
            width: None,
            height: None,
            fps: 20,
            keys: Vec::new(),
            light: None,
            material: None,
        }
    }
}

impl Orbit {
    /// Width and height in pixels.
    pub fn sides(&self) -> [u32; 2] {
        [self.width, self.height].map(|side| side.unwrap_or(self.size))
    }
}

/// The camera at one time of a film. A value that no key gives is that of the orbit.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OrbitKey {
    /// When, from 0 (first frame) to 1 (last frame); not before the key above it.
    pub at: f32,
    /// Angle around the object in degrees, counterclockwise from above; 0 is in front. Default: no
    /// key, and so one even turn.
    #[serde(default)]
    pub angle_degrees: Option<f32>,
    /// Height of the camera over the horizon in degrees, −89 to 89. Default: no key.
    #[serde(default)]
    pub elevation_degrees: Option<f32>,
    /// Distance from the object's center > 0. Default: no key.
    #[serde(default)]
    pub radius: Option<f32>,
    /// How the values change from the key before to this one. Default `Smooth`.
    #[serde(default)]
    pub easing: Easing,
}

/// How a value changes between two times.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Easing {
    /// Evenly.
    Linear,
    /// Slowly at both ends.
    #[default]
    Smooth,
    /// Slowly at first.
    In,
    /// Slowly at last.
    Out,
    /// Not at all before the later time, and then at once.
    Hold,
}

impl Easing {
    /// The part of the change that is made at the part `t` of the time, both from 0 to 1.
    pub fn at(self, t: f32) -> f32 {
        let t = t.clamp(0.0, 1.0);
        match self {
            Self::Linear => t,
            Self::Smooth => t * t * (3.0 - 2.0 * t),
            Self::In => t * t,
            Self::Out => t * (2.0 - t),
            Self::Hold => t.floor(),
        }
    }
}

/// The light turns over the frames of a film.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LightSweep {
    /// Axis of the turn. Default: the scene's `up`.
    pub axis: Option<Vec3>,
    /// Angle at the first frame in degrees. Default 0.
    pub from_degrees: f32,
    /// Angle one frame after the last, so that whole turns play without a break; with `Hold` at the
    /// last frame. Default 360.
    pub to_degrees: f32,
    /// How it changes. Default `Linear`.
    pub easing: Easing,
}

impl Default for LightSweep {
    fn default() -> Self {
        Self { axis: None, from_degrees: 0.0, to_degrees: 360.0, easing: Easing::Linear }
    }
}

/// The material changes over the frames of a film: factors on what the pass shows, at the first
/// frame and at the last.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MaterialSweep {
    /// Factors ≥ 0 on the roughness. Default (1, 1).
    pub roughness: (f32, f32),
    /// Factors ≥ 0 on the diffuse albedo. Default (1, 1).
    pub albedo: (f32, f32),
    /// Factors ≥ 0 on the specular albedo. Default (1, 1).
    pub specular: (f32, f32),
    /// How they change. Default `Linear`.
    pub easing: Easing,
}

impl Default for MaterialSweep {
    fn default() -> Self {
        Self { roughness: (1.0, 1.0), albedo: (1.0, 1.0), specular: (1.0, 1.0), easing: Easing::Linear }
    }
}

/// One change of the material:
/// `Diffuse(action: Set(0.8, 0.1, 0.1), region: Sphere(center: (0, 0.5, 0), radius: 0.3))`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum Edit {
    /// Changes the diffuse albedo.
    Diffuse {
        /// The change of the diffuse albedo.
        action: ColorAction,
        /// Where. Default `All`.
        #[serde(default)]
        region: Region,
    },
    /// Changes the specular albedo.
    Specular {
        /// The change of the specular albedo.
        action: ColorAction,
        /// Where. Default `All`.
        #[serde(default)]
        region: Region,
    },
    /// Changes the roughness.
    Roughness {
        /// The change of the roughness.
        action: ScalarAction,
        /// Where. Default `All`.
        #[serde(default)]
        region: Region,
    },
}

impl Edit {
    /// The edits that make the whole object metal of a color, `#rrggbb` in sRGB, and of a roughness
    /// in [0.03, 1].
    ///
    /// # Errors
    /// If the color is written in another way.
    pub fn metal(color: &str, roughness: f32) -> Result<[Self; 3]> {
        Ok([Self::diffuse(Vec3::ZERO), Self::specular(color_of(color)?), Self::roughness(roughness)])
    }

    /// The edits that make the whole object plastic of a color, `#rrggbb` in sRGB, and of a
    /// roughness in [0.03, 1].
    ///
    /// # Errors
    /// If the color is written in another way.
    pub fn plastic(color: &str, roughness: f32) -> Result<[Self; 3]> {
        let gray = Self::specular(Vec3::splat(0.04));
        Ok([Self::diffuse(color_of(color)?), gray, Self::roughness(roughness)])
    }

    /// Sets the diffuse albedo, linear RGB in [0, 1], everywhere.
    pub fn diffuse(color: Vec3) -> Self {
        Self::Diffuse { action: ColorAction::Set(color), region: Region::All }
    }

    /// Sets the specular albedo, linear RGB in [0, 1], everywhere.
    pub fn specular(color: Vec3) -> Self {
        Self::Specular { action: ColorAction::Set(color), region: Region::All }
    }

    /// Sets the roughness, in [0.03, 1], everywhere.
    pub fn roughness(roughness: f32) -> Self {
        Self::Roughness { action: ScalarAction::Set(roughness), region: Region::All }
    }

    /// Where the edit applies.
    pub fn region(&self) -> &Region {
        let (Self::Diffuse { region, .. } | Self::Specular { region, .. } | Self::Roughness { region, .. }) =
            self;
        region
    }
}

/// The linear color of `#rrggbb`.
fn color_of(text: &str) -> Result<Vec3> {
    let digits = text.strip_prefix('#').filter(|digits| digits.len() == 6);
    let value = digits.and_then(|digits| u32::from_str_radix(digits, 16).ok()).ok_or_else(|| {
        Error::usage(format!("`{text}` is no color"), "Write it as #rrggbb, such as #d4af37 for gold.")
    })?;
    let channel = |shift: u32| linear_from_srgb((value >> shift & 255) as f32 / 255.0);
    Ok(Vec3::new(channel(16), channel(8), channel(0)))
}

/// Change of a color; results are clamped to [0, 1].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum ColorAction {
    /// Replaces it: `Set(0.9, 0.65, 0.3)`, in [0, 1].
    Set(Vec3),
    /// Multiplies it: `Scale(1.2, 1, 1)`, ≥ 0.
    Scale(Vec3),
    /// Moves it toward a color: old + weight (color − old).
    Blend {
        /// The color, in [0, 1].
        color: Vec3,
        /// In [0, 1].
        weight: f32,
    },
    /// Replaces the diffuse albedo by an image in texture space: PNG (sRGB) or EXR (linear); must
    /// exist. `Texture("paint.png")`.
    Texture(PathBuf),
}

/// Change of the roughness; results are clamped to [0.03, 1].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum ScalarAction {
    /// Replaces it: `Set(0.15)`, in [0.03, 1].
    Set(f32),
    /// Multiplies it: `Scale(0.5)`, ≥ 0.
    Scale(f32),
    /// Moves it toward a value: old + weight (value − old).
    Blend {
        /// The value, in [0.03, 1].
        value: f32,
        /// In [0, 1].
        weight: f32,
    },
}

/// Where an edit applies.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum Region {
    /// The whole object.
    #[default]
    All,
    /// Inside an axis-aligned box in world space.
    Box {
        /// Least corner.
        min: Vec3,
        /// Greatest corner; no coordinate below `min`'s.
        max: Vec3,
        /// Distance inside the walls over which the edit sets in, world units ≥ 0. Default 0: a
        /// hard edge.
        #[serde(default)]
        falloff: f32,
    },
    /// Inside a ball in world space.
    Sphere {
        /// Center.
        center: Vec3,
        /// Radius > 0.
        radius: f32,
        /// Distance inside the ball over which the edit sets in, world units ≥ 0. Default 0: a hard
        /// edge.
        #[serde(default)]
        falloff: f32,
    },
    /// Within a distance of a line in world space, as a brush paints it: around one point a ball.
    Stroke {
        /// The points that the line goes through, in order, straight from each to the next; 1 to
        /// 256.
        points: Vec<Vec3>,
        /// Greatest distance from the line, world units > 0.
        radius: f32,
        /// Distance inside the border over which the edit sets in, world units ≥ 0. Default 0: a
        /// hard edge.
        #[serde(default)]
        falloff: f32,
    },
    /// Where an image in texture space is bright (0: not at all, 1: fully); must exist.
    /// `Mask("belly.png")`.
    Mask(PathBuf),
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn easings_begin_and_end_alike() {
        for easing in [Easing::Linear, Easing::Smooth, Easing::In, Easing::Out, Easing::Hold] {
            assert_eq!([-1.0, 0.0, 1.0, 2.0].map(|t| easing.at(t)), [0.0, 0.0, 1.0, 1.0]);
        }
        let early = |easing: Easing| easing.at(0.25);
        assert_eq!(early(Easing::Linear), 0.25);
        assert!(early(Easing::In) < early(Easing::Smooth) && early(Easing::Smooth) < 0.25);
        assert!(early(Easing::Out) > 0.25 && early(Easing::Hold) == 0.0);
    }
}
