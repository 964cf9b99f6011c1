//! Estimates of a scene's passes: memory and time, by a plain formula.
//!
//! Time is divided by the threads. It is good to a factor of two on the machine that was measured,
//! and a guess on others. Memory is meant to be no less than what is taken: whole runs took 69 to
//! 98 % of it (`spot`, also with textures up to 2048², `sphere`, `cheburashka`, `head` and `chair`;
//! 300 photographs of 512², 16 of 4096² and 1000 of 1 MP).

use crate::scene::{
    FitPass, GridLevel, Light, LightSource, Pass, RenderSettings, Scene, Shading, ShapePass, Surface,
    ViewChoice, Views, Visibility,
};
use crate::survey::counted;
use lobelia_geometry::view::Split;
use lobelia_geometry::view::look::ViewLook;
use lobelia_sg::statistics::median;
use lobelia_solve::fit::detail::{KeptPixel, MOST_PIXELS, TexelEquations, finest_side};
use lobelia_solve::visibility::VisibilitySettings;
use lobelia_solve::{fit::cameras::CameraUnknowns, fit::run::EARLY, shade::frame::frame_bytes};
use lobelia_world::{sample::Observation, sample::ObservationIndex, sample::pixel::ImageGradient};
use serde::Serialize;

/// Bytes of a pixel of a photograph in memory, in the rectangle around the object: 8-bit colors,
/// flags, and room for an alpha that is not the mask. Downscaled and undistorted photographs and
/// EXR take half floats, two or three bytes more.
const PHOTOGRAPH_BYTES: f64 = 4.2;
/// Bytes of a pixel of a mask in memory; the alpha of a photograph is the same memory.
const MASK_BYTES: f64 = 1.0;
/// Bytes of a pixel of a prior map in memory: three half floats.
const MAP_BYTES: f64 = 6.0;
/// Bytes of a pixel of a silhouette in memory: its signed distance as a half float.
const SILHOUETTE_BYTES: f64 = 2.0;
/// Bytes of a pixel in the pool of a fit: its columns, two ticks for each of the two, and its
/// entity; a table that grows keeps room for more rows.
const POOL_BYTES: f64 = 1.6 * (size_of::<(ObservationIndex, Observation)>() + 2 * 8 + 52) as f64;
/// Further bytes of a pixel in the pool, if cameras are moved.
const GRADIENT_BYTES: f64 = 1.6 * (size_of::<ImageGradient>() + 8) as f64;
/// Bytes of a texel: albedo, sheen, tilt and blend, what is shown, place and normal. A sphere of
/// 1024² and 2048² texels, one small picture.
const TEXEL_BYTES: f64 = 440.0;
/// Bytes of a texel in a fit beside these: gradients, moments, and the tables that texels left when
/// these came to them. Measured from 512² to 2048² texels.
const FIT_TEXEL_BYTES: f64 = 410.0;
/// Bytes of a texel of the finest texture, which has neither gradients nor moments.
const FINEST_TEXEL_BYTES: f64 = 380.0;
/// Bytes of a fit that do not depend on its size, as measured.
const FIT_BYTES: f64 = 150e6;
/// Bytes of a pixel while a view is scored: rendered, true, and what both are compared by. 16 views
/// of 4096².
const SCORE_PIXEL_BYTES: f64 = 105.0;
/// Bytes of a fit that tries several materials and refines its texture, besides its pool and
/// texels, as measured on four sets.
const DETAIL_BYTES: f64 = 250e6;
/// Bytes of a pixel that the sweeps over the texture visit: what is kept of it, and 50 as measured
/// on the same sets.
const DETAIL_PIXEL_BYTES: f64 = 50.0 + size_of::<KeptPixel>() as f64;
/// Bytes of a cell of a shape's grid, with its adjoints and moments, while its outlines are fitted:
/// `spot`, 128 to 512 cells a side.
const CELL_BYTES: f64 = 24.0;
/// Bytes of a cell of the lattice of albedo, of which those near the surface have texels: the same
/// with 64 and 256 cells a side.
const LATTICE_BYTES: f64 = 135.0;
/// Bytes of a found mesh and of what is made to intersect it, per square of the cells on a side:
/// about six triangles.
const MESH_BYTES: f64 = 9e3;
/// Bytes of the program itself.
const BASE_BYTES: f64 = 100e6;
/// Reading a pixel of a PNG: 100 views of 800² in 3.2 s on two cores.
const DECODE_NANOS: f64 = 100.0;
/// A pair of pixel and lobe in a step of a fit: `scenes/spot.ron` without shadows, 1 200 steps in
/// 13 s on two cores.
pub(super) const FIT_PAIR_NANOS: f64 = 27.0;
/// A pixel of the pool before the first step of a fit: choosing, tracing, and two initializations.
/// `scenes/spot.ron`, ten steps.
const FIT_START_NANOS: f64 = 16_000.0;
/// A pixel that the detail of a texture is solved for from, in all sweeps: `chair`, 0.44 times what
/// it took while each of three sweeps shaded it, 110 s for 11 million pixels in one thread.
const DETAIL_PIXEL_NANOS: f64 = 4400.0;
/// A fit that tries several materials, moves vertices and refines its texture takes this many times
/// as long.
const DETAIL_FACTOR: f64 = 3.0;
/// A pixel in a step of a shape, with all that comes before and after the steps: on two cores
/// `spot` takes 48 s, `chair` 157 s.
const SHAPE_PIXEL_NANOS: f64 = 35_000.0;
/// A ray of the visibility: 108 789 texels in 512 directions in 7.0 s on two cores.
const RAY_NANOS: f64 = 250.0;
/// Part of an object's pixels in a film at which all rays are cast, in closed form.
const FILM_REFINED: f64 = 0.2;
/// Bytes of a pixel of a frame of a film: frames that wait to be written, or one that is encoded.
const FILM_PIXEL_BYTES: f64 = 12.0;
/// A pair of pixel sample and lobe in a frame.
const RENDER_PAIR_NANOS: f64 = 8.0;
/// A pixel sample of the object in a frame, with tracing and gathering: a sphere in 2048² and 4096²
/// pixels.
const SAMPLE_NANOS: f64 = 1_700.0;
/// Encoding and writing a pixel of a picture with all its layers: the same, as small as a few
/// pixels.
const PICTURE_PIXEL_NANOS: f64 = 1_700.0;
/// Scoring a pixel of a view, with its part of the contact sheet: ten views of 256².
const SCORE_PIXEL_NANOS: f64 = 3_000.0;
/// A path of the path tracer.
const PATH_NANOS: f64 = 3_000.0;
/// Share of the atlas that charts cover, about.
const ATLAS_FILL: f32 = 0.6;
/// Share of a frame that the object covers, where no mask says.
const USUAL_COVERAGE: f64 = 0.25;

