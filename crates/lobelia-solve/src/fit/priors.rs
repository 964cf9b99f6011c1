//! Priors on albedo and normals from elsewhere: maps of the photographs ([`AlbedoMap`],
//! [`NormalMap`]).
//!
//! Light and albedo explain each other: photographs determine their product far better than either.
//! A map of the albedo tells them apart, if its errors are smaller than those that the light would
//! make. A fit begins from the maps' mean on each texel (`fuse`) with the light that suits it; the
//! rule [`Highlights`](ScaleRule::Highlights) gives way to their mean color; the photographs then
//! move each texel. (With maps that err as a network does, holding the texels to them by a term in
//! the loss as well made every score worse.)
//!
//! Normals pull a surface that moves: the loss of a pixel is the weight times Huber's function of n
//! − n′, with the normal n and that of the map n′.

use crate::fit::{components::TexelSeen, scale::ScaleRule};
use bevy_ecs::prelude::{Query, Res, Resource, With, World};
use glam::{DVec3, Vec3};
use lobelia_geometry::Result;
use lobelia_geometry::view::{AlbedoMap, ByView, NormalMap, PriorMap, ViewIndex};
use lobelia_sg::{ray::TexelAddress, shading::PointAdjoint};
use lobelia_world::material::{TexelIndex, USUAL_ALBEDO};
use lobelia_world::sample::{Observation, ObservationIndex, Samples, pixel::PixelOf, point::SurfacePoint};
use lobelia_world::{material::diffuse::write_albedo, pipeline::SystemResult, pipeline::pool::read_column};

/// Rounds of the mean on each texel and the factor of each map.
const ROUNDS: usize = 4;
/// Lengths of a difference of normals below this have a squared loss.
const SQUARE_BELOW: f32 = 0.1;
/// The greatest albedo of the brightest texels but for a few, and how many of a hundred are darker.
const MOST_ALBEDO: f32 = 0.85;
const BRIGHTEST: usize = 98;

/// Weight ≥ 0 of the maps of normals, relative to the image loss; without it they do not pull.
#[derive(Resource, Clone, Copy, Debug, Default, PartialEq)]
pub struct NormalWeight(pub f32);

