//! Steps of the map fit: Levenberg–Marquardt on all parameters, and amplitudes alone.

use super::fit_kernel::{FitLobe, Gram, Normal, Tile, error, gradient, normal};
use super::fit_linear::{cholesky, descend_nonnegative, inverse_diagonal, solve_factored};

/// What a lobe may be.
#[derive(Clone, Copy, Debug)]
pub struct Bounds {
    /// Least sharpness.
    pub dullest: f64,
    /// Greatest sharpness.
    pub sharpest: f64,
}

/// Parameters of a lobe: two tangents, log sharpness, three amplitudes.
const PARAMETERS: usize = 6;

/// Up to `steps` accepted Levenberg–Marquardt steps (Marquardt 1963; amplitudes and sharpness kept in bounds by
/// projection, parameters that press against their bound left out). Returns the error reached.
pub fn levenberg_marquardt(
    tiles: &[Tile<f32>],
    lobes: &mut Vec<FitLobe>,
    steps: usize,
    bounds: Bounds,
) -> f64 {
    let mut damping = 1e-2;
    let mut reached = error(tiles, lobes);
    for _ in 0..steps {
        let equations = normal(tiles, lobes);
        reached = equations.error;
        let Some((better, lower)) = improve(tiles, lobes, &equations, &mut damping, bounds) else { break };
        let gain = reached - lower;
        *lobes = better;
        reached = lower;
        if gain < 1e-5 * lower {
            break;
        }
    }
    reached
}

/// Tries damped steps until one lowers the error; `None` if none does.
fn improve(
    tiles: &[Tile<f32>],
    lobes: &[FitLobe],
    equations: &Normal,
    damping: &mut f64,
    bounds: Bounds,
) -> Option<(Vec<FitLobe>, f64)> {
    let slopes = gradient(lobes, &equations.correlations);
    for _ in 0..6 {
        if let Some(step) = damped_step(lobes, &slopes, &equations.gram, *damping) {
            let trial: Vec<FitLobe> = lobes
                .iter()
                .zip(step.as_chunks::<PARAMETERS>().0)
                .map(|(l, s)| stepped(l, s, bounds))
                .collect();
            let lower = error(tiles, &trial);
            if lower < equations.error {
                *damping = (*damping * 0.3).max(1e-7);
                return Some((trial, lower));
            }
        }
        *damping *= 5.0;
    }
    None
}

/// Solution of (H + damping · diag H) d = −½ gradient, with H the Gauss–Newton matrix of ½E.
fn damped_step(lobes: &[FitLobe], slopes: &[[f64; 6]], gram: &Gram, damping: f64) -> Option<Vec<f64>> {
    let n = lobes.len() * PARAMETERS;
    let mut matrix = gauss_newton(lobes, gram);
    let mut right: Vec<f64> = slopes.as_flattened().iter().map(|g| -0.5 * g).collect();
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
    for (k, a) in lobes.iter().enumerate() {
        for (l, b) in lobes.iter().enumerate().take(k + 1) {
            let colours: f64 = (0..3).map(|c| a.amplitude[c] * b.amplitude[c]).sum();
            for p in 0..PARAMETERS {
                let row = (k * PARAMETERS + p) * n + l * PARAMETERS;
                for q in 0..PARAMETERS {
                    matrix[row + q] = match (p, q) {
                        (0..3, 0..3) => colours * gram.at(k, p + 1, l, q + 1),
                        (0..3, _) => a.amplitude[q - 3] * gram.at(k, p + 1, l, 0),
                        (_, 0..3) => b.amplitude[p - 3] * gram.at(k, 0, l, q + 1),
                        _ if p == q => gram.at(k, 0, l, 0),
                        _ => 0.0,
                    };
                }
            }
        }
    }
    matrix
}

/// A lobe after its part of the step, no farther than the quadratic model can be trusted, and in bounds.
fn stepped(lobe: &FitLobe, step: &[f64; PARAMETERS], bounds: Bounds) -> FitLobe {
    let turn = step[0].hypot(step[1]);
    let farthest = (1.0 / lobe.sharpness.sqrt()).min(0.5);
    let shorter = if turn > farthest { farthest / turn } else { 1.0 };
    let mut moved = lobe.moved([step[0] * shorter, step[1] * shorter, step[2].clamp(-1.0, 1.0)]);
    moved.sharpness = moved.sharpness.clamp(bounds.dullest, bounds.sharpest);
    moved.amplitude = [0, 1, 2].map(|c| (lobe.amplitude[c] + step[3 + c]).max(0.0));
    moved
}

/// Best non-negative amplitudes for the lobes' present shapes. Returns each lobe's importance: how much the error would
/// grow without it, were the other amplitudes free to make up for it.
pub fn fit_amplitudes(tiles: &[Tile<f32>], lobes: &mut [FitLobe]) -> Vec<f64> {
    let equations = normal(tiles, lobes);
    let n = lobes.len();
    let matrix: Vec<f64> = (0..n * n).map(|e| equations.gram.at(e / n, 0, e % n, 0)).collect();
    for c in 0..3 {
        let mut x: Vec<f64> = lobes.iter().map(|l| l.amplitude[c]).collect();
        let mut slope: Vec<f64> = equations.correlations.iter().map(|r| r[0][c]).collect();
        descend_nonnegative(&matrix, &mut x, &mut slope, 300);
        lobes.iter_mut().zip(x).for_each(|(l, x)| l.amplitude[c] = x);
    }
    importances(&matrix, lobes)
}

/// Σ_c μ_kc² / (A⁻¹)_kk.
fn importances(matrix: &[f64], lobes: &[FitLobe]) -> Vec<f64> {
    let n = lobes.len();
    let largest = (0..n).map(|i| matrix[i * n + i]).fold(0.0, f64::max);
    let mut factor = matrix.to_vec();
    // Two lobes in one place make the matrix singular; a ridge keeps it solvable and their importance small.
    (0..n).for_each(|i| factor[i * n + i] += 1e-9 * largest + f64::MIN_POSITIVE);
    let energy = |l: &FitLobe| l.amplitude.iter().map(|a| a * a).sum::<f64>();
    if !cholesky(&mut factor, n) {
        return lobes.iter().enumerate().map(|(k, l)| energy(l) * matrix[k * n + k]).collect();
    }
    lobes.iter().zip(inverse_diagonal(&factor, n)).map(|(l, d)| energy(l) / d).collect()
}
