//! Kernels of [`crate::visibility`]: light on a set of directions, and the part of it that reaches partly occluded texels and points.
//!
//! The set has D near-uniform directions, each the center of a cell of 4π/D steradians. A lobe of sharpness λ is convolved with
//! a Gaussian of the width of a cell, λ' = λ·λ_c/(λ + λ_c) with λ_c = D/2 (2π/λ_c is a cell's solid angle), with the same power, so that
//! no sharp lobe falls between two directions.

use crate::math::accurate::diffuse::cosine_integral;
use crate::math::color::luminance;
use crate::math::lanes::{Lanes, Row};
use crate::math::real::{Real, dot};
use crate::math::sg::sphere_integral;
use crate::math::shading::{LobeColumns, PointVisibility};
use crate::visibility::texel_visibility::{MAX_DIRECTIONS, TexelVisibility};
use fearless_simd::{Level, Simd, dispatch};
use glam::{Mat3, Vec3};
use rayon::prelude::*;

/// Rows that a thread processes at a time.
const CHUNK: usize = 64;
/// Upper bound of the specular factor.
const MOST_MIRRORED: f32 = 8.0;
/// Directions contribute to specular light where the BRDF lobe is above e to the power of minus this.
const MIRROR_REACH: f32 = 4.0;

/// Light on a set of directions.
#[derive(Clone, Debug, Default)]
pub(crate) struct Sky {
    /// e^{λ'(ξ·d − 1)} of each lobe (padded as its columns are) at each direction.
    weights: Vec<f32>,
    stride: usize,
    /// The convolved lobes, in columns: axis x, y, z, λ', amplitude r, g, b.
    lobes: [Vec<f32>; 7],
    /// The coordinates of the directions, in columns.
    directions: [Vec<f32>; 3],
    /// Radiance from each direction, in columns.
    radiance: [Vec<f32>; 3],
}

impl Sky {
    /// The light at `directions` of `lobes`, which are rotated into the world.
    pub fn new(directions: &[Vec3], lobes: &LobeColumns, world_from_light: Mat3) -> Self {
        let stride = lobes.stride();
        let mut sky = Self {
            weights: vec![0.0; directions.len() * stride],
            stride,
            lobes: std::array::from_fn(|c| vec![if c == 3 { 1.0 } else { 0.0 }; stride]),
            directions: std::array::from_fn(|axis| directions.iter().map(|d| d[axis]).collect()),
            radiance: Default::default(),
        };
        let cell = directions.len() as f32 / 2.0;
        for (i, lobe) in (0..lobes.len()).map(|i| lobes.get(i)).enumerate() {
            let [x, y, z] = (world_from_light * Vec3::from(lobe.axis)).into();
            let sharpness = widened(lobe.sharpness, cell);
            let [r, g, b] = lobe.amplitude.map(|a| a * integral(lobe.sharpness) / integral(sharpness));
            let values = [x, y, z, sharpness, r, g, b];
            sky.lobes.iter_mut().zip(values).for_each(|(column, value)| column[i] = value);
        }
        let columns = &sky.lobes;
        let mut radiance = vec![Vec3::ZERO; directions.len()];
        let rows = sky.weights.par_chunks_mut(stride.max(1)).zip(&mut radiance).zip(directions);
        rows.for_each(|((row, radiance), direction)| {
            for (i, weight) in row[..lobes.len()].iter_mut().enumerate() {
                let at = |c: usize| columns[c][i];
                *weight = (at(3) * (Vec3::new(at(0), at(1), at(2)).dot(*direction) - 1.0)).exp();
                *radiance += Vec3::new(at(4), at(5), at(6)) * *weight;
            }
        });
        sky.radiance = std::array::from_fn(|c| radiance.iter().map(|r| r[c]).collect());
        sky
    }

    /// Radiance from a direction.
    fn radiance(&self, direction: usize) -> Vec3 {
        Vec3::from_array([0, 1, 2].map(|c| self.radiance[c][direction]))
    }
}

/// The sharpness of a lobe after convolution with the Gaussian of a cell.
fn widened(sharpness: f32, cell: f32) -> f32 {
    sharpness * cell / (sharpness + cell)
}

fn integral(sharpness: f32) -> f32 {
    sphere_integral(f64::from(sharpness)) as f32
}

/// For each row of `visibility`: the fraction of each lobe's irradiance that reaches it, 0 to 255, in rows of the lobes' stride;
/// and the resulting irradiance.
pub(crate) fn light_rows(
    visibility: &TexelVisibility,
    sky: &Sky,
    parts: &mut Vec<u8>,
    direct: &mut Vec<Vec3>,
) {
    parts.clear();
    parts.resize(visibility.len() * sky.stride, 255);
    direct.clear();
    direct.resize(visibility.len(), Vec3::ZERO);
    if sky.stride == 0 {
        return;
    }
    let chunks = parts.par_chunks_mut(CHUNK * sky.stride).zip(direct.par_chunks_mut(CHUNK));
    chunks.enumerate().for_each(|(chunk, (parts, direct))| {
        let mut hidden = vec![0.0; sky.stride];
        for (i, (parts, direct)) in parts.chunks_exact_mut(sky.stride).zip(direct).enumerate() {
            *direct = light_one_row(visibility, sky, chunk * CHUNK + i, &mut hidden, parts);
        }
    });
}

