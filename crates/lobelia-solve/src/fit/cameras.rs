//! Cameras as unknowns: the pose of each training view and one factor on all focal lengths,
//! optimized together with the rest of a fit.
//!
//! The rays of a step are cast through the cameras as they are then
//! ([`crate::fit::observe::take_observations`]).
//!
//! Direct image alignment (Lucas and Kanade 1981; Engel, Koltun and Cremers 2018): a surface point
//! keeps its position and its radiance, and the photograph is sampled where the moved camera sees
//! it. So the derivative of a residual is the gradient of the photograph times the Jacobian of the
//! point's projection, for any kind of surface. Silhouettes are aligned in the same way, by the
//! distance in pixels to the silhouette of the mask.
//!
//! Each view sums its normal equations. Together they form an arrowhead matrix, solved by the Schur
//! complement; the parameters that all views share are the focal length and, for an unknown object,
//! its rotation, translation and scale as a whole. Without the latter, cameras and object could
//! drift together; that part of the solution is not used, because the object's own fit determines
//! it.

use crate::fit::guard::{StepGuard, is_usable};
use crate::fit::{components::StepRates, exposure::Exposures, loss::radiance};
use bevy_ecs::prelude::{Component, Entity, Mut, Query, Res, ResMut, Resource, With, World};
use glam::{Affine3A, Quat, Vec2, Vec3};
use lobelia_geometry::view::{ByView, Camera, Photograph, ViewIndex, ViewName};
use lobelia_geometry::{Result, parallel};
use lobelia_sg::linear::{cholesky, solve_factored};
use lobelia_sg::{ray::Intersect, shading::Layers};
use lobelia_world::sample::pixel::{ImageGradient, Observed, PixelOf, ViewRay};
use lobelia_world::sample::point::{Scenery, SurfacePoint};
use lobelia_world::{pipeline::SystemResult, sample::Samples};
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
    /// Motion of the image in pixels per radian, and per world unit at the object.
    fn pixels(&self) -> (f64, f64) {
        let focal = f64::from(0.5 * (self.given.focal[0] + self.given.focal[1]));
        let depth = if self.depth.1 == 0 { 1.0 } else { self.depth.0 / f64::from(self.depth.1) };
        (focal, focal / depth)
    }

    fn prior(&self) -> Prior {
        let (turn, shift) = self.pixels();
        let radius = 0.25 * f64::from(self.given.width.min(self.given.height));
        let [rotation, translation, focal] = [turn, shift, radius].map(|size| PRIOR * size * size);
        Prior { rotation, translation, focal }
    }
}

/// The camera parameters that a fit optimizes.
#[derive(Resource, Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum CameraUnknowns {
    /// None: the cameras are as given.
    #[default]
    Given,
    /// Each training view's rotation and translation.
    Poses,
    /// Poses, and one factor on all focal lengths, which also applies to held-out views. From a
    /// distance it is hard to distinguish from the size of the object.
    PosesAndFocal,
}

/// A residual of a view with its derivatives with respect to the camera.
#[derive(Clone, Copy, Debug)]
pub struct AlignedRow {
    /// By the pose (rotation vector; right, down, forward), the log focal length, and the log size
    /// of the object.
    pub jacobian: [f32; JACOBIAN_COLUMNS],
    /// In radiance, or in pixels for a silhouette.
    pub residual: f32,
    /// The point's distance from the camera, world units.
    pub depth: f32,
}

impl AlignedRow {
    /// A residual `value(π(point))` − `value` where `gradient` is the gradient of `value` in the
    /// image, per pixel.
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
}

impl CameraFit {
    /// Factor on all focal lengths.
    pub fn focal_factor(&self) -> f32 {
        self.log_focal.exp() as f32
    }
}

/// Whether fits optimize cameras: there is a resource that says which parameters. Also a run
/// condition.
pub fn cameras_move(world: &World) -> bool {
    world.get_resource::<CameraUnknowns>().is_some_and(|cameras| *cameras != CameraUnknowns::Given)
}

/// Gives every view its pose state, without residuals, and the world the state that views share.
pub(super) fn attach_poses(world: &mut World) {
    world.init_resource::<CameraFit>();
    let mut query = world.query_filtered::<(Entity, &Camera, Option<&CameraPose>), With<ViewName>>();
    let attach = |(view, camera, kept): (Entity, &Camera, Option<&CameraPose>)| {
        let (given, pose) = kept.map_or((*camera, [0.0; POSE]), |kept| (kept.given, kept.pose));
        (view, CameraPose { given, pose, sums: PoseSums::default(), depth: (0.0, 0) })
    };
    let poses: Vec<(Entity, CameraPose)> = query.iter(world).map(attach).collect();
    world.insert_batch(poses);
}

