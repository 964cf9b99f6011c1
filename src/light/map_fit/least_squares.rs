//! Dense linear algebra of the map fit: a Cholesky solver and non-negative least squares.

use fearless_simd::{Level, dispatch};
use rayon::prelude::*;
use std::ops::Range;

/// Rows factored together, so that the rows below them can be done in parallel.
const PANEL: usize = 32;

/// Factors the symmetric positive definite `matrix` (n × n, row by row; the lower triangle is read) in place into L with
/// matrix = L Lᵀ; false if it is not positive definite.
pub(crate) fn cholesky(matrix: &mut [f64], n: usize) -> bool {
    for start in (0..n).step_by(PANEL) {
        let end = (start + PANEL).min(n);
        let (head, tail) = matrix.split_at_mut(end * n);
        for i in start..end {
            let (above, row) = head.split_at_mut(i * n);
            dispatch!(Level::new(), _simd => eliminate(row, above, n, start..i));
            let pivot = row[i] - product(&row[..i], &row[..i]);
            if pivot.is_nan() || pivot <= 0.0 {
                return false;
            }
            row[i] = pivot.sqrt();
        }
        tail.par_chunks_mut(n)
            .with_min_len(8)
            .for_each(|row| dispatch!(Level::new(), _simd => eliminate(row, head, n, start..end)));
    }
    true
}

/// Entries `columns` of a row of L, from those before them and the rows `above`.
#[inline(always)]
fn eliminate(row: &mut [f64], above: &[f64], n: usize, columns: Range<usize>) {
    for j in columns {
        row[j] = (row[j] - product(&row[..j], &above[j * n..j * n + j])) / above[j * n + j];
    }
}

/// Solves L Lᵀ x = `right` in place.
pub(crate) fn solve_factored(factor: &[f64], right: &mut [f64]) {
    let n = right.len();
    for i in 0..n {
        let row = &factor[i * n..i * n + i];
        right[i] = (right[i] - product(row, &right[..i])) / factor[i * n + i];
    }
    for i in (0..n).rev() {
        right[i] /= factor[i * n + i];
        let value = right[i];
        for (x, l) in right[..i].iter_mut().zip(&factor[i * n..i * n + i]) {
            *x -= l * value;
        }
    }
}

/// Sum of products, in sixteen partial sums of a fixed order.
#[inline(always)]
fn product(a: &[f64], b: &[f64]) -> f64 {
    let (a_whole, a_rest) = a.as_chunks::<16>();
    let (b_whole, b_rest) = b.as_chunks::<16>();
    let mut sums = [0.0; 16];
    for (a, b) in a_whole.iter().zip(b_whole) {
        for k in 0..16 {
            sums[k] += a[k] * b[k];
        }
    }
    let rest: f64 = a_rest.iter().zip(b_rest).map(|(a, b)| a * b).sum();
    sums.iter().sum::<f64>() + rest
}

/// Lowers ½xᵀAx − bᵀx over x ≥ 0 by coordinate descent from the given `x`, with `gradient` = Ax − b.
///
/// `matrix` is n × n and symmetric; `gradient` is updated. Stops when no entry of a sweep lowers the objective by
/// more than 10⁻¹² of the total decrease, or after `sweeps`.
pub(crate) fn descend_nonnegative(matrix: &[f64], x: &mut [f64], gradient: &mut [f64], sweeps: usize) {
    let n = x.len();
    let mut gained = 0.0;
    for _ in 0..sweeps {
        let mut best = 0.0_f64;
        for k in 0..n {
            let row = &matrix[k * n..(k + 1) * n];
            if row[k] <= 0.0 {
                continue;
            }
            let step = (-gradient[k] / row[k]).max(-x[k]);
            if step == 0.0 {
                continue;
            }
            let gain = -step * (gradient[k] + 0.5 * step * row[k]);
            x[k] += step;
            dispatch!(Level::new(), _simd => add_multiple(gradient, row, step));
            best = best.max(gain);
            gained += gain;
        }
        if best <= 1e-12 * gained {
            break;
        }
    }
}

/// sums += factor × row.
#[inline(always)]
fn add_multiple(sums: &mut [f64], row: &[f64], factor: f64) {
    sums.iter_mut().zip(row).for_each(|(sum, a)| *sum += factor * a);
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A well-conditioned symmetric positive definite matrix.
    fn matrix(n: usize) -> Vec<f64> {
        let entry = |k: usize| {
            let (i, j) = (k / n, k % n);
            let wave = ((i * j) as f64 * 0.37).cos() * 0.3 + ((i + j) as f64).sin();
            if i == j { n as f64 + wave } else { wave }
        };
        (0..n * n).map(entry).collect()
    }

    #[test]
    fn cholesky_solves_and_refuses_what_is_not_positive() {
        for n in [1, 5, 33, 100] {
            let a = matrix(n);
            let x: Vec<f64> = (0..n).map(|i| (i as f64 * 1.3).sin()).collect();
            let mut right: Vec<f64> = a.chunks(n).map(|row| product(row, &x)).collect();
            let mut factor = a.clone();
            assert!(cholesky(&mut factor, n));
            solve_factored(&factor, &mut right);
            assert!(right.iter().zip(&x).all(|(a, b)| (a - b).abs() < 1e-10));
        }
        assert!(!cholesky(&mut [1.0, 2.0, 2.0, 1.0], 2));
        assert!(!cholesky(&mut [f64::NAN], 1));
    }

    #[test]
    fn nonnegative_descent_meets_the_optimality_conditions() {
        let n = 20;
        let a = matrix(n);
        let mut x = vec![0.0; n];
        let mut gradient: Vec<f64> = (0..n).map(|i| (i as f64 * 2.1).cos()).collect();
        descend_nonnegative(&a, &mut x, &mut gradient, 500);
        let positive = x.iter().filter(|v| **v > 0.0).count();
        assert!(positive > 3 && positive < n);
        for k in 0..n {
            assert!(x[k] >= 0.0);
            assert!(if x[k] > 0.0 { gradient[k].abs() < 1e-5 } else { gradient[k] > -1e-5 });
        }
    }
}
