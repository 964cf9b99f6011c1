//! How the passes that fit are described: `Fit` and `Shape`.

use crate::fit::cameras::CameraUnknowns;
use crate::fit::exposure::ExposureChoice;
use crate::fit::loss::Loss;
use crate::math::accurate::Quality;
use serde::{Deserialize, Serialize};

/// A fit of everything unknown to the training views.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FitPass {
    /// The pass's name. Default "fit".
    pub name: String,
    /// What is minimized over pixels and channels. Default `L1`.
    pub loss: Loss,
    /// The closed form that shades. Default `Accurate`.
    pub shading: FitShading,
    /// Nodes of `Accurate` shading: `Default` or `High`. Default `Default`.
    pub quality: Quality,
    /// Number of update steps ≥ 1. Default 800: with many more, `Published` shading fits the bias of its formulas as well.
    pub steps: u32,
    /// Most pixels that are visited ≥ 1; of more, a random part, in which each texel has its share if they are fewer than four a texel. Default 2 000 000.
    pub max_pixels: u32,
    /// Pixels per step ≥ 1; half as many before the first milestone, if no vertices move. Default 6144.
    pub batch: u32,
    /// Adam's step sizes.
    pub rates: Rates,
    /// Fractions of the fit, rising, in (0, 1), after each of which all rates are multiplied by `decay`. Default [0.5, 0.75, 0.9].
    pub milestones: Vec<f32>,
    /// Factor on the rates at a milestone, in (0, 1]. Default 0.4.
    pub decay: f32,
    /// Whether photographs have exposures of their own that are not known. Default `Auto`.
    pub exposure: ExposureChoice,
    /// Which camera parameters of the training views are refined. Default `Given`: none.
    pub cameras: CameraUnknowns,
    /// Whether the vertices of the mesh are refined: they move along their normals, which then are smooth; not if
    /// `Shape` has placed them by stereo or found their normals by reflections. They are found better by a slower fit:
    /// `steps: 1200, rates: (albedo: 0.02, light: 0.02, specular: 0.01)`. Default false.
    pub vertices: bool,
    /// Whether the texture is then made as fine as the photographs, up to 2 048 texels a side, and its albedo, sheen and tilt are solved for
    /// from all pixels. Default false.
    pub detail: bool,
}

impl Default for FitPass {
    fn default() -> Self {
        Self {
            name: "fit".into(),
            loss: Loss::L1,
            shading: FitShading::Accurate,
            quality: Quality::Default,
            steps: 800,
            max_pixels: 2_000_000,
            batch: 6144,
            rates: Rates::default(),
            milestones: vec![0.5, 0.75, 0.9],
            decay: 0.4,
            exposure: ExposureChoice::Auto,
            cameras: CameraUnknowns::Given,
            vertices: false,
            detail: false,
        }
    }
}

/// A fit of shape, light and material to the training views and their masks, on grids from coarse to fine.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ShapePass {
    /// The pass's name. Default "shape".
    pub name: String,
    /// What is minimized over pixels and channels. Default `L1`.
    pub loss: Loss,
    /// The closed form that shades. Default `Accurate`.
    pub shading: FitShading,
    /// The grids, from coarse to fine. Default: 64 cells for 300 steps, the shape held for 50; then 128 for 240; then 192 for 200, if its
    /// cells are two pixels wide.
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
    /// Rounds of averaging the shape's gradient over neighboring vertices. Default 8.
    pub blur: u32,
    /// Adam's step sizes of light and material. Default `(albedo: 0.02, light: 0.02, specular: 0.01)`: slower than a `Fit`'s, for the shape moves too.
    pub rates: Rates,
    /// Whether the mesh then moves to where neighboring photographs agree, if that says more than the shading. Default true.
    pub stereo: bool,
    /// Whether space that photographs look through, such as a cup's inside, is first removed from the hull, where no silhouette shows
    /// it. For photographs of equal exposure under a light that stands still: not with `exposure: Brightness` or `Color`, nor on a turntable. Default true.
    pub hollows: bool,
    /// Whether the part of the hull that no photograph sees, such as a cone below an object on a table, is spanned like a film of soap.
    /// Default true.
    pub spans_unseen: bool,
    /// Whether vertices get normals that explain what the surface mirrors, where those of the mesh leave much unexplained and photographs kept
    /// aside are shown clearly better: for polished metal with dents finer than the mesh. `Fit(vertices: true)` does nothing after it. Not with
    /// exposures that differ. Default true.
    pub normals: bool,
    /// Whether photographs have exposures of their own that are not known, as in [`FitPass::exposure`]. Default `Auto`.
    pub exposure: ExposureChoice,
    /// Which camera parameters of the training views are refined. Default `Given`: none.
    pub cameras: CameraUnknowns,
}

impl Default for ShapePass {
    fn default() -> Self {
        Self {
            name: "shape".into(),
            loss: Loss::L1,
            shading: FitShading::Accurate,
            levels: vec![
                GridLevel { cells: 64, hold: 50, steps: 300, rates: (0.05, 0.01), ..GridLevel::default() },
                GridLevel { texel_cells: 96, steps: 240, rates: (0.08, 0.003), ..GridLevel::default() },
                GridLevel { cells: 192, texel_cells: 128, steps: 200, pixels: 2.0, ..GridLevel::default() },
            ],
            batch: 8192,
            max_pixels: 2_000_000,
            silhouette_batch: 2048,
            silhouette: 0.3,
            smoothness: 1e-6,
            blur: 8,
            rates: Rates { albedo: 0.02, light: 0.02, specular: 0.01 },
            stereo: true,
            hollows: true,
            spans_unseen: true,
            normals: true,
            exposure: ExposureChoice::Auto,
            cameras: CameraUnknowns::Given,
        }
    }
}

/// One grid of a [`ShapePass`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct GridLevel {
    /// Cells a side of the grid of distances, 16 to 512. Default 128.
    pub cells: u32,
    /// Cells a side of the lattice of albedo, 8 to 512. Default 64.
    pub texel_cells: u32,
    /// Number of update steps ≥ 1. Default 400.
    pub steps: u32,
    /// Steps before the shape moves, while light and material find themselves. Default 0.
    pub hold: u32,
    /// Typical step of a distance at the first and the last step, in cells. Default (0.05, 0.002).
    pub rates: (f32, f32),
    /// Pixels that a cell is wide in a typical photograph, below which the fit ends with the level before ≥ 0; the first level is
    /// always fitted. Default 0.
    pub pixels: f32,
}

impl Default for GridLevel {
    fn default() -> Self {
        Self { cells: 128, texel_cells: 64, steps: 400, hold: 0, rates: (0.05, 0.002), pixels: 0.0 }
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
    /// Diffuse albedo of the texels, and how base materials blend there. Default 0.03.
    pub albedo: f32,
    /// Axes, sharpness and amplitudes of the light lobes. Default 0.1.
    pub light: f32,
    /// Specular albedo and roughness. Default 0.02.
    pub specular: f32,
}

impl Default for Rates {
    fn default() -> Self {
        Self { albedo: 0.03, light: 0.1, specular: 0.02 }
    }
}
