//! `lobelia check`: what a scene file would do, and what is wrong with its data; nothing is run.

use super::start::{SceneArgs, ThreadArgs, load_options, start_threads};
use super::terminal::print;
use clap::Args;
use lobelia::pass::memory::{usual_budget, within};
use lobelia::pass::preflight::{check_outputs, check_sizes};
use lobelia::pass::{looks, rehearse};
use lobelia::progress::{RecordedMessages, Silent};
use lobelia::scene::{LoadOptions, LoadedScene, Pass, Scene, Surface, Views, load, unknown_parts};
use lobelia::survey::estimate::{Estimate, estimate};
use lobelia::survey::open::{OpenScene, survey};
use lobelia::survey::{Finding, Severity, Survey, ViewLook, table};
use lobelia::{Error, Result, codec::file::FileUse, codec::file::check_writable, view::ViewRecord};
use std::{borrow::Cow, path::Path, path::PathBuf, sync::Arc};

/// The survey.
const JSON: &str = "survey.json";

/// Read a scene file, look at its photographs and masks, and say what it would do and what is wrong
#[derive(Args, Debug)]
pub struct CheckArgs {
    #[command(flatten)]
    scene: SceneArgs,
    /// Write survey.json into this folder
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    #[command(flatten)]
    threads: ThreadArgs,
    /// Memory that a run would have to keep to: 8GiB, 500MiB [default: three quarters of what a
    /// process may have]
    #[arg(long, value_name = "SIZE", value_parser = lobelia::pass::memory::parse_bytes)]
    memory: Option<u64>,
}

/// Runs the command.
pub fn run(args: &CheckArgs) -> Result<()> {
    let options = LoadOptions { without_data: true, ..load_options(&args.scene) };
    let loaded = load(&args.scene.scene, &options)?;
    check_sizes(&loaded.scene)?;
    let has_photographs = data_is_there(&loaded);
    if let Some(out) = &args.out {
        check_out(out, &loaded, has_photographs)?;
    }
    start_threads(args.threads)?;
    let surveyed = if has_photographs { survey(&loaded.scene)? } else { None };
    let (surveyed, views) = surveyed.unzip();
    let (scene, views) = (&loaded.scene, views.unwrap_or_default());
    // Memory and time of the run, if the views are known.
    let known = surveyed.is_some() || !matches!(scene.views, Views::Dataset(_));
    let looks = known.then(|| looks(scene, surveyed.as_ref())).transpose();
    let needs = looks.as_ref().ok().and_then(Option::as_ref);
    let needs = needs.map(|looks| estimate(looks, scene, rayon::current_num_threads()));
    let found = surveyed.as_ref().and_then(|survey| survey.findings_of(Severity::Error).next());
    let (notes, further) = match found.is_some() || !loaded.unseen.is_empty() {
        true => (Vec::new(), None),
        false => rehearsed(scene, looks, views, args.memory.or_else(usual_budget)),
    };
    print(&summary(&loaded, surveyed.as_ref(), &notes, needs.as_ref(), further.is_some()))?;
    if let (Some(out), Some(survey)) = (&args.out, &surveyed) {
        std::fs::create_dir_all(out).map_err(Error::io("create", out))?;
        let json = out.join(JSON);
        survey.write_json(&json, &needs.unwrap_or_default())?;
        print(&format!("written: {}\n", json.display()))?;
    }
    found.map(Finding::to_error).or(further).map_or(Ok(()), Err)
}

/// What a run's start says before its first pass, and the error that it ends with, which is none of
/// the survey's.
fn rehearsed(
    scene: &Scene,
    looks: Result<Option<Cow<[ViewLook]>>>,
    views: Vec<ViewRecord>,
    budget: Option<u64>,
) -> (Vec<String>, Option<Error>) {
    let notes = Arc::new(RecordedMessages::new(Arc::new(Silent)));
    let keeps = looks.and_then(|looks| match looks {
        Some(looks) => within(scene, &looks, budget, &*notes).map(drop),
        None => Ok(()),
    });
    let error = keeps.and_then(|()| rehearse(scene, views, notes.clone())).err();
    (notes.take(), error)
}

