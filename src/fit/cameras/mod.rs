//! Cameras as unknowns: the pose of each training view and one factor on all focal lengths, optimized together with the rest of a fit.
//!
//! | system | stage, slot | reads | writes |
//! | --- | --- | --- | --- |
//! | [`take_gradients`] | Sample | observed pixels | [`ImageGradient`] |
//! | [`retrace_still_surface`] | Trace, `Slot::Retrace` | rays, `Scenery` | surface points; a moving surface has its own system |
//! | [`align_photographs`] | Gradient, `Slot::CameraGradient` | points, radiance, gradients | [`CameraPose`]: normal equations |
//! | [`move_cameras`] | Update, `Slot::CameraUpdate` | normal equations | [`CameraPose`], cameras |
//!
//! The rays of a step are cast through the cameras as they are then ([`crate::fit::observe::take_observations`]).
//!
//! The kernels and their references are in [`crate::fit::cameras::align`].
pub mod align;

use crate::fit::cameras::align::{
    AlignedObject, AlignedView, JACOBIAN_COLUMNS, POSE, Pose, PoseSums, Prior, moved, projection_jacobian,
    solve,
};
use crate::fit::components::StepRates;
use crate::fit::exposure::Exposures;
use crate::fit::guard::{StepGuard, is_usable};
use crate::fit::observe::{GradientsNeeded, take_gradients};
use crate::math::ray::Intersect;
use crate::math::shading::Layers;
use crate::pipeline::{Phase, Pipeline, Plugin, Slot, Stage, SystemResult};
use crate::sample::Samples;
use crate::sample::pixel::{ImageGradient, Observed, PixelOf, ViewRay};
use crate::sample::point::{Scenery, SurfacePoint};
use crate::view::{ByView, Camera, Photograph, ViewIndex, ViewName};
use bevy_ecs::prelude::{Component, Entity, Mut, Query, Res, ResMut, Resource, With, World};
use glam::{Vec2, Vec3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Steps between two moves of the cameras; their normal equations are summed over these.
const MOVE_EVERY: u32 = 25;
/// Steps before the first sums: light and material are fitted first.
pub(crate) const FIRST_STEP: u32 = 50;
/// Longest move, in pixels of the image.
const LONGEST_MOVE: f64 = 1.0;
/// Weight of the given camera, as a number of residuals of typical size per pixel.
const PRIOR: f64 = 20.0;
/// Decay factor of the running mean of the noise, per window.
const MEMORY: f32 = 0.95;

/// The given camera of a view, and its correction.
#[derive(Component, Clone, Copy, Debug, Serialize, Deserialize)]
pub struct CameraPose {
    /// The camera that was given.
    pub given: Camera,
    /// The correction to it.
    pub pose: Pose,
    sums: PoseSums,
    /// Sum of the depths of the points in `sums`, and their number.
    depth: (f64, u32),
}

impl CameraPose {
    fn new(given: Camera) -> Self {
        Self { given, pose: [0.0; POSE], sums: PoseSums::default(), depth: (0.0, 0) }
    }

    /// Adds one residual at a point.
    pub fn add(&mut self, row: &AlignedRow, noise: f32) {
        let weight = 1.0 / (noise * row.residual.abs().max(noise));
        self.sums.add(&row.jacobian, row.residual, weight);
        self.depth = (self.depth.0 + f64::from(row.depth), self.depth.1 + 1);
    }

    /// Motion of the image in pixels per radian, and per world unit at the object.
    fn pixels(&self) -> (f64, f64) {
        let focal = f64::from(0.5 * (self.given.focal[0] + self.given.focal[1]));
        let depth = if self.depth.1 == 0 { 1.0 } else { self.depth.0 / f64::from(self.depth.1) };
        (focal, focal / depth)
    }

    fn prior(&self) -> Prior {
        let (turn, shift) = self.pixels();
        let radius = 0.25 * f64::from(self.given.width.min(self.given.height));
        Prior {
            rotation: PRIOR * turn * turn,
            translation: PRIOR * shift * shift,
            focal: PRIOR * radius * radius,
        }
    }

    /// Moves by `step`, scaled down if it is longer than [`LONGEST_MOVE`].
    fn advance(&mut self, step: &Pose) {
        let (turn, shift) = self.pixels();
        let reach = |i: usize| step[i].abs() * if i < 3 { turn } else { shift };
        let part = (LONGEST_MOVE / (0..POSE).map(reach).fold(0.0, f64::max)).min(1.0);
        self.pose.iter_mut().zip(step).for_each(|(pose, step)| *pose += part * step);
    }
}

/// The camera parameters that a fit optimizes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[non_exhaustive]
pub enum CameraUnknowns {
    /// None: the cameras are as given.
    #[default]
    Given,
    /// Each training view's rotation and translation.
    Poses,
    /// Those, and one factor on all focal lengths, which also applies to held-out views. From a distance it is hard to distinguish
    /// from the size of the object.
    PosesAndFocal,
}

/// A residual of a view with its derivatives with respect to the camera.
#[derive(Clone, Copy, Debug)]
pub struct AlignedRow {
    /// By the pose (rotation vector; right, down, forward), the log focal length, and the log size of the object.
    pub jacobian: [f32; JACOBIAN_COLUMNS],
    /// In radiance, or in pixels for a silhouette.
    pub residual: f32,
    /// The point's distance from the camera, world units.
    pub depth: f32,
}

impl AlignedRow {
    /// A residual `value(π(point))` − `value` where `gradient` is the gradient of `value` in the image, per pixel.
    pub fn new(camera: &Camera, point: Vec3, center: Vec3, gradient: Vec2, residual: f32) -> Option<Self> {
        let [by_x, by_y] = projection_jacobian(camera, point, center)?;
        let jacobian = std::array::from_fn(|k| gradient.x * by_x[k] + gradient.y * by_y[k]);
        Some(Self { jacobian, residual, depth: point.distance(camera.position()) })
    }
}

/// The state that all views share.
#[derive(Resource, Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct CameraFit {
    /// Logarithm of the factor on all focal lengths.
    pub log_focal: f64,
    /// Typical size of the residuals of photographs, in radiance, and of silhouettes, in pixels.
    pub noise: [f32; 2],
    /// Approximate center of the object, world space; computed with the first residuals.
    pub center: Option<Vec3>,
    /// The parameters that are optimized.
    pub unknowns: CameraUnknowns,
    /// Whether the object moves as well, so that only relative corrections between cameras are used.
    pub object_moves: bool,
}

