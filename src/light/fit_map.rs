//! An environment map fitted by SG lobes, in the solid-angle-weighted least-squares sense.
//!
//! The map is averaged down, lobes are placed in batches where they lower the error most (matching pursuit), and all
//! parameters are moved together by Levenberg–Marquardt after each batch. Then the least useful lobes are moved, a few at
//! a time, to where the residual is greatest, as long as that helps; last come steps on the map itself (or on as much of
//! its resolution as [`MapFit::polish_width`] allows). No random numbers; the same bits on any number of threads.

use std::f64::consts::TAU;

use glam::{DVec3, Vec3};
use serde::{Deserialize, Serialize};

use super::fibonacci::{fibonacci_axes, spacing_sharpness};
use super::fit_kernel::{FitLobe, Tile, error, tiles_of};
use super::fit_place::place;
use super::fit_solve::{Bounds, fit_amplitudes, levenberg_marquardt};
use super::{EnvironmentMap, LightLobe, render_lobes};
use crate::{Error, Result};

/// Settings of [`fit_map`]; the defaults suit about 100 lobes in a few seconds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MapFit {
    /// Width in texels of the averaged map that most of the work is done on (at least 16).
    pub working_width: u32,
    /// Greatest width in texels of the map that the last steps are done on.
    pub polish_width: u32,
    /// Levenberg–Marquardt steps once all lobes are placed.
    pub iterations: usize,
    /// Rounds of moving the least useful lobes.
    pub relocations: usize,
    /// Levenberg–Marquardt steps on the polishing map.
    pub polish_iterations: usize,
    /// Greatest sharpness; by default 2 (W / 2π)², a standard deviation of 0.7 texels of the map being fitted.
    pub max_sharpness: Option<f32>,
}

impl Default for MapFit {
    fn default() -> Self {
        Self {
            working_width: 128,
            polish_width: 512,
            iterations: 24,
            relocations: 6,
            polish_iterations: 6,
            max_sharpness: None,
        }
    }
}

/// The lobes of a fit and how good they are.
#[derive(Clone, Debug, PartialEq)]
pub struct MapFitReport {
    /// As many lobes as were asked for; ones the map had no use for are black.
    pub lobes: Vec<LightLobe>,
    /// Solid-angle-weighted mean, over texel centres of the given map and channels, of the squared error.
    pub mse: f64,
    /// The same mean of the map's own squared radiance (the error of no lobes at all).
    pub mean_square: f64,
    /// Power of the lobes over the map's, per channel (1 where both are black).
    pub power_ratio: [f64; 3],
    /// Lobes that are not black.
    pub used: usize,
}

/// Least sharpness of a fitted lobe: nearly constant over the sphere.
const DULLEST: f64 = 0.05;
/// Batches that the lobes are placed in.
const BATCHES: usize = 8;
/// Steps after each batch.
const STEPS_PER_BATCH: usize = 3;
/// Steps after lobes were moved.
const STEPS_PER_RELOCATION: usize = 6;
/// Up to this many lobes get all the steps asked for; more get fewer, as a step costs their number squared and more.
const LOBES_AT_FULL_EFFORT: usize = 160;

/// Fits `lobes` SG lobes to `map`.
///
/// # Errors
/// [`Error::Usage`] if no lobes, or a working width under 16, are asked for; [`Error::Run`] if the map is smaller than 2 × 1
/// texels or holds negative or non-finite radiance.
pub fn fit_map(map: &EnvironmentMap, lobes: usize, options: &MapFit) -> Result<MapFitReport> {
    check(map, lobes, options)?;
    // In units of the map's root mean square, so that f32 sums and tolerances fit any exposure.
    let black = map.scaled(Vec3::ZERO);
    let mean_square = map.mean_squared_difference(&black).unwrap_or(0.0);
    let fitted = if mean_square > 0.0 {
        let scale = mean_square.sqrt();
        let unit = map.scaled(Vec3::splat((1.0 / scale) as f32));
        fit_unit_map(&unit, lobes, options).iter().map(|lobe| plain(lobe, scale)).collect()
    } else {
        Vec::new()
    };
    Ok(report(map, with_spares(fitted, lobes), mean_square))
}

