//! Masks of an object before a plain backdrop.
//!
//! The backdrop's color is a quadratic polynomial of the position in the image, in CIE L*a*b*: plain paper under uneven light. It is
//! fitted to a strip along the frame, robustly, since the object or its support may reach the frame, and then again to all that is
//! found to be backdrop. A pixel belongs to the object if its color is far enough from the backdrop's there; Otsu's method sets how
//! far. Lightness counts half, so that soft shadows on the backdrop are backdrop. Of what is found, specks and gaps are cleaned, the
//! largest region is kept, and its small holes are filled.

use crate::math::color::linear_from_srgb;
use crate::prepare::regions::Bits;
use image::imageops::{FilterType, resize, thumbnail};
use image::{GrayImage, Luma, RgbImage};

/// Width of the strip along the frame as a part of the image's smaller side.
const STRIP: f32 = 0.03;
/// Most pixels that the backdrop's color is fitted to.
const FITTED_PIXELS: usize = 20_000;
/// Rounds of the robust fit; each keeps the pixels that the last one explains.
const FIT_ROUNDS: usize = 6;
/// Median distance in L*a*b* of the strip's pixels from the fitted color above which the backdrop is not plain.
const PLAIN: f32 = 7.0;
/// Distances below this are never the object's, whatever Otsu's method says: noise and folds.
const LEAST_DISTANCE: f32 = 6.0;
/// Distances above this are all the same to Otsu's method, so that highlights do not raise the threshold.
const MOST_DISTANCE: f32 = 60.0;
/// How much a difference in lightness counts beside one in hue and chroma.
const LIGHTNESS_WEIGHT: f32 = 0.5;
/// Parts of the image that an object covers at least and at most.
const COVERED: [f32; 2] = [0.002, 0.95];
/// Holes up to this part of the object are filled; larger ones are seen through, as of a handle.
const LARGEST_HOLE: f32 = 0.02;

/// Pixels of a photograph above which the object is found in a smaller one: memory and time stay bounded.
const MOST_PIXELS: f64 = 4e6;

/// The mask of the object in a photograph, 0 or 255. `Err` says why there is none.
pub(super) fn mask_before_backdrop(photograph: &RgbImage) -> Result<GrayImage, String> {
    let (width, height) = photograph.dimensions();
    let shrink = (f64::from(width) * f64::from(height) / MOST_PIXELS).sqrt();
    if shrink <= 1.0 {
        return mask_at_full_size(photograph);
    }
    let small = [width, height].map(|side| ((f64::from(side) / shrink) as u32).max(1));
    let mask = mask_at_full_size(&thumbnail(photograph, small[0], small[1]))?;
    let mut mask = resize(&mask, width, height, FilterType::Triangle);
    mask.pixels_mut().for_each(|pixel| pixel.0[0] = if pixel.0[0] < 128 { 0 } else { 255 });
    Ok(mask)
}

fn mask_at_full_size(photograph: &RgbImage) -> Result<GrayImage, String> {
    let (width, height) = photograph.dimensions();
    if width.min(height) < 8 {
        return Err(format!("{width}×{height} pixels are too few"));
    }
    let lab = Lab::of(photograph);
    let strip = lab.strip();
    let model = Backdrop::fit(&lab, &strip);
    let mut off: Vec<f32> = strip.iter().map(|i| model.distance(&lab, *i)).collect();
    off.sort_by(f32::total_cmp);
    if off[off.len() / 2] > PLAIN {
        return Err("the backdrop is not plain: along the frame, colors differ too much".to_owned());
    }
    let first = object(&lab, &model);
    let behind: Vec<usize> = (0..first.pixels.len()).filter(|i| !first.pixels[*i]).collect();
    let object = if behind.len() < strip.len() { first } else { object(&lab, &Backdrop::fit(&lab, &behind)) };
    let part = object.count() as f32 / object.pixels.len() as f32;
    if !(COVERED[0]..=COVERED[1]).contains(&part) {
        let percent = 100.0 * part;
        return Err(format!("what differs from the backdrop covers {percent:.1} % of the photograph"));
    }
    Ok(GrayImage::from_fn(width, height, |x, y| {
        Luma([if object.pixels[y as usize * object.width + x as usize] { 255 } else { 0 }])
    }))
}

/// What is not backdrop, cleaned.
fn object(lab: &Lab, model: &Backdrop) -> Bits {
    let distances: Vec<f32> = (0..lab.pixels.len()).map(|i| model.distance(lab, i)).collect();
    let threshold = otsu(&distances).max(LEAST_DISTANCE);
    let pixels = distances.iter().map(|distance| *distance > threshold).collect();
    let radius = (lab.width.min(lab.height) / 400).max(1);
    let found = Bits { width: lab.width, height: lab.height, pixels };
    let clean = found.closed(radius).opened(radius).largest_region();
    clean.filled((LARGEST_HOLE * clean.count() as f32) as usize)
}

/// An image in CIE L*a*b* with white point D65.
struct Lab {
    width: usize,
    height: usize,
    pixels: Vec<[f32; 3]>,
}

