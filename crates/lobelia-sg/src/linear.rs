//! Linear systems: a Cholesky solver and non-negative least squares for dense matrices, and
//! conjugate gradients for matrices that are known by their products. Dense matrices are stored row
//! by row; sums are in `f64`.

use crate::dispatch;
use fearless_simd::prelude::*;
use fearless_simd::{Level, f64x8};
use rayon::prelude::*;
use std::ops::Range;

/// Rows factored together, so that the rows below them can be done in parallel.
const PANEL: usize = 32;
/// Rows and columns whose products are summed at once.
const ROWS: usize = 4;
const COLUMNS: usize = 2;
/// Numbers in a vector, of which a panel has a whole number.
const LANES: usize = 8;

/// Factors the symmetric positive definite `matrix` (n × n, row by row; the lower triangle is read)
/// in place into L with matrix = L Lᵀ; false if it is not positive definite.
pub fn cholesky(matrix: &mut [f64], n: usize) -> bool {
    cholesky_at(Level::new(), matrix, n)
}

fn cholesky_at(level: Level, matrix: &mut [f64], n: usize) -> bool {
    for start in (0..n).step_by(PANEL) {
        let end = (start + PANEL).min(n);
        let (head, tail) = matrix.split_at_mut(end * n);
        for i in start..end {
            let (above, row) = head.split_at_mut(i * n);
            dispatch!(level, _simd => eliminate(row, above, n, start..i));
            let pivot = row[i] - product(&row[..i], &row[..i]);
            if pivot.is_nan() || pivot <= 0.0 {
                return false;
            }
            row[i] = pivot.sqrt();
        }
        if tail.is_empty() {
            break;
        }
        let panel =
            Panel { rows: &head[start * n..], n, start, inverse: inverse_of(&head[start * n..], n, start) };
        tail.par_chunks_mut(ROWS * n)
            .with_min_len(4)
            .for_each(|rows| dispatch!(level, simd => panel.eliminate(simd, rows)));
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

/// The inverse of the triangle that `rows`, a whole panel, have from column `start` on, column by
/// column.
fn inverse_of(rows: &[f64], n: usize, start: usize) -> [[f64; PANEL]; PANEL] {
    let mut inverse = [[0.0; PANEL]; PANEL];
    for (k, column) in inverse.iter_mut().enumerate() {
        for j in k..PANEL {
            let row = &rows[j * n + start..][..PANEL];
            let known: f64 = (k..j).map(|i| row[i] * column[i]).sum();
            column[j] = (f64::from(u8::from(j == k)) - known) / row[j];
        }
    }
    inverse
}

/// Rows of L that are known, [`PANEL`] of them.
struct Panel<'a> {
    rows: &'a [f64],
    n: usize,
    /// The column of the first row's diagonal.
    start: usize,
    /// The inverse of the triangle from there on, column by column.
    inverse: [[f64; PANEL]; PANEL],
}

impl Panel<'_> {
    /// Entries of up to [`ROWS`] rows of L in the columns of this panel, from those before them.
    #[inline(always)]
    fn eliminate<S: Simd>(&self, simd: S, rows: &mut [f64]) {
        let Self { n, start, .. } = *self;
        for j in (0..PANEL).step_by(COLUMNS) {
            let above = &self.rows[j * n..(j + COLUMNS) * n];
            if rows.len() == ROWS * n {
                let products = block_products(simd, rows, above, n, start);
                for i in 0..ROWS {
                    for k in 0..COLUMNS {
                        rows[i * n + start + j + k] -= products[i][k];
                    }
                }
            } else {
                for row in rows.chunks_exact_mut(n) {
                    for k in 0..COLUMNS {
                        row[start + j + k] -= product(&row[..start], &above[k * n..k * n + start]);
                    }
                }
            }
        }
        for row in rows.chunks_exact_mut(n) {
            self.divide(simd, &mut row[start..start + PANEL]);
        }
    }

    /// Multiplies entries by the inverse.
    #[inline(always)]
    fn divide<S: Simd>(&self, simd: S, entries: &mut [f64]) {
        let mut sums = [f64x8::splat(simd, 0.0); PANEL / LANES];
        for (entry, column) in entries.iter().zip(&self.inverse) {
            let entry = f64x8::splat(simd, *entry);
            for (at, sum) in sums.iter_mut().enumerate() {
                let column = &column[at * LANES..(at + 1) * LANES];
                *sum = entry.mul_add(f64x8::from_slice(simd, column), *sum);
            }
        }
        for (at, sum) in sums.into_iter().enumerate() {
            sum.store_slice(&mut entries[at * LANES..(at + 1) * LANES]);
        }
    }
}

/// Products of the first `count` entries of [`ROWS`] rows with those of [`COLUMNS`] others: each
/// number that is read serves several sums. `count` is a multiple of [`PANEL`].
#[inline(always)]
fn block_products<S: Simd>(simd: S, a: &[f64], b: &[f64], n: usize, count: usize) -> [[f64; COLUMNS]; ROWS] {
    const { assert!(ROWS == 4 && COLUMNS == 2, "written out below") };
    let mut sums = [[S::f64s::splat(simd, 0.0); COLUMNS]; ROWS];
    let vectors = |row: usize| a[row * n..row * n + count].chunks_exact(S::f64s::LEN);
    let others = b[..count].chunks_exact(S::f64s::LEN).zip(b[n..n + count].chunks_exact(S::f64s::LEN));
    let own = vectors(0).zip(vectors(1)).zip(vectors(2).zip(vectors(3)));
    for ((first, second), ((row_0, row_1), (row_2, row_3))) in others.zip(own) {
        let (first, second) = (S::f64s::from_slice(simd, first), S::f64s::from_slice(simd, second));
        for (row, sums) in [row_0, row_1, row_2, row_3].into_iter().zip(&mut sums) {
            let row = S::f64s::from_slice(simd, row);
            sums[0] = row.mul_add(first, sums[0]);
            sums[1] = row.mul_add(second, sums[1]);
        }
    }
    let mut products = [[0.0; COLUMNS]; ROWS];
    for i in 0..ROWS {
        for j in 0..COLUMNS {
            products[i][j] = sums[i][j].as_slice().iter().sum();
        }
    }
    products
}