/// [`light_rows`] for one row, with working memory of the lobes' stride.
pub(crate) fn light_one_row(
    visibility: &TexelVisibility,
    sky: &Sky,
    row: usize,
    hidden: &mut [f32],
    parts: &mut [u8],
) -> Vec3 {
    dispatch!(Level::new(), simd => light_row(simd, visibility, sky, row, hidden, parts))
}

#[inline(always)]
fn light_row<S: Simd>(
    simd: S,
    visibility: &TexelVisibility,
    sky: &Sky,
    row: usize,
    hidden: &mut [f32],
    parts: &mut [u8],
) -> Vec3 {
    let normal = visibility.normals[row];
    hidden.fill(0.0);
    for (d, _) in visibility.hidden(row) {
        let cosine = visibility.directions[d].dot(normal);
        add_scaled(hidden, &sky.weights[d * sky.stride..][..sky.stride], cosine);
    }
    let cell = Lanes::splat(simd, cell_angle(visibility));
    let normal = normal.to_array().map(|c| Lanes::splat(simd, c));
    let mut irradiance = [Lanes::splat(simd, 0.0); 3];
    for at in (0..sky.stride).step_by(Lanes::<S>::LEN) {
        let column = |c: usize| Lanes::load(simd, &sky.lobes[c][at..at + Lanes::<S>::LEN]);
        let all = cosine_integral(column(3), dot([column(0), column(1), column(2)], normal)).value;
        let behind = Lanes::load(simd, &hidden[at..at + Lanes::<S>::LEN]) * cell;
        let part = (all.one() - behind / all.max(all.lit(1e-9))).relu();
        for (c, sum) in irradiance.iter_mut().enumerate() {
            *sum += column(4 + c) * all * part;
        }
        let mut bytes = Row::ZERO;
        part.store(&mut bytes.0[..Lanes::<S>::LEN]);
        for (out, part) in parts[at..at + Lanes::<S>::LEN].iter_mut().zip(&bytes.0) {
            *out = (part * 255.0 + 0.5) as u8;
        }
    }
    Vec3::from_array(irradiance.map(Lanes::sum))
}

#[inline(always)]
fn add_scaled(sums: &mut [f32], row: &[f32], factor: f32) {
    for (sum, value) in sums.iter_mut().zip(row) {
        *sum += factor * value;
    }
}

/// Interreflected light of rows.
#[derive(Clone, Debug, Default)]
pub(crate) struct Bounce {
    /// Irradiance of each row from other parts of the surface.
    pub indirect: Vec<Vec3>,
    /// Outgoing radiance of each row, as if all reflection were diffuse.
    pub leaving: Vec<Vec3>,
}

impl Bounce {
    /// Propagates the `direct` irradiance of each row for `bounces` reflections, with a `reflectance` per texel.
    pub fn new(
        visibility: &TexelVisibility,
        direct: &[Vec3],
        reflectance: &(dyn Fn(u32) -> Vec3 + Sync),
        bounces: u32,
    ) -> Self {
        let rows = 0..visibility.len();
        let reflectance = visibility.mean(reflectance);
        let sent = |row: usize, irradiance: Vec3| reflectance[row] * irradiance * std::f32::consts::FRAC_1_PI;
        let mut leaving: Vec<Vec3> = direct.iter().enumerate().map(|(row, e)| sent(row, *e)).collect();
        let mut indirect = vec![Vec3::ZERO; visibility.len()];
        for _ in 0..bounces {
            indirect = rows.clone().into_par_iter().map(|row| gathered(visibility, &leaving, row)).collect();
            let both = direct.iter().zip(&indirect).enumerate();
            leaving = both.map(|(row, (direct, indirect))| sent(row, *direct + *indirect)).collect();
        }
        Self { indirect, leaving }
    }
}

/// Solid angle of a cell.
fn cell_angle(visibility: &TexelVisibility) -> f32 {
    4.0 * std::f32::consts::PI / visibility.directions.len() as f32
}

/// Irradiance of a row from the texels that occlude directions.
fn gathered(visibility: &TexelVisibility, leaving: &[Vec3], row: usize) -> Vec3 {
    let normal = visibility.normals[row];
    let light = visibility
        .hidden(row)
        .map(|(d, hider)| sent_from(leaving, hider) * visibility.directions[d].dot(normal));
    light.sum::<Vec3>() * cell_angle(visibility)
}

/// Radiance that leaves a row; none for a back face.
fn sent_from(leaving: &[Vec3], row: u32) -> Vec3 {
    leaving.get(row as usize).copied().unwrap_or(Vec3::ZERO)
}

/// Up to four rows of texels and their weights, which sum to one.
pub type Blend = [(usize, f32); 4];

