//! A folder that one process at a time writes into.

use crate::codec::file::apart::Identity;
use crate::codec::file::write::create_folders;
use crate::{Error, Result};
use std::fs::{self, File, TryLockError};
use std::path::{Path, PathBuf};

/// The file whose lock stands for the folder.
pub(crate) const LOCK: &str = ".lobelia.lock";

/// The right to write into a folder. The system takes the lock back when the process ends, however it ends: a file that is left is none.
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
                // Whoever had the lock may have removed the file in between: then it stands for nothing.
                Ok(()) if is_gone(&file, &path) => continue,
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
        match file.try_lock_shared() {
            Err(TryLockError::WouldBlock) => Err(busy(folder)),
            _ => Ok(()),
        }
    }
}

impl Drop for FolderLock {
    fn drop(&mut self) {
        // What cannot be removed does no harm. Folders that were made go only if nothing was put into them.
        let _ = fs::remove_file(&self.path);
        let _ = self.file.unlock();
        for folder in &self.made {
            if fs::remove_dir(folder).is_err() {
                break;
            }
        }
    }
}

/// Checks that a lock which is there is a plain file: a link would lead elsewhere, and a pipe would never open.
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
fn is_gone(file: &File, path: &Path) -> bool {
    let held = file.metadata().ok().map(|found| Identity::of_metadata(&found));
    held != Identity::of(path)
}

#[cfg(not(unix))]
fn is_gone(_: &File, path: &Path) -> bool {
    Identity::of(path).is_none()
}

#[cfg(test)]
mod tests {
    use super::*;

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
    }

    #[test]
    fn a_file_that_a_killed_process_left_is_no_lock() {
        let root = tempfile::tempdir().unwrap();
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
