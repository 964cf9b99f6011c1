//! Many objects and many frames: a list of units that know nothing of each other. What runs them, on how many machines, is any program that runs jobs;
//! a unit that is killed goes on, and one that is run twice is done.
//!
//! | module | holds |
//! | --- | --- |
//! | [`unit`](mod@unit) | a unit, and what it has come to |
//! | `table` | `objects.csv`: an object a row |
//! | `frames` | the frames of films, so many a unit |
//! | [`merge`], `page` | what units have come to: one table and page, films joined |
//!
//! | jobs | units |
//! | --- | --- |
//! | a folder | its scene files, by name |
//! | `objects.csv` | its rows |
//! | a scene file | the frames of its films |

mod frames;
pub mod merge;
mod page;
mod table;
pub mod unit;

use crate::error::{Error, Result};
use crate::jobs::unit::Unit;
use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

/// The units of `jobs`; `data` is what `$DATA` stands for where a table does not say it, and a unit of a film has `frames` frames.
///
/// # Errors
/// [`Error::Usage`] or [`Error::Input`] that says which file, row or name is wrong.
pub fn list(jobs: &Path, data: Option<&Path>, frames: u32) -> Result<Vec<Unit>> {
    // A unit is the same wherever it is run from.
    let (jobs, data) = (&absolute(jobs)?, data.map(absolute).transpose()?);
    let data = data.as_deref();
    let units = if jobs.is_dir() {
        scenes_of(jobs, data)?
    } else if has_ending(jobs, "csv") {
        table::read(jobs, data)?
    } else {
        frames::of_films(jobs, data, frames)?
    };
    check_names(jobs, &units)?;
    Ok(units)
}

/// The unit of `jobs` that has this name.
///
/// # Errors
/// Those of [`list`]; [`Error::Usage`] if there is none.
pub fn find(jobs: &Path, data: Option<&Path>, name: &str) -> Result<Unit> {
    let (jobs, data) = (&absolute(jobs)?, data.map(absolute).transpose()?);
    let data = data.as_deref();
    // A film's unit says itself which frames it has.
    if !jobs.is_dir() && !has_ending(jobs, "csv") {
        return frames::named(jobs, data, name);
    }
    let units = list(jobs, data, 1)?;
    units.into_iter().find(|unit| unit.name == name).ok_or_else(|| {
        let problem = format!("--only {name}: {} has no unit of this name", jobs.display());
        Error::usage(problem, format!("`lobelia list {}` names them.", jobs.display()))
    })
}

fn absolute(path: &Path) -> Result<PathBuf> {
    std::path::absolute(path).map_err(Error::io("find", path))
}

fn has_ending(path: &Path, ending: &str) -> bool {
    path.extension().is_some_and(|found| found.eq_ignore_ascii_case(ending))
}

/// The scene files of a folder.
fn scenes_of(folder: &Path, data: Option<&Path>) -> Result<Vec<Unit>> {
    let entries = fs::read_dir(folder).map_err(Error::io("read", folder))?;
    let paths = entries.map(|entry| entry.map(|entry| entry.path()));
    let mut paths: Vec<PathBuf> = paths.collect::<std::io::Result<_>>().map_err(Error::io("read", folder))?;
    paths.retain(|path| has_ending(path, "ron") && path.is_file());
    paths.sort();
    if paths.is_empty() {
        let problem = format!("{} has no scene files (*.ron)", folder.display());
        return Err(Error::usage(
            problem,
            "Give a folder of scene files, a table objects.csv, or the scene file of a film.",
        ));
    }
    let unit = |scene: PathBuf| Unit {
        name: scene.file_stem().unwrap_or_default().to_string_lossy().into_owned(),
        scene,
        data: data.map(Path::to_owned),
        sets: Vec::new(),
        pass: None,
    };
    Ok(paths.into_iter().map(unit).collect())
}

/// A unit's name is that of a folder, and no two are alike where case does not count.
fn check_names(jobs: &Path, units: &[Unit]) -> Result<()> {
    let mut seen = BTreeSet::new();
    for Unit { name, .. } in units {
        let is_plain = |c: char| c.is_alphanumeric() || "-_.+".contains(c);
        let wrong =
            if name.trim() != name || name.is_empty() || name.starts_with('.') || !name.chars().all(is_plain)
            {
                "is not one"
            } else if !seen.insert(name.to_lowercase()) {
                "is there twice"
            } else {
                continue;
            };
        let problem =
            format!("{}: units are called by names of folders, and `{name}` {wrong}", jobs.display());
        return Err(Error::usage(problem, "Name them apart, by letters, digits, `-`, `_`, `.` and `+`."));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn unit(name: &str) -> Unit {
        Unit { name: name.into(), scene: "a.ron".into(), data: None, sets: Vec::new(), pass: None }
    }

    #[test]
    fn names_are_those_of_folders_and_differ() {
        let check = |names: &[&str]| {
            check_names(Path::new("objects.csv"), &names.iter().map(|name| unit(name)).collect::<Vec<_>>())
        };
        assert!(check(&["vase", "vase_2", "Krug-1.5"]).is_ok());
        for wrong in [&["a/b"][..], &["a b"], &[".."], &[""], &[" a"], &["vase", "Vase"], &["c:"]] {
            let error = check(wrong).unwrap_err().to_string();
            assert!(error.contains("objects.csv"), "{error}");
        }
    }

    #[test]
    fn a_folder_has_its_scene_files_in_order() {
        let folder = tempfile::tempdir().unwrap();
        assert!(list(folder.path(), None, 1).unwrap_err().to_string().contains("no scene files"));
        for name in ["b.ron", "a.RON", "notes.txt"] {
            fs::write(folder.path().join(name), "").unwrap();
        }
        let names: Vec<String> =
            list(folder.path(), None, 1).unwrap().into_iter().map(|unit| unit.name).collect();
        assert_eq!(names, ["a", "b"]);
        assert_eq!(find(folder.path(), None, "b").unwrap().scene, folder.path().join("b.ron"));
        assert!(find(folder.path(), None, "c").unwrap_err().to_string().contains("no unit"));
    }
}
