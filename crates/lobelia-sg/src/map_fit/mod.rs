//! Fits SG lobes to an environment map, in the solid-angle-weighted least-squares sense.
//!
//! Suns are removed first ([`crate::map_fit::sun`]). Lobes are then placed in batches where they
//! lower the error most (matching pursuit on a pyramid), and Levenberg–Marquardt optimizes all
//! parameters together after each batch. Then some additional lobes are placed, all are optimized,
//! and the least useful are removed; this repeats as long as the error decreases. Finally
//! amplitudes change by the smallest amount that preserves the power of the map. There are no
//! random numbers; results do not depend on the number of threads.

mod gram;
pub mod kernel;
mod place;
mod solve;
pub mod sun;

pub use sun::Sun;

use crate::color::luminance;
use crate::fibonacci::{fibonacci_axes, spacing_sharpness};
use crate::light::{EnvironmentMap, LightLobe, render_lobes};
use glam::{DVec3, Vec3};
use kernel::{FitLobe, Tile, derivatives};
use place::{Level, place};
use serde::{Deserialize, Serialize};
use solve::{LobeBounds, fit_amplitudes, keep_power, levenberg_marquardt, prune};
use std::f64::consts::{PI, TAU};
use sun::take_suns;

/// Most lobes that a map is fitted by where people ask for it: the work of a step grows with the
/// cube of their number.
pub const MOST_FITTED: usize = 512;

/// Settings of [`fit_map`]; the defaults suit about 100 lobes in a few seconds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MapFit {
    /// Width in texels of the averaged map that lobes are first placed on (at least 16).
    pub working_width: u32,
    /// Largest width in texels of the map for relocation and final optimization.
    pub polish_width: u32,
    /// Levenberg–Marquardt steps once all lobes are placed.
    pub iterations: usize,
    /// Rounds of placing lobes at the largest residuals and removing the least useful.
    pub relocations: usize,
    /// Levenberg–Marquardt steps at the end.
    pub polish_iterations: usize,
    /// Largest sharpness; by default 2 (W / 2π)², a standard deviation of 0.7 texels of the map
    /// being fitted.
    pub max_sharpness: Option<f32>,
    /// Light from above only: the map is black below the horizon, and no axis points below it.
    pub upper_hemisphere: bool,
    /// Gray light: the map's luminance is fitted, and every lobe has one amplitude for the three
    /// channels.
    pub white: bool,
}

impl Default for MapFit {
    fn default() -> Self {
        Self {
            working_width: 256,
            polish_width: 512,
            iterations: 16,
            relocations: 12,
            polish_iterations: 16,
            max_sharpness: None,
            upper_hemisphere: false,
            white: false,
        }
    }
}

/// The lobes of a fit, and its error.
#[derive(Clone, Debug, PartialEq)]
pub struct MapFitReport {
    /// The requested number of lobes, those of suns first; lobes that do not improve the fit are
    /// black.
    pub lobes: Vec<LightLobe>,
    /// Suns that are fitted separately; their lobes are the first of `lobes`.
    pub suns: Vec<Sun>,
    /// Solid-angle-weighted mean, over texel centers of the map (as [`target_of`] makes it) and
    /// channels, of the squared error.
    pub mse: f64,
    /// Mean, weighted as `mse`, of the squared radiance of the map (the error without lobes).
    pub mean_square: f64,
    /// Power of the lobes over the map's, per channel (1 where both are black).
    pub power_ratio: [f64; 3],
    /// Lobes that are not black.
    pub used: usize,
}

/// The reason why a map was not fitted.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum MapFitError {
    /// The settings are invalid.
    Settings {
        /// The problem.
        problem: &'static str,
        /// The remedy.
        help: &'static str,
    },
    /// The map is not usable, and why.
    Map(String),
    /// The fit was asked to stop.
    Stopped,
}

impl std::fmt::Display for MapFitError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Settings { problem, .. } => f.write_str(problem),
            Self::Map(problem) => write!(f, "fitting lobes to the environment map: {problem}"),
            Self::Stopped => f.write_str("the fit was asked to stop"),
        }
    }
}