/// Trace: intersects the rays of the window with a surface that does not move.
pub fn retrace_still_surface(
    scenery: Res<Scenery>,
    samples: Samples<(&ViewRay, &mut SurfacePoint)>,
) -> SystemResult {
    retrace(scenery.0.as_ref(), samples)
}

/// Intersects the rays of the window with the front of a surface.
pub(crate) fn retrace(of: &dyn Intersect, samples: Samples<(&ViewRay, &mut SurfacePoint)>) -> SystemResult {
    let (rays, mut points) = samples.columns()?;
    parallel::for_each_row((&mut *points, &*rays), 256, |(point, ray)| {
        let hit = of.intersect(&ray.0, 0.0);
        *point = hit.filter(|hit| hit.normal.dot(ray.0.direction) < 0.0).into();
    });
    Ok(())
}

/// Gradient: adds the residuals of the window to the normal equations of the cameras.
pub fn align_photographs(
    rates: Res<StepRates>,
    exposures: Res<Exposures>,
    mut fit: ResMut<CameraFit>,
    mut guard: ResMut<StepGuard>,
    mut views: Query<(&ViewIndex, &Camera, &mut CameraPose), With<Photograph>>,
    samples: Samples<(&PixelOf, &SurfacePoint, &Layers, &Observed, &ImageGradient)>,
) -> SystemResult {
    if rates.step < FIRST_STEP {
        return Ok(());
    }
    let (pixels, points, shaded, observed, gradients) = samples.columns()?;
    let mut views: ByView<_> = views.iter_mut().map(|view| (*view.0, view)).collect();
    let center = fit.center.unwrap_or_else(|| {
        let met = points.iter().filter(|point| point.is_hit());
        let (sum, count) = met.fold((Vec3::ZERO, 0.0f32), |(sum, count), p| (sum + p.position, count + 1.0));
        sum / count.max(1.0)
    });
    let row = |i: usize| {
        let (_, camera, _) = views.of(pixels[i].view).ok()?;
        let gradient = gradients[i].0?;
        let usable = points[i].is_hit() && !observed[i].saturated;
        let predicted = exposures.factor(pixels[i].view).dot(radiance(&shaded[i])) / 3.0;
        let residual = observed[i].radiance.element_sum() / 3.0 - predicted;
        let row = AlignedRow::new(camera, points[i].position, center, gradient, residual).filter(|_| usable);
        row.map(|row| (pixels[i].view, row))
    };
    let rows: Vec<_> = parallel::flat_map(points.len(), 256, row);
    if add_rows(0, &rows, &mut fit, &mut guard, &mut views)? {
        fit.center = Some(center);
    }
    Ok(())
}

/// Adds residuals of a kind (0: photographs, 1: silhouettes) to the normal equations of their
/// cameras. Where one or its derivatives are not finite, it tells the guard, adds none and returns
/// false.
pub(crate) fn add_rows(
    kind: usize,
    rows: &[(ViewIndex, AlignedRow)],
    fit: &mut CameraFit,
    guard: &mut StepGuard,
    views: &mut ByView<(&ViewIndex, &Camera, Mut<CameraPose>)>,
) -> Result<bool> {
    let is_bad = |row: &AlignedRow| !is_usable(&row.jacobian) || !is_usable(&[row.residual, row.depth]);
    if let Some((view, _)) = rows.iter().find(|(_, row)| is_bad(row)) {
        guard.find("the gradient", None, format!("the camera of view number {}", view.0));
        return Ok(false);
    }
    // The typical size of the residuals of this kind so far.
    let sum: f64 = rows.iter().map(|(_, row)| f64::from(row.residual.abs())).sum();
    let mean = ((sum / rows.len().max(1) as f64) as f32).max(1e-6);
    let noise = &mut fit.noise[kind];
    *noise = if *noise == 0.0 { mean } else { MEMORY * *noise + (1.0 - MEMORY) * mean };
    for (view, row) in rows {
        let pose = &mut views.of_mut(*view)?.2;
        pose.sums.add(&row.jacobian, row.residual, 1.0 / (*noise * row.residual.abs().max(*noise)));
        pose.depth = (pose.depth.0 + f64::from(row.depth), pose.depth.1 + 1);
    }
    Ok(true)
}

