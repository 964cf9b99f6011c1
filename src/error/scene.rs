//! What is wrong in a scene file, ready to be shown; whoever shows it draws the carets.

use std::fmt;
use std::ops::Range;

/// What is wrong in a scene file: one fault or more, in the order of the text.
#[derive(Clone, Debug, PartialEq)]
pub struct SceneDiagnostic {
    /// The scene file's name, as it was given.
    pub name: String,
    /// The text that [`Label::at`] counts in.
    pub text: String,
    /// What is wrong; never empty.
    pub faults: Vec<Fault>,
    /// Something to know about the text shown; may be empty.
    pub note: String,
}

/// One wrong place of a scene file.
#[derive(Clone, Debug, PartialEq)]
pub struct Fault {
    /// What is wrong, in one line.
    pub message: String,
    /// The places it is about: first the wrong one, then others that explain it.
    pub labels: Vec<Label>,
    /// What to do about it; may be empty.
    pub help: String,
}

/// A place in the text with words beside it.
#[derive(Clone, Debug, PartialEq)]
pub struct Label {
    /// Bytes of the text.
    pub at: Range<usize>,
    /// What to say there.
    pub text: String,
}

impl fmt::Display for SceneDiagnostic {
    /// In one line.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.faults[..] {
            [only] => f.write_str(&only.message),
            several => write!(f, "{} problems in {}", several.len(), self.name),
        }
    }
}
