//! What a run leaves of itself in its output folder: `run.json`, which says what belongs together, and with which `--force` knows its
//! own files from others.

use crate::codec::file::{
    FileUse, FolderLock, LOCK, MOST_TEXT, clear_scratch, is_there, is_unfinished, read_text, write_bytes,
};
use crate::error::{Error, Result};
use crate::pass::files::{PassFiles, RUN};
use crate::pass::machine::Machine;
use crate::pass::resume::hash_of;
use crate::pass::session::{METRICS, TRACE};
use crate::report::html::REPORT;
use crate::report::scores::peak_rss_mib;
use crate::scene::load::LoadedScene;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::ffi::OsStr;
use std::fs;
use std::path::{Component, Path, PathBuf};
use std::time::Instant;

/// The program's name in a manifest.
const PROGRAM: &str = "lobelia";

/// The files of a run that are of no pass, besides the manifest.
pub(crate) const OF_RUN: [&str; 3] = [METRICS, REPORT, TRACE];

/// How far something is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum RunState {
    /// It has not begun.
    Waiting,
    /// It has begun; in a folder that no process holds: it was killed.
    Running,
    /// It is done, and all its files are whole.
    Finished,
    /// It ended with an error.
    Failed,
    /// It was left out, because it needs a pass that failed.
    Skipped,
    /// It was stopped, by Ctrl-C, SIGTERM or SIGHUP; what was found until then is whole.
    Interrupted,
}

impl RunState {
    /// The word in a manifest.
    pub(super) fn word(self) -> &'static str {
        match self {
            Self::Waiting => "waiting",
            Self::Running => "running",
            Self::Finished => "finished",
            Self::Failed => "failed",
            Self::Skipped => "skipped",
            Self::Interrupted => "interrupted",
        }
    }
}

/// A pass in a manifest.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct PassRecord {
    pub(super) name: String,
    pub(super) state: RunState,
    /// Time that it took, in seconds; `None` until it has ended.
    #[serde(default)]
    pub(super) secs: Option<f64>,
    /// Largest resident memory of the process when it had ended, in MiB.
    #[serde(default)]
    pub(super) peak_rss_mib: Option<f64>,
    /// Its lines of result and its notes.
    #[serde(default)]
    pub(super) said: Vec<String>,
    /// Before it is finished: the files that it may write.
    pub(super) files: Vec<String>,
}

impl PassRecord {
    fn waiting(pass: &PassFiles) -> Self {
        Self {
            name: pass.pass.clone(),
            state: RunState::Waiting,
            secs: None,
            peak_rss_mib: None,
            said: Vec::new(),
            files: pass.files.clone(),
        }
    }

    /// A pass that the run before its break has finished: with its files, and what the manifest of `before` says of it.
    fn finished(out: &Path, pass: &PassFiles, before: Option<&Record>) -> Self {
        let is_same = |old: &&Self| old.name == pass.pass && old.state == RunState::Finished;
        let old = before.and_then(|before| before.passes.iter().find(is_same).cloned());
        Self {
            state: RunState::Finished,
            files: pass.files.iter().flat_map(|file| existing(out, file)).collect(),
            ..old.unwrap_or(Self::waiting(pass))
        }
    }
}

/// The manifest.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Record {
    program: String,
    pub(super) version: String,
    pub(super) state: RunState,
    /// The error that the run ended with.
    #[serde(default)]
    pub(super) error: Option<String>,
    pub(super) scene: String,
    /// The text of the scene file, with `--set` applied.
    #[serde(default)]
    pub(super) scene_text: String,
    /// Hash of the scene with what the command line adds, for `version` alone.
    #[serde(default)]
    scene_hash: String,
    #[serde(default)]
    pub(super) seed: Option<u64>,
    #[serde(default)]
    pub(super) arguments: Vec<String>,
    #[serde(default)]
    pub(super) machine: Option<Machine>,
    /// Hash of each photograph, mask, camera file, mesh, texture, light and ground truth that is read: the 64 bits of SipHash-1-3 as
    /// hexadecimal digits. A run that keeps no checkpoints has none.
    #[serde(default)]
    pub(super) inputs: BTreeMap<String, String>,
    /// Notes before the first pass.
    #[serde(default)]
    pub(super) said: Vec<String>,
    pub(super) passes: Vec<PassRecord>,
    /// Files of the run that are of no pass.
    files: Vec<String>,
    /// Files of earlier runs, whose passes this one does not have. They do not belong to its results.
    #[serde(default)]
    earlier: Vec<String>,
}

