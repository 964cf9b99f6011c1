//! Scores of a predicted image against its truth, in linear light. Pure functions of slices, with sums in `f64`.
//!
//! Only pixels in the mask count. Masks are eroded by one pixel first (`erode`), so that pixels on the
//! silhouette, which depend on coverage and not on material, are left out.

use crate::{Error, Result};
use glam::{DVec3, Vec3};

/// The score of equal images, in dB: PSNR is clamped to it because JSON has no infinity (an RMS error of 1e-5).
pub const PSNR_CAP_DB: f64 = 100.0;

/// Coverage from which a pixel counts as fully covered.
pub(crate) const FULL_COVERAGE: f32 = 0.999;

/// A predicted view, its truth and the pixels that count. [`ImagePair::new`] checks sizes and finiteness.
#[derive(Clone, Copy, Debug)]
pub struct ImagePair<'a> {
    /// Width in pixels.
    pub width: usize,
    /// Height in pixels.
    pub height: usize,
    /// `width * height` predicted linear values, row by row from the top left.
    pub prediction: &'a [Vec3],
    /// `width * height` true linear values.
    pub truth: &'a [Vec3],
    /// `width * height` flags: `true` where a pixel counts.
    pub mask: &'a [bool],
}

impl<'a> ImagePair<'a> {
    /// Pairs images of `size` (width, height) pixels.
    ///
    /// # Errors
    /// [`Error::Run`] if a slice is not `width * height` long, no pixel counts, or a pixel that counts is not finite.
    pub fn new(
        size: [usize; 2],
        prediction: &'a [Vec3],
        truth: &'a [Vec3],
        mask: &'a [bool],
    ) -> Result<Self> {
        let [width, height] = size;
        let count = width * height;
        for (what, len) in [("prediction", prediction.len()), ("truth", truth.len()), ("mask", mask.len())] {
            if len != count {
                return Err(bad(format!(
                    "the {what} has {len} pixels, but {width} × {height} = {count} are needed"
                )));
            }
        }
        if !mask.contains(&true) {
            return Err(bad("no pixel is left to score: the mask, eroded by one pixel, is empty"));
        }
        for (what, pixels) in [("prediction", prediction), ("truth", truth)] {
            if let Some(at) =
                pixels.iter().zip(mask).position(|(pixel, &counts)| counts && !pixel.is_finite())
            {
                return Err(bad(format!(
                    "pixel ({}, {}) of the {what} is not a finite number",
                    at % width,
                    at / width
                )));
            }
        }
        Ok(Self { width, height, prediction, truth, mask })
    }

    /// Prediction and truth of every pixel that counts, in row order.
    pub(super) fn counted(&self) -> impl Iterator<Item = (DVec3, DVec3)> {
        let pixels = self.prediction.iter().zip(self.truth).zip(self.mask);
        pixels.filter(|&(_, &counts)| counts).map(|((p, t), _)| (p.as_dvec3(), t.as_dvec3()))
    }
}

fn bad(problem: impl Into<String>) -> Error {
    Error::run("scoring", problem)
}

/// The pixels whose 3×3 neighborhood is fully covered (≥ [`FULL_COVERAGE`]). Pixels beyond the border count as
/// covered: an object that the frame cuts has no silhouette there, and a mask of ones does not change.
///
/// `coverage` is `size[0] * size[1]` values in `[0, 1]`. ([`crate::view`] has a separate erosion for fitting; this
/// one is here so that metrics depend on slices only.)
pub(crate) fn erode(size: [usize; 2], coverage: &[f32]) -> Vec<bool> {
    let [width, height] = size;
    debug_assert_eq!(coverage.len(), width * height);
    let full: Vec<bool> = coverage.iter().map(|&c| c >= FULL_COVERAGE).collect();
    let survives = |x: usize, y: usize| {
        let columns = x.saturating_sub(1)..(x + 2).min(width);
        (y.saturating_sub(1)..(y + 2).min(height))
            .all(|row| full[row * width + columns.start..row * width + columns.end].iter().all(|&f| f))
    };
    (0..full.len()).map(|i| survives(i % width, i / width)).collect()
}

