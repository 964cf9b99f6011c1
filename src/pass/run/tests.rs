//! Whole runs on a disk that fails: one error, what was written is whole, and the run goes on from
//! there.

use crate::pass::{RunOptions, run, run::record::Record};
use crate::progress::Silent;
use crate::report::RunState;
use crate::scene::{LoadOptions, LoadedScene, load};
use lobelia_geometry::error::Error;
use lobelia_io::codec::file::faults::{Call, Faulty, FileFault};
use std::{collections::BTreeMap, path::Path, sync::Arc, time::Duration};

const SCENE: &str = r#"Scene(
    version: 1,
    surface: Sphere(radius: 0.8, texture_size: 16),
    views: Photographed(
        cameras: (count: 4, test: 1, size: 16),
        truth: (
            albedo: Constant(0.5, 0.3, 0.2),
            specular: (albedo: (0.2, 0.2, 0.2), roughness: 0.3),
            light: Lobes(lobes: [(axis: (0, 1, 0), sharpness: 3, amplitude: (1, 1, 1))]),
        ),
    ),
    light: Unknown(lobes: 6),
    visibility: None,
    passes: [
        Fit(steps: 6, batch: 64),
        Render(name: "novel"),
        Evaluate(scores: [(pass: "novel", truth: Photographs)]),
        Save(),
    ],
)"#;

fn scene(folder: &Path) -> LoadedScene {
    let path = folder.join("scene.ron");
    std::fs::write(&path, SCENE).unwrap();
    load(&path, &LoadOptions::default()).unwrap()
}

fn options(out: &Path, resume: bool) -> RunOptions {
    let (out, checkpoint_every) = (out.to_owned(), Some(Duration::ZERO));
    RunOptions { out, checkpoint_every, resume, ..RunOptions::default() }
}

/// Results whose bytes do not depend on the time.
fn results(out: &Path) -> BTreeMap<String, Vec<u8>> {
    let files =
        ["fit/albedo.exr", "fit/light.npy", "fit/materials.ron", "scores/views.csv", "saved/albedo.exr"];
    let pictures = std::fs::read_dir(out.join("novel")).unwrap().map(|entry| entry.unwrap().file_name());
    let pictures = pictures.map(|name| format!("novel/{}", name.to_string_lossy()));
    let all = files.map(str::to_owned).into_iter().chain(pictures);
    all.map(|file| (file.clone(), std::fs::read(out.join(file)).unwrap())).collect()
}

fn unfinished_files(folder: &Path) -> usize {
    let entries = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap());
    let count = |entry: std::fs::DirEntry| {
        let is_named = entry.file_name().to_string_lossy().starts_with(".lobelia-");
        let is_folder = entry.file_type().unwrap().is_dir();
        usize::from(is_named) + if is_folder { unfinished_files(&entry.path()) } else { 0 }
    };
    entries.map(count).sum()
}

#[test]
fn a_run_on_a_disk_that_fails_anywhere_goes_on_when_there_is_room() {
    let folder = tempfile::tempdir().unwrap();
    let (loaded, whole) = (scene(folder.path()), folder.path().join("whole"));
    run(&loaded, &options(&whole, false), Arc::new(Silent)).unwrap();
    let whole = results(&whole);
    let syncs = [0, 1, 2, 4, 7, 11, 16, 22, 30].map(|after| (Call::Sync, after));
    let writes = [0, 3, 10, 20, 30, 40].map(|after| (Call::Write, after));
    let mut failures = 0;
    for (i, (call, after)) in syncs.into_iter().chain(writes).enumerate() {
        let out = folder.path().join(format!("broken-{i}"));
        // EIO, ENOSPC, EPIPE in turn.
        let errno = [5, 28, 32][i % 3];
        let faulty = Faulty::new(&out, call, FileFault::Errno { errno, after });
        let ended = run(&loaded, &options(&out, false), Arc::new(Silent));
        drop(faulty);
        if let Err(error) = ended {
            failures += 1;
            assert!(matches!(error, Error::Io { .. }), "{error:?}");
            assert!(!out.exists() || unfinished_files(&out) == 0, "after {after}");
            assert_ne!(Record::read(&out).map(|record| record.state), Some(RunState::Finished));
            run(&loaded, &options(&out, true), Arc::new(Silent))
                .unwrap_or_else(|error| panic!("{call:?} after {after}: {error}"));
        }
        let found = results(&out);
        for (file, bytes) in &whole {
            assert!(found[file] == *bytes, "{file} differs, {call:?} after {after}, error {errno}");
        }
    }
    assert!(failures >= 12, "{failures} runs failed");
}
