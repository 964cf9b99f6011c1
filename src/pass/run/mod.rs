//! A run: the passes of a scene, from the check of the output folder to the last line of its
//! record.
//!
//! | module | holds |
//! | --- | --- |
//! | [`preflight`] | the files that a run reads and writes, and the checks before its first pass |
//! | [`memory`] | the memory that it may take, and the machine |
//! | `record` | `OUT/run.json`, which says what belongs together |
//! | `resume` | checkpoints in `OUT/.checkpoint`, from which a run goes on |
//! | [`summary`] | `OUT/report.html`, made of what is in the folder |

pub mod memory;
pub mod preflight;
pub(crate) mod record;
pub(crate) mod resume;
pub mod summary;
#[cfg(test)]
mod tests;

use crate::object::Object;
use crate::object::photograph::imagine;
use crate::pass::{evaluate, fit, render, view};
use crate::progress::{Progress, RecordedMessages, Step};
use crate::scene::{EvaluatePass, LightSource, Pass, Scene, ViewPass, Views, unknown_parts};
use crate::spawn::{SurfaceUse, load_light, make_surface};
use crate::survey::{Severity, Survey, open::OpenScene};
use crate::{
    capture::bare_views, capture::read_views, report::RunState, report::scores::peak_rss_mib,
    scene::load::LoadedScene,
};
use bevy_ecs::prelude::World;
use lobelia_geometry::error::stop::{
    Stop, check_interrupted, finish_stopping, stopped_by, was_asked_to_stop,
};
use lobelia_geometry::view::look::ViewLook;
use lobelia_geometry::{error::Error, error::Result, view::ViewRecord};
use lobelia_io::codec::file::{FolderLock, check_writable, clear_scratch};
use lobelia_solve::{fit::ObjectTurned, fit::guard::StepGuard, shade::device::ShadingDevice};
use lobelia_world::checkpoint::{Checkpoints, keep_pass};
use preflight::Watched;
use record::{Claim, RunRecord};
use resume::RunStart;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::{borrow::Cow, path::Path, path::PathBuf, time::Duration};
use summary::Reporter;
use tracing::info_span;

/// A pass of a program's own.
#[derive(Clone)]
pub struct OwnPass {
    /// Its name, that of its folder in `OUT`; no other pass of the run has it.
    pub name: String,
    /// The files that it may write into its folder; one that ends with `/` is a folder.
    pub files: Vec<String>,
    /// Its work, with its folder, which is not there yet.
    pub work: Arc<PassWork>,
}

/// The work of a pass.
pub type PassWork = dyn Fn(&mut Object, &Path) -> Result<()> + Send + Sync;

/// How a loaded scene is run.
#[derive(Clone, Default)]
pub struct RunOptions {
    /// The output folder.
    pub out: PathBuf,
    /// Replace what an earlier run wrote into `out`.
    pub force: bool,
    /// Steps of a `Shape` between two looks at it, if it is looked at.
    pub debug_every: Option<u32>,
    /// Memory that the run may take, in bytes; `None`: as much as it takes.
    pub memory: Option<u64>,
    /// The command line, for the manifest.
    pub arguments: Vec<String>,
    /// Time between two checkpoints in the steps of a `Fit`; `None`: a minute.
    pub checkpoint_every: Option<Duration>,
    /// Go on with the run in `out`, if there is one that has not finished.
    pub resume: bool,
    /// The device of closed-form shading; `None`: this processor.
    pub device: Option<ShadingDevice>,
    /// Write the report every few seconds while a fit or shape is found, as a page that loads
    /// itself again.
    pub live: bool,
    /// Passes that run after those of the scene.
    pub own: Vec<OwnPass>,
}

/// The scores of a run, in its output folder.
pub(crate) const METRICS: &str = "metrics.json";

