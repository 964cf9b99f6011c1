//! `lobelia check`: what a scene file would do; nothing is run or written.

use super::args::CheckArgs;
use super::scene_files::load_options;
use super::terminal::print;
use lobelia::Result;
use lobelia::pass::preflight::check_sizes;
use lobelia::scene::Pass;
use lobelia::scene::{LoadOptions, LoadedScene, load, unknown_parts};
use lobelia::scene::{Scene, Surface, Views};
use std::fmt::Write as _;

/// Runs the command.
pub fn run(args: &CheckArgs) -> Result<()> {
    let options = LoadOptions { without_data: true, ..load_options(&args.scene) };
    let loaded = load(&args.scene.scene, &options)?;
    check_sizes(&loaded.scene)?;
    print(&summary(&loaded))
}

/// What `check` prints.
fn summary(loaded: &LoadedScene) -> String {
    let scene = &loaded.scene;
    let unknown = unknown_parts(scene);
    let unknown = if unknown.is_empty() { "nothing".to_owned() } else { unknown.join(", ") };
    let passes: Vec<String> =
        scene.passes.iter().map(|pass| format!("{} ({})", pass.name(), kind(pass))).collect();
    let mut text = format!("{}: fine\n", loaded.path.display());
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
