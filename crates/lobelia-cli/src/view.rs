//! `lobelia view`: the page of a saved object.

use super::start::{ThreadArgs, refuse_foreign, start_threads};
use super::terminal::Terminal;
use clap::Args;
use lobelia::progress::Progress;
use lobelia::scene::{LightSource, LoadOptions, LoadedScene, ViewPass, Views, load};
use lobelia::{Error, Result, glam::Vec3, pass::view::PAGE, pass::write_view};
use std::{path::Path, path::PathBuf, sync::Arc};

/// Writes OUT/view.html: one page that shows the object that a run saved, and needs nothing else,
/// no server and no network.
///
/// The object is turned with mouse, touch or keyboard, under the light that was found or under
/// lights given with --light; roughness, reflection, color and exposure have sliders; what was done
/// can be copied as a pass for a scene file. The photographs, if they are still there, are laid
/// beside the picture under a wipe. A pass View() in a scene file writes the same page, with the
/// lights of the scene's own passes.
#[derive(Args, Debug)]
#[command(
    about = "Write a page that shows a saved object in a browser: turned, relit, edited",
    verbatim_doc_comment
)]
pub struct ViewArgs {
    /// The output folder of a run with a `Save` pass, or a scene file in which all is known
    #[arg(value_name = "OUT")]
    out: PathBuf,
    /// Offer this light too: .ron, .npy lobes, or an OpenEXR or Radiance HDR map
    #[arg(long = "light", value_name = "FILE")]
    lights: Vec<PathBuf>,
    /// Most photographs in the page, beside which it shows its own picture; 0: none
    #[arg(long, value_name = "N", default_value_t = 24)]
    photographs: u32,
    /// The folder that $DATA stands for in the scene file
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
    #[command(flatten)]
    threads: ThreadArgs,
}

/// Mark in the head of every page.
const SIGNATURE: &str = r#"name="generator" content="Lobelia""#;

/// Runs the command.
pub fn run(args: &ViewArgs) -> Result<()> {
    let (scene, folder) = scene_of(&args.out)?;
    refuse_foreign(&folder.join(PAGE), SIGNATURE)?;
    start_threads(args.threads)?;
    let options = LoadOptions { data: args.data.clone(), ..LoadOptions::default() };
    let terminal = Terminal { quiet: false };
    let loaded = load(&scene, &options).or_else(|error| without_data(&scene, &options, error, &terminal))?;
    let lights: Vec<(String, LightSource)> = args.lights.iter().map(|path| light(path)).collect();
    let pass = ViewPass { photographs: args.photographs, ..ViewPass::default() };
    write_view(&loaded, &lights, &pass, &folder.join(PAGE), Arc::new(terminal))
}

/// The scene without its views, and a note, if it is only their data set that is no longer there.
fn without_data(scene: &Path, options: &LoadOptions, error: Error, shown: &Terminal) -> Result<LoadedScene> {
    // A scene has at least one camera.
    let sets = [("views", r#"Cameras([(name: "none", eye: (0, 0, 1))])"#), ("passes", "[]")];
    let sets = sets.map(|(path, value)| (path.to_owned(), value.to_owned())).to_vec();
    let Ok(mut loaded) = load(scene, &LoadOptions { sets, ..options.clone() }) else { return Err(error) };
    loaded.scene.views = Views::Cameras(Vec::new());
    shown.note(&format!("the page has neither photographs nor their cameras:\n{error}"));
    Ok(loaded)
}

/// The scene file of what a run saved, and the folder that the page goes into.
fn scene_of(out: &Path) -> Result<(PathBuf, PathBuf)> {
    if out.is_file() {
        return Ok((out.to_owned(), out.parent().unwrap_or(Path::new("")).to_owned()));
    }
    let places = [out.join("saved/scene.ron"), out.join("scene.ron")];
    if let Some(scene) = places.into_iter().find(|place| place.is_file()) {
        return Ok((scene, out.to_owned()));
    }
    let what = if out.is_dir() { "has no saved/scene.ron" } else { "is not there" };
    let help = "Give the output folder of a run whose scene has a `Save(name: \"saved\")` pass, or the saved scene file.";
    Err(Error::usage(format!("{} {what}", out.display()), help))
}

/// A light file, by its ending, under the name of the file.
fn light(path: &Path) -> (String, LightSource) {
    let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let ending = path.extension().unwrap_or_default().to_ascii_lowercase();
    let (path, scale, rotation_degrees) = (path.to_owned(), 1.0, Vec3::ZERO);
    let source = match ending.to_str() {
        Some("ron") => LightSource::Ron { path, scale, rotation_degrees },
        Some("npy") => LightSource::Npy { path, convention: Default::default(), scale, rotation_degrees },
        _ => LightSource::map(path),
    };
    (name, source)
}
