//! The Frame phase: one tile of a picture, or of a band of its rows, at a time, Sample ▸ Trace ▸
//! Gather ▸ Shade ▸ Resolve. [`render_frame`] runs it tile by tile, with whatever systems are in
//! its slots, after the Compose phase, which makes material and light.
//!
//! ```
//! use glam::Vec3;
//! use lobelia_geometry::mesh::{Surface, primitive::box_mesh};
//! use lobelia_geometry::view::Camera;
//! use lobelia_solve::shade::frame::{FramePlugin, render_frame, resolve};
//! use lobelia_world::{light::LightLobe, material::SpecularLobe};
//! use lobelia_world::{pipeline::Pipeline, sample::spawn_object};
//!
//! let surface = std::sync::Arc::new(Surface::new(box_mesh(Vec3::ZERO, Vec3::ONE)?, 16)?);
//! let albedo = vec![Vec3::splat(0.5); surface.atlas().position.len()];
//! // A sky of radiance one: a diffuse surface is as bright as its albedo.
//! let sky = LightLobe { axis: Vec3::Y, sharpness: 0.0, amplitude: Vec3::ONE };
//! let mut pipeline = Pipeline::new();
//! pipeline.add_plugin(&FramePlugin);
//! spawn_object(&mut pipeline.world, &surface, &albedo, &[SpecularLobe::default()], &[sky]);
//! let camera = Camera::look_at(Vec3::new(0.0, 0.0, 3.0), Vec3::ZERO, Vec3::Y, 38.0, 8, 8)?;
//! let frame = resolve(&render_frame(&mut pipeline, camera, 1)?);
//! assert!((frame.diffuse[4 * 8 + 4].x - 0.5).abs() < 1e-3);
//! # Ok::<(), lobelia_geometry::Error>(())
//! ```

use super::systems::{gather_blends, gather_points, shade_closed_form};
use crate::visibility::{WindowVisibility, forget_window};
use bevy_ecs::prelude::{IntoScheduleConfigs, Res, ResMut, Resource, With, World};
use glam::Vec3;
use lobelia_geometry::error::{Error, Result, stop::check_interrupted};
use lobelia_geometry::parallel;
use lobelia_geometry::view::{BLOCK_ROWS, Camera, Frame, ViewIndex};
use lobelia_sg::shading::{ClosedForm, Layers, ShadePoint};
use lobelia_world::light::lights::{IncidentLight, LightChoice, provide_light};
use lobelia_world::material::material_source::{
    BaseMaterials, MaterialSource, PlainBlends, ShownMaterial, blends_changed, gather_materials,
    note_plain_blends,
};
use lobelia_world::material::shown::{show_recovered, shown_material};
use lobelia_world::pipeline::{GatherPoints, Phase, Pipeline, Plugin, Slot, Stage, SystemResult};
use lobelia_world::sample::pixel::{PixelOf, SampleIndex, ViewRay, Window};
use lobelia_world::sample::point::{Scenery, SurfacePoint};
use lobelia_world::sample::{FrameSample, Samples, despawn_pool};
use lobelia_world::{light::light_frame::PictureRotation, material::edit::MaterialState};
use std::ops::Range;

/// Samples in the pool of a frame: enough to use all threads, few enough for cache and memory.
const POOL: usize = 1 << 16;

/// Most memory that a map, or the photographs that a scene renders itself, may be expected to take,
/// in bytes.
pub(crate) const MOST_FRAME_BYTES: u64 = 8 << 30;

/// Checks that `bytes` are at most `MOST_FRAME_BYTES`; `what` names the picture that takes them.
///
/// # Errors
/// [`Error::Usage`] with the size, the memory and the limit.
pub fn check_memory(what: &str, width: u32, height: u32, bytes: u64) -> Result<()> {
    if bytes <= MOST_FRAME_BYTES {
        return Ok(());
    }
    let gib = |bytes: u64| bytes as f64 / f64::from(1 << 30);
    let problem = format!(
        "{what} of {width}×{height} pixels takes {:.1} GiB of memory; the limit is {:.0} GiB",
        gib(bytes),
        gib(MOST_FRAME_BYTES)
    );
    Err(Error::usage(problem, "Choose a smaller size, or fewer frames."))
}

/// Sums over the samples of one pixel.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PixelSums {
    /// Samples with a hit.
    pub hits: u32,
    /// Sum of the layers' radiance.
    pub diffuse: Vec3,
    /// Sum of the layers' radiance.
    pub specular: Vec3,
    /// Sum of diffuse albedo over hits.
    pub albedo: Vec3,
    /// Sum of unit normals over hits.
    pub normal: Vec3,
    /// Sum of distances along the ray over hits.
    pub distance: f32,
}

