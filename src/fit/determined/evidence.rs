//! What pixels say of the logarithms of amplitudes, specular albedo and roughness, with a factor on the albedo of each patch taken out. Pure kernels.

use crate::light::map_fit::least_squares::{cholesky, solve_factored};
use crate::math::brdf::Facets;
use crate::math::published::Lobe;
use crate::math::shading::{ClosedForm, Lighting, LobeVisibility, ShadePoint, SpecularValue};
use crate::sample::observation::Observation;
use glam::Vec3;
use rayon::prelude::*;
use std::collections::HashMap;
use std::ops::Range;

/// AlbedoPatches that a thread sums up at a time, so that the order of the sums does not depend on threads.
const CHUNK: usize = 128;

/// A pixel, linear RGB.
pub(crate) struct Sample {
    /// Its diffuse radiance: what a factor on the albedo multiplies.
    pub diffuse: Vec3,
    /// Shaded minus observed radiance.
    pub residual: Vec3,
    /// Derivatives with respect to the logarithms of specular albedo and roughness.
    pub by_global: [Vec3; 2],
}

/// The pixels of each patch, and the cluster that it belongs to.
pub(crate) struct AlbedoPatches {
    pixels: Vec<u32>,
    /// The range of a patch in `pixels`, and its cluster.
    patches: Vec<(Range<usize>, usize)>,
    clusters: usize,
}

/// Parts of the surface by position, `fine` along the longest side, and by the octant of the normal; clusters are `coarse` along it.
pub(crate) fn patches(observations: &[Observation], coarse: f32, fine: f32) -> AlbedoPatches {
    let at = || observations.iter().map(|observation| observation.point.position);
    let low = at().fold(Vec3::INFINITY, Vec3::min);
    let high = at().fold(Vec3::NEG_INFINITY, Vec3::max);
    let side = (high - low).max_element().max(1e-6);
    let cell = |position: Vec3, count: f32| ((position - low) * (count / side)).as_uvec3().to_array();
    let key = |observation: &Observation| {
        let point = &observation.point;
        let octant = point.normal.to_array().map(|x| x > 0.0);
        (cell(point.position, coarse), cell(point.position, fine), octant)
    };
    let mut keyed: Vec<_> =
        observations.iter().enumerate().map(|(i, observation)| (key(observation), i as u32)).collect();
    keyed.sort_unstable();
    let mut known = HashMap::new();
    let mut found: Vec<(Range<usize>, usize)> = Vec::new();
    for (i, (key, _)) in keyed.iter().enumerate() {
        if i > 0 && keyed[i - 1].0 == *key {
            found.last_mut().expect("a patch before").0.end = i + 1;
        } else {
            let next = known.len();
            found.push((i..i + 1, *known.entry(key.0).or_insert(next)));
        }
    }
    AlbedoPatches {
        clusters: known.len(),
        patches: found,
        pixels: keyed.into_iter().map(|(_, i)| i).collect(),
    }
}

/// Curvature and gradients of half the squared error. Parameters are the lobes of red, green and blue, the specular albedo, the roughness.
pub(crate) struct Evidence {
    parameters: usize,
    /// Curvature, row by row.
    curvature: Vec<f64>,
    /// The gradient of each cluster.
    gradients: Vec<Vec<f64>>,
    /// Mean squared residual.
    variance: f64,
}

/// One channel of a run of patches: parameters are the channel's lobes and the two that all share.
struct ChannelSums {
    curvature: Vec<f64>,
    gradients: Vec<(usize, Vec<f64>)>,
}

/// Sums up the evidence of all patches.
pub(crate) fn sum_up(
    form: ClosedForm,
    points: &[ShadePoint],
    specular: &SpecularValue,
    lighting: Lighting<'_>,
    samples: &[Sample],
    patches: &AlbedoPatches,
) -> Evidence {
    let lobes = lighting.lobes.len();
    let parts: Vec<[ChannelSums; 3]> = patches
        .patches
        .par_chunks(CHUNK)
        .map(|run| sum_run(form, points, specular, lighting, samples, patches, run))
        .collect();
    let parameters = 3 * lobes + 2;
    let mut curvature = vec![0.0; parameters * parameters];
    let mut gradients = vec![vec![0.0; parameters]; patches.clusters];
    for part in &parts {
        for (channel, sums) in part.iter().enumerate() {
            let place = |k: usize| if k < lobes { channel * lobes + k } else { 2 * lobes + k };
            for i in 0..lobes + 2 {
                for j in 0..lobes + 2 {
                    curvature[place(i) * parameters + place(j)] += sums.curvature[i * (lobes + 2) + j];
                }
            }
            for (cluster, gradient) in &sums.gradients {
                gradient.iter().enumerate().for_each(|(k, value)| gradients[*cluster][place(k)] += value);
            }
        }
    }
    let squares: f64 = samples.iter().map(|sample| f64::from(sample.residual.length_squared())).sum();
    Evidence { parameters, curvature, gradients, variance: squares / (3 * samples.len().max(1)) as f64 }
}

