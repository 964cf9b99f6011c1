//! The latitude-longitude grid: directions and solid angles of texels, and interpolation. The top
//! row lies around +Y, the left edge toward −Z and the middle toward +Z.

use crate::light::lobe::MAX_RADIANCE;
use glam::{DVec3, Quat, Vec3};
use rayon::prelude::*;
use std::f64::consts::PI;

/// Radiance from every direction on a latitude-longitude grid.
///
/// Texel centers at ((i + ½)/W, (j + ½)/H); top row around +Y; left edge −Z, then +X at ¼, +Z at ½,
/// −X at ¾: direction of (u, v) = (cos θ sin φ, cos φ, sin θ sin φ), φ = πv, θ = 2πu − π/2.
#[derive(Clone, Debug, PartialEq)]
pub struct EnvironmentMap {
    /// Width in texels.
    pub width: u32,
    /// Height in texels.
    pub height: u32,
    /// `width * height` linear RGB radiances, row by row from the top left.
    pub radiance: Vec<Vec3>,
}

impl EnvironmentMap {
    /// A map of `width` × `height` texels (both at least 1) whose texels hold `radiance` in the
    /// direction of their center.
    ///
    /// Rows are computed in parallel.
    pub fn from_directions(width: u32, height: u32, radiance: impl Fn(Vec3) -> Vec3 + Sync) -> Self {
        let mut map = Self { width, height, radiance: Vec::new() };
        let rows: Vec<Vec<Vec3>> = (0..height)
            .into_par_iter()
            .map(|j| (0..width).map(|i| radiance(map.texel_direction(i, j))).collect())
            .collect();
        map.radiance = rows.concat();
        map
    }

    /// Unit direction of (`u`, `v`), each in `[0, 1]`: (cos θ sin φ, cos φ, sin θ sin φ), φ = πv, θ =
    /// 2πu − π/2.
    pub fn direction(u: f64, v: f64) -> Vec3 {
        Self::direction_of(u, (PI * v).sin_cos())
    }

    /// Unit direction of `u` and the sine and cosine of the polar angle φ = πv.
    pub(crate) fn direction_of(u: f64, (sin_phi, cos_phi): (f64, f64)) -> Vec3 {
        let (sin_theta, cos_theta) = (2.0 * PI * u - 0.5 * PI).sin_cos();
        DVec3::new(cos_theta * sin_phi, cos_phi, sin_theta * sin_phi).as_vec3()
    }

    /// (u, v) of a direction (of any length but zero), u in `[0, 1)`, v in `[0, 1]`: inverse of
    /// [`Self::direction`].
    pub fn uv(direction: Vec3) -> (f32, f32) {
        use std::f32::consts::{FRAC_1_PI, FRAC_PI_2};
        let u = (direction.z.atan2(direction.x) + FRAC_PI_2) * (0.5 * FRAC_1_PI);
        // atan2 keeps its accuracy at the poles, where acos does not.
        let v = direction.x.hypot(direction.z).atan2(direction.y) * FRAC_1_PI;
        // Wrapping a tiny negative u rounds to 1, which is the same position as 0.
        let wrapped = if u < 0.0 { u + 1.0 } else { u };
        (if wrapped >= 1.0 { 0.0 } else { wrapped }, v)
    }

    /// Unit direction of the center of texel (`i`, `j`).
    pub fn texel_direction(&self, i: u32, j: u32) -> Vec3 {
        let u = (f64::from(i) + 0.5) / f64::from(self.width);
        let v = (f64::from(j) + 0.5) / f64::from(self.height);
        Self::direction(u, v)
    }

    /// Steradians of any one texel of row `j`: (2π/W)(cos φ_j − cos φ_(j+1)); all texels sum to 4π.
    pub fn texel_solid_angle(&self, j: u32) -> f64 {
        let half_step = 0.5 * PI / f64::from(self.height);
        let middle = PI * (f64::from(j) + 0.5) / f64::from(self.height);
        // cos a − cos b = 2 sin((a + b)/2) sin((b − a)/2), without cancellation at the poles.
        2.0 * PI / f64::from(self.width) * 2.0 * middle.sin() * half_step.sin()
    }

    /// Texel (column, row) that contains (`u`, `v`).
    pub fn texel_of(&self, u: f32, v: f32) -> (u32, u32) {
        let i = (u * self.width as f32) as u32;
        let j = (v * self.height as f32) as u32;
        (i.min(self.width - 1), j.min(self.height - 1))
    }

