//! The `Evaluate` pass: scores earlier passes against ground truth, in linear light, with masks
//! eroded by one pixel; and against photographs and other pictures of encoded colors also as the
//! field's tables do, in sRGB.
//!
//! The pass writes a contact sheet of a few views, and for the report small pictures of all views:
//! `<scored pass>/<view>_truth.jpg`, `_render.jpg` and `_error.jpg`. Predictions are read from the
//! EXR files that the passes wrote, so that the scores apply to the written files; files of ground
//! truth are named and read as the second half says.

use crate::object::{Object, photograph::TrueObject};
use crate::object::{view_report, view_report::outlier_share};
use crate::pass::render::{ChosenView, chosen_views};
use crate::report::scores::{EvalView, PassScores, Scaling, score_views};
use crate::report::sheet::{SheetRow, choose_evenly, write_sheet};
use crate::scene::{EvaluatePass, LayerTruth, Pass, ScoreScale, Truth, TruthFiles, VIEW};
use glam::Vec3;
use lobelia_geometry::error::{Error, Result, stop::check_interrupted};
use lobelia_geometry::mesh::nearest::chamfer_distance;
use lobelia_geometry::view::metrics::{ImagePair, NormalAngles, albedo_psnr, coverage_iou, erode, mean};
use lobelia_geometry::view::{Image, Photograph, Placement, ViewMask, camera::Camera};
use lobelia_io::codec::image::{Gamma, IMAGE_EXTENSIONS, Orientation, image_header, read_image};
use lobelia_io::codec::tone::{Picture, VIEWS_BUDGET, error_map, side_within, write_thumbnail};
use lobelia_io::codec::{exr_frame::Layer, exr_frame::read_frame_layers, gltf::import::read_mesh};
use lobelia_world::light::lights::named_light;
use std::{ops::RangeInclusive, path::Path, path::PathBuf};
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

/// A pass that is scored. Its views are read one at a time, with the layers that are needed: one
/// takes 45 bytes a pixel, and 12 more a layer.
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

pub(crate) fn run(object: &mut Object, out: &Path, pass: &EvaluatePass) -> Result<()> {
    let counts = pass.scores.iter().map(|score| Ok(views_of(object, &score.pass)?.len()));
    let views = counts.sum::<Result<usize>>()?;
    let side = side_within(views * PARTS.len(), VIEWS_BUDGET);
    let count = pass.scores.len();
    let rows: Vec<_> = (0..count).map(|i| score_pass(object, out, pass, i, side)).collect::<Result<_>>()?;
    if let Some(path) = &pass.mesh {
        let chamfer = chamfer_distance(object.surface().mesh(), &read_mesh(path)?, object.scene().seed);
        object.scores().chamfer = chamfer;
    }
    if !rows.is_empty() {
        let path = out.join(&pass.name).join("contact_sheet.png");
        let title = out.file_name().unwrap_or_default().to_string_lossy();
        write_sheet(&path, &title, "prediction, truth, error", &rows)?;
        object.print(&format!("{}: {}", pass.name, path.display()));
    }
    Ok(())
}