fn clip(value: DVec3) -> DVec3 {
    value.clamp(DVec3::ZERO, DVec3::ONE)
}

/// Peak signal-to-noise ratio in dB, peak 1, after clipping both images to `[0, 1]`:
/// −10 log₁₀ of the mean squared error over the pixels that count and the three channels; at most [`PSNR_CAP_DB`].
pub fn psnr(pair: &ImagePair) -> f64 {
    let (mut sum, mut count) = (0.0, 0usize);
    for (prediction, truth) in pair.counted() {
        sum += (clip(prediction) - clip(truth)).length_squared();
        count += 3;
    }
    psnr_of_mse(sum / count as f64)
}

/// PSNR in dB of a mean squared error for a peak of 1; at most [`PSNR_CAP_DB`].
pub fn psnr_of_mse(mse: f64) -> f64 {
    if mse > 0.0 { (-10.0 * mse.log10()).min(PSNR_CAP_DB) } else { PSNR_CAP_DB }
}

/// Pixels at least half covered in both, over those in either; `None` if there are none in either.
pub fn coverage_iou(a: &[f32], b: &[f32]) -> Option<f64> {
    let covered = || a.iter().zip(b).map(|(a, b)| (*a >= 0.5, *b >= 0.5));
    let both = covered().filter(|(a, b)| *a && *b).count();
    let either = covered().filter(|(a, b)| *a || *b).count();
    (either > 0).then(|| both as f64 / either as f64)
}

/// Arithmetic mean; `None` for no values.
pub fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

/// `pixels` times one factor per channel.
pub fn scaled(pixels: &[Vec3], scale: [f64; 3]) -> Vec<Vec3> {
    let scale = DVec3::from_array(scale);
    pixels.iter().map(|p| (p.as_dvec3() * scale).as_vec3()).collect()
}

/// Accumulates the least-squares scale per channel over any number of views: s = Σ p·t / Σ p², unclipped, over the pixels
/// that count. Light and albedo are determined only up to such a scale.
#[derive(Clone, Copy, Debug, Default)]
pub struct ScaleSums {
    prediction_truth: DVec3,
    prediction_squared: DVec3,
}

impl ScaleSums {
    /// Adds a view.
    pub fn add(&mut self, pair: &ImagePair) {
        for (p, t) in pair.counted() {
            self.prediction_truth += p * t;
            self.prediction_squared += p * p;
        }
    }

    /// The scale per channel, never negative; 1 for channels whose prediction is black everywhere.
    pub fn scale(&self) -> [f64; 3] {
        std::array::from_fn(|c| single_scale(self.prediction_truth[c], self.prediction_squared[c]))
    }
}

fn single_scale(prediction_truth: f64, prediction_squared: f64) -> f64 {
    if prediction_squared > 0.0 { (prediction_truth / prediction_squared).max(0.0) } else { 1.0 }
}

/// One factor per channel for each of the two layers of a render.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct LayerScales {
    /// Factor of the diffuse layer, per channel.
    pub diffuse: [f64; 3],
    /// Factor of the specular layer, per channel.
    pub specular: [f64; 3],
}

impl LayerScales {
    /// The sum of the scaled layers.
    pub fn combine(&self, diffuse: &[Vec3], specular: &[Vec3]) -> Vec<Vec3> {
        let (a, b) = (DVec3::from_array(self.diffuse), DVec3::from_array(self.specular));
        diffuse.iter().zip(specular).map(|(d, s)| (a * d.as_dvec3() + b * s.as_dvec3()).as_vec3()).collect()
    }
}

/// Accumulates, over any number of views, the non-negative least-squares scales of a diffuse and a specular layer whose sum
/// approximates the truth. An edit replaces the specular layer, so that the two layers no longer have the common scale of the fit.
#[derive(Clone, Copy, Debug, Default)]
pub struct LayerScaleSums {
    dd: DVec3,
    ds: DVec3,
    ss: DVec3,
    dt: DVec3,
    st: DVec3,
}

