//! How well photographs determine what a fit has found: standard deviations from the curvature of the squared error.
//!
//! Radiance is taken as linear in the logarithms of the lobes' amplitudes, of the specular albedo and of the roughness. Each small patch of the surface has a
//! factor on its albedo that nobody knows, so that only differences between the views of a patch count (`evidence`). The residuals of a model that is not quite right
//! are alike in neighboring pixels: the deviations are those of a sandwich estimator with clusters (Liang and Zeger 1986), not those of independent noise. Each logarithm
//! has a prior of deviation 1, and so have the light as a whole and each of its channels: that is what is left where photographs say nothing.
//!
//! Left out are reflected light, sheen and tilt; and what geometry has moved since the last part of the steps began.
//!
//! The deviations are local: a fit that ended in another minimum than the truth's does not know it. Measured where the truth is known, errors are `OPTIMISM`
//! times as large (`docs/src/ablation.md`), so the deviations are multiplied by it.

pub(crate) mod evidence;

use crate::error::Result;
use crate::fit::components::Unknowns;
use crate::fit::determined::evidence::{Evidence, MergedLobes, Sample, ShadedSamples};
use crate::fit::initialization::{Initialization, Known, lobes_of, traced, with_initialization};
use crate::light::{LightLobe, kernel_lobe};
use crate::material::{SpecularLobe, recovered_albedo, recovered_materials};
use crate::math::sg::sphere_integral;
use crate::math::shading::{ClosedForm, Layers, Lighting, LobeColumns, ShadePoint};
use crate::sample::pixel::Observed;
use crate::shade::systems::kernel_specular;
use bevy_ecs::prelude::World;
use glam::Vec3;
use serde::{Deserialize, Serialize};

/// Cells along the longest side of the object whose pixels have residuals that may be alike, and patches along it whose albedo has a factor.
const CLUSTERS: f32 = 32.0;
const PATCHES: f32 = 128.0;
/// Most pixels that are looked at.
const MOST_PIXELS: usize = 60_000;
/// Most lobes of a light that count on their own; of more, those of near directions count as one.
const MOST_LOBES: usize = 128;
/// Step of the logarithms of specular albedo and roughness over which differences are taken.
const STEP: f32 = 0.02;
/// Root mean square, over seven objects, of errors over the deviations by curvature.
const OPTIMISM: f64 = 6.0;

/// How well a fit's results are determined: standard deviations of logarithms, so 0.1 is about 10 %; 1 is that of nothing known. Of what is given there is none.
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
    /// How many lobes of the light are determined, mean of the channels: the effective number of parameters.
    pub lobes: Option<f64>,
}

/// Deviation above which a result counts as not determined.
const NOT_AT_ALL: f64 = 0.5;

