//! How well photographs determine what a fit has found: standard deviations from the curvature of
//! the squared error.
//!
//! Radiance is taken as linear in the logarithms of the lobes' amplitudes, of the specular albedo
//! and of the roughness. Each small patch of the surface has a factor on its albedo that nobody
//! knows, so that only differences between the views of a patch count. The residuals of a model
//! that is not quite right are alike in neighboring pixels: the deviations are those of a sandwich
//! estimator with clusters (Liang and Zeger 1986), not those of independent noise. Each logarithm
//! has a prior of deviation 1, and so have the light as a whole and each of its channels: that is
//! what is left where photographs say nothing.
//!
//! Left out are reflected light, sheen and tilt; and what geometry has moved since the last part of
//! the steps began.
//!
//! The deviations are local: a fit that ended in another minimum than the truth's does not know it.
//! Measured where the truth is known, errors are `OPTIMISM` times as large
//! (`docs/research/fit.md`), so the deviations are multiplied by it.

use crate::fit::initialization::{Initialization, Known, extent, traced, with_initialization};
use crate::fit::{components::Unknowns, loss::radiance};
use crate::shade::systems::kernel_specular;
use bevy_ecs::prelude::World;
use glam::Vec3;
use lobelia_geometry::{Result, parallel};
use lobelia_sg::linear::{cholesky, solve_factored};
use lobelia_sg::shading::{ClosedForm, Lighting, LobeColumns, LobeVisibility, ShadePoint, SpecularValue};
use lobelia_sg::{fibonacci::fibonacci_axes, sg::sphere_integral, shading::RESPONSE_ROWS};
use lobelia_world::light::{LightLobe, lights::own_lobes};
use lobelia_world::material::{SpecularLobe, recovered_albedo, recovered_materials};
use lobelia_world::{pipeline::FitForm, sample::Observation};
use serde::{Deserialize, Serialize};
use std::{collections::HashMap, f32::consts::FRAC_1_PI, ops::Range};

/// Cells along the longest side of the object whose pixels have residuals that may be alike, and
/// patches along it whose albedo has a factor.
const CLUSTERS: f32 = 32.0;
const PATCHES: f32 = 128.0;
/// Most lobes of a light that count on their own; of more, those of near directions count as one.
const MOST_LOBES: usize = 128;
/// Step of the logarithms of specular albedo and roughness over which differences are taken.
const STEP: f32 = 0.02;
/// Root mean square, over seven objects, of errors over the deviations by curvature.
const OPTIMISM: f64 = 6.0;

/// How well a fit's results are determined: standard deviations of logarithms, so 0.1 is about 10
/// %; 1 is that of nothing known. Of what is given there is none.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Determined {
    /// Of the light's brightness, mean of the channels.
    pub brightness: Option<f64>,
    /// Of the light's color, the channel that is known least against the mean of all.
    pub color: Option<f64>,
    /// Of the specular albedo.
    pub specular_albedo: Option<f64>,
    /// Of the roughness.
    pub roughness: Option<f64>,
    /// How many lobes of the light are determined, mean of the channels: the effective number of
    /// parameters.
    pub lobes: Option<f64>,
}

/// Deviation above which a result counts as not determined.
const NOT_AT_ALL: f64 = 0.5;

impl Determined {
    /// It in words, in percent; `None` if nothing was to be found.
    pub fn words(&self) -> Option<String> {
        let part = |what: &str, deviation: Option<f64>| {
            let deviation = deviation?;
            let known = format!("{what} to {:.0} %", 100.0 * deviation);
            Some(if deviation > NOT_AT_ALL { format!("{what} not at all") } else { known })
        };
        let parts = [
            part("roughness", self.roughness),
            part("specular albedo", self.specular_albedo),
            part("color of the light", self.color),
            part("its brightness", self.brightness),
            self.lobes.map(|lobes| format!("{lobes:.0} lobes of it")),
        ];
        let known: Vec<String> = parts.into_iter().flatten().collect();
        (!known.is_empty()).then(|| known.join(", "))
    }
}

