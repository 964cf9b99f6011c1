//! One 256-color palette for a whole animation, and dithering that is constant over time.
//!
//! A palette per frame flickers and error diffusion changes from frame to frame. Here a GIF has one palette for all frames, made by variance-based cuts
//! (after X. Wu, "Efficient Statistical Computations for Optimal Color Quantization", Graphics Gems II, 1991) with a few rounds of
//! Lloyd's algorithm, and an ordered dither (T. Knoll's pattern dithering) that depends on the position of a pixel only.

use image::{Rgb, RgbImage};
use std::collections::{BTreeSet, HashMap};

/// A palette of at most 256 sRGB colors.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Palette {
    /// The colors.
    pub colors: Vec<[u8; 3]>,
}

/// A histogram cell: mean color and number of pixels.
#[derive(Clone, Copy)]
struct Bin {
    color: [f64; 3],
    weight: f64,
}

/// The colors of frames that are seen one at a time.
pub struct ColorHistogram {
    /// All of them, until they are more than [`Self::FEW`].
    few: BTreeSet<[u8; 3]>,
    /// Sums and numbers of pixels by the top six bits of each channel.
    cells: Vec<([u64; 3], u64)>,
}

impl Default for ColorHistogram {
    fn default() -> Self {
        Self { few: BTreeSet::new(), cells: vec![([0; 3], 0); 1 << 18] }
    }
}

impl ColorHistogram {
    /// The most colors that a palette can hold.
    const FEW: usize = 256;

    /// Counts the pixels of a frame.
    pub fn add(&mut self, frame: &RgbImage) {
        for pixel in frame.pixels() {
            if self.few.len() <= Self::FEW {
                self.few.insert(pixel.0);
            }
            let cell = pixel.0.iter().fold(0, |cell, c| cell << 6 | usize::from(c >> 2));
            let (sum, count) = &mut self.cells[cell];
            (0..3).for_each(|i| sum[i] += u64::from(pixel.0[i]));
            *count += 1;
        }
    }

    /// The mean of each cell that has pixels.
    fn bins(&self) -> Vec<Bin> {
        let filled = self.cells.iter().filter(|(_, count)| *count > 0);
        let bin = |(sum, count): &([u64; 3], u64)| Bin {
            color: sum.map(|s| s as f64 / *count as f64),
            // Weights grow more slowly than counts, so that a large uniform backdrop does not use up the palette.
            weight: (*count as f64).powf(0.75),
        };
        filled.map(bin).collect()
    }
}

impl Palette {
    /// The palette of at most `most` colors (1 to 256) for frames of these colors; exact if they have at most that many.
    pub fn of(colors: &ColorHistogram, most: usize) -> Self {
        let most = most.clamp(1, ColorHistogram::FEW);
        if colors.few.len() <= most {
            return Self { colors: colors.few.iter().copied().collect() };
        }
        let bins = colors.bins();
        let mut boxes = vec![bins.clone()];
        while boxes.len() < most {
            let Some(widest) = widest(&boxes) else { break };
            let (low, high) = cut(boxes.swap_remove(widest));
            boxes.extend([low, high]);
        }
        let mut means: Vec<[f64; 3]> = boxes.iter().map(|bins| mean(bins)).collect();
        for _ in 0..4 {
            means = refined(&bins, &means);
        }
        let mut colors: Vec<[u8; 3]> =
            means.iter().map(|m| m.map(|c| c.round().clamp(0.0, 255.0) as u8)).collect();
        colors.sort_unstable();
        colors.dedup();
        Self { colors }
    }

    /// Number of the color nearest to `color`, by squared sRGB distance; the first of equal ones.
    fn nearest(&self, color: [i32; 3]) -> u8 {
        let distance = |c: &[u8; 3]| (0..3).map(|i| (i32::from(c[i]) - color[i]).pow(2)).sum::<i32>();
        (0..=u8::MAX).zip(&self.colors).min_by_key(|(_, c)| distance(c)).map_or(0, |(number, _)| number)
    }
}

