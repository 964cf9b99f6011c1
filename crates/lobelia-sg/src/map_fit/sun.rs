//! Suns: a few texels that are thousands of times brighter than the rest and dominate a squared
//! error.
//!
//! A sun is removed from the map before the fit and gets a sharp lobe with the power, mean
//! direction and spread of the sun; the rest of the map is then fitted without it.

use crate::{color::luminance, light::envmap::EnvironmentMap, light::lobe::LightLobe, sg::sphere_integral};
use glam::{DVec3, Vec3};

/// A sun is this many times brighter than the mean of the rest of the map.
const BRIGHTER_THAN_REST: f64 = 1000.0;
/// Texels of at least this fraction of the peak belong to the sun.
const PART_OF_PEAK: f32 = 0.02;
/// Texels farther from the peak than this angle, in degrees, do not belong to it.
const RADIUS_DEGREES: f64 = 8.0;
/// Most suns.
const MOST_SUNS: usize = 4;

/// A sun that is removed from the map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sun {
    /// Its lobe: the sun's power, mean direction and spread.
    pub lobe: LightLobe,
    /// The largest radiance of the map there.
    pub peak: Vec3,
    /// Solid angle of its texels, in steradians.
    pub solid_angle: f64,
    /// Fraction of the luminous power of the map, 0 to 1.
    pub power_share: f64,
}

/// The suns of `map`, brightest first (no more than `most`, with lobes no sharper than `sharpest`),
/// and the map in which their texels have the radiance of their surroundings.
pub fn take_suns(map: &EnvironmentMap, most: usize, sharpest: f64) -> (Vec<Sun>, EnvironmentMap) {
    let (mut suns, mut rest) = (Vec::new(), map.clone());
    let whole = luminous(map.power());
    while suns.len() < most.min(MOST_SUNS) {
        let Some((sun, without)) = take_one(&rest, sharpest, whole) else { break };
        suns.push(sun);
        rest = without;
    }
    (suns, rest)
}

fn luminous(power: DVec3) -> f64 {
    f64::from(luminance(power.as_vec3()))
}

fn take_one(map: &EnvironmentMap, sharpest: f64, whole: f64) -> Option<(Sun, EnvironmentMap)> {
    let brightest = (0..map.radiance.len())
        .max_by(|&a, &b| luminance(map.radiance[a]).total_cmp(&luminance(map.radiance[b])).then(b.cmp(&a)))?;
    let peak = map.radiance[brightest];
    let toward = direction(map, brightest);
    let near = |k: usize| direction(map, k).dot(toward) > RADIUS_DEGREES.to_radians().cos();
    let bright = |k: &usize| luminance(map.radiance[*k]) > PART_OF_PEAK * luminance(peak) && near(*k);
    let texels: Vec<usize> = (0..map.radiance.len()).filter(bright).collect();
    let (around, surroundings) = surroundings(map, &texels, toward);
    let mut rest = map.clone();
    texels.iter().for_each(|&k| rest.radiance[k] = around.min(map.radiance[k]));
    let mean = luminous(rest.power()) / (4.0 * std::f64::consts::PI);
    if surroundings == 0 || f64::from(luminance(peak)) < BRIGHTER_THAN_REST * mean {
        return None;
    }
    let sun = sun_of(map, &rest, &texels, peak, sharpest)?;
    let share = luminous(sun.lobe.power()) / whole;
    Some((Sun { power_share: share, ..sun }, rest))
}

fn direction(map: &EnvironmentMap, texel: usize) -> DVec3 {
    let (i, j) = (texel as u32 % map.width, texel as u32 / map.width);
    map.texel_direction(i, j).as_dvec3()
}

