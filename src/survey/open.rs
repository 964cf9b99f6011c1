//! Reading a scene's data for a survey: every view once, small, with few of them in memory at a time.

use crate::codec::gltf::import::read_mesh;
use crate::codec::image::{Gamma, read_image};
use crate::dataset::{DatasetOptions, LoadedView, PlannedView, has_split, load_notes, open_dataset};
use crate::error::Result;
use crate::math::color::luminance;
use crate::mesh::primitive::{box_mesh, sphere_mesh};
use crate::mesh::triangles::Mesh;
use crate::report::sheet::choose_evenly;
use crate::scene::{Dataset, Pass, Scene, Surface, Truth, ViewChoice, Views};
use crate::survey::examine::{Subject, Survey, examine};
use crate::survey::look::{Look, MaskSource, OpenPhotograph, OpenView, SmallMask};
use crate::survey::turntable::{BACKGROUND_SIDE, BACKGROUNDS, Background};
use crate::view::{Mask, Split, ViewRecord};
use glam::Vec3;
use rayon::prelude::*;

/// Most pixels along a side of the pictures that are looked at.
const LOOK_SIDE: u32 = 1024;

/// Surveys the data set of a scene; `None` if its views are not a data set. Thumbnails are for contact sheets alone.
///
/// # Errors
/// Those of [`open_dataset`]; the first, in the order of the views, of reading photographs and masks; those of reading the mesh.
pub fn survey(scene: &Scene, with_thumbnails: bool) -> Result<Option<Survey>> {
    let Views::Dataset(spec) = &scene.views else { return Ok(None) };
    let options = dataset_options(spec, scene.up);
    let (mut planned, mut notes, mut layout) = (Vec::new(), Vec::new(), spec.layout);
    for split in wanted_splits(scene, spec, &options)? {
        let opened = open_dataset(&spec.path, split, &options)?;
        planned.extend(opened.views);
        notes.extend(opened.notes);
        layout = opened.layout;
    }
    let looked: Vec<Result<(Look, LoadedView)>> =
        planned.par_iter().map(|view| look_at(view, spec.focal_scale, with_thumbnails)).collect();
    let looked = looked.into_iter().collect::<Result<Vec<_>>>()?;
    let (looks, loaded): (Vec<Look>, Vec<LoadedView>) = looked.into_iter().unzip();
    notes.extend(load_notes(&loaded));
    let mesh = known_mesh(&scene.surface)?;
    let (Surface::Mesh { texture_size, .. }
    | Surface::Unknown { texture_size, .. }
    | Surface::Sphere { texture_size, .. }
    | Surface::Box { texture_size, .. }) = &scene.surface;
    let subject = Subject {
        mesh: mesh.as_ref(),
        up: scene.up,
        texture_size: *texture_size,
        scored: is_scored(scene),
    };
    let backgrounds = backgrounds(&planned, &looks, spec.gamma)?;
    let mut survey = examine(looks, &subject, &backgrounds);
    survey.layout = layout;
    survey.notes.splice(0..0, notes);
    Ok(Some(survey))
}

/// How a scene's data set is read.
pub fn dataset_options(spec: &Dataset, up: Vec3) -> DatasetOptions {
    DatasetOptions {
        layout: spec.layout,
        gamma: spec.gamma,
        pixel_center: spec.pixel_center,
        downscale: spec.downscale,
        every: spec.every,
        hold_out: spec.hold_out,
        select: (!spec.select.is_empty()).then(|| spec.select.clone()),
        up,
    }
}

/// The splits that a scene reads: those that a pass needs, so that a data set without one is an error, and those that are there.
///
/// # Errors
/// If the layout of the data cannot be determined.
pub fn wanted_splits(scene: &Scene, spec: &Dataset, options: &DatasetOptions) -> Result<Vec<Split>> {
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

/// Reads a view and looks at it; of what was read only name and counts are kept.
fn look_at(view: &PlannedView, focal_scale: f32, with_thumbnail: bool) -> Result<(Look, LoadedView)> {
    let LoadedView { mut record, repaired, blackened } = view.load()?;
    record.camera.focal = record.camera.focal.map(|focal| focal * focal_scale);
    let size = [record.camera.width, record.camera.height];
    let source = if view.mask_path().is_some() { MaskSource::File } else { MaskSource::Alpha };
    let look = Look::new(&reduced(OpenView::new(&record)), size, source, with_thumbnail);
    let rest = ViewRecord { photograph: None, mask: None, ..record };
    Ok((look, LoadedView { record: rest, repaired, blackened }))
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
fn backgrounds(planned: &[PlannedView], looks: &[Look], gamma: Gamma) -> Result<Vec<Background>> {
    let masked: Vec<(&PlannedView, &SmallMask)> = planned
        .iter()
        .zip(looks)
        .filter(|(_, look)| look.mask_source == MaskSource::File && look.light.is_some())
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
    let loaded = read_image(path, gamma)?;
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
