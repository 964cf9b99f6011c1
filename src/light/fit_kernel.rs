//! Kernels of the map fit: the squared error of lobes against a map, its gradient, and its Gauss–Newton matrix.
//!
//! The error is E = Σ_i w_i Σ_c (Σ_k μ_kc G_k(ω_i) − y_ic)², with w the texels' shares of the sphere. The map is cut into
//! tiles of [`TILE`] neighbouring texels; a lobe is skipped where it is below e⁻²⁰. Tiles are worked on in parallel and
//! their sums added in order, so results do not depend on the number of threads. Generic over the float: `f32` runs,
//! `f64` is checked against finite differences.

use glam::Vec3;
use rayon::prelude::*;

use super::EnvironmentMap;
use super::exp::exp_nonpositive;
use crate::math::real::{Real, dot, sub};

/// Texels in a tile.
pub const TILE: usize = 128;
/// Groups of tiles whose matrices are summed apart: fixes the order of summation, bounds the memory.
const GROUPS: usize = 4;
/// Below e to this power a lobe is taken as zero.
const CUTOFF: f32 = -20.0;

/// A float the kernels can run in.
pub trait FitFloat: Real + Send + Sync + Default {
    /// From `f64`.
    fn of(value: f64) -> Self;
    /// To `f64`.
    fn wide(self) -> f64;
    /// e^`self`, for `self` ≤ 0.
    fn exp_below(self) -> Self;
}

impl FitFloat for f32 {
    fn of(value: f64) -> Self {
        value as f32
    }
    fn wide(self) -> f64 {
        f64::from(self)
    }
    #[inline(always)]
    fn exp_below(self) -> Self {
        exp_nonpositive(self)
    }
}

impl FitFloat for f64 {
    fn of(value: f64) -> Self {
        value
    }
    fn wide(self) -> f64 {
        self
    }
    fn exp_below(self) -> Self {
        self.exp()
    }
}

/// A lobe as the fit moves it: tangents turn the axis, the sharpness changes by a factor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FitLobe {
    /// Unit axis ξ.
    pub axis: [f64; 3],
    /// Two unit vectors that are perpendicular to the axis and to each other.
    pub tangents: [[f64; 3]; 2],
    /// λ.
    pub sharpness: f64,
    /// μ, RGB.
    pub amplitude: [f64; 3],
}

impl FitLobe {
    /// A lobe; `axis` need not have unit length, but not be zero.
    pub fn new(axis: glam::DVec3, sharpness: f64, amplitude: [f64; 3]) -> Self {
        let axis = axis.normalize_or(glam::DVec3::Y);
        let (a, b) = axis.any_orthonormal_pair();
        Self { axis: axis.to_array(), tangents: [a.to_array(), b.to_array()], sharpness, amplitude }
    }

    /// The lobe after a step: axis turned towards the tangents by `step[0..2]` radians, log sharpness up by `step[2]`.
    pub fn moved(&self, step: [f64; 3]) -> Self {
        let [axis, a, b] = [self.axis, self.tangents[0], self.tangents[1]].map(glam::DVec3::from_array);
        Self::new(axis + a * step[0] + b * step[1], self.sharpness * step[2].exp(), self.amplitude)
    }
}

/// Some neighbouring texels of a map; spare places have weight 0.
#[derive(Clone, Debug)]
pub struct Tile<F> {
    directions: [[F; TILE]; 3],
    /// √w of each texel; the weights of all tiles sum to 1.
    root_weights: [F; TILE],
    /// √w y, per channel.
    targets: [[F; TILE]; 3],
    centre: Vec3,
    /// Largest angle of a texel from the centre, radians.
    radius: f32,
}

/// Values of a lobe in a tile: √w times G and its derivatives by the two tangents and by log λ.
type Basis<F> = [[F; 4]; TILE];

/// Lower triangle of the matrix of inner products of all lobes' bases, a 4 × 4 block for each pair.
#[derive(Clone, Debug)]
pub struct Gram {
    blocks: Vec<[[f64; 4]; 4]>,
}

/// E, its derivatives, and the Gram matrix at one set of lobes.
#[derive(Clone, Debug)]
pub struct Normal {
    /// E.
    pub error: f64,
    /// Σ_i √w B_a r_c for each lobe, basis a and channel c, with r the weighted residual.
    pub correlations: Vec<[[f64; 3]; 4]>,
    /// Inner products of bases.
    pub gram: Gram,
}

impl Gram {
    fn zero(lobes: usize) -> Self {
        Self { blocks: vec![[[0.0; 4]; 4]; lobes * (lobes + 1) / 2] }
    }

