//! Camera files that other programs export under any name.

use crate::codec::file;
use crate::error::{Error, Result};
use std::io::Read;
use std::path::{Path, PathBuf};

/// Bytes at the start of a file that say what it is.
const HEAD_BYTES: u64 = 4096;

/// A kind of camera file.
pub(super) struct Export {
    /// The extension of its name.
    pub extension: &'static str,
    /// What identifies it, for errors.
    pub mark: &'static str,
    /// Whether a file that starts with this text is of this kind.
    pub is_head: fn(&str) -> bool,
    /// How to export it.
    pub help: &'static str,
}

impl Export {
    /// The files of this kind in `dir`, by name.
    pub fn files(&self, dir: &Path) -> Vec<PathBuf> {
        let is_head =
            |head: &[u8]| (self.is_head)(String::from_utf8_lossy(head).trim_start_matches('\u{feff}'));
        self.heads(dir).into_iter().filter(|(_, head)| is_head(head)).map(|(file, _)| file).collect()
    }

    /// The files in `dir` with the extension of this kind, by name, and how each begins.
    pub fn heads(&self, dir: &Path) -> Vec<(PathBuf, Vec<u8>)> {
        let entries = std::fs::read_dir(dir).into_iter().flatten().flatten().map(|entry| entry.path());
        let is_kind =
            |path: &PathBuf| path.extension().is_some_and(|kind| kind.eq_ignore_ascii_case(self.extension));
        let mut files: Vec<PathBuf> = entries.filter(is_kind).collect();
        files.sort();
        files.into_iter().filter_map(|file| head(&file).map(|head| (file, head))).collect()
    }

    /// The only file of this kind in `dir`.
    ///
    /// # Errors
    /// [`Error::Input`] if there is none, or more than one.
    pub fn only(&self, dir: &Path) -> Result<PathBuf> {
        let mut files = self.files(dir);
        if files.len() > 1 {
            let names: Vec<String> = files.iter().map(|file| file.display().to_string()).collect();
            let problem = format!("several files have cameras: {}", names.join(", "));
            return Err(Error::input(dir, "", problem, "Keep the one that is to be read."));
        }
        files.pop().ok_or_else(|| Error::input(dir, "", format!("there is no {}", self.mark), self.help))
    }
}

/// How a file begins, if it can be read.
fn head(path: &Path) -> Option<Vec<u8>> {
    let reader = file::open(path, |_| String::new()).ok()?;
    let mut head = Vec::new();
    reader.take(HEAD_BYTES).read_to_end(&mut head).ok().map(|_| head)
}
