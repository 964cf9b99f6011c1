//! Scores of passes: computed view by view, and written to `metrics.json`.

use crate::report::published::{Covered, OrbScores, SrgbScores, orb_scores, srgb_scores};
use bevy_ecs::prelude::Resource;
use glam::Vec3;
use indexmap::IndexMap;
use lobelia_geometry::view::metrics::{
    ImagePair, LayerScaleSums, ScaleSums, mean, psnr, scaled, scaled_layers, ssim,
};
use lobelia_geometry::{Error, Result};
use lobelia_io::codec::file;
use lobelia_solve::fit::determined::Determined;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// The scale that is fitted to a prediction before scoring, by least squares over all views, if it
/// is not one a view (unclipped, eroded masks).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Scaling {
    /// None: for novel views.
    #[default]
    None,
    /// One factor per channel: for relighting, because light and albedo are determined only up to
    /// that factor.
    PerChannel,
    /// One factor per channel and view, as Stanford-ORB has it; its [scores](OrbScores) are then
    /// computed as well.
    PerView,
    /// One factor per channel for the diffuse layer and one for the specular layer: for edited
    /// materials.
    PerLayer,
}

/// One view to be scored; every list holds `width * height` entries, row by row from the top left.
#[derive(Clone, Debug, Default)]
pub(crate) struct EvalView {
    pub name: String,
    pub width: usize,
    pub height: usize,
    /// Predicted linear radiance, coverage-weighted on black.
    pub prediction: Vec<Vec3>,
    /// Its layers; only read for [`Scaling::PerLayer`] and may be empty otherwise.
    pub diffuse: Vec<Vec3>,
    pub specular: Vec<Vec3>,
    /// True linear radiance.
    pub truth: Vec<Vec3>,
    /// Pixels that count: the eroded mask (`erode`).
    pub mask: Vec<bool>,
    /// Coverage of the prediction; only read for sRGB scores. Empty: every pixel is covered.
    pub alpha: Vec<f32>,
    /// Coverage of the truth, likewise.
    pub coverage: Vec<f32>,
    /// Whether sRGB scores are wanted as well. They are those of the prediction after scaling.
    pub in_srgb: bool,
}

impl EvalView {
    fn pair<'a>(&'a self, prediction: &'a [Vec3]) -> Result<ImagePair<'a>> {
        let pair = ImagePair::new([self.width, self.height], prediction, &self.truth, &self.mask);
        pair.map_err(|error| match error {
            Error::Run { context, problem } => Error::run(format!("{context} view {}", self.name), problem),
            other => other,
        })
    }

    /// The prediction times factors: of the image, or of its two layers.
    fn scaled(&self, scale: [f64; 3], specular: Option<[f64; 3]>) -> Vec<Vec3> {
        match specular {
            None => scaled(&self.prediction, scale),
            Some(specular) => scaled_layers([&self.diffuse, &self.specular], [scale, specular]),
        }
    }
}

/// Scores of one view.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ViewScores {
    /// Name of the view.
    pub name: String,
    /// PSNR after scaling, dB.
    pub psnr: f64,
    /// PSNR without scaling, dB.
    pub psnr_raw: f64,
    /// SSIM after scaling.
    pub ssim: f64,
    /// The factors of this view, for [`Scaling::PerView`].
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub scale: Option<[f64; 3]>,
    /// Scores of sRGB values after scaling, if the view is scored against a photograph or another
    /// picture of encoded colors.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub srgb: Option<SrgbScores>,
    /// Stanford-ORB's scores, for [`Scaling::PerView`].
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub stanford_orb: Option<OrbScores>,
}

