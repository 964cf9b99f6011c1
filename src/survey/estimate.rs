//! What a scene's passes will take: memory and time, by a plain formula.
//!
//! | part | memory | time of one thread |
//! | --- | --- | --- |
//! | photographs | pixels around the object × (`PHOTOGRAPH_BYTES` + `MASK_BYTES`); of several processes in the first one, which keeps those of test views, and a share of the others | pixels × `DECODE_NANOS` |
//! | texels | texels × `TEXEL_BYTES` | |
//! | `Fit` | `FIT_BYTES` + pixels in the pool × `POOL_BYTES`, with unknown cameras and `GRADIENT_BYTES`, + texels × `FIT_TEXEL_BYTES` | steps × batch, half of it before the first milestone, × lobes × `FIT_PAIR_NANOS` + pixels in the pool × `FIT_START_NANOS` |
//! | `Fit(detail: true)` | the same + `DETAIL_BYTES` + pixels × `DETAIL_PIXEL_BYTES` | three times as long + pixels × `DETAIL_PIXEL_NANOS` |
//! | `Shape` | pixels in the pool × `POOL_BYTES` + cells³ × `CELL_BYTES` + cells of the lattice³ × `LATTICE_BYTES` | steps × batch × `SHAPE_PIXEL_NANOS` |
//! | its mesh | cells² × `MESH_BYTES` | |
//! | shadows | [`VisibilitySettings::bytes`] of the texels | rows × directions × `RAY_NANOS` |
//! | `Render` and the like | [`frame_bytes`] (or [`denoised_frame_bytes`]) of the largest view; [`film_bytes`] of the film | samples in the object (in a film fewer, `FILM_REFINED`) × (lobes × `RENDER_PAIR_NANOS` + `SAMPLE_NANOS`) + pixels × `PICTURE_PIXEL_NANOS` |
//! | `Evaluate` | pixels of the largest view × `SCORE_PIXEL_BYTES` | pixels of the test views × `SCORE_PIXEL_NANOS` |
//!
//! Time is divided by the threads. It is good to a factor of two on the machine that was measured, and a guess on others. Memory is meant
//! to be no less than what is taken: whole runs took 69 to 98 % of it (`spot`, also with textures up to 2048², `sphere`,
//! `cheburashka`, `head` and `chair`; 300 photographs of 512², 16 of 4096² and 1000 of 1 MP).

use crate::codec::animation::film_bytes;
use crate::fit::cameras::CameraUnknowns;
use crate::fit::detail::equations::TexelEquations;
use crate::fit::detail::kept::KeptPixel;
use crate::fit::detail::{MOST_PIXELS, finest_side};
use crate::fit::schedule::EARLY;
use crate::math::statistics::median;
use crate::sample::observation::{Observation, ObservationIndex};
use crate::sample::pixel::ImageGradient;
use crate::scene::{
    FitPass, GridLevel, Light, LightSource, Pass, RenderSettings, Scene, Score, Shading, ShapePass, Surface,
    Truth, ViewChoice, Views, Visibility,
};
use crate::shade::frame::{denoised_frame_bytes, frame_bytes};
use crate::survey::look::{PixelBounds, ViewLook};
use crate::survey::texture_detail::{ATLAS_FILL, pixels_per_texel};
use crate::view::Split;
use crate::visibility::VisibilitySettings;
use serde::Serialize;

