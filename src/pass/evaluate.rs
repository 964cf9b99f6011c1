//! The `Evaluate` pass: scores earlier passes against ground truth, in linear light, with masks eroded by one pixel; and against
//! photographs and other pictures of encoded colors also as the field's tables do, in sRGB.
//!
//! The pass writes a contact sheet of a few views, and for the report small pictures of all views: `<scored pass>/<view>_truth.jpg`, `_render.jpg` and
//! `_error.jpg`. Predictions are read from the EXR files that the passes wrote, so that the scores apply to the written files.

use crate::codec::exr_frame::{Frame, Layer, read_frame_layers};
use crate::codec::gltf::import::read_mesh;
use crate::codec::image::{Gamma, image_header};
use crate::error::stop::check_interrupted;
use crate::error::{Error, Result};
use crate::mesh::chamfer::chamfer_distance;
use crate::pass::render::{ChosenView, chosen_views};
use crate::pass::session::Session;
use crate::pass::truth_files::{ViewFiles, read_covered};
use crate::pass::view_report::{self, ScoredOutcome, outlier_share};
use crate::profile::stage;
use crate::report::heat::{error_map, factor_for, heat_map};
use crate::report::metrics::{ImagePair, albedo_psnr, coverage_iou, erode, mean};
use crate::report::normals::NormalAngles;
use crate::report::scores::{EvalView, PassScores, Scaling, score_views};
use crate::report::sheet::{Sheet, SheetCell, SheetRow, Theme, choose_evenly, write_sheet};
use crate::report::thumbnail::{side_for, write_thumbnail};
use crate::report::tone::{Backdrop, Look, Picture};
use crate::scene::{EvaluatePass, LayerTruth, Pass, RenderSettings, Score, ScoreScale, Truth};
use crate::view::camera::Camera;
use crate::view::{Photograph, Placement, ViewMask};
use bevy_ecs::prelude::{Entity, World};
use glam::Vec3;
use image::RgbImage;
use std::path::{Path, PathBuf};

/// Views shown in a row of the contact sheet.
const SHEET_VIEWS: usize = 3;

/// What is shown of every view, by the ends of the names of the files.
pub const PARTS: [&str; 3] = ["truth", "render", "error"];

/// One view of a scored pass.
struct ScoredView {
    eval: EvalView,
    camera: Camera,
    albedo: Vec<Vec3>,
    normal: Vec<Vec3>,
    /// Intersection over union of the rendered object and the mask of the view, if it has one.
    mask_iou: Option<f64>,
}

impl ScoredView {
    /// Coverage of the object: the view's mask, or as rendered if it has none.
    fn outline(&self) -> &[f32] {
        if self.eval.coverage.is_empty() { &self.eval.alpha } else { &self.eval.coverage }
    }
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
    Files(Vec<PathBuf>),
    /// Pictures of the true object: radiance, view by view.
    Made(Vec<Vec<Vec3>>),
}

/// Runs the pass.
///
/// # Errors
/// If a prediction or a ground truth is missing or has the wrong size.
pub(crate) fn run(session: &mut Session, pass: &EvaluatePass) -> Result<()> {
    let mut views = 0;
    for score in &pass.scores {
        views += views_of(session, &score.pass)?.len();
    }
    let side = side_for(views * PARTS.len());
    let mut rows = Vec::new();
    for i in 0..pass.scores.len() {
        rows.push(score_pass(session, pass, i, side)?);
    }
    if let Some(path) = &pass.mesh {
        let (found, truth) = (session.surface.mesh(), read_mesh(path)?);
        session.scores.chamfer = chamfer_distance(found, &truth, session.scene.seed);
    }
    write_contact_sheet(session, pass, rows)
}

