//! The scale between light and albedo: diffuse radiance does not change when the light is
//! multiplied by one factor per channel and the albedo is divided by it.
//!
//! The highlights determine the color of that factor: the specular albedo of a dielectric is gray,
//! so highlights have the color of the light. A change of the factor changes all lobes and texels
//! together, and hardly anything except the highlights. Adam on single parameters is slow along
//! this direction, so the factor is a separate parameter here. The level, the factor's mean over
//! the channels, stays as in the initialization (a mean albedo of about 0.4), because only the
//! Fresnel term distinguishes a bright light from a bright specular albedo. But no albedo is above
//! one: where texels at that bound are darker than the photographs, color and level give way.
//!
//! Metal ([`metal`](crate::fit::metal)) is colored itself, and its specular albedo is divided by
//! the factor too. Its reflections then say nothing of the factor. What is not metal still has gray
//! highlights; as far as all is metal, the light is taken to be nearly white, and the metal as
//! bright as metals are.

use crate::fit::components::{AdamStep, Moments, StepRates, TexelSeen, Unknowns};
use crate::fit::metal::{Metals, metalness};
use bevy_ecs::prelude::{DetectChangesMut, Query, Res, ResMut, Resource, World};
use glam::{DVec3, Vec3, Vec4};
use lobelia_geometry::{Result, parallel};
use lobelia_sg::sg::sphere_integral;
use lobelia_sg::shading::{Layers, RadianceAdjoint, ShadePoint};
use lobelia_world::light::LightLobe;
use lobelia_world::material::{
    BaseMaterial, Diffuse, SpecularBlend, SpecularLobe, TexelIndex, Texels, USUAL_ALBEDO, recovered_albedo,
};
use lobelia_world::pipeline::{SystemResult, pool::with_columns};
use lobelia_world::sample::{Samples, point::PointBlend};
use lobelia_world::{light::groups::FittedLobe, light::lights::own_lobes, material::diffuse::write_albedo};
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// The rule for the scale between light and albedo, one factor per channel, when both are unknown.
#[derive(Resource, Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum ScaleRule {
    /// The light has the color of the highlights; the mean albedo starts from 0.4.
    Highlights {
        /// Weight ≥ 0, relative to the image loss, of a prior that the light's mean radiance has
        /// the color of a lamp or a sky: that of a black body of about 3 000 to 20 000 K, all of
        /// them alike; where a fit has found metal, white is preferred. It decides where highlights
        /// are weak. Default 0.002.
        #[serde(default = "white_light")]
        white_light: f32,
    },
    /// The light's mean radiance over the sphere is gray; the mean albedo starts from 0.4.
    WhiteLight,
    /// The mean albedo of the texels that are seen, but for metal, is this color, each channel in
    /// (0, 0.9]: `MeanAlbedo(0.5, 0.4, 0.3)`.
    MeanAlbedo(Vec3),
    /// No rule: the scale results from the fit of single texels and lobes, which starts from a mean
    /// albedo of gray 0.4.
    Free,
}

fn white_light() -> f32 {
    0.002
}

impl Default for ScaleRule {
    fn default() -> Self {
        Self::Highlights { white_light: white_light() }
    }
}

impl ScaleRule {
    /// The rule as a scene file writes it.
    pub fn words(&self) -> String {
        match self {
            Self::Highlights { white_light } => format!("Highlights(white_light: {white_light:?})"),
            Self::WhiteLight => "WhiteLight".to_owned(),
            Self::MeanAlbedo(Vec3 { x, y, z }) => format!("MeanAlbedo({x:?}, {y:?}, {z:?})"),
            Self::Free => "Free".to_owned(),
        }
    }
}

/// Adam's moments of the logarithm of the factor: its color (3), its level.
#[derive(Resource, Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub struct ScaleMoments(Moments<4>);

