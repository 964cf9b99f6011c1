//! What a survey finds: a name, how bad it is, the views it is about, and what to do.

use crate::error::Error;
use serde::Serialize;

/// How bad a finding is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum Severity {
    /// A run works, perhaps worse than it could.
    Warning,
    /// A run fails, or its result is worthless.
    Error,
}

/// One thing that is wrong with the data.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Finding {
    /// How bad it is.
    pub severity: Severity,
    /// A short fixed name, e.g. `blurred`; contact sheets and `survey.json` have it.
    pub name: &'static str,
    /// The views it is about, the worst first; empty if it is about all.
    pub views: Vec<String>,
    /// What is wrong, in one sentence that names a view.
    pub problem: String,
    /// What to do about it.
    pub help: String,
}

/// Views that a sentence names; the rest are counted.
const NAMED: usize = 5;

impl Finding {
    /// A finding about some views.
    pub fn new(
        severity: Severity,
        name: &'static str,
        views: Vec<String>,
        problem: impl Into<String>,
        help: impl Into<String>,
    ) -> Self {
        Self { severity, name, views, problem: problem.into(), help: help.into() }
    }

    /// One that stops a run.
    pub fn error(
        name: &'static str,
        views: Vec<String>,
        problem: impl Into<String>,
        help: impl Into<String>,
    ) -> Self {
        Self::new(Severity::Error, name, views, problem, help)
    }

    /// One that does not.
    pub fn warning(
        name: &'static str,
        views: Vec<String>,
        problem: impl Into<String>,
        help: impl Into<String>,
    ) -> Self {
        Self::new(Severity::Warning, name, views, problem, help)
    }

    /// An error of another check, of which only problem and help are kept.
    pub fn from_error(name: &'static str, error: &Error) -> Self {
        Self::error(name, Vec::new(), error.to_string(), error.help().unwrap_or_default())
    }

    /// The error that a run ends with.
    pub fn to_error(&self) -> Error {
        Error::usage(self.problem.clone(), self.help.clone())
    }
}

/// "view `a`", "views `a`, `b`", "views `a`, `b`, `c`, `d`, `e` and 7 more".
pub fn named(views: &[String]) -> String {
    let list: Vec<String> = views.iter().take(NAMED).map(|view| format!("`{view}`")).collect();
    let noun = if views.len() == 1 { "view" } else { "views" };
    match views.len().saturating_sub(NAMED) {
        0 => format!("{noun} {}", list.join(", ")),
        rest => format!("{noun} {} and {rest} more", list.join(", ")),
    }
}

/// "1 warning", "2 warnings".
pub fn counted(count: usize, noun: &str) -> String {
    if count == 1 { format!("1 {noun}") } else { format!("{count} {noun}s") }
}
