//! The object as it is during a run, for whoever looks at it: copied between two steps, and rendered in a world of its own.
//!
//! A copy reads the run's world and changes nothing in it. All else is done on the copy, by whichever thread has it.

use crate::codec::exr_frame::Frame;
use crate::error::stop::{check_interrupted, stopped_by};
use crate::error::{Error, Result};
use crate::fit::exposure::Exposures;
use crate::light::LightLobe;
use crate::light::groups::{GroupLight, other_lights, spawn_group_lights};
use crate::light::light_frame::{LightFrame, OwnLightFrame};
use crate::light::lights::own_lobes;
use crate::light::placement::{PicturePlacement, Placements};
use crate::material::edit::MaterialState;
use crate::material::shown::{recovered_material, spawn_material};
use crate::math::color::linear_from_srgb;
use crate::math::ray::Intersect;
use crate::mesh::Surface;
use crate::page::upright::upright;
use crate::page::{Contents, PageCamera, PageLight, html};
use crate::pass::page_cameras::page_cameras;
use crate::pipeline::Pipeline;
use crate::report::heat::error_map;
use crate::report::html::data::{PassViews, RunReport, ViewReport};
use crate::report::metrics::erode;
use crate::report::scores::{EvalView, Scaling, score_views};
use crate::report::sheet::{Theme, choose_evenly};
use crate::report::thumbnail::{jpeg_address, thumbnail_jpeg};
use crate::report::tone::{Backdrop, Look, Picture};
use crate::sample::point::Scenery;
use crate::sdf::volume::SdfSurface;
use crate::shade::frame::{FramePlugin, render_frame, resolve};
use crate::shape::field::SdfField;
use crate::shape::vertices::MovingMesh;
use crate::view::{ByView, Camera, Photograph, Placement, Split, ViewIndex, ViewMask};
use crate::visibility::{FrameVisibilityPlugin, ObjectVisibility};
use bevy_ecs::prelude::World;
use glam::Vec3;
use image::RgbImage;
use rayon::prelude::*;
use std::sync::Arc;

/// Photographs that renders are compared with, at most, and how many of these are shown: the worst.
const COMPARED: usize = 12;
const SHOWN: usize = 4;
/// Longest side of these, and of the picture of a surface that is a field, in pixels.
const SIDE: u32 = 192;
const FIELD_SIDE: u32 = 400;
/// Samples a pixel.
const SAMPLES: u32 = 4;
/// What the views are called.
const NOW: &str = "as it is now";

/// The object at one moment of a run.
pub struct Snapshot {
    form: Form,
    material: MaterialState,
    lobes: Vec<LightLobe>,
    /// The lights of the other groups of photographs.
    other_lobes: Vec<GroupLight>,
    frame: LightFrame,
    visibility: Option<ObjectVisibility>,
    /// The cameras of all views, those held out first.
    cameras: Vec<(ViewIndex, PageCamera)>,
    /// How the object lies in each view.
    turns: ByView<PicturePlacement>,
    exposures: Exposures,
    photographs: Arc<Vec<Reduced>>,
    up: Vec3,
}

/// The surface, which does not change once it is here.
enum Form {
    Mesh(Arc<Surface>),
    Field(Arc<SdfSurface>),
}

/// A training photograph, made small.
struct Reduced {
    view: ViewIndex,
    /// How many times smaller it is.
    factor: u32,
    color: Vec<Vec3>,
    /// Empty without a mask.
    coverage: Vec<f32>,
}

impl Snapshot {
    /// Copies the object out of a world in which nothing is at work; `surface` is that of the run, unless the world has one that moves. An
    /// earlier copy hands on the small photographs.
    ///
    /// # Errors
    /// If the pool of texels is not whole.
    pub(super) fn copy(
        world: &mut World,
        surface: &Arc<Surface>,
        up: Vec3,
        before: Option<&Self>,
    ) -> Result<Self> {
        let photographs = before.map(|before| before.photographs.clone());
        let photographs = photographs.unwrap_or_else(|| Arc::new(reduced_photographs(world)));
        let field = world.get_resource::<SdfField>().map(|field| Arc::new(field.surface.clone()));
        let moving = world.get_resource::<MovingMesh>().map(|mesh| mesh.surface.clone());
        let mesh = moving.unwrap_or_else(|| surface.clone());
        let traced = world.get_resource::<ObjectVisibility>().filter(|_| field.is_none());
        Ok(Self {
            visibility: traced.filter(|traced| !traced.sees_all()).map(ObjectVisibility::unlit),
            form: field.map_or(Form::Mesh(mesh), Form::Field),
            material: recovered_material(world)?,
            lobes: own_lobes(world),
            other_lobes: other_lights(world),
            frame: world.get_resource::<OwnLightFrame>().map(|own| own.0).unwrap_or_default(),
            cameras: cameras(world),
            turns: turns(world),
            exposures: world.get_resource::<Exposures>().cloned().unwrap_or_default(),
            photographs,
            up,
        })
    }

