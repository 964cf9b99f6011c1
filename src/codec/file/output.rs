//! Whether results can be written, asked before hours of work: names, permissions and room.

use crate::{Error, Result};
use std::collections::HashSet;
use std::fs;
use std::io::ErrorKind;
use std::path::Path;

/// Most bytes of a view's name: its files get a prefix and an extension, and file systems stop at 255 bytes.
const MOST_NAME_BYTES: usize = 200;

/// Whether `name` can be the stem of a file.
///
/// # Errors
/// What is wrong with it, as a clause that follows the name.
pub(crate) fn check_file_name(name: &str) -> Result<(), String> {
    if name.is_empty() {
        return Err("is empty".to_owned());
    }
    if name.len() > MOST_NAME_BYTES {
        return Err(format!("has {} bytes; a file name has room for {MOST_NAME_BYTES}", name.len()));
    }
    if matches!(name, "." | "..") {
        return Err("stands for a folder".to_owned());
    }
    match name.chars().find(|&c| matches!(c, '/' | '\\') || c.is_control()) {
        Some(c) => Err(format!("holds {c:?}, which a file name must not")),
        None => Ok(()),
    }
}

/// The stems of the files of things with these names, in the order of the names, apart from each other and from those that are `taken`
/// even where case does not count. A name that can be a stem is one; what a file's name must not hold becomes `_`, and what is no longer
/// alone gets a number. No stem leads out of the folder that it is put into.
pub(crate) fn file_stems(names: &[&str], taken: &[&str]) -> Vec<String> {
    let mut used: HashSet<String> = taken.iter().map(|stem| stem.to_lowercase()).collect();
    let mut stems = vec![String::new(); names.len()];
    // Names that can stay as they are come first: another one must not take their place.
    for is_kept in [true, false] {
        for (name, place) in names.iter().zip(&mut stems) {
            if check_file_name(name).is_ok() == is_kept {
                *place = alone(&file_stem(name), &mut used);
            }
        }
    }
    stems
}

/// The stem, or the first of it with a number that is not used; it is used then.
fn alone(stem: &str, used: &mut HashSet<String>) -> String {
    let numbered = (2u64..).map(|number| format!("{stem}_{number}"));
    let mut candidates = std::iter::once(stem.to_owned()).chain(numbered);
    candidates.find(|candidate| used.insert(candidate.to_lowercase())).unwrap_or_default()
}

fn file_stem(name: &str) -> String {
    if check_file_name(name).is_ok() {
        return name.to_owned();
    }
    let allowed = |c: char| if matches!(c, '/' | '\\') || c.is_control() { '_' } else { c };
    let mut stem: String = name.chars().map(allowed).collect();
    while stem.len() > MOST_NAME_BYTES {
        stem.pop();
    }
    if matches!(stem.as_str(), "" | "." | "..") { "_".repeat(stem.len().max(1)) } else { stem }
}

/// Checks that files can be made in `folder`, which need not exist yet: a file without a name is made in the nearest folder
/// that exists, and is gone at once.
///
/// # Errors
/// [`Error::Usage`] if a part of the path is a file, or the folder may not be written into.
pub fn check_writable(folder: &Path) -> Result<()> {
    let existing = existing_folder(folder)?;
    match tempfile::tempfile_in(existing) {
        Ok(_) => Ok(()),
        Err(error) => Err(refused(existing, &error)),
    }
}

fn refused(folder: &Path, error: &std::io::Error) -> Error {
    let why = match error.kind() {
        ErrorKind::PermissionDenied => "permission denied".to_owned(),
        ErrorKind::ReadOnlyFilesystem => "the file system can only be read".to_owned(),
        ErrorKind::StorageFull | ErrorKind::QuotaExceeded => "the disk is full".to_owned(),
        _ => error.to_string(),
    };
    let problem = format!("nothing can be written into {}: {why}", folder.display());
    Error::usage(problem, "Choose another folder with --out, or allow writing there: `chmod u+wx`.")
}

/// The folder itself, or the nearest above it that exists.
fn existing_folder(folder: &Path) -> Result<&Path> {
    for place in folder.ancestors() {
        let place = if place.as_os_str().is_empty() { Path::new(".") } else { place };
        match fs::metadata(place) {
            Ok(found) if found.is_dir() => return Ok(place),
            Ok(_) => {
                let problem = format!("{} cannot be made: {} is a file", folder.display(), place.display());
                return Err(Error::usage(problem, "Choose another folder with --out."));
            }
            Err(error) if matches!(error.kind(), ErrorKind::NotFound | ErrorKind::NotADirectory) => {
                if let Ok(target) = fs::read_link(place) {
                    let (link, target) = (place.display(), target.display());
                    let problem = format!("{link} is a symbolic link to {target}, which does not exist");
                    return Err(Error::usage(problem, "Choose another folder with --out."));
                }
            }
            Err(error) => return Err(refused(place, &error)),
        }
    }
    Ok(Path::new("."))
}

