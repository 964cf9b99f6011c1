//! Many objects and frames: units, whatever runs them, and what they come to.

use crate::common::{Data, Outcome, command};
use saphyr::{LoadableYamlNode, Yaml};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// A gray sphere under a lamp, and a film of it.
const SCENE: &str = r#"Scene(
    version: 1,
    surface: Sphere(texture_size: 16),
    views: Cameras([(name: "a", eye: (0, 0, 3), width: 16, height: 16)]),
    light: Fixed(Lobes(lobes: [(axis: (1, 0.2, 0.5), sharpness: 4, amplitude: (1, 1, 1))])),
    material: (albedo: Fixed(Constant(0.5, 0.5, 0.5)), specular: (albedo: Fixed(0.1, 0.1, 0.1), roughness: Fixed(0.3))),
    passes: [
        Render(name: "still"),
        Render(name: "turn", render: (orbit: (frames: 7, size: 32, fps: 10, light: (), material: (roughness: (0.5, 2.0))))),
    ],
)"#;

/// A folder with the scene file, and a table of two objects.
fn jobs() -> (Data, PathBuf, PathBuf) {
    let data = Data::new();
    let (scene, table) = (data.path("turn.ron"), data.path("objects.csv"));
    fs::write(&scene, SCENE).unwrap();
    fs::write(&table, "scene,name,passes.still.render.exposure\nturn.ron,vase,1.5\nturn.ron,jug,\n").unwrap();
    (data, scene, table)
}

fn list(jobs: &Path, frames: &str) -> Vec<String> {
    let listed = Outcome::of(command(&["list", "--frames", frames]).arg(jobs));
    listed.succeeded().stdout.lines().map(str::to_owned).collect()
}

fn run_unit(jobs: &Path, unit: &str, out: &Path) -> Outcome {
    Outcome::of(command(&["run", "--quiet", "--only", unit]).arg(jobs).arg("--out").arg(out))
}

#[test]
fn frames_are_units_and_join_to_the_same_film() {
    let (data, scene, _) = jobs();
    let units = list(&scene, "3");
    assert_eq!(units, ["turn_000000-000002", "turn_000003-000005", "turn_000006-000006"]);
    let out = data.path("parts");
    for unit in &units[1..] {
        run_unit(&scene, unit, &out).succeeded();
    }
    let jobs = ["report", "--frames", "3", "--jobs"];
    let early = Outcome::of(command(&jobs).arg(&scene).arg(&out)).succeeded();
    let words = ["4 of 7 frames", "3 units: 2 finished, 1 not begun"];
    words.iter().for_each(|word| assert!(early.stdout.contains(word), "{}", early.stdout));
    assert!(!out.join("turn.mp4").exists());
    // Twice is as once.
    let frame = out.join("turn_000003-000005/turn/orbit_frames/000004.png");
    let before = fs::metadata(&frame).unwrap().modified().unwrap();
    run_unit(&scene, &units[1], &out).succeeded();
    assert_eq!(fs::metadata(&frame).unwrap().modified().unwrap(), before);
    run_unit(&scene, &units[0], &out).succeeded();
    Outcome::of(command(&["report"]).arg(&out)).succeeded();
    Outcome::of(command(&["run", "--quiet"]).arg(&scene).arg("--out").arg(data.path("whole"))).succeeded();
    let film = |path: PathBuf| fs::read(path).unwrap();
    assert!(film(out.join("turn.mp4")) == film(data.path("whole/turn/orbit.mp4")), "the films differ");
    assert!(!out.join(&units[0]).join("still").exists(), "a unit of a film runs its pass alone");
    // A frame that was cut short.
    let whole = film(frame.clone());
    fs::write(&frame, &whole[..whole.len() / 2]).unwrap();
    let cut = Outcome::of(command(&["report"]).arg(&out));
    assert!(cut.code == Some(1) && out.join("report.html").exists(), "{}", cut.stderr);
    assert!(
        ["not joined: ", "000004.png", "--force"].iter().all(|word| cut.stdout.contains(word)),
        "{}",
        cut.stdout
    );
    fs::write(&frame, whole).unwrap();
    // A film of somebody else in its place.
    let joined = film(out.join("turn.mp4"));
    fs::write(out.join("turn.mp4"), "theirs").unwrap();
    let kept = Outcome::of(command(&["report"]).arg(&out)).succeeded();
    assert!(kept.stdout.contains("move it away"), "{}", kept.stdout);
    assert_eq!(film(out.join("turn.mp4")), b"theirs");
    fs::write(out.join("turn.mp4"), joined).unwrap();
    // A unit of the film as it was changed meanwhile.
    fs::write(&scene, SCENE.replace("(0.5, 2.0)", "(0.5, 3.0)")).unwrap();
    run_unit(&scene, "turn_000002-000004", &out).succeeded();
    let before = film(out.join("turn.mp4"));
    let mixed = Outcome::of(command(&["report"]).arg(&out)).succeeded();
    let words = ["not joined", "turn_000002-000004", "passes.turn.render.orbit.material.roughness"];
    words.iter().for_each(|word| assert!(mixed.stdout.contains(word), "{}", mixed.stdout));
    assert!(film(out.join("turn.mp4")) == before);
}