/// Scores the pass that `pass.scores[i]` names, and writes pictures of its views with sides of at most `side` pixels. Returns its row of the
/// contact sheet. The first one also has a report of its views, and its layers are scored.
fn score_pass(session: &mut Session, pass: &EvaluatePass, i: usize, side: u32) -> Result<SheetRow> {
    let score = &pass.scores[i];
    let layers = layers_of(score.scale);
    if rendered_by(session, &score.pass)?.is_denoised() {
        let note = "is denoised: its scores are of pictures whose noise was filtered away";
        session.progress.print(&format!("{}: {} {note}", pass.name, score.pass));
    }
    let scored = ScoredPass::open(session, score)?;
    let mut overlaps = vec![None; scored.views.len()];
    let scores = score_views(scored.views.len(), scaling(score.scale), |k| {
        let view = scored.load(session, k, layers)?;
        overlaps[k] = view.mask_iou;
        Ok(view.eval)
    })?;
    let row = sheet_row(session, &scored, &scores, layers)?;
    let folder = session.folder(&pass.name);
    let outliers = write_parts(session, &scored, &scores, layers, &folder.join(&score.pass), side)?;
    if i == 0 {
        view_report::write(session, &folder, &scored.outcomes(&scores, &outliers))?;
    }
    session.scores.passes.insert(score.pass.clone(), scores);
    if i == 0 {
        session.scores.mask_iou = mean(&overlaps.into_iter().flatten().collect::<Vec<_>>());
        score_layers(session, pass, &scored)?;
    }
    Ok(row)
}

/// Writes the contact sheet, if it has a row.
fn write_contact_sheet(session: &Session, pass: &EvaluatePass, rows: Vec<SheetRow>) -> Result<()> {
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
        let truths = match (&score.truth, score.truth.files()) {
            (Truth::SelfMade { spp }, _) => TrueImages::Made(self_made(session, &score.pass, &views, *spp)?),
            (_, Some(files)) => {
                let files = ViewFiles::of(files);
                TrueImages::Files(views.iter().map(|view| files.image(&view.name)).collect())
            }
            (_, None) => TrueImages::Photographs,
        };
        Ok(Self { name: score.pass.clone(), views, truths })
    }

    fn load(&self, session: &Session, i: usize, layers: &[Layer]) -> Result<ScoredView> {
        check_interrupted()?;
        let _reading = stage("views read");
        let view = &self.views[i];
        let path = session.folder(&self.name).join(format!("{}.exr", view.stem));
        let frame = read_frame_layers(path, layers)?;
        let (truth, covered) = self.truth(&session.pipeline.world, i)?;
        let mask = session.pipeline.world.get::<ViewMask>(view.entity).map(|mask| mask.0.mask());
        let mask_iou = mask.as_ref().and_then(|mask| coverage_iou(&frame.alpha, &mask.coverage));
        let coverage = mask.map(|mask| mask.coverage).or(covered).unwrap_or_default();
        let outline = if coverage.is_empty() { &frame.alpha } else { &coverage };
        let size = [frame.width, frame.height];
        if truth.len() != frame.color.len() || outline.len() != frame.color.len() {
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
            mask: erode(size, outline),
            prediction: frame.color,
            diffuse: frame.diffuse,
            specular: frame.specular,
            truth,
            alpha: frame.alpha,
            coverage,
            in_srgb: self.truths.are_encoded(i)?,
        };
        let (camera, albedo, normal) = (view.camera, frame.albedo, frame.normal);
        Ok(ScoredView { eval, camera, albedo, normal, mask_iou })
    }

    /// PSNR and share of outliers of each view.
    fn outcomes(&self, scores: &PassScores, outliers: &[Option<f64>]) -> Vec<ScoredOutcome> {
        let each = self.views.iter().zip(&scores.views).zip(outliers);
        each.map(|((view, scores), outliers)| ScoredOutcome {
            view: view.entity,
            psnr: scores.psnr,
            outliers: *outliers,
        })
        .collect()
    }

    /// The true radiance of view `i`, and its coverage if it is a picture of encoded colors that has some.
    fn truth(&self, world: &World, i: usize) -> Result<(Vec<Vec3>, Option<Vec<f32>>)> {
        let view = &self.views[i];
        match &self.truths {
            TrueImages::Photographs => {
                let found = world.get::<Photograph>(view.entity).map(|photograph| photograph.image().pixels);
                let found = found.ok_or_else(|| {
                    Error::run(&self.name, format!("view {} has no photograph to compare with", view.stem))
                });
                Ok((found?, None))
            }
            TrueImages::Files(files) => {
                let (pixels, alpha) = read_covered(&files[i], Gamma::Srgb, &view.camera)?;
                Ok((pixels, if self.truths.are_encoded(i)? { alpha } else { None }))
            }
            TrueImages::Made(pictures) => Ok((pictures[i].clone(), None)),
        }
    }
}

