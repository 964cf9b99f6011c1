//! Running a fit: prepare the pool, initialize, and take steps.
//!
//! Rates fall at the milestones, and before the first one a step visits fewer pixels. While rates
//! are high the noise of few pixels does no harm; later it would stay in the albedo.

use crate::fit::cameras::{CameraFit, CameraPose, attach_poses, cameras_move};
use crate::fit::components::{
    AlbedoGradient, AlbedoMoments, LobeMoments, LossState, SpecularMoments, StepGradient, StepRates,
    TexelSeen, Unknowns,
};
use crate::fit::determined::{Determined, measure};
use crate::fit::exposure::{ExposureChoice, Exposures, find_exposures};
use crate::fit::groups::{StepPixels, Turns, end_turns, lights_of_views};
use crate::fit::guard::{
    StepGuard, begin_step, check_adjoints, check_loss, check_shading, end_step, step_is_sound,
};
use crate::fit::initialization::initialize_light_and_albedo;
use crate::fit::loss::{Loss, LossSums, ViewSums, count_pool, sum_by_view};
use crate::fit::neighbors::hold_to_neighbors;
use crate::fit::observe::{
    PixelChoice, make_pool, release_pool, spawn_samples, take_observations, trace_pixels,
};
use crate::fit::placements::{
    TurnSums, find_placements, placements_turn, sum_turns, turn_placements, turns_are_summed,
};
use crate::fit::priors::{NormalWeight, follow_maps, pull_to_normal_maps};
use crate::fit::roughness::{
    BlendGradient, BlendMoments, RoughnessMoments, TexelPlaces, TexelRoughness, move_blends, move_roughness,
    scatter_to_blends, tie_specular,
};
use crate::fit::scale::{ScaleMoments, ScaleRule, move_scale, start_scale};
use crate::fit::sheen::{
    SheenEvidence, SheenGradient, SheenMoments, choose_sheen, follow_known, look_for_sheen, move_sheen,
    note_residuals, scatter_to_sheen,
};
use crate::fit::start::{FramesTried, find_start};
use crate::fit::systems::{
    closed_form_shader, compare_with_photographs, move_lobes, move_specular, move_texels, scatter_to_texels,
};
use crate::fit::{detail::DetailPlugin, metal::bound_diffuse_albedo};
use crate::shade::frame::add_gathering;
use crate::visibility::{ObjectVisibility, RefreshDue};
use bevy_ecs::prelude::{
    Entity, IntoScheduleConfigs, Resource, SystemCondition, With, World, resource_exists,
};
use bevy_ecs::{prelude::Bundle, query::QueryFilter, schedule::ScheduleConfigs, system::ScheduleSystem};
use glam::Vec3;
use lobelia_geometry::view::{Camera, ViewIndex, ViewName};
use lobelia_geometry::{Error, Result, error::stop::is_stopping};
use lobelia_sg::shading::ClosedForm;
use lobelia_world::checkpoint::{Span, keep_each, keep_keyed, keep_pool, keep_resource};
use lobelia_world::light::light_frame::{LightFrame, OwnLightFrame};
use lobelia_world::light::lights::{LightChoice, provide_light};
use lobelia_world::light::placement::{GroupInTurn, Placements};
use lobelia_world::light::{LightLobe, groups::FittedLobe, lobes_in_use};
use lobelia_world::material::{BaseMaterial, Diffuse, SpecularBlend, SpecularLobe, TexelIndex};
use lobelia_world::material::{diffuse::has_tilt, first_material, texels_in_order};
use lobelia_world::pipeline::{FitForm, Phase, Pipeline, Plugin, ScatterAdjoints, Slot, Stage};
use lobelia_world::sample::{ObservedWindow, despawn_pool, pixel::Window};
use lobelia_world::{material::material_source::RecoveredMaterial, pipeline::pool::with_columns};
use serde::{Deserialize, Serialize};
use std::{ops::ControlFlow, time::Instant};
use tracing::info_span;

/// Settings of a fit.
#[derive(Clone, Debug, PartialEq)]
pub struct FitOptions {
    /// The loss that is minimized.
    pub loss: Loss,
    /// Update steps, those of an earlier part included.
    pub steps: u32,
    /// Work of an earlier part of the fit: this one goes on with its moments.
    pub done: Done,
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
    /// Whether the pool of observed pixels stays for another part of the fit; then [`release_pool`]
    /// ends it.
    pub keeps_pool: bool,
    /// Unknowns initialized from the data before the first step.
    pub initialize: Initialize,
    /// Whether the fit decides by itself if the surface has a sheen.
    pub looks_for_sheen: bool,
    /// Whether photographs have exposures of their own.
    pub exposure: ExposureChoice,
    /// Whether it is measured in the end how well the photographs determine what was found.
    pub measures: bool,
    /// The rule for the scale between light and albedo, if both are unknown.
    pub scale: ScaleRule,
    /// The frame in which the light stands still; `None`: found when the light is initialized, and
    /// kept after that. `Some` replaces what the world has.
    pub light_frame: Option<LightFrame>,
}

