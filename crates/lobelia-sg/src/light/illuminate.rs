//! Distant light that can be evaluated and sampled: an environment map, and a set of SG lobes.

use crate::lanes::{Lanes, MAX_LANES};
use crate::light::{EnvironmentMap, LightLobe};
use crate::ray::{Illuminate, LightSample};
use crate::{color::luminance, dispatch, real::Real, sg};
use fearless_simd::Simd;
use glam::{DVec3, Mat3, Vec3};
use std::{f64::consts::PI, sync::Arc};

/// A light that is rotated as a whole.
pub struct TurnedLight {
    /// The light in its own frame.
    pub light: Arc<dyn Illuminate>,
    /// The rotation from that frame into the world.
    pub world_from_light: Mat3,
}

impl Illuminate for TurnedLight {
    fn radiance(&self, direction: Vec3) -> Vec3 {
        self.light.radiance(self.world_from_light.transpose() * direction)
    }

    fn sample(&self, uniform: [f32; 3]) -> LightSample {
        let sample = self.light.sample(uniform);
        LightSample { direction: self.world_from_light * sample.direction, ..sample }
    }

    fn pdf(&self, direction: Vec3) -> f32 {
        self.light.pdf(self.world_from_light.transpose() * direction)
    }

    fn radiance_and_pdf(&self, direction: Vec3) -> (Vec3, f32) {
        self.light.radiance_and_pdf(self.world_from_light.transpose() * direction)
    }
}

/// The sample of a light that emits nothing.
const NO_SAMPLE: LightSample = LightSample { direction: Vec3::Y, radiance: Vec3::ZERO, pdf: 0.0 };

/// An environment map, evaluated bilinearly, and sampled by texels.
///
/// A texel is drawn in proportion to the mean luminance over it of the bilinear blend (the texels
/// weighted by [1 6 1]/8 along each side) times its solid angle, then a direction in it uniformly
/// in solid angle. The blend's mean is positive wherever the blend is, so the estimator
/// radiance/pdf is unbiased.
#[derive(Clone, Debug)]
pub struct MapLight {
    map: EnvironmentMap,
    /// Density per steradian in each texel.
    density: Vec<f32>,
    /// Running sums along each row (not normalized).
    columns: Vec<f64>,
    /// Running sum of the rows' totals.
    rows: Vec<f64>,
    /// Cosines of the polar angles φ of the upper edge of each row, and of the lowest edge.
    edges: Vec<f64>,
}

impl MapLight {
    /// Builds the sampling tables of `map` (not empty); about 12 bytes per texel in addition to the
    /// map.
    pub fn new(map: EnvironmentMap) -> Self {
        let (width, height) = (map.width as usize, map.height as usize);
        let means = footprint_luminance(&map);
        let mut columns = vec![0.0; width * height];
        let mut rows = Vec::with_capacity(height);
        let mut total = 0.0;
        for j in 0..height {
            let solid_angle = map.texel_solid_angle(j as u32);
            let mut along = 0.0;
            for i in j * width..(j + 1) * width {
                along += means[i] * solid_angle;
                columns[i] = along;
            }
            total += along;
            rows.push(total);
        }
        let density = means.iter().map(|m| if total > 0.0 { (m / total) as f32 } else { 0.0 }).collect();
        let edges = (0..=height).map(|row| (PI * row as f64 / height as f64).cos()).collect();
        Self { map, density, columns, rows, edges }
    }

    /// The map itself.
    pub fn map(&self) -> &EnvironmentMap {
        &self.map
    }
}

/// Mean luminance of the bilinear blend over each texel (mean in u and v).
fn footprint_luminance(map: &EnvironmentMap) -> Vec<f64> {
    let (width, height) = (map.width as usize, map.height as usize);
    let at = |i: usize, j: usize| f64::from(luminance(map.radiance[j * width + i]));
    let across = |i: usize, j: usize| {
        0.125 * (at((i + width - 1) % width, j) + 6.0 * at(i, j) + at((i + 1) % width, j))
    };
    let texel = |k: usize| {
        let (i, j) = (k % width, k / width);
        let (above, below) = (j.saturating_sub(1), (j + 1).min(height - 1));
        0.125 * (across(i, above) + 6.0 * across(i, j) + across(i, below))
    };
    (0..width * height).map(texel).collect()
}

