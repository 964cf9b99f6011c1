//! Running a fit: prepare the pool, initialize, and take steps.

use super::attach::{attach, detach};
use super::by_view::{ViewSums, count_pool, sum_by_view};
use super::components::{LossState, StepGradient, StepRates, Unknowns};
use super::exposure::{ExposureChoice, Exposures, find_exposures};
use super::groups::{Turn, Turns, exchange_light, forget_group_shadows, lights_of_views};
use super::guard::{
    StepGuard, begin_step, check_adjoints, check_loss, check_shading, end_step, step_is_sound,
};
use super::initialization::initialize_light_and_albedo;
use super::initialization::placements::find_placements;
use super::initialization::start::{Find, FramesTried, find_start};
use super::kept_state::keep_state;
use super::loss::{Loss, LossSums};
use super::observe::{
    Candidates, PixelChoice, choose_pixels, count_seen_texels, make_pool, release_pool, spawn_samples,
    take_observations, trace_pixels,
};
use super::optimizer::optimizer;
use super::placements::{PlacementPlugin, TurnSums, placements_turn};
use super::priors::follow_maps;
use super::roughness::blend::{BlendAdjoints, TexelPlaces, scatter_to_blends};
use super::scale::{ScaleMoments, ScaleRule, start_scale};
use super::schedule::Schedule;
use super::systems::{compare_with_photographs, hand_out_gradient, pull_back_radiance, scatter_to_texels};
use crate::checkpoint::{has_step_ahead, is_due, keep_step, resume_step};
use crate::error::Result;
use crate::error::stop::is_stopping;
use crate::fit::determined::{Determined, measure};
use crate::fit::sheen::evidence::{SheenEvidence, choose_sheen, look_for_sheen, note_residuals};
use crate::fit::sheen::{follow_known, scatter_to_sheen, share_with_known};
use crate::light::light_frame::{LightFrame, OwnLightFrame};
use crate::light::lights::{LightChoice, provide_light};
use crate::light::{LightLobe, lobes_in_use};
use crate::material::material_source::{PlainBlends, Recovered};
use crate::material::tilt::has_tilt;
use crate::material::{DiffuseTilt, SpecularLobe, TexelIndex, first_material};
use crate::math::shading::ClosedForm;
use crate::pipeline::pool::{read_column, write_column};
use crate::pipeline::{Phase, Pipeline, Plugin, ScatterAdjoints, Slot, Stage};
use crate::profile::stage;
use crate::ranks::agree_on_stop;
use crate::sample::bundle::despawn_pool;
use crate::sample::observation::ObservedWindow;
use crate::sample::pixel::Window;
use crate::shade::frame::{add_gathering, add_material_resources};
use crate::shade::shade_closed_form;
use crate::visibility::systems::RefreshDue;
use crate::visibility::{FitVisibilityPlugin, ObjectVisibility};
use bevy_ecs::prelude::{IntoScheduleConfigs, World};
use serde::{Deserialize, Serialize};
use std::ops::ControlFlow;
use std::time::Instant;

/// Settings of a fit.
#[derive(Clone, Debug, PartialEq)]
pub struct FitOptions {
    /// The loss that is minimized.
    pub loss: Loss,
    /// The closed form used for shading.
    pub form: ClosedForm,
    /// Update steps, those of an earlier part included.
    pub steps: u32,
    /// What an earlier part of the fit has done: this one goes on with its moments.
    pub done: Done,
    /// The step after which the caller may end the fit to go on otherwise; it is never kept as a checkpoint.
    pub asked_after: Option<u32>,
    /// Pixels per step.
    pub batch: usize,
    /// Part of them that a step visits before the first milestone, while rates are high, in (0, 1].
    pub early: f32,
    /// Rates of albedo, light and specular material at the first step.
    pub rates: [f32; 3],
    /// Fractions of the fit after which the rates are multiplied by `decay`.
    pub milestones: Vec<f32>,
    /// Factor on the rates at a milestone.
    pub decay: f32,
    /// Which parameters move.
    pub unknowns: Unknowns,
    /// Which pixels are visited.
    pub pixels: PixelChoice,
    /// Whether the pool of observed pixels stays for another part of the fit; then [`release_pool`] ends it.
    pub keeps_pool: bool,
    /// What is initialized from the data before the first step.
    pub initialize: Initialize,
    /// Whether shading includes shadows and reflections; the world then needs an [`ObjectVisibility`].
    pub visibility: bool,
    /// Whether the fit decides by itself if the surface has a sheen.
    pub looks_for_sheen: bool,
    /// Whether photographs have exposures of their own.
    pub exposure: ExposureChoice,
    /// Whether it is measured in the end how well the photographs determine what was found.
    pub measures: bool,
    /// The rule for the scale between light and albedo, if both are unknown.
    pub scale: ScaleRule,
    /// The frame in which the light stands still; `None`: found when the light is initialized, and kept after that.
    /// `Some` replaces what the world has.
    pub light_frame: Option<LightFrame>,
}

