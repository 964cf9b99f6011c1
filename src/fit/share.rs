//! One fit on several processes, which share the samples of each step.
//!
//! All processes ([`Ranks`]) run the same program on the same scene and do everything alike, but for what costs most. In a step that are the systems in
//! [`Slot::Visibility`], [`Slot::Shading`] and [`Slot::ShadingAdjoint`], which run on a process's share of the [`Window`] alone; the
//! results go to all. Besides, the tracing of shadows, their updates, the trials of a start, the shading of the initialization, the visual hull, hollows, outlines, stereo and normals by reflections
//! are divided where they are done ([`Ranks::share`]).
//!
//! | system | stage, slot | does |
//! | --- | --- | --- |
//! | [`take_share`] | Gather, before `Slot::Visibility` | narrows the window to the share |
//! | [`gather_radiance`] | Shade, after `Slot::Shading` | radiance of all samples; the whole window again |
//! | [`take_share_again`] | Gradient, before `Slot::ShadingAdjoint` | narrows the window |
//! | [`gather_adjoints`] | Gradient, after `Slot::ShadingAdjoint` | adjoints of all samples, and of what they share; the whole window again |
//!
//! Shares are whole chunks of the kernels' sums, and what samples share is summed over chunks in the order of chunks: the bits are those of one process, whatever
//! the number of processes. On a graphics adapter the share of a process is one chunk, and sums are the same up to rounding. All processes have the same bits.
//!
//! Photographs belong to the process that has read them ([`OwnedItems`](crate::ranks::owned::OwnedItems)). What is not split, and is done by each: the pool, linear solves, rays of pixels, loss, sums per texel, optimizers, what is between fits, and everything else of a moving shape or camera. While [placements](super::placements) turn,
//! nothing is split, because their system reads the shadows of a whole window.
//!
//! A stop waits ([`HeldStops`](crate::error::stop::HeldStops)) until the processes exchange something, and is then known to all of them. An error of one process ends it, and whoever started the processes has to end the others.

use super::components::StepGradient;
use super::guard::check_adjoints;
use super::placements::PlacementsTurn;
use super::roughness::blend::{BlendAdjoints, PerMaterial};
use crate::math::shading::{CHUNK, Layers, PointAdjoint};
use crate::pipeline::pool::Pool;
use crate::pipeline::{GatherPoints, Phase, Pipeline, Plugin, ScatterAdjoints, Slot, Stage, SystemResult};
use crate::ranks::packed::Message;
use crate::ranks::{Ranks, share};
use crate::sample::pixel::{SampleIndex, Window};
use bevy_ecs::prelude::{IntoScheduleConfigs, Res, ResMut, Resource, World};
use std::ops::Range;

/// The systems that share the samples of a step among processes.
pub struct AllReducePlugin(pub Ranks);

impl Plugin for AllReducePlugin {
    fn build(&self, pipeline: &mut Pipeline) {
        pipeline.world.insert_resource(self.0.clone());
        pipeline.world.init_resource::<WindowShare>();
        let adjoints = gather_adjoints.after(Slot::ShadingAdjoint).before(check_adjoints);
        let adjoints =
            adjoints.before(ScatterAdjoints).before(Slot::ShapeGradient).before(Slot::CameraGradient);
        pipeline
            .add_systems(
                Phase::FitStep,
                Stage::Gather,
                take_share.after(GatherPoints).before(Slot::Visibility),
            )
            .add_systems(Phase::FitStep, Stage::Shade, gather_radiance.after(Slot::Shading))
            .add_systems(Phase::FitStep, Stage::Gradient, take_share_again.before(Slot::ShadingAdjoint))
            .add_systems(Phase::FitStep, Stage::Gradient, adjoints);
    }

    fn cleanup(world: &mut World) {
        world.remove_resource::<Ranks>();
        world.remove_resource::<WindowShare>();
    }
}

/// The window of a step, and whether it is split.
#[derive(Resource, Clone, Debug, Default)]
pub struct WindowShare {
    whole: Range<usize>,
    is_split: bool,
}

impl WindowShare {
    /// Samples of a process, counted from the beginning of the window.
    fn of(&self, rank: usize, size: usize) -> Range<usize> {
        if self.is_split { share(self.whole.len(), CHUNK, rank, size) } else { 0..self.whole.len() }
    }

    /// The window of a process.
    fn window(&self, ranks: &Ranks) -> Range<usize> {
        let own = self.of(ranks.rank(), ranks.size());
        self.whole.start + own.start..self.whole.start + own.end
    }
}

/// Gather: narrows the window to the share of this process.
pub fn take_share(
    ranks: Res<Ranks>,
    turning: Option<Res<PlacementsTurn>>,
    mut window: ResMut<Window>,
    mut share: ResMut<WindowShare>,
) {
    *share = WindowShare { whole: window.0.clone(), is_split: turning.is_none() };
    window.0 = share.window(&ranks);
}

/// Gradient: narrows the window to the share of this process once more.
pub fn take_share_again(ranks: Res<Ranks>, share: Res<WindowShare>, mut window: ResMut<Window>) {
    window.0 = share.window(&ranks);
}

/// Shade: exchanges the radiance of the samples; the window is whole again.
pub fn gather_radiance(
    ranks: Res<Ranks>,
    share: Res<WindowShare>,
    mut window: ResMut<Window>,
    samples: Pool<SampleIndex, &mut Layers>,
) -> SystemResult {
    window.0 = share.whole.clone();
    if !share.is_split {
        return Ok(());
    }
    let mut shaded = samples.rows(share.whole.clone())?;
    let mut message = Message::default();
    message.add_column(&shaded[share.of(ranks.rank(), ranks.size())]);
    for (rank, part) in message.exchange(&ranks)?.iter_mut().enumerate() {
        part.take_column(share.of(rank, ranks.size()), &mut shaded)?;
    }
    Ok(())
}

/// Gradient: exchanges the adjoints of the samples, and sums those of what they share; the window is whole again.
pub fn gather_adjoints(
    ranks: Res<Ranks>,
    share: Res<WindowShare>,
    mut window: ResMut<Window>,
    mut gradient: ResMut<StepGradient>,
    mut blends: ResMut<BlendAdjoints>,
    samples: Pool<SampleIndex, &mut PointAdjoint>,
) -> SystemResult {
    window.0 = share.whole.clone();
    if !share.is_split {
        return Ok(());
    }
    let blended = gradient.is_blended();
    let mut back = samples.rows(share.whole.clone())?;
    let mut message = Message::default();
    message.add_column(&back[share.of(ranks.rank(), ranks.size())]);
    if blended {
        message.add_column(&blends.0);
        blends.0 = vec![PerMaterial::default(); share.whole.len()];
    }
    message.add(gradient.chunk_values());
    let mut parts = message.exchange(&ranks)?;
    for (rank, part) in parts.iter_mut().enumerate() {
        let rows = share.of(rank, ranks.size());
        part.take_column(rows.clone(), &mut back)?;
        if blended {
            part.take_column(rows, &mut blends.0)?;
        }
    }
    let chunks: Vec<f32> = parts.iter().flat_map(|part| part.rest()).copied().collect();
    gradient.set_chunk_values(&chunks);
    Ok(())
}
