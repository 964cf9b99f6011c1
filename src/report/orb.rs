//! Scores as Stanford-ORB has them (Kuang et al., NeurIPS 2023): PSNR-H and PSNR-L of a picture whose channels are scaled to the truth, each picture by
//! itself.
//!
//! Only the mask counts, eroded by two pixels, but squares are divided by all pixels of the picture. For PSNR-H both pictures are brightened by one
//! factor, the mean of the truth encoded as sRGB over its mean in linear light, and cut at 4; for PSNR-L they are cut at 1 and encoded as sRGB. No score is
//! less than that of a gray of 0.5.

use crate::math::color::srgb_from_linear;
use crate::report::metrics::{mean, psnr_of_mse};
use glam::{DVec3, Vec3};
use serde::{Deserialize, Serialize};

/// By how many pixels the mask is eroded.
const EROSION: usize = 2;
/// Coverage above which a pixel is in the mask.
const IN_MASK: f32 = 0.5;
/// Where radiance is cut for PSNR-H, after brightening.
const MOST_RADIANCE: f32 = 4.0;
/// What every score is at least as good as.
const GRAY: f64 = 0.5;

/// Scores of a picture, or their means over pictures.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct OrbScores {
    /// PSNR-H: of linear radiance, dB.
    pub psnr_hdr: f64,
    /// PSNR-L: of sRGB values, dB.
    pub psnr_ldr: f64,
}

impl OrbScores {
    /// The means over pictures; `None` if there is none, or one has none.
    pub(crate) fn mean(all: &[Option<Self>]) -> Option<Self> {
        let all = all.iter().copied().collect::<Option<Vec<_>>>()?;
        let mean = |of: fn(&Self) -> f64| mean(&all.iter().map(of).collect::<Vec<_>>());
        Some(Self { psnr_hdr: mean(|s| s.psnr_hdr)?, psnr_ldr: mean(|s| s.psnr_ldr)? })
    }
}

/// Scores a picture of `size` (width, height) pixels: linear radiance of prediction and truth, and the coverage of the truth, row by row. `None` if nothing of
/// the mask is left after erosion.
pub(crate) fn orb_scores(
    size: [usize; 2],
    prediction: &[Vec3],
    truth: &[Vec3],
    coverage: &[f32],
) -> Option<OrbScores> {
    let mask = eroded(size, coverage);
    let counted = |pixels: &[Vec3]| -> Vec<Vec3> {
        let in_mask = pixels.iter().zip(&mask).filter(|(_, counts)| **counts);
        in_mask.map(|(pixel, _)| pixel.max(Vec3::ZERO)).collect()
    };
    let (prediction, truth) = (counted(prediction), counted(truth));
    if truth.is_empty() {
        return None;
    }
    let scale = channel_scale(&prediction, &truth);
    let prediction: Vec<Vec3> = prediction.into_iter().map(|pixel| scale * pixel).collect();
    let bright = brightening(&truth);
    let psnr = |shown: &dyn Fn(Vec3) -> Vec3| {
        let error = |of: &dyn Fn(usize) -> DVec3| {
            let sum: f64 =
                (0..truth.len()).map(|i| (of(i) - shown(truth[i]).as_dvec3()).length_squared()).sum();
            psnr_of_mse(sum / (3 * mask.len()) as f64)
        };
        error(&|i| shown(prediction[i]).as_dvec3()).max(error(&|_| DVec3::splat(GRAY)))
    };
    Some(OrbScores {
        psnr_hdr: psnr(&|pixel| (bright * pixel).min(Vec3::splat(MOST_RADIANCE))),
        psnr_ldr: psnr(&|pixel| pixel.min(Vec3::ONE).to_array().map(srgb_from_linear).into()),
    })
}

/// Where all pixels of a square around a pixel are in the mask; what lies outside of the picture counts as being in it.
fn eroded([width, height]: [usize; 2], coverage: &[f32]) -> Vec<bool> {
    let is_in = |x: usize, y: usize| coverage.get(y * width + x).is_none_or(|&covered| covered > IN_MASK);
    let around = |at: usize, side: usize| at.saturating_sub(EROSION)..(at + EROSION + 1).min(side);
    let counts = |x: usize, y: usize| around(y, height).all(|y| around(x, width).all(|x| is_in(x, y)));
    (0..width * height).map(|i| counts(i % width, i / width)).collect()
}

