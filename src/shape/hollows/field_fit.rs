//! The fit of a [`RadianceField`] to photographs, by volume rendering.
//!
//! Sources: direct optimization of a grid of densities and colors from coarse to fine (Sun, Sun and Chen, "Direct Voxel Grid
//! Optimization", CVPR 2022); smoothness by total variation (Fridovich-Keil et al., "Plenoxels", CVPR 2022); Adam (Kingma and Ba, ICLR 2015).

use super::colors::ColorPicture;
use super::march::{FieldSample, march, pull_back};
use super::neighbors::neighbors;
use super::radiance_field::{FieldRay, RadianceField};
use crate::error::stop::is_stopping;
use crate::sdf::SdfGrid;
use glam::{Vec3, Vec4};
use rand::rngs::SmallRng;
use rand::{RngExt, SeedableRng};
use rayon::prelude::*;

/// Steps on the grid of half as many cells, and on the grid itself.
const STEPS: [u32; 2] = [600, 400];
/// Rays of a step.
const RAYS: usize = 6144;
/// Adam: largest step of color and density, what is left of it at the end, decay of both moments, smallest divisor.
const COLOR_RATE: f32 = 0.05;
const DENSITY_RATE: f32 = 0.4;
const LAST_RATE: f32 = 0.1;
const DECAY: (f32, f32) = (0.9, 0.99);
const SMALLEST: f32 = 1e-12;
/// Weight of the total variation of densities, and of the square of what passes through the whole object.
const VARIATION: f32 = 1e-3;
const LEAK: f32 = 0.1;
/// Most parts of a step that are summed apart.
const MOST_PARTS: usize = 8;

/// Fits a field within a surface to what rays show, first on half as many cells. Nearly transparent where no ray passes.
pub fn fit(grid: &SdfGrid, pictures: &[ColorPicture], rays: &[FieldRay]) -> RadianceField {
    let mean = rays.iter().map(|ray| ray.of(pictures).1).sum::<Vec3>() / rays.len().max(1) as f32;
    let mut random = SmallRng::seed_from_u64(0);
    let mut coarse = RadianceField::new(&grid.resampled((grid.side - 1).div_ceil(2)), mean);
    optimize(&mut coarse, pictures, rays, STEPS[0], &mut random);
    let mut fine = RadianceField::new(grid, mean).beginning_with(&coarse);
    optimize(&mut fine, pictures, rays, STEPS[1], &mut random);
    fine
}

/// First and second moments of Adam.
type Moments = (Vec4, Vec4);

/// Steps of Adam, each with other rays.
fn optimize(
    field: &mut RadianceField,
    pictures: &[ColorPicture],
    rays: &[FieldRay],
    steps: u32,
    random: &mut SmallRng,
) {
    let count = field.values.len();
    let parts = rayon::current_num_threads().min(MOST_PARTS);
    let mut gradients = vec![vec![Vec4::ZERO; count]; parts];
    let mut moments: Vec<Moments> = vec![(Vec4::ZERO, Vec4::ZERO); count];
    for step in (0..steps).take_while(|_| !rays.is_empty() && !is_stopping()) {
        let picks: Vec<(usize, f32)> =
            (0..RAYS).map(|_| (random.random_range(0..rays.len()), random.random())).collect();
        let chunks = picks.par_chunks(RAYS.div_ceil(parts));
        gradients.par_iter_mut().zip(chunks).for_each(|(gradient, picks)| {
            gradient.fill(Vec4::ZERO);
            let mut samples = Vec::new();
            for (ray, jitter) in picks {
                add_gradient(field, pictures, &rays[*ray], *jitter, &mut samples, gradient);
            }
        });
        field.values = moved(field, &gradients, &mut moments, step, steps);
    }
}

/// Adds the gradient of a ray's loss: its squared difference of colors, and the square of what passes through the whole object.
fn add_gradient(
    field: &RadianceField,
    pictures: &[ColorPicture],
    ray: &FieldRay,
    jitter: f32,
    samples: &mut Vec<FieldSample>,
    gradient: &mut [Vec4],
) {
    let (line, shown) = ray.of(pictures);
    let (color, passing) = march(field, &line, ray.surface, jitter, samples);
    let scale = 1.0 / RAYS as f32;
    pull_back(samples, 2.0 * scale * (color - shown), LEAK * scale * passing, gradient);
}

/// The values after a step of Adam.
fn moved(
    field: &RadianceField,
    gradients: &[Vec<Vec4>],
    moments: &mut [Moments],
    step: u32,
    steps: u32,
) -> Vec<Vec4> {
    let rate = LAST_RATE.powf(step as f32 / steps as f32);
    let rates = rate * Vec3::splat(COLOR_RATE).extend(DENSITY_RATE);
    let (first, second) = DECAY;
    let unbiased = (1.0 - first.powi(step as i32 + 1), 1.0 - second.powi(step as i32 + 1));
    let of_row = |(row, moments): (usize, &mut Moments)| {
        let value = field.values[row];
        let mut gradient: Vec4 = gradients.iter().map(|gradient| gradient[row]).sum();
        if row == 0 {
            return value;
        }
        gradient.w += VARIATION / field.values.len() as f32 * variation(field, row);
        moments.0 = moments.0 * first + gradient * (1.0 - first);
        moments.1 = moments.1 * second + gradient * gradient * (1.0 - second);
        let root = (moments.1 / unbiased.1).map(f32::sqrt) + Vec4::splat(SMALLEST);
        value - rates * (moments.0 / unbiased.0) / root
    };
    moments.par_iter_mut().enumerate().map(of_row).collect()
}

/// Derivative of Σ √(1 + Δ²) over the density of a row, with Δ its differences from its neighbors.
fn variation(field: &RadianceField, row: usize) -> f32 {
    let vertex = field.vertices[row] as usize;
    let of = |other: usize| match field.rows[other] as usize {
        0 => 0.0,
        other => {
            let difference = field.values[row].w - field.values[other].w;
            difference / (1.0 + difference * difference).sqrt()
        }
    };
    neighbors(vertex, field.side).map(of).sum()
}
