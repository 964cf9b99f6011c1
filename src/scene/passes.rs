//! What a scene file's `passes` list can say.

pub use crate::fit::cameras::CameraUnknowns;
pub use crate::fit::loss::Loss;
use crate::scene::description::LightSource;
pub use crate::scene::output::{ExportPass, MeshFormat, SavePass};
pub use crate::scene::render::{Orbit, OrbitFormat, Quality, RenderSettings, Shading, Tone, ViewChoice};
use glam::Vec3;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// One step of the work. A pass writes into `OUT/<name>/`; names are unique and match `[A-Za-z0-9_-]+`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Pass {
    /// Finds what the scene says is unknown, from the training views.
    Fit(FitPass),
    /// Finds the shape of a surface that is unknown, with light and material beside it.
    Shape(ShapePass),
    /// Renders the object as it is.
    Render(RenderPass),
    /// Renders the object with a changed material; later passes see the unchanged one.
    Edit(EditPass),
    /// Renders the object under another light; later passes see the unchanged one.
    Relight(RelightPass),
    /// Scores earlier passes against the truth.
    Evaluate(EvaluatePass),
    /// Writes the object as a scene file with side files, which renders the same bits again.
    Save(SavePass),
    /// Writes the object as a mesh for other programs.
    Export(ExportPass),
}

impl Pass {
    /// The pass's name: its folder under `OUT`.
    pub fn name(&self) -> &str {
        match self {
            Self::Fit(pass) => &pass.name,
            Self::Shape(pass) => &pass.name,
            Self::Render(pass) => &pass.name,
            Self::Edit(pass) => &pass.name,
            Self::Relight(pass) => &pass.name,
            Self::Evaluate(pass) => &pass.name,
            Self::Save(pass) => &pass.name,
            Self::Export(pass) => &pass.name,
        }
    }

    /// The light that the pass brings, if it does.
    pub fn light(&self) -> Option<&LightSource> {
        match self {
            Self::Edit(pass) => pass.light.as_ref(),
            Self::Relight(pass) => Some(&pass.light),
            Self::Fit(_)
            | Self::Shape(_)
            | Self::Render(_)
            | Self::Evaluate(_)
            | Self::Save(_)
            | Self::Export(_) => None,
        }
    }

    /// The edits that the pass makes before it renders.
    pub fn edits(&self) -> &[Edit] {
        match self {
            Self::Edit(pass) => &pass.edits,
            Self::Relight(pass) => &pass.edits,
            Self::Fit(_)
            | Self::Shape(_)
            | Self::Render(_)
            | Self::Evaluate(_)
            | Self::Save(_)
            | Self::Export(_) => &[],
        }
    }

    /// How the pass renders, if it renders.
    pub fn render(&self) -> Option<&RenderSettings> {
        match self {
            Self::Render(pass) => Some(&pass.render),
            Self::Edit(pass) => Some(&pass.render),
            Self::Relight(pass) => Some(&pass.render),
            Self::Fit(_) | Self::Shape(_) | Self::Evaluate(_) | Self::Save(_) | Self::Export(_) => None,
        }
    }
}

/// A fit of everything unknown to the training views.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FitPass {
    /// The pass's name. Default "fit".
    pub name: String,
    /// What is minimised over pixels and channels. Default `L1`.
    pub loss: Loss,
    /// The closed form that shades. Default `Accurate`.
    pub shading: FitShading,
    /// Nodes of `Accurate` shading: `Default` or `High`. Default `Default`.
    pub quality: Quality,
    /// Number of update steps ≥ 1. Default 1200: much longer, and the bias of the published formulas is fitted too.
    pub steps: u32,
    /// Most pixels that are visited ≥ 1; a random part of more. Default 2 000 000.
    pub max_pixels: u32,
    /// Pixels per step ≥ 1. Default 6144.
    pub batch: u32,
    /// Adam's step sizes.
    pub rates: Rates,
    /// Fractions of the fit, rising, in (0, 1), after each of which all rates are multiplied by `decay`. Default [0.5, 0.75, 0.9].
    pub milestones: Vec<f32>,
    /// Factor on the rates at a milestone, in (0, 1]. Default 0.4.
    pub decay: f32,
    /// Whether each photograph has an exposure of its own that is not known: a factor on its radiance, 0.2 to 5, their
    /// geometric mean 1. Views are rendered without. Default false.
    pub exposure: bool,
    /// What of the training views' cameras is a little off and found too. Default `Given`: nothing.
    pub cameras: CameraUnknowns,
    /// Whether the mesh is a little off and its vertices move along their normals, which then are smooth. Default false.
    pub vertices: bool,
}