/// Texels that a thread takes at a time; the chunk size of sums in a fixed order.
const CHUNK: usize = 8192;
/// Samples that a thread takes at a time.
const SAMPLES: usize = 512;
/// Rate relative to that of the light.
const RATE: f32 = 0.15;
/// Fraction of the way to white light that the initialization from gray albedo goes.
const START: f32 = 0.5;
/// Largest albedo that the factor may result in.
const MOST_ALBEDO: f32 = 0.98;
/// Albedo from which a texel counts as being at its bound.
const AT_BOUND: f32 = 0.95;
/// Weight of a unit of logarithm by which the light is not white, relative to that of `white_light`
/// and to the part of the photographs that shows metal. A metal's reflections have the product of
/// its color and the light's, and photographs are balanced to white.
const WHITE_BESIDE_METAL: f32 = 4.0;
/// Weight, relative to the image loss, of the prior that the mean albedo is [`USUAL_ALBEDO`], per
/// unit of its logarithm.
const LEVEL_WEIGHT: f32 = 0.016;

/// Update: a step along the scale, or a projection onto the rule, if light and albedo are both
/// unknown.
pub fn move_scale(
    (rates, unknowns, rule): (Res<StepRates>, Res<Unknowns>, Res<ScaleRule>),
    mut moments: ResMut<ScaleMoments>,
    samples: Samples<(&ShadePoint, &PointBlend, &Layers, &RadianceAdjoint)>,
    mut lobes: Query<&mut LightLobe, FittedLobe>,
    mut materials: Query<(&BaseMaterial, &mut SpecularLobe)>,
    texels: Texels<(&mut Diffuse, &TexelSeen, &SpecularBlend)>,
) -> SystemResult {
    if !unknowns.light || !unknowns.albedo || *rule == ScaleRule::Free {
        return Ok(());
    }
    let (mut texels, seen, texel_blends) = texels.columns()?;
    let metals = Metals::in_fit(&unknowns, &materials);
    // Of several lights, it is the sum that has the color of lamps and skies.
    let off_gray = log_color(mean_light(lobes.iter()));
    let mean = mean_albedo(&texels, &seen, |texel| 1.0 - metals.share(&texel_blends[texel].0));
    let log_factor = match *rule {
        ScaleRule::Free => Vec3::ZERO,
        ScaleRule::WhiteLight => -off_gray,
        ScaleRule::MeanAlbedo(wanted) => (mean / wanted).max(Vec3::splat(1e-6)).map(f32::ln),
        ScaleRule::Highlights { white_light } => {
            let (points, blends, layers, adjoint) = samples.columns()?;
            let evidence = ScaleEvidence {
                points: &points,
                blends: &blends,
                layers: &layers,
                adjoint: &adjoint,
                metals,
            };
            let gradient = evidence.gradient(white_light, off_gray, mean);
            let adam = AdamStep::new(RATE * rates.light, rates.step);
            let step = Vec4::from(adam.advance(&mut moments.0, &gradient.to_array()));
            -(without_mean(step.truncate()) + step.w)
        }
    };
    let factor = log_factor.exp();
    lobes.iter_mut().for_each(|mut lobe| lobe.amplitude *= factor);
    parallel::for_each_row(&mut *texels, CHUNK, |texel| texel.albedo = divided(texel.albedo, factor));
    if unknowns.metal && unknowns.specular_albedo {
        for (_, mut lobe) in &mut materials {
            let rescaled = rescaled_metal(log_factor, *lobe);
            lobe.set_if_neq(rescaled);
        }
    }
    if unknowns.sheen {
        for texel in &mut *texels {
            let along = texel.albedo + texel.sheen / factor;
            texel.sheen = along.clamp(Vec3::ZERO, Vec3::splat(MOST_ALBEDO)) - texel.albedo;
        }
    }
    Ok(())
}

/// Evidence of a window's samples about the scale.
struct ScaleEvidence<'a> {
    points: &'a [ShadePoint],
    blends: &'a [PointBlend],
    layers: &'a [Layers],
    adjoint: &'a [RadianceAdjoint],
    metals: Metals,
}