/// Scores of one pass.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PassScores {
    /// Mean PSNR over the views after scaling, dB.
    pub psnr: f64,
    /// Mean PSNR without scaling, dB.
    pub psnr_raw: f64,
    /// Mean SSIM after scaling.
    pub ssim: f64,
    /// The scaling that was applied.
    pub scaling: Scaling,
    /// The factors: of the image, or of its diffuse layer (`[1, 1, 1]` for [`Scaling::None`]);
    /// their mean over the views for [`Scaling::PerView`].
    pub scale: [f64; 3],
    /// The specular layer's factors, for [`Scaling::PerLayer`].
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub scale_specular: Option<[f64; 3]>,
    /// Mean scores of sRGB values after scaling, if the pass is scored against photographs or other
    /// pictures of encoded colors.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub srgb: Option<SrgbScores>,
    /// Stanford-ORB's mean scores, for [`Scaling::PerView`].
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub stanford_orb: Option<OrbScores>,
    /// The scores of each view.
    pub views: Vec<ViewScores>,
}

/// The scale between light and albedo, the same in all outputs of a run.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ScaleFound {
    /// The rule, as in a scene file; `Known` if light or albedo is given.
    pub rule: String,
    /// Mean radiance of the light over the sphere, linear RGB.
    pub mean_light: [f32; 3],
    /// Mean albedo of the texels that are seen, linear RGB.
    pub mean_albedo: [f32; 3],
}

/// Returns words after the error of a trial: after how many steps it was given up, if it was.
pub(crate) fn given_up_words(given_up: Option<u32>) -> String {
    given_up.map_or(String::new(), |steps| format!(" (given up after {steps} steps)"))
}

/// Grounds of a fit's choice of base materials: mean absolute errors of radiance after the same
/// steps over the same pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MaterialsTried {
    /// With one base material.
    pub one: f64,
    /// With several.
    pub several: f64,
    /// Steps after which they were compared.
    #[serde(default)]
    pub steps: u32,
    /// Steps with several after which they were given up; `several` is their error there.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub given_up: Option<u32>,
    /// Seconds of the trial.
    pub seconds: f64,
}

/// Grounds of a fit's choice of the distribution of microfacet normals: mean absolute errors of
/// radiance over the same pixels, after steps with one distribution and then as many with each of
/// the two.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct NdfTried {
    /// With GGX.
    pub ggx: f64,
    /// With the spherical Gaussian; `None` until the fit is there.
    pub sg: Option<f64>,
    /// Specular albedo (linear RGB) and roughness that GGX was found with.
    pub ggx_albedo: [f32; 3],
    /// Roughness.
    pub ggx_roughness: f32,
    /// Steps with GGX after which it was given up; `ggx` is its error there.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub given_up: Option<u32>,
    /// Steps after which they were compared.
    pub steps: u32,
}

/// How the object lay in a round of photographs.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PlacementFound {
    /// Which photographs, as in the scene file.
    pub photographs: String,
    /// How the object was turned relative to the first placement, about x, then y, then z, in
    /// degrees.
    pub turned_degrees: [f32; 3],
}

/// A frame in which the light could stand still.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct FrameTried {
    /// In words: "stands around the object".
    pub frame: String,
    /// Mean absolute error of radiance of the initialization in it.
    pub error: f32,
}

/// How one view came out; what is not known is `null`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ViewOutcome {
    /// Name of the view.
    pub name: String,
    /// `train` or `test`.
    pub split: String,
    /// Pixels that a fit may visit: they show the object, and their rays meet the surface.
    pub pixels: Option<u64>,
    /// Share of the mask that the surface covers.
    pub hit: Option<f64>,
    /// Pixels in both mask and surface over pixels in either.
    pub mask_iou: Option<f64>,
    /// PSNR: of training views as the fit sees them, of others as they are scored, dB.
    pub psnr: Option<f64>,
    /// Share of pixels whose sRGB luminance is off by more than 0.1.
    pub outliers: Option<f64>,
}

