//! Kernels of the map fit: the squared error of lobes against a map, and its derivatives.
//!
//! The error is E = Σ_i w_i Σ_c (Σ_k μ_kc G_k(ω_i) − y_ic)², with w the texels' shares of the
//! sphere. The map is cut into tiles of `TILE` neighboring texels; a lobe is skipped in tiles where
//! it is below e⁻¹⁶. Tiles are processed in parallel and their sums added in a fixed order, so
//! results do not depend on the number of threads.

use crate::{dispatch, lanes::Lanes, light::envmap::EnvironmentMap, real::Real};
use fearless_simd::Simd;
use glam::{DVec3, Vec3};
use rayon::prelude::*;
use std::ops::Range;

/// Texels in a tile.
pub const TILE: usize = 128;
/// Groups of tiles with separate sums, which fixes the order of summation.
const GROUPS: usize = 32;
/// Below e to this power a lobe is taken as zero.
const CUTOFF: f64 = -16.0;

/// A value per texel of a tile and channel.
pub type TileValues = [[f32; TILE]; 3];

/// A lobe with the parameterization of the fit: the axis rotates along tangents, the sharpness
/// changes by a factor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FitLobe {
    /// Unit axis ξ.
    pub axis: DVec3,
    /// Two unit vectors that are perpendicular to the axis and to each other.
    pub tangents: [DVec3; 2],
    /// λ.
    pub sharpness: f64,
    /// μ, RGB.
    pub amplitude: [f64; 3],
}

impl FitLobe {
    /// A lobe; `axis` is not zero and need not have unit length.
    pub fn new(axis: DVec3, sharpness: f64, amplitude: [f64; 3]) -> Self {
        let axis = axis.normalize_or(DVec3::Y);
        Self { axis, tangents: axis.any_orthonormal_pair().into(), sharpness, amplitude }
    }

    /// The lobe after a step: the axis rotates toward the tangents by `step[0..2]` radians, the log
    /// sharpness increases by `step[2]`.
    pub fn moved(&self, step: [f64; 3]) -> Self {
        let [a, b] = self.tangents;
        Self::new(self.axis + a * step[0] + b * step[1], self.sharpness * step[2].exp(), self.amplitude)
    }
}

/// A tile of neighboring texels of a map; unused entries have weight 0.
#[derive(Clone, Debug)]
pub struct Tile {
    directions: [[f32; TILE]; 3],
    /// √w of each texel; the weights of all tiles sum to 1.
    root_weights: [f32; TILE],
    /// √w y, per channel.
    targets: TileValues,
    center: Vec3,
    /// Sine and cosine of the largest angle of a texel from the center.
    radius: [f32; 2],
}

/// The region where a lobe is above the cutoff: within an angle, given by its sine and cosine, of
/// the axis.
#[derive(Clone, Copy, Debug)]
pub struct LobeCap {
    axis: Vec3,
    angle: [f32; 2],
}

/// E and its derivatives.
#[derive(Clone, Debug)]
pub struct Derivatives {
    /// E.
    pub error: f64,
    /// Σ_i √w B_a r_c for each lobe, basis a (G, its derivatives with respect to the two tangents
    /// and log λ) and channel c, with r the weighted residual.
    pub correlations: Vec<[[f64; 3]; 4]>,
}

/// Per lobe and channel: Σ √w G r, and the same times each coordinate of ω − ξ.
type Moments = [[f64; 4]; 3];

impl Derivatives {
    /// The derivatives of E with respect to each lobe's two tangents, log sharpness and three
    /// amplitudes.
    pub fn gradient(&self, lobes: &[FitLobe]) -> Vec<[f64; 6]> {
        let of_lobe = |(lobe, c): (&FitLobe, &[[f64; 3]; 4])| {
            let shape = [1, 2, 3].map(|a| 2.0 * (0..3).map(|ch| lobe.amplitude[ch] * c[a][ch]).sum::<f64>());
            [shape[0], shape[1], shape[2], 2.0 * c[0][0], 2.0 * c[0][1], 2.0 * c[0][2]]
        };
        lobes.iter().zip(&self.correlations).map(of_lobe).collect()
    }
}

