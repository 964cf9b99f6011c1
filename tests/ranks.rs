//! One fit on several processes: the same bits as on one.

use crate::common::{Data, Outcome, command, files_below};
use crate::photos::photographs;
use crate::resume::{Death, Killer, MESH, results, scene, two_balls};
use lobelia::Result;
use lobelia::pass::{self, RunOptions};
use lobelia::ranks::Ranks;
use lobelia::ranks::threads::ThreadRank;
use lobelia::scene::{LoadOptions, load};
use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// The files of a pass, by name.
type Found = BTreeMap<String, String>;

/// How ranks start, and where they are killed.
#[derive(Clone, Copy, Default)]
struct Start {
    resume: bool,
    force: bool,
    death: Option<Death>,
}

/// Runs a scene on so many threads as ranks, each in a folder of its own within `out`; returns how each has ended. `Err` if it was killed.
fn run_in(data: &Data, text: &str, out: &str, size: usize, start: Start) -> Vec<Result<Result<()>, ()>> {
    let path = data.path("scene.ron");
    std::fs::write(&path, text).unwrap();
    let work = |rank: ThreadRank, number: usize| {
        let options = LoadOptions { data: Some(data.root().to_owned()), ..LoadOptions::default() };
        let loaded = load(&path, &options).unwrap();
        let ranks = (size > 1).then(|| Ranks::new(Arc::new(rank)));
        let Start { resume, force, death } = start;
        let checkpoint = (resume || death.is_some()).then_some(Duration::ZERO);
        let out = data.path(&format!("{out}/{number}"));
        let options = RunOptions { out, ranks, resume, force, checkpoint, ..RunOptions::default() };
        catch_unwind(AssertUnwindSafe(|| pass::run(&loaded, &options, &Killer(death)))).map_err(|_| ())
    };
    std::thread::scope(|scope| {
        let work = &work;
        let start = |(number, rank)| scope.spawn(move || work(rank, number));
        let at_work: Vec<_> = ThreadRank::group(size).into_iter().enumerate().map(start).collect();
        at_work.into_iter().map(|rank| rank.join().unwrap()).collect()
    })
}

/// What each of so many ranks has written in `out` for a pass, and what it has saved.
fn found_in(data: &Data, out: &str, pass: &str, size: usize) -> Vec<(Found, Option<Found>)> {
    let of = |number: usize| {
        let own = data.path(&format!("{out}/{number}"));
        let saved = own.join("save");
        (results(&own.join(pass)), saved.is_dir().then(|| results(&saved)))
    };
    (0..size).map(of).collect()
}

/// Runs a scene on so many threads as ranks; returns what each has written for the pass, and what the first has saved.
fn run(data: &Data, text: &str, pass: &str, size: usize) -> Vec<(Found, Option<Found>)> {
    let out = size.to_string();
    run_in(data, text, &out, size, Start::default()).into_iter().for_each(|ended| ended.unwrap().unwrap());
    found_in(data, &out, pass, size)
}

/// The bits of several ranks are those of one.
#[track_caller]
fn agrees(data: &Data, text: &str, pass: &str, sizes: &[usize]) {
    let (alone, saved) = run(data, text, pass, 1).remove(0);
    assert!(alone.len() > 2, "{alone:?}");
    for size in sizes {
        for (rank, (found, also)) in run(data, text, pass, *size).into_iter().enumerate() {
            assert!(found == alone, "rank {rank} of {size} differs:\n{alone:?}\n{found:?}");
            assert_eq!(also, saved.clone().filter(|_| rank == 0), "the first of {size} saves");
        }
    }
}

#[test]
fn a_fit_on_several_ranks_has_the_bits_of_one() {
    let data = Data::new();
    two_balls(&data);
    let text = scene(
        MESH,
        "material: (gloss: One),",
        r#"Fit(name: "first", steps: 5, batch: 800), Render(name: "between"),
        Fit(name: "fit", steps: 60, batch: 800), Render(name: "after"), Save(name: "save"),"#,
    );
    // The pool has three or four chunks of samples: with seven ranks some have nothing to do.
    agrees(&data, &text, "fit", &[2, 3, 7]);
}

