//! Steps of the map fit: Levenberg–Marquardt on all parameters, and amplitudes alone.

use crate::linear::{cholesky, descend_nonnegative, solve_factored};
use crate::map_fit::kernel::{Derivatives, FitLobe, Tile, derivatives};
use crate::{map_fit::gram::Gram, sg::sphere_integral};
use rayon::prelude::*;

/// Bounds of the parameters of a lobe.
#[derive(Clone, Copy, Debug)]
pub struct LobeBounds {
    /// Least sharpness.
    pub dullest: f64,
    /// Largest sharpness.
    pub sharpest: f64,
    /// Whether axes stay at or above the horizon (y ≥ 0).
    pub upper_only: bool,
}

/// Parameters of a lobe: two tangents, log sharpness, three amplitudes.
const PARAMETERS: usize = 6;

/// Up to `steps` accepted Levenberg–Marquardt steps (Marquardt 1963; amplitudes and sharpness kept
/// in bounds by projection, active bounds excluded from the step). Returns the error reached.
pub fn levenberg_marquardt(
    tiles: &[Tile],
    lobes: &mut Vec<FitLobe>,
    steps: usize,
    bounds: LobeBounds,
    is_stopping: &dyn Fn() -> bool,
) -> f64 {
    let mut damping = 1e-2;
    let mut reached = derivatives(tiles, lobes);
    for _ in 0..steps {
        if is_stopping() {
            break;
        }
        let Some((better, lower)) = improve(tiles, lobes, &reached, &mut damping, bounds) else { break };
        let gain = reached.error - lower.error;
        *lobes = better;
        reached = lower;
        if gain < 1e-5 * reached.error {
            break;
        }
    }
    reached.error
}

/// Tries damped steps until one lowers the error; `None` if none does.
fn improve(
    tiles: &[Tile],
    lobes: &[FitLobe],
    reached: &Derivatives,
    damping: &mut f64,
    bounds: LobeBounds,
) -> Option<(Vec<FitLobe>, Derivatives)> {
    let gradient = reached.gradient(lobes);
    let gram = Gram::of(lobes);
    for _ in 0..6 {
        if let Some(step) = damped_step(lobes, &gradient, gauss_newton(lobes, &gram), *damping) {
            let steps = lobes.iter().zip(step.as_chunks::<PARAMETERS>().0);
            let trial: Vec<FitLobe> = steps.map(|(l, s)| stepped(l, s, bounds)).collect();
            let lower = derivatives(tiles, &trial);
            if lower.error < reached.error {
                *damping = (*damping * 0.3).max(1e-7);
                return Some((trial, lower));
            }
        }
        *damping *= 5.0;
    }
    None
}

/// The solution of (H + damping · diag H) d = −½ gradient, with H the Gauss–Newton matrix of ½E.
fn damped_step(
    lobes: &[FitLobe],
    gradient: &[[f64; 6]],
    mut matrix: Vec<f64>,
    damping: f64,
) -> Option<Vec<f64>> {
    let n = lobes.len() * PARAMETERS;
    let mut right: Vec<f64> = gradient.as_flattened().iter().map(|g| -0.5 * g).collect();
    let largest = (0..n).map(|i| matrix[i * n + i]).fold(0.0, f64::max);
    for i in 0..n {
        let (lobe, parameter) = (&lobes[i / PARAMETERS], i % PARAMETERS);
        let pressed = parameter >= 3 && lobe.amplitude[parameter - 3] <= 0.0 && right[i] <= 0.0;
        if pressed {
            matrix[i * n..i * n + i].fill(0.0);
            (i + 1..n).for_each(|row| matrix[row * n + i] = 0.0);
            right[i] = 0.0;
        }
        matrix[i * n + i] = matrix[i * n + i] * (1.0 + damping) + 1e-12 * largest;
    }
    cholesky(&mut matrix, n).then(|| {
        solve_factored(&matrix, &mut right);
        right
    })
}

/// Lower triangle of Σ_c JᵀJ, from the Gram matrix of the bases.
fn gauss_newton(lobes: &[FitLobe], gram: &Gram) -> Vec<f64> {
    let n = lobes.len() * PARAMETERS;
    let mut matrix = vec![0.0; n * n];
    matrix.par_chunks_mut(PARAMETERS * n).zip(lobes).enumerate().for_each(|(k, (rows, a))| {
        for (l, b) in lobes.iter().enumerate().take(k + 1) {
            let colors: f64 = (0..3).map(|c| a.amplitude[c] * b.amplitude[c]).sum();
            for p in 0..PARAMETERS {
                let row = p * n + l * PARAMETERS;
                for q in 0..PARAMETERS {
                    rows[row + q] = match (p, q) {
                        (0..3, 0..3) => colors * gram.at(k, p + 1, l, q + 1),
                        (0..3, _) => a.amplitude[q - 3] * gram.at(k, p + 1, l, 0),
                        (_, 0..3) => b.amplitude[p - 3] * gram.at(k, 0, l, q + 1),
                        _ if p == q => gram.at(k, 0, l, 0),
                        _ => 0.0,
                    };
                }
            }
        }
    });
    matrix
}

