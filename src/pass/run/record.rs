//! Record of a run in its output folder: `run.json` lists the files that belong together, by which
//! `--force` tells its own files from others.

use crate::pass::run::preflight::{RUN, check_outputs, inputs, outputs};
use crate::pass::run::{METRICS, OwnPass, RunOptions, memory::Machine, resume, resume::RunStart};
use crate::report::{PassRecord, RunState, html::REPORT, scores::peak_rss_mib};
use crate::{scene::load::LoadedScene, survey::open::OpenScene};
use lobelia_geometry::error::{Error, Result};
use lobelia_io::codec::file::{
    FileUse, FolderLock, LOCK, MOST_TEXT, check_apart, clear_scratch, is_there, is_unfinished, read_text,
    write_bytes,
};
use serde::{Deserialize, Serialize};
use std::{collections::BTreeSet, ffi::OsStr, fs, path::Component, path::Path, path::PathBuf, time::Instant};

const PROGRAM: &str = "lobelia";

/// The files of a run that are of no pass, besides the manifest.
const OF_RUN: [&str; 4] = [METRICS, REPORT, PROFILES[0], PROFILES[1]];
/// Those of `--profile`, which are written after the last manifest.
const PROFILES: [&str; 2] = ["profile.txt", "trace.json"];

/// The manifest.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Record {
    program: String,
    /// With what it was begun.
    #[serde(flatten)]
    pub start: RunStart,
    pub state: RunState,
    /// The error that the run ended with.
    pub error: Option<String>,
    pub scene: String,
    /// The text of the scene file, with `--set` applied.
    #[serde(default)]
    pub scene_text: String,
    pub seed: Option<u64>,
    #[serde(default)]
    pub arguments: Vec<String>,
    pub machine: Option<Machine>,
    /// Notes before the first pass.
    #[serde(default)]
    pub said: Vec<String>,
    pub passes: Vec<PassRecord>,
    /// Files of the run that are of no pass.
    files: Vec<String>,
    /// Files of earlier runs, whose passes this one does not have. They do not belong to its
    /// results.
    #[serde(default)]
    earlier: Vec<String>,
}

