//! The surface that a scene describes.

use crate::codec::gltf::import::read_mesh_with_report;
use crate::error::{Error, Result};
use crate::mesh::Surface;
use crate::mesh::atlas::unwrap_mesh;
use crate::mesh::primitive::{box_mesh, sphere_mesh};
use crate::scene::Surface as SurfaceSpec;
use crate::shape::hull::visual_hull;
use crate::shape::hull_repair::check_hull;
use crate::shape::parts::extract_parts;
use crate::shape::silhouette::Silhouette;
use crate::view::{Split, ViewRecord};
use glam::Vec3;
use std::path::Path;

/// What a surface is made for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum SurfaceUse {
    /// All passes.
    Lasting,
    /// Those before a `Shape` puts another in place of an unknown one: a coarse one will do.
    UntilShape,
    /// Checks alone: a speck stands for an unknown one, whose masks a survey has looked at.
    Checks,
}

/// Radius of that speck, world units: no camera is inside.
const SPECK: f32 = 1e-6;

/// Most cells and texels a side of an unknown surface that is to be replaced.
const DRAFT: (u32, u32) = (48, 256);

/// Makes the surface, from the training views' masks where it is unknown; the notes say what was repaired on the way.
///
/// # Errors
/// If the mesh cannot be read or unwrapped.
pub fn make_surface(
    spec: &SurfaceSpec,
    views: &[ViewRecord],
    use_of: SurfaceUse,
) -> Result<(Surface, Vec<String>)> {
    match spec {
        SurfaceSpec::Unknown { cells, texture_size } => match use_of {
            SurfaceUse::Lasting => hull_of_masks(views, *cells, *texture_size),
            SurfaceUse::UntilShape => hull_of_masks(views, DRAFT.0.min(*cells), DRAFT.1.min(*texture_size)),
            SurfaceUse::Checks => Ok((Surface::new(sphere_mesh(Vec3::ZERO, SPECK)?, DRAFT.1)?, Vec::new())),
        },
        SurfaceSpec::Mesh { path, texture_size, own_material } => {
            mesh_of_file(path, *texture_size, *own_material)
        }
        SurfaceSpec::Sphere { center, radius, texture_size } => {
            Ok((Surface::new(sphere_mesh(*center, *radius)?, *texture_size)?, Vec::new()))
        }
        SurfaceSpec::Box { center, size, texture_size } => {
            Ok((Surface::new(box_mesh(*center, *size)?, *texture_size)?, Vec::new()))
        }
    }
}

/// The visual hull of the training views' masks, on a grid of `cells` cells a side.
fn hull_of_masks(views: &[ViewRecord], cells: u32, texture_size: u32) -> Result<(Surface, Vec<String>)> {
    let train = views.iter().filter(|view| view.split == Split::Train);
    let silhouette = |view: &ViewRecord| Silhouette::new(&view.name, &view.camera, view.mask.as_ref()?);
    let mut silhouettes: Vec<Silhouette> = train.filter_map(silhouette).collect();
    let hull = visual_hull(&mut silhouettes, cells, None)?;
    let notes = check_hull(&hull, &silhouettes)?;
    let unwrapped = unwrap_mesh(&extract_parts(&hull, &silhouettes), texture_size)?;
    Ok((Surface::new(unwrapped.mesh, texture_size)?, notes))
}

/// The mesh of a file. Where it is to have its `own_material`, its own texture coordinates have to do.
fn mesh_of_file(path: &Path, texture_size: u32, own_material: bool) -> Result<(Surface, Vec<String>)> {
    let (mesh, report) = read_mesh_with_report(path)?;
    let unwrapped = unwrap_mesh(&mesh, texture_size)?;
    if own_material && unwrapped.charts.is_some() {
        let problem = "its texture coordinates are missing or overlap, so that its own material has no place";
        let help = "Give the material in the scene file, or unwrap the mesh in another program.";
        return Err(Error::input(path, "", problem, help));
    }
    let notes = report.notes().into_iter().chain(unwrapped.note);
    let notes = notes.map(|note| format!("{}: {note}", path.display())).collect();
    Ok((Surface::new(unwrapped.mesh, texture_size)?, notes))
}
