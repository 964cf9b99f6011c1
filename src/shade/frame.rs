//! The Frame phase: one tile of a picture at a time, Sample ▸ Trace ▸ Gather ▸ Shade ▸ Resolve.

use super::systems::{gather_blends, gather_points, shade_closed_form};
use crate::codec::frame::Frame;
use crate::error::{Error, Result};
use crate::light::lights::{IncidentLight, LightChoice, provide_light};
use crate::material::shown::{mark_material_changed, show_recovered};
use crate::material::source::{
    BaseMaterials, MaterialSource, PlainBlends, Shown, blends_changed, gather_materials, note_plain_blends,
};
use crate::math::shading::{ClosedForm, Layers, ShadePoint};
use crate::pipeline::{GatherPoints, Phase, Pipeline, Plugin, Slot, Stage, SystemResult};
use crate::sample::Samples;
use crate::sample::bundle::{FrameSample, despawn_pool};
use crate::sample::pixel::{PixelOf, SampleIndex, ViewRay, Window};
use crate::sample::point::{Scenery, SurfacePoint};
use crate::view::{Camera, ViewIndex};
use bevy_ecs::prelude::{IntoScheduleConfigs, Res, ResMut, Resource, World};
use glam::Vec3;
use rayon::prelude::*;

/// Samples in the pool of a frame: enough to use all threads, few enough for cache and memory.
const POOL: usize = 1 << 16;

/// Most memory that one picture may be expected to take, in bytes.
pub const MOST_FRAME_BYTES: u64 = 8 << 30;

/// Memory that rendering and writing a picture of `width` × `height` pixels takes at its peak, in bytes: the sums of its pixels
/// and the [`Frame`] at first; then the frame, its channels, and what the encoder holds of them.
pub fn frame_bytes(width: u32, height: u32) -> u64 {
    // The color and four layers of three floats, alpha and depth.
    const FRAME: u64 = 17 * 4;
    let per_pixel = (size_of::<PixelSums>() as u64 + FRAME).max(3 * FRAME);
    (u64::from(width) * u64::from(height)).saturating_mul(per_pixel)
}

/// Checks that pictures of `width` × `height` pixels fit into [`MOST_FRAME_BYTES`], beside `other` bytes; `what` names them.
///
/// # Errors
/// [`Error::Usage`] with the size, the memory and the limit.
pub fn check_frame(what: &str, width: u32, height: u32, other: u64) -> Result<()> {
    check_memory(what, width, height, frame_bytes(width, height).saturating_add(other))
}

/// Checks that `bytes` are at most [`MOST_FRAME_BYTES`]; `what` names the picture that takes them.
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

/// The picture that is rendered.
#[derive(Resource, Clone, Debug)]
pub struct FrameTarget {
    /// The camera.
    pub camera: Camera,
    /// Camera rays along each side of a pixel's grid of samples.
    pub side: u32,
    /// Sums per pixel, row by row.
    pub pixels: Vec<PixelSums>,
    /// First sample of the current tile.
    cursor: usize,
}

impl FrameTarget {
    /// An empty picture with about `samples_per_pixel` camera rays per pixel, on a square grid.
    pub fn new(camera: Camera, samples_per_pixel: u32) -> Self {
        let side = (f64::from(samples_per_pixel.max(1))).sqrt().round().max(1.0) as u32;
        let count = camera.width as usize * camera.height as usize;
        Self { camera, side, pixels: vec![PixelSums::default(); count], cursor: 0 }
    }

    /// Camera rays per pixel.
    pub fn samples_per_pixel(&self) -> usize {
        (self.side * self.side) as usize
    }

    fn samples(&self) -> usize {
        self.pixels.len() * self.samples_per_pixel()
    }

    /// Pixel and ray of sample `index`; the samples of a pixel are consecutive.
    fn sample(&self, index: usize) -> (PixelOf, ViewRay) {
        let per_pixel = self.samples_per_pixel();
        let (pixel, within) = (index / per_pixel, (index % per_pixel) as u32);
        let (x, y) = (pixel as u32 % self.camera.width, pixel as u32 / self.camera.width);
        let offset = |i: u32| (i as f32 + 0.5) / self.side as f32;
        let ray =
            self.camera.ray(x as f32 + offset(within % self.side), y as f32 + offset(within / self.side));
        (PixelOf { view: ViewIndex(0), pixel: pixel as u32 }, ViewRay(ray))
    }
}

/// Rendering of pictures: the Frame phase with the recovered material, the scene's own light and accurate closed-form shading. Each
/// of these systems can be swapped.
pub struct FramePlugin;

impl Plugin for FramePlugin {
    fn build(&self, pipeline: &mut Pipeline) {
        add_material_resources::<Shown>(&mut pipeline.world);
        pipeline
            .add_systems(Phase::Frame, Stage::Sample, sample_pixels)
            .add_systems(Phase::Frame, Stage::Trace, trace_samples)
            .swap(Phase::Frame, Slot::Material, show_recovered())
            .swap(Phase::Frame, Slot::Light, provide_light(LightChoice::Own, false))
            .swap(Phase::Frame, Slot::Shading, shade_closed_form(ClosedForm::default()))
            .add_systems(Phase::Frame, Stage::Resolve, resolve_pixels);
        add_gathering::<Shown>(pipeline, Phase::Frame);
    }

    fn cleanup(world: &mut World) {
        world.remove_resource::<PlainBlends<Shown>>();
    }
}

/// Inserts the resources that the Gather stage writes.
pub fn add_material_resources<M: MaterialSource>(world: &mut World) {
    world.init_resource::<Window>();
    world.init_resource::<IncidentLight>();
    world.init_resource::<BaseMaterials>();
    world.init_resource::<PlainBlends<M>>();
}