/// A lobe after its part of the step, within the trust region of the quadratic model and the
/// bounds.
fn stepped(lobe: &FitLobe, step: &[f64; PARAMETERS], bounds: LobeBounds) -> FitLobe {
    let turn = step[0].hypot(step[1]);
    let farthest = (1.0 / lobe.sharpness.sqrt()).min(0.5);
    let shorter = if turn > farthest { farthest / turn } else { 1.0 };
    let mut moved = lobe.moved([step[0] * shorter, step[1] * shorter, step[2].clamp(-1.0, 1.0)]);
    moved.sharpness = moved.sharpness.clamp(bounds.dullest, bounds.sharpest);
    if bounds.upper_only && moved.axis.y < 0.0 {
        let level = moved.axis.with_y(0.0);
        moved = FitLobe::new(level.normalize_or(glam::DVec3::Y), moved.sharpness, moved.amplitude);
    }
    moved.amplitude = [0, 1, 2].map(|c| (lobe.amplitude[c] + step[3 + c]).max(0.0));
    moved
}

/// Computes the best non-negative amplitudes for the current shapes of the lobes.
pub fn fit_amplitudes(tiles: &[Tile], lobes: &mut [FitLobe]) {
    let reached = derivatives(tiles, lobes);
    let matrix = amplitude_matrix(lobes);
    for c in 0..3 {
        let mut x: Vec<f64> = lobes.iter().map(|l| l.amplitude[c]).collect();
        let mut gradient: Vec<f64> = reached.correlations.iter().map(|r| r[0][c]).collect();
        descend_nonnegative(&matrix, &mut x, &mut gradient, 300);
        lobes.iter_mut().zip(x).for_each(|(l, x)| l.amplitude[c] = x);
    }
}

/// Inner products of the lobes' G.
fn amplitude_matrix(lobes: &[FitLobe]) -> Vec<f64> {
    let (n, gram) = (lobes.len(), Gram::of(lobes));
    (0..n * n).map(|e| gram.at(e / n, 0, e % n, 0)).collect()
}

/// Inverse of the symmetric positive semi-definite `matrix` (n × n) with a `ridge` (a fraction of
/// its largest entry), because two coincident lobes make it singular. `None` if it is singular
/// nevertheless.
fn ridged_inverse(mut matrix: Vec<f64>, n: usize, ridge: f64) -> Option<Vec<f64>> {
    let largest = (0..n).map(|i| matrix[i * n + i]).fold(0.0, f64::max);
    (0..n).for_each(|i| matrix[i * n + i] += ridge * largest + f64::MIN_POSITIVE);
    if !cholesky(&mut matrix, n) {
        return None;
    }
    let column = |k: usize| {
        let mut unit = vec![0.0; n];
        unit[k] = 1.0;
        solve_factored(&matrix, &mut unit);
        unit
    };
    Some((0..n).into_par_iter().flat_map_iter(column).collect())
}

/// Removes the least important lobes, one after another, until `count` are left.
///
/// Without lobe k the error grows by Σ_c μ_kc²/(A⁻¹)_kk after the other amplitudes are optimized.
/// They are updated before the next lobe is selected, so that of two coincident lobes only one is
/// removed (the "optimal brain surgeon", Hassibi and Stork 1993).
pub fn prune(lobes: &mut Vec<FitLobe>, count: usize) {
    let n = lobes.len();
    let Some(mut inverse) = ridged_inverse(amplitude_matrix(lobes), n, 1e-9) else {
        lobes.truncate(count);
        return;
    };
    let mut left: Vec<usize> = (0..n).collect();
    while left.len() > count {
        let energy = |k: usize| lobes[k].amplitude.iter().map(|a| a * a).sum::<f64>();
        let cost = |k: usize| energy(k) / inverse[k * n + k];
        let least = (0..left.len()).min_by(|&a, &b| cost(left[a]).total_cmp(&cost(left[b])));
        let Some(k) = least.map(|at| left.remove(at)) else { break };
        let row = inverse[k * n..(k + 1) * n].to_vec();
        let gone = lobes[k].amplitude;
        for &j in &left {
            let share = row[j] / row[k];
            let lobe = &mut lobes[j];
            lobe.amplitude = [0, 1, 2].map(|c| (lobe.amplitude[c] - share * gone[c]).max(0.0));
            inverse[j * n..(j + 1) * n].iter_mut().zip(&row).for_each(|(a, b)| *a -= share * b);
        }
    }
    *lobes = left.into_iter().map(|k| lobes[k]).collect();
}

/// Rounds in which amplitudes that would turn negative leave [`keep_power`].
const POWER_ROUNDS: usize = 8;