impl ScaleEvidence<'_> {
    /// Derivative of the loss and its priors with respect to the logarithm of the factor: its color
    /// (three channels with a mean of 0), its level.
    fn gradient(&self, white_light: f32, off_gray: Vec3, mean_albedo: Vec3) -> Vec4 {
        let count = self.layers.len();
        let of_run = |k: usize| self.sums(k * SAMPLES..count.min((k + 1) * SAMPLES));
        let of_runs: Vec<_> = parallel::map(count.div_ceil(SAMPLES), 1, of_run);
        let [highlights, bound] =
            [0, 1].map(|k| of_runs.iter().map(|(by, _)| by[k]).sum::<DVec3>().as_vec3());
        let metal = (of_runs.iter().map(|(_, metal)| metal).sum::<f64>() / count.max(1) as f64) as f32;
        let light = lamp_derivative(off_gray) + metal * WHITE_BESIDE_METAL * off_gray;
        let level = level_derivative(bound, mean_albedo)
            + LEVEL_WEIGHT * self.metals.level_derivative(metal, mean_albedo.element_sum() / 3.0);
        without_mean(highlights + white_light * light + bound).extend(level)
    }

    /// Sums over samples: derivatives of the loss with respect to the logarithm of the factor, of
    /// the specular light that has the color of the light and of what cannot give way, because
    /// albedos are at their bound; and the part of each sample that is metal.
    fn sums(&self, run: Range<usize>) -> ([DVec3; 2], f64) {
        let (mut highlights, mut bound, mut metal) = (DVec3::ZERO, DVec3::ZERO, 0.0);
        let are_none = self.metals.are_none();
        for i in run {
            let (layers, adjoint) = (&self.layers[i], &self.adjoint[i]);
            let specular = specular_derivative(layers, adjoint);
            bound += bound_derivative(&self.points[i], layers, adjoint);
            if are_none {
                highlights += specular;
                continue;
            }
            let blend = &self.blends[i].0;
            highlights += specular * (Vec3::ONE - self.metals.specular_share(0.0, blend)).as_dvec3();
            bound += specular * self.metals.specular_share(AT_BOUND, blend).as_dvec3();
            metal += f64::from(self.metals.share(blend));
        }
        ([highlights, bound], metal)
    }
}

/// Moves an initialization from gray albedo part of the way to white light, for
/// [`ScaleRule::Highlights`].
///
/// # Errors
/// If the pool of texels is incomplete.
pub fn start_scale(world: &mut World, rule: ScaleRule) -> Result<()> {
    if !matches!(rule, ScaleRule::Highlights { .. }) {
        return Ok(());
    }
    let mut lobes = world.query_filtered::<&mut LightLobe, FittedLobe>();
    let factor = (-START * log_color(mean_light(lobes.iter(world)))).exp();
    lobes.iter_mut(world).for_each(|mut lobe| lobe.amplitude *= factor);
    let albedo = recovered_albedo(world)?.into_iter().map(|albedo| divided(albedo, factor));
    write_albedo(world, &albedo.collect::<Vec<_>>())
}

/// The current scale: mean radiance of the light over the sphere, and mean albedo of the texels
/// that are seen.
///
/// # Errors
/// If the pool of texels is incomplete.
pub fn means(world: &mut World) -> Result<[Vec3; 2]> {
    let light = mean_light(own_lobes(world).iter());
    with_columns::<TexelIndex, (&Diffuse, &TexelSeen), _>(world, |(texels, seen)| {
        Ok([light, mean_albedo(&texels, &seen, |_| 1.0)])
    })
}

/// An albedo under a light that is multiplied by the factor.
fn divided(albedo: Vec3, factor: Vec3) -> Vec3 {
    (albedo * factor.recip()).min(Vec3::splat(MOST_ALBEDO))
}

/// A base material with its specular albedo divided by the factor as far as it is metal.
fn rescaled_metal(log_factor: Vec3, lobe: SpecularLobe) -> SpecularLobe {
    let albedo = lobe.albedo * (-log_factor * metalness(&lobe)).exp();
    SpecularLobe { albedo: albedo.min(Vec3::splat(MOST_ALBEDO)), ..lobe }
}

/// Derivative of the loss with respect to the logarithm of the factor, if the diffuse light of a
/// sample does not change and its specular light is multiplied by the factor.
fn specular_derivative(layers: &Layers, adjoint: &RadianceAdjoint) -> DVec3 {
    (Vec3::from(layers.specular) * Vec3::from(adjoint.0)).as_dvec3()
}

/// Derivative of the loss with respect to the logarithm of the factor where the albedo of a sample
/// is at its bound: it cannot give way to a darker light, and its diffuse radiance is multiplied by
/// the factor.
fn bound_derivative(point: &ShadePoint, layers: &Layers, adjoint: &RadianceAdjoint) -> DVec3 {
    let at_bound = Vec3::from(point.albedo).cmpge(Vec3::splat(AT_BOUND));
    Vec3::select(at_bound, Vec3::from(layers.diffuse) * Vec3::from(adjoint.0), Vec3::ZERO).as_dvec3()
}