#[test]
fn make_runs_all_units_and_goes_on_after_a_kill() {
    let (data, _, table) = jobs();
    assert_eq!(list(&table, "3"), ["vase", "jug"]);
    if !is_there("make") {
        return;
    }
    let out = data.path("out");
    // A unit that was killed while it ran: its record says so.
    run_unit(&table, "vase", &out).succeeded();
    let record = out.join("vase/run.json");
    let killed =
        fs::read_to_string(&record).unwrap().replacen("\"state\": \"finished\"", "\"state\": \"running\"", 1);
    fs::write(&record, killed).unwrap();
    fs::remove_dir_all(out.join("vase/still")).unwrap();
    let variable = |name: &str, path: &Path| format!("{name}={}", path.display());
    let mut make = Command::new("make");
    make.arg("-j2")
        .arg("-f")
        .arg(example("Makefile"))
        .arg(variable("JOBS", &table))
        .arg(variable("OUT", &out));
    make.arg(variable("LOBELIA", Path::new(env!("CARGO_BIN_EXE_lobelia")))).arg("THREADS=1");
    let made = Outcome::of(&mut make);
    made.succeeded();
    let units = fs::read_to_string(out.join("units.csv")).unwrap();
    assert!(units.contains("jug,finished") && units.contains("vase,finished"), "{units}");
    assert!(out.join("vase/still/a.png").exists());
    fs::write(&table, "scene,name\nturn.ron,vase\nnone.ron,jug\n").unwrap();
    let failed = Outcome::of(make.arg(variable("OUT", &data.path("other"))));
    assert!(failed.code != Some(0) && failed.stdout.contains("jug: not begun"), "{}", failed.stdout);
    assert!(data.path("other/vase/still/a.png").exists(), "one unit holds back another");
    // What is not among the jobs is no reason to fail.
    fs::write(&table, "scene,name\nturn.ron,vase\n").unwrap();
    fs::create_dir(data.path("other/jug")).unwrap();
    let running = fs::read_to_string(out.join("jug/run.json")).unwrap();
    let running = running.replacen("\"state\": \"finished\"", "\"state\": \"running\"", 1);
    fs::write(data.path("other/jug/run.json"), running).unwrap();
    Outcome::of(&mut make).succeeded();
}

/// Whether a program is installed and runs.
fn is_there(program: &str) -> bool {
    let is_there =
        Command::new(program).arg("--version").output().is_ok_and(|output| output.status.success());
    if !is_there {
        eprintln!("{program} is not installed: its units are not run");
    }
    is_there
}

/// A `PATH` on which the program is called as examples call it.
fn path_with_program() -> std::ffi::OsString {
    let folder = Path::new(env!("CARGO_BIN_EXE_lobelia")).parent().unwrap().to_owned();
    let usual = std::env::var_os("PATH").unwrap_or_default();
    std::env::join_paths(std::iter::once(folder).chain(std::env::split_paths(&usual))).unwrap()
}

fn example(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/jobs").join(name)
}

#[cfg(unix)]
#[test]
fn a_pod_of_the_indexed_job_runs_its_unit() {
    let (data, ..) = jobs();
    let text = fs::read_to_string(example("kubernetes.yaml")).unwrap();
    let job = &Yaml::load_from_str(&text).unwrap()[0];
    let of_job = |field: &str| job[field].as_str().unwrap();
    assert_eq!((of_job("apiVersion"), of_job("kind")), ("batch/v1", "Job"));
    let spec = &job["spec"];
    assert_eq!(spec["completionMode"].as_str(), Some("Indexed"));
    let pod = &spec["template"]["spec"];
    assert_eq!(pod["restartPolicy"].as_str(), Some("Never"), "what `backoffLimitPerIndex` needs");
    let container = &pod["containers"][0];
    let (mount, volume) = (&container["volumeMounts"][0], &pod["volumes"][0]);
    assert_eq!(
        (mount["name"].as_str(), mount["mountPath"].as_str()),
        (volume["name"].as_str(), Some("/museum"))
    );
    let command: Vec<&str> =
        container["command"].as_vec().unwrap().iter().map(|word| word.as_str().unwrap()).collect();
    let [shell, flags, script] = command[..] else { panic!("{command:?}") };
    let script = script.replace("/museum", &data.root().display().to_string());
    let mut pod = Command::new(shell);
    pod.args([flags, &script]).env("PATH", path_with_program()).env("JOB_COMPLETION_INDEX", "1");
    Outcome::of(&mut pod).succeeded();
    assert!(
        data.path("out/jug/still/a.png").exists() && !data.path("out/vase").exists(),
        "the second unit alone"
    );
}

