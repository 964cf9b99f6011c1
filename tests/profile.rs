//! A profiled run says where its time went, changes no result, and leaves nothing of it in the next.

use crate::common::{Data, files_below, manifest, scene};
use lobelia::profile::{Profiler, stage};
use serde_json::Value;
use std::path::Path;
use std::time::Instant;

const PASSES: &str = r#"
    Fit(name: "fit", steps: 60, batch: 512),
    Render(name: "novel"),
    Evaluate(name: "scores", scores: [(pass: "novel", truth: Photographs)]),
"#;

fn json(path: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap()
}

/// A part inside another, by name.
#[track_caller]
fn inside<'a>(part: &'a Value, name: &str) -> &'a Value {
    let parts = part["parts"].as_array().unwrap_or_else(|| panic!("nothing is inside {part}"));
    parts.iter().find(|part| part["name"] == name).unwrap_or_else(|| panic!("no {name} in {part:#}"))
}

fn secs(part: &Value) -> f64 {
    part["wall_secs"].as_f64().unwrap()
}

/// Number and MiB of allocations.
fn allocated(part: &Value) -> (u64, f64) {
    (part["allocations"].as_u64().unwrap(), part["allocated_mib"].as_f64().unwrap())
}

/// Checks that no part is longer than what is around it, or has more allocations; returns how many there are.
fn check_nested(part: &Value) -> usize {
    let parts = part["parts"].as_array().map(Vec::as_slice).unwrap_or_default();
    let sum: f64 = parts.iter().map(secs).sum();
    assert!(sum <= secs(part) + 1e-6, "{sum} s inside {part:#}");
    let (count, mib) = parts.iter().map(allocated).fold((0, 0.0), |sum, one| (sum.0 + one.0, sum.1 + one.1));
    let all = allocated(part);
    assert!(count <= all.0 && mib <= all.1 + 1e-6, "{count}, {mib} MiB inside {part:#}");
    1 + parts.iter().map(check_nested).sum::<usize>()
}

/// Begin and end of the events of a name, in microseconds.
fn events(trace: &Value, name: &str) -> Vec<(f64, f64)> {
    let all = trace["traceEvents"].as_array().unwrap();
    let of = all.iter().filter(|event| event["ph"] == "X" && event["name"] == name);
    let span = |event: &Value| {
        let (begin, took) = (event["ts"].as_f64().unwrap(), event["dur"].as_f64().unwrap());
        (begin, begin + took)
    };
    of.map(span).collect()
}

#[test]
fn a_profiled_run_says_where_its_time_went() {
    let data = Data::new();
    let start = Instant::now();
    let outcome = data.run(&scene(PASSES), "out", &["--profile=trace", "--threads", "2"]).succeeded();
    let elapsed = start.elapsed().as_secs_f64();
    for words in ["time by part", "  allocs  ", "pass fit", "FitStep", "Of 2 threads"] {
        assert!(outcome.stdout.contains(words), "no {words:?} in\n{}", outcome.stdout);
    }
    let profile = json(&data.path("out/metrics.json"))["profile"].take();
    let whole = &profile["whole"];
    assert!(check_nested(whole) > 20, "{whole:#}");
    let all = allocated(whole);
    assert!(all.0 > 1000 && all.1 > 1.0 && allocated(inside(whole, "fit")).0 > 60, "{all:?}");
    // The process starts and ends, and the files of the end are written, beside what is measured.
    assert!(secs(whole) <= elapsed && secs(whole) > 0.3 * elapsed, "{} of {elapsed} s", secs(whole));
    let stages: f64 = whole["parts"].as_array().unwrap().iter().map(secs).sum();
    assert!(stages > 0.6 * secs(whole), "{stages} of {} s", secs(whole));
    let step = inside(inside(inside(whole, "fit"), "steps"), "FitStep");
    assert_eq!((step["runs"].as_u64(), step["kind"].as_str()), (Some(60), Some("schedule")));
    for system in ["take_observations", "shade_closed_form", "move_texels", "gather_points<Recovered>"] {
        assert_eq!(inside(step, system)["runs"], 60, "{system}");
    }
    if cfg!(target_os = "linux") {
        let busy = inside(whole, "fit")["threads_busy"].as_f64().unwrap();
        assert!(busy > 0.0 && busy < 16.0, "{busy}");
    }
    let trace = json(&data.path("out/trace.json"));
    assert!(
        trace["traceEvents"][1]["args"]["allocations"].as_u64() > Some(1000),
        "{}",
        trace["traceEvents"][1]
    );
    let (steps, systems) = (events(&trace, "FitStep"), events(&trace, "move_texels"));
    assert_eq!((steps.len(), systems.len(), events(&trace, "run").len()), (60, 60, 1));
    for (begin, end) in systems {
        assert!(steps.iter().any(|(from, to)| *from <= begin + 1e-3 && end <= to + 1e-3), "{begin} {end}");
    }
    assert!(manifest(&data.path("out"))["files"].as_array().unwrap().contains(&"trace.json".into()));
    let page = std::fs::read_to_string(data.path("out/report.html")).unwrap();
    assert!(page.contains("Where the time goes") && page.contains("FitStep"));
}

/// This one has the allocator that programs have if they choose none.
#[test]
fn a_program_whose_allocator_does_not_count_has_no_allocations_in_its_profile() {
    let profiler = Profiler::new(true);
    let sum: u64 = profiler.during(|| {
        let _filling = stage("filling");
        std::hint::black_box(vec![1u64; 1000]).iter().sum()
    });
    let profile = profiler.profile();
    let filling = profile.find(&["filling"]).expect("it ran");
    assert_eq!((sum, filling.runs, filling.allocations, filling.allocated_mib), (1000, 1, None, None));
    assert_eq!(profile.whole.rest_allocations(), (None, None));
    let mut trace = Vec::new();
    profiler.write_trace(&mut trace).unwrap();
    assert!(!String::from_utf8(trace).unwrap().contains("alloc"));
}

#[test]
fn a_run_without_the_flag_measures_nothing_and_has_the_same_bits() {
    let data = Data::new();
    let (passes, threads) = (scene(PASSES), ["--threads", "2"]);
    data.run(&passes, "plain", &threads).succeeded();
    data.run(&passes, "table", &["--profile", "--threads", "2"]).succeeded();
    let results = |out: &str| -> Vec<(String, Vec<u8>)> {
        let files = files_below(&data.path(out));
        let timeless = files.into_iter().filter(|file| file.ends_with(".exr") || file.ends_with(".npy"));
        timeless.map(|file| (file.clone(), std::fs::read(data.path(out).join(file)).unwrap())).collect()
    };
    assert!(results("plain").len() >= 4 && results("plain") == results("table"));
    assert_eq!(files_below(&data.path("plain")), files_below(&data.path("table")), "no trace was asked for");
    let section = |out: &str| json(&data.path(out).join("metrics.json")).get("profile").cloned();
    assert!(section("plain").is_none() && section("table").is_some());
    // What an earlier run measured goes with it.
    data.run(&passes, "table", &["--profile=trace", "--force"]).succeeded();
    assert!(data.path("table/trace.json").exists());
    let outcome = data.run(&passes, "table", &["--force"]).succeeded();
    assert!(!data.path("table/trace.json").exists() && section("table").is_none());
    assert!(!outcome.stdout.contains("time by part"), "{}", outcome.stdout);
}
