//! The files that a run reads, watched: one that changes or goes while the run is at work is told of, instead of results that are half of one
//! and half of the other.

use crate::error::{Error, Result};
use std::fs;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

/// Size and time of change of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Stamp {
    bytes: u64,
    /// `None` where the system does not say.
    changed: Option<SystemTime>,
}

impl Stamp {
    fn of(path: &Path) -> Option<Self> {
        let found = fs::metadata(path).ok()?;
        Some(Self { bytes: found.len(), changed: found.modified().ok() })
    }
}

/// Files as they were when the run began.
#[derive(Clone, Debug, Default)]
pub(super) struct Watched(Vec<(PathBuf, Option<Stamp>)>);

impl Watched {
    /// Watches these files from now on.
    pub fn new(files: Vec<PathBuf>) -> Self {
        Self(
            files
                .into_iter()
                .map(|path| (Stamp::of(&path), path))
                .map(|(stamp, path)| (path, stamp))
                .collect(),
        )
    }

    /// Checks that no file has changed.
    ///
    /// # Errors
    /// [`Error::Input`] that names the first that has.
    pub fn check(&self) -> Result<()> {
        self.check_those(|_| true)
    }

    /// Checks those that are one of `places`, or in a folder that is.
    ///
    /// # Errors
    /// Those of [`Self::check`].
    pub fn check_below(&self, places: &[PathBuf]) -> Result<()> {
        self.check_those(|path| places.iter().any(|place| path.starts_with(place)))
    }

    fn check_those(&self, counts: impl Fn(&Path) -> bool) -> Result<()> {
        for (path, before) in self.0.iter().filter(|(path, _)| counts(path)) {
            let problem = match (before, Stamp::of(path)) {
                (before, now) if *before == now => continue,
                (_, None) => "the file has gone since the run began",
                _ => "the file has changed since the run began",
            };
            let help = "Put it back as it was and go on with --resume, or start again with --force.";
            return Err(Error::input(path, "", problem, help));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_that_changes_or_goes_is_told_of() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        fs::create_dir(at("truth")).unwrap();
        for name in ["photo.png", "truth/a.png"] {
            fs::write(at(name), "old").unwrap();
        }
        let watched = Watched::new(vec![at("photo.png"), at("truth/a.png")]);
        watched.check().unwrap();
        fs::write(at("truth/a.png"), "newer").unwrap();
        let error = watched.check().unwrap_err();
        assert!(
            error.to_string().contains("a.png: the file has changed") && error.exit_code() == 2,
            "{error}"
        );
        watched.check_below(&[at("photo.png")]).unwrap();
        assert!(watched.check_below(&[at("truth")]).is_err());
        fs::remove_file(at("photo.png")).unwrap();
        assert!(watched.check().unwrap_err().to_string().contains("photo.png: the file has gone"));
    }
}
