//! The `Evaluate` pass: scores earlier passes against ground truth, in linear light, with masks eroded by one pixel.
//!
//! Predictions are read from the EXR files that the passes wrote, so that the scores apply to the written files.

use crate::codec::frame::{Frame, Layer, read_frame_layers};
use crate::codec::gltf::import::read_mesh;
use crate::codec::image::{Gamma, IMAGE_EXTENSIONS, Orientation, read_image};
use crate::error::{Error, Result};
use crate::mesh::chamfer::chamfer_distance;
use crate::pass::render::{ChosenView, chosen_views};
use crate::pass::session::Session;
use crate::report::heat::{factor_for, heat_map};
use crate::report::metrics::{Pair, albedo_psnr, coverage_iou, erode, mean, mean_normal_angle_degrees};
use crate::report::scores::{EvalView, PassScores, Scaling, score_views};
use crate::report::sheet::{Sheet, SheetCell, SheetRow, Theme, choose_evenly, write_sheet};
use crate::report::tone::{Backdrop, Look, Picture};
use crate::scene::{EvaluatePass, LayerTruth, Pass, Score, ScoreScale, Truth, ViewChoice};
use crate::view::camera::Camera;
use crate::view::{Photograph, ViewMask, ViewName};
use bevy_ecs::prelude::World;
use glam::Vec3;
use std::path::{Path, PathBuf};

/// Views shown in a row of the contact sheet.
const SHEET_VIEWS: usize = 3;

/// One view of a scored pass.
struct ScoredView {
    eval: EvalView,
    camera: Camera,
    albedo: Vec<Vec3>,
    normal: Vec<Vec3>,
    coverage: Vec<f32>,
    /// Intersection over union of the rendered object and the mask of the view, if it has one.
    mask_iou: Option<f64>,
}

/// A pass that is scored. Its views are read one at a time, with the layers that are needed: one takes 45 bytes a pixel, and 12 more a layer.
struct ScoredPass {
    name: String,
    views: Vec<ChosenView>,
    truths: TrueImages,
}

/// Where the ground truth of the views of a pass is.
enum TrueImages {
    Photographs,
    Folder(PathBuf),
    /// Pictures of the true object: radiance, view by view.
    Made(Vec<Vec<Vec3>>),
}

/// Runs the pass.
///
/// # Errors
/// If a prediction or a ground truth is missing or has the wrong size.
pub fn run(session: &mut Session, pass: &EvaluatePass) -> Result<()> {
    let mut rows = Vec::new();
    for (i, score) in pass.scores.iter().enumerate() {
        let scored = ScoredPass::open(session, score)?;
        let mut overlaps = vec![None; scored.views.len()];
        let scores = score_views(scored.views.len(), scaling(score.scale), |k| {
            let view = scored.load(session, k, layers_of(score.scale))?;
            overlaps[k] = view.mask_iou;
            Ok(view.eval)
        })?;
        rows.push(sheet_row(session, &scored, &scores, layers_of(score.scale))?);
        session.scores.passes.insert(score.pass.clone(), scores);
        if i == 0 {
            session.scores.mask_iou = mean(&overlaps.into_iter().flatten().collect::<Vec<_>>());
            score_layers(session, pass, &scored)?;
        }
    }
    if let Some(path) = &pass.mesh {
        let (found, truth) = (session.surface.mesh(), read_mesh(path)?);
        session.scores.chamfer = chamfer_distance(found, &truth, session.scene.seed);
    }
    let path = session.folder(&pass.name).join("contact_sheet.png");
    let sheet = Sheet {
        title: session.out.file_name().unwrap_or_default().to_string_lossy().into_owned(),
        subtitle: "prediction, truth, error".to_owned(),
        rows,
        theme: Theme::Light,
        ..Sheet::default()
    };
    if !sheet.rows.is_empty() {
        write_sheet(&path, &sheet)?;
        session.progress.print(&format!("{}: {}", pass.name, path.display()));
    }
    Ok(())
}

impl ScoredPass {
    fn open(session: &mut Session, score: &Score) -> Result<Self> {
        let views = views_of(session, &score.pass)?;
        let truths = match &score.truth {
            Truth::Photographs => TrueImages::Photographs,
            Truth::Folder(folder) => TrueImages::Folder(folder.clone()),
            Truth::SelfMade { spp } => TrueImages::Made(self_made(session, &score.pass, &views, *spp)?),
        };
        Ok(Self { name: score.pass.clone(), views, truths })
    }

