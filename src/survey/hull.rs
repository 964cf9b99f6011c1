//! How well masks agree with each other: the visual hull on a coarse grid, seen again by every camera.

use crate::survey::look::SmallMask;
use crate::survey::meeting::{Sight, meeting_point};
use crate::survey::silhouette::overlap;
use crate::survey::statistics::median;
use glam::Vec3;
use rayon::prelude::*;

/// Cells a side of the grid.
const CELLS: u32 = 48;
/// Half a side of the grid in sizes of the object (the longer half of its boxes).
const REACH: f32 = 1.15;
/// Views that must see a cell.
const LEAST_VIEWS: usize = 3;
/// Most pixels that half a cell is drawn large.
const MOST_RADIUS: f32 = 8.0;
/// Share of the views that may see a cell outside their mask.
const FORGIVEN: f32 = 0.05;

/// Mean over views of the intersection over union of a mask with the hull of all masks; 0 if there is no hull. `None` for fewer than
/// three masks.
pub fn consistency(views: &[SmallMask]) -> Option<f32> {
    let boxes: Vec<(Sight, f32)> = views.iter().filter_map(sight_and_size).collect();
    if boxes.len() < LEAST_VIEWS {
        return None;
    }
    let sights: Vec<Sight> = boxes.iter().map(|found| found.0).collect();
    let Some(center) = meeting_point(&sights) else { return Some(0.0) };
    let ahead = sights.iter().filter(|sight| sight.direction.dot(center - sight.origin) > 0.0).count();
    if 2 * ahead < sights.len() {
        return Some(0.0);
    }
    let mut sizes: Vec<f32> =
        boxes.iter().map(|(sight, size)| size * sight.origin.distance(center) as f32).collect();
    let half = REACH * median(&mut sizes)?;
    let cells = hull(views, center.as_vec3(), half);
    let found: Vec<f32> = views.par_iter().map(|view| seen_again(view, &cells, half)).collect();
    Some(found.iter().sum::<f32>() / found.len() as f32)
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

/// Centers of the cells that nearly all views that see them have in their masks.
fn hull(views: &[SmallMask], center: Vec3, half: f32) -> Vec<Vec3> {
    let step = 2.0 * half / CELLS as f32;
    let is_inside = |point: &Vec3| {
        let (mut seen, mut missed) = (0usize, 0usize);
        for view in views {
            if let Some(pixel) = pixel(view, *point) {
                seen += 1;
                missed += usize::from(!view.inside[pixel]);
            }
        }
        seen >= LEAST_VIEWS.min(views.len()) && missed as f32 <= FORGIVEN * seen as f32
    };
    let layer = |z: u32| {
        let cell = move |i: u32| Vec3::new((i % CELLS) as f32, (i / CELLS) as f32, z as f32);
        let points = (0..CELLS * CELLS).map(move |i| center + (cell(i) + 0.5) * step - Vec3::splat(half));
        points.filter(is_inside).collect::<Vec<Vec3>>()
    };
    (0..CELLS).into_par_iter().map(layer).collect::<Vec<_>>().concat()
}

/// Overlap of a mask with the cells, each drawn as large as it appears.
fn seen_again(view: &SmallMask, cells: &[Vec3], half: f32) -> f32 {
    let (width, height) = (view.camera.width as i64, view.camera.height as i64);
    let step = 2.0 * half / CELLS as f32;
    let mut drawn = vec![false; view.inside.len()];
    for cell in cells {
        let Some((x, y, depth)) = view.camera.project(*cell) else { continue };
        let radius = (0.5 * step * view.camera.focal[0] / depth).min(MOST_RADIUS);
        let [left, right] = [x - radius, x + radius].map(|at| at.clamp(-1e6, 1e6).floor() as i64);
        let [top, bottom] = [y - radius, y + radius].map(|at| at.clamp(-1e6, 1e6).floor() as i64);
        for row in top.max(0)..=bottom.min(height - 1) {
            for column in left.max(0)..=right.min(width - 1) {
                drawn[(row * width + column) as usize] = true;
            }
        }
    }
    overlap(&drawn, &view.inside).unwrap_or(0.0)
}
