//! The `Evaluate` pass: scores earlier passes against ground truth, in linear light, with masks eroded by one pixel; and against
//! photographs and other pictures of encoded colors also as the field's tables do, in sRGB.
//!
//! The pass writes a contact sheet of a few views, and for the report small pictures of all views: `<scored pass>/<view>_truth.jpg`, `_render.jpg` and
//! `_error.jpg`. Predictions are read from the EXR files that the passes wrote, so that the scores apply to the written files.

use crate::pass::render::{ChosenView, chosen_views};
use crate::pass::view_report::{ScoredOutcome, outlier_share};
use crate::pass::{run::session::Session, truth_files::read_covered, view_report};
use crate::report::metrics::{ImagePair, NormalAngles, albedo_psnr, coverage_iou, erode, mean};
use crate::report::scores::{EvalView, PassScores, Scaling, ViewScores, score_views};
use crate::report::sheet::{SheetRow, choose_evenly, write_sheet};
use crate::report::tone::{Picture, VIEWS_BUDGET, error_map, side_within, write_thumbnail};
use crate::scene::{EvaluatePass, LayerTruth, Pass, ScoreScale, Truth};
use bevy_ecs::prelude::Entity;
use glam::Vec3;
use image::RgbImage;
use lobelia_geometry::error::{Error, Result, stop::check_interrupted};
use lobelia_geometry::mesh::nearest::chamfer_distance;
use lobelia_geometry::view::{Photograph, Placement, ViewMask, camera::Camera};
use lobelia_io::codec::exr_frame::{Layer, read_frame_layers};
use lobelia_io::codec::{gltf::import::read_mesh, image::Gamma, image::image_header};
use std::path::{Path, PathBuf};
use tracing::info_span;

/// Views shown in a row of the contact sheet.
const SHEET_VIEWS: usize = 3;

/// Pictures of every view, by the ends of their file names.
pub const PARTS: [&str; 3] = ["truth", "render", "error"];