fn mean(bins: &[Bin]) -> [f64; 3] {
    let weight: f64 = bins.iter().map(|bin| bin.weight).sum();
    std::array::from_fn(|c| bins.iter().map(|bin| bin.weight * bin.color[c]).sum::<f64>() / weight)
}

/// Weighted squared deviation per channel.
fn spread(bins: &[Bin]) -> [f64; 3] {
    let mean = mean(bins);
    std::array::from_fn(|c| bins.iter().map(|bin| bin.weight * (bin.color[c] - mean[c]).powi(2)).sum())
}

/// The box with the largest squared deviation; `None` if no box can be cut.
fn widest(boxes: &[Vec<Bin>]) -> Option<usize> {
    let total = |bins: &Vec<Bin>| spread(bins).iter().sum::<f64>();
    let scores =
        boxes.iter().enumerate().filter(|(_, bins)| bins.len() > 1).map(|(i, bins)| (i, total(bins)));
    scores.max_by(|a, b| a.1.total_cmp(&b.1)).map(|(i, _)| i)
}

/// Cuts a box of at least two bins at its mean along the channel of largest deviation.
fn cut(bins: Vec<Bin>) -> (Vec<Bin>, Vec<Bin>) {
    let (spread, mean) = (spread(&bins), mean(&bins));
    let axis = (0..3).max_by(|&a, &b| spread[a].total_cmp(&spread[b])).unwrap_or(0);
    let (low, high): (Vec<Bin>, Vec<Bin>) = bins.iter().partition(|bin| bin.color[axis] < mean[axis]);
    if low.is_empty() || high.is_empty() {
        // This happens only through rounding (nearly equal colors); the box is still halved, so that the loop ends.
        let (low, high) = bins.split_at(bins.len() / 2);
        return (low.to_vec(), high.to_vec());
    }
    (low, high)
}

/// One round of Lloyd's algorithm; a mean without pixels stays unchanged.
fn refined(bins: &[Bin], means: &[[f64; 3]]) -> Vec<[f64; 3]> {
    let mut sums = vec![([0.0; 3], 0.0); means.len()];
    for bin in bins {
        let distance = |m: &[f64; 3]| (0..3).map(|c| (m[c] - bin.color[c]).powi(2)).sum::<f64>();
        let nearest = means.iter().enumerate().min_by(|a, b| distance(a.1).total_cmp(&distance(b.1)));
        let (sum, weight): &mut ([f64; 3], f64) = &mut sums[nearest.map_or(0, |(i, _)| i)];
        (0..3).for_each(|c| sum[c] += bin.weight * bin.color[c]);
        *weight += bin.weight;
    }
    let settled = |(&(sum, weight), old): (&([f64; 3], f64), &[f64; 3])| {
        if weight > 0.0 { sum.map(|s| s / weight) } else { *old }
    };
    sums.iter().zip(means).map(settled).collect()
}

/// Rank of each place of a 4×4 tile (Bayer), 0 to 15.
const RANKS: [[usize; 4]; 4] = [[0, 8, 2, 10], [12, 4, 14, 6], [3, 11, 1, 9], [15, 7, 13, 5]];

/// Fraction of the remaining error that the next candidate corrects; a value below 1 reduces grain.
const STRENGTH: f32 = 0.8;

/// Colors that a cache holds before it starts again.
const CACHED: usize = 1 << 20;

/// Dithers frames to a palette, with a cache per color.
pub(crate) struct Ditherer<'a> {
    palette: &'a Palette,
    candidates: HashMap<[u8; 3], [u8; 16]>,
    nearest: HashMap<[i32; 3], u8>,
}

impl<'a> Ditherer<'a> {
    /// A ditherer for `palette`.
    pub fn new(palette: &'a Palette) -> Self {
        Self { palette, candidates: HashMap::new(), nearest: HashMap::new() }
    }

    /// `frame` as numbers of the palette's colors, row by row.
    pub fn dithered(&mut self, frame: &RgbImage) -> Vec<u8> {
        let number = |(x, y, pixel): (u32, u32, &Rgb<u8>)| {
            self.candidates_of(pixel.0)[RANKS[y as usize % 4][x as usize % 4]]
        };
        frame.enumerate_pixels().map(number).collect()
    }

