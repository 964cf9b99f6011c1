//! Silhouettes of a known mesh beside the masks, at few pixels.

use crate::math::statistics::median;
use crate::mesh::bvh::TriangleBvh;
use crate::survey::look::{SmallMask, ViewLook};
use rayon::prelude::*;

/// Which pixels of a small mask's frame the mesh covers.
pub fn covered(bvh: &TriangleBvh, view: &SmallMask) -> Vec<bool> {
    let pixels = view.camera.width * view.camera.height;
    (0..pixels).map(|pixel| bvh.any(&view.camera.pixel_ray(pixel), 0.0, f32::INFINITY)).collect()
}

/// Pixels in both over pixels in either; `None` if neither has any.
pub fn overlap(a: &[bool], b: &[bool]) -> Option<f32> {
    let count = |both: fn((&bool, &bool)) -> bool| a.iter().zip(b).filter(|pair| both(*pair)).count();
    let (either, both) = (count(|(a, b)| *a || *b), count(|(a, b)| *a && *b));
    (either > 0).then(|| both as f32 / either as f32)
}

/// The overlap of the mesh with one mask.
pub fn agreement(bvh: &TriangleBvh, view: &SmallMask) -> f32 {
    overlap(&covered(bvh, view), &view.inside).unwrap_or(0.0)
}

/// How the mesh and the mask of each view agree.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Agreement {
    /// Intersection over union of the mesh and the mask.
    pub iou: f32,
    /// The same of the mesh and the background.
    pub inverse_iou: f32,
    /// Mean distance of the outlines in pixels of the small mask: pixels that one of both covers, for each along the outline of the mesh.
    pub offset: f32,
    /// Share of the mask's pixels that are well outside the mesh.
    pub missing: f32,
    /// Pixels of the mesh well outside the mask, relative to those of the mask.
    pub beyond: f32,
}

/// Pixels of a small mask beyond which a pixel is well outside a silhouette.
const MARGIN: usize = 2;

/// For each view that has a mask, how it agrees with the mesh.
pub(crate) fn agreements(bvh: &TriangleBvh, looks: &[ViewLook]) -> Vec<Option<Agreement>> {
    let of_view = |look: &ViewLook| {
        let mask = &look.mask.as_ref()?.small;
        let mesh = covered(bvh, mask);
        let outside: Vec<bool> = mask.inside.iter().map(|inside| !inside).collect();
        let iou = overlap(&mesh, &mask.inside).unwrap_or(0.0);
        let inverse_iou = overlap(&mesh, &outside).unwrap_or(0.0);
        let apart = mesh.iter().zip(&mask.inside).filter(|(mesh, mask)| mesh != mask).count();
        let width = mask.camera.width as usize;
        let offset = apart as f32 / outline(&mesh, width).max(1) as f32;
        let area = mask.inside.iter().filter(|inside| **inside).count().max(1) as f32;
        let missing = well_outside(&mask.inside, &mesh, width) as f32 / area;
        let beyond = well_outside(&mesh, &mask.inside, width) as f32 / area;
        Some(Agreement { iou, inverse_iou, offset, missing, beyond })
    };
    looks.par_iter().map(of_view).collect()
}

/// Pixels of `a` that have no pixel of `b` within [`MARGIN`] in either direction.
fn well_outside(a: &[bool], b: &[bool], width: usize) -> usize {
    let height = a.len() / width.max(1);
    let is_near = |i: usize| {
        let (x, y) = (i % width, i / width);
        let columns = x.saturating_sub(MARGIN)..(x + MARGIN + 1).min(width);
        let mut rows = y.saturating_sub(MARGIN)..(y + MARGIN + 1).min(height);
        rows.any(|row| b[row * width..][columns.clone()].contains(&true))
    };
    (0..a.len()).filter(|i| a[*i] && !b[*i] && !is_near(*i)).count()
}

/// Covered pixels beside one that is not.
fn outline(inside: &[bool], width: usize) -> usize {
    let is_beside = |i: &usize| {
        let (first, last) = (i.is_multiple_of(width), i % width + 1 == width);
        let left = !first && !inside[i - 1];
        let right = !last && !inside[i + 1];
        let above = *i >= width && !inside[i - width];
        left || right || above || inside.get(i + width).is_some_and(|inside| !inside)
    };
    (0..inside.len()).filter(|i| inside[*i] && is_beside(i)).count()
}

/// The median overlap of the mesh with several masks; 0 without masks.
pub(crate) fn median_agreement(bvh: &TriangleBvh, views: &[SmallMask]) -> f32 {
    let mut found: Vec<f32> = views.par_iter().map(|view| agreement(bvh, view)).collect();
    median(&mut found).unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_frame_is_no_outline() {
        // A square of 3×3 in the middle of 5×5, and one in a corner.
        let square = |low: usize| -> Vec<bool> {
            let within = move |at: usize| (low..low + 3).contains(&at);
            (0..25).map(|i| within(i % 5) && within(i / 5)).collect()
        };
        assert_eq!(outline(&square(1), 5), 8);
        assert_eq!(outline(&square(0), 5), 5);
    }

    #[test]
    fn a_rim_is_not_well_outside() {
        // Squares of 4×4 and 8×8 around the middle of 12×12, and one with another part in a corner.
        let square = |low: usize, high: usize| -> Vec<bool> {
            (0..144).map(|i| (low..high).contains(&(i % 12)) && (low..high).contains(&(i / 12))).collect()
        };
        let (small, large) = (square(4, 8), square(2, 10));
        assert_eq!([well_outside(&large, &small, 12), well_outside(&small, &large, 12)], [0, 0]);
        let mut parted = small.clone();
        [0, 1, 12, 13].into_iter().for_each(|i| parted[i] = true);
        assert_eq!(well_outside(&parted, &small, 12), 4);
        assert_eq!(well_outside(&small, &[false; 144], 12), 16);
    }
}
