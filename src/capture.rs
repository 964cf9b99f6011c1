//! Photographs of one object with their cameras, from a folder in any known layout, or made in
//! memory.
//!
//! ```
//! use lobelia::prelude::*;
//!
//! let cameras = Camera::around(24, 2.8, 38.0, 64)?.into_iter().enumerate();
//! let view = |(i, camera)| ViewRecord::of_camera(format!("{i:02}"), Split::Train, camera);
//! let capture = Capture::from(cameras.map(view).collect::<Vec<_>>()).hold_out(8);
//! assert_eq!((capture.test().len(), capture.train().len()), (3, 21));
//! # Ok::<(), lobelia::Error>(())
//! ```

use crate::prepare::scene_file::scene_for;
use crate::progress::{Progress, Silent};
use crate::scene::{
    CameraSpec, FitPass, LoadOptions, Pass, Rates, Scene, ShapePass, Surface, Views, load::read,
};
use crate::survey::{Severity, Survey, open::OpenScene};
use glam::Vec3;
use lobelia_geometry::{Result, view::Camera, view::Split, view::ViewRecord};
use lobelia_io::codec::nearby::natural_order;
use lobelia_io::dataset::{DatasetOptions, Layout, has_split};
use lobelia_solve::fit::{cameras::CameraUnknowns, exposure::ExposureChoice};
use std::{ops::Deref, path::Path, sync::Arc};
use tracing::info_span;

/// Photographs of one object with their cameras. It derefs to its views.
#[derive(Clone, Debug)]
pub struct Capture {
    views: Vec<ViewRecord>,
    /// What is said of the object by the photographs alone.
    scene: Scene,
    /// Whether the data say which views are held out.
    has_split: bool,
    survey: Option<Arc<Survey>>,
}

impl Capture {
    /// Reads a folder of photographs with cameras, as the scene file says that `lobelia new` writes
    /// for it: its layout is found, and where it does not say which views are held out, every eighth
    /// of at least twelve is.
    ///
    /// # Errors
    /// If the folder is no data set, it has neither masks nor a mesh, a photograph cannot be read, or
    /// what the photographs show cannot work: black ones, inverted masks.
    pub fn read(folder: impl AsRef<Path>) -> Result<Self> {
        let folder = folder.as_ref();
        let path = folder.join("scene.ron");
        let mut scene = read(scene_for(folder, Layout::Auto, &path)?, &path, &LoadOptions::default())?.scene;
        let data = OpenScene::new(&scene)?;
        let (views, survey) = read_views(&scene, data.as_ref(), &Silent)?;
        drop(data);
        let options = DatasetOptions { hold_out: 0, ..DatasetOptions::default() };
        let has_split = has_split(folder, Split::Test, &options)?;
        scene.passes.clear();
        Ok(Self { views, scene, has_split, survey: survey.map(Arc::new) })
    }

    /// Holds every n-th view by name out of fits, from two on and starting with the first, or none.
    /// Nothing changes where the data say themselves which views are held out.
    #[must_use]
    pub fn hold_out(mut self, every: u32) -> Self {
        if !self.has_split {
            self.views.sort_by(|a, b| natural_order(&a.name, &b.name));
            for (view, place) in self.views.iter_mut().zip(0u32..) {
                let is_held_out = every > 1 && place.is_multiple_of(every);
                view.split = if is_held_out { Split::Test } else { Split::Train };
            }
            if let Views::Dataset(data) = &mut self.scene.views {
                data.hold_out = if every > 1 { every } else { 0 };
            }
        }
        self
    }

    /// The views that fits see, in a capture of their own.
    pub fn train(&self) -> Self {
        self.of(Split::Train)
    }

    /// The views that are held out, in a capture of their own.
    pub fn test(&self) -> Self {
        self.of(Split::Test)
    }

    fn of(&self, split: Split) -> Self {
        let views = self.views.iter().filter(|view| view.split == split).cloned().collect();
        Self { views, scene: self.scene.clone(), has_split: self.has_split, survey: self.survey.clone() }
    }

    /// What is said of the object: its views and their up.
    pub(crate) fn scene(&self) -> Scene {
        let views = match &self.scene.views {
            Views::Cameras(_) => Views::Cameras(self.iter().map(spec_of).collect()),
            data => data.clone(),
        };
        Scene { views, ..self.scene.clone() }
    }

