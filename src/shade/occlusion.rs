//! Kernels of [`super::visibility`]: light on a set of directions, and what of it reaches texels and points that see only part of it.
//!
//! The set has D near-uniform directions, each the middle of a cell of 4π/D steradians. A lobe of sharpness λ is read through
//! a Gaussian as wide as a cell, λ' = λ·λ_c/(λ + λ_c) with λ_c = D/2 (2π/λ_c is a cell's solid angle), at the same power, so that
//! sharp lobes fall between no two directions.

use crate::math::color::luminance;
use crate::math::sg::sphere_integral;
use crate::math::shading::{LobeColumns, PointVisibility, ShadePoint};
use crate::surface::visibility::TexelVisibility;
use fearless_simd::{Level, Simd, dispatch};
use glam::Vec3;
use rayon::prelude::*;

/// Rows a thread takes at a time.
const CHUNK: usize = 64;
/// Mirrored light may exceed what closed forms say by at most this factor.
const MOST_MIRRORED: f32 = 8.0;
/// Directions count for a mirror up to where its lobe falls below e to the power of minus this.
const MIRROR_REACH: f32 = 4.5;

/// Light on a set of directions.
#[derive(Clone, Debug, Default)]
pub struct Sky {
    /// e^{λ'(ξ·d − 1)} of each lobe (padded as its columns are) at each direction.
    weights: Vec<f32>,
    stride: usize,
    /// Radiance from each direction.
    pub radiance: Vec<Vec3>,
}

impl Sky {
    /// The light of `lobes` at `directions`.
    pub fn new(directions: &[Vec3], lobes: &LobeColumns) -> Self {
        let stride = lobes.stride();
        let mut sky = Self {
            weights: vec![0.0; directions.len() * stride],
            stride,
            radiance: vec![Vec3::ZERO; directions.len()],
        };
        let cell = directions.len() as f32 / 2.0;
        let lobes: Vec<_> = (0..lobes.len()).map(|i| lobes.get(i)).collect();
        let rows = sky.weights.par_chunks_mut(stride.max(1)).zip(&mut sky.radiance).zip(directions);
        rows.for_each(|((row, radiance), direction)| {
            for (weight, lobe) in row.iter_mut().zip(&lobes) {
                let sharpness = widened(lobe.sharpness, cell);
                *weight = (sharpness * (Vec3::from(lobe.axis).dot(*direction) - 1.0)).exp();
                let share = integral(lobe.sharpness) / integral(sharpness);
                *radiance += Vec3::from(lobe.amplitude) * (*weight * share);
            }
        });
        sky
    }
}

/// The sharpness of a lobe seen through a cell's Gaussian.
fn widened(sharpness: f32, cell: f32) -> f32 {
    sharpness * cell / (sharpness + cell)
}

fn integral(sharpness: f32) -> f32 {
    sphere_integral(f64::from(sharpness)) as f32
}

/// For each row of `visibility`, the part of each lobe's irradiance that reaches it, 0 to 255, in rows of the lobes' stride.
pub fn lobe_parts(visibility: &TexelVisibility, sky: &Sky, out: &mut Vec<u8>) {
    out.clear();
    out.resize(visibility.len() * sky.stride, 255);
    let level = Level::new();
    out.par_chunks_mut((CHUNK * sky.stride).max(1)).enumerate().for_each(|(chunk, out)| {
        let mut sums = (vec![0.0; sky.stride], vec![0.0; sky.stride]);
        for (i, out) in out.chunks_exact_mut(sky.stride).enumerate() {
            let row = chunk * CHUNK + i;
            // Most rows of most objects see everything.
            if visibility.hidden(row).next().is_some() {
                dispatch!(level, simd => row_parts(simd, visibility, sky, row, &mut sums, out));
            }
        }
    });
}

#[inline(always)]
fn row_parts<S: Simd>(
    _simd: S,
    visibility: &TexelVisibility,
    sky: &Sky,
    row: usize,
    (all, hidden): &mut (Vec<f32>, Vec<f32>),
    out: &mut [u8],
) {
    let normal = visibility.normals[row];
    all.fill(0.0);
    hidden.fill(0.0);
    let weights = |d: usize| &sky.weights[d * sky.stride..][..sky.stride];
    for (d, direction) in visibility.directions.iter().enumerate() {
        let cosine = direction.dot(normal);
        if cosine > 0.0 {
            add_scaled(all, weights(d), cosine);
        }
    }
    for (d, _) in visibility.hidden(row) {
        add_scaled(hidden, weights(d), visibility.directions[d].dot(normal));
    }
    for ((out, all), hidden) in out.iter_mut().zip(all.iter()).zip(hidden.iter()) {
        let part = if *all > 1e-12 { 1.0 - hidden / all } else { 1.0 };
        *out = (part * 255.0 + 0.5) as u8;
    }
}

#[inline(always)]
fn add_scaled(sums: &mut [f32], row: &[f32], factor: f32) {
    for (sum, value) in sums.iter_mut().zip(row) {
        *sum += factor * value;
    }
}

