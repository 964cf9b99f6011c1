//! What a run has come to, in a row: for tables of many runs.

use crate::codec::file::{MOST_TEXT, read_text};
use crate::error::{Error, Result};
use crate::pass::record::{Record, RunState};
use crate::pass::session::METRICS;
use crate::report::scores::Scores;
use crate::scene::fields::fields;
use std::collections::BTreeMap;
use std::path::Path;

/// What a run has come to.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Outcome {
    /// How far it is, in a word: finished, failed, interrupted, running (in a folder that no process holds: killed).
    pub state: String,
    /// The error that it ended with.
    pub error: Option<String>,
    /// Time of its passes, in seconds.
    pub secs: f64,
    /// Largest resident memory, in MiB.
    pub peak_rss_mib: Option<f64>,
    /// Passes that were scored, each with its PSNR in dB and its SSIM.
    pub scores: Vec<(String, [f64; 2])>,
    /// PSNR of the albedo, in dB.
    pub albedo_psnr: Option<f64>,
    /// The values of its scene file, each by its path.
    pub fields: Vec<(String, String)>,
    /// A hash of each file that it reads, by path; none if it keeps no checkpoints.
    pub inputs: BTreeMap<String, String>,
}

impl Outcome {
    /// Whether all of it is done.
    pub fn is_finished(&self) -> bool {
        self.state == RunState::Finished.word()
    }
}

/// What the run in a folder has come to; `None` if there is none. Scores that cannot be read are left out.
pub fn read_outcome(out: &Path) -> Option<Outcome> {
    let record = Record::read(out)?;
    let scores = read_scores(out).unwrap_or_default();
    let scored = scores.passes.iter().map(|(pass, score)| (pass.clone(), [score.psnr, score.ssim]));
    Some(Outcome {
        state: record.state.word().to_owned(),
        error: record.error.clone(),
        secs: record.passes.iter().filter_map(|pass| pass.secs).sum(),
        peak_rss_mib: record.passes.iter().filter_map(|pass| pass.peak_rss_mib).reduce(f64::max),
        scores: scored.collect(),
        albedo_psnr: scores.albedo_psnr,
        fields: fields(&record.scene_text),
        inputs: record.inputs,
    })
}

/// The scores of a run.
pub(super) fn read_scores(out: &Path) -> Result<Scores> {
    let path = out.join(METRICS);
    let text = read_text(&path, MOST_TEXT, |_| String::new())?;
    serde_json::from_str(&text).map_err(|error| {
        let place = format!("line {}, column {}", error.line(), error.column());
        let problem = format!("is not the scores of a run of this version: {error}");
        Error::input(&path, place, problem, "Run the scene again, with this version.")
    })
}
