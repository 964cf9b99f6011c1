//! The edge-avoiding à-trous wavelet: a joint bilateral filter of 5×5 taps, whose taps lie twice as far apart at each level (Dammertz et al.
//! 2010). How far a pixel's light may differ from another's follows the noise of the pixel, as in SVGF (Schied et al. 2017).

use crate::math::color::luminance;
use glam::Vec3;
use rayon::prelude::*;

/// What is known of a picture without noise, row by row. Pixels without coverage are neither changed nor mixed into others.
#[derive(Clone, Copy, Debug)]
pub struct Guides<'a> {
    /// Width in pixels.
    pub width: usize,
    /// Coverage by the object in `[0, 1]`.
    pub coverage: &'a [f32],
    /// Diffuse albedo, linear RGB in `[0, 1]`.
    pub albedo: &'a [Vec3],
    /// Unit normal, zero where it is unknown.
    pub normal: &'a [Vec3],
    /// World position.
    pub position: &'a [Vec3],
}

/// What keeps the filter from mixing two pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stops {
    /// Levels: the last one has taps 2^(levels − 1) pixels apart.
    pub levels: u32,
    /// Difference of luminance, in standard deviations of the noise, at which a weight falls to 1/e.
    pub deviations: f32,
    /// Factor of 1 − cosine between the normals in a weight's exponent.
    pub normal: f32,
    /// Factor of the squared sine by which the other point lies off the tangent plane in a weight's exponent.
    pub plane: f32,
    /// Factor of the squared difference of albedo in a weight's exponent.
    pub albedo: f32,
}

/// Light with noise, row by row.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct NoisyLight {
    /// The light, linear RGB.
    pub value: Vec<Vec3>,
    /// How much each channel of `value` counts, in `[0, 1]`; 0: it is unknown.
    pub confidence: Vec<Vec3>,
    /// Variance of the luminance of `value`; negative where it is unknown.
    pub variance: Vec<f32>,
}

/// Weights of the taps along an axis, from the middle: a cubic B-spline.
const SPLINE: [f32; 3] = [3.0 / 8.0, 1.0 / 4.0, 1.0 / 16.0];

/// Exponents from which a weight counts as zero.
const NEGLIGIBLE: f32 = 12.0;

/// Difference of luminance, relative to the larger one, that is rounding and no edge.
const ROUNDING: f32 = 1e-5;

/// Filters the light of a picture. What has no noise stays as it is. The result depends on the arguments only, not on threads.
pub fn filter(guides: &Guides, stops: &Stops, mut light: NoisyLight) -> Vec<Vec3> {
    light.variance = pooled(guides, stops, &light.variance);
    for level in 0..stops.levels {
        light = filter_level(guides, stops, light, 1 << level);
    }
    light.value
}

/// Luminance of the channels that are known.
pub fn known_luminance(value: Vec3, confidence: Vec3) -> f32 {
    let known = luminance(confidence);
    if known > 0.0 { luminance(value * confidence) / known } else { 0.0 }
}

/// One level, with taps `step` pixels apart.
fn filter_level(guides: &Guides, stops: &Stops, light: NoisyLight, step: usize) -> NoisyLight {
    let (mut value, mut variance) = (light.value.clone(), light.variance.clone());
    let level = Level {
        luminances: light
            .value
            .par_iter()
            .zip(&light.confidence)
            .map(|(v, c)| known_luminance(*v, *c))
            .collect(),
        smooth: blurred(guides, &light.variance),
        step,
    };
    let width = guides.width.max(1);
    let rows = value.par_chunks_mut(width).zip(variance.par_chunks_mut(width));
    rows.enumerate().for_each(|(row, (values, variances))| {
        for (column, (value, variance)) in values.iter_mut().zip(variances).enumerate() {
            let at = row * width + column;
            if guides.coverage[at] > 0.0 {
                level.sum(guides, stops, &light, at).finish(value, variance);
            }
        }
    });
    NoisyLight { value, variance, confidence: light.confidence }
}

/// What a level needs of all pixels beside the light.
struct Level {
    luminances: Vec<f32>,
    /// Variance of the luminance, smoothed.
    smooth: Vec<f32>,
    step: usize,
}

impl Level {
    /// The weighted sums around pixel `at`.
    fn sum(&self, guides: &Guides, stops: &Stops, light: &NoisyLight, at: usize) -> Sum {
        let own = self.luminances[at];
        let tolerance = (stops.deviations * self.smooth[at].sqrt()).max(f32::MIN_POSITIVE);
        let mut sum = Sum::default();
        guides.taps(at, self.step, |tap, spline| {
            let other = self.luminances[tap];
            let difference = (own - other).abs() - ROUNDING * own.abs().max(other.abs());
            let exponent = guides.exponent(stops, at, tap) + difference.max(0.0) / tolerance;
            if exponent < NEGLIGIBLE {
                sum.add(spline * (-exponent).exp(), light, tap);
            }
        });
        sum
    }
}

