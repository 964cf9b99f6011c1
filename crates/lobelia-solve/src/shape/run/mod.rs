//! Fit of a shape: starts from the visual hull and runs one fit per level, on finer and finer
//! grids. Then the surface that was found is brought closer to the photographs: by masks, neighbors
//! and reflections.

use crate::fit::cameras::{
    CameraUnknowns, align_photographs, cameras_move, move_cameras, retrace_still_surface,
};
use crate::fit::components::{AlbedoGradient, AlbedoMoments, TexelSeen};
use crate::fit::observe::take_gradients;
use crate::fit::run::{FitOptions, FitProgress, Initialize, entities, run_fit};
use crate::shape::field::{ErrorRows, ModelError, SdfField};
use crate::shape::hollows::{HULL_SHARE, LEVEL_SHARE, carve_hollows, keep_empty, look_through};
use crate::shape::hull::{FORGIVEN, regrow, reliable_pixels, trim, visual_hull};
use crate::shape::mirror::{NormalReport, refine_normals};
use crate::shape::outline::{OutlineReport, fit_outlines};
use crate::shape::silhouette::{Silhouette, SilhouetteSample, SilhouetteSamples};
use crate::shape::stereo::{StereoReport, refine};
use crate::shape::systems::{
    ShapeSchedule, align_silhouettes, move_bricks, pull_back_silhouettes, pull_back_to_field,
    recast_silhouettes, retrace_window, smooth_gradient, sum_model_error,
};
use crate::shape::unseen::{SPANNED_CELLS, span_unseen};
use crate::shape::vertices::{MovingMesh, move_vertices, pull_back_to_vertices, retrace_vertices};
use crate::{fit::exposure::Exposures, fit::light_turns, shape::pictures::TrainingView};
use bevy_ecs::prelude::{IntoScheduleConfigs, Resource, SystemCondition, With, World, not, resource_exists};
use glam::Vec3;
use lobelia_geometry::error::stop::{check_interrupted, is_stopping};
use lobelia_geometry::sdf::volume::{SdfSurface, TexelVolume};
use lobelia_geometry::view::{ByView, Camera, Photograph, Placement, Split, ViewIndex, ViewMask, ViewName};
use lobelia_geometry::{Error, Result, mesh::triangles::Mesh, parallel, sdf::SdfGrid};
use lobelia_sg::statistics::median;
use lobelia_world::checkpoint::{
    Span, from_bytes, has_part_ahead, keep_part, keep_resource, keep_state, resume_part, to_bytes,
};
use lobelia_world::material::{
    MAX_SPECULAR_LOBES, SpecularBlend, TexelIndex, USUAL_ALBEDO, diffuse::of_albedos, recovered_albedo,
    recovered_materials, spawn_texels,
};
use lobelia_world::pipeline::{Phase, Pipeline, Plugin, Slot, Stage, pool::despawn_rows};
use lobelia_world::{light::placement::PlacedFrame, sample::point::Scenery};
use rand::{SeedableRng, rngs::SmallRng, seq::SliceRandom};
use serde::{Deserialize, Serialize};
use std::{ops::ControlFlow, sync::Arc};
use tracing::info_span;

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
    /// Width of a cell in a typical photograph, in pixels, below which the fit ends with the level
    /// before; the first is always fitted.
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
    /// Whether what photographs look through is removed from the hull first (`hollows`).
    pub hollows: bool,
    /// Whether what no photograph sees of the hull is spanned like a film of soap (`unseen`).
    pub spans_unseen: bool,
}

/// What moves the geometry during a fit: a field, the vertices of a mesh or cameras, as long as the
/// world has an [`SdfField`], a [`MovingMesh`] or [`CameraUnknowns`].
pub struct GeometryPlugin;

