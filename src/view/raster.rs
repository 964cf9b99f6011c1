//! Operations on images and masks as grids: box filtering, interpolation and erosion.

use crate::view::image::{Image, Mask};
use glam::{DVec3, Vec3};

/// Coverage above which a pixel counts as fully covered (8-bit masks hold 254/255 = 0.996 and 1).
pub(crate) const FULL_COVERAGE: f32 = 0.999;

impl Image {
    /// The image `factor` times smaller along each axis; each pixel is the mean of its block. Remaining pixels at the right and
    /// bottom edge are dropped, as in [`crate::view::Camera::scaled`]. A `factor` of 0 counts as 1.
    pub fn downscaled(&self, factor: u32) -> Self {
        let (width, height) = small_size(self.width, self.height, factor);
        let scale = 1.0 / f64::from(factor.max(1)).powi(2);
        let pixels = blocks(self.width, self.height, factor)
            .map(|block| {
                let sum: DVec3 = block.map(|i| self.pixels[i].as_dvec3()).sum();
                Vec3::new((sum.x * scale) as f32, (sum.y * scale) as f32, (sum.z * scale) as f32)
            })
            .collect();
        Self { width, height, pixels }
    }
}

impl Mask {
    /// The mask `factor` times smaller along each axis; see [`Image::downscaled`].
    pub fn downscaled(&self, factor: u32) -> Self {
        let (width, height) = small_size(self.width, self.height, factor);
        let scale = 1.0 / f64::from(factor.max(1)).powi(2);
        let coverage = blocks(self.width, self.height, factor)
            .map(|block| (block.map(|i| f64::from(self.coverage[i])).sum::<f64>() * scale) as f32)
            .collect();
        Self { width, height, coverage }
    }

    /// The fully covered interior of the mask: a pixel keeps its coverage if all pixels of the (2·`pixels` + 1)² around it have
    /// at least 0.999, and becomes 0 otherwise. Pixels outside the image count as uncovered. With
    /// `pixels` = 0 only partly covered pixels are removed.
    pub fn eroded(&self, pixels: u32) -> Self {
        let (width, height) = (self.width as usize, self.height as usize);
        let covered: Vec<bool> = self.coverage.iter().map(|&c| c >= FULL_COVERAGE).collect();
        let mut along_rows = vec![false; covered.len()];
        for y in 0..height {
            erode_line(&covered, &mut along_rows, y * width, 1, width, pixels as usize);
        }
        let mut along_both = vec![false; covered.len()];
        for x in 0..width {
            erode_line(&along_rows, &mut along_both, x, width, height, pixels as usize);
        }
        let coverage =
            self.coverage.iter().zip(&along_both).map(|(&c, &keep)| if keep { c } else { 0.0 }).collect();
        Self { width: self.width, height: self.height, coverage }
    }
}

/// Whether any pixel of each block is set; see [`Image::downscaled`].
pub(crate) fn any_downscaled(flags: &[bool], width: u32, height: u32, factor: u32) -> Vec<bool> {
    blocks(width, height, factor).map(|mut block| block.any(|i| flags[i])).collect()
}

fn small_size(width: u32, height: u32, factor: u32) -> (u32, u32) {
    (width / factor.max(1), height / factor.max(1))
}

/// For each pixel of the small image, row by row, the indices of its block in the large one.
fn blocks(width: u32, height: u32, factor: u32) -> impl Iterator<Item = impl Iterator<Item = usize>> {
    let (small_width, small_height) = small_size(width, height, factor);
    let (width, factor) = (width as usize, factor.max(1) as usize);
    (0..small_height as usize).flat_map(move |y| {
        (0..small_width as usize).map(move |x| {
            (0..factor)
                .flat_map(move |dy| (0..factor).map(move |dx| (y * factor + dy) * width + x * factor + dx))
        })
    })
}

/// Index of a pixel, and its weight in a sum.
pub(crate) type Tap = (usize, f32);

/// The four pixels around a position, with bilinear weights; (0, 0) is the center of the first pixel. Positions outside
/// are clamped to the border.
pub(crate) fn bilinear(width: u32, height: u32, x: f32, y: f32) -> [Tap; 4] {
    let split = |at: f32, count: u32| {
        let at = at.clamp(0.0, count.saturating_sub(1) as f32);
        let first = at as usize;
        (first, (first + 1).min(count.saturating_sub(1) as usize), at - first as f32)
    };
    let ((x0, x1, tx), (y0, y1, ty)) = (split(x, width), split(y, height));
    let width = width as usize;
    [
        (y0 * width + x0, (1.0 - tx) * (1.0 - ty)),
        (y0 * width + x1, tx * (1.0 - ty)),
        (y1 * width + x0, (1.0 - tx) * ty),
        (y1 * width + x1, tx * ty),
    ]
}