/// Scores the pass that `pass.scores[i]` names, and writes pictures of its views with sides of at
/// most `side` pixels. Returns its row of the contact sheet. The first one also has a report of its
/// views, and its layers are scored.
fn score_pass(object: &mut Object, out: &Path, pass: &EvaluatePass, i: usize, side: u32) -> Result<SheetRow> {
    let score = &pass.scores[i];
    let (scaling, layers): (_, &[Layer]) = match score.scale {
        ScoreScale::None => (Scaling::None, &[]),
        ScoreScale::PerChannel => (Scaling::PerChannel, &[]),
        ScoreScale::PerView => (Scaling::PerView, &[]),
        ScoreScale::PerLayer => (Scaling::PerLayer, &[Layer::Diffuse, Layer::Specular]),
    };
    let views = views_of(object, &score.pass)?;
    let truths = match (&score.truth, score.truth.files()) {
        // The true object under the light and edits of the pass.
        (Truth::SelfMade { spp }, _) => {
            let scene = object.scene();
            let edits = scene.pass_named(Some(&score.pass)).map_or(&[] as &[_], Pass::edits);
            let bar = object.progress().bar("truth", views.len() as u64);
            let world = &mut object.pipeline.world;
            let light = named_light(world, &score.pass);
            let of = |view: &ChosenView| world.get::<Placement>(view.entity).copied().unwrap_or_default();
            let shown: Vec<_> = views.iter().map(|view| (view.camera, of(view))).collect();
            let seed = scene.seed.wrapping_add(1_000_003);
            let mut truth = world.get_resource_mut::<TrueObject>().ok_or_else(no_true_object)?;
            let frames = truth.pictures(&shown, light, edits, *spp, seed, || bar.inc(1))?;
            TrueImages::Made(frames.into_iter().map(|frame| frame.color).collect())
        }
        (_, Some(files)) => TrueImages::Files(views.iter().map(|view| files.image(&view.name)).collect()),
        (_, None) => TrueImages::Photographs,
    };
    let scored = ScoredPass { name: score.pass.clone(), views, truths };
    let mut overlaps = vec![None; scored.views.len()];
    let scores = score_views(scored.views.len(), scaling, |k| {
        let view = scored.load(object, out, k, layers)?;
        overlaps[k] = view.mask_iou;
        Ok(view.eval)
    })?;
    let folder = out.join(&pass.name);
    let (row, outliers) = show_views(object, out, &scored, &scores, layers, &folder.join(&score.pass), side)?;
    if i == 0 {
        let each = scored.views.iter().zip(&scores.views).zip(outliers);
        let each = each.map(|((view, scores), outliers)| (view.entity, (scores.psnr, outliers)));
        view_report::write(object, &folder, &each.collect())?;
    }
    object.scores().passes.insert(score.pass.clone(), scores);
    if i == 0 {
        object.scores().mask_iou = mean(overlaps.into_iter().flatten());
        if let Some(truth) = &pass.albedo {
            let pixels = (0..scored.views.len())
                .map(|i| layer_pixels(object, out, &scored, truth, Layer::Albedo, i))
                .collect::<Result<Vec<_>>>()?;
            let pairs = pixels.iter().map(LayerPixels::pair).collect::<Result<Vec<_>>>()?;
            object.scores().albedo_psnr = albedo_psnr(&pairs);
        }
        if let Some(truth) = &pass.normal {
            let mut angles = NormalAngles::default();
            for i in 0..scored.views.len() {
                angles.add(&layer_pixels(object, out, &scored, truth, Layer::Normal, i)?.pair()?);
            }
            object.scores().normal_deg = angles.mean_degrees();
            object.scores().normal_pixels = Some(angles.pixels() as u64);
            object.scores().normal_median_deg = angles.median_degrees();
        }
    }
    Ok(row)
}

