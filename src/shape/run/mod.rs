//! Fitting a shape: from the visual hull through levels of finer grids, each a fit of its own.

use crate::error::Result;
use crate::fit::cameras::{
    CameraFit, CameraPlugin, CameraUnknowns, align_photographs, attach_poses, recast_rays,
};
use crate::fit::components::{AlbedoGradient, AlbedoMoments, TexelSeen};
use crate::fit::run::{FirstGuess, FitOptions, FitProgress, run_fit};
use crate::material::{DiffuseAlbedo, SpecularBlend, SpecularLobe};
use crate::pipeline::{Phase, Pipeline, Plugin, Slot};
use crate::sample::pixel::PixelOf;
use crate::sdf::SdfGrid;
use crate::sdf::volume::{SdfSurface, TexelVolume};
use crate::shade::Scenery;
use crate::shape::field::{BrickAt, BrickGradient, BrickMoments, BrickValues, SdfField, bricks_near_surface};
use crate::shape::hull::{FORGIVEN, Silhouette, pixel_size, visual_hull};
use crate::shape::repair::{believed_pixels, regrow};
use crate::shape::silhouette_loss::SilhouetteSample;
use crate::shape::systems::{
    ShapeSchedule, align_outlines, hand_out_to_bricks, move_bricks, pull_back_silhouettes,
    pull_back_to_field, recast_outlines, retrace_window,
};
use crate::view::{Camera, Photograph, Split, ViewMask, ViewName};
use bevy_ecs::prelude::{Component, Entity, IntoScheduleConfigs, With, Without, World};
use glam::Vec3;
use rand::seq::SliceRandom;
use rand::{SeedableRng, rngs::SmallRng};
use std::ops::ControlFlow;
use std::sync::Arc;

/// Pixels from an outline within which silhouette rays are cast.
const SILHOUETTE_REACH: f32 = 6.0;
/// Part of the half side of the grid within which there are texels.
const TEXEL_REACH: f32 = 0.15;

/// One level of a shape's fit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ShapeLevel {
    /// Cells a side of the grid.
    pub cells: u32,
    /// Cells a side of the lattice of texels.
    pub texel_cells: u32,
    /// How the shape moves.
    pub schedule: ShapeSchedule,
}

/// Settings of a shape's fit.
#[derive(Clone, Debug, PartialEq)]
pub struct ShapeOptions {
    /// From coarse to fine; at least one.
    pub levels: Vec<ShapeLevel>,
    /// The fit of light and material beside it; its steps are those of the level.
    pub fit: FitOptions,
    /// What of the cameras is found too.
    pub cameras: CameraUnknowns,
}

/// The systems that fit a shape; [`ShapePlugin::remove`] takes them out again.
pub struct ShapePlugin;

impl Plugin for ShapePlugin {
    fn build(&self, pipeline: &mut Pipeline) {
        pipeline
            .swap(Phase::FitStep, Slot::Retrace, retrace_window)
            .swap(
                Phase::FitStep,
                Slot::ShapeGradient,
                (pull_back_to_field, pull_back_silhouettes, hand_out_to_bricks).chain(),
            )
            .swap(Phase::FitStep, Slot::ShapeUpdate, move_bricks);
    }
}

impl ShapePlugin {
    /// Takes the systems out, so that surfaces stay as they are.
    pub fn remove(pipeline: &mut Pipeline) {
        for slot in [Slot::Retrace, Slot::ShapeGradient, Slot::ShapeUpdate] {
            pipeline.clear(Phase::FitStep, slot);
        }
    }
}

/// The systems that move cameras to where photographs and masks ask for, beside a shape; [`CameraPlugin::remove`] takes
/// them out again.
struct ShapeCameraPlugin(CameraUnknowns);

impl Plugin for ShapeCameraPlugin {
    fn build(&self, pipeline: &mut Pipeline) {
        pipeline
            .add_plugin(&CameraPlugin(self.0))
            .swap(Phase::FitStep, Slot::Recast, (recast_rays, recast_outlines))
            .swap(Phase::FitStep, Slot::Retrace, retrace_window)
            .swap(Phase::FitStep, Slot::CameraGradient, (align_photographs, align_outlines).chain());
        pipeline.world.resource_mut::<CameraFit>().object_moves = true;
    }
}

