//! Kernels of [`crate::visibility`]: light on a set of directions, and the part of it that reaches partly occluded texels and points.
//!
//! The set has D near-uniform directions, each the center of a cell of 4π/D steradians. A lobe of sharpness λ is convolved with
//! a Gaussian of the width of a cell, λ' = λ·λ_c/(λ + λ_c) with λ_c = D/2 (2π/λ_c is a cell's solid angle), with the same power, so that
//! no sharp lobe falls between two directions.

use crate::error::Result;
use crate::math::accurate::diffuse::cosine_integral;
use crate::math::brdf::ndf_sharpness;
use crate::math::lanes::{Lanes, Row};
use crate::math::real::{Real, dot};
use crate::math::sg::sphere_integral;
use crate::math::shading::LobeColumns;
use crate::ranks::Ranks;
use crate::visibility::texel_visibility::TexelVisibility;
use fearless_simd::{Level, Simd, dispatch};
use glam::{Mat3, Vec3};
use rayon::prelude::*;

/// Least sharpness of a lobe.
const LEAST_LOBE: f32 = 1e-6;
/// Rows that a thread processes at a time.
const CHUNK: usize = 64;
/// Upper bound of the specular factor.
pub(crate) const MOST_MIRRORED: f32 = 8.0;

/// Light on a set of directions.
#[derive(Clone, Debug, Default)]
pub(crate) struct Sky {
    /// e^{λ'(ξ·d − 1)} of each lobe (padded as its columns are) at each direction.
    weights: Vec<f32>,
    stride: usize,
    /// The convolved lobes, in columns: axis x, y, z, λ', amplitude r, g, b.
    lobes: [Vec<f32>; 7],
    /// The lobes as they are, in the same columns.
    narrow: [Vec<f32>; 7],
    /// The coordinates of the directions, in columns.
    pub directions: [Vec<f32>; 3],
    /// Radiance from each direction, in columns.
    pub radiance: [Vec<f32>; 3],
}

