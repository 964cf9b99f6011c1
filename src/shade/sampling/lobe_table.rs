//! Sampling of directions for one SG light at one point, robust for any position of light, horizon and mirror lobe.
//!
//! For a light below the horizon, or a sharp one far from a sharp mirror lobe, only the far tails of both contribute; samples
//! of either alone practically never fall where the product is largest. Here the hemisphere is divided into cells, finer where
//! the product is larger, and directions are sampled from the cells. Logarithms keep tails as low as 1e-160 accurate. The density
//! of samples is exact for any cells, so estimates are unbiased.

use crate::math::brdf::ndf_sharpness;
use crate::math::real::{dot, sub};
use crate::shade::sampling::TangentFrame;
use std::f64::consts::PI;

/// Initial cells, along the cosine and around the normal.
const FIRST_CELLS: [usize; 2] = [8, 16];
/// Subdivisions of a cell into four, one after the other.
const CUTS: usize = 400;
/// Probes along each side of a cell.
const PROBES: usize = 3;

/// The four quarters of a cell, in the order in which they are kept.
const CORNERS: [[f64; 2]; 4] = [[0.0, 0.0], [0.0, 1.0], [1.0, 0.0], [1.0, 1.0]];

/// A part of the hemisphere: `low` and `size` of (cosine, turn), both in `[0, 1]`; equal areas are equal solid angles.
#[derive(Clone, Copy, Debug)]
struct Cell {
    low: [f64; 2],
    size: [f64; 2],
    /// ln of the estimated integral over the cell, up to a constant common to all cells; −∞ once it is subdivided.
    log_mass: f64,
    /// Index of the first of its four parts, which are consecutive; 0 for a cell that is not subdivided.
    parts: usize,
}

/// A density over the hemisphere, constant within each cell.
#[derive(Clone, Debug)]
pub struct LobeTable {
    frame: TangentFrame<f64>,
    cells: Vec<Cell>,
    /// Cumulative probability of the cells; the last is 1.
    cumulative: Vec<f64>,
}

impl LobeTable {
    /// A density close to light × cosine (`mirror` None) or light × NDF × cosine, over the hemisphere of `normal`.
    ///
    /// The light is an SG of `axis` and `sharpness`; `mirror` is the unit direction to the viewer and the roughness.
    pub fn new(normal: [f64; 3], axis: [f64; 3], sharpness: f64, mirror: Option<([f64; 3], f64)>) -> Self {
        let log_product = |direction: [f64; 3]| {
            let light = sub(direction, axis);
            let log = -0.5 * sharpness * dot(light, light) + dot(direction, normal).ln();
            let Some((to_viewer, roughness)) = mirror else { return log };
            let half = [0, 1, 2].map(|i| direction[i] + to_viewer[i]);
            let length = dot(half, half).sqrt();
            let off = [0, 1, 2].map(|i| half[i] / length - normal[i]);
            log - 0.5 * ndf_sharpness(roughness) * dot(off, off)
        };
        Self::adapted(TangentFrame::new(normal), log_product)
    }

    fn adapted(frame: TangentFrame<f64>, log_product: impl Fn([f64; 3]) -> f64) -> Self {
        let probed = |low: [f64; 2], size: [f64; 2]| {
            let cell = Cell { low, size, log_mass: 0.0, parts: 0 };
            Cell { log_mass: log_mass(&frame, &cell, &log_product), ..cell }
        };
        let size = FIRST_CELLS.map(|n| 1.0 / n as f64);
        let mut cells: Vec<Cell> = (0..FIRST_CELLS[0] * FIRST_CELLS[1])
            .map(|i| [i / FIRST_CELLS[1], i % FIRST_CELLS[1]])
            .map(|[row, column]| probed([row as f64 * size[0], column as f64 * size[1]], size))
            .collect();
        for _ in 0..CUTS {
            let heaviest = (1..cells.len())
                .fold(0, |best, i| if cells[i].log_mass > cells[best].log_mass { i } else { best });
            let Cell { low, size, .. } = cells[heaviest];
            cells[heaviest].log_mass = f64::NEG_INFINITY;
            cells[heaviest].parts = cells.len();
            let size = size.map(|s| 0.5 * s);
            cells.extend(CORNERS.map(|[a, b]| probed([low[0] + a * size[0], low[1] + b * size[1]], size)));
        }
        let cumulative = cumulative_chances(&cells);
        Self { frame, cells, cumulative }
    }

    /// Draws a unit direction above the horizon, from three numbers in `[0, 1)`.
    pub fn sample(&self, u: [f64; 3]) -> [f64; 3] {
        let i = self.cumulative.partition_point(|&c| c <= u[0]).min(self.cells.len() - 1);
        direction_in(&self.frame, &self.cells[i], [u[1], u[2]])
    }

    /// Density per steradian with which [`Self::sample`] draws `direction`.
    pub fn pdf(&self, direction: [f64; 3]) -> f64 {
        let TangentFrame { tangent, bitangent, normal } = &self.frame;
        let cosine = dot(direction, *normal);
        let turn = dot(direction, *bitangent).atan2(dot(direction, *tangent)) / (2.0 * PI);
        let at = [cosine, turn.rem_euclid(1.0)];
        if cosine <= 0.0 || !at.iter().all(|x| x.is_finite()) {
            return 0.0;
        }
        let i = self.cell_at(at);
        let before = if i == 0 { 0.0 } else { self.cumulative[i - 1] };
        let cell = &self.cells[i];
        (self.cumulative[i] - before) / (2.0 * PI * cell.size[0] * cell.size[1])
    }

