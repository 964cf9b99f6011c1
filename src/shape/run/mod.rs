//! Fit of a shape: starts from the visual hull and runs one fit per level, on finer and finer grids.
//!
//! | file | holds |
//! | --- | --- |
//! | `refine` | what brings the surface that was found closer to the photographs |
//! | `training` | the training photographs and masks as slices |

pub(crate) mod refine;
pub(crate) mod training;

use crate::checkpoint::{has_level_ahead, keep_level, resume_level};
use crate::error::stop::{check_interrupted, is_stopping};
use crate::error::{Error, Result};
use crate::fit::cameras::{CameraFit, CameraPlugin, CameraUnknowns, align_photographs, attach_poses};
use crate::fit::components::{AlbedoGradient, AlbedoMoments, TexelSeen};
use crate::fit::exposure::Exposures;
use crate::fit::light_turns;
use crate::fit::run::{FitOptions, FitProgress, Initialize, run_fit};
use crate::material::sheen::KnownAlong;
use crate::material::{DiffuseAlbedo, DiffuseSheen, DiffuseTilt, USUAL_ALBEDO};
use crate::material::{
    MAX_SPECULAR_LOBES, SpecularBlend, TexelIndex, recovered_albedo, recovered_materials, spawn_texels,
};
use crate::mesh::triangles::Mesh;
use crate::pipeline::pool::despawn_rows;
use crate::pipeline::{Phase, Pipeline, Plugin, Slot};
use crate::profile::stage;
use crate::ranks::Ranks;
use crate::sample::pixel::PixelOf;
use crate::sample::point::Scenery;
use crate::sdf::SdfGrid;
use crate::sdf::volume::{SdfSurface, TexelVolume};
use crate::shape::field::{
    BRICK_LEN, BrickAt, BrickGradient, BrickIndex, BrickMoments, BrickValues, ModelError, SdfField,
    bricks_near_surface, keep_field,
};
use crate::shape::hollows::{HULL_SHARE, LEVEL_SHARE, carve_hollows, keep_empty, look_through};
use crate::shape::hull::{FORGIVEN, visual_hull};
use crate::shape::hull_repair::{regrow, reliable_pixels};
use crate::shape::parts::extract_parts;
use crate::shape::run::training::{training_silhouettes, with_training_views};
use crate::shape::silhouette::{Silhouette, pixel_size};
use crate::shape::silhouette_loss::{SilhouetteIndex, SilhouetteSample};
use crate::shape::systems::{
    ShapeSchedule, align_silhouettes, check_bricks, hand_out_to_bricks, move_bricks, pull_back_silhouettes,
    pull_back_to_field, recast_silhouettes, retrace_window, sum_model_error,
};
use crate::shape::unseen::span_unseen;
use crate::view::{ByView, Camera, Photograph, ViewIndex};
use bevy_ecs::prelude::{Component, Entity, IntoScheduleConfigs, With, World};
use glam::Vec3;
use rand::seq::SliceRandom;
use rand::{SeedableRng, rngs::SmallRng};
use rayon::prelude::*;
use std::ops::ControlFlow;
use std::sync::Arc;

/// Distance from a silhouette, in pixels, within which silhouette rays are cast.
const SILHOUETTE_REACH: f32 = 6.0;
/// Distance from the surface within which there are texels, relative to the half side of the grid.
const TEXEL_REACH: f32 = 0.15;

/// One level of a shape's fit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ShapeLevel {
    /// Cells per side of the grid.
    pub cells: u32,
    /// Cells per side of the lattice of texels.
    pub texel_cells: u32,
    /// Width of a cell in a typical photograph, in pixels, below which the fit ends with the level before; the first is always fitted.
    pub least_pixels: f32,
    /// Schedule of the optimization.
    pub schedule: ShapeSchedule,
}

/// Settings of a shape's fit.
#[derive(Clone, Debug, PartialEq)]
pub struct ShapeOptions {
    /// From coarse to fine; at least one.
    pub levels: Vec<ShapeLevel>,
    /// Settings of the simultaneous fit of light and material; its steps are those of the level.
    pub fit: FitOptions,
    /// The camera parameters that are optimized as well.
    pub cameras: CameraUnknowns,
    /// Whether what photographs look through is removed from the hull first ([`hollows`](crate::shape::hollows)).
    pub hollows: bool,
    /// Whether what no photograph sees of the hull is spanned like a film of soap (`unseen`).
    pub spans_unseen: bool,
}

/// The systems that fit a shape; removing the plugin removes them.
pub struct ShapePlugin;

