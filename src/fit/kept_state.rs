//! What of a fit is state: registered for checkpoints and trials.

use super::by_view::ViewSums;
use super::cameras::{CameraFit, CameraPose};
use super::components::{AlbedoMoments, LobeMoments, SpecularMoments};
use super::exposure::Exposures;
use super::guard::StepGuard;
use super::initialization::start::FramesTried;
use super::placements::TurnSums;
use super::roughness::blend::BlendMoments;
use super::roughness::texel::{RoughnessMoments, TexelRoughness};
use super::scale::ScaleMoments;
use super::sheen::SheenMoments;
use super::sheen::evidence::SheenEvidence;
use crate::checkpoint::{Span, keep_each, keep_keyed, keep_pool, keep_resource};
use crate::light::LightLobe;
use crate::light::groups::FittedLobe;
use crate::light::light_frame::OwnLightFrame;
use crate::light::placement::Placements;
use crate::material::{
    BaseMaterial, DiffuseAlbedo, DiffuseSheen, DiffuseTilt, SpecularBlend, SpecularLobe, TexelIndex,
};
use crate::view::{Camera, ViewIndex, ViewName};
use bevy_ecs::prelude::{With, World};

/// Registers what a fit, or a pass after it, goes on from.
pub(super) fn keep_state(world: &mut World) {
    keep_each::<LightLobe, FittedLobe>(world, Span::Run);
    keep_keyed::<BaseMaterial, SpecularLobe, With<SpecularLobe>>(world, Span::Run);
    keep_keyed::<ViewIndex, Camera, With<ViewName>>(world, Span::Run);
    keep_keyed::<ViewIndex, CameraPose, With<ViewName>>(world, Span::Run);
    keep_pool::<TexelIndex, DiffuseAlbedo>(world, Span::Run);
    keep_pool::<TexelIndex, DiffuseSheen>(world, Span::Run);
    keep_pool::<TexelIndex, DiffuseTilt>(world, Span::Run);
    keep_pool::<TexelIndex, SpecularBlend>(world, Span::Run);
    keep_pool::<TexelIndex, TexelRoughness>(world, Span::Run);
    keep_resource::<OwnLightFrame>(world, Span::Run);
    keep_resource::<Placements>(world, Span::Run);
    keep_resource::<Exposures>(world, Span::Run);
    keep_resource::<CameraFit>(world, Span::Run);
    keep_resource::<StepGuard>(world, Span::Run);
    keep_resource::<ViewSums>(world, Span::Pass);
    keep_each::<LobeMoments, FittedLobe>(world, Span::Pass);
    keep_keyed::<BaseMaterial, SpecularMoments, With<SpecularLobe>>(world, Span::Pass);
    keep_pool::<TexelIndex, AlbedoMoments>(world, Span::Pass);
    keep_pool::<TexelIndex, SheenMoments>(world, Span::Pass);
    keep_pool::<TexelIndex, BlendMoments>(world, Span::Pass);
    keep_pool::<TexelIndex, RoughnessMoments>(world, Span::Pass);
    keep_resource::<ScaleMoments>(world, Span::Pass);
    keep_resource::<TurnSums>(world, Span::Pass);
    keep_resource::<FramesTried>(world, Span::Pass);
    keep_resource::<SheenEvidence>(world, Span::Pass);
}
