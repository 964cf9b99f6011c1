//! Linear solvers of the initialization: for fixed axes and sharpness, radiance is linear in the amplitudes of the lobes, and
//! for fixed light it is linear in the albedo. Pure kernels; [`crate::fit::initialization`] alternates them.

use crate::light::map_fit::least_squares::descend_nonnegative;
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
/// Lobes whose products are summed at once, in registers.
const TILE: usize = 16;
/// Responses below this count as none, because products of two such are subnormal numbers, with which processors are many times slower.
const TINY: f32 = 1e-18;
/// Most sweeps of the descent to the amplitudes.
const SWEEPS: usize = 300;

/// Responses of a chunk of points to unit lobes in one channel: [`TILE`] lobes of every point after each other, then the next lobes.
type Responses = Vec<[f32; TILE]>;

/// A chunk of points: its responses and targets of each channel.
struct Rows {
    responses: [Responses; 3],
    targets: [Vec<f32>; 3],
}

/// Non-negative amplitudes of `lobes` (whose own amplitudes are ignored) that fit the radiance `targets` at `points` best in
/// the least-squares sense, given the albedo in `points`, the specular material and the visibility. A prior toward equal amplitudes of
/// weight `ridge` (relative to the mean diagonal of the normal equations) determines lobes that no pixel distinguishes.
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
    let chunk = |number: usize| {
        let run = number * CHUNK..points.len().min((number + 1) * CHUNK);
        respond(form, points, targets, specular, lighting, run)
    };
    let rows: Vec<Rows> = (0..points.len().div_ceil(CHUNK)).into_par_iter().map(chunk).collect();
    let channels = [0, 1, 2].map(|channel| normal_equations(&rows, channel, lobes.len()));
    let solved = channels.into_par_iter().map(|(matrix, right)| solve(matrix, &right, ridge));
    let solved: Vec<Vec<f64>> = solved.collect();
    (0..lobes.len()).map(|i| Vec3::from_array(std::array::from_fn(|c| solved[c][i] as f32))).collect()
}

/// What each lobe of unit amplitude adds to a run of points, and what all should show.
fn respond(
    form: ClosedForm,
    points: &[ShadePoint],
    targets: &[Vec3],
    specular: &SpecularValue,
    Lighting { lobes, visibility }: Lighting<'_>,
    run: Range<usize>,
) -> Rows {
    let (stride, count) = (lobes.stride(), run.len());
    let mut values = vec![0.0; count * RESPONSE_ROWS * stride];
    form.respond(&points[run.clone()], specular, lobes, &mut values);
    let mut rows = Rows {
        responses: std::array::from_fn(|_| vec![[0.0; TILE]; lobes.len().div_ceil(TILE) * count]),
        targets: std::array::from_fn(|_| Vec::with_capacity(count)),
    };
    for (k, (n, value)) in run.zip(values.chunks_exact(RESPONSE_ROWS * stride)).enumerate() {
        let (parts, around) = LobeVisibility::point(visibility, n, stride);
        let (irradiance, glossy) = value.split_at(stride);
        for (c, glossy) in glossy.chunks_exact(stride).enumerate() {
            let diffuse = points[n].albedo[c] * FRAC_1_PI;
            // The visibility of a lobe approximates the visibility of its specular light, and does not need the amplitudes.
            let part = |i: usize| parts.map_or(1.0, |parts| f32::from(parts[i]) / 255.0);
            for i in 0..lobes.len() {
                let response = (diffuse * irradiance[i] + glossy[i]) * part(i);
                rows.responses[c][i / TILE * count + k][i % TILE] =
                    if response < TINY { 0.0 } else { response };
            }
            rows.targets[c].push((targets[n][c] - diffuse * around.indirect[c]).max(0.0));
        }
    }
    rows
}

/// The normal equations of one channel: the symmetric matrix row by row, and the right side. Products of lobes are summed in f32 over a chunk, all else in f64.
fn normal_equations(rows: &[Rows], channel: usize, n: usize) -> (Vec<f64>, Vec<f64>) {
    let mut matrix = vec![0.0; n * n];
    let mut right = vec![0.0; n];
    let lines = matrix.par_chunks_mut(TILE * n).zip(right.par_chunks_mut(TILE)).enumerate();
    lines.for_each(|(tile, (lines, right))| {
        for Rows { responses, targets } in rows {
            let (responses, targets) = (&responses[channel], &targets[channel]);
            let own = &responses[tile * targets.len()..][..targets.len()];
            for (other, responses) in responses.chunks_exact(targets.len()).take(tile + 1).enumerate() {
                let products = dispatch!(Level::new(), _simd => tile_products(own, responses));
                for (line, products) in lines.chunks_exact_mut(n).zip(&products) {
                    let sums = line[other * TILE..].iter_mut().zip(products);
                    sums.for_each(|(sum, product)| *sum += f64::from(*product));
                }
            }
            for (response, target) in own.iter().zip(targets) {
                right.iter_mut().zip(response).for_each(|(sum, a)| *sum += f64::from(a * target));
            }
        }
    });
    for i in 0..n {
        for j in 0..i {
            matrix[j * n + i] = matrix[i * n + j];
        }
    }
    (matrix, right)
}