/// All scores of a run; `metrics.json`.
#[derive(Resource, Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Scores {
    /// By pass name, in the order of scoring.
    pub passes: IndexMap<String, PassScores>,
    /// Albedo PSNR after median scales, dB; `null` if there is no true albedo.
    pub albedo_psnr: Option<f64>,
    /// Mean angle between normals, degrees; `null` if there are no true normals.
    pub normal_deg: Option<f64>,
    /// Median angle between normals, degrees.
    pub normal_median_deg: Option<f64>,
    /// Number of pixels whose normals are compared.
    pub normal_pixels: Option<u64>,
    /// Mean over the views of the first scored pass: pixels in both the view's mask and the object
    /// as rendered, over pixels in either; `null` if no view has a mask.
    pub mask_iou: Option<f64>,
    /// Chamfer distance of the surface to the true mesh, in the data's own unit (unit-ball units
    /// where the object is in the unit ball): the mean of the two directed mean distances; `null`
    /// if no true mesh is named.
    pub chamfer: Option<f64>,
    /// The scale between light and albedo after the last fit; `null` if nothing is fitted.
    pub scale: Option<ScaleFound>,
    /// The frame in which a fit found the light to stand still, as a scene file writes it; `null`
    /// if none was looked for.
    pub light_frame: Option<String>,
    /// The frames that were tried.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub light_frames_tried: Vec<FrameTried>,
    /// How the object lies in each placement, if a fit has looked for it.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub placements: Vec<PlacementFound>,
    /// The materials that a fit has chosen from, if it had to.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub materials_tried: Option<MaterialsTried>,
    /// The distributions of microfacet normals that a fit has chosen from, if it had to.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ndf_tried: Option<NdfTried>,
    /// How well the photographs determine what the last fit found, as standard deviations of
    /// logarithms.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub determined: Option<Determined>,
    /// Steps of fits that were not taken, because loss or gradient were not finite.
    pub steps_taken_back: u32,
    /// Problems, in sentences; empty if there were none.
    pub warnings: Vec<String>,
    /// How each view came out of the last fit, and of scores.
    pub views: Vec<ViewOutcome>,
    /// Time of all fits, seconds.
    pub fit_secs: Option<f64>,
    /// Largest resident memory of the process so far, MiB.
    pub peak_rss_mib: Option<f64>,
}

/// Scores `count` views. `load(i)` gives view `i`; it is called once for each view, and once more
/// before that for the scale, if there is one of all views, so that at most one view is in memory.
pub(crate) fn score_views(
    count: usize,
    scaling: Scaling,
    mut load: impl FnMut(usize) -> Result<EvalView>,
) -> Result<PassScores> {
    let (mut scale, mut scale_specular) = ([1.0; 3], None);
    if scaling == Scaling::PerChannel {
        let mut sums = ScaleSums::default();
        for i in 0..count {
            let view = load(i)?;
            sums.add(&view.pair(&view.prediction)?);
        }
        scale = sums.scale();
    } else if scaling == Scaling::PerLayer {
        let mut sums = LayerScaleSums::default();
        for i in 0..count {
            let view = load(i)?;
            sums.add(&view.pair(&view.diffuse)?, &view.specular)?;
        }
        let [diffuse, specular] = sums.scales();
        (scale, scale_specular) = (diffuse, Some(specular));
    }
    let mut views: Vec<ViewScores> = Vec::new();
    for i in 0..count {
        let view = load(i)?;
        let size = [view.width, view.height];
        let raw = view.pair(&view.prediction)?;
        let own = (scaling == Scaling::PerView).then(|| {
            let mut sums = ScaleSums::default();
            sums.add(&raw);
            sums.scale()
        });
        let prediction = view.scaled(own.unwrap_or(scale), scale_specular);
        let pair = view.pair(&prediction)?;
        let srgb = view.in_srgb.then(|| {
            let prediction = Covered { radiance: &prediction, alpha: &view.alpha };
            srgb_scores(size, prediction, Covered { radiance: &view.truth, alpha: &view.coverage })
        });
        views.push(ViewScores {
            psnr: psnr(&pair),
            psnr_raw: psnr(&raw),
            ssim: ssim(&pair),
            scale: own,
            srgb,
            stanford_orb: own.and_then(|_| orb_scores(size, [&view.prediction, &view.truth], &view.coverage)),
            name: view.name,
        });
    }
    if scaling == Scaling::PerView {
        let of_channel = |c: usize| mean(views.iter().filter_map(|view| Some(view.scale?[c])));
        scale = std::array::from_fn(|c| of_channel(c).unwrap_or_default());
    }
    let mean = |of: fn(&ViewScores) -> f64| {
        mean(views.iter().map(of)).ok_or_else(|| Error::run("scoring", "there is no view to score"))
    };
    Ok(PassScores {
        psnr: mean(|view| view.psnr)?,
        psnr_raw: mean(|view| view.psnr_raw)?,
        ssim: mean(|view| view.ssim)?,
        scaling,
        scale,
        scale_specular,
        srgb: SrgbScores::mean(&views.iter().map(|view| view.srgb).collect::<Vec<_>>()),
        stanford_orb: OrbScores::mean(&views.iter().map(|view| view.stanford_orb).collect::<Vec<_>>()),
        views,
    })
}

