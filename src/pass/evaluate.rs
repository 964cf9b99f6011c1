//! The `Evaluate` pass: earlier passes against the truth, in linear light, masks eroded by one pixel.
//!
//! Predictions are read back from the EXRs that the passes wrote, so that what is scored is what a person gets.

use super::Session;
use super::render::chosen_views;
use crate::error::{Error, Result};
use crate::report::exr_file::{Frame, read_frame};
use crate::report::heat::{factor_for, heat_map};
use crate::report::metrics::{
    LayerScaleSums, Pair, ScaleSums, erode, mean, mean_normal_angle_degrees, median, psnr, psnr_of_mse, scaled,
};
use crate::report::scores::PassScores;
use crate::report::sheet::{Sheet, SheetCell, SheetRow, Theme, choose_evenly, write_sheet};
use crate::report::ssim::ssim;
use crate::report::tone::{Backdrop, Look, Picture};
use crate::scene::pass_types::{EvaluatePass, LayerTruth, Pass, ScaleRule, Score, Truth, ViewChoice};
use crate::scene::types::LightSource;
use crate::view::camera::Camera;
use crate::view::image_io::{Gamma, read_image};
use crate::view::{Photograph, ViewMask, ViewName};
use glam::Vec3;
use std::path::Path;

/// Views shown in a row of the contact sheet.
const SHEET_VIEWS: usize = 3;

/// One view of a scored pass.
struct ScoredView {
    name: String,
    camera: Camera,
    frame: Frame,
    truth: Vec<Vec3>,
    coverage: Vec<f32>,
    counts: Vec<bool>,
}

impl ScoredView {
    fn pair<'a>(&'a self, prediction: &'a [Vec3]) -> Result<Pair<'a>> {
        Pair::new([self.frame.width, self.frame.height], prediction, &self.truth, &self.counts)
            .map_err(|error| Error::run(format!("view {}", self.name), error.to_string()))
    }
}