fn check(map: &EnvironmentMap, lobes: usize, options: &MapFit) -> Result<()> {
    if lobes == 0 {
        return Err(Error::usage(
            "a map cannot be fitted by zero lobes",
            "ask for one lobe or more, e.g. 128",
        ));
    }
    if options.working_width < 16 || options.max_sharpness.is_some_and(|s| s.is_nan() || s < 1.0) {
        return Err(Error::usage(
            "the map fit needs a working width of at least 16 texels and a greatest sharpness of at least 1",
            "leave them out to take the defaults",
        ));
    }
    let texels = map.width as usize * map.height as usize;
    if map.width < 2 || texels == 0 || texels != map.radiance.len() {
        let problem =
            format!("{} texels do not make a {} × {} map", map.radiance.len(), map.width, map.height);
        return Err(Error::run("fitting lobes to the environment map", problem));
    }
    if let Some(k) = map.radiance.iter().position(|r| !r.is_finite() || r.min_element() < 0.0) {
        let (i, j) = (k % map.width as usize, k / map.width as usize);
        let problem = format!("texel ({i}, {j}) is {}, negative or not finite", map.radiance[k]);
        return Err(Error::run("fitting lobes to the environment map", problem));
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

fn bounds_at(width: u32, options: &MapFit) -> Bounds {
    let finest = 2.0 * (f64::from(width) / TAU).powi(2);
    let asked = options.max_sharpness.map_or(f64::INFINITY, f64::from);
    Bounds { dullest: DULLEST, sharpest: finest.max(2.0).min(asked) }
}

/// `steps`, or fewer of them (but one) where there are very many lobes.
fn affordable(steps: usize, lobes: usize) -> usize {
    let share = (LOBES_AT_FULL_EFFORT as f64 / lobes as f64).powi(2).min(1.0);
    ((steps as f64 * share).ceil() as usize).min(steps)
}

/// Fits a map with a mean square of about one.
fn fit_unit_map(map: &EnvironmentMap, count: usize, options: &MapFit) -> Vec<FitLobe> {
    let working = narrowed(map, options.working_width);
    let (tiles, bounds) = (tiles_of::<f32>(&working), bounds_at(working.width, options));
    let axes = fibonacci_axes((working.radiance.len() / 3).clamp(100, 4000));
    let mut lobes = grow(&tiles, &axes, count, bounds);
    levenberg_marquardt(&tiles, &mut lobes, affordable(options.iterations, count), bounds);
    relocate(&tiles, &axes, &mut lobes, affordable(options.relocations, count), bounds);
    let fine = narrowed(map, options.polish_width);
    polish(
        &tiles_of(&fine),
        &mut lobes,
        affordable(options.polish_iterations, count),
        bounds_at(fine.width, options),
    );
    lobes
}

/// Places lobes in batches until there are `count` or nothing is left to explain.
fn grow(tiles: &[Tile<f32>], axes: &[Vec3], count: usize, bounds: Bounds) -> Vec<FitLobe> {
    let mut lobes = vec![FitLobe::new(DVec3::Y, 0.5_f64.min(bounds.sharpest), [0.5; 3])];
    fit_amplitudes(tiles, &mut lobes);
    for batch in 1..=BATCHES {
        let wanted = (count * batch).div_ceil(BATCHES).saturating_sub(lobes.len());
        lobes.extend(place(tiles, &lobes, axes, wanted, bounds));
        fit_amplitudes(tiles, &mut lobes);
        levenberg_marquardt(tiles, &mut lobes, affordable(STEPS_PER_BATCH, count), bounds);
    }
    lobes
}

/// Moves the least important lobes to the greatest residuals; rounds that do not help are undone and the next moves fewer.
fn relocate(tiles: &[Tile<f32>], axes: &[Vec3], lobes: &mut Vec<FitLobe>, rounds: usize, bounds: Bounds) {
    let mut moving = lobes.len() / 8;
    let mut best = error(tiles, lobes);
    for _ in 0..rounds {
        if moving == 0 {
            break;
        }
        let mut trial = lobes.clone();
        let importance = fit_amplitudes(tiles, &mut trial);
        let mut order: Vec<usize> = (0..trial.len()).collect();
        order.sort_by(|&a, &b| importance[a].total_cmp(&importance[b]));
        order.truncate(moving);
        let mut index = 0..;
        trial.retain(|_| index.next().is_some_and(|k| !order.contains(&k)));
        trial.extend(place(tiles, &trial, axes, moving, bounds));
        fit_amplitudes(tiles, &mut trial);
        let reached = levenberg_marquardt(tiles, &mut trial, STEPS_PER_RELOCATION, bounds);
        if reached < best {
            *lobes = trial;
            best = reached;
        } else {
            moving /= 2;
        }
    }
}

/// Last steps on the finest map; never makes it worse.
fn polish(tiles: &[Tile<f32>], lobes: &mut Vec<FitLobe>, steps: usize, bounds: Bounds) {
    let reached = levenberg_marquardt(tiles, lobes, steps, bounds);
    let mut trial = lobes.clone();
    fit_amplitudes(tiles, &mut trial);
    if error(tiles, &trial) < reached {
        *lobes = trial;
    }
}

fn plain(lobe: &FitLobe, scale: f64) -> LightLobe {
    LightLobe {
        axis: DVec3::from_array(lobe.axis).as_vec3(),
        sharpness: lobe.sharpness as f32,
        amplitude: (DVec3::from_array(lobe.amplitude) * scale).as_vec3(),
    }
}

/// The lobes, made up to `count` by black ones spread over the sphere.
fn with_spares(mut lobes: Vec<LightLobe>, count: usize) -> Vec<LightLobe> {
    lobes.truncate(count);
    let sharpness = spacing_sharpness(count);
    let spares = fibonacci_axes(count - lobes.len()).into_iter();
    lobes.extend(spares.map(|axis| LightLobe { axis, sharpness, amplitude: Vec3::ZERO }));
    lobes
}

fn report(map: &EnvironmentMap, lobes: Vec<LightLobe>, mean_square: f64) -> MapFitReport {
    let rendered = render_lobes(&lobes, map.width, map.height);
    let (power, true_power) = (super::lobes_power(&lobes).to_array(), map.power().to_array());
    let ratio = |c: usize| if true_power[c] > 0.0 { power[c] / true_power[c] } else { 1.0 };
    MapFitReport {
        mse: map.mean_squared_difference(&rendered).unwrap_or(f64::NAN),
        mean_square,
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
        let truth = [
            LightLobe {
                axis: Vec3::new(0.6, 0.0, 0.8),
                sharpness: 30.0,
                amplitude: Vec3::new(5.0, 1.0, 2.0),
            },
            LightLobe {
                axis: Vec3::new(-0.8, 0.6, 0.0),
                sharpness: 7.0,
                amplitude: Vec3::new(0.5, 1.5, 3.0),
            },
            LightLobe { axis: Vec3::NEG_Y, sharpness: 2.0, amplitude: Vec3::new(1.0, 1.0, 0.2) },
        ];
        let map = render_lobes(&truth, 64, 32);
        let fit = fit_map(&map, 6, &MapFit { iterations: 60, ..quick() }).unwrap();
        assert!(fit.mse < 1e-5 * fit.mean_square, "mse {} of {}", fit.mse, fit.mean_square);
        assert!(fit.power_ratio.iter().all(|r| (r - 1.0).abs() < 1e-2), "{:?}", fit.power_ratio);
    }

    #[test]
    fn a_sky_with_a_sun_is_fitted_and_the_same_on_any_number_of_threads() {
        let fit = fit_map(&sky(), 16, &quick()).unwrap();
        assert!(super::super::validate_lobes(&fit.lobes).is_ok());
        assert_eq!(fit.lobes.len(), 16);
        assert!(fit.mse < 5e-3 * fit.mean_square, "mse {} of {}", fit.mse, fit.mean_square);
        assert!(fit.power_ratio.iter().all(|r| (r - 1.0).abs() < 0.05), "{:?}", fit.power_ratio);
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
    fn nonsense_is_refused() {
        assert_eq!(fit_map(&sky(), 0, &quick()).unwrap_err().exit_code(), 2);
        assert!(fit_map(&sky(), 4, &MapFit { working_width: 0, ..quick() }).is_err());
        let mut map = sky();
        map.radiance[70].y = f32::NAN;
        assert!(fit_map(&map, 4, &quick()).unwrap_err().to_string().contains("texel (6, 1)"));
        map.radiance.pop();
        assert!(fit_map(&map, 4, &quick()).is_err());
    }
}
