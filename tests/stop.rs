//! Runs that are asked to stop: they end soon, wherever they are, and keep what they have found.

use crate::common::*;
use crate::photos::photographs;
use glam::Vec3;
use std::time::{Duration, Instant};

/// How long a run may take to stop; a program without optimization on a busy machine gets more than
/// the two seconds that it needs.
const PATIENCE: Duration = Duration::from_secs(20);

/// A picture that takes minutes.
const SLOW: &str =
    r#"Render(name: "slow", render: (shading: PathTraced(spp: 65536), samples_per_pixel: 64)), "#;
const REST: &str = "Save(), Export(), ";

/// Sends a signal to a run whose pass is at work, and expects that it ends in time, with this exit
/// code and these states of passes.
#[track_caller]
fn stopped(data: &Data, scene: &str, pass: &str, signal: (&str, i32), states: &[&str]) {
    let at_work = AtWork::start(data, scene, &[], pass);
    if pass == "endless" {
        at_work.until_a_step();
    }
    stop(at_work, signal);
    let files = files_below(&data.path("out"));
    assert!(!files.iter().any(|file| is_temporary(file)), "{files:?}");
    assert_eq!(data.manifest("out")["state"], "interrupted");
    assert_eq!(data.states("out"), states);
}

#[track_caller]
fn stop(at_work: AtWork, (signal, code): (&str, i32)) {
    let start = Instant::now();
    at_work.signal(signal);
    assert_eq!(at_work.ended(), Some(code), "{signal}");
    assert!(start.elapsed() < PATIENCE, "{signal}: {:?}", start.elapsed());
}

#[test]
fn any_signal_stops_a_fit_and_what_it_found_is_saved() {
    for signal in [("TERM", 143), ("HUP", 129), ("INT", 130)] {
        let data = Data::new();
        // Nothing is rendered that could be scored.
        let states = ["interrupted", "waiting", "waiting", "finished", "finished"];
        stopped(&data, &scene(&[ENDLESS, NOVEL, SCORES, REST].concat()), "endless", signal, &states);
        let of_fit = ["albedo.png", "environment.exr", "light.npy", "log.csv", "materials.ron"];
        let of_fit = of_fit.map(|file| format!("endless/{file}"));
        let others = ["saved/scene.ron", "export/mesh.glb", "metrics.json"].map(str::to_owned);
        for file in of_fit.into_iter().chain(others) {
            assert!(data.path("out").join(&file).exists(), "{signal:?}: no {file}");
        }
        let report = data.text("out/report.html");
        assert!(report.contains("s-interrupted") && report.contains("endless: albedo"), "{signal:?}");
    }
}

#[test]
fn a_picture_is_stopped_between_two_samples_and_earlier_ones_are_scored() {
    let data = Data::new();
    let text = scene(&[FIT, NOVEL, SLOW, ENDLESS, SCORES, REST].concat());
    let states = ["finished", "finished", "interrupted", "waiting", "finished", "finished", "finished"];
    stopped(&data, &text, "slow", ("TERM", 143), &states);
    let metrics = data.metrics("out");
    assert!(metrics["passes"]["novel"]["psnr"].is_number(), "{metrics}");
    let left = files_below(&data.path("out/slow"));
    assert!(left.is_empty(), "a picture that is not whole is none: {left:?}");
}

#[test]
fn a_shape_that_is_stopped_is_a_mesh() {
    let data = photographs();
    let shape = r#"Shape(name: "endless", levels: [(cells: 16, texel_cells: 16, steps: 1500000000)]), "#;
    let mesh = r#"Mesh(path: "$DATA/mesh.glb", texture_size: 16)"#;
    let text = scene(&[shape, REST].concat()).replace(mesh, "Unknown(cells: 16, texture_size: 128)");
    stopped(&data, &text, "endless", ("TERM", 143), &["interrupted", "finished", "finished"]);
    let mesh = lobelia::codec::gltf::import::read_mesh(&data.path("out/export/mesh.glb")).unwrap();
    assert!(mesh.triangles.len() > 100, "{}", mesh.triangles.len());
    let text = data.text("out/saved/scene.ron");
    assert!(text.contains("surface: Mesh("), "{text}");
}

#[cfg(target_os = "linux")]
#[test]
fn a_run_that_ignores_hangups_goes_on() {
    let data = Data::new();
    data.write("scene.ron", scene(ENDLESS));
    let at_work = AtWork::begin_by(&data, &["nohup"], &[]);
    at_work.until_a_step();
    at_work.signal("HUP");
    at_work.until_a_step();
    at_work.signal("TERM");
    assert_eq!(at_work.ended(), Some(143), "not 129");
}

#[test]
fn a_second_signal_ends_a_run_at_once() {
    let data = Data::new();
    let at_work = AtWork::start(&data, &scene(ENDLESS), &[], "endless");
    at_work.signal("TERM");
    at_work.signal("TERM");
    assert_eq!(at_work.ended(), Some(143));
}

#[test]
fn a_run_that_is_stopped_before_its_first_pass_leaves_nothing() {
    let data = Data::new();
    let text = scene(FIT).replace("Unknown(lobes: 6)", r#"Initial(Map(path: "$DATA/sky.exr", lobes: 128))"#);
    let pixel = |i: u32| Vec3::splat(0.1 + ((i * 7919) % 1000) as f32 / 500.0);
    write_image(&data.path("sky.exr"), &(0..256 * 128).map(pixel).collect::<Vec<_>>(), 256);
    data.write("scene.ron", text);
    let at_work = AtWork::begin(&data, &[]);
    at_work.until(|event| event["event"] == "done" && event["title"] == "photographs");
    stop(at_work, ("TERM", 143));
    assert_eq!(files_below(&data.path("out")), Vec::<String>::new());
}