/// Sums over points of the products of all lobes of a tile with all of another.
#[inline(always)]
fn tile_products(a: &[[f32; TILE]], b: &[[f32; TILE]]) -> [[f32; TILE]; TILE] {
    let mut products = [[0.0; TILE]; TILE];
    // So few lines at a time stay in registers.
    for start in (0..TILE).step_by(4) {
        let mut sums = [[0.0; TILE]; 4];
        for (a, b) in a.iter().zip(b) {
            for line in 0..4 {
                for k in 0..TILE {
                    sums[line][k] += a[start + line] * b[k];
                }
            }
        }
        products[start..start + 4].copy_from_slice(&sums);
    }
    products
}

/// Non-negative solution of normal equations with the prior, from equal amplitudes.
fn solve(mut matrix: Vec<f64>, right: &[f64], ridge: f64) -> Vec<f64> {
    let n = right.len();
    let diagonal: f64 = (0..n).map(|i| matrix[i * n + i]).sum::<f64>() / n as f64;
    let total: f64 = matrix.iter().sum();
    let level = (right.iter().sum::<f64>() / total.max(1e-30)).max(0.0);
    let mut x = vec![level; n];
    // The prior has no slope at equal amplitudes.
    let slope = |(row, right): (&[f64], &f64)| level * row.iter().sum::<f64>() - right;
    let mut gradient: Vec<f64> = matrix.chunks_exact(n).zip(right).map(slope).collect();
    (0..n).for_each(|i| matrix[i * n + i] += ridge * diagonal + 1e-30);
    descend_nonnegative(&matrix, &mut x, &mut gradient, SWEEPS);
    x
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

    /// Chunks of 200 points in all, of which each sees `response(point, lobe)` of a lobe in every channel, and shows what the amplitudes `truth` make of it.
    fn rows(truth: &[f32], response: impl Fn(usize, usize) -> f32) -> Vec<Rows> {
        let chunk = |points: Range<usize>| {
            let mut responses = vec![[0.0; TILE]; truth.len().div_ceil(TILE) * points.len()];
            for (k, point) in points.clone().enumerate() {
                for lobe in 0..truth.len() {
                    responses[lobe / TILE * points.len() + k][lobe % TILE] = response(point, lobe);
                }
            }
            let shown = |point: usize| truth.iter().enumerate().map(|(i, x)| response(point, i) * x).sum();
            let targets: Vec<f32> = points.map(shown).collect();
            Rows {
                responses: std::array::from_fn(|_| responses.clone()),
                targets: std::array::from_fn(|_| targets.clone()),
            }
        };
        vec![chunk(0..130), chunk(130..200)]
    }

    #[test]
    fn amplitudes_are_found_again_and_none_is_negative() {
        for lobes in [11, 37] {
            let response =
                |pixel: usize, lobe: usize| 0.5 + 0.5 * (0.731 * (pixel * (lobe + 1)) as f32).sin();
            let truth: Vec<f32> =
                (0..lobes).map(|i| if i % 3 == 0 { 0.0 } else { 0.3 + 0.1 * i as f32 }).collect();
            let (matrix, right) = normal_equations(&rows(&truth, response), 1, lobes);
            for (i, j) in [(0, 0), (3, 8), (10, 2), (lobes - 1, 1), (1, lobes - 1)] {
                let sum: f64 = (0..200).map(|p| f64::from(response(p, i) * response(p, j))).sum();
                assert!((matrix[i * lobes + j] - sum).abs() < 1e-3, "{i} {j}");
            }
            for (found, truth) in solve(matrix, &right, 0.0).iter().zip(&truth) {
                assert!((found - f64::from(*truth)).abs() < 1e-2 && *found >= 0.0, "{found} {truth}");
            }
        }
    }

    #[test]
    fn the_prior_makes_of_nothing_nothing_and_of_what_no_pixel_sees_the_mean() {
        let (matrix, right) = normal_equations(&rows(&[0.0; 5], |_, _| 0.0), 0, 5);
        assert_eq!(solve(matrix, &right, 1e-2), vec![0.0; 5]);
        let (matrix, right) = normal_equations(&rows(&[2.0; 5], |_, lobe| f32::from(lobe != 3)), 0, 5);
        let found = solve(matrix, &right, 1e-2);
        assert!(found.iter().all(|x| (x - 2.0).abs() < 1e-3), "{found:?}");
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
