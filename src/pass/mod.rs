//! The passes of a scene file, one module per kind, and the function that runs them.
//!
//! | pass | file | writes into `OUT/<name>/` |
//! | --- | --- | --- |
//! | `Fit` | `fit` | the recovered light (`light.npy`, `environment.exr`), `albedo.png`, `materials.ron`, `log.csv`; of several base materials `blend.exr`, `.png`, with one roughness per texel `roughness.exr`, `.png` |
//! | `Shape` | `shape` | with `--debug-every N`, normals, depth and mesh every N steps |
//! | both | `found_views` | `cam_dict_norm.json` of optimized cameras, `exposures.csv` |
//! | `Render`, `Edit`, `Relight` | [`render`] | an EXR with layers and a PNG per view, the animation of an orbit |
//! | `Evaluate` | [`evaluate`] | a contact sheet, `views.csv`, and a folder per scored pass with small pictures of its views; scores go to `OUT/metrics.json` |
//! | `Save` | [`save`] | `scene.ron` with side files |
//! | `Export` | [`export`] | `mesh.glb`, `mesh.ply`, `mesh.obj`, `mesh.usda`, `mesh.usdz` with their textures; the light as `.hdr`; a page |
//! | `View` | [`view`] | `view.html` |
//!
//! `resume` keeps checkpoints in `OUT/.checkpoint`, and takes a run up where it was. `renew` leaves the pools of a `Shape` or `Fit` behind.
//!
//! [`preflight`] checks the inputs of all passes before the first one runs; [`files`] knows all files that they may write, so that
//! none of them is one that is read; `record` keeps `OUT/run.json`, which says what belongs together; [`summary`] makes `OUT/report.html`
//! of what is in the folder. [`live`] copies and renders the state during a pass, for whoever looks at a run.

mod detail;
pub mod edit;
pub mod evaluate;
pub mod export;
#[cfg(test)]
mod fault_tests;
pub mod files;
mod film;
pub(crate) mod fit;
mod found_views;
mod gloss;
mod inputs;
pub(crate) mod inspect;
mod lend;
pub mod live;
mod machine;
pub mod memory;
mod memory_limits;
mod ndf;
mod page_cameras;
pub mod photograph;
mod placements;
pub mod preflight;
pub mod progress;
mod reading;
pub(crate) mod record;
pub mod render;
mod renew;
mod resume;
pub mod save;
mod sequence;
mod session;
mod shading;
pub(crate) mod shape;
pub(crate) mod show;
mod steps;
pub mod summary;
mod truth_files;
pub mod view;
mod view_photographs;
mod view_report;

pub use session::{Placed, SceneLights, Session};

use crate::codec::file::{FileUse, FolderLock, check_apart, check_room, clear_scratch};
use crate::error::stop::{HeldStops, check_interrupted, stopped_by};
use crate::error::{Error, Result};
use crate::fit::ObjectTurned;
use crate::mesh::Surface;
use crate::profile::{Profiler, stage};
use crate::ranks::Ranks;
use crate::scene::Pass;
use crate::scene::load::LoadedScene;
use crate::scene::{CameraSpec, LightSource, Photographed, Scene, ViewPass, Views, unknown_parts};
use crate::shade::device::ShadingDevice;
use crate::spawn::{SurfaceUse, load_light, make_surface, spawn};
use crate::survey::estimate::written_bytes;
use crate::survey::look::ViewLook;
use crate::survey::open::OpenScene;
use crate::survey::{Severity, Survey};
use crate::view::ViewRecord;
use inputs::Watched;
use memory::Sharing;
use photograph::{TrueObject, camera_of};
use placements::check_placements;
use progress::{Progress, RecordedMessages};
use record::{Claim, RunRecord};
use resume::RunStart;
use std::borrow::Cow;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;
use summary::Reporter;

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
    /// Processes among `ranks` that divide this memory, as those of one machine do; each may take all of it if there are fewer than two.
    pub memory_shared_by: usize,
    /// The command line, for the manifest.
    pub arguments: Vec<String>,
    /// Time between two checkpoints of a pass that takes long; `None`: no checkpoints.
    pub checkpoint: Option<Duration>,
    /// Go on with the run in `out`, if there is one that has not finished.
    pub resume: bool,
    /// With `resume`: a run in `out` that kept no checkpoints begins again, and what it has written goes.
    pub begin_again: bool,
    /// The device of closed-form shading; `None`: this processor.
    pub device: Option<ShadingDevice>,
    /// Whether to measure where the time goes.
    pub profile: Profiling,
    /// The processes that share the work of a fit; each has a folder of its own. `None`: this one alone.
    pub ranks: Option<Ranks>,
}