impl PassScores {
    /// The prediction of `view` with the scale of these scores, for contact sheets and error maps.
    pub(crate) fn scored_prediction(&self, view: &EvalView) -> Vec<Vec3> {
        let own = self.views.iter().find(|scores| scores.name == view.name).and_then(|scores| scores.scale);
        view.scaled(own.unwrap_or(self.scale), self.scale_specular)
    }

    /// "41.62 dB, SSIM 0.9871", with the unscaled PSNR where it differs: for headings of contact
    /// sheets.
    pub fn summary(&self) -> String {
        match self.scaling {
            Scaling::None => format!("{:.2} dB, SSIM {:.4}", self.psnr, self.ssim),
            _ => format!("{:.2} dB ({:.2} unscaled), SSIM {:.4}", self.psnr, self.psnr_raw, self.ssim),
        }
    }
}

impl Scores {
    /// Adds to the time of all fits.
    pub(crate) fn add_fit_secs(&mut self, secs: f64) {
        *self.fit_secs.get_or_insert(0.0) += secs;
    }

    /// Writes `metrics.json` (indented, keys in a fixed order).
    ///
    /// # Errors
    /// [`Error::Io`] if the file cannot be written.
    pub fn write_json(&self, path: impl AsRef<Path>) -> Result<()> {
        let text = serde_json::to_string_pretty(self);
        let text = text.map_err(|error| Error::run("scoring", error.to_string()))? + "\n";
        file::write_bytes(path.as_ref(), text.as_bytes())
    }

