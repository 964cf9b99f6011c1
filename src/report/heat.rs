//! Error heat maps: the difference of a prediction and its truth, times a given factor.

use glam::Vec3;
use image::{Rgb, RgbImage};

/// sRGB stops of the color scale at 0, 1/8 … 1: matplotlib's "inferno" (N. Smith and S. van der Walt, 2015), which is
/// perceptually uniform and suitable for color-blind readers.
const INFERNO: [[u8; 3]; 9] = [
    [0, 0, 4],
    [31, 12, 72],
    [85, 15, 109],
    [136, 34, 106],
    [186, 54, 85],
    [227, 89, 51],
    [249, 140, 10],
    [249, 201, 50],
    [252, 255, 164],
];

/// Color of the scale at `value`, which is clamped to `[0, 1]` (NaN is cyan, which the scale does not contain).
pub fn heat_color(value: f32) -> [u8; 3] {
    if value.is_nan() {
        return [0, 255, 255];
    }
    let at = value.clamp(0.0, 1.0) * (INFERNO.len() - 1) as f32;
    let low = (at as usize).min(INFERNO.len() - 2);
    let blend = at - low as f32;
    let (a, b) = (INFERNO[low], INFERNO[low + 1]);
    std::array::from_fn(|c| (f32::from(a[c]) + (f32::from(b[c]) - f32::from(a[c])) * blend).round() as u8)
}

/// Mean absolute difference over the channels, both values clipped to `[0, 1]`, in linear light.
fn difference(prediction: Vec3, truth: Vec3) -> f32 {
    let gap = (prediction.clamp(Vec3::ZERO, Vec3::ONE) - truth.clamp(Vec3::ZERO, Vec3::ONE)).abs();
    gap.element_sum() / 3.0
}

/// Heat map of `width` × `height` pixels: the scale's color at error × `factor`. Pixels with zero coverage are `outside`.
///
/// `prediction`, `truth` and `coverage` hold `width * height` entries; missing entries are shown as `outside`.
pub fn heat_map(
    size: [u32; 2],
    images: [&[Vec3]; 2],
    coverage: &[f32],
    factor: f32,
    outside: [u8; 3],
) -> RgbImage {
    map_of(size, images, coverage, outside, |error| error * factor)
}

/// The colors of errors at the places that `place` gives them on the scale.
fn map_of(
    [width, height]: [u32; 2],
    images: [&[Vec3]; 2],
    coverage: &[f32],
    outside: [u8; 3],
    place: impl Fn(f32) -> f32,
) -> RgbImage {
    RgbImage::from_fn(width, height, |x, y| {
        let at = y as usize * width as usize + x as usize;
        let pixel = images[0].get(at).zip(images[1].get(at)).zip(coverage.get(at));
        match pixel {
            Some(((&prediction, &truth), &covered)) if covered > 0.0 => {
                Rgb(heat_color(place(difference(prediction, truth))))
            }
            _ => Rgb(outside),
        }
    })
}

/// The error at the end of the scale of [`error_map`].
pub const LARGEST_ERROR: f32 = 0.25;

/// Error map of `width` × `height` pixels on a scale that is the same for all pictures: the color at √(error / [`LARGEST_ERROR`]), so that small
/// errors are seen and large ones told apart. Otherwise as [`heat_map`].
pub fn error_map(size: [u32; 2], images: [&[Vec3]; 2], coverage: &[f32], outside: [u8; 3]) -> RgbImage {
    map_of(size, images, coverage, outside, |error| (error / LARGEST_ERROR).sqrt())
}

/// A factor (4, 8, 16, 32 or 64) for a PSNR of `psnr` dB: an error of three times the root
/// mean square is about the end of the scale. Use one factor for all rows that are to be compared.
pub fn factor_for(psnr: f64) -> f32 {
    let root_mean_square = 10f64.powf(-psnr / 20.0);
    let wanted = 1.0 / (3.0 * root_mean_square);
    [4.0, 8.0, 16.0, 32.0].into_iter().find(|&factor| wanted < factor * 1.414).unwrap_or(64.0) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scale_ends_and_rises() {
        assert_eq!(heat_color(-1.0), INFERNO[0]);
        assert_eq!(heat_color(2.0), INFERNO[8]);
        assert_eq!(heat_color(0.5), INFERNO[4]);
        let lightness = |v: f32| {
            let [r, g, b] = heat_color(v).map(f32::from);
            0.21 * r + 0.72 * g + 0.07 * b
        };
        assert!((1..=64).all(|i| lightness(i as f32 / 64.0) > lightness((i - 1) as f32 / 64.0)));
    }

    #[test]
    fn error_times_factor_is_the_place_on_the_scale() {
        let (p, t) = ([Vec3::new(0.5, 2.0, 0.2), Vec3::ZERO], [Vec3::new(0.2, 1.0, 0.2), Vec3::ONE]);
        let map = heat_map([2, 1], [&p, &t], &[1.0, 0.0], 5.0, [9, 9, 9]);
        assert_eq!(map.get_pixel(0, 0).0, heat_color(0.1 * 5.0));
        assert_eq!(map.get_pixel(1, 0).0, [9, 9, 9]);
    }

    #[test]
    fn the_scale_of_a_report_does_not_depend_on_the_run() {
        let (p, t) = ([Vec3::splat(0.5), Vec3::ONE, Vec3::ONE], [Vec3::splat(0.49), Vec3::ZERO, Vec3::ZERO]);
        let map = error_map([3, 1], [&p, &t], &[1.0, 1.0, 0.0], [9, 9, 9]);
        assert_eq!(map.get_pixel(0, 0).0, heat_color(0.2));
        assert_eq!((map.get_pixel(1, 0).0, map.get_pixel(2, 0).0), (INFERNO[8], [9, 9, 9]));
    }

    #[test]
    fn factors_follow_the_score() {
        assert_eq!([10.0, 24.0, 30.0, 40.0, 99.0].map(factor_for), [4.0, 4.0, 8.0, 32.0, 64.0]);
    }
}
