//! Surfaces: meshes, primitives, ray casting and the texel atlas.
//!
//! A mesh comes from a file or from [`primitive`], gets texture coordinates
//! ([`atlas::unwrap_mesh`]) and becomes a [`Surface`]: a resource that answers rays with positions,
//! normals and texel addresses.
//!
//! There is no plugin here: a surface is built once, before a run, and inserted into the world as a
//! resource; the Trace stage reads it through [`Intersect`].
//!
//! ```
//! use glam::Vec3;
//! use lobelia_geometry::mesh::{Surface, primitive::box_mesh};
//! use lobelia_sg::ray::{Intersect, Ray};
//!
//! let surface = Surface::new(box_mesh(Vec3::ZERO, Vec3::splat(2.0))?, 64)?;
//! let ray = Ray { origin: Vec3::new(0.2, 0.3, 5.0), direction: Vec3::NEG_Z };
//! let hit = surface.intersect(&ray, 0.0);
//! assert!(hit.is_some_and(|hit| (hit.distance - 4.0).abs() < 1e-5 && hit.normal.z > 0.999));
//! assert!(surface.is_inside(Vec3::ZERO));
//! # Ok::<(), lobelia_geometry::Error>(())
//! ```

pub mod atlas;
pub mod bvh;
pub mod decimate;
pub mod nearest;
pub mod primitive;
pub mod tangents;
pub mod triangles;
mod wide_bvh;

use crate::{Error, Result};
use atlas::{TexelAtlas, address};
use bevy_ecs::prelude::Resource;
use bvh::{PACKET, TriangleBvh, TriangleHit};
use glam::{Vec2, Vec3};
use lobelia_sg::ray::{Hit, Intersect, Ray};
use triangles::Mesh;

/// The largest coordinate of a surface, in world units: squares of areas of boxes must stay finite
/// in `f32`.
pub const MAX_COORDINATE: f32 = 1e9;

/// The largest side of an atlas, in texels.
pub const MAX_TEXTURE_SIZE: u32 = 16384;

/// A triangle surface, ready to be traced.
#[derive(Resource)]
pub struct Surface {
    mesh: Mesh,
    atlas: TexelAtlas,
    bvh: TriangleBvh,
    /// Unit normal of each flat triangle.
    geometric_normals: Vec<Vec3>,
}

impl Surface {
    /// Builds the atlas (`texture_size`² texels) and the hierarchy of a mesh that has texture
    /// coordinates (from [`atlas::unwrap_mesh`]).
    ///
    /// # Errors
    /// [`Error::Usage`] for a texture size out of range; [`Error::Run`] for a mesh without
    /// triangles or texture coordinates, with degenerate triangles, with arrays of different
    /// lengths, or that is not finite.
    pub fn new(mesh: Mesh, texture_size: u32) -> Result<Self> {
        if !(1..=MAX_TEXTURE_SIZE).contains(&texture_size) {
            let problem = format!("the texture size {texture_size} is out of range");
            return Err(Error::usage(problem, format!("choose a size from 1 to {MAX_TEXTURE_SIZE}")));
        }
        check(&mesh).map_err(|problem| Error::run("making a surface", problem))?;
        let atlas = TexelAtlas::new(&mesh, texture_size, texture_size);
        let bvh = TriangleBvh::new(&mesh);
        let geometric_normals = (0..mesh.triangles.len()).map(|t| mesh.geometric_normal(t)).collect();
        Ok(Self { mesh, atlas, bvh, geometric_normals })
    }

    /// The triangles.
    pub fn mesh(&self) -> &Mesh {
        &self.mesh
    }

    /// The texels.
    pub fn atlas(&self) -> &TexelAtlas {
        &self.atlas
    }

    /// Center and radius of a sphere around the surface, world units.
    pub fn bounding_sphere(&self) -> (Vec3, f32) {
        self.bvh.bounding_sphere()
    }

