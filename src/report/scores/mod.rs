//! Scores of passes: computed view by view, and written to `metrics.json`.

use crate::codec::file;
use crate::fit::determined::Determined;
use crate::profile::Profile;
use crate::report::metrics;
use crate::report::metrics::{ImagePair, LayerScaleSums, LayerScales, ScaleSums};
use crate::report::orb::{OrbScores, orb_scores};
use crate::report::srgb::{Covered, SrgbScores, srgb_scores};
use crate::report::ssim::ssim;
use crate::{Error, Result};
use glam::Vec3;
use indexmap::IndexMap;
use serde::{Deserialize, Serialize};
use std::borrow::Borrow;
use std::path::Path;

/// The scale that is fitted to a prediction before scoring, by least squares over all views, if it is not one a view (unclipped, eroded masks).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum Scaling {
    /// None: for novel views.
    #[default]
    None,
    /// One factor per channel: for relighting, because light and albedo are determined only up to that factor.
    PerChannel,
    /// One factor per channel and view, as Stanford-ORB has it; its [scores](crate::report::orb) are then computed as well.
    PerView,
    /// One factor per channel for the diffuse layer and one for the specular layer: for edited materials.
    PerLayer,
}

/// One view to be scored; every list holds `width * height` entries, row by row from the top left.
#[derive(Clone, Debug, Default)]
pub struct EvalView {
    /// Name of the view.
    pub name: String,
    /// Width in pixels.
    pub width: usize,
    /// Height in pixels.
    pub height: usize,
    /// Predicted linear radiance, coverage-weighted on black.
    pub prediction: Vec<Vec3>,
    /// Its diffuse layer; only read for [`Scaling::PerLayer`] and may be empty otherwise.
    pub diffuse: Vec<Vec3>,
    /// Its specular layer; only read for [`Scaling::PerLayer`] and may be empty otherwise.
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
        ImagePair::new([self.width, self.height], prediction, &self.truth, &self.mask)
            .map_err(|error| self.named(error))
    }

    fn srgb(&self, prediction: &[Vec3]) -> Result<Option<SrgbScores>> {
        let prediction = Covered { radiance: prediction, alpha: &self.alpha };
        let truth = Covered { radiance: &self.truth, alpha: &self.coverage };
        let scores = self.in_srgb.then(|| srgb_scores([self.width, self.height], prediction, truth));
        scores.transpose().map_err(|error| self.named(error))
    }

    fn named(&self, error: Error) -> Error {
        match error {
            Error::Run { context, problem } => Error::run(format!("{context} view {}", self.name), problem),
            other => other,
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
    /// Scores of sRGB values after scaling, if the view is scored against a photograph or another picture of encoded colors.
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
    /// The factors: of the image, or of its diffuse layer (`[1, 1, 1]` for [`Scaling::None`]); their mean over the views for [`Scaling::PerView`].
    pub scale: [f64; 3],
    /// The specular layer's factors, for [`Scaling::PerLayer`].
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub scale_specular: Option<[f64; 3]>,
    /// Mean scores of sRGB values after scaling, if the pass is scored against photographs or other pictures of encoded colors.
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

/// That a trial was given up after so many steps, if it was, in words that follow its error.
pub(crate) fn given_up_words(given_up: Option<u32>) -> String {
    given_up.map_or(String::new(), |steps| format!(" (given up after {steps} steps)"))
}

/// What a fit has chosen its base materials by: mean absolute errors of radiance after the same steps over the same pixels.
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

/// What a fit has chosen the distribution of microfacet normals by: mean absolute errors of radiance over the same pixels, after steps with one distribution and
/// then as many with each of the two.
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
    /// How the object was turned relative to the first placement, about x, then y, then z, in degrees.
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

/// What a fit on several processes has sent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Communication {
    /// Processes.
    pub ranks: usize,
    /// Bytes that the first process has got from others, a step.
    pub bytes_per_step: f64,
    /// Seconds of its communication, a step; waiting for others is included.
    pub seconds_per_step: f64,
    /// Bytes beside those of the steps' samples: of shadows, and of what is done before the first step.
    #[serde(default)]
    pub bytes_of_shares: f64,
    /// Seconds of that; waiting for others is included.
    #[serde(default)]
    pub seconds_of_shares: f64,
}

impl Communication {
    /// "2 ranks: 0.400 MB and 1.20 ms of communication a step; 30.0 MB and 0.21 s for shadows and the beginning".
    pub fn words(&self) -> String {
        let Self { ranks, bytes_per_step, seconds_per_step, bytes_of_shares, seconds_of_shares } = self;
        let ranks = if *ranks == 1 { "1 rank".to_owned() } else { format!("{ranks} ranks") };
        let (megabytes, milliseconds) = (bytes_per_step / 1e6, seconds_per_step * 1e3);
        let beside = format!("{:.1} MB and {seconds_of_shares:.2} s", bytes_of_shares / 1e6);
        format!(
            "{ranks}: {megabytes:.3} MB and {milliseconds:.2} ms of communication a step; {beside} for shadows and the beginning"
        )
    }
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
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Scores {
    /// By pass name, in the order of scoring.
    pub passes: IndexMap<String, PassScores>,
    /// Albedo PSNR after median scales, dB; `null` if there is no true albedo.
    pub albedo_psnr: Option<f64>,
    /// Mean angle between normals, degrees; `null` if there are no true normals.
    pub normal_deg: Option<f64>,
    /// Median angle between normals, degrees.
    #[serde(default)]
    pub normal_median_deg: Option<f64>,
    /// Number of pixels whose normals are compared.
    #[serde(default)]
    pub normal_pixels: Option<u64>,
    /// Mean over the views of the first scored pass: pixels in both the view's mask and the object as rendered, over pixels in
    /// either; `null` if no view has a mask.
    pub mask_iou: Option<f64>,
    /// Chamfer distance of the surface to the true mesh, in the data's own unit (unit-ball units where the object is in the unit ball):
    /// the mean of the two directed mean distances; `null` if no true mesh is named.
    #[serde(default)]
    pub chamfer: Option<f64>,
    /// The scale between light and albedo after the last fit; `null` if nothing is fitted.
    #[serde(default)]
    pub scale: Option<ScaleFound>,
    /// The frame in which a fit found the light to stand still, as a scene file writes it; `null` if none was looked for.
    #[serde(default)]
    pub light_frame: Option<String>,
    /// The frames that were tried.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub light_frames_tried: Vec<FrameTried>,
    /// How the object lies in each placement, if a fit has looked for it.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub placements: Vec<PlacementFound>,
    /// The materials that a fit has chosen from, if it had to.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub materials_tried: Option<MaterialsTried>,
    /// The distributions of microfacet normals that a fit has chosen from, if it had to.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub ndf_tried: Option<NdfTried>,
    /// How well the photographs determine what the last fit found, as standard deviations of logarithms.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub determined: Option<Determined>,
    /// Steps of fits that were not taken, because loss or gradient were not finite.
    #[serde(default)]
    pub steps_taken_back: u32,
    /// What went wrong, in sentences; empty if nothing did.
    #[serde(default)]
    pub warnings: Vec<String>,
    /// How each view came out of the last fit, and of scores.
    #[serde(default)]
    pub views: Vec<ViewOutcome>,
    /// What the last fit has sent, on several processes.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub communication: Option<Communication>,
    /// Time of all fits, seconds.
    pub fit_secs: Option<f64>,
    /// Largest resident memory of the process so far, MiB.
    pub peak_rss_mib: Option<f64>,
    /// Where the time went, if the run is profiled.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub profile: Option<Profile>,
}

/// Scores `count` views. `load(i)` gives view `i`, borrowed or owned; it is called once for each view, and once more before that
/// for the scale, if there is one, so that at most one view is in memory.
///
/// # Errors
/// Whatever `load` returns; [`Error::Run`] for no views, lists of the wrong length, empty masks or non-finite pixels.
pub fn score_views<V: Borrow<EvalView>>(
    count: usize,
    scaling: Scaling,
    mut load: impl FnMut(usize) -> Result<V>,
) -> Result<PassScores> {
    let applied = find_scale(count, scaling, &mut load)?;
    let views: Vec<ViewScores> =
        (0..count).map(|i| score_view(load(i)?.borrow(), &applied)).collect::<Result<_>>()?;
    let mean = |of: fn(&ViewScores) -> f64| metrics::mean(&views.iter().map(of).collect::<Vec<_>>());
    let (Some(psnr), Some(psnr_raw), Some(ssim)) = (mean(|v| v.psnr), mean(|v| v.psnr_raw), mean(|v| v.ssim))
    else {
        return Err(Error::run("scoring", "there is no view to score"));
    };
    let (scale, scale_specular) = match applied {
        Applied::Nothing => ([1.0; 3], None),
        Applied::OwnOfView => (mean_scale(&views), None),
        Applied::Image(scale) => (scale, None),
        Applied::Layers(scales) => (scales.diffuse, Some(scales.specular)),
    };
    let srgb = SrgbScores::mean(&views.iter().map(|view| view.srgb).collect::<Vec<_>>());
    let stanford_orb = OrbScores::mean(&views.iter().map(|view| view.stanford_orb).collect::<Vec<_>>());
    Ok(PassScores { psnr, psnr_raw, ssim, scaling, scale, scale_specular, srgb, stanford_orb, views })
}

fn mean_scale(views: &[ViewScores]) -> [f64; 3] {
    let sum = |c: usize| views.iter().filter_map(|view| Some(view.scale?[c])).sum::<f64>();
    std::array::from_fn(|c| sum(c) / views.len().max(1) as f64)
}

enum Applied {
    Nothing,
    OwnOfView,
    Image([f64; 3]),
    Layers(LayerScales),
}

fn find_scale<V: Borrow<EvalView>>(
    count: usize,
    scaling: Scaling,
    load: &mut impl FnMut(usize) -> Result<V>,
) -> Result<Applied> {
    match scaling {
        Scaling::None => Ok(Applied::Nothing),
        Scaling::PerView => Ok(Applied::OwnOfView),
        Scaling::PerChannel => {
            let mut sums = ScaleSums::default();
            for i in 0..count {
                let view = load(i)?;
                let view = view.borrow();
                sums.add(&view.pair(&view.prediction)?);
            }
            Ok(Applied::Image(sums.scale()))
        }
        Scaling::PerLayer => {
            let mut sums = LayerScaleSums::default();
            for i in 0..count {
                let view = load(i)?;
                let view = view.borrow();
                sums.add(&view.pair(&view.diffuse)?, &view.specular)?;
            }
            Ok(Applied::Layers(sums.scales()))
        }
    }
}

fn score_view(view: &EvalView, applied: &Applied) -> Result<ViewScores> {
    let raw = view.pair(&view.prediction)?;
    let own = matches!(applied, Applied::OwnOfView).then(|| {
        let mut sums = ScaleSums::default();
        sums.add(&raw);
        sums.scale()
    });
    let scaled = match (applied, own) {
        (Applied::Layers(scales), _) => scales.combine(&view.diffuse, &view.specular),
        (&Applied::Image(scale), _) | (_, Some(scale)) => metrics::scaled(&view.prediction, scale),
        (Applied::Nothing | Applied::OwnOfView, None) => Vec::new(),
    };
    let prediction = if scaled.is_empty() { &view.prediction } else { &scaled };
    let pair = view.pair(prediction)?;
    let size = [view.width, view.height];
    Ok(ViewScores {
        name: view.name.clone(),
        psnr: metrics::psnr(&pair),
        psnr_raw: metrics::psnr(&raw),
        ssim: ssim(&pair),
        scale: own,
        srgb: view.srgb(prediction)?,
        stanford_orb: own.and_then(|_| orb_scores(size, &view.prediction, &view.truth, &view.coverage)),
    })
}

impl PassScores {
    /// The prediction of `view` with the scale of these scores, for contact sheets
    /// and error maps.
    pub fn scored_prediction(&self, view: &EvalView) -> Vec<Vec3> {
        match (self.scaling, self.scale_specular) {
            (Scaling::PerLayer, Some(specular)) => {
                LayerScales { diffuse: self.scale, specular }.combine(&view.diffuse, &view.specular)
            }
            _ => {
                let of_view = self.views.iter().find(|scores| scores.name == view.name);
                metrics::scaled(
                    &view.prediction,
                    of_view.and_then(|scores| scores.scale).unwrap_or(self.scale),
                )
            }
        }
    }

    /// "41.62 dB, SSIM 0.9871", with the unscaled PSNR where it differs: for headings of contact sheets.
    pub fn summary(&self) -> String {
        match self.scaling {
            Scaling::None => format!("{:.2} dB, SSIM {:.4}", self.psnr, self.ssim),
            _ => format!("{:.2} dB ({:.2} unscaled), SSIM {:.4}", self.psnr, self.psnr_raw, self.ssim),
        }
    }
}

impl Scores {
    /// Writes `metrics.json` (indented, keys in a fixed order).
    ///
    /// # Errors
    /// [`Error::Io`] if the file cannot be written.
    pub fn write_json(&self, path: impl AsRef<Path>) -> Result<()> {
        let path = path.as_ref();
        let mut text =
            serde_json::to_string_pretty(self).map_err(|error| Error::run("scoring", error.to_string()))?;
        text.push('\n');
        file::write_bytes(path, text.as_bytes())
    }
}

/// Largest resident memory of this process so far in MiB (`VmHWM`); `None` without `/proc`.
pub fn peak_rss_mib() -> Option<f64> {
    peak_in_status(&std::fs::read_to_string("/proc/self/status").ok()?)
}

fn peak_in_status(status: &str) -> Option<f64> {
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    let kib: f64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kib / 1024.0)
}

#[cfg(test)]
mod tests;