/// Bytes of a pixel of a photograph in memory, in the rectangle around the object: 8-bit colors, flags, and room for an alpha that is not the mask.
/// Downscaled and undistorted photographs and EXR take half floats, two or three bytes more.
pub(crate) const PHOTOGRAPH_BYTES: f64 = 4.2;
/// Bytes of a pixel of a mask in memory; the alpha of a photograph is the same memory.
pub(crate) const MASK_BYTES: f64 = 1.0;
/// Bytes of a pixel of a prior map in memory: three half floats.
const MAP_BYTES: f64 = 6.0;
/// Bytes of a pixel of a silhouette in memory: its signed distance as a half float.
pub(crate) const SILHOUETTE_BYTES: f64 = 2.0;
/// Bytes of a pixel in the pool of a fit: its columns, two ticks for each of the two, and its entity; a table that grows keeps room for
/// more rows.
pub(crate) const POOL_BYTES: f64 = 1.6 * (size_of::<(ObservationIndex, Observation)>() + 2 * 8 + 52) as f64;
/// The same of what a pixel has besides, if cameras are moved.
const GRADIENT_BYTES: f64 = 1.6 * (size_of::<ImageGradient>() + 8) as f64;
/// Bytes of a texel: albedo, sheen, tilt and blend, what is shown, place and normal. A sphere of 1024² and 2048² texels, one small picture.
pub(crate) const TEXEL_BYTES: f64 = 440.0;
/// Bytes of a texel in a fit beside these: gradients, moments, and the tables that texels left when these came to them. Measured
/// from 512² to 2048² texels.
pub(crate) const FIT_TEXEL_BYTES: f64 = 410.0;
/// Bytes of a texel of the finest texture, which has neither gradients nor moments.
pub(crate) const FINEST_TEXEL_BYTES: f64 = 380.0;
/// Bytes of a fit that do not depend on its size, as measured.
pub(crate) const FIT_BYTES: f64 = 150e6;
/// Bytes of a pixel while a view is scored: rendered, true, and what both are compared by. 16 views of 4096².
pub(crate) const SCORE_PIXEL_BYTES: f64 = 105.0;
/// Bytes of a fit that tries several materials and refines its texture, besides its pool and texels, as measured on four sets.
pub(crate) const DETAIL_BYTES: f64 = 250e6;
/// Bytes of a pixel that the sweeps over the texture visit: what is kept of it, and 50 as measured on the same sets.
pub(crate) const DETAIL_PIXEL_BYTES: f64 = 50.0 + size_of::<KeptPixel>() as f64;
/// Bytes of a cell of a shape's grid, with its adjoints and moments, while its outlines are fitted: `spot`, 128 to 512 cells a side.
pub(crate) const CELL_BYTES: f64 = 24.0;
/// Bytes of a cell of the lattice of albedo, of which those near the surface have texels: the same with 64 and 256 cells a side.
pub(crate) const LATTICE_BYTES: f64 = 135.0;
/// Bytes of a found mesh and of what is made to intersect it, per square of the cells on a side: about six triangles.
pub(crate) const MESH_BYTES: f64 = 9e3;
/// Bytes of the program itself.
pub(crate) const BASE_BYTES: f64 = 100e6;
/// Reading a pixel of a PNG: 100 views of 800² in 3.2 s on two cores.
pub(crate) const DECODE_NANOS: f64 = 100.0;
/// A pair of pixel and lobe in a step of a fit: `scenes/spot.ron` without shadows, 1 200 steps in 13 s on two cores.
pub(crate) const FIT_PAIR_NANOS: f64 = 27.0;
/// A pixel of the pool before the first step of a fit: choosing, tracing, and two initializations. `scenes/spot.ron`, ten steps.
pub(crate) const FIT_START_NANOS: f64 = 16_000.0;
/// A pixel that the detail of a texture is solved for from, in all sweeps: `chair`, 0.44 times what it took while each of three sweeps shaded it,
/// 110 s for 11 million pixels in one thread.
pub(crate) const DETAIL_PIXEL_NANOS: f64 = 4400.0;
/// A fit that tries several materials, moves vertices and refines its texture takes this many times as long.
pub(crate) const DETAIL_FACTOR: f64 = 3.0;
/// A pixel in a step of a shape, with all that comes before and after the steps: on two cores `spot` takes 48 s, `chair` 157 s.
pub(crate) const SHAPE_PIXEL_NANOS: f64 = 35_000.0;
/// A ray of the visibility: 108 789 texels in 512 directions in 7.0 s on two cores.
pub(crate) const RAY_NANOS: f64 = 250.0;
/// Part of an object's pixels in a film at which all rays are cast, in closed form.
const FILM_REFINED: f64 = 0.2;
/// A pair of pixel sample and lobe in a frame.
pub(crate) const RENDER_PAIR_NANOS: f64 = 8.0;
/// A pixel sample of the object in a frame, with tracing and gathering: a sphere in 2048² and 4096² pixels.
pub(crate) const SAMPLE_NANOS: f64 = 1_700.0;
/// Encoding and writing a pixel of a picture with all its layers: the same, as small as a few pixels.
pub(crate) const PICTURE_PIXEL_NANOS: f64 = 1_700.0;
/// Scoring a pixel of a view, with its part of the contact sheet: ten views of 256².
pub(crate) const SCORE_PIXEL_NANOS: f64 = 3_000.0;
/// A path of the path tracer.
pub(crate) const PATH_NANOS: f64 = 3_000.0;
/// Filtering the noise of a pixel of the object away: two views of `spot` of 256² in 0.16 s of one core.
const DENOISE_NANOS: f64 = 6_000.0;
/// Share of a frame that the object covers, where no mask says.
const USUAL_COVERAGE: f64 = 0.25;

