//! Rotations from the world into the frame of a light that does not stand still in it.

use crate::light::lights::IncidentLight;
use crate::light::placement::PlacedFrame;
use crate::view::Placement;
use crate::view::{Camera, Photograph, ViewIndex};
use bevy_ecs::prelude::{Query, Res, With};
use bevy_ecs::system::SystemParam;
use glam::Mat3;

/// The rotation of each photograph, as a system parameter.
#[derive(SystemParam)]
pub struct LightTurns<'w, 's> {
    light: Res<'w, IncidentLight>,
    views: Query<'w, 's, (&'static ViewIndex, &'static Camera, Option<&'static Placement>), With<Photograph>>,
}

impl LightTurns<'_, '_> {
    /// The rotations for the light of this run.
    pub fn table(&self) -> TurnTable {
        let view = |(index, camera, placement): (&ViewIndex, &Camera, Option<&Placement>)| {
            (*index, *camera, placement.copied().unwrap_or_default())
        };
        TurnTable::new(&self.light.frame, self.views.iter().map(view))
    }
}

/// The rotation from the world into the light's frame of each view, by its index; empty for a light that stands still in the world.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TurnTable(Vec<Option<Mat3>>);

impl TurnTable {
    /// The rotations of these views, each of a placement of the object, for a light in this frame.
    pub fn new(frame: &PlacedFrame, views: impl Iterator<Item = (ViewIndex, Camera, Placement)>) -> Self {
        let mut table = Vec::new();
        if frame.is_still() {
            return Self(table);
        }
        for (index, camera, placement) in views {
            let index = index.0 as usize;
            if table.len() <= index {
                table.resize(index + 1, None);
            }
            table[index] = Some(frame.light_from_world(camera.world_from_camera.matrix3.into(), placement));
        }
        Self(table)
    }

    /// The rotation of one view; `None` if the light stands still in the world.
    #[inline]
    pub fn of(&self, view: ViewIndex) -> Option<Mat3> {
        self.0.get(view.0 as usize).copied().flatten()
    }

    /// All rotations, by the views' indices; `None` where there is no photograph.
    pub fn all(&self) -> &[Option<Mat3>] {
        &self.0
    }
}