    fn load(&self, session: &Session, i: usize, layers: &[Layer]) -> Result<ScoredView> {
        let view = &self.views[i];
        let path = session.folder(&self.name).join(format!("{}.exr", view.stem));
        let frame = read_frame_layers(path, layers)?;
        let truth = self.truth(&session.pipeline.world, i)?;
        let mask = session.pipeline.world.get::<ViewMask>(view.entity).map(|mask| mask.0.mask());
        let mask_iou = mask.as_ref().and_then(|mask| coverage_iou(&frame.alpha, &mask.coverage));
        let coverage = mask.map_or(frame.alpha, |mask| mask.coverage);
        let size = [frame.width, frame.height];
        if truth.len() != frame.color.len() || coverage.len() != frame.color.len() {
            return Err(Error::run(
                format!("{}, view {}", self.name, view.stem),
                format!(
                    "the ground truth has {} pixels, the prediction {} × {}",
                    truth.len(),
                    size[0],
                    size[1]
                ),
            ));
        }
        let eval = EvalView {
            name: view.stem.clone(),
            width: frame.width,
            height: frame.height,
            mask: erode(size, &coverage),
            prediction: frame.color,
            diffuse: frame.diffuse,
            specular: frame.specular,
            truth,
        };
        let (camera, albedo, normal) = (view.camera, frame.albedo, frame.normal);
        Ok(ScoredView { eval, camera, albedo, normal, coverage, mask_iou })
    }

    fn truth(&self, world: &World, i: usize) -> Result<Vec<Vec3>> {
        let view = &self.views[i];
        match &self.truths {
            TrueImages::Photographs => {
                let found = world.get::<Photograph>(view.entity).map(|photograph| photograph.image().pixels);
                found.ok_or_else(|| {
                    Error::run(&self.name, format!("view {} has no photograph to compare with", view.stem))
                })
            }
            TrueImages::Folder(folder) => {
                let name = world.get::<ViewName>(view.entity).map_or("", |name| name.0.as_str());
                read_fitting(&true_image_path(folder, name), Gamma::Srgb, &view.camera)
            }
            TrueImages::Made(pictures) => Ok(pictures[i].clone()),
        }
    }
}

/// The layers that a scale needs.
fn layers_of(rule: ScoreScale) -> &'static [Layer] {
    match rule {
        ScoreScale::None | ScoreScale::PerChannel => &[],
        ScoreScale::PerLayer => &[Layer::Diffuse, Layer::Specular],
    }
}

/// The views that a pass rendered, by the scene file.
fn views_of(session: &mut Session, pass: &str) -> Result<Vec<ChosenView>> {
    let settings = session.scene.passes.iter().find(|p| p.name() == pass).and_then(Pass::render);
    let choice: &ViewChoice = &settings
        .ok_or_else(|| Error::run("evaluate", format!("there is no earlier pass {pass} that renders")))?
        .views;
    Ok(chosen_views(&mut session.pipeline.world, choice))
}

fn scaling(rule: ScoreScale) -> Scaling {
    match rule {
        ScoreScale::None => Scaling::None,
        ScoreScale::PerChannel => Scaling::PerChannel,
        ScoreScale::PerLayer => Scaling::PerLayer,
    }
}

/// The file of the ground truth of a view: the first format that exists, EXR if none does.
pub fn true_image_path(folder: &Path, name: &str) -> PathBuf {
    let of_kind = |kind: &str| folder.join(format!("{name}.{kind}"));
    let found = IMAGE_EXTENSIONS.iter().map(|kind| of_kind(kind)).find(|path| path.is_file());
    found.unwrap_or_else(|| of_kind("exr"))
}

/// The file of the ground-truth albedo or normals of a view: `albedo_003.exr` for the view `003`, `r_003` or `test_003`.
pub fn true_layer_path(folder: &Path, layer: &str, view: &str) -> PathBuf {
    let number = view.rsplit('_').next().unwrap_or(view);
    folder.join(format!("{layer}_{number}.exr"))
}

/// The pixels of the ground-truth image of a view. If views are downscaled on reading, so is their ground truth.
///
/// # Errors
/// [`Error::Input`] if the image cannot be read or its size does not match the view.
pub fn read_fitting(path: &Path, gamma: Gamma, camera: &Camera) -> Result<Vec<Vec3>> {
    let image = read_image(path, gamma, Orientation::Upright)?.image;
    let factor = image.width / camera.width.max(1);
    let fitting = if factor > 1 { image.downscaled(factor) } else { image.clone() };
    if (fitting.width, fitting.height) == (camera.width, camera.height) {
        return Ok(fitting.pixels);
    }
    let problem = format!(
        "the truth has {}×{} pixels, its view {}×{}",
        image.width, image.height, camera.width, camera.height
    );
    let help = "A truth is as large as its view, or a whole number of times larger.";
    Err(Error::input(path, "", problem, help))
}

/// The true object under the light and edits of the pass.
fn self_made(session: &mut Session, pass: &str, views: &[ChosenView], spp: u32) -> Result<Vec<Vec<Vec3>>> {
    let found = session.scene.passes.iter().find(|p| p.name() == pass);
    let edits = found.map_or(&[] as &[_], Pass::edits);
    let light = session.lights.of_passes.get(pass);
    let cameras: Vec<Camera> = views.iter().map(|view| view.camera).collect();
    let bar = session.progress.bar("truth", cameras.len() as u64);
    let seed = session.scene.seed.wrapping_add(1_000_003);
    let Some(truth) = &mut session.truth else {
        return Err(Error::run(pass, "only `Photographed` views have a true object"));
    };
    let frames = truth.pictures(&cameras, light, edits, spp, seed, || bar.inc(1))?;
    bar.finish_and_clear();
    Ok(frames.into_iter().map(|frame| frame.color).collect())
}