    /// Whether the surface is still a field, which has no page.
    pub fn is_field(&self) -> bool {
        matches!(self.form, Form::Field(_))
    }

    /// The page of the object ([`page`](crate::page)), without photographs.
    ///
    /// # Errors
    /// If the surface is a field; those of the page.
    pub fn page(&self, title: &str) -> Result<String> {
        let Form::Mesh(surface) = &self.form else {
            return Err(Error::run("the page", "the surface is not a mesh yet"));
        };
        let cameras: Vec<PageCamera> = self.cameras.iter().map(|(_, camera)| camera.clone()).collect();
        let light =
            PageLight { name: "found".into(), lobes: self.lobes.clone(), frame: self.frame, own: true };
        html(&Contents {
            title,
            up: upright(&cameras, self.up),
            surface,
            material: &self.material,
            edits: Vec::new(),
            lights: vec![light],
            cameras,
            visibility: self.visibility.as_ref(),
        })
    }

    /// A picture of the object from a training view, as a `data:` address.
    ///
    /// # Errors
    /// If a system fails; [`Error::Interrupted`] if the run is stopped meanwhile.
    pub fn picture(&self) -> Result<String> {
        let train = self.cameras.iter().find(|(_, camera)| camera.split == Split::Train);
        let (index, view) = train
            .or(self.cameras.first())
            .ok_or_else(|| Error::run("a picture of the object", "the scene has no view"))?;
        let frame = self.shot(&mut self.pipeline(), *index, reduced(&view.camera, FIELD_SIDE).0)?;
        address(&shown([frame.width, frame.height], &frame.color, &frame.alpha)?)
    }

    /// The worst of a few training views: photograph, render and error, as a report shows them. There is nothing in it without photographs.
    ///
    /// # Errors
    /// As [`Self::picture`].
    pub fn worst_views(&self) -> Result<RunReport> {
        let mut pipeline = self.pipeline();
        let mut views = Vec::new();
        for photograph in self.photographs.iter() {
            views.extend(self.compared(&mut pipeline, photograph)?);
        }
        let mut run = RunReport::default();
        if views.is_empty() {
            return Ok(run);
        }
        let mut scores = score_views(views.len(), Scaling::None, |i| Ok(&views[i]))?;
        let mut order: Vec<usize> = (0..views.len()).collect();
        order.sort_by(|a, b| scores.views[*a].psnr.total_cmp(&scores.views[*b].psnr));
        order.truncate(SHOWN);
        let drawn = order.iter().map(|i| drawn(&views[*i])).collect::<Result<_>>()?;
        scores.views = order.iter().map(|i| scores.views[*i].clone()).collect();
        run.views = vec![PassViews { pass: NOW.to_owned(), views: drawn, left_out: 0 }];
        run.scores.passes.insert(NOW.to_owned(), scores);
        Ok(run)
    }

    /// A render beside its photograph; `None` if no pixel of it counts.
    fn compared(&self, pipeline: &mut Pipeline, photograph: &Reduced) -> Result<Option<EvalView>> {
        let Some((_, view)) = self.cameras.iter().find(|(index, _)| *index == photograph.view) else {
            return Ok(None);
        };
        let frame = self.shot(pipeline, photograph.view, view.camera.scaled(photograph.factor))?;
        let outline = match photograph.coverage.is_empty() {
            true => frame.alpha.clone(),
            false => photograph.coverage.clone(),
        };
        if frame.color.len() != photograph.color.len() {
            return Ok(None);
        }
        let mask = erode([frame.width, frame.height], &outline);
        let factor = self.exposures.factor(photograph.view);
        let is_compared = mask.contains(&true);
        Ok(is_compared.then(|| EvalView {
            name: view.name.clone(),
            width: frame.width,
            height: frame.height,
            mask,
            prediction: frame.color,
            diffuse: Vec::new(),
            specular: Vec::new(),
            truth: photograph.color.iter().map(|color| *color / factor).collect(),
            coverage: outline,
            alpha: frame.alpha,
            in_srgb: true,
        }))
    }

    /// A frame that is whole, of the object as it lies in a view.
    fn shot(&self, pipeline: &mut Pipeline, view: ViewIndex, camera: Camera) -> Result<Frame> {
        let before = stopped_by();
        check_interrupted()?;
        let shown = self.turns.get(view).copied();
        shown.into_iter().for_each(|shown| pipeline.world.insert_resource::<PicturePlacement>(shown));
        let target = render_frame(pipeline, camera, SAMPLES)?;
        // While a run stops, loops leave rows as they are, and the run may have seen to that by now.
        if stopped_by() == before { Ok(resolve(&target)) } else { Err(Error::Interrupted) }
    }