/// The visibility of a point from the rows around it. `lobe_sharpness` is that of the microfacet normals, 2/R⁴.
///
/// Specular light is scaled by Σ_d B(d)·L(d) over Σ_d B(d)·sky(d), where B is the lobe of the BRDF around the mirror direction
/// (sharpness L/(4 n·v), Wang et al. 2009) times the cosine, and L the incident radiance from d: that of the sky, or of the texel that occludes it.
pub fn point_visibility(
    visibility: &TexelVisibility,
    sky: &Sky,
    bounce: &Bounce,
    blend: &Blend,
    [normal, to_viewer]: [Vec3; 2],
    lobe_sharpness: f32,
) -> PointVisibility {
    let indirect: Vec3 = blend.iter().map(|(row, weight)| bounce.indirect[*row] * *weight).sum();
    let open = blend.iter().all(|(row, weight)| *weight == 0.0 || visibility.sees_all(*row));
    let up = normal.dot(to_viewer);
    if open || up <= 0.0 {
        return PointVisibility { indirect: indirect.into(), ..PointVisibility::OPEN };
    }
    let mirrored = 2.0 * up * normal - to_viewer;
    let cell = visibility.directions.len() as f32 / 2.0;
    let sharpness = widened(lobe_sharpness / (4.0 * up.max(0.05)), cell);
    let least = 1.0 - MIRROR_REACH / sharpness;
    let mut near = [0; MAX_DIRECTIONS / 64];
    dispatch!(Level::new(), simd => directions_near(simd, &sky.directions, mirrored, least, &mut near));
    let rows = blend.iter().filter(|(_, part)| *part > 0.0);
    if !rows.clone().any(|(row, _)| visibility.hides_any(*row, &near)) {
        return PointVisibility { indirect: indirect.into(), ..PointVisibility::OPEN };
    }
    let lobe = MirroredLobe { axis: mirrored, sharpness, least, normal };
    let mut weights = [0.0; MAX_DIRECTIONS];
    let unhidden = dispatch!(Level::new(), simd => weigh_directions(simd, sky, &lobe, &near, &mut weights));
    let arriving = rows.fold(unhidden, |arriving, (row, part)| {
        let instead = visibility
            .hidden_among(*row, &near)
            .map(|(d, hider)| (sent_from(&bounce.leaving, hider) - sky.radiance(d)) * weights[d]);
        arriving + instead.sum::<Vec3>() * *part
    });
    let floor = Vec3::splat(1e-6 * luminance(unhidden).max(1e-20));
    let specular = (arriving / unhidden.max(floor)).clamp(Vec3::ZERO, Vec3::splat(MOST_MIRRORED));
    PointVisibility { specular: specular.into(), indirect: indirect.into() }
}

/// Sets the bit of each direction whose cosine to `axis` is above `least`.
#[inline(always)]
fn directions_near<S: Simd>(simd: S, directions: &[Vec<f32>; 3], axis: Vec3, least: f32, near: &mut [u64]) {
    let axis = axis.to_array().map(|c| Lanes::splat(simd, c));
    let least = Lanes::splat(simd, least);
    for at in (0..directions[0].len()).step_by(Lanes::<S>::LEN) {
        let column = |c: usize| Lanes::load(simd, &directions[c][at..at + Lanes::<S>::LEN]);
        let bits = least.bits_below(dot([column(0), column(1), column(2)], axis));
        near[at / 64] |= bits << (at % 64);
    }
}

/// The lobe of the BRDF around the mirrored view, where its cosine to a direction is above `least`, times the cosine with `normal`.
struct MirroredLobe {
    axis: Vec3,
    sharpness: f32,
    least: f32,
    normal: Vec3,
}

/// The lobe's value at each direction, in groups of lanes of which a bit of `near` is set, and the light of the whole sky weighted by it.
#[inline(always)]
fn weigh_directions<S: Simd>(
    simd: S,
    sky: &Sky,
    lobe: &MirroredLobe,
    near: &[u64],
    weights: &mut [f32; MAX_DIRECTIONS],
) -> Vec3 {
    let [axis, normal] = [lobe.axis, lobe.normal].map(|v| v.to_array().map(|c| Lanes::splat(simd, c)));
    let [least, sharpness, zero] = [lobe.least, lobe.sharpness, 0.0].map(|c| Lanes::splat(simd, c));
    let mut light = [zero; 3];
    let group = u64::MAX >> (64 - Lanes::<S>::LEN);
    for at in (0..sky.directions[0].len()).step_by(Lanes::<S>::LEN) {
        if near[at / 64] >> (at % 64) & group == 0 {
            continue;
        }
        let load =
            |columns: &[Vec<f32>; 3], c: usize| Lanes::load(simd, &columns[c][at..at + Lanes::<S>::LEN]);
        let direction = [0, 1, 2].map(|c| load(&sky.directions, c));
        let cosine = dot(direction, axis);
        let value = (sharpness * (cosine - cosine.one()).min(zero)).decay() * dot(direction, normal).relu();
        let value = least.select_lt(cosine, value, zero);
        value.store(&mut weights[at..at + Lanes::<S>::LEN]);
        for (c, sum) in light.iter_mut().enumerate() {
            *sum += load(&sky.radiance, c) * value;
        }
    }
    Vec3::from_array(light.map(Lanes::sum))
}