impl Default for FitOptions {
    /// All of light and material but blends are unknown; 300 steps of 1024 pixels, without shadows.
    fn default() -> Self {
        Self {
            loss: Loss::default(),
            form: ClosedForm::default(),
            steps: 300,
            done: Done::default(),
            asked_after: None,
            batch: 1024,
            early: 1.0,
            rates: [0.05, 0.02, 0.01],
            milestones: vec![0.5, 0.75, 0.9],
            decay: 0.4,
            unknowns: Unknowns::default(),
            pixels: PixelChoice { seed: 0, max_pixels: 2_000_000, evenly: false },
            keeps_pool: false,
            initialize: Initialize::ALL,
            visibility: false,
            looks_for_sheen: false,
            exposure: ExposureChoice::Equal,
            measures: false,
            scale: ScaleRule::default(),
            light_frame: Some(LightFrame::World),
        }
    }
}

/// The earlier part of a fit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Done {
    /// Its steps.
    pub steps: u32,
    /// What it took, in seconds.
    pub secs: f64,
}

/// The unknowns that a fit initializes from the data before its first step; the others start from their current values.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Initialize {
    /// The amplitudes of the light.
    pub light: bool,
    /// The albedo.
    pub albedo: bool,
    /// Specular albedo and roughness, if both are unknown and there is one base material.
    pub specular: bool,
}

impl Initialize {
    /// Light, albedo and specular lobe.
    pub const ALL: Self = Self { light: true, albedo: true, specular: true };
    /// Nothing: a fit that continues another.
    pub const NONE: Self = Self { light: false, albedo: false, specular: false };
}

/// The state of a running fit, for the caller.
#[derive(Clone, Copy, Debug)]
#[non_exhaustive]
pub struct FitProgress {
    /// The last finished step, from 1.
    pub step: u32,
    /// Total number of steps.
    pub steps: u32,
    /// Sums over the last pass through the pool's windows.
    pub sums: LossSums,
    /// The specular lobe now.
    pub specular: SpecularLobe,
    /// Lobes that hold 99 % of the light's power.
    pub lobes: usize,
    /// Seconds since the fit began.
    pub elapsed_secs: f64,
}

/// The summary of a finished fit.
#[derive(Clone, Copy, Debug, Default)]
#[non_exhaustive]
pub struct FitSummary {
    /// Steps done.
    pub steps: u32,
    /// Pixels in the pool.
    pub pixels: usize,
    /// Total seconds, initialization included.
    pub elapsed_secs: f64,
    /// Whether the caller stopped it early.
    pub stopped: bool,
    /// Part of the squared residuals of views kept aside that a sheen explains, if the fit has decided about it.
    pub explained_by_sheen: Option<f64>,
    /// How well the photographs determine what was found; `None` before the end, with several base materials, and where exposures are unknown.
    pub determined: Option<Determined>,
}

/// The fit's systems: Adam on texels, light lobes and the specular lobe, with closed-form shading.
pub struct FitPlugin;

impl Plugin for FitPlugin {
    fn build(&self, pipeline: &mut Pipeline) {
        pipeline.world.init_resource::<Candidates>();
        pipeline.world.init_resource::<ObservedWindow>();
        pipeline.world.init_resource::<StepGradient>();
        pipeline.world.init_resource::<BlendAdjoints>();
        pipeline.world.init_resource::<TexelPlaces>();
        pipeline.world.init_resource::<ScaleMoments>();
        pipeline.world.init_resource::<TurnSums>();
        pipeline.world.init_resource::<Exposures>();
        pipeline.world.init_resource::<StepGuard>();
        pipeline.world.init_resource::<ViewSums>();
        add_material_resources::<Recovered>(&mut pipeline.world);
        pipeline
            .add_systems(Phase::Prepare, Stage::Sample, choose_pixels)
            .add_systems(Phase::Prepare, Stage::Trace, trace_pixels)
            .add_systems(Phase::Prepare, Stage::Gather, count_seen_texels);
        add_step(pipeline);
        hold_back_unsound_steps(pipeline);
        add_gathering::<Recovered>(pipeline, Phase::FitStep);
        keep_state(&mut pipeline.world);
    }

