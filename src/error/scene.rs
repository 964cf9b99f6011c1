//! Diagnostics of a scene file; the caller renders them.

use std::fmt;
use std::ops::Range;

/// The faults of a scene file, at least one, in the order of the text.
#[derive(Clone, Debug, PartialEq)]
pub struct SceneDiagnostic {
    /// The scene file's name, as it was given.
    pub name: String,
    /// The text that [`Label::at`] counts in.
    pub text: String,
    /// What is wrong; never empty.
    pub faults: Vec<Fault>,
    /// A note about the text; may be empty.
    pub note: String,
}

/// One wrong place of a scene file.
#[derive(Clone, Debug, PartialEq)]
pub struct Fault {
    /// What is wrong, in one line.
    pub message: String,
    /// The places it is about: first the wrong one, then places that explain it.
    pub labels: Vec<Label>,
    /// What to do about it; may be empty.
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