/// Update: every `MOVE_EVERY` steps, one Gauss–Newton step of all cameras; resets the sums. If the
/// object moves as well, only relative corrections between cameras are used.
pub fn move_cameras<const OBJECT_MOVES: bool>(
    rates: Res<StepRates>,
    unknowns: Res<CameraUnknowns>,
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
    // There is one focal length for all views. If it is not optimized, it keeps its value from an
    // earlier pass.
    let (share, from) = match *unknowns {
        CameraUnknowns::PosesAndFocal => (1.0 / aligned.len() as f64, fit.log_focal),
        _ => (1e30, 0.0),
    };
    aligned.iter_mut().for_each(|view| view.prior.focal *= share);
    let center = fit.center.unwrap_or_default();
    let (mut steps, mut by_focal) = solve(&aligned, center, !OBJECT_MOVES, from);
    if !(by_focal.is_finite() && steps.iter().flatten().all(|step| step.is_finite())) {
        // Cameras stay where they are, and their sums start again.
        (steps, by_focal) = (vec![[0.0; POSE]; views.len()], 0.0);
    }
    fit.log_focal += by_focal.clamp(-0.01, 0.01);
    for ((camera, pose), step) in views.iter_mut().zip(&steps) {
        // Scaled down if it is longer than the longest move.
        let (turn, shift) = pose.pixels();
        let reach = |i: usize| step[i].abs() * if i < 3 { turn } else { shift };
        let part = (LONGEST_MOVE / (0..POSE).map(reach).fold(0.0, f64::max)).min(1.0);
        pose.pose.iter_mut().zip(step).for_each(|(pose, step)| *pose += part * step);
        **camera = moved(&pose.given, &pose.pose, fit.log_focal);
        (pose.sums, pose.depth) = (PoseSums::default(), (0.0, 0));
    }
}

/// Parameters of a pose.
const POSE: usize = 6;
/// Columns of the Jacobian of a residual: the pose, the log focal length, and the log size of the
/// object.
const JACOBIAN_COLUMNS: usize = POSE + 2;
/// Parameters that all views share: the log focal length, and the object's log size, rotation and
/// translation.
const SHARED: usize = 8;

/// Correction to the given pose of a camera: rotation about its own axes (radians), then
/// translation along them (world units).
type Pose = [f64; POSE];

/// A camera turned and shifted along its own axes, its focal lengths multiplied by e^`log_focal`.
fn moved(given: &Camera, pose: &Pose, log_focal: f64) -> Camera {
    let [x, y, z, right, down, forward] = pose.map(|p| p as f32);
    let turn = Quat::from_scaled_axis(Vec3::new(x, y, z));
    let shift = Affine3A::from_rotation_translation(turn, Vec3::new(right, down, forward));
    let focal = given.focal.map(|f| f * (log_focal.exp() as f32));
    Camera { world_from_camera: given.world_from_camera * shift, focal, ..*given }
}

/// Jacobian of the projection of a world point (x, then y, in pixels) with respect to pose, log
/// focal length, and log size of the object around `center`; `None` behind the camera.
fn projection_jacobian(camera: &Camera, point: Vec3, center: Vec3) -> Option<[[f32; JACOBIAN_COLUMNS]; 2]> {
    let camera_from_world = camera.world_from_camera.inverse();
    let local = camera_from_world.transform_point3(point);
    if local.z <= f32::MIN_POSITIVE {
        return None;
    }
    let (x, y, z) = (local.x, local.y, local.z);
    let [fx, fy] = camera.focal;
    let to_x = Vec3::new(fx, camera.skew, -(fx * x + camera.skew * y) / z) / z;
    let to_y = Vec3::new(0.0, fy, -fy * y / z) / z;
    let outward = camera_from_world.transform_vector3(point - center);
    // A camera that turns by ω and shifts by t sees the point move by −ω × p − t.
    let row = |gradient: Vec3, by_focal: f32| {
        let turn = gradient.cross(local);
        [turn.x, turn.y, turn.z, -gradient.x, -gradient.y, -gradient.z, by_focal, gradient.dot(outward)]
    };
    Some([row(to_x, fx * x / z), row(to_y, fy * y / z)])
}

/// Normal equations of one view: the lower triangle of JᵀWJ, and JᵀWr.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
struct PoseSums {
    matrix: [[f64; JACOBIAN_COLUMNS]; JACOBIAN_COLUMNS],
    right: [f64; JACOBIAN_COLUMNS],
}