/// Derivative with respect to the logarithm of the level. Without texels that are too dark at their
/// bound the level is left alone; with them, the usual mean albedo speaks against a few that no
/// light should explain.
fn level_derivative(bound: Vec3, mean_albedo: Vec3) -> f32 {
    let darker = bound.element_sum().min(0.0);
    let prior = LEVEL_WEIGHT * (USUAL_ALBEDO / (mean_albedo.element_sum() / 3.0).max(1e-3)).ln();
    (darker + prior.max(0.0)).min(0.0)
}

/// Directions in the space of the three channels' logarithms: (red − blue)/√2 and (2 green − red −
/// blue)/√6. In linear Rec. 709, black bodies from 3 200 to 15 000 K lie within 0.02 of the line
/// green = 0.14 warm − 0.04, from −0.55 to 1.16 along `WARM`.
const WARM: Vec3 = Vec3::new(std::f32::consts::FRAC_1_SQRT_2, 0.0, -std::f32::consts::FRAC_1_SQRT_2);
const GREEN: Vec3 = Vec3::new(-0.408_248_3, 0.816_496_6, -0.408_248_3);
const LINE: (f32, f32) = (0.14, -0.04);
/// Lights along that line, and how far beside it they may be: all of these are equally usual.
const USUAL_WARM: (f32, f32) = (-0.65, 1.3);
const USUAL_GREEN: f32 = 0.08;
/// Logarithm beyond what is usual over which the prior grows as a square; farther away it grows
/// linearly.
const NEAR: f32 = 0.24;
/// Weight of a unit of logarithm squared, relative to that across the line.
const ALONG: f32 = 0.2;

/// Derivative, with respect to the logarithm of the light's color, of a distance to the colors of
/// lamps and skies; zero among them.
fn lamp_derivative(log_color: Vec3) -> Vec3 {
    let beyond =
        |x: f32, low: f32, high: f32| (x - x.clamp(low, high)).clamp(-NEAR, NEAR) / USUAL_GREEN.powi(2);
    let (warm, green) = (log_color.dot(WARM), log_color.dot(GREEN));
    let along = ALONG * beyond(warm, USUAL_WARM.0, USUAL_WARM.1);
    let across = beyond(green - LINE.0 * warm - LINE.1, -USUAL_GREEN, USUAL_GREEN);
    (along - LINE.0 * across) * WARM + across * GREEN
}

/// Mean radiance of lobes over the sphere.
fn mean_light<'a>(lobes: impl Iterator<Item = &'a LightLobe>) -> Vec3 {
    let power = |lobe: &LightLobe| lobe.amplitude.as_dvec3() * sphere_integral(f64::from(lobe.sharpness));
    (lobes.map(power).sum::<DVec3>() / (4.0 * std::f64::consts::PI)).as_vec3()
}

/// Mean albedo of the texels that are seen, with the weight `weight(i)` of texel i: that which is
/// not metal.
fn mean_albedo(texels: &[Diffuse], seen: &[TexelSeen], weight: impl Fn(usize) -> f32 + Sync) -> Vec3 {
    let of_chunk = |(chunk, (texels, seen)): (usize, (&[Diffuse], &[TexelSeen]))| {
        let texels = (chunk * CHUNK..).zip(texels).zip(seen).filter(|(_, seen)| seen.0 > 0.0);
        texels.fold((DVec3::ZERO, 0.0), |(sum, weights), ((i, texel), _)| {
            let weight = f64::from(weight(i));
            (sum + texel.albedo.as_dvec3() * weight, weights + weight)
        })
    };
    let chunks = texels.chunks(CHUNK).zip(seen.chunks(CHUNK)).enumerate();
    let sums: Vec<(DVec3, f64)> = parallel::map_items(chunks, of_chunk);
    let (sum, weights) =
        sums.into_iter().fold((DVec3::ZERO, 0.0), |all, of_chunk| (all.0 + of_chunk.0, all.1 + of_chunk.1));
    (sum / weights.max(1e-6)).as_vec3()
}

/// The logarithms of the channels of a color minus their mean: zero for gray.
fn log_color(color: Vec3) -> Vec3 {
    without_mean(color.max(Vec3::splat(1e-12)).map(f32::ln))
}