impl Default for FitOptions {
    /// All of light and material but blends are unknown; 300 steps of 1024 pixels.
    fn default() -> Self {
        Self {
            loss: Loss::default(),
            steps: 300,
            done: Done::default(),
            batch: 1024,
            early: 1.0,
            rates: [0.05, 0.02, 0.01],
            milestones: vec![0.5, 0.75, 0.9],
            decay: 0.4,
            unknowns: Unknowns::default(),
            pixels: PixelChoice { seed: 0, max_pixels: 2_000_000, evenly: false },
            keeps_pool: false,
            initialize: Initialize::ALL,
            looks_for_sheen: false,
            exposure: ExposureChoice::Equal,
            measures: false,
            scale: ScaleRule::default(),
            light_frame: Some(LightFrame::World),
        }
    }
}

impl FitOptions {
    /// The rates of a step, from 1, which is a visit to its group.
    fn rates_at(&self, step: u32, visit: u32) -> StepRates {
        let progress = (step - 1) as f32 / self.steps as f32;
        let passed = self.milestones.iter().filter(|milestone| **milestone <= progress).count();
        let factor = self.decay.powi(passed as i32);
        let [albedo, light, specular] = self.rates.map(|rate| rate * factor);
        StepRates { step, visit, progress, albedo, light, specular }
    }
}

/// The earlier part of a fit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Done {
    /// Its steps.
    pub steps: u32,
    /// Its time, in seconds.
    pub secs: f64,
    /// Whether it only paused, at a step from which it may go on as if it had not.
    pub is_pause: bool,
}

/// The unknowns that a fit initializes from the data before its first step; the others start from
/// their current values.
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
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub struct FitSummary {
    /// Steps done.
    pub steps: u32,
    /// Pixels in the pool.
    pub pixels: usize,
    /// Total seconds, initialization included.
    pub elapsed_secs: f64,
    /// Whether the caller stopped it early.
    pub stopped: bool,
    /// Part of the squared residuals of views kept aside that a sheen explains, if the fit has
    /// decided about it.
    pub explained_by_sheen: Option<f64>,
    /// How well the photographs determine what was found; `None` before the end, with several base
    /// materials, and where exposures are unknown.
    pub determined: Option<Determined>,
}

/// The fit's systems: Adam on texels, light lobes and the specular lobe, with accurate closed-form
/// shading, without shadows, until another shader is put in ([`Pipeline::set_shader`]) and
/// [`see_recovered_of_step`](crate::visibility::see_recovered_of_step) into [`Slot::Visibility`].
pub struct FitPlugin;

impl Plugin for FitPlugin {
    fn build(&self, pipeline: &mut Pipeline) {
        let world = &mut pipeline.world;
        world.init_resource::<ObservedWindow>();
        world.init_resource::<StepGradient>();
        world.init_resource::<TexelPlaces>();
        world.init_resource::<ScaleMoments>();
        world.init_resource::<TurnSums>();
        world.init_resource::<Exposures>();
        world.init_resource::<StepGuard>();
        world.init_resource::<ViewSums>();
        world.init_resource::<RecentSums>();
        keep_state(world);
        add_gathering::<RecoveredMaterial>(pipeline, Phase::FitStep);
        let exposures = find_exposures.run_if(step_is_sound);
        let residuals = (note_residuals, sum_by_view).chain().run_if(step_is_sound);
        let loss = (check_shading, exposures, compare_with_photographs, check_loss, residuals);
        let scatter = (scatter_to_texels, scatter_to_sheen, scatter_to_blends, hold_to_neighbors);
        // After a bad value all adjoints are zero, and are to remain so.
        let pull = pull_to_normal_maps.run_if(resource_exists::<NormalWeight>.and_then(step_is_sound));
        let adjoints = (check_adjoints, pull).chain().after(Slot::ShadingAdjoint).before(ScatterAdjoints);
        pipeline
            .add_systems(Phase::Prepare, Stage::Trace, trace_pixels)
            .add_systems(Phase::FitStep, Stage::Sample, take_observations)
            .swap(Phase::FitStep, Slot::Light, provide_light(LightChoice::Own, false))
            .set_shader(Phase::FitStep, closed_form_shader(ClosedForm::default()))
            .add_systems(Phase::FitStep, Stage::Loss, loss.chain())
            .add_systems(Phase::FitStep, Stage::Gradient, adjoints)
            .add_systems(Phase::FitStep, Stage::Gradient, scatter.chain().in_set(ScatterAdjoints))
            .add_systems(Phase::FitStep, Stage::Gradient, sum_turns.run_if(turns_are_summed))
            .swap(Phase::FitStep, Slot::Optimizer, optimizer())
            .add_systems(Phase::FitStep, Stage::Update, follow_known.after(Slot::Optimizer))
            .add_systems(Phase::FitStep, Stage::Update, turn_placements.run_if(placements_turn))
            .add_plugin(&DetailPlugin);
        // Also what other plugins put into these stages is left out, shapes and cameras.
        for stage in [Stage::Gradient, Stage::Update] {
            pipeline.configure_sets(Phase::FitStep, stage.run_if(step_is_sound));
        }
    }
}