/// Measures it with the observations of a fit, of several groups those of the first, under the
/// light, albedo and material that the world has now. `None` with several base materials, without
/// pixels, or where no inverse can be found.
pub(crate) fn measure(world: &mut World, unknowns: Unknowns, shadowed: bool) -> Result<Option<Determined>> {
    let FitForm(form) = *world.resource();
    let materials = recovered_materials(world);
    let [(_, specular)] = materials.as_slice() else { return Ok(None) };
    if !unknowns.light && !unknowns.specular_albedo && !unknowns.roughness {
        return Ok(None);
    }
    let (lobes, texels) = (own_lobes(world), recovered_albedo(world)?);
    // With shadows of the light that was found, and without a change for what comes after.
    let object = traced(world, shadowed);
    let known = Known { form, specular: *specular, unknowns, object, in_part: true, placement: None };
    let merged = MergedLobes::new(&LobeColumns::from_lobes(lobes.iter().map(Into::into)), MOST_LOBES);
    let evidence =
        with_initialization(world, known, |of| gather_evidence(&mut of[0], &lobes, &merged, &texels));
    let shares = power_shares(&lobes, &merged);
    Ok(evidence?.and_then(|evidence| determined(&evidence, &shares, unknowns)))
}

/// Sums up what the pixels on a part of the surface say.
fn gather_evidence(
    problem: &mut Initialization,
    lobes: &[LightLobe],
    merged: &MergedLobes,
    texels: &[Vec3],
) -> Result<Option<Evidence>> {
    let n = problem.observations.len();
    if n == 0 {
        return Ok(None);
    }
    let columns = LobeColumns::from_lobes(lobes.iter().map(Into::into));
    problem.refresh(&columns, texels);
    let lit = problem.lit(problem.observations, &columns, |point| point.texels.blend(texels))?;
    let (form, own) = (problem.known.form, problem.known.specular);
    let shade = |lobe: SpecularLobe| lit.shade(form, &lobe);
    let [less, more] = [-STEP, STEP].map(f32::exp);
    // Derivatives of radiance by a logarithm, from where it is a step less and a step more.
    let slopes = |low: SpecularLobe, high: SpecularLobe| -> Vec<Vec3> {
        let (low, high) = (shade(low), shade(high));
        low.iter().zip(&high).map(|(low, high)| (radiance(high) - radiance(low)) / (2.0 * STEP)).collect()
    };
    let albedo = |factor: f32| SpecularLobe { albedo: own.albedo * factor, ..own };
    let roughness = |factor: f32| SpecularLobe { roughness: own.roughness * factor, ..own };
    let by_albedo = slopes(albedo(less), albedo(more));
    let by_roughness = slopes(roughness(less), roughness(more));
    let here = shade(own);
    let sample = |i: usize| {
        let observed = &problem.observations[i].observed;
        let residual = observed.differences(radiance(&here[i]));
        let says = |c: usize| if observed.saturated && residual[c] == 0.0 { 0.0 } else { 1.0 };
        let weight = Vec3::from_array(std::array::from_fn(says));
        let by_global = [by_albedo[i], by_roughness[i]];
        Sample { diffuse: Vec3::from(here[i].diffuse), residual, weight, by_global }
    };
    let samples: Vec<Sample> = (0..n).map(sample).collect();
    let patches = patches(problem.observations, [CLUSTERS, PATCHES], problem.known.unknowns.albedo);
    let shaded = ShadedSamples {
        form,
        points: &lit.points,
        specular: &kernel_specular(&own),
        lighting: lit.lighting(),
        merged,
        samples: &samples,
    };
    Ok(Some(sum_up(&shaded, &patches)))
}

