//! Looking at a shape while it is fitted (`--debug-every N`): its normals and depth from one camera, and its mesh.

use crate::codec::gltf::export::write_glb;
use crate::codec::png_file::write_rgb8;
use crate::error::Result;
use crate::math::ray::{Hit, Intersect};
use crate::sdf::extract::extract_mesh;
use crate::sdf::volume::SdfSurface;
use crate::view::Camera;
use image::{Rgb, RgbImage};
use rayon::prelude::*;
use std::path::PathBuf;

/// Writes `normal_STEP.png`, `depth_STEP.png` and `mesh_STEP.glb` into a folder.
pub(crate) struct ShapeInspector {
    /// Steps from one look to the next ≥ 1.
    pub every: u32,
    /// Where the files go.
    pub folder: PathBuf,
    /// Where it is seen from; without one only the mesh is written.
    pub camera: Option<Camera>,
}

impl ShapeInspector {
    /// Writes what the shape is at `step`, counted over all levels.
    ///
    /// # Errors
    /// If a file cannot be written, or the shape is empty.
    pub fn look(&self, surface: &SdfSurface, step: u32) -> Result<()> {
        std::fs::create_dir_all(&self.folder).map_err(crate::Error::io("create", &self.folder))?;
        let path = |kind: &str, ending: &str| self.folder.join(format!("{kind}_{step:06}.{ending}"));
        if let Some(camera) = &self.camera {
            let hits = cast(surface, camera);
            write_rgb8(path("normal", "png"), &normal_picture(camera, &hits))?;
            write_rgb8(path("depth", "png"), &depth_picture(camera, &hits))?;
        }
        write_glb(&path("mesh", "glb"), &extract_mesh(&surface.grid), None)
    }
}

fn cast(surface: &SdfSurface, camera: &Camera) -> Vec<Option<Hit>> {
    let pixels = (0..camera.width * camera.height).into_par_iter();
    let center = |i: u32| ((i % camera.width) as f32 + 0.5, (i / camera.width) as f32 + 0.5);
    pixels.map(|i| surface.intersect(&camera.ray(center(i).0, center(i).1), 0.0)).collect()
}

/// World normals, from [-1, 1] to [0, 255].
fn normal_picture(camera: &Camera, hits: &[Option<Hit>]) -> RgbImage {
    let byte = |x: f32| (127.5 * (x + 1.0)).round() as u8;
    picture(camera, |i| hits[i].map_or([0; 3], |hit| hit.normal.to_array().map(byte)))
}

/// Distance along the ray: the nearest point white, the farthest dark gray, nothing black.
fn depth_picture(camera: &Camera, hits: &[Option<Hit>]) -> RgbImage {
    let distances = || hits.iter().flatten().map(|hit| hit.distance);
    let (near, far) = (distances().fold(f32::INFINITY, f32::min), distances().fold(0.0, f32::max));
    let gray = |distance: f32| (255.0 - 200.0 * (distance - near) / (far - near).max(1e-12)) as u8;
    picture(camera, |i| hits[i].map_or([0; 3], |hit| [gray(hit.distance); 3]))
}

fn picture(camera: &Camera, pixel: impl Fn(usize) -> [u8; 3]) -> RgbImage {
    RgbImage::from_fn(camera.width, camera.height, |x, y| Rgb(pixel((y * camera.width + x) as usize)))
}