impl std::error::Error for MapFitError {}

/// Progress of a fit, and the mean squared error so far, without suns.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MapFitProgress {
    /// Completed fraction of the work, 0 to 1.
    pub done: f64,
    /// Like [`MapFitReport::mse`], for the map at the current resolution and without its suns.
    pub mse: f64,
}

/// Least sharpness of a fitted lobe: nearly constant over the sphere.
const DULLEST: f64 = 0.05;
/// Batches that the lobes are placed in.
const BATCHES: usize = 8;
/// Steps after each batch.
const STEPS_PER_BATCH: usize = 3;
/// Fraction of the lobes that a round adds and removes: one in this many, cyclically.
const MOVED_ONE_IN: [usize; 3] = [6, 12, 25];
/// Steps after adding lobes, and after removing the same number.
const STEPS_PER_RELOCATION: [usize; 2] = [4, 6];
/// A cycle of rounds that lowers the error by less than this fraction is the last.
const WORTHWHILE: f64 = 3e-4;
/// Up to this many lobes, all requested rounds run; with more lobes fewer, as the cost of a step is
/// at least quadratic in their number.
const LOBES_AT_FULL_EFFORT: usize = 128;
/// Widths of the pyramid below the finest level.
const WIDTHS: [u32; 4] = [32, 64, 128, 256];
/// With fewer lobes than this, none is used for a sun.
const LOBES_FOR_A_SUN: usize = 4;

/// Fits `lobes` SG lobes to `map`.
///
/// # Errors
/// [`MapFitError::Settings`] for zero lobes, a working width below 16 or a largest sharpness below
/// 1; [`MapFitError::Map`] if the map is smaller than 2 × 1 texels or holds negative or non-finite
/// radiance.
pub fn fit_map(map: &EnvironmentMap, lobes: usize, options: &MapFit) -> Result<MapFitReport, MapFitError> {
    fit_map_with(map, lobes, options, &mut |_| {}, &|| false)
}

/// [`fit_map`] with progress reports; it ends early once `is_stopping` returns true, which is asked
/// before every step.
///
/// # Errors
/// The errors of [`fit_map`], and [`MapFitError::Stopped`].
pub fn fit_map_with(
    map: &EnvironmentMap,
    lobes: usize,
    options: &MapFit,
    progress: &mut dyn FnMut(MapFitProgress),
    is_stopping: &dyn Fn() -> bool,
) -> Result<MapFitReport, MapFitError> {
    check(map, lobes, options)?;
    let target = target_of(map, options);
    let (suns, rest) = take_suns(&target, lobes / LOBES_FOR_A_SUN, sharpest_at(target.width, options));
    // In units of the root mean square of the map, so that f32 sums and tolerances work for any
    // exposure.
    let scale = mean_square(&rest).sqrt();
    let mut fitted: Vec<LightLobe> = suns.iter().map(|sun| sun.lobe).collect();
    if scale > 0.0 {
        let unit = rest.scaled(Vec3::splat((1.0 / scale) as f32));
        let mut tell = |p: MapFitProgress| progress(MapFitProgress { mse: p.mse * scale * scale, ..p });
        let found = fit_unit_map(&unit, lobes - suns.len(), options, &mut tell, is_stopping);
        if is_stopping() {
            return Err(MapFitError::Stopped);
        }
        fitted.extend(found.iter().map(|lobe| plain(lobe, scale, options.white)));
    }
    Ok(report(&target, with_spares(fitted, lobes), suns))
}

/// The map that is fitted, by the options: `map` itself, its luminance, or the map with black below
/// the horizon.
pub fn target_of(map: &EnvironmentMap, options: &MapFit) -> EnvironmentMap {
    let mut target = map.clone();
    if options.white {
        target.radiance.iter_mut().for_each(|r| *r = Vec3::splat(luminance(*r)));
    }
    if options.upper_hemisphere {
        let middle = target.width as usize * (target.height as usize).div_ceil(2);
        target.radiance[middle..].fill(Vec3::ZERO);
    }
    target
}

