//! How a fit explains each photograph, from its last visit to every pixel: what a report names views by.

use super::exposure::Exposures;
use super::guard::StepGuard;
use crate::math::color::{luminance, srgb_from_linear};
use crate::math::shading::Layers;
use crate::pipeline::SystemResult;
use crate::sample::Samples;
use crate::sample::observation::{Observation, ObservationIndex};
use crate::sample::pixel::{Observed, PixelOf};
use crate::view::ViewIndex;
use bevy_ecs::prelude::{Res, ResMut, Resource, With, World};
use glam::Vec3;
use serde::{Deserialize, Serialize};

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

/// Whether a pixel is an outlier.
pub(crate) fn is_outlier(predicted: Vec3, observed: Vec3) -> bool {
    let code = |radiance: Vec3| srgb_from_linear(luminance(radiance).clamp(0.0, 1.0));
    (code(predicted) - code(observed)).abs() > OUTLIER
}

/// Loss: adds the pixels of the step, in the last visit to the pool.
pub fn sum_by_view(
    guard: Res<StepGuard>,
    exposures: Res<Exposures>,
    mut sums: ResMut<ViewSums>,
    samples: Samples<(&PixelOf, &Layers, &Observed)>,
) -> SystemResult {
    if !sums.counts || !guard.is_sound() {
        return Ok(());
    }
    let (pixels, shaded, observed) = samples.columns()?;
    for ((pixel, shaded), observed) in pixels.iter().zip(&*shaded).zip(&*observed) {
        let predicted =
            exposures.factor(pixel.view) * (Vec3::from(shaded.diffuse) + Vec3::from(shaded.specular));
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