    /// Inner product of basis `a` of lobe `k` with basis `b` of lobe `l`.
    pub fn at(&self, k: usize, a: usize, l: usize, b: usize) -> f64 {
        if k >= l { self.blocks[k * (k + 1) / 2 + l][a][b] } else { self.blocks[l * (l + 1) / 2 + k][b][a] }
    }
}

/// The derivative of E by each lobe's two tangents, log sharpness and three amplitudes.
pub fn gradient(lobes: &[FitLobe], correlations: &[[[f64; 3]; 4]]) -> Vec<[f64; 6]> {
    let of_lobe = |(lobe, c): (&FitLobe, &[[f64; 3]; 4])| {
        let shape = [1, 2, 3].map(|a| 2.0 * (0..3).map(|ch| lobe.amplitude[ch] * c[a][ch]).sum::<f64>());
        [shape[0], shape[1], shape[2], 2.0 * c[0][0], 2.0 * c[0][1], 2.0 * c[0][2]]
    };
    lobes.iter().zip(correlations).map(of_lobe).collect()
}

/// Cuts a map into tiles of 16 × 8 texels.
pub fn tiles_of<F: FitFloat>(map: &EnvironmentMap) -> Vec<Tile<F>> {
    let corners = (0..map.height).step_by(8).flat_map(|j| (0..map.width).step_by(16).map(move |i| (i, j)));
    corners.map(|(left, top)| tile_at(map, left, top)).collect()
}

fn tile_at<F: FitFloat>(map: &EnvironmentMap, left: u32, top: u32) -> Tile<F> {
    let mut tile = Tile {
        directions: [[F::default(); TILE]; 3],
        root_weights: [F::default(); TILE],
        targets: [[F::default(); TILE]; 3],
        centre: Vec3::Y,
        radius: std::f32::consts::PI,
    };
    let inside = |k: u32| (left + k % 16, top + k / 16);
    let texels: Vec<(u32, u32)> =
        (0..TILE as u32).map(inside).filter(|&(i, j)| i < map.width && j < map.height).collect();
    for (k, &(i, j)) in texels.iter().enumerate() {
        let (u, v) = (f64::from(i) + 0.5, f64::from(j) + 0.5);
        let (sin_phi, cos_phi) = (std::f64::consts::PI * v / f64::from(map.height)).sin_cos();
        let (sin, cos) = (std::f64::consts::PI * (2.0 * u / f64::from(map.width) - 0.5)).sin_cos();
        let root = (map.texel_solid_angle(j) / (4.0 * std::f64::consts::PI)).sqrt();
        let radiance = map.radiance[(j * map.width + i) as usize].to_array();
        tile.root_weights[k] = F::of(root);
        for (c, d) in [cos * sin_phi, cos_phi, sin * sin_phi].into_iter().enumerate() {
            tile.directions[c][k] = F::of(d);
            tile.targets[c][k] = F::of(root * f64::from(radiance[c]));
        }
    }
    let directions: Vec<Vec3> = texels.iter().map(|&(i, j)| map.texel_direction(i, j)).collect();
    tile.centre = directions.iter().sum::<Vec3>().normalize_or(Vec3::Y);
    tile.radius = directions.iter().map(|d| d.angle_between(tile.centre)).fold(0.0, f32::max);
    tile
}

impl<F: FitFloat> Tile<F> {
    /// Whether a lobe is anywhere above the cutoff here.
    pub fn is_reached(&self, axis: Vec3, sharpness: f32) -> bool {
        let nearest = (self.centre.dot(axis).clamp(-1.0, 1.0).acos() - self.radius - 1e-3).max(0.0);
        sharpness * (nearest.cos() - 1.0) > CUTOFF
    }

    fn reached_by(&self, lobes: &[FitLobe]) -> Vec<usize> {
        let reached = |lobe: &FitLobe| {
            self.is_reached(glam::DVec3::from_array(lobe.axis).as_vec3(), lobe.sharpness as f32)
        };
        (0..lobes.len()).filter(|&k| reached(&lobes[k])).collect()
    }

    /// √w G at every texel.
    pub fn values(&self, axis: [f64; 3], sharpness: f64) -> [F; TILE] {
        let (axis, half) = (axis.map(F::of), F::of(-0.5 * sharpness));
        let [x, y, z] = &self.directions;
        std::array::from_fn(|i| {
            let d = sub([x[i], y[i], z[i]], axis);
            self.root_weights[i] * (half * dot(d, d)).exp_below()
        })
    }