/// Runs the passes of a scene in order, and reports to `progress`. What will be written is known
/// before anything is read, and `OUT/run.json` says how far the run is.
///
/// # Errors
/// The first error of a pass; passes that do not need it are run all the same, and the scores
/// written. [`Error::Interrupted`] if the run is stopped, once what it found is written.
/// [`Error::Usage`] if a file that would be written is an input, or is of something else than an
/// earlier run, if another run writes into the output folder, or if a run is to go on with
/// something else than it was begun with.
pub fn run(loaded: &LoadedScene, options: &RunOptions, progress: Arc<dyn Progress>) -> Result<()> {
    Stop::current().over(|| run_in_folder(loaded, options, progress))
}

fn run_in_folder(loaded: &LoadedScene, options: &RunOptions, progress: Arc<dyn Progress>) -> Result<()> {
    let RunOptions { out, resume, debug_every, .. } = options;
    // Steps are shown in the report, if that is watched, and by the pictures of `debug_every`.
    let reporter = Arc::new(Mutex::new(Reporter::new(options.live)));
    let (live, folder, every) = (reporter.clone(), out.clone(), *debug_every);
    let show = move |at: &Step, world: &mut World| {
        locked(&live).step(&folder, at, world);
        let is_shown = every.is_some_and(|every| at.fit.step.is_multiple_of(every));
        if is_shown { fit::look(&folder, at, world) } else { Ok(()) }
    };
    let told = Arc::new(RecordedMessages::new(progress).watching(Box::new(show)));
    let progress: &dyn Progress = &*told;

    // The folder: may this run write there, and is there one to go on with?
    resume::check_folder(out)?;
    record::check_used(out, options.force || *resume)?;
    let before = if *resume { record::resumed(out, loaded)? } else { None };
    if before.as_ref().is_some_and(|before| before.state == RunState::Finished) {
        // A process that was killed at its very end has left its lock, checkpoints, a report that
        // says that it runs, and half of a new one. None of these is worth an error.
        if let Ok(_lock) = FolderLock::take(out) {
            let _ = clear_scratch(out).and(resume::clear(out));
            let _ = Reporter::default().write(out);
        }
        progress.note(&format!("the run in {} has finished: nothing is left to do", out.display()));
        return Ok(());
    }
    let begun = before.map(|before| before.start);

    // The scene, before anything that it names is read. Then the folder is taken.
    begun.as_ref().map_or(Ok(()), |begun| begun.check_scene(&loaded.scene))?;
    check_writable(out)?;
    loaded.scene.passes.iter().try_for_each(|pass| check_writable(&out.join(pass.name())))?;
    preflight::check_sizes(&loaded.scene)?;
    let data = OpenScene::new(&loaded.scene)?;
    let data = data.as_ref();
    let claim = Claim::new(loaded, data, options)?;

    // The inputs. What passes read later must stay as it is now.
    let inputs = preflight::contents(loaded, data);
    let watched = Watched::new(inputs.iter().cloned());
    let (views, survey) = read_views(&loaded.scene, data, progress)?;
    let looks = looks(&loaded.scene, survey.as_ref())?;
    let scene = memory::within(&loaded.scene, &looks, options.memory, progress)?;
    let is_draft = matches!(scene.passes.first(), Some(Pass::Shape(_)));
    let use_of = if is_draft { SurfaceUse::UntilShape } else { SurfaceUse::Lasting };
    let made = make_surface(&scene.surface, &views, use_of)?;
    let mut object = Object::of_scene(scene.into_owned(), made, views, told.clone(), true)?;
    options.device.clone().into_iter().for_each(|device| object.pipeline.world.insert_resource(device));
    preflight::check_passes(&mut object)?;
    if let Some(survey) = survey {
        let warnings = survey.findings_of(Severity::Warning);
        object.scores().warnings = warnings.map(|warning| warning.problem.clone()).collect();
        if survey.is_turntable() {
            object.pipeline.world.insert_resource(ObjectTurned);
        }
    }
    check_interrupted()?;
    watched.check()?;
    // The files of views are read by now.
    let views = data.iter().flat_map(|data| &data.views);
    let watched =
        watched.without(views.flat_map(|view| {
            view.pictures().map(|picture| picture.path).chain([view.plan.camera_file.clone()])
        }));

    // The beginning, or the last checkpoint.
    let now = RunStart::new(&loaded.scene, &object.scene(), data, &inputs)?;
    let every = options.checkpoint_every.unwrap_or(resume::USUAL_TIME);
    let done = match &begun {
        Some(begun) => {
            begun.check_data(&now, progress)?;
            resume::take_up(&mut object, out, begun, true, every)?
        }
        None => {
            if *resume {
                progress.note("there is no checkpoint to go on from: the run begins");
            }
            // Checkpoints of an earlier run go first: its results will, and nothing goes on from
            // there.
            resume::clear(out)?;
            0
        }
    };
    let is_new = begun.is_none();
    let start = begun.unwrap_or(now);
    let record = claim.begin(loaded, &options.arguments, start.clone(), told.take(), done)?;
    let mut run = Run { out, own: &options.own, told: &told, reporter: &reporter, watched, record };
    if is_new {
        resume::take_up(&mut object, out, &start, false, every)?;
    }

    // The passes, and how the run ends. One that is not said to have finished needs its
    // checkpoints. The folder is its own until its report says how it ended.
    let ended = run_passes(&mut object, &mut run, done);
    let finished = write_scores(&mut object, out);
    if finished.is_ok() {
        progress.print(&object.scores().table());
        progress.print(&format!("Results are in {}.", out.display()));
    }
    let ended = run.record.end(ended.and(finished));
    let cleared = if ended.is_ok() { resume::clear(out) } else { Ok(()) };
    if ended.is_err() {
        if let Some(signal) = stopped_by() {
            progress.print(&format!("Stopped by {signal}; what was found until then is written."));
        }
        progress.print("The same command with --resume goes on from the last checkpoint.");
    }
    ended.and(run.report()).and(cleared)
}

