//! The systems of [`Slot::Optimizer`](crate::pipeline::Slot::Optimizer), in their order.

use super::metal::bound_diffuse_albedo;
use super::roughness::blend::move_blends;
use super::roughness::texel::{move_roughness, tie_specular};
use super::scale::move_scale;
use super::sheen::move_sheen;
use super::systems::{move_lobes, move_specular, move_texels};
use bevy_ecs::prelude::IntoScheduleConfigs;
use bevy_ecs::schedule::ScheduleConfigs;
use bevy_ecs::system::ScheduleSystem;

/// Moves all that a fit may move; roughness varies by the blend of base materials.
pub fn optimizer() -> ScheduleConfigs<ScheduleSystem> {
    (move_scale, move_texels, move_sheen, move_blends, move_lobes, move_specular, bound_diffuse_albedo)
        .chain()
}

/// The same with one roughness per texel, which needs its [prior](super::roughness::texel::RoughnessPrior) and
/// [state](super::roughness::texel::attach_roughness).
pub(crate) fn optimizer_of_texel_roughness() -> ScheduleConfigs<ScheduleSystem> {
    (move_scale, move_texels, move_sheen, move_roughness, move_lobes, tie_specular, move_specular).chain()
}