/// The picture that is rendered, or a band of its rows.
#[derive(Resource, Clone, Debug)]
pub struct FrameTarget {
    /// The camera of the whole picture.
    pub camera: Camera,
    /// Camera rays along each side of a pixel's grid of samples.
    pub side: u32,
    /// The rows of the picture that are rendered.
    pub rows: Range<u32>,
    /// Sums per pixel of these rows, row by row.
    pub pixels: Vec<PixelSums>,
    /// Numbers of the only pixels that rays are cast at, counted over the whole picture; `None`:
    /// all of these rows.
    pub(super) chosen: Option<Vec<u32>>,
    /// First sample of the current tile, counted over the whole picture.
    cursor: usize,
}

impl FrameTarget {
    /// Empty `rows` of a picture with about `samples_per_pixel` camera rays per pixel, on a square
    /// grid. Rays and random numbers of a pixel are the same in any band.
    pub fn band(camera: Camera, samples_per_pixel: u32, rows: Range<u32>) -> Self {
        let side = (f64::from(samples_per_pixel.max(1))).sqrt().round().max(1.0) as u32;
        let count = camera.width as usize * rows.len();
        let pixels = vec![PixelSums::default(); count];
        Self { camera, side, rows, pixels, chosen: None, cursor: 0 }
    }

    /// Camera rays per pixel.
    pub fn samples_per_pixel(&self) -> usize {
        (self.side * self.side) as usize
    }

    /// Number in the whole picture of the first pixel.
    pub(super) fn first_pixel(&self) -> usize {
        self.rows.start as usize * self.camera.width as usize
    }

    /// The samples of these rows, counted over the whole picture; of chosen pixels, counted over
    /// these.
    fn samples(&self) -> Range<usize> {
        let first = self.first_pixel();
        let per_pixel = self.samples_per_pixel();
        if let Some(chosen) = &self.chosen {
            return 0..chosen.len() * per_pixel;
        }
        first * per_pixel..(first + self.pixels.len()) * per_pixel
    }

    /// Pixel and ray of sample `index`; the samples of a pixel are consecutive.
    fn sample(&self, index: usize) -> (PixelOf, ViewRay) {
        let per_pixel = self.samples_per_pixel();
        let (place, within) = (index / per_pixel, (index % per_pixel) as u32);
        let pixel = self.chosen.as_ref().map_or(place, |chosen| chosen[place] as usize);
        let (x, y) = (pixel as u32 % self.camera.width, pixel as u32 / self.camera.width);
        let offset = |i: u32| (i as f32 + 0.5) / self.side as f32;
        let ray =
            self.camera.ray(x as f32 + offset(within % self.side), y as f32 + offset(within / self.side));
        (PixelOf { view: ViewIndex(0), pixel: pixel as u32 }, ViewRay(ray))
    }
}

/// Rendering of pictures: the Compose phase with the recovered material and the scene's own light,
/// the Frame phase with accurate closed-form shading. Each of these systems can be swapped.
pub struct FramePlugin;

impl Plugin for FramePlugin {
    fn build(&self, pipeline: &mut Pipeline) {
        pipeline
            .add_systems(Phase::Frame, Stage::Sample, sample_pixels)
            .add_systems(Phase::Frame, Stage::Trace, trace_samples)
            .swap(Phase::Compose, Slot::Material, show_recovered())
            .swap(Phase::Compose, Slot::Light, provide_light(LightChoice::Own, false))
            .swap(Phase::Frame, Slot::Shading, shade_closed_form(ClosedForm::default()))
            .add_systems(Phase::Frame, Stage::Resolve, resolve_pixels);
        add_gathering::<ShownMaterial>(pipeline, Phase::Frame);
    }
}

/// Adds the systems of [`GatherPoints`]: base materials, albedo and blends of a material at the
/// points of the window, of which no visibility is known yet; and what the Gather stage writes.
pub fn add_gathering<M: MaterialSource>(pipeline: &mut Pipeline, phase: Phase) {
    let world = &mut pipeline.world;
    world.init_resource::<Window>();
    world.init_resource::<IncidentLight>();
    world.init_resource::<BaseMaterials>();
    world.init_resource::<PlainBlends<M>>();
    world.init_resource::<WindowVisibility>();
    let materials =
        (note_plain_blends::<M>.run_if(blends_changed::<M>), gather_materials::<M>, gather_blends::<M>);
    pipeline.add_systems(phase, Stage::Gather, (forget_window, gather_points::<M>).in_set(GatherPoints));
    pipeline.add_systems(phase, Stage::Gather, materials.chain().in_set(GatherPoints));
}