impl TrueImages {
    /// Whether the picture of view `i` is of encoded colors, as the field's tables are: any but floats.
    fn are_encoded(&self, i: usize) -> Result<bool> {
        match self {
            Self::Photographs => Ok(true),
            Self::Files(files) => Ok(!image_header(&files[i])?.is_float),
            Self::Made(_) => Ok(false),
        }
    }
}

/// The layers that a scale needs.
fn layers_of(rule: ScoreScale) -> &'static [Layer] {
    match rule {
        ScoreScale::None | ScoreScale::PerChannel | ScoreScale::PerView => &[],
        ScoreScale::PerLayer => &[Layer::Diffuse, Layer::Specular],
    }
}

/// The views that a pass rendered, by the scene file.
fn views_of(session: &mut Session, pass: &str) -> Result<Vec<ChosenView>> {
    let settings = rendered_by(session, pass)?.clone();
    Ok(chosen_views(&mut session.pipeline.world, &settings))
}

/// How a pass rendered, by the scene file.
fn rendered_by<'s>(session: &'s Session, pass: &str) -> Result<&'s RenderSettings> {
    let settings = session.scene.passes.iter().find(|p| p.name() == pass).and_then(Pass::render);
    settings.ok_or_else(|| Error::run("evaluate", format!("there is no earlier pass {pass} that renders")))
}

fn scaling(rule: ScoreScale) -> Scaling {
    match rule {
        ScoreScale::None => Scaling::None,
        ScoreScale::PerChannel => Scaling::PerChannel,
        ScoreScale::PerView => Scaling::PerView,
        ScoreScale::PerLayer => Scaling::PerLayer,
    }
}

/// The true object under the light and edits of the pass.
fn self_made(session: &mut Session, pass: &str, views: &[ChosenView], spp: u32) -> Result<Vec<Vec<Vec3>>> {
    let found = session.scene.passes.iter().find(|p| p.name() == pass);
    let edits = found.map_or(&[] as &[_], Pass::edits);
    let light = session.lights.of_passes.get(pass);
    let of = |view: Entity| session.pipeline.world.get::<Placement>(view).copied().unwrap_or_default();
    let views: Vec<(Camera, Placement)> = views.iter().map(|view| (view.camera, of(view.entity))).collect();
    let bar = session.progress.bar("truth", views.len() as u64);
    let seed = session.scene.seed.wrapping_add(1_000_003);
    let Some(truth) = &mut session.truth else {
        return Err(Error::run(pass, "only `Photographed` views have a true object"));
    };
    let frames = truth.pictures(&views, light, edits, spp, seed, || bar.inc(1))?;
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
        ImagePair::new([*width, *height], layer, truth, mask)?;
        let counted = |pixels: &[Vec3]| -> Vec<Vec3> {
            pixels.iter().zip(mask).filter(|(_, counts)| **counts).map(|(pixel, _)| *pixel).collect()
        };
        let (prediction, truth) = (counted(layer), counted(truth));
        Ok(Self { counts: vec![true; prediction.len()], prediction, truth })
    }

    fn pair(&self) -> Result<ImagePair<'_>> {
        ImagePair::new([self.counts.len(), 1], &self.prediction, &self.truth, &self.counts)
    }
}

/// Scores the albedo and normals of the views of a pass.
fn score_layers(session: &mut Session, pass: &EvaluatePass, scored: &ScoredPass) -> Result<()> {
    if let Some(truth) = &pass.albedo {
        let pixels = (0..scored.views.len())
            .map(|i| layer_pixels(session, scored, truth, Layer::Albedo, i))
            .collect::<Result<Vec<_>>>()?;
        let pairs = pixels.iter().map(LayerPixels::pair).collect::<Result<Vec<_>>>()?;
        session.scores.albedo_psnr = albedo_psnr(&pairs).map(|score| score.psnr);
    }
    if let Some(truth) = &pass.normal {
        let mut angles = NormalAngles::default();
        for i in 0..scored.views.len() {
            angles.add(&layer_pixels(session, scored, truth, Layer::Normal, i)?.pair()?);
        }
        session.scores.normal_deg = angles.mean_degrees();
        session.scores.normal_pixels = Some(angles.pixels() as u64);
        session.scores.normal_median_deg = angles.median_degrees();
    }
    Ok(())
}

