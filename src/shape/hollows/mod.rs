//! Hollows that no silhouette shows: removes from the hull what photographs look through.
//!
//! The hull closes a cup with a lid. What is seen through the lid moves against it from view to view, so that photographs disagree on
//! the lid's color, and agree far behind it. Each view is compared with those around it ([`colors`]) at all depths from the surface to
//! the far side. Where they agree much better at one of these than at the surface, the space in front of it is empty. All views vote, and
//! what enough of them see through is removed; the next round knows better what hides what.
//! A deep hollow has places that no two photographs around share, or whose colors change slowly. So all photographs together are asked
//! first: a field of densities and colors ([`radiance_field`]) is fitted to them by volume rendering, and a space is empty where that
//! explains them far better than the surface does ([`evidence`]).
//! The hull is coarse: what its cells do not resolve is looked for once more on the finer grid of the second level.
//!
//! Only what is open to the outside is removed: a reflection that seems to lie far behind a glossy surface leaves no bubble inside the object.
//! What reflections have opened all the same is filled again (`reflections`).
//! A margin before the depth that was found stays: the walls of a hollow may be thin, and a fit moves a surface that is nearly in place.
//!
//! | file | holds |
//! | --- | --- |
//! | [`colors`] | photographs as small pictures in color, and at which depth they agree with those around them |
//! | `reflections` | what reflections have opened is filled again |
//! | [`radiance_field`], [`field_fit`] | densities and colors, and their fit |
//! | `neighbors` | the neighbors of a vertex |
//! | [`march`] | volume rendering of a ray, and its adjoint |
//! | [`evidence`] | what speaks for an opaque surface and what for empty space |
//!
//! Sources: photo-consistency of color (Kutulakos and Seitz, "A Theory of Shape by Space Carving", IJCV 2000); votes for empty space
//! (Merrell et al., "Real-Time Visibility-Based Fusion of Depth Maps", ICCV 2007).

pub mod colors;
pub mod evidence;
pub mod field_fit;
pub mod march;
mod neighbors;
pub mod radiance_field;
mod reflections;

use crate::error::Result;
use crate::error::stop::is_stopping;
use crate::mesh::bvh::TriangleBvh;
use crate::ranks::Ranks;
use crate::ranks::packed::divided;
use crate::sdf::SdfGrid;
use crate::shape::parts::extract_parts;
use crate::shape::silhouette::{Silhouette, pixel_size};
use crate::shape::stereo::{StereoView, TrainingViews, match_pictures};
use colors::{ColorPicture, DepthMap, around, compare};
use evidence::emptiness;
use field_fit::fit;
use glam::Vec3;
use neighbors::neighbors;
use radiance_field::FieldRay;
use rayon::prelude::*;
use reflections::fill_reflections;

/// Pixels of a picture per cell of the grid.
const PIXELS_PER_CELL: f32 = 1.5;
/// Most photographs that a field is fitted to; of more, some are, evenly chosen.
const MOST_VIEWS: usize = 100;
/// Share of the object's volume that a round must remove for another one, where the search begins. Rounds on a finer grid take
/// several times as long.
pub(crate) const HULL_SHARE: f32 = 1e-3;
/// The same on the grid of a later level.
pub(crate) const LEVEL_SHARE: f32 = 1e-2;

/// Rounds at most.
const ROUNDS: usize = 3;
/// Votes from which space is empty, and what a view that sees a surface there counts against one that sees through it. Reflections on a
/// glossy object make a few views see too deep, each somewhere else.
const ENOUGH: f32 = 2.0;
const AGAINST: f32 = 1.5;
/// What stays before the depth that was found, in cells and in pixels of a view around.
const MARGIN: (f32, f32) = (0.75, 0.5);

/// Removes the space that the photographs look through; returns the share of the volume that goes. Another round follows one that
/// removes at least `least_share` of it. A run that is stopping ([`is_stopping`]) removes nothing more. `ranks` divide the photographs, and the
/// layers of the grid.
///
/// # Errors
/// If another process is gone.
pub(crate) fn carve_hollows(
    grid: &mut SdfGrid,
    silhouettes: &[Silhouette],
    views: &TrainingViews,
    least_share: f32,
) -> Result<f32> {
    let factor = picture_factor(grid, views);
    let (pictures, ranks) = (color_pictures(views, factor)?, views.ranks());
    let volume = |grid: &SdfGrid| grid.values.iter().filter(|value| **value < 0.0).count();
    let whole = volume(grid);
    let closed = grid.clone();
    for _ in 0..ROUNDS {
        let before = volume(grid);
        let depths = all_depths(grid, silhouettes, &pictures, ranks)?;
        if is_stopping() {
            break;
        }
        remove(grid, &pictures, &depths, ranks)?;
        if (before.saturating_sub(volume(grid)) as f32) < least_share * whole as f32 {
            break;
        }
    }
    if volume(grid) < whole && !is_stopping() {
        fill_reflections(grid, &closed, silhouettes, &match_pictures(views, factor)?);
    }
    Ok(1.0 - volume(grid) as f32 / whole.max(1) as f32)
}