/// Bytes that this user may still write below `folder`, which need not exist yet; `None` if the system does not say.
#[cfg(unix)]
fn free_bytes(folder: &Path) -> Option<u64> {
    let found = rustix::fs::statvfs(existing_folder(folder).ok()?).ok()?;
    Some(found.f_bavail.saturating_mul(found.f_frsize))
}

/// Bytes that this user may still write below `folder`; this system is not asked.
#[cfg(not(unix))]
fn free_bytes(_: &Path) -> Option<u64> {
    None
}

/// Checks that `needed` bytes can still be written below `folder`.
///
/// # Errors
/// [`Error::Usage`] with both numbers.
pub(crate) fn check_room(folder: &Path, needed: u64) -> Result<()> {
    room(folder, free_bytes(folder), needed)
}

fn room(folder: &Path, free: Option<u64>, needed: u64) -> Result<()> {
    match free {
        Some(free) if free < needed => {
            let mib = |bytes: u64| bytes.div_ceil(1 << 20);
            let (place, needed, free) = (folder.display(), mib(needed), free >> 20);
            let problem = format!(
                "the disk of {place} is too full: {free} MiB are free, and the results need at least {needed} MiB"
            );
            Err(Error::usage(problem, "Make room, or choose a folder on another disk with --out."))
        }
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_that_files_cannot_have_are_refused() {
        for good in ["rgb_000000", "r 0.5", "Bäume:1", "...", &"a".repeat(200)] {
            assert_eq!(check_file_name(good), Ok(()));
        }
        let long = "a".repeat(300);
        for (bad, word) in [
            ("", "empty"),
            (long.as_str(), "300 bytes"),
            ("..", "stands for"),
            (".", "stands for"),
            ("a/b", "'/'"),
            ("a\\b", "'\\\\'"),
            ("a\0b", "'\\0'"),
            ("a\nb", "'\\n'"),
            ("a\u{1b}[2Jb", "'\\u{1b}'"),
        ] {
            let problem = check_file_name(bad).unwrap_err();
            assert!(problem.contains(word), "{bad:?}: {problem}");
        }
    }

    #[test]
    fn names_of_views_become_names_of_files_that_stay_in_their_folder() {
        let long = "ä".repeat(300);
        let names = [
            "../up", "/abs/a", "a", "A", "a\\b", "a/b", "..", ".", "", "a\0b", &long, "orbit", "_abs_a",
            "a_b",
        ];
        let stems = file_stems(&names, &["orbit"]);
        let expected = [
            ".._up",
            "_abs_a_2",
            "a",
            "A_2",
            "a_b_2",
            "a_b_3",
            "__",
            "_",
            "__2",
            "a_b_4",
            &"ä".repeat(100),
            "orbit_2",
            "_abs_a",
            "a_b",
        ];
        assert_eq!(stems, expected);
        for stem in &stems {
            check_file_name(stem).unwrap();
        }
        let apart: HashSet<String> = stems.iter().map(|stem| stem.to_lowercase()).collect();
        assert_eq!(apart.len(), names.len());
    }

    #[test]
    fn an_output_folder_is_tried_without_a_trace() {
        let folder = tempfile::tempdir().unwrap();
        check_writable(&folder.path().join("new/and/deep")).unwrap();
        check_writable(folder.path()).unwrap();
        check_writable(Path::new("new")).unwrap();
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
        let file = folder.path().join("file");
        fs::write(&file, "").unwrap();
        let error = check_writable(&file.join("out")).unwrap_err();
        assert!(error.to_string().contains("file is a file") && error.exit_code() == 2, "{error}");
        assert!(check_writable(&folder.path().join("a".repeat(300))).is_err());
        // Whoever runs the tests may write everywhere, perhaps: the system's answers are made up.
        let refused = |kind: ErrorKind| refused(&file, &kind.into()).to_string();
        assert!(refused(ErrorKind::PermissionDenied).contains("permission denied"));
        assert!(refused(ErrorKind::ReadOnlyFilesystem).contains("can only be read"));
        assert!(refused(ErrorKind::StorageFull).contains("full"));
        assert!(refused(ErrorKind::TimedOut).contains("timed out"));
    }

    #[cfg(unix)]
    #[test]
    fn an_output_folder_below_a_broken_link_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let link = folder.path().join("link");
        std::os::unix::fs::symlink("nowhere", &link).unwrap();
        let error = check_writable(&link.join("out")).unwrap_err();
        assert!(error.to_string().contains("symbolic link to nowhere"), "{error}");
    }

    #[test]
    fn a_full_disk_is_told_with_both_numbers() {
        let folder = tempfile::tempdir().unwrap();
        if cfg!(unix) {
            assert!(free_bytes(&folder.path().join("new")).unwrap() > 0);
        }
        check_room(folder.path(), 0).unwrap();
        assert!(check_room(folder.path(), u64::MAX).is_err() || cfg!(not(unix)));
        let error = room(folder.path(), Some(5 << 20), (7 << 20) + 1).unwrap_err();
        assert!(error.to_string().contains("5 MiB are free, and the results need at least 8 MiB"), "{error}");
        assert_eq!(error.exit_code(), 2);
        room(folder.path(), None, u64::MAX).unwrap();
    }
}