    /// √w G, ∂/∂tangents = λ(ω·t)G and ∂/∂log λ = λ(ω·ξ − 1)G.
    fn basis(&self, lobe: &FitLobe) -> Basis<F> {
        let (axis, sharpness) = (lobe.axis.map(F::of), F::of(lobe.sharpness));
        let tangents = lobe.tangents.map(|t| t.map(F::of));
        let half = F::of(-0.5 * lobe.sharpness);
        let [x, y, z] = &self.directions;
        std::array::from_fn(|i| {
            let omega = [x[i], y[i], z[i]];
            let d = sub(omega, axis);
            let exponent = half * dot(d, d);
            let value = self.root_weights[i] * exponent.exp_below();
            let slope = sharpness * value;
            [value, slope * dot(omega, tangents[0]), slope * dot(omega, tangents[1]), exponent * value]
        })
    }

    /// √w (model − y) of the lobes that reach this tile.
    fn residual(&self, lobes: &[FitLobe], reached: &[usize]) -> [[F; TILE]; 3] {
        let mut residual = self.targets.map(|t| t.map(|v| -v));
        for &k in reached {
            let values = self.values(lobes[k].axis, lobes[k].sharpness);
            for (c, channel) in residual.iter_mut().enumerate() {
                let amplitude = F::of(lobes[k].amplitude[c]);
                for (r, v) in channel.iter_mut().zip(values) {
                    *r += amplitude * v;
                }
            }
        }
        residual
    }
}

fn squared<F: FitFloat>(residual: &[[F; TILE]; 3]) -> f64 {
    residual.as_flattened().iter().map(|r| r.wide() * r.wide()).sum()
}

/// E.
pub fn error<F: FitFloat>(tiles: &[Tile<F>], lobes: &[FitLobe]) -> f64 {
    let of_tile = |tile: &Tile<F>| squared(&tile.residual(lobes, &tile.reached_by(lobes)));
    let parts: Vec<f64> = tiles.par_iter().map(of_tile).collect();
    parts.iter().sum()
}

/// The weighted residual √w (model − y) of every tile, per channel.
pub fn residuals<F: FitFloat>(tiles: &[Tile<F>], lobes: &[FitLobe]) -> Vec<[[F; TILE]; 3]> {
    tiles.par_iter().map(|tile| tile.residual(lobes, &tile.reached_by(lobes))).collect()
}

/// E, its derivatives and the Gram matrix.
pub fn normal<F: FitFloat>(tiles: &[Tile<F>], lobes: &[FitLobe]) -> Normal {
    let group = tiles.len().div_ceil(GROUPS).max(1);
    let parts: Vec<Normal> = tiles.par_chunks(group).map(|tiles| normal_of_group(tiles, lobes)).collect();
    let zero = || Normal {
        error: 0.0,
        correlations: vec![[[0.0; 3]; 4]; lobes.len()],
        gram: Gram::zero(lobes.len()),
    };
    parts.into_iter().reduce(|sum, part| sum.plus(&part)).unwrap_or_else(zero)
}

impl Normal {
    fn plus(mut self, other: &Self) -> Self {
        self.error += other.error;
        let pairs = self.correlations.as_flattened_mut().as_flattened_mut().iter_mut();
        pairs.zip(other.correlations.as_flattened().as_flattened()).for_each(|(a, b)| *a += b);
        let pairs = self.gram.blocks.as_flattened_mut().as_flattened_mut().iter_mut();
        pairs.zip(other.gram.blocks.as_flattened().as_flattened()).for_each(|(a, b)| *a += b);
        self
    }
}

fn normal_of_group<F: FitFloat>(tiles: &[Tile<F>], lobes: &[FitLobe]) -> Normal {
    let mut sum =
        Normal { error: 0.0, correlations: vec![[[0.0; 3]; 4]; lobes.len()], gram: Gram::zero(lobes.len()) };
    let mut bases: Vec<Basis<F>> = Vec::new();
    for tile in tiles {
        let reached = tile.reached_by(lobes);
        let residual = tile.residual(lobes, &reached);
        sum.error += squared(&residual);
        bases.clear();
        bases.extend(reached.iter().map(|&k| tile.basis(&lobes[k])));
        for (row, &k) in reached.iter().enumerate() {
            correlate(&bases[row], &residual, &mut sum.correlations[k]);
            for (column, &l) in reached.iter().enumerate().take(row + 1) {
                inner_products(&bases[row], &bases[column], &mut sum.gram.blocks[k * (k + 1) / 2 + l]);
            }
        }
    }
    sum
}

