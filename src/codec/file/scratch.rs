//! Unfinished files and folders: their names say that they are this program's and count for nothing.

use crate::{Error, Result};
use std::ffi::OsStr;
use std::fs;
use std::io::ErrorKind;
use std::path::Path;
use tempfile::TempDir;

/// How the names of unfinished files and folders begin.
pub(super) const PREFIX: &str = ".lobelia-";

/// A folder in `folder` (created if missing) for what is needed for a while; it goes when this is dropped.
///
/// # Errors
/// [`Error::Io`] if it cannot be created.
pub(crate) fn scratch_folder(folder: &Path) -> Result<TempDir> {
    fs::create_dir_all(folder).map_err(Error::io("create folder", folder))?;
    let made = tempfile::Builder::new().prefix(PREFIX).tempdir_in(folder);
    made.map_err(Error::io("create a folder in", folder))
}

/// Whether this is the name of something unfinished.
pub(crate) fn is_unfinished(name: &OsStr) -> bool {
    name.as_encoded_bytes().starts_with(PREFIX.as_bytes())
}

/// Whether a file is in a scratch folder, or in one below.
pub(super) fn is_scratch(file: &Path) -> bool {
    file.ancestors().skip(1).any(|folder| folder.file_name().is_some_and(is_unfinished))
}

/// Removes what a killed process left unfinished in `folder` itself. Nobody else may be writing there.
///
/// # Errors
/// [`Error::Io`] if something cannot be removed.
pub(crate) fn clear_scratch(folder: &Path) -> Result<()> {
    let entries = match fs::read_dir(folder) {
        Ok(entries) => entries,
        Err(error) if matches!(error.kind(), ErrorKind::NotFound | ErrorKind::NotADirectory) => {
            return Ok(());
        }
        Err(error) => return Err(Error::io("read", folder)(error)),
    };
    for entry in entries {
        let entry = entry.map_err(Error::io("read", folder))?;
        if !is_unfinished(&entry.file_name()) {
            continue;
        }
        let path = entry.path();
        let is_folder = entry.file_type().map_err(Error::io("read", &path))?.is_dir();
        let removed = if is_folder { fs::remove_dir_all(&path) } else { fs::remove_file(&path) };
        removed.map_err(Error::io("remove", &path))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

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
        let mut left: Vec<_> =
            fs::read_dir(root.path()).unwrap().map(|entry| entry.unwrap().file_name()).collect();
        left.sort();
        assert_eq!(left, [".hidden", "mine.txt"]);
    }
}
