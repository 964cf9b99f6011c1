//! Exposure and white balance of each photograph as unknowns: factors on the radiance of the scene.
//!
//! A factor is the weighted least-squares ratio of the photograph to the prediction over recent
//! windows, with weights that minimize the sum of absolute differences (iteratively reweighted
//! least squares), so it needs no rate. The geometric mean of the factors of the photographs under
//! a light is held at 1: a common factor belongs to the light.

use crate::fit::components::StepRates;
use bevy_ecs::prelude::{Res, ResMut, Resource};
use glam::{DVec3, Vec3};
use lobelia_geometry::view::ViewIndex;
use lobelia_sg::{shading::Layers, statistics::quantile};
use lobelia_world::sample::pixel::{Observed, PixelOf, SATURATION};
use lobelia_world::{light::placement::LightGroup, pipeline::SystemResult, sample::Samples};
use serde::{Deserialize, Serialize};

/// Decay factor of the sums, per window.
const MEMORY: f64 = 0.97;
/// Windows before the factors begin to change: the light is fitted first.
const FIRST_STEP: u32 = 50;
/// Differences below this fraction of the prediction have a squared loss.
const SQUARE_BELOW: f32 = 0.03;
/// Range of a factor.
const RANGE: (f32, f32) = (0.2, 5.0);
/// The step after which [`ExposureChoice::Auto`] decides whether photographs differ: before the
/// errors are measured by which materials are chosen.
const DECIDED_AT: u32 = 60;
/// Difference of the logarithm from the median, of a fifth of the photographs at least, from which
/// their brightness is unknown.
const DIFFERENT: f32 = 0.1;
/// The same of a channel beside the brightness, from which their color is.
const COLORED: f32 = 0.05;
/// Signal of a channel, relative to the strongest, below which it says nothing of color.
const FAINT: f64 = 0.1;
/// Signal of a photograph, relative to the mean of all, below which it has no say in the decision.
const SELDOM: f64 = 0.05;
/// Part of the photographs that are nearer to the median.
const ALIKE: f32 = 0.8;

/// Whether photographs have exposures of their own: factors on their radiance, 0.2 to 5, of which
/// the geometric mean is 1. Views are rendered without.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum ExposureChoice {
    /// Each fit decides after 60 steps: unknown if more than a fifth of the photographs are
    /// brighter or darker than the fit explains by 10 %, with a color if a channel is by 5 %. Until
    /// then it has what the fit before decided.
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
    /// Choice in use; `Auto` is as `Equal`.
    pub used: ExposureChoice,
    /// Whether it is still to be decided.
    is_open: bool,
    /// Factors of each view, by [`ViewIndex`]; empty before the first solve.
    pub factors: Vec<Vec3>,
    /// Per view and channel.
    sums: Vec<[ChannelSums; 3]>,
    /// The light of each view; empty if all have the same.
    lights: Vec<LightGroup>,
}

/// Sums over the pixels of a view in one channel.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
struct ChannelSums {
    /// Weighted radiance of the photograph.
    observed: f64,
    /// Weighted radiance of the prediction.
    predicted: f64,
    /// Radiance of the prediction.
    signal: f64,
}