/// Memory and time of one part.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PartEstimate {
    /// The part: "photographs", "shadows", or a pass's name.
    pub what: String,
    /// Memory in bytes.
    pub bytes: f64,
    /// Time in seconds.
    pub seconds: f64,
    /// Whether the memory stays until the end of the run.
    pub stays: bool,
}

/// Memory and time of a run.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Estimate {
    /// Its parts.
    pub parts: Vec<PartEstimate>,
    /// How many threads the times are for.
    pub threads: usize,
}

impl Estimate {
    /// The most memory at a time: what stays, and the largest of what does not, in bytes.
    pub fn bytes(&self) -> f64 {
        let stays: f64 = self.parts.iter().filter(|part| part.stays).map(|part| part.bytes).sum();
        let most = self.parts.iter().filter(|part| !part.stays).map(|part| part.bytes).fold(0.0, f64::max);
        BASE_BYTES + stays + most
    }

    /// The time of all parts, in seconds.
    pub fn seconds(&self) -> f64 {
        self.parts.iter().map(|part| part.seconds).sum()
    }

    /// "about 1.2 GiB and 3 min on 2 threads (photographs 0.9 GiB, fit 2 min, …)".
    pub fn words(&self) -> String {
        let is_large = |part: &&PartEstimate| part.seconds >= 1.0 || part.bytes > 64e6;
        let mut parts: Vec<&PartEstimate> = self.parts.iter().filter(is_large).collect();
        parts.sort_by(|a, b| b.seconds.total_cmp(&a.seconds));
        let part = |of: &&PartEstimate| format!("{} {}, {}", of.what, duration(of.seconds), memory(of.bytes));
        let list: Vec<String> = parts.iter().take(4).map(part).collect();
        let list = if list.is_empty() { String::new() } else { format!(" ({})", list.join("; ")) };
        let (bytes, time) = (memory(self.bytes()), duration(self.seconds()));
        format!("about {bytes} and {time} on {}{list}", counted(self.threads, "thread"))
    }
}

