//! Reports: the outputs of passes.
//!
//! Contact sheets ([`sheet`]), the scores of a prediction against its truth ([`published`],
//! [`scores`], [`compare`]), and the page that shows all of a run ([`html`]). Kernels work on
//! slices; every file is written by [`lobelia_io::codec::file`], so that incomplete files never
//! have their final name.

pub mod compare;
pub mod html;
pub mod published;
pub mod scores;
pub mod sheet;

use lobelia_geometry::{Error, Result};
use serde::{Deserialize, Serialize};

/// How far something is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum RunState {
    Waiting,
    /// It has begun; in a folder that no process holds: it was killed.
    Running,
    /// It is done, and all its files are whole.
    Finished,
    Failed,
    /// It was left out, because it needs a pass that failed.
    Skipped,
    /// It was stopped, by Ctrl-C, SIGTERM or SIGHUP; what was found until then is whole.
    Interrupted,
}

impl RunState {
    /// The state of what ended so.
    pub fn of(ended: &Result<()>) -> Self {
        match ended {
            Ok(()) => Self::Finished,
            Err(Error::Interrupted) => Self::Interrupted,
            Err(_) => Self::Failed,
        }
    }

    pub fn word(self) -> String {
        format!("{self:?}").to_lowercase()
    }
}

/// A pass in a manifest.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct PassRecord {
    pub name: String,
    pub state: RunState,
    /// Time that it took, in seconds; `None` until it has ended.
    pub secs: Option<f64>,
    /// Largest resident memory of the process when it had ended, in MiB.
    pub peak_rss_mib: Option<f64>,
    /// Its lines of result and its notes.
    #[serde(default)]
    pub said: Vec<String>,
    /// Paths below the output folder, with `/` between their parts; one that ends with `/` is a
    /// folder of which all files are the pass's. Before it is finished: the files that it may
    /// write.
    pub files: Vec<String>,
}

impl PassRecord {
    pub fn waiting(name: &str, files: Vec<String>) -> Self {
        let (name, state) = (name.to_owned(), RunState::Waiting);
        Self { name, state, secs: None, peak_rss_mib: None, said: Vec::new(), files }
    }
}
