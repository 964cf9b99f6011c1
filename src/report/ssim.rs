//! Structural similarity (Wang, Bovik, Sheikh and Simoncelli, "Image Quality Assessment", IEEE TIP 2004, eq. 13).

use crate::report::metrics::ImagePair;
use glam::Vec3;
use rayon::prelude::*;
use std::ops::Range;

/// Half width of the 11×11 window.
const RADIUS: usize = 5;
/// Standard deviation of the window in pixels.
const SIGMA: f64 = 1.5;
/// (K₁ L)² with K₁ = 0.01, L = 1.
const C1: f64 = 0.01 * 0.01;
/// (K₂ L)² with K₂ = 0.03, L = 1.
const C2: f64 = 0.03 * 0.03;

/// Mean SSIM over the three channels and the pixels that count, in linear light, for a dynamic range of 1.
///
/// Both images are clipped to `[0, 1]` and black outside the mask, so that no pixel outside the mask has an effect.
/// The similarity map is then computed over the whole image, with windows reflected at the border (… b a | a b …), and
/// averaged over the pixels that count. The window is an 11×11 Gaussian of σ 1.5, normalized to 1; variances are not
/// bias-corrected, as in the original.
pub fn ssim(pair: &ImagePair) -> f64 {
    let value = |pixel: usize, channel: usize| {
        let clipped = |pixels: &[Vec3]| f64::from(pixels[pixel][channel]).clamp(0.0, 1.0);
        if pair.mask[pixel] { [clipped(pair.prediction), clipped(pair.truth)] } else { [0.0; 2] }
    };
    ssim_of([pair.width, pair.height], |pixel| pair.mask[pixel], value)
}

/// The same of pictures that are computed as they are needed: `value(pixel, channel)` is the prediction and the truth, in `[0, 1]`, and
/// `counts(pixel)` whether a pixel counts; at least one must. Values are asked for several times.
pub fn ssim_of(
    size: [usize; 2],
    counts: impl Fn(usize) -> bool + Sync,
    value: impl Fn(usize, usize) -> [f64; 2] + Sync,
) -> f64 {
    let of_channel = |channel: usize| channel_ssim(size, &counts, &|pixel| value(pixel, channel));
    let channels: Vec<f64> = (0..3).into_par_iter().map(of_channel).collect();
    channels.iter().sum::<f64>() / 3.0
}

/// Rows of the similarity map that are in memory at a time.
const BAND: usize = 64;

fn channel_ssim(
    size: [usize; 2],
    counts: &impl Fn(usize) -> bool,
    value: &impl Fn(usize) -> [f64; 2],
) -> f64 {
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
fn blurred_band(
    [width, height]: [usize; 2],
    value: &impl Fn(usize) -> [f64; 2],
    rows: Range<usize>,
) -> [Vec<f64>; 5] {
    let weights = weights();
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

/// Index of position `at − RADIUS` on an axis of `len` cells, reflected at both ends as often as necessary.
fn reflected(at: usize, len: usize) -> usize {
    let period = 2 * len as isize;
    let folded = (at as isize - RADIUS as isize).rem_euclid(period);
    folded.min(period - 1 - folded) as usize
}

#[cfg(test)]
mod tests {
    use super::*;

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
        let prediction =
            (0..count as u32).map(|i| truth[i as usize] * 0.8 + 0.5 * noise(i + 99_999)).collect();
        (prediction, truth)
    }

    /// The definition, window by window, with a two-dimensional Gaussian.
    fn direct(pair: &ImagePair) -> f64 {
        let reflect = |at: isize, len: usize| {
            let len = len as isize;
            (if at < 0 {
                -1 - at
            } else if at >= len {
                2 * len - 1 - at
            } else {
                at
            }) as usize
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
    fn equals_the_direct_definition() {
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
    fn equal_images_score_one_even_when_tiny() {
        for size in [[1, 1], [3, 2], [12, 12]] {
            let (_, truth) = images(size[0] * size[1]);
            let mask = vec![true; truth.len()];
            let score = ssim(&ImagePair::new(size, &truth, &truth, &mask).unwrap());
            assert!((score - 1.0).abs() < 1e-12, "{score}");
        }
    }

    #[test]
    fn constant_images_by_hand() {
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
        prediction
            .iter_mut()
            .zip(&mask)
            .filter(|(_, counts)| !**counts)
            .for_each(|(p, _)| *p = Vec3::splat(f32::NAN));
        assert_eq!(before, ssim(&ImagePair::new([20, 20], &prediction, &truth, &mask).unwrap()));
    }
}