impl Plugin for ShapePlugin {
    fn build(&self, pipeline: &mut Pipeline) {
        keep_field(&mut pipeline.world);
        pipeline
            .swap(Phase::FitStep, Slot::Retrace, retrace_window)
            .swap(
                Phase::FitStep,
                Slot::ShapeGradient,
                (
                    sum_model_error,
                    pull_back_to_field,
                    pull_back_silhouettes,
                    hand_out_to_bricks,
                    check_bricks,
                )
                    .chain(),
            )
            .swap(Phase::FitStep, Slot::ShapeUpdate, move_bricks);
    }
}

/// The systems that align cameras with photographs and masks, during the fit of a shape.
struct ShapeCameraPlugin(CameraUnknowns);

impl Plugin for ShapeCameraPlugin {
    fn build(&self, pipeline: &mut Pipeline) {
        pipeline
            .add_plugin(&CameraPlugin(self.0))
            .swap(Phase::FitStep, Slot::Recast, recast_silhouettes)
            .swap(Phase::FitStep, Slot::Retrace, retrace_window)
            .swap(Phase::FitStep, Slot::CameraGradient, (align_photographs, align_silhouettes).chain());
        pipeline.world.resource_mut::<CameraFit>().object_moves = true;
    }
}

/// What was removed from the visual hull before the fit, and from what the first level has found, as shares of the volume.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct HullReport {
    /// What photographs look through.
    pub opened: f32,
    /// What lies outside of what spans the unseen, of what is left then.
    pub spanned: f32,
    /// What photographs look through of what the first level has found; 0 before the second.
    pub opened_again: f32,
}

/// What the first level starts from.
struct Hull {
    grid: SdfGrid,
    report: HullReport,
    /// As in [`SdfSurface`].
    empty: Option<SdfGrid>,
}

/// The state of a running fit, for the caller.
pub struct ShapeProgress<'a> {
    /// What was removed from the hull; nothing in a run that is resumed after that.
    pub hull: HullReport,
    /// Index of the level.
    pub level: usize,
    /// Levels that will be fitted: those that the photographs resolve.
    pub levels: usize,
    /// The fit of that level.
    pub fit: &'a FitProgress,
}

/// Fits shape, light and material. `watch` is called after every step, with the current [`SdfField`] in the
/// world. The texels of the finest lattice stay in the world, with the [`ModelError`] of the last level.
///
/// # Errors
/// If the masks have no hull, or a fit fails.
pub fn fit_shape(
    pipeline: &mut Pipeline,
    options: &ShapeOptions,
    watch: &mut dyn FnMut(&ShapeProgress, &mut World) -> ControlFlow<()>,
) -> Result<SdfSurface> {
    let carving = stage("hull");
    let mut silhouettes = training_silhouettes(&mut pipeline.world);
    check_interrupted()?;
    let ranks = pipeline.world.get_resource::<Ranks>();
    let mut grid = visual_hull(&mut silhouettes, options.levels[0].cells, ranks)?;
    // More than the longest level visits are of no use.
    let visited = |level: &ShapeLevel| level.schedule.steps as usize * level.schedule.silhouette_batch;
    let most = options.levels.iter().map(visited).max().unwrap_or(0);
    let samples = silhouette_samples(&grid, &silhouettes, options.fit.pixels.seed, most);
    drop(carving);
    let (report, empty) = reduce_hull(&mut pipeline.world, &mut grid, &silhouettes, options)?;
    check_interrupted()?;
    pipeline.world.spawn_batch(samples);
    pipeline.add_plugin(&ShapePlugin);
    if options.cameras != CameraUnknowns::Given {
        pipeline.add_plugin(&ShapeCameraPlugin(options.cameras));
    }
    let found = fit_levels(pipeline, Hull { grid, report, empty }, &mut silhouettes, options, watch);
    pipeline.remove_plugin::<ShapeCameraPlugin>().remove_plugin::<ShapePlugin>();
    despawn_with::<SilhouetteSample>(&mut pipeline.world);
    found
}

