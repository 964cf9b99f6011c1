//! Linear solvers of the initialization: for fixed axes and sharpness, radiance is linear in the amplitudes of the lobes, and
//! for fixed light it is linear in the albedo. Pure kernels; [`crate::fit::initialization`] alternates them.

use crate::math::published::Lobe;
use crate::math::shading::{
    ClosedForm, Layers, Lighting, LobeColumns, LobeVisibility, RESPONSE_ROWS, ShadePoint, SpecularValue,
};
use crate::sample::observation::Observation;
use fearless_simd::{Level, dispatch};
use glam::{DVec3, Vec3};
use rayon::prelude::*;
use std::f32::consts::FRAC_1_PI;
use std::ops::Range;

/// Points that a thread processes at a time; the chunk size of the fixed-order sums.
const CHUNK: usize = 256;

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
        dispatch!(Level::new(), _simd => add_products(&mut self.matrix[channel], row));
        for (sum, a) in self.right[channel].iter_mut().zip(row) {
            *sum += f64::from(a * observed);
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
        let (n, lower) = (self.lobes, &self.matrix[channel]);
        let both = |at: usize| lower[(at / n).max(at % n) * n + (at / n).min(at % n)];
        let matrix: Vec<f64> = (0..n * n).map(both).collect();
        let solved = dispatch!(Level::new(), _simd => descend(&matrix, &self.right[channel], ridge));
        solved.into_iter().map(|x| x as f32).collect()
    }
}

/// Adds the products of all pairs of a row to the lower triangle of a matrix.
#[inline(always)]
fn add_products(matrix: &mut [f64], row: &[f32]) {
    for (i, (line, a)) in matrix.chunks_exact_mut(row.len().max(1)).zip(row).enumerate() {
        for (sum, b) in line[..=i].iter_mut().zip(row) {
            *sum += f64::from(a * b);
        }
    }
}

/// [`NormalEquations::solve`] for a whole symmetric matrix, row by row.
#[inline(always)]
fn descend(matrix: &[f64], right: &[f64], ridge: f64) -> Vec<f64> {
    let n = right.len();
    let diagonal: f64 = (0..n).map(|i| matrix[i * n + i]).sum::<f64>() / n as f64;
    let total: f64 = matrix.iter().sum();
    let level = (right.iter().sum::<f64>() / total.max(1e-30)).max(0.0);
    let pull = ridge * diagonal + 1e-30;
    let mut x = vec![level; n];
    for _ in 0..300 {
        for i in 0..n {
            let row = &matrix[i * n..][..n];
            let rest = product(row, &x) - row[i] * x[i];
            x[i] = ((right[i] - rest + pull * level) / (row[i] + pull)).max(0.0);
        }
    }
    x
}

/// Sum of products, in eight partial sums of a fixed order.
#[inline(always)]
fn product(a: &[f64], b: &[f64]) -> f64 {
    let (a_whole, a_rest) = a.as_chunks::<8>();
    let (b_whole, b_rest) = b.as_chunks::<8>();
    let mut sums = [0.0; 8];
    for (a, b) in a_whole.iter().zip(b_whole) {
        for k in 0..8 {
            sums[k] += a[k] * b[k];
        }
    }
    let rest: f64 = a_rest.iter().zip(b_rest).map(|(a, b)| a * b).sum();
    sums.iter().sum::<f64>() + rest
}

