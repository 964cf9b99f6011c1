//! The image loss and its adjoint; how a fit explains each photograph, from its last visit to every
//! pixel: what a report names views by.

use crate::fit::exposure::Exposures;
use bevy_ecs::prelude::{Res, ResMut, Resource, With, World};
use glam::Vec3;
use lobelia_geometry::{Result, view::ViewIndex};
use lobelia_sg::color::{luminance, srgb_from_linear};
use lobelia_sg::shading::{Layers, RadianceAdjoint};
use lobelia_world::pipeline::SystemResult;
use lobelia_world::sample::pixel::{Observed, PixelOf};
use lobelia_world::sample::{Observation, ObservationIndex, Samples};
use serde::{Deserialize, Serialize};

/// The function that a fit minimizes, averaged over pixels and channels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
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

/// Radiance of a point: the sum of its layers.
pub(crate) fn radiance(layers: &Layers) -> Vec3 {
    Vec3::from(layers.diffuse) + Vec3::from(layers.specular)
}

/// Writes the adjoint of the mean loss over these pixels and returns their sums. `exposure` are the
/// exposure factors of a pixel's photograph.
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
        let predicted = exposure * radiance(layers);
        for c in 0..3 {
            let (predicted, difference) = (predicted[c], observed.difference(c, predicted[c]));
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

/// Difference of sRGB luminance from which on a pixel is an outlier.
pub(crate) const OUTLIER: f32 = 0.1;

/// Sums over the pixels of one photograph.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ViewSum {
    /// Pixels that the fit may visit: they show the object, and their rays meet the surface.
    pub pool: u64,
    /// Pixels that are summed here.
    pub pixels: u64,
    /// Squared differences after clipping to `[0, 1]`, over three channels.
    pub squares: f64,
    /// Pixels whose difference is above 0.1.
    pub outliers: u64,
    /// Luminance of the photograph.
    pub observed: f64,
}

impl ViewSum {
    /// PSNR in dB; `None` without pixels.
    pub fn psnr(&self) -> Option<f64> {
        let mean = self.squares / (3 * self.pixels) as f64;
        (self.pixels > 0).then(|| -10.0 * mean.max(1e-10).log10())
    }

    /// Share of outliers; `None` without pixels.
    pub fn outlier_share(&self) -> Option<f64> {
        (self.pixels > 0).then(|| self.outliers as f64 / self.pixels as f64)
    }
}

/// The sums of all photographs, by [`ViewIndex`].
#[derive(Resource, Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ViewSums {
    /// Whether this step is one of the last visit.
    pub(super) counts: bool,
    /// By [`ViewIndex`]; views beyond its end have nothing.
    pub views: Vec<ViewSum>,
}

impl ViewSums {
    /// The sums of one view.
    pub fn of(&self, view: ViewIndex) -> ViewSum {
        self.views.get(view.0 as usize).copied().unwrap_or_default()
    }

    fn at(&mut self, view: ViewIndex) -> &mut ViewSum {
        let index = view.0 as usize;
        if index >= self.views.len() {
            self.views.resize(index + 1, ViewSum::default());
        }
        &mut self.views[index]
    }
}

/// Luminance with the curve of sRGB.
pub(crate) fn coded_luminance(radiance: Vec3) -> f32 {
    srgb_from_linear(luminance(radiance).clamp(0.0, 1.0))
}

/// Whether a pixel is an outlier.
pub fn is_outlier(predicted: Vec3, observed: Vec3) -> bool {
    (coded_luminance(predicted) - coded_luminance(observed)).abs() > OUTLIER
}

/// Loss: adds the pixels of the step, in the last visit to the pool.
pub fn sum_by_view(
    exposures: Res<Exposures>,
    mut sums: ResMut<ViewSums>,
    samples: Samples<(&PixelOf, &Layers, &Observed)>,
) -> SystemResult {
    if sums.counts { Ok(add_step(&mut sums, &exposures, samples)?) } else { Ok(()) }
}

/// The pixels of the last step alone, by photograph.
pub fn sums_of_step(
    exposures: Res<Exposures>,
    samples: Samples<(&PixelOf, &Layers, &Observed)>,
) -> Result<ViewSums> {
    let mut sums = ViewSums::default();
    add_step(&mut sums, &exposures, samples)?;
    Ok(sums)
}

fn add_step(
    sums: &mut ViewSums,
    exposures: &Exposures,
    samples: Samples<(&PixelOf, &Layers, &Observed)>,
) -> Result<()> {
    let (pixels, shaded, observed) = samples.columns()?;
    for ((pixel, shaded), observed) in pixels.iter().zip(&*shaded).zip(&*observed) {
        let predicted = exposures.factor(pixel.view) * radiance(shaded);
        let difference = |c: usize| match observed.difference(c, predicted[c]) {
            // A saturated channel that is predicted brighter is right.
            0.0 => 0.0,
            _ => predicted[c].clamp(0.0, 1.0) - observed.radiance[c].clamp(0.0, 1.0),
        };
        let sum = sums.at(pixel.view);
        sum.pixels += 1;
        sum.squares += (0..3).map(|c| f64::from(difference(c)).powi(2)).sum::<f64>();
        sum.outliers += u64::from(is_outlier(predicted, observed.radiance));
        sum.observed += f64::from(luminance(observed.radiance));
    }
    Ok(())
}

/// Counts the pixels of each view that a fit may visit, and forgets all other sums.
pub(super) fn count_pool(world: &mut World) {
    let mut sums = ViewSums::default();
    let mut rows = world.query_filtered::<&Observation, With<ObservationIndex>>();
    rows.iter(world).for_each(|row| sums.at(row.pixel.view).pool += 1);
    world.insert_resource(sums);
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

    #[test]
    fn adjoint_agrees_with_central_differences() {
        let layers = |x: f32| Layers { diffuse: [x, 0.2, 0.5], specular: [0.1, 0.0, 0.0] };
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