/// Renders one picture with the systems in the slots of the Frame phase. All of it is in memory,
/// [`PixelSums`] per pixel; for a large one see [`render_bands`].
///
/// # Errors
/// The first error of a system.
pub fn render_frame(pipeline: &mut Pipeline, camera: Camera, samples_per_pixel: u32) -> Result<FrameTarget> {
    let target = FrameTarget::band(camera, samples_per_pixel, 0..camera.height);
    spawn_pool(&mut pipeline.world, target.samples().len());
    let rendered = render_rows(pipeline, target);
    despawn_pool(&mut pipeline.world);
    rendered
}

/// Renders one picture in bands of `rows_per_band` rows (at least 1), from the top, so that its
/// height needs no memory. `take` gets the world, the number of the band's first row and the band;
/// the pixels have the bits of [`render_frame`].
///
/// # Errors
/// The first error of a system or of `take`.
pub fn render_bands(
    pipeline: &mut Pipeline,
    camera: Camera,
    samples_per_pixel: u32,
    rows_per_band: u32,
    take: &mut dyn FnMut(&World, u32, &Frame) -> Result<()>,
) -> Result<()> {
    let band = |rows: Range<u32>| FrameTarget::band(camera, samples_per_pixel, rows);
    let samples = camera.width as usize * camera.height as usize * band(0..0).samples_per_pixel();
    spawn_pool(&mut pipeline.world, samples);
    let outcome = bands(camera, rows_per_band).try_for_each(|rows| {
        let start = rows.start;
        // The sums go before the band is taken, which needs memory of its own.
        let frame = resolve(&render_rows(pipeline, band(rows))?);
        take(&pipeline.world, start, &frame)
    });
    despawn_pool(&mut pipeline.world);
    outcome
}

/// The rows of the bands of a picture.
pub(super) fn bands(camera: Camera, rows_per_band: u32) -> impl Iterator<Item = Range<u32>> {
    let (height, count) = (camera.height, rows_per_band.max(1));
    (0..height).step_by(count as usize).map(move |start| start..start.saturating_add(count).min(height))
}

/// Pixels of a band: enough to use all threads, few enough for memory.
const BAND_PIXELS: u32 = 1 << 19;

/// Rows of a band for [`render_bands`] of a picture of this width and height: about half a million
/// pixels, and whole blocks of [`BLOCK_ROWS`] where a band has several.
pub fn band_rows([width, height]: [u32; 2]) -> u32 {
    let rows = (BAND_PIXELS / width.max(1)).max(1);
    let whole_blocks = rows - rows % BLOCK_ROWS as u32;
    (if whole_blocks > 0 { whole_blocks } else { rows }).min(height.max(1))
}

/// Peak memory in bytes of rendering a picture of this width and height in bands of [`band_rows`]
/// and writing it as EXR and PNG: it grows with the width only. What the scene itself takes is not
/// included.
pub fn frame_bytes([width, height]: [u32; 2]) -> u64 {
    let band = u64::from(width) * u64::from(band_rows([width, height]));
    // A block that is not complete waits for the next band.
    let waiting = u64::from(width) * BLOCK_ROWS as u64;
    // The band, its light behind and its 8-bit colors; its blocks raw, reordered and compressed.
    let per_pixel = Frame::PIXEL_BYTES + size_of::<Vec3>() + 4 + 4 * Frame::PIXEL_BYTES;
    // The pool and what shading makes of it.
    let pool = 2 * POOL * size_of::<FrameSample>();
    band * per_pixel as u64 + waiting * Frame::PIXEL_BYTES as u64 + pool as u64
}

/// Spawns the pool of samples for a picture of `samples` samples; one of the same size that a
/// picture before has left is taken over.
pub(super) fn spawn_pool(world: &mut World, samples: usize) {
    let count = samples.min(POOL);
    let mut left = world.query_filtered::<(), (With<SampleIndex>, With<Layers>)>();
    if left.iter(world).count() == count {
        return;
    }
    despawn_pool(world);
    let blank = |row| FrameSample { index: SampleIndex(row), ..FrameSample::default() };
    world.spawn_batch((0..count as u32).map(blank).collect::<Vec<_>>());
}

