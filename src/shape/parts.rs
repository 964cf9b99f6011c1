//! Which components of a surface are parts of the object: the largest, and those that the masks show beside it.
//!
//! A field has floaters: space that no mask contradicts. They project into the masks, but always onto what the object covers anyway. A
//! part of the object, such as a link of a chain, is needed: without it masks have pixels that show nothing.

use crate::math::ray::Ray;
use crate::mesh::bvh::TriangleBvh;
use crate::mesh::triangles::Mesh;
use crate::sdf::SdfGrid;
use crate::sdf::extract::extract_components;
use crate::shape::silhouette::{MIN_VIEWS, Silhouette, is_inner};
use rayon::prelude::*;

/// Pixels inside a mask's outline beyond which a ray should meet the object.
const DEPTH: f32 = 2.0;
/// One of as many pixels is asked.
const STRIDE: usize = 7;
/// Pixels of those in a view that a part must show alone for the view to need it.
const LEAST_PIXELS: usize = 2;
/// Share of the views that must need a part, none of which it may hide behind.
const LEAST_SHARE: f32 = 0.25;
/// Components beyond the largest that are looked at.
const MOST_PARTS: usize = 63;

/// The zero level of the field as a mesh: its largest component, and the others that the masks show.
pub(crate) fn extract_parts(grid: &SdfGrid, silhouettes: &[Silhouette]) -> Mesh {
    let mut components = extract_components(grid).into_iter();
    let Some(mut mesh) = components.next() else { return Mesh::default() };
    let others: Vec<Mesh> = components.take(MOST_PARTS).collect();
    if others.is_empty() || silhouettes.is_empty() {
        return mesh;
    }
    let largest = TriangleBvh::new(&mesh);
    let mut missing: Vec<Vec<Ray>> =
        silhouettes.par_iter().map(|view| missing_rays(view, &largest)).collect();
    let needed = MIN_VIEWS.max((LEAST_SHARE * silhouettes.len() as f32).ceil() as usize);
    for other in others {
        let bvh = TriangleBvh::new(&other);
        let meets = |ray: &&Ray| bvh.nearest(ray, 0.0).is_some();
        let shows = |rays: &&Vec<Ray>| rays.iter().filter(meets).take(LEAST_PIXELS).count() == LEAST_PIXELS;
        if missing.par_iter().filter(shows).count() >= needed {
            missing.par_iter_mut().for_each(|rays| rays.retain(|ray| !meets(&ray)));
            append(&mut mesh, other);
        }
    }
    mesh
}

/// Rays through pixels well inside a mask that miss the surface.
fn missing_rays(view: &Silhouette, surface: &TriangleBvh) -> Vec<Ray> {
    // Other columns in each row, whatever the width.
    let width = view.camera.width as usize;
    let is_asked = |i: &usize| (i % width + 3 * (i / width)).is_multiple_of(STRIDE);
    let pixels = (0..view.pixel_count()).filter(is_asked).filter(|i| view.distance(*i) < -DEPTH);
    let inner = pixels.map(|i| view.center(i)).filter(|(x, y)| is_inner(&view.camera, *x, *y));
    inner.map(|(x, y)| view.camera.ray(x, y)).filter(|ray| surface.nearest(ray, 0.0).is_none()).collect()
}

fn append(mesh: &mut Mesh, other: Mesh) {
    let first = mesh.positions.len() as u32;
    mesh.positions.extend(other.positions);
    mesh.normals.extend(other.normals);
    mesh.triangles.extend(other.triangles.iter().map(|corners| corners.map(|corner| corner + first)));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::view::{Camera, Mask, StoredMask};
    use glam::Vec3;

    const SIZE: u32 = 96;

    fn ball(p: Vec3, x: f32, radius: f32) -> f32 {
        p.distance(Vec3::new(x, 0.0, 0.0)) - radius
    }

    fn grid(field: impl Fn(Vec3) -> f32 + Sync) -> SdfGrid {
        SdfGrid::from_fn(Vec3::ZERO, 1.0, 48, field)
    }

    /// Masks of a field from all around.
    fn silhouettes(field: impl Fn(Vec3) -> f32 + Sync) -> Vec<Silhouette> {
        let grid = grid(field);
        let view = |(i, camera): (usize, &Camera)| {
            let covered = |pixel: u32| {
                f32::from(u8::from(grid.first_crossing(&camera.pixel_ray(pixel), 0.0).is_some()))
            };
            let coverage = (0..SIZE * SIZE).map(covered).collect();
            let mask = StoredMask::new(&Mask { width: SIZE, height: SIZE, coverage });
            Silhouette::new(&format!("v{i}"), camera, &mask).unwrap()
        };
        Camera::around(24, 3.5, 40.0, SIZE).unwrap().iter().enumerate().map(view).collect()
    }

    /// The least and the largest x of the mesh.
    fn width(mesh: &Mesh) -> (f32, f32) {
        mesh.positions.iter().fold((f32::MAX, f32::MIN), |(low, high), p| (low.min(p.x), high.max(p.x)))
    }

    #[test]
    fn every_part_that_masks_show_is_kept() {
        let beads = |p: Vec3| ball(p, -0.6, 0.3).min(ball(p, 0.1, 0.25)).min(ball(p, 0.7, 0.2));
        let mesh = extract_parts(&grid(beads), &silhouettes(beads));
        let (low, high) = width(&mesh);
        assert!((low + 0.9).abs() < 0.01 && (high - 0.9).abs() < 0.01, "{low} {high}");
        assert!(mesh.positions.iter().any(|p| (p.x - 0.1).abs() < 0.05), "the bead between them");
        assert!(mesh.triangles.iter().flatten().all(|v| (*v as usize) < mesh.positions.len()));
    }

    #[test]
    fn what_no_mask_needs_is_dropped() {
        let object = |p: Vec3| ball(p, 0.0, 0.6);
        // One floater is beside the object in every mask, a void is within it.
        let found = |p: Vec3| object(p).max(-ball(p, 0.0, 0.2)).min(ball(p, 0.85, 0.1));
        let mesh = extract_parts(&grid(found), &silhouettes(object));
        assert!(width(&mesh).1 < 0.62, "{:?}", width(&mesh));
        assert!(mesh.positions.iter().all(|p| p.length() > 0.5));
    }
}