impl PoseSums {
    /// Adds a residual with its row of the Jacobian.
    #[inline]
    fn add(&mut self, jacobian: &[f32; JACOBIAN_COLUMNS], residual: f32, weight: f32) {
        for (i, derivative) in jacobian.iter().enumerate() {
            let scaled = f64::from(weight * derivative);
            self.right[i] += scaled * f64::from(residual);
            for (sum, other) in self.matrix[i].iter_mut().zip(&jacobian[..=i]) {
                *sum += scaled * f64::from(*other);
            }
        }
    }

    fn at(&self, i: usize, j: usize) -> f64 {
        self.matrix[i.max(j)][i.min(j)]
    }
}

/// Weights of the Gaussian prior on a camera's correction: per radian², per world unit², and on the
/// squared log of the focal factor.
#[derive(Clone, Copy)]
struct Prior {
    rotation: f64,
    translation: f64,
    focal: f64,
}

/// One view in a joint step: its normal equations, and its camera with the correction and the prior
/// that draws that to 0.
#[derive(Clone, Copy)]
struct AlignedView {
    sums: PoseSums,
    pose: Pose,
    prior: Prior,
    camera: Camera,
}

/// One Gauss–Newton step of all views together: the change of each pose and of the log focal
/// length. A view without residuals does not move. Where the object's position, orientation and
/// size are not known (about its `center`), the step solves for them as well, and does not use
/// them.
fn solve(views: &[AlignedView], center: Vec3, is_known: bool, log_focal: f64) -> (Vec<Pose>, f64) {
    let mut tip = [0.0; SHARED * SHARED];
    let mut step = [0.0; SHARED];
    let mut arms = Vec::with_capacity(views.len());
    for view in views {
        let arm = Arm::of(view, center);
        tip[0] += view.prior.focal;
        step[0] -= view.prior.focal * log_focal;
        if let Some(arm) = &arm {
            tip.iter_mut().zip(arm.tip.as_flattened()).for_each(|(sum, x)| *sum += x);
            step.iter_mut().zip(&arm.tip_right).for_each(|(sum, x)| *sum += x);
        }
        arms.push(arm);
    }
    (0..SHARED).for_each(|i| tip[i * SHARED + i] = tip[i * SHARED + i] * (1.0 + 1e-9) + 1e-12);
    if is_known {
        // Of the shared parameters, only the focal length remains.
        step = std::array::from_fn(|i| if i == 0 { step[0] / tip[0] } else { 0.0 });
    } else if cholesky(&mut tip, SHARED) {
        solve_factored(&tip, &mut step);
    } else {
        step = [0.0; SHARED];
    }
    let pose = |arm: &Option<Arm>| {
        let Some(Arm { by_right, by_shared, .. }) = arm else { return [0.0; POSE] };
        std::array::from_fn(|i| by_right[i] - (0..SHARED).map(|k| by_shared[k][i] * step[k]).sum::<f64>())
    };
    (arms.iter().map(pose).collect(), step[0])
}

/// A view with its pose eliminated.
struct Arm {
    /// The step of the pose for fixed shared parameters, and its derivatives with respect to these,
    /// negated.
    by_right: Pose,
    by_shared: [Pose; SHARED],
    /// The contribution of the view to the block of shared parameters.
    tip: [[f64; SHARED]; SHARED],
    tip_right: [f64; SHARED],
}

impl Arm {
    fn of(view: &AlignedView, center: Vec3) -> Option<Self> {
        let (sums, prior) = (&view.sums, &view.prior);
        if sums.matrix[0][0] == 0.0 {
            return None;
        }
        let acts = shared_acts(&view.camera, center);
        // Derivatives of the sums with respect to the shared parameters: S E.
        let by: [[f64; SHARED]; JACOBIAN_COLUMNS] = std::array::from_fn(|i| {
            std::array::from_fn(|k| (0..JACOBIAN_COLUMNS).map(|j| sums.at(i, j) * acts[j][k]).sum())
        });
        let pull: Pose = std::array::from_fn(|i| if i < 3 { prior.rotation } else { prior.translation });
        let mut matrix: [f64; POSE * POSE] = std::array::from_fn(|e| sums.at(e / POSE, e % POSE));
        (0..POSE).for_each(|i| matrix[POSE * i + i] += pull[i]);
        if !cholesky(&mut matrix, POSE) {
            return None;
        }
        let solved = |mut right: Pose| {
            solve_factored(&matrix, &mut right);
            right
        };
        let by_right = solved(std::array::from_fn(|i| -sums.right[i] - pull[i] * view.pose[i]));
        let by_shared = std::array::from_fn(|k| solved(std::array::from_fn(|i| by[i][k])));
        let along = |k: usize, pose: &Pose| (0..POSE).map(|i| by[i][k] * pose[i]).sum::<f64>();
        let tip = std::array::from_fn(|k| {
            std::array::from_fn(|l| {
                (0..JACOBIAN_COLUMNS).map(|j| acts[j][k] * by[j][l]).sum::<f64>() - along(k, &by_shared[l])
            })
        });
        let tip_right = std::array::from_fn(|k| {
            -(0..JACOBIAN_COLUMNS).map(|j| acts[j][k] * sums.right[j]).sum::<f64>() - along(k, &by_right)
        });
        Some(Self { by_right, by_shared, tip, tip_right })
    }
}