/// Whether a run measures where its time goes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub enum Profiling {
    /// It does not.
    #[default]
    Off,
    /// A table at its end, and the section `profile` of `metrics.json`.
    Table,
    /// The same, and `OUT/trace.json`, which Perfetto opens.
    Trace,
}

/// Time between two checkpoints where nothing is said.
pub(crate) const USUAL_CHECKPOINT: Duration = Duration::from_secs(30);

/// Runs the passes of a scene in order, and reports to `progress`. What will be written is known before anything is read, and
/// `OUT/run.json` says how far the run is.
///
/// # Errors
/// The first error of a pass; passes that do not need it are run all the same, and the scores written. [`Error::Interrupted`] if the run is
/// stopped, once what it found is written. [`Error::Usage`] if a file that would be written is an input, or is of something else than an
/// earlier run, if another run writes into the output folder, or if a run is to go on with something else than it was begun with.
pub fn run(loaded: &LoadedScene, options: &RunOptions, progress: &dyn Progress) -> Result<()> {
    let profiler = match options.profile {
        Profiling::Off => return run_passes(loaded, options, progress, None),
        Profiling::Table => Profiler::new(false),
        Profiling::Trace => Profiler::new(true),
    };
    profiler.during(|| run_passes(loaded, options, progress, Some(profiler.clone())))
}

/// [`run`], under its profiler.
fn run_passes(
    loaded: &LoadedScene,
    options: &RunOptions,
    progress: &dyn Progress,
    profiler: Option<Profiler>,
) -> Result<()> {
    let told = RecordedMessages::new(progress);
    let progress: &dyn Progress = &told;
    resume::check_folder(&options.out)?;
    let kept = RunStart::read(&options.out);
    let has_checkpoints = !matches!(kept, Ok(None));
    record::check_used(&options.out, options.force || options.resume, has_checkpoints)?;
    let has_finished = options.resume
        && record::check_resumed(&options.out, loaded, has_checkpoints || options.begin_again)?;
    let begun = if options.resume && !has_finished { kept? } else { None };
    let ranks = agreed_ranks(loaded, options, begun.as_ref(), has_finished)?;
    if has_finished {
        leave_finished(&options.out, progress);
        return Ok(());
    }
    check_unread(loaded, options, begun.as_ref())?;
    let data = OpenScene::new(&loaded.scene, loaded.roots.as_deref())?;
    let claim = claim(loaded, data.as_ref(), options)?;
    let watched = Watched::new(files::contents(loaded, data.as_ref()));
    // Processes that read photographs together also stop together; the session holds stops after them.
    let held_stops = ranks.filter(|_| data.is_some()).map(|_| HeldStops::new());
    let (views, survey) = read_views(&loaded.scene, data.as_ref(), ranks, progress)?;
    let scene = within_limits(&loaded.scene, survey.as_ref(), options, progress)?;
    let mut session = open(&scene, views, options, progress, photograph::take, use_of(&scene))?;
    if let Some(survey) = survey {
        take_in(&mut session, &survey);
    }
    drop(held_stops);
    check_interrupted()?;
    watched.check()?;
    (session.watched, session.profiler) = (watched, profiler);
    let (record, done) = begin(&mut session, claim, loaded, data.as_ref(), options, begun)?;
    run_to_end(session, record, options, &told, done)
}

/// The processes that carry out the run, if they are several: they begin alike.
fn agreed_ranks<'a>(
    loaded: &LoadedScene,
    options: &'a RunOptions,
    begun: Option<&RunStart>,
    has_finished: bool,
) -> Result<Option<&'a Ranks>> {
    let Some(ranks) = options.ranks.as_ref().filter(|ranks| ranks.size() > 1) else { return Ok(None) };
    let memory = format!("{:?} bytes, shared by {}", options.memory, options.memory_shared_by);
    resume::agree(ranks, loaded, (&options.out, memory), begun, has_finished)?;
    Ok(Some(ranks))
}