impl Plugin for GeometryPlugin {
    fn build(&self, pipeline: &mut Pipeline) {
        let (field, mesh) = (resource_exists::<SdfField>, resource_exists::<MovingMesh>);
        let cameras_alone = || cameras_move.and_then(not(field));
        let still = retrace_still_surface.run_if(cameras_alone().and_then(not(mesh)));
        let adjoints = (sum_model_error, pull_back_to_field, pull_back_silhouettes, smooth_gradient).chain();
        let of_field = adjoints.distributive_run_if(field);
        let silhouettes = || cameras_move.and_then(field);
        let align = (align_photographs.run_if(cameras_move), align_silhouettes.run_if(silhouettes()));
        let with_object = move_cameras::<true>.run_if(silhouettes());
        let alone = move_cameras::<false>.run_if(cameras_alone());
        let retrace = (retrace_window.run_if(field), retrace_vertices.run_if(mesh), still);
        let gradient = (of_field, pull_back_to_vertices.run_if(mesh));
        let update = (move_bricks.run_if(field), move_vertices.run_if(mesh));
        pipeline
            .add_systems(Phase::FitStep, Stage::Sample, take_gradients.run_if(cameras_move))
            .swap(Phase::FitStep, Slot::Recast, recast_silhouettes.run_if(silhouettes()))
            .swap(Phase::FitStep, Slot::Retrace, retrace)
            .swap(Phase::FitStep, Slot::ShapeGradient, gradient)
            .swap(Phase::FitStep, Slot::ShapeUpdate, update)
            .swap(Phase::FitStep, Slot::CameraGradient, align.chain())
            .swap(Phase::FitStep, Slot::CameraUpdate, (with_object, alone));
    }
}

/// Shares of the volume that were removed from the visual hull before the fit, and from the surface
/// that the first level has found.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct HullReport {
    /// Share that photographs look through.
    pub opened: f32,
    /// Share of the rest that lies outside of the film that spans the unseen.
    pub spanned: f32,
    /// Share of the first level's surface that photographs look through; 0 before the second.
    pub opened_again: f32,
}

/// The state of a running fit, for the caller.
pub struct ShapeProgress<'a> {
    /// Shares removed from the hull; nothing in a run that is resumed after that.
    pub hull: HullReport,
    /// Index of the level.
    pub level: usize,
    /// Levels that will be fitted: those that the photographs resolve.
    pub levels: usize,
    /// The fit of that level.
    pub fit: &'a FitProgress,
}

/// The training photographs with their masks, in the order of their views.
fn training_views(world: &mut World) -> Vec<TrainingView<'_>> {
    let mut query = world
        .query::<((&ViewIndex, &ViewName, &Split), (&Camera, &Photograph, &ViewMask, Option<&Placement>))>();
    let mut views = Vec::new();
    for ((index, name, split), (camera, photograph, mask, placement)) in query.iter(world) {
        if *split == Split::Train {
            let (index, placement) = (*index, placement.copied().unwrap_or_default());
            views.push(TrainingView { index, name: &name.0, camera, photograph, mask: &mask.0, placement });
        }
    }
    views.sort_by_key(|view| view.index);
    views
}

/// The silhouettes of the training masks, in the order of their views.
pub fn training_silhouettes(world: &mut World) -> Vec<Silhouette> {
    let views = training_views(world);
    let silhouette = |i: usize| if is_stopping() { None } else { views[i].silhouette() };
    parallel::flat_map(views.len(), 1, silhouette)
}