/// Refuses an `--out` that would be empty, cannot be written, or would replace what the scene
/// reads: before photographs are read.
fn check_out(out: &Path, loaded: &LoadedScene, has_photographs: bool) -> Result<()> {
    if !has_photographs {
        let problem = "--out has nothing to show: no photographs are looked at";
        return Err(Error::usage(problem, "Say --data DIR, with a scene whose views are a `Dataset`."));
    }
    check_writable(out)?;
    let open = OpenScene::new(&loaded.scene)?;
    let outputs = [FileUse::new(out.join(JSON), "--out")];
    check_outputs(loaded, open.as_ref(), &outputs, "Choose another folder with --out.")
}

/// Whether nothing that a survey reads is below a `$DATA` that stands for nothing.
fn data_is_there(loaded: &LoadedScene) -> bool {
    let is_there = |path: &Path| !loaded.unseen.iter().any(|unseen| unseen == path);
    let lacks_mesh = matches!(&loaded.scene.surface, Surface::Mesh { path, .. } if !is_there(path));
    !lacks_mesh && matches!(&loaded.scene.views, Views::Dataset(dataset) if is_there(&dataset.path))
}

/// Returns the text that `check` prints.
fn summary(
    loaded: &LoadedScene,
    surveyed: Option<&Survey>,
    notes: &[String],
    needs: Option<&Estimate>,
    has_further_error: bool,
) -> String {
    let scene = &loaded.scene;
    let unknown = unknown_parts(scene);
    let unknown = if unknown.is_empty() { "nothing".to_owned() } else { unknown.join(", ") };
    // The debug text of a pass begins with the word of the scene file, as in `Fit(…`.
    let kind = |pass: &Pass| format!("{pass:?}").split('(').next().unwrap_or_default().to_owned();
    let passes: Vec<String> =
        scene.passes.iter().map(|pass| format!("{} ({})", pass.name(), kind(pass))).collect();
    let verdict = match loaded.unseen.is_empty() {
        true => table::verdict(surveyed, usize::from(has_further_error)),
        false => "the scene file is fine; its data was not looked at: say --data DIR".to_owned(),
    };
    let found = loaded.files.len();
    let files = match loaded.unseen.len() {
        0 => format!("{found} named, all found"),
        unseen => format!("{found} found, {unseen} below $DATA not looked for (say --data DIR to look)"),
    };
    let mut rows = vec![
        ("surface", surface(scene)),
        ("views", views(scene)),
        ("unknown", unknown),
        ("passes", format!("{}: {}", passes.len(), passes.join(", "))),
        ("files", files),
    ];
    let named = loaded.files.iter().chain(&loaded.unseen);
    rows.extend(named.map(|file| ("", file.display().to_string())));
    rows.extend(surveyed.map(table::rows).unwrap_or_default());
    rows.extend(needs.map(|needs| ("needs", needs.words())));
    let notes = surveyed.iter().flat_map(|survey| &survey.notes).chain(notes);
    rows.extend(notes.map(|note| ("note", note.clone())));
    let rows: String = rows.into_iter().map(|(label, text)| format!("  {label:<8} {text}\n")).collect();
    let findings = surveyed.map(table::findings).unwrap_or_default();
    format!("{}: {verdict}\n{rows}{findings}", loaded.path.display())
}

fn surface(scene: &Scene) -> String {
    let (shape, side) = match &scene.surface {
        Surface::Mesh { path, texture_size, .. } => (path.display().to_string(), texture_size),
        Surface::Unknown { cells, texture_size } => (format!("unknown, on a grid of {cells}³"), texture_size),
        Surface::Sphere { radius, texture_size, .. } => (format!("sphere of radius {radius}"), texture_size),
        Surface::Box { size, texture_size, .. } => (format!("box {size}"), texture_size),
    };
    format!("{shape}, texture {side}²")
}

fn views(scene: &Scene) -> String {
    match &scene.views {
        Views::Dataset(dataset) => format!("photographs in {}", dataset.path.display()),
        Views::Cameras(cameras) => format!("{} cameras without photographs", cameras.len()),
        Views::Photographed(made) => {
            format!("{} to fit and {} to test, photographed here", made.cameras.count, made.cameras.test)
        }
    }
}