/// Each shared parameter as a combination of the Jacobian columns of a view: a motion of the object
/// is the inverse motion of the camera.
fn shared_acts(camera: &Camera, center: Vec3) -> [[f64; SHARED]; JACOBIAN_COLUMNS] {
    let camera_from_world = camera.world_from_camera.inverse();
    let middle = camera_from_world.transform_point3(center);
    let mut acts = [[0.0; SHARED]; JACOBIAN_COLUMNS];
    (acts[POSE][0], acts[POSE + 1][1]) = (1.0, 1.0);
    for (k, axis) in [Vec3::X, Vec3::Y, Vec3::Z].into_iter().enumerate() {
        let local = camera_from_world.transform_vector3(axis);
        let shift = local.cross(middle);
        for i in 0..3 {
            acts[i][2 + k] = f64::from(-local[i]);
            acts[3 + i][2 + k] = f64::from(shift[i]);
            acts[3 + i][5 + k] = f64::from(-local[i]);
        }
    }
    acts
}

#[cfg(test)]
mod tests {
    use super::*;
    use lobelia_sg::fibonacci::fibonacci_axes;

    fn camera(eye: Vec3) -> Camera {
        let up = if eye.normalize().y.abs() > 0.9 { Vec3::X } else { Vec3::Y };
        Camera { skew: 0.7, ..Camera::look_at(eye, Vec3::ZERO, up, 40.0, 64, 64).unwrap() }
    }

    #[test]
    fn projection_jacobian_is_that_of_the_moved_camera() {
        let (given, point) = (camera(Vec3::new(1.0, 2.0, 3.0)), Vec3::new(0.3, -0.2, 0.4));
        let center = Vec3::new(-0.1, 0.2, 0.0);
        let jacobian = projection_jacobian(&given, point, center).unwrap();
        let at = |i: usize, by: f64| {
            let mut pose = [0.0; POSE];
            pose.iter_mut().skip(i).take(1).for_each(|p| *p = by);
            let focal = if i == POSE { by } else { 0.0 };
            let grown = if i > POSE { center + (point - center) * by.exp() as f32 } else { point };
            moved(&given, &pose, focal).project(grown).unwrap()
        };
        for (axis, row) in jacobian.iter().enumerate() {
            for (i, found) in row.iter().enumerate() {
                let (up, down) = (at(i, 2e-3), at(i, -2e-3));
                let exact = [(up.0 - down.0) / 4e-3, (up.1 - down.1) / 4e-3][axis];
                assert!((found - exact).abs() < 0.02 + 2e-3 * exact.abs(), "{axis} {i}: {found} {exact}");
            }
        }
        assert!(projection_jacobian(&given, 2.0 * given.position(), Vec3::ZERO).is_none());
    }

    /// A pattern in space with features of a few pixels.
    fn pattern(p: Vec3) -> f32 {
        (9.0 * p.x).sin() * (8.0 * p.y + 1.0).cos() + (7.0 * p.z + 0.5 * p.x).sin()
    }

    /// Where a camera's ray meets the unit ball.
    fn on_ball(camera: &Camera, x: f32, y: f32) -> Option<Vec3> {
        let ray = camera.ray(x, y);
        let along = -ray.origin.dot(ray.direction);
        let reach = 1.0 - (ray.origin + along * ray.direction).length_squared();
        (reach > 0.05).then(|| ray.origin + (along - reach.sqrt()) * ray.direction)
    }