/// Changes the amplitudes by the smallest amount (in the metric of the error) for which the lobes
/// have the mean radiance `means` over the sphere, per channel: x + A⁻¹m (p − mᵀx)/(mᵀA⁻¹m), with m
/// the means of the lobes, over the lobes that are not black.
pub fn keep_power(lobes: &mut [FitLobe], means: [f64; 3]) {
    let matrix = amplitude_matrix(lobes);
    let own: Vec<f64> =
        lobes.iter().map(|l| sphere_integral(l.sharpness) / (4.0 * std::f64::consts::PI)).collect();
    for (c, mean) in means.into_iter().enumerate() {
        for _ in 0..POWER_ROUNDS {
            let shining: Vec<usize> = (0..lobes.len()).filter(|&k| lobes[k].amplitude[c] > 0.0).collect();
            let missing = mean - shining.iter().map(|&k| own[k] * lobes[k].amplitude[c]).sum::<f64>();
            if missing.abs() <= 1e-5 * mean {
                break;
            }
            let Some(steps) = power_steps(&matrix, lobes.len(), &own, &shining, missing) else { break };
            for (&k, step) in shining.iter().zip(steps) {
                lobes[k].amplitude[c] = (lobes[k].amplitude[c] + step).max(0.0);
            }
        }
    }
}

fn power_steps(matrix: &[f64], n: usize, own: &[f64], shining: &[usize], missing: f64) -> Option<Vec<f64>> {
    let m = shining.len();
    let part = (0..m * m).map(|e| matrix[shining[e / m] * n + shining[e % m]]).collect();
    // A large ridge prevents coincident lobes from changing far in opposite directions.
    let inverse = ridged_inverse(part, m, 1e-3)?;
    let row = |k: usize| (0..m).map(|l| inverse[k * m + l] * own[shining[l]]).sum::<f64>();
    let direction: Vec<f64> = (0..m).map(row).collect();
    let response: f64 = direction.iter().zip(shining).map(|(d, &k)| d * own[k]).sum();
    (response > 0.0).then(|| direction.iter().map(|d| d * missing / response).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{light::envmap::EnvironmentMap, map_fit::kernel::tiles_of};
    use glam::{DVec3, Vec3};

    fn lobes() -> Vec<FitLobe> {
        let lobe =
            |axis: [f64; 3], sharpness, gray| FitLobe::new(axis.into(), sharpness, [gray, 2.0 * gray, 0.0]);
        vec![
            lobe([0.0, 1.0, 0.0], 3.0, 1.0),
            lobe([1.0, 0.0, 0.0], 40.0, 4.0),
            lobe([1.0, 0.001, 0.0], 40.0, 4.0),
            lobe([0.0, 0.0, -1.0], 40.0, 0.1),
        ]
    }

    #[test]
    fn pruning_takes_a_duplicate_and_a_dim_lobe_and_keeps_the_light() {
        let mut left = lobes();
        prune(&mut left, 2);
        assert_eq!(left.len(), 2);
        assert!(left[1].axis.x > 0.99 && (left[1].amplitude[0] - 8.0).abs() < 0.1, "{left:?}");
    }

    #[test]
    fn power_is_kept_and_amplitudes_stay_in_bounds() {
        let mut fitted = lobes();
        keep_power(&mut fitted, [0.5, 0.1, 0.0]);
        let mean = |c: usize| -> f64 {
            let own =
                |l: &FitLobe| l.amplitude[c] * sphere_integral(l.sharpness) / (4.0 * std::f64::consts::PI);
            fitted.iter().map(own).sum()
        };
        assert!((mean(0) - 0.5).abs() < 1e-4 && (mean(1) - 0.1).abs() < 1e-4 && mean(2) == 0.0);
        assert!(fitted.iter().flat_map(|l| l.amplitude).all(|a| a >= 0.0));
    }

    #[test]
    fn steps_lower_the_error_and_stay_above_the_horizon_when_asked() {
        let map = EnvironmentMap::from_directions(64, 32, |d| {
            Vec3::splat((8.0 * (d.dot(Vec3::new(0.8, -0.6, 0.0)) - 1.0)).exp())
        });
        let tiles = tiles_of(&map);
        let mut bounds = LobeBounds { dullest: 0.1, sharpest: 100.0, upper_only: false };
        let start = vec![FitLobe::new(DVec3::X, 4.0, [0.5; 3])];
        let mut free = start.clone();
        assert!(levenberg_marquardt(&tiles, &mut free, 30, bounds, &|| false) < 1e-6);
        assert!(free[0].axis.y < -0.5);
        bounds.upper_only = true;
        let mut level = start.clone();
        let reached = levenberg_marquardt(&tiles, &mut level, 30, bounds, &|| false);
        assert!(reached < derivatives(&tiles, &start).error && level[0].axis.y >= 0.0);
    }
}
