//! The Frame phase: one tile of a picture at a time, Sample ▸ Trace ▸ Gather ▸ Shade ▸ Resolve.

use crate::error::Result;
use crate::math::shading::{Layers, ShadePoint};
use crate::pipeline::{Phase, Pipeline, Plugin, Slot, Stage, SystemResult};
use crate::sample::bundle::{FrameSample, despawn_pool, only_table};
use crate::sample::pixel::{PixelOf, ViewRay, Window};
use crate::sample::point::SurfacePoint;
use crate::shade::{
    IncidentLight, Scenery, ShadingForm, gather_blends, gather_points, provide_lobes, shade_closed_form,
};
use crate::view::Camera;
use crate::visibility::RefreshDue;
use bevy_ecs::prelude::{IntoScheduleConfigs, Query, Res, ResMut, Resource};
use glam::Vec3;
use rayon::prelude::*;

/// Samples in the pool of a frame: enough to keep the threads busy, few enough to stay in cache and memory.
const POOL: usize = 1 << 16;

/// Sums over the samples of one pixel.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PixelSums {
    /// Samples that met the surface.
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

/// The picture being made.
#[derive(Resource, Clone, Debug)]
pub struct FrameTarget {
    /// The camera.
    pub camera: Camera,
    /// Camera rays along each side of a pixel's grid of samples.
    pub side: u32,
    /// Sums per pixel, row by row.
    pub pixels: Vec<PixelSums>,
    /// First sample of the present tile.
    cursor: usize,
}

impl FrameTarget {
    /// An empty picture with about `samples_per_pixel` camera rays a pixel, on a square grid.
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

    /// Pixel and ray of sample `index`; the samples of a pixel follow each other.
    fn sample(&self, index: usize) -> (PixelOf, ViewRay) {
        let per_pixel = self.samples_per_pixel();
        let (pixel, within) = (index / per_pixel, (index % per_pixel) as u32);
        let (x, y) = (pixel as u32 % self.camera.width, pixel as u32 / self.camera.width);
        let offset = |i: u32| (i as f32 + 0.5) / self.side as f32;
        let ray =
            self.camera.ray(x as f32 + offset(within % self.side), y as f32 + offset(within / self.side));
        (PixelOf { view: 0, pixel: pixel as u32 }, ViewRay(ray))
    }
}

/// Rendering of pictures: the Frame phase with SG lobes as light and closed-form shading, both of which can be swapped.
pub struct FramePlugin;

impl Plugin for FramePlugin {
    fn build(&self, pipeline: &mut Pipeline) {
        pipeline.world.init_resource::<Window>();
        pipeline.world.init_resource::<IncidentLight>();
        pipeline.world.init_resource::<ShadingForm>();
        pipeline
            .add_systems(Phase::Frame, Stage::Sample, sample_pixels)
            .add_systems(Phase::Frame, Stage::Trace, trace_samples)
            .add_systems(Phase::Frame, Stage::Gather, (gather_points, gather_blends).before(Slot::Visibility))
            .swap(Phase::Frame, Slot::Light, provide_lobes)
            .swap(Phase::Frame, Slot::Shading, shade_closed_form)
            .add_systems(Phase::Frame, Stage::Resolve, resolve_pixels);
    }
}

/// Renders one picture with whatever systems are in the Frame phase's slots.
///
/// # Errors
/// The first error of a system.
pub fn render_frame(pipeline: &mut Pipeline, camera: Camera, samples_per_pixel: u32) -> Result<FrameTarget> {
    let target = FrameTarget::new(camera, samples_per_pixel);
    let total = target.samples();
    despawn_pool(&mut pipeline.world);
    let blank = FrameSample::blank(camera.ray(0.0, 0.0));
    pipeline.world.spawn_batch(std::iter::repeat_n(blank, total.min(POOL)));
    pipeline.world.insert_resource(target);
    for start in (0..total).step_by(POOL) {
        pipeline.world.resource_mut::<FrameTarget>().cursor = start;
        pipeline.world.insert_resource(RefreshDue(start == 0));
        pipeline.world.resource_mut::<Window>().0 = 0..POOL.min(total - start);
        pipeline.run(Phase::Frame)?;
    }
    despawn_pool(&mut pipeline.world);
    Ok(pipeline.world.remove_resource::<FrameTarget>().expect("it was inserted above"))
}

/// Sample: the camera rays of the present tile.
pub fn sample_pixels(
    window: Res<Window>,
    target: Res<FrameTarget>,
    mut samples: Query<(&mut PixelOf, &mut ViewRay)>,
) -> SystemResult {
    if let Some((mut pixels, mut rays)) = only_table(samples.contiguous_iter_mut()?, |t| t.0.len(), "pixel")?
    {
        let pixels = &mut pixels.bypass_change_detection()[window.0.clone()];
        let rays = &mut rays.bypass_change_detection()[window.0.clone()];
        let columns = pixels.par_iter_mut().zip(rays).enumerate().with_min_len(4096);
        columns.for_each(|(i, (pixel, ray))| (*pixel, *ray) = target.sample(target.cursor + i));
    }
    Ok(())
}

/// Trace: where the rays meet the surface. What shows its back (from inside an open mesh) counts as a hit and shades to zero.
pub fn trace_samples(
    window: Res<Window>,
    scenery: Res<Scenery>,
    mut samples: Query<(&ViewRay, &mut SurfacePoint)>,
) -> SystemResult {
    if let Some((rays, mut points)) = only_table(samples.contiguous_iter_mut()?, |t| t.0.len(), "pixel")? {
        let rays = &rays[window.0.clone()];
        let points = &mut points.bypass_change_detection()[window.0.clone()];
        let columns = points.par_iter_mut().zip(rays).with_min_len(512);
        columns.for_each(|(point, ray)| *point = scenery.0.intersect(&ray.0, 0.0).into());
    }
    Ok(())
}

/// Resolve: adds the tile's samples to their pixels, in row order.
pub fn resolve_pixels(
    window: Res<Window>,
    mut target: ResMut<FrameTarget>,
    samples: Query<(&PixelOf, &SurfacePoint, &ShadePoint, &Layers)>,
) -> SystemResult {
    let Some((pixels, points, gathered, shaded)) =
        only_table(samples.contiguous_iter()?, |t| t.0.len(), "pixel")?
    else {
        return Ok(());
    };
    for i in window.0.clone() {
        if points[i].is_hit() {
            let sums = &mut target.pixels[pixels[i].pixel as usize];
            sums.hits += 1;
            sums.diffuse += Vec3::from(shaded[i].diffuse);
            sums.specular += Vec3::from(shaded[i].specular);
            sums.albedo += Vec3::from(gathered[i].albedo);
            sums.normal += points[i].normal;
            sums.distance += points[i].distance;
        }
    }
    Ok(())
}
