//! Checking and converting the matrices in camera files.

use glam::{Affine3A, DMat3, DVec3};

/// How far RᵀR may be from the identity, in any entry, before a matrix counts as not rigid.
const RIGID_TOLERANCE: f64 = 1e-3;

/// A rigid transform x ↦ `rotation` x + `translation`, in f64.
#[derive(Clone, Copy, Debug)]
pub(super) struct Rigid {
    pub rotation: DMat3,
    pub translation: DVec3,
}

impl Rigid {
    /// From a row-major 4×4 matrix. A rotation with an error below 1e-3 is replaced by the nearest exact one.
    /// `Err` is a clause that follows the name of the matrix: "is singular".
    pub fn from_rows(rows: &[f64; 16]) -> Result<Self, String> {
        if let Some(i) = rows.iter().position(|value| !(*value as f32).is_finite()) {
            return Err(format!("has a NaN or infinite value in row {}, column {}", i / 4 + 1, i % 4 + 1));
        }
        if rows[12..] != [0.0, 0.0, 0.0, 1.0] {
            return Err(format!("has {:?} as its last row, not 0, 0, 0, 1 (is it transposed?)", &rows[12..]));
        }
        let row = |i: usize| DVec3::new(rows[4 * i], rows[4 * i + 1], rows[4 * i + 2]);
        let linear = DMat3::from_cols(row(0), row(1), row(2)).transpose();
        let translation = DVec3::new(rows[3], rows[7], rows[11]);
        Ok(Self { rotation: nearest_rotation(linear)?, translation })
    }

    pub fn inverse(self) -> Self {
        let rotation = self.rotation.transpose();
        Self { rotation, translation: -(rotation * self.translation) }
    }

    /// The same camera in OpenCV axes, if this is world_from_camera in OpenGL axes (y up, z backward).
    pub fn in_opencv_axes(self) -> Self {
        let flip = DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));
        Self { rotation: self.rotation * flip, translation: self.translation }
    }

    pub fn to_affine(self) -> Affine3A {
        Affine3A { matrix3: self.rotation.as_mat3().into(), translation: self.translation.as_vec3().into() }
    }
}

fn nearest_rotation(linear: DMat3) -> Result<DMat3, String> {
    let size = (0..3).map(|i| linear.col(i).length_squared()).sum::<f64>().sqrt() / 3f64.sqrt();
    let determinant = linear.determinant();
    if determinant.abs() <= 1e-6 * size.powi(3) {
        return Err("is singular".into());
    }
    let error = (linear.transpose() * linear - DMat3::IDENTITY).to_cols_array();
    let error = error.into_iter().fold(0.0, |worst: f64, value| worst.max(value.abs()));
    if error >= RIGID_TOLERANCE {
        return Err(format!(
            "is not rigid: its 3×3 part times its transpose differs from the identity by {error:.2e} (scale {size:.4})"
        ));
    }
    if determinant < 0.0 {
        return Err("is a reflection (determinant −1)".into());
    }
    // Newton's iteration for the polar factor (Higham 1986); the error squares each time.
    Ok((0..4).fold(linear, |r, _| (r + r.inverse().transpose()) * 0.5))
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
    fn small_errors_are_made_good() {
        let rotation = with(1, 4e-4).unwrap().rotation;
        let off = (rotation.transpose() * rotation - DMat3::IDENTITY).to_cols_array();
        assert!(off.iter().all(|value| value.abs() < 1e-15), "{off:?}");
        assert!((rotation.col(1).x - 2e-4).abs() < 1e-7, "the nearest rotation shares the error out");
    }

    #[test]
    fn what_is_no_rigid_transform_is_refused() {
        let problem = |i, value| with(i, value).unwrap_err();
        assert!(problem(0, 0.0).contains("singular"));
        assert!(problem(0, 1.01).contains("not rigid"));
        assert!(problem(1, 0.01).contains("not rigid"));
        assert!(problem(10, -1.0).contains("reflection"));
        assert!(problem(6, f64::NAN).contains("row 2, column 3"));
        assert!(problem(3, 1e300).contains("row 1, column 4"));
        assert!(problem(12, 1.0).contains("last row"));
    }

    #[test]
    fn inverse_undoes() {
        let rotation = DMat3::from_rotation_y(0.4) * DMat3::from_rotation_x(1.0);
        let rigid = Rigid { rotation, translation: DVec3::new(1.0, -2.0, 0.5) };
        let point = DVec3::new(0.3, 0.2, -5.0);
        let there = rigid.rotation * point + rigid.translation;
        let back = rigid.inverse();
        assert!((back.rotation * there + back.translation).distance(point) < 1e-14);
    }
}