impl Record {
    /// The manifest in `out`; `None` if there is none that this program wrote.
    pub(super) fn read(out: &Path) -> Option<Self> {
        let text = read_text(&out.join(RUN), MOST_TEXT, |_| String::new()).ok()?;
        let record: Self = serde_json::from_str(&text).ok()?;
        (record.program == PROGRAM).then_some(record)
    }

    fn write(&self, out: &Path) -> Result<()> {
        let text = serde_json::to_string_pretty(self)
            .map_err(|error| Error::run("writing run.json", error.to_string()))?;
        write_bytes(&out.join(RUN), (text + "\n").as_bytes())
    }

    /// All that it lists, of any run.
    fn listed(&self) -> impl Iterator<Item = &String> {
        self.passes.iter().flat_map(|pass| &pass.files).chain(&self.files).chain(&self.earlier)
    }
}

/// The files below `out` that a listed path stands for and that exist, as paths below `out`. What leads out of `out`, by `..` or by a
/// link of a folder, stands for nothing.
fn existing(out: &Path, listed: &str) -> Vec<String> {
    let path = Path::new(listed);
    let mut at = out.to_owned();
    for part in path.components() {
        let is_link = |path: &Path| path.symlink_metadata().is_ok_and(|found| found.is_symlink());
        if !matches!(part, Component::Normal(_)) || (at != out && is_link(&at)) {
            return Vec::new();
        }
        at.push(part);
    }
    if !listed.ends_with('/') {
        let is_file = at.symlink_metadata().is_ok_and(|found| !found.is_dir());
        return if is_file { vec![listed.to_owned()] } else { Vec::new() };
    }
    let is_folder = at.symlink_metadata().is_ok_and(|found| found.is_dir());
    let entries = if is_folder { fs::read_dir(&at).ok() } else { None };
    let entries = entries.into_iter().flatten().flatten();
    let files = entries.filter(|entry| entry.file_type().is_ok_and(|kind| !kind.is_dir()));
    files.map(|entry| format!("{listed}{}", entry.file_name().to_string_lossy())).collect()
}

/// Checks an output folder before anything is read: it is new or empty, or `force` may write into it; and no other run does.
/// `has_checkpoints` is whether the run in it can go on.
///
/// # Errors
/// [`Error::Usage`] that says what is in the way.
pub(crate) fn check_used(out: &Path, force: bool, has_checkpoints: bool) -> Result<()> {
    FolderLock::check_free(out)?;
    if force || !is_used(out) {
        return Ok(());
    }
    let shown = out.display();
    let (problem, help) = match Record::read(out).map(|record| record.state) {
        Some(RunState::Finished) => (
            format!("the output folder {shown} is not empty: it has the results of a run"),
            "Choose another with --out, or replace them with --force.",
        ),
        Some(_) if !has_checkpoints => (
            format!("the output folder {shown} is not empty: it has a run that did not finish"),
            "It kept no checkpoints. Choose another folder with --out, or replace what it left with --force.",
        ),
        Some(_) => (
            format!("the output folder {shown} is not empty: it has a run that did not finish"),
            "Go on with it: --resume. Or choose another with --out, or replace what it left with --force.",
        ),
        None => (
            format!("the output folder {shown} is not empty"),
            "Choose another with --out. --force replaces the results of an earlier run and nothing else.",
        ),
    };
    Err(Error::usage(problem, help))
}

/// Whether the run in `out` that is to go on has finished. One without `checkpoints` begins again, if it has written nothing.
///
/// # Errors
/// [`Error::Usage`] if it was of another scene, or if what it has written would be lost.
pub(crate) fn check_resumed(out: &Path, loaded: &LoadedScene, has_checkpoints: bool) -> Result<bool> {
    let Some(record) = Record::read(out) else { return Ok(false) };
    if record.state == RunState::Finished {
        if record.version == env!("LOBELIA_VERSION") && record.scene_hash != scene_hash(loaded) {
            let problem = format!("the run in {} has finished, and was of another scene", out.display());
            let help = "Choose another folder with --out, or replace its results with --force.";
            return Err(Error::usage(problem, help));
        }
        return Ok(true);
    }
    // Of a pass that waits there is what an earlier run left, if the process was killed before that was removed.
    let written = |pass: &PassRecord| {
        pass.state != RunState::Waiting && pass.files.iter().any(|file| !existing(out, file).is_empty())
    };
    if !has_checkpoints && record.passes.iter().any(written) {
        let problem = format!(
            "the run in {} kept no checkpoints: --resume would begin again and remove its results",
            out.display()
        );
        return Err(Error::usage(problem, "Choose another folder with --out, or begin again with --force."));
    }
    Ok(false)
}

fn scene_hash(loaded: &LoadedScene) -> String {
    format!("{:016x}", hash_of(&loaded.scene))
}

