use super::*;
use crate::checkpoint::{begin_pass, keep_level, keep_pass, keep_step, resume_pass};
use crate::pass::progress::Silent;
use bevy_ecs::prelude::World;

const MARK: u64 = 7;

fn place(pass: u32, level: u32, step: u32) -> Place {
    Place { pass, level, step }
}

/// A world that keeps checkpoints in `out`.
fn world(out: &Path) -> World {
    let files = Files { folder: out.join(FOLDER), mark: MARK, last: Place::default() };
    let mut world = World::new();
    world.insert_resource(Checkpoints::new(Box::new(files), Duration::ZERO, Vec::new()));
    world
}

fn kept(out: &Path) -> Vec<Place> {
    let mut kept = places(&out.join(FOLDER));
    kept.sort_unstable();
    kept
}

fn found(out: &Path) -> Vec<Place> {
    find(out, MARK, &Silent).unwrap().into_iter().map(|(place, _)| place).collect()
}

/// Two passes, the second of two levels, killed during the second level.
fn killed() -> tempfile::TempDir {
    let out = tempfile::tempdir().unwrap();
    let mut world = world(out.path());
    begin_pass(&mut world, 0);
    keep_step(&mut world, 10, &"0").unwrap();
    keep_pass(&mut world, 1, &"1").unwrap();
    begin_pass(&mut world, 1);
    for step in [10, 20, 30] {
        keep_step(&mut world, step, &"1").unwrap();
    }
    keep_level(&mut world, 1, &"1-1").unwrap();
    keep_step(&mut world, 10, &"1-1").unwrap();
    out
}

#[test]
fn only_the_last_two_places_and_the_ways_there_are_kept() {
    let out = killed();
    assert_eq!(kept(out.path()), [place(1, 0, 0), place(1, 1, 0), place(1, 1, 10)]);
    assert_eq!(found(out.path()), kept(out.path()));
    let mut world = world(out.path());
    begin_pass(&mut world, 1);
    keep_step(&mut world, 40, &"").unwrap();
    keep_pass(&mut world, 2, &"").unwrap();
    assert_eq!(kept(out.path()), [place(1, 0, 0), place(1, 0, 40), place(2, 0, 0)]);
    assert_eq!(found(out.path()), [place(2, 0, 0)]);
}

#[test]
fn of_a_damaged_checkpoint_the_one_before_is_taken() {
    let out = killed();
    let file = |place| out.path().join(FOLDER).join(file_name(place));
    let last = file(place(1, 1, 10));
    let whole = std::fs::read(&last).unwrap();
    for at in 0..whole.len() {
        let mut bytes = whole.clone();
        bytes[at] ^= 1;
        std::fs::write(&last, &bytes).unwrap();
        assert_eq!(found(out.path()), [place(1, 0, 0), place(1, 1, 0)], "byte {at}");
        std::fs::write(&last, &whole[..at]).unwrap();
        assert_eq!(found(out.path()), [place(1, 0, 0), place(1, 1, 0)], "{at} bytes");
    }
    std::fs::write(&last, &whole).unwrap();
    assert_eq!(found(out.path()).len(), 3);
    // What a way goes through is needed.
    std::fs::write(file(place(1, 1, 0)), b"x").unwrap();
    assert_eq!(found(out.path()), [place(1, 0, 0)]);
    std::fs::remove_file(file(place(1, 0, 0))).unwrap();
    let error = find(out.path(), MARK, &Silent).unwrap_err();
    assert!(error.exit_code() == 2 && error.help().is_some(), "{error}");
}

#[test]
fn checkpoints_of_another_run_are_none() {
    let out = killed();
    assert!(find(out.path(), MARK + 1, &Silent).unwrap_err().to_string().contains("damaged"));
    std::fs::write(out.path().join(FOLDER).join("1-1-x.state"), "").unwrap();
    std::fs::write(out.path().join(FOLDER).join("9-9.state"), "").unwrap();
    assert_eq!(found(out.path()).len(), 3);
    let ahead = find(out.path(), MARK, &Silent).unwrap();
    let mut world = World::new();
    let files = Files { folder: out.path().join(FOLDER), mark: MARK, last: place(1, 1, 10) };
    world.insert_resource(Checkpoints::new(Box::new(files), Duration::ZERO, ahead));
    let resumed = resume_pass::<String>(&mut world, |_, _| Ok(())).unwrap();
    assert_eq!(resumed, Some((1, "1".to_owned())));
}

#[test]
fn clearing_removes_checkpoints_and_nothing_else() {
    let out = killed();
    std::fs::write(out.path().join(FOLDER).join(".lobelia-abc.part.state"), "half").unwrap();
    clear(out.path()).unwrap();
    assert!(!out.path().join(FOLDER).exists());
    clear(out.path()).unwrap();
    std::fs::create_dir(out.path().join(FOLDER)).unwrap();
    std::fs::write(out.path().join(FOLDER).join("mine"), "x").unwrap();
    clear(out.path()).unwrap();
    assert!(out.path().join(FOLDER).join("mine").exists());
}

#[cfg(unix)]
#[test]
fn a_folder_that_leads_elsewhere_is_refused() {
    let out = tempfile::tempdir().unwrap();
    std::os::unix::fs::symlink("/", out.path().join(FOLDER)).unwrap();
    assert_eq!(clear(out.path()).unwrap_err().exit_code(), 2);
}

fn begun() -> RunStart {
    let inputs = [("a.png".to_owned(), 1), ("b.png".to_owned(), 2)].into();
    RunStart { version: "1".into(), scene: 1, within_memory: 2, threads: 2, views: 3, inputs }
}

#[test]
fn other_data_are_named() {
    let refused = |change: fn(&mut RunStart)| {
        let mut now = begun();
        change(&mut now);
        let error = begun().check_data(&now, &Silent).unwrap_err();
        assert!(error.exit_code() == 2 && error.help().unwrap().contains("--force"), "{error}");
        error.to_string()
    };
    assert!(refused(|now| *now.inputs.get_mut("b.png").unwrap() = 3).starts_with("b.png"));
    assert!(refused(|now| _ = now.inputs.remove("a.png")).starts_with("a.png"));
    assert!(refused(|now| _ = now.inputs.insert("c.png".into(), 1)).starts_with("c.png"));
    assert!(refused(|now| now.within_memory = 9).contains("memory"));
    assert!(refused(|now| now.views = 4).contains("cameras"));
    // Another number of threads changes bits alone.
    begun().check_data(&RunStart { threads: 1, ..begun() }, &Silent).unwrap();
}

#[test]
fn what_a_run_was_begun_with_is_read_back() {
    let out = tempfile::tempdir().unwrap();
    assert_eq!(RunStart::read(out.path()).unwrap(), None);
    begun().write(out.path()).unwrap();
    assert_eq!(RunStart::read(out.path()).unwrap(), Some(begun()));
    std::fs::write(out.path().join(FOLDER).join(BEGUN), "{").unwrap();
    let error = RunStart::read(out.path()).unwrap_err();
    assert!(error.exit_code() == 2 && error.to_string().contains("damaged"), "{error}");
}