/// One view of a scored pass.
struct ScoredView {
    eval: EvalView,
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

pub(crate) fn run(session: &mut Session, pass: &EvaluatePass) -> Result<()> {
    let mut views = 0;
    for score in &pass.scores {
        views += views_of(session, &score.pass)?.len();
    }
    let side = side_within(views * PARTS.len(), VIEWS_BUDGET);
    let rows: Vec<SheetRow> =
        (0..pass.scores.len()).map(|i| score_pass(session, pass, i, side)).collect::<Result<_>>()?;
    if let Some(path) = &pass.mesh {
        let (found, truth) = (session.surface.mesh(), read_mesh(path)?);
        session.scores.chamfer = chamfer_distance(found, &truth, session.scene.seed);
    }
    if !rows.is_empty() {
        let path = session.out.join(&pass.name).join("contact_sheet.png");
        let title = session.out.file_name().unwrap_or_default().to_string_lossy();
        write_sheet(&path, &title, "prediction, truth, error", &rows)?;
        session.progress.print(&format!("{}: {}", pass.name, path.display()));
    }
    Ok(())
}

/// Scores the pass that `pass.scores[i]` names, and writes pictures of its views with sides of at most
/// `side` pixels. Returns its row of the contact sheet. The first one also has a report of its views,
/// and its layers are scored.
fn score_pass(session: &mut Session, pass: &EvaluatePass, i: usize, side: u32) -> Result<SheetRow> {
    let score = &pass.scores[i];
    let (scaling, layers): (_, &[Layer]) = match score.scale {
        ScoreScale::None => (Scaling::None, &[]),
        ScoreScale::PerChannel => (Scaling::PerChannel, &[]),
        ScoreScale::PerView => (Scaling::PerView, &[]),
        ScoreScale::PerLayer => (Scaling::PerLayer, &[Layer::Diffuse, Layer::Specular]),
    };
    let views = views_of(session, &score.pass)?;
    let truths = match (&score.truth, score.truth.files()) {
        (Truth::SelfMade { spp }, _) => TrueImages::Made(self_made(session, &score.pass, &views, *spp)?),
        (_, Some(files)) => TrueImages::Files(views.iter().map(|view| files.image(&view.name)).collect()),
        (_, None) => TrueImages::Photographs,
    };
    let scored = ScoredPass { name: score.pass.clone(), views, truths };
    let mut overlaps = vec![None; scored.views.len()];
    let scores = score_views(scored.views.len(), scaling, |k| {
        let view = scored.load(session, k, layers)?;
        overlaps[k] = view.mask_iou;
        Ok(view.eval)
    })?;
    let folder = session.out.join(&pass.name);
    let (row, outliers) = show_views(session, &scored, &scores, layers, &folder.join(&score.pass), side)?;
    if i == 0 {
        let each = scored.views.iter().zip(&scores.views).zip(outliers);
        let outcome = |((view, scores), outliers): ((&ChosenView, &ViewScores), Option<f64>)| ScoredOutcome {
            view: view.entity,
            psnr: scores.psnr,
            outliers,
        };
        view_report::write(session, &folder, &each.map(outcome).collect::<Vec<_>>())?;
    }
    session.scores.passes.insert(score.pass.clone(), scores);
    if i == 0 {
        session.scores.mask_iou = mean(overlaps.into_iter().flatten());
        score_layers(session, pass, &scored)?;
    }
    Ok(row)
}

impl ScoredPass {
    fn load(&self, session: &Session, i: usize, layers: &[Layer]) -> Result<ScoredView> {
        check_interrupted()?;
        let _reading = info_span!("views read").entered();
        let view = &self.views[i];
        let path = session.out.join(&self.name).join(format!("{}.exr", view.stem));
        let frame = read_frame_layers(path, layers)?;
        let place = || format!("{}, view {}", self.name, view.stem);
        let world = &session.pipeline.world;
        // True radiance, the coverage of a picture of encoded colors that has some, and whether it is one,
        // as those of the field's tables are: any but floats.
        let (truth, covered, in_srgb) = match &self.truths {
            TrueImages::Photographs => {
                let found = world.get::<Photograph>(view.entity).map(|photograph| photograph.image().pixels);
                let none = || Error::run(place(), "there is no photograph to compare with");
                (found.ok_or_else(none)?, None, true)
            }
            TrueImages::Files(files) => {
                let in_srgb = !image_header(&files[i])?.is_float;
                let (pixels, alpha) = read_covered(&files[i], Gamma::Srgb, &view.camera)?;
                (pixels, alpha.filter(|_| in_srgb), in_srgb)
            }
            TrueImages::Made(pictures) => (pictures[i].clone(), None, false),
        };
        let mask = world.get::<ViewMask>(view.entity).map(|mask| mask.0.mask());
        let mask_iou = mask.as_ref().and_then(|mask| coverage_iou(&frame.alpha, &mask.coverage));
        let coverage = mask.map(|mask| mask.coverage).or(covered).unwrap_or_default();
        let outline = if coverage.is_empty() { &frame.alpha } else { &coverage };
        let size = [frame.width, frame.height];
        if [truth.len(), outline.len()] != [frame.color.len(); 2] {
            return Err(Error::run(place(), "the ground truth has another size than the prediction"));
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
            in_srgb,
        };
        Ok(ScoredView { eval, albedo: frame.albedo, normal: frame.normal, mask_iou })
    }
}

/// The views that a pass rendered, by the scene file.
fn views_of(session: &mut Session, pass: &str) -> Result<Vec<ChosenView>> {
    let settings = session.pass_named(Some(pass)).and_then(Pass::render);
    let none = || Error::run("evaluate", format!("there is no earlier pass {pass} that renders"));
    Ok(chosen_views(&mut session.pipeline.world, settings.ok_or_else(none)?))
}

/// The true object under the light and edits of the pass.
fn self_made(session: &mut Session, pass: &str, views: &[ChosenView], spp: u32) -> Result<Vec<Vec<Vec3>>> {
    let edits = session.pass_named(Some(pass)).map_or(&[] as &[_], Pass::edits);
    let light = session.pass_lights.get(pass);
    let of = |view: Entity| session.pipeline.world.get::<Placement>(view).copied().unwrap_or_default();
    let views: Vec<(Camera, Placement)> = views.iter().map(|view| (view.camera, of(view.entity))).collect();
    let bar = session.progress.bar("truth", views.len() as u64);
    let seed = session.scene.seed.wrapping_add(1_000_003);
    let truth = session.truth.as_mut().ok_or_else(no_true_object)?;
    let frames = truth.pictures(&views, light, edits, spp, seed, || bar.inc(1))?;
    bar.finish_and_clear();
    Ok(frames.into_iter().map(|frame| frame.color).collect())
}

fn no_true_object() -> Error {
    Error::run("evaluate", "only `Photographed` views have a true object")
}

/// A layer of the pixels that count, and its ground truth, of one view.
struct LayerPixels {
    prediction: Vec<Vec3>,
    truth: Vec<Vec3>,
    counts: Vec<bool>,
}

impl LayerPixels {
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
        session.scores.albedo_psnr = albedo_psnr(&pairs);
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
    let ChosenView { stem, name, camera, .. } = &scored.views[i];
    let is_normal = layer == Layer::Normal;
    let truth: Vec<Vec3> = match truth.files() {
        Some(files) => files.read_layer(layer, [stem, name], camera)?,
        None => {
            let seed = session.scene.seed.wrapping_add(i as u64);
            let object = session.truth.as_mut().ok_or_else(no_true_object)?;
            let frames = object.pictures(&[(*camera, Placement::default())], None, &[], 16, seed, || ())?;
            frames.into_iter().flat_map(|f| if is_normal { f.normal } else { f.albedo }).collect()
        }
    };
    let found = if is_normal { view.normal } else { view.albedo };
    let EvalView { width, height, mask, .. } = view.eval;
    ImagePair::new([width, height], &found, &truth, &mask)?;
    let counted = |pixels: &[Vec3]| -> Vec<Vec3> {
        pixels.iter().zip(&mask).filter(|(_, counts)| **counts).map(|(pixel, _)| *pixel).collect()
    };
    let prediction = counted(&found);
    Ok(LayerPixels { counts: vec![true; prediction.len()], truth: counted(&truth), prediction })
}

/// Writes small pictures of all views: ground truth, prediction as it is scored, error. Returns a row of a
/// few views for the contact sheet (prediction, ground truth, error) and the share of outliers of each
/// view, of the prediction as it is scored.
fn show_views(
    session: &Session,
    scored: &ScoredPass,
    scores: &PassScores,
    layers: &[Layer],
    folder: &Path,
    side: u32,
) -> Result<(SheetRow, Vec<Option<f64>>)> {
    let _drawing = info_span!("pictures").entered();
    let on_sheet = choose_evenly(scored.views.len(), SHEET_VIEWS);
    let (mut cells, mut outliers) = (Vec::new(), Vec::new());
    for (i, chosen) in scored.views.iter().enumerate() {
        check_interrupted()?;
        let view = scored.load(session, i, layers)?;
        let EvalView { name, width, height, truth, .. } = &view.eval;
        let shown = scores.scored_prediction(&view.eval);
        outliers.push(outlier_share(&view.eval, &shown));
        let error = error_map([*width, *height], [&shown, truth], view.outline());
        let pictures = [picture(&view, truth)?, picture(&view, &shown)?, error];
        for (part, picture) in PARTS.iter().zip(&pictures) {
            write_thumbnail(&folder.join(format!("{}_{part}.jpg", chosen.stem)), picture, side)?;
        }
        if on_sheet.contains(&i) {
            let [truth_shown, render, error] = pictures;
            cells.push((format!("{name} {:.1} dB", scores.views[i].psnr), render));
            cells.push(("truth".to_owned(), truth_shown));
            cells.push(("error".to_owned(), error));
        }
    }
    Ok((SheetRow { heading: format!("{}: {}", scored.name, scores.summary()), cells }, outliers))
}

/// Radiance of a view as a picture on the mat of a light sheet.
fn picture(view: &ScoredView, color: &[Vec3]) -> Result<RgbImage> {
    let EvalView { width, height, .. } = view.eval;
    Picture { width, height, color, alpha: view.outline() }.on_mat()
}