/// Fits shape, light and material. `watch` is called after every step, with the current
/// [`SdfField`] in the world. The texels of the finest lattice stay in the world, with the
/// [`ModelError`] of the last level.
///
/// # Errors
/// If the masks have no hull, or a fit fails.
pub fn fit_shape(
    pipeline: &mut Pipeline,
    options: &ShapeOptions,
    watch: &mut dyn FnMut(&ShapeProgress, &mut World) -> ControlFlow<()>,
) -> Result<SdfSurface> {
    let world = &mut pipeline.world;
    let carving = info_span!("hull").entered();
    let mut silhouettes = training_silhouettes(world);
    check_interrupted()?;
    let mut hull = visual_hull(&mut silhouettes, options.levels[0].cells)?;
    // More than the longest level visits are of no use.
    let visited = |level: &ShapeLevel| level.schedule.steps as usize * level.schedule.silhouette_batch;
    let most = options.levels.iter().map(visited).max().unwrap_or(0);
    let samples = silhouette_samples(&hull, &silhouettes, options.fit.pixels.seed, most);
    drop(carving);
    let (mut report, mut empty) = (HullReport::default(), None);
    // A run that is resumed later needs no hull.
    let needs_hull = !has_part_ahead(world);
    if needs_hull && options.hollows && !light_turns(world) {
        let _opening = info_span!("hollows").entered();
        let views = training_views(world);
        (report.opened, empty) = look_through(&mut hull, &silhouettes, &views);
        let compared = carve_hollows(&mut hull, &silhouettes, &views, HULL_SHARE);
        report.opened = 1.0 - (1.0 - report.opened) * (1.0 - compared);
    }
    if needs_hull && options.spans_unseen {
        let _spanning = info_span!("unseen").entered();
        report.spanned = span_unseen(&mut hull, &silhouettes, SPANNED_CELLS);
    }
    check_interrupted()?;
    world.insert_resource(SilhouetteSamples(samples));
    world.insert_resource(options.cameras);
    pipeline.add_plugin(&GeometryPlugin);
    let found = fit_levels(pipeline, (hull, empty), report, &mut silhouettes, options, watch);
    pipeline.world.remove_resource::<SilhouetteSamples>();
    pipeline.world.remove_resource::<CameraUnknowns>();
    found
}

/// Fits one level after the other, until `watch` stops it. The first begins with the hull, and what
/// is known to be empty.
fn fit_levels(
    pipeline: &mut Pipeline,
    hull: (SdfGrid, Option<SdfGrid>),
    mut report: HullReport,
    silhouettes: &mut [Silhouette],
    options: &ShapeOptions,
    watch: &mut dyn FnMut(&ShapeProgress, &mut World) -> ControlFlow<()>,
) -> Result<SdfSurface> {
    // Those up to the first whose cells the median photograph does not resolve; at least one.
    let too_fine = |level: &ShapeLevel| {
        let finer = (hull.0.side - 1) as f32 / level.cells as f32;
        let mut widths: Vec<f32> = silhouettes.iter().map(|view| finer * view.cell_pixels(&hull.0)).collect();
        median(&mut widths).unwrap_or(0.0) < level.least_pixels
    };
    let coarse = options.levels.iter().skip(1).position(too_fine).map(|place| place + 1);
    let levels = coarse.unwrap_or(options.levels.len());
    let (begun, mut surface) = begin_levels(&mut pipeline.world, hull, options)?;
    for index in begun..levels {
        let _level = info_span!("level", name = %format_args!("level {}", index + 1)).entered();
        let world = &mut pipeline.world;
        if index > begun {
            let (next, opened) = next_surface(world, surface, silhouettes, options, index)?;
            (surface, report.opened_again) = (next, report.opened_again + opened);
            surface = keep_level(world, index, surface, None)?;
        }
        let schedule = options.levels[index].schedule;
        let (volume, empty) = (surface.volume.clone(), surface.empty.clone());
        world.insert_resource(Scenery(Arc::new(surface.clone())));
        world.insert_resource(ModelError::new(&surface.grid));
        world.insert_resource(SdfField::new(surface));
        world.insert_resource(schedule);
        let initialize = if index == 0 { options.fit.initialize } else { Initialize::NONE };
        let fit = FitOptions { steps: schedule.steps, initialize, ..options.fit.clone() };
        let result = run_fit(pipeline, &fit, &mut |fit, world| {
            watch(&ShapeProgress { hull: report, level: index, levels, fit }, world)
        });
        let field = pipeline.world.remove_resource::<SdfField>();
        let field = field.expect("a level leaves the field it entered");
        surface = SdfSurface { grid: field.surface.grid, volume, empty };
        match result {
            // What earlier levels found is there.
            Err(Error::Interrupted) if index > 0 => return Ok(surface),
            Err(error) => return Err(error),
            Ok(summary) if summary.stopped => return Ok(surface),
            Ok(_) => {}
        }
    }
    if begun < levels {
        let error = pipeline.world.get_resource::<ModelError>().map(ModelError::rows);
        surface = keep_level(&mut pipeline.world, levels, surface, error)?;
    }
    Ok(surface)
}

