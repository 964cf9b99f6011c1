//! Hollows that no silhouette shows: removes from the hull what photographs look through.
//!
//! The hull closes a cup with a lid. What is seen through the lid moves against it from view to
//! view, so that photographs disagree on the lid's color, and agree far behind it. Each view is
//! compared with those around it ([`mod@compare`]) at all depths from the surface to the far side.
//! Where they agree much better at one of these than at the surface, the space in front of it is
//! empty. All views vote, and what enough of them see through is removed; the next round knows
//! better what hides what. A deep hollow has places that no two photographs around share, or whose
//! colors change slowly. So all photographs together are asked first: a field of densities and
//! colors ([`radiance_field`]) is fitted to them by volume rendering, and a space is empty where
//! that explains them far better than the surface does ([`evidence`]). The hull is coarse: what its
//! cells do not resolve is looked for once more on the finer grid of the second level.
//!
//! Only space that is open to the outside is removed: a reflection that seems to lie far behind a
//! glossy surface leaves no bubble inside the object. Spaces that reflections have opened all the
//! same are filled again. A margin before the depth that was found stays: the walls of a hollow may
//! be thin, and a fit moves a surface that is nearly in place.
//!
//! Sources: photo-consistency of color (Kutulakos and Seitz, "A Theory of Shape by Space Carving",
//! IJCV 2000); votes for empty space (Merrell et al., "Real-Time Visibility-Based Fusion of Depth
//! Maps", ICCV 2007).

mod compare;
mod evidence;
mod radiance_field;

use crate::shape::pictures::{ColorPicture, MatchPicture, Seen, TrainingView, picture_factor};
use crate::shape::{cube, flood, hull::extract_parts, is_border, neighbors, shell::Shell, size, volume};
use crate::{shape::silhouette::Silhouette, shape::stereo::pattern_shares};
use compare::{SINE, around, compare};
use evidence::emptiness;
use glam::Vec3;
use lobelia_geometry::{error::stop::is_stopping, mesh::bvh::TriangleBvh, parallel, sdf::SdfGrid};
use radiance_field::{FieldRay, FieldRays, fit};

/// Pixels of a picture per cell of the grid.
const PIXELS_PER_CELL: f32 = 1.5;
/// Most photographs that a field is fitted to; of more, some are, evenly chosen.
const MOST_VIEWS: usize = 100;
/// Share of the object's volume that a round must remove for another one, where the search begins.
/// Rounds on a finer grid take several times as long.
pub(super) const HULL_SHARE: f32 = 1e-3;
/// Share of the volume for another round on the grid of a later level.
pub(super) const LEVEL_SHARE: f32 = 1e-2;
const ROUNDS: usize = 3;
/// Votes from which space is empty, and the weight of a view that sees a surface there against one
/// that sees through it. Reflections on a glossy object make a few views see too deep, each
/// somewhere else.
const ENOUGH: f32 = 2.0;
const AGAINST: f32 = 1.5;
/// Margin that stays before the depth that was found, in cells and in pixels of a view around.
const MARGIN: (f32, f32) = (0.75, 0.5);
/// Share of the pattern on the floor of a hollow, on average, below which it was opened by
/// reflections.
const LEAST_PATTERN: f32 = 0.475;
/// Stands for grid vertices that were not opened.
const NONE: u32 = u32::MAX;

/// Removes the space that the photographs look through; returns the share of the volume that goes.
/// Another round follows one that removes at least `least_share` of it. A run that is stopping
/// ([`is_stopping`]) removes nothing more.
pub(super) fn carve_hollows(
    grid: &mut SdfGrid,
    silhouettes: &[Silhouette],
    views: &[TrainingView],
    least_share: f32,
) -> f32 {
    let factor = factor(grid, views);
    let pictures = ColorPicture::of_views(views, factor);
    let (whole, closed) = (volume(grid), grid.clone());
    for _ in 0..ROUNDS {
        let before = volume(grid);
        // Each picture is compared with those around it, on the surface of the field as it is.
        let bvh = TriangleBvh::new(&extract_parts(grid, silhouettes));
        let (center, _) = bvh.bounding_sphere();
        let seen = cast_all(&bvh, &pictures);
        let depths_of = |i: usize| {
            let near = around(&pictures, i, center);
            let sources: Vec<_> = near.into_iter().map(|j| (&pictures[j], &*seen[j])).collect();
            compare(&bvh, &pictures[i], &seen[i], &sources)
        };
        let depths: Vec<Vec<f32>> = parallel::map(pictures.len(), 1, depths_of);
        if is_stopping() {
            break;
        }
        remove(grid, &pictures, &depths);
        if (before.saturating_sub(volume(grid)) as f32) < least_share * whole as f32 {
            break;
        }
    }
    if volume(grid) < whole && !is_stopping() {
        fill_reflections(grid, &closed, silhouettes, &MatchPicture::of_views(views, factor));
    }
    1.0 - volume(grid) as f32 / whole.max(1) as f32
}

