//! Exposure and white balance of each photograph as unknowns: factors on the radiance of the scene.
//!
//! A factor is the weighted least-squares ratio of the photograph to the prediction over recent windows, with weights that
//! minimize the sum of absolute differences (iteratively reweighted least squares), so it needs no rate. The geometric mean of the
//! factors is held at 1: a common factor belongs to the light.
//!
//! | name | unit | value | meaning |
//! | --- | --- | --- | --- |
//! | `DECIDED_AT` | step | 100 | when [`ExposureChoice::Auto`] decides |
//! | `DIFFERENT` | | 0.1 | difference of the logarithm from the median, of a fifth of the photographs at least, from which their brightness is unknown |
//! | `COLORED` | | 0.05 | the same of a channel beside the mean of the channels, from which their color is |

use crate::fit::components::StepRates;
use crate::math::shading::Layers;
use crate::math::statistics::quantile;
use crate::pipeline::SystemResult;
use crate::sample::Samples;
use crate::sample::pixel::{Observed, PixelOf, SATURATION};
use crate::view::ViewIndex;
use bevy_ecs::prelude::{Res, ResMut, Resource};
use glam::{DVec3, Vec3};
use serde::{Deserialize, Serialize};

/// Decay factor of the sums, per window.
const MEMORY: f64 = 0.97;
/// Windows before the factors begin to change: the light is fitted first.
const FIRST_STEP: u32 = 50;
/// Differences below this fraction of the prediction have a squared loss.
const SQUARE_BELOW: f32 = 0.03;
/// Range of a factor.
const RANGE: (f32, f32) = (0.2, 5.0);
/// The step after which it is decided whether photographs differ.
const DECIDED_AT: u32 = 100;
/// Difference of the logarithm of the brightness of photographs that differ.
const DIFFERENT: f32 = 0.1;
/// Difference of the logarithm of a channel from their mean.
const COLORED: f32 = 0.05;
/// Part of the photographs that are nearer to the median.
const ALIKE: f32 = 0.8;

/// Whether photographs have exposures of their own: factors on their radiance, 0.2 to 5, of which the geometric mean is 1. Views are
/// rendered without.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum ExposureChoice {
    /// A fit decides after 100 steps: unknown if a fifth of the photographs are brighter or darker than the fit explains by 10 %, with a color
    /// if a channel is by 5 %. The default.
    #[default]
    Auto,
    /// All photographs have the same exposure and white balance.
    Equal,
    /// One factor for each photograph: its exposure differs.
    Brightness,
    /// One factor for each photograph and channel: its white balance differs as well.
    Color,
}

/// The photographs' exposures.
#[derive(Resource, Clone, Debug, Default, Serialize, Deserialize)]
pub struct Exposures {
    /// What is used now; `Auto` before it is decided, which is as `Equal`.
    pub used: ExposureChoice,
    /// Factors of each view, by [`ViewIndex`]; empty before the first solve.
    pub factors: Vec<Vec3>,
    /// Per view and channel: weighted sums of prediction · photograph, and of prediction².
    sums: Vec<[(f64, f64); 3]>,
}

impl Exposures {
    /// What a fit begins with: with `Auto`, that which was decided before it.
    pub fn begin(&mut self, choice: ExposureChoice) {
        if choice != ExposureChoice::Auto {
            self.used = choice;
        } else if self.used == ExposureChoice::Equal {
            self.used = ExposureChoice::Auto;
        }
    }

    /// Whether photographs have factors of their own.
    pub fn are_unknown(&self) -> bool {
        matches!(self.used, ExposureChoice::Brightness | ExposureChoice::Color)
    }

    /// The factors of a view; 1 if exposures are known.
    #[inline]
    pub fn factor(&self, view: ViewIndex) -> Vec3 {
        let found = || self.factors.get(view.0 as usize).copied().unwrap_or(Vec3::ONE);
        if self.are_unknown() { found() } else { Vec3::ONE }
    }

