//! Placements: an object that is turned over between two rounds of photographs, so that its
//! underside is seen as well.
//!
//! Cameras are given relative to the object: it stays where it is, and the room turns around it.
//! Its light is that of one room all the time, and each placement has a rotation that says how the
//! object lies in it, relative to the first. The lobes of the light, its frame ([`LightFrame`]) and
//! all shadows stay what they are; a view's rotation into the light's frame is that of the frame
//! after that of its placement. A placement in another room has a light of its own
//! ([`LightGroup`]), in the axes of the object.

use super::light_frame::{LightFrame, OwnLightFrame};
use bevy_ecs::prelude::{Component, Resource, World};
use glam::{Mat3, Quat};
use lobelia_geometry::view::Placement;
use serde::{Deserialize, Serialize};

/// Number of a group of photographs that have one light; 0 is that of the scene's own light.
#[derive(Component, Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct LightGroup(pub u32);

impl LightGroup {
    /// The group under the scene's own light.
    pub const OWN: Self = Self(0);
}

/// How well the rotation of a placement is known.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum TurnSource {
    /// It is said.
    Said,
    /// A fit has found it.
    Found,
    /// It is not known: the identity stands for it.
    #[default]
    Unknown,
}

/// The rotation of a placement, and the light there.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PlacementTurn {
    /// From the object's axes (the world's, in which the cameras are) to those that it has in the
    /// first placement.
    pub room_from_object: Quat,
    /// Where it is from.
    pub source: TurnSource,
    /// Whose light shines on it.
    pub light: LightGroup,
}

impl PlacementTurn {
    /// A rotation that is said.
    pub const fn said(room_from_object: Quat) -> Self {
        Self { room_from_object, source: TurnSource::Said, light: LightGroup::OWN }
    }

    /// The placement under a light of its own.
    pub const fn under(light: LightGroup) -> Self {
        Self { light, ..Self::said(Quat::IDENTITY) }
    }
}

/// The placements of the object under the scene's own light, by number; empty if it has only one.
/// The first has the identity.
#[derive(Resource, Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Placements(pub Vec<PlacementTurn>);

impl Placements {
    /// The rotation of a placement.
    pub fn room_from_object(&self, placement: Placement) -> Mat3 {
        let turn = self.0.get(placement.0 as usize).map(|turn| turn.room_from_object);
        turn.map_or(Mat3::IDENTITY, Mat3::from_quat)
    }

    /// Whether photographs have several lights.
    pub fn has_groups(&self) -> bool {
        self.0.iter().any(|turn| turn.light != LightGroup::OWN)
    }

    /// Whose light shines on a placement.
    pub fn light(&self, placement: Placement) -> LightGroup {
        self.0.get(placement.0 as usize).map(|turn| turn.light).unwrap_or_default()
    }
}

/// The rotation from the object's axes into those of the room in the picture that is rendered;
/// without it, the object lies as in the first placement.
#[derive(Resource, Clone, Copy, Debug, PartialEq)]
pub struct PicturePlacement(pub Mat3);

/// The group whose light shines in place of the scene's own: that of the picture that is rendered,
/// or of the step of a fit.
#[derive(Resource, Clone, Copy, Debug, PartialEq, Eq)]
pub struct GroupInTurn(pub LightGroup);

/// The frame of a light, and the placements of the object under it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PlacedFrame {
    /// The frame in which the light stands still.
    pub frame: LightFrame,
    /// The placements.
    pub placements: Placements,
}

impl PlacedFrame {
    /// Returns the frame and placements of the scene's own light.
    pub fn own(world: &World) -> Self {
        let frame = world.get_resource::<OwnLightFrame>().map(|own| own.0).unwrap_or_default();
        Self { frame, placements: world.get_resource::<Placements>().cloned().unwrap_or_default() }
    }

    /// Whether the light stands still around the object.
    pub fn is_still(&self) -> bool {
        let lies = |turn: &PlacementTurn| turn.room_from_object == Quat::IDENTITY;
        self.frame == LightFrame::World && self.placements.0.iter().all(lies)
    }

    /// The rotation from the object's axes (the world's) into the light's frame for a view, given
    /// that from its camera's axes into the world.
    pub fn light_from_world(&self, world_from_camera: Mat3, placement: Placement) -> Mat3 {
        light_from_world(self.frame, world_from_camera, self.placements.room_from_object(placement))
    }
}

/// The rotation from the world into the light's frame for a view of an object that has this
/// rotation in the room.
pub fn light_from_world(frame: LightFrame, world_from_camera: Mat3, room_from_object: Mat3) -> Mat3 {
    frame.light_from_world(room_from_object * world_from_camera) * room_from_object
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    fn placed(frame: LightFrame, turn: Quat) -> PlacedFrame {
        let turns = vec![PlacementTurn::said(Quat::IDENTITY), PlacementTurn::said(turn)];
        PlacedFrame { frame, placements: Placements(turns) }
    }

    #[test]
    fn a_light_in_the_room_turns_against_the_object() {
        let turn = Quat::from_rotation_x(1.2) * Quat::from_rotation_y(0.4);
        let frame = placed(LightFrame::World, turn);
        let camera = Mat3::from_rotation_z(0.3);
        assert_eq!(frame.light_from_world(camera, Placement(0)), Mat3::IDENTITY);
        let up = frame.light_from_world(camera, Placement(1)) * (turn.inverse() * Vec3::Y);
        assert!(up.distance(Vec3::Y) < 1e-6);
        assert!(!frame.is_still() && placed(LightFrame::World, Quat::IDENTITY).is_still());
    }

    #[test]
    fn a_light_before_the_camera_does_not_mind_how_the_object_lies() {
        let camera = Mat3::from_quat(Quat::from_rotation_y(0.7) * Quat::from_rotation_x(0.2));
        let frame = placed(LightFrame::Camera, Quat::from_rotation_x(2.0));
        let [first, second] = [0, 1].map(|k| frame.light_from_world(camera, Placement(k)));
        assert!(first.abs_diff_eq(second, 1e-6));
    }

    #[test]
    fn a_turntable_does_not_mind_how_the_object_is_turned_about_its_axis() {
        let axis = Vec3::Y;
        let camera = Mat3::from_quat(Quat::from_rotation_y(0.7) * Quat::from_rotation_x(0.2));
        let over = Quat::from_rotation_z(2.0);
        let turned = |about: f32| {
            let frame = placed(LightFrame::Turntable(axis), Quat::from_axis_angle(axis, about) * over);
            frame.light_from_world(camera, Placement(1))
        };
        assert!(turned(0.0).abs_diff_eq(turned(2.1), 1e-5));
    }
}