fn without_mean(v: Vec3) -> Vec3 {
    v - v.element_sum() / 3.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::loss::{Loss, image_loss};
    use lobelia_world::sample::pixel::Observed;

    #[test]
    fn the_derivative_of_the_scale_agrees_with_differences() {
        let layers: [Layers; 50] = std::array::from_fn(|i| {
            let at = |c: usize| 0.1 + 0.3 * ((i * 7 + c * 5) % 11) as f32 / 11.0;
            Layers { diffuse: [0, 1, 2].map(at), specular: [3, 4, 5].map(at) }
        });
        let observed = vec![Observed { radiance: Vec3::new(0.5, 0.4, 0.2), saturated: false }; 50];
        let loss = |factor: Vec3, adjoint: &mut [RadianceAdjoint]| {
            let scaled = |l: &Layers| Layers { specular: (Vec3::from(l.specular) * factor).into(), ..*l };
            let scaled: Vec<Layers> = layers.iter().map(scaled).collect();
            image_loss(Loss::L2, &scaled, &observed, |_| Vec3::ONE, adjoint).loss / 150.0
        };
        let mut adjoint = vec![RadianceAdjoint::default(); 50];
        loss(Vec3::ONE, &mut adjoint);
        let of_samples = layers.iter().zip(&adjoint).map(|(of, adjoint)| specular_derivative(of, adjoint));
        let gradient = of_samples.sum::<DVec3>().as_vec3();
        for axis in Vec3::AXES {
            let mut at = |step: f32| loss((axis * step).exp(), &mut adjoint);
            let exact = (at(1e-2) - at(-1e-2)) / 2e-2;
            let found = f64::from(gradient.dot(axis));
            assert!((found - exact).abs() < 1e-3 * exact.abs() + 1e-6, "{found} {exact}");
        }
    }

    #[test]
    fn texels_at_their_bound_ask_for_more_light_in_their_channel() {
        let point = |blue: f32| ShadePoint { albedo: [0.5, 0.5, blue], ..ShadePoint::default() };
        let points = [point(0.97), point(0.3)];
        let layers = [Layers { diffuse: [0.5, 0.5, 0.7], specular: [0.0; 3] }; 2];
        let observed = vec![Observed { radiance: Vec3::new(0.5, 0.5, 0.9), saturated: false }; 2];
        let mut adjoint = vec![RadianceAdjoint::default(); 2];
        image_loss(Loss::L1, &layers, &observed, |_| Vec3::ONE, &mut adjoint);
        // Only the first point cannot follow with its albedo: −1/6 per unit of radiance, of which
        // there is 0.7.
        let of_sample = |i: usize| bound_derivative(&points[i], &layers[i], &adjoint[i]);
        let bound = (of_sample(0) + of_sample(1)).as_vec3();
        assert!((bound - Vec3::new(0.0, 0.0, -0.7 / 6.0)).length() < 1e-6, "{bound}");
        assert!(level_derivative(bound, Vec3::splat(USUAL_ALBEDO)) < 0.0);
        // A few of them do not make the rest black, and without them the level stays.
        assert_eq!(level_derivative(0.05 * bound, Vec3::splat(0.1)), 0.0);
        assert_eq!(level_derivative(Vec3::ZERO, Vec3::splat(0.7)), 0.0);
    }

    #[test]
    fn what_metal_mirrors_says_nothing_of_the_light() {
        let gold = SpecularLobe::new(Vec3::new(0.9, 0.6, 0.3), 0.2);
        let varnish = SpecularLobe::new(Vec3::splat(0.04), 0.2);
        let metals = Metals::of([(0, &gold), (1, &varnish)]);
        let blend = |metal: f32| PointBlend(std::array::from_fn(|k| [metal, 1.0 - metal, 0.0][k.min(2)]));
        let layers = [Layers { diffuse: [0.1; 3], specular: [0.3, 0.2, 0.1] }; 2];
        let points = [ShadePoint { albedo: [0.3; 3], ..ShadePoint::default() }; 2];
        let adjoint = [RadianceAdjoint([0.1, 0.0, -0.1]); 2];
        let gradient = |metal: f32, off_gray: Vec3| {
            let (points, blends) = (&points, &[blend(metal), blend(0.0)]);
            let evidence = ScaleEvidence { points, blends, layers: &layers, adjoint: &adjoint, metals };
            evidence.gradient(0.002, off_gray, Vec3::splat(USUAL_ALBEDO))
        };
        let (paint, half) = (gradient(0.0, Vec3::ZERO), gradient(1.0, Vec3::ZERO));
        assert!((paint.x - 2.0 * half.x).abs() < 1e-7 && half.x > 0.0, "{paint} {half}");
        // Among lamps only metal prefers white; a metal of 0.9 is a little too dark to be one.
        let warm = Vec3::new(0.3, 0.0, -0.3);
        assert_eq!(gradient(0.0, warm), paint);
        assert!((gradient(1.0, warm) - half).x > 0.0 && (gradient(1.0, warm) - half).z < 0.0);
        assert!(paint.w == 0.0 && half.w > 0.0 && half.w < 1e-3, "{half}");
    }

    #[test]
    fn lamps_and_skies_are_left_alone_and_green_light_is_not() {
        // Linear Rec. 709 of black bodies of 3 200, 6 500 and 15 000 K, by the CIE 1931 color
        // matching functions.
        for color in [[1.747, 0.913, 0.341], [1.022, 0.965, 1.014], [0.678, 0.854, 1.468]] {
            assert_eq!(lamp_derivative(log_color(color.into())), Vec3::ZERO, "{color:?}");
        }
        let green = lamp_derivative(log_color(Vec3::new(1.37, 3.23, 0.53)));
        assert!(green.y > 10.0 && green.x < 0.0, "{green}");
        assert!(green.element_sum().abs() < 1e-3);
        let red = lamp_derivative(log_color(Vec3::new(4.0, 1.0, 0.1)));
        assert!(red.x > 0.0 && red.z < 0.0, "{red}");
    }

    #[test]
    fn the_prior_is_the_derivative_of_a_distance() {
        let distance = |log: Vec3| {
            let huber = |x: f32, low: f32, high: f32| {
                let over = (x - x.clamp(low, high)).abs();
                let near = over.min(NEAR);
                (0.5 * near * near + NEAR * (over - near)) / USUAL_GREEN.powi(2)
            };
            let (warm, green) = (log.dot(WARM), log.dot(GREEN));
            ALONG * huber(warm, USUAL_WARM.0, USUAL_WARM.1)
                + huber(green - LINE.0 * warm - LINE.1, -USUAL_GREEN, USUAL_GREEN)
        };
        for log in [Vec3::new(0.1, 0.2, -0.3), Vec3::new(-0.4, 0.6, -0.2), Vec3::new(2.0, -0.5, -1.5)] {
            let found = lamp_derivative(log);
            for axis in Vec3::AXES {
                let exact = (distance(log + 1e-2 * axis) - distance(log - 1e-2 * axis)) / 2e-2;
                assert!((found.dot(axis) - exact).abs() < 1e-2 * exact.abs().max(1.0), "{log} {exact}");
            }
        }
    }

    #[test]
    fn rescaling_keeps_light_times_albedo() {
        let lobe = LightLobe { axis: Vec3::Y, sharpness: 3.0, amplitude: Vec3::new(1.0, 2.0, 4.0) };
        let albedo = Vec3::new(0.1, 0.2, 0.4);
        let to_white = (-log_color(mean_light([lobe].iter()))).exp();
        let white = LightLobe { amplitude: lobe.amplitude * to_white, ..lobe };
        assert!(log_color(mean_light([white].iter())).length() < 1e-6);
        let product = white.amplitude * divided(albedo, to_white);
        assert!((product - lobe.amplitude * albedo).length() < 1e-6);
        let log_factor = Vec3::new(0.1, 0.0, -0.2);
        let metal = SpecularLobe::new(Vec3::new(0.8, 0.6, 0.3), 0.2);
        let product = rescaled_metal(log_factor, metal).albedo * log_factor.exp();
        assert!((product - metal.albedo).length() < 1e-6);
        let varnish = SpecularLobe::new(Vec3::splat(0.04), 0.2);
        assert_eq!(rescaled_metal(log_factor, varnish), varnish);
        assert_eq!(mean_albedo(&[Diffuse::of_albedo(albedo)], &[TexelSeen(1.0)], |_| 0.5), albedo);
    }
}