    /// A world with nothing but the object.
    fn pipeline(&self) -> Pipeline {
        let mut pipeline = Pipeline::new();
        pipeline.add_plugin(&FramePlugin);
        let scenery: Arc<dyn Intersect> = match &self.form {
            Form::Mesh(surface) => surface.clone(),
            Form::Field(surface) => surface.clone(),
        };
        let world = &mut pipeline.world;
        world.insert_resource(Scenery(scenery));
        world.insert_resource(OwnLightFrame(self.frame));
        spawn_material(world, &self.material);
        world.spawn_batch(self.lobes.clone());
        spawn_group_lights(world, &self.other_lobes);
        if let Some(visibility) = &self.visibility {
            world.insert_resource(visibility.unlit());
            pipeline.add_plugin(&FrameVisibilityPlugin);
        }
        pipeline
    }
}

/// Photograph, render and error of a view.
fn drawn(view: &EvalView) -> Result<ViewReport> {
    let size = [view.width, view.height];
    let part = |color: &[Vec3]| address(&shown(size, color, &view.coverage)?).map(Some);
    let (prediction, truth) = (view.prediction.as_slice(), view.truth.as_slice());
    let error =
        error_map(size.map(|side| side as u32), [prediction, truth], &view.coverage, Theme::Light.mat());
    Ok(ViewReport {
        name: view.name.clone(),
        truth: part(truth)?,
        render: part(prediction)?,
        error: Some(address(&error)?),
    })
}

/// Radiance as a picture on the mat of a report.
fn shown([width, height]: [usize; 2], color: &[Vec3], alpha: &[f32]) -> Result<RgbImage> {
    let mat = Theme::Light.mat().map(|byte| linear_from_srgb(f32::from(byte) / 255.0));
    let picture = Picture { width, height, color, alpha };
    picture.rgb8(&Look::default(), Backdrop::Solid(Vec3::from(mat)))
}

fn address(picture: &RgbImage) -> Result<String> {
    Ok(jpeg_address(&thumbnail_jpeg(picture, FIELD_SIDE)?))
}

/// The cameras of all views, by number, in the order of the page.
fn cameras(world: &mut World) -> Vec<(ViewIndex, PageCamera)> {
    let cameras = page_cameras(world).into_iter();
    cameras.filter_map(|(view, camera)| Some((*world.get::<ViewIndex>(view)?, camera))).collect()
}

/// How the object lies in each view.
fn turns(world: &mut World) -> ByView<PicturePlacement> {
    let placements = world.get_resource::<Placements>().cloned().unwrap_or_default();
    let mut views = world.query::<(&ViewIndex, &Placement)>();
    let shown = |placement: &Placement| PicturePlacement::new(&placements, *placement);
    views.iter(world).map(|(view, placement)| (*view, shown(placement))).collect()
}

/// A camera whose picture has at most about `side` pixels a side, and by which factor it is smaller.
fn reduced(camera: &Camera, side: u32) -> (Camera, u32) {
    let factor = camera.width.max(camera.height).div_ceil(side).max(1);
    (camera.scaled(factor), factor)
}

/// A few training photographs, evenly chosen of those that this process has.
fn reduced_photographs(world: &mut World) -> Vec<Reduced> {
    let mut query = world.query::<(&ViewIndex, &Split, &Camera, &Photograph, Option<&ViewMask>)>();
    let is_here = |split: &Split, photograph: &Photograph| *split == Split::Train && photograph.has_pixels();
    let mut train: Vec<_> =
        query.iter(world).filter(|(_, split, _, photograph, _)| is_here(split, photograph)).collect();
    train.sort_by_key(|(index, ..)| **index);
    let chosen = choose_evenly(train.len(), COMPARED);
    let small = |place: usize| {
        let (index, _, camera, photograph, mask) = train[place];
        reduced_photograph(*index, camera, photograph, mask)
    };
    chosen.into_par_iter().map(small).collect()
}

fn reduced_photograph(
    view: ViewIndex,
    camera: &Camera,
    photograph: &Photograph,
    mask: Option<&ViewMask>,
) -> Reduced {
    let (small, factor) = reduced(camera, SIDE);
    let width = photograph.size()[0] as usize;
    let pixels = |i: u32| {
        let (x, y) = (i % small.width * factor, i / small.width * factor);
        let row = move |y: u32| (x..x + factor).map(move |x| y as usize * width + x as usize);
        (y..y + factor).flat_map(row)
    };
    let share = 1.0 / (factor * factor) as f32;
    let count = small.width * small.height;
    let color = |i| share * pixels(i).map(|pixel| photograph.radiance(pixel)).sum::<Vec3>();
    let covered = |mask: &ViewMask, i| share * pixels(i).map(|pixel| mask.0.coverage(pixel)).sum::<f32>();
    Reduced {
        view,
        factor,
        color: (0..count).map(color).collect(),
        coverage: mask.map_or(Vec::new(), |mask| (0..count).map(|i| covered(mask, i)).collect()),
    }
}