    fn cleanup(world: &mut World) {
        world.remove_resource::<Candidates>();
        world.remove_resource::<ObservedWindow>();
        world.remove_resource::<StepGradient>();
        world.remove_resource::<BlendAdjoints>();
        world.remove_resource::<TexelPlaces>();
        world.remove_resource::<ScaleMoments>();
        world.remove_resource::<TurnSums>();
        world.remove_resource::<Exposures>();
        world.remove_resource::<StepGuard>();
        world.remove_resource::<ViewSums>();
        world.remove_resource::<PlainBlends<Recovered>>();
        // Those of a run.
        world.remove_resource::<LossState>();
        world.remove_resource::<StepRates>();
        world.remove_resource::<Unknowns>();
        world.remove_resource::<PixelChoice>();
        world.remove_resource::<ScaleRule>();
        world.remove_resource::<RefreshDue>();
        world.remove_resource::<FramesTried>();
        world.remove_resource::<SheenEvidence>();
        detach(world);
    }
}

/// Adds the systems of a step; [`prepare`] replaces those that shade by those of the fit's closed form.
fn add_step(pipeline: &mut Pipeline) {
    let loss = (
        check_shading,
        find_exposures.run_if(step_is_sound),
        compare_with_photographs,
        check_loss,
        note_residuals.run_if(step_is_sound),
        sum_by_view,
    );
    let scatter =
        (scatter_to_texels, scatter_to_sheen, share_with_known, scatter_to_blends, hand_out_gradient);
    pipeline
        .add_systems(Phase::FitStep, Stage::Sample, take_observations)
        .swap(Phase::FitStep, Slot::Light, provide_light(LightChoice::Own, false))
        .swap(Phase::FitStep, Slot::Shading, shade_closed_form(ClosedForm::default()))
        .swap(Phase::FitStep, Slot::ShadingAdjoint, pull_back_radiance(ClosedForm::default()))
        .add_systems(Phase::FitStep, Stage::Loss, loss.chain())
        .add_systems(Phase::FitStep, Stage::Gradient, scatter.chain().in_set(ScatterAdjoints))
        .swap(Phase::FitStep, Slot::Optimizer, optimizer())
        .add_systems(Phase::FitStep, Stage::Update, follow_known.after(Slot::Optimizer));
}

/// Leaves the rest of a step out once something of it is not finite, also what other plugins put into these stages: shapes and cameras.
fn hold_back_unsound_steps(pipeline: &mut Pipeline) {
    let check = check_adjoints.after(Slot::ShadingAdjoint).before(ScatterAdjoints);
    pipeline.add_systems(Phase::FitStep, Stage::Gradient, check);
    for stage in [Stage::Gradient, Stage::Update] {
        pipeline.run_stage_if(Phase::FitStep, stage, step_is_sound);
    }
}

/// Runs a whole fit in the pipeline's world. `watch` is called after every step and may stop the fit.
///
/// # Errors
/// If there is nothing to fit to, or a system fails; [`Error::Interrupted`](crate::Error::Interrupted) if the run is stopped before
/// the first step.
pub fn run_fit(
    pipeline: &mut Pipeline,
    options: &FitOptions,
    watch: &mut dyn FnMut(&FitProgress, &mut World) -> ControlFlow<()>,
) -> Result<FitSummary> {
    let fitted = fit(pipeline, options, watch);
    despawn_pool(&mut pipeline.world);
    if !options.keeps_pool || fitted.is_err() {
        release_pool(&mut pipeline.world);
    }
    forget_group_shadows(&mut pipeline.world);
    fitted
}

/// What the loop over steps keeps beside the world.
#[derive(Default, Serialize, Deserialize)]
struct Loop {
    /// The last steps' sums, for the caller.
    recent: Vec<LossSums>,
    elapsed_secs: f64,
}

impl Loop {
    /// Takes up the sums of the step that was just made; returns the state of the fit after it.
    fn progress(&mut self, world: &mut World, step: u32, steps: u32) -> FitProgress {
        self.recent.push(world.resource::<LossState>().last);
        self.recent.drain(..self.recent.len().saturating_sub(20));
        FitProgress {
            step,
            steps,
            sums: self.recent.iter().fold(LossSums::default(), |a, b| a.merged(*b)),
            specular: first_material(world),
            lobes: lobes_in_use(world.query::<&LightLobe>().iter(world)),
            elapsed_secs: self.elapsed_secs,
        }
    }
}

