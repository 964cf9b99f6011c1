//! `lobelia check`: what a scene file would do, and what is wrong with its data; nothing is run.

use super::args::CheckArgs;
use super::scene_files::load_options;
use super::terminal::print;
use super::threads::start_threads;
use lobelia::pass::preflight::check_sizes;
use lobelia::report::sheet::write_sheet;
use lobelia::scene::Pass;
use lobelia::scene::{LoadOptions, LoadedScene, load, unknown_parts};
use lobelia::scene::{Scene, Surface, Views};
use lobelia::survey::estimate::{Estimate, estimate};
use lobelia::survey::open::survey;
use lobelia::survey::sheet::contact_sheet;
use lobelia::survey::{Severity, Survey, json, table};
use lobelia::{Error, Result};
use std::fmt::Write as _;
use std::path::Path;

/// Runs the command.
pub fn run(args: &CheckArgs) -> Result<()> {
    let options = LoadOptions { without_data: true, ..load_options(&args.scene) };
    let loaded = load(&args.scene.scene, &options)?;
    check_sizes(&loaded.scene)?;
    start_threads(args.threads)?;
    let surveyed = if data_is_there(&loaded) { survey(&loaded.scene, args.out.is_some())? } else { None };
    let surveyed = surveyed.map(|survey| {
        let estimate = estimate(&survey, &loaded.scene, rayon::current_num_threads());
        (survey, estimate)
    });
    print(&summary(&loaded, surveyed.as_ref()))?;
    match (&args.out, &surveyed) {
        (Some(out), Some((survey, estimate))) => write(out, &loaded, survey, estimate)?,
        (Some(_), None) => {
            let problem = "--out has nothing to show: no photographs are looked at";
            return Err(Error::usage(problem, "Say --data DIR, with a scene whose views are a `Dataset`."));
        }
        (None, _) => {}
    }
    let error = surveyed.as_ref().and_then(|(survey, _)| survey.findings_of(Severity::Error).next());
    error.map_or(Ok(()), |error| Err(error.to_error()))
}

/// Whether nothing that a survey reads is below a `$DATA` that stands for nothing.
fn data_is_there(loaded: &LoadedScene) -> bool {
    let is_there = |path: &Path| !loaded.unseen.iter().any(|unseen| unseen == path);
    let mesh = match &loaded.scene.surface {
        Surface::Mesh { path, .. } => is_there(path),
        _ => true,
    };
    mesh && matches!(&loaded.scene.views, Views::Dataset(dataset) if is_there(&dataset.path))
}

/// Writes the contact sheet and the survey as JSON.
fn write(out: &Path, loaded: &LoadedScene, survey: &Survey, estimate: &Estimate) -> Result<()> {
    std::fs::create_dir_all(out).map_err(Error::io("create", out))?;
    let (sheet, data) = (out.join("contact_sheet.png"), out.join("survey.json"));
    write_sheet(&sheet, &contact_sheet(survey, &loaded.path.display().to_string()))?;
    json::write_json(&data, survey, estimate)?;
    print(&format!("written: {}, {}\n", sheet.display(), data.display()))
}

/// What `check` prints.
fn summary(loaded: &LoadedScene, surveyed: Option<&(Survey, Estimate)>) -> String {
    let scene = &loaded.scene;
    let unknown = unknown_parts(scene);
    let unknown = if unknown.is_empty() { "nothing".to_owned() } else { unknown.join(", ") };
    let passes: Vec<String> =
        scene.passes.iter().map(|pass| format!("{} ({})", pass.name(), kind(pass))).collect();
    let verdict = surveyed.map_or("fine".to_owned(), |(survey, _)| table::verdict(survey));
    let mut text = format!("{}: {verdict}\n", loaded.path.display());
    let mut line = |label: &str, value: &str| writeln!(text, "  {label:<8} {value}");
    // Writing to a `String` cannot fail.
    let _ = line("surface", &surface(scene));
    let _ = line("views", &views(scene));
    let _ = line("unknown", &unknown);
    let _ = line("passes", &format!("{}: {}", passes.len(), passes.join(", ")));
    let _ = line("files", &files(loaded));
    for file in loaded.files.iter().chain(&loaded.unseen) {
        let _ = line("", &file.display().to_string());
    }
    if let Some((survey, estimate)) = surveyed {
        for (label, value) in table::rows(survey, estimate) {
            let _ = line(label, &value);
        }
        text += &table::findings(survey);
    }
    text
}

fn files(loaded: &LoadedScene) -> String {
    let found = loaded.files.len();
    match loaded.unseen.len() {
        0 => format!("{found} named, all found"),
        unseen => format!("{found} found, {unseen} below $DATA not looked for (say --data DIR to look)"),
    }
}

fn surface(scene: &Scene) -> String {
    match &scene.surface {
        Surface::Mesh { path, texture_size, .. } => format!("{}, texture {texture_size}²", path.display()),
        Surface::Unknown { cells, texture_size } => {
            format!("unknown, on a grid of {cells}³, texture {texture_size}²")
        }
        Surface::Sphere { radius, texture_size, .. } => {
            format!("sphere of radius {radius}, texture {texture_size}²")
        }
        Surface::Box { size, texture_size, .. } => format!("box {size}, texture {texture_size}²"),
    }
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

fn kind(pass: &Pass) -> &'static str {
    match pass {
        Pass::Fit(_) => "Fit",
        Pass::Shape(_) => "Shape",
        Pass::Render(_) => "Render",
        Pass::Edit(_) => "Edit",
        Pass::Relight(_) => "Relight",
        Pass::Evaluate(_) => "Evaluate",
        Pass::Save(_) => "Save",
        Pass::Export(_) => "Export",
    }
}