/// The deviations of what is unknown.
fn determined(evidence: &Evidence, shares: &[f64], unknowns: Unknowns) -> Option<Determined> {
    let count = shares.len() / 3;
    let posterior = evidence.posterior([unknowns.light, unknowns.specular_albedo, unknowns.roughness])?;
    // With what is usual beside it; of nothing known it is 1.
    let reported = |direction: &[f64]| (OPTIMISM * posterior.deviation(direction)).min(1.0);
    let of_light = |weight: &dyn Fn(usize) -> f64| {
        let direction = (0..3 * count).map(|at| weight(at / count) * shares[at]).chain([0.0; 2]);
        reported(&direction.collect::<Vec<f64>>())
    };
    let unit = |at: usize| -> Vec<f64> { (0..3 * count + 2).map(|i| f64::from(u8::from(i == at))).collect() };
    let color = |channel: usize| of_light(&|c| f64::from(u8::from(c == channel)) - 1.0 / 3.0);
    Some(Determined {
        brightness: unknowns.light.then(|| of_light(&|_| 1.0 / 3.0)),
        color: unknowns.light.then(|| (0..3).map(color).fold(0.0, f64::max)),
        specular_albedo: unknowns.specular_albedo.then(|| reported(&unit(3 * count))),
        roughness: unknowns.roughness.then(|| reported(&unit(3 * count + 1))),
        lobes: unknowns.light.then(|| posterior.effective_of_light() / 3.0),
    })
}

/// The part that each merged lobe has of the light's mean radiance, by channel and then lobe.
fn power_shares(lobes: &[LightLobe], merged: &MergedLobes) -> Vec<f64> {
    let of_channel = |channel: usize| {
        let amplitude = |lobe: &LightLobe| f64::from(lobe.amplitude[channel]);
        let power = |lobe: &LightLobe| amplitude(lobe) * sphere_integral(f64::from(lobe.sharpness));
        let all = merged.sums(lobes.iter().map(power));
        let total: f64 = all.iter().sum::<f64>().max(1e-30);
        all.into_iter().map(move |power| power / total)
    };
    (0..3).flat_map(of_channel).collect()
}

/// Runs of patches that are summed up on their own, so that the order of the sums does not depend
/// on threads.
const RUNS: usize = 16;
/// Fewest clusters.
const LEAST_CLUSTERS: usize = 20;

/// A pixel, linear RGB.
struct Sample {
    /// Its diffuse radiance: what a factor on the albedo multiplies.
    pub diffuse: Vec3,
    /// Shaded minus observed radiance.
    pub residual: Vec3,
    /// 0 in a channel that says nothing: one that is clipped, and shaded brighter. Else 1.
    pub weight: Vec3,
    /// Derivatives with respect to the logarithms of specular albedo and roughness.
    pub by_global: [Vec3; 2],
}

/// The range of a patch in the pixels of all, and its cluster.
type Patch = (Range<usize>, usize);

/// The pixels of each patch, and the cluster that it belongs to.
struct AlbedoPatches {
    /// Whether the albedo of a patch has a factor that nobody knows.
    pub albedo_is_unknown: bool,
    pixels: Vec<u32>,
    patches: Vec<Patch>,
    clusters: usize,
}

/// Parts of the surface by position, `fine` along the longest side, and by the octant of the
/// normal; clusters are `coarse` along it.
fn patches(observations: &[Observation], [coarse, fine]: [f32; 2], albedo_is_unknown: bool) -> AlbedoPatches {
    let (low, side) = extent(observations);
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
    let mut patches: Vec<Patch> = Vec::new();
    for (i, (key, _)) in keyed.iter().enumerate() {
        if i > 0 && keyed[i - 1].0 == *key {
            patches.last_mut().expect("a patch before").0.end = i + 1;
        } else {
            let next = known.len();
            patches.push((i..i + 1, *known.entry(key.0).or_insert(next)));
        }
    }
    let pixels = keyed.into_iter().map(|(_, i)| i).collect();
    AlbedoPatches { albedo_is_unknown, clusters: known.len(), patches, pixels }
}