fn fit(
    pipeline: &mut Pipeline,
    options: &FitOptions,
    watch: &mut dyn FnMut(&FitProgress, &mut World) -> ControlFlow<()>,
) -> Result<FitSummary> {
    let start = Instant::now();
    let pixels = prepare(pipeline, options)?;
    let _steps = stage("steps");
    let begun = || (options.done.steps, Loop { recent: Vec::new(), elapsed_secs: options.done.secs });
    let (done, mut state) = resume_step(&mut pipeline.world)?.unwrap_or_else(begun);
    // By now the rotations are those of the step that is gone on from.
    pipeline.remove_plugin::<PlacementPlugin>();
    if placements_turn(&pipeline.world) {
        pipeline.add_plugin(&PlacementPlugin(options.form));
    }
    let before = state.elapsed_secs;
    let elapsed = || before + start.elapsed().as_secs_f64();
    let mut summary = FitSummary { steps: done, pixels, elapsed_secs: before, ..FitSummary::default() };
    let mut turns = turns_after(&mut pipeline.world, options, done);
    for step in done + 1..=options.steps {
        choose_sheen(&mut pipeline.world, (step - 1) as f32 / options.steps as f32);
        run_step(pipeline, options, step, &turns.next())?;
        summary.steps = step;
        state.elapsed_secs = elapsed();
        let progress = state.progress(&mut pipeline.world, step, options.steps);
        summary.stopped = watch(&progress, &mut pipeline.world).is_break() | agree_on_stop(&pipeline.world)?;
        state.elapsed_secs = elapsed();
        keep_if_due(&mut pipeline.world, options, step, &state)?;
        if summary.stopped {
            break;
        }
    }
    summary.explained_by_sheen =
        pipeline.world.get_resource::<SheenEvidence>().and_then(|evidence| evidence.explained);
    summary.determined = how_well(&mut pipeline.world, options, summary.steps)?;
    summary.elapsed_secs = elapsed();
    Ok(summary)
}

fn schedule_of(options: &FitOptions) -> Schedule<'_> {
    let FitOptions { steps, batch, early, decay, rates, .. } = *options;
    Schedule { steps, batch, early, milestones: &options.milestones, decay, rates }
}

/// Which photographs each step visits, after so many.
fn turns_after(world: &mut World, options: &FitOptions, steps: u32) -> Turns {
    let every = refresh_every(world);
    let mut turns = Turns::new(world, schedule_of(options).pixels(), every).until(options.steps);
    (0..steps).for_each(|_| _ = turns.next());
    turns
}

/// How well the photographs determine what was found, after the last step.
fn how_well(world: &mut World, options: &FitOptions, step: u32) -> Result<Option<Determined>> {
    if !options.measures || step < options.steps || is_stopping() {
        return Ok(None);
    }
    if world.resource::<Exposures>().are_unknown() {
        return Ok(None);
    }
    let _measuring = stage("determined");
    measure(world, options.unknowns, options.form, options.visibility)
}

/// Keeps the state after a step if a checkpoint is due, where the fit goes on and its next step finds shadows and reflections anew.
fn keep_if_due(world: &mut World, options: &FitOptions, step: u32, state: &Loop) -> Result<()> {
    // After the last step there is none that would find shadows anew.
    let may_keep = step < options.steps && options.asked_after != Some(step) && refresh_is_next(world, step);
    if may_keep && is_due(world) { keep_step(world, step, state) } else { Ok(()) }
}

/// Whether the step after this one computes shadows and reflections again, so that they need not be kept.
fn refresh_is_next(world: &World, step: u32) -> bool {
    step.is_multiple_of(refresh_every(world))
}

fn refresh_every(world: &World) -> u32 {
    world.get_resource::<ObjectVisibility>().map_or(1, |v| v.settings().refresh_every).max(1)
}