/// What surrounds the passes of a run.
struct Run<'a> {
    out: &'a Path,
    own: &'a [OwnPass],
    told: &'a RecordedMessages,
    reporter: &'a Mutex<Reporter>,
    /// The files that passes read when they run, as they were when the run began.
    watched: Watched,
    record: RunRecord,
}

impl Run<'_> {
    /// Writes the report.
    fn report(&self) -> Result<()> {
        locked(self.reporter).write(self.out)
    }
}

fn locked(reporter: &Mutex<Reporter>) -> MutexGuard<'_, Reporter> {
    reporter.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Runs all passes after the first `done`, but those that need one that failed; scores and report
/// are written after each. Once the run is asked to stop, only what was found until then is
/// written: scored, saved and exported.
fn run_passes(object: &mut Object, run: &mut Run, done: usize) -> Result<()> {
    let (scene, out, told) = (object.scene(), run.out, run.told);
    let passes: Vec<_> = scene.passes.iter().map(Work::Scene).chain(run.own.iter().map(Work::Own)).collect();
    // Those that failed or need one that did, and those that were stopped before their end.
    let (mut failed, mut stopped): (Vec<Work>, Vec<Work>) = Default::default();
    let mut first: Option<Error> = None;
    if done > 0 {
        write_scores(object, out)?;
    }
    run.report()?;
    for (index, pass) in passes.iter().copied().enumerate().skip(done) {
        let name = pass.name();
        if let Some(needed) = failed.iter().find(|failed| pass.needs(**failed)) {
            told.note(&format!("pass {name} is left out: it needs {}", needed.name()));
            failed.push(pass);
            run.record.pass(index, RunState::Skipped, told.take())?;
            continue;
        }
        if was_asked_to_stop() {
            if !(object.found().has_object && pass.writes_results(&stopped)) {
                stopped.push(pass);
                continue;
            }
            // The run may have been asked between two passes.
            finish_stopping();
        }
        run.record.pass(index, RunState::Running, Vec::new())?;
        told.pass(name, index + 1, passes.len());
        let at_work = info_span!("pass", name = %format_args!("pass {name}")).entered();
        let ended = run_pass(object, run, pass);
        drop(at_work);
        finish_stopping();
        let state = RunState::of(&ended);
        match ended {
            Ok(()) => {}
            Err(Error::Interrupted) => stopped.push(pass),
            Err(error) => {
                match &first {
                    None => told.note(&format!("pass {name} failed; what does not need it goes on")),
                    Some(_) => told.note(&format!("pass {name} failed: {error}")),
                }
                failed.push(pass);
                first.get_or_insert(error);
            }
        }
        // On a full disk this fails as well, and ends the run.
        let _after = info_span!("scores, report, checkpoint").entered();
        let recorded = run
            .record
            .pass(index, state, told.take())
            .and_then(|()| write_scores(object, out))
            .and_then(|()| run.report());
        if recorded.is_err() {
            return first.map_or(recorded, Err);
        }
        if failed.is_empty() {
            keep_pass(&mut object.pipeline.world, index as u32 + 1)?;
        } else {
            // A run that goes on repeats all from the first failure.
            object.pipeline.world.remove_resource::<Checkpoints>();
        }
    }
    first.or(was_asked_to_stop().then_some(Error::Interrupted)).map_or(Ok(()), Err)
}