fn mean_square(map: &EnvironmentMap) -> f64 {
    map.mean_squared_difference(&map.scaled(Vec3::ZERO)).unwrap_or(0.0)
}

fn check(map: &EnvironmentMap, lobes: usize, options: &MapFit) -> Result<(), MapFitError> {
    if lobes == 0 {
        return Err(MapFitError::Settings {
            problem: "a map cannot be fitted by zero lobes",
            help: "request at least one lobe, e.g. 128",
        });
    }
    if options.working_width < 16 || options.max_sharpness.is_some_and(|s| s.is_nan() || s < 1.0) {
        return Err(MapFitError::Settings {
            problem: "the map fit needs a working width of at least 16 texels and a largest sharpness of at least 1",
            help: "leave them out to use the defaults",
        });
    }
    let texels = map.width as usize * map.height as usize;
    if map.width < 2 || texels == 0 || texels != map.radiance.len() {
        let problem =
            format!("{} texels do not make a {} × {} map", map.radiance.len(), map.width, map.height);
        return Err(MapFitError::Map(problem));
    }
    if let Some(k) = map.radiance.iter().position(|r| !r.is_finite() || r.min_element() < 0.0) {
        let (i, j) = (k % map.width as usize, k / map.width as usize);
        let problem = format!("texel ({i}, {j}) is {}, negative or not finite", map.radiance[k]);
        return Err(MapFitError::Map(problem));
    }
    Ok(())
}

/// The map at no more than `width` texels across.
fn narrowed(map: &EnvironmentMap, width: u32) -> EnvironmentMap {
    if map.width <= width {
        return map.clone();
    }
    let height = (f64::from(map.height) * f64::from(width) / f64::from(map.width)).round().max(1.0);
    map.downsampled(width, height as u32)
}

fn sharpest_at(width: u32, options: &MapFit) -> f64 {
    let finest = 2.0 * (f64::from(width) / TAU).powi(2);
    finest.max(2.0).min(options.max_sharpness.map_or(f64::INFINITY, f64::from))
}

fn bounds_at(width: u32, options: &MapFit) -> LobeBounds {
    LobeBounds {
        dullest: DULLEST,
        sharpest: sharpest_at(width, options),
        upper_only: options.upper_hemisphere,
    }
}

/// `steps`, or fewer (at least one) for very many lobes.
fn affordable(steps: usize, lobes: usize) -> usize {
    let share = (LOBES_AT_FULL_EFFORT as f64 / lobes as f64).powi(2).min(1.0);
    ((steps as f64 * share).ceil() as usize).min(steps)
}

/// The map averaged to increasing widths, the last at most `finest`.
fn pyramid(map: &EnvironmentMap, finest: u32) -> Vec<Level> {
    let last = finest.min(map.width);
    let widths = WIDTHS.into_iter().filter(|&width| width < last).chain([last]);
    widths.map(|width| Level::new(&narrowed(map, width))).collect()
}

/// Progress, counted in rounds, and the question whether to go on.
struct Teller<'a> {
    told: &'a mut dyn FnMut(MapFitProgress),
    is_stopping: &'a dyn Fn() -> bool,
    rounds: usize,
    of: usize,
}

impl Teller<'_> {
    fn round(&mut self, error: f64) {
        self.rounds += 1;
        let done = (self.rounds as f64 / self.of as f64).min(1.0);
        // E is summed over the channels.
        (self.told)(MapFitProgress { done, mse: error / 3.0 });
    }
}