#[test]
fn a_shape_on_several_ranks_has_the_bits_of_one() {
    let data = photographs();
    let passes = r#"Shape(name: "shape", levels: [(cells: 16, texel_cells: 12, steps: 54, hold: 5)],
        batch: 600, silhouette_batch: 32, cameras: PosesAndFocal, exposure: Color),
        Fit(name: "fit", steps: 10, batch: 600, vertices: true), Save(name: "save"),"#;
    let text = scene("Unknown(cells: 16, texture_size: 128)", "material: (gloss: One),", passes);
    agrees(&data, &text, "fit", &[2]);
}

#[test]
fn what_surrounds_the_steps_of_a_shape_has_the_bits_of_one() {
    let data = photographs();
    // Hollows are looked for in the hull and on the second grid; outlines and stereo come after.
    let passes = r#"Shape(name: "shape", batch: 600, silhouette_batch: 32, levels: [
            (cells: 16, texel_cells: 12, steps: 12, hold: 5), (cells: 24, texel_cells: 12, steps: 12, pixels: 0.1)]),
        Fit(name: "fit", steps: 4, batch: 600), Save(name: "save"),"#;
    let text = scene("Unknown(cells: 16, texture_size: 128)", "material: (gloss: One),", passes);
    agrees(&data, &text, "fit", &[2, 3]);
}

/// Pixels of training photographs stay with the process that has read them; passes get those that they look at.
#[test]
fn photographs_that_others_keep_are_compared_and_shown() {
    let data = photographs();
    let again = r#"Render(name: "again", render: (views: All)),
        Evaluate(name: "between", scores: [(pass: "again", truth: Photographs)]),"#;
    let passes = format!(
        r#"Fit(name: "first", steps: 90, batch: 300, cameras: Poses, detail: true), {again}
        View(name: "page", photographs: 3), Fit(name: "fit", steps: 4, batch: 800), Render(name: "novel"),
        Evaluate(name: "scores", scores: [(pass: "novel", truth: Photographs), (pass: "again", truth: Photographs)]),
        View(name: "view", photographs: 4),"#
    );
    two_balls(&data);
    let text = scene(MESH, "material: (gloss: One),", &passes);
    let (alone, _) = run(&data, &text, "fit", 1).remove(0);
    let of = |run: &str, pass: &str| results(&data.path(run).join(pass));
    for size in [2, 3] {
        for (rank, (found, _)) in run(&data, &text, "fit", size).into_iter().enumerate() {
            assert!(found == alone, "rank {rank} of {size} differs:\n{alone:?}\n{found:?}");
            let between = of("1/0", "between");
            let also = of(&format!("{size}/{rank}"), "between");
            assert!(!between.is_empty() && also == between, "{rank} of {size}");
        }
        // The title of a page is that of its output folder, which is another for each rank.
        for pass in ["page", "scores", "view"] {
            let (expected, found) = (of("1/0", pass), of(&format!("{size}/0"), pass));
            assert!(!expected.is_empty() && found == expected, "{pass} with {size} ranks");
        }
        for pass in ["scores", "view"] {
            assert!(
                !data.path(&format!("{size}/1")).join(pass).exists(),
                "{pass} is for the first of {size}"
            );
        }
    }
}

