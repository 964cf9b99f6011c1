//! Rotations from the world into the frame of a light that does not stand still in it.

use crate::light::light_frame::LightFrame;
use crate::light::lights::IncidentLight;
use crate::view::{Camera, Photograph, ViewIndex};
use bevy_ecs::prelude::{Query, Res, With};
use bevy_ecs::system::SystemParam;
use glam::Mat3;

/// The rotation of each photograph, as a system parameter.
#[derive(SystemParam)]
pub struct LightTurns<'w, 's> {
    light: Res<'w, IncidentLight>,
    views: Query<'w, 's, (&'static ViewIndex, &'static Camera), With<Photograph>>,
}

impl LightTurns<'_, '_> {
    /// The rotations for the light of this run.
    pub fn table(&self) -> TurnTable {
        TurnTable::new(self.light.frame, self.views.iter().map(|(index, camera)| (*index, camera)))
    }
}

/// The rotation from the world into the light's frame of each view, by its index; empty for a light that stands still in the world.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TurnTable(Vec<Option<Mat3>>);

impl TurnTable {
    /// The rotations of these views for a light in this frame.
    pub fn new<'a>(frame: LightFrame, views: impl Iterator<Item = (ViewIndex, &'a Camera)>) -> Self {
        let mut table = Vec::new();
        if frame == LightFrame::World {
            return Self(table);
        }
        for (index, camera) in views {
            let index = index.0 as usize;
            if table.len() <= index {
                table.resize(index + 1, None);
            }
            table[index] = Some(frame.light_from_world(camera.world_from_camera.matrix3.into()));
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