/// As much of Ray as the example calls, in one process.
const RAY: &str = "
def remote(**options):
    return lambda task: type('Task', (), {'remote': staticmethod(task)})
def init(): pass
def get(results): return results
";

#[test]
fn ray_tasks_run_all_units() {
    if !is_there("python3") {
        return;
    }
    let (data, _, table) = jobs();
    fs::create_dir(data.path("modules")).unwrap();
    fs::write(data.path("modules/ray.py"), RAY).unwrap();
    let run = |jobs: &Path, out: &str, options: &[&str]| {
        let mut python = Command::new("python3");
        python.arg("-B").arg(example("ray_units.py")).arg(jobs).arg(data.path(out)).args(options);
        Outcome::of(python.env("PATH", path_with_program()).env("PYTHONPATH", data.path("modules")))
    };
    let made = run(&table, "out", &["--data", &data.root().display().to_string()]).succeeded();
    assert!(made.stdout.contains("2 units: 2 finished"), "{}", made.stdout);
    fs::write(&table, "scene,name\nturn.ron,vase\nnone.ron,jug\n").unwrap();
    let failed = run(&table, "other", &[]);
    assert!(failed.code == Some(1) && failed.stderr.contains("failed: jug"), "{}", failed.stderr);
    assert!(failed.stdout.contains("1 finished, 1 not begun"), "{}", failed.stdout);
}

/// Whether a Slurm cluster answers here, with a node that is idle.
fn slurm_is_idle() -> bool {
    let asked = Command::new("sinfo").args(["--noheader", "--format=%T"]).output();
    asked.is_ok_and(|asked| asked.status.success() && String::from_utf8_lossy(&asked.stdout).contains("idle"))
}

/// The script of the array, as a task of it runs it.
#[cfg(unix)]
#[test]
fn a_task_of_an_array_runs_its_unit() {
    if !is_there("bash") {
        return;
    }
    let (data, _, table) = jobs();
    let mut task = Command::new("bash");
    task.arg(example("slurm.sh")).arg(&table).arg(data.path("out")).arg("--data").arg(data.root());
    task.env("LOBELIA", env!("CARGO_BIN_EXE_lobelia")).env("SLURM_ARRAY_TASK_ID", "2");
    Outcome::of(&mut task).succeeded();
    assert!(
        data.path("out/jug/still/a.png").exists() && !data.path("out/vase").exists(),
        "the second unit alone"
    );
}

#[test]
fn a_slurm_array_runs_all_units() {
    if !slurm_is_idle() {
        eprintln!("no idle Slurm node: units are not run by it");
        return;
    }
    let (data, _, table) = jobs();
    let out = data.path("out");
    let mut array = Command::new("sbatch");
    array.args(["--wait", "--array=1-2", "--mem=300M", "--cpus-per-task=1", "--time=5", "--chdir"]);
    array.arg(data.path("")).env("LOBELIA", env!("CARGO_BIN_EXE_lobelia"));
    Outcome::of(array.arg(example("slurm.sh")).arg(&table).arg(&out)).succeeded();
    let merged = Outcome::of(command(&["report"]).arg(&out)).succeeded();
    assert!(merged.stdout.contains("2 units: 2 finished"), "{}", merged.stdout);
}

#[test]
fn what_is_wrong_is_named() {
    let (data, scene, table) = jobs();
    let refused = |args: &[&str], jobs: &Path, words: &[&str]| {
        let outcome = Outcome::of(command(args).arg(jobs));
        assert_eq!(outcome.code, Some(2), "{}", outcome.stderr);
        words.iter().for_each(|word| assert!(outcome.stderr.contains(word), "{word}: {}", outcome.stderr));
    };
    refused(&["run", "--only", "cup"], &table, &["--only cup", "objects.csv", "lobelia list"]);
    refused(&["run", "--only", "turn_000005-000009"], &scene, &["turn.ron", "turn_000000-000006"]);
    refused(&["list"], &data.path("nothing"), &["nothing", "no such file"]);
    let out = data.path("out");
    let set = "passes.turn.render.orbit.part=(5, 3)";
    let outcome = Outcome::of(command(&["run", "--set", set]).arg(&scene).arg("--out").arg(&out));
    assert!(outcome.code == Some(2) && outcome.stderr.contains("frames from 0 to 6"), "{}", outcome.stderr);
    fs::write(data.path("number.ron"), SCENE.replace("\"turn\"", "\"7\"")).unwrap();
    refused(&["list"], &data.path("number.ron"), &["number.ron", "\"7\"", "a letter"]);
    let fits = SCENE
        .replace("Render(name: \"still\")", "Fit(name: \"still\")")
        .replace("albedo: Fixed(Constant(0.5, 0.5, 0.5))", "albedo: Unknown(0.5, 0.5, 0.5)");
    fs::write(data.path("fits.ron"), fits).unwrap();
    refused(&["list"], &data.path("fits.ron"), &["fits.ron"]);
    assert!(!out.exists());
}
