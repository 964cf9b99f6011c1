//! The training photographs and masks as slices.

use crate::error::stop::is_stopping;
use crate::shape::silhouette::Silhouette;
use crate::shape::stereo::{StereoView, TrainingViews};
use crate::view::Placement;
use crate::view::{Camera, Photograph, Split, ViewIndex, ViewMask, ViewName};
use bevy_ecs::prelude::{With, World};
use rayon::prelude::*;

/// Hands the training photographs with their masks to `use_of`.
pub(super) fn with_training_views<T>(world: &mut World, use_of: impl FnOnce(&TrainingViews) -> T) -> T {
    type View = (
        &'static ViewIndex,
        &'static Camera,
        &'static Photograph,
        &'static ViewMask,
        &'static Split,
        Option<&'static Placement>,
    );
    let mut query = world.query::<View>();
    let mut train: Vec<_> = query.iter(world).filter(|(.., split, _)| **split == Split::Train).collect();
    train.sort_by_key(|(index, ..)| **index);
    let views: Vec<StereoView> = train
        .into_iter()
        .map(|(_, camera, photograph, mask, _, placement)| {
            let placement = placement.copied().unwrap_or_default();
            StereoView { camera, photograph, mask: &mask.0, placement }
        })
        .collect();
    use_of(&TrainingViews::new(views, world.get_resource(), |view| view.photograph.keeper()))
}

type SilhouetteView =
    (&'static ViewIndex, &'static ViewName, &'static Camera, &'static ViewMask, &'static Split);

/// The silhouettes of the training masks, in the order of their views.
pub(crate) fn training_silhouettes(world: &mut World) -> Vec<Silhouette> {
    let mut views = world.query_filtered::<SilhouetteView, With<Photograph>>();
    let mut train: Vec<_> = views.iter(world).filter(|(.., split)| **split == Split::Train).collect();
    train.sort_by_key(|(index, ..)| **index);
    let silhouette = |(index, name, camera, mask, _): (&ViewIndex, &ViewName, &Camera, &ViewMask, _)| {
        Some(Silhouette::new(&name.0, camera, &mask.0)?.of_view(*index))
    };
    train.into_par_iter().filter(|_| !is_stopping()).filter_map(silhouette).collect()
}