fn sum_run(
    form: ClosedForm,
    points: &[ShadePoint],
    specular: &SpecularValue,
    lighting: Lighting<'_>,
    samples: &[Sample],
    patches: &AlbedoPatches,
    run: &[(Range<usize>, usize)],
) -> [ChannelSums; 3] {
    let width = lighting.lobes.len() + 2;
    let mut sums =
        std::array::from_fn(|_| ChannelSums { curvature: vec![0.0; width * width], gradients: Vec::new() });
    for (pixels, cluster) in run {
        let pixels = &patches.pixels[pixels.clone()];
        let rows: Vec<[Vec<f64>; 3]> = pixels
            .iter()
            .map(|&i| row(form, &points[i as usize], specular, lighting, i as usize, &samples[i as usize]))
            .collect();
        for (channel, sums) in sums.iter_mut().enumerate() {
            let rows: Vec<&Vec<f64>> = rows.iter().map(|row| &row[channel]).collect();
            let value = |of: &dyn Fn(&Sample) -> Vec3| -> Vec<f64> {
                pixels.iter().map(|&i| f64::from(of(&samples[i as usize])[channel])).collect()
            };
            add_patch(sums, *cluster, &rows, &value(&|s| s.diffuse), &value(&|s| s.residual));
        }
    }
    sums
}

/// Derivatives of a pixel, by channel: with respect to the channel's lobes, then to what all channels share.
fn row(
    form: ClosedForm,
    point: &ShadePoint,
    specular: &SpecularValue,
    Lighting { lobes, visibility }: Lighting<'_>,
    index: usize,
    sample: &Sample,
) -> [Vec<f64>; 3] {
    let mut rows: [Vec<f64>; 3] = std::array::from_fn(|_| Vec::with_capacity(lobes.len() + 2));
    let (parts, _) = LobeVisibility::point(visibility, index, lobes.stride());
    let facets = Facets { ndf: specular.ndf, roughness: specular.roughness };
    for i in 0..lobes.len() {
        let lobe: Lobe<f32> = lobes.get(i);
        let [diffuse, glossy] =
            form.shade_pair([point.normal, point.to_viewer], &lobe, point.albedo, specular.albedo, facets);
        let part = parts.map_or(1.0, |parts| f64::from(parts[i]) / 255.0);
        for (c, row) in rows.iter_mut().enumerate() {
            row.push(f64::from(diffuse[c] + glossy[c]) * part);
        }
    }
    for (c, row) in rows.iter_mut().enumerate() {
        row.extend(sample.by_global.map(|by| f64::from(by[c])));
    }
    rows
}

/// Adds a patch, without what a factor on its albedo explains.
fn add_patch(sums: &mut ChannelSums, cluster: usize, rows: &[&Vec<f64>], diffuse: &[f64], residual: &[f64]) {
    let width = rows[0].len();
    let power: f64 = diffuse.iter().map(|d| d * d).sum::<f64>() + 1e-12;
    let taken =
        |values: &dyn Fn(usize) -> f64| (0..rows.len()).map(|n| diffuse[n] * values(n)).sum::<f64>() / power;
    let along: Vec<f64> = (0..width).map(|k| taken(&|n| rows[n][k])).collect();
    let along_residual = taken(&|n| residual[n]);
    let mut gradient = vec![0.0; width];
    for (n, row) in rows.iter().enumerate() {
        let clean: Vec<f64> =
            row.iter().zip(&along).map(|(value, along)| value - along * diffuse[n]).collect();
        let left = residual[n] - along_residual * diffuse[n];
        for (i, (a, line)) in clean.iter().zip(sums.curvature.chunks_exact_mut(width)).enumerate() {
            gradient[i] += a * left;
            line.iter_mut().zip(&clean).for_each(|(sum, b)| *sum += a * b);
        }
    }
    match sums.gradients.last_mut() {
        Some((last, sum)) if *last == cluster => sum.iter_mut().zip(&gradient).for_each(|(sum, g)| *sum += g),
        _ => sums.gradients.push((cluster, gradient)),
    }
}