/// A pass of the scene, or of the program.
#[derive(Clone, Copy)]
enum Work<'a> {
    Scene(&'a Pass),
    Own(&'a OwnPass),
}

impl Work<'_> {
    fn name(&self) -> &str {
        match self {
            Self::Scene(pass) => pass.name(),
            Self::Own(pass) => &pass.name,
        }
    }

    /// Whether it scores another.
    fn scores(self, other: Self) -> bool {
        let scores = |pass: &EvaluatePass| pass.scores.iter().any(|score| score.pass == other.name());
        matches!(self, Self::Scene(Pass::Evaluate(pass)) if scores(pass))
    }

    /// Whether it writes what was found when a run is stopped: it takes little time, and all that
    /// it needs is there.
    fn writes_results(self, stopped: &[Self]) -> bool {
        matches!(self, Self::Scene(Pass::Save(_) | Pass::Export(_) | Pass::Evaluate(_)))
            && !stopped.iter().any(|stopped| self.scores(*stopped))
    }

    /// Whether it has nothing to work with where an earlier one failed: everything after what finds
    /// the object, scores after their pictures.
    fn needs(self, failed: Self) -> bool {
        matches!(failed, Self::Scene(Pass::Fit(_) | Pass::Shape(_))) || self.scores(failed)
    }
}

fn run_pass(object: &mut Object, run: &Run, pass: Work) -> Result<()> {
    let out = run.out;
    let pass = match pass {
        Work::Scene(pass) => pass,
        Work::Own(pass) => return (pass.work)(object, &out.join(&pass.name)),
    };
    match pass {
        Pass::Fit(pass) => fit::run(object, out, pass),
        Pass::Shape(pass) => fit::run_shape(object, out, pass),
        Pass::Render(of) | Pass::Edit(of) | Pass::Relight(of) => render::run(object, out, pass, &of.render),
        Pass::Evaluate(pass) => {
            // A truth that has changed is told of, instead of scores that are half of one and half
            // of the other.
            run.watched.check()?;
            evaluate::run(object, out, pass)
        }
        Pass::Save(pass) => {
            let folder = out.join(&pass.name);
            object.shown_by(pass.of.as_deref()).save(&folder)?;
            object.print(&format!("{}: {}", pass.name, folder.join("scene.ron").display()));
            Ok(())
        }
        Pass::Export(pass) => {
            let written = object.shown_by(pass.of.as_deref()).export_as(pass, &out.join(&pass.name))?;
            written.iter().for_each(|path| object.print(&format!("{}: {}", pass.name, path.display())));
            Ok(())
        }
        Pass::View(pass) => view::run(object, out, pass),
    }
}