/// What a level starts from, while a checkpoint is kept or taken up.
#[derive(Resource, Serialize, Deserialize)]
struct LevelStart {
    /// The level; after the last one, their number.
    index: u32,
    surface: SdfSurface,
    /// The [`ModelError`] after the last one.
    error: Option<ErrorRows>,
}

/// Keeps what level `index` starts from.
fn keep_level(
    world: &mut World,
    index: usize,
    surface: SdfSurface,
    error: Option<ErrorRows>,
) -> Result<SdfSurface> {
    world.insert_resource(LevelStart { index: index as u32, surface, error });
    let kept = keep_part(world);
    let start = world.remove_resource::<LevelStart>().expect("it was inserted above");
    kept.map(|()| start.surface)
}

/// The level that a fit begins with, and what it starts from: the first and the hull, with gray
/// texels, or what a run that is resumed has kept.
fn begin_levels(
    world: &mut World,
    (mut hull, empty): (SdfGrid, Option<SdfGrid>),
    options: &ShapeOptions,
) -> Result<(usize, SdfSurface)> {
    keep_resource::<LevelStart>(world, Span::Pass);
    if resume_part(world)?
        && let Some(LevelStart { index, surface, error }) = world.remove_resource()
    {
        if let Some(rows) = error {
            world.insert_resource(ModelError::of_rows(&surface.grid, rows));
        }
        return Ok((index as usize, surface));
    }
    hull.redistance();
    let first = with_texels(world, hull, empty, &options.levels[0], None);
    Ok((0, keep_level(world, 0, first, None)?))
}

/// Registers the number of texels as state: that of the columns which are loaded after it.
pub fn keep_texel_count(world: &mut World) {
    let count = |world: &mut World| world.query::<&TexelIndex>().iter(world).len();
    let save = move |world: &mut World| to_bytes(&count(world)).map(Some);
    let load = move |world: &mut World, bytes: &[u8]| {
        let kept = from_bytes::<usize>(bytes)?;
        if kept != count(world) {
            replace_texels(world, &vec![Vec3::ZERO; kept]);
        }
        Ok(())
    };
    keep_state(world, "texels", Span::Run, save, load);
}

/// The start of level `index`, the surface that the level before has found, on its own grid and
/// with its own texels, and the share of the hollows that it opens. Hollows that the hull's grid is
/// too coarse for are looked for on the grid of the second level, unless the object mirrors or the
/// light turns.
fn next_surface(
    world: &mut World,
    found: SdfSurface,
    silhouettes: &mut [Silhouette],
    options: &ShapeOptions,
    index: usize,
) -> Result<(SdfSurface, f32)> {
    let mut views = world.query_filtered::<(&ViewIndex, &Camera), With<Photograph>>();
    let cameras: ByView<Camera> = views.iter(world).map(|(index, camera)| (*index, *camera)).collect();
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
    // Photographs disagree on the surface of a mirror as if they looked through it.
    let mirrors = recovered_materials(world).iter().any(|(_, lobe)| lobe.is_mirror_like());
    if options.hollows && are_alike && index == 1 && !mirrors && !light_turns(world) {
        let _opening = info_span!("hollows").entered();
        opened = carve_hollows(&mut grid, silhouettes, &training_views(world), LEVEL_SHARE);
    }
    let albedo = recovered_albedo(world)?;
    Ok((with_texels(world, grid, found.empty, level, Some((&found.volume, &albedo))), opened))
}

/// The surface of a level, whose texels replace those in the world.
fn with_texels(
    world: &mut World,
    grid: SdfGrid,
    empty: Option<SdfGrid>,
    level: &ShapeLevel,
    old: Option<(&TexelVolume, &[Vec3])>,
) -> SdfSurface {
    let half_side = 0.5 * grid.spacing * (grid.side - 1) as f32;
    let volume = TexelVolume::new(&grid, level.texel_cells, TEXEL_REACH * half_side);
    // Interpolated where the old lattice has texels, else gray.
    let carried = |at: Vec3| old.and_then(|(old, albedo)| Some(old.nearest_address(at)?.blend(albedo)));
    let albedo = volume.positions().map(|at| carried(at).unwrap_or(Vec3::splat(USUAL_ALBEDO)));
    // They have the state that a fit attaches: one table holds them, and none that they left keeps
    // its room.
    let blend = remove_texels(world);
    let texels = (0..).map(TexelIndex).zip(of_albedos(world, albedo));
    world.spawn_batch(texels.map(|(index, diffuse)| {
        let state = (AlbedoGradient::default(), AlbedoMoments::default(), TexelSeen::default());
        (index, diffuse, blend, state)
    }));
    SdfSurface { grid, volume, empty }
}

