//! How sharp a photograph is, as one number that can be compared with that of photographs from nearly the same side.

use crate::math::color::luminance;
use crate::view::Image;
use serde::{Deserialize, Serialize};

/// Pixels of the halved picture that a measure needs.
const LEAST_PIXELS: usize = 32;
/// Distance of a pixel of the halved picture from the silhouette.
const MARGIN: usize = 2;
/// Least detail that is measured: below it there is nothing but rounding.
const LEAST_DETAIL: f32 = 1e-9;
/// Brightest value that counts, in medians: highlights come and go from view to view.
const MOST: f32 = 4.0;

/// How much fine detail a photograph has: mean squares of second derivatives of the square root of luminance, relative to the median, in
/// halved resolution (which takes most of the noise out).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Sharpness {
    /// Of the Laplacian: the same for all directions.
    pub everywhere: f32,
    /// Along the one of four directions where there is least: motion blurs along one direction only.
    pub least: f32,
}

/// A photograph in halved resolution.
struct Halved {
    width: usize,
    height: usize,
    /// Square root of luminance relative to the median; `None` where not all of four pixels are the object's.
    values: Vec<Option<f32>>,
}

impl Halved {
    fn new(image: &Image, median: f32, inside: impl Fn(usize) -> bool) -> Self {
        let (width, height) = (image.width as usize / 2, image.height as usize / 2);
        let full = image.width as usize;
        let value = |i: usize| (luminance(image.pixels[i]) / median).clamp(0.0, MOST).sqrt();
        let halved = |i: usize| {
            let corner = 2 * (i / width) * full + 2 * (i % width);
            let block = [corner, corner + 1, corner + full, corner + full + 1];
            block.iter().all(|&i| inside(i)).then(|| block.iter().map(|&i| value(i)).sum::<f32>() / 4.0)
        };
        Self { width, height, values: (0..width * height).map(halved).collect() }
    }

    /// Whether all pixels around this one have a value. The silhouette is no detail of the object, and a blurred one reaches a little way in.
    fn is_inner(&self, x: usize, y: usize) -> bool {
        (y - MARGIN..=y + MARGIN).all(|row| {
            let row = row * self.width;
            self.values[row + x - MARGIN..=row + x + MARGIN].iter().all(Option::is_some)
        })
    }

    /// Second derivatives at a pixel: across, down, and along both diagonals.
    fn second(&self, x: usize, y: usize) -> [f32; 4] {
        let i = y * self.width + x;
        let at = |i: usize| self.values[i].unwrap_or(0.0);
        // With the square of the step.
        let directions = [(1, 1.0f32), (self.width, 1.0), (self.width + 1, 2.0), (self.width - 1, 2.0)];
        directions.map(|(step, square)| (at(i - step) + at(i + step) - 2.0 * at(i)) / square)
    }
}

/// The sharpness of a photograph: `median` is the median luminance in the object, `inside(i)` says whether pixel i is the object's.
///
/// A blur of two pixels lowers it at least fourfold where the object has texture. `None` for fewer than 32 pixels, or no detail at all.
pub fn sharpness(image: &Image, median: f32, inside: impl Fn(usize) -> bool) -> Option<Sharpness> {
    if median <= 0.0 || !median.is_finite() {
        return None;
    }
    let halved = Halved::new(image, median, inside);
    let (mut laplacian, mut along, mut count) = (0.0f64, [0.0f64; 4], 0usize);
    for y in MARGIN..halved.height.saturating_sub(MARGIN) {
        for x in MARGIN..halved.width.saturating_sub(MARGIN) {
            if !halved.is_inner(x, y) {
                continue;
            }
            let second = halved.second(x, y);
            laplacian += f64::from(second[0] + second[1]).powi(2);
            along.iter_mut().zip(second).for_each(|(sum, second)| *sum += f64::from(second).powi(2));
            count += 1;
        }
    }
    let mean = |sum: f64| (sum / count as f64) as f32;
    let least = mean(along.into_iter().fold(f64::INFINITY, f64::min));
    let found = Sharpness { everywhere: mean(laplacian), least };
    (count >= LEAST_PIXELS && least > LEAST_DETAIL).then_some(found)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    fn textured(blur: bool) -> Image {
        let value = |i: u32| {
            let (x, y) = (i % 40, i / 40);
            Vec3::splat(if (x / 3 + y / 3).is_multiple_of(2) { 0.2 } else { 0.6 })
        };
        let pixels: Vec<Vec3> = (0..1600).map(value).collect();
        let near = |i: i32| {
            let taps = (-2..=2).flat_map(|dy: i32| (-2..=2).map(move |dx: i32| i + 40 * dy + dx));
            taps.map(|k| pixels[k.clamp(0, 1599) as usize]).sum::<Vec3>() / 25.0
        };
        let blurred = (0..1600).map(near).collect();
        Image { width: 40, height: 40, pixels: if blur { blurred } else { pixels } }
    }

    #[test]
    fn a_blurred_texture_is_less_sharp_at_any_exposure() {
        let sharp = sharpness(&textured(false), 0.4, |_| true).unwrap();
        let blurred = sharpness(&textured(true), 0.4, |_| true).unwrap();
        assert!(blurred.everywhere < 0.25 * sharp.everywhere, "{blurred:?} {sharp:?}");
        assert!(blurred.least < 0.25 * sharp.least, "{blurred:?} {sharp:?}");
        let mut brighter = textured(false);
        brighter.pixels.iter_mut().for_each(|pixel| *pixel *= 8.0);
        let again = sharpness(&brighter, 3.2, |_| true).unwrap();
        assert!((again.everywhere - sharp.everywhere).abs() < 1e-4, "{again:?} {sharp:?}");
    }

    #[test]
    fn motion_along_any_direction_is_a_blur() {
        let sharp = sharpness(&textured(false), 0.4, |_| true).unwrap();
        for step in [1, 40, 41, 39, 82] {
            let Image { pixels, .. } = textured(false);
            let moved = |i: i32| {
                let taps = (-4..=4).map(|k: i32| pixels[(i + k * step).clamp(0, 1599) as usize]);
                taps.sum::<Vec3>() / 9.0
            };
            let blurred = Image { width: 40, height: 40, pixels: (0..1600).map(moved).collect() };
            let blurred = sharpness(&blurred, 0.4, |_| true).unwrap();
            assert!(blurred.least < 0.25 * sharp.least, "{step}: {blurred:?} {sharp:?}");
        }
    }

    #[test]
    fn nothing_to_measure_has_no_sharpness() {
        let flat = Image { width: 40, height: 40, pixels: vec![Vec3::splat(0.3); 1600] };
        assert_eq!(sharpness(&flat, 0.3, |_| true), None);
        assert_eq!(sharpness(&textured(false), 0.4, |i| i < 200), None);
        assert_eq!(sharpness(&textured(false), 0.0, |_| true), None);
        assert_eq!(sharpness(&Image::default(), 0.4, |_| true), None);
    }
}