/// Cuts a map into tiles of 16 × 8 texels, row by row.
pub fn tiles_of(map: &EnvironmentMap) -> Vec<Tile> {
    let corners = (0..map.height).step_by(8).flat_map(|j| (0..map.width).step_by(16).map(move |i| (i, j)));
    corners.map(|(left, top)| tile_at(map, left, top)).collect()
}

/// The tiles of a row of a map, by number, and the least and largest height y of what is in them.
#[derive(Clone, Debug)]
pub struct TileRow {
    tiles: Range<usize>,
    heights: [f32; 2],
}

/// The rows of the tiles of a map of this width.
pub fn rows_of(tiles: &[Tile], width: u32) -> Vec<TileRow> {
    let across = width.div_ceil(16) as usize;
    let row = |(number, row): (usize, &[Tile])| {
        let ends = row.iter().map(Tile::heights);
        let heights = ends.fold([1.0f32, -1.0], |[low, high], [l, h]| [low.min(l), high.max(h)]);
        TileRow { tiles: number * across..number * across + row.len(), heights }
    };
    tiles.chunks(across).enumerate().map(row).collect()
}

fn tile_at(map: &EnvironmentMap, left: u32, top: u32) -> Tile {
    let mut tile = Tile {
        directions: [[0.0; TILE]; 3],
        root_weights: [0.0; TILE],
        targets: [[0.0; TILE]; 3],
        center: Vec3::Y,
        radius: [0.0, 1.0],
    };
    let inside = |k: u32| (left + k % 16, top + k / 16);
    let texels: Vec<(u32, u32)> =
        (0..TILE as u32).map(inside).filter(|&(i, j)| i < map.width && j < map.height).collect();
    for (k, &(i, j)) in texels.iter().enumerate() {
        let root = (map.texel_solid_angle(j) / (4.0 * std::f64::consts::PI)).sqrt() as f32;
        let radiance = map.radiance[(j * map.width + i) as usize].to_array();
        tile.root_weights[k] = root;
        for (c, d) in map.texel_direction(i, j).to_array().into_iter().enumerate() {
            tile.directions[c][k] = d;
            tile.targets[c][k] = root * radiance[c];
        }
    }
    let directions: Vec<Vec3> = texels.iter().map(|&(i, j)| map.texel_direction(i, j)).collect();
    tile.center = directions.iter().sum::<Vec3>().normalize_or(Vec3::Y);
    let radius = directions.iter().map(|d| d.angle_between(tile.center)).fold(0.0, f32::max);
    tile.radius = (radius + 1e-3).sin_cos().into();
    tile
}

impl LobeCap {
    /// The reach of a lobe.
    pub fn new(axis: DVec3, sharpness: f64) -> Self {
        // λ(cos θ − 1) = cutoff.
        let cosine = (1.0 + CUTOFF / sharpness.max(1e-9)).max(-1.0);
        Self { axis: axis.as_vec3(), angle: [(1.0 - cosine * cosine).sqrt() as f32, cosine as f32] }
    }

    /// Whether the lobe is above the cutoff anywhere in the tile.
    #[inline(always)]
    pub fn meets(&self, tile: &Tile) -> bool {
        let ([s, c], [sin, cos]) = (self.angle, tile.radius);
        // The sum of the angles exceeds π where the sine of the sum is negative.
        s * cos + c * sin < 0.0 || c <= -1.0 || tile.center.dot(self.axis) > c * cos - s * sin
    }

    /// The tiles of a row, none of them if the lobe is dark at all heights of the row.
    pub fn tiles_in(&self, row: &TileRow) -> Range<usize> {
        let [low, high] = heights_of_cap(self.axis, self.angle);
        let meets = self.angle[1] <= 0.0 || (row.heights[0] <= high && row.heights[1] >= low);
        if meets { row.tiles.clone() } else { 0..0 }
    }
}

/// The least and largest height y within an angle of at most a right one, given by its sine and
/// cosine, of a direction: its own, turned down and up as far as the poles.
fn heights_of_cap(axis: Vec3, [sin, cos]: [f32; 2]) -> [f32; 2] {
    let y = axis.y.clamp(-1.0, 1.0);
    let level = (1.0 - y * y).sqrt();
    let low = if -y > cos { -1.0 } else { y * cos - level * sin };
    let high = if y > cos { 1.0 } else { y * cos + level * sin };
    [low, high]
}

