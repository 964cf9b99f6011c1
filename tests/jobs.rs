//! Scripts that run many objects, the table of what these have come to, and events for programs
//! (`lobelia run --log json`).

use crate::common::{Data, GRAY_SPHERE, Outcome, is_installed, scene, skipped};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::{fs, process::Command};

/// Two objects, `jug` and `vase`, in the folder `photos`.
fn objects() -> Data {
    let data = Data::bare();
    let scene = GRAY_SPHERE.replace("{PASS}", r#"Render(name: "still")"#);
    for name in ["jug", "vase"] {
        data.write(format!("photos/{name}/scene.ron"), &scene);
    }
    data
}

fn example(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/jobs").join(name)
}

/// A command in the folder of the objects that finds `lobelia` on its `PATH`.
fn engine(data: &Data, program: &str) -> Command {
    let folder = Path::new(env!("CARGO_BIN_EXE_lobelia")).parent().unwrap().to_owned();
    let usual = std::env::var_os("PATH").unwrap_or_default();
    let paths = std::env::join_paths(std::iter::once(folder).chain(std::env::split_paths(&usual))).unwrap();
    let mut command = Command::new(program);
    command.current_dir(data.root()).env("PATH", paths);
    command
}

#[track_caller]
fn has_run(data: &Data, jug: bool, vase: bool) {
    let there = ["jug", "vase"].map(|name| data.path(format!("out/{name}/still/a.png")).exists());
    assert_eq!(there, [jug, vase]);
}

/// Runs a script of the examples with the folders of objects and of results; expects that it runs
/// one object, or both.
#[track_caller]
fn runs(program: &str, arguments: &[&str], script: &str, variable: Option<(&str, &str)>, both: bool) {
    let data = objects();
    let mut command = engine(&data, program);
    command.args(arguments).arg(example(script)).args(["photos", "out"]).envs(variable);
    Outcome::of(&mut command).succeeded();
    has_run(&data, both, true);
}

#[test]
fn make_runs_all_objects_and_goes_on_after_a_kill() {
    if !is_installed("make") {
        return;
    }
    let data = objects();
    let make = || {
        let mut make = engine(&data, "make");
        make.args(["-k", "-j2", "OBJECTS=photos", "THREADS=1", "-f"]).arg(example("Makefile"));
        Outcome::of(&mut make)
    };
    make().succeeded();
    has_run(&data, true, true);
    // A run that was killed: its record says so.
    let killed = data.text("out/vase/run.json").replacen("\"finished\"", "\"running\"", 1);
    data.write("out/vase/run.json", killed);
    fs::remove_dir_all(data.path("out/vase/still")).unwrap();
    make().succeeded();
    has_run(&data, true, true);
    fs::write(data.path("photos/jug/scene.ron"), "Scene(").unwrap();
    fs::remove_dir_all(data.path("out")).unwrap();
    let failed = make();
    assert!(failed.code != Some(0) && failed.stderr.contains("run-jug"), "{}", failed.stderr);
    has_run(&data, false, true);
}

#[cfg(unix)]
#[test]
fn a_pod_of_the_indexed_job_runs_its_object() {
    let data = objects();
    let text = fs::read_to_string(example("kubernetes.yaml")).unwrap();
    let lines = text.lines().skip_while(|line| line.trim() != "- |").skip(1);
    let script: Vec<&str> = lines.map_while(|line| line.strip_prefix("              ")).collect();
    let mut pod = engine(&data, "/bin/sh");
    Outcome::of(pod.args(["-ec", &script.join("\n")]).env("JOB_COMPLETION_INDEX", "1")).succeeded();
    has_run(&data, false, true);
}

#[test]
fn ray_tasks_run_all_objects() {
    let ray = Command::new("python3").args(["-c", "import ray"]).output();
    if ray.is_ok_and(|ray| ray.status.success()) {
        runs("python3", &["-B"], "ray_objects.py", None, true);
    } else {
        skipped("Ray is not installed");
    }
}

#[cfg(unix)]
#[test]
fn a_slurm_array_runs_all_objects_and_a_task_its_own() {
    if is_installed("bash") {
        runs("bash", &[], "slurm.sh", Some(("SLURM_ARRAY_TASK_ID", "2")), false);
    }
    if is_installed("sbatch") {
        let array = ["--wait", "--array=1-2", "--mem=300M", "--cpus-per-task=1", "--time=5"];
        runs("sbatch", &array, "slurm.sh", None, true);
    }
}

#[test]
fn runs_are_set_side_by_side() {
    let data = objects();
    data.lobelia(&["run", "photos/vase/scene.ron", "--out", "out/vase", "--quiet"]).succeeded();
    let csv = data.lobelia(&["report", "out/jug", "out/vase", "--csv"]).succeeded().stdout;
    let lines: Vec<&str> = csv.lines().collect();
    assert_eq!(lines[..2], ["run,state,seconds,memory_mib", "jug,no run,,"], "{csv}");
    assert!(lines[2].starts_with("vase,finished,"), "{csv}");
    assert!(data.lobelia(&["report", "out/jug", "out/vase"]).succeeded().stdout.contains("finished"));
    data.lobelia(&["list", "objects.csv"]).refused(&["--resume"]);
}

#[test]
fn every_line_is_an_event_and_the_last_says_how_it_ended() {
    let data = Data::new();
    let text = scene(r#"Fit(name: "fit", steps: 10, batch: 256), Render(name: "novel"), Save(),"#);
    let said = data.run(&text, "out", &["--log", "json"]).succeeded().stdout;
    let events: Vec<Value> = said.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let of = |kind: &str| events.iter().filter(|event| event["event"] == kind).collect::<Vec<_>>();
    let passes: Vec<&str> = of("pass").iter().map(|pass| pass["name"].as_str().unwrap()).collect();
    assert_eq!(passes, ["fit", "novel", "saved"]);
    assert!(of("pass").iter().all(|pass| pass["count"] == 3));
    let stages = of("stage");
    assert!(stages.iter().any(|of| of["title"] == "photographs" && of["length"].as_u64() > Some(0)));
    assert!(of("progress").iter().any(|at| at["title"] == "fit" && at["message"] == "first guess"));
    assert!(of("progress").iter().all(|at| at["length"] == 0 || at["message"] != "first guess"));
    assert_eq!(stages.len(), of("done").len(), "every task that begins ends");
    assert!(of("done").iter().any(|task| task["title"] == "fit" && task["done"] == 10));
    assert!(of("result").iter().any(|line| line["text"].as_str().unwrap().contains("10 steps")));
    let steps = of("step");
    assert!(steps.len() == 1 && steps[0]["step"] == 10 && steps[0]["steps"] == 10, "{steps:?}");
    assert!(steps[0]["psnr"].as_f64() > Some(5.0) && steps[0]["lobes"].as_u64() > Some(0), "{steps:?}");
    let secs: Vec<f64> = events.iter().map(|event| event["secs"].as_f64().unwrap()).collect();
    assert!(secs.windows(2).all(|pair| pair[0] <= pair[1]), "{secs:?}");
    let ended = of("ended");
    assert!(ended.len() == 1 && ended[0]["state"] == "finished" && ended[0]["error"].is_null(), "{ended:?}");
    assert_eq!(ended[0], events.last().unwrap());
    // What fails before the first pass is an event, too.
    let outcome = data.run("Scene(version: 1)", "failed", &["--log", "json"]);
    outcome.refused(&[]);
    let ended: Value = serde_json::from_str(&outcome.stdout).expect("one event");
    assert!(ended["state"] == "failed" && ended["error"].as_str().unwrap().contains("scene.ron"), "{ended}");
    let both = data.run(&scene("Save(),"), "out", &["--log", "json", "--quiet"]);
    assert_eq!(both.code, Some(2), "{}", both.stderr);
}
