//! `lobelia eval PREDICTION TRUTH`: scores two folders of images, or two images, against each
//! other. Images of two folders are matched by their names without endings; those without a match
//! are left out.

use crate::report::scores::{EvalView, PassScores, Scaling, aligned, score_views};
use lobelia_geometry::view::metrics::erode;
use lobelia_geometry::{Error, Result};
use lobelia_io::codec::file::read_folder;
use lobelia_io::codec::image::{BRIGHTEST, Gamma, IMAGE_EXTENSIONS, Orientation, read_image};
use std::{collections::BTreeMap, path::Path, path::PathBuf};

/// The result of a comparison.
#[derive(Clone, Debug, PartialEq)]
pub struct Comparison {
    /// Means, scale and the scores of each file.
    pub scores: PassScores,
    /// File stems of predictions without a truth; they are left out.
    pub only_prediction: Vec<String>,
    /// File stems of truths without a prediction; they are left out.
    pub only_truth: Vec<String>,
}

/// Compares `prediction` with `truth`, two files or two folders whose images are matched by stem
/// (if a folder has several files with one stem, the first extension in [`IMAGE_EXTENSIONS`] is
/// used).
///
/// Images are read like photographs: EXR and HDR are linear, others sRGB. Pixels in the mask count:
/// the truth's alpha if it has one, else the prediction's, else the whole image; eroded by one
/// pixel. sRGB scores are of whole images, after the scale if there is one; an image without alpha
/// has that of the other.
///
/// Images have no layers of their own, so that `scaling` is not [`Scaling::PerLayer`].
///
/// # Errors
/// [`Error::Usage`] for a file against a folder, or no common stems; [`Error::Input`] for an
/// unreadable image, unequal sizes, an empty mask, or a non-finite pixel in the mask.
pub fn compare(prediction: &Path, truth: &Path, scaling: Scaling) -> Result<Comparison> {
    let help = "give two files or two folders";
    let is_folder = |path: &Path| {
        let found = path.metadata();
        let found = found.map_err(|error| Error::input(path, "", format!("cannot be opened: {error}"), help));
        Ok::<_, Error>(found?.is_dir())
    };
    // By stem.
    let (predictions, mut truths) = match (is_folder(prediction)?, is_folder(truth)?) {
        (true, true) => (images_in(prediction)?, images_in(truth)?),
        (false, false) => {
            let name = prediction.file_stem().unwrap_or_default().to_string_lossy().into_owned();
            let of = |path: &Path| BTreeMap::from([(name.clone(), path.to_owned())]);
            (of(prediction), of(truth))
        }
        _ => {
            let (prediction, truth) = (prediction.display(), truth.display());
            let problem = format!("one of {prediction} and {truth} is a folder, the other a file");
            return Err(Error::usage(problem, help));
        }
    };
    let found = [(prediction, predictions.len()), (truth, truths.len())];
    let (mut pairs, mut only_prediction) = (Vec::new(), Vec::new());
    for (stem, path) in predictions {
        match truths.remove(&stem) {
            Some(true_path) => pairs.push((stem, path, true_path)),
            None => only_prediction.push(stem),
        }
    }
    if pairs.is_empty() {
        let [a, b] = found.map(|(folder, count)| format!("{} ({count} found)", folder.display()));
        let problem = format!("no image in {a} has the name of one in {b}");
        let help = "images are matched by name without the ending, as in a/view_3.exr and b/view_3.png";
        return Err(Error::usage(problem, help));
    }
    let scores = score_views(pairs.len(), scaling, |i| load_view(&pairs[i].0, &pairs[i].1, &pairs[i].2))?;
    Ok(Comparison { scores, only_prediction, only_truth: truths.into_keys().collect() })
}

impl Comparison {
    /// A table for the terminal: one line per file, the means, those of sRGB values, and the files
    /// that are left out.
    pub fn table(&self) -> String {
        let scaled = self.scores.scaling != Scaling::None;
        let line = |name: &str, psnr: f64, raw: f64, ssim: f64| {
            let last = if scaled { format!("{raw:.2}") } else { String::new() };
            [name.to_owned(), format!("{psnr:.2}"), format!("{ssim:.4}"), last]
        };
        let head = ["file", "PSNR dB", "SSIM", if scaled { "unscaled dB" } else { "" }];
        let mut rows = vec![head.map(str::to_owned)];
        rows.extend(self.scores.views.iter().map(|v| line(&v.name, v.psnr, v.psnr_raw, v.ssim)));
        rows.push(line("mean", self.scores.psnr, self.scores.psnr_raw, self.scores.ssim));
        let mut text = aligned(&rows);
        if scaled {
            let [r, g, b] = self.scores.scale;
            text += &format!("scale R {r:.4} G {g:.4} B {b:.4}\n");
        }
        if let Some(mean) = &self.scores.srgb {
            let of = |psnr: f64, ssim: f64| format!("{psnr:.2} dB, SSIM {ssim:.4}");
            let (white, black) = (of(mean.psnr_white, mean.ssim_white), of(mean.psnr_black, mean.ssim_black));
            text += &format!("sRGB: mask {:.2} dB · white {white} · black {black}\n", mean.psnr_mask);
        }
        for (what, names) in [("prediction", &self.only_prediction), ("truth", &self.only_truth)] {
            if let Some(first) = names.first() {
                text += &format!("left out, only in the {what}: {} ({first}, …)\n", names.len());
            }
        }
        text
    }
}

