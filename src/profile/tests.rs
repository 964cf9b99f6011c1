use super::recorder::short;
use super::*;
use crate::pipeline::{Phase, Pipeline, Slot, Stage as Order};
use serde_json::Value;
use std::time::{Duration, Instant};

fn work_for(millis: u64) {
    let begin = Instant::now();
    while begin.elapsed() < Duration::from_millis(millis) {
        std::hint::black_box(begin);
    }
}

fn slow() {
    work_for(8);
}

/// A closure, as systems with settings are.
fn waiting(millis: u64) -> impl Fn() {
    move || work_for(millis)
}

fn tick(pipeline: &mut Pipeline) {
    let _rounds = stage("rounds");
    for round in 0..3 {
        let _round = stage(format_args!("round {}", round / 2));
        pipeline.run(Phase::Frame).unwrap();
    }
}

fn measured(keeps_events: bool) -> Profiler {
    let profiler = Profiler::new(keeps_events);
    profiler.during(|| {
        let mut pipeline = Pipeline::new();
        pipeline.add_systems(Phase::Frame, Order::Sample, slow);
        pipeline.swap(Phase::Frame, Slot::Shading, waiting(4));
        tick(&mut pipeline);
        // After a swap, too.
        pipeline.swap(Phase::Frame, Slot::Shading, slow);
        tick(&mut pipeline);
    });
    profiler
}

/// No part is longer than what is around it, or has more allocations.
fn check_nested(part: &Part) {
    let inside: f64 = part.parts.iter().map(|part| part.wall_secs).sum();
    assert!(inside <= part.wall_secs + 1e-6, "{inside} s inside {part:?}");
    assert!((0.0..=1.0 + 1e-9).contains(&part.wall_share), "{part:?}");
    let allocations: u64 = part.parts.iter().filter_map(|part| part.allocations).sum();
    let mib: f64 = part.parts.iter().filter_map(|part| part.allocated_mib).sum();
    assert!(part.allocations >= Some(allocations) && part.allocated_mib >= Some(mib), "{part:?}");
    assert_eq!(part.rest_allocations().0, part.allocations.map(|all| all - allocations));
    part.parts.iter().for_each(check_nested);
}

#[test]
fn stages_and_systems_are_summed_where_they_are() {
    let profile = measured(false).profile();
    check_nested(&profile.whole);
    let runs = |names: &[&str]| profile.find(names).unwrap_or_else(|| panic!("{names:?}: {profile:#?}")).runs;
    assert_eq!(runs(&[]), 1);
    assert_eq!(runs(&["rounds"]), 2);
    assert_eq!((runs(&["rounds", "round 0"]), runs(&["rounds", "round 1"])), (4, 2));
    assert_eq!(runs(&["rounds", "round 0", "Frame"]), 4);
    let frame = profile.find(&["rounds", "round 0", "Frame"]).unwrap();
    // Two of the four runs had the closure, two the function in its place; and that was there in all of them.
    assert_eq!((frame.kind, runs(&["rounds", "round 0", "Frame", "waiting"])), (PartKind::Schedule, 2));
    assert_eq!(runs(&["rounds", "round 0", "Frame", "slow"]), 6);
    assert!(frame.parts.iter().all(|part| part.parts.is_empty()), "{frame:#?}");
    let (slow, waiting) = (
        &frame.parts.iter().find(|part| part.name == "slow"),
        &frame.parts.iter().find(|part| part.name == "waiting"),
    );
    let (slow, waiting) = (slow.unwrap(), waiting.unwrap());
    assert!(slow.wall_secs >= 6.0 * 0.008 && waiting.wall_secs >= 2.0 * 0.004, "{frame:#?}");
    if let Some(cpu) = slow.cpu_secs {
        assert!(cpu > 0.0 && slow.threads_busy.unwrap() > 0.0 && slow.cpu_share.unwrap() > 0.0);
    }
}

/// Other tests allocate meanwhile, and so there may be more.
#[test]
fn allocations_are_in_the_part_that_waits_for_them() {
    let fill = || std::hint::black_box(vec![1u8; 8 << 20]).len();
    let profiler = Profiler::new(false);
    let during = profiler.during(|| {
        let _around = pass("around");
        for _ in 0..2 {
            let _threads = stage("of threads");
            std::thread::scope(|scope| [scope.spawn(fill), scope.spawn(fill)].map(|one| one.join().unwrap()));
        }
        let _open = stage("open");
        fill();
        profiler.profile()
    });
    check_nested(&during.whole);
    let allocated =
        |names: &[&str]| during.find(names).and_then(|part| part.allocations.zip(part.allocated_mib));
    for (names, count, mib) in
        [(&["around", "of threads"][..], 4, 32.0), (&["around", "open"], 1, 8.0), (&["around"], 5, 40.0)]
    {
        let found = allocated(names).expect("the allocator counts");
        assert!(found.0 >= count && found.1 >= mib, "{names:?}: {found:?}");
    }
}