impl Record {
    /// The manifest in `out`; `None` if there is none that this program wrote.
    pub fn read(out: &Path) -> Option<Self> {
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

/// The files below `out` that a listed path stands for and that exist, as paths below `out`. What
/// leads out of `out`, by `..` or by a link of a folder, stands for nothing.
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
    let entries = fs::read_dir(&at).into_iter().flatten().flatten().filter(|_| is_folder);
    let files = entries.filter(|entry| entry.file_type().is_ok_and(|kind| !kind.is_dir()));
    files.map(|entry| format!("{listed}{}", entry.file_name().to_string_lossy())).collect()
}

/// Checks an output folder before anything is read: it is new or empty, or `force` may write into
/// it; and no other run does.
pub(super) fn check_used(out: &Path, force: bool) -> Result<()> {
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

/// The run in `out` that is to go on, which may have finished; `None` if it kept no checkpoints and
/// has written nothing, so that it begins again.
///
/// # Errors
/// [`Error::Usage`] if it has finished and was of another scene, or if what it has written would be
/// lost.
pub(super) fn resumed(out: &Path, loaded: &LoadedScene) -> Result<Option<Record>> {
    let Some(record) = Record::read(out) else { return Ok(None) };
    if record.state == RunState::Finished && record.start.is_of_another(&loaded.scene) {
        let problem = format!("the run in {} has finished, and was of another scene", out.display());
        let help = "Choose another folder with --out, or replace its results with --force.";
        return Err(Error::usage(problem, help));
    }
    if record.state == RunState::Finished || out.join(resume::FOLDER).is_dir() {
        return Ok(Some(record));
    }
    // Of a pass that waits there is what an earlier run left, if the process was killed before that
    // was removed.
    let written = |of: &PassRecord| of.state != RunState::Waiting && !all_existing(out, &of.files).is_empty();
    if record.passes.iter().any(written) {
        let problem = format!(
            "the run in {} kept no checkpoints: --resume would begin again and remove its results",
            out.display()
        );
        return Err(Error::usage(problem, "Choose another folder with --out, or begin again with --force."));
    }
    Ok(None)
}

/// Whether a folder has more than what a process that was killed at its very start left: its lock,
/// and half of a manifest. What else keeps it from being written is told elsewhere.
fn is_used(out: &Path) -> bool {
    let entries = fs::read_dir(out).into_iter().flatten().flatten();
    entries.map(|entry| entry.file_name()).any(|name| name != OsStr::new(LOCK) && !is_unfinished(&name))
}

/// The files below `out` that listed paths stand for and that exist.
fn all_existing<'a>(out: &Path, listed: impl IntoIterator<Item = &'a String>) -> Vec<String> {
    listed.into_iter().flat_map(|file| existing(out, file)).collect()
}

/// An output folder that this process alone writes into, in which nothing is changed yet.
pub(super) struct Claim {
    lock: FolderLock,
    out: PathBuf,
    plan: Vec<PassRecord>,
    /// The manifest of the run before, and the files that it lists, also of runs before that.
    before: Option<Record>,
    old: BTreeSet<String>,
}

impl Claim {
    /// Takes the output folder, once it is clear that nothing in it is read or somebody else's.
    ///
    /// # Errors
    /// [`Error::Usage`] if another run writes there, something else is in the way, or an input
    /// would be replaced or removed.
    pub fn new(loaded: &LoadedScene, data: Option<&OpenScene>, options: &RunOptions) -> Result<Self> {
        let out = &options.out;
        let mut plan = outputs(&loaded.scene, data, options.debug_every);
        for OwnPass { name, files, .. } in &options.own {
            let is_name = |c: char| c.is_ascii_alphanumeric() || "_-".contains(c);
            if name.is_empty() || !name.chars().all(is_name) || plan.iter().any(|pass| pass.name == *name) {
                let problem = format!("a pass cannot have the name `{name}`");
                return Err(Error::usage(problem, "Give it another, of letters, digits, _ and -."));
            }
            plan.push(PassRecord::waiting(name, files.iter().map(|file| format!("{name}/{file}")).collect()));
        }
        let used = |file: &str, by: &str| FileUse::new(out.join(file), by);
        let of_pass = |pass: &PassRecord| -> Vec<FileUse> {
            let by = format!("pass {}", pass.name);
            pass.files.iter().map(|file| used(file, &by)).collect()
        };
        let of_run = OF_RUN.into_iter().chain([RUN]).map(|file| used(file, "the run"));
        let written: Vec<FileUse> = plan.iter().flat_map(of_pass).chain(of_run).collect();
        let help = "Choose another folder with --out, or give the pass another name. Inputs are never replaced, --force or not.";
        check_outputs(loaded, data, &written, help)?;
        let claim = Self::of_plan(out, plan)?;
        let (stale, _) = claim.leftovers(&[]);
        let stale: Vec<FileUse> = stale.iter().map(|file| used(file, "--force")).collect();
        let help = "It is of an earlier run. Copy it elsewhere, choose another folder with --out, or rename the pass.";
        check_apart(&inputs(loaded, data), &stale, help)?;
        Ok(claim)
    }

    /// Takes a folder for a run that may write `plan`, of which nothing may be there that no run
    /// has written.
    fn of_plan(out: &Path, plan: Vec<PassRecord>) -> Result<Self> {
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
        let profiles = before.iter().flat_map(|_| PROFILES).map(str::to_owned);
        let mut old = BTreeSet::from_iter(all_existing(out, before.iter().flat_map(Record::listed)));
        old.extend(profiles.filter(|file| is_there(&out.join(file))));
        for folder in plan.iter().flat_map(folders_of).map(|folder| out.join(folder)) {
            resume::check_no_link(&folder)?;
        }
        for file in plan.iter().flat_map(|pass| &pass.files).map(String::as_str).chain(OF_RUN) {
            let there = match file.ends_with('/') {
                true => existing(out, file),
                false => Some(file.to_owned()).filter(|file| is_there(&out.join(file))).into_iter().collect(),
            };
            if let Some(other) = there.iter().find(|file| !old.contains(*file)) {
                let problem = format!("{} is in the way: no run has written it", out.join(other).display());
                return Err(Error::usage(problem, "Move it away, or choose another folder with --out."));
            }
        }
        Ok(Self { lock, out: out.to_owned(), plan, before, old })
    }

