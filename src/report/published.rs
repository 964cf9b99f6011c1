//! Scores as published tables have them: of sRGB values in a mask that is not eroded and of whole
//! pictures on white and on black ([`SrgbScores`]), and those of Stanford-ORB ([`OrbScores`]).
//!
//! NeRF's synthetic photographs are RGBA with straight, encoded colors; its tables are of those
//! colors over a background, blended as they are encoded: encoded · α + background · (1 − α).
//! Tables "in the mask", as IDR's and NeuS's, are of pixels at least half covered. Everything is
//! computed pixel by pixel, so that no picture is copied.

use glam::{DVec3, Vec3};
use lobelia_geometry::view::metrics::{eroded, mean, psnr_of_mse, ssim_of};
use lobelia_sg::color::srgb_from_linear;
use serde::{Deserialize, Serialize};

/// Coverage of the truth from which a pixel is in the mask.
const IN_MASK: f32 = 0.5;

/// Scores of sRGB values in `[0, 1]`: those of a view, or their means over views.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SrgbScores {
    /// PSNR over the pixels whose true coverage is at least half, dB; of colors that are not
    /// blended with a background.
    pub psnr_mask: f64,
    /// PSNR over all pixels, on white, dB.
    pub psnr_white: f64,
    /// PSNR over all pixels, on black, dB.
    pub psnr_black: f64,
    /// SSIM over all pixels, on white.
    pub ssim_white: f64,
    /// SSIM over all pixels, on black.
    pub ssim_black: f64,
}

/// A picture with its coverage.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Covered<'a> {
    /// Linear radiance, coverage-weighted on black.
    pub radiance: &'a [Vec3],
    /// Coverage in `[0, 1]`, one value per pixel; empty: every pixel is covered.
    pub alpha: &'a [f32],
}

impl Covered<'_> {
    /// Coverage of a pixel, in `[0, 1]`.
    fn coverage(&self, pixel: usize) -> f32 {
        self.alpha.get(pixel).map_or(1.0, |alpha| alpha.clamp(0.0, 1.0))
    }

    /// A channel of the object's own color, encoded, in `[0, 1]`; 0 where nothing is covered.
    fn encoded(&self, pixel: usize, channel: usize) -> f64 {
        let coverage = self.coverage(pixel);
        let straight = if coverage > 0.0 { self.radiance[pixel][channel] / coverage } else { 0.0 };
        f64::from(srgb_from_linear(straight))
    }

    /// An encoded channel over a background of this encoded value.
    fn over(&self, background: f64, pixel: usize, channel: usize) -> f64 {
        let coverage = f64::from(self.coverage(pixel));
        self.encoded(pixel, channel) * coverage + background * (1.0 - coverage)
    }
}

/// Scores a prediction of `size` (width, height) pixels, of which the truth covers at least one by
/// half; all are finite.
pub(crate) fn srgb_scores(size: [usize; 2], prediction: Covered, truth: Covered) -> SrgbScores {
    let pixels = size[0] * size[1];
    // Squared errors, summed over pixels and channels.
    let (mut mask, mut white, mut black, mut counted) = (0.0, 0.0, 0.0, 0);
    for pixel in 0..pixels {
        let in_mask = truth.coverage(pixel) >= IN_MASK;
        counted += usize::from(in_mask);
        let [a, b] = [&prediction, &truth].map(|picture| f64::from(picture.coverage(pixel)));
        for channel in 0..3 {
            let [p, t] = [&prediction, &truth].map(|picture| picture.encoded(pixel, channel));
            let gap = p * a - t * b;
            black += gap * gap;
            white += (gap + (b - a)) * (gap + (b - a));
            mask += if in_mask { (p - t) * (p - t) } else { 0.0 };
        }
    }
    let psnr = |sum: f64, pixels: usize| psnr_of_mse(sum / (3 * pixels) as f64);
    let ssim_on = |background: f64| {
        let over = |pixel, channel| [&prediction, &truth].map(|of| of.over(background, pixel, channel));
        ssim_of(size, |_| true, over)
    };
    SrgbScores {
        psnr_mask: psnr(mask, counted),
        psnr_white: psnr(white, pixels),
        psnr_black: psnr(black, pixels),
        ssim_white: ssim_on(1.0),
        ssim_black: ssim_on(0.0),
    }
}

impl SrgbScores {
    /// Means over views; `None` if a view has none, or there is no view.
    pub(crate) fn mean(views: &[Option<Self>]) -> Option<Self> {
        let views: Vec<Self> = views.iter().copied().collect::<Option<_>>()?;
        let of = |score: fn(&Self) -> f64| mean(views.iter().map(score));
        Some(Self {
            psnr_mask: of(|view| view.psnr_mask)?,
            psnr_white: of(|view| view.psnr_white)?,
            psnr_black: of(|view| view.psnr_black)?,
            ssim_white: of(|view| view.ssim_white)?,
            ssim_black: of(|view| view.ssim_black)?,
        })
    }
}

