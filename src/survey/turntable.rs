//! Captures on a turntable: cameras on rings, before a background that is the same in all photographs. The light's own frame is found by a
//! fit, with or without a background.

use crate::math::statistics::median;
use crate::survey::cameras::{Arrangement, ArrangementKind};
use crate::survey::finding::Finding;

/// Most pixels a side of the backgrounds that are compared.
pub(crate) const BACKGROUND_SIDE: u32 = 64;
/// Photographs that are compared.
pub(crate) const BACKGROUNDS: usize = 12;
/// Pixels that must be background in all of them.
const LEAST_PIXELS: usize = 150;
/// Standard deviation over the background below which it is plain, in square roots of its mean luminance.
const PLAIN: f32 = 0.03;
/// Correlation between backgrounds from which on they are the same.
const SAME: f32 = 0.85;

/// The background of one photograph, before its mask makes it black.
#[derive(Clone, Debug, PartialEq)]
pub struct Background {
    /// Width and height in pixels.
    pub size: [u32; 2],
    /// Square root of luminance of each pixel; `None` where the object is.
    pub values: Vec<Option<f32>>,
}

/// Median correlation of each background with the mean of the others, over pixels that are background in all. `None` if they differ in
/// size, leave too few pixels, or are plain.
pub(crate) fn sameness(backgrounds: &[Background]) -> Option<f32> {
    let first = backgrounds.first().filter(|_| backgrounds.len() >= 3)?;
    if backgrounds.iter().any(|background| background.size != first.size) {
        return None;
    }
    let common: Vec<usize> = (0..first.values.len())
        .filter(|&i| backgrounds.iter().all(|background| background.values[i].is_some()))
        .collect();
    if common.len() < LEAST_PIXELS {
        return None;
    }
    let rows: Vec<Vec<f32>> = backgrounds
        .iter()
        .map(|background| common.iter().filter_map(|&i| background.values[i]).collect())
        .collect();
    let count = rows.len() as f32;
    let sums: Vec<f32> = (0..common.len()).map(|i| rows.iter().map(|row| row[i]).sum()).collect();
    let mean = sums.iter().sum::<f32>() / (count * common.len() as f32);
    let spread = deviation(&sums) / count;
    if spread <= PLAIN * mean.max(0.05) {
        return None;
    }
    let one = |row: &Vec<f32>| {
        let others: Vec<f32> =
            sums.iter().zip(row).map(|(sum, value)| (sum - value) / (count - 1.0)).collect();
        correlation(row, &others)
    };
    median(&mut rows.iter().map(one).collect::<Vec<_>>())
}

fn deviation(values: &[f32]) -> f32 {
    let mean = values.iter().sum::<f32>() / values.len() as f32;
    (values.iter().map(|value| (value - mean).powi(2)).sum::<f32>() / values.len() as f32).sqrt()
}

/// 0 where one of the two does not vary.
fn correlation(a: &[f32], b: &[f32]) -> f32 {
    let mean = |values: &[f32]| values.iter().sum::<f32>() / values.len() as f32;
    let (mean_a, mean_b) = (mean(a), mean(b));
    let product: f32 = a.iter().zip(b).map(|(a, b)| (a - mean_a) * (b - mean_b)).sum();
    let both = deviation(a) * deviation(b) * a.len() as f32;
    if both > 0.0 { product / both } else { 0.0 }
}

/// Whether the object turned before a camera that stood still.
pub(crate) fn is_turntable(arrangement: Option<&Arrangement>, sameness: Option<f32>) -> bool {
    let rings = arrangement.is_some_and(|arrangement| matches!(arrangement.kind, ArrangementKind::Rings(_)));
    rings && sameness.is_some_and(|sameness| sameness >= SAME)
}

/// What a turntable means for a fit.
pub(crate) fn finding(sameness: f32) -> Finding {
    let problem = format!(
        "this is a turntable capture: the cameras lie on a ring and the background is the same in all photographs (correlation \
         {sameness:.2}), so the light did not turn with the object"
    );
    let help = "A fit of an unknown light finds that by itself, unless `light_frame` says otherwise; see Turntables in the manual's chapter on photographs.";
    Finding::warning("turntable", Vec::new(), problem, help)
}
