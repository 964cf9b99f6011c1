//! Evidence of the photographs about space inside the hull: whether they look through it, and how
//! much better that explains them.
//!
//! A field of densities also explains reflections in a surface by something dense behind it, as if
//! one looked through the surface. It does so badly: a reflection moves otherwise than anything
//! that stands still behind a window. So two models compete for each pixel. One is opaque at the
//! surface, with a color that all photographs share; the other is the field. Their squared errors
//! are summed over all rays that pass a vertex before they are stopped, and over all vertices of a
//! connected space. A deep hollow leaves the field 1 to 3 % of the error of its lid; reflections in
//! paint or metal leave 10 to 25 %. Between them is the excess of a hull beside a glossy surface:
//! there the field is dense too deep, and would eat into the object.

use super::radiance_field::{FieldRay, FieldRays, RadianceField, depth, march};
use crate::shape::{cube, flood, neighbors, size};
use glam::{Vec3, Vec4, Vec4Swizzles};
use lobelia_geometry::{error::stop::is_stopping, parallel, sdf::SdfGrid};

/// Before the depth at which half of the light is stopped, and behind it, space counts as that
/// where a ray is stopped, in cells.
const MARGIN: f32 = 0.75;
/// Length of a step along a ray, in cells.
const STEP: f32 = 0.5;
/// Rays that must pass the 27 vertices around one.
const LEAST_RAYS: f32 = 20.0;
/// Share of the surface's error that the field may leave around each vertex of a connected space,
/// and in the space as a whole, for that to be empty.
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

/// How empty each vertex of a grid is, in (−1, 1), positive where photographs look through it. The
/// field has been fitted to the rays.
pub(super) fn emptiness(grid: &SdfGrid, field: &RadianceField, rays: &FieldRays) -> Vec<f32> {
    let by_surface = surface_errors(field, rays);
    let by_field = field_errors(field, rays);
    let evidence = evidence(field, rays, &by_surface, &by_field);
    // The evidence at the 27 vertices around that of each row.
    let around = |row: usize| -> Evidence {
        let others = cube(grid, field.vertices[row] as usize).map(|(other, _)| field.rows[other] as usize);
        others.filter(|other| *other > 0).map(|other| evidence[other]).sum()
    };
    let smooth: Vec<Evidence> = parallel::map(evidence.len(), 1024, around);
    let is_accepted = accepted(grid, field, &evidence, &smooth);
    let of_vertex = |vertex: usize| {
        let row = field.rows[vertex] as usize;
        let [passed, stopped, ..] = smooth[row].to_array();
        let balance = (passed - stopped) / (passed + stopped).max(1.0);
        let is_accepted_at = |vertex: usize| is_accepted[field.rows[vertex] as usize];
        if is_accepted[row] {
            balance.max(LEAST)
        } else if neighbors(vertex, size(grid)).any(is_accepted_at) {
            balance.min(-LEAST)
        } else {
            -1.0
        }
    };
    parallel::map(grid.values.len(), 1024, of_vertex)
}

/// Squared error of each ray if the surface is opaque: its colors are those of a trilinear lattice
/// that explain all rays best.
fn surface_errors(field: &RadianceField, rays: &FieldRays) -> Vec<f32> {
    let mut colors = vec![Vec3::ZERO; field.values.len()];
    let missing = |colors: &[Vec3], ray: &FieldRay| {
        let (line, shown) = rays.of(ray);
        let (rows, weights) = field.corners(line.origin + ray.surface * line.direction);
        let color: Vec3 = rows.iter().zip(weights).map(|(row, weight)| colors[*row as usize] * weight).sum();
        (rows, weights, shown - color)
    };
    for _ in 0..PASSES {
        let sums = summed(&rays.rays, colors.len(), |sums, _, ray| {
            let (rows, weights, missing) = missing(&colors, ray);
            for (row, weight) in rows.iter().zip(weights) {
                sums[*row as usize] += weight * missing.extend(1.0);
            }
        });
        for (color, sum) in colors.iter_mut().zip(sums).filter(|(_, sum)| sum.w > 0.0) {
            *color += RELAXATION * sum.xyz() / sum.w;
        }
    }
    parallel::map_slice(&rays.rays, CHUNK, |ray| missing(&colors, ray).2.length_squared())
}

