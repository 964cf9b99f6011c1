//! Guards against steps that are not finite: a step whose loss or gradient is not finite is traced
//! to its pixel and parameter, and not taken.
//!
//! Shapes, vertices and cameras look at their own gradients, with `is_usable`, and tell the
//! [`StepGuard`].
//!
//! Values that are not finite are set to zero, so that nothing that is kept from step to step takes
//! them up; `step_is_sound` then holds Update back, and Gradient too if they are found in Loss. If
//! they are found in Gradient, the rest of that stage runs on zeros.

use crate::fit::components::{AlbedoGradient, LossState, StepGradient};
use crate::fit::exposure::Exposures;
use crate::fit::{loss::LossSums, roughness::BlendGradient, sheen::SheenGradient};
use bevy_ecs::component::Mutable;
use bevy_ecs::prelude::{Component, Res, ResMut, Resource, World};
use lobelia_geometry::view::{Camera, ViewIndex, ViewName};
use lobelia_geometry::{Error, Result};
use lobelia_sg::shading::{Layers, LobeColumns, PointAdjoint, RadianceAdjoint, ShadePoint};
use lobelia_world::light::{LightLobe, groups::FittedLobe, lights::IncidentLight};
use lobelia_world::material::{Diffuse, SpecularBlend, SpecularLobe, TexelIndex};
use lobelia_world::pipeline::{SystemResult, pool::with_columns};
use lobelia_world::sample::pixel::{Observed, PixelOf};
use lobelia_world::sample::{Samples, point::SurfacePoint};
use serde::{Deserialize, Serialize};

/// Steps in a row that may be taken back; one more ends the fit.
const MOST_IN_A_ROW: u32 = 9;
/// Adjoints beyond this count as not finite: their squares, times the range of an amplitude, must
/// not overflow.
const LARGEST: f32 = 1e12;
/// Radiance beyond this counts as not finite.
const BRIGHTEST: f32 = 1e15;