/// Gradient: adds the adjoints of the terms of the normals in the loss to those of the samples.
pub fn pull_to_normal_maps(
    weight: Res<NormalWeight>,
    views: Query<(&ViewIndex, &NormalMap)>,
    samples: Samples<(&'static PixelOf, &'static SurfacePoint, &'static mut PointAdjoint)>,
) -> SystemResult {
    let maps: ByView<&PriorMap> = views.iter().map(|(view, map)| (*view, &map.0)).collect();
    let (pixels, points, mut back) = samples.columns()?;
    let each = weight.0 / (3 * pixels.len().max(1)) as f32;
    for ((back, at), pixel) in back.iter_mut().zip(&*points).zip(&*pixels) {
        if !at.is_hit() {
            continue;
        }
        let Some(known) = maps.get(pixel.view).and_then(|map| map.at(pixel.pixel as usize)) else { continue };
        let pull = huber_slope(at.normal - known) * each;
        back.normal = (Vec3::from(back.normal) + pull).into();
    }
    Ok(())
}

/// The gradient of Huber's function of the length x of a difference, x²/2s below s =
/// [`SQUARE_BELOW`] and x − s/2 above.
fn huber_slope(difference: Vec3) -> Vec3 {
    difference / difference.length().max(SQUARE_BELOW)
}

/// A pixel with what its map says of it.
type MapPixel = (ViewIndex, TexelAddress, Vec3);

/// The mean of the maps on each texel, each map times the factor by which it agrees with the others
/// best; the geometric mean of the factors is
/// 1. A texel that no map shows has the mean of all.
fn fuse(pixels: &[MapPixel], texels: usize) -> Vec<Vec3> {
    let views = pixels.iter().map(|(view, ..)| view.0 as usize + 1).max().unwrap_or(0);
    let mut factors = vec![1.0f32; views];
    let mut means = texel_means(pixels, &factors, texels);
    for _ in 0..ROUNDS {
        let mut sums = vec![(0.0, 0.0); views];
        for (view, texels, value) in pixels {
            let (view, mean) = (view.0 as usize, texels.blend(&means));
            sums[view].0 += f64::from(mean.dot(*value));
            sums[view].1 += f64::from(value.length_squared());
        }
        let known = |sums: &&(f64, f64)| sums.0 > 0.0 && sums.1 > 0.0;
        let logs: Vec<f64> = sums.iter().filter(known).map(|sums| (sums.0 / sums.1).ln()).collect();
        let middle = logs.iter().sum::<f64>() / logs.len().max(1) as f64;
        for (factor, sums) in factors.iter_mut().zip(&sums).filter(|(_, sums)| known(sums)) {
            *factor = ((sums.0 / sums.1).ln() - middle).exp() as f32;
        }
        means = texel_means(pixels, &factors, texels);
    }
    means
}

/// The weighted mean of the pixels of each texel, times the factors of their views.
fn texel_means(pixels: &[MapPixel], factors: &[f32], texels: usize) -> Vec<Vec3> {
    let mut sums = vec![(Vec3::ZERO, 0.0f32); texels];
    let mut all = (DVec3::ZERO, 0u64);
    for (view, of, value) in pixels {
        let value = value * factors[view.0 as usize];
        for (texel, weight) in of.indices.into_iter().zip(of.weights) {
            sums[texel as usize].0 += weight * value;
            sums[texel as usize].1 += weight;
        }
        all = (all.0 + value.as_dvec3(), all.1 + 1);
    }
    let mean = (all.0 / all.1.max(1) as f64).as_vec3();
    sums.into_iter().map(|(sum, weight)| if weight > 1e-3 { sum / weight } else { mean }).collect()
}

/// Lets the mean color of the maps of the albedo take the place of
/// [`Highlights`](ScaleRule::Highlights) as the rule for the scale of a fit of light and albedo
/// (but with metals, of which maps show a color of another meaning). One that `begins` them anew
/// begins from the maps: its texels have their albedo at a usual level. Returns whether there are
/// maps.
pub(super) fn follow_maps(world: &mut World, metal: bool, begins: bool) -> Result<bool> {
    let pixels = map_pixels(world);
    if pixels.is_empty() {
        return Ok(false);
    }
    let seen = read_column::<TexelIndex, TexelSeen>(world)?;
    let means = fuse(&pixels, seen.len());
    let shown: Vec<Vec3> =
        means.iter().zip(&seen).filter(|(_, seen)| seen.0 > 0.0).map(|(mean, _)| *mean).collect();
    let (mean, level) = usual_mean(&shown);
    if !metal && matches!(world.get_resource::<ScaleRule>(), Some(ScaleRule::Highlights { .. })) {
        world.insert_resource(ScaleRule::MeanAlbedo(mean * level));
    }
    if begins {
        let albedo = means.into_iter().map(|mean| (mean * level).clamp(Vec3::ZERO, Vec3::ONE));
        write_albedo(world, &albedo.collect::<Vec<_>>())?;
    }
    Ok(true)
}

/// The mean of the albedo of texels that are seen, and the factor that makes it a usual one while
/// the brightest but for a few stay below 1.
fn usual_mean(shown: &[Vec3]) -> (Vec3, f32) {
    let sum: DVec3 = shown.iter().map(|albedo| albedo.as_dvec3()).sum();
    let mean = (sum / shown.len().max(1) as f64).as_vec3().max(Vec3::splat(1e-4));
    let mut brightest: Vec<f32> = shown.iter().map(|albedo| albedo.max_element()).collect();
    brightest.sort_unstable_by(f32::total_cmp);
    let place = brightest.len().saturating_sub(1) * BRIGHTEST / 100;
    let brightest = brightest.get(place).copied().unwrap_or(0.0).max(1e-4);
    (mean, (3.0 * USUAL_ALBEDO / mean.element_sum()).min(MOST_ALBEDO / brightest))
}

/// The observed pixels of which a map says something.
fn map_pixels(world: &mut World) -> Vec<MapPixel> {
    if !AlbedoMap::are_in(world) {
        return Vec::new();
    }
    let mut views = world.query::<(&ViewIndex, &AlbedoMap)>();
    let mut observations = world.query_filtered::<&Observation, With<ObservationIndex>>();
    let maps: ByView<&PriorMap> = views.iter(world).map(|(view, map)| (*view, &map.0)).collect();
    let shown = observations.iter(world).filter_map(|observation| {
        let (view, pixel) = (observation.pixel.view, observation.pixel.pixel as usize);
        let value = maps.get(view)?.at(pixel)?;
        Some((view, observation.point.texels, value))
    });
    shown.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_slope_of_hubers_function_agrees_with_central_differences() {
        let huber = |x: f32| {
            if x < SQUARE_BELOW { x * x / (2.0 * SQUARE_BELOW) } else { x - 0.5 * SQUARE_BELOW }
        };
        for difference in [Vec3::new(0.3, -0.4, 0.1), Vec3::new(0.02, 0.01, -0.03)] {
            let slope = huber_slope(difference);
            for axis in Vec3::AXES {
                let at = |step: f32| huber((difference + axis * step).length());
                let central = (at(1e-3) - at(-1e-3)) / 2e-3;
                assert!((central - slope.dot(axis)).abs() < 1e-3, "{difference}: {central} {slope}");
            }
        }
    }

    #[test]
    fn the_level_is_that_of_texels_that_are_seen_and_none_of_nothing() {
        let gray = |value: f32, count: usize| vec![Vec3::splat(value); count];
        let (mean, level) = usual_mean(&gray(0.1, 50));
        assert!(mean.abs_diff_eq(Vec3::splat(0.1), 1e-6) && (level - 10.0 * USUAL_ALBEDO).abs() < 1e-4);
        // A tenth is so bright that a usual mean would make it brighter than anything is.
        let bright = [gray(0.1, 90), gray(2.0, 10)].concat();
        assert!((usual_mean(&bright).1 - MOST_ALBEDO / 2.0).abs() < 1e-5);
        assert!(usual_mean(&[]).1.is_finite());
    }

    /// Pixels of four texels in three views, whose maps have these factors.
    fn pixels(factors: [f32; 3], truth: impl Fn(usize) -> Vec3) -> Vec<MapPixel> {
        let pixel = |i: usize| {
            let texel = i % 4;
            let at = |k: u32| (texel as u32 + k) % 4;
            let texels =
                TexelAddress { indices: [at(0), at(1), at(2), at(3)], weights: [1.0, 0.0, 0.0, 0.0] };
            (ViewIndex((i % 3) as u32), texels, truth(texel) * factors[i % 3])
        };
        (0..240).map(pixel).collect()
    }

    #[test]
    fn maps_of_other_levels_are_one_albedo() {
        let truth = |texel: usize| Vec3::new(0.2 + 0.1 * texel as f32, 0.3, 0.5 - 0.1 * texel as f32);
        let means = fuse(&pixels([0.8, 1.25, 1.0], truth), 5);
        for (texel, mean) in means.iter().enumerate().take(4) {
            assert!(mean.abs_diff_eq(truth(texel), 1e-3), "{texel}: {mean} {}", truth(texel));
        }
        // No map shows the last texel.
        let middle = (0..4).map(truth).sum::<Vec3>() / 4.0;
        assert!(means[4].abs_diff_eq(middle, 0.02), "{} {middle}", means[4]);
    }
}