/// Bytes on the disk of a pixel of the object in a pass's picture, no more than were measured: EXR with all layers, and PNG.
const PICTURE_PIXEL_BYTES: f64 = 20.0;
/// Bytes on the disk of a texel in what a fit and `Save` write, no more than were measured.
const SAVED_TEXEL_BYTES: f64 = 20.0;

/// What one part takes.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PartEstimate {
    /// What takes it: "photographs", "shadows", or a pass's name.
    pub what: String,
    /// Memory in bytes.
    pub bytes: f64,
    /// Time in seconds.
    pub seconds: f64,
    /// Whether the memory stays until the end of the run.
    pub stays: bool,
}

/// What a run takes.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Estimate {
    /// Its parts.
    pub parts: Vec<PartEstimate>,
    /// How many threads the times are for.
    pub threads: usize,
    /// How many processes share the run: the memory is that of the first one, the times are those of a process alone.
    pub processes: usize,
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
        let mut parts: Vec<&PartEstimate> =
            self.parts.iter().filter(|part| part.seconds >= 1.0 || part.bytes > 64e6).collect();
        parts.sort_by(|a, b| b.seconds.total_cmp(&a.seconds));
        let part = |part: &&PartEstimate| {
            format!("{} {}, {}", part.what, duration(part.seconds), memory(part.bytes))
        };
        let list: Vec<String> = parts.iter().take(4).map(part).collect();
        let list = if list.is_empty() { String::new() } else { format!(" ({})", list.join("; ")) };
        let threads =
            if self.threads == 1 { "1 thread".to_owned() } else { format!("{} threads", self.threads) };
        let (bytes, time) = (memory(self.bytes()), duration(self.seconds()));
        match self.processes {
            0 | 1 => format!("about {bytes} and {time} on {threads}{list}"),
            count => format!(
                "about {bytes} in each of {count} processes; alone, one needs {time} on {threads}{list}"
            ),
        }
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

/// Part of the width that a level's cells must have in photographs from which on it counts: the grid is not exactly as wide as the object.
const NEARLY: f32 = 0.9;

/// What carries out a scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Workers {
    /// Threads of a process; at least one.
    pub threads: usize,
    /// Processes that share the photographs; at least one.
    pub processes: usize,
}

impl Workers {
    /// One process with these threads.
    pub fn threads(threads: usize) -> Self {
        Self { threads: threads.max(1), processes: 1 }
    }
}

/// What the passes of `scene` will take for these views, memory in the first process.
pub fn estimate(looks: &[ViewLook], scene: &Scene, workers: Workers) -> Estimate {
    let task = Task { looks, scene, workers };
    let mut parts = vec![task.photographs(), task.part("texels", TEXEL_BYTES * task.texels(), 0.0, true)];
    parts.extend(task.shadows());
    for pass in &scene.passes {
        if let Pass::Shape(shape) = pass {
            parts.push(task.mesh(shape));
        }
        parts.extend(match pass {
            Pass::Fit(fit) => Some(task.fit(fit)),
            Pass::Shape(shape) => Some(task.shape(shape)),
            Pass::Evaluate(evaluate) => Some(task.scores(&evaluate.name)),
            other => other.render().map(|render| task.render(other.name(), render)),
        });
    }
    Estimate { parts, threads: workers.threads, processes: workers.processes }
}