/// Index of the interval of the running sum `sums` that contains the target, and the position in
/// it, in `[0, 1)`.
fn draw(sums: &[f64], uniform: f32) -> (usize, f64) {
    let target = f64::from(uniform) * sums.last().copied().unwrap_or(0.0);
    let index = sums.partition_point(|&s| s <= target).min(sums.len().saturating_sub(1));
    let before = if index == 0 { 0.0 } else { sums[index - 1] };
    let inside = (target - before) / (sums[index] - before);
    (index, inside.clamp(0.0, 1.0))
}

impl Illuminate for MapLight {
    fn radiance(&self, direction: Vec3) -> Vec3 {
        self.map.sample_bilinear(direction)
    }

    /// The first number selects the row, the second the column and the position in it, the third
    /// the height in the row.
    fn sample(&self, uniform: [f32; 3]) -> LightSample {
        if self.rows.last().is_none_or(|&total| total <= 0.0) {
            return NO_SAMPLE;
        }
        let width = self.map.width as usize;
        let (j, _) = draw(&self.rows, uniform[0]);
        let (i, across) = draw(&self.columns[j * width..(j + 1) * width], uniform[1]);
        let u = (i as f64 + across) / width as f64;
        let (top, bottom) = (self.edges[j], self.edges[j + 1]);
        let cos_phi = (top + (bottom - top) * f64::from(uniform[2])).clamp(-1.0, 1.0);
        let (v, sin_phi) = (cos_phi.acos() / PI, (1.0 - cos_phi * cos_phi).max(0.0).sqrt());
        LightSample {
            direction: EnvironmentMap::direction_of(u, (sin_phi, cos_phi)),
            radiance: self.map.bilinear_at(u as f32, v as f32),
            pdf: self.density[j * width + i],
        }
    }

    fn pdf(&self, direction: Vec3) -> f32 {
        let (u, v) = EnvironmentMap::uv(direction);
        let (i, j) = self.map.texel_of(u, v);
        self.density[(j * self.map.width + i) as usize]
    }

    fn radiance_and_pdf(&self, direction: Vec3) -> (Vec3, f32) {
        let (u, v) = EnvironmentMap::uv(direction);
        let (i, j) = self.map.texel_of(u, v);
        (self.map.bilinear_at(u, v), self.density[(j * self.map.width + i) as usize])
    }
}

/// A set of SG lobes, sampled exactly in proportion to their luminance.
///
/// A lobe is drawn in proportion to luminance(μ) 2π(1 − e^(−2λ))/λ, then a direction from its SG.
/// The density of the mixture is then luminance(radiance) over the total power: no sample weighs
/// more than another in luminance.
#[derive(Clone, Debug)]
pub struct LobeLight {
    lobes: Vec<LightLobe>,
    /// Structure of arrays for the evaluation: axis x, y, z, −λ/2, μ r, g, b; filled up with black
    /// lobes to whole vectors.
    columns: [Vec<f32>; 7],
    /// Running sum of the lobes' luminous power.
    powers: Vec<f64>,
}

impl LobeLight {
    /// The light of `lobes` with unit axes (see [`crate::light::validate_lobes`]); without lobes it
    /// is black.
    pub fn new(lobes: &[LightLobe]) -> Self {
        let mut columns = [const { Vec::new() }; 7];
        for LightLobe { axis, sharpness, amplitude } in lobes {
            let values = [axis.x, axis.y, axis.z, -0.5 * sharpness, amplitude.x, amplitude.y, amplitude.z];
            columns.iter_mut().zip(values).for_each(|(column, value)| column.push(value));
        }
        let whole = lobes.len().next_multiple_of(MAX_LANES);
        columns.iter_mut().for_each(|column| column.resize(whole, 0.0));
        let sum = |total: &mut f64, l: &LightLobe| {
            *total += f64::from(luminance(l.amplitude)) * sg::sphere_integral(f64::from(l.sharpness));
            Some(*total)
        };
        Self { lobes: lobes.to_vec(), columns, powers: lobes.iter().scan(0.0, sum).collect() }
    }

