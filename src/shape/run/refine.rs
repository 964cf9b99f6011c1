//! What brings the surface that a fit has found closer to the photographs themselves: masks, neighbors, reflections.

use crate::error::Result;
use crate::light::placement::PlacedFrame;
use crate::mesh::triangles::Mesh;
use crate::sdf::volume::SdfSurface;
use crate::shape::field::ModelError;
use crate::shape::hollows::keep_empty;
use crate::shape::hull::trim;
use crate::shape::mirror::{NormalReport, refine_normals};
use crate::shape::outline::{OutlineReport, fit_outlines};
use crate::shape::run::training::{training_silhouettes, with_training_views};
use crate::shape::stereo::{StereoGuides, StereoReport, refine};
use bevy_ecs::prelude::World;
use std::ops::ControlFlow;

/// Removes from the found field what lies outside the hull, and moves its contours to the outlines of the training masks
/// ([`outline`](crate::shape::outline)).
///
/// # Errors
/// If another process is gone.
pub(crate) fn refine_by_outlines(world: &mut World, surface: &mut SdfSurface) -> Result<OutlineReport> {
    let mut silhouettes = training_silhouettes(world);
    let grid = &mut surface.grid;
    trim(grid, &mut silhouettes);
    if let Some(empty) = &surface.empty {
        keep_empty(grid, empty);
    }
    grid.redistance_near();
    fit_outlines(grid, &silhouettes, world.get_resource())
}

/// Moves the vertices of a mesh of the found surface to where the training photographs agree ([`stereo`](crate::shape::stereo)).
/// Nothing moves without a [`ModelError`] in the world, which this removes.
///
/// # Errors
/// If another process is gone.
pub(crate) fn refine_by_stereo(
    world: &mut World,
    mesh: &mut Mesh,
    go_on: impl FnMut(usize) -> ControlFlow<()>,
) -> Result<StereoReport> {
    let Some(error) = world.remove_resource::<ModelError>() else { return Ok(StereoReport::default()) };
    let silhouettes = training_silhouettes(world);
    let known = StereoGuides { silhouettes: &silhouettes, error: &error };
    with_training_views(world, |views| refine(mesh, views, &known, go_on))
}

/// Gives the vertices of a mesh of the found surface normals that explain what it mirrors ([`mirror`](crate::shape::mirror)).
///
/// # Errors
/// If another process is gone.
pub(crate) fn refine_by_mirror(
    world: &mut World,
    mesh: &mut Mesh,
    go_on: impl FnMut(usize) -> ControlFlow<()>,
) -> Result<NormalReport> {
    let frame = PlacedFrame::own(world);
    with_training_views(world, |views| refine_normals(mesh, views, &frame, go_on))
}