    /// The undivided cell that contains a position with both coordinates in `[0, 1]`.
    fn cell_at(&self, at: [f64; 2]) -> usize {
        let [row, column] =
            [0, 1].map(|k| ((at[k] * FIRST_CELLS[k] as f64) as usize).min(FIRST_CELLS[k] - 1));
        let mut i = row * FIRST_CELLS[1] + column;
        while self.cells[i].parts != 0 {
            let Cell { low, size, parts, .. } = self.cells[i];
            let upper = [0, 1].map(|k| usize::from(at[k] >= low[k] + 0.5 * size[k]));
            i = parts + 2 * upper[0] + upper[1];
        }
        i
    }
}

/// The direction at the fractions `u` of a cell's two sides.
fn direction_in(frame: &TangentFrame<f64>, cell: &Cell, u: [f64; 2]) -> [f64; 3] {
    let cosine = cell.low[0] + u[0] * cell.size[0];
    let sine = (1.0 - cosine * cosine).max(0.0).sqrt();
    let (s, c) = (2.0 * PI * (cell.low[1] + u[1] * cell.size[1])).sin_cos();
    frame.world(sine * c, sine * s, cosine)
}

/// ln of a cell's mass, half from the mean of the probes and half from the largest, as the mean may underestimate a peak.
fn log_mass(frame: &TangentFrame<f64>, cell: &Cell, log_product: &impl Fn([f64; 3]) -> f64) -> f64 {
    let mut logs = [0.0; PROBES * PROBES];
    for (i, log) in logs.iter_mut().enumerate() {
        let u = [i / PROBES, i % PROBES].map(|k| (k as f64 + 0.5) / PROBES as f64);
        *log = log_product(direction_in(frame, cell, u));
    }
    let largest = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let mean = logs.iter().map(|log| (log - largest).exp()).sum::<f64>() / logs.len() as f64;
    largest + (0.5 * (1.0 + mean) * cell.size[0] * cell.size[1]).ln()
}

fn cumulative_chances(cells: &[Cell]) -> Vec<f64> {
    let largest = cells.iter().map(|c| c.log_mass).fold(f64::NEG_INFINITY, f64::max);
    let mut sum = 0.0;
    let mut cumulative: Vec<f64> = cells
        .iter()
        .map(|c| {
            sum += (c.log_mass - largest).exp();
            sum
        })
        .collect();
    cumulative.iter_mut().for_each(|c| *c /= sum);
    cumulative
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shade::sampling::sobol::Sequence;

    /// Samples have the density of `pdf`: the cell of each sample is found, and means of the cosine agree.
    #[test]
    fn draws_follow_their_density() {
        let normal = [0.36, -0.48, 0.8];
        let to_viewer = [0.0, 0.0, 1.0];
        let table = LobeTable::new(normal, [0.0, 1.0, 0.0], 3.0, Some((to_viewer, 0.6)));
        let count = 4096;
        let (mut solid_angle, mut cosine) = (0.0, 0.0);
        for i in 0..count {
            let direction = table.sample(Sequence::new(1, 0, i).group(0));
            let pdf = table.pdf(direction);
            assert!(pdf > 0.0 && (dot(direction, direction) - 1.0).abs() < 1e-12);
            solid_angle += 1.0 / pdf / f64::from(count);
            cosine += dot(direction, normal) / pdf / f64::from(count);
        }
        assert!((solid_angle / (2.0 * PI) - 1.0).abs() < 0.2, "{solid_angle}");
        assert!((cosine / PI - 1.0).abs() < 0.2, "{cosine}");
    }

    /// ∫ light × cosine far below the horizon, against a quadrature made for it, to 1 %.
    #[test]
    fn a_light_far_below_the_horizon_is_found() {
        let (sharpness, depth) = (700.0, 0.5f64);
        let axis = [(1.0 - depth * depth).sqrt(), 0.0, -depth];
        let table = LobeTable::new([0.0, 0.0, 1.0], axis, sharpness, None);
        let log_peak = sharpness * (axis[0] - 1.0);
        let value = |w: [f64; 3]| (sharpness * (dot(w, axis) - 1.0) - log_peak).exp() * w[2];
        let count = 4096;
        let found = (0..count)
            .map(|i| table.sample(Sequence::new(1, 0, i).group(0)))
            .map(|w| value(w) / table.pdf(w) / f64::from(count))
            .sum::<f64>();
        let (steps, reach) = (2000, [0.1, 0.5]);
        let mut expected = 0.0;
        for i in 0..steps {
            let z = reach[0] * (i as f64 + 0.5) / steps as f64;
            let r = (1.0 - z * z).sqrt();
            for j in 0..steps {
                let turn = reach[1] * (2.0 * (j as f64 + 0.5) / steps as f64 - 1.0);
                expected += value([r * turn.cos(), r * turn.sin(), z]);
            }
        }
        expected *= reach[0] * 2.0 * reach[1] / (steps * steps) as f64;
        assert!((found / expected - 1.0).abs() < 0.01, "{found} {expected}");
    }
}