fn reaches(lobes: &[FitLobe]) -> Vec<LobeCap> {
    lobes.iter().map(|lobe| LobeCap::new(lobe.axis, lobe.sharpness)).collect()
}

/// A lobe in every lane: axis, −λ/2, amplitude.
#[inline(always)]
fn splat<S: Simd>(simd: S, lobe: &FitLobe) -> [Lanes<S>; 7] {
    let mut lanes = [Lanes::splat(simd, (-0.5 * lobe.sharpness) as f32); 7];
    for c in 0..3 {
        lanes[c] = Lanes::splat(simd, lobe.axis[c] as f32);
        lanes[4 + c] = Lanes::splat(simd, lobe.amplitude[c] as f32);
    }
    lanes
}

impl Tile {
    /// The least and largest height y within its radius around its center.
    fn heights(&self) -> [f32; 2] {
        heights_of_cap(self.center, self.radius)
    }

    #[inline(always)]
    fn load<S: Simd>(simd: S, row: &[f32; TILE], at: usize) -> Lanes<S> {
        Lanes::load(simd, &row[at..at + Lanes::<S>::LEN])
    }

    /// √w G at the texels from `at` on.
    #[inline(always)]
    fn value<S: Simd>(&self, simd: S, lobe: &[Lanes<S>; 7], at: usize) -> Lanes<S> {
        let x = Self::load(simd, &self.directions[0], at) - lobe[0];
        let y = Self::load(simd, &self.directions[1], at) - lobe[1];
        let z = Self::load(simd, &self.directions[2], at) - lobe[2];
        let square = x.mul_add(x, y.mul_add(y, z * z));
        Self::load(simd, &self.root_weights, at) * (lobe[3] * square).exp()
    }

    /// Writes √w (model − y) of the lobes `reached`, and √w G of each of them, one after the other,
    /// into `values`.
    #[inline(always)]
    fn residual<S: Simd>(
        &self,
        simd: S,
        lobes: &[FitLobe],
        reached: &[usize],
        values: &mut Vec<f32>,
    ) -> TileValues {
        let mut residual = self.targets.map(|row| row.map(|y| -y));
        values.resize(reached.len() * TILE, 0.0);
        for (&k, values) in reached.iter().zip(values.chunks_exact_mut(TILE)) {
            let lobe = splat(simd, &lobes[k]);
            for at in (0..TILE).step_by(Lanes::<S>::LEN) {
                let value = self.value(simd, &lobe, at);
                value.store(&mut values[at..at + Lanes::<S>::LEN]);
                for (c, row) in residual.iter_mut().enumerate() {
                    (lobe[4 + c] * value).add_to(&mut row[at..at + Lanes::<S>::LEN]);
                }
            }
        }
        residual
    }

    /// A lobe's moments with a residual; `values` are its √w G.
    #[inline(always)]
    fn moments<S: Simd>(&self, simd: S, lobe: &FitLobe, values: &[f32], residual: &TileValues) -> Moments {
        let lobe = splat(simd, lobe);
        let mut sums = [[Lanes::splat(simd, 0.0); 4]; 3];
        for at in (0..TILE).step_by(Lanes::<S>::LEN) {
            let value = Lanes::load(simd, &values[at..at + Lanes::<S>::LEN]);
            let x = Self::load(simd, &self.directions[0], at) - lobe[0];
            let y = Self::load(simd, &self.directions[1], at) - lobe[1];
            let z = Self::load(simd, &self.directions[2], at) - lobe[2];
            for c in 0..3 {
                let product = value * Self::load(simd, &residual[c], at);
                sums[c][0] += product;
                sums[c][1] = product.mul_add(x, sums[c][1]);
                sums[c][2] = product.mul_add(y, sums[c][2]);
                sums[c][3] = product.mul_add(z, sums[c][3]);
            }
        }
        let mut moments = Moments::default();
        for c in 0..3 {
            for k in 0..4 {
                moments[c][k] = f64::from(sums[c][k].sum());
            }
        }
        moments
    }