/// "850 MiB", "1.2 GiB".
pub fn memory(bytes: f64) -> String {
    let mib = bytes / f64::from(1 << 20);
    if mib < 1000.0 { format!("{mib:.0} MiB") } else { format!("{:.1} GiB", mib / 1024.0) }
}

/// "12 s", "3 min".
pub(crate) fn duration(seconds: f64) -> String {
    match seconds {
        s if s < 100.0 => format!("{:.0} s", s.ceil()),
        s if s < 6000.0 => format!("{:.0} min", s / 60.0),
        s => format!("{:.1} h", s / 3600.0),
    }
}

/// Part of the width that a level's cells must have in photographs from which on it counts: the
/// grid is not exactly as wide as the object.
const NEARLY: f32 = 0.9;

/// Estimates memory and time of the passes of `scene` for these views on so many threads.
pub fn estimate(looks: &[ViewLook], scene: &Scene, threads: usize) -> Estimate {
    let threads = threads.max(1);
    let task = Task { looks, scene, threads };
    let mut parts = vec![task.photographs(), task.part("texels", TEXEL_BYTES * task.texels(), 0.0, true)];
    parts.extend(task.shadows());
    for pass in &scene.passes {
        match pass {
            Pass::Fit(fit) => parts.push(task.fit(fit)),
            Pass::Shape(shape) => parts.extend(task.shape(shape)),
            Pass::Evaluate(evaluate) => parts.push(task.scores(&evaluate.name)),
            other => parts.extend(other.render().map(|render| task.render(other.name(), render))),
        }
    }
    Estimate { parts, threads }
}

struct Task<'a> {
    looks: &'a [ViewLook],
    scene: &'a Scene,
    threads: usize,
}

/// Bytes of a pixel in the pool of a fit that moves cameras, or does not.
fn pool_bytes(cameras: CameraUnknowns) -> f64 {
    POOL_BYTES + if cameras == CameraUnknowns::Given { 0.0 } else { GRADIENT_BYTES }
}

fn pixels(look: &ViewLook) -> f64 {
    f64::from(look.size[0]) * f64::from(look.size[1])
}

/// Width and height of the rectangle around the object, in pixels of the photograph.
fn object_sides(look: &ViewLook) -> Option<[f32; 2]> {
    let (bounds, sides) = (look.mask.as_ref()?.bounds?, [look.camera.width, look.camera.height]);
    Some([0, 1].map(|k| (bounds.high[k] - bounds.low[k]) * (look.size[k] as f32 / sides[k] as f32)))
}

/// Pixels of the rectangle around the object, or of the photograph.
fn window_pixels(look: &ViewLook) -> f64 {
    object_sides(look).map_or(pixels(look), |[x, y]| f64::from(x * y))
}

fn object_pixels(look: &ViewLook) -> f64 {
    look.object_pixels().map_or(USUAL_COVERAGE * pixels(look), f64::from)
}