impl CameraFit {
    /// Factor on all focal lengths.
    pub fn focal_factor(&self) -> f32 {
        self.log_focal.exp() as f32
    }

    /// Adds residuals of a kind (0: photographs, 1: silhouettes); returns their typical size so far.
    pub fn observe(&mut self, kind: usize, rows: &[(ViewIndex, AlignedRow)]) -> f32 {
        let sum: f64 = rows.iter().map(|(_, row)| f64::from(row.residual.abs())).sum();
        let mean = ((sum / rows.len().max(1) as f64) as f32).max(1e-6);
        let noise = &mut self.noise[kind];
        *noise = if *noise == 0.0 { mean } else { MEMORY * *noise + (1.0 - MEMORY) * mean };
        *noise
    }
}

/// The systems that align cameras with the photographs, for fixed and moving surfaces.
pub struct CameraPlugin(pub CameraUnknowns);

impl Plugin for CameraPlugin {
    fn build(&self, pipeline: &mut Pipeline) {
        attach_poses(&mut pipeline.world);
        pipeline.world.insert_resource(GradientsNeeded);
        let mut fit = pipeline.world.resource_mut::<CameraFit>();
        (fit.unknowns, fit.object_moves) = (self.0, false);
        pipeline
            .add_systems(Phase::FitStep, Stage::Sample, take_gradients)
            .swap(Phase::FitStep, Slot::Retrace, retrace_still_surface)
            .swap(Phase::FitStep, Slot::CameraGradient, align_photographs)
            .swap(Phase::FitStep, Slot::CameraUpdate, move_cameras);
    }

    fn cleanup(world: &mut World) {
        world.remove_resource::<GradientsNeeded>();
    }
}

/// Gives every view its pose state, without residuals, and the world the state that views share.
pub(crate) fn attach_poses(world: &mut World) {
    world.init_resource::<CameraFit>();
    let mut query = world.query_filtered::<(Entity, &Camera, Option<&CameraPose>), With<ViewName>>();
    let attach = |(view, camera, pose): (Entity, &Camera, Option<&CameraPose>)| {
        let kept = pose.map_or(CameraPose::new(*camera), |pose| CameraPose {
            pose: pose.pose,
            ..CameraPose::new(pose.given)
        });
        (view, kept)
    };
    let poses: Vec<(Entity, CameraPose)> = query.iter(world).map(attach).collect();
    for (view, pose) in poses {
        world.entity_mut(view).insert(pose);
    }
}

/// Trace: intersects the rays of the window with a surface that does not move.
pub fn retrace_still_surface(
    scenery: Res<Scenery>,
    samples: Samples<(&ViewRay, &mut SurfacePoint)>,
) -> SystemResult {
    retrace(scenery.0.as_ref(), samples)
}

/// Intersects the rays of the window with the front of `surface`.
///
/// # Errors
/// If the pool of samples is incomplete.
pub(crate) fn retrace(
    surface: &dyn Intersect,
    samples: Samples<(&ViewRay, &mut SurfacePoint)>,
) -> SystemResult {
    let (rays, mut points) = samples.columns()?;
    points.par_iter_mut().zip(&*rays).with_min_len(256).for_each(|(point, ray)| {
        let hit = surface.intersect(&ray.0, 0.0);
        *point = hit.filter(|hit| hit.normal.dot(ray.0.direction) < 0.0).into();
    });
    Ok(())
}

