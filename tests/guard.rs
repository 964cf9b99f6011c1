//! Steps of a fit that are not finite: traced, taken back, and without any trace in what is found.

use crate::common::{RADIUS, camera, day, photograph, studio};
use lobelia::fit::cameras::{CameraFit, CameraPlugin, CameraUnknowns};
use lobelia::fit::components::{
    AlbedoGradient, AlbedoMoments, LobeMoments, SpecularMoments, StepRates, Unknowns,
};
use lobelia::fit::exposure::{ExposureChoice, Exposures};
use lobelia::fit::guard::{StepGuard, check_adjoints};
use lobelia::fit::scale::ScaleMoments;
use lobelia::fit::sheen::{SheenGradient, SheenMoments};
use lobelia::prelude::*;
use lobelia::sg::shading::{Layers, PointAdjoint};
use lobelia::shape::vertices::{MovingMesh, VertexPlugin};
use std::ops::{ControlFlow, Range};

/// Value that is made NaN in some steps of a fit.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Place {
    /// The radiance of a sample.
    Radiance,
    /// The adjoint of a sample's albedo.
    Adjoint,
    /// The moves of vertices.
    Vertices,
    /// The moves of cameras.
    Cameras,
}

#[derive(Resource)]
struct Poison {
    steps: Range<u32>,
    place: Place,
}

impl Poison {
    fn is_due(&self, place: Place, rates: &StepRates) -> bool {
        self.place == place && self.steps.contains(&rates.step)
    }
}

fn poison_radiance<const PLACE: usize>(
    poison: Res<Poison>,
    rates: Res<StepRates>,
    samples: Samples<&mut Layers>,
) -> SystemResult {
    if poison.is_due([Place::Radiance, Place::Cameras][PLACE], &rates) {
        samples.columns()?.iter_mut().for_each(|layers| layers.specular[1] = f32::NAN);
    }
    Ok(())
}

fn poison_adjoints<const PLACE: usize>(
    poison: Res<Poison>,
    rates: Res<StepRates>,
    samples: Samples<&mut PointAdjoint>,
) -> SystemResult {
    if poison.is_due([Place::Adjoint, Place::Vertices][PLACE], &rates) {
        let mut back = samples.columns()?;
        (back[3].albedo[1], back[5].normal[1]) = (f32::NAN, f32::NAN);
    }
    Ok(())
}

/// All that a fit moves or sums from step to step, in words.
fn state(world: &mut World) -> String {
    let texels = (
        read_column::<TexelIndex, DiffuseAlbedo>(world).unwrap(),
        read_column::<TexelIndex, AlbedoGradient>(world).unwrap(),
        read_column::<TexelIndex, AlbedoMoments>(world).unwrap(),
        read_column::<TexelIndex, DiffuseSheen>(world).unwrap(),
        read_column::<TexelIndex, SheenGradient>(world).unwrap(),
        read_column::<TexelIndex, SheenMoments>(world).unwrap(),
    );
    let lights: Vec<_> = world.query::<(&LightLobe, &LobeMoments)>().iter(world).collect();
    let mut words = format!("{texels:?} {lights:?}");
    let gloss: Vec<_> = world.query::<(&SpecularLobe, &SpecularMoments)>().iter(world).collect();
    words += &format!("{gloss:?} {:?} {:?}", world.resource::<ScaleMoments>(), world.resource::<Exposures>());
    words
}

/// A fit of a photograph of the studio in which something is NaN in some steps; its state after each step.
fn poisoned_fit(
    poison: Poison,
    options: &FitOptions,
    prepare: impl FnOnce(&mut Pipeline),
) -> (Pipeline, Result<FitSummary>, Vec<String>) {
    let mut truth = studio(&day());
    let mut pipeline = studio(&LightLobe::even(16));
    pipeline.add_plugin(&FitPlugin);
    let view = photograph(&mut truth, camera([0.1, 0.2, 1.0], 24), |_| ());
    spawn_views(&mut pipeline.world, vec![view]);
    prepare(&mut pipeline);
    pipeline.world.insert_resource(poison);
    let late = poison_adjoints::<1>.after(ScatterAdjoints).before(Slot::ShapeGradient);
    pipeline
        .add_systems(Phase::FitStep, Stage::Shade, poison_radiance::<0>.after(Slot::Shading))
        .add_systems(
            Phase::FitStep,
            Stage::Gradient,
            poison_adjoints::<0>.after(Slot::ShadingAdjoint).before(check_adjoints),
        )
        .add_systems(Phase::FitStep, Stage::Gradient, late)
        .add_systems(
            Phase::FitStep,
            Stage::Gradient,
            poison_radiance::<1>.after(Slot::ShapeGradient).before(Slot::CameraGradient),
        );
    let mut states = Vec::new();
    let summary = run_fit(&mut pipeline, options, &mut |_, world| {
        if options.unknowns.sheen {
            states.push(state(world));
        }
        ControlFlow::Continue(())
    });
    (pipeline, summary, states)
}