impl LayerScaleSums {
    /// Adds a view whose `pair.prediction` is the diffuse layer; `specular` is the other layer.
    ///
    /// # Errors
    /// [`Error::Run`] if `specular` has another size or a pixel that counts is not finite.
    pub fn add(&mut self, pair: &ImagePair, specular: &[Vec3]) -> Result<()> {
        let other = ImagePair::new([pair.width, pair.height], specular, pair.truth, pair.mask)?;
        for ((d, t), (s, _)) in pair.counted().zip(other.counted()) {
            self.dd += d * d;
            self.ds += d * s;
            self.ss += s * s;
            self.dt += d * t;
            self.st += s * t;
        }
        Ok(())
    }

    /// The scales, never negative. If the layers are proportional to each other, or one is black, both have the
    /// scale of their sum.
    pub fn scales(&self) -> LayerScales {
        let solved: [[f64; 2]; 3] = std::array::from_fn(|c| {
            two_scales([self.dd[c], self.ds[c], self.ss[c]], [self.dt[c], self.st[c]])
        });
        LayerScales { diffuse: solved.map(|pair| pair[0]), specular: solved.map(|pair| pair[1]) }
    }
}

/// Minimizes |a·d + b·s − t|² over a, b ≥ 0 from the sums of the normal equations.
fn two_scales([dd, ds, ss]: [f64; 3], [dt, st]: [f64; 2]) -> [f64; 2] {
    let determinant = dd * ss - ds * ds;
    if determinant <= 1e-9 * dd * ss {
        let both = single_scale(dt + st, dd + 2.0 * ds + ss);
        return [both, both];
    }
    let (a, b) = ((dt * ss - st * ds) / determinant, (st * dd - dt * ds) / determinant);
    if a >= 0.0 && b >= 0.0 {
        return [a, b];
    }
    // The minimum is on an edge of the quadrant; the better edge is used.
    let (only_a, only_b) = ([single_scale(dt, dd), 0.0], [0.0, single_scale(st, ss)]);
    let cost = |[a, b]: [f64; 2]| a * a * dd + 2.0 * a * b * ds + b * b * ss - 2.0 * (a * dt + b * st);
    if cost(only_a) <= cost(only_b) { only_a } else { only_b }
}

/// The score of the albedo.
#[derive(Clone, Debug, PartialEq)]
pub struct AlbedoScore {
    /// PSNR over the counted pixels of all views together, dB.
    pub psnr: f64,
    /// Each view's PSNR, dB.
    pub views: Vec<f64>,
    /// The median scale that was applied, per channel.
    pub scale: [f64; 3],
}

/// Albedo PSNR after one scale per channel for all views: the median over all views' counted pixels of truth / prediction
/// (pixels whose prediction is not positive have no ratio and are skipped; without any ratio the scale is 1). `None` for no views.
pub fn albedo_psnr(views: &[ImagePair]) -> Option<AlbedoScore> {
    let scale = std::array::from_fn(|channel| median_ratio(views, channel));
    let scores: Vec<f64> = views
        .iter()
        .map(|view| {
            let prediction = scaled(view.prediction, scale);
            psnr(&ImagePair { prediction: &prediction, ..*view })
        })
        .collect();
    let mut pooled = DVec3::ZERO;
    let mut count = 0usize;
    for (p, t) in views.iter().flat_map(|view| view.counted()) {
        let gap = clip(p * DVec3::from_array(scale)) - clip(t);
        pooled += gap * gap;
        count += 3;
    }
    let psnr = psnr_of_mse(pooled.element_sum() / count as f64);
    (count > 0).then_some(AlbedoScore { psnr, views: scores, scale })
}

fn median_ratio(views: &[ImagePair], channel: usize) -> f64 {
    let mut ratios: Vec<f64> = views
        .iter()
        .flat_map(|view| view.counted())
        .filter(|(p, _)| p[channel] > 1e-6)
        .map(|(p, t)| t[channel] / p[channel])
        .collect();
    median(&mut ratios).unwrap_or(1.0)
}

