//! What each view shows at each vertex.

use crate::error::Result;
use crate::light::placement::PlacedFrame;
use crate::math::ray::Ray;
use crate::math::statistics::median;
use crate::mesh::bvh::TriangleBvh;
use crate::mesh::triangles::Mesh;
use crate::shape::stereo::votes::Shell;
use crate::shape::stereo::{StereoView, TrainingViews};
use crate::view::raster::bilinear;
use glam::{Mat3, Vec3};
use rayon::prelude::*;

/// Least cosine between the direction to a view and the normal of the mesh.
const LEAST_COSINE: f32 = 0.25;
/// Coverage that all pixels around the projection of a vertex must have.
const COVERED: f32 = 0.99;
/// Start of the ray to a view above the surface, in mean edges.
const LIFT: f32 = 0.3;
/// Radiance, relative to the median, that is added to that of a sight for its weight: noise of dark pixels counts less than that of bright ones,
/// relative to their value more.
const FLOOR: f32 = 0.5;

/// What one view shows at a vertex.
#[derive(Clone, Copy, Debug)]
pub struct VertexSight {
    /// Row of the view.
    pub view: u32,
    /// Rotation from the world into the light's frame.
    pub light_from_world: Mat3,
    /// Unit direction to the camera, in the light's frame.
    pub to_view: Vec3,
    /// Linear radiance.
    pub radiance: Vec3,
    /// Weight of a squared difference, in units of 1 / radiance.
    pub weight: f32,
}

impl VertexSight {
    /// A world direction in the light's frame.
    #[inline]
    pub fn in_light(&self, world: Vec3) -> Vec3 {
        self.light_from_world * world
    }

    /// The direction that a surface with this world normal mirrors to the view, in the light's frame.
    #[inline]
    pub fn mirrored(&self, normal: Vec3) -> Vec3 {
        let normal = self.in_light(normal);
        2.0 * normal.dot(self.to_view) * normal - self.to_view
    }
}

/// What the views that see it show at each merged vertex of `shell`.
pub(crate) fn sights(
    mesh: &Mesh,
    shell: &Shell,
    normals: &[Vec3],
    views: &TrainingViews,
    frame: &PlacedFrame,
) -> Result<Vec<Vec<VertexSight>>> {
    let bvh = TriangleBvh::new(mesh);
    let lift = LIFT * shell.graph.mean_edge(&shell.positions);
    let of_view = |_, view: &StereoView| -> Vec<(u32, Vec3, Vec3)> {
        let of_vertex = |i: usize| {
            let (to_view, radiance) = shown_by(view, &bvh, shell.positions[i], normals[i], lift)?;
            Some((i as u32, to_view, radiance))
        };
        (0..normals.len()).into_par_iter().filter_map(of_vertex).collect()
    };
    let mut all = vec![Vec::new(); normals.len()];
    views.each_in_turn(of_view, |number, shown| {
        let StereoView { camera, placement, .. } = views.items[number];
        let light_from_world = frame.light_from_world(camera.world_from_camera.matrix3.into(), placement);
        for (vertex, to_view, radiance) in shown {
            let (view, to_view) = (number as u32, light_from_world * to_view);
            all[vertex as usize].push(VertexSight { view, light_from_world, to_view, radiance, weight: 1.0 });
        }
    })?;
    all.iter_mut().for_each(Vec::shrink_to_fit);
    weigh(&mut all);
    Ok(all)
}

/// Sets the weights.
fn weigh(all: &mut [Vec<VertexSight>]) {
    let mean = |sight: &VertexSight| sight.radiance.element_sum() / 3.0;
    let mut some: Vec<f32> = all.iter().filter_map(|sights| sights.first()).map(mean).collect();
    let floor = (FLOOR * median(&mut some).unwrap_or(0.0)).max(f32::MIN_POSITIVE);
    for sight in all.iter_mut().flatten() {
        sight.weight = 1.0 / (floor + mean(sight));
    }
}

/// The world direction to a view, and the radiance that it shows at a point with this normal; `None` if it does not see it.
fn shown_by(view: &StereoView, bvh: &TriangleBvh, at: Vec3, normal: Vec3, lift: f32) -> Option<(Vec3, Vec3)> {
    let offset = view.camera.position() - at;
    let (distance, to_view) = (offset.length(), offset.normalize_or_zero());
    if normal.dot(to_view) < LEAST_COSINE {
        return None;
    }
    let (x, y, _) = view.camera.project(at)?;
    let (width, height) = (view.camera.width, view.camera.height);
    let inside = x >= 0.5 && y >= 0.5 && x <= width as f32 - 0.5 && y <= height as f32 - 0.5;
    if !inside {
        return None;
    }
    let taps = bilinear(width, height, x - 0.5, y - 0.5);
    if taps.iter().any(|(pixel, _)| view.mask.coverage(*pixel) < COVERED) {
        return None;
    }
    let ray = Ray { origin: at + lift * normal, direction: to_view };
    let radiance = || taps.iter().map(|(pixel, weight)| view.photograph.radiance(*pixel) * *weight).sum();
    (!bvh.any(&ray, 0.0, distance)).then(|| (to_view, radiance()))
}