/// Non-negative amplitudes of `lobes` (whose own amplitudes are ignored) that fit the radiance `targets` at `points` best in
/// the least-squares sense, given the albedo in `points`, the specular material and the visibility.
pub(crate) fn solve_amplitudes(
    form: ClosedForm,
    points: &[ShadePoint],
    targets: &[Vec3],
    specular: &SpecularValue,
    lighting: Lighting<'_>,
    ridge: f64,
) -> Vec<Vec3> {
    let lobes = lighting.lobes;
    let of_unit = |i: usize| Lobe { amplitude: [1.0; 3], ..lobes.get(i) };
    let unit = LobeColumns::from_lobes((0..lobes.len()).map(of_unit));
    let lighting = Lighting { lobes: &unit, ..lighting };
    let partial: Vec<NormalEquations> = (0..points.len())
        .into_par_iter()
        .chunks(CHUNK)
        .map(|run| {
            let run = run[0]..run[run.len() - 1] + 1;
            accumulate(form, points, targets, specular, lighting, run)
        })
        .collect();
    let mut sum = NormalEquations::zeros(lobes.len());
    partial.iter().for_each(|p| sum.merge(p));
    let solved: Vec<Vec<f32>> = (0..3).into_par_iter().map(|channel| sum.solve(channel, ridge)).collect();
    (0..lobes.len()).map(|i| Vec3::from_array(std::array::from_fn(|c| solved[c][i]))).collect()
}

fn accumulate(
    form: ClosedForm,
    points: &[ShadePoint],
    targets: &[Vec3],
    specular: &SpecularValue,
    Lighting { lobes, visibility }: Lighting<'_>,
    run: Range<usize>,
) -> NormalEquations {
    let stride = lobes.stride();
    let mut sum = NormalEquations::zeros(lobes.len());
    let mut responses = vec![0.0; run.len() * RESPONSE_ROWS * stride];
    form.respond(&points[run.clone()], specular, lobes, &mut responses);
    let mut row = vec![0.0; lobes.len()];
    for (n, response) in run.zip(responses.chunks_exact(RESPONSE_ROWS * stride)) {
        let (parts, around) = LobeVisibility::point(visibility, n, stride);
        let (irradiance, glossy) = response.split_at(stride);
        for (c, glossy) in glossy.chunks_exact(stride).enumerate() {
            let diffuse = points[n].albedo[c] * FRAC_1_PI;
            // The visibility of a lobe approximates the visibility of its specular light, and does not need the amplitudes.
            let part = |i: usize| parts.map_or(1.0, |parts| f32::from(parts[i]) / 255.0);
            for (i, value) in row.iter_mut().enumerate() {
                *value = (diffuse * irradiance[i] + glossy[i]) * part(i);
            }
            sum.add(c, &row, (targets[n][c] - diffuse * around.indirect[c]).max(0.0));
        }
    }
    sum
}