fn write_scores(object: &mut Object, out: &Path) -> Result<()> {
    let guard = object.pipeline.world.get_resource::<StepGuard>();
    let taken_back = guard.map_or(0, |guard| guard.taken_back);
    let mut scores = object.scores();
    (scores.steps_taken_back, scores.peak_rss_mib) = (taken_back, peak_rss_mib());
    scores.write_json(out.join(METRICS))
}

/// Writes the page of a scene in which everything is known, as `Save` writes it, to `path`; no pass
/// of the scene is run, and nothing else is written. The page offers these lights besides the
/// scene's own, by name, and has the photographs of `pass` if the data set can be read; if not, a
/// note says why.
///
/// # Errors
/// [`Error::Usage`] if something is unknown; those of [`run`] before its first pass; those of the
/// page.
pub fn write_view(
    loaded: &LoadedScene,
    lights: &[(String, LightSource)],
    pass: &ViewPass,
    path: &Path,
    progress: Arc<dyn Progress>,
) -> Result<()> {
    if let Some(part) = unknown_parts(&loaded.scene).first() {
        let problem = format!("the {part} of {} is unknown", loaded.path.display());
        return Err(Error::usage(problem, "Run the scene; a `Save` pass writes one in which all is known."));
    }
    let scene = Scene { passes: Vec::new(), ..loaded.scene.clone() };
    let mut named = Vec::new();
    for (name, source) in lights {
        let light = load_light(source)?;
        light.notes.iter().for_each(|note| progress.note(note));
        named.push((name.clone(), light.lobes));
    }
    let views = OpenScene::new(&scene).and_then(|data| Ok(read_views(&scene, data.as_ref(), &*progress)?.0));
    let views = match views {
        Ok(views) => views,
        Err(error) => {
            check_interrupted()?;
            progress.note(&format!("the page has neither photographs nor their cameras: {error}"));
            Vec::new()
        }
    };
    let out = path.parent().unwrap_or(Path::new("")).to_owned();
    let made = make_surface(&scene.surface, &views, SurfaceUse::Lasting)?;
    let mut object = Object::of_scene(scene, made, views, progress, false)?;
    view::write_page(&mut object, &out, pass, named, path)
}

/// Does the work of [`run`] before the first pass of a scene, without any photograph: the files
/// that the scene names are read and checked, no pass is run, no hull of an unknown surface is
/// made, and nothing is written. `views` are those of a data set
/// ([`survey`](crate::survey::open::survey)), if the scene has one.
///
/// # Errors
/// Errors of [`run`] before its first pass.
pub fn rehearse(scene: &Scene, mut views: Vec<ViewRecord>, progress: Arc<dyn Progress>) -> Result<()> {
    if let Views::Cameras(specs) = &scene.views {
        views = bare_views(specs)?;
    }
    let made = make_surface(&scene.surface, &views, SurfaceUse::Checks)?;
    let mut object = Object::of_scene(scene.clone(), made, views, progress, false)?;
    preflight::check_passes(&mut object)
}

/// The views of a scene as a survey has seen them; those that are not of a data set are known by
/// their sizes.
///
/// # Errors
/// If a camera cannot be used.
pub fn looks<'a>(scene: &Scene, survey: Option<&'a Survey>) -> Result<Cow<'a, [ViewLook]>> {
    if let Some(survey) = survey {
        return Ok(Cow::Borrowed(&survey.looks));
    }
    let views = match &scene.views {
        Views::Cameras(specs) => bare_views(specs)?,
        Views::Photographed(spec) => imagine(spec, scene)?,
        Views::Dataset(_) => Vec::new(),
    };
    Ok(views.iter().map(ViewLook::unseen).collect())
}