/// The pixels around the silhouettes of all training masks that are consistent with the hull,
/// shuffled; at most `most`.
fn silhouette_samples(hull: &SdfGrid, views: &[Silhouette], seed: u64, most: usize) -> Vec<SilhouetteSample> {
    // Silhouette and pixel: a sample is ten times as large.
    let near_one = |number: usize| {
        if is_stopping() {
            return Vec::new();
        }
        let silhouette = &views[number];
        let reliable = reliable_pixels(hull, silhouette);
        let is_near = |&i: &usize| reliable[i] && silhouette.distance(i).abs() < SILHOUETTE_REACH;
        (0..reliable.len()).filter(is_near).map(|i| (number as u32, i as u32)).collect()
    };
    let mut near: Vec<(u32, u32)> = parallel::flat_map(views.len(), 1, near_one);
    near.shuffle(&mut SmallRng::seed_from_u64(seed));
    near.truncate(most);
    let sample = |(number, pixel): (u32, u32)| SilhouetteSample::new(&views[number as usize], pixel);
    near.into_iter().map(sample).collect()
}

/// Replaces the texels in the world by texels with this albedo, and no sheen but a known one.
pub fn replace_texels(world: &mut World, albedo: &[Vec3]) {
    let blend = remove_texels(world);
    let diffuse = of_albedos(world, albedo.iter().copied());
    spawn_texels(world, &diffuse, &vec![blend; albedo.len()]);
}

/// Removes the texels; returns the blend weights of those that replace them.
fn remove_texels(world: &mut World) -> SpecularBlend {
    let texels = entities::<With<TexelIndex>>(world);
    despawn_rows(world, &texels);
    let materials = recovered_materials(world);
    let mut blend = SpecularBlend::even(materials.len().max(1));
    if materials.iter().zip(0..).any(|((number, _), place)| *number != place) {
        blend = SpecularBlend([0.0; MAX_SPECULAR_LOBES]);
        materials.iter().for_each(|(number, _)| blend.0[*number] = 1.0 / materials.len() as f32);
    }
    blend
}

/// Removes from the found field what lies outside the hull, and moves its contours to the outlines
/// of the training masks (`outline`).
pub fn refine_by_outlines(world: &mut World, surface: &mut SdfSurface) -> OutlineReport {
    let mut silhouettes = training_silhouettes(world);
    let grid = &mut surface.grid;
    trim(grid, &mut silhouettes);
    if let Some(empty) = &surface.empty {
        keep_empty(grid, empty);
    }
    grid.redistance_near();
    fit_outlines(grid, &silhouettes)
}

/// Moves the vertices of a mesh of the found surface to where the training photographs agree
/// ([`stereo`](crate::shape::stereo)). Nothing moves without a [`ModelError`] in the world, which
/// this removes.
pub fn refine_by_stereo(
    world: &mut World,
    mesh: &mut Mesh,
    go_on: impl FnMut(usize) -> ControlFlow<()>,
) -> StereoReport {
    let Some(error) = world.remove_resource::<ModelError>() else { return StereoReport::default() };
    let silhouettes = training_silhouettes(world);
    refine(mesh, &training_views(world), &silhouettes, &error, go_on)
}

/// Gives the vertices of a mesh of the found surface normals that explain what it mirrors
/// ([`mirror`](crate::shape::mirror)).
pub fn refine_by_mirror(
    world: &mut World,
    mesh: &mut Mesh,
    go_on: impl FnMut(usize) -> ControlFlow<()>,
) -> NormalReport {
    let frame = PlacedFrame::own(world);
    refine_normals(mesh, &training_views(world), &frame, go_on)
}

#[cfg(test)]
mod tests;