    /// What may be wrong with the photographs, in sentences.
    pub fn warnings(&self) -> Vec<String> {
        let warnings = self.survey.iter().flat_map(|survey| survey.findings_of(Severity::Warning));
        warnings.map(|warning| warning.problem.clone()).collect()
    }

    /// Whether the object was turned before a camera that stood still.
    pub(crate) fn is_turntable(&self) -> bool {
        self.survey.as_ref().is_some_and(|survey| survey.is_turntable())
    }

    /// What is not known of photographs of a camera: each has an exposure of its own, and poses are a
    /// little off. Those that say which views are held out come from a renderer or a rig.
    fn unknowns(&self) -> (ExposureChoice, CameraUnknowns) {
        match &self.scene.views {
            Views::Dataset(_) if !self.has_split => (ExposureChoice::Brightness, CameraUnknowns::Poses),
            _ => (ExposureChoice::Auto, CameraUnknowns::Given),
        }
    }

    pub(crate) fn shape_pass(&self) -> ShapePass {
        let (exposure, cameras) = self.unknowns();
        ShapePass { exposure, cameras, ..ShapePass::default() }
    }

    pub(crate) fn fit_pass(&self) -> FitPass {
        let (exposure, cameras) = self.unknowns();
        FitPass { exposure, cameras, ..FitPass::default() }
    }

    /// The fit after a shape, which is slower and moves vertices and texels.
    pub(crate) fn fit_pass_of_shape(&self) -> FitPass {
        let rates = Rates { albedo: 0.02, light: 0.02, specular: 0.01 };
        FitPass { vertices: true, detail: true, steps: 1200, rates, ..self.fit_pass() }
    }
}

impl From<Vec<ViewRecord>> for Capture {
    fn from(views: Vec<ViewRecord>) -> Self {
        let scene = Scene::of_views(Views::Cameras(Vec::new()));
        Self { views, scene, has_split: false, survey: None }
    }
}

impl Deref for Capture {
    type Target = [ViewRecord];

    fn deref(&self) -> &[ViewRecord] {
        &self.views
    }
}

/// A camera as a scene file says it, without its principal point and skew.
fn spec_of(view: &ViewRecord) -> CameraSpec {
    let Camera { world_from_camera, focal, width, height, .. } = view.camera;
    let [eye, forward, down] =
        [world_from_camera.translation, world_from_camera.matrix3.z_axis, world_from_camera.matrix3.y_axis]
            .map(Vec3::from);
    CameraSpec {
        name: view.name.clone(),
        eye,
        target: eye + forward,
        up: -down,
        fov_degrees: 2.0 * (0.5 * height as f32 / focal[1]).atan().to_degrees(),
        width,
        height,
        split: view.split,
    }
}

/// Reads the views that do not depend on the object; rendered photographs come later. Those of a
/// data set that passes learn from or are scored against are surveyed: a warning is a note, the
/// first error ends the run.
///
/// # Errors
/// [`Error::Usage`] for the first thing that cannot work; those of reading photographs and masks.
pub(crate) fn read_views(
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
    let is_used = matches!(scene.surface, Surface::Unknown { .. }) || scene.passes.iter().any(learns);
    let bar = progress.bar("photographs", data.views.len() as u64);
    let (views, looks, notes) = data.read(|_| bar.inc(1))?;
    drop(bar);
    notes.iter().for_each(|note| progress.note(note));
    let survey = is_used.then(|| data.examine(looks)).transpose()?;
    if let Some(survey) = &survey {
        survey.findings_of(Severity::Warning).for_each(|warning| progress.note(&warning.problem));
        survey.findings_of(Severity::Error).next().map_or(Ok(()), |error| Err(error.to_error()))?;
    }
    Ok((views, survey))
}

/// Cameras without photographs.
pub(crate) fn bare_views(specs: &[CameraSpec]) -> Result<Vec<ViewRecord>> {
    let view = |of: &CameraSpec| Ok(ViewRecord::of_camera(of.name.clone(), of.split, of.camera()?));
    specs.iter().map(view).collect()
}