/// Solves L Lᵀ x = `right` in place.
pub fn solve_factored(factor: &[f64], right: &mut [f64]) {
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

/// Lowers ½xᵀAx − bᵀx over x ≥ 0 by coordinate descent from the given `x`, with `gradient` = Ax −
/// b.
///
/// `matrix` is n × n and symmetric; `gradient` is updated. Stops when no entry of a sweep lowers
/// the objective by more than 10⁻¹² of the total decrease, or after `sweeps`.
pub fn descend_nonnegative(matrix: &[f64], x: &mut [f64], gradient: &mut [f64], sweeps: usize) {
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
            dispatch!(_simd => add_multiple(gradient, row, step));
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

/// Solution x of A x = `right` for a symmetric positive definite A, given as the function `apply`
/// that multiplies by A, by conjugate gradients from x = 0 with a diagonal preconditioner `scale`.
///
/// Ends when the preconditioned squared residual is at most `tolerance` of that of the start, or
/// after `rounds`.
pub fn conjugate_gradients(
    apply: impl Fn(&[f32]) -> Vec<f32>,
    right: Vec<f32>,
    scale: &[f32],
    tolerance: f64,
    rounds: usize,
) -> Vec<f32> {
    let dot = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| f64::from(a * b)).sum::<f64>();
    let scaled = |r: &[f32]| r.iter().zip(scale).map(|(r, s)| r * s).collect::<Vec<f32>>();
    let (mut x, mut residual) = (vec![0.0; right.len()], right);
    let mut z = scaled(&residual);
    let mut along = z.clone();
    let mut size = dot(&residual, &z);
    let enough = tolerance * size;
    for _ in 0..rounds {
        if size <= enough {
            break;
        }
        let product = apply(&along);
        let step = (size / dot(&along, &product)) as f32;
        x.iter_mut().zip(&along).for_each(|(x, a)| *x += step * a);
        residual.iter_mut().zip(&product).for_each(|(r, p)| *r -= step * p);
        z = scaled(&residual);
        let next = dot(&residual, &z);
        let keep = (next / size) as f32;
        along.iter_mut().zip(&z).for_each(|(a, z)| *a = z + keep * *a);
        size = next;
    }
    x
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
        for (n, level) in
            [1, 5, 32, 33, 67, 96, 101].into_iter().flat_map(|n| [(n, Level::new()), (n, Level::baseline())])
        {
            let a = matrix(n);
            let x: Vec<f64> = (0..n).map(|i| (i as f64 * 1.3).sin()).collect();
            let mut right: Vec<f64> = a.chunks(n).map(|row| product(row, &x)).collect();
            let mut factor = a.clone();
            assert!(cholesky_at(level, &mut factor, n));
            solve_factored(&factor, &mut right);
            assert!(right.iter().zip(&x).all(|(a, b)| (a - b).abs() < 1e-10), "{n}");
            for wrong in [-1.0, f64::NAN] {
                let mut factor = a.clone();
                factor[n * n - 1] = wrong;
                assert!(!cholesky_at(level, &mut factor, n), "{n} {wrong}");
            }
        }
        assert!(!cholesky(&mut [1.0, 2.0, 2.0, 1.0], 2));
    }

    #[test]
    fn a_nearly_singular_matrix_is_the_product_of_its_factors() {
        // Products of Gaussians that overlap nearly all, and the ridge of the map fit.
        let n = 101;
        let entry = |i: usize, j: usize| (-0.002 * (i as f64 - j as f64).powi(2)).exp();
        let a: Vec<f64> =
            (0..n * n).map(|k| entry(k / n, k % n) + if k / n == k % n { 1e-9 } else { 0.0 }).collect();
        let mut factor = a.clone();
        assert!(cholesky(&mut factor, n));
        for (i, j) in (0..n).flat_map(|i| (0..=i).map(move |j| (i, j))) {
            let sum = product(&factor[i * n..=i * n + j], &factor[j * n..=j * n + j]);
            assert!((sum - a[i * n + j]).abs() < 1e-11, "{i} {j}: {sum} {}", a[i * n + j]);
        }
    }

    #[test]
    fn conjugate_gradients_solve() {
        let n = 30;
        let a = matrix(n);
        let apply = |x: &[f32]| -> Vec<f32> {
            let row = |row: &[f64]| row.iter().zip(x).map(|(a, x)| a * f64::from(*x)).sum::<f64>() as f32;
            a.chunks(n).map(row).collect()
        };
        let x: Vec<f32> = (0..n).map(|i| (i as f32 * 1.3).sin()).collect();
        let found = conjugate_gradients(apply, apply(&x), &vec![1.0 / n as f32; n], 1e-12, 100);
        assert!(found.iter().zip(&x).all(|(a, b)| (a - b).abs() < 1e-4), "{found:?}");
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