    /// Inner products of a unit-amplitude lobe with −`residual`, per channel.
    #[inline(always)]
    pub fn products<S: Simd>(&self, simd: S, lobe: &FitLobe, residual: &TileValues) -> [f64; 3] {
        let lobe = splat(simd, lobe);
        let mut sums = [Lanes::splat(simd, 0.0); 3];
        for at in (0..TILE).step_by(Lanes::<S>::LEN) {
            let value = self.value(simd, &lobe, at);
            for (sum, row) in sums.iter_mut().zip(residual) {
                *sum = value.mul_add(Self::load(simd, row, at), *sum);
            }
        }
        let mut products = [0.0; 3];
        for c in 0..3 {
            products[c] = -f64::from(sums[c].sum());
        }
        products
    }
}

fn squared(residual: &TileValues) -> f64 {
    let row = |row: &[f32; TILE]| f64::from(row.iter().map(|r| r * r).sum::<f32>());
    residual.iter().map(row).sum()
}

/// The weighted residual √w (model − y) of every tile, per channel.
pub fn residuals(tiles: &[Tile], lobes: &[FitLobe]) -> Vec<TileValues> {
    let reaches = reaches(lobes);
    let of_tile = |tile: &Tile| {
        let reached: Vec<usize> = (0..lobes.len()).filter(|&k| reaches[k].meets(tile)).collect();
        dispatch!(simd => tile.residual(simd, lobes, &reached, &mut Vec::new()))
    };
    tiles.par_iter().map(of_tile).collect()
}

/// E and its derivatives.
pub fn derivatives(tiles: &[Tile], lobes: &[FitLobe]) -> Derivatives {
    let reaches = reaches(lobes);
    let group = tiles.len().div_ceil(GROUPS).max(1);
    let parts: Vec<(f64, Vec<Moments>)> = tiles
        .par_chunks(group)
        .map(|tiles| dispatch!(simd => derivatives_of_group(simd, tiles, lobes, &reaches)))
        .collect();
    let mut error = 0.0;
    let mut moments = vec![[[0.0; 4]; 3]; lobes.len()];
    for (part, more) in parts {
        error += part;
        let sums = moments.as_flattened_mut().as_flattened_mut().iter_mut();
        sums.zip(more.as_flattened().as_flattened()).for_each(|(sum, value)| *sum += value);
    }
    Derivatives { error, correlations: lobes.iter().zip(&moments).map(|(l, m)| correlations(l, m)).collect() }
}

#[inline(always)]
fn derivatives_of_group<S: Simd>(
    simd: S,
    tiles: &[Tile],
    lobes: &[FitLobe],
    reaches: &[LobeCap],
) -> (f64, Vec<Moments>) {
    let mut error = 0.0;
    let mut moments = vec![[[0.0; 4]; 3]; lobes.len()];
    let (mut reached, mut values) = (Vec::new(), Vec::new());
    for tile in tiles {
        reached.clear();
        reached.extend((0..lobes.len()).filter(|&k| reaches[k].meets(tile)));
        let residual = tile.residual(simd, lobes, &reached, &mut values);
        error += squared(&residual);
        for (&k, values) in reached.iter().zip(values.chunks_exact(TILE)) {
            let more = tile.moments(simd, &lobes[k], values, &residual);
            let sums = moments[k].as_flattened_mut().iter_mut();
            sums.zip(more.as_flattened()).for_each(|(sum, value)| *sum += value);
        }
    }
    (error, moments)
}