/// Whether a folder has more than what a process that was killed at its very start left: its lock, and half of a manifest. What else keeps it
/// from being written is told elsewhere.
fn is_used(out: &Path) -> bool {
    let entries = fs::read_dir(out).into_iter().flatten().flatten();
    entries.map(|entry| entry.file_name()).any(|name| name != OsStr::new(LOCK) && !is_unfinished(&name))
}

/// An output folder that this process alone writes into, in which nothing is changed yet.
pub(crate) struct Claim {
    lock: FolderLock,
    out: PathBuf,
    plan: Vec<PassFiles>,
    /// The manifest of the run before.
    before: Option<Record>,
}

impl Claim {
    /// Takes an output folder for a run that may write `plan`, of which nothing may be there that no run has written.
    ///
    /// # Errors
    /// [`Error::Usage`] if another run writes there, or something else is in the way.
    pub fn new(out: &Path, plan: Vec<PassFiles>) -> Result<Self> {
        let lock = FolderLock::take(out)?;
        let before = Record::read(out);
        if before.is_none() && is_used(out) {
            let problem = format!(
                "--force replaces the results of an earlier run, but {} has none: it has files and no {RUN} of a run",
                out.display()
            );
            let help = "Choose another folder with --out. What an older version wrote is best moved away or removed.";
            return Err(Error::usage(problem, help));
        }
        let known: BTreeSet<String> =
            before.iter().flat_map(Record::listed).flat_map(|listed| existing(out, listed)).collect();
        for pass in &plan {
            check_pass(out, pass, &known)?;
        }
        for file in OF_RUN {
            if is_there(&out.join(file)) && !known.contains(file) {
                return Err(foreign(&out.join(file)));
            }
        }
        Ok(Self { lock, out: out.to_owned(), plan, before })
    }

    /// What earlier runs left under the names of this one's passes, and which goes when it begins.
    pub fn stale(&self) -> impl Iterator<Item = FileUse> {
        let (stale, _) = self.leftovers(&[]);
        stale.into_iter().map(|file| FileUse::new(self.out.join(file), "--force"))
    }

    /// What earlier runs left, beside what is of the passes that are `done`: what goes, and what stays.
    fn leftovers(&self, done: &[PassRecord]) -> (Vec<String>, Vec<String>) {
        let names: BTreeSet<&str> =
            self.plan.iter().skip(done.len()).map(|pass| pass.pass.as_str()).collect();
        let mut old: BTreeSet<String> = self
            .before
            .iter()
            .flat_map(Record::listed)
            .flat_map(|listed| existing(&self.out, listed))
            .collect();
        old.retain(|file| *file != RUN && !done.iter().any(|pass| pass.files.contains(file)));
        let is_stale = |file: &String| file.split('/').next().is_some_and(|first| names.contains(first));
        old.into_iter().partition(|file| OF_RUN.contains(&file.as_str()) || is_stale(file))
    }

    /// Begins the run: writes its manifest, and then removes what earlier runs left of the same passes, so that old results are never
    /// beside new ones as if they were of one run. The first `done` passes are of this run, which is resumed.
    ///
    /// # Errors
    /// [`Error::Io`] if something cannot be written or removed.
    pub fn begin(self, loaded: &LoadedScene, arguments: &[String], done: usize) -> Result<RunRecord> {
        let finished = self.plan.iter().take(done);
        let done: Vec<PassRecord> =
            finished.map(|pass| PassRecord::finished(&self.out, pass, self.before.as_ref())).collect();
        let (stale, kept) = self.leftovers(&done);
        let Self { lock, out, plan, .. } = self;
        let waiting = plan.iter().skip(done.len()).map(PassRecord::waiting);
        let passes = done.into_iter().chain(waiting).collect();
        let mut record = Record {
            program: PROGRAM.into(),
            version: env!("LOBELIA_VERSION").into(),
            state: RunState::Running,
            error: None,
            scene: loaded.path.to_string_lossy().into_owned(),
            scene_text: loaded.text.clone(),
            scene_hash: scene_hash(loaded),
            seed: Some(loaded.scene.seed),
            arguments: arguments.to_vec(),
            machine: Some(Machine::this()),
            inputs: BTreeMap::new(),
            said: Vec::new(),
            passes,
            files: OF_RUN.map(str::to_owned).to_vec(),
            earlier: [stale.clone(), kept.clone()].concat(),
        };
        record.write(&out)?;
        clear(&out, stale, &plan)?;
        record.earlier = kept;
        record.write(&out)?;
        Ok(RunRecord { record, out, began: Instant::now(), _lock: lock })
    }
}