/// By how many pixels Stanford-ORB erodes the mask.
const EROSION: usize = 2;
/// Where radiance is cut for PSNR-H, after brightening.
const MOST_RADIANCE: f32 = 4.0;
/// Value of the gray picture whose PSNR is the floor of every score.
const GRAY: f64 = 0.5;

/// Scores as Stanford-ORB has them (Kuang et al., NeurIPS 2023), of a picture, or their means over
/// pictures: PSNR-H and PSNR-L of a picture whose channels are scaled to the truth, each picture by
/// itself.
///
/// Only the mask counts, eroded by two pixels, but squares are divided by all pixels of the
/// picture. For PSNR-H both pictures are brightened by one factor, the mean of the truth encoded as
/// sRGB over its mean in linear light, and cut at 4; for PSNR-L they are cut at 1 and encoded as
/// sRGB. No score is less than that of a gray of 0.5.
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
        let all: Vec<Self> = all.iter().copied().collect::<Option<_>>()?;
        let of = |score: fn(&Self) -> f64| mean(all.iter().map(score));
        Some(Self { psnr_hdr: of(|view| view.psnr_hdr)?, psnr_ldr: of(|view| view.psnr_ldr)? })
    }
}

/// Scores a picture of `size` (width, height) pixels: linear radiance of prediction and truth, and
/// the coverage of the truth, row by row. `None` if nothing of the mask is left after erosion.
pub(crate) fn orb_scores(size: [usize; 2], pictures: [&[Vec3]; 2], coverage: &[f32]) -> Option<OrbScores> {
    let mask = eroded(size, EROSION, |i| coverage.get(i).is_none_or(|&covered| covered > IN_MASK));
    let counted = |pixels: &[Vec3]| -> Vec<Vec3> {
        let in_mask = pixels.iter().zip(&mask).filter(|(_, counts)| **counts);
        in_mask.map(|(pixel, _)| pixel.max(Vec3::ZERO)).collect()
    };
    let [prediction, truth] = pictures.map(counted);
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
    use lobelia_geometry::view::metrics::PSNR_CAP_DB;
    use lobelia_sg::color::linear_from_srgb;

    /// Radiance of encoded gray values under a coverage.
    fn radiance(encoded: &[f32], alpha: &[f32]) -> Vec<Vec3> {
        let pixels = encoded.iter().zip(alpha);
        pixels.map(|(value, alpha)| Vec3::splat(linear_from_srgb(*value) * alpha)).collect()
    }

    fn scores(size: [usize; 2], p: (&[f32], &[f32]), t: (&[f32], &[f32])) -> SrgbScores {
        let (prediction, truth) = (radiance(p.0, p.1), radiance(t.0, t.1));
        let prediction = Covered { radiance: &prediction, alpha: p.1 };
        srgb_scores(size, prediction, Covered { radiance: &truth, alpha: t.1 })
    }

    fn db(mse: f64) -> f64 {
        -10.0 * mse.log10()
    }

    /// Expects PSNR in the mask, on white and on black.
    #[track_caller]
    fn near(found: &SrgbScores, expected: [f64; 3]) {
        let found = [found.psnr_mask, found.psnr_white, found.psnr_black];
        assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-4), "{found:?}");
    }

    #[test]
    fn a_half_covered_pixel_by_hand() {
        // 0.8 at full coverage against 0.4 at half: on white 0.8 and 0.7, on black 0.8 and 0.2;
        // straight 0.8 and 0.4.
        let found = scores([1, 1], (&[0.8], &[1.0]), (&[0.4], &[0.5]));
        near(&found, [db(0.16), 20.0, db(0.36)]);
        // One pixel has no variance: SSIM is its luminance term.
        let luminance = |p: f64, t: f64| (2.0 * p * t + 1e-4) / (p * p + t * t + 1e-4);
        assert!((found.ssim_white - luminance(0.8, 0.7)).abs() < 1e-6, "{found:?}");
        assert!((found.ssim_black - luminance(0.8, 0.2)).abs() < 1e-6, "{found:?}");
    }

    #[test]
    fn the_masked_score_counts_half_covered_pixels_and_no_others() {
        // In the mask: gaps of 0.1 and 0.3. A quarter covered: outside. On black all four count,
        // weighted by coverage.
        let alpha = [1.0, 0.5, 0.25, 0.0];
        let found = scores([2, 2], (&[0.5, 0.6, 0.9, 0.0], &alpha), (&[0.6, 0.3, 0.1, 0.0], &alpha));
        let black = db((0.1f64.powi(2) + 0.15f64.powi(2) + 0.2f64.powi(2)) / 4.0);
        // Equal coverage: the background has no part in the error.
        near(&found, [db((0.01 + 0.09) / 2.0), black, black]);
    }

    #[test]
    fn equal_pictures_have_the_largest_scores() {
        let (value, alpha) = ([0.1, 0.9, 0.4, 0.7, 0.2, 0.3], [1.0, 0.5, 0.0, 0.3, 1.0, 0.8]);
        let found = scores([3, 2], (&value, &alpha), (&value, &alpha));
        near(&found, [PSNR_CAP_DB; 3]);
        assert!([found.ssim_white, found.ssim_black].iter().all(|s| (s - 1.0).abs() < 1e-12), "{found:?}");
        // What is brighter than white is white.
        let (bright, white) = ([Vec3::splat(7.0); 4], [Vec3::ONE; 4]);
        let picture = |radiance| Covered { radiance, alpha: &[] };
        let found = srgb_scores([2, 2], picture(&bright), picture(&white));
        near(&found, [PSNR_CAP_DB; 3]);
    }

    #[test]
    fn means_need_every_view() {
        let a = SrgbScores { psnr_mask: 10.0, ssim_white: 0.5, ..SrgbScores::default() };
        let b = SrgbScores { psnr_mask: 30.0, ssim_white: 1.0, ..SrgbScores::default() };
        let mean = SrgbScores::mean(&[Some(a), Some(b)]).unwrap();
        assert_eq!((mean.psnr_mask, mean.ssim_white), (20.0, 0.75));
        assert_eq!(SrgbScores::mean(&[Some(a), None]), None);
        assert_eq!(SrgbScores::mean(&[]), None);
    }

    const ORB_SIZE: [usize; 2] = [12, 10];

    fn picture(of: impl Fn(usize) -> Vec3) -> Vec<Vec3> {
        (0..120).map(of).collect()
    }

    #[test]
    fn a_factor_per_channel_is_no_error_to_stanford_orb() {
        let truth = picture(|i| Vec3::new(0.1, 0.2, 0.3) + 0.002 * i as f32);
        let prediction: Vec<Vec3> = truth.iter().map(|&pixel| Vec3::new(0.5, 2.0, 4.0) * pixel).collect();
        let scores = orb_scores(ORB_SIZE, [&prediction, &truth], &[]).unwrap();
        assert!(scores.psnr_hdr > 90.0 && scores.psnr_ldr > 90.0, "{scores:?}");
    }

    /// The numbers of `orb/utils/metrics.py` for these pictures, computed by its formulas with
    /// NumPy.
    #[test]
    fn scores_are_those_of_stanford_orb() {
        let at = |i: usize, k: usize| ((i * (7 + 2 * k) + 3 * k) % 17) as f32 / 17.0;
        let truth = picture(|i| Vec3::new(1.6 * at(i, 0), at(i, 1), 0.5 * at(i, 2)));
        let prediction = picture(|i| Vec3::new(at(i, 0) + 0.1, 0.5 * at(i, 1) + 0.2, at(i + 1, 2)));
        let coverage: Vec<f32> = (0..120).map(|i| if i % 12 < 9 && i / 12 > 0 { 1.0 } else { 0.4 }).collect();
        let scores = orb_scores(ORB_SIZE, [&prediction, &truth], &coverage).unwrap();
        let gaps = [scores.psnr_hdr - 17.485_288, scores.psnr_ldr - 17.657_117];
        assert!(gaps.iter().all(|gap| gap.abs() < 2e-3), "{scores:?}");
    }

    #[test]
    fn no_orb_score_is_below_gray_and_an_empty_mask_has_none() {
        let truth = picture(|i| Vec3::splat(if i % 2 == 0 { 0.2 } else { 0.3 }));
        let wrong = picture(|i| Vec3::splat(if i % 2 == 0 { 90.0 } else { 0.0 }));
        let scores = orb_scores(ORB_SIZE, [&wrong, &truth], &[]).unwrap();
        let squares = [0.2, 0.3].map(|gray| (f64::from(srgb_from_linear(gray)) - 0.5).powi(2));
        assert!((scores.psnr_ldr - db((squares[0] + squares[1]) / 2.0)).abs() < 1e-4, "{scores:?}");
        assert_eq!(orb_scores(ORB_SIZE, [&wrong, &truth], &[0.0; 120]), None);
        // Erosion by two pixels leaves nothing of a strip of four.
        let strip: Vec<f32> = (0..120).map(|i| if (3..7).contains(&(i % 12)) { 1.0 } else { 0.0 }).collect();
        assert_eq!(orb_scores(ORB_SIZE, [&wrong, &truth], &strip), None);
    }
}