/// Removes the space inside a hull that a field of densities explains as empty; returns the share of the volume that goes, and what
/// distances are at least from now on ([`keep_empty`]), if any. A run that is stopping ([`is_stopping`]) removes nothing.
///
/// # Errors
/// If another process is gone.
pub(crate) fn look_through(
    grid: &mut SdfGrid,
    silhouettes: &[Silhouette],
    views: &TrainingViews,
) -> Result<(f32, Option<SdfGrid>)> {
    let factor = picture_factor(grid, views);
    let stride = views.items.len().div_ceil(MOST_VIEWS).max(1);
    let pictures = color_pictures(&views.every(stride), factor)?;
    let rays = rays(grid, silhouettes, &pictures, views.ranks())?;
    let field = fit(grid, &pictures, &rays);
    let empty = emptiness(grid, &field, &pictures, &rays, views.ranks())?;
    let volume = |grid: &SdfGrid| grid.values.iter().filter(|value| **value < 0.0).count();
    let whole = volume(grid);
    if is_stopping() || empty.iter().all(|empty| *empty <= 0.0) {
        return Ok((0.0, None));
    }
    let mut least = grid.clone();
    carve(grid, &empty);
    grid.redistance();
    let slack = grid.spacing;
    for (least, now) in least.values.iter_mut().zip(&grid.values) {
        let is_opened = *least < 0.0 && *now > slack;
        *least = if is_opened { now - slack } else { f32::MIN };
    }
    Ok((1.0 - volume(grid) as f32 / whole.max(1) as f32, Some(least)))
}

/// Empties again what is known to be empty: a grid too coarse for the wall of a hollow has gaps in it, which the masks
/// contradict, and what is restored there may be a lid.
pub(crate) fn keep_empty(grid: &mut SdfGrid, empty: &SdfGrid) {
    let kept = |row: usize| grid.values[row].max(empty.value(grid.position(grid.vertex(row))));
    grid.values = (0..grid.values.len()).into_par_iter().map(kept).collect();
}

/// The rays of all pixels that meet the surface and show the object alone.
fn rays(
    grid: &SdfGrid,
    silhouettes: &[Silhouette],
    pictures: &[ColorPicture],
    ranks: Option<&Ranks>,
) -> Result<Vec<FieldRay>> {
    let bvh = TriangleBvh::new(&extract_parts(grid, silhouettes));
    let of_picture = |(picture, seen): (u32, Vec<f32>)| {
        let seen = (0..).zip(seen).filter(|(_, surface)| surface.is_finite());
        seen.map(move |(place, surface)| FieldRay { picture, place, surface })
    };
    Ok((0..).zip(cast_all(&bvh, pictures, ranks)?).flat_map(of_picture).collect())
}

/// How far the rays of each picture go to the surface, as [`ColorPicture::cast`] finds it; `ranks` divide the pictures.
fn cast_all(bvh: &TriangleBvh, pictures: &[ColorPicture], ranks: Option<&Ranks>) -> Result<Vec<Vec<f32>>> {
    divided(ranks, pictures.len(), |picture| pictures[picture].cast(bvh))
}

/// The photographs in color, `factor` times smaller along each axis.
fn color_pictures(views: &TrainingViews, factor: u32) -> Result<Vec<ColorPicture>> {
    let pictures = views.each(|_, v| ColorPicture::new(v.camera, v.photograph, v.mask, factor))?;
    Ok(pictures.into_iter().flatten().collect())
}

/// How many times smaller than the photographs the pictures are that are compared.
fn picture_factor(grid: &SdfGrid, views: &TrainingViews) -> u32 {
    let middle = grid.origin + Vec3::splat(0.5 * grid.spacing * (grid.side - 1) as f32);
    let footprint = |v: &StereoView| pixel_size(v.camera) * v.camera.position().distance(middle);
    let mut footprints: Vec<f32> = views.items.iter().map(footprint).collect();
    footprints.sort_by(f32::total_cmp);
    let typical = footprints.get(footprints.len() / 2).copied().unwrap_or(grid.spacing);
    (grid.spacing / (PIXELS_PER_CELL * typical)).round().clamp(1.0, 1024.0) as u32
}

