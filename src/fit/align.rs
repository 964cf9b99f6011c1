//! Kernels that find how far cameras are off: a view's pose (six numbers) and one factor on all focal lengths.
//!
//! Direct image alignment (Lucas and Kanade 1981; Engel, Koltun and Cremers 2018): a surface point keeps its place and its
//! radiance, and the photograph is read where the moved camera sees it. So a residual's slope is the photograph's own slope times
//! that of the point's image position, whatever kind the surface is. Outlines are aligned likewise, by the distance to the mask's
//! outline in pixels. Each view sums its normal equations; together they are an arrow with the focal length in its tip, solved by
//! Schur's complement.

use crate::light::fit_linear::{cholesky, solve_factored};
use crate::view::Camera;
use glam::{Affine3A, Quat, Vec3};

/// Numbers of a pose.
pub const POSE: usize = 6;
/// Those, and the logarithm of the factor on the focal lengths.
pub const PARAMETERS: usize = POSE + 1;

/// Where a camera is from where it was given: rotation about its own axes (radians), then translation along them (world units).
pub type Pose = [f64; POSE];

/// A camera turned and shifted along its own axes, its focal lengths multiplied by e^`log_focal`.
pub fn moved(given: &Camera, pose: &Pose, log_focal: f64) -> Camera {
    let [x, y, z, right, down, forward] = pose.map(|p| p as f32);
    let turn = Quat::from_scaled_axis(Vec3::new(x, y, z));
    let shift = Affine3A::from_rotation_translation(turn, Vec3::new(right, down, forward));
    Camera {
        world_from_camera: given.world_from_camera * shift,
        focal: given.focal.map(|f| f * log_focal.exp() as f32),
        ..*given
    }
}

/// Slopes of a world point's image position (x, then y, in pixels) with respect to a small change of pose and log focal length;
/// `None` behind the camera.
pub fn projection_slopes(camera: &Camera, point: Vec3) -> Option<[[f32; PARAMETERS]; 2]> {
    let local = camera.world_from_camera.inverse().transform_point3(point);
    if local.z <= f32::MIN_POSITIVE {
        return None;
    }
    let (x, y, z) = (local.x, local.y, local.z);
    let [fx, fy] = camera.focal;
    let to_x = Vec3::new(fx, camera.skew, -(fx * x + camera.skew * y) / z) / z;
    let to_y = Vec3::new(0.0, fy, -fy * y / z) / z;
    // A camera that turns by ω and shifts by t sees the point move by −ω × p − t.
    let row = |slope: Vec3, by_focal: f32| {
        let turn = slope.cross(local);
        [turn.x, turn.y, turn.z, -slope.x, -slope.y, -slope.z, by_focal]
    };
    Some([row(to_x, fx * x / z), row(to_y, fy * y / z)])
}

/// Normal equations of one view: JᵀWJ, its lower triangle row by row, and JᵀWr.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PoseSums {
    matrix: [[f64; PARAMETERS]; PARAMETERS],
    right: [f64; PARAMETERS],
}

impl PoseSums {
    /// Takes in a residual with its slopes.
    #[inline]
    pub fn add(&mut self, slopes: &[f32; PARAMETERS], residual: f32, weight: f32) {
        for i in 0..PARAMETERS {
            let scaled = f64::from(weight * slopes[i]);
            self.right[i] += scaled * f64::from(residual);
            for j in 0..=i {
                self.matrix[i][j] += scaled * f64::from(slopes[j]);
            }
        }
    }
}

/// What a camera is believed to be off before it is looked at.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Prior {
    /// Weight of a squared rotation, per radian².
    pub rotation: f64,
    /// Weight of a squared translation, per world unit².
    pub translation: f64,
    /// Weight of the squared log of the focal factor.
    pub focal: f64,
}

/// One Gauss–Newton step of all views together: by how much each pose and the log focal length change. `poses` and `log_focal` are
/// where they are, from where the prior takes its pull back to 0. A view without residuals stays.
pub fn solve(sums: &[PoseSums], poses: &[Pose], log_focal: f64, priors: &[Prior]) -> (Vec<Pose>, f64) {
    let (mut tip, mut tip_right) = (1e-12, 0.0);
    let mut solved = Vec::with_capacity(sums.len());
    for ((sums, pose), prior) in sums.iter().zip(poses).zip(priors) {
        let arm: Pose = std::array::from_fn(|j| sums.matrix[POSE][j]);
        let view = eliminate(sums, pose, prior);
        tip += sums.matrix[POSE][POSE] + prior.focal;
        tip_right -= sums.right[POSE] + prior.focal * log_focal;
        if let Some((by_right, by_arm)) = &view {
            let dot = |a: &Pose| arm.iter().zip(a).map(|(x, y)| x * y).sum::<f64>();
            tip -= dot(by_arm);
            tip_right -= dot(by_right);
        }
        solved.push(view);
    }
    let focal = tip_right / tip;
    let step = |view: Option<(Pose, Pose)>| {
        view.map_or([0.0; POSE], |(by_right, by_arm)| {
            std::array::from_fn(|i| by_right[i] - by_arm[i] * focal)
        })
    };
    (solved.into_iter().map(step).collect(), focal)
}