impl Exposures {
    /// Begins a fit: with `Auto`, by the choice that was decided before it, until it decides.
    /// `lights` are those of the views, by index; empty if all have the same.
    pub fn begin(&mut self, choice: ExposureChoice, lights: Vec<LightGroup>) {
        self.lights = lights;
        self.is_open = choice == ExposureChoice::Auto;
        self.sums.clear();
        if !self.is_open {
            self.used = choice;
        }
        if !self.are_unknown() {
            self.factors.clear();
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
        for ChannelSums { observed, predicted, signal } in self.sums.iter_mut().flatten() {
            [observed, predicted, signal].into_iter().for_each(|sum| *sum *= MEMORY);
        }
        for ((pixel, shaded), observed) in pixels.iter().zip(shaded).zip(observed) {
            let view = pixel.view.0 as usize;
            let views = (view + 1).max(self.sums.len());
            self.sums.resize(views, [ChannelSums::default(); 3]);
            self.factors.resize(views.max(self.factors.len()), Vec3::ONE);
            for c in 0..3 {
                let (predicted, seen) = (shaded.diffuse[c] + shaded.specular[c], observed.radiance[c]);
                if seen < SATURATION && predicted > 0.0 {
                    let off = (seen - self.factors[view][c] * predicted).abs().max(SQUARE_BELOW * predicted);
                    let weight = f64::from(predicted / off);
                    let sums = &mut self.sums[view][c];
                    sums.observed += weight * f64::from(seen);
                    sums.predicted += weight * f64::from(predicted);
                    sums.signal += f64::from(predicted);
                }
            }
        }
    }

    /// The logarithms of the ratios of each view, in its brightness and in each channel, less their
    /// means over the views under the same light; `None` for a view of which not more is seen than
    /// a part of the mean of all. A channel of which too little is seen is like the brightness.
    fn logs(&self, part: f64) -> Vec<Option<(f64, DVec3)>> {
        let signal = |sums: &[ChannelSums; 3]| DVec3::from(sums.map(|sums| sums.signal));
        let all: DVec3 = self.sums.iter().map(signal).sum();
        let seen = self.sums.iter().filter(|sums| signal(sums).max_element() > 0.0).count().max(1) as f64;
        let least = part / seen * all;
        let log = |sums: &[ChannelSums; 3]| {
            let observed: f64 = sums.iter().map(|of| of.observed).sum();
            let predicted: f64 = sums.iter().map(|of| of.predicted).sum();
            let is_seen = observed > 0.0 && signal(sums).element_sum() > least.element_sum();
            let brightness = (observed / predicted).ln();
            let channel = |c: usize| {
                let ChannelSums { observed, predicted, signal } = sums[c];
                let tells = all[c] > FAINT * all.max_element() && signal > least[c] && observed > 0.0;
                if tells { (observed / predicted).ln() } else { brightness }
            };
            is_seen.then(|| (brightness, DVec3::new(channel(0), channel(1), channel(2))))
        };
        let logs: Vec<Option<(f64, DVec3)>> = self.sums.iter().map(log).collect();
        self.without_means(logs)
    }

    /// Logarithms less their means over the views under the same light.
    fn without_means(&self, mut logs: Vec<Option<(f64, DVec3)>>) -> Vec<Option<(f64, DVec3)>> {
        let most = self.lights.iter().max().copied().unwrap_or_default();
        for light in (0..=most.0).map(LightGroup) {
            let is_under = |view: usize| self.lights.get(view).copied().unwrap_or_default() == light;
            let under = logs.iter_mut().enumerate().filter(|(view, _)| is_under(*view));
            let mut of_light: Vec<&mut (f64, DVec3)> = under.filter_map(|(_, log)| log.as_mut()).collect();
            let count = of_light.len().max(1) as f64;
            let brightness = of_light.iter().map(|log| log.0).sum::<f64>() / count;
            let color = of_light.iter().map(|log| log.1).sum::<DVec3>() / count;
            of_light.iter_mut().for_each(|log| **log = (log.0 - brightness, log.1 - color));
        }
        logs
    }

    /// Computes the factors from the sums; their geometric mean is 1 before clamping to the range.
    fn solve(&mut self) {
        let is_colored = self.used == ExposureChoice::Color;
        let used = |log: (f64, DVec3)| if is_colored { log.1 } else { DVec3::splat(log.0) };
        let factor = |log: Option<(f64, DVec3)>| log.map_or(DVec3::ONE, |log| used(log).exp()).as_vec3();
        let in_range = |factor: Vec3| factor.clamp(Vec3::splat(RANGE.0), Vec3::splat(RANGE.1));
        self.factors = self.logs(0.0).into_iter().map(|log| in_range(factor(log))).collect();
    }

    /// Decides what is used by how much most photographs differ.
    fn decide(&mut self) {
        let logs: Vec<(f64, DVec3)> = self.logs(SELDOM).into_iter().flatten().collect();
        let apart = spread(logs.iter().map(|log| log.0 as f32));
        let channel = |c: usize| spread(logs.iter().map(move |log| (log.1[c] - log.0) as f32));
        let is_colored = (0..3).any(|c| channel(c) > COLORED);
        self.is_open = false;
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

/// Loss: estimates unknown exposures from the predictions of the window, and decides whether they
/// are unknown.
pub fn find_exposures(
    rates: Res<StepRates>,
    mut exposures: ResMut<Exposures>,
    samples: Samples<(&PixelOf, &Layers, &Observed)>,
) -> SystemResult {
    if !exposures.is_open && !exposures.are_unknown() {
        return Ok(());
    }
    let (pixels, shaded, observed) = samples.columns()?;
    exposures.observe(&pixels, &shaded, &observed);
    if exposures.is_open && rates.step >= DECIDED_AT {
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

    /// The exposures after many windows of views with these factors, a fifth of whose pixels are in
    /// a shadow.
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
        let gray = [Vec3::splat(0.8), Vec3::splat(1.25), Vec3::ONE];
        let colored = [Vec3::new(0.8, 1.0, 1.25), Vec3::new(1.25, 1.0, 0.8), Vec3::ONE];
        // Where only their brightness is unknown, photographs of other colors are alike.
        for (truth, used, expected, within) in [
            (gray, ExposureChoice::Brightness, gray, 0.01),
            (colored, ExposureChoice::Color, colored, 0.01),
            (colored, ExposureChoice::Brightness, [Vec3::ONE; 3], 0.03),
        ] {
            let mut exposures = found(&truth, used);
            for (view, expected) in (0..).map(ViewIndex).zip(expected) {
                let found = exposures.factor(view);
                assert!(found.abs_diff_eq(expected, within), "{used:?} {view:?}: {found} {expected}");
            }
            exposures.used = ExposureChoice::Equal;
            assert_eq!(exposures.factor(ViewIndex(0)), Vec3::ONE);
        }
    }

    #[test]
    fn the_mean_of_each_light_is_one() {
        let mut exposures =
            Exposures { lights: [0, 0, 1, 1].map(LightGroup).to_vec(), ..Exposures::default() };
        let log = |value: f64| Some((value, DVec3::splat(value)));
        // The second light is too dark by a factor of two.
        let logs = vec![log(-0.1), log(0.1), log(0.6), None, log(0.2)];
        exposures.lights.push(LightGroup(1));
        let left: Vec<f64> =
            exposures.without_means(logs).iter().map(|log| log.map_or(9.0, |log| log.0)).collect();
        assert!(left.iter().zip([-0.1, 0.1, 0.2, 9.0, -0.2]).all(|(a, b)| (a - b).abs() < 1e-12), "{left:?}");
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
    fn a_decision_holds_until_the_next_fit_decides() {
        let differ = [Vec3::splat(0.7), Vec3::splat(1.4), Vec3::ONE];
        let mut exposures = found(&differ, ExposureChoice::Auto);
        exposures.decide();
        exposures.solve();
        let before = exposures.factor(ViewIndex(0));
        assert!(before.abs_diff_eq(Vec3::splat(0.7 / (0.98f32).cbrt()), 0.01), "{before}");
        exposures.begin(ExposureChoice::Auto, Vec::new());
        assert!(exposures.is_open && exposures.are_unknown());
        assert_eq!(exposures.factor(ViewIndex(0)), before);
        exposures.begin(ExposureChoice::Equal, Vec::new());
        assert!(!exposures.is_open && !exposures.are_unknown());
        exposures.begin(ExposureChoice::Auto, Vec::new());
        assert_eq!(exposures.factor(ViewIndex(0)), Vec3::ONE);
    }

    /// The exposures after one window of twelve views of this radiance, each 100 pixels of
    /// `seen(view)`.
    fn after(radiance: [f32; 3], seen: impl Fn(usize) -> Vec3) -> Exposures {
        let mut exposures = Exposures { is_open: true, ..Exposures::default() };
        let pixels: Vec<_> = (0..1200).map(|i| PixelOf { view: ViewIndex(i % 12), pixel: i }).collect();
        let shaded = vec![Layers { diffuse: radiance, specular: [0.0; 3] }; 1200];
        let observed = |i: usize| {
            let radiance = (seen(i % 12) * Vec3::from(radiance)).min(Vec3::ONE);
            Observed { radiance, saturated: radiance.max_element() >= SATURATION }
        };
        exposures.observe(&pixels, &shaded, &(0..1200).map(observed).collect::<Vec<_>>());
        exposures
    }

    #[test]
    fn a_channel_without_signal_or_a_clipped_one_has_the_brightness() {
        let brighter = |factor: f32, is: bool| Vec3::splat(if is { factor } else { 1.0 });
        let blueless = after([0.4, 0.2, 0.0], |view| brighter(1.3, view.is_multiple_of(3)));
        let over = after([0.6, 0.3, 0.2], |view| brighter(2.0, view < 4));
        for (mut found, ratio) in [(blueless, 1.3), (over, 2.0)] {
            found.decide();
            assert_eq!(found.used, ExposureChoice::Brightness);
            found.solve();
            let brighter = found.factor(ViewIndex(0)) / found.factor(ViewIndex(5));
            assert!(brighter.abs_diff_eq(Vec3::splat(ratio), 0.01 * ratio), "{brighter}");
        }
        // Noise in the dark is no color.
        let noise = |view: usize| Vec3::new(1.0, 1.0, if view.is_multiple_of(2) { 1.4 } else { 0.7 });
        let mut dark = after([0.4, 0.2, 0.004], noise);
        dark.decide();
        assert_eq!(dark.used, ExposureChoice::Equal);
    }
}
