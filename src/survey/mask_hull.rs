//! How well masks agree with each other: the visual hull on a coarse grid, seen again by every camera.

use crate::math::statistics::median;
use crate::survey::look::SmallMask;
use crate::survey::meeting::{Sight, meeting_point};
use crate::survey::mesh_overlap::overlap;
use glam::Vec3;
use rayon::prelude::*;

/// Cells a side of the grid, and of the one that tells whether what the first leaves uncovered is only thinner than its cells.
pub(crate) const CELLS: u32 = 48;
pub(crate) const FINE_CELLS: u32 = 96;
/// Half a side of the grid in sizes of the object (the longer half of its boxes).
const REACH: f32 = 1.15;
/// Views that must see a cell.
const LEAST_VIEWS: usize = 3;
/// Most pixels that half a cell is drawn large.
const MOST_RADIUS: f32 = 8.0;
/// Share of the views that may see a cell outside their mask.
pub(crate) const FORGIVEN: f32 = 0.05;

/// The cube around the object that is divided into cells.
struct Grid {
    center: Vec3,
    half: f32,
    /// Cells a side.
    cells: u32,
}

/// A cell of the hull: its center, how many views see it, and how many of them see it outside their mask.
struct Cell {
    at: Vec3,
    seen: usize,
    missed: usize,
}

/// Mean over views of the intersection over union of a mask with the hull of all masks; 0 if there is no hull. `None` for fewer than
/// three masks.
pub(crate) fn consistency(views: &[SmallMask]) -> Option<f32> {
    if views.iter().filter_map(sight_and_size).count() < LEAST_VIEWS {
        return None;
    }
    let all: Vec<&SmallMask> = views.iter().collect();
    let Some(grid) = Grid::new(&all, CELLS) else { return Some(0.0) };
    let least = LEAST_VIEWS.min(views.len());
    let is_inside = |seen: usize, missed: usize| seen >= least && missed as f32 <= FORGIVEN * seen as f32;
    let cells = grid.cells(&all, is_inside);
    let agreement = |view: &SmallMask| {
        let drawn = draw(view, cells.iter().map(|cell| cell.at), grid.step());
        overlap(&drawn, &view.inside).unwrap_or(0.0)
    };
    let found: Vec<f32> = views.par_iter().map(agreement).collect();
    Some(found.iter().sum::<f32>() / found.len() as f32)
}

/// For each view, the share of its mask that the hull of the other views which are `trusted`, of `side` cells a side, leaves uncovered;
/// `forgiven` is the share of those that may see a cell outside their mask. Parts of a mask narrower than three pixels do not count. 1 if there is no hull.
pub(crate) fn uncovered(views: &[SmallMask], trusted: &[bool], forgiven: f32, side: u32) -> Vec<f32> {
    let voters: Vec<&SmallMask> =
        views.iter().zip(trusted).filter(|(_, trusted)| **trusted).map(|(view, _)| view).collect();
    let Some(grid) = Grid::new(&voters, side) else { return vec![1.0; views.len()] };
    let is_inside =
        |seen: usize, missed: usize| seen >= LEAST_VIEWS && missed as f32 <= forgiven * seen as f32;
    // A view that is left out takes one vote with it.
    let cells = grid.cells(&voters, |seen, missed| {
        is_inside(seen, missed) || (missed > 0 && is_inside(seen - 1, missed - 1))
    });
    let of_view = |(view, trusted): (&SmallMask, &bool)| {
        let without = |cell: &&Cell| {
            let own = pixel(view, cell.at).filter(|_| *trusted);
            let missed = own.filter(|pixel| !view.inside[*pixel]);
            is_inside(cell.seen - usize::from(own.is_some()), cell.missed - usize::from(missed.is_some()))
        };
        let drawn = draw(view, cells.iter().filter(without).map(|cell| cell.at), grid.step());
        let solid = solid(view);
        let open = solid.iter().zip(&drawn).filter(|(solid, drawn)| **solid && !**drawn).count();
        open as f32 / solid.iter().filter(|solid| **solid).count().max(1) as f32
    };
    views.par_iter().zip(trusted).map(of_view).collect()
}

/// For each view that is `trusted`, how many cells it takes from the hull of the others: those that more than `FORGIVEN` and at most
/// `most` of the views see outside their masks, each shared by these views.
pub fn carved(views: &[SmallMask], trusted: &[bool], most: f32) -> Vec<f32> {
    let voters: Vec<&SmallMask> =
        views.iter().zip(trusted).filter(|(_, trusted)| **trusted).map(|(view, _)| view).collect();
    let Some(grid) = Grid::new(&voters, CELLS) else { return vec![0.0; views.len()] };
    let cells = grid.cells(&voters, |seen, missed| {
        let share = missed as f32 / seen.max(1) as f32;
        seen >= LEAST_VIEWS && share > FORGIVEN && share <= most
    });
    let of_view = |(view, trusted): (&SmallMask, &bool)| {
        let misses = |cell: &&Cell| *trusted && pixel(view, cell.at).is_some_and(|pixel| !view.inside[pixel]);
        cells.iter().filter(misses).map(|cell| 1.0 / cell.missed as f32).sum::<f32>()
    };
    views.par_iter().zip(trusted).map(of_view).collect()
}