#[test]
fn what_is_open_counts_until_now() {
    let profiler = Profiler::new(true);
    let during = profiler.during(|| {
        let _open = pass("half");
        work_for(5);
        profiler.profile()
    });
    let half = during.find(&["half"]).unwrap();
    assert!((half.runs, half.kind) == (1, PartKind::Pass) && half.wall_secs >= 0.005, "{during:?}");
    let after = profiler.profile();
    assert!(after.find(&["half"]).unwrap().wall_secs >= half.wall_secs && after.whole.wall_secs > 0.005);
    assert_eq!(after.find(&["half"]).unwrap().runs, 1);
}

#[test]
fn without_a_profiler_nothing_is_recorded() {
    let profiler = Profiler::new(true);
    let mut pipeline = Pipeline::new();
    pipeline.add_systems(Phase::Frame, Order::Sample, slow);
    tick(&mut pipeline);
    assert!(profiler.profile().whole.parts.is_empty());
    assert!(!tracing::dispatcher::get_default(|dispatch| dispatch.is::<Recorder>()));
    // Another profiler does not see what goes on under this one.
    let other = Profiler::new(false);
    profiler.during(|| drop(stage("mine")));
    assert!(other.profile().whole.parts.is_empty() && profiler.profile().find(&["mine"]).is_some());
}

/// The thread that comes first to a place has no profiler.
#[test]
fn a_thread_without_a_profiler_takes_no_spans_from_one_with() {
    fn at_the_place() {
        drop(tracing::info_span!(target: "lobelia", "stage", name = "here").entered());
    }
    let profiler = Profiler::new(false);
    std::thread::scope(|scope| drop(scope.spawn(at_the_place)));
    profiler.during(at_the_place);
    assert!(profiler.profile().find(&["here"]).is_some());
}

#[test]
fn the_trace_is_json_with_nested_spans() {
    let profiler = measured(true);
    let mut bytes = Vec::new();
    profiler.write_trace(&mut bytes).unwrap();
    let trace: Value = serde_json::from_slice(&bytes).unwrap();
    let events = trace["traceEvents"].as_array().unwrap();
    let named = |name: &str| -> Vec<(f64, f64)> {
        let of = events.iter().filter(|event| event["ph"] == "X" && event["name"] == name);
        let end = |event: &Value| event["ts"].as_f64().unwrap() + event["dur"].as_f64().unwrap();
        of.map(|event| (event["ts"].as_f64().unwrap(), end(event))).collect()
    };
    assert_eq!((named("run").len(), named("Frame").len(), named("slow").len()), (1, 6, 9));
    let lies_in = |inner: &str, outer: &str| {
        let outer = named(outer);
        named(inner)
            .iter()
            .all(|(begin, end)| outer.iter().any(|(from, to)| *begin >= from - 1e-3 && *end <= to + 1e-3))
    };
    assert!(lies_in("slow", "Frame") && lies_in("Frame", "rounds") && lies_in("rounds", "run"), "{trace}");
    assert_eq!(trace["otherData"]["events_left_out"], 0);
    let run = events.iter().find(|event| event["ph"] == "X" && event["name"] == "run").unwrap();
    let args = ["allocations", "allocated_bytes"].map(|name| run["args"][name].as_u64().unwrap());
    assert!(args.iter().all(|value| *value > 0), "{run}");
    let mut none = Vec::new();
    measured(false).write_trace(&mut none).unwrap();
    let none: Value = serde_json::from_slice(&none).unwrap();
    assert!(none["traceEvents"].as_array().unwrap().iter().all(|event| event["ph"] == "M"));
}

#[test]
fn names_lose_their_modules() {
    for (name, shown) in [
        ("lobelia::fit::systems::move_texels", "move_texels"),
        ("lobelia::shade::systems::shade_closed_form::{{closure}}", "shade_closed_form"),
        ("a::gather_points<lobelia::material::material_source::Shown>", "gather_points<Shown>"),
        ("Pipe<a::b, (c::d, e::f::{{closure}})>", "Pipe<b, (d, f)>"),
        ("", ""),
    ] {
        assert_eq!(short(name), shown);
    }
}
