//! Reading a scene's data for a survey: every view once, small, with few of them in memory at a
//! time.

use crate::scene::{Dataset, Pass, Scene, Surface, ViewChoice, Views};
use crate::survey::cameras::{BACKGROUND_SIDE, BACKGROUNDS, Background};
use crate::{report::sheet::choose_evenly, survey::Survey, survey::examine};
use glam::Vec3;
use lobelia_geometry::view::look::{MaskOrigin, SmallMask, ViewLook};
use lobelia_geometry::view::{Photograph, Split, ViewPriors, ViewRecord};
use lobelia_geometry::{Result, mesh::primitive::box_mesh, mesh::primitive::sphere_mesh};
use lobelia_geometry::{error::stop::check_interrupted, parallel};
use lobelia_io::codec::gltf::import::read_mesh;
use lobelia_io::codec::image::{Gamma, Orientation, read_image};
use lobelia_io::dataset::{
    DatasetOptions, Layout, LoadedView, PlannedView, has_split, load_notes, open_dataset,
};
use lobelia_sg::color::luminance;

/// A scene's data set whose views are known and not read: training views, then test views.
pub struct OpenScene<'a> {
    scene: &'a Scene,
    spec: &'a Dataset,
    /// The layout that was found.
    layout: Layout,
    /// The views.
    pub views: Vec<PlannedView>,
    /// Notes for the user about all views.
    pub notes: Vec<String>,
}

impl<'a> OpenScene<'a> {
    /// Opens the splits that a pass needs, so that a data set without one is an error, and those
    /// that are there; `None` if the scene's views are no data set.
    ///
    /// # Errors
    /// Errors of [`open_dataset`], or if the layout of the data cannot be determined.
    pub fn new(scene: &'a Scene) -> Result<Option<Self>> {
        let Views::Dataset(spec) = &scene.views else { return Ok(None) };
        let options = DatasetOptions {
            layout: spec.layout,
            gamma: spec.gamma,
            pixel_center: spec.pixel_center,
            downscale: spec.downscale,
            every: spec.every,
            hold_out: spec.hold_out,
            select: (!spec.select.is_empty()).then(|| spec.select.clone()),
            up: scene.up,
            priors: spec.priors.clone(),
            placements: spec.placements.iter().map(|of| of.photographs.clone()).collect(),
        };
        let mut open = Self { scene, spec, layout: spec.layout, views: Vec::new(), notes: Vec::new() };
        for (split, choice) in [(Split::Train, ViewChoice::Train), (Split::Test, ViewChoice::Test)] {
            let needs = |pass: &Pass| match pass {
                Pass::Fit(_) | Pass::Shape(_) => split == Split::Train,
                _ => pass.render().is_some_and(|settings| settings.views == choice),
            };
            if !scene.passes.iter().any(needs) && !has_split(&spec.path, split, &options)? {
                continue;
            }
            let opened = open_dataset(&spec.path, split, &options)?;
            open.views.extend(opened.views);
            open.notes.extend(opened.notes);
            open.layout = opened.layout;
        }
        Ok(Some(open))
    }

    /// Reads the views, looks at each, and has `keep` take from it what is not needed any more. Also
    /// returns notes for the user.
    ///
    /// # Errors
    /// The first, in the order of the views, of [`PlannedView::load`].
    pub fn read(
        &self,
        keep: impl Fn(&mut ViewRecord) + Sync,
    ) -> Result<(Vec<ViewRecord>, Vec<ViewLook>, Vec<String>)> {
        let read: Vec<Result<(LoadedView, ViewLook)>> = parallel::map_slice(&self.views, 1, |view| {
            check_interrupted()?;
            let mut loaded = view.load()?;
            let camera = &mut loaded.record.camera;
            camera.focal = camera.focal.map(|focal| focal * self.spec.focal_scale);
            let source = if view.plan.mask.is_some() { MaskOrigin::File } else { MaskOrigin::Alpha };
            let look = ViewLook::new(&loaded.record, source);
            keep(&mut loaded.record);
            Ok((loaded, look))
        });
        let (loaded, looks): (Vec<_>, Vec<_>) =
            read.into_iter().collect::<Result<Vec<_>>>()?.into_iter().unzip();
        let notes = self.notes.iter().cloned().chain(load_notes(&loaded)).collect();
        Ok((loaded.into_iter().map(|view| view.record).collect(), looks, notes))
    }