    /// Whether `point` is enclosed by the surface: most of five rays from it cross an odd number of
    /// triangles.
    ///
    /// For an open mesh the result is meaningful only where the mesh is nearly closed.
    pub fn is_inside(&self, point: Vec3) -> bool {
        const DIRECTIONS: [[f32; 3]; 5] = [
            [0.3127, 0.8419, 0.4397],
            [-0.7031, 0.2293, 0.6731],
            [0.5417, -0.7717, 0.3331],
            [-0.2273, -0.4159, -0.8807],
            [0.8273, 0.1931, -0.5273],
        ];
        let odd = DIRECTIONS.into_iter().filter(|&direction| {
            let ray = Ray { origin: point, direction: Vec3::from(direction).normalize() };
            self.bvh.count(&ray, 0.0, f32::INFINITY, usize::MAX) % 2 == 1
        });
        odd.count() >= 3
    }

    /// The nearest hit of a ray beyond `min_distance`.
    pub fn nearest(&self, ray: &Ray, min_distance: f32) -> Option<TriangleHit> {
        self.bvh.nearest(ray, min_distance)
    }

    /// The surface point of a hit on this surface's mesh.
    pub fn hit(&self, found: TriangleHit) -> Hit {
        let triangle = found.triangle as usize;
        let corners = self.mesh.triangles[triangle].map(|v| v as usize);
        let blend = |values: &[Vec3]| -> Vec3 { (0..3).map(|k| values[corners[k]] * found.weights[k]).sum() };
        let geometric_normal = self.geometric_normals[triangle];
        let (position, normal) = (blend(&self.mesh.positions), blend(&self.mesh.normals));
        let normal = normal.try_normalize().unwrap_or(geometric_normal);
        let uvs = self.mesh.uvs.as_deref().unwrap_or_default();
        let uv: Vec2 = (0..3).map(|k| uvs[corners[k]] * found.weights[k]).sum();
        let texels = address(uv, self.atlas.width, self.atlas.height);
        Hit { distance: found.distance, position, normal, geometric_normal, uv, texels }
    }
}

impl Intersect for Surface {
    fn intersect(&self, ray: &Ray, min_distance: f32) -> Option<Hit> {
        self.nearest(ray, min_distance).map(|found| self.hit(found))
    }

    fn intersect_packet(
        &self,
        origin: Vec3,
        directions: &[Vec3],
        min_distance: f32,
        hits: &mut [Option<Hit>],
    ) {
        for (hits, directions) in hits.chunks_mut(PACKET).zip(directions.chunks(PACKET)) {
            let found = self.bvh.nearest_of_packet(origin, directions, min_distance);
            hits.iter_mut().zip(found).for_each(|(hit, found)| *hit = found.map(|found| self.hit(found)));
        }
    }

    fn occluded(&self, ray: &Ray, min_distance: f32, max_distance: f32) -> bool {
        self.bvh.any(ray, min_distance, max_distance)
    }

    fn radius(&self) -> f32 {
        self.bounding_sphere().1
    }

    fn bounds(&self) -> Option<(Vec3, Vec3)> {
        self.mesh.bounds()
    }
}

fn check(mesh: &Mesh) -> std::result::Result<(), String> {
    let Some(uvs) = &mesh.uvs else { return Err("the mesh has no texture coordinates".to_owned()) };
    mesh.check_lists()?;
    if mesh.triangles.is_empty() {
        return Err("the mesh has no triangles".to_owned());
    }
    for (vertex, at) in mesh.positions.iter().enumerate() {
        if !(mesh.normals[vertex].is_finite() && uvs[vertex].is_finite()) {
            return Err(format!("vertex {vertex} is not finite"));
        }
        if at.abs().max_element() > MAX_COORDINATE {
            return Err(format!(
                "vertex {vertex} is at {at}: coordinates must be at most {MAX_COORDINATE:e}"
            ));
        }
    }
    match (0..mesh.triangles.len()).find(|&t| mesh.is_degenerate(t)) {
        Some(bad) => Err(format!("triangle {bad} has no area (drop degenerate triangles first)")),
        None => Ok(()),
    }
}

#[cfg(test)]
pub(crate) mod tests;