/// The lobes that count as one: each has all of the power of near directions, and its logarithm is
/// a parameter.
struct MergedLobes {
    /// For each lobe the one that it is a part of.
    of_lobe: Vec<usize>,
    /// Number of lobes after merging.
    count: usize,
}

impl MergedLobes {
    /// Each for itself, or if there are more than `most`, the nearest of as many even directions.
    pub fn new(lobes: &LobeColumns, most: usize) -> Self {
        if lobes.len() <= most {
            return Self { of_lobe: (0..lobes.len()).collect(), count: lobes.len() };
        }
        let directions = fibonacci_axes(most);
        let mut number = HashMap::new();
        let of_lobe = (0..lobes.len()).map(|i| {
            let axis = Vec3::from(lobes.get(i).axis);
            let near = |a: &usize, b: &usize| directions[*a].dot(axis).total_cmp(&directions[*b].dot(axis));
            let nearest = (0..most).max_by(near).unwrap_or(0);
            let next = number.len();
            *number.entry(nearest).or_insert(next)
        });
        Self { of_lobe: of_lobe.collect(), count: number.len() }
    }

    /// Sums of a channel's values over the lobes that count as one.
    pub fn sums(&self, values: impl Iterator<Item = f64>) -> Vec<f64> {
        let mut sums = vec![0.0; self.count];
        self.of_lobe.iter().zip(values).for_each(|(&at, value)| sums[at] += value);
        sums
    }
}

/// Shaded points with their light and material, and the samples of the photographs.
struct ShadedSamples<'a> {
    pub form: ClosedForm,
    pub points: &'a [ShadePoint],
    pub specular: &'a SpecularValue,
    pub lighting: Lighting<'a>,
    pub merged: &'a MergedLobes,
    pub samples: &'a [Sample],
}

/// Curvature and gradients of half the squared error. Parameters are the lobes of red, green and
/// blue, the specular albedo, the roughness.
struct Evidence {
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
    /// The lower triangle, row by row.
    curvature: Vec<f64>,
    gradients: Vec<(usize, Vec<f64>)>,
}