/// A layer of the pixels that count, and its ground truth, of one view.
#[derive(Default)]
struct LayerPixels {
    prediction: Vec<Vec3>,
    truth: Vec<Vec3>,
    counts: Vec<bool>,
}

impl LayerPixels {
    fn new(view: &ScoredView, layer: &[Vec3], truth: &[Vec3]) -> Result<Self> {
        let EvalView { width, height, mask, .. } = &view.eval;
        Pair::new([*width, *height], layer, truth, mask)?;
        let counted = |pixels: &[Vec3]| -> Vec<Vec3> {
            pixels.iter().zip(mask).filter(|(_, counts)| **counts).map(|(pixel, _)| *pixel).collect()
        };
        let (prediction, truth) = (counted(layer), counted(truth));
        Ok(Self { counts: vec![true; prediction.len()], prediction, truth })
    }

    fn pair(&self) -> Result<Pair<'_>> {
        Pair::new([self.counts.len(), 1], &self.prediction, &self.truth, &self.counts)
    }
}

/// Scores the albedo and normals of the views of a pass.
fn score_layers(session: &mut Session, pass: &EvaluatePass, scored: &ScoredPass) -> Result<()> {
    if let Some(truth) = &pass.albedo {
        let pixels = layer_pixels(session, scored, truth, Layer::Albedo)?;
        let pairs = pixels.iter().map(LayerPixels::pair).collect::<Result<Vec<_>>>()?;
        session.scores.albedo_psnr = albedo_psnr(&pairs).map(|score| score.psnr);
    }
    if let Some(truth) = &pass.normal {
        let pixels = layer_pixels(session, scored, truth, Layer::Normal)?;
        let pairs = pixels.iter().map(LayerPixels::pair).collect::<Result<Vec<_>>>()?;
        session.scores.normal_deg = mean_normal_angle_degrees(&pairs);
    }
    Ok(())
}

fn layer_pixels(
    session: &mut Session,
    scored: &ScoredPass,
    truth: &LayerTruth,
    layer: Layer,
) -> Result<Vec<LayerPixels>> {
    let (name, normals) = if layer == Layer::Normal { ("normal", true) } else { ("albedo", false) };
    let mut pixels = Vec::new();
    for i in 0..scored.views.len() {
        let view = scored.load(session, i, &[layer])?;
        let truth = true_layer(session, &view, truth, name, i as u64)?;
        let found = if normals { &view.normal } else { &view.albedo };
        pixels.push(LayerPixels::new(&view, found, &truth)?);
    }
    Ok(pixels)
}

/// Ground-truth albedo or normals of a view.
fn true_layer(
    session: &mut Session,
    view: &ScoredView,
    truth: &LayerTruth,
    layer: &str,
    number: u64,
) -> Result<Vec<Vec3>> {
    match truth {
        LayerTruth::Folder(folder) => {
            let path = true_layer_path(folder, layer, &view.eval.name);
            read_fitting(&path, Gamma::Linear, &view.camera)
        }
        LayerTruth::SelfMade => {
            let seed = session.scene.seed.wrapping_add(number);
            let Some(object) = &mut session.truth else {
                return Err(Error::run(layer, "only `Photographed` views have a true object"));
            };
            let frames = object.pictures(&[view.camera], None, &[], 16, seed, || ())?;
            let pick = |f: Frame| if layer == "albedo" { f.albedo } else { f.normal };
            Ok(frames.into_iter().flat_map(pick).collect())
        }
    }
}

/// A few views: prediction, ground truth, error.
fn sheet_row(
    session: &Session,
    scored: &ScoredPass,
    scores: &PassScores,
    layers: &[Layer],
) -> Result<SheetRow> {
    let factor = factor_for(scores.psnr);
    let mut cells = Vec::new();
    for i in choose_evenly(scored.views.len(), SHEET_VIEWS) {
        let view = scored.load(session, i, layers)?;
        let eval = &view.eval;
        let shown = scores.scored_prediction(eval);
        cells.push(cell(format!("{} {:.1} dB", eval.name, scores.views[i].psnr), &view, &shown)?);
        cells.push(cell("truth".to_owned(), &view, &eval.truth)?);
        let images = [shown.as_slice(), eval.truth.as_slice()];
        let size = [eval.width as u32, eval.height as u32];
        let image = heat_map(size, images, &view.coverage, factor, Theme::Light.mat());
        cells.push(SheetCell { label: format!("error x {factor}"), image });
    }
    Ok(SheetRow { heading: format!("{}: {}", scored.name, scores.summary()), cells })
}

fn cell(label: String, view: &ScoredView, color: &[Vec3]) -> Result<SheetCell> {
    let picture = Picture { width: view.eval.width, height: view.eval.height, color, alpha: &view.coverage };
    let mat = Theme::Light.mat().map(|b| crate::math::color::linear_from_srgb(f32::from(b) / 255.0));
    let image = picture.rgb8(&Look::default(), Backdrop::Solid(Vec3::from(mat)))?;
    Ok(SheetCell { label, image })
}