impl Lab {
    fn of(photograph: &RgbImage) -> Self {
        let linear: Vec<f32> =
            (0..=255u16).map(|stored| linear_from_srgb(f32::from(stored) / 255.0)).collect();
        let cube = |t: f32| if t > 0.008_856 { t.cbrt() } else { 7.787 * t + 16.0 / 116.0 };
        let pixel = |rgb: &image::Rgb<u8>| {
            let [r, g, b] = rgb.0.map(|stored| linear[usize::from(stored)]);
            let x = cube((0.4124 * r + 0.3576 * g + 0.1805 * b) / 0.9505);
            let y = cube(0.2126 * r + 0.7152 * g + 0.0722 * b);
            let z = cube((0.0193 * r + 0.1192 * g + 0.9505 * b) / 1.089);
            [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
        };
        let (width, height) = (photograph.width() as usize, photograph.height() as usize);
        Self { width, height, pixels: photograph.pixels().map(pixel).collect() }
    }

    /// The pixels near the frame.
    fn strip(&self) -> Vec<usize> {
        let depth = ((STRIP * self.width.min(self.height) as f32) as usize).max(2);
        let near = |i: usize, length: usize| i < depth || i + depth >= length;
        let inside = |i: &usize| near(i % self.width, self.width) || near(i / self.width, self.height);
        (0..self.pixels.len()).filter(inside).collect()
    }

    /// The terms of the polynomial at a pixel, of coordinates from −1 to 1.
    fn terms(&self, i: usize) -> [f64; 6] {
        let x = 2.0 * (i % self.width) as f64 / (self.width - 1) as f64 - 1.0;
        let y = 2.0 * (i / self.width) as f64 / (self.height - 1) as f64 - 1.0;
        [1.0, x, y, x * x, x * y, y * y]
    }
}

/// The color of the backdrop over the image: a polynomial per channel.
struct Backdrop([[f64; 6]; 3]);

impl Backdrop {
    /// A robust least-squares fit to some pixels.
    fn fit(lab: &Lab, pixels: &[usize]) -> Self {
        let chosen: Vec<usize> =
            pixels.iter().copied().step_by(pixels.len().div_ceil(FITTED_PIXELS)).collect();
        let mut model = Self::constant(lab, &chosen);
        for _ in 0..FIT_ROUNDS {
            let mut off: Vec<f32> = chosen.iter().map(|i| model.distance(lab, *i)).collect();
            let all = off.clone();
            off.sort_by(f32::total_cmp);
            let limit = (2.5 * off[off.len() / 2]).max(2.0);
            let explained = chosen.iter().zip(&all).filter(|(_, off)| **off <= limit).map(|(i, _)| *i);
            model = Self::least_squares(lab, explained).unwrap_or(model);
        }
        model
    }

    /// The median of each channel.
    fn constant(lab: &Lab, pixels: &[usize]) -> Self {
        Self([0, 1, 2].map(|channel| {
            let mut values: Vec<f32> = pixels.iter().map(|i| lab.pixels[*i][channel]).collect();
            values.sort_by(f32::total_cmp);
            [f64::from(values[values.len() / 2]), 0.0, 0.0, 0.0, 0.0, 0.0]
        }))
    }

    fn least_squares(lab: &Lab, pixels: impl Iterator<Item = usize>) -> Option<Self> {
        let mut normal = [[0.0; 9]; 6];
        for i in pixels {
            let terms = lab.terms(i);
            for (row, term) in normal.iter_mut().zip(terms) {
                row[..6].iter_mut().zip(terms).for_each(|(cell, other)| *cell += term * other);
                row[6..]
                    .iter_mut()
                    .zip(lab.pixels[i])
                    .for_each(|(cell, value)| *cell += term * f64::from(value));
            }
        }
        let weight = normal[0][0];
        // Keeps terms small of which the pixels say nothing, such as a slope across a strip.
        (0..6).for_each(|k| normal[k][k] += 1e-6 * weight);
        solve(normal).map(Self)
    }