    /// The lobes.
    pub fn lobes(&self) -> &[LightLobe] {
        &self.lobes
    }

    fn density_of(&self, radiance: Vec3) -> f32 {
        match self.powers.last() {
            Some(&total) if total > 0.0 => (f64::from(luminance(radiance)) / total) as f32,
            _ => 0.0,
        }
    }
}

/// The sum of lobes in a direction.
#[inline(always)]
fn radiance_of<S: Simd>(simd: S, columns: &[Vec<f32>; 7], direction: Vec3) -> Vec3 {
    let [x, y, z] = direction.to_array().map(|c| Lanes::splat(simd, c));
    let [mut r, mut g, mut b] = [Lanes::splat(simd, 0.0); 3];
    for at in (0..columns[0].len()).step_by(Lanes::<S>::LEN) {
        let lobes = at..at + Lanes::<S>::LEN;
        let dx = x - Lanes::load(simd, &columns[0][lobes.clone()]);
        let dy = y - Lanes::load(simd, &columns[1][lobes.clone()]);
        let dz = z - Lanes::load(simd, &columns[2][lobes.clone()]);
        let squared = dx.mul_add(dx, dy.mul_add(dy, dz * dz));
        let value = (squared * Lanes::load(simd, &columns[3][lobes.clone()])).exp();
        r = value.mul_add(Lanes::load(simd, &columns[4][lobes.clone()]), r);
        g = value.mul_add(Lanes::load(simd, &columns[5][lobes.clone()]), g);
        b = value.mul_add(Lanes::load(simd, &columns[6][lobes]), b);
    }
    Vec3::new(r.sum(), g.sum(), b.sum())
}

impl Illuminate for LobeLight {
    fn radiance(&self, direction: Vec3) -> Vec3 {
        dispatch!(simd => radiance_of(simd, &self.columns, direction))
    }

    /// The first number selects the lobe, the second the angle to its axis, the third the angle
    /// around it.
    fn sample(&self, uniform: [f32; 3]) -> LightSample {
        if self.powers.last().is_none_or(|&total| total <= 0.0) {
            return NO_SAMPLE;
        }
        let lobe = &self.lobes[draw(&self.powers, uniform[0]).0];
        let direction = sample_sg(lobe.axis, lobe.sharpness, uniform[1], uniform[2]);
        let radiance = self.radiance(direction);
        LightSample { direction, radiance, pdf: self.density_of(radiance) }
    }

    /// luminance(radiance) over the total luminous power; this evaluates the radiance.
    fn pdf(&self, direction: Vec3) -> f32 {
        self.density_of(self.radiance(direction))
    }

    fn radiance_and_pdf(&self, direction: Vec3) -> (Vec3, f32) {
        let radiance = self.radiance(direction);
        (radiance, self.density_of(radiance))
    }
}

/// A direction drawn from the normalized SG of `axis` and `sharpness` ≥ 0.
///
/// cos θ = 1 + ln(1 − u(1 − e^(−2λ)))/λ, computed as 1 − cos θ in `f64` so that it is accurate for
/// both sharp and broad lobes.
fn sample_sg(axis: Vec3, sharpness: f32, u: f32, turn: f32) -> Vec3 {
    let (lambda, u) = (f64::from(sharpness), f64::from(u));
    let rise = if lambda < 1e-6 { 2.0 * u } else { -(u * (-2.0 * lambda).exp_m1()).ln_1p() / lambda };
    let rise = rise.clamp(0.0, 2.0);
    let radius = (rise * (2.0 - rise)).sqrt();
    let (sin, cos) = (2.0 * PI * f64::from(turn)).sin_cos();
    let axis = axis.as_dvec3().normalize_or(DVec3::Y);
    let (tangent, bitangent) = axis.any_orthonormal_pair();
    (axis * (1.0 - rise) + (tangent * cos + bitangent * sin) * radius).as_vec3()
}