/// Median (mean of the middle two for an even count) of finite values, which are reordered; `None` for no values.
pub fn median<T: Copy + Into<f64>>(values: &mut [T]) -> Option<f64> {
    let middle = values.len() / 2;
    if values.is_empty() {
        return None;
    }
    let even = values.len().is_multiple_of(2);
    let (below, &mut upper, _) =
        values.select_nth_unstable_by(middle, |a, b| (*a).into().total_cmp(&(*b).into()));
    let upper = upper.into();
    let lower =
        if even { below.iter().map(|v| (*v).into()).fold(f64::NEG_INFINITY, f64::max) } else { upper };
    Some(0.5 * (lower + upper))
}

#[cfg(test)]
mod tests {
    use super::*;

    const ALL: [bool; 4] = [true; 4];

    fn pair<'a>(prediction: &'a [Vec3], truth: &'a [Vec3], mask: &'a [bool]) -> ImagePair<'a> {
        ImagePair::new([2, 2], prediction, truth, mask).unwrap()
    }

    #[test]
    fn overlap_is_counted_from_half_coverage_on() {
        assert_eq!(coverage_iou(&[1.0, 0.6, 0.4, 0.0], &[1.0, 0.2, 0.5, 0.1]), Some(1.0 / 3.0));
        assert_eq!(coverage_iou(&[0.1], &[0.0]), None);
    }

    #[test]
    fn psnr_by_hand() {
        let truth = [Vec3::splat(0.5); 4];
        let prediction = [Vec3::splat(0.6); 4];
        assert!((psnr(&pair(&prediction, &truth, &ALL)) - 20.0).abs() < 1e-5);
        // One channel of one of four pixels off by 0.5: MSE = 0.25 / 12.
        let mut prediction = truth;
        prediction[2].y = 1.0;
        let expected = -10.0 * (0.25f64 / 12.0).log10();
        assert!((psnr(&pair(&prediction, &truth, &ALL)) - expected).abs() < 1e-9);
        // … and ignored if masked out; equal images have the largest PSNR.
        let mask = [true, true, false, true];
        assert_eq!(psnr(&pair(&prediction, &truth, &mask)), PSNR_CAP_DB);
    }

    #[test]
    fn psnr_clips_both_sides() {
        let truth = [Vec3::new(7.0, -1.0, 0.25); 4];
        let prediction = [Vec3::new(1.5, -0.1, 0.25); 4];
        assert_eq!(psnr(&pair(&prediction, &truth, &ALL)), PSNR_CAP_DB);
    }

    #[test]
    fn bad_pairs_are_refused() {
        let (good, short) = ([Vec3::ONE; 4], [Vec3::ONE; 3]);
        let refused = |p: &[Vec3], m: &[bool]| ImagePair::new([2, 2], p, &good, m).unwrap_err().to_string();
        assert!(refused(&short, &ALL).contains("prediction has 3 pixels"));
        assert!(refused(&good, &[false; 4]).contains("empty"));
        let mut with_nan = good;
        with_nan[3].z = f32::NAN;
        assert!(refused(&with_nan, &ALL).contains("pixel (1, 1) of the prediction"));
        assert!(ImagePair::new([2, 2], &with_nan, &good, &[true, true, true, false]).is_ok());
    }

    #[test]
    fn erosion_removes_the_rim_but_not_the_border() {
        assert!(erode([3, 2], &[1.0; 6]).iter().all(|&kept| kept));
        let mut coverage = vec![1.0; 25];
        coverage[0] = 0.99;
        let kept = erode([5, 5], &coverage);
        for y in 0..5 {
            for x in 0..5 {
                assert_eq!(kept[y * 5 + x], x > 1 || y > 1, "({x}, {y})");
            }
        }
    }

    #[test]
    fn least_squares_scale_by_hand() {
        let mut sums = ScaleSums::default();
        // Red: p = (1, 2), t = (2, 3): s = (2 + 6) / 5. Green: p = 0. Blue: p·t < 0.
        let (p, t) = ([Vec3::new(1.0, 0.0, 1.0); 4], [Vec3::new(2.0, 1.0, -1.0); 4]);
        let one = [true, false, false, false];
        sums.add(&pair(&p, &t, &one));
        let (p, t) = ([Vec3::new(2.0, 0.0, 1.0); 4], [Vec3::new(3.0, 1.0, -1.0); 4]);
        sums.add(&pair(&p, &t, &one));
        assert_eq!(sums.scale(), [8.0 / 5.0, 1.0, 0.0]);
        assert_eq!(scaled(&[Vec3::new(0.5, 2.0, 1.0)], [2.0, 0.5, 3.0]), [Vec3::new(1.0, 1.0, 3.0)]);
    }

    #[test]
    fn layer_scales_recover_what_was_mixed() {
        let diffuse: Vec<Vec3> = (0..4).map(|i| Vec3::new(0.1 * i as f32, 0.2, 0.3)).collect();
        let specular: Vec<Vec3> = (0..4).map(|i| Vec3::new(0.5, 0.1 * (i * i) as f32, 0.0)).collect();
        let made = LayerScales { diffuse: [2.0, 0.5, 3.0], specular: [0.25, 4.0, 3.0] };
        let truth = made.combine(&diffuse, &specular);
        let mut sums = LayerScaleSums::default();
        sums.add(&pair(&diffuse, &truth, &ALL), &specular).unwrap();
        let found = sums.scales();
        // Blue has no specular light: singular, one scale for both.
        for c in 0..3 {
            assert!((found.diffuse[c] - made.diffuse[c]).abs() < 1e-5, "{found:?}");
            assert!((found.specular[c] - made.specular[c]).abs() < 1e-5, "{found:?}");
        }
        assert!(sums.add(&pair(&diffuse, &truth, &ALL), &specular[..3]).is_err());
    }

    #[test]
    fn two_scales_stay_non_negative_and_optimal() {
        // t = d − s: without the bound (1, −1). On the edge b = 0, a = dt / dd.
        let (d, s) = ([1.0, 2.0, 0.5], [0.2, 0.3, 0.9]);
        let t = [0, 1, 2].map(|i| d[i] - s[i]);
        let dot = |x: [f64; 3], y: [f64; 3]| x.iter().zip(y).map(|(a, b)| a * b).sum::<f64>();
        let found = two_scales([dot(d, d), dot(d, s), dot(s, s)], [dot(d, t), dot(s, t)]);
        let cost = |a: f64, b: f64| (0..3).map(|i| (a * d[i] + b * s[i] - t[i]).powi(2)).sum::<f64>();
        let best = cost(found[0], found[1]);
        for i in 0..=200 {
            for j in 0..=200 {
                assert!(best <= cost(i as f64 * 0.01, j as f64 * 0.01) + 1e-12);
            }
        }
        assert_eq!(two_scales([0.0; 3], [0.0; 2]), [1.0, 1.0]);
    }

    #[test]
    fn albedo_scale_is_a_median() {
        // Ratios in red: 2, 2, 2, 10 → 2; the outlier is left with its error.
        let p = [0.1, 0.2, 0.3, 0.05].map(Vec3::splat);
        let t = [0.2, 0.4, 0.6, 0.5].map(Vec3::splat);
        let score = albedo_psnr(&[pair(&p, &t, &ALL)]).unwrap();
        for scale in score.scale {
            assert!((scale - 2.0).abs() < 1e-6);
        }
        let expected = -10.0 * (0.4f64 * 0.4 / 4.0).log10();
        assert!((score.psnr - expected).abs() < 1e-5);
        assert!(albedo_psnr(&[]).is_none());
        let black = [Vec3::ZERO; 4];
        assert_eq!(albedo_psnr(&[pair(&black, &t, &ALL)]).unwrap().scale, [1.0; 3]);
    }

    #[test]
    fn medians() {
        assert_eq!(median::<f64>(&mut []), None);
        assert_eq!(median(&mut [3.0]), Some(3.0));
        assert_eq!(median(&mut [5.0, 1.0, 3.0]), Some(3.0));
        assert_eq!(median(&mut [4.0f32, 1.0, 3.0, 2.0]), Some(2.5));
    }
}
