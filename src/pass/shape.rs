//! The `Shape` pass: recovers an unknown surface from photographs and masks, and says where it
//! came.

use crate::object::{Object, progress::Step};
use crate::{pass::fit::write_views, scene::ShapePass};
use bevy_ecs::prelude::World;
use image::{Rgb, RgbImage};
use lobelia_geometry::error::{Error, Result};
use lobelia_geometry::{parallel, sdf::extract::extract_mesh, view::Camera};
use lobelia_io::codec::{gltf::export::write_glb, png_file::write_rgb8};
use lobelia_sg::{ray::Hit, ray::Intersect};
use lobelia_solve::shape::field::SdfField;
use std::path::Path;

/// Runs the pass.
///
/// # Errors
/// If the surface of the scene is not unknown, the masks have no hull, or a fit fails.
pub(crate) fn run(object: &mut Object, out: &Path, pass: &ShapePass) -> Result<()> {
    let stopped = object.find_shape(pass)?;
    write_views(object, out, &pass.name, pass.cameras)?;
    if stopped { Err(Error::Interrupted) } else { Ok(()) }
}

/// Writes what a shape is at a step (`--debug-every`) as `normal_STEP.png`, `depth_STEP.png` and
/// `mesh_STEP.glb` into the folder of its pass; without a camera only the mesh.
pub(super) fn look(out: &Path, at: &Step, world: &mut World) -> Result<()> {
    let camera = world.query::<&Camera>().iter(world).next().copied();
    let Some(SdfField { surface, .. }) = world.get_resource() else { return Ok(()) };
    let (folder, step) = (out.join(at.pass).join("debug"), at.step);
    std::fs::create_dir_all(&folder).map_err(Error::io("create", &folder))?;
    let path = |kind: &str, ending: &str| folder.join(format!("{kind}_{step:06}.{ending}"));
    if let Some(camera) = camera {
        let hit = |pixel: usize| surface.intersect(&camera.pixel_ray(pixel as u32), 0.0);
        let hits: Vec<_> = parallel::map((camera.width * camera.height) as usize, 1024, hit);
        let picture = |color: &dyn Fn(&Hit) -> [u8; 3]| {
            let pixel = |x: u32, y: u32| hits[(y * camera.width + x) as usize].as_ref().map_or([0; 3], color);
            RgbImage::from_fn(camera.width, camera.height, |x, y| Rgb(pixel(x, y)))
        };
        // World normals, from [-1, 1] to [0, 255].
        let byte = |x: f32| (127.5 * (x + 1.0)).round() as u8;
        write_rgb8(path("normal", "png"), &picture(&|hit| hit.normal.to_array().map(byte)))?;
        // Distance along the ray: the nearest point white, the farthest dark gray, nothing black.
        let distances = || hits.iter().flatten().map(|hit| hit.distance);
        let (near, far) = (distances().fold(f32::INFINITY, f32::min), distances().fold(0.0, f32::max));
        let gray = |distance: f32| (255.0 - 200.0 * (distance - near) / (far - near).max(1e-12)) as u8;
        write_rgb8(path("depth", "png"), &picture(&|hit| [gray(hit.distance); 3]))?;
    }
    write_glb(&path("mesh", "glb"), &extract_mesh(&surface.grid), None)
}