    /// A table for the terminal, one line per pass; a second one of sRGB scores below a blank line,
    /// if there are any; a line for each pass that is scored as Stanford-ORB does; and a line for
    /// the rest. Ends with a line break.
    pub fn table(&self) -> String {
        let heads = ["in sRGB", "mask dB", "white dB", "SSIM", "black dB", "SSIM"];
        let (mut srgb, mut rest) = (vec![heads.map(str::to_owned)], String::new());
        let mut rows = vec![["pass", "PSNR dB", "raw", "SSIM", "scale R", "G", "B"].map(str::to_owned)];
        let (two, four) = (|value: f64| format!("{value:.2}"), |value: f64| format!("{value:.4}"));
        for (name, pass) in &self.passes {
            let [r, g, b] = match pass.scaling {
                Scaling::None => ["–", "–", "–"].map(str::to_owned),
                // Their mean.
                Scaling::PerView => pass.scale.map(|s| format!("ø {s:.3}")),
                _ => pass.scale.map(|s| format!("{s:.3}")),
            };
            rows.push([name.clone(), two(pass.psnr), two(pass.psnr_raw), four(pass.ssim), r, g, b]);
            if let Some(specular) = pass.scale_specular {
                let [r, g, b] = specular.map(|s| format!("{s:.3}"));
                let nothing = String::new;
                rows.push(["  its specular layer".to_owned(), nothing(), nothing(), nothing(), r, g, b]);
            }
            if let Some(of) = pass.srgb {
                let [mask, white, black] = [of.psnr_mask, of.psnr_white, of.psnr_black].map(two);
                srgb.push([name.clone(), mask, white, four(of.ssim_white), black, four(of.ssim_black)]);
            }
            if let Some(OrbScores { psnr_hdr: hdr, psnr_ldr: ldr }) = pass.stanford_orb {
                rest += &format!("{name}, as Stanford-ORB: PSNR-H {hdr:.2} dB, PSNR-L {ldr:.2} dB\n");
            }
        }
        let normals = self.normal_deg.map(|mean| {
            let more = self.normal_median_deg.zip(self.normal_pixels);
            let more = more.map(|(median, pixels)| format!(" (median {median:.2}°, {pixels} pixels)"));
            format!("normals {mean:.2}°{}", more.unwrap_or_default())
        });
        let whole = [
            self.albedo_psnr.map(|v| format!("albedo {v:.2} dB")),
            normals,
            self.mask_iou.map(|v| format!("mask IoU {v:.4}")),
            self.chamfer.map(|v| format!("Chamfer {v:.5}")),
            self.fit_secs.map(|v| format!("fit {v:.1} s")),
            self.peak_rss_mib.map(|v| format!("peak memory {v:.0} MiB")),
        ];
        let whole: Vec<String> = whole.into_iter().flatten().collect();
        if !whole.is_empty() {
            rest += &(whole.join(" · ") + "\n");
        }
        let passes = if rows.len() > 1 { aligned(&rows) } else { String::new() };
        let srgb = if srgb.len() > 1 { format!("\n{}", aligned(&srgb)) } else { String::new() };
        passes + &srgb + &rest
    }
}

/// Pads columns to their widest entry, with a rule under the first row; the first column is
/// left-aligned, the others right-aligned.
pub(crate) fn aligned(rows: &[impl AsRef<[String]>]) -> String {
    let columns = rows.first().map_or(0, |row| row.as_ref().len());
    let longest = |c: usize| rows.iter().map(|row| row.as_ref()[c].chars().count()).max().unwrap_or(0);
    let width: Vec<usize> = (0..columns).map(longest).collect();
    let mut text = String::new();
    for (i, row) in rows.iter().enumerate() {
        let mut line = String::new();
        for (c, (entry, width)) in row.as_ref().iter().zip(&width).enumerate() {
            line += &if c == 0 { format!("{entry:<width$}") } else { format!("  {entry:>width$}") };
        }
        text += &format!("{}\n", line.trim_end());
        if i == 0 {
            text += &format!("{}\n", "─".repeat(width.iter().sum::<usize>() + 2 * (columns - 1)));
        }
    }
    text
}