/// Fits a map with a mean square of about one.
fn fit_unit_map(
    map: &EnvironmentMap,
    count: usize,
    options: &MapFit,
    told: &mut dyn FnMut(MapFitProgress),
    is_stopping: &dyn Fn() -> bool,
) -> Vec<FitLobe> {
    let rounds = affordable(options.relocations, count);
    let mut teller = Teller { told, is_stopping, rounds: 0, of: BATCHES + rounds + 1 };
    let working = pyramid(map, options.working_width);
    let bounds = bounds_at(options.working_width.min(map.width), options);
    let mut lobes = grow(&working, count, bounds, &mut teller);
    let steps = affordable(options.iterations, count);
    levenberg_marquardt(finest(&working), &mut lobes, steps, bounds, is_stopping);
    let width = options.polish_width.max(options.working_width).min(map.width);
    let (levels, bounds) = (pyramid(map, width), bounds_at(width, options));
    relocate(&levels, &mut lobes, rounds, bounds, &mut teller);
    let steps = affordable(options.polish_iterations, count);
    let reached = levenberg_marquardt(finest(&levels), &mut lobes, steps, bounds, is_stopping);
    keep_power(&mut lobes, (map.power() / (4.0 * PI)).to_array());
    teller.round(reached);
    lobes
}

fn finest(levels: &[Level]) -> &[Tile] {
    levels.last().map_or(&[], |level| &level.tiles)
}

/// Places lobes in batches until there are `count` or no residual is left.
fn grow(levels: &[Level], count: usize, bounds: LobeBounds, teller: &mut Teller) -> Vec<FitLobe> {
    let tiles = finest(levels);
    let mut lobes = vec![FitLobe::new(DVec3::Y, 0.5_f64.min(bounds.sharpest), [0.5; 3])];
    fit_amplitudes(tiles, &mut lobes);
    for batch in 1..=BATCHES {
        if (teller.is_stopping)() {
            break;
        }
        let wanted = (count * batch).div_ceil(BATCHES).saturating_sub(lobes.len());
        lobes.extend(place(levels, &lobes, wanted, bounds));
        fit_amplitudes(tiles, &mut lobes);
        let steps = affordable(STEPS_PER_BATCH, count);
        let reached = levenberg_marquardt(tiles, &mut lobes, steps, bounds, teller.is_stopping);
        teller.round(reached);
    }
    lobes
}

/// Adds lobes where the residual is largest, optimizes all, and removes the least useful; a round
/// that does not lower the error is reverted.
fn relocate(
    levels: &[Level],
    lobes: &mut Vec<FitLobe>,
    rounds: usize,
    bounds: LobeBounds,
    teller: &mut Teller,
) {
    let (tiles, count) = (finest(levels), lobes.len());
    let mut best = derivatives(tiles, lobes).error;
    let mut before = best;
    for round in 0..rounds {
        if (teller.is_stopping)() {
            break;
        }
        let moved = (count / MOVED_ONE_IN[round % MOVED_ONE_IN.len()]).max(1);
        let mut trial = lobes.clone();
        trial.extend(place(levels, &trial, moved, bounds));
        fit_amplitudes(tiles, &mut trial);
        levenberg_marquardt(tiles, &mut trial, STEPS_PER_RELOCATION[0], bounds, teller.is_stopping);
        prune(&mut trial, count);
        fit_amplitudes(tiles, &mut trial);
        let reached =
            levenberg_marquardt(tiles, &mut trial, STEPS_PER_RELOCATION[1], bounds, teller.is_stopping);
        if reached < best {
            *lobes = trial;
            best = reached;
        }
        teller.round(best);
        if (round + 1) % MOVED_ONE_IN.len() == 0 {
            if before - best < WORTHWHILE * best {
                break;
            }
            before = best;
        }
    }
}

fn plain(lobe: &FitLobe, scale: f64, white: bool) -> LightLobe {
    let amplitude = DVec3::from_array(lobe.amplitude) * scale;
    let gray = DVec3::splat(amplitude.element_sum() / 3.0);
    LightLobe {
        axis: lobe.axis.as_vec3(),
        sharpness: lobe.sharpness as f32,
        amplitude: if white { gray } else { amplitude }.as_vec3(),
    }
}

/// The lobes, padded to `count` with black ones spread over the sphere.
fn with_spares(mut lobes: Vec<LightLobe>, count: usize) -> Vec<LightLobe> {
    lobes.truncate(count);
    let sharpness = spacing_sharpness(count);
    let spares = fibonacci_axes(count - lobes.len()).into_iter();
    lobes.extend(spares.map(|axis| LightLobe { axis, sharpness, amplitude: Vec3::ZERO }));
    lobes
}