/// What each picture shows of the field as it is.
fn all_depths(
    grid: &SdfGrid,
    silhouettes: &[Silhouette],
    pictures: &[ColorPicture],
    ranks: Option<&Ranks>,
) -> Result<Vec<DepthMap>> {
    let bvh = TriangleBvh::new(&extract_parts(grid, silhouettes));
    let (center, _) = bvh.bounding_sphere();
    let seen = cast_all(&bvh, pictures, ranks)?;
    let of_picture = |i: usize| {
        let sources: Vec<(&ColorPicture, &[f32])> =
            around(pictures, i, center).into_iter().map(|j| (&pictures[j], &*seen[j])).collect();
        compare(&bvh, &pictures[i], &seen[i], &sources).depths
    };
    let depths = divided(ranks, pictures.len(), of_picture)?;
    let maps = depths.into_iter().zip(pictures);
    Ok(maps.map(|(depths, picture)| DepthMap { depths, step: picture.step() }).collect())
}

/// Removes what enough pictures look through.
fn remove(
    grid: &mut SdfGrid,
    pictures: &[ColorPicture],
    depths: &[DepthMap],
    ranks: Option<&Ranks>,
) -> Result<()> {
    let (rows, plane) = (grid.values.len(), (grid.side as usize).pow(2));
    let mut votes = vec![0.0; rows];
    let own = ranks.map_or(0..rows, |ranks| ranks.share(rows, plane));
    let (first, own) = (own.start, &mut votes[own]);
    own.par_iter_mut().enumerate().for_each(|(at, vote)| {
        *vote = votes_at(grid, first + at, pictures, depths);
    });
    if let Some(ranks) = ranks {
        ranks.complete(&mut votes, plane)?;
    }
    let emptiness = |row| (spread(grid, &votes, row) / ENOUGH - 1.0).clamp(-1.0, 1.0);
    let empty: Vec<f32> = (0..votes.len()).into_par_iter().map(emptiness).collect();
    carve(grid, &empty);
    grid.redistance();
    Ok(())
}

/// Removes what is `empty`, in cells, and open to the outside.
fn carve(grid: &mut SdfGrid, empty: &[f32]) {
    let is_outside = outside(grid, empty);
    // The neighbors keep their share of a cell: the zero level lies between.
    let is_carved = |row| is_outside[row] || neighbors(row, grid.side).any(|other| is_outside[other]);
    let carved = |row: usize| {
        let value = grid.values[row];
        if is_carved(row) { value.max(empty[row] * grid.spacing) } else { value }
    };
    grid.values = (0..empty.len()).into_par_iter().map(carved).collect();
}

/// The vertices that are reached from the border of the grid through what is not the object, or is `empty`.
fn outside(grid: &SdfGrid, empty: &[f32]) -> Vec<bool> {
    let is_open = |row: usize| grid.values[row] > 0.0 || empty[row] > 0.0;
    let mut is_outside = vec![false; empty.len()];
    let mut reached: Vec<usize> =
        (0..empty.len()).filter(|&row| is_border(grid, row) && is_open(row)).collect();
    while let Some(row) = reached.pop() {
        if !std::mem::replace(&mut is_outside[row], true) {
            reached.extend(neighbors(row, grid.side).filter(|&next| !is_outside[next] && is_open(next)));
        }
    }
    is_outside
}

fn is_border(grid: &SdfGrid, row: usize) -> bool {
    let vertex = grid.vertex(row);
    vertex.min_element() == 0 || vertex.max_element() + 1 == grid.side
}

/// How many pictures look through a vertex of the grid, less those that show a surface there.
fn votes_at(grid: &SdfGrid, row: usize, pictures: &[ColorPicture], depths: &[DepthMap]) -> f32 {
    if grid.values[row] > 2.0 * grid.spacing || is_stopping() {
        return 0.0;
    }
    let point = grid.position(grid.vertex(row));
    let vote = |(picture, compared): (&ColorPicture, &DepthMap)| {
        let Some(depth) = picture.place(point).map(|place| compared.depths[place]).filter(|d| *d > 0.0)
        else {
            return 0.0;
        };
        let margin = MARGIN.0 * grid.spacing + MARGIN.1 * compared.step * depth;
        let behind = picture.camera.position().distance(point) - depth;
        if behind < -margin {
            1.0
        } else if behind < margin {
            -AGAINST
        } else {
            0.0
        }
    };
    pictures.iter().zip(depths).map(vote).sum()
}

/// The mean of the votes around a vertex, with weights 4, 2, 1 and ½ for itself and its neighbors across faces, edges and corners.
fn spread(grid: &SdfGrid, votes: &[f32], row: usize) -> f32 {
    if is_border(grid, row) {
        return votes[row];
    }
    let side = grid.side as isize;
    let (mut sum, mut weights) = (0.0, 0.0);
    for z in -1..=1isize {
        for y in -1..=1isize {
            for x in -1..=1isize {
                let weight = 4.0 * 0.5f32.powi((x.abs() + y.abs() + z.abs()) as i32);
                let other = row as isize + x + side * (y + side * z);
                sum += weight * votes[other as usize];
                weights += weight;
            }
        }
    }
    sum / weights
}

#[cfg(test)]
mod tests;