    /// Sixteen colors of the palette by number, dark to light, whose mean is about `color`; all equal if the palette contains it.
    fn candidates_of(&mut self, color: [u8; 3]) -> [u8; 16] {
        if let Some(known) = self.candidates.get(&color) {
            return *known;
        }
        if self.candidates.len().max(self.nearest.len()) > CACHED {
            self.candidates.clear();
            self.nearest.clear();
        }
        let mut error = [0.0f32; 3];
        let mut chosen = [0u8; 16];
        for slot in &mut chosen {
            let aim: [i32; 3] =
                std::array::from_fn(|c| (f32::from(color[c]) + STRENGTH * error[c]).round() as i32);
            *slot = *self.nearest.entry(aim).or_insert_with(|| self.palette.nearest(aim));
            let near = self.palette.colors[usize::from(*slot)];
            (0..3).for_each(|c| error[c] += f32::from(color[c]) - f32::from(near[c]));
        }
        let luma = |c: [u8; 3]| 299 * u32::from(c[0]) + 587 * u32::from(c[1]) + 114 * u32::from(c[2]);
        chosen.sort_by_key(|number| luma(self.palette.colors[usize::from(*number)]));
        self.candidates.insert(color, chosen);
        chosen
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ramp() -> RgbImage {
        RgbImage::from_fn(128, 64, |x, y| Rgb([x as u8 * 2, y as u8 * 4, (x + y) as u8]))
    }

    fn palette(frame: &RgbImage, most: usize) -> Palette {
        let mut colors = ColorHistogram::default();
        colors.add(frame);
        Palette::of(&colors, most)
    }

    /// `frame` in colors of the palette.
    fn dithered(ditherer: &mut Ditherer, frame: &RgbImage) -> RgbImage {
        let numbers = ditherer.dithered(frame);
        let colors = numbers.iter().flat_map(|number| ditherer.palette.colors[usize::from(*number)]);
        RgbImage::from_raw(frame.width(), frame.height(), colors.collect()).unwrap()
    }

    #[test]
    fn few_colors_are_kept_exactly() {
        let frame = RgbImage::from_fn(16, 16, |x, y| Rgb([x as u8, y as u8, 77]));
        let palette = palette(&frame, 256);
        assert_eq!(palette.colors.len(), 256);
        assert_eq!(dithered(&mut Ditherer::new(&palette), &frame), frame);
    }

    #[test]
    fn many_colors_are_met_on_average() {
        let frame = ramp();
        let palette = palette(&frame, 64);
        assert!(palette.colors.len() > 60 && palette.colors.len() <= 64);
        let dithered = dithered(&mut Ditherer::new(&palette), &frame);
        let block_mean = |image: &RgbImage, left: u32, top: u32, c: usize| {
            let sum: u32 = (0..64).map(|i| u32::from(image.get_pixel(left + i % 8, top + i / 8).0[c])).sum();
            sum as f32 / 64.0
        };
        let mut worst = 0.0f32;
        for (left, top) in (0..128).map(|i| (i % 16 * 8, i / 16 * 8)) {
            for c in 0..3 {
                let gap = block_mean(&frame, left, top, c) - block_mean(&dithered, left, top, c);
                worst = worst.max(gap.abs());
            }
        }
        assert!(worst < 14.0, "{worst}");
    }

    #[test]
    fn dither_of_a_still_part_stands_still() {
        let palette = palette(&ramp(), 32);
        let mut ditherer = Ditherer::new(&palette);
        let first = dithered(&mut ditherer, &ramp());
        let mut moved = ramp();
        (0..64).for_each(|y| moved.put_pixel(0, y, Rgb([255, 0, 255])));
        let second = dithered(&mut ditherer, &moved);
        assert!(first.enumerate_pixels().all(|(x, y, p)| x == 0 || second.get_pixel(x, y) == p));
    }
}
