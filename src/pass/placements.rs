//! The placements of the object in a run: whether each has photographs, and which one a picture shows.

use crate::error::{Error, Result};
use crate::light::placement::{PicturePlacement, Placements};
use crate::scene::{Pass, Scene, Views};
use crate::view::{Placement, Split, ViewRecord};
use bevy_ecs::prelude::{Entity, World};

/// Checks that each placement has a training photograph, where something is fitted to them.
///
/// # Errors
/// [`Error::Usage`] that names the first without.
pub(super) fn check_placements(scene: &Scene, views: &[ViewRecord]) -> Result<()> {
    let names: Vec<String> = match &scene.views {
        Views::Dataset(data) => data.placements.iter().map(|of| format!("`{}`", of.photographs)).collect(),
        Views::Photographed(spec) => (1..=spec.truth.rounds()).map(|round| round.to_string()).collect(),
        Views::Cameras(_) => Vec::new(),
    };
    let fits = scene.passes.iter().any(|pass| matches!(pass, Pass::Fit(_) | Pass::Shape(_)));
    let is_seen = |number: usize| {
        views.iter().any(|view| view.split == Split::Train && view.placement.0 as usize == number)
    };
    match (0..names.len()).find(|number| fits && !is_seen(*number)) {
        Some(number) => Err(Error::usage(
            format!("no training photograph shows the placement {}", names[number]),
            "A photograph belongs to the first entry of `placements` that it suits: say the longer name first, or leave the entry out.",
        )),
        None => Ok(()),
    }
}

/// Pictures to come show the object as it lies in this view.
pub(super) fn show_placement(world: &mut World, view: Entity) {
    let placement = world.get::<Placement>(view).copied().unwrap_or_default();
    let shown = world.get_resource::<Placements>().map(|all| PicturePlacement::new(all, placement));
    shown.into_iter().for_each(|shown| world.insert_resource(shown));
}