    /// Radiance from a direction, interpolated between the four nearest texel centers; wraps in u,
    /// clamps at the poles.
    pub fn sample_bilinear(&self, direction: Vec3) -> Vec3 {
        let (u, v) = Self::uv(direction);
        self.bilinear_at(u, v)
    }

    /// Radiance at (`u`, `v`), each in `[0, 1]`; as [`Self::sample_bilinear`].
    pub fn bilinear_at(&self, u: f32, v: f32) -> Vec3 {
        let (width, height) = (self.width as usize, self.height as usize);
        let x = u * self.width as f32 - 0.5;
        let y = (v * self.height as f32 - 0.5).clamp(0.0, (height - 1) as f32);
        let (x_floor, y_floor) = (x.floor(), y.floor());
        let left = (x_floor + self.width as f32) as usize % width;
        let right = (left + 1) % width;
        let top = y_floor as usize;
        let bottom = (top + 1).min(height - 1);
        let (s, t) = (x - x_floor, y - y_floor);
        let row = |j: usize| {
            let (a, b) = (self.radiance[j * width + left], self.radiance[j * width + right]);
            a * (1.0 - s) + b * s
        };
        row(top) * (1.0 - t) + row(bottom) * t
    }

    /// The map with every radiance multiplied by `factor` (per channel).
    pub fn scaled(&self, factor: Vec3) -> Self {
        let radiance = self.radiance.iter().map(|&r| r * factor).collect();
        Self { radiance, ..*self }
    }

    /// The map rotated by `rotation`: light from direction d comes from `rotation * d` afterward.
    ///
    /// Resampled bilinearly at texel centers, at the same size; the identity returns the same bits.
    /// A light that is smaller than a texel keeps its power only up to the accuracy of the
    /// interpolation.
    pub fn rotated(&self, rotation: Quat) -> Self {
        let inverse = rotation.normalize().inverse();
        if inverse.xyz() == Vec3::ZERO {
            return self.clone();
        }
        Self::from_directions(self.width, self.height, |omega| self.sample_bilinear(inverse * omega))
    }

    /// The map averaged to `width` × `height` texels (at least 1, at most its own size), weighted
    /// by solid angle, so that its power is preserved.
    pub fn downsampled(&self, width: u32, height: u32) -> Self {
        let (width, height) = (width.clamp(1, self.width), height.clamp(1, self.height));
        if (width, height) == (self.width, self.height) {
            return self.clone();
        }
        let mut filter = BoxFilter::new([self.width, self.height], [width, height]);
        for (texel, &value) in self.radiance.iter().enumerate() {
            filter.add(texel % self.width as usize, texel / self.width as usize, value);
        }
        filter.finish()
    }

    /// Integral of the radiance over the whole sphere, linear RGB × steradians.
    pub fn power(&self) -> DVec3 {
        let rows = self.radiance.chunks_exact(self.width as usize);
        let row_sum = |row: &[Vec3]| row.iter().map(|r| r.as_dvec3()).sum::<DVec3>();
        rows.zip(0..).map(|(row, j)| row_sum(row) * self.texel_solid_angle(j)).sum()
    }

    /// Solid-angle-weighted mean, over texels and channels, of the squared difference from `other`
    /// of the same size; `None` if the sizes differ.
    pub fn mean_squared_difference(&self, other: &Self) -> Option<f64> {
        if (self.width, self.height) != (other.width, other.height) {
            return None;
        }
        let width = self.width as usize;
        let rows = self.radiance.chunks_exact(width).zip(other.radiance.chunks_exact(width));
        let row_sum = |((a, b), j): ((&[Vec3], &[Vec3]), u32)| {
            let squares = a.iter().zip(b).map(|(a, b)| (a.as_dvec3() - b.as_dvec3()).length_squared());
            squares.sum::<f64>() * self.texel_solid_angle(j)
        };
        Some(rows.zip(0..).map(row_sum).sum::<f64>() / (3.0 * 4.0 * PI))
    }
}

/// Averages a latitude-longitude map into a smaller one, one texel at a time and in any order.
///
/// Weights are overlaps in longitude times overlaps in cos φ, which is overlap in solid angle.
pub struct BoxFilter {
    columns: Vec<Share>,
    rows: Vec<Share>,
    map: EnvironmentMap,
}

/// The one or two output texels along one axis that an input texel overlaps, and its fraction of
/// each.
#[derive(Clone, Copy)]
struct Share {
    first: usize,
    weights: [f32; 2],
}

