//! Reading a scene's data for a survey: every view once, small, with few of them in memory at a time.

use crate::codec::gltf::import::read_mesh;
use crate::codec::image::{Gamma, Orientation, read_image};
use crate::dataset::{DatasetOptions, Layout, LoadedView, PlannedView, has_split, load_notes, open_dataset};
use crate::error::Result;
use crate::math::color::luminance;
use crate::mesh::primitive::{box_mesh, sphere_mesh};
use crate::mesh::triangles::Mesh;
use crate::report::sheet::choose_evenly;
use crate::scene::{Dataset, Pass, Scene, Surface, Truth, ViewChoice, Views};
use crate::survey::examine::{Subject, Survey, examine};
use crate::survey::look::{MaskOrigin, OpenPhotograph, OpenView, SmallMask, ViewLook};
use crate::survey::turntable::{BACKGROUND_SIDE, BACKGROUNDS, Background};
use crate::view::{Mask, Photograph, Split, ViewPriors, ViewRecord};
use glam::Vec3;
use rayon::prelude::*;
use std::path::PathBuf;

/// Most pixels along a side of the pictures that are looked at.
const LOOK_SIDE: u32 = 1024;

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
    /// Opens the data set; `None` if the scene's views are none. Nothing outside `roots` is read, if there are any
    /// ([`LoadedScene::roots`](crate::scene::LoadedScene::roots)).
    ///
    /// # Errors
    /// Those of [`open_dataset`].
    pub fn new(scene: &'a Scene, roots: Option<&[PathBuf]>) -> Result<Option<Self>> {
        let Views::Dataset(spec) = &scene.views else { return Ok(None) };
        let roots = roots.map(<[PathBuf]>::to_vec);
        let options = DatasetOptions { roots, ..dataset_options(spec, scene.up) };
        let mut open = Self { scene, spec, layout: spec.layout, views: Vec::new(), notes: Vec::new() };
        for split in wanted_splits(scene, spec, &options)? {
            let opened = open_dataset(&spec.path, split, &options)?;
            open.views.extend(opened.views);
            open.notes.extend(opened.notes);
            open.layout = opened.layout;
        }
        Ok(Some(open))
    }

    /// Reads a view.
    ///
    /// # Errors
    /// Those of [`PlannedView::load`].
    pub fn load(&self, view: &PlannedView) -> Result<LoadedView> {
        let mut loaded = view.load()?;
        let focal_scale = self.spec.focal_scale;
        loaded.record.camera.focal = loaded.record.camera.focal.map(|focal| focal * focal_scale);
        Ok(loaded)
    }

    /// Looks at a view that was read.
    pub fn look(&self, view: &PlannedView, loaded: &LoadedView, with_thumbnail: bool) -> ViewLook {
        let camera = &loaded.record.camera;
        let size = [camera.width, camera.height];
        let source = if view.mask_path().is_some() { MaskOrigin::File } else { MaskOrigin::Alpha };
        ViewLook::new(&reduced(OpenView::new(loaded)), size, source, with_thumbnail)
    }

    /// The survey of what was looked at, one look for each view.
    ///
    /// # Errors
    /// Those of reading the mesh, and some photographs again.
    pub fn examine(&self, looks: Vec<ViewLook>) -> Result<Survey> {
        let mesh = known_mesh(&self.scene.surface)?;
        let (Surface::Mesh { texture_size, .. }
        | Surface::Unknown { texture_size, .. }
        | Surface::Sphere { texture_size, .. }
        | Surface::Box { texture_size, .. }) = &self.scene.surface;
        let subject = Subject {
            mesh: mesh.as_ref(),
            up: self.scene.up,
            texture_size: *texture_size,
            refined: is_refined(self.scene),
            scored: is_scored(self.scene),
        };
        let backgrounds = backgrounds(&self.views, &looks, self.spec.gamma)?;
        let mut survey = examine(looks, &subject, &backgrounds);
        survey.layout = self.layout;
        Ok(survey)
    }
}

/// Surveys the data set of a scene; `None` if its views are not a data set. Of each view that is read a few numbers are kept, and its
/// record without the pixels of the photograph, and without the mask unless the surface is made of it. Thumbnails are for contact
/// sheets alone.
///
/// # Errors
/// Those of [`OpenScene::new`]; the first, in the order of the views, of reading photographs and masks; those of reading the mesh.
pub fn survey(
    scene: &Scene,
    roots: Option<&[PathBuf]>,
    with_thumbnails: bool,
) -> Result<Option<(Survey, Vec<ViewRecord>)>> {
    let Some(open) = OpenScene::new(scene, roots)? else { return Ok(None) };
    let needs_masks = matches!(scene.surface, Surface::Unknown { .. });
    let look_at = |view: &PlannedView| {
        let loaded = open.load(view)?;
        let look = open.look(view, &loaded, with_thumbnails);
        let LoadedView { record, .. } = loaded;
        let [width, height] = [record.camera.width, record.camera.height];
        let rest = ViewRecord {
            photograph: record.photograph.map(|_| Photograph::without_pixels(width, height)),
            mask: record.mask.filter(|_| needs_masks),
            priors: ViewPriors::default(),
            ..record
        };
        Ok((look, LoadedView { record: rest, ..loaded }))
    };
    let looked: Vec<Result<(ViewLook, LoadedView)>> = open.views.par_iter().map(look_at).collect();
    let looked = looked.into_iter().collect::<Result<Vec<_>>>()?;
    let (looks, loaded): (Vec<ViewLook>, Vec<LoadedView>) = looked.into_iter().unzip();
    let mut survey = open.examine(looks)?;
    survey.notes.splice(0..0, open.notes.into_iter().chain(load_notes(&loaded)));
    Ok(Some((survey, loaded.into_iter().map(|view| view.record).collect())))
}

