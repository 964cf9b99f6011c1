//! Running a fit: prepare the pool, make a first guess, step until done.

use crate::error::Result;
use crate::fit::components::{
    AlbedoGradient, AlbedoMoments, LobeGradient, LobeMoments, LossState, SpecularGradient, SpecularMoments,
    StepGradient, StepRates, TexelSeen, Unknowns,
};
use crate::fit::exposure::{Exposures, find_exposures};
use crate::fit::initialization::make_first_guess;
use crate::fit::loss::{Loss, LossSums};
use crate::fit::observe::{Candidates, PixelChoice, choose_pixels, count_seen_texels, trace_pixels};
use crate::fit::roughness::blend::{
    BlendAdjoints, BlendGradient, BlendMoments, TexelPlaces, move_blends, scatter_to_blends,
};
use crate::fit::scale::{ScaleMoments, ScaleRule, move_scale, start_scale};
use crate::fit::systems::{
    compare_with_photographs, hand_out_gradient, move_lobes, move_specular, move_texels, pull_back_radiance,
    scatter_to_texels,
};
use crate::light::LightLobe;
use crate::material::{DiffuseAlbedo, SpecularLobe};
use crate::math::shading::ClosedForm;
use crate::pipeline::{Phase, Pipeline, Plugin, Slot, Stage};
use crate::sample::bundle::despawn_pool;
use crate::sample::pixel::{PixelOf, Window};
use crate::shade::{
    IncidentLight, ShadingForm, gather_blends, gather_points, provide_lobes, shade_closed_form,
};
use crate::visibility::{ObjectVisibility, RefreshDue, add_visibility, remove_visibility};
use bevy_ecs::prelude::{Entity, IntoScheduleConfigs, With, Without, World};
use glam::Vec3;
use std::ops::ControlFlow;
use std::time::Instant;

/// Settings of a fit.
#[derive(Clone, Debug, PartialEq)]
pub struct FitOptions {
    /// What is minimised.
    pub loss: Loss,
    /// The closed form that shades.
    pub form: ClosedForm,
    /// Update steps.
    pub steps: u32,
    /// Pixels a step.
    pub batch: usize,
    /// Rates at the first step.
    pub rates: [f32; 3],
    /// Fractions of the fit after which the rates are multiplied by `decay`.
    pub milestones: Vec<f32>,
    /// Factor on the rates at a milestone.
    pub decay: f32,
    /// Which parameters move.
    pub unknowns: Unknowns,
    /// Which pixels are visited.
    pub pixels: PixelChoice,
    /// What is guessed from the data before the first step.
    pub guess: FirstGuess,
    /// Whether shading knows of shadows and reflections; the world then needs an [`ObjectVisibility`].
    pub visibility: bool,
    /// Whether each photograph's exposure is unknown.
    pub exposure: bool,
    /// What decides the scale between light and albedo, if both are unknown.
    pub scale: ScaleRule,
}

/// What a fit guesses before its first step, of what is unknown; the rest starts from its present value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FirstGuess {
    /// The amplitudes of the light.
    pub light: bool,
    /// The albedo.
    pub albedo: bool,
}

impl FirstGuess {
    /// Light and albedo.
    pub const ALL: Self = Self { light: true, albedo: true };
    /// Nothing: a fit that goes on from another.
    pub const NONE: Self = Self { light: false, albedo: false };
}

/// What a caller sees of a running fit.
#[derive(Clone, Copy, Debug)]
pub struct FitProgress {
    /// Step just done, from 1.
    pub step: u32,
    /// Steps in all.
    pub steps: u32,
    /// Sums over the last pass through the pool's windows.
    pub sums: LossSums,
    /// The specular lobe now.
    pub specular: SpecularLobe,
    /// Seconds since the fit began.
    pub elapsed_secs: f64,
}

/// What a fit leaves behind.
#[derive(Clone, Copy, Debug)]
pub struct FitSummary {
    /// Steps done.
    pub steps: u32,
    /// Pixels in the pool.
    pub pixels: usize,
    /// Seconds in all, first guess included.
    pub elapsed_secs: f64,
    /// Whether the caller stopped it early.
    pub stopped: bool,
}

/// The fit's systems: Adam on texels, light lobes and the specular lobe, with closed-form shading.
pub struct FitPlugin;

impl Plugin for FitPlugin {
    fn build(&self, pipeline: &mut Pipeline) {
        pipeline.world.init_resource::<Candidates>();
        pipeline.world.init_resource::<StepGradient>();
        pipeline.world.init_resource::<BlendAdjoints>();
        pipeline.world.init_resource::<TexelPlaces>();
        pipeline.world.init_resource::<ScaleMoments>();
        pipeline.world.init_resource::<Window>();
        pipeline.world.init_resource::<Exposures>();
        pipeline.world.init_resource::<IncidentLight>();
        pipeline.world.init_resource::<ShadingForm>();
        pipeline
            .add_systems(Phase::Prepare, Stage::Sample, choose_pixels)
            .add_systems(Phase::Prepare, Stage::Trace, trace_pixels)
            .add_systems(Phase::Prepare, Stage::Gather, (count_seen_texels, gather_points))
            .add_systems(
                Phase::FitStep,
                Stage::Gather,
                (gather_points, gather_blends).before(Slot::Visibility),
            )
            .swap(Phase::FitStep, Slot::Light, provide_lobes)
            .swap(Phase::FitStep, Slot::Shading, shade_closed_form)
            .add_systems(Phase::FitStep, Stage::Loss, (find_exposures, compare_with_photographs).chain())
            .add_systems(
                Phase::FitStep,
                Stage::Gradient,
                (pull_back_radiance, scatter_to_texels, scatter_to_blends, hand_out_gradient)
                    .chain()
                    .before(Slot::ShapeGradient),
            )
            .swap(
                Phase::FitStep,
                Slot::Optimizer,
                (move_scale, move_texels, move_blends, move_lobes, move_specular).chain(),
            );
    }
}