impl Determined {
    /// It in words, in percent; `None` if nothing was to be found.
    pub fn words(&self) -> Option<String> {
        let part = |what: &str, deviation: Option<f64>| {
            let deviation = deviation?;
            let to = if deviation > NOT_AT_ALL {
                "not at all".to_owned()
            } else {
                format!("to {:.0} %", 100.0 * deviation)
            };
            Some(format!("{what} {to}"))
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

/// Measures it with the observations of a fit, of several groups those of the first, under the light, albedo and material that the world has
/// now. `None` with several base materials, without pixels, or where no inverse can be found.
///
/// # Errors
/// If a pool is incomplete.
pub(crate) fn measure(
    world: &mut World,
    unknowns: Unknowns,
    form: ClosedForm,
    shadowed: bool,
) -> Result<Option<Determined>> {
    let materials = recovered_materials(world);
    let [(_, specular)] = materials.as_slice() else { return Ok(None) };
    if !unknowns.light && !unknowns.specular_albedo && !unknowns.roughness {
        return Ok(None);
    }
    let (lobes, texels) = (lobes_of(world).1, recovered_albedo(world)?);
    // With shadows of the light that was found, and without a change for what comes after.
    let object = traced(world, shadowed);
    let known = Known { form, specular: *specular, unknowns, object, in_part: true, placement: None };
    let merged = MergedLobes::new(&LobeColumns::from_lobes(lobes.iter().map(kernel_lobe)), MOST_LOBES);
    let evidence =
        with_initialization(world, known, |problem| gather_evidence(problem, &lobes, &merged, &texels));
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
    let n = problem.observations.len().min(MOST_PIXELS);
    if n == 0 {
        return Ok(None);
    }
    let points = problem.gather(0..n, |point| point.texels.blend(texels))?;
    let columns = LobeColumns::from_lobes(lobes.iter().map(kernel_lobe));
    problem.refresh(&columns, texels)?;
    let (rows, seen) = problem.seen(0..n)?;
    let lighting = Lighting { lobes: &columns, visibility: rows.view(&seen) };
    let specular = kernel_specular(&problem.specular);
    let shade = |lobe: SpecularLobe| shaded(problem.form, &points, lobe, lighting);
    let own = problem.specular;
    let [less, more] = [-STEP, STEP].map(f32::exp);
    let change = |low, high| slopes(&shade(low), &shade(high));
    let albedo = |factor: f32| SpecularLobe { albedo: own.albedo * factor, ..own };
    let roughness = |factor: f32| SpecularLobe { roughness: own.roughness * factor, ..own };
    let by_albedo = change(albedo(less), albedo(more));
    let by_roughness = change(roughness(less), roughness(more));
    let here = shade(own);
    let sample =
        |i: usize| sample_of(&problem.observations[i].observed, &here[i], [by_albedo[i], by_roughness[i]]);
    let samples: Vec<Sample> = (0..n).map(sample).collect();
    let patches = evidence::patches(&problem.observations[..n], [CLUSTERS, PATCHES], problem.unknowns.albedo);
    let shaded = ShadedSamples {
        form: problem.form,
        points: &points,
        specular: &specular,
        lighting,
        merged,
        samples: &samples,
    };
    Ok(Some(evidence::sum_up(&shaded, &patches)))
}

/// Derivatives of radiance by a logarithm, from where it is a step less and a step more.
fn slopes(low: &[Layers], high: &[Layers]) -> Vec<Vec3> {
    low.iter().zip(high).map(|(low, high)| (sum_of(high) - sum_of(low)) / (2.0 * STEP)).collect()
}

fn sample_of(observed: &Observed, shaded: &Layers, by_global: [Vec3; 2]) -> Sample {
    let all = sum_of(shaded);
    let residual = Vec3::from_array(std::array::from_fn(|c| observed.difference(c, all[c])));
    let says = |c: usize| if observed.saturated && residual[c] == 0.0 { 0.0 } else { 1.0 };
    let weight = Vec3::from_array(std::array::from_fn(says));
    Sample { diffuse: Vec3::from(shaded.diffuse), residual, weight, by_global }
}

fn shaded(
    form: ClosedForm,
    points: &[ShadePoint],
    lobe: SpecularLobe,
    lighting: Lighting<'_>,
) -> Vec<Layers> {
    let mut out = vec![Layers::default(); points.len()];
    form.shade(points, &kernel_specular(&lobe), lighting, &mut out);
    out
}

fn sum_of(layers: &Layers) -> Vec3 {
    Vec3::from(layers.diffuse) + Vec3::from(layers.specular)
}

/// The deviations of what is unknown.
fn determined(evidence: &Evidence, shares: &[f64], unknowns: Unknowns) -> Option<Determined> {
    let count = shares.len() / 3;
    let posterior = evidence.posterior([unknowns.light, unknowns.specular_albedo, unknowns.roughness])?;
    let of_light = |weight: &dyn Fn(usize) -> f64| {
        let direction: Vec<f64> =
            (0..3 * count).map(|at| weight(at / count) * shares[at]).chain([0.0; 2]).collect();
        reported(posterior.deviation(&direction))
    };
    let unit = |at: usize| -> Vec<f64> { (0..3 * count + 2).map(|i| f64::from(u8::from(i == at))).collect() };
    let color = |channel: usize| of_light(&|c| f64::from(u8::from(c == channel)) - 1.0 / 3.0);
    Some(Determined {
        brightness: unknowns.light.then(|| of_light(&|_| 1.0 / 3.0)),
        color: unknowns.light.then(|| (0..3).map(color).fold(0.0, f64::max)),
        specular_albedo: unknowns.specular_albedo.then(|| reported(posterior.deviation(&unit(3 * count)))),
        roughness: unknowns.roughness.then(|| reported(posterior.deviation(&unit(3 * count + 1)))),
        lobes: unknowns.light.then(|| posterior.effective_of_light() / 3.0),
    })
}

/// A deviation with what is usual beside it; of nothing known it is 1.
fn reported(deviation: f64) -> f64 {
    (OPTIMISM * deviation).min(1.0)
}

/// The part that each merged lobe has of the light's mean radiance, by channel and then lobe.
fn power_shares(lobes: &[LightLobe], merged: &MergedLobes) -> Vec<f64> {
    let power = |channel: usize| {
        move |lobe: &LightLobe| {
            f64::from(lobe.amplitude[channel]) * sphere_integral(f64::from(lobe.sharpness))
        }
    };
    let of_channel = |channel: usize| {
        let all = merged.sums(lobes.iter().map(power(channel)));
        let total: f64 = all.iter().sum::<f64>().max(1e-30);
        all.into_iter().map(move |power| power / total)
    };
    (0..3).flat_map(of_channel).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::LightLobe;

    #[test]
    fn words_leave_out_what_is_given() {
        assert_eq!(Determined::default().words(), None);
        let light = Determined {
            color: Some(0.044),
            brightness: Some(0.51),
            lobes: Some(50.7),
            ..Determined::default()
        };
        assert_eq!(
            light.words().unwrap(),
            "color of the light to 4 %, its brightness not at all, 51 lobes of it"
        );
    }

    #[test]
    fn shares_are_of_a_channels_power() {
        let lobe = |sharpness, amplitude| LightLobe { axis: Vec3::Y, sharpness, amplitude };
        // Twice as sharp and twice as bright is nearly as much.
        let lobes = [lobe(50.0, Vec3::new(1.0, 1.0, 0.0)), lobe(100.0, Vec3::new(2.0, 6.0, 0.0))];
        let columns = LobeColumns::from_lobes(lobes.iter().map(kernel_lobe));
        let shares = power_shares(&lobes, &MergedLobes::new(&columns, 2));
        let expected = [0.5, 0.5, 0.25, 0.75, 0.0, 0.0];
        assert!(shares.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-9), "{shares:?}");
        // Lobes of one direction count as one.
        assert_eq!(power_shares(&lobes, &MergedLobes::new(&columns, 1)), [1.0, 1.0, 0.0]);
    }
}