impl Default for FitPass {
    fn default() -> Self {
        Self {
            name: "fit".into(),
            loss: Loss::L1,
            shading: FitShading::Accurate,
            quality: Quality::Default,
            steps: 1200,
            max_pixels: 2_000_000,
            batch: 6144,
            rates: Rates::default(),
            milestones: vec![0.5, 0.75, 0.9],
            decay: 0.4,
            exposure: false,
            cameras: CameraUnknowns::Given,
            vertices: false,
        }
    }
}

/// A fit of shape, light and material to the training views and their masks, on grids from coarse to fine.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ShapePass {
    /// The pass's name. Default "shape".
    pub name: String,
    /// What is minimised over pixels and channels. Default `L1`.
    pub loss: Loss,
    /// The closed form that shades. Default `Accurate`.
    pub shading: FitShading,
    /// The grids, from coarse to fine. Default: 64 cells for 300 steps, the shape held for 50; then 128 for 400.
    pub levels: Vec<GridLevel>,
    /// Pixels per step ≥ 1. Default 8192.
    pub batch: u32,
    /// Most pixels that are visited ≥ 1; a random part of more. Default 2 000 000.
    pub max_pixels: u32,
    /// Silhouette rays per step ≥ 1. Default 2048.
    pub silhouette_batch: u32,
    /// Weight of the silhouettes beside the images ≥ 0. Default 0.3.
    pub silhouette: f32,
    /// Weight of the field's smoothness ≥ 0 at the end of each level, relaxed from ten times that. Default 1e-6.
    pub smoothness: f32,
    /// Rounds of averaging the shape's gradient over neighbouring vertices. Default 8.
    pub blur: u32,
    /// Adam's step sizes of light and material.
    pub rates: Rates,
    /// Whether each photograph has an exposure of its own that is not known, as in [`FitPass::exposure`]. Default false.
    pub exposure: bool,
    /// What of the training views' cameras is a little off and found too. Default `Given`: nothing.
    pub cameras: CameraUnknowns,
}

/// One grid of a [`ShapePass`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct GridLevel {
    /// Cells a side of the grid of distances, 16 to 320. Default 128.
    pub cells: u32,
    /// Cells a side of the lattice of albedo, 8 to 320. Default 64.
    pub texel_cells: u32,
    /// Number of update steps ≥ 1. Default 400.
    pub steps: u32,
    /// Steps before the shape moves, while light and material find themselves. Default 0.
    pub hold: u32,
    /// Typical step of a distance at the first and the last step, in cells. Default (0.05, 0.002).
    pub rates: (f32, f32),
}

impl Default for GridLevel {
    fn default() -> Self {
        Self { cells: 128, texel_cells: 64, steps: 400, hold: 0, rates: (0.05, 0.002) }
    }
}

impl Default for ShapePass {
    fn default() -> Self {
        Self {
            name: "shape".into(),
            loss: Loss::L1,
            shading: FitShading::Accurate,
            levels: vec![
                GridLevel { cells: 64, hold: 50, steps: 300, rates: (0.05, 0.01), ..GridLevel::default() },
                GridLevel { texel_cells: 96, ..GridLevel::default() },
            ],
            batch: 8192,
            max_pixels: 2_000_000,
            silhouette_batch: 2048,
            silhouette: 0.3,
            smoothness: 1e-6,
            blur: 8,
            rates: Rates::default(),
            exposure: false,
            cameras: CameraUnknowns::Given,
        }
    }
}

/// The closed forms that a fit can shade by.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum FitShading {
    /// Accurate integrals of light SG × BRDF × cosine.
    #[default]
    Accurate,
    /// PhySG's published approximation of them.
    Published,
}

/// Adam's step size for each block of parameters, in the unconstrained parameter's unit; 0 leaves a block as it is.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Rates {
    /// Diffuse albedo of the texels, and how base materials blend there. Default 0.02.
    pub albedo: f32,
    /// Axes, sharpness and amplitudes of the light lobes. Default 0.02.
    pub light: f32,
    /// Specular albedo and roughness. Default 0.01.
    pub specular: f32,
}

impl Default for Rates {
    fn default() -> Self {
        Self { albedo: 0.02, light: 0.02, specular: 0.01 }
    }
}

/// Renders the object as it is.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RenderPass {
    /// The pass's name.
    pub name: String,
    /// Which pictures, and how.
    #[serde(default)]
    pub render: RenderSettings,
}

/// Renders the object with a changed material, and optionally another light.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EditPass {
    /// The pass's name.
    pub name: String,
    /// The edits, in order.
    pub edits: Vec<Edit>,
    /// The light; by default the scene's own.
    #[serde(default)]
    pub light: Option<LightSource>,
    /// Which pictures, and how.
    #[serde(default)]
    pub render: RenderSettings,
}

/// Renders the object under another light, and optionally with a changed material.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RelightPass {
    /// The pass's name.
    pub name: String,
    /// The light.
    pub light: LightSource,
    /// Edits of the material, in order. Default [].
    #[serde(default)]
    pub edits: Vec<Edit>,
    /// Which pictures, and how.
    #[serde(default)]
    pub render: RenderSettings,
}