    /// The files of earlier runs but those of the passes that are `done`: those that are removed
    /// when this one begins, which are of [`OF_RUN`] or under the names of its passes, and those
    /// that stay.
    fn leftovers(&self, done: &[PassRecord]) -> (Vec<String>, Vec<String>) {
        let names: BTreeSet<&str> = self.plan.iter().skip(done.len()).map(|pass| &*pass.name).collect();
        let is_old = |file: &&String| *file != RUN && !done.iter().any(|pass| pass.files.contains(file));
        let is_stale = |file: &String| {
            OF_RUN.contains(&file.as_str())
                || file.split('/').next().is_some_and(|first| names.contains(first))
        };
        self.old.iter().filter(is_old).cloned().partition(is_stale)
    }

    /// Begins the run: writes its manifest, and then removes what earlier runs left of the same
    /// passes, so that old results are never beside new ones as if they were of one run. The first
    /// `done` passes are of this run, which was begun with `start` and is resumed; `said` are its
    /// notes so far.
    pub fn begin(
        self,
        loaded: &LoadedScene,
        arguments: &[String],
        start: RunStart,
        said: Vec<String>,
        done: usize,
    ) -> Result<RunRecord> {
        let mut passes = Vec::new();
        for pass in self.plan.iter().take(done) {
            let is_same = |old: &&PassRecord| old.name == pass.name && old.state == RunState::Finished;
            let old = self.before.iter().flat_map(|before| &before.passes).find(is_same);
            passes.push(PassRecord {
                state: RunState::Finished,
                files: all_existing(&self.out, &pass.files),
                ..old.unwrap_or(pass).clone()
            });
        }
        let (mut stale, kept) = self.leftovers(&passes);
        let Self { lock, out, plan, .. } = self;
        passes.extend(plan.iter().skip(done).cloned());
        let mut record = Record {
            program: PROGRAM.into(),
            start,
            state: RunState::Running,
            error: None,
            scene: loaded.path.to_string_lossy().into_owned(),
            scene_text: loaded.text.clone(),
            seed: Some(loaded.scene.seed),
            arguments: arguments.to_vec(),
            machine: Some(Machine::this()),
            said,
            passes,
            files: OF_RUN.map(str::to_owned).to_vec(),
            earlier: [stale.clone(), kept.clone()].concat(),
        };
        record.write(&out)?;
        // Old files go, and what was left unfinished. A saved scene must not outlive the files that
        // it names.
        stale.sort_by_key(|file| !file.ends_with(".ron"));
        for file in &stale {
            let path = out.join(file);
            fs::remove_file(&path).map_err(Error::io("remove", &path))?;
        }
        clear_scratch(&out)?;
        let of_stale = stale.iter().flat_map(|file| parents(file));
        let folders: BTreeSet<String> = plan.iter().flat_map(folders_of).chain(of_stale).collect();
        // Those inside come before those around them.
        for folder in folders.iter().rev().map(|folder| out.join(folder)) {
            clear_scratch(&folder)?;
            // Folders go if nothing is left in them.
            let _ = fs::remove_dir(folder);
        }
        record.earlier = kept;
        record.write(&out)?;
        Ok(RunRecord { record, out, began: Instant::now(), _lock: lock })
    }
}

/// The folders that a listed path lies in, as paths below the output folder. One that ends with `/`
/// is itself one of them.
fn parents(listed: &str) -> impl Iterator<Item = String> + use<'_> {
    listed.match_indices('/').map(|(at, _)| listed[..at].to_owned())
}

/// The folders that a pass may write into, as paths below the output folder.
fn folders_of(pass: &PassRecord) -> BTreeSet<String> {
    pass.files.iter().flat_map(|file| parents(file)).chain([pass.name.clone()]).collect()
}

/// The manifest of a run that has begun; the folder is its own as long as this lives.
pub(super) struct RunRecord {
    record: Record,
    out: PathBuf,
    /// When the pass that runs began.
    began: Instant,
    _lock: FolderLock,
}