/// Runs a whole fit in the pipeline's world. `watch` is called after every step and may stop the fit.
///
/// # Errors
/// If there is nothing to fit to, or a system fails.
pub fn run_fit(
    pipeline: &mut Pipeline,
    options: &FitOptions,
    watch: &mut dyn FnMut(&FitProgress, &World) -> ControlFlow<()>,
) -> Result<FitSummary> {
    let start = Instant::now();
    attach_state(&mut pipeline.world);
    pipeline.world.insert_resource(options.pixels);
    pipeline.world.insert_resource(options.unknowns);
    pipeline.world.insert_resource(options.scale);
    pipeline.world.insert_resource(ScaleMoments::default());
    pipeline.world.insert_resource(ShadingForm(options.form));
    pipeline.world.insert_resource(LossState { loss: options.loss, last: LossSums::default() });
    pipeline.world.resource_mut::<Exposures>().unknown = options.exposure;
    pipeline.run(Phase::Prepare)?;
    let refresh_every = pipeline.world.get_resource::<ObjectVisibility>().map(|v| v.settings().refresh_every);
    let refresh_every = refresh_every.filter(|_| options.visibility);
    match refresh_every {
        Some(_) => add_visibility(pipeline, Phase::FitStep),
        None => remove_visibility(pipeline, Phase::FitStep),
    }
    let pixels = pipeline.world.resource::<Window>().0.len();
    let unknowns = Unknowns {
        light: options.unknowns.light && options.guess.light,
        albedo: options.unknowns.albedo && options.guess.albedo,
        ..options.unknowns
    };
    make_first_guess(&mut pipeline.world, unknowns, refresh_every.is_some())?;
    if unknowns.light && unknowns.albedo {
        start_scale(&mut pipeline.world, options.scale);
    }
    let mut recent: Vec<LossSums> = Vec::new();
    let mut summary = FitSummary { steps: 0, pixels, elapsed_secs: 0.0, stopped: false };
    for step in 1..=options.steps {
        pipeline.world.resource_mut::<Window>().0 = window_of(step, options.batch, pixels);
        pipeline.world.insert_resource(rates_at(step, options));
        let every =
            pipeline.world.get_resource::<ObjectVisibility>().map_or(1, |v| v.settings().refresh_every);
        pipeline.world.insert_resource(RefreshDue((step - 1).is_multiple_of(every.max(1))));
        pipeline.world.resource_mut::<TexelPlaces>().progress = step as f32 / options.steps as f32;
        pipeline.run(Phase::FitStep)?;
        recent.push(pipeline.world.resource::<LossState>().last);
        recent.drain(..recent.len().saturating_sub(20));
        summary.steps = step;
        let progress = FitProgress {
            step,
            steps: options.steps,
            sums: recent.iter().fold(LossSums::default(), |a, b| a.merged(*b)),
            specular: first_specular(&mut pipeline.world),
            elapsed_secs: start.elapsed().as_secs_f64(),
        };
        if watch(&progress, &pipeline.world).is_break() {
            summary.stopped = true;
            break;
        }
    }
    despawn_pool(&mut pipeline.world);
    summary.elapsed_secs = start.elapsed().as_secs_f64();
    Ok(summary)
}

/// Rows that a step visits: contiguous windows of the shuffled pool, in turn; the last one of a round may be short.
fn window_of(step: u32, batch: usize, pixels: usize) -> std::ops::Range<usize> {
    let batch = batch.clamp(1, pixels);
    let windows = pixels.div_ceil(batch);
    let start = (step as usize - 1) % windows * batch;
    start..(start + batch).min(pixels)
}

fn rates_at(step: u32, options: &FitOptions) -> StepRates {
    let done = (step - 1) as f32 / options.steps as f32;
    let passed = options.milestones.iter().filter(|m| **m <= done).count();
    let factor = options.decay.powi(passed as i32);
    let [albedo, light, specular] = options.rates.map(|rate| rate * factor);
    StepRates { step, albedo, light, specular }
}

pub(super) fn first_specular(world: &mut World) -> SpecularLobe {
    let lobe = world.query::<&SpecularLobe>().iter(world).next().copied();
    lobe.unwrap_or(SpecularLobe::new(Vec3::ZERO, 1.0))
}

/// Gives texels and lobes fresh gradients and moments.
fn attach_state(world: &mut World) {
    let blended = world.query::<&SpecularLobe>().iter(world).len() > 1;
    let texels: Vec<Entity> =
        world.query_filtered::<Entity, (With<DiffuseAlbedo>, Without<PixelOf>)>().iter(world).collect();
    for texel in texels {
        let state = (AlbedoGradient::default(), AlbedoMoments::default(), TexelSeen::default());
        world.entity_mut(texel).insert(state);
        if blended {
            world.entity_mut(texel).insert((BlendGradient::default(), BlendMoments::default()));
        }
    }
    let lobes: Vec<Entity> = world.query_filtered::<Entity, With<LightLobe>>().iter(world).collect();
    for lobe in lobes {
        world.entity_mut(lobe).insert((LobeGradient::default(), LobeMoments::default()));
    }
    let materials: Vec<Entity> = world.query_filtered::<Entity, With<SpecularLobe>>().iter(world).collect();
    for material in materials {
        world.entity_mut(material).insert((SpecularGradient::default(), SpecularMoments::default()));
    }
}