/// The distribution of the parameters given the photographs.
pub(crate) struct Posterior {
    parameters: usize,
    /// Factor of curvature and prior.
    factor: Vec<f64>,
    gradients: Vec<Vec<f64>>,
    variance: f64,
    is_free: Vec<bool>,
}

impl Evidence {
    /// With the parameters that are free; a prior of deviation 1 on each. `None` if the curvature is not finite.
    pub fn posterior(&self, is_free: impl Fn(usize) -> bool) -> Option<Posterior> {
        let n = self.parameters;
        let is_free: Vec<bool> = (0..n).map(is_free).collect();
        let variance = self.variance.max(1e-12);
        let mut factor = self.curvature.clone();
        for i in 0..n {
            for j in 0..n {
                if !is_free[i] || !is_free[j] {
                    factor[i * n + j] = 0.0;
                }
            }
            factor[i * n + i] += variance;
        }
        let gradients = self.gradients.clone();
        cholesky(&mut factor, n).then_some(Posterior { parameters: n, factor, gradients, variance, is_free })
    }
}

impl Posterior {
    /// Standard deviation along a direction of the free parameters: that of the scores of clusters, and of the prior.
    pub fn deviation(&self, direction: &[f64]) -> f64 {
        let mut solved: Vec<f64> =
            direction.iter().zip(&self.is_free).map(|(d, free)| if *free { *d } else { 0.0 }).collect();
        solve_factored(&self.factor, &mut solved);
        let of_cluster = |gradient: &Vec<f64>| {
            let score: f64 = gradient
                .iter()
                .zip(&solved)
                .zip(&self.is_free)
                .map(|((g, s), free)| if *free { g * s } else { 0.0 })
                .sum();
            score * score
        };
        let data: f64 = self.gradients.iter().map(of_cluster).sum();
        let prior: f64 = solved.iter().map(|s| (self.variance * s).powi(2)).sum();
        (data + prior).sqrt()
    }