/// Largest resident memory of this process so far in MiB (`VmHWM`); `None` without `/proc`.
pub fn peak_rss_mib() -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    let kib: f64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kib / 1024.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A view whose prediction's layers differ from the truth's by known factors.
    fn view(index: usize, diffuse_factor: f32, specular_factor: f32) -> EvalView {
        let (width, height) = (14, 12);
        let value = |i: usize, k: usize| ((i * 7919 + index * 31 + k * 104_729) % 997) as f32 / 2500.0;
        let layer = |k: usize| -> Vec<Vec3> {
            (0..width * height).map(|i| Vec3::new(value(i, k), value(i, k + 1), value(i, k + 2))).collect()
        };
        let (diffuse, specular) = (layer(0), layer(9));
        let sum = |a: f32, b: f32| diffuse.iter().zip(&specular).map(|(d, s)| a * *d + b * *s).collect();
        EvalView {
            name: format!("view_{index}"),
            width,
            height,
            prediction: sum(1.0, 1.0),
            truth: sum(diffuse_factor, specular_factor),
            mask: vec![true; width * height],
            diffuse,
            specular,
            ..EvalView::default()
        }
    }

    fn scored(views: &[EvalView], scaling: Scaling) -> PassScores {
        score_views(views.len(), scaling, |i| Ok(views[i].clone())).unwrap()
    }

    #[test]
    fn scales_are_shared_by_all_views() {
        let found = scored(&[view(0, 1.25, 1.25), view(1, 1.25, 1.25)], Scaling::PerChannel);
        assert!(found.scale.iter().all(|s| (s - 1.25).abs() < 1e-6), "{:?}", found.scale);
        assert!(found.psnr > 90.0 && found.psnr_raw < 30.0 && found.ssim > 0.999_999);
        assert_eq!(found.views[1].name, "view_1");
        // One view at 1, one at 2: a shared scale fits neither.
        let found = scored(&[view(0, 1.0, 1.0), view(1, 2.0, 2.0)], Scaling::PerChannel);
        assert!(found.scale.iter().all(|&s| s > 1.3 && s < 1.7) && found.psnr < 30.0);
        assert_eq!(found.psnr, (found.views[0].psnr + found.views[1].psnr) / 2.0);
    }

    #[test]
    fn layers_have_scales_of_their_own() {
        let views = [view(0, 0.5, 1.5), view(1, 0.5, 1.5)];
        let single = scored(&views, Scaling::PerChannel);
        let layers = scored(&views, Scaling::PerLayer);
        assert!(layers.psnr > 90.0 && single.psnr < 35.0, "{} {}", layers.psnr, single.psnr);
        assert!(layers.scale_specular.unwrap().iter().all(|s| (s - 1.5).abs() < 1e-5));
        let raw = scored(&views, Scaling::None);
        assert_eq!(raw.scored_prediction(&views[0]), views[0].prediction);
        let shown = layers.scored_prediction(&views[1]);
        assert!(shown.iter().zip(&views[1].truth).all(|(p, t)| p.abs_diff_eq(*t, 1e-5)));
        assert_eq!((raw.psnr, raw.psnr), (raw.psnr_raw, layers.psnr_raw));
    }

    #[test]
    fn each_view_may_have_its_own_scale() {
        let views = [view(0, 1.25, 1.25), view(1, 0.5, 0.5)];
        let (shared, own) = (scored(&views, Scaling::PerChannel), scored(&views, Scaling::PerView));
        assert!(shared.psnr < 40.0 && own.psnr > 90.0, "{} {}", shared.psnr, own.psnr);
        assert!((own.views[1].scale.unwrap()[0] - 0.5).abs() < 1e-6 && (own.scale[0] - 0.875).abs() < 1e-6);
        let shown = own.scored_prediction(&views[1]);
        assert!(shown.iter().zip(&views[1].truth).all(|(p, t)| p.abs_diff_eq(*t, 1e-5)));
        assert!(own.stanford_orb.is_some() && shared.stanford_orb.is_none());
    }

    #[test]
    fn bad_views_are_named() {
        let mut bad = view(3, 1.0, 1.0);
        bad.prediction[15].y = f32::INFINITY;
        let message = score_views(1, Scaling::None, |_| Ok(bad.clone())).unwrap_err().to_string();
        assert!(message.contains("view_3") && message.contains("pixel (1, 1)"), "{message}");
        let mut bad = view(3, 1.0, 1.0);
        bad.specular.clear();
        assert!(score_views(1, Scaling::PerLayer, |_| Ok(bad.clone())).is_err());
        assert!(score_views(0, Scaling::None, |_| Ok(bad.clone())).is_err());
    }

    #[test]
    fn srgb_scores_are_of_the_scaled_prediction_and_only_where_wanted() {
        let views = [0, 1].map(|i| EvalView { in_srgb: true, ..view(i, 1.25, 1.25) });
        let (plain, scaled) = (scored(&views, Scaling::None), scored(&views, Scaling::PerChannel));
        let of_views: Vec<f64> = plain.views.iter().map(|v| v.srgb.unwrap().psnr_mask).collect();
        assert_eq!(plain.srgb.unwrap().psnr_mask, (of_views[0] + of_views[1]) / 2.0);
        assert!(plain.srgb.unwrap().psnr_mask < 30.0);
        assert!(scaled.psnr > 90.0 && scaled.srgb.unwrap().psnr_mask > 90.0);
        let unwanted = scored(&[view(0, 1.25, 1.25), view(1, 1.25, 1.25)], Scaling::None);
        assert_eq!((unwanted.srgb, unwanted.views[0].srgb), (None, None));
        assert_eq!((unwanted.psnr, unwanted.ssim), (plain.psnr, plain.ssim));
    }

    #[test]
    fn json_has_the_asked_for_form() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("metrics.json");
        let mut scores = Scores { albedo_psnr: Some(35.5), fit_secs: Some(61.25), ..Scores::default() };
        let views = [EvalView { in_srgb: true, ..view(0, 1.1, 1.1) }];
        scores.passes.insert("relit".into(), scored(&views, Scaling::PerChannel));
        scores.write_json(&path).unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        let json: serde_json::Value = serde_json::from_str(&text).unwrap();
        assert_eq!(json["passes"]["relit"]["scaling"], "per_channel");
        assert_eq!(json["albedo_psnr"], 35.5);
        assert!(json["normal_deg"].is_null() && json.as_object().unwrap().contains_key("peak_rss_mib"));
        let read: Scores = serde_json::from_str(&text).unwrap();
        let (read, made) = (&read.passes["relit"], &scores.passes["relit"]);
        assert_eq!((read.scaling, read.views.len()), (Scaling::PerChannel, 1));
        assert!((read.psnr_raw - made.psnr_raw).abs() < 1e-9 && (read.scale[1] - made.scale[1]).abs() < 1e-9);
    }

    const TABLE: &str = "\
pass                  PSNR dB   raw    SSIM  scale R      G       B
───────────────────────────────────────────────────────────────────
novel                   41.62  9.50  0.9877        –      –       –
edited_gold             41.62  9.50  0.9877    1.000  0.500  12.250
  its specular layer                           2.000  2.000   2.000