/// Sums of one pixel over its taps.
#[derive(Clone, Copy, Debug, Default)]
struct Sum {
    value: Vec3,
    weight: Vec3,
    variance: f32,
    total: f32,
}

impl Sum {
    fn add(&mut self, weight: f32, light: &NoisyLight, tap: usize) {
        let confidence = light.confidence[tap];
        let mean = weight * luminance(confidence);
        self.value += weight * confidence * light.value[tap];
        self.weight += weight * confidence;
        self.variance += mean * mean * light.variance[tap];
        self.total += mean;
    }

    /// Writes the means; a channel that no tap knows stays as it is.
    fn finish(self, value: &mut Vec3, variance: &mut f32) {
        let is_known = self.weight.cmpgt(Vec3::ZERO);
        *value = Vec3::select(is_known, self.value / self.weight, *value);
        if self.total > 0.0 {
            *variance = self.variance / (self.total * self.total);
        }
    }
}

/// The variance of few samples is itself noisy: its mean over 5×5 pixels of the same surface, or its own if that is larger.
fn pooled(guides: &Guides, stops: &Stops, variance: &[f32]) -> Vec<f32> {
    let mean = |at: usize| {
        let (mut sum, mut total) = (0.0, 0.0);
        guides.taps(at, 1, |tap, _| {
            if variance[tap] >= 0.0 {
                let exponent = guides.exponent(stops, at, tap);
                let weight = guides.coverage[tap] * (-exponent.min(NEGLIGIBLE)).exp();
                sum += weight * variance[tap];
                total += weight;
            }
        });
        (if total > 0.0 { sum / total } else { 0.0 }).max(variance[at])
    };
    (0..variance.len()).into_par_iter().with_min_len(1024).map(mean).collect()
}

/// Means over 3×3 covered pixels, weighted 1 2 1.
fn blurred(guides: &Guides, variance: &[f32]) -> Vec<f32> {
    let mean = |at: usize| {
        let (mut sum, mut total) = (0.0, 0.0);
        guides.window(at, 1, 1, |tap, [x, y]| {
            if guides.coverage[tap] > 0.0 {
                let weight = 1.0 / ((1 + x) * (1 + y)) as f32;
                sum += weight * variance[tap];
                total += weight;
            }
        });
        if total > 0.0 { sum / total } else { 0.0 }
    };
    (0..variance.len()).into_par_iter().with_min_len(1024).map(mean).collect()
}

impl Guides<'_> {
    /// Calls `visit` for the covered pixels among 5×5 around pixel `at`, `step` pixels apart, with their weights in the spline.
    fn taps(&self, at: usize, step: usize, mut visit: impl FnMut(usize, f32)) {
        self.window(at, 2, step, |tap, [x, y]| {
            if self.coverage[tap] > 0.0 {
                visit(tap, SPLINE[x] * SPLINE[y]);
            }
        });
    }

    /// Calls `visit` for the pixels of the picture up to `reach` steps around pixel `at`, row by row, with how many steps they are away.
    fn window(&self, at: usize, reach: usize, step: usize, mut visit: impl FnMut(usize, [usize; 2])) {
        let (column, row) = (at % self.width, at / self.width);
        let height = self.coverage.len() / self.width;
        for dy in 0..=2 * reach {
            let Some(y) = (row + dy * step).checked_sub(reach * step).filter(|y| *y < height) else {
                continue;
            };
            for dx in 0..=2 * reach {
                let x = (column + dx * step).checked_sub(reach * step).filter(|x| *x < self.width);
                if let Some(x) = x {
                    visit(y * self.width + x, [dx.abs_diff(reach), dy.abs_diff(reach)]);
                }
            }
        }
    }

    /// How unlike the surfaces at two pixels are: the negative exponent of their weight.
    fn exponent(&self, stops: &Stops, at: usize, tap: usize) -> f32 {
        let normal = self.normal[at];
        let turned = (1.0 - normal.dot(self.normal[tap])).max(0.0);
        let apart = self.position[tap] - self.position[at];
        let height = normal.dot(apart);
        let off_plane = if height == 0.0 { 0.0 } else { height * height / apart.length_squared() };
        let color = (self.albedo[tap] - self.albedo[at]).length_squared();
        if at == tap { 0.0 } else { stops.normal * turned + stops.plane * off_plane + stops.albedo * color }
    }
}