/// Light that rows receive and send on.
#[derive(Clone, Debug, Default)]
pub struct Bounce {
    /// Irradiance of each row by way of other parts of the surface.
    pub indirect: Vec<Vec3>,
    /// Radiance that leaves each row, as if it were all diffuse.
    pub leaving: Vec<Vec3>,
}

impl Bounce {
    /// The light of `sky` after up to `bounces` reflections, by texels that reflect `reflectance` (albedo, per texel).
    pub fn new(
        visibility: &TexelVisibility,
        sky: &Sky,
        reflectance: &(dyn Fn(u32) -> Vec3 + Sync),
        bounces: u32,
    ) -> Self {
        let rows = 0..visibility.len();
        let direct: Vec<Vec3> =
            rows.clone().into_par_iter().map(|row| direct(visibility, sky, row)).collect();
        let sent = |row: usize, irradiance: Vec3| {
            reflectance(visibility.texels[row]) * irradiance * std::f32::consts::FRAC_1_PI
        };
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

/// Irradiance of a row from the directions it sees.
fn direct(visibility: &TexelVisibility, sky: &Sky, row: usize) -> Vec3 {
    let normal = visibility.normals[row];
    let lit = visibility.directions.iter().zip(&sky.radiance);
    let all: Vec3 = lit.map(|(d, radiance)| *radiance * d.dot(normal).max(0.0)).sum();
    let behind = visibility.hidden(row).map(|(d, _)| sky.radiance[d] * visibility.directions[d].dot(normal));
    (all - behind.sum::<Vec3>()).max(Vec3::ZERO) * cell_angle(visibility)
}

/// Irradiance of a row from the texels that hide other directions from it.
fn gathered(visibility: &TexelVisibility, leaving: &[Vec3], row: usize) -> Vec3 {
    let normal = visibility.normals[row];
    let light = visibility
        .hidden(row)
        .map(|(d, texel)| sent_from(visibility, leaving, texel) * visibility.directions[d].dot(normal));
    light.sum::<Vec3>() * cell_angle(visibility)
}

fn sent_from(visibility: &TexelVisibility, leaving: &[Vec3], texel: u32) -> Vec3 {
    let row = visibility.rows[texel as usize];
    leaving.get(row as usize).copied().unwrap_or(Vec3::ZERO)
}

/// Up to four rows of texels and their weights, which sum to one.
pub type Blend = [(usize, f32); 4];

/// A point's visibility from the rows around it. `lobe_sharpness` is that of the microfacet normals, 2/R⁴.
///
/// Specular light is scaled by Σ_d B(d)·L(d) over Σ_d B(d)·sky(d), where B is the BRDF's lobe around the mirrored view
/// (sharpness L/(4 n·v), Wang et al. 2009) times the cosine, and L the radiance that comes from d: the sky's, or that of what hides it.
pub fn point_visibility(
    visibility: &TexelVisibility,
    sky: &Sky,
    bounce: &Bounce,
    blend: &Blend,
    point: &ShadePoint,
    lobe_sharpness: f32,
) -> PointVisibility {
    let indirect: Vec3 = blend.iter().map(|(row, weight)| bounce.indirect[*row] * *weight).sum();
    let open = blend.iter().all(|(row, weight)| *weight == 0.0 || visibility.hidden(*row).next().is_none());
    let (normal, to_viewer) = (Vec3::from(point.normal), Vec3::from(point.to_viewer));
    let up = normal.dot(to_viewer);
    if open || up <= 0.0 {
        return PointVisibility { indirect: indirect.into(), ..PointVisibility::OPEN };
    }
    let mirrored = 2.0 * up * normal - to_viewer;
    let cell = visibility.directions.len() as f32 / 2.0;
    let sharpness = widened(lobe_sharpness / (4.0 * up.max(0.05)), cell);
    let least = 1.0 - MIRROR_REACH / sharpness;
    let (mut arriving, mut unhidden) = (Vec3::ZERO, Vec3::ZERO);
    for (d, direction) in visibility.directions.iter().enumerate() {
        let along = direction.dot(mirrored);
        let cosine = direction.dot(normal);
        if along < least || cosine <= 0.0 {
            continue;
        }
        let weight = cosine * (sharpness * (along - 1.0)).exp();
        unhidden += sky.radiance[d] * weight;
        for (row, part) in blend.iter().filter(|(_, part)| *part > 0.0) {
            let light = match visibility.hider(*row, d) {
                Some(texel) => sent_from(visibility, &bounce.leaving, texel),
                None => sky.radiance[d],
            };
            arriving += light * (weight * part);
        }
    }
    let floor = Vec3::splat(1e-6 * luminance(unhidden).max(1e-20));
    let specular = (arriving / unhidden.max(floor)).clamp(Vec3::ZERO, Vec3::splat(MOST_MIRRORED));
    PointVisibility { specular: specular.into(), indirect: indirect.into() }
}
