//! The folder that a data set is prepared in: nothing gets its final name before all of it is done, and what was done is not done
//! again.

use crate::codec::file::{FolderLock, write_bytes};
use crate::error::{Error, Result};
use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

/// Where work in progress lies, inside the output folder.
const WORK: &str = ".work";
/// Where the output of programs goes.
const LOGS: &str = "logs";

/// An output folder with work in progress.
pub(super) struct Work {
    out: PathBuf,
    /// The settings of all steps so far, each after the steps that it depends on.
    settings: String,
    /// Whether a step was done again, after which no later one holds.
    stale: bool,
    lock: FolderLock,
}

impl Work {
    /// Takes `out`, which is new, empty, or holds work in progress. `finished` are the names of what will lie in it.
    ///
    /// # Errors
    /// [`Error::Usage`] if there is anything else in it or another process works there, [`Error::Io`] if it cannot be written.
    pub fn claim(out: &Path, finished: &[&str]) -> Result<Self> {
        let names = match fs::read_dir(out) {
            Ok(entries) => entries
                .map(|entry| Ok(entry.map_err(Error::io("read", out))?.file_name()))
                .collect::<Result<Vec<_>>>()?,
            Err(error) if error.kind() == ErrorKind::NotFound => Vec::new(),
            Err(error) if error.kind() == ErrorKind::NotADirectory => {
                let problem = format!("the output folder {} is a file", out.display());
                return Err(Error::usage(problem, "Give a folder that is new or empty."));
            }
            Err(error) => return Err(Error::io("read", out)(error)),
        };
        let goes_on = names.iter().any(|name| name == WORK);
        let is_ours = |name: &std::ffi::OsStr| {
            name == WORK || name == LOGS || finished.iter().any(|known| name == *known)
        };
        if let Some(other) = names.iter().find(|name| !(goes_on && is_ours(name))) {
            let problem =
                format!("the output folder {} is not empty: it has {}", out.display(), other.display());
            let is_finished =
                finished.iter().all(|known| *known == "masks" || names.iter().any(|n| n == *known));
            let help = if is_finished {
                "It holds a data set that is finished; for other options, give another folder."
            } else {
                "Give a folder that is new or empty."
            };
            return Err(Error::usage(problem, help));
        }
        for folder in [out.join(WORK), out.join(LOGS)] {
            if folder.symlink_metadata().is_ok_and(|found| found.is_symlink()) {
                let problem =
                    format!("{} is a symbolic link: work would be done elsewhere", folder.display());
                return Err(Error::usage(problem, "Remove the link, or give another folder."));
            }
            fs::create_dir_all(&folder).map_err(Error::io("create folder", &folder))?;
        }
        let lock = FolderLock::take(&out.join(WORK))?;
        Ok(Self { out: out.to_owned(), settings: String::new(), stale: false, lock })
    }

    /// A path of work in progress.
    pub fn path(&self, name: &str) -> PathBuf {
        self.out.join(WORK).join(name)
    }

    /// The log of a step.
    pub fn log(&self, name: &str) -> PathBuf {
        self.out.join(LOGS).join(format!("{name}.log"))
    }

    /// Does a step, unless it was done with the same settings before, and so were all steps before it. Returns whether it was done now.
    ///
    /// # Errors
    /// Those of `step`; [`Error::Io`] if its completion cannot be recorded.
    pub fn step(
        &mut self,
        name: &str,
        settings: &str,
        step: impl FnOnce(&Self) -> Result<()>,
    ) -> Result<bool> {
        self.settings += &format!("{name}: {settings}\n");
        let stamp = self.path(&format!("{name}.done"));
        if !self.stale && fs::read_to_string(&stamp).is_ok_and(|done| done == self.settings) {
            return Ok(false);
        }
        self.stale = true;
        remove(&stamp)?;
        step(self)?;
        write_bytes(&stamp, self.settings.as_bytes())?;
        Ok(true)
    }

    /// An empty folder of work in progress, whatever an earlier run left there.
    pub fn emptied(&self, name: &str) -> Result<PathBuf> {
        let folder = self.path(name);
        remove(&folder)?;
        fs::create_dir_all(&folder).map_err(Error::io("create folder", &folder))?;
        Ok(folder)
    }

    /// Gives finished work its final name. What already has it, from an earlier run that was stopped, stays.
    ///
    /// # Errors
    /// [`Error::Io`] if it cannot be renamed.
    pub fn publish(&self, from: &Path, name: &str) -> Result<()> {
        let to = self.out.join(name);
        if !from.exists() && to.exists() {
            return Ok(());
        }
        if let Some(parent) = to.parent() {
            fs::create_dir_all(parent).map_err(Error::io("create folder", parent))?;
        }
        // An older result of work in progress, by other settings, is no longer one.
        remove(&to)?;
        fs::rename(from, &to).map_err(Error::io("create", &to))
    }