/// Runs a whole fit in the pipeline's world. `watch` is called after every step and may stop the
/// fit.
///
/// # Errors
/// If there is nothing to fit to, the shader has no adjoint, or a system fails;
/// [`Error::Interrupted`] if the run is stopped before the
/// first step.
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
    end_turns(&mut pipeline.world);
    fitted
}

/// The sums of the last steps, for the caller.
#[derive(Resource, Default, Serialize, Deserialize)]
struct RecentSums(Vec<LossSums>);

fn fit(
    pipeline: &mut Pipeline,
    options: &FitOptions,
    watch: &mut dyn FnMut(&FitProgress, &mut World) -> ControlFlow<()>,
) -> Result<FitSummary> {
    let start = Instant::now();
    let (pixels, shadowed) = prepare(pipeline, options)?;
    let _steps = info_span!("steps").entered();
    let (done, before) = (options.done.steps, options.done.secs);
    let elapsed = || before + start.elapsed().as_secs_f64();
    let mut summary = FitSummary { steps: done, pixels, elapsed_secs: before, ..FitSummary::default() };
    let every = refresh_every(&pipeline.world);
    let FitOptions { batch: late, steps, ref milestones, .. } = *options;
    // Fewer before the first milestone.
    let early = (options.early * late as f32).ceil() as usize;
    let until = milestones.iter().copied().fold(f32::INFINITY, f32::min);
    let pixels_of_step = StepPixels { early, late, until, steps };
    let mut turns = Turns::new(&mut pipeline.world, pixels_of_step, every).until(steps);
    (0..done).for_each(|_| _ = turns.next());
    for step in done + 1..=options.steps {
        choose_sheen(&mut pipeline.world, (step - 1) as f32 / options.steps as f32);
        let turn = turns.next();
        let world = &mut pipeline.world;
        world.resource_mut::<Window>().0 = 0..turn.rows.len();
        world.resource_mut::<ObservedWindow>().0 = turn.rows;
        world.insert_resource(options.rates_at(step, turn.visit));
        world.resource_mut::<ViewSums>().counts = turn.is_last;
        world.insert_resource(RefreshDue(turn.refreshes));
        world.resource_mut::<TexelPlaces>().progress = step as f32 / options.steps as f32;
        begin_step(world);
        world.insert_resource(GroupInTurn(turn.group));
        pipeline.run(Phase::FitStep)?;
        let world = &mut pipeline.world;
        end_step(world, step)?;
        summary.steps = step;
        let last = world.resource::<LossState>().last;
        let recent = &mut world.resource_mut::<RecentSums>().0;
        recent.push(last);
        recent.drain(..recent.len().saturating_sub(20));
        let progress = FitProgress {
            step,
            steps: options.steps,
            sums: recent.iter().fold(LossSums::default(), |a, b| a.merged(*b)),
            specular: first_material(world),
            lobes: lobes_in_use(world.query_filtered::<&LightLobe, FittedLobe>().iter(world)),
            elapsed_secs: elapsed(),
        };
        summary.stopped = watch(&progress, world).is_break();
        if summary.stopped {
            break;
        }
    }
    let world = &mut pipeline.world;
    summary.explained_by_sheen = world.get_resource::<SheenEvidence>().and_then(|found| found.explained);
    let is_whole = summary.steps >= options.steps && !is_stopping();
    if options.measures && is_whole && !world.resource::<Exposures>().are_unknown() {
        let _measuring = info_span!("determined").entered();
        summary.determined = measure(world, options.unknowns, shadowed)?;
    }
    summary.elapsed_secs = elapsed();
    Ok(summary)
}