/// Removes the space inside a hull that a field of densities explains as empty; returns the share
/// of the volume that goes, and what distances are at least from now on ([`keep_empty`]), if any. A
/// run that is stopping ([`is_stopping`]) removes nothing.
pub(super) fn look_through(
    grid: &mut SdfGrid,
    silhouettes: &[Silhouette],
    views: &[TrainingView],
) -> (f32, Option<SdfGrid>) {
    let stride = views.len().div_ceil(MOST_VIEWS).max(1);
    let some: Vec<TrainingView> = views.iter().step_by(stride).copied().collect();
    let pictures = ColorPicture::of_views(&some, factor(grid, views));
    // The rays of all pixels that meet the surface and show the object alone.
    let bvh = TriangleBvh::new(&extract_parts(grid, silhouettes));
    let of_picture = |(picture, seen): (u32, Vec<Seen>)| {
        let seen = (0..).zip(seen).filter(|(_, seen)| seen.distance.is_finite());
        seen.map(move |(place, seen)| FieldRay { picture, place, surface: seen.distance })
    };
    let rays = (0..).zip(cast_all(&bvh, &pictures)).flat_map(of_picture).collect();
    let rays = FieldRays { pictures: &pictures, rays };
    let empty = emptiness(grid, &fit(grid, &rays), &rays);
    if is_stopping() || empty.iter().all(|empty| *empty <= 0.0) {
        return (0.0, None);
    }
    let (whole, mut least, slack) = (volume(grid), grid.clone(), grid.spacing);
    carve(grid, &empty);
    for (least, now) in least.values.iter_mut().zip(&grid.values) {
        let is_opened = *least < 0.0 && *now > slack;
        *least = if is_opened { now - slack } else { f32::MIN };
    }
    (1.0 - volume(grid) as f32 / whole.max(1) as f32, Some(least))
}

/// Empties again what is known to be empty: a grid too coarse for the wall of a hollow has gaps in
/// it, which the masks contradict, and what is restored there may be a lid.
pub(super) fn keep_empty(grid: &mut SdfGrid, empty: &SdfGrid) {
    let kept = |row: usize| grid.values[row].max(empty.value(grid.position(grid.vertex(row))));
    grid.values = parallel::map(grid.values.len(), 1024, kept);
}

fn cast_all(bvh: &TriangleBvh, pictures: &[ColorPicture]) -> Vec<Vec<Seen>> {
    parallel::map_slice(pictures, 1, |picture| picture.cast(bvh))
}

/// How many times smaller than the photographs the pictures are that are compared.
fn factor(grid: &SdfGrid, views: &[TrainingView]) -> u32 {
    let middle = grid.origin + Vec3::splat(0.5 * grid.spacing * (grid.side - 1) as f32);
    picture_factor(views, middle, grid.spacing, PIXELS_PER_CELL).unwrap_or(1)
}

/// Removes what enough pictures look through; `depths` are those that their pixels show, 0 where
/// that is not known.
fn remove(grid: &mut SdfGrid, pictures: &[ColorPicture], depths: &[Vec<f32>]) {
    // How many pictures look through a vertex, less those that show a surface there.
    let votes_at = |row: usize| {
        if grid.values[row] > 2.0 * grid.spacing || is_stopping() {
            return 0.0;
        }
        let point = grid.position(grid.vertex(row));
        let vote = |(picture, depths): (&ColorPicture, &Vec<f32>)| {
            let depth = picture.place(point).map_or(0.0, |place| depths[place]);
            let margin = MARGIN.0 * grid.spacing + MARGIN.1 * picture.step(SINE) * depth;
            let behind = picture.camera.position().distance(point) - depth;
            match behind {
                _ if depth <= 0.0 => 0.0,
                behind if behind < -margin => 1.0,
                behind if behind < margin => -AGAINST,
                _ => 0.0,
            }
        };
        pictures.iter().zip(depths).map(vote).sum()
    };
    let votes: Vec<f32> = parallel::map(grid.values.len(), 1024, votes_at);
    // The mean of the votes around a vertex, with weights 4, 2, 1 and ½ for itself and its
    // neighbors across faces, edges and corners.
    let spread = |row: usize| {
        if is_border(grid, row) {
            return votes[row];
        }
        let (mut sum, mut weights) = (0.0, 0.0);
        for (other, apart) in cube(grid, row) {
            let weight = 4.0 * 0.5f32.powi(apart);
            sum += weight * votes[other];
            weights += weight;
        }
        sum / weights
    };
    let empty = |row: usize| (spread(row) / ENOUGH - 1.0).clamp(-1.0, 1.0);
    let empty: Vec<f32> = parallel::map(grid.values.len(), 1024, empty);
    carve(grid, &empty);
}

