//! What a scene file's `passes` list can say, one file a pass, and running the list.
//!
//! | pass | file | writes into `OUT/<name>/` |
//! | --- | --- | --- |
//! | `Fit` | [`fit`] | the recovered light (`light.npy`, `environment.exr`), `albedo.png`, `materials.ron`, `log.csv`; of several base materials `blend.exr`, `.png`, of a gloss for each texel `roughness.exr`, `.png` |
//! | `Shape` | [`shape`] | with `--debug-every N`, normals, depth and mesh every N steps |
//! | both | `found_views` | `cam_dict_norm.json` of cameras that moved, `exposures.csv` |
//! | `Render`, `Edit`, `Relight` | [`render`] | an EXR with layers and a PNG per view, the film of an orbit |
//! | `Evaluate` | [`evaluate`] | a contact sheet; scores go to `OUT/metrics.json` |
//! | `Save` | [`save`] | `scene.ron` with side files |
//! | `Export` | [`export`] | `mesh.glb`, `mesh.ply`, `mesh.obj` with `mesh.mtl` and `mesh_albedo.png` |
//!
//! [`preflight`] looks for what a later pass could stumble over before the first one runs.

pub mod bench;
pub mod edit;
pub mod env;
pub mod evaluate;
pub mod export;
pub mod fit;
mod found_views;
pub mod inspect;
pub mod photograph;
pub mod preflight;
pub mod progress;
pub mod render;
pub mod save;
pub mod shade_cases;
pub mod shape;
pub mod show;

use crate::dataset::{DatasetOptions, has_split, read_dataset};
use crate::error::{Error, Result};
use crate::fit::run::{FirstGuess, FitPlugin};
use crate::mesh::Surface;
use crate::pipeline::Pipeline;
use crate::report::scores::Scores;
use crate::scene::description::{
    Albedo, CameraSpec, Light, Scene, Surface as SurfaceSpec, Views, Visibility,
};
use crate::scene::load::{LoadedScene, RunOptions};
use crate::scene::passes::{EditPass, Pass, RelightPass, RenderPass, ViewChoice};
use crate::shade::frame::FramePlugin;
use crate::spawn::{LoadedLight, SurfaceUse, load_light, make_surface, spawn};
use crate::view::camera::Camera;
use crate::view::mask_check::check_masks;
use crate::view::{Split, ViewRecord};
use crate::visibility::{ObjectVisibility, VisibilitySettings};
use photograph::TrueObject;
use progress::Progress;
use std::collections::BTreeMap;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

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
    /// The lights that the scene names, loaded.
    pub lights: Lights,
    /// What the next fit guesses before its first step: what is unknown without an initial value, until there has been one.
    pub guess: FirstGuess,
    /// Steps of a `Shape` between two looks at it.
    pub debug_every: Option<u32>,
    /// What the terminal shows.
    pub progress: &'a dyn Progress,
    /// Scores so far.
    pub scores: Scores,
}

/// The lights that a scene names; read before anything is fitted, so that a bad file is found at once.
pub struct Lights {
    /// The scene's own, if it is not unknown.
    pub own: Option<LoadedLight>,
    /// Those of passes, by the pass's name.
    pub of_passes: BTreeMap<String, LoadedLight>,
}

impl Lights {
    fn load(scene: &Scene, progress: &dyn Progress) -> Result<Self> {
        let load = |source| {
            let light = load_light(source)?;
            light.notes.iter().for_each(|note| progress.note(note));
            Ok(light)
        };
        let own = match &scene.light {
            Light::Initial(source) | Light::Fixed(source) => Some(load(source)?),
            Light::Unknown(_) => None,
        };
        let mut of_passes = BTreeMap::new();
        for pass in &scene.passes {
            if let Some(source) = pass.light() {
                of_passes.insert(pass.name().to_owned(), load(source)?);
            }
        }
        Ok(Self { own, of_passes })
    }
}