/// The lobes' radiance at every texel center of a `width` × `height` map; a size of 0 is taken as
/// 1.
pub fn render_lobes(lobes: &[LightLobe], width: u32, height: u32) -> EnvironmentMap {
    let light = LobeLight::new(lobes);
    EnvironmentMap::from_directions(width.max(1), height.max(1), |omega| light.radiance(omega))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fibonacci::fibonacci_axes;
    use crate::light::lobe::{lobes_power, scale_lobes};

    /// Uniform numbers in `[0, 1)` (SplitMix64).
    struct Numbers(u64);

    impl Numbers {
        fn next(&mut self) -> f32 {
            self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
            let mut z = self.0;
            z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
            ((z ^ (z >> 31)) >> 40) as f32 / (1_u64 << 24) as f32
        }
    }

    /// Checks that the mean of weight × radiance/pdf over samples is within 4 standard errors of
    /// `exact`, and that the density of `sample` is that of `pdf`.
    fn check_estimate(light: &dyn Illuminate, weight: fn(Vec3) -> f64, exact: DVec3, floor: f64) {
        let (mut sum, mut squares) = (DVec3::ZERO, DVec3::ZERO);
        let mut numbers = Numbers(7);
        let n = 60_000;
        let mut disagreements = 0;
        for _ in 0..n {
            let sample = light.sample([numbers.next(), numbers.next(), numbers.next()]);
            assert!(sample.pdf > 0.0 && sample.pdf.is_finite());
            assert!(sample.radiance.is_finite() && (sample.direction.length() - 1.0).abs() < 1e-5);
            // Only samples within rounding of the edge of a texel may have the density of the
            // neighbor.
            let direction = sample.direction;
            assert_eq!(light.radiance_and_pdf(direction), (light.radiance(direction), light.pdf(direction)));
            disagreements += i32::from((light.pdf(sample.direction) / sample.pdf - 1.0).abs() > 1e-3);
            let value = sample.radiance.as_dvec3() * weight(sample.direction) / f64::from(sample.pdf);
            sum += value;
            squares += value * value;
        }
        assert!(disagreements < 30, "{disagreements} densities disagree");
        let mean = sum / f64::from(n);
        let error = ((squares / f64::from(n) - mean * mean).max(DVec3::ZERO) / f64::from(n)).map(f64::sqrt);
        let off = (mean - exact).abs() - 4.0 * error;
        assert!(off.max_element() <= floor * exact.abs().max_element(), "{mean} ± {error}, exact {exact}");
    }

    /// Sum of `value` × solid angle over a fine grid.
    fn quadrature(value: impl Fn(Vec3) -> DVec3) -> DVec3 {
        let grid = EnvironmentMap { width: 1200, height: 600, radiance: Vec::new() };
        let row = |j| {
            (0..1200).map(|i| value(grid.texel_direction(i, j))).sum::<DVec3>() * grid.texel_solid_angle(j)
        };
        (0..600).map(row).sum()
    }

    fn tilt(direction: Vec3) -> f64 {
        1.5 + f64::from(direction.x * direction.y) + f64::from(direction.z)
    }

    fn spotted_map() -> EnvironmentMap {
        let mut map = EnvironmentMap { width: 30, height: 15, radiance: vec![Vec3::ZERO; 450] };
        for (k, texel) in map.radiance.iter_mut().enumerate() {
            if k % 7 == 0 {
                *texel = Vec3::new(0.1, 0.2, 0.3) * (1 + k % 11) as f32;
            }
        }
        map.radiance[0] = Vec3::splat(30.0);
        map.radiance[224] = Vec3::new(500.0, 400.0, 300.0);
        map
    }

    #[test]
    fn map_estimates_are_unbiased_and_its_density_integrates_to_one() {
        let light = MapLight::new(spotted_map());
        let total = quadrature(|d| DVec3::splat(f64::from(light.pdf(d))));
        assert!((total.x - 1.0).abs() < 1e-3, "{total}");
        let exact = quadrature(|d| light.radiance(d).as_dvec3() * tilt(d));
        check_estimate(&light, tilt, exact, 1e-3);
        for d in fibonacci_axes(5000) {
            assert!(light.radiance(d) == Vec3::ZERO || light.pdf(d) > 0.0);
        }
    }

    #[test]
    fn lobes_estimate_their_integral_sharp_and_flat() {
        for sharpness in [0.0, 1e-7, 1e-3, 1.0, 40.0, 1e3, 1e5] {
            let lobe = LightLobe {
                axis: Vec3::new(0.36, 0.48, -0.8),
                sharpness,
                amplitude: Vec3::new(1.0, 2.0, 0.5),
            };
            let light = LobeLight::new(&[lobe]);
            // f32 directions limit the accuracy for sharp lobes.
            check_estimate(&light, |_| 1.0, lobe.power(), 1e-5);
            let peak = light.radiance(lobe.axis);
            assert!(peak.distance(lobe.amplitude) < 1e-4 && light.radiance(-lobe.axis).is_finite());
        }
    }

    #[test]
    fn samples_of_a_lobe_follow_its_profile() {
        for sharpness in [1e-3_f32, 3.0, 1e5] {
            let light = LobeLight::new(&[LightLobe { axis: Vec3::Y, sharpness, amplitude: Vec3::ONE }]);
            let mut numbers = Numbers(3);
            let n = 40_000;
            let lambda = f64::from(sharpness);
            // 1 − cos θ through |ω − ξ|²/2, which does not cancel.
            let mean: f64 = (0..n)
                .map(|_| {
                    let d = light.sample([0.0, numbers.next(), numbers.next()]).direction;
                    f64::from((d - Vec3::Y).length_squared()) / 2.0
                })
                .sum::<f64>()
                / f64::from(n);
            let exact = 1.0 / lambda - 2.0 * (-2.0 * lambda).exp() / (1.0 - (-2.0 * lambda).exp());
            assert!((mean / exact - 1.0).abs() < 4.0 / f64::from(n).sqrt(), "{sharpness}: {mean}, {exact}");
        }
    }

    #[test]
    fn a_mixture_of_lobes_is_unbiased_for_any_weight() {
        let lobe = |(i, axis)| LightLobe {
            axis,
            sharpness: [0.5, 4.0, 60.0][i % 3],
            amplitude: Vec3::new(0.1 + i as f32, 0.7, 2.0 / (1 + i) as f32),
        };
        let lobes: Vec<LightLobe> = fibonacci_axes(11).into_iter().enumerate().map(lobe).collect();
        let light = LobeLight::new(&lobes);
        let direct = crate::light::lobes_radiance(&lobes, Vec3::new(0.6, 0.0, 0.8));
        assert!(light.radiance(Vec3::new(0.6, 0.0, 0.8)).distance(direct) < 1e-5 * direct.length());
        let total = quadrature(|d| DVec3::splat(f64::from(light.pdf(d))));
        assert!((total.x - 1.0).abs() < 1e-4, "{total}");
        check_estimate(&light, tilt, quadrature(|d| light.radiance(d).as_dvec3() * tilt(d)), 1e-5);
    }

    #[test]
    fn black_lights_draw_nothing() {
        let dark = LightLobe { axis: Vec3::Y, sharpness: 2.0, amplitude: Vec3::ZERO };
        let map = EnvironmentMap { width: 4, height: 2, radiance: vec![Vec3::ZERO; 8] };
        let lights: [Box<dyn Illuminate>; 3] =
            [Box::new(LobeLight::new(&[])), Box::new(LobeLight::new(&[dark])), Box::new(MapLight::new(map))];
        for light in lights {
            let sample = light.sample([0.5; 3]);
            assert_eq!((sample.pdf, sample.radiance, light.pdf(Vec3::X)), (0.0, Vec3::ZERO, 0.0));
        }
    }

    #[test]
    fn power_agrees_with_the_rendered_map() {
        let lobe = LightLobe { axis: Vec3::X, sharpness: 5.0, amplitude: Vec3::new(1.0, 2.0, 3.0) };
        let lobes = scale_lobes(&[lobe, LightLobe { axis: Vec3::Y, ..lobe }], Vec3::new(2.0, 1.0, 1.0));
        let map = render_lobes(&lobes, 256, 128);
        let (sum, exact) = (map.power(), lobes_power(&lobes));
        assert!((sum - exact).abs().max_element() < 1e-3 * exact.max_element(), "{sum} {exact}");
    }
}