/// Checks a scene before anything that it names is read; one that goes on must be as it was when the run was `begun`.
fn check_unread(loaded: &LoadedScene, options: &RunOptions, begun: Option<&RunStart>) -> Result<()> {
    begun.map_or(Ok(()), |begun| begun.check_scene(&loaded.scene))?;
    preflight::check_output(&loaded.scene, &options.out)?;
    preflight::check_sizes(&loaded.scene)?;
    preflight::check_paths(&loaded.scene)?;
    files::check_within(loaded)
}

/// The scene with pools that keep to the memory that the run may take. What a new run writes must have room on the disk.
fn within_limits<'a>(
    scene: &'a Scene,
    survey: Option<&Survey>,
    options: &RunOptions,
    progress: &dyn Progress,
) -> Result<Cow<'a, Scene>> {
    let looks = looks(scene, survey)?;
    let processes = options.ranks.as_ref().map_or(1, Ranks::size);
    let sharing = Sharing { processes, of_memory: options.memory_shared_by };
    let scene = memory::within(scene, &looks, options.memory, sharing, progress)?;
    // Other processes than the first write nothing that stays.
    let writes = options.ranks.as_ref().is_none_or(|ranks| ranks.rank() == 0);
    if writes && !options.resume {
        check_room(&options.out, written_bytes(&looks, &scene) as u64)?;
    }
    Ok(scene)
}

/// Takes into a session what a survey has found in the photographs: warnings, and whether the object turns before the camera.
fn take_in(session: &mut Session, survey: &Survey) {
    let warnings = survey.findings_of(Severity::Warning);
    session.scores.warnings = warnings.map(|warning| warning.problem.clone()).collect();
    if survey.is_turntable() {
        session.pipeline.world.insert_resource(ObjectTurned);
    }
}

/// Runs the passes after the first `done`, and writes how the run ended into its manifest and its report.
fn run_to_end(
    mut session: Session,
    mut record: RunRecord,
    options: &RunOptions,
    told: &RecordedMessages,
    done: usize,
) -> Result<()> {
    let mut report = Reporter::default();
    let ended = sequence::run(&mut session, &mut record, &mut report, told, done);
    let finished = session.finish();
    let ended = ended.and(finished);
    // A run that is not said to have finished needs its checkpoints. The folder is its own until its report says how it ended.
    let ended = record.end(ended);
    let cleared = match &ended {
        Ok(()) => resume::clear(&options.out),
        Err(_) => {
            say_how_to_go_on(options, told);
            Ok(())
        }
    };
    ended.and(report.write(&options.out)).and(cleared)
}

/// Says that a run that is to go on has finished.
fn leave_finished(out: &Path, progress: &dyn Progress) {
    // A process that was killed at its very end has left its lock, checkpoints, a report that says that it runs, and half of a new one. None
    // of these is worth an error.
    if let Ok(_lock) = FolderLock::take(out) {
        let _ = clear_scratch(out).and(resume::clear(out));
        let _ = Reporter::default().write(out);
    }
    progress.note(&format!("the run in {} has finished: nothing is left to do", out.display()));
}

/// Begins a run, or goes on with one that was `begun`. Returns its manifest, and how many of its passes are done.
fn begin(
    session: &mut Session,
    claim: Claim,
    loaded: &LoadedScene,
    data: Option<&OpenScene>,
    options: &RunOptions,
    begun: Option<RunStart>,
) -> Result<(RunRecord, usize)> {
    let keeps = options.checkpoint.is_some() || begun.is_some();
    let now =
        keeps.then(|| RunStart::new(&loaded.scene, session.scene, data, &files::contents(loaded, data)));
    let (now, every) = (now.transpose()?, options.checkpoint.unwrap_or(USUAL_CHECKPOINT));
    if let (Some(begun), Some(now)) = (&begun, &now) {
        begun.check_data(now, session.progress)?;
        let done = resume::take_up(session, begun, true, every)?;
        let mut record = claim.begin(loaded, &options.arguments, done)?;
        record.reads(now.inputs());
        return Ok((record, done));
    }
    if options.resume {
        session.progress.note("there is no checkpoint to go on from: the run begins");
    }
    // Checkpoints of an earlier run go first: its results will, and nothing goes on from there.
    resume::clear(&options.out)?;
    let mut record = claim.begin(loaded, &options.arguments, 0)?;
    if let Some(now) = now {
        now.write(&options.out)?;
        record.reads(now.inputs());
        resume::take_up(session, &now, false, every)?;
    }
    Ok((record, 0))
}