/// Fits one level after the other, until `watch` stops it.
fn fit_levels(
    pipeline: &mut Pipeline,
    hull: Hull,
    silhouettes: &mut [Silhouette],
    options: &ShapeOptions,
    watch: &mut dyn FnMut(&ShapeProgress, &mut World) -> ControlFlow<()>,
) -> Result<SdfSurface> {
    let levels = resolved_levels(&hull.grid, &options.levels, silhouettes);
    let mut report = hull.report;
    let (begun, mut surface) = begin_levels(&mut pipeline.world, hull, options)?;
    for index in begun..levels {
        let _level = stage(format_args!("level {}", index + 1));
        if index > begun {
            let (next, opened) = next_surface(&mut pipeline.world, surface, silhouettes, options, index)?;
            (surface, report.opened_again) = (next, report.opened_again + opened);
            keep_level(&mut pipeline.world, index as u32 + 1, &surface)?;
        }
        let fitted = fit_level(pipeline, surface, options, index, &mut |progress, world| {
            watch(&ShapeProgress { hull: report, level: index, levels, fit: progress }, world)
        })?;
        match fitted {
            ControlFlow::Continue(found) => surface = found,
            ControlFlow::Break(found) => return Ok(found),
        }
    }
    if begun < levels {
        keep_level(&mut pipeline.world, levels as u32 + 1, &surface)?;
    }
    Ok(surface)
}

/// The level that a fit begins with, and what it starts from: the first and the hull, or what a run that is resumed has kept. For
/// checkpoints the hull counts as the first level.
fn begin_levels(world: &mut World, hull: Hull, options: &ShapeOptions) -> Result<(usize, SdfSurface)> {
    let blank = |world: &mut World, kept: &SdfSurface| {
        replace_texels(world, &vec![Vec3::ZERO; kept.volume.len()]);
        Ok(())
    };
    if let Some((done, kept)) = resume_level(world, blank)? {
        return Ok((done as usize - 1, kept));
    }
    let first = SdfSurface { empty: hull.empty, ..first_surface(world, hull.grid, options) };
    keep_level(world, 1, &first)?;
    Ok((0, first))
}

/// Fits level `index`, which starts from `surface`. Returns the surface that was found; as `Break` if the fit ends with it.
fn fit_level(
    pipeline: &mut Pipeline,
    surface: SdfSurface,
    options: &ShapeOptions,
    index: usize,
    watch: &mut dyn FnMut(&FitProgress, &mut World) -> ControlFlow<()>,
) -> Result<ControlFlow<SdfSurface, SdfSurface>> {
    let schedule = options.levels[index].schedule;
    let (volume, empty) = (surface.volume.clone(), surface.empty.clone());
    enter(&mut pipeline.world, surface, schedule);
    let initialize = if index == 0 { options.fit.initialize } else { Initialize::NONE };
    let fit = FitOptions { steps: schedule.steps, initialize, ..options.fit.clone() };
    let result = run_fit(pipeline, &fit, watch);
    let found = SdfSurface { grid: leave(&mut pipeline.world), volume, empty };
    match result {
        // What earlier levels found is there.
        Err(Error::Interrupted) if index > 0 => Ok(ControlFlow::Break(found)),
        Err(error) => Err(error),
        Ok(summary) if summary.stopped => Ok(ControlFlow::Break(found)),
        Ok(_) => Ok(ControlFlow::Continue(found)),
    }
}

/// How many levels are fitted: those up to the first whose cells the photographs do not resolve; at least one.
fn resolved_levels(hull: &SdfGrid, levels: &[ShapeLevel], silhouettes: &[Silhouette]) -> usize {
    let too_fine =
        |level: &ShapeLevel| typical_cell_pixels(hull, level.cells, silhouettes) < level.least_pixels;
    levels.iter().skip(1).position(too_fine).map_or(levels.len(), |place| place + 1)
}

/// Width in pixels of a cell in the median photograph, if the grid had `cells` cells a side.
fn typical_cell_pixels(grid: &SdfGrid, cells: u32, silhouettes: &[Silhouette]) -> f32 {
    let finer = (grid.side - 1) as f32 / cells as f32;
    let mut widths: Vec<f32> = silhouettes.iter().map(|view| finer * view.cell_pixels(grid)).collect();
    widths.sort_by(f32::total_cmp);
    widths.get(widths.len() / 2).copied().unwrap_or(0.0)
}

/// What the first level starts from: the hull, with gray texels.
fn first_surface(world: &mut World, mut hull: SdfGrid, options: &ShapeOptions) -> SdfSurface {
    if options.cameras != CameraUnknowns::Given {
        attach_poses(world);
    }
    hull.redistance();
    with_texels(world, hull, &options.levels[0], None)
}