impl RunRecord {
    /// Says how far a pass is, and what it said.
    pub fn pass(&mut self, index: usize, state: RunState, said: Vec<String>) -> Result<()> {
        let pass = &mut self.record.passes[index];
        pass.state = state;
        pass.said.extend(said);
        if state == RunState::Running {
            self.began = Instant::now();
        } else {
            if state != RunState::Skipped {
                pass.secs = Some(self.began.elapsed().as_secs_f64());
                pass.peak_rss_mib = peak_rss_mib();
            }
            pass.files = all_existing(&self.out, &pass.files);
        }
        self.record.write(&self.out)
    }

    /// Says how the run ended, and what it has written. The first error is the one to tell.
    ///
    /// # Errors
    /// The run's; [`Error::Io`] if it has none and the manifest cannot be written.
    pub fn end(&mut self, result: Result<()>) -> Result<()> {
        let Self { record, out, .. } = self;
        record.state = RunState::of(&result);
        record.error = result.as_ref().err().map(ToString::to_string);
        for pass in &mut record.passes {
            pass.files = all_existing(out, &pass.files);
        }
        record.files.retain(|file| is_there(&out.join(file)));
        let written = record.write(out);
        result.and(written)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{LoadOptions, load::read};

    fn plan(files: &[&str]) -> Vec<PassRecord> {
        vec![PassRecord::waiting("novel", files.iter().map(|file| format!("novel/{file}")).collect())]
    }

    const SCENE: &str = r#"(version: 1, surface: Sphere(), views: Cameras([(name: "a", eye: (0, 0, 3))]))"#;

    fn begin(out: &Path, files: &[&str]) -> RunRecord {
        let scene = read(SCENE.to_owned(), Path::new("scene.ron"), &LoadOptions::default()).unwrap();
        let claim = Claim::of_plan(out, plan(files)).unwrap();
        claim.begin(&scene, &[], RunStart::default(), Vec::new(), 0).unwrap()
    }

    /// Manifests come with folders from anywhere.
    #[test]
    fn a_manifest_that_lists_what_is_elsewhere_removes_nothing_there() {
        let root = tempfile::tempdir().unwrap();
        let (out, photograph) = (root.path().join("out"), root.path().join("photo.png"));
        fs::write(&photograph, "x").unwrap();
        let mut record = begin(&out, &["a.png"]);
        let absolute = photograph.to_string_lossy();
        let elsewhere =
            ["../photo.png", "novel/../../photo.png", &absolute, "..", "novel/../../", "link/photo.png"];
        record.record.files.extend(elsewhere.map(str::to_owned));
        record.record.passes[0].files.extend(elsewhere.map(str::to_owned));
        #[cfg(unix)]
        std::os::unix::fs::symlink(root.path(), out.join("link")).unwrap();
        record.record.write(&out).unwrap();
        drop(record);
        begin(&out, &["a.png"]).end(Ok(())).unwrap();
        assert!(photograph.exists());
        assert_eq!(Record::read(&out).unwrap().listed().count(), 0);
    }

    #[test]
    fn a_run_that_was_killed_at_its_very_start_is_none() {
        let root = tempfile::tempdir().unwrap();
        let out = root.path();
        write_bytes(&out.join(".lobelia-abc.part.json"), b"{").unwrap();
        write_bytes(&out.join(".lobelia.lock"), b"").unwrap();
        check_used(out, false).unwrap();
        drop(begin(out, &["a.png"]));
        assert!(!out.join(".lobelia-abc.part.json").exists());
        std::fs::create_dir(out.join("else")).unwrap();
        write_bytes(&out.join("else/mine.txt"), b"x").unwrap();
        assert!(check_used(&out.join("else"), false).is_err());
    }

    #[test]
    fn files_of_a_killed_run_are_known_to_the_next() {
        let root = tempfile::tempdir().unwrap();
        let out = root.path();
        let mut record = begin(out, &["a.png", "never.png", "debug/"]);
        record.pass(0, RunState::Running, Vec::new()).unwrap();
        write_bytes(&out.join("novel/a.png"), b"x").unwrap();
        write_bytes(&out.join("novel/debug/1.png"), b"x").unwrap();
        drop(record);
        assert_eq!(Record::read(out).unwrap().state, RunState::Running);
        assert!(check_used(out, false).unwrap_err().to_string().contains("did not finish"));
        begin(out, &["a.png"]);
        assert!(!out.join("novel").exists(), "old results are gone before new ones come");
    }
}
