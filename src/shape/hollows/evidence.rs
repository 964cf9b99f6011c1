//! What photographs say about space inside the hull: whether they look through it, and how much better that explains them.
//!
//! A field of densities also explains what a surface mirrors by something dense behind it, as if one looked through the surface. It does so
//! badly: a reflection moves otherwise than anything that stands still behind a window. So two models compete for each pixel. One is
//! opaque at the surface, with a color that all photographs share; the other is the field. Their squared errors are summed over all rays
//! that pass a vertex before they are stopped, and over all vertices of a connected space. What lies in a deep hollow leaves the field 1 to 3 %
//! of the error of its lid; reflections in paint or metal leave 10 to 25 %. Between them is what a hull has too much of beside a glossy
//! surface: there the field is dense too deep, and would eat into the object.

use super::colors::ColorPicture;
use super::march::{depth, march};
use super::neighbors::neighbors;
use super::radiance_field::{FieldRay, RadianceField};
use crate::error::Result;
use crate::error::stop::is_stopping;
use crate::ranks::Ranks;
use crate::ranks::packed::divided;
use crate::sdf::SdfGrid;
use glam::{UVec3, Vec3, Vec4, Vec4Swizzles};
use rayon::prelude::*;
use std::ops::AddAssign;

/// Before the depth at which half of the light is stopped, and behind it, space counts as that where a ray is stopped, in cells.
const MARGIN: f32 = 0.75;
/// Length of a step along a ray, in cells.
const STEP: f32 = 0.5;
/// Rays that must pass the 27 vertices around one.
const LEAST_RAYS: f32 = 20.0;
/// Share of the surface's error that the field may leave around each vertex of a connected space, and in the space as a whole, for that
/// to be empty.
const VERTEX_SHARE: f32 = 0.2;
const SPACE_SHARE: f32 = 0.032;
/// Least distance of the emptiness from zero.
const LEAST: f32 = 0.1;
/// Squared error of three channels that is noise.
const NOISE: f32 = 3e-4;
/// Passes over all rays that find the colors of the surface, and how far each goes.
const PASSES: usize = 8;
const RELAXATION: f32 = 1.5;
/// Parts of the rays that are summed apart.
const PARTS: usize = 8;
/// Rays that are marched one after another.
const CHUNK: usize = 4096;

/// How empty each vertex of a grid is, in (−1, 1), positive where photographs look through it. The field has been fitted to the rays.
///
/// # Errors
/// If another process is gone.
pub fn emptiness(
    grid: &SdfGrid,
    field: &RadianceField,
    pictures: &[ColorPicture],
    rays: &[FieldRay],
    ranks: Option<&Ranks>,
) -> Result<Vec<f32>> {
    let by_surface = surface_errors(field, pictures, rays);
    let by_field = field_errors(field, pictures, rays, ranks)?;
    let evidence = evidence(field, pictures, rays, &by_surface, &by_field);
    let is_accepted = accepted(grid, field, &evidence);
    let smooth = around(grid, field, &evidence);
    let of_vertex = |vertex: usize| {
        let row = field.rows[vertex] as usize;
        let balance =
            (smooth[row].passed - smooth[row].stopped) / (smooth[row].passed + smooth[row].stopped).max(1.0);
        if is_accepted[row] {
            balance.max(LEAST)
        } else if neighbors(vertex, grid.side).any(|other| is_accepted[field.rows[other] as usize]) {
            balance.min(-LEAST)
        } else {
            -1.0
        }
    };
    Ok((0..grid.values.len()).into_par_iter().map(of_vertex).collect())
}

/// Squared error of each ray if the surface is opaque: its colors are those of a trilinear lattice that explain all rays best.
fn surface_errors(field: &RadianceField, pictures: &[ColorPicture], rays: &[FieldRay]) -> Vec<f32> {
    let mut colors = vec![Vec3::ZERO; field.values.len()];
    let missing = |colors: &[Vec3], ray: &FieldRay| {
        let (line, shown) = ray.of(pictures);
        let (rows, weights) = field.corners(line.origin + ray.surface * line.direction);
        let color: Vec3 = rows.iter().zip(weights).map(|(row, weight)| colors[*row as usize] * weight).sum();
        (rows, weights, shown - color)
    };
    for _ in 0..PASSES {
        let sums = summed(rays, colors.len(), |sums: &mut [Vec4], _, ray| {
            let (rows, weights, missing) = missing(&colors, ray);
            for (row, weight) in rows.iter().zip(weights) {
                sums[*row as usize] += weight * missing.extend(1.0);
            }
        });
        for (color, sum) in colors.iter_mut().zip(sums).filter(|(_, sum)| sum.w > 0.0) {
            *color += RELAXATION * sum.xyz() / sum.w;
        }
    }
    rays.par_iter().map(|ray| missing(&colors, ray).2.length_squared()).collect()
}

/// What rays have summed up at a vertex.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Evidence {
    /// Rays that pass, and rays that are stopped.
    passed: f32,
    stopped: f32,
    /// Squared errors of those that pass, if the surface is opaque and with the field.
    by_surface: f32,
    by_field: f32,
}

impl AddAssign for Evidence {
    fn add_assign(&mut self, other: Self) {
        self.passed += other.passed;
        self.stopped += other.stopped;
        self.by_surface += other.by_surface;
        self.by_field += other.by_field;
    }
}