impl Sky {
    /// The light at `directions` of `lobes`, which are rotated into the world.
    pub fn new(directions: &[Vec3], lobes: &LobeColumns, world_from_light: Mat3) -> Self {
        let stride = lobes.stride();
        let padded: [Vec<f32>; 7] = std::array::from_fn(|c| vec![if c == 3 { 1.0 } else { 0.0 }; stride]);
        let mut sky = Self {
            weights: vec![0.0; directions.len() * stride],
            stride,
            lobes: padded.clone(),
            narrow: padded,
            directions: std::array::from_fn(|axis| directions.iter().map(|d| d[axis]).collect()),
            radiance: Default::default(),
        };
        let cell = directions.len() as f32 / 2.0;
        for (i, lobe) in (0..lobes.len()).map(|i| lobes.get(i)).enumerate() {
            let [x, y, z] = (world_from_light * Vec3::from(lobe.axis)).into();
            let sharpness = widened(lobe.sharpness, cell);
            let put = |columns: &mut [Vec<f32>; 7], sharpness: f32, [r, g, b]: [f32; 3]| {
                let values = [x, y, z, sharpness, r, g, b];
                columns.iter_mut().zip(values).for_each(|(column, value)| column[i] = value);
            };
            put(&mut sky.narrow, lobe.sharpness.max(LEAST_LOBE), lobe.amplitude);
            let factor = integral(lobe.sharpness) / integral(sharpness);
            put(&mut sky.lobes, sharpness, lobe.amplitude.map(|a| a * factor));
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

    /// Radiance of the lobes around a direction, convolved with a Gaussian of this sharpness (well above 1).
    pub fn toward(&self, direction: Vec3, sharpness: f32) -> Vec3 {
        dispatch!(Level::new(), simd => light_toward(simd, &self.narrow, direction, sharpness))
    }

    /// Radiance from one of the directions.
    pub fn radiance(&self, direction: usize) -> Vec3 {
        Vec3::from_array([0, 1, 2].map(|c| self.radiance[c][direction]))
    }
}

/// [`Sky::toward`]: λ' = λ s/(λ + s), and by their nearly equal power, a' = a λ'/λ.
#[inline(always)]
fn light_toward<S: Simd>(simd: S, lobes: &[Vec<f32>; 7], direction: Vec3, sharpness: f32) -> Vec3 {
    let direction = direction.to_array().map(|c| Lanes::splat(simd, c));
    let [width, zero] = [sharpness, 0.0].map(|value| Lanes::splat(simd, value));
    let mut light = [zero; 3];
    for at in (0..lobes[0].len()).step_by(Lanes::<S>::LEN) {
        let column = |c: usize| Lanes::load(simd, &lobes[c][at..at + Lanes::<S>::LEN]);
        let part = width / (column(3) + width);
        let cosine = dot([column(0), column(1), column(2)], direction);
        let value = (column(3) * part * (cosine - cosine.one()).min(zero)).decay() * part;
        for (c, sum) in light.iter_mut().enumerate() {
            *sum += column(4 + c) * value;
        }
    }
    Vec3::from_array(light.map(Lanes::sum))
}

/// Sharpness of the lobe of the BRDF around the mirrored view, given that of the microfacet normals (2/R⁴) and the cosine of the view
/// (Wang et al. 2009).
pub(crate) fn sharpness_of_lobe(of_normals: f32, up: f32) -> f32 {
    of_normals / (4.0 * up.max(0.05))
}

/// The sharpness of a lobe after convolution with the Gaussian of a cell.
pub(crate) fn widened(sharpness: f32, cell: f32) -> f32 {
    sharpness * cell / (sharpness + cell)
}

fn integral(sharpness: f32) -> f32 {
    sphere_integral(f64::from(sharpness)) as f32
}

/// The irradiance of each row of `visibility`; `parts` becomes the fraction of each lobe's irradiance that reaches it, 0 to 255, in rows of the lobes' stride.
/// `ranks` divide the rows.
///
/// # Errors
/// If another process is gone.
pub(crate) fn light_rows(
    visibility: &TexelVisibility,
    sky: &Sky,
    parts: &mut Vec<u8>,
    ranks: Option<&Ranks>,
) -> Result<Vec<Vec3>> {
    let (count, stride) = (visibility.len(), sky.stride);
    parts.clear();
    parts.resize(count * stride, 255);
    let mut direct = vec![Vec3::ZERO; count];
    if stride == 0 {
        return Ok(direct);
    }
    let rows = ranks.map_or(0..count, |ranks| ranks.share(count, CHUNK));
    let own = &mut parts[rows.start * stride..rows.end * stride];
    let chunks = own.par_chunks_mut(CHUNK * stride).zip(direct[rows.clone()].par_chunks_mut(CHUNK));
    chunks.enumerate().for_each(|(chunk, (parts, direct))| {
        let mut hidden = Vec::new();
        for (i, (parts, direct)) in parts.chunks_exact_mut(stride).zip(direct).enumerate() {
            let row = rows.start + chunk * CHUNK + i;
            *direct = light_one_row(visibility, sky, row, &mut hidden, parts);
        }
    });
    if let Some(ranks) = ranks {
        ranks.complete_bytes(parts, stride, CHUNK)?;
        ranks.complete(&mut direct, CHUNK)?;
    }
    Ok(direct)
}

/// A direction that is hidden from a row: where its weights begin, and the cosine with the normal times a cell's solid angle.
pub(crate) type HiddenDirection = (usize, f32);

/// [`light_rows`] for one row; `hidden` is working memory.
pub(crate) fn light_one_row(
    visibility: &TexelVisibility,
    sky: &Sky,
    row: usize,
    hidden: &mut Vec<HiddenDirection>,
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
    hidden: &mut Vec<HiddenDirection>,
    parts: &mut [u8],
) -> Vec3 {
    let normal = visibility.normals[row];
    hidden.clear();
    let cell = cell_angle(visibility);
    let cosine = |d: usize| visibility.directions[d].dot(normal);
    hidden.extend(visibility.hidden(row).map(|(d, _)| (d * sky.stride, cell * cosine(d))));
    let mut irradiance = [Lanes::splat(simd, 0.0); 3];
    let (blocks, rest) = (sky.stride / (BLOCK * Lanes::<S>::LEN), sky.stride / Lanes::<S>::LEN % BLOCK);
    for block in 0..blocks {
        let at = block * BLOCK * Lanes::<S>::LEN;
        let behind: [_; BLOCK] = light_behind(simd, sky, hidden, at);
        light_lobes(simd, sky, normal, (at, behind), parts, &mut irradiance);
    }
    for k in 0..rest {
        let at = (blocks * BLOCK + k) * Lanes::<S>::LEN;
        let behind: [_; 1] = light_behind(simd, sky, hidden, at);
        light_lobes(simd, sky, normal, (at, behind), parts, &mut irradiance);
    }
    Vec3::from_array(irradiance.map(Lanes::sum))
}

/// Vectors of lobes that are summed up at a time: their sums stay in registers.
const BLOCK: usize = 4;

/// The sums over the `hidden` directions of the weights of the lobes from `at` on.
#[inline(always)]
fn light_behind<S: Simd, const N: usize>(
    simd: S,
    sky: &Sky,
    hidden: &[HiddenDirection],
    at: usize,
) -> [Lanes<S>; N] {
    let mut sums = [Lanes::splat(simd, 0.0); N];
    for &(begin, cosine) in hidden {
        let row = &sky.weights[begin + at..][..N * Lanes::<S>::LEN];
        let cosine = Lanes::splat(simd, cosine);
        for k in 0..N {
            let weights = Lanes::load(simd, &row[k * Lanes::<S>::LEN..(k + 1) * Lanes::<S>::LEN]);
            sums[k] = weights.mul_add(cosine, sums[k]);
        }
    }
    sums
}

/// The parts of the lobes from `at` on that arrive, of which `behind` is hidden, as bytes; their light is added to `irradiance`.
#[inline(always)]
fn light_lobes<S: Simd, const N: usize>(
    simd: S,
    sky: &Sky,
    normal: Vec3,
    (at, behind): (usize, [Lanes<S>; N]),
    parts: &mut [u8],
    irradiance: &mut [Lanes<S>; 3],
) {
    let normal = normal.to_array().map(|c| Lanes::splat(simd, c));
    for (at, behind) in (at..).step_by(Lanes::<S>::LEN).zip(behind) {
        let column = |c: usize| Lanes::load(simd, &sky.lobes[c][at..at + Lanes::<S>::LEN]);
        let all = cosine_integral(column(3), dot([column(0), column(1), column(2)], normal)).value;
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
}

/// Interreflected light of rows.
#[derive(Clone, Debug, Default)]
pub(crate) struct Bounce {
    /// Irradiance of each row from other parts of the surface.
    pub indirect: Vec<Vec3>,
    /// Outgoing radiance of each row, as if all reflection were diffuse.
    pub leaving: Vec<Vec3>,
    /// What each row is to rays that say what narrow lobes meet.
    pub mirrors: Vec<Mirror>,
}

/// How a texel reflects light.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Reflectance {
    /// Diffuse albedo.
    pub diffuse: Vec3,
    /// Specular albedo.
    pub specular: Vec3,
    /// Roughness R of its specular lobe.
    pub roughness: f32,
}

/// A row that is mirrored in another.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Mirror {
    /// Outgoing diffuse radiance.
    pub diffuse: Vec3,
    /// Specular albedo.
    pub albedo: Vec3,
    /// Sharpness of its microfacet normals.
    pub sharpness: f32,
}

impl Mirror {
    /// The sum with another of this weight.
    pub fn plus(&self, other: &Self, weight: f32) -> Self {
        Self {
            diffuse: self.diffuse + other.diffuse * weight,
            albedo: self.albedo + other.albedo * weight,
            sharpness: self.sharpness + other.sharpness * weight,
        }
    }
}

impl Bounce {
    /// Propagates the `direct` irradiance of each row for `bounces` reflections, with a `reflectance` per texel.
    pub fn new(
        visibility: &TexelVisibility,
        direct: &[Vec3],
        of: &(dyn Fn(u32) -> Reflectance + Sync),
        bounces: u32,
    ) -> Self {
        let rows = 0..visibility.len();
        let values = |Reflectance { diffuse, specular, roughness }: Reflectance| {
            [(diffuse + specular).min(Vec3::ONE), diffuse.min(Vec3::ONE), specular, Vec3::splat(roughness)]
        };
        let reflectance = visibility.means(&|texel| values(of(texel)));
        let radiance = |albedo: Vec3, irradiance: Vec3| albedo * irradiance * std::f32::consts::FRAC_1_PI;
        let sent = |row: usize, irradiance: Vec3| radiance(reflectance[row][0], irradiance);
        let mut leaving: Vec<Vec3> = direct.iter().enumerate().map(|(row, e)| sent(row, *e)).collect();
        let mut indirect = vec![Vec3::ZERO; visibility.len()];
        for _ in 0..bounces {
            indirect = rows.clone().into_par_iter().map(|row| gathered(visibility, &leaving, row)).collect();
            let both = direct.iter().zip(&indirect).enumerate();
            leaving = both.map(|(row, (direct, indirect))| sent(row, *direct + *indirect)).collect();
        }
        let mirror = |row: usize| {
            let [_, diffuse, albedo, roughness] = reflectance[row];
            let diffuse = radiance(diffuse, direct[row] + indirect[row]);
            Mirror { diffuse, albedo, sharpness: ndf_sharpness(roughness.x) }
        };
        let mirrors = rows.into_par_iter().map(mirror).collect();
        Self { indirect, leaving, mirrors }
    }

    /// Radiance that leaves a row; none for a back face.
    pub fn sent_from(&self, row: u32) -> Vec3 {
        self.leaving.get(row as usize).copied().unwrap_or(Vec3::ZERO)
    }
}

/// Solid angle of a cell.
fn cell_angle(visibility: &TexelVisibility) -> f32 {
    4.0 * std::f32::consts::PI / visibility.directions.len() as f32
}

/// Irradiance of a row from the texels that occlude directions.
fn gathered(visibility: &TexelVisibility, leaving: &[Vec3], row: usize) -> Vec3 {
    let normal = visibility.normals[row];
    let light = visibility.hidden(row).map(|(d, hider)| {
        leaving.get(hider as usize).map_or(Vec3::ZERO, |sent| *sent) * visibility.directions[d].dot(normal)
    });
    light.sum::<Vec3>() * cell_angle(visibility)
}
