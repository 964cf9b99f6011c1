//! Checking and converting the matrices in camera files.

use glam::{Affine3A, DMat3, DVec3};

/// How far RᵀR may be from the identity, in any entry, before a matrix counts as not rigid: numbers
/// with 3 decimals are as far off, and some with 2.
const RIGID_TOLERANCE: f64 = 5e-3;
/// How far it may be before the user is told of it.
pub(super) const PRECISE: f64 = 1e-3;
/// How far it is at most if the matrix of a rotation has 2 decimals.
const MOST_ROUNDED: f64 = 0.02;

/// A rigid transform x ↦ `rotation` x + `translation`, in f64.
#[derive(Clone, Copy, Debug)]
pub(super) struct Rigid {
    pub rotation: DMat3,
    pub translation: DVec3,
    /// How far RᵀR was from the identity, in any entry, before the rotation was made exact.
    pub error: f64,
}

impl Rigid {
    /// From an exact rotation.
    pub fn new(rotation: DMat3, translation: DVec3) -> Self {
        Self { rotation, translation, error: 0.0 }
    }

    /// From a row-major 4×4 matrix. A rotation with an error below 5e-3 is replaced by the nearest
    /// exact one. `Err` is a clause that follows the name of the matrix: "is singular".
    pub fn from_rows(rows: &[f64]) -> Result<Self, String> {
        check_matrix(rows)?;
        if rows[12..] != [0.0, 0.0, 0.0, 1.0] {
            return Err(format!("has {:?} as its last row, not 0, 0, 0, 1 (is it transposed?)", &rows[12..]));
        }
        let row = |i: usize| DVec3::new(rows[4 * i], rows[4 * i + 1], rows[4 * i + 2]);
        let linear = DMat3::from_cols(row(0), row(1), row(2)).transpose();
        let translation = DVec3::new(rows[3], rows[7], rows[11]);
        let (rotation, error) = nearest_rotation(linear)?;
        Ok(Self { rotation, translation, error })
    }

    pub fn inverse(self) -> Self {
        let rotation = self.rotation.transpose();
        Self { rotation, translation: -(rotation * self.translation), ..self }
    }

    /// Returns the camera in OpenCV axes, if this is world_from_camera in OpenGL axes (y up, z
    /// backward).
    pub fn in_opencv_axes(self) -> Self {
        let flip = DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));
        Self { rotation: self.rotation * flip, ..self }
    }

    pub fn to_affine(self) -> Affine3A {
        Affine3A { matrix3: self.rotation.as_mat3().into(), translation: self.translation.as_vec3().into() }
    }
}

/// Refuses the first number of rows of four that is not finite.
pub(super) fn check_finite(rows: &[f64], is_finite: fn(f64) -> bool) -> Result<(), String> {
    rows.iter().position(|&value| !is_finite(value)).map_or(Ok(()), |i| {
        Err(format!("has a NaN or infinite value in row {}, column {}", i / 4 + 1, i % 4 + 1))
    })
}

/// Refuses what is not a 4×4 matrix of numbers in the range of `f32`.
pub(super) fn check_matrix(rows: &[f64]) -> Result<(), String> {
    if rows.len() != 16 {
        return Err(format!("has {} numbers, not 16", rows.len()));
    }
    check_finite(rows, |value| (value as f32).is_finite())
}

/// The nearest rotation, and how far the matrix times its transpose is from the identity.
fn nearest_rotation(linear: DMat3) -> Result<(DMat3, f64), String> {
    let size = (0..3).map(|i| linear.col(i).length_squared()).sum::<f64>().sqrt() / 3f64.sqrt();
    let determinant = linear.determinant();
    if determinant.abs() <= 1e-6 * size.powi(3) {
        return Err("is singular".into());
    }
    let error = (linear.transpose() * linear - DMat3::IDENTITY).to_cols_array();
    let error = error.into_iter().fold(0.0, |worst: f64, value| worst.max(value.abs()));
    if error >= RIGID_TOLERANCE {
        let is_rounded = error < MOST_ROUNDED && has_few_decimals(linear);
        let rounded = if is_rounded { "; it is written with too few decimals: export it with 6" } else { "" };
        return Err(format!(
            "is not rigid: its 3×3 part times its transpose differs from the identity by {error:.2e} (scale {size:.4}){rounded}"
        ));
    }
    if determinant < 0.0 {
        return Err("is a reflection (determinant −1)".into());
    }
    // Newton's iteration for the polar factor (Higham 1986); the error squares each time.
    Ok(((0..4).fold(linear, |r, _| (r + r.inverse().transpose()) * 0.5), error))
}

/// Whether all numbers of a matrix have at most 2 decimals, and not all are whole.
fn has_few_decimals(linear: DMat3) -> bool {
    let is_multiple =
        |of: f64| linear.to_cols_array().iter().all(|v| (of * v - (of * v).round()).abs() < 1e-6);
    is_multiple(100.0) && !is_multiple(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    const IDENTITY: [f64; 16] =
        [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0];

    fn with(i: usize, value: f64) -> Result<Rigid, String> {
        let mut rows = IDENTITY;
        rows[i] = value;
        Rigid::from_rows(&rows)
    }

    #[test]
    fn what_is_no_rigid_transform_is_refused() {
        for (i, value, words) in [
            (0, 0.0, "singular"),
            (0, 1.01, "not rigid"),
            (1, 0.01, "too few decimals: export it with 6"),
            (10, -1.0, "reflection"),
            (6, f64::NAN, "row 2, column 3"),
            (3, 1e300, "row 1, column 4"),
            (12, 1.0, "last row"),
        ] {
            let problem = with(i, value).unwrap_err();
            assert!(problem.contains(words), "{problem}");
        }
        // A scale of 1 % is none of rounding.
        let mut rows = IDENTITY.map(|value| value * 1.0123);
        rows[15] = 1.0;
        assert!(!Rigid::from_rows(&rows).unwrap_err().contains("decimals"));
    }

    #[test]
    fn small_errors_are_made_good() {
        let shared = with(1, 4.9e-3).unwrap();
        assert!((shared.error - 4.9e-3).abs() < 1e-4);
        // The nearest rotation shares the error out.
        assert!((shared.rotation.col(1).x - 2.45e-3).abs() < 1e-6, "{}", shared.rotation);
        let off = (shared.rotation.transpose() * shared.rotation - DMat3::IDENTITY).to_cols_array();
        assert!(off.iter().all(|value| value.abs() < 1e-14), "{off:?}");
    }
}
