//! What a scene file's `passes` list can say, one file a pass, and running the list.
//!
//! | pass | file | writes into `OUT/<name>/` |
//! | --- | --- | --- |
//! | `Fit` | [`fit`] | the recovered light (`light.npy`, `environment.exr`), `albedo.png`, `materials.ron`, `log.csv` |
//! | `Render`, `Edit`, `Relight` | [`render`] | an EXR with layers and a PNG per view, the film of an orbit |
//! | `Evaluate` | [`evaluate`] | a contact sheet; scores go to `OUT/metrics.json` |
//! | `Save` | [`save`] | `scene.ron` with side files |
//! | `Export` | [`save`] | `mesh.glb` |

pub mod bench;
pub mod edit;
pub mod evaluate;
pub mod fit;
pub mod photograph;
pub mod progress;
pub mod render;
pub mod save;
pub mod shade_cases;

use crate::error::{Error, Result};
use crate::fit::run::FitPlugin;
use crate::report::scores::Scores;
use crate::scene::load::{LoadedScene, RunOptions};
use crate::scene::pass_types::Pass;
use crate::scene::spawn::{make_surface, spawn};
use crate::scene::types::{Scene, Views};
use crate::shade::frame::FramePlugin;
use crate::stage::Pipeline;
use crate::surface::Surface;
use crate::view::camera::Camera;
use crate::view::dataset::{DatasetOptions, read_dataset};
use crate::view::{Split, ViewRecord};
use photograph::TrueObject;
use progress::Progress;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Set by Ctrl-C: the fit in progress ends at its next step, other passes at their next picture.
pub static INTERRUPTED: AtomicBool = AtomicBool::new(false);

/// Everything the passes of one run share.
pub struct Session<'a> {
    /// The scene that is run.
    pub scene: &'a Scene,
    /// The world and its schedules.
    pub pipeline: Pipeline,
    /// The object's surface.
    pub surface: Arc<Surface>,
    /// The object that took its own photographs, if there is one.
    pub truth: Option<TrueObject>,
    /// Output folder.
    pub out: PathBuf,
    /// What the terminal shows.
    pub progress: Progress,
    /// Scores so far.
    pub scores: Scores,
}

/// Runs a scene's passes in order.
///
/// # Errors
/// The first error of a pass; what earlier passes wrote stays.
pub fn run(loaded: &LoadedScene, options: &RunOptions) -> Result<()> {
    let mut session = open(&loaded.scene, options)?;
    for pass in &loaded.scene.passes {
        let folder = session.out.join(pass.name());
        std::fs::create_dir_all(&folder).map_err(Error::io("create", &folder))?;
        match pass {
            Pass::Fit(pass) => fit::run(&mut session, pass)?,
            Pass::Render(pass) => render::run(&mut session, &pass.name, None, &[], &pass.render)?,
            Pass::Edit(pass) => {
                render::run(&mut session, &pass.name, pass.light.as_ref(), &pass.edits, &pass.render)?;
            }
            Pass::Relight(pass) => {
                render::run(&mut session, &pass.name, Some(&pass.light), &pass.edits, &pass.render)?;
            }
            Pass::Evaluate(pass) => evaluate::run(&mut session, pass)?,
            Pass::Save(pass) => save::run_save(&mut session, &pass.name)?,
            Pass::Export(pass) => save::run_export(&mut session, &pass.name)?,
        }
        check_interrupted()?;
    }
    session.finish()
}

/// [`Error::Interrupted`] once Ctrl-C was pressed.
///
/// # Errors
/// That one.
pub fn check_interrupted() -> Result<()> {
    if INTERRUPTED.load(Ordering::Relaxed) { Err(Error::Interrupted) } else { Ok(()) }
}

/// Reads everything the scene names and puts it into a world. Nothing is written yet.
fn open<'a>(scene: &'a Scene, options: &RunOptions) -> Result<Session<'a>> {
    let progress = Progress::new(options.quiet);
    let (surface, notes) = make_surface(&scene.surface)?;
    notes.iter().for_each(|note| progress.note(note));
    let surface = Arc::new(surface);
    let (views, truth) = read_views(scene, &surface, &progress)?;
    check_cameras(&views, &surface)?;
    let mut pipeline = Pipeline::new();
    pipeline.add_plugin(&FramePlugin).add_plugin(&FitPlugin);
    spawn(&mut pipeline, scene, &surface, views)?;
    let out = options.out.clone();
    Ok(Session { scene, pipeline, surface, truth, out, progress, scores: Scores::default() })
}

fn read_views(
    scene: &Scene,
    surface: &Arc<Surface>,
    progress: &Progress,
) -> Result<(Vec<ViewRecord>, Option<TrueObject>)> {
    match &scene.views {
        Views::Dataset(spec) => {
            let options = DatasetOptions {
                layout: spec.layout,
                gamma: spec.gamma,
                pixel_center: spec.pixel_center,
                downscale: spec.downscale,
                every: spec.every,
                select: (!spec.select.is_empty()).then(|| spec.select.clone()),
                up: scene.up,
            };
            let mut views = Vec::new();
            for split in [Split::Train, Split::Test] {
                let part = read_dataset(&spec.path, split, &options)?;
                part.notes.iter().for_each(|note| progress.note(note));
                views.extend(part.views);
            }
            Ok((views, None))
        }
        Views::Cameras(specs) => Ok((specs.iter().map(bare_view).collect::<Result<_>>()?, None)),
        Views::Photographed(spec) => {
            let mut truth = TrueObject::new(spec, surface)?;
            let views = photograph::take(&mut truth, spec, scene, progress)?;
            Ok((views, Some(truth)))
        }
    }
}

fn bare_view(spec: &crate::scene::types::CameraSpec) -> Result<ViewRecord> {
    let camera = Camera::look_at(spec.eye, spec.target, spec.up, spec.fov_degrees, spec.width, spec.height)?;
    Ok(ViewRecord { name: spec.name.clone(), split: spec.split, camera, photograph: None, mask: None })
}

/// A camera inside a closed object would see its back everywhere.
fn check_cameras(views: &[ViewRecord], surface: &Surface) -> Result<()> {
    match views.iter().find(|view| surface.is_inside(view.camera.position())) {
        None => Ok(()),
        Some(view) => {
            let at = view.camera.position();
            Err(Error::usage(
                format!(
                    "the camera of view {} is inside the object, at ({:.3}, {:.3}, {:.3})",
                    view.name, at.x, at.y, at.z
                ),
                "Do the cameras and the mesh share one coordinate system and unit? Else drop that view.",
            ))
        }
    }
}

impl Session<'_> {
    /// The folder of a pass.
    pub fn folder(&self, pass: &str) -> PathBuf {
        self.out.join(pass)
    }

    /// Writes the metrics and shows the table.
    fn finish(mut self) -> Result<()> {
        self.scores.peak_rss_mib = crate::report::scores::peak_rss_mib();
        self.scores.write_json(self.out.join("metrics.json"))?;
        self.progress.print(&self.scores.table());
        self.progress.print(&format!("Results are in {}.", self.out.display()));
        Ok(())
    }
}