    /// Adds the pixels of one window.
    fn observe(&mut self, pixels: &[PixelOf], shaded: &[Layers], observed: &[Observed]) {
        self.sums.iter_mut().flatten().for_each(|sums| *sums = (MEMORY * sums.0, MEMORY * sums.1));
        for ((pixel, shaded), observed) in pixels.iter().zip(shaded).zip(observed) {
            let view = pixel.view.0 as usize;
            if view >= self.sums.len() {
                self.sums.resize(view + 1, [(0.0, 0.0); 3]);
                self.factors.resize(view + 1, Vec3::ONE);
            }
            for c in 0..3 {
                let (predicted, seen) = (shaded.diffuse[c] + shaded.specular[c], observed.radiance[c]);
                if seen < SATURATION && predicted > 0.0 {
                    let off = (seen - self.factors[view][c] * predicted).abs().max(SQUARE_BELOW * predicted);
                    let weight = f64::from(predicted / off);
                    self.sums[view][c].0 += weight * f64::from(seen);
                    self.sums[view][c].1 += weight * f64::from(predicted);
                }
            }
        }
    }

    /// The logarithms of the ratios of each view, less their means over the views; `None` for a view of which too little is seen.
    fn logs(&self) -> Vec<Option<DVec3>> {
        let log = |sums: &[(f64, f64); 3]| {
            let known = sums.iter().all(|sums| sums.0 > 0.0 && sums.1 > 0.0);
            known.then(|| DVec3::from(sums.map(|sums| (sums.0 / sums.1).ln())))
        };
        let logs: Vec<Option<DVec3>> = self.sums.iter().map(log).collect();
        let count = logs.iter().flatten().count().max(1);
        let mean = logs.iter().flatten().sum::<DVec3>() / count as f64;
        logs.into_iter().map(|log| Some(log? - mean)).collect()
    }

    /// Computes the factors from the sums; their geometric mean is 1 before clamping to the range.
    fn solve(&mut self) {
        let is_colored = self.used == ExposureChoice::Color;
        let used = |log: DVec3| if is_colored { log } else { DVec3::splat(log.element_sum() / 3.0) };
        let factor = |log: Option<DVec3>| log.map_or(DVec3::ONE, |log| used(log).exp()).as_vec3();
        let in_range = |factor: Vec3| factor.clamp(Vec3::splat(RANGE.0), Vec3::splat(RANGE.1));
        self.factors = self.logs().into_iter().map(|log| in_range(factor(log))).collect();
    }

    /// Decides what is used by how much most photographs differ.
    fn decide(&mut self) {
        let logs: Vec<DVec3> = self.logs().into_iter().flatten().collect();
        let gray = |log: &DVec3| (log.element_sum() / 3.0) as f32;
        let apart = spread(logs.iter().map(gray));
        let channel = |c: usize| spread(logs.iter().map(move |log| log[c] as f32 - gray(log)));
        let is_colored = (0..3).any(|c| channel(c) > COLORED);
        self.used = match (is_colored, apart > DIFFERENT) {
            (true, _) => ExposureChoice::Color,
            (false, true) => ExposureChoice::Brightness,
            (false, false) => ExposureChoice::Equal,
        };
    }
}

/// The difference from the median that [`ALIKE`] of some numbers do not reach.
fn spread(values: impl Iterator<Item = f32>) -> f32 {
    let mut values: Vec<f32> = values.collect();
    let middle = quantile(&mut values, 0.5).unwrap_or(0.0);
    values.iter_mut().for_each(|value| *value = (*value - middle).abs());
    quantile(&mut values, ALIKE).unwrap_or(0.0)
}