impl BoxFilter {
    /// From `input` to `output` (width, height); no output side is longer than its input side.
    pub fn new(input: [u32; 2], output: [u32; 2]) -> Self {
        let [width, height] = output;
        let radiance = vec![Vec3::ZERO; width as usize * height as usize];
        Self {
            columns: shares(input[0], width, |u| u),
            rows: shares(input[1], height, |v| (0.5 * PI * v).sin().powi(2)),
            map: EnvironmentMap { width, height, radiance },
        }
    }

    /// Adds the input texel (`x`, `y`).
    pub fn add(&mut self, x: usize, y: usize, value: Vec3) {
        let (column, row) = (self.columns[x], self.rows[y]);
        let width = self.map.width as usize;
        for (j, row_weight) in (row.first..).zip(row.weights) {
            for (i, column_weight) in (column.first..).zip(column.weights) {
                // A weight of zero may belong to a texel beyond the edge.
                if row_weight * column_weight > 0.0 {
                    self.map.radiance[j * width + i] += value * (row_weight * column_weight);
                }
            }
        }
    }

    /// The smaller map.
    pub fn finish(self) -> EnvironmentMap {
        self.map
    }
}

/// How `input` texels along an axis are distributed over `output` ones; `measure` grows from 0 to 1
/// in proportion to area.
fn shares(input: u32, output: u32, measure: impl Fn(f64) -> f64) -> Vec<Share> {
    let edge = |k: u64, n: u32| measure(k as f64 / f64::from(n));
    (0..u64::from(input))
        .map(|k| {
            let first = k * u64::from(output) / u64::from(input);
            let part = |target: u64| {
                let low = edge(k, input).max(edge(target, output));
                let high = edge(k + 1, input).min(edge(target + 1, output));
                let whole = edge(target + 1, output) - edge(target, output);
                // Adjacent texels overlap only by rounding, which does not count.
                let part = ((high - low) / whole).max(0.0) as f32;
                if target < u64::from(output) && part > 1e-7 { part } else { 0.0 }
            };
            Share { first: first as usize, weights: [part(first), part(first + 1)] }
        })
        .collect()
}