/// A fit of which steps `from` to `to` are poisoned.
fn poisoned(from: u32, to: u32) -> (Pipeline, Result<FitSummary>) {
    let options = FitOptions { steps: 40, batch: 64, ..FitOptions::default() };
    let poison = Poison { steps: from..to, place: Place::Radiance };
    let (pipeline, summary, _) = poisoned_fit(poison, &options, |_| ());
    (pipeline, summary)
}

#[test]
fn a_step_that_is_not_finite_is_taken_back_and_counted() {
    let (mut pipeline, summary) = poisoned(10, 14);
    assert_eq!(summary.unwrap().steps, 40);
    let guard = pipeline.world.resource::<StepGuard>();
    assert_eq!(guard.taken_back, 4);
    let first = guard.first.clone().unwrap();
    assert!(first.starts_with("step 10: the radiance is not finite at view front, pixel ("), "{first}");
    let world = &mut pipeline.world;
    let albedo = read_column::<TexelIndex, DiffuseAlbedo>(world).unwrap();
    assert!(albedo.iter().all(|albedo| albedo.0.is_finite()));
    assert!(world.query::<&LightLobe>().iter(world).all(|lobe| lobe.amplitude.is_finite()));
}

#[test]
fn the_steps_that_are_taken_back_change_nothing_else() {
    let unknowns = Unknowns { sheen: true, ..Unknowns::default() };
    let options = FitOptions {
        steps: 24,
        batch: 64,
        unknowns,
        exposure: ExposureChoice::Color,
        ..FitOptions::default()
    };
    let states = |place: Place, steps: Range<u32>| {
        let (pipeline, summary, states) = poisoned_fit(Poison { steps, place }, &options, |_| ());
        summary.unwrap();
        (states, pipeline.world.resource::<StepGuard>().taken_back)
    };
    let (sound, none) = states(Place::Radiance, 99..99);
    assert!(none == 0 && sound.windows(2).all(|pair| pair[0] != pair[1]), "every step changes something");
    for place in [Place::Radiance, Place::Adjoint] {
        let (found, taken_back) = states(place, 10..14);
        assert_eq!(taken_back, 4);
        // Step n is number n − 1.
        assert!(found[..9] == sound[..9], "{place:?}: before");
        assert!((9..13).all(|step| found[step] == found[8]), "{place:?}: during");
        assert!(found[13..].windows(2).all(|pair| pair[0] != pair[1]), "{place:?}: the fit goes on");
    }
    // Wherever a step fails, what follows is the same.
    assert!(states(Place::Radiance, 10..14).0 == states(Place::Adjoint, 10..14).0);
}

#[test]
fn steps_of_vertices_and_cameras_that_are_not_finite_are_taken_back() {
    let options = FitOptions { steps: 110, batch: 64, ..FitOptions::default() };
    let fit = |place: Place, prepare: &dyn Fn(&mut Pipeline)| {
        let (mut pipeline, summary, _) = poisoned_fit(Poison { steps: 60..63, place }, &options, prepare);
        summary.unwrap();
        let cameras = pipeline.world.query::<&Camera>();
        assert!(cameras.iter_manual(&pipeline.world).all(|camera| camera.check().is_ok()));
        let guard = pipeline.world.resource::<StepGuard>();
        assert_eq!(guard.taken_back, 3);
        (guard.first.clone().unwrap(), pipeline)
    };
    let (first, pipeline) = fit(Place::Cameras, &|pipeline| {
        _ = pipeline.add_plugin(&CameraPlugin(CameraUnknowns::Poses));
    });
    assert!(first.contains("step 60: the gradient is not finite, by the camera of view number 0"), "{first}");
    let fit_of_cameras = pipeline.world.resource::<CameraFit>();
    assert!(fit_of_cameras.noise.iter().all(|noise| noise.is_finite()));
    let (first, pipeline) = fit(Place::Vertices, &|pipeline| {
        let surface = Surface::new(sphere_mesh(Vec3::ZERO, RADIUS).unwrap(), 32).unwrap();
        _ = pipeline.add_plugin(&VertexPlugin {
            surface: Arc::new(surface),
            steps: 110,
            silhouettes: Arc::default(),
        });
    });
    assert!(first.contains("step 60: the gradient is not finite, by vertex "), "{first}");
    let positions = &pipeline.world.resource::<MovingMesh>().surface.mesh().positions;
    assert!(positions.iter().all(|position| position.is_finite()));
    assert!(positions.iter().any(|position| (position.length() - RADIUS).abs() > 1e-6), "they move");
}

#[test]
fn a_fit_of_which_no_step_is_finite_ends_with_the_place() {
    let error = poisoned(5, 99).1.unwrap_err().to_string();
    for word in ["fit, step 14", "10 steps in a row", "at view front, pixel (", "no parameter"] {
        assert!(error.contains(word), "no {word:?} in {error}");
    }
}
