//! Angles between predicted and true normals.

use crate::report::metrics::{ImagePair, median};

/// Collects the angles of any number of views: four bytes per pixel that counts.
#[derive(Clone, Debug, Default)]
pub struct NormalAngles {
    /// Radians, in the order of the pixels.
    angles: Vec<f32>,
    /// Their sum.
    sum: f64,
}

impl NormalAngles {
    /// Adds the pixels of a view that count. Both normals are normalized first (truth is an average over a pixel); a pixel where
    /// either is zero is unknown and skipped.
    pub fn add(&mut self, pair: &ImagePair) {
        for (prediction, truth) in pair.counted() {
            if prediction.length_squared() > 1e-12 && truth.length_squared() > 1e-12 {
                // atan2 is exact for small angles, where acos of a dot product is not.
                let angle = prediction.cross(truth).length().atan2(prediction.dot(truth));
                self.angles.push(angle as f32);
                self.sum += angle;
            }
        }
    }

    /// Number of pixels.
    pub fn pixels(&self) -> usize {
        self.angles.len()
    }

    /// Mean angle in degrees; `None` without pixels.
    pub fn mean_degrees(&self) -> Option<f64> {
        (!self.angles.is_empty()).then(|| (self.sum / self.angles.len() as f64).to_degrees())
    }

    /// Median angle in degrees; `None` without pixels.
    pub fn median_degrees(mut self) -> Option<f64> {
        median(&mut self.angles).map(f64::to_degrees)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    fn angles(prediction: &[Vec3; 4]) -> NormalAngles {
        let truth = [Vec3::X * 0.5, Vec3::X, Vec3::X, Vec3::X];
        let mut angles = NormalAngles::default();
        angles.add(&ImagePair::new([2, 2], prediction, &truth, &[true; 4]).unwrap());
        angles
    }

    #[test]
    fn angles_by_hand() {
        // 0°, 90°, 45° and one without a normal.
        let found = angles(&[Vec3::X, Vec3::Y * 3.0, Vec3::new(1.0, 1.0, 0.0), Vec3::ZERO]);
        assert_eq!(found.pixels(), 3);
        assert!((found.mean_degrees().unwrap() - 45.0).abs() < 1e-6);
        assert!((found.median_degrees().unwrap() - 45.0).abs() < 1e-5);
        // 0°, 0°, 90° and 180°: the mean is 67.5°, the median 45°.
        let found = angles(&[Vec3::X, Vec3::X, Vec3::Y, Vec3::NEG_X]);
        assert!((found.mean_degrees().unwrap() - 67.5).abs() < 1e-6);
        assert!((found.median_degrees().unwrap() - 45.0).abs() < 1e-5);
    }

    #[test]
    fn no_pixel_has_no_angle() {
        let none = angles(&[Vec3::ZERO; 4]);
        assert_eq!((none.pixels(), none.mean_degrees()), (0, None));
        assert_eq!(none.median_degrees(), None);
    }
}
