//! Exposure of each photograph as an unknown: a factor on the radiance of the scene.
//!
//! A factor is the weighted least-squares ratio of the photograph to the prediction over recent windows, with weights that
//! minimize the sum of absolute differences (iteratively reweighted least squares), so it needs no rate. The geometric mean of the
//! factors is held at 1: a common factor belongs to the light.

use crate::fit::components::StepRates;
use crate::math::shading::Layers;
use crate::pipeline::SystemResult;
use crate::sample::Samples;
use crate::sample::pixel::{Observed, PixelOf, SATURATION};
use crate::view::ViewIndex;
use bevy_ecs::prelude::{Res, ResMut, Resource};
use serde::{Deserialize, Serialize};

/// Decay factor of the sums, per window.
const MEMORY: f64 = 0.97;
/// Windows before the factors begin to change: the light is fitted first.
const FIRST_STEP: u32 = 50;
/// Differences below this fraction of the prediction have a squared loss.
const SQUARE_BELOW: f32 = 0.03;
/// Range of a factor.
const RANGE: (f32, f32) = (0.2, 5.0);

/// The photographs' exposures.
#[derive(Resource, Clone, Debug, Default, Serialize, Deserialize)]
pub struct Exposures {
    /// Whether they are optimized and used.
    pub unknown: bool,
    /// Factor of each view, by [`ViewIndex`]; empty before the first solve.
    pub factors: Vec<f32>,
    /// Per view: weighted sums of prediction · photograph, and of prediction².
    sums: Vec<(f64, f64)>,
}

impl Exposures {
    /// The factor of a view; 1 if exposures are known.
    #[inline]
    pub fn factor(&self, view: ViewIndex) -> f32 {
        if self.unknown { self.factors.get(view.0 as usize).copied().unwrap_or(1.0) } else { 1.0 }
    }

    /// Adds the pixels of one window.
    fn observe(&mut self, pixels: &[PixelOf], shaded: &[Layers], observed: &[Observed]) {
        self.sums.iter_mut().for_each(|sums| *sums = (MEMORY * sums.0, MEMORY * sums.1));
        for ((pixel, shaded), observed) in pixels.iter().zip(shaded).zip(observed) {
            let view = pixel.view.0 as usize;
            if view >= self.sums.len() {
                self.sums.resize(view + 1, (0.0, 0.0));
                self.factors.resize(view + 1, 1.0);
            }
            for c in 0..3 {
                let (predicted, seen) = (shaded.diffuse[c] + shaded.specular[c], observed.radiance[c]);
                if seen < SATURATION && predicted > 0.0 {
                    let off = (seen - self.factors[view] * predicted).abs().max(SQUARE_BELOW * predicted);
                    let weight = f64::from(predicted / off);
                    self.sums[view].0 += weight * f64::from(seen);
                    self.sums[view].1 += weight * f64::from(predicted);
                }
            }
        }
    }

    /// Computes the factors from the sums; their geometric mean is 1 before clamping to the range.
    fn solve(&mut self) {
        let logs =
            self.sums.iter().filter(|sums| sums.0 > 0.0 && sums.1 > 0.0).map(|sums| (sums.0 / sums.1).ln());
        let count = logs.clone().count().max(1);
        let mean = logs.sum::<f64>() / count as f64;
        for (factor, sums) in self.factors.iter_mut().zip(&self.sums) {
            let known = sums.0 > 0.0 && sums.1 > 0.0;
            let found = if known { ((sums.0 / sums.1).ln() - mean).exp() as f32 } else { 1.0 };
            *factor = found.clamp(RANGE.0, RANGE.1);
        }
    }
}

/// Loss: estimates unknown exposures from the predictions of the window.
pub fn find_exposures(
    rates: Res<StepRates>,
    mut exposures: ResMut<Exposures>,
    samples: Samples<(&PixelOf, &Layers, &Observed)>,
) -> SystemResult {
    if !exposures.unknown {
        return Ok(());
    }
    let (pixels, shaded, observed) = samples.columns()?;
    exposures.observe(&pixels, &shaded, &observed);
    if rates.step >= FIRST_STEP {
        exposures.solve();
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn factors_are_found_in_spite_of_outliers_and_their_mean_is_one() {
        let truth = [0.8f32, 1.25, 1.0];
        let mut exposures = Exposures { unknown: true, ..Exposures::default() };
        assert_eq!(exposures.factor(ViewIndex(7)), 1.0);
        let pixel = |i: usize| PixelOf { view: ViewIndex((i % 3) as u32), pixel: i as u32 };
        let layers = |i: usize| Layers { diffuse: [0.1 + 0.001 * (i % 300) as f32; 3], specular: [0.02; 3] };
        let seen = |i: usize| {
            let shadow = if i.is_multiple_of(5) { 0.4 } else { 1.0 };
            let radiance = truth[i % 3] * shadow * (layers(i).diffuse[0] + 0.02);
            Observed { radiance: glam::Vec3::splat(radiance), saturated: false }
        };
        let pixels: Vec<_> = (0..3000).map(pixel).collect();
        let (shaded, observed): (Vec<_>, Vec<_>) = (0..3000).map(|i| (layers(i), seen(i))).unzip();
        for _ in 0..60 {
            exposures.observe(&pixels, &shaded, &observed);
            exposures.solve();
        }
        for (view, truth) in truth.iter().enumerate() {
            let found = exposures.factor(ViewIndex(view as u32));
            assert!((found - truth).abs() < 0.01, "view {view}: {found} {truth}");
        }
        exposures.unknown = false;
        assert_eq!(exposures.factor(ViewIndex(0)), 1.0);
    }
}