/// A view's pose eliminated: its step if the focal length stayed, and the step's slope with that length, negated.
fn eliminate(sums: &PoseSums, pose: &Pose, prior: &Prior) -> Option<(Pose, Pose)> {
    if sums.matrix[0][0] == 0.0 {
        return None;
    }
    let pull: Pose = std::array::from_fn(|i| if i < 3 { prior.rotation } else { prior.translation });
    let mut matrix = [0.0; POSE * POSE];
    for i in 0..POSE {
        for j in 0..=i {
            matrix[POSE * i + j] = sums.matrix[i][j];
        }
        matrix[POSE * i + i] += pull[i];
    }
    let mut by_right: Pose = std::array::from_fn(|i| -sums.right[i] - pull[i] * pose[i]);
    let mut by_arm: Pose = std::array::from_fn(|i| sums.matrix[POSE][i]);
    cholesky(&mut matrix, POSE).then(|| {
        solve_factored(&matrix, &mut by_right);
        solve_factored(&matrix, &mut by_arm);
        (by_right, by_arm)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::fibonacci::fibonacci_axes;

    fn camera(eye: Vec3) -> Camera {
        let up = if eye.normalize().y.abs() > 0.9 { Vec3::X } else { Vec3::Y };
        Camera { skew: 0.7, ..Camera::look_at(eye, Vec3::ZERO, up, 40.0, 64, 64).unwrap() }
    }

    #[test]
    fn projection_slopes_are_those_of_the_moved_camera() {
        let (given, point) = (camera(Vec3::new(1.0, 2.0, 3.0)), Vec3::new(0.3, -0.2, 0.4));
        let slopes = projection_slopes(&given, point).unwrap();
        for i in 0..PARAMETERS {
            let at = |by: f64| {
                let mut pose = [0.0; POSE];
                let focal = if i < POSE { 0.0 } else { by };
                pose.iter_mut().skip(i).take(1).for_each(|p| *p = by);
                moved(&given, &pose, focal).project(point).unwrap()
            };
            let (up, down) = (at(2e-3), at(-2e-3));
            let exact = [(up.0 - down.0) / 4e-3, (up.1 - down.1) / 4e-3];
            for (axis, exact) in exact.into_iter().enumerate() {
                let found = slopes[axis][i];
                assert!((found - exact).abs() < 0.02 + 2e-3 * exact.abs(), "{axis} {i}: {found} {exact}");
            }
        }
        assert!(projection_slopes(&given, 2.0 * given.position()).is_none());
    }

    /// A pattern in space with features of a few pixels, and its slope.
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

    #[test]
    fn poses_and_focal_length_are_found_from_a_pattern_on_a_ball() {
        let given: Vec<Camera> = fibonacci_axes(24).into_iter().map(|axis| camera(3.5 * axis)).collect();
        let off = |i: usize, k: usize| 0.01 * ((7 * i + 3 * k) as f64 * 1.7).sin();
        let truth: Vec<Camera> =
            given.iter().enumerate().map(|(i, c)| moved(c, &std::array::from_fn(|k| off(i, k)), 0.02)).collect();
        let prior = Prior { rotation: 1e-3, translation: 1e-3, focal: 1e-3 };
        let (mut poses, mut focal) = (vec![[0.0; POSE]; given.len()], 0.0);
        for _ in 0..8 {
            let sums: Vec<PoseSums> = (0..given.len())
                .map(|i| {
                    let (camera, mut sums) = (moved(&given[i], &poses[i], focal), PoseSums::default());
                    for pixel in 0..64 * 64 {
                        let (x, y) = ((pixel % 64) as f32 + 0.5, (pixel / 64) as f32 + 0.5);
                        let photograph = |x: f32, y: f32| on_ball(&truth[i], x, y).map(pattern);
                        let around = [(x, y), (x + 1.0, y), (x - 1.0, y), (x, y + 1.0), (x, y - 1.0)];
                        let [Some(here), Some(right), Some(left), Some(below), Some(above)] =
                            around.map(|(x, y)| photograph(x, y))
                        else {
                            continue;
                        };
                        let Some(point) = on_ball(&camera, x, y) else { continue };
                        let Some([by_x, by_y]) = projection_slopes(&camera, point) else { continue };
                        let (dx, dy) = (0.5 * (right - left), 0.5 * (below - above));
                        let slopes = std::array::from_fn(|k| -(dx * by_x[k] + dy * by_y[k]));
                        sums.add(&slopes, pattern(point) - here, 1.0);
                    }
                    sums
                })
                .collect();
            let (steps, change) = solve(&sums, &poses, focal, &vec![prior; given.len()]);
            poses.iter_mut().flatten().zip(steps.iter().flatten()).for_each(|(p, step)| *p += step);
            focal += change;
        }
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
    fn a_view_without_residuals_stays() {
        let prior = Prior { rotation: 1.0, translation: 1.0, focal: 1.0 };
        let (steps, focal) = solve(&[PoseSums::default()], &[[0.0; POSE]], 0.0, &[prior]);
        assert_eq!((steps, focal), (vec![[0.0; POSE]], 0.0));
    }
}
