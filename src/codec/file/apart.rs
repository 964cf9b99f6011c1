//! Whether a file that is to be written is one that is read: told by what paths lead to, not by how they are spelled.

use crate::{Error, Result};
use std::collections::HashMap;
use std::fs;
use std::path::{Path, PathBuf};

/// A file, and what reads or writes it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FileUse {
    /// The file, which need not exist.
    pub path: PathBuf,
    /// What it is to the reader ("the scene file"), or who writes it ("pass novel", "--out"), for a message.
    pub by: String,
}

impl FileUse {
    /// A use of `path`, described by `by`.
    pub fn new(path: impl Into<PathBuf>, by: impl Into<String>) -> Self {
        Self { path: path.into(), by: by.into() }
    }
}

/// What a path leads to: the same through links, `..` and names in another case, where the file system takes these for one.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) enum Identity {
    /// Device and inode.
    #[cfg(unix)]
    Inode(u64, u64),
    /// The canonical path.
    #[cfg(not(unix))]
    Canonical(PathBuf),
}

impl Identity {
    /// `None` if there is nothing at that path.
    #[cfg(unix)]
    pub fn of(path: &Path) -> Option<Self> {
        fs::metadata(path).ok().map(|found| Self::of_metadata(&found))
    }

    /// `None` if there is nothing at that path.
    #[cfg(not(unix))]
    pub fn of(path: &Path) -> Option<Self> {
        fs::canonicalize(path).ok().map(Self::Canonical)
    }

    /// That of a file that is open.
    #[cfg(unix)]
    pub fn of_metadata(found: &fs::Metadata) -> Self {
        use std::os::unix::fs::MetadataExt;
        Self::Inode(found.dev(), found.ino())
    }
}

/// Checks that no file that is to be written is one that is read.
///
/// # Errors
/// [`Error::Usage`] that names the first such file and both uses.
pub fn check_apart(inputs: &[FileUse], outputs: &[FileUse], help: &str) -> Result<()> {
    let read: HashMap<Identity, &FileUse> =
        inputs.iter().filter_map(|input| Some((Identity::of(&input.path)?, input))).collect();
    for output in outputs {
        if let Some(input) = Identity::of(&output.path).and_then(|id| read.get(&id)) {
            let problem = format!("{} would replace {}, {}", output.by, output.path.display(), input.by);
            return Err(Error::usage(problem, help));
        }
    }
    Ok(())
}

/// Checks that no file is to be written into a folder of which pictures are read: it would be one of them the next time.
///
/// # Errors
/// [`Error::Usage`] that names the first such file, and one of the pictures.
pub(crate) fn check_not_among(pictures: &[FileUse], outputs: &[FileUse], help: &str) -> Result<()> {
    // The parent of a mere name is empty: the working folder.
    let of = |path: &Path| path.parent().and_then(|folder| Identity::of(&folder.join(".")));
    let read: HashMap<Identity, &FileUse> =
        pictures.iter().filter_map(|picture| Some((of(&picture.path)?, picture))).collect();
    for output in outputs {
        if let Some(picture) = of(&output.path).and_then(|id| read.get(&id)) {
            let (by, file, among) = (&output.by, output.path.display(), picture.path.display());
            let problem = format!("{by} would write {file} beside {among}, {}", picture.by);
            return Err(Error::usage(problem, help));
        }
    }
    Ok(())
}

/// Whether `path` is `folder` or lies in it, whatever links lead there; `path` must exist, or it lies nowhere.
pub(crate) fn lies_in(path: &Path, folder: &Path) -> bool {
    match (path.canonicalize(), folder.canonicalize()) {
        (Ok(path), Ok(folder)) => path.starts_with(folder),
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn says(inputs: &[&Path], output: &Path) -> Option<String> {
        let inputs: Vec<FileUse> = inputs.iter().map(|path| FileUse::new(*path, "the photograph")).collect();
        let error = check_apart(&inputs, &[FileUse::new(output, "pass novel")], "Choose another.").err()?;
        assert_eq!((error.exit_code(), error.help()), (2, Some("Choose another.")));
        Some(error.to_string())
    }

    #[test]
    fn files_that_are_read_and_written_are_told_by_what_they_are() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        fs::create_dir(at("sub")).unwrap();
        fs::write(at("photo.png"), "x").unwrap();
        fs::write(at("other.png"), "x").unwrap();
        let clash = says(&[&at("photo.png")], &at("photo.png")).unwrap();
        assert!(
            clash.starts_with("pass novel would replace") && clash.ends_with("the photograph"),
            "{clash}"
        );
        assert!(says(&[&at("photo.png")], &at("sub/../photo.png")).is_some());
        assert!(says(&[&at("sub/../sub/./../photo.png")], &at("photo.png")).is_some());
        assert_eq!(says(&[&at("photo.png")], &at("other.png")), None);
        assert_eq!(says(&[&at("none.png"), &at("photo.png")], &at("none.png")), None);
        assert!(lies_in(&at("sub/../photo.png"), folder.path()) && lies_in(folder.path(), folder.path()));
        assert!(!lies_in(&at("photo.png"), &at("sub")) && !lies_in(&at("none"), folder.path()));
    }

    #[cfg(unix)]
    #[test]
    fn links_do_not_hide_that_a_file_is_read() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        fs::write(at("photo.png"), "x").unwrap();
        std::os::unix::fs::symlink(at("photo.png"), at("soft.png")).unwrap();
        std::os::unix::fs::symlink(folder.path(), at("loop")).unwrap();
        fs::hard_link(at("photo.png"), at("hard.png")).unwrap();
        for name in ["soft.png", "hard.png", "loop/photo.png", "loop/loop/soft.png"] {
            assert!(says(&[&at("photo.png")], &at(name)).is_some(), "{name}");
            assert!(says(&[&at(name)], &at("photo.png")).is_some(), "{name}");
        }
    }
}