/// Pixels of a mask that some 3×3 covered pixels have.
pub fn solid(view: &SmallMask) -> Vec<bool> {
    let (width, height) = (view.camera.width as usize, view.camera.height as usize);
    let mut found = vec![false; view.inside.len()];
    for y in 0..height.saturating_sub(2) {
        for x in 0..width.saturating_sub(2) {
            let rows = || (y..y + 3).map(|row| row * width + x..row * width + x + 3);
            if rows().all(|row| view.inside[row].iter().all(|inside| *inside)) {
                rows().for_each(|row| found[row].fill(true));
            }
        }
    }
    found
}

/// The ray through the middle of a mask's box, and half the box's longer side as an angle.
fn sight_and_size(view: &SmallMask) -> Option<(Sight, f32)> {
    let width = view.camera.width as usize;
    let (mut low, mut high) = ([f32::INFINITY; 2], [f32::NEG_INFINITY; 2]);
    for (i, _) in view.inside.iter().enumerate().filter(|(_, inside)| **inside) {
        let at = [(i % width) as f32, (i / width) as f32];
        (low, high) = ([0, 1].map(|k| low[k].min(at[k])), [0, 1].map(|k| high[k].max(at[k] + 1.0)));
    }
    let sight = Sight::new(&view.camera, 0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1]));
    let halves = [0, 1].map(|k| 0.5 * (high[k] - low[k]) / view.camera.focal[k]);
    (low[0] < high[0]).then_some((sight, halves[0].max(halves[1])))
}

/// Pixel of a point, if the frame has it.
fn pixel(view: &SmallMask, point: Vec3) -> Option<usize> {
    let (x, y, _) = view.camera.project(point)?;
    let inside = x >= 0.0 && y >= 0.0 && x < view.camera.width as f32 && y < view.camera.height as f32;
    inside.then(|| y as usize * view.camera.width as usize + x as usize)
}

impl Grid {
    /// Of `cells` cells a side around the point where the masks' middles meet; `None` if they do not, or behind most cameras.
    fn new(views: &[&SmallMask], cells: u32) -> Option<Self> {
        let boxes: Vec<(Sight, f32)> = views.iter().filter_map(|view| sight_and_size(view)).collect();
        let sights: Vec<Sight> = boxes.iter().map(|found| found.0).collect();
        let center = meeting_point(&sights)?;
        let ahead = sights.iter().filter(|sight| sight.direction.dot(center - sight.origin) > 0.0).count();
        let mut sizes: Vec<f32> =
            boxes.iter().map(|(sight, size)| size * sight.origin.distance(center) as f32).collect();
        let half = REACH * median(&mut sizes)?;
        (2 * ahead >= sights.len()).then_some(Self { center: center.as_vec3(), half, cells })
    }

    /// The side of a cell.
    fn step(&self) -> f32 {
        2.0 * self.half / self.cells as f32
    }

    /// The cells of which `is_inside` holds for how many of the views see them, and how many of these outside their mask.
    fn cells(&self, views: &[&SmallMask], is_inside: impl Fn(usize, usize) -> bool + Sync) -> Vec<Cell> {
        let cell = |at: Vec3| {
            let (mut seen, mut missed) = (0usize, 0usize);
            for view in views {
                if let Some(pixel) = pixel(view, at) {
                    seen += 1;
                    missed += usize::from(!view.inside[pixel]);
                }
            }
            is_inside(seen, missed).then_some(Cell { at, seen, missed })
        };
        let side = self.cells;
        let layer = |z: u32| {
            let place = move |i: u32| Vec3::new((i % side) as f32, (i / side) as f32, z as f32);
            let points = (0..side * side)
                .map(move |i| self.center + (place(i) + 0.5) * self.step() - Vec3::splat(self.half));
            points.filter_map(cell).collect::<Vec<Cell>>()
        };
        (0..side).into_par_iter().flat_map_iter(layer).collect()
    }
}

/// Pixels of a view that cells of this side cover, each drawn as large as it appears.
fn draw(view: &SmallMask, cells: impl Iterator<Item = Vec3>, step: f32) -> Vec<bool> {
    let (width, height) = (view.camera.width as i64, view.camera.height as i64);
    let mut drawn = vec![false; view.inside.len()];
    for cell in cells {
        let Some((x, y, depth)) = view.camera.project(cell) else { continue };
        let radius = (0.5 * step * view.camera.focal[0] / depth).min(MOST_RADIUS);
        let [left, right] = [x - radius, x + radius].map(|at| at.clamp(-1e6, 1e6).floor() as i64);
        let [top, bottom] = [y - radius, y + radius].map(|at| at.clamp(-1e6, 1e6).floor() as i64);
        for row in top.max(0)..=bottom.min(height - 1) {
            for column in left.max(0)..=right.min(width - 1) {
                drawn[(row * width + column) as usize] = true;
            }
        }
    }
    drawn
}