/// Each texel's least-squares albedo given the light: `pixels` are samples with their radiance if the albedo were 1, `before` the albedo until now, with which clipped
/// samples are brighter than they are seen or not. Texels with few samples are drawn to `prior`. Results are in `[0.02, 0.98]`.
pub(crate) fn solve_albedo<'a>(
    pixels: impl Iterator<Item = (&'a Observation, &'a Layers)>,
    before: &[Vec3],
    prior: Vec3,
) -> Vec<Vec3> {
    let texels = before.len();
    let (mut above, mut below) = (vec![DVec3::ZERO; texels], vec![DVec3::ZERO; texels]);
    let (mut power, mut count) = (DVec3::ZERO, 0u32);
    for (Observation { point, observed, .. }, unit) in pixels {
        let (white, specular) = (Vec3::from(unit.diffuse), Vec3::from(unit.specular));
        let target = (observed.target(white * point.texels.blend(before) + specular) - specular).as_dvec3();
        let diffuse = white.as_dvec3();
        power += diffuse * diffuse;
        count += 1;
        for i in 0..4 {
            let (texel, weight) = (point.texels.indices[i] as usize, f64::from(point.texels.weights[i]));
            above[texel] += diffuse * target * weight;
            below[texel] += diffuse * diffuse * weight;
        }
    }
    // One twentieth of the weight of an average sample.
    let lean = power * (0.05 / f64::from(count.max(1))) + DVec3::splat(1e-12);
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::ray::TexelAddress;
    use crate::sample::pixel::{Observed, PixelOf};
    use crate::sample::point::SurfacePoint;
    use crate::view::ViewIndex;

    #[test]
    fn amplitudes_are_found_again_and_none_is_negative() {
        let lobes = 11;
        let response = |pixel: usize, lobe: usize| ((pixel * 31 + lobe * lobe * 17) % 23) as f32 / 23.0;
        let truth: Vec<f32> =
            (0..lobes).map(|i| if i % 3 == 0 { 0.0 } else { 0.3 + 0.1 * i as f32 }).collect();
        let mut sum = NormalEquations::zeros(lobes);
        for pixel in 0..200 {
            let row: Vec<f32> = (0..lobes).map(|lobe| response(pixel, lobe)).collect();
            let observed = row.iter().zip(&truth).map(|(a, x)| a * x).sum();
            sum.add(1, &row, observed);
        }
        let found = sum.solve(1, 0.0);
        for (found, truth) in found.iter().zip(&truth) {
            assert!((found - truth).abs() < 1e-2 && *found >= 0.0, "{found} {truth}");
        }
        // The prior makes of nothing at all the same nothing everywhere.
        assert_eq!(sum.solve(0, 1e-2), vec![0.0; lobes]);
    }

    #[test]
    fn a_descent_agrees_with_one_written_out() {
        let n = 19;
        let at =
            |i: usize, j: usize| 1.0 / (1.0 + (i as f64 - j as f64).abs()) + if i == j { 0.5 } else { 0.0 };
        let matrix: Vec<f64> = (0..n * n).map(|k| at(k / n, k % n)).collect();
        let right: Vec<f64> = (0..n).map(|i| (i as f64 * 0.7).sin() + 0.4).collect();
        let pull = 1e-2 * 1.5 + 1e-30;
        let level = right.iter().sum::<f64>() / matrix.iter().sum::<f64>();
        let mut x = vec![level; n];
        for _ in 0..300 {
            for i in 0..n {
                let rest: f64 = (0..n).filter(|j| *j != i).map(|j| at(i, j) * x[j]).sum();
                x[i] = ((right[i] - rest + pull * level) / (at(i, i) + pull)).max(0.0);
            }
        }
        let found = descend(&matrix, &right, 1e-2);
        assert!(x.iter().zip(&found).all(|(x, found)| (x - found).abs() < 1e-9), "{x:?} {found:?}");
        assert!(found.contains(&0.0) && found.iter().any(|x| *x > 0.1));
    }

    #[test]
    fn clipped_samples_do_not_darken_an_albedo() {
        // One texel of albedo 0.6 under lights from 0.5 to 2.5: the photograph ends at 1.
        let lights: Vec<f32> = (0..9).map(|i| 0.5 + 0.25 * i as f32).collect();
        let unit: Vec<Layers> =
            lights.iter().map(|light| Layers { diffuse: [*light; 3], specular: [0.0; 3] }).collect();
        let point = SurfacePoint {
            texels: TexelAddress { weights: [1.0, 0.0, 0.0, 0.0], ..TexelAddress::default() },
            ..SurfacePoint::default()
        };
        let seen = |light: &f32| {
            let radiance = Vec3::splat((0.6 * light).min(1.0));
            let observed = Observed { radiance, saturated: 0.6 * light >= 1.0 };
            Observation { pixel: PixelOf { view: ViewIndex(0), pixel: 0 }, observed, point }
        };
        let observations: Vec<Observation> = lights.iter().map(seen).collect();
        let mut albedo = vec![Vec3::splat(0.4)];
        let mut found = Vec::new();
        for _ in 0..30 {
            albedo = solve_albedo(observations.iter().zip(&unit), &albedo, Vec3::splat(0.6));
            found.push(albedo[0].x);
        }
        assert!(found[0] < 0.52 && (found[29] - 0.6).abs() < 1e-3, "{found:?}");
        assert!(found.windows(2).all(|pair| pair[1] >= pair[0] - 1e-6), "{found:?}");
    }
}