/// Makes the pool and initializes; returns the number of pixels.
fn prepare(pipeline: &mut Pipeline, options: &FitOptions) -> Result<usize> {
    let _preparing = stage("prepared");
    begin(&mut pipeline.world, options)?;
    pipeline.swap(Phase::FitStep, Slot::Shading, shade_closed_form(options.form)).swap(
        Phase::FitStep,
        Slot::ShadingAdjoint,
        pull_back_radiance(options.form),
    );
    let pixels = make_pool(pipeline)?;
    let shadowed = options.visibility && pipeline.world.contains_resource::<ObjectVisibility>();
    pipeline.remove_plugin::<FitVisibilityPlugin>();
    if shadowed {
        pipeline.add_plugin(&FitVisibilityPlugin);
    }
    count_pool(&mut pipeline.world);
    initialize(&mut pipeline.world, options, shadowed)?;
    spawn_samples(&mut pipeline.world, options.batch.clamp(1, pixels));
    Ok(pixels)
}

/// Gives a world the settings of a fit, and its unknowns their gradients and moments.
fn begin(world: &mut World, options: &FitOptions) -> Result<()> {
    let sheen = options.unknowns.sheen || (options.looks_for_sheen && options.unknowns.albedo);
    let begins = options.done.steps == 0;
    attach(world, sheen, begins);
    world.insert_resource(options.pixels);
    world.insert_resource(options.unknowns);
    if begins {
        begin_albedo(world, options)?;
        world.insert_resource(ScaleMoments::default());
        world.insert_resource(TurnSums::default());
        let lights = lights_of_views(world);
        world.resource_mut::<Exposures>().begin(options.exposure, lights);
    }
    world.insert_resource(options.scale);
    world.insert_resource(LossState { loss: options.loss, last: LossSums::default() });
    Ok(())
}

/// Initializes the unknowns from the data; a fit that is resumed is initialized.
fn initialize(world: &mut World, options: &FitOptions, shadowed: bool) -> Result<()> {
    let initialize = if has_step_ahead(world) { Initialize::NONE } else { options.initialize };
    let unknowns = Unknowns {
        light: options.unknowns.light && initialize.light,
        albedo: options.unknowns.albedo && initialize.albedo,
        ..options.unknowns
    };
    if let Some(frame) = options.light_frame {
        world.insert_resource(OwnLightFrame(frame));
    }
    let finds =
        Find { frame: options.light_frame.is_none() && unknowns.light, specular: initialize.specular };
    find_start(world, finds, unknowns, options.form)?;
    if options.done.steps == 0 && !has_step_ahead(world) {
        find_placements(world, unknowns, options.form)?;
    }
    let _initializing = stage("initialization");
    let both = unknowns.light && unknowns.albedo;
    // A fit that goes on, or is resumed, keeps to the color of the maps as well.
    let keeps = options.unknowns.light && options.unknowns.albedo;
    let from_maps = keeps && follow_maps(world, unknowns.metal, both)?;
    // Light is solved for under the albedo of the maps, which alternation would leave again.
    let solved = Unknowns { albedo: unknowns.albedo && !(from_maps && both), ..unknowns };
    initialize_light_and_albedo(world, solved, options.form, shadowed)?;
    if both && !from_maps {
        start_scale(world, options.scale)?;
    }
    Ok(())
}

fn run_step(pipeline: &mut Pipeline, options: &FitOptions, step: u32, turn: &Turn) -> Result<()> {
    let world = &mut pipeline.world;
    world.resource_mut::<Window>().0 = 0..turn.rows.len();
    world.resource_mut::<ObservedWindow>().0 = turn.rows.clone();
    world.insert_resource(schedule_of(options).rates_at(step, turn.visit));
    world.resource_mut::<ViewSums>().counts = turn.is_last;
    world.insert_resource(RefreshDue(turn.refreshes));
    world.resource_mut::<TexelPlaces>().progress = step as f32 / options.steps as f32;
    begin_step(world);
    exchange_light(world, turn.group);
    let ran = pipeline.run(Phase::FitStep);
    exchange_light(&mut pipeline.world, turn.group);
    ran?;
    end_step(&mut pipeline.world, step)
}

/// A fit of the albedo begins without a tilt, which belongs to the albedo that it was found with, and may have to decide about a sheen.
fn begin_albedo(world: &mut World, options: &FitOptions) -> Result<()> {
    world.remove_resource::<SheenEvidence>();
    if !options.unknowns.albedo {
        return Ok(());
    }
    if options.looks_for_sheen {
        look_for_sheen(world)?;
    }
    let tilt = read_column::<TexelIndex, DiffuseTilt>(world)?;
    if has_tilt(&tilt) {
        write_column::<TexelIndex, DiffuseTilt>(world, &vec![DiffuseTilt::default(); tilt.len()])?;
    }
    Ok(())
}
