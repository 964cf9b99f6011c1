//! A run: the passes of a scene, from the check of the output folder to the last line of its
//! record.
//!
//! | module | holds |
//! | --- | --- |
//! | [`preflight`] | the files that a run reads and writes, and the checks before its first pass |
//! | [`memory`] | the memory that it may take, and the machine |
//! | `session` | what its passes share |
//! | `record` | `OUT/run.json`, which says what belongs together |
//! | `resume` | checkpoints in `OUT/.checkpoint`, from which a run goes on |
//! | [`progress`] | what it says on the way |
//! | [`summary`] | `OUT/report.html`, made of what is in the folder |

pub mod memory;
pub mod preflight;
pub mod progress;
pub(crate) mod record;
pub(crate) mod resume;
pub(crate) mod session;
pub mod summary;
#[cfg(test)]
mod tests;

use crate::pass::photograph::{camera_of, imagine};
use crate::pass::{evaluate, export, fit, render, save, shape, view};
use crate::scene::{
    CameraSpec, LightSource, Pass, Scene, Surface as SurfaceSpec, ViewPass, Views, unknown_parts,
};
use crate::survey::{Severity, Survey, open::OpenScene};
use crate::{scene::load::LoadedScene, spawn::SurfaceUse, spawn::load_light};
use lobelia_geometry::error::stop::{check_interrupted, finish_stopping, stopped_by};
use lobelia_geometry::parallel;
use lobelia_geometry::view::look::ViewLook;
use lobelia_geometry::{error::Error, error::Result, view::ViewRecord};
use lobelia_io::codec::file::{FolderLock, check_writable, clear_scratch};
use lobelia_io::dataset::load_notes;
use lobelia_solve::{fit::ObjectTurned, shade::device::ShadingDevice};
use lobelia_world::checkpoint::Checkpoints;
use preflight::Watched;
use progress::{Moment, Progress, RecordedMessages};
use record::{Claim, RunRecord, RunState};
use resume::RunStart;
use session::Session;
use std::{borrow::Cow, path::Path, path::PathBuf, time::Duration};
use summary::Reporter;
use tracing::info_span;

/// How a loaded scene is run.
#[derive(Clone, Debug, Default, PartialEq)]
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
}