/// Loss: estimates unknown exposures from the predictions of the window, and decides whether they are unknown.
pub fn find_exposures(
    rates: Res<StepRates>,
    mut exposures: ResMut<Exposures>,
    samples: Samples<(&PixelOf, &Layers, &Observed)>,
) -> SystemResult {
    if exposures.used == ExposureChoice::Equal {
        return Ok(());
    }
    let (pixels, shaded, observed) = samples.columns()?;
    exposures.observe(&pixels, &shaded, &observed);
    if exposures.used == ExposureChoice::Auto && rates.step >= DECIDED_AT {
        exposures.decide();
    }
    if rates.step >= FIRST_STEP && exposures.are_unknown() {
        exposures.solve();
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The exposures after many windows of views with these factors, a fifth of whose pixels are in a shadow.
    fn found(truth: &[Vec3], used: ExposureChoice) -> Exposures {
        let views = truth.len();
        let mut exposures = Exposures { used, ..Exposures::default() };
        let pixel = |i: usize| PixelOf { view: ViewIndex((i % views) as u32), pixel: i as u32 };
        let layers = |i: usize| Layers { diffuse: [0.1 + 0.001 * (i % 300) as f32; 3], specular: [0.02; 3] };
        let seen = |i: usize| {
            let shadow = if (i / views).is_multiple_of(5) { 0.4 } else { 1.0 };
            let radiance = truth[i % views] * shadow * (layers(i).diffuse[0] + 0.02);
            Observed { radiance, saturated: false }
        };
        let pixels: Vec<_> = (0..1000 * views).map(pixel).collect();
        let (shaded, observed): (Vec<_>, Vec<_>) = (0..1000 * views).map(|i| (layers(i), seen(i))).unzip();
        for _ in 0..60 {
            exposures.observe(&pixels, &shaded, &observed);
            exposures.solve();
        }
        exposures
    }

    #[test]
    fn factors_are_found_in_spite_of_outliers_and_their_mean_is_one() {
        assert_eq!(Exposures::default().factor(ViewIndex(7)), Vec3::ONE);
        let truth = [Vec3::splat(0.8), Vec3::splat(1.25), Vec3::ONE];
        let mut exposures = found(&truth, ExposureChoice::Brightness);
        for (view, truth) in truth.iter().enumerate() {
            let found = exposures.factor(ViewIndex(view as u32));
            assert!(found.abs_diff_eq(*truth, 0.01), "view {view}: {found} {truth}");
        }
        exposures.used = ExposureChoice::Equal;
        assert_eq!(exposures.factor(ViewIndex(0)), Vec3::ONE);
    }

    #[test]
    fn the_color_of_photographs_is_found_if_it_is_unknown() {
        let truth = [Vec3::new(0.8, 1.0, 1.25), Vec3::new(1.25, 1.0, 0.8), Vec3::ONE];
        let colored = found(&truth, ExposureChoice::Color);
        let gray = found(&truth, ExposureChoice::Brightness);
        for (view, truth) in truth.iter().enumerate() {
            let view = ViewIndex(view as u32);
            assert!(colored.factor(view).abs_diff_eq(*truth, 0.01), "{}", colored.factor(view));
            assert!(gray.factor(view).abs_diff_eq(Vec3::ONE, 0.03), "{}", gray.factor(view));
        }
    }

    #[test]
    fn what_most_photographs_are_like_decides() {
        let decided = |truth: &[Vec3]| {
            let mut exposures = found(truth, ExposureChoice::Auto);
            exposures.decide();
            exposures.used
        };
        let with = |value: Vec3, every: usize| -> Vec<Vec3> {
            (0..12).map(|i| if i % every == 0 { value } else { Vec3::ONE }).collect()
        };
        assert_eq!(decided(&with(Vec3::splat(1.05), 2)), ExposureChoice::Equal);
        assert_eq!(decided(&with(Vec3::splat(1.3), 3)), ExposureChoice::Brightness);
        assert_eq!(decided(&with(Vec3::new(1.2, 1.0, 0.85), 3)), ExposureChoice::Color);
        // A single photograph may show something else.
        assert_eq!(decided(&with(Vec3::splat(2.0), 12)), ExposureChoice::Equal);
    }

    #[test]
    fn a_decision_holds_for_the_fits_that_follow() {
        let mut exposures = Exposures { used: ExposureChoice::Color, ..Exposures::default() };
        exposures.begin(ExposureChoice::Auto);
        assert_eq!(exposures.used, ExposureChoice::Color);
        exposures.begin(ExposureChoice::Equal);
        assert!(!exposures.are_unknown());
        // That they are alike was said for that fit alone.
        exposures.begin(ExposureChoice::Auto);
        assert_eq!(exposures.used, ExposureChoice::Auto);
    }
}