    /// The distance of a pixel's color from the backdrop's.
    fn distance(&self, lab: &Lab, i: usize) -> f32 {
        let terms = lab.terms(i);
        let channel = |k: usize| {
            let expected: f64 = self.0[k].iter().zip(terms).map(|(c, term)| c * term).sum();
            lab.pixels[i][k] - expected as f32
        };
        let lightness = LIGHTNESS_WEIGHT * channel(0);
        (lightness * lightness + channel(1).powi(2) + channel(2).powi(2)).sqrt()
    }
}

/// Gauss–Jordan elimination of a symmetric positive definite 6×6 system with three right-hand sides.
fn solve(mut rows: [[f64; 9]; 6]) -> Option<[[f64; 6]; 3]> {
    for k in 0..6 {
        let pivot = rows[k][k];
        if pivot.is_nan() || pivot <= 1e-12 {
            return None;
        }
        rows[k].iter_mut().for_each(|cell| *cell /= pivot);
        let row = rows[k];
        for other in (0..6).filter(|other| *other != k) {
            let factor = rows[other][k];
            rows[other].iter_mut().zip(row).for_each(|(cell, value)| *cell -= factor * value);
        }
    }
    Some([6, 7, 8].map(|side| std::array::from_fn(|k| rows[k][side])))
}

/// Otsu's threshold: it separates the values into two classes with the least variance within them.
fn otsu(values: &[f32]) -> f32 {
    const BINS: usize = 256;
    let mut counts = [0u64; BINS];
    for value in values {
        counts[((value / MOST_DISTANCE * BINS as f32) as usize).min(BINS - 1)] += 1;
    }
    let sum = |range: std::ops::Range<usize>| -> (f64, f64) {
        range.fold((0.0, 0.0), |(n, s), k| (n + counts[k] as f64, s + k as f64 * counts[k] as f64))
    };
    let between = |split: usize| {
        let ((n0, s0), (n1, s1)) = (sum(0..split), sum(split..BINS));
        if n0 == 0.0 || n1 == 0.0 { 0.0 } else { n0 * n1 * (s0 / n0 - s1 / n1).powi(2) }
    };
    let best = (1..BINS).max_by(|a, b| between(*a).total_cmp(&between(*b)).then(b.cmp(a))).unwrap_or(1);
    best as f32 / BINS as f32 * MOST_DISTANCE
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::prepare::test_data::disc;
    use image::Rgb;

    fn overlap(mask: &GrayImage, is_object: impl Fn(f32, f32) -> bool) -> f64 {
        let (mut both, mut either) = (0, 0);
        for (x, y, pixel) in mask.enumerate_pixels() {
            let (found, truth) = (pixel.0[0] > 0, is_object(x as f32 + 0.5, y as f32 + 0.5));
            both += u32::from(found && truth);
            either += u32::from(found || truth);
        }
        f64::from(both) / f64::from(either)
    }

    #[test]
    fn an_object_before_unevenly_lit_paper_is_found() {
        let mask = mask_before_backdrop(&disc(120, 90)).unwrap();
        let truth = |x: f32, y: f32| (x - 60.0).hypot(y - 45.0) < 22.5;
        assert!(overlap(&mask, truth) > 0.97, "{}", overlap(&mask, truth));
        assert!(mask.pixels().all(|pixel| pixel.0[0] == 0 || pixel.0[0] == 255));
    }

    /// A shadow on the paper is no object, a speck neither; a highlight inside the object is filled; a support that reaches the
    /// frame does not change what the backdrop is.
    #[test]
    fn shadows_specks_and_highlights_are_understood() {
        let mut picture = disc(200, 200);
        for (x, y, pixel) in picture.enumerate_pixels_mut() {
            let at = |cx: f32, cy: f32| (x as f32 - cx).hypot(y as f32 - cy);
            if at(130.0, 150.0) < 25.0 && at(100.0, 100.0) > 50.0 {
                pixel.0 = pixel.0.map(|value| (f32::from(value) * 0.94) as u8);
            }
            if at(90.0, 90.0) < 4.0 {
                *pixel = Rgb([190, 190, 190]);
            }
            if at(20.0, 60.0) < 3.0 || ((80..120).contains(&x) && y > 140) {
                *pixel = Rgb([30, 60, 150]);
            }
        }
        let mask = mask_before_backdrop(&picture).unwrap();
        let truth =
            |x: f32, y: f32| (x - 100.0).hypot(y - 100.0) < 50.0 || ((80.0..120.0).contains(&x) && y > 140.0);
        assert!(overlap(&mask, truth) > 0.97, "{}", overlap(&mask, truth));
        assert_eq!(mask.get_pixel(90, 90).0[0], 255);
        assert_eq!(mask.get_pixel(20, 60).0[0], 0);
    }

    #[test]
    fn what_has_no_plain_backdrop_is_refused() {
        let tiles = RgbImage::from_fn(80, 60, |x, y| {
            if (x / 6 + y / 6) % 2 == 0 { Rgb([230, 30, 30]) } else { Rgb([20, 90, 200]) }
        });
        assert!(mask_before_backdrop(&tiles).unwrap_err().contains("not plain"));
        let empty = RgbImage::from_pixel(80, 60, Rgb([120, 130, 140]));
        assert!(mask_before_backdrop(&empty).unwrap_err().contains("covers 0.0 %"));
        assert!(mask_before_backdrop(&RgbImage::new(4, 100)).unwrap_err().contains("too few"));
    }

    #[test]
    fn large_photographs_are_segmented_in_a_smaller_one() {
        let mask = mask_before_backdrop(&disc(2600, 1800)).unwrap();
        assert_eq!(mask.dimensions(), (2600, 1800));
        let truth = |x: f32, y: f32| (x - 1300.0).hypot(y - 900.0) < 450.0;
        assert!(overlap(&mask, truth) > 0.98, "{}", overlap(&mask, truth));
    }

    #[test]
    fn two_classes_are_separated() {
        let values: Vec<f32> =
            (0..200).map(|k| if k % 4 == 0 { 40.0 } else { 2.0 + 0.01 * k as f32 }).collect();
        let threshold = otsu(&values);
        assert!((4.0..40.0).contains(&threshold), "{threshold}");
    }
}