/// The least-squares factor of each channel; a channel that is black stays black.
fn channel_scale(prediction: &[Vec3], truth: &[Vec3]) -> Vec3 {
    let sum = |of: &dyn Fn(usize) -> Vec3| (0..truth.len()).map(|i| of(i).as_dvec3()).sum::<DVec3>();
    let product = sum(&|i| prediction[i] * truth[i]);
    let square = sum(&|i| prediction[i] * prediction[i]);
    (product / square.max(DVec3::splat(1e-12))).as_vec3()
}

/// The mean of the truth encoded as sRGB over its mean in linear light, both cut at 1.
fn brightening(truth: &[Vec3]) -> f32 {
    let cut = |pixel: &Vec3| pixel.min(Vec3::ONE);
    let encoded =
        |pixel: &Vec3| cut(pixel).to_array().map(|v| f64::from(srgb_from_linear(v))).iter().sum::<f64>();
    let linear: f64 = truth.iter().map(|pixel| f64::from(cut(pixel).element_sum())).sum();
    let mean = linear / (3 * truth.len()) as f64;
    if mean > 1e-8 { (truth.iter().map(encoded).sum::<f64>() / linear) as f32 } else { 1.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: [usize; 2] = [12, 10];

    fn picture(of: impl Fn(usize) -> Vec3) -> Vec<Vec3> {
        (0..120).map(of).collect()
    }

    #[test]
    fn a_factor_per_channel_is_no_error() {
        let truth = picture(|i| Vec3::new(0.1, 0.2, 0.3) + 0.002 * i as f32);
        let prediction: Vec<Vec3> = truth.iter().map(|&pixel| Vec3::new(0.5, 2.0, 4.0) * pixel).collect();
        let scores = orb_scores(SIZE, &prediction, &truth, &[]).unwrap();
        assert!(scores.psnr_hdr > 90.0 && scores.psnr_ldr > 90.0, "{scores:?}");
    }

    /// The numbers of `orb/utils/metrics.py` for these pictures, computed by its formulas with NumPy.
    #[test]
    fn scores_are_those_of_the_benchmark() {
        let at = |i: usize, k: usize| ((i * (7 + 2 * k) + 3 * k) % 17) as f32 / 17.0;
        let truth = picture(|i| Vec3::new(1.6 * at(i, 0), at(i, 1), 0.5 * at(i, 2)));
        let prediction = picture(|i| Vec3::new(at(i, 0) + 0.1, 0.5 * at(i, 1) + 0.2, at(i + 1, 2)));
        let coverage: Vec<f32> = (0..120).map(|i| if i % 12 < 9 && i / 12 > 0 { 1.0 } else { 0.4 }).collect();
        let scores = orb_scores(SIZE, &prediction, &truth, &coverage).unwrap();
        assert!(
            (scores.psnr_hdr - 17.485_288).abs() < 2e-3 && (scores.psnr_ldr - 17.657_117).abs() < 2e-3,
            "{scores:?}"
        );
    }

    #[test]
    fn no_score_is_below_gray_and_an_empty_mask_has_none() {
        let truth = picture(|i| Vec3::splat(if i % 2 == 0 { 0.2 } else { 0.3 }));
        let wrong = picture(|i| Vec3::splat(if i % 2 == 0 { 90.0 } else { 0.0 }));
        let scores = orb_scores(SIZE, &wrong, &truth, &[]).unwrap();
        let gray = |encoded: [f32; 2]| {
            let mse = encoded.iter().map(|&v| (f64::from(v) - 0.5).powi(2)).sum::<f64>() / 2.0;
            -10.0 * mse.log10()
        };
        let srgb = [0.2, 0.3].map(srgb_from_linear);
        assert!((scores.psnr_ldr - gray(srgb)).abs() < 1e-4, "{scores:?}");
        assert_eq!(orb_scores(SIZE, &wrong, &truth, &[0.0; 120]), None);
        // Erosion by two pixels leaves nothing of a strip of four.
        let strip: Vec<f32> = (0..120).map(|i| if (3..7).contains(&(i % 12)) { 1.0 } else { 0.0 }).collect();
        assert_eq!(eroded(SIZE, &strip), [false; 120]);
    }
}