/// Sums over rays at a vertex: rays that pass, rays that are stopped, and the squared errors of
/// those that pass, if the surface is opaque and with the field.
type Evidence = Vec4;

/// Squared error of each ray with the field, and the depth at which it is stopped, infinite if it
/// is not.
fn field_errors(field: &RadianceField, rays: &FieldRays) -> Vec<[f32; 2]> {
    let chunks: Vec<&[FieldRay]> = rays.rays.chunks(CHUNK).collect();
    let of_chunk = |chunk: usize| {
        let mut samples = Vec::new();
        let of_ray = |ray: &FieldRay| {
            let (line, shown) = rays.of(ray);
            let (color, _) = march(field, &line, ray.surface, 0.0, &mut samples);
            [(color - shown).length_squared() + NOISE, depth(&samples).unwrap_or(f32::INFINITY)]
        };
        chunks[chunk].iter().map(of_ray).collect::<Vec<_>>()
    };
    parallel::flat_map(chunks.len(), 1, of_chunk)
}

/// The evidence at the vertex of each row; `by_surface` are the errors of the rays if the surface
/// is opaque, `by_field` those with the field, and depths.
fn evidence(
    field: &RadianceField,
    rays: &FieldRays,
    by_surface: &[f32],
    by_field: &[[f32; 2]],
) -> Vec<Evidence> {
    let margin = MARGIN * field.grid.spacing;
    summed(&rays.rays, field.values.len(), |sums, at, ray| {
        let (line, _) = rays.of(ray);
        let [by_field, depth] = by_field[at];
        if depth.is_infinite() {
            return;
        }
        let (passing, stopped) = (Vec4::new(1.0, 0.0, by_surface[at], by_field), Vec4::Y);
        let mut distance = ray.surface - field.grid.spacing;
        while distance < depth + margin {
            let row = field.nearest(line.origin + distance * line.direction);
            sums[row] += if distance < depth - margin { passing } else { stopped };
            distance += STEP * field.grid.spacing;
        }
    })
}

/// Sums over rays for each row, in parts whose order is always the same. `add` gets a part's sums,
/// the index of a ray and the ray.
fn summed(rays: &[FieldRay], rows: usize, add: impl Fn(&mut [Vec4], usize, &FieldRay) + Sync) -> Vec<Vec4> {
    let length = rays.len().div_ceil(PARTS).max(1);
    let part = |(part, rays): (usize, &[FieldRay])| {
        let mut sums = vec![Vec4::ZERO; rows];
        for (at, ray) in rays.iter().enumerate().take_while(|_| !is_stopping()) {
            add(&mut sums, part * length + at, ray);
        }
        sums
    };
    let parts: Vec<Vec<Vec4>> = parallel::map_items(rays.chunks(length).enumerate(), part);
    parallel::map(rows, CHUNK, |row| parts.iter().map(|part| part[row]).sum())
}

/// Which rows are in connected spaces that the field explains far better, as a whole, than an
/// opaque surface does. `smooth` is the evidence around each row.
fn accepted(grid: &SdfGrid, field: &RadianceField, evidence: &[Evidence], smooth: &[Evidence]) -> Vec<bool> {
    let is_candidate = |row: usize| {
        let [passed, stopped, by_surface, by_field] = smooth[row].to_array();
        let is_inside = row > 0 && grid.values[field.vertices[row] as usize] < 0.0;
        is_inside && passed > LEAST_RAYS.max(stopped) && by_field < VERTEX_SHARE * by_surface
    };
    let mut open: Vec<bool> = (0..evidence.len()).map(is_candidate).collect();
    let mut is_accepted = vec![false; evidence.len()];
    let next = |row: usize| {
        neighbors(field.vertices[row] as usize, size(grid)).map(move |vertex| field.rows[vertex] as usize)
    };
    for start in 0..evidence.len() {
        let (mut space, mut sum) = (Vec::new(), Evidence::ZERO);
        flood([start], &mut open, next, |row| {
            space.push(row);
            sum += evidence[row];
        });
        if sum.w < SPACE_SHARE * sum.z {
            space.into_iter().for_each(|row| is_accepted[row] = true);
        }
    }
    is_accepted
}