/// What can be done with a run that has not finished.
fn say_how_to_go_on(options: &RunOptions, progress: &dyn Progress) {
    if let Some(signal) = stopped_by() {
        progress.print(&format!("Stopped by {signal}; what was found until then is written."));
    }
    if options.checkpoint.is_some() {
        progress.print("The same command with --resume goes on from the last checkpoint.");
    }
}

/// Takes the output folder, once it is clear that nothing in it is read or somebody else's.
fn claim(loaded: &LoadedScene, data: Option<&OpenScene>, options: &RunOptions) -> Result<Claim> {
    let plan = files::outputs(&loaded.scene, data, options.debug_every);
    let used = |name: &str, by: String| FileUse::new(options.out.join(name), by);
    let of_passes =
        plan.iter().flat_map(|pass| pass.files.iter().map(|file| used(file, format!("pass {}", pass.pass))));
    let of_run = record::OF_RUN.into_iter().chain([files::RUN]).map(|name| used(name, "the run".to_owned()));
    let outputs: Vec<FileUse> = of_passes.chain(of_run).collect();
    let help = "Choose another folder with --out, or give the pass another name. Inputs are never replaced, --force or not.";
    files::check_outputs(loaded, data, &outputs, help)?;
    let claim = Claim::new(&options.out, plan)?;
    let help =
        "It is of an earlier run. Copy it elsewhere, choose another folder with --out, or rename the pass.";
    check_apart(&files::inputs(loaded, data), &claim.stale().collect::<Vec<_>>(), help)?;
    Ok(claim)
}

/// Writes the page of a scene in which everything is known, as `Save` writes it, to `path`; no pass of the scene is run, and nothing else
/// is written. The page offers these lights besides the scene's own, by name, and has the photographs of `pass` if the data set can be
/// read; if not, a note says why.
///
/// # Errors
/// [`Error::Usage`] if something is unknown; those of [`run`] before its first pass; those of the page.
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
    files::check_within(loaded)?;
    let views = OpenScene::new(&scene, loaded.roots.as_deref())
        .and_then(|data| Ok(read_views(&scene, data.as_ref(), None, progress)?.0));
    let views = views.or_else(|error| without_photographs(&error, progress))?;
    let out = path.parent().unwrap_or(Path::new("")).to_owned();
    let options = RunOptions { out, force: true, ..RunOptions::default() };
    let mut session = open(&scene, views, &options, progress, UNRENDERED, SurfaceUse::Lasting)?;
    view::write_page(&mut session, pass, named, path)
}

/// No views, and a note on what kept their photographs from being read; a page is worth having without them.
fn without_photographs(error: &Error, progress: &dyn Progress) -> Result<Vec<ViewRecord>> {
    check_interrupted()?;
    progress.note(&format!("the page has neither photographs nor their cameras: {error}"));
    Ok(Vec::new())
}

/// Does what [`run`] does before the first pass of a scene, without any photograph: what the scene names is read and checked, no pass
/// is run, no hull of an unknown surface is made, and nothing is written. `views` are those of a data set ([`survey`](crate::survey::open::survey)), if the scene has one.
///
/// # Errors
/// Those that [`run`] ends with before its first pass.
pub fn rehearse(scene: &Scene, views: Vec<ViewRecord>, progress: &dyn Progress) -> Result<()> {
    let views = match &scene.views {
        Views::Cameras(specs) => specs.iter().map(bare_view).collect::<Result<_>>()?,
        Views::Dataset(_) | Views::Photographed(_) => views,
    };
    let options = RunOptions::default();
    open(scene, views, &options, progress, UNRENDERED, SurfaceUse::Checks).map(drop)
}

/// How a scene gets the photographs that it makes of its own object.
type Take = fn(&mut TrueObject, &Photographed, &Scene, &dyn Progress) -> Result<Vec<ViewRecord>>;

/// Photographs without pixels, for checks that look at none.
const UNRENDERED: Take = |_, spec, scene, _| photograph::imagine(spec, scene);