/// Renders the rows of `target`, or its chosen pixels, tile by tile.
pub(super) fn render_rows(pipeline: &mut Pipeline, target: FrameTarget) -> Result<FrameTarget> {
    let (samples, per_pixel) = (target.samples(), target.samples_per_pixel());
    // Tiles begin at the same samples of the picture whatever the rows: a sample has the same place
    // in the pool, and with it the same random numbers, in any band. They have whole pixels, unless
    // a pixel has more samples.
    let tile = POOL - if per_pixel <= POOL { POOL % per_pixel } else { 0 };
    let first = samples.start - samples.start % tile;
    pipeline.world.insert_resource(PictureRotation(target.camera.world_from_camera.matrix3.into()));
    pipeline.world.insert_resource(target);
    let outcome = pipeline.run(Phase::Compose).and_then(|()| {
        (first..samples.end).step_by(tile).try_for_each(|cursor| {
            pipeline.world.resource_mut::<FrameTarget>().cursor = cursor;
            let end = samples.end.min(cursor + tile);
            pipeline.world.resource_mut::<Window>().0 = samples.start.max(cursor) - cursor..end - cursor;
            pipeline.run(Phase::Frame)?;
            // A tile that was stopped is not whole.
            check_interrupted()
        })
    });
    pipeline.world.remove_resource::<PictureRotation>();
    let target = pipeline.world.remove_resource::<FrameTarget>().expect("it was inserted above");
    outcome.map(|()| target)
}

/// The material that a frame would show now, by the system in [`Slot::Material`].
///
/// # Errors
/// The first error of a system; if the pool of texels is not whole.
pub fn frame_material(pipeline: &mut Pipeline) -> Result<MaterialState> {
    pipeline.run(Phase::Compose)?;
    shown_material(&mut pipeline.world)
}

/// Converts sums over samples to the layers of a frame: radiance averages over all samples, other
/// layers over samples with a hit.
pub fn resolve(target: &FrameTarget) -> Frame {
    let samples = target.samples_per_pixel() as f32;
    let each = |f: &(dyn Fn(&PixelSums) -> Vec3 + Sync)| parallel::map_slice(&target.pixels, 1024, f);
    Frame {
        width: target.camera.width as usize,
        height: target.rows.len(),
        color: each(&|p| (p.diffuse + p.specular) / samples),
        alpha: target.pixels.iter().map(|p| p.hits as f32 / samples).collect(),
        diffuse: each(&|p| p.diffuse / samples),
        specular: each(&|p| p.specular / samples),
        albedo: each(&|p| p.albedo / p.hits.max(1) as f32),
        normal: each(&|p| p.normal.normalize_or_zero()),
        depth: target.pixels.iter().map(|p| p.distance / p.hits.max(1) as f32).collect(),
    }
}

/// Sample: the camera rays of the current tile.
pub fn sample_pixels(
    target: Res<FrameTarget>,
    samples: Samples<(&SampleIndex, &mut PixelOf, &mut ViewRay)>,
) -> SystemResult {
    let (index, mut pixels, mut rays) = samples.columns()?;
    let columns = ((&mut *pixels, &mut *rays), &*index);
    parallel::for_each_row(columns, 4096, |((pixel, ray), index)| {
        (*pixel, *ray) = target.sample(target.cursor + index.0 as usize);
    });
    Ok(())
}

/// Trace: intersects the rays with the surface. A back face (seen from inside an open mesh) counts
/// as a hit and has zero radiance.
pub fn trace_samples(scenery: Res<Scenery>, samples: Samples<(&ViewRay, &mut SurfacePoint)>) -> SystemResult {
    let (rays, mut points) = samples.columns()?;
    parallel::for_each_row((&mut *points, &*rays), 512, |(point, ray)| {
        *point = scenery.0.intersect(&ray.0, 0.0).into();
    });
    Ok(())
}

/// Resolve: adds the samples of the tile to their pixels, in the order of [`SampleIndex`].
pub fn resolve_pixels(
    mut target: ResMut<FrameTarget>,
    samples: Samples<(&PixelOf, &SurfacePoint, &ShadePoint, &Layers)>,
) -> SystemResult {
    let (pixels, points, gathered, shaded) = samples.columns()?;
    let (first, target) = (target.first_pixel(), &mut *target);
    for i in (0..points.len()).filter(|&i| points[i].is_hit()) {
        let at = pixels[i].pixel as usize - first;
        let [diffuse, specular, albedo] =
            [shaded[i].diffuse, shaded[i].specular, gathered[i].albedo].map(Vec3::from);
        let sums = &mut target.pixels[at];
        sums.hits += 1;
        sums.diffuse += diffuse;
        sums.specular += specular;
        sums.albedo += albedo;
        sums.normal += points[i].normal;
        sums.distance += points[i].distance;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_takes_too_much_memory_is_refused_with_the_number() {
        check_memory("a map", 4096, 4096, MOST_FRAME_BYTES).unwrap();
        let error = check_memory("a map", 16_384, 16_384, 51 << 30).unwrap_err();
        assert_eq!(error.exit_code(), 2);
        let text = error.to_string();
        assert!(text.contains("a map of 16384×16384 pixels takes 51.0 GiB"), "{text}");
        assert!(text.contains("the limit is 8 GiB"), "{text}");
    }
}