/// Runs the passes of a scene in order, and reports to `progress`. What will be written is known
/// before anything is read, and `OUT/run.json` says how far the run is.
///
/// # Errors
/// The first error of a pass; passes that do not need it are run all the same, and the scores
/// written. [`Error::Interrupted`] if the run is stopped, once what it found is written.
/// [`Error::Usage`] if a file that would be written is an input, or is of something else than an
/// earlier run, if another run writes into the output folder, or if a run is to go on with
/// something else than it was begun with.
pub fn run(loaded: &LoadedScene, options: &RunOptions, progress: &dyn Progress) -> Result<()> {
    let told = RecordedMessages::new(progress);
    let progress: &dyn Progress = &told;
    let RunOptions { out, resume, .. } = options;

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
    let mut session = Session::open(&scene, views, options, progress, use_of, true)?;
    if let Some(survey) = survey {
        let warnings = survey.findings_of(Severity::Warning);
        session.scores.warnings = warnings.map(|warning| warning.problem.clone()).collect();
        if survey.is_turntable() {
            session.pipeline.world.insert_resource(ObjectTurned);
        }
    }
    check_interrupted()?;
    watched.check()?;
    // The files of views are read by now.
    let views = data.iter().flat_map(|data| &data.views);
    session.watched =
        watched.without(views.flat_map(|view| {
            view.pictures().map(|picture| picture.path).chain([view.plan.camera_file.clone()])
        }));
    session.report = Reporter::new(options.live);

    // The beginning, or the last checkpoint.
    let now = RunStart::new(&loaded.scene, session.scene, data, &inputs)?;
    let every = options.checkpoint_every.unwrap_or(resume::USUAL_TIME);
    let done = match &begun {
        Some(begun) => {
            begun.check_data(&now, progress)?;
            resume::take_up(&mut session, begun, true, every)?
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
    let mut record = claim.begin(loaded, &options.arguments, start.clone(), told.take(), done)?;
    if is_new {
        resume::take_up(&mut session, &start, false, every)?;
    }

    // The passes, and how the run ends. One that is not said to have finished needs its
    // checkpoints. The folder is its own until its report says how it ended.
    let ended = run_passes(&mut session, &mut record, &told, done);
    let finished = session.write_scores();
    if finished.is_ok() {
        progress.print(&session.scores.table());
        progress.print(&format!("Results are in {}.", out.display()));
    }
    let ended = record.end(ended.and(finished));
    let cleared = if ended.is_ok() { resume::clear(out) } else { Ok(()) };
    if ended.is_err() {
        if let Some(signal) = stopped_by() {
            progress.print(&format!("Stopped by {signal}; what was found until then is written."));
        }
        progress.print("The same command with --resume goes on from the last checkpoint.");
    }
    ended.and(session.report.write(out)).and(cleared)
}

/// Runs all passes after the first `done`, but those that need one that failed; scores and report
/// are written after each. Once the run is asked to stop, only what was found until then is
/// written: scored, saved and exported.
fn run_passes(
    session: &mut Session,
    record: &mut RunRecord,
    told: &RecordedMessages,
    done: usize,
) -> Result<()> {
    let passes = &session.scene.passes;
    // Those that failed or need one that did, and those that were stopped before their end.
    let (mut failed, mut stopped): (Vec<&Pass>, Vec<&Pass>) = Default::default();
    let mut first: Option<Error> = None;
    if done > 0 {
        session.write_scores()?;
    }
    session.report.write(&session.out)?;
    for (index, pass) in passes.iter().enumerate().skip(done) {
        let name = pass.name();
        if let Some(needed) = failed.iter().find(|failed| needs(pass, failed)) {
            told.note(&format!("pass {name} is left out: it needs {}", needed.name()));
            failed.push(pass);
            record.pass(index, RunState::Skipped, told.take())?;
            continue;
        }
        if stopped_by().is_some() {
            if !(session.kept.has_object && writes_results(pass, &stopped)) {
                stopped.push(pass);
                continue;
            }
            // The run may have been asked between two passes.
            finish_stopping();
        }
        record.pass(index, RunState::Running, Vec::new())?;
        told.moment(Moment::Pass { name, number: index + 1, count: passes.len() });
        let at_work = info_span!("pass", name = %format_args!("pass {name}")).entered();
        let ended = run_pass(session, pass);
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
        let recorded = record
            .pass(index, state, told.take())
            .and_then(|()| session.write_scores())
            .and_then(|()| session.report.write(&session.out));
        if recorded.is_err() {
            return first.map_or(recorded, Err);
        }
        if failed.is_empty() {
            resume::keep(session, Some(index + 1))?;
        } else {
            // A run that goes on repeats all from the first failure.
            session.pipeline.world.remove_resource::<Checkpoints>();
        }
    }
    first.or(stopped_by().map(|_| Error::Interrupted)).map_or(Ok(()), Err)
}

/// Whether a pass scores another.
fn scores(pass: &Pass, other: &Pass) -> bool {
    matches!(pass, Pass::Evaluate(pass) if pass.scores.iter().any(|score| score.pass == other.name()))
}

/// Whether a pass writes what was found when a run is stopped: it takes little time, and all that
/// it needs is there.
fn writes_results(pass: &Pass, stopped: &[&Pass]) -> bool {
    matches!(pass, Pass::Save(_) | Pass::Export(_) | Pass::Evaluate(_))
        && !stopped.iter().any(|stopped| scores(pass, stopped))
}

/// Whether a pass has nothing to work with where an earlier one failed: everything after what finds
/// the object, scores after their pictures.
fn needs(pass: &Pass, failed: &Pass) -> bool {
    matches!(failed, Pass::Fit(_) | Pass::Shape(_)) || scores(pass, failed)
}

fn run_pass(session: &mut Session, pass: &Pass) -> Result<()> {
    match pass {
        Pass::Fit(pass) => fit::run(session, pass),
        Pass::Shape(pass) => shape::run(session, pass),
        Pass::Render(of) | Pass::Edit(of) | Pass::Relight(of) => render::run(session, pass, &of.render),
        Pass::Evaluate(pass) => {
            // A truth that has changed is told of, instead of scores that are half of one and half
            // of the other.
            session.watched.check()?;
            evaluate::run(session, pass)
        }
        Pass::Save(pass) => save::run(session, pass),
        Pass::Export(pass) => export::run(session, pass),
        Pass::View(pass) => view::run(session, pass),
    }
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
    progress: &dyn Progress,
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
    let views = OpenScene::new(&scene).and_then(|data| Ok(read_views(&scene, data.as_ref(), progress)?.0));
    let views = match views {
        Ok(views) => views,
        Err(error) => {
            check_interrupted()?;
            progress.note(&format!("the page has neither photographs nor their cameras: {error}"));
            Vec::new()
        }
    };
    let out = path.parent().unwrap_or(Path::new("")).to_owned();
    let options = RunOptions { out, force: true, ..RunOptions::default() };
    let mut session = Session::open(&scene, views, &options, progress, SurfaceUse::Lasting, false)?;
    view::write_page(&mut session, pass, named, path)
}

/// Does the work of [`run`] before the first pass of a scene, without any photograph: the files
/// that the scene names are read and checked, no pass is run, no hull of an unknown surface is
/// made, and nothing is written. `views` are those of a data set
/// ([`survey`](crate::survey::open::survey)), if the scene has one.
///
/// # Errors
/// Errors of [`run`] before its first pass.
pub fn rehearse(scene: &Scene, mut views: Vec<ViewRecord>, progress: &dyn Progress) -> Result<()> {
    if let Views::Cameras(specs) = &scene.views {
        views = bare_views(specs)?;
    }
    Session::open(scene, views, &RunOptions::default(), progress, SurfaceUse::Checks, false).map(drop)
}

/// Reads the views that do not depend on the object; rendered photographs come later. Those of a
/// data set that passes learn from or are scored against are surveyed: a warning is a note, the
/// first error ends the run.
///
/// # Errors
/// [`Error::Usage`] for the first thing that cannot work; those of reading photographs and masks.
fn read_views(
    scene: &Scene,
    data: Option<&OpenScene>,
    progress: &dyn Progress,
) -> Result<(Vec<ViewRecord>, Option<Survey>)> {
    let _reading = info_span!("photographs read").entered();
    let data = match (&scene.views, data) {
        (Views::Dataset(_), Some(data)) => data,
        (Views::Cameras(specs), _) => return Ok((bare_views(specs)?, None)),
        (Views::Photographed(_) | Views::Dataset(_), _) => return Ok((Vec::new(), None)),
    };
    let learns = |pass: &Pass| matches!(pass, Pass::Fit(_) | Pass::Shape(_) | Pass::Evaluate(_));
    let is_used = matches!(scene.surface, SurfaceSpec::Unknown { .. }) || scene.passes.iter().any(learns);
    let bar = progress.bar("photographs", data.views.len() as u64);
    let read: Vec<Result<_>> = parallel::map_slice(&data.views, 1, |view| {
        check_interrupted()?;
        let loaded = data.load(view)?;
        let look = is_used.then(|| data.look(view, &loaded));
        bar.inc(1);
        Ok((loaded, look))
    });
    // The first error, in the order of the views, ends it.
    let (loaded, looks): (Vec<_>, Vec<_>) = read.into_iter().collect::<Result<Vec<_>>>()?.into_iter().unzip();
    bar.finish_and_clear();
    data.notes.iter().chain(&load_notes(&loaded)).for_each(|note| progress.note(note));
    let survey = is_used.then(|| data.examine(looks.into_iter().flatten().collect())).transpose()?;
    if let Some(survey) = &survey {
        survey.findings_of(Severity::Warning).for_each(|warning| progress.note(&warning.problem));
        survey.findings_of(Severity::Error).next().map_or(Ok(()), |error| Err(error.to_error()))?;
    }
    Ok((loaded.into_iter().map(|view| view.record).collect(), survey))
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

fn bare_views(specs: &[CameraSpec]) -> Result<Vec<ViewRecord>> {
    let view = |of: &CameraSpec| Ok(ViewRecord::of_camera(of.name.clone(), of.split, camera_of(of)?));
    specs.iter().map(view).collect()
}
