//! Scores of a predicted image against its truth, in linear light: PSNR, SSIM, the scales that are
//! removed first, albedo and normals. Pure functions of slices, with sums in `f64`.
//!
//! Only pixels in the mask count. Masks are eroded by one pixel first (`erode`), so that pixels on
//! the silhouette, which depend on coverage and not on material, are left out.
//!
//! ```
//! use glam::Vec3;
//! use lobelia_geometry::view::metrics::{ImagePair, ScaleSums, psnr};
//!
//! let (prediction, truth) = ([Vec3::splat(0.6); 64], [Vec3::splat(0.5); 64]);
//! let mask = [true; 64];
//! let pair = ImagePair::new([8, 8], &prediction, &truth, &mask)?;
//! assert!((psnr(&pair) - 20.0).abs() < 1e-4);
//! let mut sums = ScaleSums::default();
//! sums.add(&pair);
//! assert!((sums.scale()[0] - 0.5 / 0.6).abs() < 1e-6);
//! # Ok::<(), lobelia_geometry::Error>(())
//! ```

use crate::{Error, Result, parallel, view::raster::FULL_COVERAGE};
use glam::{DVec3, Vec3};
use std::ops::Range;

/// The score of equal images, in dB: PSNR is clamped to it because JSON has no infinity (an RMS
/// error of 1e-5).
pub const PSNR_CAP_DB: f64 = 100.0;

/// A predicted view, its truth and the pixels that count. [`ImagePair::new`] checks sizes and
/// finiteness.
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
    /// [`Error::Run`] if a slice is not `width * height` long, no pixel counts, or a pixel that
    /// counts is not finite.
    pub fn new(
        size: [usize; 2],
        prediction: &'a [Vec3],
        truth: &'a [Vec3],
        mask: &'a [bool],
    ) -> Result<Self> {
        let [width, height] = size;
        let count = width * height;
        let bad = |problem: String| Err(Error::run("scoring", problem));
        for (what, len) in [("prediction", prediction.len()), ("truth", truth.len()), ("mask", mask.len())] {
            if len != count {
                return bad(format!(
                    "the {what} has {len} pixels, but {width} × {height} = {count} are needed"
                ));
            }
        }
        if !mask.contains(&true) {
            return bad("no pixel is left to score: the mask, eroded by one pixel, is empty".to_owned());
        }
        for (what, pixels) in [("prediction", prediction), ("truth", truth)] {
            let mut pixels = pixels.iter().zip(mask);
            if let Some(at) = pixels.position(|(pixel, &counts)| counts && !pixel.is_finite()) {
                let (x, y) = (at % width, at / width);
                return bad(format!("pixel ({x}, {y}) of the {what} is not a finite number"));
            }
        }
        Ok(Self { width, height, prediction, truth, mask })
    }

    /// Prediction and truth of every pixel that counts, in row order.
    pub fn counted(&self) -> impl Iterator<Item = (DVec3, DVec3)> {
        let pixels = self.prediction.iter().zip(self.truth).zip(self.mask);
        pixels.filter(|&(_, &counts)| counts).map(|((p, t), _)| (p.as_dvec3(), t.as_dvec3()))
    }
}

/// The pixels whose 3×3 neighborhood is fully covered (≥ [`FULL_COVERAGE`]). Pixels beyond the
/// border count as covered: an object that the frame cuts has no silhouette there, and a mask of
/// ones does not change.
///
/// `coverage` is `size[0] * size[1]` values in `[0, 1]`.
pub fn erode(size: [usize; 2], coverage: &[f32]) -> Vec<bool> {
    eroded(size, 1, |i| coverage[i] >= FULL_COVERAGE)
}

/// Whether all pixels of a picture are `inside` up to so many pixels to each side of a pixel.
pub fn eroded([width, height]: [usize; 2], by: usize, inside: impl Fn(usize) -> bool) -> Vec<bool> {
    let around = |at: usize, side: usize| at.saturating_sub(by)..(at + by + 1).min(side);
    let counts = |x, y| around(y, height).all(|y| around(x, width).all(|x| inside(y * width + x)));
    (0..width * height).map(|i| counts(i % width, i / width)).collect()
}

