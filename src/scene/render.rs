//! How a pass renders: which views, which shading, and how the pictures look.

use crate::math::accurate::Quality;
use crate::report::tone::Tone;
use crate::scene::film::{LightSweep, MaterialSweep, OrbitKey};
use serde::{Deserialize, Serialize};
use std::ops::Range;

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
    /// Camera rays per pixel, 1 to 1024 (the path tracer uses its `spp`); in a film in closed form at edges and patterns only. Default 4.
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

impl RenderSettings {
    /// Whether noise is filtered away.
    pub fn is_denoised(&self) -> bool {
        matches!(self.shading, Shading::PathTraced { denoise: true, .. })
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
    /// Accurate integrals of light SG × BRDF × cosine, with shadows and interreflection as far as `visibility` finds them.
    #[default]
    Accurate,
    /// PhySG's published approximation of them, without shadows and interreflection.
    Published,
    /// An unbiased path tracer with the same BRDF: shadows and interreflection.
    PathTraced {
        /// Paths per pixel, 1 to 65536. Default 64.
        #[serde(default = "spp")]
        spp: u32,
        /// Most surface hits of a path, 1 to 64. Default 4.
        #[serde(default = "max_bounces")]
        max_bounces: u32,
        /// Where the light is a map, trace against the map itself and not against the lobes fitted to it. Default true.
        #[serde(default = "yes")]
        map: bool,
        /// Filter the noise away, guided by albedo, normals and depth: pictures have a small bias instead. Needs `spp` ≥ 4; a pixel has at least
        /// 4 camera rays. Default false.
        #[serde(default)]
        denoise: bool,
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
    /// Distance from the object's center > 0. Default: far enough that the object fills the picture.
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
    /// What the film is written as, besides an MP4. Default `Gif`.
    pub format: OrbitFormat,
    /// Where the camera is over time, in the order of time, instead of one even turn at one height and distance. Default [].
    pub keys: Vec<OrbitKey>,
    /// The light turns over the frames. Default: it stands still.
    pub light: Option<LightSweep>,
    /// The material changes over the frames. Default: it stays as it is.
    pub material: Option<MaterialSweep>,
    /// The first frame that is rendered, from 0, and how many are, of a film that several runs share (`lobelia list`): without a film of
    /// the part. Default: all.
    pub part: Option<(u32, u32)>,
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
            format: OrbitFormat::Gif,
            keys: Vec::new(),
            light: None,
            material: None,
            part: None,
        }
    }
}

impl Orbit {
    /// The frames that are rendered.
    pub fn rendered(&self) -> Range<u32> {
        self.part.map_or(0..self.frames, |(first, count)| first..(first + count).min(self.frames))
    }

    /// Width and height in pixels.
    pub fn sides(&self) -> [u32; 2] {
        [self.width, self.height].map(|side| side.unwrap_or(self.size))
    }
}

/// What an orbit is written as.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum OrbitFormat {
    /// 256 colors, plays everywhere.
    #[default]
    Gif,
    /// All colors.
    Apng,
    /// The MP4 alone (H.264).
    Mp4,
    /// PNG files in `orbit_frames/`, which stay whatever becomes of the film.
    Frames,
}

fn spp() -> u32 {
    64
}
fn max_bounces() -> u32 {
    4
}
fn yes() -> bool {
    true
}