/// What a caller sees of a running fit.
pub struct ShapeProgress<'a> {
    /// Index of the level.
    pub level: usize,
    /// The fit of that level.
    pub fit: &'a FitProgress,
    /// The field now.
    pub field: &'a SdfField,
}

/// Fits shape, light and material; leaves the shape's texels in the world as they are on its finest lattice.
///
/// # Errors
/// If the masks have no hull, or a fit fails.
pub fn fit_shape(
    pipeline: &mut Pipeline,
    options: &ShapeOptions,
    watch: &mut dyn FnMut(&ShapeProgress) -> ControlFlow<()>,
) -> Result<SdfSurface> {
    let mut silhouettes = training_silhouettes(&mut pipeline.world);
    let hull = visual_hull(&silhouettes, options.levels[0].cells)?;
    pipeline.world.spawn_batch(silhouette_samples(&hull, &silhouettes, options.fit.pixels.seed));
    pipeline.add_plugin(&ShapePlugin);
    if options.cameras != CameraUnknowns::Given {
        pipeline.add_plugin(&ShapeCameraPlugin(options.cameras));
    }
    let found = fit_levels(pipeline, hull, &mut silhouettes, options, watch);
    CameraPlugin::remove(pipeline);
    ShapePlugin::remove(pipeline);
    despawn_with::<SilhouetteSample>(&mut pipeline.world);
    found
}

/// Fits one level after the other, until `watch` stops it.
fn fit_levels(
    pipeline: &mut Pipeline,
    mut grid: SdfGrid,
    silhouettes: &mut [Silhouette],
    options: &ShapeOptions,
    watch: &mut dyn FnMut(&ShapeProgress) -> ControlFlow<()>,
) -> Result<SdfSurface> {
    let mut texels: Option<(TexelVolume, Vec<Vec3>)> = None;
    for (index, level) in options.levels.iter().enumerate() {
        if options.cameras != CameraUnknowns::Given {
            attach_poses(&mut pipeline.world);
        }
        if index > 0 {
            let cameras = photographed_cameras(&mut pipeline.world);
            silhouettes.iter_mut().for_each(|s| s.camera = cameras[s.view as usize]);
            grid = grid.resampled(level.cells);
            regrow(&mut grid, silhouettes, FORGIVEN);
        }
        grid.redistance();
        let volume = TexelVolume::new(&grid, level.texel_cells, TEXEL_REACH * half_side(&grid));
        let albedo = carried_albedo(&volume, texels.as_ref());
        replace_texels(&mut pipeline.world, &albedo);
        enter(&mut pipeline.world, SdfSurface { grid, volume: volume.clone() }, level.schedule);
        let guess = if index == 0 { options.fit.guess } else { FirstGuess::NONE };
        let fit = FitOptions { steps: level.schedule.steps, guess, ..options.fit.clone() };
        let result = run_fit(pipeline, &fit, &mut |progress, world| {
            let field = world.resource::<SdfField>();
            watch(&ShapeProgress { level: index, fit: progress, field })
        });
        grid = leave(&mut pipeline.world);
        let world = &mut pipeline.world;
        texels = Some((volume, world.query::<&DiffuseAlbedo>().iter(world).map(|a| a.0).collect()));
        if result?.stopped {
            break;
        }
    }
    let volume = texels.map(|t| t.0).unwrap_or_else(|| TexelVolume::new(&grid, 1, 0.0));
    Ok(SdfSurface { grid, volume })
}

fn half_side(grid: &SdfGrid) -> f32 {
    0.5 * grid.spacing * (grid.side - 1) as f32
}

/// The cameras of all photographs, by [`PixelOf::view`].
fn photographed_cameras(world: &mut World) -> Vec<Camera> {
    world.query_filtered::<&Camera, With<Photograph>>().iter(world).copied().collect()
}