/// Adds the inner products of two bases.
fn inner_products<F: FitFloat>(a: &Basis<F>, b: &Basis<F>, sum: &mut [[f64; 4]; 4]) {
    let mut block = [[F::default(); 4]; 4];
    for (a, b) in a.iter().zip(b) {
        for p in 0..4 {
            for q in 0..4 {
                block[p][q] += a[p] * b[q];
            }
        }
    }
    sum.as_flattened_mut().iter_mut().zip(block.as_flattened()).for_each(|(s, v)| *s += v.wide());
}

/// Adds the inner products of a basis with the residual.
fn correlate<F: FitFloat>(basis: &Basis<F>, residual: &[[F; TILE]; 3], sum: &mut [[f64; 3]; 4]) {
    for (c, channel) in residual.iter().enumerate() {
        let mut part = [F::default(); 4];
        for (b, &r) in basis.iter().zip(channel) {
            for a in 0..4 {
                part[a] += b[a] * r;
            }
        }
        for a in 0..4 {
            sum[a][c] += part[a].wide();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

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
    fn gradient_agrees_with_central_differences() {
        let tiles = tiles_of::<f64>(&map());
        let lobes = lobes();
        let analytic = gradient(&lobes, &normal(&tiles, &lobes).correlations);
        for (k, of_lobe) in analytic.iter().enumerate() {
            for (p, &value) in of_lobe.iter().enumerate() {
                let h = 1e-5;
                let at = |h| error(&tiles, &nudged(&lobes, k, p, h));
                let numeric = (at(h) - at(-h)) / (2.0 * h);
                assert!((value - numeric).abs() < 1e-7 + 1e-6 * numeric.abs(), "{k} {p}: {value} {numeric}");
            }
        }
    }

    #[test]
    fn gram_agrees_with_differences_of_the_residual() {
        let tiles = tiles_of::<f64>(&map());
        let lobes = lobes();
        let gram = normal(&tiles, &lobes).gram;
        let h = 1e-5;
        // Derivative of the unit-amplitude lobe by shape parameter, from residuals of that lobe alone.
        let basis = |k: usize, a: usize| -> Vec<f64> {
            let mut one = vec![lobes[k]];
            one[0].amplitude = [1.0, 0.0, 0.0];
            let channel =
                |l: &[FitLobe]| -> Vec<f64> { residuals(&tiles, l).iter().flat_map(|r| r[0]).collect() };
            let (low, high) =
                if a == 0 { (vec![], one) } else { (nudged(&one, 0, a - 1, -h), nudged(&one, 0, a - 1, h)) };
            let scale = if a == 0 { 1.0 } else { 2.0 * h };
            channel(&high).iter().zip(channel(&low)).map(|(x, y)| (x - y) / scale).collect()
        };
        for (k, a, l, b) in
            [(0, 0, 0, 0), (0, 1, 0, 3), (1, 2, 0, 0), (0, 3, 2, 1), (2, 0, 2, 0), (2, 3, 2, 2)]
        {
            let numeric: f64 = basis(k, a).iter().zip(basis(l, b)).map(|(x, y)| x * y).sum();
            let value = gram.at(k, a, l, b);
            assert!((value - numeric).abs() < 1e-8 + 1e-5 * numeric.abs(), "{value} {numeric}");
        }
    }

    #[test]
    fn single_precision_agrees_with_double() {
        let (fast, exact) =
            (normal(&tiles_of::<f32>(&map()), &lobes()), normal(&tiles_of::<f64>(&map()), &lobes()));
        assert!((fast.error / exact.error - 1.0).abs() < 1e-5);
        let scale = exact.gram.at(0, 0, 0, 0);
        assert!((fast.gram.at(0, 0, 1, 2) - exact.gram.at(0, 0, 1, 2)).abs() < 1e-5 * scale);
        assert!((error(&tiles_of::<f32>(&map()), &lobes()) - fast.error).abs() < 1e-6 * fast.error);
    }

    #[test]
    fn the_error_is_the_mean_squared_difference() {
        let map = map();
        let plain: Vec<crate::light::LightLobe> = lobes()
            .iter()
            .map(|l| crate::light::LightLobe {
                axis: DVec3::from_array(l.axis).as_vec3(),
                sharpness: l.sharpness as f32,
                amplitude: DVec3::from_array(l.amplitude).as_vec3(),
            })
            .collect();
        let rendered = crate::light::render_lobes(&plain, map.width, map.height);
        let difference = map.mean_squared_difference(&rendered).unwrap();
        assert!((error(&tiles_of::<f64>(&map), &lobes()) / 3.0 - difference).abs() < 1e-5 * difference);
    }
}