/// The columns of the samples that are compared with photographs.
type AlignColumns =
    (&'static PixelOf, &'static SurfacePoint, &'static Layers, &'static Observed, &'static ImageGradient);

/// Gradient: adds the residuals of the window to the normal equations of the cameras.
pub fn align_photographs(
    rates: Res<StepRates>,
    exposures: Res<Exposures>,
    mut fit: ResMut<CameraFit>,
    mut guard: ResMut<StepGuard>,
    mut views: Query<(&ViewIndex, &Camera, &mut CameraPose), With<Photograph>>,
    samples: Samples<AlignColumns>,
) -> SystemResult {
    if rates.step < FIRST_STEP {
        return Ok(());
    }
    let (pixels, points, shaded, observed, gradients) = samples.columns()?;
    let mut views: ByView<_> = views.iter_mut().map(|view| (*view.0, view)).collect();
    let center = fit.center.unwrap_or_else(|| middle(&points));
    let row = |i: usize| {
        let (_, camera, _) = views.of(pixels[i].view).ok()?;
        let gradient = gradients[i].0?;
        let usable = points[i].is_hit() && !observed[i].saturated;
        let predicted = mean_exposed(exposures.factor(pixels[i].view), &shaded[i]);
        let residual = observed[i].radiance.element_sum() / 3.0 - predicted;
        let row = AlignedRow::new(camera, points[i].position, center, gradient, residual).filter(|_| usable);
        row.map(|row| (pixels[i].view, row))
    };
    let rows: Vec<(ViewIndex, AlignedRow)> =
        (0..points.len()).into_par_iter().with_min_len(256).filter_map(row).collect();
    if !are_usable(&rows, &mut guard) {
        return Ok(());
    }
    fit.center = Some(center);
    let noise = fit.observe(0, &rows);
    for (view, row) in &rows {
        views.of_mut(*view)?.2.add(row, noise);
    }
    Ok(())
}

/// Whether residuals and their derivatives are finite; else tells the guard, and none of them may be added.
pub(crate) fn are_usable(rows: &[(ViewIndex, AlignedRow)], guard: &mut StepGuard) -> bool {
    let is_bad = |row: &AlignedRow| !is_usable(&row.jacobian) || !is_usable(&[row.residual, row.depth]);
    let bad = rows.iter().find(|(_, row)| is_bad(row));
    if let Some((view, _)) = bad {
        guard.find("the gradient", None, format!("the camera of view number {}", view.0));
    }
    bad.is_none()
}

/// Mean of the hit points.
fn middle(points: &[SurfacePoint]) -> Vec3 {
    let met = points.iter().filter(|point| point.is_hit());
    let (sum, count) = met.fold((Vec3::ZERO, 0.0f32), |(sum, count), p| (sum + p.position, count + 1.0));
    sum / count.max(1.0)
}

/// Mean over the channels of the radiance of a photograph with these factors of exposure.
fn mean_exposed(factors: Vec3, layers: &Layers) -> f32 {
    factors.dot(Vec3::from(layers.diffuse) + Vec3::from(layers.specular)) / 3.0
}

/// Update: every `MOVE_EVERY` steps, one Gauss–Newton step of all cameras; resets the sums.
pub fn move_cameras(
    rates: Res<StepRates>,
    mut fit: ResMut<CameraFit>,
    mut views: Query<(&mut Camera, &mut CameraPose)>,
) {
    if rates.step < FIRST_STEP + MOVE_EVERY || !rates.step.is_multiple_of(MOVE_EVERY) {
        return;
    }
    let mut views: Vec<_> = views.iter_mut().collect();
    let aligned = |(camera, pose): &(Mut<Camera>, Mut<CameraPose>)| AlignedView {
        sums: pose.sums,
        pose: pose.pose,
        prior: pose.prior(),
        camera: **camera,
    };
    let mut aligned: Vec<AlignedView> = views.iter().map(aligned).collect();
    // There is one focal length for all views.
    let share = if fit.unknowns == CameraUnknowns::PosesAndFocal { 1.0 / aligned.len() as f64 } else { 1e30 };
    aligned.iter_mut().for_each(|view| view.prior.focal *= share);
    // If it is not optimized, it keeps its value from an earlier pass.
    let from = if fit.unknowns == CameraUnknowns::PosesAndFocal { fit.log_focal } else { 0.0 };
    let object = AlignedObject { center: fit.center.unwrap_or_default(), known: !fit.object_moves };
    let (mut steps, mut by_focal) = solve(&aligned, object, from);
    if !(by_focal.is_finite() && steps.iter().flatten().all(|step| step.is_finite())) {
        // Cameras stay where they are, and their sums start again.
        steps.fill([0.0; POSE]);
        by_focal = 0.0;
    }
    fit.log_focal += by_focal.clamp(-0.01, 0.01);
    for ((camera, pose), step) in views.iter_mut().zip(&steps) {
        pose.advance(step);
        **camera = moved(&pose.given, &pose.pose, fit.log_focal);
        (pose.sums, pose.depth) = (PoseSums::default(), (0.0, 0));
    }
}