fn clip(value: DVec3) -> DVec3 {
    value.clamp(DVec3::ZERO, DVec3::ONE)
}

/// Peak signal-to-noise ratio in dB, peak 1, after clipping both images to `[0, 1]`: −10 log₁₀ of
/// the mean squared error over the pixels that count and the three channels; at most
/// [`PSNR_CAP_DB`].
pub fn psnr(pair: &ImagePair) -> f64 {
    let squares = || pair.counted().map(|(p, t)| (clip(p) - clip(t)).length_squared());
    psnr_of_mse(squares().sum::<f64>() / (3 * squares().count()) as f64)
}

/// PSNR in dB of a mean squared error for a peak of 1; at most [`PSNR_CAP_DB`].
pub fn psnr_of_mse(mse: f64) -> f64 {
    if mse > 0.0 { (-10.0 * mse.log10()).min(PSNR_CAP_DB) } else { PSNR_CAP_DB }
}

/// Half width of the 11×11 window of SSIM.
const RADIUS: usize = 5;
/// Standard deviation of the window in pixels.
const SIGMA: f64 = 1.5;
/// (K₁ L)² with K₁ = 0.01, L = 1.
const C1: f64 = 0.01 * 0.01;
/// (K₂ L)² with K₂ = 0.03, L = 1.
const C2: f64 = 0.03 * 0.03;

/// Mean structural similarity (Wang, Bovik, Sheikh and Simoncelli, "Image Quality Assessment", IEEE
/// TIP 2004, eq. 13) over the three channels and the pixels that count, in linear light, for a
/// dynamic range of 1.
///
/// Both images are clipped to `[0, 1]` and black outside the mask, so that no pixel outside the
/// mask has an effect. The similarity map is then computed over the whole image, with windows
/// reflected at the border (… b a | a b …), and averaged over the pixels that count. The window is
/// an 11×11 Gaussian of σ 1.5, normalized to 1; variances are not bias-corrected, as in the
/// original.
pub fn ssim(pair: &ImagePair) -> f64 {
    let value = |pixel: usize, channel: usize| {
        let clipped = |pixels: &[Vec3]| f64::from(pixels[pixel][channel]).clamp(0.0, 1.0);
        if pair.mask[pixel] { [clipped(pair.prediction), clipped(pair.truth)] } else { [0.0; 2] }
    };
    ssim_of([pair.width, pair.height], |pixel| pair.mask[pixel], value)
}

/// The SSIM of pictures that are computed as they are needed: `value(pixel, channel)` is the
/// prediction and the truth, in `[0, 1]`, and `counts(pixel)` whether a pixel counts; at least one
/// must. Values are asked for several times.
pub fn ssim_of(
    size: [usize; 2],
    counts: impl Fn(usize) -> bool + Sync,
    value: impl Fn(usize, usize) -> [f64; 2] + Sync,
) -> f64 {
    let of_channel = |channel: usize| plane_ssim(size, &counts, &|pixel| value(pixel, channel));
    let channels: Vec<f64> = parallel::map(3, 1, of_channel);
    channels.iter().sum::<f64>() / 3.0
}

/// Rows of the similarity map that are in memory at a time.
const BAND: usize = 64;

fn plane_ssim(size: [usize; 2], counts: &impl Fn(usize) -> bool, value: &impl Fn(usize) -> [f64; 2]) -> f64 {
    let [width, height] = size;
    let (mut sum, mut count) = (0.0, 0usize);
    for top in (0..height).step_by(BAND) {
        let rows = top..height.min(top + BAND);
        let [p, t, pp, tt, pt] = blurred_band(size, value, rows);
        let first = top * width;
        for i in (0..p.len()).filter(|&i| counts(first + i)) {
            sum += similarity([p[i], t[i]], [pp[i], tt[i], pt[i]]);
            count += 1;
        }
    }
    sum / count as f64
}