/// One change of the material: `Diffuse(action: Set(0.8, 0.1, 0.1), region: Sphere(center: (0, 0.5, 0), radius: 0.3))`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum Edit {
    /// Changes the diffuse albedo.
    Diffuse {
        /// What is done to it.
        action: DiffuseAction,
        /// Where. Default `All`.
        #[serde(default)]
        region: Region,
    },
    /// Changes the specular albedo.
    Specular {
        /// What is done to it.
        action: ColorAction,
        /// Where. Default `All`.
        #[serde(default)]
        region: Region,
    },
    /// Changes the roughness.
    Roughness {
        /// What is done to it.
        action: ScalarAction,
        /// Where. Default `All`.
        #[serde(default)]
        region: Region,
    },
}

impl Edit {
    /// Where the edit applies.
    pub fn region(&self) -> &Region {
        match self {
            Self::Diffuse { region, .. } | Self::Specular { region, .. } | Self::Roughness { region, .. } => {
                region
            }
        }
    }
}

/// What is done to the diffuse albedo; results are clamped to [0, 1].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum DiffuseAction {
    /// Replaces it: `Set(0.8, 0.1, 0.1)`, in [0, 1].
    Set(Vec3),
    /// Multiplies it: `Scale(1.2, 1, 1)`, ≥ 0.
    Scale(Vec3),
    /// Moves it towards a colour: old + weight (color − old).
    Blend {
        /// The colour, in [0, 1].
        color: Vec3,
        /// In [0, 1].
        weight: f32,
    },
    /// Replaces it by an image in texture space: PNG (sRGB) or EXR (linear); must exist. `Texture("paint.png")`.
    Texture(PathBuf),
}

/// What is done to a colour; results are clamped to [0, 1].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum ColorAction {
    /// Replaces it: `Set(0.9, 0.65, 0.3)`, in [0, 1].
    Set(Vec3),
    /// Multiplies it: `Scale(1.2, 1, 1)`, ≥ 0.
    Scale(Vec3),
    /// Moves it towards a colour: old + weight (color − old).
    Blend {
        /// The colour, in [0, 1].
        color: Vec3,
        /// In [0, 1].
        weight: f32,
    },
}

/// What is done to the roughness; results are clamped to [0.03, 1].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum ScalarAction {
    /// Replaces it: `Set(0.15)`, in [0.03, 1].
    Set(f32),
    /// Multiplies it: `Scale(0.5)`, ≥ 0.
    Scale(f32),
    /// Moves it towards a value: old + weight (value − old).
    Blend {
        /// The value, in [0.03, 1].
        value: f32,
        /// In [0, 1].
        weight: f32,
    },
}

/// Where an edit applies.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum Region {
    /// The whole object.
    #[default]
    All,
    /// Inside an axis-aligned box in world space.
    Box {
        /// Least corner.
        min: Vec3,
        /// Greatest corner; no coordinate below `min`'s.
        max: Vec3,
        /// Distance inside the walls over which the edit sets in, world units ≥ 0. Default 0: a hard edge.
        #[serde(default)]
        falloff: f32,
    },
    /// Inside a ball in world space.
    Sphere {
        /// Centre.
        center: Vec3,
        /// Radius > 0.
        radius: f32,
        /// Distance inside the ball over which the edit sets in, world units ≥ 0. Default 0: a hard edge.
        #[serde(default)]
        falloff: f32,
    },
    /// Where an image in texture space is bright (0: not at all, 1: fully); must exist. `Mask("belly.png")`.
    Mask(PathBuf),
}

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
    /// True world normals of the test views (`normal_<number>.exr`). Default: not scored.
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
    pub scale: ScaleRule,
}

/// What a pass's images should be.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum Truth {
    /// The views' own photographs.
    Photographs,
    /// Images in a folder, with the views' names; must exist. `Folder("$DATA/test/gt/edit_gold")`.
    Folder(PathBuf),
    /// The true object of `Photographed` views under the pass's own edits and light, path traced.
    SelfMade {
        /// Paths per pixel, 1 to 65536. Default 256.
        #[serde(default = "truth_spp")]
        spp: u32,
    },
}

/// What a layer's images should be.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum LayerTruth {
    /// Images in a folder; must exist.
    Folder(PathBuf),
    /// From the true object of `Photographed` views.
    SelfMade,
}

/// The least-squares scales that are taken out before scoring.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum ScaleRule {
    /// None.
    #[default]
    None,
    /// One per channel, shared by all views.
    PerChannel,
    /// One per channel for the diffuse layer and one for the specular layer, shared by all views.
    PerLayer,
}

fn truth_spp() -> u32 {
    256
}
