//! Removes noise from path-traced pictures, at the price of a small bias: an edge-avoiding filter that is guided by what has no noise.
//!
//! Diffuse light is divided by the albedo before and multiplied after, so that texture stays as it is; specular light is filtered apart,
//! and less. How much noise a pixel has is told by how its camera rays differ. Partly covered pixels count by their coverage.
//!
//! | name | levels | deviations | normal | plane | albedo |
//! | --- | --- | --- | --- | --- | --- |
//! | `DIFFUSE` | 5 | 4 | 32 | 32 | 0 |
//! | `SPECULAR` | 4 | 4 | 200 | 96 | 4 |

pub mod wavelet;

use crate::codec::exr_frame::Frame;
use crate::math::color::luminance;
use glam::Vec3;
use rayon::prelude::*;
use wavelet::{Guides, NoisyLight, Stops, filter};

/// What diffuse light, divided by albedo, is mixed across: it varies slowly.
const DIFFUSE: Stops = Stops { levels: 5, deviations: 4.0, normal: 32.0, plane: 32.0, albedo: 0.0 };

/// What specular light is mixed across: highlights are narrow, and albedo tells materials apart.
const SPECULAR: Stops = Stops { levels: 4, deviations: 4.0, normal: 200.0, plane: 96.0, albedo: 4.0 };

/// Albedo below which a channel counts less, because division by it says little of the light.
const DARK: f32 = 0.02;

/// Least albedo that light is divided by.
const DARKEST: f32 = 1e-6;

/// Bytes per pixel that [`denoise`] takes besides its arguments: positions, and light with confidence and variance, twice.
pub(crate) const DENOISE_PIXEL_BYTES: usize = 96;

/// How the light of the samples of a pixel differs.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SampleSpread {
    /// Samples with a hit.
    hits: u32,
    /// Sums of luminance: of diffuse light over albedo, and of specular light.
    sums: [f32; 2],
    /// Sums of their squares.
    squares: [f32; 2],
}

impl SampleSpread {
    /// Adds a sample: diffuse albedo in `[0, 1]`, diffuse and specular radiance, linear RGB.
    pub fn add(&mut self, albedo: Vec3, diffuse: Vec3, specular: Vec3) {
        let known = luminance((albedo / DARK).min(Vec3::ONE));
        let diffuse = luminance(diffuse / albedo.max(Vec3::splat(DARK)));
        let values = [if known > 0.0 { diffuse / known } else { 0.0 }, luminance(specular)];
        self.hits += 1;
        for (layer, value) in values.into_iter().enumerate() {
            self.sums[layer] += value;
            self.squares[layer] += value * value;
        }
    }

    /// Variance of the mean over the hits, diffuse and specular; `None` with fewer than two.
    fn variance(&self) -> Option<[f32; 2]> {
        let count = self.hits as f32;
        let variance = |layer: usize| {
            let mean = self.sums[layer] / count;
            ((self.squares[layer] / count - mean * mean) / (count - 1.0)).max(0.0)
        };
        (self.hits > 1).then(|| [variance(0), variance(1)])
    }
}

/// Removes noise from the light of `frame`, whose points lie at `position` (world) and whose samples differ by `spread`, pixel by pixel.
/// Layers without noise stay as they are. The result does not depend on threads.
pub fn denoise(frame: &mut Frame, position: &[Vec3], spread: &[SampleSpread]) {
    let guides = Guides {
        width: frame.width,
        coverage: &frame.alpha,
        albedo: &frame.albedo,
        normal: &frame.normal,
        position,
    };
    let diffuse = filter(&guides, &DIFFUSE, irradiance(frame, spread));
    let specular = filter(&guides, &SPECULAR, reflection(frame, spread));
    let covered = |values: Vec<Vec3>| -> Vec<Vec3> {
        values.into_par_iter().zip(&frame.alpha).map(|(value, alpha)| value * *alpha).collect()
    };
    let (diffuse, specular) = (covered(diffuse), covered(specular));
    frame.diffuse =
        diffuse.into_par_iter().zip(&frame.albedo).map(|(light, albedo)| light * *albedo).collect();
    frame.specular = specular;
    frame.color = frame.diffuse.par_iter().zip(&frame.specular).map(|(a, b)| *a + *b).collect();
}

/// Diffuse light of a frame over coverage and albedo.
fn irradiance(frame: &Frame, spread: &[SampleSpread]) -> NoisyLight {
    let light = |i: usize| {
        let (alpha, albedo) = (frame.alpha[i], frame.albedo[i]);
        let value = if alpha > 0.0 {
            frame.diffuse[i] / (alpha * albedo.max(Vec3::splat(DARKEST)))
        } else {
            Vec3::ZERO
        };
        (value, alpha * (albedo / DARK).min(Vec3::ONE))
    };
    let (value, confidence) = (0..frame.alpha.len()).into_par_iter().map(light).unzip();
    NoisyLight { value, confidence, variance: variances(spread, 0) }
}

/// Specular light of a frame over coverage.
fn reflection(frame: &Frame, spread: &[SampleSpread]) -> NoisyLight {
    let light = |i: usize| {
        let alpha = frame.alpha[i];
        (if alpha > 0.0 { frame.specular[i] / alpha } else { Vec3::ZERO }, Vec3::splat(alpha))
    };
    let (value, confidence) = (0..frame.alpha.len()).into_par_iter().map(light).unzip();
    NoisyLight { value, confidence, variance: variances(spread, 1) }
}

fn variances(spread: &[SampleSpread], layer: usize) -> Vec<f32> {
    spread.iter().map(|spread| spread.variance().map_or(-1.0, |both| both[layer])).collect()
}

#[cfg(test)]
mod tests;
