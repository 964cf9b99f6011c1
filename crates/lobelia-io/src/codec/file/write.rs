//! Writing whole files: a temporary file in the same folder, which is renamed when it is complete
//! and on the disk. The names of unfinished files and folders say that they are this program's and
//! count for nothing.

use crate::codec::file::DiskFile;
use lobelia_geometry::{Error, Result};
use std::io::ErrorKind::{NotADirectory, NotFound};
use std::io::{BufWriter, Write as _};
use std::{collections::HashSet, ffi::OsStr, fmt::Display, fs, fs::File, path::Path, path::PathBuf};
use tempfile::TempDir;

/// Writes `path` through `write`: the bytes go to a hidden temporary file in the same folder
/// (created if missing), which gets the final name only when `write` has succeeded and the bytes
/// are on the disk. An existing file of that name is replaced; on failure it stays as it was and
/// the temporary file is removed.
///
/// # Errors
/// The errors of `write`, or [`Error::Io`] for other errors of the operating system.
pub fn write_file(path: &Path, write: impl FnOnce(&mut BufWriter<DiskFile>) -> Result<()>) -> Result<()> {
    let folder = folder_of(path);
    create_folders(folder)?;
    let mut builder = tempfile::Builder::new();
    builder.prefix(PREFIX).suffix(".part");
    // A temporary file is private to its owner by default; a result has the usual permissions (0666
    // less umask).
    #[cfg(unix)]
    let builder = builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    let made = builder.tempfile_in(folder).map_err(Error::io("create a file in", folder))?;
    let (file, temporary) = made.into_parts();
    let mut writer = BufWriter::new(DiskFile { file, path: path.to_owned() });
    write(&mut writer)?;
    let file = writer.into_inner().map_err(|failed| Error::io("write", path)(failed.into_error()))?;
    // After a power cut there is the old file or the new one, never an empty one.
    let counts = !is_scratch(path);
    if counts {
        file.sync_all().map_err(Error::io("write", path))?;
    }
    temporary.persist(path).map_err(|refused| Error::io("write", path)(refused.error))?;
    if counts { sync_folder(folder) } else { Ok(()) }
}

/// `write_file` for bytes that are already in memory.
pub fn write_bytes(path: &Path, bytes: &[u8]) -> Result<()> {
    write_file(path, |writer| writer.write_all(bytes).map_err(Error::io("write", path)))
}

/// Checks that all `values` are finite before they are written to `path`; `what` names the value
/// with a number, counted from 0.
///
/// # Errors
/// [`Error::Run`] that names the first value that is NaN or infinite.
pub fn check_finite(
    path: &Path,
    values: impl IntoIterator<Item = f32>,
    what: impl FnOnce(usize) -> String,
) -> Result<()> {
    let Some(at) = values.into_iter().position(|value| !value.is_finite()) else { return Ok(()) };
    Err(not_written(path, format!("{}, so nothing is written", what(at))))
}

/// The error for what cannot be written to `path`.
pub(crate) fn not_written(path: &Path, problem: impl Display) -> Error {
    Error::run(format!("writing {}", path.display()), problem.to_string())
}

/// Creates `folder` and those around it that are missing, with their names on the disk; returns
/// them, from the innermost.
///
/// # Errors
/// [`Error::Io`].
pub(crate) fn create_folders(folder: &Path) -> Result<Vec<PathBuf>> {
    let is_new = |place: &&Path| !place.as_os_str().is_empty() && !place.exists();
    let made: Vec<PathBuf> = folder.ancestors().take_while(is_new).map(Path::to_owned).collect();
    fs::create_dir_all(folder).map_err(Error::io("create folder", folder))?;
    made.iter().filter(|made| !is_scratch(made)).try_for_each(|made| sync_folder(folder_of(made)))?;
    Ok(made)
}

/// The folder that a path is in: of a mere name the working folder.
pub(crate) fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// Puts the names in a folder on the disk.
#[cfg(unix)]
fn sync_folder(folder: &Path) -> Result<()> {
    match File::open(folder).and_then(|opened| opened.sync_all()) {
        // EIO and ENOSPC.
        Err(error) if matches!(error.raw_os_error(), Some(5 | 28)) => Err(Error::io("write", folder)(error)),
        // Some file systems have no such thing, and some folders may be written but not read.
        _ => Ok(()),
    }
}