    /// The survey of what was looked at, one look for each view.
    ///
    /// # Errors
    /// Errors of reading the mesh, and some photographs again.
    pub fn examine(&self, looks: Vec<ViewLook>) -> Result<Survey> {
        let mesh = match &self.scene.surface {
            Surface::Mesh { path, .. } => Some(read_mesh(path)?),
            Surface::Sphere { center, radius, .. } => Some(sphere_mesh(*center, *radius)?),
            Surface::Box { center, size, .. } => Some(box_mesh(*center, *size)?),
            Surface::Unknown { .. } => None,
        };
        let backgrounds = backgrounds(&self.views, &looks, self.spec.gamma)?;
        let mut survey = examine(looks, mesh.as_ref(), self.scene.up, &backgrounds);
        survey.layout = self.layout;
        Ok(survey)
    }
}

/// Surveys the data set of a scene; `None` if its views are not a data set. Of each view that is
/// read a few numbers are kept, and its record without the pixels of the photograph, and without
/// the mask unless the surface is made of it.
///
/// # Errors
/// Errors of [`OpenScene::new`]; the first, in the order of the views, of reading photographs and
/// masks; errors of reading the mesh.
pub fn survey(scene: &Scene) -> Result<Option<(Survey, Vec<ViewRecord>)>> {
    let Some(open) = OpenScene::new(scene)? else { return Ok(None) };
    let needs_masks = matches!(scene.surface, Surface::Unknown { .. });
    let (views, looks, notes) = open.read(|ViewRecord { photograph, mask, priors, camera, .. }| {
        *photograph = photograph.take().map(|_| Photograph::without_pixels(camera.width, camera.height));
        *mask = mask.take().filter(|_| needs_masks);
        *priors = ViewPriors::default();
    })?;
    let mut survey = open.examine(looks)?;
    survey.notes.splice(0..0, notes);
    Ok(Some((survey, views)))
}

/// Backgrounds of some photographs that have masks of their own and no alpha.
fn backgrounds(planned: &[PlannedView], looks: &[ViewLook], gamma: Gamma) -> Result<Vec<Background>> {
    let views = planned.iter().zip(looks);
    let views = views.filter(|(_, look)| look.mask_source == MaskOrigin::File && look.light.is_some());
    let masked: Vec<(&PlannedView, &SmallMask)> =
        views.filter_map(|(view, look)| Some((view, &look.mask.as_ref()?.small))).collect();
    let chosen = choose_evenly(masked.len(), BACKGROUNDS);
    let read: Vec<Result<Option<Background>>> =
        parallel::map_slice(&chosen, 1, |i| background(masked[*i].0, masked[*i].1, gamma));
    Ok(read.into_iter().collect::<Result<Vec<_>>>()?.into_iter().flatten().collect())
}

/// A photograph as its file has it, without the object and a pixel around it; `None` if it has
/// alpha.
fn background(view: &PlannedView, mask: &SmallMask, gamma: Gamma) -> Result<Option<Background>> {
    let Some(path) = &view.plan.image else { return Ok(None) };
    let loaded = read_image(path, gamma, Orientation::AsStored)?;
    if loaded.alpha.is_some() {
        return Ok(None);
    }
    let factor = loaded.image.width.max(loaded.image.height).div_ceil(BACKGROUND_SIDE).max(1);
    let small = loaded.image.downscaled(factor);
    let (width, height) = (mask.camera.width as i64, mask.camera.height as i64);
    let at = |i: i64, of: u32, side: i64| ((2 * i + 1) * side) / (2 * i64::from(of));
    let is_object = |x: i64, y: i64| {
        let (x, y) = (at(x, small.width, width), at(y, small.height, height));
        let inside = |x: i64, y: i64| {
            (0..width).contains(&x) && (0..height).contains(&y) && mask.inside[(y * width + x) as usize]
        };
        (-2..=2).any(|dy| (-2..=2).any(|dx| inside(x + dx, y + dy)))
    };
    let value = |(i, pixel): (usize, &Vec3)| {
        let (x, y) = ((i as u32 % small.width) as i64, (i as u32 / small.width) as i64);
        (!is_object(x, y)).then(|| luminance(*pixel).max(0.0).sqrt())
    };
    let values = small.pixels.iter().enumerate().map(value).collect();
    Ok(Some(Background { size: [small.width, small.height], values }))
}