/// Squared error of each ray with the field, and the depth at which it is stopped, infinite if it is not; `ranks` divide the rays.
fn field_errors(
    field: &RadianceField,
    pictures: &[ColorPicture],
    rays: &[FieldRay],
    ranks: Option<&Ranks>,
) -> Result<Vec<[f32; 2]>> {
    let of_chunk = |chunk: usize| {
        let mut samples = Vec::new();
        let of_ray = |ray: &FieldRay| {
            let (line, shown) = ray.of(pictures);
            let (color, _) = march(field, &line, ray.surface, 0.0, &mut samples);
            [(color - shown).length_squared() + NOISE, depth(&samples).unwrap_or(f32::INFINITY)]
        };
        let end = rays.len().min((chunk + 1) * CHUNK);
        rays[chunk * CHUNK..end].iter().map(of_ray).collect()
    };
    Ok(divided(ranks, rays.len().div_ceil(CHUNK), of_chunk)?.into_iter().flatten().collect())
}

/// The evidence at the vertex of each row; `by_surface` are the errors of the rays if the surface is opaque, `by_field` those with the field, and depths.
fn evidence(
    field: &RadianceField,
    pictures: &[ColorPicture],
    rays: &[FieldRay],
    by_surface: &[f32],
    by_field: &[[f32; 2]],
) -> Vec<Evidence> {
    let margin = MARGIN * field.spacing;
    summed(rays, field.values.len(), |sums: &mut [Evidence], at, ray| {
        let (line, _) = ray.of(pictures);
        let [by_field, depth] = by_field[at];
        if depth.is_infinite() {
            return;
        }
        let passing = Evidence { passed: 1.0, stopped: 0.0, by_surface: by_surface[at], by_field };
        let stopped = Evidence { stopped: 1.0, ..Evidence::default() };
        let mut distance = ray.surface - field.spacing;
        while distance < depth + margin {
            let row = field.nearest(line.origin + distance * line.direction);
            sums[row] += if distance < depth - margin { passing } else { stopped };
            distance += STEP * field.spacing;
        }
    })
}

/// Sums over rays for each row, in parts whose order is always the same. `add` gets a part's sums, the index of a ray and the ray.
fn summed<T: Copy + Default + AddAssign + Send + Sync>(
    rays: &[FieldRay],
    rows: usize,
    add: impl Fn(&mut [T], usize, &FieldRay) + Sync,
) -> Vec<T> {
    let length = rays.len().div_ceil(PARTS).max(1);
    let part = |(part, rays): (usize, &[FieldRay])| {
        let mut sums = vec![T::default(); rows];
        for (at, ray) in rays.iter().enumerate().take_while(|_| !is_stopping()) {
            add(&mut sums, part * length + at, ray);
        }
        sums
    };
    let parts: Vec<Vec<T>> = rays.par_chunks(length).enumerate().map(part).collect();
    let total = |row: usize| {
        let mut total = T::default();
        parts.iter().for_each(|part| total += part[row]);
        total
    };
    (0..rows).into_par_iter().map(total).collect()
}

/// The evidence at the 27 vertices around that of each row.
fn around(grid: &SdfGrid, field: &RadianceField, evidence: &[Evidence]) -> Vec<Evidence> {
    let of_row = |row: usize| {
        let vertex = grid.vertex(field.vertices[row] as usize);
        let mut sum = Evidence::default();
        for offset in 0..27 {
            let at = vertex + UVec3::new(offset % 3, offset / 3 % 3, offset / 9);
            if at.min_element() > 0 && at.max_element() <= grid.side {
                match field.rows[grid.index(at - UVec3::ONE)] {
                    0 => {}
                    other => sum += evidence[other as usize],
                }
            }
        }
        sum
    };
    (0..evidence.len()).into_par_iter().map(of_row).collect()
}

/// Which rows are in connected spaces that the field explains far better, as a whole, than an opaque surface does.
fn accepted(grid: &SdfGrid, field: &RadianceField, evidence: &[Evidence]) -> Vec<bool> {
    let smooth = around(grid, field, evidence);
    let is_candidate = |row: usize| {
        let sums = &smooth[row];
        let is_inside = row > 0 && grid.values[field.vertices[row] as usize] < 0.0;
        is_inside
            && sums.passed > LEAST_RAYS.max(sums.stopped)
            && sums.by_field < VERTEX_SHARE * sums.by_surface
    };
    let mut is_open: Vec<bool> = (0..evidence.len()).map(is_candidate).collect();
    let mut is_accepted = vec![false; evidence.len()];
    for start in 0..evidence.len() {
        if !std::mem::replace(&mut is_open[start], false) {
            continue;
        }
        let (mut space, mut next) = (vec![start], 0);
        let mut sum = Evidence::default();
        while next < space.len() {
            let row = space[next];
            next += 1;
            sum += evidence[row];
            for other in neighbors(field.vertices[row] as usize, grid.side) {
                let other = field.rows[other] as usize;
                if std::mem::replace(&mut is_open[other], false) {
                    space.push(other);
                }
            }
        }
        if sum.by_field < SPACE_SHARE * sum.by_surface {
            space.into_iter().for_each(|row| is_accepted[row] = true);
        }
    }
    is_accepted
}