/// Checks that the map is a usable light.
///
/// # Errors
/// A clause that names the first texel with a radiance that is negative, not finite, or above
/// [`MAX_RADIANCE`].
pub fn validate_map(map: &EnvironmentMap) -> Result<(), String> {
    let usable = |r: &Vec3| r.to_array().iter().all(|channel| (0.0..=MAX_RADIANCE).contains(channel));
    let Some(k) = map.radiance.iter().position(|r| !usable(r)) else { return Ok(()) };
    let (i, j) = (k % map.width as usize, k / map.width as usize);
    let [r, g, b] = map.radiance[k].to_array();
    Err(format!("texel ({i}, {j}) has radiance ({r:e}, {g:e}, {b:e}), not from 0 to {MAX_RADIANCE:e}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bumpy(width: u32, height: u32) -> EnvironmentMap {
        EnvironmentMap::from_directions(width, height, |d| {
            Vec3::new(1.0 + d.x, 1.5 + d.y * d.z, 1.0 + 0.5 * (3.0 * d.z).sin())
        })
    }

    #[test]
    fn the_four_quarters_and_the_poles_lie_where_the_convention_says() {
        let close = |u: f64, v: f64, d: Vec3| {
            assert!(EnvironmentMap::direction(u, v).distance(d) < 1e-6, "({u}, {v}) should be {d}");
            let (u_back, v_back) = EnvironmentMap::uv(d);
            assert!((f64::from(v_back) - v).abs() < 1e-6);
            assert!(v == 0.0 || v == 1.0 || (f64::from(u_back) - u).abs() < 1e-6);
        };
        close(0.0, 0.5, Vec3::NEG_Z);
        close(0.25, 0.5, Vec3::X);
        close(0.5, 0.5, Vec3::Z);
        close(0.75, 0.5, Vec3::NEG_X);
        close(0.3, 0.0, Vec3::Y);
        close(0.3, 1.0, Vec3::NEG_Y);
    }

    #[test]
    fn uv_inverts_direction_everywhere() {
        for k in 0..1000 {
            let (u, v) = ((f64::from(k) * 0.618_034).fract(), (f64::from(k) + 0.5) / 1000.0);
            let d = EnvironmentMap::direction(u, v);
            let (u_back, v_back) = EnvironmentMap::uv(d);
            let again = EnvironmentMap::direction(f64::from(u_back), f64::from(v_back));
            assert!(again.distance(d) < 1e-6);
            assert!((0.0..1.0).contains(&u_back));
        }
        // Just left of the seam.
        let (u, _) = EnvironmentMap::uv(Vec3::new(-1e-20, 0.0, -1.0));
        assert!((0.0..1.0).contains(&u));
    }

    #[test]
    fn solid_angles_sum_to_the_sphere() {
        let map = EnvironmentMap::from_directions(14, 7, |_| Vec3::ONE);
        let total: f64 = (0..7).map(|j| 14.0 * map.texel_solid_angle(j)).sum();
        assert!((total - 4.0 * PI).abs() < 1e-12);
        let exact = 2.0 * PI / 14.0 * ((2.0 * PI / 7.0).cos() - (3.0 * PI / 7.0).cos());
        assert!((map.texel_solid_angle(2) - exact).abs() < 1e-12);
        assert!((map.power() - DVec3::splat(4.0 * PI)).abs().max_element() < 1e-9);
    }

    #[test]
    fn bilinear_is_exact_at_centers_and_wraps() {
        let map = bumpy(20, 10);
        for j in 0..10 {
            for i in 0..20 {
                let d = map.texel_direction(i, j);
                let there = map.radiance[(j * 20 + i) as usize];
                assert!(map.sample_bilinear(d).distance(there) < 1e-4);
            }
        }
        let seam = map.bilinear_at(0.0, 0.55);
        let mean = (map.radiance[5 * 20] + map.radiance[5 * 20 + 19]) / 2.0;
        assert!(seam.distance(mean) < 1e-5);
        assert_eq!(map.bilinear_at(0.025, 0.0), map.radiance[0]);
    }

    #[test]
    fn rotation_turns_the_light_the_right_way() {
        let map = bumpy(128, 64);
        assert_eq!(map.rotated(Quat::IDENTITY), map);
        let turn = Quat::from_euler(glam::EulerRot::XYZ, 0.4, 1.1, -0.7);
        let turned = map.rotated(turn);
        for d in crate::fibonacci::fibonacci_axes(50) {
            assert!(turned.sample_bilinear(turn * d).distance(map.sample_bilinear(d)) < 0.02);
        }
        let (before, after) = (map.power(), turned.power());
        assert!((before - after).abs().max_element() < 2e-3 * before.max_element());
    }

    #[test]
    fn downsampling_keeps_the_power() {
        let map = bumpy(50, 25);
        for (width, height) in [(50, 25), (25, 12), (16, 8), (7, 3), (1, 1)] {
            let small = map.downsampled(width, height);
            assert_eq!((small.width, small.height), (width, height));
            assert!((small.power() - map.power()).abs().max_element() < 1e-4);
        }
        let exact = map.downsampled(10, 5).radiance[2 * 10 + 3];
        let mean = (10..15).flat_map(|j| (15..20).map(move |i| (i, j)));
        let mean = mean.map(|(i, j)| map.radiance[j * 50 + i].as_dvec3() * map.texel_solid_angle(j as u32));
        let weight: f64 = (10..15).map(|j| 5.0 * map.texel_solid_angle(j)).sum();
        assert!((mean.sum::<DVec3>() / weight).as_vec3().distance(exact) < 1e-5);
    }

    #[test]
    fn scaling_and_differences() {
        let map = bumpy(8, 4);
        let double = map.scaled(Vec3::new(2.0, 1.0, 1.0));
        assert_eq!(double.radiance[5].x, 2.0 * map.radiance[5].x);
        let ones = EnvironmentMap::from_directions(8, 4, |_| Vec3::ONE);
        let threes = ones.scaled(Vec3::splat(3.0));
        assert!((ones.mean_squared_difference(&threes).unwrap() - 4.0).abs() < 1e-9);
        assert_eq!(ones.mean_squared_difference(&bumpy(4, 2)), None);
    }

    #[test]
    fn maps_with_unusable_texels_are_refused_with_their_place() {
        let mut map = EnvironmentMap::from_directions(8, 4, |_| Vec3::ONE);
        assert!(validate_map(&map).is_ok());
        for bad in [f32::NAN, f32::INFINITY, -1.0, 1e38] {
            map.radiance[11].y = bad;
            let message = validate_map(&map).unwrap_err();
            assert!(message.starts_with("texel (3, 1) has radiance"), "{message}");
        }
    }
}
