//! Running a fit: prepare the pool, make a first guess, step until done.

use super::components::{
    AlbedoGradient, AlbedoMoments, LobeGradient, LobeMoments, LossState, SpecularGradient, SpecularMoments,
    StepGradient, StepRates, TexelSeen, Unknowns,
};
use super::exposure::{Exposures, find_exposures};
use super::first_guess::{solve_albedo, solve_amplitudes};
use super::loss::{Loss, LossSums};
use super::observe::{Candidates, PixelChoice, choose_pixels, count_seen_texels, trace_pixels};
use super::systems::{
    compare_with_photographs, hand_out_gradient, move_lobes, move_specular, move_texels, pull_back_radiance,
    scatter_to_texels,
};
use crate::error::Result;
use crate::light::LightLobe;
use crate::material::{DiffuseAlbedo, SpecularLobe};
use crate::math::shading::{ClosedForm, Layers, ShadePoint, SpecularValue};
use crate::shade::pool::{despawn_pool, only_table};
use crate::shade::systems::{kernel_lobe, kernel_specular};
use crate::shade::{IncidentLight, ShadingForm, gather_points, provide_lobes, shade_closed_form};
use crate::stage::{Phase, Pipeline, Plugin, Slot, Stage};
use crate::surface::point::SurfacePoint;
use crate::view::pixel::{Observed, PixelOf, Window};
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
    /// Whether each photograph's exposure is unknown.
    pub exposure: bool,
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
        pipeline.world.init_resource::<Window>();
        pipeline.world.init_resource::<Exposures>();
        pipeline.world.init_resource::<IncidentLight>();
        pipeline.world.init_resource::<ShadingForm>();
        pipeline
            .add_systems(Phase::Prepare, Stage::Sample, choose_pixels)
            .add_systems(Phase::Prepare, Stage::Trace, trace_pixels)
            .add_systems(Phase::Prepare, Stage::Gather, (count_seen_texels, gather_points))
            .add_systems(Phase::FitStep, Stage::Gather, gather_points)
            .swap(Phase::FitStep, Slot::Light, provide_lobes)
            .swap(Phase::FitStep, Slot::Shading, shade_closed_form)
            .add_systems(Phase::FitStep, Stage::Loss, (find_exposures, compare_with_photographs).chain())
            .add_systems(
                Phase::FitStep,
                Stage::Gradient,
                (pull_back_radiance, scatter_to_texels, hand_out_gradient)
                    .chain()
                    .before(Slot::ShapeGradient),
            )
            .swap(Phase::FitStep, Slot::Optimizer, (move_texels, move_lobes, move_specular));
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
    pipeline.world.insert_resource(ShadingForm(options.form));
    pipeline.world.insert_resource(LossState { loss: options.loss, last: LossSums::default() });
    pipeline.world.resource_mut::<Exposures>().unknown = options.exposure;
    pipeline.run(Phase::Prepare)?;
    let pixels = pipeline.world.resource::<Window>().0.len();
    let unknowns = Unknowns {
        light: options.unknowns.light && options.guess.light,
        albedo: options.unknowns.albedo && options.guess.albedo,
        ..options.unknowns
    };
    make_first_guess(&mut pipeline.world, unknowns)?;
    let mut recent: Vec<LossSums> = Vec::new();
    let mut summary = FitSummary { steps: 0, pixels, elapsed_secs: 0.0, stopped: false };
    for step in 1..=options.steps {
        pipeline.world.resource_mut::<Window>().0 = window_of(step, options.batch, pixels);
        pipeline.world.insert_resource(rates_at(step, options));
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

fn first_specular(world: &mut World) -> SpecularLobe {
    let lobe = world.query::<&SpecularLobe>().iter(world).next().copied();
    lobe.unwrap_or(SpecularLobe::new(Vec3::ZERO, 1.0))
}

/// Gives texels and lobes fresh gradients and moments.
fn attach_state(world: &mut World) {
    let texels: Vec<Entity> =
        world.query_filtered::<Entity, (With<DiffuseAlbedo>, Without<PixelOf>)>().iter(world).collect();
    for texel in texels {
        let state = (AlbedoGradient::default(), AlbedoMoments::default(), TexelSeen::default());
        world.entity_mut(texel).insert(state);
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

/// Most pixels the amplitudes are solved from.
const AMPLITUDE_PIXELS: usize = 6144;
/// Most pixels the albedo is solved from in all but the last round.
const ALBEDO_PIXELS: usize = 400_000;
/// Rounds of light, then albedo.
const ROUNDS: usize = 4;

/// Alternates amplitudes and albedo, whichever are unknown, from grey.
fn make_first_guess(world: &mut World, unknowns: Unknowns) -> Result<()> {
    if !unknowns.light && !unknowns.albedo {
        return Ok(());
    }
    let mut lobes: Vec<LightLobe> = world.query::<&LightLobe>().iter(world).copied().collect();
    let specular = kernel_specular(&first_specular(world));
    let form = world.resource::<ShadingForm>().0;
    let mut texels: Vec<Vec3> = world.query::<&DiffuseAlbedo>().iter(world).map(|a| a.0).collect();
    {
        let mut query = world.query::<(&SurfacePoint, &ShadePoint, &Observed)>();
        let query = query.query(world);
        let chunks = query.contiguous_iter().map_err(|e| crate::Error::run("fit", e.to_string()))?;
        let Some((points, gathered, observed)) = only_table(chunks, |t| t.0.len(), "pixel")? else {
            return Ok(());
        };
        let mut guess = Guess { form, points, gathered, observed, specular, unknowns };
        guess.alternate(&mut lobes, &mut texels);
    }
    for (mut lobe, guess) in world.query::<&mut LightLobe>().iter_mut(world).zip(&lobes) {
        *lobe = *guess;
    }
    for (mut texel, guess) in world.query::<&mut DiffuseAlbedo>().iter_mut(world).zip(&texels) {
        texel.0 = *guess;
    }
    Ok(())
}

/// The data a first guess is made from.
struct Guess<'a> {
    form: ClosedForm,
    points: &'a [SurfacePoint],
    gathered: &'a [ShadePoint],
    observed: &'a [Observed],
    specular: SpecularValue,
    unknowns: Unknowns,
}

impl Guess<'_> {
    fn alternate(&mut self, lobes: &mut [LightLobe], texels: &mut Vec<Vec3>) {
        for round in 0..ROUNDS {
            if self.unknowns.light {
                let n = self.points.len().min(AMPLITUDE_PIXELS);
                let points: Vec<ShadePoint> = (0..n).map(|i| self.with_albedo(i, texels)).collect();
                let columns = crate::math::shading::LobeColumns::from_lobes(lobes.iter().map(kernel_lobe));
                let amplitudes =
                    solve_amplitudes(self.form, &points, &self.observed[..n], &self.specular, &columns, 1e-2);
                for (lobe, amplitude) in lobes.iter_mut().zip(amplitudes) {
                    lobe.amplitude = amplitude.max(Vec3::splat(1e-3));
                }
            }
            if self.unknowns.albedo {
                let n = if round + 1 == ROUNDS { self.points.len() } else { ALBEDO_PIXELS };
                *texels = self.albedo_under(lobes, texels.len(), n.min(self.points.len()));
            }
        }
    }

    fn with_albedo(&self, i: usize, texels: &[Vec3]) -> ShadePoint {
        ShadePoint { albedo: self.points[i].texels.blend(texels).into(), ..self.gathered[i] }
    }

    fn albedo_under(&self, lobes: &[LightLobe], texels: usize, n: usize) -> Vec<Vec3> {
        let columns = crate::math::shading::LobeColumns::from_lobes(lobes.iter().map(kernel_lobe));
        let white: Vec<ShadePoint> =
            self.gathered[..n].iter().map(|p| ShadePoint { albedo: [1.0; 3], ..*p }).collect();
        let mut unit = vec![Layers::default(); n];
        self.form.shade(&white, &self.specular, &columns, &mut unit);
        solve_albedo(&self.points[..n], &unit, &self.observed[..n], texels, Vec3::splat(0.4))
    }
}