/// Erodes the `count` flags at `start`, `start + stride`, … by `radius`, counting runs of set flags.
fn erode_line(
    source: &[bool],
    target: &mut [bool],
    start: usize,
    stride: usize,
    count: usize,
    radius: usize,
) {
    let mut run = 0usize;
    for i in 0..count {
        run = if source[start + i * stride] { run + 1 } else { 0 };
        if run > 2 * radius {
            target[start + (i - radius) * stride] = true;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn brute_force(mask: &Mask, k: i64) -> Vec<f32> {
        let (w, h) = (i64::from(mask.width), i64::from(mask.height));
        let full = |x: i64, y: i64| {
            (0..w).contains(&x) && (0..h).contains(&y) && mask.coverage[(y * w + x) as usize] >= FULL_COVERAGE
        };
        (0..w * h)
            .map(|i| {
                let (x, y) = (i % w, i / w);
                let keep = (-k..=k).all(|dy| (-k..=k).all(|dx| full(x + dx, y + dy)));
                if keep { mask.coverage[i as usize] } else { 0.0 }
            })
            .collect()
    }

    proptest! {
        #[test]
        fn erosion_is_the_box_minimum(k in 0u32..4, seed in prop::collection::vec(0u8..12, 9 * 7)) {
            let coverage = seed.iter().map(|&s| if s == 0 { 0.5 } else { 1.0 - 1e-5 * f32::from(s) }).collect();
            let mask = Mask { width: 9, height: 7, coverage };
            prop_assert_eq!(mask.eroded(k).coverage, brute_force(&mask, i64::from(k)));
        }
    }

    #[test]
    fn a_full_mask_loses_its_border() {
        let mask = Mask { width: 5, height: 4, coverage: vec![1.0; 20] };
        let kept: f32 = mask.eroded(1).coverage.iter().sum();
        assert_eq!(kept, 6.0);
        assert_eq!(mask.eroded(2).coverage.iter().sum::<f32>(), 0.0);
        assert_eq!(mask.eroded(u32::MAX).coverage.iter().sum::<f32>(), 0.0);
        assert_eq!(mask.eroded(0), mask);
        assert_eq!(Mask::default().eroded(1), Mask::default());
    }

    #[test]
    fn bilinear_weights_are_exact_for_planes() {
        let plane = |x: f32, y: f32| 2.0 * x - 3.0 * y + 1.0;
        let values: Vec<f32> = (0..35).map(|i| plane((i % 7) as f32, (i / 7) as f32)).collect();
        let at = |x: f32, y: f32| bilinear(7, 5, x, y).iter().map(|tap| values[tap.0] * tap.1).sum::<f32>();
        for (x, y) in [(0.0, 0.0), (6.0, 4.0), (2.25, 3.5), (5.9, 0.1)] {
            assert!((at(x, y) - plane(x, y)).abs() < 1e-5);
        }
        assert_eq!((at(-3.0, 9.0), at(f32::NAN, 0.0).is_nan()), (plane(0.0, 4.0), true));
    }

    #[test]
    fn blocks_are_averaged_and_the_rest_dropped() {
        let pixels = (0..15).map(|i| Vec3::new(i as f32, 1.0, -2.0 * i as f32)).collect();
        let small = Image { width: 5, height: 3, pixels }.downscaled(2);
        assert_eq!((small.width, small.height), (2, 1));
        assert_eq!(small.pixels, [Vec3::new(3.0, 1.0, -6.0), Vec3::new(5.0, 1.0, -10.0)]);
        let mask = Mask { width: 2, height: 2, coverage: vec![1.0, 0.0, 0.5, 0.5] };
        assert_eq!(mask.downscaled(2).coverage, [0.5]);
        assert_eq!(any_downscaled(&[false, false, true, false], 4, 1, 1), [false, false, true, false]);
        assert_eq!(
            any_downscaled(&[false, false, false, true, false, false, false, false], 4, 2, 2),
            [false, true]
        );
    }
}