/// This system writes the names in a folder by itself.
#[cfg(not(unix))]
fn sync_folder(_: &Path) -> Result<()> {
    Ok(())
}

/// How the names of unfinished files and folders begin.
const PREFIX: &str = ".lobelia-";

/// A folder in `folder` (created if missing) for what is needed for a while; it goes when this is
/// dropped.
///
/// # Errors
/// [`Error::Io`] if it cannot be created.
pub fn scratch_folder(folder: &Path) -> Result<TempDir> {
    fs::create_dir_all(folder).map_err(Error::io("create folder", folder))?;
    let made = tempfile::Builder::new().prefix(PREFIX).tempdir_in(folder);
    made.map_err(Error::io("create a folder in", folder))
}

/// True for the names of unfinished files and folders.
pub fn is_unfinished(name: &OsStr) -> bool {
    name.as_encoded_bytes().starts_with(PREFIX.as_bytes())
}

/// True for a file in a scratch folder, or in one below.
fn is_scratch(file: &Path) -> bool {
    file.ancestors().skip(1).any(|folder| folder.file_name().is_some_and(is_unfinished))
}

/// Removes what a killed process left unfinished in `folder` itself. Nobody else may be writing
/// there.
///
/// # Errors
/// [`Error::Io`] if something cannot be removed.
pub fn clear_scratch(folder: &Path) -> Result<()> {
    let entries = match fs::read_dir(folder) {
        Err(error) if matches!(error.kind(), NotFound | NotADirectory) => return Ok(()),
        entries => entries.map_err(Error::io("read", folder))?,
    };
    for entry in entries {
        let entry = entry.map_err(Error::io("read", folder))?;
        let path = entry.path();
        if is_unfinished(&entry.file_name()) {
            let is_folder = entry.file_type().map_err(Error::io("read", &path))?.is_dir();
            let removed = if is_folder { fs::remove_dir_all(&path) } else { fs::remove_file(&path) };
            removed.map_err(Error::io("remove", &path))?;
        }
    }
    Ok(())
}

/// Most bytes of a view's name: its files get a prefix and an extension, and file systems stop at
/// 255 bytes.
const MOST_NAME_BYTES: usize = 200;

/// Checks that `name` can be the stem of a file.
///
/// # Errors
/// The problem, as a clause that follows the name.
pub fn check_file_name(name: &str) -> Result<(), String> {
    if name.is_empty() {
        return Err("is empty".to_owned());
    }
    if name.len() > MOST_NAME_BYTES {
        return Err(format!("has {} bytes; a file name has room for {MOST_NAME_BYTES}", name.len()));
    }
    if matches!(name, "." | "..") {
        return Err("stands for a folder".to_owned());
    }
    let bad = name.chars().find(|&c| matches!(c, '/' | '\\') || c.is_control());
    bad.map_or(Ok(()), |c| Err(format!("holds {c:?}, which a file name must not")))
}

/// The stems of the files of things with these names, in the order of the names, apart from each
/// other and from those that are `taken` even where case does not count. A name that can be a stem
/// is one; what a file's name must not hold becomes `_`, and what is no longer alone gets a number.
/// No stem leads out of the folder that it is put into.
pub fn file_stems(names: &[&str], taken: &[&str]) -> Vec<String> {
    let mut used: HashSet<String> = taken.iter().map(|stem| stem.to_lowercase()).collect();
    let mut stems = vec![String::new(); names.len()];
    // Names that can stay as they are come first: another one must not take their place.
    for is_kept in [true, false] {
        for (name, place) in names.iter().zip(&mut stems) {
            if check_file_name(name).is_ok() == is_kept {
                let stem = if is_kept { (*name).to_owned() } else { file_stem(name) };
                let numbered = (2u64..).map(|number| format!("{stem}_{number}"));
                let mut candidates = std::iter::once(stem.clone()).chain(numbered);
                let alone = candidates.find(|candidate| used.insert(candidate.to_lowercase()));
                *place = alone.unwrap_or_default();
            }
        }
    }
    stems
}