#[test]
fn a_fit_under_two_lights_has_the_bits_of_one() {
    let data = photographs();
    two_balls(&data);
    let passes = r#"Fit(name: "fit", steps: 24, batch: 400, detail: true), Save(name: "save"),"#;
    let placements = r#"placements: [(photographs: "rgb_000000"), (photographs: "rgb_", light: Own)]"#;
    let text = scene(MESH, "material: (gloss: One),", passes)
        .replace(r#"Dataset(path: "$DATA")"#, &format!(r#"Dataset(path: "$DATA", {placements})"#));
    agrees(&data, &text, "fit", &[2, 3]);
}

#[test]
fn several_base_materials_have_the_bits_of_one_process() {
    let data = Data::new();
    two_balls(&data);
    let passes = r#"Fit(name: "fit", steps: 40, batch: 800), Save(name: "save"),"#;
    agrees(&data, &scene(MESH, "material: (gloss: Blend(materials: 2)),", passes), "fit", &[2, 3, 7]);
}

/// The material that is chosen is the same as well, where one is.
#[test]
fn a_fit_that_tries_materials_has_the_bits_of_one_process() {
    let data = Data::new();
    two_balls(&data);
    let passes = r#"Fit(name: "fit", steps: 40, batch: 800), Save(name: "save"),"#;
    agrees(&data, &scene(MESH, "", passes), "fit", &[2]);
}

/// What a run of some ranks has kept when it is killed, a run of others goes on from.
#[test]
fn a_run_goes_on_with_another_number_of_ranks() {
    let data = Data::new();
    two_balls(&data);
    let passes = r#"Fit(name: "fit", steps: 40, batch: 800), Save(name: "save"),"#;
    let text = scene(MESH, "material: (gloss: One),", passes);
    let (alone, saved) = run(&data, &text, "fit", 1).remove(0);
    let resume = Start { resume: true, ..Start::default() };
    for (before, after) in [(1, 3), (2, 1), (3, 2)] {
        let killed = format!("killed-{before}");
        let death = Some(("fit", 23));
        let ended = run_in(&data, &text, &killed, before, Start { death, ..Start::default() });
        assert!(ended.iter().all(Result::is_err), "{ended:?}");
        let resumed = format!("resumed-{after}");
        for rank in 0..after {
            copy_folder(&data.path(&format!("{killed}/0")), &data.path(&format!("{resumed}/{rank}")));
        }
        let ended = run_in(&data, &text, &resumed, after, resume);
        let told = std::fs::read_to_string(data.path(&resumed).join("0/run.json")).unwrap();
        assert!(told.contains("the run goes on in pass fit"), "{told}");
        assert!(ended.iter().all(|ended| matches!(ended, Ok(Ok(())))), "{ended:?}");
        for (rank, (found, also)) in found_in(&data, &resumed, "fit", after).into_iter().enumerate() {
            assert!(found == alone, "rank {rank} of {after} differs after {before}:\n{alone:?}\n{found:?}");
            assert_eq!(also, saved.clone().filter(|_| rank == 0));
        }
    }
    // One of them does not see what the others go on from.
    copy_folder(&data.path("killed-1/0"), &data.path("unlike/1"));
    for ended in run_in(&data, &text, "unlike", 2, resume) {
        let said = ended.unwrap().unwrap_err().to_string();
        assert!(said.contains("different checkpoints"), "{said}");
    }
    // The first process alone sees the run that is replaced.
    copy_folder(&data.path("killed-1/0"), &data.path("replaced/0"));
    let again = Start { force: true, ..Start::default() };
    let ended = run_in(&data, &text, "replaced", 2, again);
    assert!(ended.iter().all(|ended| matches!(ended, Ok(Ok(())))), "{ended:?}");
}

#[test]
fn a_program_without_mpi_is_not_one_of_several() {
    if cfg!(feature = "mpi") {
        println!("left out: the program has the feature mpi");
        return;
    }
    let data = Data::new();
    let several = |arguments: &[&str]| {
        let mut program = command(&["run", "scene.ron"]);
        Outcome::of(program.args(arguments).current_dir(data.root()).env("OMPI_COMM_WORLD_SIZE", "2"))
    };
    let refused = several(&[]);
    assert!(refused.code == Some(2) && refused.stderr.contains("--features mpi"), "{}", refused.stderr);
    // Units of a job know nothing of each other.
    assert!(!several(&["--only", "vase"]).stderr.contains("mpi"));
}

fn copy_folder(from: &Path, to: &Path) {
    for file in files_below(from) {
        std::fs::create_dir_all(to.join(&file).parent().unwrap()).unwrap();
        std::fs::copy(from.join(&file), to.join(&file)).unwrap();
    }
}

#[test]
fn what_communication_takes_is_told() {
    let data = Data::new();
    let text = scene(MESH, "material: (gloss: One),", r#"Fit(name: "fit", steps: 4, batch: 800),"#);
    run(&data, &text, "fit", 2);
    let scores = std::fs::read_to_string(data.path("2/0/metrics.json")).unwrap();
    let scores: serde_json::Value = serde_json::from_str(&scores).unwrap();
    let found = &scores["communication"];
    assert_eq!(found["ranks"], 2);
    // Radiance and adjoints of half of some hundred samples, and the sums of their chunks.
    assert!((5e3..1e5).contains(&found["bytes_per_step"].as_f64().unwrap()), "{found}");
    // Of photographs, the shadows of half of some thousand texels, and radiance of the first guess.
    assert!((1e5..1e8).contains(&found["bytes_of_shares"].as_f64().unwrap()), "{found}");
}

/// Two processes of one thread each that run the scene file of `data` and write into its folder `out`; `None` where the program has no MPI.
fn two_processes(data: &Data, out: &str) -> Option<Command> {
    if !cfg!(feature = "mpi") || Command::new("mpirun").arg("--version").output().is_err() {
        println!("left out: it needs the feature mpi, and mpirun");
        return None;
    }
    let mut mpirun = Command::new("mpirun");
    mpirun.args(["-n", "2", "--allow-run-as-root", "--oversubscribe"]).arg(command(&[]).get_program());
    mpirun.arg("run").arg(data.path("scene.ron")).arg("--data").arg(data.root());
    mpirun.arg("--out").arg(data.path(out)).args(["--threads", "1"]);
    Some(mpirun)
}

#[test]
fn processes_under_mpirun_have_the_bits_of_one() {
    let data = Data::new();
    let Some(mut mpirun) = two_processes(&data, "both") else { return };
    two_balls(&data);
    let passes = r#"Fit(name: "fit", steps: 60, batch: 800), Save(name: "saved"),"#;
    let text = scene(MESH, "material: (gloss: One),", passes);
    data.run(&text, "alone", &["--threads", "1"]).succeeded();
    let outcome = Outcome::of(&mut mpirun).succeeded();
    assert!(outcome.stdout.contains("fit: 2 ranks: "), "{}", outcome.stdout);
    let saved = |out: &str| {
        let mut files = results(&data.path(out).join("saved"));
        files.retain(|name, _| name.contains("albedo") || name.contains("light"));
        files
    };
    assert!(saved("alone").len() >= 2, "{:?}", saved("alone"));
    assert_eq!(saved("alone"), saved("both"));
    data.run(&text, "threads", &["--threads", "2"]).succeeded();
    assert_eq!(saved("threads"), saved("both"), "one process with as many threads");
}

/// A signal to one process under `mpirun` ends all after the same step, and what they have found is written.
#[test]
#[cfg(target_os = "linux")]
fn a_signal_to_one_process_stops_all_together() {
    let data = Data::new();
    let Some(mut mpirun) = two_processes(&data, "out") else { return };
    two_balls(&data);
    let passes = r#"Fit(name: "fit", steps: 1000000, batch: 800), Save(name: "saved"),"#;
    std::fs::write(data.path("scene.ron"), scene(MESH, "material: (gloss: One),", passes)).unwrap();
    let mut running = mpirun.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    let record = || std::fs::read_to_string(data.path("out/run.json")).unwrap_or_default();
    until(|| record().contains("\"running\""), "the run has not begun");
    std::thread::sleep(Duration::from_secs(3));
    let own = format!("/proc/{0}/task/{0}/children", running.id());
    let children = std::fs::read_to_string(own).unwrap();
    let last = children.split_whitespace().last().unwrap();
    assert!(Command::new("kill").args(["-TERM", last]).status().unwrap().success());
    until(|| running.try_wait().unwrap().is_some(), "the run does not end");
    assert!(record().contains("\"interrupted\"") && !record().contains("\"running\""), "{}", record());
    let log = std::fs::read_to_string(data.path("out/fit/log.csv")).unwrap();
    assert!(log.lines().count() > 2, "{log}");
}

/// Waits for a minute at most.
#[cfg(target_os = "linux")]
fn until(mut is_so: impl FnMut() -> bool, problem: &str) {
    let begun = Instant::now();
    while !is_so() {
        assert!(begun.elapsed() < Duration::from_secs(60), "{problem}");
        std::thread::sleep(Duration::from_millis(100));
    }
}
