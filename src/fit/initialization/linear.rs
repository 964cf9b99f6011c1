//! Linear solvers of the initialization: for fixed axes and sharpness, radiance is linear in the amplitudes of the lobes, and
//! for fixed light it is linear in the albedo. Pure kernels; [`crate::fit::initialization`] alternates them.

use crate::math::brdf::Facets;
use crate::math::published::Lobe;
use crate::math::shading::{ClosedForm, Layers, Lighting, ShadePoint, SpecularValue, Visibility};
use crate::sample::observation::Observation;
use glam::{DVec3, Vec3};
use rayon::prelude::*;
use std::ops::Range;

/// Points that a thread processes at a time; the chunk size of the fixed-order sums.
const CHUNK: usize = 512;

/// Normal equations of the amplitudes, one system per channel.
struct NormalEquations {
    lobes: usize,
    matrix: [Vec<f64>; 3],
    right: [Vec<f64>; 3],
}

impl NormalEquations {
    fn zeros(lobes: usize) -> Self {
        Self {
            lobes,
            matrix: std::array::from_fn(|_| vec![0.0; lobes * lobes]),
            right: std::array::from_fn(|_| vec![0.0; lobes]),
        }
    }

    /// Adds one pixel; `row` is its response to each lobe of unit amplitude.
    fn add(&mut self, channel: usize, row: &[f32], observed: f32) {
        let matrix = &mut self.matrix[channel];
        for (i, a) in row.iter().enumerate() {
            let line = &mut matrix[i * self.lobes..][..=i];
            for (sum, b) in line.iter_mut().zip(row) {
                *sum += f64::from(a * b);
            }
            self.right[channel][i] += f64::from(a * observed);
        }
    }

    fn merge(&mut self, other: &Self) {
        for c in 0..3 {
            self.matrix[c].iter_mut().zip(&other.matrix[c]).for_each(|(a, b)| *a += b);
            self.right[c].iter_mut().zip(&other.right[c]).for_each(|(a, b)| *a += b);
        }
    }

    /// Non-negative solution by cyclic coordinate descent, with a prior toward equal amplitudes of weight `ridge` (relative to
    /// the mean diagonal of the matrix), which determines lobes that no pixel distinguishes.
    fn solve(&self, channel: usize, ridge: f64) -> Vec<f32> {
        let (n, matrix, right) = (self.lobes, &self.matrix[channel], &self.right[channel]);
        let at = |i: usize, j: usize| if j <= i { matrix[i * n + j] } else { matrix[j * n + i] };
        let diagonal: f64 = (0..n).map(|i| at(i, i)).sum::<f64>() / n as f64;
        let total: f64 = (0..n).map(|i| (0..n).map(|j| at(i, j)).sum::<f64>()).sum();
        let level = (right.iter().sum::<f64>() / total.max(1e-30)).max(0.0);
        let pull = ridge * diagonal + 1e-30;
        let mut x = vec![level; n];
        for _ in 0..300 {
            for i in 0..n {
                let rest: f64 = (0..n).filter(|&j| j != i).map(|j| at(i, j) * x[j]).sum();
                x[i] = ((right[i] - rest + pull * level) / (at(i, i) + pull)).max(0.0);
            }
        }
        x.into_iter().map(|x| x as f32).collect()
    }
}

/// Non-negative amplitudes of `lobes` (whose own amplitudes are ignored) that fit the observed radiance at `points` best in
/// the least-squares sense, given the albedo in `points`, the specular material and the visibility.
pub fn solve_amplitudes(
    form: ClosedForm,
    points: &[ShadePoint],
    observations: &[Observation],
    specular: &SpecularValue,
    lighting: Lighting<'_>,
    ridge: f64,
) -> Vec<Vec3> {
    let lobes = lighting.lobes;
    let partial: Vec<NormalEquations> = (0..points.len())
        .into_par_iter()
        .chunks(CHUNK)
        .map(|run| {
            let run = run[0]..run[run.len() - 1] + 1;
            accumulate(form, points, observations, specular, lighting, run)
        })
        .collect();
    let mut sum = NormalEquations::zeros(lobes.len());
    partial.iter().for_each(|p| sum.merge(p));
    let [r, g, b] = std::array::from_fn(|c| sum.solve(c, ridge));
    (0..lobes.len()).map(|i| Vec3::new(r[i], g[i], b[i])).collect()
}

fn accumulate(
    form: ClosedForm,
    points: &[ShadePoint],
    observations: &[Observation],
    specular: &SpecularValue,
    Lighting { lobes, visibility }: Lighting<'_>,
    run: Range<usize>,
) -> NormalEquations {
    let mut sum = NormalEquations::zeros(lobes.len());
    let mut rows: [Vec<f32>; 3] = std::array::from_fn(|_| vec![0.0; lobes.len()]);
    for n in run {
        let point = &points[n];
        let (parts, around) = Visibility::point(visibility, n, lobes.stride());
        let directions = [point.normal, point.to_viewer];
        let facets = Facets { ndf: specular.ndf, roughness: specular.roughness };
        for i in 0..lobes.len() {
            let lobe = Lobe { amplitude: [1.0; 3], ..lobes.get(i) };
            let [diffuse, glossy] = form.shade_pair(directions, &lobe, point.albedo, specular.albedo, facets);
            for (c, row) in rows.iter_mut().enumerate() {
                // The visibility of a lobe approximates the visibility of its specular light, and does not need the amplitudes.
                row[i] = (diffuse[c] + glossy[c]) * parts.map_or(1.0, |parts| f32::from(parts[i]) / 255.0);
            }
        }
        for (c, row) in rows.iter().enumerate() {
            let indirect = point.albedo[c] * around.indirect[c] * std::f32::consts::FRAC_1_PI;
            sum.add(c, row, (observations[n].observed.radiance[c] - indirect).max(0.0));
        }
    }
    sum
}

/// Each texel's least-squares albedo given the light: `unit` is the radiance of the samples with albedo 1. Texels with
/// few samples are drawn to `prior`. Results are in `[0.02, 0.98]`.
pub fn solve_albedo(observations: &[Observation], unit: &[Layers], texels: usize, prior: Vec3) -> Vec<Vec3> {
    let (mut above, mut below) = (vec![DVec3::ZERO; texels], vec![DVec3::ZERO; texels]);
    let mut power = DVec3::ZERO;
    for (Observation { point, observed, .. }, unit) in observations.iter().zip(unit) {
        let diffuse = Vec3::from(unit.diffuse).as_dvec3();
        let target = (observed.radiance - Vec3::from(unit.specular)).as_dvec3();
        power += diffuse * diffuse;
        for i in 0..4 {
            let (texel, weight) = (point.texels.indices[i] as usize, f64::from(point.texels.weights[i]));
            above[texel] += diffuse * target * weight;
            below[texel] += diffuse * diffuse * weight;
        }
    }
    // One twentieth of the weight of an average sample.
    let lean = power * (0.05 / observations.len().max(1) as f64) + DVec3::splat(1e-12);
    let prior = prior.as_dvec3();
    above
        .iter()
        .zip(&below)
        .map(|(a, b)| {
            let albedo = (*a + lean * prior) / (*b + lean);
            albedo.clamp(DVec3::splat(0.02), DVec3::splat(0.98)).as_vec3()
        })
        .collect()
}