    /// Effective number of parameters among these: 1 for each that the photographs determine, 0 for each that the prior does.
    pub fn effective(&self, parameters: Range<usize>) -> f64 {
        let of = |at: usize| {
            let mut unit = vec![0.0; self.parameters];
            unit[at] = 1.0;
            solve_factored(&self.factor, &mut unit);
            1.0 - self.variance * unit[at]
        };
        parameters.into_par_iter().map(of).collect::<Vec<f64>>().iter().sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::brdf::Ndf;
    use crate::math::shading::{Layers, LobeColumns};
    use crate::sample::pixel::{Observed, PixelOf};
    use crate::sample::point::SurfacePoint;
    use crate::view::ViewIndex;

    #[test]
    fn patches_are_near_and_turned_alike() {
        let at = |x: f32, normal: Vec3| Observation {
            pixel: PixelOf { view: ViewIndex(0), pixel: 0 },
            observed: Observed { radiance: Vec3::ONE, saturated: false },
            point: SurfacePoint { position: Vec3::new(x, 0.0, 0.0), normal, ..SurfacePoint::default() },
        };
        let seen =
            [at(0.0, Vec3::X), at(1.0, Vec3::X), at(0.001, Vec3::X), at(0.001, -Vec3::X), at(0.03, Vec3::X)];
        let patches = patches(&seen, 16.0, 128.0);
        let found: Vec<(Vec<u32>, usize)> = patches
            .patches
            .iter()
            .map(|(run, cluster)| (patches.pixels[run.clone()].to_vec(), *cluster))
            .collect();
        // The side of a wall that is seen from behind is a patch of its own; all but the far one are in one cluster.
        assert_eq!(found, [(vec![3], 0), (vec![0, 2], 0), (vec![4], 0), (vec![1], 1)]);
        assert_eq!(patches.clusters, 2);
    }

    #[test]
    fn rows_of_lobes_sum_up_to_radiance() {
        let point =
            ShadePoint { normal: [0.0, 0.0, 1.0], to_viewer: [0.6, 0.0, 0.8], albedo: [0.4, 0.3, 0.2] };
        let specular = SpecularValue { albedo: [0.1; 3], roughness: 0.4, ndf: Ndf::Sg };
        let lobe = |x: f32, sharpness| Lobe {
            axis: [x, 0.0, (1.0 - x * x).sqrt()],
            sharpness,
            amplitude: [1.0, 2.0, 3.0],
        };
        let columns =
            LobeColumns::from_lobes([lobe(-0.5, 10.0), lobe(0.3, 2.0), lobe(0.9, 40.0)].into_iter());
        let form = ClosedForm::default();
        let mut shaded = [Layers::default()];
        form.shade(&[point], &specular, &columns, &mut shaded);
        let sample = Sample {
            diffuse: Vec3::ONE,
            residual: Vec3::ZERO,
            by_global: [Vec3::splat(7.0), Vec3::splat(9.0)],
        };
        let rows = row(form, &point, &specular, Lighting::from(&columns), 0, &sample);
        for (c, row) in rows.iter().enumerate() {
            let all = f64::from(shaded[0].diffuse[c] + shaded[0].specular[c]);
            assert!((row[..3].iter().sum::<f64>() - all).abs() < 1e-4 * all, "{row:?} {all}");
            assert_eq!(row[3..], [7.0, 9.0]);
        }
    }

    #[test]
    fn what_a_factor_on_the_albedo_explains_does_not_count() {
        let diffuse = [0.5, 1.0, 2.0];
        let alike: Vec<Vec<f64>> = diffuse.iter().map(|d| vec![3.0 * d, d * d]).collect();
        let mut sums = ChannelSums { curvature: vec![0.0; 4], gradients: Vec::new() };
        add_patch(&mut sums, 5, &alike.iter().collect::<Vec<_>>(), &diffuse, &[1.0, -1.0, 0.0]);
        let [first, mixed, again, second] = sums.curvature[..] else { panic!() };
        assert!(first.abs() < 1e-12 && mixed.abs() < 1e-12 && again.abs() < 1e-12 && second > 0.1);
        // Σ d⁴ − (Σ d³)²/Σ d².
        assert!((second - (17.0625 - 9.125 * 9.125 / 5.25)).abs() < 1e-9, "{second}");
        assert_eq!(sums.gradients[0].0, 5);
    }

    #[test]
    fn deviations_are_those_of_least_squares_and_of_the_prior() {
        // Ten thousand measurements of the first parameter with noise of variance 0.04, each a cluster; nothing is known of the second, the third is given.
        let measured = 10_000;
        let noise = |i: usize| if i.is_multiple_of(2) { 0.2 } else { -0.2 };
        let evidence = Evidence {
            parameters: 3,
            curvature: vec![measured as f64, 0.0, 5.0, 0.0, 0.0, 0.0, 5.0, 0.0, 9.0],
            gradients: (0..measured).map(|i| vec![noise(i), 0.0, 3.0]).collect(),
            variance: 0.04,
        };
        let posterior = evidence.posterior(|parameter| parameter < 2).unwrap();
        let of = |direction: [f64; 3]| posterior.deviation(&direction);
        assert!((of([1.0, 0.0, 0.0]) / 0.002 - 1.0).abs() < 1e-3, "{}", of([1.0, 0.0, 0.0]));
        assert!((of([0.0, 1.0, 0.0]) - 1.0).abs() < 1e-6 && of([0.0, 0.0, 1.0]) == 0.0);
        assert!((posterior.effective(0..2) - 1.0).abs() < 1e-3);
        // The same noise in a hundred clusters that are alike within.
        let gradients = (0..100).map(|i| vec![100.0 * noise(i), 0.0, 0.0]).collect();
        let alike = Evidence { gradients, ..evidence }.posterior(|parameter| parameter < 2).unwrap();
        assert!((alike.deviation(&[1.0, 0.0, 0.0]) / 0.02 - 1.0).abs() < 1e-3);
        assert!(
            Evidence {
                curvature: vec![f64::NAN; 9],
                ..Evidence { parameters: 3, curvature: vec![], gradients: vec![], variance: 1.0 }
            }
            .posterior(|_| true)
            .is_none()
        );
    }
}