impl ScoredPass {
    fn load(&self, object: &Object, out: &Path, i: usize, layers: &[Layer]) -> Result<ScoredView> {
        check_interrupted()?;
        let _reading = info_span!("views read").entered();
        let view = &self.views[i];
        let path = out.join(&self.name).join(format!("{}.exr", view.stem));
        let frame = read_frame_layers(path, layers)?;
        let place = || format!("{}, view {}", self.name, view.stem);
        let world = &object.pipeline.world;
        // True radiance, the coverage of a picture of encoded colors that has some, and whether it
        // is one, as those of the field's tables are: any but floats.
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
fn views_of(object: &mut Object, pass: &str) -> Result<Vec<ChosenView>> {
    let scene = object.scene();
    let settings = scene.pass_named(Some(pass)).and_then(Pass::render);
    let none = || Error::run("evaluate", format!("there is no earlier pass {pass} that renders"));
    Ok(chosen_views(&mut object.pipeline.world, settings.ok_or_else(none)?))
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

/// A layer of view `i`.
fn layer_pixels(
    object: &mut Object,
    out: &Path,
    scored: &ScoredPass,
    truth: &LayerTruth,
    layer: Layer,
    i: usize,
) -> Result<LayerPixels> {
    let view = scored.load(object, out, i, &[layer])?;
    let ChosenView { stem, name, camera, .. } = &scored.views[i];
    let is_normal = layer == Layer::Normal;
    let truth: Vec<Vec3> = match truth.files() {
        Some(files) => files.read_layer(layer, [stem, name], camera)?,
        None => {
            let seed = object.scene().seed.wrapping_add(i as u64);
            let truth = object.pipeline.world.get_resource_mut::<TrueObject>();
            let mut truth = truth.ok_or_else(no_true_object)?;
            let frames = truth.pictures(&[(*camera, Placement::default())], None, &[], 16, seed, || ())?;
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

/// Writes small pictures of all views: ground truth, prediction as it is scored, error. Returns a
/// row of a few views for the contact sheet (prediction, ground truth, error) and the share of
/// outliers of each view, of the prediction as it is scored.
fn show_views(
    object: &Object,
    out: &Path,
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
        let view = scored.load(object, out, i, layers)?;
        let EvalView { name, width, height, truth, .. } = &view.eval;
        let shown = scores.scored_prediction(&view.eval);
        outliers.push(outlier_share(&view.eval, &shown));
        // Coverage of the object: the view's mask, or as rendered if it has none.
        let alpha = if view.eval.coverage.is_empty() { &view.eval.alpha } else { &view.eval.coverage };
        let error = error_map([*width, *height], [&shown, truth], alpha);
        // On the mat of a light sheet.
        let (width, height) = (*width, *height);
        let picture = |color: &[Vec3]| Picture { width, height, color, alpha }.on_mat();
        let pictures = [picture(truth)?, picture(&shown)?, error];
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

/// Lengths between which a normal of a PNG is known. Its components are rounded and averaged over a
/// pixel, and one that is black may be negative.
const KNOWN_LENGTHS: RangeInclusive<f32> = 0.9..=1.1;

impl TruthFiles<'_> {
    /// The image of a view: the first format that exists, EXR if none does.
    pub(crate) fn image(&self, view: &str) -> PathBuf {
        if let Some(file) = self.named(view) {
            return file;
        }
        let of_kind = |kind: &str| self.folder.join(format!("{view}.{kind}"));
        let found = IMAGE_EXTENSIONS.iter().map(|kind| of_kind(kind)).find(|path| path.is_file());
        found.unwrap_or_else(|| of_kind("exr"))
    }

    /// The files that are there, whatever views there are: all in the folder, or those whose paths
    /// are of the given form.
    pub(crate) fn found(&self) -> Vec<PathBuf> {
        let form = self.file.unwrap_or(VIEW);
        let parts = Path::new(form).components().filter_map(|part| part.as_os_str().to_str());
        let mut found = vec![self.folder.to_owned()];
        for part in parts.filter(|part| *part != ".") {
            found = found.into_iter().flat_map(|folder| matching(&folder, part)).collect();
        }
        found
    }

    fn named(&self, view: &str) -> Option<PathBuf> {
        self.file.map(|file| self.folder.join(file.replace(VIEW, view)))
    }

    /// The true albedo or normals of a view, in linear light or world axes, by the stem of its
    /// files and its name. Unknown normals are zero.
    pub(crate) fn read_layer(&self, layer: Layer, names: [&str; 2], camera: &Camera) -> Result<Vec<Vec3>> {
        let [stem, name] = names;
        let Some(path) = self.named(name) else { return read_usual_layer(self.folder, layer, stem, camera) };
        let (mut pixels, alpha) = read_covered(&path, Gamma::Linear, camera)?;
        let straight = |(pixel, alpha): (&mut Vec3, f32)| *pixel /= alpha.max(1e-6);
        pixels.iter_mut().zip(alpha.unwrap_or_default()).for_each(straight);
        if layer == Layer::Normal && !image_header(&path)?.is_float {
            pixels.iter_mut().for_each(|pixel| *pixel = known_normal(2.0 * *pixel - 1.0, f32::NEG_INFINITY));
        }
        Ok(pixels)
    }
}

/// Returns the paths in a folder that match `part`, where [`VIEW`] stands for anything.
fn matching(folder: &Path, part: &str) -> Vec<PathBuf> {
    let Some((start, end)) = part.split_once(VIEW) else {
        return Some(folder.join(part)).filter(|path| path.exists()).into_iter().collect();
    };
    // Of a name that stands twice in a part, the first and the last piece are enough.
    let end = end.rsplit_once(VIEW).map_or(end, |(_, end)| end);
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let named = entries.filter(|entry| {
        entry.file_name().to_str().is_some_and(|name| name.starts_with(start) && name.ends_with(end))
    });
    named.map(|entry| entry.path()).collect()
}

/// True albedo or normals as they are usually called: `albedo_003.exr` for the view `003`, `r_003`
/// or `test_003`. Normals are also read from `r_003_normal.png`, if there is no such EXR.
fn read_usual_layer(folder: &Path, layer: Layer, view: &str, camera: &Camera) -> Result<Vec<Vec3>> {
    let number = view.rsplit('_').next().unwrap_or(view);
    let name = if layer == Layer::Normal { "normal" } else { "albedo" };
    let exr = folder.join(format!("{name}_{number}.exr"));
    let png = folder.join(format!("{view}_normal.png"));
    if layer != Layer::Normal || exr.is_file() {
        return read_fitting(&exr, Gamma::Linear, camera);
    }
    if !png.is_file() {
        let help = format!("Name the folder that has it, or {view}_normal.png.");
        return Err(Error::input(&exr, "", "there are no true normals of this view", help));
    }
    let mut image = read_image(&png, Gamma::Srgb, Orientation::Upright)?.image;
    image.pixels.iter_mut().for_each(|normal| *normal = known_normal(*normal, 0.0));
    // Few normals of a block may be unknown, or they would be those of one side of an edge.
    let fitting = fit(&png, image, camera)?;
    Ok(fitting.into_iter().map(|normal| known_normal(normal, 0.0)).collect())
}

/// The normal of a decoded pixel of a PNG: known, and then made a unit vector, if all components
/// are above `least` (of a picture of max(0, n) one that is 0 may be any) and its length is nearly
/// 1; else zero.
fn known_normal(decoded: Vec3, least: f32) -> Vec3 {
    let known = decoded.min_element() > least && KNOWN_LENGTHS.contains(&decoded.length());
    if known { decoded.normalize() } else { Vec3::ZERO }
}

/// The pixels of the ground-truth image of a view. If views are downscaled on reading, so is their
/// ground truth.
///
/// # Errors
/// [`Error::Input`] if the image cannot be read or its size does not match the view.
pub(crate) fn read_fitting(path: &Path, gamma: Gamma, camera: &Camera) -> Result<Vec<Vec3>> {
    read_covered(path, gamma, camera).map(|(pixels, _)| pixels)
}

/// Returns the pixels of [`read_fitting`], weighted by coverage, and the coverage if the image has
/// alpha.
fn read_covered(path: &Path, gamma: Gamma, camera: &Camera) -> Result<(Vec<Vec3>, Option<Vec<f32>>)> {
    let loaded = read_image(path, gamma, Orientation::Upright)?;
    let (width, height) = (loaded.image.width, loaded.image.height);
    let alpha = loaded.alpha.map(|alpha| {
        let pixels = alpha.into_iter().map(Vec3::splat).collect();
        let fitted = fit(path, Image { width, height, pixels }, camera)?;
        Ok::<_, Error>(fitted.into_iter().map(|pixel| pixel.x).collect())
    });
    Ok((fit(path, loaded.image, camera)?, alpha.transpose()?))
}

/// The pixels of an image, downscaled to the view's size.
fn fit(path: &Path, image: Image, camera: &Camera) -> Result<Vec<Vec3>> {
    let factor = image.width / camera.width.max(1);
    let fitting = if factor > 1 { image.downscaled(factor) } else { image.clone() };
    if (fitting.width, fitting.height) == (camera.width, camera.height) {
        return Ok(fitting.pixels);
    }
    let Camera { width, height, .. } = camera;
    let problem = format!("the truth has {}×{} pixels, its view {width}×{height}", image.width, image.height);
    let help = "A truth is as large as its view, or a whole number of times larger.";
    Err(Error::input(path, "", problem, help))
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::{Rgb, RgbImage};
    use lobelia_io::codec::{exr::ExrLayers, exr_frame::write_channels, png_file::write_rgb8};

    fn camera(size: u32) -> Camera {
        Camera::look_at(Vec3::Z, Vec3::ZERO, Vec3::Y, 40.0, size, size).unwrap()
    }

    /// A normal as NeRF's synthetic sets store it.
    fn stored(normal: Vec3) -> Rgb<u8> {
        let code = |n: f32| (255.0 * lobelia_sg::color::srgb_from_linear(n)).round() as u8;
        Rgb(normal.to_array().map(code))
    }

    /// The normals of view `r_3` as a picture of `side` pixels holds them, for a view of 2 × 2.
    fn read(side: u32, normal: impl Fn(u32, u32) -> Vec3) -> Vec<Vec3> {
        let folder = tempfile::tempdir().unwrap();
        let image = RgbImage::from_fn(side, side, |x, y| stored(normal(x, y)));
        write_rgb8(folder.path().join("r_3_normal.png"), &image).unwrap();
        read_usual_layer(folder.path(), Layer::Normal, "r_3", &camera(2)).unwrap()
    }

    #[test]
    fn a_png_has_the_normals_that_are_positive() {
        let (known, tilted) = (Vec3::new(2.0, 3.0, 6.0) / 7.0, Vec3::new(0.8, 0.599, 0.04).normalize());
        let rows = [[known, tilted], [Vec3::new(0.6, -0.8, 1e-3), Vec3::splat(0.45)]];
        let found = read(2, |x, y| rows[y as usize][x as usize]);
        assert!(found[0].angle_between(known) < 0.01 && found[1].angle_between(tilted) < 0.01, "{found:?}");
        assert!((found[0].length() - 1.0).abs() < 1e-6);
        // A negative component, and a length of 0.78.
        assert_eq!(found[2..], [Vec3::ZERO; 2]);
    }

    #[test]
    fn larger_pngs_are_averaged_where_all_is_known() {
        let known = Vec3::new(2.0, 3.0, 6.0) / 7.0;
        let found = read(4, |x, y| if (x, y) == (1, 1) { Vec3::X } else { known });
        assert_eq!(found[0], Vec3::ZERO);
        assert!(found[1..].iter().all(|normal| normal.angle_between(known) < 0.01), "{found:?}");
    }

    #[test]
    fn an_exr_is_read_first_and_a_missing_file_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let read = |layer| read_usual_layer(folder.path(), layer, "r_3", &camera(2));
        let message = read(Layer::Normal).unwrap_err().to_string();
        assert!(message.contains("normal_3.exr") && message.contains("no true normals"), "{message}");
        assert!(read(Layer::Albedo).unwrap_err().to_string().contains("albedo_3.exr"));
        write_rgb8(folder.path().join("r_3_normal.png"), &RgbImage::new(2, 2)).unwrap();
        assert_eq!(read(Layer::Normal).unwrap(), [Vec3::ZERO; 4]);
        let values = [("R", -1.0), ("G", 0.0), ("B", 0.0)].map(|(name, x)| (name.to_owned(), vec![x; 4]));
        let layers = ExrLayers { width: 2, height: 2, channels: values.into_iter().collect() };
        write_channels(folder.path().join("normal_3.exr"), &layers).unwrap();
        assert_eq!(read(Layer::Normal).unwrap(), [Vec3::NEG_X; 4]);
        assert!(read(Layer::Albedo).is_err(), "a PNG is for normals only");
    }

    #[test]
    fn alpha_is_coverage() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("truth.png");
        let pixel = |x: u32| image::Rgba([255, 51, 0, if x < 2 { 255 } else { 102 }]);
        image::RgbaImage::from_fn(4, 4, |x, _| pixel(x)).save(&path).unwrap();
        let (pixels, alpha) = read_covered(&path, Gamma::Linear, &camera(2)).unwrap();
        let alpha = alpha.unwrap();
        assert!((alpha[0] - 1.0).abs() < 1e-6 && (alpha[1] - 0.4).abs() < 1e-6, "{alpha:?}");
        assert!((pixels[1] - 0.4 * Vec3::new(1.0, 0.2, 0.0)).length() < 1e-6, "{pixels:?}");
        let files = TruthFiles { folder: folder.path(), file: Some("{view}.png") };
        let albedo = files.read_layer(Layer::Albedo, ["truth", "truth"], &camera(2)).unwrap();
        assert!((albedo[1] - Vec3::new(1.0, 0.2, 0.0)).length() < 1e-6, "{albedo:?}");
    }

    #[test]
    fn files_are_named_by_view() {
        let folder = tempfile::tempdir().unwrap();
        let at = folder.path().to_owned();
        std::fs::create_dir(at.join("test_003")).unwrap();
        let normal = Vec3::new(-2.0, 3.0, 6.0) / 7.0;
        let code = |n: f32| (127.5 * (n + 1.0)).round() as u8;
        let pixel = |x| if x == 0 { Rgb(normal.to_array().map(code)) } else { Rgb([128; 3]) };
        let rgb = RgbImage::from_fn(2, 2, |x, _| pixel(x));
        write_rgb8(at.join("test_003/normal.png"), &rgb).unwrap();
        write_rgb8(at.join("test_003/albedo.png"), &RgbImage::from_pixel(2, 2, Rgb([51, 102, 255]))).unwrap();
        let files = |file| TruthFiles { folder: &at, file: Some(file) };
        assert!(files("{view}/rgba_city.png").image("test_003").ends_with("test_003/rgba_city.png"));
        let names = ["train_test_003", "test_003"];
        let found = files("{view}/normal.png").read_layer(Layer::Normal, names, &camera(2)).unwrap();
        assert!(found[0].angle_between(normal) < 0.01 && (found[0].length() - 1.0).abs() < 1e-6, "{found:?}");
        assert_eq!(found[1], Vec3::ZERO, "gray has no direction");
        // Not encoded as sRGB.
        let albedo = files("{view}/albedo.png").read_layer(Layer::Albedo, names, &camera(2)).unwrap();
        assert!((albedo[0] - Vec3::new(0.2, 0.4, 1.0)).length() < 1e-6, "{albedo:?}");
        let mut found = files("{view}/normal.png").found();
        assert_eq!(found, [at.join("test_003/normal.png")]);
        found = files("test_{view}/a{view}o.png").found();
        assert_eq!(found, [at.join("test_003/albedo.png")]);
        assert_eq!(TruthFiles { folder: &at, file: None }.found(), [at.join("test_003")]);
        let missing = files("{view}/depth.png").read_layer(Layer::Albedo, names, &camera(2)).unwrap_err();
        assert!(missing.to_string().contains("test_003/depth.png"), "{missing}");
    }
}