fn training_silhouettes(world: &mut World) -> Vec<Silhouette> {
    let mut views =
        world.query_filtered::<(&ViewName, &Camera, Option<&ViewMask>, &Split), With<Photograph>>();
    let train = views.iter(world).zip(0..).filter(|((_, _, _, split), _)| **split == Split::Train);
    let silhouette = |((name, camera, mask, _), view): ((&ViewName, &Camera, Option<&ViewMask>, _), u32)| {
        Some(Silhouette::new(&name.0, camera, &mask?.0)?.of_view(view))
    };
    train.filter_map(silhouette).collect()
}

/// The pixels around the outlines of all training masks that go with the hull, shuffled.
fn silhouette_samples(hull: &SdfGrid, silhouettes: &[Silhouette], seed: u64) -> Vec<SilhouetteSample> {
    let mut samples = Vec::new();
    for silhouette in silhouettes {
        let camera = &silhouette.camera;
        let pixel_size = pixel_size(camera);
        let believed = believed_pixels(hull, silhouette);
        let near =
            (0..believed.len()).filter(|&i| believed[i] && silhouette.distance[i].abs() < SILHOUETTE_REACH);
        samples.extend(near.map(|i| {
            let pixel = PixelOf { view: silhouette.view, pixel: i as u32 };
            let (outline, outline_slope) = (silhouette.distance[i], silhouette.slope(i));
            let (ray, coverage) = (camera.pixel_ray(pixel.pixel), silhouette.coverage[i]);
            SilhouetteSample { pixel, ray, outline, outline_slope, coverage, pixel_size }
        }));
    }
    samples.shuffle(&mut SmallRng::seed_from_u64(seed));
    samples
}

/// Albedo for a new lattice: that of the old one where it reaches, else grey.
fn carried_albedo(volume: &TexelVolume, old: Option<&(TexelVolume, Vec<Vec3>)>) -> Vec<Vec3> {
    let grey = Vec3::splat(0.4);
    let carried = |at: Vec3| {
        let (old, albedo) = old?;
        Some(old.nearest_address(at)?.blend(albedo))
    };
    volume.positions().map(|at| carried(at).unwrap_or(grey)).collect()
}

/// Puts texels of this albedo in place of those in the world.
pub fn replace_texels(world: &mut World, albedo: &[Vec3]) {
    let old: Vec<Entity> =
        world.query_filtered::<Entity, (With<DiffuseAlbedo>, Without<PixelOf>)>().iter(world).collect();
    for texel in old {
        world.despawn(texel);
    }
    let blend = SpecularBlend::even(world.query::<&SpecularLobe>().iter(world).len().max(1));
    let texels: Vec<_> = albedo
        .iter()
        .map(|albedo| {
            let state = (AlbedoGradient::default(), AlbedoMoments::default(), TexelSeen::default());
            (DiffuseAlbedo(*albedo), blend, state.0, state.1, state.2)
        })
        .collect();
    world.spawn_batch(texels);
}

/// Puts a field and its bricks into the world.
fn enter(world: &mut World, surface: SdfSurface, schedule: ShapeSchedule) {
    let blank = [0.0; crate::shape::field::BRICK_LEN];
    let bricks: Vec<_> = bricks_near_surface(&surface.grid)
        .into_iter()
        .map(|at| (at, BrickValues::of(&surface.grid, at), BrickGradient(blank), BrickMoments(blank)))
        .collect();
    world.spawn_batch(bricks);
    world.insert_resource(Scenery(Arc::new(surface.clone())));
    world.insert_resource(SdfField::new(surface));
    world.insert_resource(schedule);
}

/// Takes the bricks out again and returns the field.
fn leave(world: &mut World) -> SdfGrid {
    despawn_with::<BrickAt>(world);
    let field = world.remove_resource::<SdfField>().expect("a level leaves the field it entered");
    field.surface.grid
}

fn despawn_with<T: Component>(world: &mut World) {
    let entities: Vec<Entity> = world.query_filtered::<Entity, With<T>>().iter(world).collect();
    for entity in entities {
        world.despawn(entity);
    }
}

#[cfg(test)]
mod tests;