/// The images of a folder by stem.
fn images_in(folder: &Path) -> Result<BTreeMap<String, PathBuf>> {
    let mut found: BTreeMap<String, (usize, PathBuf)> = BTreeMap::new();
    for entry in read_folder(folder)? {
        let path = entry.map_err(Error::io("read", folder))?.path();
        let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let kind = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
        let Some(rank) = IMAGE_EXTENSIONS.iter().position(|known| *known == kind) else { continue };
        let better = found.get(&stem).is_none_or(|(other, _)| rank < *other);
        if better && path.is_file() && !stem.starts_with('.') {
            found.insert(stem, (rank, path));
        }
    }
    Ok(found.into_iter().map(|(stem, (_, path))| (stem, path)).collect())
}

fn load_view(name: &str, prediction: &Path, truth: &Path) -> Result<EvalView> {
    let read = |path| read_image(path, Gamma::Srgb, Orientation::Upright);
    let (predicted, true_image) = (read(prediction)?, read(truth)?);
    let (width, height) = (true_image.image.width as usize, true_image.image.height as usize);
    let size = [predicted.image.width as usize, predicted.image.height as usize];
    if size != [width, height] {
        let sizes = format!("is {} × {} pixels", size[0], size[1]);
        let other = format!("but {} is {width} × {height}", truth.display());
        return Err(Error::input(prediction, "", format!("{sizes}, {other}"), "compare images of one size"));
    }
    let alpha = true_image.alpha.as_ref().or(predicted.alpha.as_ref());
    let coverage = alpha.cloned().unwrap_or_default();
    let mask =
        if coverage.is_empty() { vec![true; width * height] } else { erode([width, height], &coverage) };
    if !mask.contains(&true) {
        let problem = "no pixel is left to compare: the alpha channel, eroded by one pixel, is empty";
        return Err(Error::input(truth, "", problem, "the object must cover at least 3 × 3 pixels"));
    }
    // NaN and infinite pixels are repaired on reading; inside the mask they are an error here.
    for (path, loaded) in [(prediction, &predicted), (truth, &true_image)] {
        let mut repaired = loaded.saturated.iter().zip(&mask);
        if let Some(at) = repaired.position(|(bad, counts)| loaded.is_float && *bad && *counts) {
            let place = format!("pixel ({}, {})", at % width, at / width);
            let help = "write the image again without NaN, infinite or absurd values";
            let problem = format!("is not a finite number up to {BRIGHTEST}");
            return Err(Error::input(path, place, problem, help));
        }
    }
    Ok(EvalView {
        name: name.to_owned(),
        width,
        height,
        prediction: predicted.image.pixels,
        truth: true_image.image.pixels,
        mask,
        alpha: predicted.alpha.unwrap_or_else(|| coverage.clone()),
        coverage,
        in_srgb: true,
        ..EvalView::default()
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::RgbImage;
    use lobelia_io::{codec::exr::ExrLayers, codec::exr_frame::write_channels, codec::png_file};

    fn exr(path: &Path, size: [usize; 2], value: impl Fn(usize) -> f32, alpha: Option<Vec<f32>>) {
        let values: Vec<f32> = (0..size[0] * size[1]).map(value).collect();
        let colors = ["R", "G", "B"].map(|name| (name.to_owned(), values.clone()));
        let channels = colors.into_iter().chain(alpha.map(|alpha| ("A".to_owned(), alpha))).collect();
        let [width, height] = size.map(|side| side as u32);
        write_channels(path, &ExrLayers { width, height, channels }).unwrap();
    }

    /// Folders `p` and `t`.
    fn folders() -> (tempfile::TempDir, PathBuf, PathBuf) {
        let root = tempfile::tempdir().unwrap();
        let (p, t) = (root.path().join("p"), root.path().join("t"));
        [&p, &t].iter().for_each(|folder| std::fs::create_dir(folder).unwrap());
        (root, p, t)
    }

    #[test]
    fn folders_are_matched_by_stem() {
        let (_root, p, t) = folders();
        exr(&p.join("a.exr"), [6, 5], |_| 0.6, None);
        exr(&t.join("a.exr"), [6, 5], |_| 0.5, None);
        for path in [p.join("b.exr"), t.join("b.exr"), p.join("mine.exr"), t.join("yours.exr")] {
            exr(&path, [4, 4], |_| 0.25, None);
        }
        // The EXR of a stem has priority over its PNG; other files are ignored.
        png_file::write_rgb8(p.join("a.png"), &RgbImage::new(2, 2)).unwrap();
        std::fs::write(p.join("notes.txt"), "x").unwrap();
        let found = compare(&p, &t, Scaling::None).unwrap();
        assert_eq!(found.scores.views.len(), 2);
        assert!((found.scores.views[0].psnr - 20.0).abs() < 1e-5);
        assert_eq!(found.scores.views[1].psnr, 100.0);
        assert!((found.scores.psnr - 60.0).abs() < 1e-5);
        assert_eq!((found.only_prediction, found.only_truth), (vec!["mine".into()], vec!["yours".into()]));
    }

    #[test]
    fn scale_is_pooled_and_shown() {
        let (_root, p, t) = folders();
        exr(&p.join("a.exr"), [12, 12], |i| i as f32 / 300.0, None);
        exr(&t.join("a.exr"), [12, 12], |i| i as f32 / 150.0, None);
        let found = compare(&p.join("a.exr"), &t.join("a.exr"), Scaling::PerChannel).unwrap();
        assert!(found.scores.psnr > 90.0 && found.scores.psnr_raw < 20.0);
        let table = found.table();
        assert!(table.contains("sRGB: mask ") && found.scores.srgb.unwrap().psnr_mask > 90.0, "{table}");
        assert!(table.contains("scale R 2.0000 G 2.0000 B 2.0000") && table.contains("mean"), "{table}");
    }

    #[test]
    fn the_mask_comes_from_the_truth_first() {
        let (_root, p, t) = folders();
        // Right half wrong; the truth's alpha covers columns 0–3 (eroded: 0–2), the prediction's
        // all.
        let wrong = |i: usize| if i % 8 >= 4 { 0.9 } else { 0.5 };
        exr(&p.join("a.exr"), [8, 6], wrong, Some(vec![1.0; 48]));
        let covered: Vec<f32> = (0..48).map(|i| if i % 8 < 4 { 1.0 } else { 0.0 }).collect();
        exr(&t.join("a.exr"), [8, 6], |_| 0.5, Some(covered.clone()));
        assert_eq!(compare(&p, &t, Scaling::None).unwrap().scores.psnr, 100.0);
        exr(&t.join("a.exr"), [8, 6], |_| 0.5, None);
        assert!(compare(&p, &t, Scaling::None).unwrap().scores.psnr < 15.0);
        exr(&p.join("a.exr"), [8, 6], wrong, Some(covered));
        let scores = compare(&p, &t, Scaling::None).unwrap().scores;
        assert_eq!(scores.psnr, 100.0);
        // Both have that alpha for sRGB scores, too.
        let srgb = scores.srgb.unwrap();
        assert_eq!([srgb.psnr_mask, srgb.psnr_white, srgb.psnr_black], [100.0; 3]);
    }

    #[track_caller]
    fn refused(p: &Path, t: &Path, words: &str) {
        let error = compare(p, t, Scaling::None).unwrap_err();
        assert!(error.to_string().contains(words) && error.exit_code() == 2, "{error}");
    }

    #[test]
    fn bad_input_is_one_clear_error() {
        let (root, p, t) = folders();
        let (a, b) = (p.join("a.exr"), t.join("a.exr"));
        refused(&p, &t, "(0 found)");
        refused(&root.path().join("none"), &t, "cannot be opened");
        exr(&a, [6, 5], |_| 0.6, None);
        refused(&a, &t, "is a folder");
        exr(&b, [5, 6], |_| 0.6, None);
        refused(&p, &t, "is 6 × 5 pixels, but");
        let pixel = |x, y| if (x, y) == (2, 1) { (f32::NAN, 0.5, 0.5) } else { (0.5, 0.5, 0.5) };
        exr::prelude::write_rgb_file(&b, 6, 5, pixel).unwrap();
        refused(&p, &t, "pixel (2, 1)");
        exr(&b, [6, 5], |_| 0.5, Some(vec![0.0; 30]));
        refused(&p, &t, "no pixel is left");
        let whole = std::fs::read(&b).unwrap();
        std::fs::write(&b, &whole[..whole.len() / 2]).unwrap();
        refused(&p, &t, "the EXR is damaged or truncated");
        std::fs::remove_file(&b).unwrap();
        std::fs::write(t.join("a.png"), b"not a PNG").unwrap();
        refused(&p, &t, "neither PNG, JPEG, TIFF");
        std::fs::write(root.path().join("x.txt"), b"").unwrap();
        refused(&a, &root.path().join("x.txt"), "is empty");
    }
}