/// Products with G, λ(ω·t)G and λ(ω·ξ − 1)G from the moments about the axis: t is perpendicular to
/// ξ, and ω·ξ − 1 = (ω − ξ)·ξ.
fn correlations(lobe: &FitLobe, moments: &Moments) -> [[f64; 3]; 4] {
    let along = |direction: DVec3| {
        moments.map(|m| lobe.sharpness * (0..3).map(|k| direction[k] * m[k + 1]).sum::<f64>())
    };
    [moments.map(|m| m[0]), along(lobe.tangents[0]), along(lobe.tangents[1]), along(lobe.axis)]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn map() -> EnvironmentMap {
        EnvironmentMap::from_directions(37, 18, |d| {
            Vec3::new(1.0 + d.x, 1.2 + (4.0 * d.y).sin(), 3.0 * (9.0 * (d.z - 1.0)).exp())
        })
    }

    fn lobes() -> Vec<FitLobe> {
        vec![
            FitLobe::new(DVec3::new(0.3, -0.5, 0.7), 2.0, [0.5, 0.9, 1.4]),
            FitLobe::new(DVec3::new(-0.9, 0.2, 0.1), 15.0, [1.5, 0.0, 0.3]),
            FitLobe::new(DVec3::new(0.1, 0.1, 0.9), 60.0, [0.2, 2.0, 0.7]),
        ]
    }

    /// E in `f64`, straight from its definition.
    fn error(map: &EnvironmentMap, lobes: &[FitLobe]) -> f64 {
        let texel = |(k, y): (usize, &Vec3)| {
            let (i, j) = (k as u32 % map.width, k as u32 / map.width);
            let omega = map.texel_direction(i, j).as_dvec3();
            let of = |l: &FitLobe| {
                let value = (l.sharpness * (omega.dot(l.axis) - 1.0)).exp();
                DVec3::from_array(l.amplitude) * value
            };
            let model: DVec3 = lobes.iter().map(of).sum();
            (model - y.as_dvec3()).length_squared() * map.texel_solid_angle(j) / (4.0 * std::f64::consts::PI)
        };
        map.radiance.iter().enumerate().map(texel).sum()
    }

    fn nudged(lobes: &[FitLobe], k: usize, p: usize, h: f64) -> Vec<FitLobe> {
        let mut moved = lobes.to_vec();
        if p < 3 {
            let mut step = [0.0; 3];
            step[p] = h;
            moved[k] = moved[k].moved(step);
        } else {
            moved[k].amplitude[p - 3] += h;
        }
        moved
    }

    #[test]
    fn error_and_gradient_agree_with_the_definition() {
        let (map, lobes) = (map(), lobes());
        let tiles = tiles_of(&map);
        let derivatives = derivatives(&tiles, &lobes);
        assert!((derivatives.error / error(&map, &lobes) - 1.0).abs() < 1e-5);
        let sum: f64 = residuals(&tiles, &lobes).iter().map(squared).sum();
        assert!((sum / derivatives.error - 1.0).abs() < 1e-5);
        for (k, of_lobe) in derivatives.gradient(&lobes).iter().enumerate() {
            for (p, &value) in of_lobe.iter().enumerate() {
                let h = 1e-4;
                let at = |h| error(&map, &nudged(&lobes, k, p, h));
                let numeric = (at(h) - at(-h)) / (2.0 * h);
                assert!((value - numeric).abs() < 1e-5 + 1e-4 * numeric.abs(), "{k} {p}: {value} {numeric}");
            }
        }
    }

    #[test]
    fn a_lobe_is_skipped_only_where_it_is_dark() {
        let tiles = tiles_of(&EnvironmentMap::from_directions(64, 32, |_| Vec3::ONE));
        let rows = rows_of(&tiles, 64);
        for sharpness in [0.05, 5.0, 8.0, 9.0, 40.0, 900.0] {
            for axis in crate::fibonacci::fibonacci_axes(40) {
                let reach = LobeCap::new(axis.as_dvec3(), sharpness);
                let near: Vec<usize> = rows.iter().flat_map(|row| reach.tiles_in(row)).collect();
                let is_skipped = |at: &usize| !near.contains(at) || !reach.meets(&tiles[*at]);
                for tile in (0..tiles.len()).filter(is_skipped).map(|at| &tiles[at]) {
                    let [x, y, z] = &tile.directions;
                    let bright = |k: usize| {
                        let omega = Vec3::new(x[k], y[k], z[k]).as_dvec3();
                        sharpness * (omega.dot(axis.as_dvec3()) - 1.0) > CUTOFF
                    };
                    assert!(!(0..TILE).any(|k| tile.root_weights[k] > 0.0 && bright(k)));
                }
            }
        }
    }
}
