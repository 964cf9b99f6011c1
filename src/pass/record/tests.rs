//! The manifest of a run, and what may be replaced.

use super::*;
use crate::scene::load::{LoadOptions, load};

fn plan(files: &[&str]) -> Vec<PassFiles> {
    let files = files.iter().map(|file| format!("novel/{file}")).collect();
    vec![PassFiles { pass: "novel".into(), files }]
}

const SCENE: &str = r#"Scene(
    version: 1,
    surface: Sphere(),
    views: Cameras([(name: "a", eye: (0, 0, 3), width: 4, height: 4)]),
    seed: 7,
)"#;

fn scene() -> LoadedScene {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.ron");
    fs::write(&path, SCENE).unwrap();
    load(&path, &LoadOptions::default()).unwrap()
}

fn begin(out: &Path, files: &[&str]) -> RunRecord {
    Claim::new(out, plan(files)).unwrap().begin(&scene(), &[], 0).unwrap()
}

/// Manifests come with folders from anywhere.
#[test]
fn a_manifest_that_lists_what_is_elsewhere_removes_nothing_there() {
    let root = tempfile::tempdir().unwrap();
    let (out, photograph) = (root.path().join("out"), root.path().join("photo.png"));
    fs::write(&photograph, "x").unwrap();
    let mut record = begin(&out, &["a.png"]);
    let absolute = photograph.to_string_lossy().into_owned();
    record.record.files.extend([
        "../photo.png".into(),
        "novel/../../photo.png".into(),
        absolute,
        "..".into(),
    ]);
    record.record.passes[0].files.extend([
        "../photo.png".into(),
        "novel/../../".into(),
        "link/photo.png".into(),
    ]);
    #[cfg(unix)]
    std::os::unix::fs::symlink(root.path(), out.join("link")).unwrap();
    record.record.write(&out).unwrap();
    drop(record);
    begin(&out, &["a.png"]).end(Ok(())).unwrap();
    assert!(photograph.exists());
    assert_eq!(Record::read(&out).unwrap().listed().count(), 0);
}

#[test]
fn a_run_that_was_killed_at_its_very_start_is_none() {
    let root = tempfile::tempdir().unwrap();
    let out = root.path();
    write_bytes(&out.join(".lobelia-abc.part.json"), b"{").unwrap();
    write_bytes(&out.join(".lobelia.lock"), b"").unwrap();
    check_used(out, false, true).unwrap();
    drop(begin(out, &["a.png"]));
    assert!(!out.join(".lobelia-abc.part.json").exists());
    std::fs::create_dir(out.join("else")).unwrap();
    write_bytes(&out.join("else/mine.txt"), b"x").unwrap();
    assert!(check_used(&out.join("else"), false, true).is_err());
}

#[test]
fn states_and_files_are_those_of_the_run() {
    let root = tempfile::tempdir().unwrap();
    let out = root.path();
    let mut record = begin(out, &["a.png", "never.png", "debug/"]);
    record.pass(0, RunState::Running, Vec::new()).unwrap();
    write_bytes(&out.join("novel/a.png"), b"x").unwrap();
    write_bytes(&out.join("novel/debug/1.png"), b"x").unwrap();
    // Killed here: the next run knows the files.
    drop(record);
    assert_eq!(Record::read(out).unwrap().state, RunState::Running);
    assert!(check_used(out, false, true).unwrap_err().to_string().contains("did not finish"));
    let mut record = begin(out, &["a.png"]);
    assert!(!out.join("novel").exists(), "old results are gone before new ones come");
    write_bytes(&out.join("novel/a.png"), b"x").unwrap();
    record.pass(0, RunState::Finished, vec!["1 view".into()]).unwrap();
    record.end(Err(Error::run("late", "it failed"))).unwrap_err();
    drop(record);
    let read = Record::read(out).unwrap();
    assert_eq!((read.state, read.passes[0].state), (RunState::Failed, RunState::Finished));
    assert_eq!(
        (read.error.as_deref(), read.passes[0].files.as_slice()),
        (Some("late: it failed"), &["novel/a.png".to_owned()][..])
    );
    assert_eq!((read.seed, read.passes[0].said.len()), (Some(7), 1));
    assert!(read.scene_text.starts_with("Scene(") && read.machine.is_some());
    assert!(read.passes[0].secs.is_some_and(|secs| (0.0..60.0).contains(&secs)));
}