/// Median (by luminance) of the texels around the sun's, and how many those are.
fn surroundings(map: &EnvironmentMap, texels: &[usize], toward: DVec3) -> (Vec3, usize) {
    let angle = |k: usize| direction(map, k).angle_between(toward);
    let radius = texels.iter().map(|&k| angle(k)).fold(0.0, f64::max);
    let outer = 1.5 * radius + 3.0 * std::f64::consts::PI / f64::from(map.height);
    let mut ring: Vec<Vec3> = (0..map.radiance.len())
        .filter(|&k| angle(k) < outer && texels.binary_search(&k).is_err())
        .map(|k| map.radiance[k])
        .collect();
    ring.sort_by(|a, b| luminance(*a).total_cmp(&luminance(*b)));
    (ring.get(ring.len() / 2).copied().unwrap_or(Vec3::ZERO), ring.len())
}

/// The lobe with the power, mean direction and spread of the difference of `map` and `rest` in
/// `texels`.
fn sun_of(
    map: &EnvironmentMap,
    rest: &EnvironmentMap,
    texels: &[usize],
    peak: Vec3,
    sharpest: f64,
) -> Option<Sun> {
    let (mut power, mut moment, mut weight, mut solid_angle) = (DVec3::ZERO, DVec3::ZERO, 0.0, 0.0);
    for &k in texels {
        let share = map.texel_solid_angle(k as u32 / map.width);
        let excess = (map.radiance[k] - rest.radiance[k]).as_dvec3() * share;
        let luminous = luminous(excess);
        power += excess;
        moment += direction(map, k) * luminous;
        weight += luminous;
        solid_angle += share;
    }
    // The length of a sharp SG's mean direction is about 1 − 1/λ.
    let spread = (1.0 - moment.length() / weight).max(1.0 / sharpest);
    let sharpness = 1.0 / spread;
    let amplitude = (power / sphere_integral(sharpness)).as_vec3();
    let axis = moment.try_normalize()?.as_vec3();
    let lobe = LightLobe { axis, sharpness: sharpness as f32, amplitude };
    Some(Sun { lobe, peak, solid_angle, power_share: 0.0 })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sky(sun: f32) -> EnvironmentMap {
        let toward = Vec3::new(0.48, 0.6, 0.64);
        EnvironmentMap::from_directions(256, 128, |d| {
            let disk = d.angle_between(toward) < 0.03;
            if disk { Vec3::new(1.0, 0.9, 0.7) * sun } else { Vec3::new(0.3, 0.5, 0.9) }
        })
    }

    #[test]
    fn a_sun_becomes_one_sharp_lobe_with_its_power() {
        let map = sky(2e4);
        let (suns, rest) = take_suns(&map, 8, 1e5);
        assert_eq!(suns.len(), 1);
        let sun = suns[0];
        assert!(sun.lobe.axis.angle_between(Vec3::new(0.48, 0.6, 0.64)) < 0.01);
        let lost = (map.power() - rest.power() - sun.lobe.power()).abs().max_element();
        assert!(lost < 1e-3 * map.power().max_element(), "{lost}");
        // A disk of radius r has 1 − cos of r²/4 on average.
        assert!((sun.lobe.sharpness / (4.0 / 0.03_f32.powi(2)) - 1.0).abs() < 0.3, "{:?}", sun.lobe);
        assert!(rest.radiance.iter().all(|r| r.max_element() < 1.0));
        assert!(sun.power_share > 0.5 && sun.power_share < 1.0);
    }

    #[test]
    fn lamps_and_flat_maps_have_no_sun() {
        assert!(take_suns(&sky(50.0), 8, 1e5).0.is_empty());
        assert!(take_suns(&sky(0.3), 8, 1e5).0.is_empty());
        let (none, same) = take_suns(&sky(2e4), 0, 1e5);
        assert!(none.is_empty() && same == sky(2e4));
        let mut lonely = EnvironmentMap::from_directions(8, 4, |_| Vec3::ZERO);
        lonely.radiance[9] = Vec3::splat(1e6);
        assert_eq!(take_suns(&lonely, 8, 50.0).0.len(), 1);
    }
}