/// Bytes that the passes of `scene` will write at least.
pub(crate) fn written_bytes(looks: &[ViewLook], scene: &Scene) -> f64 {
    let task = Task { looks, scene, workers: Workers::threads(1) };
    let of_pass = |pass: &Pass| match pass {
        Pass::Save(_) => SAVED_TEXEL_BYTES * task.texels(),
        other => other.render().map_or(0.0, |render| {
            PICTURE_PIXEL_BYTES * task.chosen(render).into_iter().map(object_pixels).sum::<f64>()
        }),
    };
    scene.passes.iter().map(of_pass).sum()
}

struct Task<'a> {
    looks: &'a [ViewLook],
    scene: &'a Scene,
    workers: Workers,
}

/// Bytes of a pixel in the pool of a fit that moves cameras, or does not.
fn pool_bytes(cameras: CameraUnknowns) -> f64 {
    POOL_BYTES + if cameras == CameraUnknowns::Given { 0.0 } else { GRADIENT_BYTES }
}

/// Whether a pass renders a view.
fn is_chosen(look: &ViewLook, render: &RenderSettings) -> bool {
    match &render.views {
        ViewChoice::Test => look.split == Split::Test,
        ViewChoice::Train => look.split == Split::Train,
        ViewChoice::All => true,
        ViewChoice::Named(names) => names.contains(&look.name),
    }
}

fn pixels(look: &ViewLook) -> f64 {
    f64::from(look.size[0]) * f64::from(look.size[1])
}

/// Pixels of the rectangle around the object.
fn window_pixels(look: &ViewLook) -> f64 {
    let share = |bounds: &PixelBounds| {
        let [x, y] = [0, 1].map(|k| bounds.high[k] - bounds.low[k]);
        f64::from(x * y) / (f64::from(look.camera.width) * f64::from(look.camera.height))
    };
    let bounds = look.mask.as_ref().and_then(|mask| mask.bounds.as_ref());
    bounds.map_or(1.0, share) * pixels(look)
}

/// Longer side of the rectangle around the object, in pixels of the photograph.
fn object_width(look: &ViewLook) -> Option<f32> {
    let bounds = look.mask.as_ref()?.bounds?;
    let side = (bounds.high[0] - bounds.low[0]).max(bounds.high[1] - bounds.low[1]);
    Some(side * look.size[0] as f32 / look.camera.width as f32)
}

fn object_pixels(look: &ViewLook) -> f64 {
    look.object_pixels().map_or(USUAL_COVERAGE * pixels(look), f64::from)
}