/// How a scene's data set is read.
fn dataset_options(spec: &Dataset, up: Vec3) -> DatasetOptions {
    DatasetOptions {
        layout: spec.layout,
        gamma: spec.gamma,
        pixel_center: spec.pixel_center,
        downscale: spec.downscale,
        every: spec.every,
        hold_out: spec.hold_out,
        select: (!spec.select.is_empty()).then(|| spec.select.clone()),
        up,
        priors: spec.priors.clone(),
        placements: spec.placements.iter().map(|of| of.photographs.clone()).collect(),
        roots: None,
    }
}

/// The splits that a scene reads: those that a pass needs, so that a data set without one is an error, and those that are there.
///
/// # Errors
/// If the layout of the data cannot be determined.
fn wanted_splits(scene: &Scene, spec: &Dataset, options: &DatasetOptions) -> Result<Vec<Split>> {
    let mut splits = Vec::new();
    for split in [Split::Train, Split::Test] {
        if needs(scene, split) || has_split(&spec.path, split, options)? {
            splits.push(split);
        }
    }
    Ok(splits)
}

/// Whether a pass needs views of this split.
fn needs(scene: &Scene, split: Split) -> bool {
    let choice = if split == Split::Train { ViewChoice::Train } else { ViewChoice::Test };
    scene.passes.iter().any(|pass| match pass {
        Pass::Fit(_) | Pass::Shape(_) => split == Split::Train,
        _ => pass.render().is_some_and(|settings| settings.views == choice),
    })
}

/// Whether a fit makes the texture as fine as the photographs.
fn is_refined(scene: &Scene) -> bool {
    scene.passes.iter().any(|pass| matches!(pass, Pass::Fit(fit) if fit.detail))
}

/// Whether photographs of test views are what a pass is scored against.
fn is_scored(scene: &Scene) -> bool {
    scene.passes.iter().any(|pass| match pass {
        Pass::Evaluate(evaluate) => evaluate.scores.iter().any(|score| score.truth == Truth::Photographs),
        _ => false,
    })
}

fn known_mesh(surface: &Surface) -> Result<Option<Mesh>> {
    match surface {
        Surface::Mesh { path, .. } => read_mesh(path).map(Some),
        Surface::Sphere { center, radius, .. } => sphere_mesh(*center, *radius).map(Some),
        Surface::Box { center, size, .. } => box_mesh(*center, *size).map(Some),
        Surface::Unknown { .. } => Ok(None),
    }
}

/// A view of at most [`LOOK_SIDE`] pixels a side.
fn reduced(view: OpenView) -> OpenView {
    let (width, height) = (view.camera.width, view.camera.height);
    let factor = width.max(height).div_ceil(LOOK_SIDE).max(1);
    if factor == 1 {
        return view;
    }
    let small = |photograph: &OpenPhotograph| OpenPhotograph {
        image: photograph.image.downscaled(factor),
        saturated: mostly(&photograph.saturated, width, height, factor),
    };
    OpenView {
        camera: view.camera.scaled(factor),
        photograph: view.photograph.as_ref().map(small),
        mask: view.mask.as_ref().map(|mask| mask.downscaled(factor)),
        ..view
    }
}

/// Whether most pixels of each block are set, so that shares stay what they are.
fn mostly(flags: &[bool], width: u32, height: u32, factor: u32) -> Vec<bool> {
    let coverage = flags.iter().map(|&flag| f32::from(u8::from(flag))).collect();
    let small = Mask { width, height, coverage }.downscaled(factor);
    small.coverage.into_iter().map(|share| share >= 0.5).collect()
}

/// Backgrounds of some photographs that have masks of their own and no alpha.
fn backgrounds(planned: &[PlannedView], looks: &[ViewLook], gamma: Gamma) -> Result<Vec<Background>> {
    let masked: Vec<(&PlannedView, &SmallMask)> = planned
        .iter()
        .zip(looks)
        .filter(|(_, look)| look.mask_source == MaskOrigin::File && look.light.is_some())
        .filter_map(|(view, look)| Some((view, &look.mask.as_ref()?.small)))
        .collect();
    let chosen = choose_evenly(masked.len(), BACKGROUNDS);
    let read: Vec<Result<Option<Background>>> =
        chosen.into_par_iter().map(|i| background(masked[i].0, masked[i].1, gamma)).collect();
    Ok(read.into_iter().collect::<Result<Vec<_>>>()?.into_iter().flatten().collect())
}

/// A photograph as its file has it, without the object and a pixel around it; `None` if it has alpha.
fn background(view: &PlannedView, mask: &SmallMask, gamma: Gamma) -> Result<Option<Background>> {
    let Some(path) = view.image_path() else { return Ok(None) };
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
