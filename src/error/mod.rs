//! The one error type of the crate.
//!
//! An error is made where the cause is known, carried upwards unchanged with `?`, and reported once, at the
//! edge (the command), which also chooses the exit code: 2 for [`Error::Input`], [`Error::Scene`] and
//! [`Error::Usage`], 130 for [`Error::Interrupted`], 1 for the rest.

mod scene;

pub use scene::{Fault, Label, SceneDiagnostic};

use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Result of everything in this crate that can fail.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// What went wrong, where, and what a person can do about it.
#[derive(Clone, Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A file that was given is not usable: names the file, the place in it, the problem and the mend.
    #[error("{}{}: {problem}", path.display(), place_suffix(place))]
    Input {
        /// The offending file or folder.
        path: PathBuf,
        /// Where in the file ("frame 3", "node 2", "pixel (4, 7)"); may be empty.
        place: String,
        /// What is wrong.
        problem: String,
        /// What to do about it; may be empty.
        help: String,
    },
    /// A scene file is wrong: where in its text, what was expected there, and help.
    #[error("{0}")]
    Scene(Arc<SceneDiagnostic>),
    /// The request itself makes no sense (a bad flag value, an output folder that exists).
    #[error("{problem}")]
    Usage {
        /// What is wrong.
        problem: String,
        /// What to do about it; may be empty.
        help: String,
    },
    /// The operating system refused to read or write.
    #[error("cannot {action} {}: {source}", path.display())]
    Io {
        /// "read", "write", "create"…
        action: &'static str,
        /// The file or folder.
        path: PathBuf,
        /// The system's own word.
        source: Arc<std::io::Error>,
    },
    /// The work was well-formed but could not be done.
    #[error("{context}: {problem}")]
    Run {
        /// The pass or step that failed.
        context: String,
        /// Why.
        problem: String,
    },
    /// The user pressed Ctrl-C; what was finished has been kept.
    #[error("interrupted")]
    Interrupted,
}

fn place_suffix(place: &str) -> String {
    if place.is_empty() { String::new() } else { format!(", {place}") }
}

impl Error {
    /// A bad input file; `place` and `help` may be empty.
    pub fn input(
        path: impl AsRef<Path>,
        place: impl Into<String>,
        problem: impl Into<String>,
        help: impl Into<String>,
    ) -> Self {
        Self::Input {
            path: path.as_ref().to_owned(),
            place: place.into(),
            problem: problem.into(),
            help: help.into(),
        }
    }

    /// A request that makes no sense.
    pub fn usage(problem: impl Into<String>, help: impl Into<String>) -> Self {
        Self::Usage { problem: problem.into(), help: help.into() }
    }

    /// Work that could not be done.
    pub fn run(context: impl Into<String>, problem: impl Into<String>) -> Self {
        Self::Run { context: context.into(), problem: problem.into() }
    }

    /// For `map_err` on `std::io` calls: `fs::read(p).map_err(Error::io("read", p))`.
    pub fn io(action: &'static str, path: impl AsRef<Path>) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.as_ref().to_owned();
        move |source| Self::Io { action, path, source: Arc::new(source) }
    }

    /// What to do about it, if there is more to say than the message.
    pub fn help(&self) -> Option<&str> {
        match self {
            Self::Input { help, .. } | Self::Usage { help, .. } if !help.is_empty() => Some(help),
            _ => None,
        }
    }

    /// The process's exit code: 2 for bad input, 130 for Ctrl-C, 1 for what ran and failed.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Input { .. } | Self::Scene(_) | Self::Usage { .. } => 2,
            Self::Interrupted => 130,
            Self::Io { .. } | Self::Run { .. } => 1,
        }
    }
}