fn report(map: &EnvironmentMap, lobes: Vec<LightLobe>, suns: Vec<Sun>) -> MapFitReport {
    let rendered = render_lobes(&lobes, map.width, map.height);
    let (power, true_power) = (crate::light::lobes_power(&lobes).to_array(), map.power().to_array());
    let ratio = |c: usize| if true_power[c] > 0.0 { power[c] / true_power[c] } else { 1.0 };
    MapFitReport {
        mse: map.mean_squared_difference(&rendered).unwrap_or(f64::NAN),
        mean_square: mean_square(map),
        suns,
        power_ratio: [ratio(0), ratio(1), ratio(2)],
        used: lobes.iter().filter(|l| l.amplitude.max_element() > 0.0).count(),
        lobes,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn quick() -> MapFit {
        MapFit { working_width: 64, polish_width: 64, relocations: 2, ..MapFit::default() }
    }

    fn sky() -> EnvironmentMap {
        EnvironmentMap::from_directions(64, 32, |d| {
            let sun = 40.0 * (80.0 * (d.dot(Vec3::new(0.48, 0.6, 0.64)) - 1.0)).exp();
            let sky =
                if d.y > 0.0 { Vec3::new(0.4, 0.6, 1.0) * (1.0 - 0.5 * d.y) } else { Vec3::splat(0.15) };
            sky + Vec3::new(1.0, 0.9, 0.7) * sun
        })
    }

    #[test]
    fn lobes_are_recovered_from_their_own_map() {
        let lobe =
            |axis, sharpness, amplitude: [f32; 3]| LightLobe { axis, sharpness, amplitude: amplitude.into() };
        let truth = [
            lobe(Vec3::new(0.6, 0.0, 0.8), 30.0, [5.0, 1.0, 2.0]),
            lobe(Vec3::new(-0.8, 0.6, 0.0), 7.0, [0.5, 1.5, 3.0]),
            lobe(Vec3::NEG_Y, 2.0, [1.0, 1.0, 0.2]),
        ];
        let map = render_lobes(&truth, 64, 32);
        let fit = fit_map(&map, 6, &MapFit { iterations: 60, ..quick() }).unwrap();
        assert!(fit.mse < 1e-5 * fit.mean_square, "mse {} of {}", fit.mse, fit.mean_square);
        assert!(fit.power_ratio.iter().all(|r| (r - 1.0).abs() < 1e-2), "{:?}", fit.power_ratio);
        // Unused lobes have no effect.
        for count in [8, 16, 40] {
            let fit = fit_map(&map, count, &quick()).unwrap();
            assert!(fit.mse < 1e-4 * fit.mean_square, "{count}: mse {} of {}", fit.mse, fit.mean_square);
        }
    }

    #[test]
    fn a_sky_with_a_sun_is_fitted_and_the_same_on_any_number_of_threads() {
        let fit = fit_map(&sky(), 16, &quick()).unwrap();
        assert!(crate::light::validate_lobes(&fit.lobes).is_ok());
        assert_eq!(fit.lobes.len(), 16);
        assert!(fit.mse < 5e-3 * fit.mean_square, "mse {} of {}", fit.mse, fit.mean_square);
        assert!(fit.power_ratio.iter().all(|r| (r - 1.0).abs() < 0.01), "{:?}", fit.power_ratio);
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
        assert_eq!(pool.install(|| fit_map(&sky(), 16, &quick())).unwrap(), fit);
    }

    #[test]
    fn exposure_does_not_matter() {
        let fit = fit_map(&sky(), 8, &quick()).unwrap();
        let bright = fit_map(&sky().scaled(Vec3::splat(1024.0)), 8, &quick()).unwrap();
        assert!((bright.mse / fit.mse / 1024.0_f64.powi(2) - 1.0).abs() < 1e-2);
    }

    #[test]
    fn constant_black_and_one_sided_maps_are_fitted() {
        let constant = fit_map(&sky().scaled(Vec3::ZERO).clone(), 5, &quick()).unwrap();
        assert_eq!((constant.lobes.len(), constant.used, constant.mse), (5, 0, 0.0));
        let ones = EnvironmentMap::from_directions(32, 16, |_| Vec3::ONE);
        for count in [1, 5] {
            let fit = fit_map(&ones, count, &quick()).unwrap();
            assert_eq!(fit.lobes.len(), count);
            assert!(fit.mse < 2e-3, "{count} lobes: mse {}", fit.mse);
        }
        let red = fit_map(&sky().scaled(Vec3::X), 4, &quick()).unwrap();
        assert!(red.lobes.iter().all(|l| l.amplitude.y == 0.0 && l.amplitude.z == 0.0));
        let tiny = EnvironmentMap { width: 2, height: 1, radiance: vec![Vec3::ONE, Vec3::ZERO] };
        assert_eq!(fit_map(&tiny, 3, &quick()).unwrap().lobes.len(), 3);
    }

    #[test]
    fn light_from_above_only_and_gray_light() {
        let options = MapFit { upper_hemisphere: true, white: true, ..quick() };
        let fit = fit_map(&sky(), 12, &options).unwrap();
        assert!(fit.lobes.iter().all(|l| l.axis.y >= -1e-6));
        assert!(fit.lobes.iter().all(|l| l.amplitude.min_element() == l.amplitude.max_element()));
        assert!(fit.mse < 0.05 * fit.mean_square, "mse {} of {}", fit.mse, fit.mean_square);
        let target = target_of(&sky(), &options);
        assert_eq!(target.sample_bilinear(Vec3::NEG_Y), Vec3::ZERO);
        assert_eq!(target.radiance[70].x, luminance(sky().radiance[70]));
    }

    #[test]
    fn a_sun_gets_its_own_lobe_and_the_sky_is_fitted_beside_it() {
        let toward = Vec3::new(0.48, 0.6, 0.64);
        let with_sun = EnvironmentMap::from_directions(128, 64, |d| {
            let sun = if d.angle_between(toward) < 0.05 { 2e4 } else { 0.0 };
            sky().sample_bilinear(d) + Vec3::splat(sun)
        });
        let fit = fit_map(&with_sun, 16, &quick()).unwrap();
        assert_eq!(fit.suns.len(), 1);
        assert_eq!(fit.lobes[0], fit.suns[0].lobe);
        assert!(fit.power_ratio.iter().all(|r| (r - 1.0).abs() < 0.01), "{:?}", fit.power_ratio);
        let away: Vec<Vec3> = fibonacci_axes(400).into_iter().filter(|d| d.dot(toward) < 0.9).collect();
        let square = |d: &Vec3| {
            (crate::light::lobes_radiance(&fit.lobes, *d) - sky().sample_bilinear(*d)).length_squared()
        };
        let mean = away.iter().map(square).sum::<f32>() / away.len() as f32;
        assert!(mean < 0.04, "mean square {mean} of the sky");
    }

    #[test]
    fn progress_is_told_to_the_end() {
        let mut told = Vec::new();
        fit_map_with(&sky(), 8, &quick(), &mut |p| told.push(p), &|| false).unwrap();
        assert!(told.len() > 5 && told.windows(2).all(|w| w[0].done <= w[1].done));
        assert!(told.iter().all(|p| p.mse.is_finite() && p.done <= 1.0));
    }

    #[test]
    fn nonsense_is_refused() {
        assert!(matches!(fit_map(&sky(), 0, &quick()), Err(MapFitError::Settings { .. })));
        let stopped = fit_map_with(&sky(), 4, &quick(), &mut |_| {}, &|| true);
        assert_eq!(stopped.unwrap_err(), MapFitError::Stopped);
        assert!(fit_map(&sky(), 4, &MapFit { working_width: 0, ..quick() }).is_err());
        let mut map = sky();
        map.radiance[70].y = f32::NAN;
        assert!(fit_map(&map, 4, &quick()).unwrap_err().to_string().contains("texel (6, 1)"));
        map.radiance.pop();
        assert!(fit_map(&map, 4, &quick()).is_err());
    }
}
