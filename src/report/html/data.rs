//! What a report shows of a run.

use crate::report::scores::Scores;

/// A run. All texts are as they come from its files; the page escapes them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RunReport {
    /// What the page calls it: the name of its folder.
    pub name: String,
    /// How it ended: "finished", "failed", …
    pub state: String,
    /// The error that it ended with.
    pub error: Option<String>,
    /// Version, scene file, seed, arguments, machine: name and value.
    pub facts: Vec<(String, String)>,
    /// The text of the scene file.
    pub scene_text: String,
    /// The values in it, by their paths.
    pub fields: Vec<(String, String)>,
    /// Notes before the first pass.
    pub said: Vec<String>,
    /// Its passes, in their order.
    pub passes: Vec<PassReport>,
    /// Its scores so far.
    pub scores: Scores,
    /// The logs of its fits.
    pub logs: Vec<FitLog>,
    /// Lights and textures.
    pub pictures: Vec<ReportPicture>,
    /// The views of the passes that rendered.
    pub views: Vec<PassViews>,
    /// What its fits found.
    pub findings: Vec<FitFinding>,
}

/// A pass.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PassReport {
    /// Its name.
    pub name: String,
    /// How far it is: "finished", "running", …
    pub state: String,
    /// Time that it took, in seconds.
    pub secs: Option<f64>,
    /// Largest resident memory of the process when it had ended, in MiB.
    pub peak_rss_mib: Option<f64>,
    /// Its lines of result and notes.
    pub said: Vec<String>,
}

/// The log of a fit: columns of numbers, one entry each per line.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FitLog {
    /// The pass.
    pub pass: String,
    /// The columns, by name.
    pub columns: Vec<(String, Vec<f64>)>,
}

impl FitLog {
    /// The column of this name.
    pub fn column(&self, name: &str) -> Option<&[f64]> {
        self.columns.iter().find(|(column, _)| column == name).map(|(_, values)| values.as_slice())
    }
}

/// A picture: a light or a texture.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ReportPicture {
    /// What it shows: "fit: recovered light". Pictures of the same title are of several runs side by side.
    pub title: String,
    /// A `data:` address.
    pub address: String,
}

/// The views of a pass.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PassViews {
    /// The pass.
    pub pass: String,
    /// Its views.
    pub views: Vec<ViewReport>,
    /// How many more there are in the pass's folder.
    pub left_out: usize,
}

/// A view: `data:` addresses of its pictures, as far as there are any.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ViewReport {
    /// Its name.
    pub name: String,
    /// The photograph, or another ground truth.
    pub truth: Option<String>,
    /// The render, with the scale that its score is found with.
    pub render: Option<String>,
    /// The error.
    pub error: Option<String>,
}

/// Something that a fit found or decided.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FitFinding {
    /// What: "mean light".
    pub what: String,
    /// Its value.
    pub value: String,
    /// A color to show beside it, sRGB.
    pub color: Option<[u8; 3]>,
}