    /// Removes what the work needed.
    pub fn finish(self) -> Result<()> {
        let Self { out, lock, .. } = self;
        drop(lock);
        remove(&out.join(WORK))
    }
}

/// Removes a file or folder, if it exists.
fn remove(path: &Path) -> Result<()> {
    let removed = match path.symlink_metadata() {
        Ok(metadata) if metadata.is_dir() => fs::remove_dir_all(path),
        Ok(_) => fs::remove_file(path),
        Err(error) => Err(error),
    };
    match removed {
        Err(error) if error.kind() != ErrorKind::NotFound => Err(Error::io("remove", path)(error)),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn done_now(out: &Path, steps: &[(&str, &str)]) -> Vec<bool> {
        let mut work = Work::claim(out, &["images"]).unwrap();
        steps.iter().map(|(name, settings)| work.step(name, settings, |_| Ok(())).unwrap()).collect()
    }

    #[test]
    fn steps_are_done_once_until_their_settings_change() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("new/out");
        let steps = [("a", "1"), ("b", "1"), ("c", "1")];
        assert_eq!(done_now(&out, &steps), [true, true, true]);
        assert_eq!(done_now(&out, &steps), [false, false, false]);
        assert_eq!(done_now(&out, &[("a", "1"), ("b", "2"), ("c", "1")]), [false, true, true]);
        assert_eq!(done_now(&out, &steps), [false, true, true]);
    }

    #[test]
    fn a_step_that_fails_is_done_again() {
        let folder = tempfile::tempdir().unwrap();
        let mut work = Work::claim(folder.path(), &[]).unwrap();
        work.step("a", "", |_| Ok(())).unwrap();
        let failed = work.step("b", "", |work| {
            fs::write(work.emptied("models").unwrap().join("half"), "x").unwrap();
            Err(Error::Interrupted)
        });
        assert!(matches!(failed, Err(Error::Interrupted)));
        let busy = Work::claim(folder.path(), &[]).err().unwrap();
        assert!(busy.to_string().contains("another run"), "{busy}");
        drop(work);
        let mut work = Work::claim(folder.path(), &[]).unwrap();
        assert!(!work.step("a", "", |_| Ok(())).unwrap());
        let again = work.step("b", "", |work| {
            assert!(fs::read_dir(work.emptied("models").unwrap()).unwrap().next().is_none());
            Ok(())
        });
        assert!(again.unwrap());
    }

    #[test]
    fn a_folder_with_other_files_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path();
        fs::create_dir(out.join("images")).unwrap();
        let error = Work::claim(out, &["images"]).err().unwrap();
        assert!(
            error.to_string().contains("is not empty: it has images") && error.exit_code() == 2,
            "{error}"
        );
        assert!(!out.join(WORK).exists());
        // Work in progress may have published part of its results, and nothing else.
        fs::create_dir(out.join(WORK)).unwrap();
        assert!(Work::claim(out, &["images"]).is_ok());
        fs::write(out.join("thesis.txt"), "x").unwrap();
        let error = Work::claim(out, &["images"]).err().unwrap();
        assert!(error.to_string().contains("thesis.txt"), "{error}");
        let error = Work::claim(&out.join("thesis.txt"), &[]).err().unwrap();
        assert!(error.to_string().contains("is a file"), "{error}");
    }

    #[cfg(unix)]
    #[test]
    fn work_is_not_done_where_a_link_leads() {
        let folder = tempfile::tempdir().unwrap();
        let (out, data) = (folder.path().join("out"), folder.path().join("data"));
        fs::create_dir_all(data.join("photographs")).unwrap();
        fs::create_dir(&out).unwrap();
        std::os::unix::fs::symlink(&data, out.join(WORK)).unwrap();
        let error = Work::claim(&out, &["images"]).err().unwrap();
        assert!(error.to_string().contains("is a symbolic link") && error.exit_code() == 2, "{error}");
        assert_eq!(fs::read_dir(&data).unwrap().count(), 1);
    }

    #[test]
    fn results_get_their_names_at_the_end() {
        let folder = tempfile::tempdir().unwrap();
        let work = Work::claim(folder.path(), &["images", "sparse"]).unwrap();
        let made = work.emptied("made").unwrap();
        fs::write(made.join("a"), "x").unwrap();
        work.publish(&made, "sparse/0").unwrap();
        // The second time, after a stop, it is there already.
        work.publish(&made, "sparse/0").unwrap();
        assert!(work.publish(&folder.path().join("nothing"), "images").is_err());
        work.finish().unwrap();
        assert!(folder.path().join("sparse/0/a").is_file() && !folder.path().join(WORK).exists());
    }
}
