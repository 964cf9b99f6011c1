//! Steps of a fit that are not finite: traced, taken back, and without any trace in what is found.

use crate::common::{RADIUS, column, day, photographs_of, studio};
use lobelia::fit::cameras::{CameraFit, CameraUnknowns};
use lobelia::fit::components::{
    AlbedoGradient, AlbedoMoments, LobeMoments, SpecularMoments, StepRates, Unknowns,
};
use lobelia::fit::exposure::{ExposureChoice, Exposures};
use lobelia::fit::guard::{StepGuard, check_adjoints};
use lobelia::fit::sheen::{SheenGradient, SheenMoments};
use lobelia::sg::shading::{Layers, PointAdjoint};
use lobelia::shape::{run::GeometryPlugin, vertices::MovingMesh};
use lobelia::{ecs::*, fit::scale::ScaleMoments, prelude::*};
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

/// Whether this is a step in which this value is to be NaN.
fn is_due(place: Place) -> impl Fn(Res<Poison>, Res<StepRates>) -> bool + Clone {
    move |poison, rates| poison.place == place && poison.steps.contains(&rates.step)
}

fn poison_radiance(samples: Samples<&mut Layers>) -> SystemResult {
    samples.columns()?.iter_mut().for_each(|layers| layers.specular[1] = f32::NAN);
    Ok(())
}

fn poison_adjoints(samples: Samples<&mut PointAdjoint>) -> SystemResult {
    let mut back = samples.columns()?;
    (back[3].albedo[1], back[5].normal[1]) = (f32::NAN, f32::NAN);
    Ok(())
}

/// All that a fit moves or sums from step to step, in words.
fn state(world: &mut World) -> String {
    let texels: Vec<Diffuse> = column(world);
    let albedo: (Vec<AlbedoGradient>, Vec<AlbedoMoments>) = (column(world), column(world));
    let sheen: (Vec<SheenGradient>, Vec<SheenMoments>) = (column(world), column(world));
    let lights: Vec<_> = world.query::<(&LightLobe, &LobeMoments)>().iter(world).collect();
    let mut words = format!("{texels:?} {albedo:?} {sheen:?} {lights:?}");
    let gloss: Vec<_> = world.query::<(&SpecularLobe, &SpecularMoments)>().iter(world).collect();
    words += &format!("{gloss:?} {:?} {:?}", world.resource::<ScaleMoments>(), world.resource::<Exposures>());
    words
}

/// A fit of a photograph of the studio in which something is NaN in some steps; its state after
/// each step.
fn poisoned_fit(
    poison: Poison,
    options: &FitOptions,
    prepare: impl FnOnce(&mut Pipeline),
) -> (Pipeline, Result<FitSummary>, Vec<String>) {
    let mut truth = studio(&day());
    let mut pipeline = studio(&LightLobe::even(16));
    pipeline.add_plugin(&FitPlugin).add_plugin(&GeometryPlugin);
    spawn_views(&mut pipeline.world, photographs_of(&mut truth, 1, 24, |_, _| ()));
    prepare(&mut pipeline);
    pipeline.world.insert_resource(poison);
    let radiance = |place| poison_radiance.run_if(is_due(place));
    let adjoints = |place| poison_adjoints.run_if(is_due(place));
    pipeline
        .add_systems(Phase::FitStep, Stage::Shade, radiance(Place::Radiance).after(Slot::Shading))
        .add_systems(
            Phase::FitStep,
            Stage::Gradient,
            (
                adjoints(Place::Adjoint).after(Slot::ShadingAdjoint).before(check_adjoints),
                adjoints(Place::Vertices).after(ScatterAdjoints).before(Slot::ShapeGradient),
                radiance(Place::Cameras).after(Slot::ShapeGradient).before(Slot::CameraGradient),
            ),
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

#[test]
fn a_step_that_is_not_finite_is_taken_back_and_counted() {
    let fit = |steps: Range<u32>| {
        let options = FitOptions { steps: 40, batch: 64, ..FitOptions::default() };
        poisoned_fit(Poison { steps, place: Place::Radiance }, &options, |_| ())
    };
    let (mut pipeline, summary, _) = fit(10..14);
    assert_eq!(summary.unwrap().steps, 40);
    let guard = pipeline.world.resource::<StepGuard>();
    assert_eq!(guard.taken_back, 4);
    let first = guard.first.clone().unwrap();
    assert!(first.starts_with("step 10: the radiance is not finite at view front, pixel ("), "{first}");
    let world = &mut pipeline.world;
    assert!(column::<Diffuse>(world).iter().all(|texel| texel.albedo.is_finite()));
    assert!(world.query::<&LightLobe>().iter(world).all(|lobe| lobe.amplitude.is_finite()));
    // A fit of which no step is finite ends with the place.
    let error = fit(5..99).1.unwrap_err().to_string();
    for word in ["fit, step 14", "10 steps in a row", "at view front, pixel (", "no parameter"] {
        assert!(error.contains(word), "no {word:?} in {error}");
    }
}

#[test]
fn the_steps_that_are_taken_back_change_nothing_else() {
    let unknowns = Unknowns { sheen: true, ..Unknowns::default() };
    let exposure = ExposureChoice::Color;
    let options = FitOptions { steps: 24, batch: 64, unknowns, exposure, ..FitOptions::default() };
    let states = |place: Place, steps: Range<u32>| {
        let (pipeline, summary, states) = poisoned_fit(Poison { steps, place }, &options, |_| ());
        summary.unwrap();
        (states, pipeline.world.resource::<StepGuard>().taken_back)
    };
    let (sound, none) = states(Place::Radiance, 99..99);
    assert!(none == 0 && sound.windows(2).all(|pair| pair[0] != pair[1]), "every step changes something");
    // Wherever a step fails, what follows is the same.
    let [found, other] = [Place::Radiance, Place::Adjoint].map(|place| states(place, 10..14));
    assert!(found == other && found.1 == 4);
    let found = found.0;
    // Step n is number n − 1.
    assert!(found[..9] == sound[..9], "before");
    assert!((9..13).all(|step| found[step] == found[8]), "during");
    assert!(found[13..].windows(2).all(|pair| pair[0] != pair[1]), "the fit goes on");
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
        pipeline.world.insert_resource(CameraUnknowns::Poses);
    });
    assert!(first.contains("step 60: the gradient is not finite, by the camera of view number 0"), "{first}");
    let fit_of_cameras = pipeline.world.resource::<CameraFit>();
    assert!(fit_of_cameras.noise.iter().all(|noise| noise.is_finite()));
    let (first, pipeline) = fit(Place::Vertices, &|pipeline| {
        let surface = Arc::new(Surface::new(sphere_mesh(Vec3::ZERO, RADIUS).unwrap(), 32).unwrap());
        pipeline.world.insert_resource(MovingMesh::new(surface, 110, Vec::new()));
    });
    assert!(first.contains("step 60: the gradient is not finite, by vertex "), "{first}");
    let positions = &pipeline.world.resource::<MovingMesh>().surface.mesh().positions;
    assert!(positions.iter().all(|position| position.is_finite()));
    assert!(positions.iter().any(|position| (position.length() - RADIUS).abs() > 1e-6), "they move");
}