/// The stem for a name that a file cannot have.
fn file_stem(name: &str) -> String {
    let allowed = |c: char| if matches!(c, '/' | '\\') || c.is_control() { '_' } else { c };
    let mut stem: String = name.chars().map(allowed).collect();
    while stem.len() > MOST_NAME_BYTES {
        stem.pop();
    }
    if matches!(stem.as_str(), "" | "." | "..") { "_".repeat(stem.len().max(1)) } else { stem }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::codec::test_data::temporary;

    fn names_in(folder: &Path) -> Vec<String> {
        let mut names: Vec<String> = fs::read_dir(folder)
            .unwrap()
            .map(|entry| entry.unwrap().file_name().to_string_lossy().into_owned())
            .collect();
        names.sort();
        names
    }

    #[test]
    fn success_leaves_only_the_final_file_and_failure_the_old_one() {
        let (_folder, path) = temporary("new/out.txt");
        write_bytes(&path, b"one").unwrap();
        write_bytes(&path, b"two").unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"two");
        let refused = write_file(&path, |writer| {
            writer.write_all(b"half of the new").map_err(Error::io("write", &path))?;
            Err(Error::run("test", "stopped"))
        });
        assert!(refused.is_err());
        assert_eq!(fs::read(&path).unwrap(), b"two");
        assert_eq!(names_in(path.parent().unwrap()), ["out.txt"]);
        let below = write_bytes(&path.join("below"), b"y").unwrap_err();
        assert!(matches!(below, Error::Io { .. }), "{below}");
    }

    #[cfg(unix)]
    #[test]
    fn the_result_is_not_more_private_than_a_plain_file() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().unwrap();
        let (ours, plain) = (folder.path().join("ours"), folder.path().join("plain"));
        write_bytes(&ours, b"x").unwrap();
        fs::write(&plain, b"x").unwrap();
        let mode = |path: &Path| fs::metadata(path).unwrap().permissions().mode();
        assert_eq!(mode(&ours), mode(&plain));
    }

    #[test]
    fn what_was_left_unfinished_goes_and_the_rest_stays() {
        let root = tempfile::tempdir().unwrap();
        let at = |name: &str| root.path().join(name);
        clear_scratch(&at("none")).unwrap();
        for name in [".lobelia-abc.part.png", "mine.txt", ".hidden"] {
            fs::write(at(name), "x").unwrap();
        }
        let folder = scratch_folder(root.path()).unwrap().keep();
        fs::write(folder.join("000.png"), "x").unwrap();
        assert!(is_scratch(&folder.join("000.png")) && !is_scratch(&at("mine.txt")));
        clear_scratch(root.path()).unwrap();
        assert_eq!(names_in(root.path()), [".hidden", "mine.txt"]);
    }

    #[test]
    fn names_that_files_cannot_have_are_refused_and_made_into_others() {
        for good in ["rgb_000000", "r 0.5", "Bäume:1", "...", &"a".repeat(200)] {
            assert_eq!(check_file_name(good), Ok(()));
        }
        let long = "ä".repeat(150);
        for (bad, word) in [
            ("", "empty"),
            (long.as_str(), "300 bytes"),
            ("..", "stands for"),
            ("a/b", "'/'"),
            ("a\\b", "'\\\\'"),
            ("a\0b", "'\\0'"),
            ("a\u{1b}[2Jb", "'\\u{1b}'"),
        ] {
            let problem = check_file_name(bad).unwrap_err();
            assert!(problem.contains(word), "{bad:?}: {problem}");
        }
        let names = ["../up", "/abs/a", "a", "A", "a/b", "..", "", "a\0b", &long, "orbit", "_abs_a", "a_b"];
        let half = "ä".repeat(100);
        let expected =
            [".._up", "_abs_a_2", "a", "A_2", "a_b_2", "__", "_", "a_b_3", &half, "orbit_2", "_abs_a", "a_b"];
        let stems = file_stems(&names, &["orbit"]);
        assert_eq!(stems, expected);
        assert!(stems.iter().all(|stem| check_file_name(stem).is_ok()));
    }
}