in sRGB  mask dB  white dB    SSIM  black dB    SSIM
────────────────────────────────────────────────────
novel      28.12     31.50  0.9600      9.88  0.7500
normals 0.12° · peak memory 812 MiB
";

    #[test]
    fn the_table_lines_up() {
        let srgb = SrgbScores {
            psnr_mask: 28.125,
            psnr_white: 31.5,
            psnr_black: 9.876,
            ssim_white: 0.96,
            ssim_black: 0.75,
        };
        let pass =
            PassScores { psnr: 41.618, psnr_raw: 9.5, ssim: 0.98765, srgb: Some(srgb), ..Default::default() };
        let edited = PassScores {
            scaling: Scaling::PerLayer,
            scale: [1.0, 0.5, 12.25],
            scale_specular: Some([2.0; 3]),
            srgb: None,
            ..pass.clone()
        };
        let passes = IndexMap::from([("novel".to_owned(), pass), ("edited_gold".to_owned(), edited)]);
        let mut scores =
            Scores { passes, normal_deg: Some(0.125), peak_rss_mib: Some(812.4), ..Scores::default() };
        assert_eq!(scores.table(), TABLE);
        (scores.normal_median_deg, scores.normal_pixels) = (Some(0.075), Some(12_779));
        let normals = "normals 0.12° (median 0.07°, 12779 pixels) · ";
        assert!(scores.table().contains(normals), "{}", scores.table());
        scores.passes[0].stanford_orb = Some(OrbScores { psnr_hdr: 25.614, psnr_ldr: 31.2 });
        let line = "\nnovel, as Stanford-ORB: PSNR-H 25.61 dB, PSNR-L 31.20 dB\n";
        assert!(scores.table().contains(line), "{}", scores.table());
        assert_eq!(Scores::default().table(), "");
    }
}