impl Task<'_> {
    fn part(&self, what: &str, bytes: f64, nanos: f64, stays: bool) -> PartEstimate {
        PartEstimate {
            what: what.to_owned(),
            bytes,
            seconds: nanos * 1e-9 / self.workers.threads as f64,
            stays,
        }
    }

    fn lobes(&self) -> f64 {
        let lobes = match &self.scene.light {
            Light::Unknown(light) => light.lobes as usize,
            Light::Initial(LightSource::Lobes { lobes, .. })
            | Light::Fixed(LightSource::Lobes { lobes, .. }) => lobes.len(),
            Light::Initial(LightSource::Map { lobes, .. }) | Light::Fixed(LightSource::Map { lobes, .. }) => {
                *lobes as usize
            }
            _ => 128,
        };
        lobes as f64
    }

    fn texels(&self) -> f64 {
        let size = match self.scene.surface {
            Surface::Mesh { texture_size, .. }
            | Surface::Unknown { texture_size, .. }
            | Surface::Sphere { texture_size, .. }
            | Surface::Box { texture_size, .. } => f64::from(texture_size),
        };
        size * size
    }

    /// Prior maps that may be read beside a photograph.
    fn maps_of_a_photograph(&self) -> u8 {
        let Views::Dataset(data) = &self.scene.views else { return 0 };
        u8::from(data.priors.albedo.is_some()) + u8::from(data.priors.normals.is_some())
    }

    fn photographs(&self) -> PartEstimate {
        let photographs = || self.looks.iter().filter(|look| look.light.is_some());
        let kept: f64 = photographs().map(window_pixels).sum();
        let read: f64 = photographs().map(pixels).sum();
        let shared: f64 = photographs().filter(|look| !self.is_compared(look)).map(window_pixels).sum();
        let elsewhere = shared * (1.0 - 1.0 / self.workers.processes as f64);
        let silhouettes = match self.scene.surface {
            Surface::Unknown { .. } => SILHOUETTE_BYTES,
            _ => 0.0,
        };
        let maps = f64::from(self.maps_of_a_photograph());
        let bytes =
            PHOTOGRAPH_BYTES * (kept - elsewhere) + kept * (MASK_BYTES + silhouettes + MAP_BYTES * maps);
        self.part("photographs", bytes, read * DECODE_NANOS * (1.0 + maps), true)
    }

    /// Whether one process looks at the whole photograph of a view: of all those held out, and of others that renders are compared with.
    fn is_compared(&self, look: &ViewLook) -> bool {
        let scores = self.scene.passes.iter().filter_map(|pass| match pass {
            Pass::Evaluate(evaluate) => Some(&evaluate.scores),
            _ => None,
        });
        let compares = |score: &Score| {
            let rendered = self.scene.passes.iter().find(|pass| pass.name() == score.pass);
            let settings = rendered.and_then(Pass::render).filter(|_| score.truth == Truth::Photographs);
            settings.is_some_and(|settings| is_chosen(look, settings))
        };
        look.split == Split::Test || scores.flatten().any(compares)
    }

    fn shadows(&self) -> Option<PartEstimate> {
        let Visibility::Traced { directions, bounces, refresh_every } = self.scene.visibility else {
            return None;
        };
        let settings = VisibilitySettings { directions, bounces, refresh_every };
        let texels = (f64::from(ATLAS_FILL) * self.texels()) as usize;
        let nanos = settings.rows(texels) as f64 * f64::from(directions) * RAY_NANOS;
        Some(self.part(
            "shadows",
            settings.bytes(texels, self.scene.views.placements(), self.scene.views.other_lights().len() + 1)
                as f64,
            nanos,
            true,
        ))
    }

    /// Pixels that a fit visits.
    fn pool(&self, most: u32) -> f64 {
        let train = self.looks.iter().filter(|look| look.split == Split::Train && look.light.is_some());
        train.map(object_pixels).sum::<f64>().min(f64::from(most))
    }

    fn fit(&self, fit: &FitPass) -> PartEstimate {
        let early =
            if fit.vertices { 0.0 } else { fit.milestones.first().copied().unwrap_or(1.0) * (1.0 - EARLY) };
        let early = f64::from(early);
        let pairs = f64::from(fit.steps) * (1.0 - early) * f64::from(fit.batch) * self.lobes();
        let pool = self.pool(fit.max_pixels) * pool_bytes(fit.cameras);
        let bytes = FIT_BYTES + pool + self.texels() * FIT_TEXEL_BYTES;
        let start = self.pool(fit.max_pixels) * FIT_START_NANOS;
        if !fit.detail {
            return self.part(&fit.name, bytes, start + pairs * FIT_PAIR_NANOS, false);
        }
        let wide = pixels_per_texel(self.looks, self.texels().sqrt() as u32).unwrap_or(1.0).round().max(1.0);
        let visited = self.pool(MOST_PIXELS as u32);
        let side =
            (self.texels().sqrt() * f64::from(wide)).min(finest_side(visited)).max(self.texels().sqrt());
        let sweeps = visited * DETAIL_PIXEL_NANOS;
        let finest = side * side * (FINEST_TEXEL_BYTES + size_of::<TexelEquations>() as f64);
        let steps = bytes + DETAIL_BYTES + visited * DETAIL_PIXEL_BYTES;
        self.part(
            &fit.name,
            steps.max(finest + FIT_BYTES + visited * DETAIL_PIXEL_BYTES),
            start + DETAIL_FACTOR * pairs * FIT_PAIR_NANOS + sweeps,
            false,
        )
    }

    /// The mesh that a shape is found as.
    fn mesh(&self, shape: &ShapePass) -> PartEstimate {
        let cells = self.resolved(&shape.levels).last().map_or(0.0, |level| f64::from(level.cells));
        self.part("mesh", cells * cells * MESH_BYTES, 0.0, true)
    }

    fn shape(&self, shape: &ShapePass) -> PartEstimate {
        let levels = self.resolved(&shape.levels);
        let steps: f64 = levels.iter().map(|level| f64::from(level.steps)).sum();
        let cube = |cells: u32| f64::from(cells).powi(3);
        let of_level =
            |level: &GridLevel| cube(level.cells) * CELL_BYTES + cube(level.texel_cells) * LATTICE_BYTES;
        let bytes = self.pool(shape.max_pixels) * pool_bytes(shape.cameras)
            + levels.iter().map(of_level).fold(0.0, f64::max);
        self.part(&shape.name, bytes, steps * f64::from(shape.batch) * SHAPE_PIXEL_NANOS, false)
    }

    /// One view at a time is scored.
    fn scores(&self, name: &str) -> PartEstimate {
        let largest = self.looks.iter().map(pixels).fold(0.0, f64::max);
        let scored = self.looks.iter().filter(|look| look.split == Split::Test).map(pixels).sum::<f64>();
        self.part(name, largest * SCORE_PIXEL_BYTES, scored * SCORE_PIXEL_NANOS, false)
    }

    /// The levels that photographs of this size resolve, as far as their masks tell; a level that is nearly resolved counts.
    fn resolved<'a>(&self, levels: &'a [GridLevel]) -> &'a [GridLevel] {
        let train = self.looks.iter().filter(|look| look.split == Split::Train && look.light.is_some());
        let mut widths: Vec<f32> = train.filter_map(object_width).collect();
        let Some(width) = median(&mut widths) else { return levels };
        let too_fine = |level: &GridLevel| width / (level.cells as f32) < NEARLY * level.pixels;
        let count = levels.iter().skip(1).position(too_fine).map_or(levels.len(), |place| place + 1);
        &levels[..count]
    }

    /// The views that a pass renders.
    fn chosen(&self, render: &RenderSettings) -> Vec<&ViewLook> {
        self.looks.iter().filter(|look| is_chosen(look, render)).collect()
    }

    fn render(&self, name: &str, render: &RenderSettings) -> PartEstimate {
        let views = self.chosen(render);
        let picture_bytes = if render.is_denoised() { denoised_frame_bytes } else { frame_bytes };
        let orbit = render.orbit.as_ref().map_or((0, 0.0), |orbit| {
            let size = orbit.sides();
            let pixels = f64::from(size[0]) * f64::from(size[1]);
            (picture_bytes(size) + film_bytes(size, orbit.frames), pixels * f64::from(orbit.frames))
        });
        let of_views = views.iter().map(|look| object_pixels(look)).sum::<f64>();
        let of_film = USUAL_COVERAGE * orbit.1;
        let all = views.iter().map(|look| pixels(look)).sum::<f64>() + orbit.1;
        let rays = f64::from(render.samples_per_pixel);
        let nanos = match render.shading {
            Shading::PathTraced { spp, denoise, .. } => {
                let filtering = if denoise { DENOISE_NANOS } else { 0.0 };
                (of_views + of_film) * (f64::from(spp) * PATH_NANOS + filtering)
            }
            _ => {
                let samples = rays * of_views + rays.min(1.0 + FILM_REFINED * rays) * of_film;
                samples * (self.lobes() * RENDER_PAIR_NANOS + SAMPLE_NANOS)
            }
        };
        let largest = views.iter().map(|look| picture_bytes(look.size)).fold(orbit.0, u64::max);
        self.part(name, largest as f64, nanos + all * PICTURE_PIXEL_NANOS, false)
    }
}
