//! The error type of the crate.
//!
//! An error is created where the cause is known, propagated unchanged with `?`, and reported once,
//! at the edge (the command), which also chooses the exit code: 2 for [`Error::Input`],
//! [`Error::Scene`] and [`Error::Usage`], 130 (or that of the signal) for [`Error::Interrupted`], 1
//! for the rest.

pub mod stop;

use lobelia_sg::map_fit::MapFitError;
use std::io::ErrorKind::{QuotaExceeded, StorageFull};
use std::path::{Path, PathBuf};
use std::{fmt, ops::Range, sync::Arc};

/// Result of the fallible functions of this crate.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// An error: what is wrong, where, and what the user can do about it.
#[derive(Clone, Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// An input file is not usable: the file, the place in it, the problem and the remedy.
    #[error("{}{}{place}: {problem}", path.display(), if place.is_empty() { "" } else { ", " })]
    Input {
        /// The file or folder.
        path: PathBuf,
        /// Where in the file ("frame 3", "node 2", "pixel (4, 7)"); may be empty.
        place: String,
        /// The problem.
        problem: String,
        /// The remedy; may be empty.
        help: String,
    },
    /// A scene file is invalid: the places in its text, what is expected there, and help.
    #[error("{0}")]
    Scene(Arc<SceneDiagnostic>),
    /// The request is invalid (a bad flag value, an output folder that exists).
    #[error("{problem}")]
    Usage {
        /// The problem.
        problem: String,
        /// The remedy; may be empty.
        help: String,
    },
    /// The operating system returned an error for a file or folder.
    #[error("cannot {action} {}: {source}", path.display())]
    Io {
        /// "read", "write", "create"…
        action: &'static str,
        /// The file or folder.
        path: PathBuf,
        /// The error of the system.
        source: Arc<std::io::Error>,
    },
    /// The inputs are valid, but the work cannot be done.
    #[error("{context}: {problem}")]
    Run {
        /// The pass or step that failed.
        context: String,
        /// Why.
        problem: String,
    },
    /// The run was asked to stop ([`stop`]); finished results are kept.
    #[error("interrupted")]
    Interrupted,
}

impl From<MapFitError> for Error {
    fn from(error: MapFitError) -> Self {
        match error {
            MapFitError::Settings { problem, help } => Self::usage(problem, help),
            MapFitError::Map(problem) => Self::run("fitting lobes to the environment map", problem),
            MapFitError::Stopped => Self::Interrupted,
        }
    }
}

impl Error {
    /// Creates [`Error::Input`]; `place` and `help` may be empty.
    pub fn input(
        path: impl AsRef<Path>,
        place: impl Into<String>,
        problem: impl Into<String>,
        help: impl Into<String>,
    ) -> Self {
        let (path, place) = (path.as_ref().to_owned(), place.into());
        Self::Input { path, place, problem: problem.into(), help: help.into() }
    }

    /// Creates [`Error::Usage`].
    pub fn usage(problem: impl Into<String>, help: impl Into<String>) -> Self {
        Self::Usage { problem: problem.into(), help: help.into() }
    }

    /// Creates [`Error::Run`].
    pub fn run(context: impl Into<String>, problem: impl Into<String>) -> Self {
        Self::Run { context: context.into(), problem: problem.into() }
    }

    /// For `map_err` on `std::io` calls: `fs::read(p).map_err(Error::io("read", p))`.
    pub fn io(action: &'static str, path: impl AsRef<Path>) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.as_ref().to_owned();
        move |source| Self::Io { action, path, source: Arc::new(source) }
    }

    /// The remedy, if there is one.
    pub fn help(&self) -> Option<&str> {
        match self {
            Self::Input { help, .. } | Self::Usage { help, .. } if !help.is_empty() => Some(help),
            Self::Io { source, .. } if matches!(source.kind(), StorageFull | QuotaExceeded) => {
                Some("Make room; a run goes on where it was with the same command and --resume.")
            }
            _ => None,
        }
    }

    /// The exit code of the process: 2 for bad input, 130 for a run that was stopped (that of its
    /// signal is [`StopSignal::exit_code`](stop::StopSignal::exit_code)), 1 for all other errors.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Input { .. } | Self::Scene(_) | Self::Usage { .. } => 2,
            Self::Interrupted => 130,
            Self::Io { .. } | Self::Run { .. } => 1,
        }
    }
}

/// The faults of a scene file, at least one, in the order of the text.
#[derive(Clone, Debug, PartialEq)]
pub struct SceneDiagnostic {
    /// The scene file's name, as it was given.
    pub name: String,
    /// The text that [`Label::at`] counts in.
    pub text: String,
    /// The faults; never empty.
    pub faults: Vec<Fault>,
    /// A note about the text; may be empty.
    pub note: String,
}

/// One wrong place of a scene file.
#[derive(Clone, Debug, PartialEq)]
pub struct Fault {
    /// The problem, in one line.
    pub message: String,
    /// The places it is about: first the wrong one, then places that explain it.
    pub labels: Vec<Label>,
    /// The remedy; may be empty.
    pub help: String,
}

/// A place in the text with a label.
#[derive(Clone, Debug, PartialEq)]
pub struct Label {
    /// Byte range of the text.
    pub at: Range<usize>,
    /// The text of the label.
    pub text: String,
}

impl fmt::Display for SceneDiagnostic {
    /// Formats the faults in one line.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.faults[..] {
            [only] => f.write_str(&only.message),
            several => write!(f, "{} problems in {}", several.len(), self.name),
        }
    }
}
