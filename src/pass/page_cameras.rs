//! The cameras of a world's views, as pages of the object have them.

use crate::page::PageCamera;
use crate::view::{Camera, Split, ViewName};
use bevy_ecs::prelude::{Entity, World};

/// The cameras of all views: those held out first, each group by name.
pub(super) fn page_cameras(world: &mut World) -> Vec<(Entity, PageCamera)> {
    let mut query = world.query::<(Entity, &ViewName, &Camera, &Split)>();
    let camera = |(view, name, camera, split): (Entity, &ViewName, &Camera, &Split)| {
        (view, PageCamera { name: name.0.clone(), split: *split, camera: *camera, photograph: None })
    };
    let mut cameras: Vec<(Entity, PageCamera)> = query.iter(world).map(camera).collect();
    cameras.sort_by(|(_, a), (_, b)| {
        let key = |c: &PageCamera| (c.split != Split::Test, c.name.clone());
        key(a).cmp(&key(b))
    });
    cameras
}
