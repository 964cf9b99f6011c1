//! Kernels of camera alignment: corrections to the pose of each view (six parameters) and one factor on all focal lengths.
//!
//! Direct image alignment (Lucas and Kanade 1981; Engel, Koltun and Cremers 2018): a surface point keeps its position and its
//! radiance, and the photograph is sampled where the moved camera sees it. So the derivative of a residual is the gradient of the
//! photograph times the Jacobian of the point's projection, for any kind of surface. Silhouettes are aligned in the same way, by the
//! distance in pixels to the silhouette of the mask.
//!
//! Each view sums its normal equations. Together they form an arrowhead matrix, solved by the Schur complement; the parameters that all
//! views share are the focal length and, for an unknown object, its rotation, translation and scale as a whole. Without the latter,
//! cameras and object could drift together; that part of the solution is not used, because the object's own fit determines it.

use crate::light::map_fit::least_squares::{cholesky, solve_factored};
use crate::view::Camera;
use glam::{Affine3A, Quat, Vec3};
use serde::{Deserialize, Serialize};

/// Parameters of a pose.
pub(crate) const POSE: usize = 6;
/// Columns of the Jacobian of a residual: the pose, the log focal length, and the log size of the object.
pub(crate) const JACOBIAN_COLUMNS: usize = POSE + 2;
/// Parameters that all views share: the log focal length, and the object's log size, rotation and translation.
const SHARED: usize = 8;

/// Correction to the given pose of a camera: rotation about its own axes (radians), then translation along them (world units).
pub(crate) type Pose = [f64; POSE];

/// A camera turned and shifted along its own axes, its focal lengths multiplied by e^`log_focal`.
pub fn moved(given: &Camera, pose: &Pose, log_focal: f64) -> Camera {
    let [x, y, z, right, down, forward] = pose.map(|p| p as f32);
    let turn = Quat::from_scaled_axis(Vec3::new(x, y, z));
    let shift = Affine3A::from_rotation_translation(turn, Vec3::new(right, down, forward));
    Camera {
        world_from_camera: given.world_from_camera * shift,
        focal: given.focal.map(|f| f * (log_focal.exp() as f32)),
        ..*given
    }
}

/// Jacobian of the projection of a world point (x, then y, in pixels) with respect to pose, log focal length, and log size of the
/// object around `center`; `None` behind the camera.
pub(crate) fn projection_jacobian(
    camera: &Camera,
    point: Vec3,
    center: Vec3,
) -> Option<[[f32; JACOBIAN_COLUMNS]; 2]> {
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
pub struct PoseSums {
    matrix: [[f64; JACOBIAN_COLUMNS]; JACOBIAN_COLUMNS],
    right: [f64; JACOBIAN_COLUMNS],
}

impl PoseSums {
    /// Adds a residual with its row of the Jacobian.
    #[inline]
    pub fn add(&mut self, jacobian: &[f32; JACOBIAN_COLUMNS], residual: f32, weight: f32) {
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

/// The Gaussian prior on camera corrections.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Prior {
    /// Weight of a squared rotation, per radian².
    pub rotation: f64,
    /// Weight of a squared translation, per world unit².
    pub translation: f64,
    /// Weight of the squared log of the focal factor.
    pub focal: f64,
}

/// One view in a joint step.
#[derive(Clone, Copy, Debug)]
pub struct AlignedView {
    /// Its normal equations.
    pub sums: PoseSums,
    /// Correction of its camera.
    pub pose: Pose,
    /// The prior that draws the correction to 0.
    pub prior: Prior,
    /// Its camera.
    pub camera: Camera,
}

/// The properties of the object that a step needs.
#[derive(Clone, Copy, Debug)]
pub struct AlignedObject {
    /// Center of its rotation and scaling.
    pub center: Vec3,
    /// Whether its position, orientation and size are known; otherwise the step solves for them as well, and does not use them.
    pub known: bool,
}

/// One Gauss–Newton step of all views together: the change of each pose and of the log focal length. A view without
/// residuals does not move.
pub fn solve(views: &[AlignedView], object: AlignedObject, log_focal: f64) -> (Vec<Pose>, f64) {
    let mut tip = [0.0; SHARED * SHARED];
    let mut step = [0.0; SHARED];
    let mut arms = Vec::with_capacity(views.len());
    for view in views {
        let arm = Arm::of(view, object);
        tip[0] += view.prior.focal;
        step[0] -= view.prior.focal * log_focal;
        if let Some(arm) = &arm {
            tip.iter_mut().zip(arm.tip.as_flattened()).for_each(|(sum, x)| *sum += x);
            step.iter_mut().zip(&arm.tip_right).for_each(|(sum, x)| *sum += x);
        }
        arms.push(arm);
    }
    (0..SHARED).for_each(|i| tip[i * SHARED + i] = tip[i * SHARED + i] * (1.0 + 1e-9) + 1e-12);
    if object.known {
        // Of the shared parameters, only the focal length remains.
        step = std::array::from_fn(|i| if i == 0 { step[0] / tip[0] } else { 0.0 });
    } else if cholesky(&mut tip, SHARED) {
        solve_factored(&tip, &mut step);
    } else {
        step = [0.0; SHARED];
    }
    let pose = |arm: &Option<Arm>| arm.as_ref().map_or([0.0; POSE], |arm| arm.pose_step(&step));
    (arms.iter().map(pose).collect(), step[0])
}

/// A view with its pose eliminated.
struct Arm {
    /// The step of the pose for fixed shared parameters, and its derivatives with respect to these, negated.
    by_right: Pose,
    by_shared: [Pose; SHARED],
    /// The contribution of the view to the block of shared parameters.
    tip: [[f64; SHARED]; SHARED],
    tip_right: [f64; SHARED],
}

impl Arm {
    fn of(view: &AlignedView, object: AlignedObject) -> Option<Self> {
        let (sums, prior) = (&view.sums, &view.prior);
        if sums.matrix[0][0] == 0.0 {
            return None;
        }
        let acts = shared_acts(&view.camera, object.center);
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

    fn pose_step(&self, shared: &[f64; SHARED]) -> Pose {
        std::array::from_fn(|i| {
            self.by_right[i] - (0..SHARED).map(|k| self.by_shared[k][i] * shared[k]).sum::<f64>()
        })
    }
}

/// Each shared parameter as a combination of the Jacobian columns of a view: a motion of the object is the inverse motion of the camera.
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
    use crate::math::fibonacci::fibonacci_axes;

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

    /// Normal equations of a view of the ball: its pattern as `camera` predicts it, moved by `object`, against a photograph from
    /// `truth`.
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
                AlignedView {
                    sums: equations(&camera, &truth[i], &object),
                    pose: poses[i],
                    prior: PRIOR,
                    camera,
                }
            };
            let views: Vec<AlignedView> = (0..given.len()).map(view).collect();
            let (steps, change) = solve(&views, AlignedObject { center: Vec3::ZERO, known }, focal);
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
            let (steps, focal) = solve(&[view], AlignedObject { center: Vec3::ZERO, known }, 0.0);
            assert_eq!((steps, focal), (vec![[0.0; POSE]], 0.0));
        }
    }
}