/// What level `index` starts from: the surface that the level before has found, on its own grid and with its own texels. Hollows that
/// the hull's grid is too coarse for are looked for on the grid of the second level, unless the object mirrors or the light turns; their
/// share is returned.
fn next_surface(
    world: &mut World,
    found: SdfSurface,
    silhouettes: &mut [Silhouette],
    options: &ShapeOptions,
    index: usize,
) -> Result<(SdfSurface, f32)> {
    if options.cameras != CameraUnknowns::Given {
        attach_poses(world);
    }
    let cameras = photographed_cameras(world);
    for silhouette in silhouettes.iter_mut() {
        silhouette.camera = *cameras.of(silhouette.view)?;
    }
    let level = &options.levels[index];
    let mut grid = found.grid.resampled(level.cells);
    regrow(&mut grid, silhouettes, FORGIVEN);
    if let Some(empty) = &found.empty {
        keep_empty(&mut grid, empty);
    }
    grid.redistance();
    let mut opened = 0.0;
    let are_alike = !world.get_resource::<Exposures>().is_some_and(Exposures::are_unknown);
    if options.hollows && are_alike && index == 1 && !is_mirror_like(world) && !light_turns(world) {
        let _opening = stage("hollows");
        opened =
            with_training_views(world, |views| carve_hollows(&mut grid, silhouettes, views, LEVEL_SHARE))?;
    }
    let albedo = recovered_albedo(world)?;
    let next = with_texels(world, grid, level, Some((&found.volume, &albedo)));
    Ok((SdfSurface { empty: found.empty, ..next }, opened))
}

/// Whether a material mirrors: photographs disagree on its surface as if they looked through it.
fn is_mirror_like(world: &mut World) -> bool {
    recovered_materials(world).iter().any(|(_, lobe)| lobe.is_mirror_like())
}

/// The surface of a level, whose texels replace those in the world.
fn with_texels(
    world: &mut World,
    grid: SdfGrid,
    level: &ShapeLevel,
    old: Option<(&TexelVolume, &[Vec3])>,
) -> SdfSurface {
    let volume = TexelVolume::new(&grid, level.texel_cells, TEXEL_REACH * half_side(&grid));
    replace_by_fitted_texels(world, &carried_albedo(&volume, old));
    SdfSurface { grid, volume, empty: None }
}

/// The mesh of a field: its largest component, and others that the training masks show ([`parts`](crate::shape::parts)).
pub(crate) fn mesh_of_parts(world: &mut World, grid: &SdfGrid) -> Mesh {
    extract_parts(grid, &training_silhouettes(world))
}

/// Removes from the hull what the training photographs look through, if the light stands still, and spans what none of them sees. A run that is resumed later
/// needs neither.
fn reduce_hull(
    world: &mut World,
    hull: &mut SdfGrid,
    silhouettes: &[Silhouette],
    options: &ShapeOptions,
) -> Result<(HullReport, Option<SdfGrid>)> {
    let (mut report, mut empty) = (HullReport::default(), None);
    if has_level_ahead(world) {
        return Ok((report, empty));
    }
    if options.hollows && !light_turns(world) {
        let _opening = stage("hollows");
        (report.opened, empty) = with_training_views(world, |views| -> Result<_> {
            let (seen_through, empty) = look_through(hull, silhouettes, views)?;
            let compared = carve_hollows(hull, silhouettes, views, HULL_SHARE)?;
            Ok((1.0 - (1.0 - seen_through) * (1.0 - compared), empty))
        })?;
    }
    if options.spans_unseen {
        let _spanning = stage("unseen");
        report.spanned = span_unseen(hull, silhouettes);
    }
    Ok((report, empty))
}

fn half_side(grid: &SdfGrid) -> f32 {
    0.5 * grid.spacing * (grid.side - 1) as f32
}

/// The cameras of all photographs.
fn photographed_cameras(world: &mut World) -> ByView<Camera> {
    let mut views = world.query_filtered::<(&ViewIndex, &Camera), With<Photograph>>();
    views.iter(world).map(|(index, camera)| (*index, *camera)).collect()
}

/// The pixels around the silhouettes of all training masks that are consistent with the hull, shuffled; at most `most`.
fn silhouette_samples(
    hull: &SdfGrid,
    silhouettes: &[Silhouette],
    seed: u64,
    most: usize,
) -> Vec<(SilhouetteIndex, SilhouetteSample)> {
    // Silhouette and pixel: a sample is ten times as large.
    let near_one = |(number, silhouette): (u32, &Silhouette)| {
        let reliable = reliable_pixels(hull, silhouette);
        let is_near = |&i: &usize| reliable[i] && silhouette.distance(i).abs() < SILHOUETTE_REACH;
        (0..reliable.len()).filter(is_near).map(|i| (number, i as u32)).collect::<Vec<_>>()
    };
    let views = (0..silhouettes.len() as u32).into_par_iter().zip(silhouettes);
    let mut near: Vec<(u32, u32)> = views.filter(|_| !is_stopping()).flat_map_iter(near_one).collect();
    near.shuffle(&mut SmallRng::seed_from_u64(seed));
    near.truncate(most);
    let sample = |(number, pixel): (u32, u32)| silhouette_sample(&silhouettes[number as usize], pixel);
    (0..).map(SilhouetteIndex).zip(near.into_iter().map(sample)).collect()
}

