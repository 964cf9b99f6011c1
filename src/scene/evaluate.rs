//! How the pass that scores others is described: `Evaluate`.

use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Scores earlier passes against the truth.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct EvaluatePass {
    /// The pass's name. Default "scores".
    pub name: String,
    /// The passes to score.
    pub scores: Vec<Score>,
    /// True diffuse albedo of the test views (`albedo_<number>.exr`). Default: not scored.
    pub albedo: Option<LayerTruth>,
    /// True world normals of the test views: `normal_<number>.exr`, or `<view>_normal.png` as beside the photographs of NeRF's
    /// synthetic sets. Such a PNG holds max(0, n) per component, encoded as sRGB, and only normals whose three components are positive
    /// are known and scored; maps that hold (n + 1)/2 cannot be told from it: name them with `Files`. Default: not scored.
    pub normal: Option<LayerTruth>,
    /// The true surface, a `.glb` or `.gltf` in the coordinates of the cameras; must exist. The Chamfer distance to it is scored, in
    /// the data's own unit. Default: not scored.
    pub mesh: Option<PathBuf>,
}

impl Default for EvaluatePass {
    fn default() -> Self {
        Self { name: "scores".into(), scores: Vec::new(), albedo: None, normal: None, mesh: None }
    }
}

/// One pass to score.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Score {
    /// The name of an earlier `Render`, `Edit` or `Relight` pass.
    pub pass: String,
    /// What its images should be.
    pub truth: Truth,
    /// Scales that are fitted before scoring, because light and albedo are known only up to one per channel. Default `None`.
    #[serde(default)]
    pub scale: ScoreScale,
}

/// What a pass's images should be.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum Truth {
    /// The views' own photographs.
    Photographs,
    /// Images in a folder, with the views' names; must exist. `Folder("$DATA/test/gt/edit_gold")`.
    Folder(PathBuf),
    /// An image for each view: `Files(folder: "$DATA", file: "{view}/rgba_city.png")`, as beside the photographs of TensoIR-Synthetic.
    Files {
        /// Where the files lie; must exist.
        folder: PathBuf,
        /// Path of each from there, with `{view}` for the name of its view.
        file: String,
    },
    /// The true object of `Photographed` views under the pass's own edits and light, path traced.
    SelfMade {
        /// Paths per pixel, 1 to 65536. Default 256.
        #[serde(default = "truth_spp")]
        spp: u32,
    },
}

/// What a layer's images should be.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum LayerTruth {
    /// Images in a folder; must exist.
    Folder(PathBuf),
    /// An image for each view: `Files(folder: "$DATA", file: "{view}/normal.png")`. EXR: the values; PNG and others: albedo as it is, not encoded as
    /// sRGB, and normals as (n + 1)/2, as NeRFactor and TensoIR-Synthetic have them.
    Files {
        /// Where the files lie; must exist.
        folder: PathBuf,
        /// Path of each from there, with `{view}` for the name of its view.
        file: String,
    },
    /// From the true object of `Photographed` views.
    SelfMade,
}

/// What stands for the name of a view in the path of a file.
pub const VIEW: &str = "{view}";

impl Truth {
    /// The folder of its files, and the path of each from there if the scene says it.
    pub fn files(&self) -> Option<(&PathBuf, Option<&str>)> {
        match self {
            Self::Folder(folder) => Some((folder, None)),
            Self::Files { folder, file } => Some((folder, Some(file))),
            Self::Photographs | Self::SelfMade { .. } => None,
        }
    }
}

impl LayerTruth {
    /// The folder of its files, and the path of each from there if the scene says it.
    pub fn files(&self) -> Option<(&PathBuf, Option<&str>)> {
        match self {
            Self::Folder(folder) => Some((folder, None)),
            Self::Files { folder, file } => Some((folder, Some(file))),
            Self::SelfMade => None,
        }
    }
}

/// The least-squares scales that are taken out before scoring.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum ScoreScale {
    /// None.
    #[default]
    None,
    /// One per channel, shared by all views.
    PerChannel,
    /// One per channel and view, as Stanford-ORB has it; `metrics.json` and the terminal then have its PSNR-H and PSNR-L, too.
    PerView,
    /// One per channel for the diffuse layer and one for the specular layer, shared by all views.
    PerLayer,
}

fn truth_spp() -> u32 {
    256
}