/// Puts the scene and its views into a world, reads its other inputs, and checks all passes. Nothing is written yet.
fn open<'a>(
    scene: &'a Scene,
    mut views: Vec<ViewRecord>,
    options: &RunOptions,
    progress: &'a dyn Progress,
    take: Take,
    use_of: SurfaceUse,
) -> Result<Session<'a>> {
    let _opening = stage("scene opened");
    let (surface, notes) = make_surface(&scene.surface, &views, use_of)?;
    notes.iter().for_each(|note| progress.note(note));
    let surface = Arc::new(surface);
    let lights = SceneLights::load(scene, progress)?;
    let mut truth = None;
    if let Views::Photographed(spec) = &scene.views {
        let truth = truth.insert(TrueObject::new(spec, &surface)?);
        views = take(truth, spec, scene, progress)?;
    }
    check_placements(scene, &views)?;
    check_cameras(&views, &surface)?;
    let mut session = Session::new(scene, surface, lights, progress);
    (session.truth, session.out, session.debug_every) = (truth, options.out.clone(), options.debug_every);
    session.ranks = options.ranks.clone();
    session.device = options.device.clone();
    session.add_plugins();
    let SceneLights { own, of_groups, .. } = &session.lights;
    spawn(&mut session.pipeline, scene, &session.surface, views, own.as_ref(), of_groups)?;
    preflight::check(&mut session)?;
    Ok(session)
}

/// Reads the views that do not depend on the object; rendered photographs come later. Photographs that cannot work end the run here.
fn read_views(
    scene: &Scene,
    data: Option<&OpenScene>,
    ranks: Option<&Ranks>,
    progress: &dyn Progress,
) -> Result<(Vec<ViewRecord>, Option<Survey>)> {
    let _reading = stage("photographs read");
    match (&scene.views, data) {
        (Views::Dataset(_), Some(data)) => reading::read_data(scene, data, ranks, progress),
        (Views::Cameras(specs), _) => Ok((specs.iter().map(bare_view).collect::<Result<_>>()?, None)),
        (Views::Photographed(_) | Views::Dataset(_), _) => Ok((Vec::new(), None)),
    }
}

/// The views of a scene as a survey has seen them; those that are not of a data set are known by their sizes.
///
/// # Errors
/// If a camera cannot be used.
pub fn looks<'a>(scene: &Scene, survey: Option<&'a Survey>) -> Result<Cow<'a, [ViewLook]>> {
    if let Some(survey) = survey {
        return Ok(Cow::Borrowed(&survey.looks));
    }
    let views = match &scene.views {
        Views::Cameras(specs) => specs.iter().map(bare_view).collect::<Result<_>>()?,
        Views::Photographed(spec) => photograph::imagine(spec, scene)?,
        Views::Dataset(_) => Vec::new(),
    };
    Ok(views.iter().map(ViewLook::unseen).collect())
}

/// The use of the scene's surface: none, if the first pass recovers another.
fn use_of(scene: &Scene) -> SurfaceUse {
    match scene.passes.first() {
        Some(Pass::Shape(_)) => SurfaceUse::UntilShape,
        _ => SurfaceUse::Lasting,
    }
}

fn bare_view(spec: &CameraSpec) -> Result<ViewRecord> {
    Ok(ViewRecord::of_camera(spec.name.clone(), spec.split, camera_of(spec)?))
}

/// Checks that the cameras can be used, and that none is inside a closed object, where it sees only back faces.
fn check_cameras(views: &[ViewRecord], surface: &Surface) -> Result<()> {
    for view in views {
        view.camera.check().map_err(|problem| {
            let help = "Correct the camera, its field of view or `focal_scale`.";
            Error::usage(format!("the camera of view {} cannot be used: {problem}", view.name), help)
        })?;
    }
    match views.iter().find(|view| surface.is_inside(view.camera.position())) {
        None => Ok(()),
        Some(view) => {
            let at = view.camera.position();
            Err(Error::usage(
                format!(
                    "the camera of view {} is inside the object, at ({:.3}, {:.3}, {:.3})",
                    view.name, at.x, at.y, at.z
                ),
                "Check that the cameras and the object have the same coordinate system and unit, or leave out that view.",
            ))
        }
    }
}