/// A layer of view `i`.
fn layer_pixels(
    session: &mut Session,
    scored: &ScoredPass,
    truth: &LayerTruth,
    layer: Layer,
    i: usize,
) -> Result<LayerPixels> {
    let view = scored.load(session, i, &[layer])?;
    let names = [&scored.views[i].stem, &scored.views[i].name].map(String::as_str);
    let truth = match truth.files() {
        Some(files) => ViewFiles::of(files).read_layer(layer, names, &view.camera)?,
        None => self_made_layer(session, &view, layer, i as u64)?,
    };
    let found = if layer == Layer::Normal { &view.normal } else { &view.albedo };
    LayerPixels::new(&view, found, &truth)
}

/// Albedo or normals of a view of the true object.
fn self_made_layer(session: &mut Session, view: &ScoredView, layer: Layer, number: u64) -> Result<Vec<Vec3>> {
    let seed = session.scene.seed.wrapping_add(number);
    let Some(object) = &mut session.truth else {
        return Err(Error::run("evaluate", "only `Photographed` views have a true object"));
    };
    let frames = object.pictures(&[(view.camera, Placement::default())], None, &[], 16, seed, || ())?;
    let pick = |f: Frame| if layer == Layer::Albedo { f.albedo } else { f.normal };
    Ok(frames.into_iter().flat_map(pick).collect())
}

/// Writes small pictures of all views: ground truth, prediction as it is scored, error. Returns the share of outliers of each view, of the
/// prediction as it is scored.
fn write_parts(
    session: &Session,
    scored: &ScoredPass,
    scores: &PassScores,
    layers: &[Layer],
    folder: &Path,
    side: u32,
) -> Result<Vec<Option<f64>>> {
    let mut outliers = Vec::new();
    let _drawing = stage("pictures");
    for (i, chosen) in scored.views.iter().enumerate() {
        check_interrupted()?;
        let view = scored.load(session, i, layers)?;
        let EvalView { width, height, truth, .. } = &view.eval;
        let shown = scores.scored_prediction(&view.eval);
        outliers.push(outlier_share(&view.eval, &shown));
        let size = [*width as u32, *height as u32];
        let error = error_map(size, [&shown, truth], view.outline(), Theme::Light.mat());
        let pictures = [picture(&view, truth)?, picture(&view, &shown)?, error];
        for (part, picture) in PARTS.iter().zip(&pictures) {
            write_thumbnail(&folder.join(format!("{}_{part}.jpg", chosen.stem)), picture, side)?;
        }
    }
    Ok(outliers)
}

/// A few views: prediction, ground truth, error.
fn sheet_row(
    session: &Session,
    scored: &ScoredPass,
    scores: &PassScores,
    layers: &[Layer],
) -> Result<SheetRow> {
    let _drawing = stage("pictures");
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
        let image = heat_map(size, images, view.outline(), factor, Theme::Light.mat());
        cells.push(SheetCell { label: format!("error x {factor}"), image });
    }
    Ok(SheetRow { heading: format!("{}: {}", scored.name, scores.summary()), cells })
}

fn cell(label: String, view: &ScoredView, color: &[Vec3]) -> Result<SheetCell> {
    Ok(SheetCell { label, image: picture(view, color)? })
}

/// Radiance of a view as a picture on the mat of a light sheet.
fn picture(view: &ScoredView, color: &[Vec3]) -> Result<RgbImage> {
    let EvalView { width, height, .. } = view.eval;
    let picture = Picture { width, height, color, alpha: view.outline() };
    let mat = Theme::Light.mat().map(|b| crate::math::color::linear_from_srgb(f32::from(b) / 255.0));
    picture.rgb8(&Look::default(), Backdrop::Solid(Vec3::from(mat)))
}