impl Task<'_> {
    fn part(&self, what: &str, bytes: f64, nanos: f64, stays: bool) -> PartEstimate {
        PartEstimate { what: what.to_owned(), bytes, seconds: nanos * 1e-9 / self.threads as f64, stays }
    }

    fn lobes(&self) -> f64 {
        match &self.scene.light {
            Light::Unknown(light) => f64::from(light.lobes),
            Light::Initial(source) | Light::Fixed(source) => match source {
                LightSource::Lobes { lobes, .. } => lobes.len() as f64,
                LightSource::Map { lobes, .. } => f64::from(*lobes),
                LightSource::Npy { .. } | LightSource::Ron { .. } => 128.0,
            },
        }
    }

    /// Width and height of the texture in texels.
    fn side(&self) -> f64 {
        match self.scene.surface {
            Surface::Mesh { texture_size, .. }
            | Surface::Unknown { texture_size, .. }
            | Surface::Sphere { texture_size, .. }
            | Surface::Box { texture_size, .. } => f64::from(texture_size),
        }
    }

    fn texels(&self) -> f64 {
        self.side() * self.side()
    }

    /// Photographs that are learned from.
    fn train(&self) -> impl Iterator<Item = &ViewLook> {
        self.looks.iter().filter(|look| look.split == Split::Train && look.light.is_some())
    }

    fn photographs(&self) -> PartEstimate {
        let photographs = || self.looks.iter().filter(|look| look.light.is_some());
        let kept: f64 = photographs().map(window_pixels).sum();
        let read: f64 = photographs().map(pixels).sum();
        let is_unknown = matches!(self.scene.surface, Surface::Unknown { .. });
        let silhouettes = if is_unknown { SILHOUETTE_BYTES } else { 0.0 };
        // Prior maps that may be read beside a photograph.
        let priors = if let Views::Dataset(data) = &self.scene.views { Some(&data.priors) } else { None };
        let maps = priors.map_or(0, |of| u8::from(of.albedo.is_some()) + u8::from(of.normals.is_some()));
        let maps = f64::from(maps);
        let bytes = kept * (PHOTOGRAPH_BYTES + MASK_BYTES + silhouettes + MAP_BYTES * maps);
        self.part("photographs", bytes, read * DECODE_NANOS * (1.0 + maps), true)
    }

    fn shadows(&self) -> Option<PartEstimate> {
        let Visibility::Traced { directions, bounces, refresh_every } = self.scene.visibility else {
            return None;
        };
        let settings = VisibilitySettings { directions, bounces, refresh_every };
        let texels = (f64::from(ATLAS_FILL) * self.texels()) as usize;
        let nanos = settings.rows(texels) as f64 * f64::from(directions) * RAY_NANOS;
        let views = &self.scene.views;
        let bytes = settings.bytes(texels, views.placements(), views.other_lights().len() + 1) as f64;
        Some(self.part("shadows", bytes, nanos, true))
    }

    /// Pixels that a fit visits.
    fn pool(&self, most: u32) -> f64 {
        self.train().map(object_pixels).sum::<f64>().min(f64::from(most))
    }

    fn fit(&self, fit: &FitPass) -> PartEstimate {
        let first = fit.milestones.first().copied().unwrap_or(1.0);
        let early = if fit.vertices { 0.0 } else { f64::from(first * (1.0 - EARLY)) };
        let pairs = f64::from(fit.steps) * (1.0 - early) * f64::from(fit.batch) * self.lobes();
        let pool = self.pool(fit.max_pixels) * pool_bytes(fit.cameras);
        let bytes = FIT_BYTES + pool + self.texels() * FIT_TEXEL_BYTES;
        let start = self.pool(fit.max_pixels) * FIT_START_NANOS;
        if !fit.detail {
            return self.part(&fit.name, bytes, start + pairs * FIT_PAIR_NANOS, false);
        }
        // Width of a texel in pixels. A view shows about a quarter of the surface: the mean
        // projected area of a convex object (Cauchy).
        let mut areas: Vec<f32> = self.train().filter_map(ViewLook::object_pixels).collect();
        let wide = median(&mut areas).map(|area| (4.0 * area / (ATLAS_FILL * self.texels() as f32)).sqrt());
        let wide = wide.unwrap_or(1.0).round().max(1.0);
        let visited = self.pool(MOST_PIXELS as u32);
        let side = (self.side() * f64::from(wide)).min(finest_side(visited)).max(self.side());
        let sweeps = visited * DETAIL_PIXEL_NANOS;
        let finest = side * side * (FINEST_TEXEL_BYTES + size_of::<TexelEquations>() as f64);
        let steps = bytes + DETAIL_BYTES + visited * DETAIL_PIXEL_BYTES;
        let most = steps.max(finest + FIT_BYTES + visited * DETAIL_PIXEL_BYTES);
        self.part(&fit.name, most, start + DETAIL_FACTOR * pairs * FIT_PAIR_NANOS + sweeps, false)
    }

    /// The mesh that a shape is found as, and its fit.
    fn shape(&self, shape: &ShapePass) -> [PartEstimate; 2] {
        let levels = self.resolved(&shape.levels);
        let cells = levels.last().map_or(0.0, |level| f64::from(level.cells));
        let mesh = self.part("mesh", cells * cells * MESH_BYTES, 0.0, true);
        let steps: f64 = levels.iter().map(|level| f64::from(level.steps)).sum();
        let cube = |cells: u32| f64::from(cells).powi(3);
        let grids = levels
            .iter()
            .map(|level| cube(level.cells) * CELL_BYTES + cube(level.texel_cells) * LATTICE_BYTES);
        let bytes = self.pool(shape.max_pixels) * pool_bytes(shape.cameras) + grids.fold(0.0, f64::max);
        let nanos = steps * f64::from(shape.batch) * SHAPE_PIXEL_NANOS;
        [mesh, self.part(&shape.name, bytes, nanos, false)]
    }

    /// One view at a time is scored.
    fn scores(&self, name: &str) -> PartEstimate {
        let largest = self.looks.iter().map(pixels).fold(0.0, f64::max);
        let scored = self.looks.iter().filter(|look| look.split == Split::Test).map(pixels).sum::<f64>();
        self.part(name, largest * SCORE_PIXEL_BYTES, scored * SCORE_PIXEL_NANOS, false)
    }

    /// The levels that photographs of this size resolve, as far as their masks tell; a level that
    /// is nearly resolved counts.
    fn resolved<'a>(&self, levels: &'a [GridLevel]) -> &'a [GridLevel] {
        let widths = self.train().filter_map(object_sides);
        let mut widths: Vec<f32> = widths.map(|[x, y]| x.max(y)).collect();
        let Some(width) = median(&mut widths) else { return levels };
        let too_fine = |level: &GridLevel| width / (level.cells as f32) < NEARLY * level.pixels;
        let count = levels.iter().skip(1).position(too_fine).map_or(levels.len(), |place| place + 1);
        &levels[..count]
    }

    fn render(&self, name: &str, render: &RenderSettings) -> PartEstimate {
        let is_chosen = |look: &&ViewLook| match &render.views {
            ViewChoice::Test => look.split == Split::Test,
            ViewChoice::Train => look.split == Split::Train,
            ViewChoice::All => true,
            ViewChoice::Named(names) => names.contains(&look.name),
        };
        let views: Vec<&ViewLook> = self.looks.iter().filter(is_chosen).collect();
        let orbit = render.orbit.as_ref().map_or((0, 0.0), |orbit| {
            let size = orbit.sides();
            let pixels = f64::from(size[0]) * f64::from(size[1]);
            (frame_bytes(size) + (FILM_PIXEL_BYTES * pixels) as u64, pixels * f64::from(orbit.frames))
        });
        let of_views = views.iter().map(|look| object_pixels(look)).sum::<f64>();
        let of_film = USUAL_COVERAGE * orbit.1;
        let all = views.iter().map(|look| pixels(look)).sum::<f64>() + orbit.1;
        let rays = f64::from(render.samples_per_pixel);
        let nanos = match render.shading {
            Shading::PathTraced { spp, .. } => (of_views + of_film) * f64::from(spp) * PATH_NANOS,
            _ => {
                let samples = rays * of_views + rays.min(1.0 + FILM_REFINED * rays) * of_film;
                samples * (self.lobes() * RENDER_PAIR_NANOS + SAMPLE_NANOS)
            }
        };
        let largest = views.iter().map(|look| frame_bytes(look.size)).fold(orbit.0, u64::max);
        self.part(name, largest as f64, nanos + all * PICTURE_PIXEL_NANOS, false)
    }
}