/// Runs a scene's passes in order, and says through `progress` how they get on.
///
/// # Errors
/// The first error of a pass; what earlier passes wrote stays.
pub fn run(loaded: &LoadedScene, options: &RunOptions, progress: &dyn Progress) -> Result<()> {
    refuse_used(&options.out, options.force)?;
    let mut session = open(&loaded.scene, options, progress)?;
    preflight::check(&mut session)?;
    for pass in &loaded.scene.passes {
        match pass {
            Pass::Fit(pass) => fit::run(&mut session, pass)?,
            Pass::Shape(pass) => shape::run(&mut session, pass)?,
            Pass::Render(RenderPass { render, .. })
            | Pass::Edit(EditPass { render, .. })
            | Pass::Relight(RelightPass { render, .. }) => render::run(&mut session, pass, render)?,
            Pass::Evaluate(pass) => evaluate::run(&mut session, pass)?,
            Pass::Save(pass) => save::run(&mut session, pass)?,
            Pass::Export(pass) => export::run(&mut session, pass)?,
        }
        check_interrupted()?;
    }
    session.finish()
}

/// Most memory that shadows and reflections may be expected to take.
pub const MOST_VISIBILITY_BYTES: usize = 4 << 30;

impl Session<'_> {
    /// Whether the object has shadows and reflections that the scene does not leave out; if so, the world has what it takes to find them.
    ///
    /// # Errors
    /// If that would take more than [`MOST_VISIBILITY_BYTES`].
    pub fn has_visibility(&mut self) -> Result<bool> {
        let Visibility::Traced { directions, bounces, refresh_every } = self.scene.visibility else {
            return Ok(false);
        };
        if !self.pipeline.world.contains_resource::<ObjectVisibility>() {
            let settings = VisibilitySettings { directions, bounces, refresh_every };
            let texels = self.surface.atlas().covered.iter().filter(|covered| **covered).count();
            let bytes = texels * settings.bytes_per_texel();
            if bytes > MOST_VISIBILITY_BYTES {
                let gib = bytes as f64 / f64::from(1 << 30);
                let problem =
                    format!("shadows of {texels} texels in {directions} directions may take {gib:.1} GiB");
                let help =
                    "Lower `texture_size` or `visibility: Traced(directions: …)`, or say `visibility: None`.";
                return Err(Error::usage(problem, help));
            }
            let start = Instant::now();
            let traced = ObjectVisibility::new(&self.surface, settings);
            let (mib, elapsed) = (traced.bytes() as f64 / 1048576.0, start.elapsed().as_secs_f64());
            self.progress.print(&format!("visibility: traced in {elapsed:.1} s, {mib:.1} MiB"));
            self.pipeline.world.insert_resource(traced);
        }
        // A convex object hides nothing, and need not look at every step.
        Ok(!self.pipeline.world.resource::<ObjectVisibility>().sees_all())
    }
}

/// An output folder with something in it is kept, unless `force`.
fn refuse_used(out: &Path, force: bool) -> Result<()> {
    let used = match std::fs::read_dir(out) {
        Ok(mut entries) => entries.next().is_some() && !force,
        Err(error) if error.kind() == ErrorKind::NotFound => false,
        Err(error) if error.kind() == ErrorKind::NotADirectory => {
            let problem = format!("the output folder {} is a file", out.display());
            return Err(Error::usage(problem, "Choose another folder with --out."));
        }
        Err(error) => return Err(Error::io("read", out)(error)),
    };
    if used {
        let problem = format!("the output folder {} is not empty", out.display());
        return Err(Error::usage(problem, "Choose another with --out, or write into it with --force."));
    }
    Ok(())
}

/// [`Error::Interrupted`] once Ctrl-C was pressed.
///
/// # Errors
/// That one.
pub fn check_interrupted() -> Result<()> {
    if INTERRUPTED.load(Ordering::Relaxed) { Err(Error::Interrupted) } else { Ok(()) }
}