/// Sums up the evidence of all patches.
fn sum_up(shaded: &ShadedSamples<'_>, patches: &AlbedoPatches) -> Evidence {
    let (lobes, samples) = (shaded.merged.count, shaded.samples);
    let runs = patches.patches.chunks(patches.patches.len().div_ceil(RUNS).max(1));
    let parts: Vec<[ChannelSums; 3]> = parallel::map_items(runs, |run| sum_run(shaded, patches, run));
    let parameters = 3 * lobes + 2;
    let mut curvature = vec![0.0; parameters * parameters];
    let mut gradients = vec![vec![0.0; parameters]; patches.clusters];
    for part in &parts {
        for (channel, sums) in part.iter().enumerate() {
            let place = |k: usize| if k < lobes { channel * lobes + k } else { 2 * lobes + k };
            for i in 0..lobes + 2 {
                for j in 0..lobes + 2 {
                    let lower = i.max(j) * (lobes + 2) + i.min(j);
                    curvature[place(i) * parameters + place(j)] += sums.curvature[lower];
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

fn sum_run(shaded: &ShadedSamples<'_>, patches: &AlbedoPatches, run: &[Patch]) -> [ChannelSums; 3] {
    let ShadedSamples { form, points, specular, lighting, merged, samples } = *shaded;
    let width = merged.count + 2;
    let mut sums =
        std::array::from_fn(|_| ChannelSums { curvature: vec![0.0; width * width], gradients: Vec::new() });
    for (pixels, cluster) in run {
        let pixels = &patches.pixels[pixels.clone()];
        let of_patch: Vec<ShadePoint> = pixels.iter().map(|&i| points[i as usize]).collect();
        let each = RESPONSE_ROWS * lighting.lobes.stride();
        let mut responses = vec![0.0; pixels.len() * each];
        form.respond(&of_patch, specular, lighting.lobes, &mut responses);
        let row_of = |(&i, response): (&u32, &[f32])| row(response, shaded, i as usize);
        let rows: Vec<[Vec<f64>; 3]> = pixels.iter().zip(responses.chunks_exact(each)).map(row_of).collect();
        for (channel, sums) in sums.iter_mut().enumerate() {
            let rows: Vec<&Vec<f64>> = rows.iter().map(|row| &row[channel]).collect();
            let value = |of: &dyn Fn(&Sample) -> Vec3| -> Vec<f64> {
                let samples = pixels.iter().map(|&i| &samples[i as usize]);
                samples.map(|s| f64::from((of(s) * s.weight)[channel])).collect()
            };
            let factor = if patches.albedo_is_unknown { Vec3::ONE } else { Vec3::ZERO };
            add_patch(sums, *cluster, &rows, &value(&|s| s.diffuse * factor), &value(&|s| s.residual));
        }
    }
    sums
}

/// Derivatives of a pixel, by channel: with respect to the channel's lobes, then to what all
/// channels share. `response` is that of the point ([`ClosedForm::respond`]). Reflected light
/// counts as known.
fn row(response: &[f32], shaded: &ShadedSamples<'_>, index: usize) -> [Vec<f64>; 3] {
    let Lighting { lobes, visibility } = shaded.lighting;
    let (point, sample) = (&shaded.points[index], &shaded.samples[index]);
    let stride = lobes.stride();
    let (parts, around) = LobeVisibility::point(visibility, index, stride);
    let (irradiance, glossy) = response.split_at(stride);
    std::array::from_fn(|c| {
        let (glossy, diffuse) = (&glossy[c * stride..], point.albedo[c] * FRAC_1_PI);
        let by_amplitude = |i: usize| {
            let part = parts.map_or(1.0, |parts| f32::from(parts[i]) / 255.0);
            let radiance = diffuse * irradiance[i] * part + glossy[i] * around.specular[c];
            f64::from(radiance * lobes.get(i).amplitude[c] * sample.weight[c])
        };
        let mut row = shaded.merged.sums((0..lobes.len()).map(by_amplitude));
        row.extend(sample.by_global.iter().map(|by| f64::from(by[c] * sample.weight[c])));
        row
    })
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
        let clean: Vec<_> = row.iter().zip(&along).map(|(value, along)| value - along * diffuse[n]).collect();
        let left = residual[n] - along_residual * diffuse[n];
        for (i, (a, line)) in clean.iter().zip(sums.curvature.chunks_exact_mut(width)).enumerate() {
            gradient[i] += a * left;
            line[..=i].iter_mut().zip(&clean).for_each(|(sum, b)| *sum += a * b);
        }
    }
    match sums.gradients.last_mut() {
        Some((last, sum)) if *last == cluster => sum.iter_mut().zip(&gradient).for_each(|(sum, g)| *sum += g),
        _ => sums.gradients.push((cluster, gradient)),
    }
}

/// The distribution of the parameters given the photographs. To the parameters of the evidence come
/// four that all lobes share: a factor on all light, and one on each channel. So a light of many
/// lobes is not brighter or redder by prior than one of few.
struct Posterior {
    lobes: usize,
    /// Factor of curvature and prior.
    factor: Vec<f64>,
    gradients: Vec<Vec<f64>>,
    variance: f64,
    is_free: Vec<bool>,
}

/// A direction, gradient or row of the evidence's parameters in those of the posterior.
fn with_shared(vector: &[f64], lobes: usize) -> Vec<f64> {
    let channel = |c: usize| vector[c * lobes..(c + 1) * lobes].iter().sum();
    let channels: [f64; 3] = std::array::from_fn(channel);
    [vector, &[channels.iter().sum()], &channels].concat()
}

impl Evidence {
    /// With what is free: light, specular albedo, roughness; a prior of deviation 1 on each
    /// parameter. `None` if the curvature is not finite, or with fewer clusters than tell anything
    /// of their scatter.
    pub fn posterior(&self, [light, specular_albedo, roughness]: [bool; 3]) -> Option<Posterior> {
        let lobes = (self.parameters - 2) / 3;
        if self.gradients.len() < LEAST_CLUSTERS {
            return None;
        }
        let is_free = [vec![light; 3 * lobes], vec![specular_albedo, roughness], vec![light; 4]].concat();
        let half: Vec<Vec<f64>> =
            self.curvature.chunks_exact(self.parameters).map(|row| with_shared(row, lobes)).collect();
        let n = is_free.len();
        let column = |j: usize| with_shared(&half.iter().map(|row| row[j]).collect::<Vec<_>>(), lobes);
        let variance = self.variance.max(1e-12);
        let mut factor: Vec<f64> = (0..n).flat_map(column).collect();
        for i in 0..n {
            for j in 0..n {
                if !is_free[i] || !is_free[j] {
                    factor[i * n + j] = 0.0;
                }
            }
            factor[i * n + i] += variance;
        }
        let gradients = self.gradients.iter().map(|gradient| with_shared(gradient, lobes)).collect();
        cholesky(&mut factor, n).then_some(Posterior { lobes, factor, gradients, variance, is_free })
    }
}

impl Posterior {
    /// Standard deviation along a direction of the evidence's parameters, as far as they are free:
    /// that of the scores of clusters, and of the prior.
    pub fn deviation(&self, direction: &[f64]) -> f64 {
        let free = |vector: &[f64]| -> Vec<f64> {
            vector.iter().zip(&self.is_free).map(|(value, free)| if *free { *value } else { 0.0 }).collect()
        };
        let mut solved = free(&with_shared(direction, self.lobes));
        solve_factored(&self.factor, &mut solved);
        let solved = free(&solved);
        let score = |by: &Vec<f64>| by.iter().zip(&solved).map(|(g, s)| g * s).sum::<f64>().powi(2);
        let data: f64 = self.gradients.iter().map(score).sum();
        let prior: f64 = solved.iter().map(|s| (self.variance * s).powi(2)).sum();
        let clusters = self.gradients.len() as f64;
        (data * clusters / (clusters - 1.0) + prior).sqrt()
    }

    /// Effective number of parameters of the light: 1 for each that the photographs determine, 0
    /// for each that the prior does.
    pub fn effective_of_light(&self) -> f64 {
        let of = |at: usize| {
            let mut unit = vec![0.0; self.is_free.len()];
            unit[at] = 1.0;
            solve_factored(&self.factor, &mut unit);
            1.0 - self.variance * unit[at]
        };
        let light = (0..3 * self.lobes).chain(3 * self.lobes + 2..self.is_free.len());
        parallel::map_items(light, of).iter().sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use lobelia_sg::{brdf::Ndf, published::Lobe, shading::Layers};
    use lobelia_world::sample::point::SurfacePoint;

    #[test]
    fn words_leave_out_what_is_given() {
        assert_eq!(Determined::default().words(), None);
        let (color, brightness, lobes) = (Some(0.044), Some(0.51), Some(50.7));
        let light = Determined { brightness, color, lobes, ..Determined::default() };
        let words = "color of the light to 4 %, its brightness not at all, 51 lobes of it";
        assert_eq!(light.words().as_deref(), Some(words));
    }

    #[test]
    fn shares_are_of_a_channels_power() {
        let lobe = |sharpness, amplitude| LightLobe { axis: Vec3::Y, sharpness, amplitude };
        // Twice as sharp and twice as bright is nearly as much.
        let lobes = [lobe(50.0, Vec3::new(1.0, 1.0, 0.0)), lobe(100.0, Vec3::new(2.0, 6.0, 0.0))];
        let columns = LobeColumns::from_lobes(lobes.iter().map(Into::into));
        let shares = power_shares(&lobes, &MergedLobes::new(&columns, 2));
        let expected = [0.5, 0.5, 0.25, 0.75, 0.0, 0.0];
        assert!(shares.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-9), "{shares:?}");
        // Lobes of one direction count as one.
        assert_eq!(power_shares(&lobes, &MergedLobes::new(&columns, 1)), [1.0, 1.0, 0.0]);
    }

    #[test]
    fn patches_are_near_and_turned_alike() {
        let at = |x: f32, normal: Vec3| Observation {
            point: SurfacePoint { position: Vec3::new(x, 0.0, 0.0), normal, ..SurfacePoint::default() },
            ..Observation::default()
        };
        let seen =
            [at(0.0, Vec3::X), at(1.0, Vec3::X), at(0.001, Vec3::X), at(0.001, -Vec3::X), at(0.03, Vec3::X)];
        let patches = patches(&seen, [16.0, 128.0], true);
        let of = |(run, cluster): &Patch| (patches.pixels[run.clone()].to_vec(), *cluster);
        let found: Vec<(Vec<u32>, usize)> = patches.patches.iter().map(of).collect();
        // The side of a wall that is seen from behind is a patch of its own; all but the far one
        // are in one cluster.
        assert_eq!(found, [(vec![3], 0), (vec![0, 2], 0), (vec![4], 0), (vec![1], 1)]);
        assert_eq!(patches.clusters, 2);
    }

    #[test]
    fn rows_of_lobes_sum_up_to_radiance() {
        let point =
            ShadePoint { normal: [0.0, 0.0, 1.0], to_viewer: [0.6, 0.0, 0.8], albedo: [0.4, 0.3, 0.2] };
        let specular = SpecularValue { albedo: [0.1; 3], roughness: 0.4, ndf: Ndf::Sg };
        let amplitude = [1.0, 2.0, 3.0];
        let lobe = |x: f32, sharpness| Lobe { axis: [x, 0.0, (1.0 - x * x).sqrt()], sharpness, amplitude };
        let columns =
            LobeColumns::from_lobes([lobe(-0.5, 10.0), lobe(0.3, 2.0), lobe(0.9, 40.0)].into_iter());
        let form = ClosedForm::default();
        let mut shaded = [Layers::default()];
        form.shade(&[point], &specular, &columns, &mut shaded);
        let sample = Sample {
            diffuse: Vec3::ONE,
            residual: Vec3::ZERO,
            weight: Vec3::new(1.0, 1.0, 0.0),
            by_global: [Vec3::splat(7.0), Vec3::splat(9.0)],
        };
        let mut response = vec![0.0; RESPONSE_ROWS * columns.stride()];
        form.respond(&[point], &specular, &columns, &mut response);
        for count in [3, 2] {
            let merged = MergedLobes::new(&columns, count);
            assert_eq!(merged.count, count);
            let shaded_point = ShadedSamples {
                form,
                points: &[point],
                specular: &specular,
                lighting: Lighting::from(&columns),
                merged: &merged,
                samples: std::slice::from_ref(&sample),
            };
            let rows = row(&response, &shaded_point, 0);
            for (c, row) in rows[..2].iter().enumerate() {
                let all = f64::from(shaded[0].diffuse[c] + shaded[0].specular[c]);
                assert!((row[..count].iter().sum::<f64>() - all).abs() < 1e-4 * all, "{row:?} {all}");
                assert_eq!(row[count..], [7.0, 9.0]);
            }
            // The last channel is clipped.
            assert_eq!(rows[2], vec![0.0; count + 2]);
        }
    }

    #[test]
    fn what_a_factor_on_the_albedo_explains_does_not_count() {
        let diffuse = [0.5, 1.0, 2.0];
        let alike: Vec<Vec<f64>> = diffuse.iter().map(|d| vec![3.0 * d, d * d]).collect();
        let mut sums = ChannelSums { curvature: vec![0.0; 4], gradients: Vec::new() };
        add_patch(&mut sums, 5, &alike.iter().collect::<Vec<_>>(), &diffuse, &[1.0, -1.0, 0.0]);
        let [first, _, mixed, second] = sums.curvature[..] else { panic!() };
        assert!(first.abs() < 1e-12 && mixed.abs() < 1e-12 && second > 0.1);
        // Σ d⁴ − (Σ d³)²/Σ d².
        assert!((second - (17.0625 - 9.125 * 9.125 / 5.25)).abs() < 1e-9, "{second}");
        assert_eq!(sums.gradients[0].0, 5);
    }

    #[test]
    fn deviations_are_those_of_least_squares_and_of_the_prior() {
        // No lobe; ten thousand measurements of the first parameter with noise of variance 0.04,
        // each a cluster; the second is given.
        let measured = 10_000;
        let noise = |i: usize| if i.is_multiple_of(2) { 0.2 } else { -0.2 };
        let evidence = Evidence {
            parameters: 2,
            curvature: vec![measured as f64, 5.0, 5.0, 9.0],
            gradients: (0..measured).map(|i| vec![noise(i), 3.0]).collect(),
            variance: 0.04,
        };
        let posterior = evidence.posterior([false, true, false]).unwrap();
        let known = posterior.deviation(&[1.0, 0.0]);
        assert!((known / 0.002 - 1.0).abs() < 1e-3 && posterior.deviation(&[0.0, 1.0]) == 0.0, "{known}");
        // The same noise in a hundred clusters that are alike within.
        let gradients = (0..100).map(|i| vec![100.0 * noise(i), 0.0]).collect();
        let alike = Evidence { gradients, ..evidence }.posterior([false, true, false]).unwrap();
        assert!((alike.deviation(&[1.0, 0.0]) / 0.0201 - 1.0).abs() < 1e-2);
        let nan = |clusters| Evidence {
            parameters: 2,
            curvature: vec![f64::NAN; 4],
            gradients: vec![vec![0.0; 2]; clusters],
            variance: 1.0,
        };
        assert!(nan(100).posterior([true; 3]).is_none() && nan(3).posterior([true; 3]).is_none());
    }

    #[test]
    fn of_a_light_that_nothing_shows_nothing_is_known_however_many_lobes_it_has() {
        for lobes in [1, 100] {
            let n = 3 * lobes + 2;
            let evidence = |curvature: f64| Evidence {
                parameters: n,
                // The power of each lobe is measured, or not.
                curvature: (0..n * n).map(|at| if at / n == at % n { curvature } else { 0.0 }).collect(),
                gradients: vec![vec![0.0; n]; 30],
                variance: 1.0,
            };
            let share = 1.0 / lobes as f64;
            let brightness: Vec<_> = (0..n).map(|i| if i < 3 * lobes { share / 3.0 } else { 0.0 }).collect();
            let red: Vec<f64> = (0..n)
                .map(|i| match i / lobes {
                    0 => share * 2.0 / 3.0,
                    1 | 2 if i < 3 * lobes => -share / 3.0,
                    _ => 0.0,
                })
                .collect();
            let unknown = evidence(0.0).posterior([true; 3]).unwrap();
            let found = [&brightness, &red].map(|direction| unknown.deviation(direction));
            assert!(found[0] >= 1.0 && found[1] > 0.8, "{found:?}");
            assert!(unknown.effective_of_light().abs() < 1e-9);
            let known = evidence(1e6).posterior([true; 3]).unwrap();
            assert!(known.deviation(&brightness) < 1e-3 && known.effective_of_light() > 2.9 * lobes as f64);
        }
    }
}