/// Whether a fit whose geometry stands still may pause after this step, to go on with the same
/// bits: the next one computes shadows and reflections again, so that they need not be kept.
pub fn may_pause(world: &World, step: u32) -> bool {
    step.is_multiple_of(refresh_every(world))
}

fn refresh_every(world: &World) -> u32 {
    world.get_resource::<ObjectVisibility>().map_or(1, |v| v.settings().refresh_every).max(1)
}

/// Gives a world the settings of a fit and its unknowns their gradients and moments, makes the pool
/// and initializes; returns the number of pixels, and whether there are shadows.
fn prepare(pipeline: &mut Pipeline, options: &FitOptions) -> Result<(usize, bool)> {
    let _preparing = info_span!("prepared").entered();
    if !pipeline.is_filled(Phase::FitStep, Slot::ShadingAdjoint) {
        let help = "Put in one that has, with `Pipeline::set_shader` and `Shader::with_adjoint`.";
        return Err(Error::usage("the shader of the fit has no adjoint", help));
    }
    let has_shadows = pipeline.is_filled(Phase::FitStep, Slot::Visibility);
    let world = &mut pipeline.world;
    let begins = options.done.steps == 0;
    if cameras_move(world) {
        attach_poses(world);
    }
    attach(world, options.unknowns.sheen || (options.looks_for_sheen && options.unknowns.albedo), begins);
    world.insert_resource(options.pixels);
    world.insert_resource(options.unknowns);
    if begins {
        world.remove_resource::<SheenEvidence>();
        if options.unknowns.albedo {
            if options.looks_for_sheen {
                look_for_sheen(world)?;
            }
            // A tilt belongs to the albedo that it was found with.
            with_columns::<TexelIndex, &mut Diffuse, _>(world, |mut texels| {
                if has_tilt(&texels) {
                    texels.iter_mut().for_each(|texel| texel.tilt = Vec3::ZERO);
                }
                Ok(())
            })?;
        }
        world.insert_resource(ScaleMoments::default());
        world.insert_resource(TurnSums::default());
        let lights = lights_of_views(world);
        world.resource_mut::<Exposures>().begin(options.exposure, lights);
    }
    world.insert_resource(options.scale);
    world.insert_resource(LossState { loss: options.loss, last: LossSums::default() });
    let pixels = make_pool(pipeline)?;
    let shadowed = has_shadows && pipeline.world.contains_resource::<ObjectVisibility>();
    if !options.done.is_pause {
        count_pool(&mut pipeline.world);
        pipeline.world.insert_resource(RecentSums::default());
    }
    initialize(&mut pipeline.world, options, shadowed)?;
    spawn_samples(&mut pipeline.world, options.batch.clamp(1, pixels));
    Ok((pixels, shadowed))
}

/// Initializes the unknowns from the data.
fn initialize(world: &mut World, options: &FitOptions, shadowed: bool) -> Result<()> {
    let (initialize, FitForm(form)) = (options.initialize, *world.resource());
    let unknowns = Unknowns {
        light: options.unknowns.light && initialize.light,
        albedo: options.unknowns.albedo && initialize.albedo,
        ..options.unknowns
    };
    if let Some(frame) = options.light_frame {
        world.insert_resource(OwnLightFrame(frame));
    }
    let finds_frame = options.light_frame.is_none() && unknowns.light;
    find_start(world, finds_frame, initialize.specular, unknowns, form)?;
    if options.done.steps == 0 {
        find_placements(world, unknowns, form)?;
    }
    let _initializing = info_span!("initialization").entered();
    let both = unknowns.light && unknowns.albedo;
    // A fit that goes on keeps to the color of the maps as well.
    let keeps = options.unknowns.light && options.unknowns.albedo;
    let from_maps = keeps && follow_maps(world, unknowns.metal, both)?;
    // Light is solved for under the albedo of the maps, which alternation would leave again.
    let solved = Unknowns { albedo: unknowns.albedo && !(from_maps && both), ..unknowns };
    initialize_light_and_albedo(world, solved, form, shadowed)?;
    if both && !from_maps {
        start_scale(world, options.scale)?;
    }
    Ok(())
}

