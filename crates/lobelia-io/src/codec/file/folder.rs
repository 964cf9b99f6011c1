//! What is asked before anything is written into a folder: whether a file that is to be written is
//! one that is read, told by what paths lead to and not by how they are spelled; whether files can
//! be made there; and whether another process writes there.

use crate::codec::file::write::{create_folders, folder_of};
use lobelia_geometry::{Error, Result};
use std::fs::{self, File, TryLockError};
use std::{collections::HashMap, path::Path, path::PathBuf};

/// A file, and what reads or writes it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FileUse {
    /// The file, which need not exist.
    pub path: PathBuf,
    /// Its role for the reader ("the scene file"), or its writer ("pass novel", "--out"), for a
    /// message.
    pub by: String,
}

impl FileUse {
    /// A use of `path`, described by `by`.
    pub fn new(path: impl Into<PathBuf>, by: impl Into<String>) -> Self {
        Self { path: path.into(), by: by.into() }
    }
}

/// Checks that no file that is to be written is one that is read.
///
/// # Errors
/// [`Error::Usage`] that names the first such file and both uses.
pub fn check_apart(inputs: &[FileUse], outputs: &[FileUse], help: &str) -> Result<()> {
    clash(inputs, outputs, help, Path::to_owned, |output, input| {
        format!("{} would replace {}, {}", output.by, output.path.display(), input.by)
    })
}

/// Checks that no file is to be written into a folder of which pictures are read: it would be one
/// of them the next time.
///
/// # Errors
/// [`Error::Usage`] that names the first such file, and one of the pictures.
pub fn check_not_among(pictures: &[FileUse], outputs: &[FileUse], help: &str) -> Result<()> {
    clash(
        pictures,
        outputs,
        help,
        |path| folder_of(path).join("."),
        |output, picture| {
            let (file, among) = (output.path.display(), picture.path.display());
            format!("{} would write {file} beside {among}, {}", output.by, picture.by)
        },
    )
}

/// Refuses the first output of which `of` gives a path that leads to what it gives of an input, if
/// that exists.
fn clash(
    inputs: &[FileUse],
    outputs: &[FileUse],
    help: &str,
    of: impl Fn(&Path) -> PathBuf,
    problem: impl Fn(&FileUse, &FileUse) -> String,
) -> Result<()> {
    let led = |file: &FileUse| of(&file.path).canonicalize().ok();
    let read: HashMap<_, _> = inputs.iter().filter_map(|input| Some((led(input)?, input))).collect();
    let found = |output: &FileUse| Some(problem(output, read.get(&led(output)?)?));
    outputs.iter().find_map(found).map_or(Ok(()), |problem| Err(Error::usage(problem, help)))
}

/// True if `path` exists and is `folder` or lies in it, whatever links lead there.
pub fn lies_in(path: &Path, folder: &Path) -> bool {
    path.canonicalize().is_ok_and(|path| folder.canonicalize().is_ok_and(|folder| path.starts_with(folder)))
}

/// Checks that files can be made in `folder`, which need not exist yet: a file without a name is
/// made in the nearest folder that exists, and is gone at once.
///
/// # Errors
/// [`Error::Usage`] if a part of the path is a file, or the folder may not be written into.
pub fn check_writable(folder: &Path) -> Result<()> {
    let mut places = folder.ancestors().filter(|place| !place.as_os_str().is_empty());
    let existing = places.find(|place| place.symlink_metadata().is_ok()).unwrap_or(Path::new("."));
    tempfile::tempfile_in(existing).map(|_| ()).map_err(|error| {
        let problem = if existing.is_file() {
            format!("{} cannot be made: {} is a file", folder.display(), existing.display())
        } else {
            format!("nothing can be written into {}: {error}", existing.display())
        };
        Error::usage(problem, "Choose another folder with --out, or allow writing there: `chmod u+wx`.")
    })
}

/// The file whose lock stands for the folder.
pub const LOCK: &str = ".lobelia.lock";

/// The right to write into a folder. The system takes the lock back when the process ends, however
/// it ends: a file that is left is none.
#[derive(Debug)]
pub struct FolderLock {
    file: File,
    path: PathBuf,
    /// Folders that did not exist, from the innermost.
    made: Vec<PathBuf>,
}

impl FolderLock {
    /// Locks `folder`, which is made if it does not exist.
    ///
    /// # Errors
    /// [`Error::Usage`] if another process has it; [`Error::Io`] if nothing can be written there.
    pub fn take(folder: &Path) -> Result<Self> {
        let made = create_folders(folder)?;
        let path = folder.join(LOCK);
        check_ours(&path)?;
        loop {
            let mut options = File::options();
            let file = options.create(true).truncate(false).read(true).write(true).open(&path);
            let file = file.map_err(Error::io("lock", folder))?;
            match file.try_lock() {
                Err(TryLockError::WouldBlock) => return Err(busy(folder)),
                // A file system without locks is no reason not to work.
                Err(TryLockError::Error(_)) => {}
                // Whoever had the lock may have removed the file in between: then it stands for
                // nothing.
                Ok(()) if is_gone(&file) => continue,
                Ok(()) => {}
            }
            return Ok(Self { file, path, made });
        }
    }