/// Removes old files, and what was left unfinished.
fn clear(out: &Path, mut stale: Vec<String>, plan: &[PassFiles]) -> Result<()> {
    // A saved scene must not outlive the files that it names.
    stale.sort_by_key(|file| !file.ends_with(".ron"));
    for file in &stale {
        let path = out.join(file);
        fs::remove_file(&path).map_err(Error::io("remove", &path))?;
    }
    clear_scratch(out)?;
    let folders: BTreeSet<String> =
        plan.iter().flat_map(folders_of).chain(stale.iter().flat_map(|file| parents(file))).collect();
    // Those inside come before those around them.
    for folder in folders.iter().rev().map(|folder| out.join(folder)) {
        clear_scratch(&folder)?;
        // Folders go if nothing is left in them.
        let _ = fs::remove_dir(folder);
    }
    Ok(())
}

/// The folders that a listed path lies in, as paths below the output folder. One that ends with `/` is itself one of them.
fn parents(listed: &str) -> impl Iterator<Item = String> + use<'_> {
    listed.match_indices('/').map(|(at, _)| listed[..at].to_owned())
}

/// The folders that a pass may write into, as paths below the output folder.
fn folders_of(pass: &PassFiles) -> BTreeSet<String> {
    pass.files.iter().flat_map(|file| parents(file)).chain([pass.pass.clone()]).collect()
}

/// Checks that a pass's folder is one, and that its files are not there but for those of earlier runs.
fn check_pass(out: &Path, pass: &PassFiles, known: &BTreeSet<String>) -> Result<()> {
    for folder in folders_of(pass).iter().map(|folder| out.join(folder)) {
        if folder.symlink_metadata().is_ok_and(|found| found.is_symlink()) {
            let problem = format!(
                "{} is a symbolic link: pass {} would write outside the output folder",
                folder.display(),
                pass.pass
            );
            return Err(Error::usage(problem, "Remove the link, or choose another folder with --out."));
        }
    }
    for file in &pass.files {
        let there = if file.ends_with('/') {
            existing(out, file)
        } else if is_there(&out.join(file)) {
            vec![file.clone()]
        } else {
            Vec::new()
        };
        if let Some(other) = there.iter().find(|file| !known.contains(*file)) {
            return Err(foreign(&out.join(other)));
        }
    }
    Ok(())
}

fn foreign(path: &Path) -> Error {
    let problem = format!("{} is in the way: no run has written it", path.display());
    Error::usage(problem, "Move it away, or choose another folder with --out.")
}

/// The manifest of a run that has begun; the folder is its own as long as this lives.
pub(crate) struct RunRecord {
    record: Record,
    out: PathBuf,
    /// When the pass that runs began.
    began: Instant,
    _lock: FolderLock,
}

impl RunRecord {
    /// Keeps notes from before the first pass; the manifest has them from its next change on.
    pub fn said_before(&mut self, said: Vec<String>) {
        self.record.said = said;
    }

    /// Keeps the hashes of the files that are read; the manifest has them from its next change on.
    pub fn reads(&mut self, inputs: BTreeMap<String, String>) {
        self.record.inputs = inputs;
    }

    /// Says how far a pass is, and what it said.
    ///
    /// # Errors
    /// [`Error::Io`] if the manifest cannot be written.
    pub fn pass(&mut self, index: usize, state: RunState, said: Vec<String>) -> Result<()> {
        let Some(pass) = self.record.passes.get_mut(index) else { return Ok(()) };
        pass.state = state;
        pass.said.extend(said);
        if state == RunState::Running {
            self.began = Instant::now();
        }
        if !matches!(state, RunState::Waiting | RunState::Running | RunState::Skipped) {
            pass.secs = Some(self.began.elapsed().as_secs_f64());
            pass.peak_rss_mib = peak_rss_mib();
        }
        if !matches!(state, RunState::Waiting | RunState::Running) {
            pass.files = pass.files.iter().flat_map(|file| existing(&self.out, file)).collect();
        }
        self.record.write(&self.out)
    }

    /// Says how the run ended, and what it has written. The first error is the one to tell.
    ///
    /// # Errors
    /// The run's; [`Error::Io`] if it has none and the manifest cannot be written.
    pub fn end(&mut self, result: Result<()>) -> Result<()> {
        self.record.state = match &result {
            Ok(()) => RunState::Finished,
            Err(Error::Interrupted) => RunState::Interrupted,
            Err(_) => RunState::Failed,
        };
        self.record.error = result.as_ref().err().map(ToString::to_string);
        let out = &self.out;
        for pass in &mut self.record.passes {
            pass.files = pass.files.iter().flat_map(|file| existing(out, file)).collect();
        }
        self.record.files.retain(|file| is_there(&out.join(file)));
        let written = self.record.write(out);
        result.and(written)
    }
}

#[cfg(test)]
mod tests;
