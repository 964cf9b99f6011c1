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
}

/// For each view that has a mask, how it agrees with the mesh.
pub fn agreements(bvh: &TriangleBvh, looks: &[ViewLook]) -> Vec<Option<Agreement>> {
    let of_view = |look: &ViewLook| {
        let mask = &look.mask.as_ref()?.small;
        let mesh = covered(bvh, mask);
        let outside: Vec<bool> = mask.inside.iter().map(|inside| !inside).collect();
        let iou = overlap(&mesh, &mask.inside).unwrap_or(0.0);
        Some(Agreement { iou, inverse_iou: overlap(&mesh, &outside).unwrap_or(0.0) })
    };
    looks.par_iter().map(of_view).collect()
}

/// The median overlap of the mesh with several masks; 0 without masks.
pub fn median_agreement(bvh: &TriangleBvh, views: &[SmallMask]) -> f32 {
    let mut found: Vec<f32> = views.par_iter().map(|view| agreement(bvh, view)).collect();
    median(&mut found).unwrap_or(0.0)
}