fn silhouette_sample(silhouette: &Silhouette, pixel: u32) -> SilhouetteSample {
    let (camera, i) = (&silhouette.camera, pixel as usize);
    SilhouetteSample {
        pixel: PixelOf { view: silhouette.view, pixel },
        ray: camera.pixel_ray(pixel),
        distance: silhouette.distance(i),
        distance_gradient: silhouette.slope(i),
        coverage: silhouette.mask.coverage(i),
        pixel_size: pixel_size(camera),
    }
}

/// Albedo for a new lattice: interpolated from the old one where it has texels, else gray.
fn carried_albedo(volume: &TexelVolume, old: Option<(&TexelVolume, &[Vec3])>) -> Vec<Vec3> {
    let gray = Vec3::splat(USUAL_ALBEDO);
    let carried = |at: Vec3| {
        let (old, albedo) = old?;
        Some(old.nearest_address(at)?.blend(albedo))
    };
    volume.positions().map(|at| carried(at).unwrap_or(gray)).collect()
}

/// Replaces the texels in the world by texels with this albedo, and no sheen but a known one.
pub(crate) fn replace_texels(world: &mut World, albedo: &[Vec3]) {
    let (blend, sheen) = new_material(world, albedo);
    let (tilt, blends) = (vec![DiffuseTilt::default(); albedo.len()], vec![blend; albedo.len()]);
    spawn_texels(world, albedo, &sheen, &tilt, &blends);
}

/// The same with what a fit attaches to texels: one table holds them, and none that they left keeps its room.
fn replace_by_fitted_texels(world: &mut World, albedo: &[Vec3]) {
    let (blend, sheen) = new_material(world, albedo);
    let texels = (0..).map(TexelIndex).zip(albedo.iter().zip(sheen));
    world.spawn_batch(texels.map(|(index, (albedo, sheen))| {
        let state = (AlbedoGradient::default(), AlbedoMoments::default(), TexelSeen::default());
        (index, DiffuseAlbedo(*albedo), sheen, blend, state)
    }));
}

/// Removes the texels; returns the blend weights of those that replace them, and their sheen.
fn new_material(world: &mut World, albedo: &[Vec3]) -> (SpecularBlend, Vec<DiffuseSheen>) {
    despawn_with::<TexelIndex>(world);
    let materials = recovered_materials(world);
    let mut blend = SpecularBlend::even(materials.len().max(1));
    if materials.iter().zip(0..).any(|((number, _), place)| *number != place) {
        blend = SpecularBlend([0.0; MAX_SPECULAR_LOBES]);
        materials.iter().for_each(|(number, _)| blend.0[*number] = 1.0 / materials.len() as f32);
    }
    let known = world.get_resource::<KnownAlong>().and_then(|known| known.sheen(albedo));
    (blend, known.unwrap_or_else(|| vec![DiffuseSheen::default(); albedo.len()]))
}

/// Inserts a field and its bricks into the world.
fn enter(world: &mut World, surface: SdfSurface, schedule: ShapeSchedule) {
    let blank = [0.0; BRICK_LEN];
    let bricks: Vec<_> = bricks_near_surface(&surface.grid)
        .into_iter()
        .zip((0..).map(BrickIndex))
        .map(|(at, index)| {
            (index, at, BrickValues::of(&surface.grid, at), BrickGradient(blank), BrickMoments(blank))
        })
        .collect();
    world.spawn_batch(bricks);
    world.insert_resource(Scenery(Arc::new(surface.clone())));
    world.insert_resource(ModelError::new(&surface.grid));
    world.insert_resource(SdfField::new(surface));
    world.insert_resource(schedule);
}

/// Removes the bricks and returns the field.
fn leave(world: &mut World) -> SdfGrid {
    despawn_with::<BrickAt>(world);
    let field = world.remove_resource::<SdfField>().expect("a level leaves the field it entered");
    field.surface.grid
}

fn despawn_with<T: Component>(world: &mut World) {
    let entities: Vec<Entity> = world.query_filtered::<Entity, With<T>>().iter(world).collect();
    despawn_rows(world, &entities);
}

#[cfg(test)]
mod tests;