/// Runs the pass.
///
/// # Errors
/// If a prediction or a truth is missing or does not fit.
pub fn run(session: &mut Session, pass: &EvaluatePass) -> Result<()> {
    let mut rows = Vec::new();
    for score in &pass.scores {
        let views = scored_views(session, score)?;
        let scaled = scale_views(&views, score.scale)?;
        let scores = score_views(&views, &scaled)?;
        rows.extend(sheet_rows(&score.pass, &views, &scaled, &scores)?);
        session.scores.passes.insert(score.pass.clone(), scores);
    }
    if let Some(first) = pass.scores.first() {
        if let Some(truth) = &pass.albedo {
            session.scores.albedo_psnr = Some(score_albedo(session, first, truth)?);
        }
        if let Some(truth) = &pass.normal {
            session.scores.normal_deg = score_normals(session, first, truth)?;
        }
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

/// The views that a pass rendered, as the scene file says.
fn views_of(session: &mut Session, pass: &str) -> Result<Vec<(String, Camera)>> {
    let settings = session.scene.passes.iter().find(|p| p.name() == pass).and_then(Pass::render);
    let choice: &ViewChoice = &settings
        .ok_or_else(|| Error::run("evaluate", format!("there is no earlier pass {pass} that renders")))?
        .views;
    Ok(chosen_views(&mut session.pipeline.world, choice))
}

fn scored_views(session: &mut Session, score: &Score) -> Result<Vec<ScoredView>> {
    let views = views_of(session, &score.pass)?;
    let truths = true_images(session, score, &views)?;
    views
        .into_iter()
        .zip(truths)
        .map(|((name, camera), truth)| scored_view(session, &score.pass, name, camera, truth))
        .collect()
}

fn scored_view(
    session: &mut Session,
    pass: &str,
    name: String,
    camera: Camera,
    truth: Vec<Vec3>,
) -> Result<ScoredView> {
    let frame = read_frame(session.folder(pass).join(format!("{name}.exr")))?;
    let coverage = true_coverage(session, &name).unwrap_or_else(|| frame.alpha.clone());
    let size = [frame.width, frame.height];
    if truth.len() != frame.color.len() || coverage.len() != frame.color.len() {
        return Err(Error::run(
            format!("{pass}, view {name}"),
            format!("the truth has {} pixels, the prediction {} × {}", truth.len(), size[0], size[1]),
        ));
    }
    let counts = erode(size, &coverage);
    Ok(ScoredView { name, camera, frame, truth, coverage, counts })
}

fn true_coverage(session: &mut Session, name: &str) -> Option<Vec<f32>> {
    let world = &mut session.pipeline.world;
    let mut query = world.query::<(&ViewName, &ViewMask)>();
    query.iter(world).find(|(n, _)| n.0 == name).map(|(_, mask)| mask.0.coverage.clone())
}

fn true_images(session: &mut Session, score: &Score, views: &[(String, Camera)]) -> Result<Vec<Vec<Vec3>>> {
    match &score.truth {
        Truth::Photographs => {
            let world = &mut session.pipeline.world;
            let mut query = world.query::<(&ViewName, &Photograph)>();
            let photograph = |name: &str| {
                let found = query.iter(world).find(|(n, _)| n.0 == name);
                found.map(|(_, photograph)| photograph.image.pixels.clone()).ok_or_else(|| {
                    Error::run(&score.pass, format!("view {name} has no photograph to compare with"))
                })
            };
            let mut photograph = photograph;
            views.iter().map(|(name, _)| photograph(name)).collect()
        }
        Truth::Folder(folder) => views.iter().map(|(name, _)| read_truth(folder, name)).collect(),
        Truth::SelfMade { spp } => self_made(session, &score.pass, views, *spp),
    }
}

fn read_truth(folder: &Path, name: &str) -> Result<Vec<Vec3>> {
    let exr = folder.join(format!("{name}.exr"));
    let png = folder.join(format!("{name}.png"));
    let path = if !exr.is_file() && png.is_file() { png } else { exr };
    Ok(read_image(path, Gamma::Srgb)?.image.pixels)
}

/// The true object under the pass's own light and edits.
fn self_made(
    session: &mut Session,
    pass: &str,
    views: &[(String, Camera)],
    spp: u32,
) -> Result<Vec<Vec<Vec3>>> {
    let found = session.scene.passes.iter().find(|p| p.name() == pass);
    let (light, edits): (Option<&LightSource>, &[_]) = match found {
        Some(Pass::Edit(pass)) => (pass.light.as_ref(), &pass.edits),
        Some(Pass::Relight(pass)) => (Some(&pass.light), &pass.edits),
        _ => (None, &[]),
    };
    let cameras: Vec<Camera> = views.iter().map(|(_, camera)| *camera).collect();
    let bar = session.progress.bar("truth", cameras.len() as u64);
    let seed = session.scene.seed.wrapping_add(1_000_003);
    let Some(truth) = &mut session.truth else {
        return Err(Error::run(pass, "only Photographed views have a true object of their own"));
    };
    let frames = truth.pictures(&cameras, light, edits, spp, seed, || bar.inc(1))?;
    bar.finish_and_clear();
    Ok(frames.into_iter().map(|frame| frame.color).collect())
}

/// Predictions after the scales that the rule takes out.
fn scale_views(views: &[ScoredView], rule: ScaleRule) -> Result<Vec<Vec<Vec3>>> {
    match rule {
        ScaleRule::None => Ok(views.iter().map(|v| v.frame.color.clone()).collect()),
        ScaleRule::PerChannel => {
            let mut sums = ScaleSums::default();
            for view in views {
                sums.add(&view.pair(&view.frame.color)?);
            }
            Ok(views.iter().map(|v| scaled(&v.frame.color, sums.scale())).collect())
        }
        ScaleRule::PerLayer => {
            let mut sums = LayerScaleSums::default();
            for view in views {
                sums.add(&view.pair(&view.frame.diffuse)?, &view.frame.specular)?;
            }
            let scales = sums.scales();
            Ok(views.iter().map(|v| scales.combine(&v.frame.diffuse, &v.frame.specular)).collect())
        }
    }
}

fn score_views(views: &[ScoredView], scaled: &[Vec<Vec3>]) -> Result<PassScores> {
    let (mut psnrs, mut raw, mut similarity) = (Vec::new(), Vec::new(), Vec::new());
    for (view, scaled) in views.iter().zip(scaled) {
        psnrs.push(psnr(&view.pair(scaled)?));
        raw.push(psnr(&view.pair(&view.frame.color)?));
        similarity.push(ssim(&view.pair(scaled)?));
    }
    let of = |values: &[f64]| {
        mean(values).ok_or_else(|| Error::run("evaluate", "the pass rendered no view that could be scored"))
    };
    let names = views.iter().map(|v| v.name.clone());
    Ok(PassScores {
        psnr: of(&psnrs)?,
        psnr_raw: of(&raw)?,
        ssim: of(&similarity)?,
        views: names.zip(psnrs.iter().copied()).collect(),
    })
}

/// True albedo or normals of the views of a score.
fn true_layers(
    session: &mut Session,
    views: &[ScoredView],
    truth: &LayerTruth,
    layer: &str,
) -> Result<Vec<Vec<Vec3>>> {
    match truth {
        LayerTruth::Folder(folder) => views
            .iter()
            .map(|view| {
                let number = view.name.rsplit('_').next().unwrap_or(&view.name);
                let path = folder.join(format!("{layer}_{number}.exr"));
                Ok(read_image(path, Gamma::Linear)?.image.pixels)
            })
            .collect(),
        LayerTruth::SelfMade => {
            let cameras: Vec<Camera> = views.iter().map(|v| v.camera).collect();
            let seed = session.scene.seed;
            let Some(object) = &mut session.truth else {
                return Err(Error::run(layer, "only Photographed views have a true object of their own"));
            };
            let frames = object.pictures(&cameras, None, &[], 16, seed, || ())?;
            let pick = |f: Frame| if layer == "albedo" { f.albedo } else { f.normal };
            Ok(frames.into_iter().map(pick).collect())
        }
    }
}

/// Albedo PSNR over all views' pixels together, after one median scale per channel.
fn score_albedo(session: &mut Session, score: &Score, truth: &LayerTruth) -> Result<f64> {
    let mut views = scored_views(session, score)?;
    let truths = true_layers(session, &views, truth, "albedo")?;
    let mut pairs: [Vec<(f64, f64)>; 3] = Default::default();
    for (view, truth) in views.iter_mut().zip(truths) {
        view.truth = truth;
        let pair = view.pair(&view.frame.albedo)?;
        for i in (0..pair.mask.len()).filter(|&i| pair.mask[i]) {
            for c in 0..3 {
                pairs[c].push((f64::from(pair.prediction[i][c]), f64::from(pair.truth[i][c])));
            }
        }
    }
    let (mut squares, mut count) = (0.0, 0usize);
    for channel in &pairs {
        let mut ratios: Vec<f64> =
            channel.iter().filter(|(p, _)| *p > 1e-6).map(|(p, t)| t / p).collect();
        let scale = median(&mut ratios).unwrap_or(1.0);
        let error = |(p, t): &(f64, f64)| ((p * scale).clamp(0.0, 1.0) - t.clamp(0.0, 1.0)).powi(2);
        squares += channel.iter().map(error).sum::<f64>();
        count += channel.len();
    }
    Ok(psnr_of_mse(squares / count.max(1) as f64))
}

fn score_normals(session: &mut Session, score: &Score, truth: &LayerTruth) -> Result<Option<f64>> {
    let mut views = scored_views(session, score)?;
    let truths = true_layers(session, &views, truth, "normal")?;
    for (view, truth) in views.iter_mut().zip(truths) {
        view.truth = truth;
    }
    let pairs: Vec<Pair> = views.iter().map(|v| v.pair(&v.frame.normal)).collect::<Result<_>>()?;
    Ok(mean_normal_angle_degrees(&pairs))
}

/// A row a view: prediction, truth, error.
fn sheet_rows(
    pass: &str,
    views: &[ScoredView],
    scaled: &[Vec<Vec3>],
    scores: &PassScores,
) -> Result<Vec<SheetRow>> {
    let factor = factor_for(scores.psnr);
    let mut row = SheetRow {
        heading: format!("{pass}   PSNR {:.2} dB   SSIM {:.4}", scores.psnr, scores.ssim),
        cells: Vec::new(),
    };
    let mut rows = Vec::new();
    for i in choose_evenly(views.len(), SHEET_VIEWS) {
        let view = &views[i];
        row.cells.push(cell(format!("{} {:.1} dB", view.name, scores.views[i].1), view, &scaled[i])?);
        row.cells.push(cell("truth".to_owned(), view, &view.truth)?);
        let images = [scaled[i].as_slice(), view.truth.as_slice()];
        let size = [view.frame.width as u32, view.frame.height as u32];
        let image = heat_map(size, images, &view.coverage, factor, Theme::Light.mat());
        row.cells.push(SheetCell { label: format!("error × {factor}"), image });
    }
    rows.push(std::mem::take(&mut row));
    Ok(rows)
}

fn cell(label: String, view: &ScoredView, color: &[Vec3]) -> Result<SheetCell> {
    let picture = Picture {
        width: view.frame.width,
        height: view.frame.height,
        color,
        alpha: &view.coverage,
    };
    let mat = Theme::Light.mat().map(|b| crate::math::color::linear_from_srgb(f32::from(b) / 255.0));
    let image = picture.rgb8(&Look::default(), Backdrop::Solid(Vec3::from(mat)))?;
    Ok(SheetCell { label, image })
}