    /// Normal equations of a view of the ball: its pattern as `camera` predicts it, moved by
    /// `object`, against a photograph from `truth`.
    fn equations(camera: &Camera, truth: &Camera, object: impl Fn(Vec3) -> Vec3) -> PoseSums {
        let mut sums = PoseSums::default();
        let photograph = |x: f32, y: f32| on_ball(truth, x, y).map(|p| pattern(object(p)));
        for pixel in 0..64 * 64 {
            let (x, y) = ((pixel % 64) as f32 + 0.5, (pixel / 64) as f32 + 0.5);
            let around = [(x, y), (x + 1.0, y), (x - 1.0, y), (x, y + 1.0), (x, y - 1.0)];
            let [Some(here), Some(right), Some(left), Some(below), Some(above)] =
                around.map(|(x, y)| photograph(x, y))
            else {
                continue;
            };
            let Some(point) = on_ball(camera, x, y) else { continue };
            let Some([by_x, by_y]) = projection_jacobian(camera, point, Vec3::ZERO) else { continue };
            let (dx, dy) = (0.5 * (right - left), 0.5 * (below - above));
            let jacobian = std::array::from_fn(|k| dx * by_x[k] + dy * by_y[k]);
            sums.add(&jacobian, here - pattern(point), 1.0);
        }
        sums
    }

    const PRIOR: Prior = Prior { rotation: 1e-3, translation: 1e-3, focal: 1e-3 };

    /// Poses and log focal length after some steps from the given cameras.
    fn aligned(
        given: &[Camera],
        truth: &[Camera],
        known: bool,
        object: impl Fn(Vec3) -> Vec3,
    ) -> (Vec<Pose>, f64) {
        let (mut poses, mut focal) = (vec![[0.0; POSE]; given.len()], 0.0);
        for _ in 0..8 {
            let view = |i: usize| {
                let camera = moved(&given[i], &poses[i], focal);
                let sums = equations(&camera, &truth[i], &object);
                AlignedView { sums, pose: poses[i], prior: PRIOR, camera }
            };
            let views: Vec<AlignedView> = (0..given.len()).map(view).collect();
            let (steps, change) = solve(&views, Vec3::ZERO, known, focal);
            poses.iter_mut().flatten().zip(steps.iter().flatten()).for_each(|(p, step)| *p += step);
            focal += change;
        }
        (poses, focal)
    }

    fn around_the_ball() -> Vec<Camera> {
        fibonacci_axes(24).into_iter().map(|axis| camera(3.5 * axis)).collect()
    }

    #[test]
    fn poses_and_focal_length_are_found_from_a_pattern_on_a_known_ball() {
        let given = around_the_ball();
        let off = |i: usize, k: usize| 0.01 * ((7 * i + 3 * k) as f64 * 1.7).sin();
        let truth: Vec<Camera> =
            (0..given.len()).map(|i| moved(&given[i], &std::array::from_fn(|k| off(i, k)), 0.02)).collect();
        let (poses, focal) = aligned(&given, &truth, true, |p| p);
        for (i, truth) in truth.iter().enumerate() {
            let found = moved(&given[i], &poses[i], focal);
            for point in [Vec3::ZERO, 0.8 * Vec3::X, 0.8 * Vec3::Y, 0.8 * Vec3::Z] {
                let ((x, y, _), (u, v, _)) = (found.project(point).unwrap(), truth.project(point).unwrap());
                let off = (x - u).hypot(y - v);
                assert!(off < 0.05, "view {i}: {off} pixels");
            }
        }
    }

    #[test]
    fn cameras_do_not_follow_an_object_that_turned_as_a_whole() {
        let given = around_the_ball();
        let turned = |p: Vec3| Quat::from_scaled_axis(Vec3::new(0.01, -0.02, 0.015)) * p;
        let farthest = |known: bool| {
            let (poses, focal) = aligned(&given, &given, known, turned);
            let turns = poses.iter().map(|p| (0..3).map(|i| p[i] * p[i]).sum::<f64>().sqrt());
            turns.fold(focal.abs(), f64::max)
        };
        assert!(farthest(false) < 2e-3, "{}", farthest(false));
        assert!(farthest(true) > 5e-3, "{}", farthest(true));
    }

    #[test]
    fn a_view_without_residuals_stays() {
        let camera = camera(Vec3::X);
        let view = AlignedView { sums: PoseSums::default(), pose: [0.0; POSE], prior: PRIOR, camera };
        for known in [false, true] {
            let (steps, focal) = solve(&[view], Vec3::ZERO, known, 0.0);
            assert_eq!((steps, focal), (vec![[0.0; POSE]], 0.0));
        }
    }
}
