//! The image loss and its adjoint.

use crate::math::shading::{Layers, RadianceAdjoint};
use crate::sample::pixel::Observed;
use glam::Vec3;
use serde::{Deserialize, Serialize};

/// The function that a fit minimizes, averaged over pixels and channels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[non_exhaustive]
pub enum Loss {
    /// Absolute difference of linear radiance.
    #[default]
    L1,
    /// Squared difference of linear radiance.
    L2,
}

/// Sums over the pixels of one window.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LossSums {
    /// Sum of the loss over pixels and channels.
    pub loss: f64,
    /// Sum of squared differences after clipping both to `[0, 1]`, for PSNR.
    pub clipped_squares: f64,
    /// Number of pixels.
    pub pixels: usize,
}

impl LossSums {
    /// Mean loss over pixels and channels.
    pub fn mean(&self) -> f64 {
        self.loss / (3 * self.pixels.max(1)) as f64
    }

    /// PSNR in dB of the clipped radiance.
    pub fn psnr(&self) -> f64 {
        -10.0 * (self.clipped_squares / (3 * self.pixels.max(1)) as f64).max(1e-10).log10()
    }

    /// The total of both sums.
    pub fn merged(self, other: Self) -> Self {
        Self {
            loss: self.loss + other.loss,
            clipped_squares: self.clipped_squares + other.clipped_squares,
            pixels: self.pixels + other.pixels,
        }
    }
}

/// Writes the adjoint of the mean loss over these pixels and returns their sums. `exposure` are the exposure
/// factors of a pixel's photograph.
pub fn image_loss(
    loss: Loss,
    shaded: &[Layers],
    observed: &[Observed],
    exposure: impl Fn(usize) -> Vec3,
    adjoint: &mut [RadianceAdjoint],
) -> LossSums {
    let weight = 1.0 / (3 * shaded.len().max(1)) as f32;
    let mut sums = LossSums { pixels: shaded.len(), ..Default::default() };
    for (i, ((layers, observed), adjoint)) in shaded.iter().zip(observed).zip(adjoint).enumerate() {
        let exposure = exposure(i);
        for c in 0..3 {
            let predicted = exposure[c] * (layers.diffuse[c] + layers.specular[c]);
            let difference = observed.difference(c, predicted);
            let (value, slope) = match loss {
                Loss::L1 => (difference.abs(), if difference == 0.0 { 0.0 } else { difference.signum() }),
                Loss::L2 => (difference * difference, 2.0 * difference),
            };
            sums.loss += f64::from(value);
            let clipped = predicted.clamp(0.0, 1.0) - observed.radiance[c].clamp(0.0, 1.0);
            sums.clipped_squares += f64::from(clipped * clipped);
            adjoint.0[c] = exposure[c] * slope * weight;
        }
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::*;

    fn seen(radiance: [f32; 3]) -> Observed {
        Observed { radiance: radiance.into(), saturated: false }
    }

    #[test]
    fn a_saturated_channel_may_be_any_amount_brighter() {
        let observed = [Observed { radiance: [1.0, 0.1, 1.0].into(), saturated: true }];
        let shaded = [Layers { diffuse: [7.0, 0.3, 0.4], specular: [0.0; 3] }];
        let mut adjoint = [RadianceAdjoint::default()];
        let sums = image_loss(Loss::L1, &shaded, &observed, |_| Vec3::ONE, &mut adjoint);
        assert!((sums.loss - 0.8).abs() < 1e-6);
        assert!(adjoint[0].0[0] == 0.0 && adjoint[0].0[1] > 0.0 && adjoint[0].0[2] < 0.0);
    }

    fn layers(x: f32) -> Layers {
        Layers { diffuse: [x, 0.2, 0.5], specular: [0.1, 0.0, 0.0] }
    }

    #[test]
    fn adjoint_agrees_with_central_differences() {
        let observed = [seen([0.4, 0.1, 0.9]), seen([0.0, 0.3, 0.2])];
        for loss in [Loss::L1, Loss::L2] {
            let mean = |x: f32| {
                let mut adjoint = [RadianceAdjoint::default(); 2];
                let exposure = |i: usize| [Vec3::new(0.8, 1.0, 1.1), Vec3::splat(1.3)][i];
                let sums = image_loss(loss, &[layers(x), layers(0.7)], &observed, exposure, &mut adjoint);
                (sums.mean(), adjoint[0].0[0])
            };
            let difference = (mean(0.61).0 - mean(0.59).0) / 0.02;
            assert!((difference as f32 - mean(0.6).1).abs() < 1e-5);
        }
    }

    #[test]
    fn psnr_is_that_of_clipped_radiance() {
        let shaded = [Layers { diffuse: [3.0, 0.5, 0.5], specular: [0.0; 3] }];
        let observed = [seen([2.0, 0.5, 0.4])];
        let sums = image_loss(Loss::L2, &shaded, &observed, |_| Vec3::ONE, &mut [RadianceAdjoint::default()]);
        let expected = -10.0 * (0.01f64 / 3.0).log10();
        assert!((sums.psnr() - expected).abs() < 1e-4);
    }
}
