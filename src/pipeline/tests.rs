use super::failure::RunCell;
use super::*;
use bevy_ecs::error::{ErrorContext, FallbackErrorHandler};
use bevy_ecs::prelude::{Component, Entity, In, IntoSystem, ResMut, Resource, World};
use bevy_ecs::schedule::{FixedBitSet, MultiThreadedExecutor, SystemExecutor, SystemSchedule};
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Mutex};

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
fn stages_run_in_order_and_slots_can_be_swapped() -> Result<()> {
    let mut pipeline = pipeline();
    pipeline.run(Phase::Frame)?;
    pipeline.swap(Phase::Frame, Slot::Shading, say("otherwise"));
    pipeline.run(Phase::Frame)?;
    pipeline.swap(Phase::Frame, Slot::Shading, say("shade"));
    pipeline.run(Phase::Frame)?;
    assert_eq!(trail(&mut pipeline), "sample shade write sample otherwise write sample shade write");
    Ok(())
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

/// Runs every system on a thread that is not the caller's, as bevy's multi-threaded executor may.
struct OnAnotherThread(SingleThreadedExecutor);

impl SystemExecutor for OnAnotherThread {
    fn init(&mut self, schedule: &SystemSchedule) {
        self.0.init(schedule);
    }

    fn run(
        &mut self,
        schedule: &mut SystemSchedule,
        world: &mut World,
        skip: Option<&FixedBitSet>,
        error_handler: fn(BevyError, ErrorContext),
    ) {
        std::thread::scope(|scope| {
            scope.spawn(|| self.0.run(schedule, world, skip, error_handler));
        });
    }

    fn set_apply_final_deferred(&mut self, value: bool) {
        self.0.set_apply_final_deferred(value);
    }
}

/// Says on which thread it fails.
fn fail_by_name() -> SystemResult {
    Err(Error::run("a system", format!("{:?}", std::thread::current().id())).into())
}

fn failing_runs(run: usize) -> (Vec<Option<String>>, String) {
    let mut pipeline = pipeline();
    match run % 2 {
        0 => pipeline.schedule_mut(Phase::Frame).set_executor(MultiThreadedExecutor::new()),
        _ => pipeline.schedule_mut(Phase::Frame).set_executor(OnAnotherThread(SingleThreadedExecutor::new())),
    };
    match run % 3 {
        0 => pipeline.swap(Phase::Frame, Slot::Shading, fail),
        1 => pipeline.swap(Phase::Frame, Slot::Shading, fail_by_name),
        _ => &mut pipeline,
    };
    let said = (0..20).map(|_| pipeline.run(Phase::Frame).err().map(|error| error.to_string())).collect();
    (said, trail(&mut pipeline))
}

#[test]
fn errors_on_other_threads_reach_their_own_callers() {
    // More at once than there are cells for errors.
    let runs: Vec<_> = (0..48).map(|run| std::thread::spawn(move || (run, failing_runs(run)))).collect();
    for run in runs {
        let caller = format!("{:?}", run.thread().id());
        let (run, (said, trail)) = run.join().expect("no run panics");
        for said in said {
            match run % 3 {
                0 => assert_eq!(said.as_deref(), Some("a.png, pixel (3, 4): not finite")),
                1 => assert!(said.is_some_and(|said| run % 2 == 0 || !said.contains(&caller))),
                _ => assert_eq!(said, None),
            }
        }
        assert_eq!(trail.contains("write"), run % 3 == 2, "what comes after the failed system is skipped");
    }
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
    let is_left = |world: &World| {
        world.contains_resource::<FallbackErrorHandler>() || world.contains_resource::<RunCell>()
    };
    assert!(!is_left(&plain.world), "after a run");
    plain.swap(Phase::Frame, Slot::Shading, fail);
    assert!(plain.run(Phase::Frame).is_err() && !is_left(&plain.world), "after a failure");
    assert!(plain.run(Preview).is_err() && !is_left(&plain.world), "after a run of no phase");

    let mut own = pipeline();
    own.world.insert_resource(FallbackErrorHandler(counting));
    own.swap(Phase::Frame, Slot::Shading, fail);
    let before = COUNTED.load(Ordering::Relaxed);
    assert!(own.run(Phase::Frame).is_err());
    assert_eq!(COUNTED.load(Ordering::Relaxed), before, "the run has the pipeline's handler");
    own.world.run_schedule(Phase::Frame);
    assert_eq!(COUNTED.load(Ordering::Relaxed), before + 1, "the user's is back");
    assert_eq!(trail(&mut own), "sample sample write", "and no cell of a run holds systems back");
    Ok(())
}

#[test]
fn a_schedule_that_is_run_by_hand_neither_hears_of_another_pipeline_nor_tells_it() -> Result<()> {
    let mut first = pipeline();
    first.run(Phase::Frame)?;
    assert_eq!(trail(&mut first), "sample shade write");
    let first = Arc::new(Mutex::new(first));
    // The cell of the first run is free again: the other pipeline is likely to get it, and has failed when the first goes on.
    let mut other = pipeline();
    other.swap(Phase::Frame, Slot::Shading, fail);
    let inside = first.clone();
    let run_first = move || inside.lock().expect("nothing panics").world.run_schedule(Phase::Frame);
    other.schedule_mut(Phase::Frame).add_systems(run_first.in_set(Stage::Write));
    let error = other.run(Phase::Frame).expect_err("it fails");
    assert_eq!(error.to_string(), "a.png, pixel (3, 4): not finite");
    assert_eq!(trail(&mut first.lock().expect("nothing panics")), "sample shade write");
    Ok(())
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

/// A slot of a user's own.
#[derive(SystemSet, Clone, Debug, PartialEq, Eq, Hash)]
struct Denoise;

impl SlotLabel for Denoise {
    fn stage(&self) -> Stage {
        Stage::Resolve
    }
}

#[test]
fn users_have_phases_and_slots_of_their_own() -> Result<()> {
    let mut pipeline = pipeline();
    pipeline
        .add_phase(Preview)
        .add_systems(Preview, Stage::Write, say("write"))
        .swap(Preview, Denoise, say("smooth"))
        .swap(Preview, Slot::Shading, say("shade"));
    pipeline.run(Preview)?;
    pipeline.swap(Preview, Denoise, say("median"));
    pipeline.run(Preview)?;
    pipeline.clear(Preview, Denoise);
    pipeline.run(Preview)?;
    assert_eq!(trail(&mut pipeline), "shade smooth write shade median write shade write");
    Ok(())
}

#[test]
fn own_systems_go_before_and_after_every_built_in_set() -> Result<()> {
    let mut pipeline = Pipeline::new();
    pipeline.world.init_resource::<Trail>();
    for (slot, word) in [
        (Slot::Visibility, "visibility"),
        (Slot::Material, "material"),
        (Slot::Light, "light"),
        (Slot::Shading, "shading"),
    ] {
        pipeline.swap(Phase::Frame, slot, say(word));
    }
    pipeline
        .add_systems(Phase::Frame, Stage::Gather, say("points").in_set(GatherPoints))
        .add_systems(
            Phase::Frame,
            Stage::Gather,
            say("before points").before(GatherPoints).after(Slot::Light),
        )
        .add_systems(
            Phase::Frame,
            Stage::Gather,
            say("after points").after(GatherPoints).before(Slot::Visibility),
        )
        .add_systems(Phase::Frame, Stage::Gather, say("before material").before(Slot::Material))
        .add_systems(Phase::Frame, Stage::Shade, say("after shading").after(Slot::Shading));
    pipeline.run(Phase::Frame)?;
    let expected =
        "before material material light before points points after points visibility shading after shading";
    assert_eq!(trail(&mut pipeline), expected);
    Ok(())
}

/// A capability with one inside.
struct Outer;
struct Inner;

#[derive(Resource)]
struct InnerState;

impl Plugin for Outer {
    fn build(&self, pipeline: &mut Pipeline) {
        pipeline.add_systems(Phase::Frame, Stage::Loss, say("outer")).add_plugin(&Inner);
        pipeline.swap(Phase::FitStep, Slot::Shading, say("outer fit"));
    }
}

impl Plugin for Inner {
    fn build(&self, pipeline: &mut Pipeline) {
        pipeline.world.insert_resource(InnerState);
        pipeline.add_systems(Phase::Frame, Stage::Update, say("inner"));
    }

    fn cleanup(world: &mut World) {
        world.remove_resource::<InnerState>();
    }
}

#[test]
fn a_plugin_is_removed_again_with_what_it_brought() -> Result<()> {
    let mut pipeline = pipeline();
    pipeline.add_plugin(&Outer);
    pipeline.run(Phase::Frame)?;
    assert_eq!(trail(&mut pipeline), "sample shade outer inner write");
    pipeline.remove_plugin::<Inner>();
    assert!(!pipeline.world.contains_resource::<InnerState>());
    pipeline.run(Phase::Frame)?;
    assert_eq!(trail(&mut pipeline), "sample shade outer write");
    pipeline.add_plugin(&Outer).remove_plugin::<Outer>();
    assert!(!pipeline.world.contains_resource::<InnerState>(), "inner plugins take out what is theirs");
    pipeline.run(Phase::Frame)?;
    pipeline.run(Phase::FitStep)?;
    assert_eq!(trail(&mut pipeline), "sample shade write", "also the first that was added, and its slots");
    Ok(())
}

#[test]
fn a_plugin_that_is_added_again_replaces_the_first() -> Result<()> {
    let mut pipeline = pipeline();
    pipeline.add_plugin(&Outer).add_plugin(&Outer).add_plugin(&Inner);
    pipeline.run(Phase::Frame)?;
    assert_eq!(trail(&mut pipeline), "sample shade outer inner write");
    pipeline.remove_plugin::<Outer>();
    pipeline.run(Phase::Frame)?;
    assert_eq!(trail(&mut pipeline), "sample shade inner write", "the last was added on its own");
    Ok(())
}

static ASKED: AtomicU32 = AtomicU32::new(0);

/// A condition that counts how often it is asked.
fn counts() -> bool {
    ASKED.fetch_add(1, Ordering::Relaxed);
    true
}

fn never() -> bool {
    false
}

fn say_failed(world: &mut World) {
    world.resource_mut::<Trail>().0.push("failed");
}

/// A capability that holds a stage back, and looks at failed runs.
struct Guard;

impl Plugin for Guard {
    fn build(&self, pipeline: &mut Pipeline) {
        pipeline
            .run_stage_if(Phase::Frame, Stage::Loss, counts)
            .run_stage_if(Phase::Frame, Stage::Resolve, never)
            .mark_after_failure(say_failed);
    }
}

#[test]
fn a_stage_has_a_condition_once_and_what_follows_a_failure_goes_with_its_plugin() -> Result<()> {
    let mut pipeline = pipeline();
    pipeline.add_systems(Phase::Frame, Stage::Loss, say("loss"));
    pipeline.add_systems(Phase::Frame, Stage::Resolve, say("resolve"));
    pipeline.run_stage_if(Phase::Frame, Stage::Loss, counts).add_plugin(&Guard).add_plugin(&Guard);
    pipeline.run(Phase::Frame)?;
    assert_eq!(trail(&mut pipeline), "sample shade loss write");
    assert_eq!(ASKED.load(Ordering::Relaxed), 1);
    pipeline.run_stage_if(Phase::Frame, Stage::Loss, never);
    pipeline.run(Phase::Frame)?;
    assert_eq!(
        trail(&mut pipeline),
        "sample shade write",
        "another condition of a stage that has one and has run"
    );
    pipeline.swap(Phase::Frame, Slot::Shading, fail).mark_after_failure(say_failed);
    assert!(pipeline.run(Phase::Frame).is_err());
    assert_eq!(trail(&mut pipeline), "sample failed", "it is called once");
    pipeline.remove_plugin::<Guard>();
    assert!(pipeline.run(Phase::Frame).is_err());
    assert_eq!(trail(&mut pipeline), "sample failed", "it was given outside of the plugin as well");
    let mut other = self::pipeline();
    other.swap(Phase::Frame, Slot::Shading, fail).add_plugin(&Guard).remove_plugin::<Guard>();
    assert!(other.run(Phase::Frame).is_err());
    assert_eq!(trail(&mut other), "sample");
    Ok(())
}

#[test]
fn systems_that_hand_a_value_on_can_be_piped() -> Result<()> {
    let mut pipeline = pipeline();
    let said = (|| "piped").pipe(|In(word): In<&'static str>, mut trail: ResMut<Trail>| trail.0.push(word));
    pipeline.swap(Phase::Frame, Slot::Shading, said);
    pipeline.run(Phase::Frame)?;
    assert_eq!(trail(&mut pipeline), "sample piped write");
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