/// Where a step that is not taken fails first: the quantity that is not finite ("the radiance",
/// "the gradient"), the pixel if it is one's, and the parameter that it is traced to ("light lobe
/// 3", "the albedo of texel 517").
type BadStep = (&'static str, Option<PixelOf>, String);

/// Counts the steps that were taken back, over all fits of a run.
#[derive(Resource, Clone, Debug, Default, Serialize, Deserialize)]
pub struct StepGuard {
    /// Why the step at work is not taken.
    #[serde(skip)]
    bad_step: Option<BadStep>,
    /// Steps that were not taken.
    pub taken_back: u32,
    /// In words: where the first of them failed.
    pub first: Option<String>,
    in_a_row: u32,
    /// Exposures before the step at work: they are found before its loss is.
    #[serde(skip)]
    exposures: Exposures,
}

impl StepGuard {
    /// Notes what is not finite, and the parameter that it is traced to; the first of a step
    /// counts.
    pub fn find(&mut self, what: &'static str, pixel: Option<PixelOf>, parameter: impl Into<String>) {
        self.bad_step.get_or_insert((what, pixel, parameter.into()));
    }
}

/// Whether everything in this step is finite.
pub fn step_is_sound(guard: Option<Res<StepGuard>>) -> bool {
    guard.is_none_or(|guard| guard.bad_step.is_none())
}

fn is_sound(values: &[f32], largest: f32) -> bool {
    // Not `all`, whose early exit keeps the loop from being a vector loop; comparisons with NaN are
    // false.
    values.iter().fold(true, |sound, value| sound & (value.abs() <= largest))
}

/// Whether a gradient can be used: it is finite, and so is what is made of it.
pub fn is_usable(gradient: &[f32]) -> bool {
    is_sound(gradient, LARGEST)
}

/// Loss: looks for radiance and photographs that are not finite.
pub fn check_shading(
    light: Res<IncidentLight>,
    mut guard: ResMut<StepGuard>,
    samples: Samples<(&PixelOf, &ShadePoint, &SurfacePoint, &mut Layers, &mut Observed)>,
) -> SystemResult {
    let (pixels, gathered, points, mut shaded, mut observed) = samples.columns()?;
    for i in 0..pixels.len() {
        let layers = &shaded[i];
        if !is_sound(&layers.diffuse, BRIGHTEST) || !is_sound(&layers.specular, BRIGHTEST) {
            let parameter = cause(&light.lobes, &gathered[i], &points[i]);
            guard.find("the radiance", Some(pixels[i]), parameter);
            shaded[i] = Layers::default();
        }
        if !is_sound(&observed[i].radiance.to_array(), BRIGHTEST) {
            guard.find("the photograph", Some(pixels[i]), "the photograph itself");
            observed[i] = Observed::default();
        }
    }
    Ok(())
}

/// The parameter that makes the radiance of a point what it is.
fn cause(lobes: &LobeColumns, gathered: &ShadePoint, point: &SurfacePoint) -> String {
    let is_bad = |i: &usize| {
        let lobe = lobes.get(*i);
        !is_sound(&lobe.axis, BRIGHTEST)
            || !is_sound(&lobe.amplitude, BRIGHTEST)
            || !lobe.sharpness.is_finite()
    };
    if let Some(lobe) = (0..lobes.len()).find(is_bad) {
        return format!("light lobe {lobe}");
    }
    if !is_sound(&gathered.albedo, BRIGHTEST) {
        return of_texel(point);
    }
    if !is_sound(&gathered.normal, BRIGHTEST) {
        return "the normal of the surface".into();
    }
    "no parameter: all are finite".into()
}

/// The albedo of the texel that counts most at a point.
fn of_texel(point: &SurfacePoint) -> String {
    format!("the albedo of texel {}", point.texels.main())
}

/// Loss: looks for a loss, or an adjoint of it, that is not finite.
pub fn check_loss(
    mut state: ResMut<LossState>,
    mut guard: ResMut<StepGuard>,
    samples: Samples<(&PixelOf, &mut RadianceAdjoint)>,
) -> SystemResult {
    let (pixels, mut adjoint) = samples.columns()?;
    for (pixel, adjoint) in pixels.iter().zip(adjoint.iter_mut()) {
        if !is_sound(&adjoint.0, LARGEST) {
            guard.find("the loss", Some(*pixel), "the radiance there");
            *adjoint = RadianceAdjoint::default();
        }
    }
    if !(state.last.loss.is_finite() && state.last.clipped_squares.is_finite()) {
        guard.find("the loss", None, "the sum over the pixels of the step");
    }
    if guard.bad_step.is_some() {
        state.last = LossSums::default();
    }
    Ok(())
}

/// Gradient: looks for adjoints that are not finite; with one, all become zero.
pub fn check_adjoints(
    mut guard: ResMut<StepGuard>,
    mut gradient: ResMut<StepGradient>,
    samples: Samples<(&PixelOf, &SurfacePoint, &RadianceAdjoint, &mut PointAdjoint)>,
) -> SystemResult {
    let (pixels, points, radiance, mut back) = samples.columns()?;
    let bad = back.iter().position(|of| !is_sound(&of.albedo, LARGEST) || !is_sound(&of.normal, LARGEST));
    if let Some(i) = bad {
        let is_albedo = !is_sound(&back[i].albedo, LARGEST);
        let parameter = if is_albedo { of_texel(&points[i]) } else { "the normal of the surface".into() };
        guard.find("the gradient", Some(pixels[i]), parameter);
    }
    let blended = gradient.blends.iter().position(|blend| !is_sound(blend, LARGEST));
    if let Some(i) = blended {
        guard.find("the gradient", pixels.get(i).copied(), "the blend of base materials there");
    }
    if let Some(parameter) = shared_parameter(&gradient) {
        // Sums do not say whose they are: the pixel with the largest adjoint is the likeliest.
        let weight = |i: &usize| radiance[*i].0.iter().map(|value| value.abs()).fold(0.0, f32::max);
        let worst = (0..pixels.len()).max_by(|a, b| weight(a).total_cmp(&weight(b)));
        guard.find("the gradient", worst.map(|i| pixels[i]), parameter);
    }
    if guard.bad_step.is_some() {
        back.fill(PointAdjoint::default());
        gradient.blends.iter_mut().for_each(|blend| blend.fill(0.0));
        gradient.shared.lobes = LobeColumns::zeros(gradient.shared.lobes.len());
        gradient.shared.specular = Default::default();
        gradient.specular.iter_mut().for_each(|specular| *specular = Default::default());
    }
    Ok(())
}

/// The first light lobe or base material whose gradient is not finite.
fn shared_parameter(gradient: &StepGradient) -> Option<String> {
    let bad = |parts: &[(&'static str, [f32; 3])]| {
        parts.iter().find(|(_, values)| !is_sound(values, LARGEST)).map(|(part, _)| *part)
    };
    let of_lobe = |i: usize| {
        let lobe = gradient.shared.lobes.get(i);
        let parts = [("axis", lobe.axis), ("amplitude", lobe.amplitude), ("sharpness", [lobe.sharpness; 3])];
        bad(&parts).map(|part| format!("the {part} of light lobe {i}"))
    };
    let of_material = |k: usize| {
        let specular = &gradient.specular[k];
        let parts = [("specular albedo", specular.albedo), ("roughness", [specular.roughness; 3])];
        bad(&parts).map(|part| format!("the {part} of base material {k}"))
    };
    (0..gradient.shared.lobes.len())
        .find_map(of_lobe)
        .or_else(|| (0..gradient.specular.len()).find_map(of_material))
}

/// Forgets why the step before was not taken.
pub(super) fn begin_step(world: &mut World) {
    let exposures = world.resource::<Exposures>().clone();
    let mut guard = world.resource_mut::<StepGuard>();
    (guard.bad_step, guard.exposures) = (None, exposures);
}

/// Counts a step that was not taken.
///
/// # Errors
/// [`Error::Run`] if too many in a row were not.
pub(super) fn end_step(world: &mut World, step: u32) -> Result<()> {
    let mut guard = world.resource_mut::<StepGuard>();
    let before = std::mem::take(&mut guard.exposures);
    let Some(bad_step) = guard.bad_step.take() else {
        guard.in_a_row = 0;
        return Ok(());
    };
    let place = words(world, bad_step);
    // What is summed until the next step must not reach it.
    forget::<AlbedoGradient>(world);
    forget::<SheenGradient>(world);
    forget::<BlendGradient>(world);
    world.insert_resource(before);
    let mut guard = world.resource_mut::<StepGuard>();
    guard.taken_back += 1;
    guard.in_a_row += 1;
    guard.first.get_or_insert_with(|| format!("step {step}: {place}"));
    if guard.in_a_row <= MOST_IN_A_ROW {
        return Ok(());
    }
    let problem = format!("{} steps in a row cannot be taken: {place}", guard.in_a_row);
    guard.in_a_row = 0;
    Err(Error::run(format!("fit, step {step}"), problem))
}

fn forget<T: Component<Mutability = Mutable> + Default>(world: &mut World) {
    world.query::<&mut T>().iter_mut(world).for_each(|mut gradient| *gradient = T::default());
}

/// "the gradient is not finite at view rgb_000003, pixel (12, 40), by the albedo of texel 517"
fn words(world: &mut World, (what, pixel, parameter): BadStep) -> String {
    let at = pixel.map(|PixelOf { view, pixel }| {
        let mut views = world.query::<(&ViewIndex, &ViewName, &Camera)>();
        let found = views.iter(world).find(|(index, ..)| **index == view);
        found.map_or(format!(" at view number {}, pixel {pixel}", view.0), |(_, name, camera)| {
            let width = camera.width.max(1);
            format!(" at view {}, pixel ({}, {})", name.0, pixel % width, pixel / width)
        })
    });
    format!("{what} is not finite{}, by {parameter}", at.unwrap_or_default())
}

/// Checks what a fit has found before any of it is written.
///
/// # Errors
/// [`Error::Run`] that names the first parameter that is not finite.
pub fn check_parameters(world: &mut World) -> Result<()> {
    let mut lobes = world.query_filtered::<&LightLobe, FittedLobe>();
    let is_finite =
        |lobe: &LightLobe| lobe.axis.is_finite() && lobe.sharpness.is_finite() && lobe.amplitude.is_finite();
    check_all("light lobe", lobes.iter(world).map(is_finite))?;
    let mut materials = world.query::<&SpecularLobe>();
    if !materials.iter(world).all(|lobe| lobe.albedo.is_finite() && lobe.roughness.is_finite()) {
        return Err(not_finite("a specular lobe"));
    }
    let mut views = world.query::<(&ViewName, &Camera)>();
    if let Some((name, problem)) = views.iter(world).find_map(|(name, c)| Some((name, c.check().err()?))) {
        return Err(Error::run("fit", format!("the camera of view {} is lost: {problem}", name.0)));
    }
    check_texels(world, "albedo", |texel: &Diffuse| texel.albedo.is_finite())?;
    check_texels(world, "sheen", |texel: &Diffuse| texel.sheen.is_finite())?;
    check_texels(world, "tilt", |texel: &Diffuse| texel.tilt.is_finite())?;
    check_texels(world, "blend", |blend: &SpecularBlend| blend.0.iter().all(|weight| weight.is_finite()))
}

fn check_texels<T: Component + Copy>(world: &mut World, what: &str, is_finite: fn(&T) -> bool) -> Result<()> {
    with_columns::<TexelIndex, &T, _>(world, |column| {
        check_all(&format!("the {what} of texel"), column.iter().map(is_finite))
    })
}

/// Checks numbers of a surface that was found, such as values of a field or coordinates of
/// vertices, before any of it is written.
///
/// # Errors
/// [`Error::Run`] that names the first that is not finite: `what` and its place.
pub fn check_numbers(what: &str, numbers: impl Iterator<Item = f32>) -> Result<()> {
    check_all(what, numbers.map(f32::is_finite))
}

fn check_all(what: &str, mut are_finite: impl Iterator<Item = bool>) -> Result<()> {
    let bad = are_finite.position(|is_finite| !is_finite);
    bad.map_or(Ok(()), |i| Err(not_finite(&format!("{what} {i}"))))
}

fn not_finite(what: &str) -> Error {
    Error::run("fit", format!("{what} is not finite: nothing of it is written"))
}