/// Removes what is `empty`, in cells, and open to the outside: reached from the border of the grid
/// through what is not the object, or is empty. Restores distances.
fn carve(grid: &mut SdfGrid, empty: &[f32]) {
    let rows = 0..empty.len();
    let mut open: Vec<bool> = rows.clone().map(|row| grid.values[row] > 0.0 || empty[row] > 0.0).collect();
    let mut is_outside = vec![false; empty.len()];
    let around = |row: usize| neighbors(row, size(grid));
    flood(rows.clone().filter(|row| is_border(grid, *row)), &mut open, around, |row| is_outside[row] = true);
    // The neighbors keep their share of a cell: the zero level lies between.
    let carved = |row: usize| {
        let (value, is_near) = (grid.values[row], || around(row).any(|other| is_outside[other]));
        if is_outside[row] || is_near() { value.max(empty[row] * grid.spacing) } else { value }
    };
    grid.values = parallel::map(empty.len(), 1024, carved);
    grid.redistance();
}

/// Fills the spaces of `grid` that were opened since it was `closed`, and whose floors show no
/// pattern.
///
/// Reflections in metal or glaze seem to lie behind the surface, as the floor of a hollow does. But
/// the floor of a hollow is a surface with a pattern, on which all photographs agree once it is
/// laid open; on the floor of a space that a reflection has opened they agree no better than before
/// ([`pattern_shares`]). Each connected space is judged as a whole by the surface that borders on
/// it.
fn fill_reflections(grid: &mut SdfGrid, closed: &SdfGrid, views: &[Silhouette], pictures: &[MatchPicture]) {
    let mesh = extract_parts(grid, views);
    let shell = Shell::new(&mesh);
    let shares = pattern_shares(&mesh, &shell, pictures);
    if is_stopping() {
        return;
    }
    let (spaces, count) = opened_spaces(grid, closed);
    let (mut sums, mut counts) = (vec![0.0; count], vec![0.0; count]);
    for (at, share) in shell.positions.iter().zip(shares) {
        let bordering = grid.corners(*at).into_iter().find(|(row, _)| spaces[*row] != NONE);
        if let Some((row, _)) = bordering {
            sums[spaces[row] as usize] += share;
            counts[spaces[row] as usize] += 1.0;
        }
    }
    let is_reflection: Vec<bool> =
        sums.iter().zip(&counts).map(|(sum, count)| *sum < LEAST_PATTERN * count).collect();
    if !is_reflection.contains(&true) {
        return;
    }
    for (row, space) in spaces.iter().enumerate() {
        if is_reflection.get(*space as usize) == Some(&true) {
            grid.values[row] = closed.values[row];
        }
    }
    grid.redistance();
}

/// For each vertex of the grid the number of the opened space that it is in, and how many spaces
/// there are. Vertices hang together along edges.
fn opened_spaces(grid: &SdfGrid, closed: &SdfGrid) -> (Vec<u32>, usize) {
    let pairs = grid.values.iter().zip(&closed.values);
    let mut open: Vec<bool> = pairs.map(|(now, before)| *now >= 0.0 && *before < 0.0).collect();
    let mut spaces = vec![NONE; open.len()];
    let mut count = 0;
    for start in 0..spaces.len() {
        if open[start] {
            flood([start], &mut open, |row| neighbors(row, size(grid)), |row| spaces[row] = count);
            count += 1;
        }
    }
    (spaces, count as usize)
}

#[cfg(test)]
mod tests;
