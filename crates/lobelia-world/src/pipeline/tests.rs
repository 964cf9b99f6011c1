use super::*;
use crate::material::Diffuse;
use bevy_ecs::prelude::{Changed, Component, Entity, Query, ResMut, Resource};
use std::sync::atomic::{AtomicU32, Ordering};

#[derive(Resource, Default)]
struct Trail(Vec<&'static str>);

fn say(word: &'static str) -> impl FnMut(ResMut<Trail>) {
    move |mut trail| trail.0.push(word)
}

fn sample(mut trail: ResMut<Trail>) {
    trail.0.push("sample");
}

fn fail() -> SystemResult {
    Err(Error::input("a.png", "pixel (3, 4)", "not finite", "mask it").into())
}

fn pipeline() -> Pipeline {
    let mut pipeline = Pipeline::new();
    pipeline.world.init_resource::<Trail>();
    pipeline
        .add_systems(Phase::Frame, Stage::Write, say("write"))
        .add_systems(Phase::Frame, Stage::Sample, sample)
        .swap(Phase::Frame, Slot::Shading, say("shade"));
    pipeline
}

fn trail(pipeline: &mut Pipeline) -> String {
    std::mem::take(&mut pipeline.world.resource_mut::<Trail>().0).join(" ")
}

#[test]
fn a_system_error_stops_the_run_and_reaches_the_caller_whole() {
    let mut pipeline = pipeline();
    pipeline.swap(Phase::Frame, Slot::Shading, fail);
    let error = pipeline.run(Phase::Frame).expect_err("the system fails");
    assert_eq!(error.to_string(), "a.png, pixel (3, 4): not finite");
    assert_eq!(error.help(), Some("mask it"));
    assert_eq!(error.exit_code(), 2);
    assert_eq!(trail(&mut pipeline), "sample");
    pipeline.swap(Phase::Frame, Slot::Shading, say("shade"));
    assert!(pipeline.run(Phase::Frame).is_ok(), "the pipeline goes on after the cause is gone");
}

static COUNTED: AtomicU32 = AtomicU32::new(0);

/// An error handler of a user's own.
fn counting(_: BevyError, _: ErrorContext) {
    COUNTED.fetch_add(1, Ordering::Relaxed);
}

#[test]
fn a_run_leaves_the_error_handler_of_the_world_as_it_was() -> Result<()> {
    let mut plain = pipeline();
    plain.run(Phase::Frame)?;
    assert!(!plain.world.contains_resource::<FallbackErrorHandler>(), "after a run");
    plain.swap(Phase::Frame, Slot::Shading, fail);
    assert!(plain.run(Phase::Frame).is_err() && plain.run(Preview).is_err());
    assert!(!plain.world.contains_resource::<FallbackErrorHandler>(), "after a failure");

    let mut own = pipeline();
    own.world.insert_resource(FallbackErrorHandler(counting));
    own.swap(Phase::Frame, Slot::Shading, fail);
    let before = COUNTED.load(Ordering::Relaxed);
    assert!(own.run(Phase::Frame).is_err());
    assert_eq!(COUNTED.load(Ordering::Relaxed), before, "the run has the pipeline's handler");
    own.world.run_schedule(Phase::Frame);
    assert_eq!(COUNTED.load(Ordering::Relaxed), before + 1, "the user's is back");
    assert_eq!(trail(&mut own), "sample sample write", "and no failed run holds systems back");
    Ok(())
}

#[test]
fn a_run_inside_another_one_has_its_own_error() {
    let mut outer = pipeline();
    let mut inner = pipeline();
    inner.swap(Phase::Frame, Slot::Shading, fail);
    let run_inner = move |mut trail: ResMut<Trail>| {
        assert!(inner.run(Phase::Frame).is_err());
        trail.0.push("inner");
    };
    outer.swap(Phase::Frame, Slot::Shading, run_inner);
    assert!(outer.run(Phase::Frame).is_ok());
    assert_eq!(trail(&mut outer), "sample inner write");
}

#[test]
fn a_missing_resource_and_a_missing_phase_are_errors_not_panics() {
    let mut pipeline = Pipeline::new();
    pipeline.add_systems(Phase::Frame, Stage::Sample, sample);
    let error = pipeline.run(Phase::Frame).expect_err("there is no Trail");
    assert_eq!(error.exit_code(), 1);
    assert!(error.to_string().contains("sample"), "{error}");
    let error = pipeline.run(Preview).expect_err("it was not added");
    assert!(error.to_string().contains("Preview"), "{error}");
}

/// A phase of a user's own.
#[derive(ScheduleLabel, Clone, Debug, PartialEq, Eq, Hash)]
struct Preview;

#[test]
fn users_have_phases_of_their_own() -> Result<()> {
    let mut pipeline = pipeline();
    pipeline.add_phase(Preview).add_systems(Preview, Stage::Write, say("write"));
    pipeline.swap(Preview, Slot::Shading, say("shade"));
    pipeline.run(Preview)?;
    pipeline.clear(Preview, Slot::Shading);
    pipeline.run(Preview)?;
    assert_eq!(trail(&mut pipeline), "shade write write");
    Ok(())
}

#[test]
fn own_systems_go_before_and_after_every_built_in_set() -> Result<()> {
    let mut pipeline = Pipeline::new();
    pipeline.world.init_resource::<Trail>();
    let words = ["visibility", "material", "light", "shading"];
    for (slot, word) in [Slot::Visibility, Slot::Material, Slot::Light, Slot::Shading].into_iter().zip(words)
    {
        pipeline.swap(Phase::Frame, slot, say(word));
    }
    let own = (
        say("points").in_set(GatherPoints),
        say("before points").before(GatherPoints).after(Slot::Light),
        say("after points").after(GatherPoints).before(Slot::Visibility),
        say("before material").before(Slot::Material),
    );
    pipeline.add_systems(Phase::Frame, Stage::Gather, own);
    pipeline.add_systems(Phase::Frame, Stage::Shade, say("after shading").after(Slot::Shading));
    pipeline.run(Phase::Frame)?;
    let expected =
        "before material material light before points points after points visibility shading after shading";
    assert_eq!(trail(&mut pipeline), expected);
    Ok(())
}

/// A capability in two phases.
struct Capability;

impl Plugin for Capability {
    fn build(&self, pipeline: &mut Pipeline) {
        pipeline.add_systems(Phase::Frame, Stage::Loss, say("loss"));
        pipeline.swap(Phase::FitStep, Slot::Shading, say("fit"));
    }
}

#[test]
fn a_plugin_is_built_once() -> Result<()> {
    let mut pipeline = pipeline();
    pipeline.add_plugin(&Capability).swap(Phase::FitStep, Slot::Shading, say("otherwise"));
    pipeline.add_plugin(&Capability);
    pipeline.run(Phase::Frame)?;
    pipeline.run(Phase::FitStep)?;
    assert_eq!(trail(&mut pipeline), "sample shade loss write otherwise");
    Ok(())
}

#[test]
fn a_shader_is_put_in_with_its_adjoint_and_goes_with_it() -> Result<()> {
    let mut pipeline = pipeline();
    let form = ClosedForm::Published;
    let shader = || Shader { form, ..Shader::new(say("shade")).with_adjoint(say("pull back")) };
    pipeline.set_shader(Phase::Frame, shader()).set_shader(Phase::FitStep, shader());
    pipeline.run(Phase::Frame)?;
    pipeline.run(Phase::FitStep)?;
    assert_eq!(trail(&mut pipeline), "sample shade write shade pull back");
    assert_eq!(*pipeline.world.resource::<FitForm>(), FitForm(form));
    pipeline.swap(Phase::FitStep, Slot::Shading, say("otherwise"));
    assert!(pipeline.is_filled(Phase::FitStep, Slot::Shading));
    assert!(!pipeline.is_filled(Phase::FitStep, Slot::ShadingAdjoint));
    pipeline.run(Phase::FitStep)?;
    assert_eq!(trail(&mut pipeline), "otherwise");
    Ok(())
}

#[test]
fn a_stage_with_a_condition_is_left_out_and_what_a_failure_skips_is_done_after_it() -> Result<()> {
    let mut pipeline = pipeline();
    pipeline.configure_sets(Phase::Frame, Stage::Loss.run_if(|| false));
    let is_new = |albedo: Query<(), Changed<Diffuse>>| !albedo.is_empty();
    pipeline
        .add_systems(Phase::Frame, Stage::Loss, say("loss"))
        .add_systems(Phase::Frame, Stage::Resolve, say("new").run_if(is_new))
        .swap(Phase::Frame, Slot::Shading, fail);
    pipeline.world.spawn(Diffuse::default());
    assert!(pipeline.run(Phase::Frame).is_err());
    pipeline.swap(Phase::Frame, Slot::Shading, say("shade"));
    pipeline.run(Phase::Frame)?;
    pipeline.run(Phase::Frame)?;
    assert_eq!(trail(&mut pipeline), "sample sample shade new write sample shade write");
    Ok(())
}

#[test]
fn many_rows_are_removed_without_a_message_for_each() {
    #[derive(Component)]
    struct Row;
    let mut world = World::new();
    let count = 3 * (1 << 16) + 5;
    let rows: Vec<Entity> = world.spawn_batch((0..count).map(|_| Row).collect::<Vec<_>>()).collect();
    pool::despawn_rows(&mut world, &rows);
    assert_eq!(world.query::<&Row>().iter(&world).count(), 0);
    let told = world.removed::<Row>().count();
    assert!(told <= 2 << 16, "{told}");
}