/// Prediction, truth, their squares and their product of one channel in some rows, blurred.
fn blurred_band(size: [usize; 2], value: &impl Fn(usize) -> [f64; 2], rows: Range<usize>) -> [Vec<f64>; 5] {
    let ([width, height], weights) = (size, weights());
    let columns: Vec<usize> = (0..width + 2 * RADIUS).map(|x| reflected(x, width)).collect();
    let mut blurred: [Vec<f64>; 5] = std::array::from_fn(|_| vec![0.0; rows.len() * width]);
    let mut line = vec![0.0; width];
    // Each row, blurred along itself, is added to the rows whose windows touch it.
    for at in rows.start..rows.end + 2 * RADIUS {
        let row = reflected(at, height);
        let planes = planes(value, row * width..(row + 1) * width);
        for (plane, blurred) in planes.iter().zip(&mut blurred) {
            for (x, out) in line.iter_mut().enumerate() {
                *out = weights.iter().zip(&columns[x..]).map(|(w, &column)| w * plane[column]).sum();
            }
            for (tap, weight) in weights.iter().enumerate() {
                let row = at.checked_sub(rows.start + tap).filter(|row| *row < rows.len());
                let Some(row) = row else { continue };
                let to = &mut blurred[row * width..][..width];
                to.iter_mut().zip(&line).for_each(|(out, value)| *out += weight * value);
            }
        }
    }
    blurred
}

/// Some pixels of one channel: prediction, truth, their squares and their product.
fn planes(value: &impl Fn(usize) -> [f64; 2], pixels: Range<usize>) -> [Vec<f64>; 5] {
    let (p, t): (Vec<f64>, Vec<f64>) = pixels.map(|pixel| value(pixel).into()).unzip();
    let product = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).collect::<Vec<f64>>();
    let (pp, tt, pt) = (product(&p, &p), product(&t, &t), product(&p, &t));
    [p, t, pp, tt, pt]
}

/// SSIM of one window from its means and mean products.
fn similarity([p, t]: [f64; 2], [pp, tt, pt]: [f64; 3]) -> f64 {
    let (variance_p, variance_t) = ((pp - p * p).max(0.0), (tt - t * t).max(0.0));
    let covariance = pt - p * t;
    ((2.0 * p * t + C1) * (2.0 * covariance + C2)) / ((p * p + t * t + C1) * (variance_p + variance_t + C2))
}

/// The window's 11 weights along one axis; they sum to 1.
fn weights() -> [f64; 2 * RADIUS + 1] {
    let raw: [f64; 2 * RADIUS + 1] =
        std::array::from_fn(|i| (-0.5 * ((i as f64 - RADIUS as f64) / SIGMA).powi(2)).exp());
    let sum: f64 = raw.iter().sum();
    raw.map(|weight| weight / sum)
}

/// Index of position `at − RADIUS` on an axis of `len` cells, reflected at both ends as often as
/// necessary.
fn reflected(at: usize, len: usize) -> usize {
    let period = 2 * len as isize;
    let folded = (at as isize - RADIUS as isize).rem_euclid(period);
    folded.min(period - 1 - folded) as usize
}

/// Pixels at least half covered in both, over those in either; `None` if there are none in either.
pub fn coverage_iou(a: &[f32], b: &[f32]) -> Option<f64> {
    let covered = || a.iter().zip(b).map(|(a, b)| (*a >= 0.5, *b >= 0.5));
    let both = covered().filter(|(a, b)| *a && *b).count();
    let either = covered().filter(|(a, b)| *a || *b).count();
    (either > 0).then(|| both as f64 / either as f64)
}

