//! A unit, and what it has come to.

use crate::pass::summary::Outcome;
use serde::Serialize;
use std::path::PathBuf;

/// One run among many.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Unit {
    /// Its name: its results lie in a folder of this name.
    pub name: String,
    /// The scene file.
    pub scene: PathBuf,
    /// What `$DATA` stands for.
    pub data: Option<PathBuf>,
    /// Values of the scene file that are replaced: path and RON text.
    pub sets: Vec<(String, String)>,
    /// The only pass of the scene that is run.
    pub pass: Option<String>,
}

/// A unit, by the name of its folder, with what it has come to.
pub type UnitRow = (String, Outcome);

/// What a unit is that has no folder yet.
pub(super) const NOT_BEGUN: &str = "not begun";

/// A film whose frames units have rendered.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct JoinedFilm {
    /// Its file.
    pub file: PathBuf,
    /// Frames that are there.
    pub there: usize,
    /// Frames of the film.
    pub frames: u32,
    /// Why it was not joined although they may all be there.
    pub problem: Option<String>,
    /// Whether that is because a frame or a folder of frames cannot be read.
    pub is_unreadable: bool,
}

impl JoinedFilm {
    /// Whether the file was written.
    pub fn is_joined(&self) -> bool {
        self.problem.is_none() && self.there == self.frames as usize
    }

    /// How far it is, in words.
    pub fn words(&self) -> String {
        let there = format!("{} of {} frames", self.there, self.frames);
        self.problem.as_ref().map_or(there.clone(), |problem| format!("{there}, not joined: {problem}"))
    }
}

/// The columns that a score has, of all units.
pub(super) fn scored_passes(units: &[UnitRow]) -> Vec<String> {
    let mut passes: Vec<String> = Vec::new();
    for (pass, _) in units.iter().flat_map(|(_, outcome)| &outcome.scores) {
        if !passes.contains(pass) {
            passes.push(pass.clone());
        }
    }
    passes
}