/// Adds the systems of [`GatherPoints`]: base materials, albedo and blends of a material at the points of the window.
pub fn add_gathering<M: MaterialSource>(pipeline: &mut Pipeline, phase: Phase) {
    pipeline.mark_after_failure(mark_material_changed);
    let materials =
        (note_plain_blends::<M>.run_if(blends_changed::<M>), gather_materials::<M>, gather_blends::<M>);
    pipeline.add_systems(phase, Stage::Gather, gather_points::<M>.in_set(GatherPoints));
    pipeline.add_systems(phase, Stage::Gather, materials.chain().in_set(GatherPoints));
}

/// Renders one picture with the systems in the slots of the Frame phase.
///
/// # Errors
/// The first error of a system.
pub fn render_frame(pipeline: &mut Pipeline, camera: Camera, samples_per_pixel: u32) -> Result<FrameTarget> {
    let target = FrameTarget::new(camera, samples_per_pixel);
    let total = target.samples();
    despawn_pool(&mut pipeline.world);
    let blank = |row| FrameSample::blank(SampleIndex(row), camera.ray(0.0, 0.0));
    pipeline.world.spawn_batch((0..total.min(POOL) as u32).map(blank).collect::<Vec<_>>());
    pipeline.world.insert_resource(target);
    for start in (0..total).step_by(POOL) {
        pipeline.world.resource_mut::<FrameTarget>().cursor = start;
        pipeline.world.resource_mut::<Window>().0 = 0..POOL.min(total - start);
        pipeline.run(Phase::Frame)?;
    }
    despawn_pool(&mut pipeline.world);
    Ok(pipeline.world.remove_resource::<FrameTarget>().expect("it was inserted above"))
}

/// Converts sums over samples to the layers of a frame: radiance averages over all samples, other layers over samples with a hit.
pub fn resolve(target: &FrameTarget) -> Frame {
    let samples = target.samples_per_pixel() as f32;
    let over_hits = |sum: Vec3, hits: u32| if hits > 0 { sum / hits as f32 } else { Vec3::ZERO };
    let each = |f: &dyn Fn(&PixelSums) -> Vec3| target.pixels.iter().map(f).collect();
    Frame {
        width: target.camera.width as usize,
        height: target.camera.height as usize,
        color: each(&|p| (p.diffuse + p.specular) / samples),
        alpha: target.pixels.iter().map(|p| p.hits as f32 / samples).collect(),
        diffuse: each(&|p| p.diffuse / samples),
        specular: each(&|p| p.specular / samples),
        albedo: each(&|p| over_hits(p.albedo, p.hits)),
        normal: each(&|p| p.normal.normalize_or_zero()),
        depth: target
            .pixels
            .iter()
            .map(|p| if p.hits > 0 { p.distance / p.hits as f32 } else { 0.0 })
            .collect(),
    }
}

/// Sample: the camera rays of the current tile.
pub fn sample_pixels(
    target: Res<FrameTarget>,
    samples: Samples<(&SampleIndex, &mut PixelOf, &mut ViewRay)>,
) -> SystemResult {
    let (index, mut pixels, mut rays) = samples.columns()?;
    let columns = pixels.par_iter_mut().zip(&mut *rays).zip(&*index).with_min_len(4096);
    columns.for_each(|((pixel, ray), index)| {
        (*pixel, *ray) = target.sample(target.cursor + index.0 as usize);
    });
    Ok(())
}

/// Trace: intersects the rays with the surface. A back face (seen from inside an open mesh) counts as a hit and has zero radiance.
pub fn trace_samples(scenery: Res<Scenery>, samples: Samples<(&ViewRay, &mut SurfacePoint)>) -> SystemResult {
    let (rays, mut points) = samples.columns()?;
    let columns = points.par_iter_mut().zip(&*rays).with_min_len(512);
    columns.for_each(|(point, ray)| *point = scenery.0.intersect(&ray.0, 0.0).into());
    Ok(())
}

/// Resolve: adds the samples of the tile to their pixels, in the order of [`SampleIndex`].
pub fn resolve_pixels(
    mut target: ResMut<FrameTarget>,
    samples: Samples<(&PixelOf, &SurfacePoint, &ShadePoint, &Layers)>,
) -> SystemResult {
    let (pixels, points, gathered, shaded) = samples.columns()?;
    for i in (0..points.len()).filter(|&i| points[i].is_hit()) {
        let sums = &mut target.pixels[pixels[i].pixel as usize];
        sums.hits += 1;
        sums.diffuse += Vec3::from(shaded[i].diffuse);
        sums.specular += Vec3::from(shaded[i].specular);
        sums.albedo += Vec3::from(gathered[i].albedo);
        sums.normal += points[i].normal;
        sums.distance += points[i].distance;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_that_take_too_much_memory_are_refused_with_the_number() {
        assert_eq!(frame_bytes(10, 10), 100 * 204);
        check_frame("a view", 4096, 4096, 0).unwrap();
        let error = check_frame("view front", 16_384, 16_384, 0).unwrap_err();
        assert_eq!(error.exit_code(), 2);
        let text = error.to_string();
        assert!(
            text.contains("view front of 16384×16384 pixels takes 51.0 GiB") && text.contains("8 GiB"),
            "{text}"
        );
        assert!(check_frame("a film", 64, 64, MOST_FRAME_BYTES).is_err());
        assert!(check_frame("a view", u32::MAX, u32::MAX, u64::MAX).is_err());
    }
}