/// Arithmetic mean; `None` for no values.
pub fn mean(values: impl IntoIterator<Item = f64>) -> Option<f64> {
    let values: Vec<f64> = values.into_iter().collect();
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

/// `pixels` times one factor per channel.
pub fn scaled(pixels: &[Vec3], scale: [f64; 3]) -> Vec<Vec3> {
    let scale = DVec3::from_array(scale);
    pixels.iter().map(|p| (p.as_dvec3() * scale).as_vec3()).collect()
}

/// Accumulates the least-squares scale per channel over any number of views: s = Σ p·t / Σ p²,
/// unclipped, over the pixels that count. Light and albedo are determined only up to such a scale.
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

/// The sum of a diffuse and a specular layer, each times one factor per channel.
pub fn scaled_layers(layers: [&[Vec3]; 2], scales: [[f64; 3]; 2]) -> Vec<Vec3> {
    let [a, b] = scales.map(DVec3::from_array);
    let pixels = layers[0].iter().zip(layers[1]);
    pixels.map(|(d, s)| (a * d.as_dvec3() + b * s.as_dvec3()).as_vec3()).collect()
}

/// Accumulates, over any number of views, the non-negative least-squares scales of a diffuse and a
/// specular layer whose sum approximates the truth. An edit replaces the specular layer, so that
/// the two layers no longer have the common scale of the fit.
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

    /// The scales of both layers per channel, never negative. If the layers are proportional to
    /// each other, or one is black, both have the scale of their sum.
    pub fn scales(&self) -> [[f64; 3]; 2] {
        let solved: [[f64; 2]; 3] = std::array::from_fn(|c| {
            two_scales([self.dd[c], self.ds[c], self.ss[c]], [self.dt[c], self.st[c]])
        });
        [0, 1].map(|layer| solved.map(|pair| pair[layer]))
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

/// Albedo PSNR in dB over the counted pixels of all views together, after one scale per channel for
/// all: the median over these pixels of truth / prediction (pixels whose prediction is not positive
/// have no ratio and are skipped; without any ratio the scale is 1). `None` for no views.
pub fn albedo_psnr(views: &[ImagePair]) -> Option<f64> {
    let counted = || views.iter().flat_map(|view| view.counted());
    let scale = DVec3::from_array(std::array::from_fn(|c| {
        let ratios = counted().filter(|(p, _)| p[c] > 1e-6).map(|(p, t)| t[c] / p[c]);
        median(&mut ratios.collect::<Vec<f64>>()).unwrap_or(1.0)
    }));
    let gaps = counted().map(|(p, t)| clip(p * scale) - clip(t));
    let (sum, count) = (gaps.map(|gap| gap * gap).sum::<DVec3>().element_sum(), 3 * counted().count());
    (count > 0).then(|| psnr_of_mse(sum / count as f64))
}

/// Median (mean of the middle two for an even count) of finite values, which are reordered; `None`
/// for no values.
pub fn median<T: Copy + Into<f64>>(values: &mut [T]) -> Option<f64> {
    if values.is_empty() {
        return None;
    }
    let (middle, is_odd) = (values.len() / 2, values.len() % 2 == 1);
    let by_size = |a: &T, b: &T| (*a).into().total_cmp(&(*b).into());
    let (below, &mut upper, _) = values.select_nth_unstable_by(middle, by_size);
    let upper = upper.into();
    let lower = below.iter().map(|v| (*v).into()).reduce(f64::max).filter(|_| !is_odd);
    Some(0.5 * (lower.unwrap_or(upper) + upper))
}

/// Collects the angles of any number of views: four bytes per pixel that counts.
#[derive(Clone, Debug, Default)]
pub struct NormalAngles {
    /// Radians, in the order of the pixels.
    angles: Vec<f32>,
    /// Their sum.
    sum: f64,
}

impl NormalAngles {
    /// Adds the pixels of a view that count. Both normals are normalized first (truth is an average
    /// over a pixel); a pixel where either is zero is unknown and skipped.
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
        // Both sides are clipped.
        let (truth, prediction) = ([Vec3::new(7.0, -1.0, 0.25); 4], [Vec3::new(1.5, -0.1, 0.25); 4]);
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
        (0..25).for_each(|i| assert_eq!(kept[i], i % 5 > 1 || i / 5 > 1, "{i}"));
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
        let made = [[2.0, 0.5, 3.0], [0.25, 4.0, 3.0]];
        let truth = scaled_layers([&diffuse, &specular], made);
        let mut sums = LayerScaleSums::default();
        sums.add(&pair(&diffuse, &truth, &ALL), &specular).unwrap();
        let found = sums.scales();
        // Blue has no specular light: singular, one scale for both.
        for (found, made) in found.as_flattened().iter().zip(made.as_flattened()) {
            assert!((found - made).abs() < 1e-5, "{found} {made}");
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
        let on_grid = |i: i32| cost(f64::from(i % 201) * 0.01, f64::from(i / 201) * 0.01);
        assert!((0..201 * 201).all(|i| best <= on_grid(i) + 1e-12));
        assert_eq!(two_scales([0.0; 3], [0.0; 2]), [1.0, 1.0]);
    }

    #[test]
    fn albedo_scale_is_a_median() {
        // Ratios in red: 2, 2, 2, 10 → 2; the outlier is left with its error.
        let p = [0.1, 0.2, 0.3, 0.05].map(Vec3::splat);
        let t = [0.2, 0.4, 0.6, 0.5].map(Vec3::splat);
        let expected = -10.0 * (0.4f64 * 0.4 / 4.0).log10();
        assert!((albedo_psnr(&[pair(&p, &t, &ALL)]).unwrap() - expected).abs() < 1e-5);
        assert!(albedo_psnr(&[]).is_none());
        let black = [Vec3::ZERO; 4];
        let of_black = pair(&black, &t, &ALL);
        assert!((albedo_psnr(&[of_black]).unwrap() - psnr(&of_black)).abs() < 1e-9);
    }

    #[test]
    fn medians() {
        assert_eq!((median::<f64>(&mut []), median(&mut [3.0])), (None, Some(3.0)));
        assert_eq!((median(&mut [5.0, 1.0, 3.0]), median(&mut [4.0, 1.0, 3.0, 2.0])), (Some(3.0), Some(2.5)));
    }

    #[test]
    fn angles_by_hand() {
        let truth = [Vec3::X * 0.5, Vec3::X, Vec3::X, Vec3::X];
        for (prediction, pixels, expected) in [
            // 0°, 90°, 45° and one without a normal.
            ([Vec3::X, Vec3::Y * 3.0, Vec3::new(1.0, 1.0, 0.0), Vec3::ZERO], 3, [45.0, 45.0]),
            // 0°, 0°, 90° and 180°: the mean is 67.5°, the median 45°.
            ([Vec3::X, Vec3::X, Vec3::Y, Vec3::NEG_X], 4, [67.5, 45.0]),
            ([Vec3::ZERO; 4], 0, [-1.0; 2]),
        ] {
            let mut angles = NormalAngles::default();
            angles.add(&pair(&prediction, &truth, &ALL));
            assert_eq!(angles.pixels(), pixels);
            let found = [angles.mean_degrees(), angles.median_degrees()].map(|angle| angle.unwrap_or(-1.0));
            assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-5), "{found:?}");
        }
    }

    /// Numbers in [0, 1) that look random.
    fn noise(seed: u32) -> f32 {
        let mut x = seed.wrapping_mul(0x9E37_79B9) ^ 0x85EB_CA6B;
        x = (x ^ (x >> 15)).wrapping_mul(0x2C1B_3C6D);
        x = (x ^ (x >> 12)).wrapping_mul(0x297A_2D39);
        (x >> 8) as f32 / (1u32 << 24) as f32
    }

    fn images(count: usize) -> (Vec<Vec3>, Vec<Vec3>) {
        let truth: Vec<Vec3> =
            (0..count as u32).map(|i| Vec3::new(noise(i), noise(i + 7777), noise(i + 15555))).collect();
        let prediction = (0..).zip(&truth).map(|(i, t)| *t * 0.8 + 0.5 * noise(i + 99_999)).collect();
        (prediction, truth)
    }

    /// The definition, window by window, with a two-dimensional Gaussian.
    fn direct(pair: &ImagePair) -> f64 {
        let reflect = |at: isize, len: usize| {
            let len = len as isize;
            at.max(-1 - at).min(2 * len - 1 - at.max(-1 - at)) as usize
        };
        let (mut total, mut count) = (0.0, 0.0);
        for center in (0..pair.mask.len()).filter(|&i| pair.mask[i]) {
            for channel in 0..3 {
                let (x, y) = ((center % pair.width) as isize, (center / pair.width) as isize);
                let mut window = Vec::new();
                for dy in -5..=5isize {
                    for dx in -5..=5isize {
                        let at = reflect(y + dy, pair.height) * pair.width + reflect(x + dx, pair.width);
                        let value =
                            |v: Vec3| if pair.mask[at] { v[channel].clamp(0.0, 1.0) as f64 } else { 0.0 };
                        let weight = (-((dx * dx + dy * dy) as f64) / (2.0 * 1.5 * 1.5)).exp();
                        window.push((weight, value(pair.prediction[at]), value(pair.truth[at])));
                    }
                }
                let norm: f64 = window.iter().map(|w| w.0).sum();
                let expect = |f: &dyn Fn(f64, f64) -> f64| {
                    window.iter().map(|&(w, p, t)| w * f(p, t)).sum::<f64>() / norm
                };
                let (p, t) = (expect(&|p, _| p), expect(&|_, t| t));
                let (vp, vt) = (expect(&|a, _| (a - p).powi(2)), expect(&|_, b| (b - t).powi(2)));
                let cov = expect(&|a, b| (a - p) * (b - t));
                total +=
                    (2.0 * p * t + 1e-4) * (2.0 * cov + 9e-4) / ((p * p + t * t + 1e-4) * (vp + vt + 9e-4));
                count += 1.0;
            }
        }
        total / count
    }

    #[test]
    fn ssim_equals_its_direct_definition() {
        for size in [[17, 13], [6, 9], [7, 150]] {
            let (prediction, truth) = images(size[0] * size[1]);
            let mask: Vec<bool> = (0..truth.len()).map(|i| i % 5 != 0 && i > size[0]).collect();
            let pair = ImagePair::new(size, &prediction, &truth, &mask).unwrap();
            let (fast, slow) = (ssim(&pair), direct(&pair));
            assert!((fast - slow).abs() < 1e-12, "{fast} {slow}");
            assert!(fast > 0.2 && fast < 0.95, "{fast}");
        }
    }

    #[test]
    fn ssim_of_equal_images_is_one_even_when_tiny() {
        for size in [[1, 1], [3, 2], [12, 12]] {
            let (_, truth) = images(size[0] * size[1]);
            let mask = vec![true; truth.len()];
            let score = ssim(&ImagePair::new(size, &truth, &truth, &mask).unwrap());
            assert!((score - 1.0).abs() < 1e-12, "{score}");
        }
        // No variance: only the luminance term is left.
        let (p, t, mask) = (vec![Vec3::splat(0.5); 144], vec![Vec3::splat(0.25); 144], vec![true; 144]);
        let expected = (2.0 * 0.5 * 0.25 + C1) / (0.25 + 0.0625 + C1);
        assert!((ssim(&ImagePair::new([12, 12], &p, &t, &mask).unwrap()) - expected).abs() < 1e-12);
    }

    #[test]
    fn pixels_outside_the_mask_have_no_say() {
        let (mut prediction, truth) = images(400);
        let mask: Vec<bool> = (0..400).map(|i| i % 20 > 8).collect();
        let before = ssim(&ImagePair::new([20, 20], &prediction, &truth, &mask).unwrap());
        let outside = prediction.iter_mut().zip(&mask).filter(|(_, counts)| !**counts);
        outside.for_each(|(p, _)| *p = Vec3::splat(f32::NAN));
        assert_eq!(before, ssim(&ImagePair::new([20, 20], &prediction, &truth, &mask).unwrap()));
    }
}