    /// Checks that no other process has `folder`, without a trace.
    ///
    /// # Errors
    /// [`Error::Usage`] if one has.
    pub fn check_free(folder: &Path) -> Result<()> {
        check_ours(&folder.join(LOCK))?;
        let Ok(file) = File::open(folder.join(LOCK)) else { return Ok(()) };
        let is_taken = matches!(file.try_lock_shared(), Err(TryLockError::WouldBlock));
        if is_taken { Err(busy(folder)) } else { Ok(()) }
    }
}

impl Drop for FolderLock {
    fn drop(&mut self) {
        // What cannot be removed does no harm. Folders that were made go only if nothing was put
        // into them.
        let _ = fs::remove_file(&self.path);
        let _ = self.file.unlock();
        let _ = self.made.iter().try_for_each(fs::remove_dir);
    }
}

/// Checks that a lock which is there is a plain file: a link would lead elsewhere, and a pipe would
/// never open.
fn check_ours(path: &Path) -> Result<()> {
    if path.symlink_metadata().is_ok_and(|found| !found.is_file()) {
        let problem = format!("{} is in the way: it is not a plain file", path.display());
        return Err(Error::usage(problem, "Remove it, or choose another folder with --out."));
    }
    Ok(())
}

fn busy(folder: &Path) -> Error {
    let problem = format!("another run writes into {}", folder.display());
    Error::usage(problem, "Wait until it has ended, or choose another folder with --out.")
}

#[cfg(unix)]
fn is_gone(file: &File) -> bool {
    use std::os::unix::fs::MetadataExt;
    file.metadata().is_ok_and(|found| found.nlink() == 0)
}

/// Here nobody removes a file that is open.
#[cfg(not(unix))]
fn is_gone(_: &File) -> bool {
    false
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
        assert!(clash.starts_with("pass novel would replace"), "{clash}");
        assert!(clash.ends_with("the photograph"), "{clash}");
        #[cfg_attr(not(unix), allow(unused_mut))]
        let mut others = vec!["sub/../photo.png", "sub/../sub/./../photo.png"];
        #[cfg(unix)]
        {
            std::os::unix::fs::symlink(at("photo.png"), at("soft.png")).unwrap();
            std::os::unix::fs::symlink(folder.path(), at("loop")).unwrap();
            others.extend(["soft.png", "loop/photo.png", "loop/loop/soft.png"]);
        }
        for name in others {
            assert!(says(&[&at("photo.png")], &at(name)).is_some(), "{name}");
            assert!(says(&[&at(name)], &at("photo.png")).is_some(), "{name}");
        }
        assert_eq!(says(&[&at("photo.png")], &at("other.png")), None);
        assert_eq!(says(&[&at("none.png"), &at("photo.png")], &at("none.png")), None);
        assert!(lies_in(&at("sub/../photo.png"), folder.path()) && lies_in(folder.path(), folder.path()));
        assert!(!lies_in(&at("photo.png"), &at("sub")) && !lies_in(&at("none"), folder.path()));
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
    }

    #[test]
    fn a_folder_is_locked_once_and_nothing_stays() {
        let root = tempfile::tempdir().unwrap();
        let folder = root.path().join("new/out");
        FolderLock::check_free(&folder).unwrap();
        let lock = FolderLock::take(&folder).unwrap();
        for refused in [FolderLock::take(&folder).map(|_| ()), FolderLock::check_free(&folder)] {
            let error = refused.unwrap_err();
            assert!(error.to_string().contains("another run") && error.exit_code() == 2, "{error}");
        }
        drop(lock);
        assert!(!root.path().join("new").exists(), "folders that were made for the lock are gone");
        // A file that a killed process left is no lock.
        fs::write(root.path().join(LOCK), "").unwrap();
        FolderLock::check_free(root.path()).unwrap();
        let lock = FolderLock::take(root.path()).unwrap();
        fs::write(root.path().join("result"), "x").unwrap();
        drop(lock);
        assert!(root.path().join("result").exists() && !root.path().join(LOCK).exists());
    }

    #[cfg(unix)]
    #[test]
    fn a_lock_that_is_a_link_or_a_pipe_is_refused() {
        let root = tempfile::tempdir().unwrap();
        let (lock, elsewhere) = (root.path().join(LOCK), root.path().join("elsewhere"));
        let refused = || {
            for refused in [FolderLock::take(root.path()).map(|_| ()), FolderLock::check_free(root.path())] {
                assert!(refused.unwrap_err().to_string().contains("is not a plain file"));
            }
        };
        std::os::unix::fs::symlink(&elsewhere, &lock).unwrap();
        refused();
        assert!(!elsewhere.exists());
        fs::remove_file(&lock).unwrap();
        assert!(std::process::Command::new("mkfifo").arg(&lock).status().unwrap().success());
        refused();
    }
}