/// Reads everything the scene names and puts it into a world. Nothing is written yet.
fn open<'a>(scene: &'a Scene, options: &RunOptions, progress: &'a dyn Progress) -> Result<Session<'a>> {
    let mut views = read_views(scene, progress)?;
    if matches!(scene.surface, SurfaceSpec::Unknown { .. }) {
        let train: Vec<&ViewRecord> = views.iter().filter(|view| view.split == Split::Train).collect();
        check_masks(&train)?.iter().for_each(|note| progress.note(note));
    }
    let (surface, notes) = make_surface(&scene.surface, &views, use_of(scene))?;
    notes.iter().for_each(|note| progress.note(note));
    let surface = Arc::new(surface);
    let lights = Lights::load(scene, progress)?;
    let mut truth = None;
    if let Views::Photographed(spec) = &scene.views {
        let truth = truth.insert(TrueObject::new(spec, &surface)?);
        views = photograph::take(truth, spec, scene, progress)?;
    }
    check_cameras(&views, &surface)?;
    let mut pipeline = Pipeline::new();
    pipeline.add_plugin(&FramePlugin).add_plugin(&FitPlugin);
    spawn(&mut pipeline, scene, &surface, views, lights.own.as_ref())?;
    let out = options.out.clone();
    let guess = FirstGuess {
        light: matches!(scene.light, Light::Unknown(_)),
        albedo: matches!(scene.material.albedo, Albedo::Unknown),
    };
    Ok(Session {
        scene,
        pipeline,
        surface,
        truth,
        out,
        lights,
        guess,
        debug_every: options.debug_every,
        progress,
        scores: Scores::default(),
    })
}

/// The views that are there before the object is: those that it photographs itself are not.
fn read_views(scene: &Scene, progress: &dyn Progress) -> Result<Vec<ViewRecord>> {
    match &scene.views {
        Views::Dataset(spec) => {
            let options = DatasetOptions {
                layout: spec.layout,
                gamma: spec.gamma,
                pixel_center: spec.pixel_center,
                downscale: spec.downscale,
                every: spec.every,
                hold_out: spec.hold_out,
                select: (!spec.select.is_empty()).then(|| spec.select.clone()),
                up: scene.up,
            };
            let mut views = Vec::new();
            for split in [Split::Train, Split::Test] {
                if !needs(scene, split) && !has_split(&spec.path, split, &options)? {
                    continue;
                }
                let part = read_dataset(&spec.path, split, &options)?;
                part.notes.iter().for_each(|note| progress.note(note));
                views.extend(part.views);
            }
            views
                .iter_mut()
                .for_each(|view| view.camera.focal = view.camera.focal.map(|f| f * spec.focal_scale));
            Ok(views)
        }
        Views::Cameras(specs) => specs.iter().map(bare_view).collect(),
        Views::Photographed(_) => Ok(Vec::new()),
    }
}

/// What the scene's surface is made for: nothing, if the first pass finds another.
fn use_of(scene: &Scene) -> SurfaceUse {
    match scene.passes.first() {
        Some(Pass::Shape(_)) => SurfaceUse::UntilShape,
        _ => SurfaceUse::Lasting,
    }
}

/// Whether a pass needs views of this split, so that a data set without it is a mistake.
fn needs(scene: &Scene, split: Split) -> bool {
    let choice = if split == Split::Train { ViewChoice::Train } else { ViewChoice::Test };
    scene.passes.iter().any(|pass| match pass {
        Pass::Fit(_) | Pass::Shape(_) => split == Split::Train,
        _ => pass.render().is_some_and(|settings| settings.views == choice),
    })
}

fn bare_view(spec: &CameraSpec) -> Result<ViewRecord> {
    let camera = camera_of(spec)?;
    Ok(ViewRecord { name: spec.name.clone(), split: spec.split, camera, photograph: None, mask: None })
}

fn camera_of(spec: &CameraSpec) -> Result<Camera> {
    Camera::look_at(spec.eye, spec.target, spec.up, spec.fov_degrees, spec.width, spec.height)
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
                "Do the cameras and the object share one coordinate system and unit? Else drop that view.",
            ))
        }
    }
}

impl<'a> Session<'a> {
    /// The pass of this name.
    pub fn pass_named(&self, name: Option<&str>) -> Option<&'a Pass> {
        self.scene.passes.iter().find(|pass| Some(pass.name()) == name)
    }

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