/// Registers what a fit, or a pass after it, goes on from.
fn keep_state(world: &mut World) {
    keep_each::<LightLobe, FittedLobe>(world, Span::Run);
    keep_keyed::<BaseMaterial, SpecularLobe, With<SpecularLobe>>(world, Span::Run);
    keep_keyed::<ViewIndex, Camera, With<ViewName>>(world, Span::Run);
    keep_keyed::<ViewIndex, CameraPose, With<ViewName>>(world, Span::Run);
    keep_pool::<TexelIndex, Diffuse>(world, Span::Run);
    keep_pool::<TexelIndex, SpecularBlend>(world, Span::Run);
    keep_pool::<TexelIndex, TexelRoughness>(world, Span::Run);
    keep_resource::<OwnLightFrame>(world, Span::Run);
    keep_resource::<Placements>(world, Span::Run);
    keep_resource::<Exposures>(world, Span::Run);
    keep_resource::<CameraFit>(world, Span::Run);
    keep_resource::<StepGuard>(world, Span::Run);
    keep_resource::<ViewSums>(world, Span::Pass);
    keep_resource::<RecentSums>(world, Span::Pass);
    keep_resource::<ScaleRule>(world, Span::Pass);
    keep_pool::<TexelIndex, TexelSeen>(world, Span::Pass);
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

/// Part of the pixels of a step that a `Fit` visits before the first milestone.
pub const EARLY: f32 = 0.5;

/// Moves all that a fit may move; roughness varies by the blend of base materials.
pub fn optimizer() -> ScheduleConfigs<ScheduleSystem> {
    (move_scale, move_texels, move_sheen, move_blends, move_lobes, move_specular, bound_diffuse_albedo)
        .chain()
}

/// Moves all that a fit may move, with one roughness per texel, which needs its
/// [prior](crate::fit::roughness::RoughnessPrior) and
/// [state](crate::fit::roughness::attach_roughness).
pub fn optimizer_of_texel_roughness() -> ScheduleConfigs<ScheduleSystem> {
    (move_scale, move_texels, move_sheen, move_roughness, move_lobes, tie_specular, move_specular).chain()
}

/// Gives texels zero gradients, and texels, lobes and base materials zero moments where a fit
/// begins; one that goes on has kept its own.
fn attach(world: &mut World, sheen: bool, begins: bool) {
    let (texels, lobes) = (texels_in_order(world), entities::<FittedLobe>(world));
    let materials = entities::<With<SpecularLobe>>(world);
    let gradient = (AlbedoGradient::default(), TexelSeen::default());
    let moments = AlbedoMoments::default();
    let (of_sheen, of_blend) = (SheenGradient::default(), BlendGradient::default());
    let (sheen_moments, blend_moments) = (SheenMoments::default(), BlendMoments::default());
    // All at once: each table that texels leave keeps its memory.
    match (sheen, materials.len() > 1) {
        (false, false) => give(world, texels, gradient, moments, begins),
        (true, false) => give(world, texels, (gradient, of_sheen), (moments, sheen_moments), begins),
        (false, true) => give(world, texels, (gradient, of_blend), (moments, blend_moments), begins),
        (true, true) => {
            let gradients = (gradient, of_sheen, of_blend);
            give(world, texels, gradients, (moments, sheen_moments, blend_moments), begins);
        }
    }
    give(world, lobes, (), LobeMoments::default(), begins);
    give(world, materials, (), SpecularMoments::default(), begins);
}

/// Gives gradients, and moments to those that have none or all where a fit `begins`.
fn give<G: Bundle + Clone, M: Bundle + Clone>(
    world: &mut World,
    entities: Vec<Entity>,
    gradients: G,
    moments: M,
    begins: bool,
) {
    for entity in entities {
        let mut entity = world.entity_mut(entity);
        if begins {
            entity.insert((gradients.clone(), moments.clone()));
        } else {
            entity.insert(gradients.clone()).insert_if_new(moments.clone());
        }
    }
}

/// The entities that a filter selects.
pub(crate) fn entities<F: QueryFilter>(world: &mut World) -> Vec<Entity> {
    world.query_filtered::<Entity, F>().iter(world).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rates_fall_at_the_milestones() {
        let (milestones, rates) = (vec![0.3, 0.8], [1.0, 2.0, 4.0]);
        let options = FitOptions { steps: 10, milestones, decay: 0.5, rates, ..Default::default() };
        let lights: Vec<f32> = (1..=10).map(|step| options.rates_at(step, step).light).collect();
        assert_eq!(lights, [2.0, 2.0, 2.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.5, 0.5]);
    }
}
