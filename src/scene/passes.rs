//! Entries of a scene file's `passes` list.

use crate::scene::{Edit, LightSource, RenderSettings, number};
use lobelia_sg::accurate::Quality;
use lobelia_solve::fit::{cameras::CameraUnknowns, exposure::ExposureChoice, loss::Loss};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// One step of the work. A pass writes into `OUT/<name>/`; names are unique and match
/// `[A-Za-z0-9_-]+`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Pass {
    /// Finds what the scene says is unknown, from the training views.
    Fit(FitPass),
    /// Finds the shape of a surface that is unknown, with light and material beside it.
    Shape(ShapePass),
    /// Renders the object as it is.
    Render(RenderPass),
    /// Renders the object with a changed material; later passes see the unchanged one.
    Edit(RenderPass),
    /// Renders the object under another light; later passes see the unchanged one.
    Relight(RenderPass),
    /// Scores earlier passes against the truth.
    Evaluate(EvaluatePass),
    /// Writes the object as a scene file with side files, which renders the same bits again.
    Save(SavePass),
    /// Writes the object as a mesh for other programs.
    Export(ExportPass),
    /// Writes a page that shows the object in a browser.
    View(ViewPass),
}

impl Pass {
    /// The pass's name: its folder under `OUT`.
    pub fn name(&self) -> &str {
        match self {
            Self::Fit(pass) => &pass.name,
            Self::Shape(pass) => &pass.name,
            Self::Render(pass) | Self::Edit(pass) | Self::Relight(pass) => &pass.name,
            Self::Evaluate(pass) => &pass.name,
            Self::Save(pass) => &pass.name,
            Self::Export(pass) => &pass.name,
            Self::View(pass) => &pass.name,
        }
    }

    fn rendered(&self) -> Option<&RenderPass> {
        match self {
            Self::Render(pass) | Self::Edit(pass) | Self::Relight(pass) => Some(pass),
            _ => None,
        }
    }

    /// The light that the pass brings, if it does.
    pub fn light(&self) -> Option<&LightSource> {
        self.rendered()?.light.as_ref()
    }

    /// The edits that the pass makes before it renders.
    pub fn edits(&self) -> &[Edit] {
        self.rendered().map_or(&[], |pass| &pass.edits)
    }

    /// How the pass renders, if it renders.
    pub fn render(&self) -> Option<&RenderSettings> {
        Some(&self.rendered()?.render)
    }
}

/// Renders the object: as it is, with a changed material (`Edit`), or under another light
/// (`Relight`).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RenderPass {
    /// The pass's name.
    pub name: String,
    /// Edits of the material, in order: at least one of an `Edit`, none of a `Render`. Default [].
    #[serde(default)]
    pub edits: Vec<Edit>,
    /// The light, which a `Relight` must have and a `Render` cannot. Default: the scene's own.
    #[serde(default)]
    pub light: Option<LightSource>,
    /// Which pictures, and how.
    #[serde(default)]
    pub render: RenderSettings,
}

/// A fit of everything unknown to the training views.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FitPass {
    /// The pass's name. Default "fit".
    pub name: String,
    /// Loss minimized over pixels and channels. Default `L1`.
    pub loss: Loss,
    /// The closed form that shades. Default `Accurate`.
    pub shading: FitShading,
    /// Nodes of `Accurate` shading: `Default` or `High`. Default `Default`.
    pub quality: Quality,
    /// Number of update steps ≥ 1. Default 800: with many more, `Published` shading fits the bias
    /// of its formulas as well.
    pub steps: u32,
    /// Most pixels that are visited ≥ 1; of more, a random part, in which each texel has its share
    /// if they are fewer than four a texel. Default 2 000 000.
    pub max_pixels: u32,
    /// Pixels per step ≥ 1; half as many before the first milestone, if no vertices move. Default
    /// 6144.
    pub batch: u32,
    /// Adam's step sizes.
    pub rates: Rates,
    /// Fractions of the fit, rising, in (0, 1), after each of which all rates are multiplied by
    /// `decay`. Default [0.5, 0.75, 0.9].
    pub milestones: Vec<f32>,
    /// Factor on the rates at a milestone, in (0, 1]. Default 0.4.
    pub decay: f32,
    /// Whether photographs have exposures of their own that are not known. Default `Auto`.
    pub exposure: ExposureChoice,
    /// Which camera parameters of the training views are refined. Default `Given`: none.
    pub cameras: CameraUnknowns,
    /// Whether the vertices of the mesh are refined: they move along their normals, which then are
    /// smooth; not if `Shape` has placed them by stereo or found their normals by reflections. They
    /// are found better by a slower fit:
    /// `steps: 1200, rates: (albedo: 0.02, light: 0.02, specular: 0.01)`. Default false.
    pub vertices: bool,
    /// Whether the texture is then made as fine as the photographs, up to 2 048 texels a side, and
    /// its albedo, sheen and tilt are solved for from all pixels. Default false.
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

/// A fit of shape, light and material to the training views and their masks, on grids from coarse
/// to fine.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ShapePass {
    /// The pass's name. Default "shape".
    pub name: String,
    /// Loss minimized over pixels and channels. Default `L1`.
    pub loss: Loss,
    /// The closed form that shades. Default `Accurate`.
    pub shading: FitShading,
    /// The grids, from coarse to fine. Default: 64 cells for 300 steps, the shape held for 50; then
    /// 128 for 240; then 192 for 200, if its cells are two pixels wide.
    pub levels: Vec<GridLevel>,
    /// Pixels per step ≥ 1. Default 8192.
    pub batch: u32,
    /// Most pixels that are visited ≥ 1; a random part of more. Default 2 000 000.
    pub max_pixels: u32,
    /// Silhouette rays per step ≥ 1. Default 2048.
    pub silhouette_batch: u32,
    /// Weight of the silhouettes beside the images ≥ 0. Default 0.3.
    pub silhouette: f32,
    /// Weight of the field's smoothness ≥ 0 at the end of each level, relaxed from ten times that.
    /// Default 1e-6.
    pub smoothness: f32,
    /// Rounds of averaging the shape's gradient over neighboring vertices. Default 8.
    pub blur: u32,
    /// Adam's step sizes of light and material. Default
    /// `(albedo: 0.02, light: 0.02, specular: 0.01)`: slower than a `Fit`'s, for the shape moves
    /// too.
    pub rates: Rates,
    /// Whether the mesh then moves to where neighboring photographs agree, if that says more than
    /// the shading. Default true.
    pub stereo: bool,
    /// Whether space that photographs look through, such as a cup's inside, is first removed from
    /// the hull, where no silhouette shows it. For photographs of equal exposure under a light that
    /// stands still: not with `exposure: Brightness` or `Color`, nor on a turntable. Default true.
    pub hollows: bool,
    /// Whether the part of the hull that no photograph sees, such as a cone below an object on a
    /// table, is spanned like a film of soap. Default true.
    pub spans_unseen: bool,
    /// Whether vertices get normals that explain what the surface mirrors, where those of the mesh
    /// leave much unexplained and photographs kept aside are shown clearly better: for polished
    /// metal with dents finer than the mesh. `Fit(vertices: true)` does nothing after it. Not with
    /// exposures that differ. Default true.
    pub normals: bool,
    /// Whether photographs have exposures of their own that are not known, as in
    /// [`FitPass::exposure`]. Default `Auto`.
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
    /// Pixels that a cell is wide in a typical photograph, below which the fit ends with the level
    /// before ≥ 0; the first level is always fitted. Default 0.
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

/// Adam's step size for each block of parameters, in the unconstrained parameter's unit; 0 leaves a
/// block as it is.
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
    /// True world normals of the test views: `normal_<number>.exr`, or `<view>_normal.png` as
    /// beside the photographs of NeRF's synthetic sets. Such a PNG holds max(0, n) per component,
    /// encoded as sRGB, and only normals whose three components are positive are known and scored;
    /// maps that hold (n + 1)/2 cannot be told from it: name them with `Files`. Default: not
    /// scored.
    pub normal: Option<LayerTruth>,
    /// The true surface, a `.glb` or `.gltf` in the coordinates of the cameras; must exist. The
    /// Chamfer distance to it is scored, in the data's own unit. Default: not scored.
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
    /// Reference for its images.
    pub truth: Truth,
    /// Scales that are fitted before scoring, because light and albedo are known only up to one per
    /// channel. Default `None`.
    #[serde(default)]
    pub scale: ScoreScale,
}

/// Reference for a pass's images.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum Truth {
    /// The views' own photographs.
    Photographs,
    /// Images in a folder, with the views' names; must exist. `Folder("$DATA/test/gt/edit_gold")`.
    Folder(PathBuf),
    /// An image for each view: `Files(folder: "$DATA", file: "{view}/rgba_city.png")`, as beside
    /// the photographs of TensoIR-Synthetic.
    Files {
        /// Where the files lie; must exist.
        folder: PathBuf,
        /// Path of each from there, with `{view}` for the name of its view.
        file: String,
    },
    /// The true object of `Photographed` views under the pass's own edits and light, path traced.
    SelfMade {
        /// Paths per pixel, 1 to 65536. Default 256.
        #[serde(default = "number::<256>")]
        spp: u32,
    },
}

/// Reference for a layer's images.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum LayerTruth {
    /// Images in a folder; must exist.
    Folder(PathBuf),
    /// An image for each view: `Files(folder: "$DATA", file: "{view}/normal.png")`. EXR: the
    /// values; PNG and others: albedo as it is, not encoded as sRGB, and normals as (n + 1)/2, as
    /// NeRFactor and TensoIR-Synthetic have them.
    Files {
        /// Where the files lie; must exist.
        folder: PathBuf,
        /// Path of each from there, with `{view}` for the name of its view.
        file: String,
    },
    /// From the true object of `Photographed` views.
    SelfMade,
}

/// Placeholder for the name of a view in the path of a file.
pub const VIEW: &str = "{view}";

/// Where the ground truth of each view is: in a folder, by a path from there with [`VIEW`] for its
/// name, or as files of a folder are usually called.
#[derive(Clone, Copy, Debug)]
pub struct TruthFiles<'a> {
    /// The folder.
    pub folder: &'a Path,
    /// The path of each from there, if the scene says it.
    pub file: Option<&'a str>,
}

impl Truth {
    /// Its files, if it has some.
    pub fn files(&self) -> Option<TruthFiles<'_>> {
        match self {
            Self::Folder(folder) => Some(TruthFiles { folder, file: None }),
            Self::Files { folder, file } => Some(TruthFiles { folder, file: Some(file) }),
            Self::Photographs | Self::SelfMade { .. } => None,
        }
    }
}

impl LayerTruth {
    /// Its files, if it has some.
    pub fn files(&self) -> Option<TruthFiles<'_>> {
        match self {
            Self::Folder(folder) => Some(TruthFiles { folder, file: None }),
            Self::Files { folder, file } => Some(TruthFiles { folder, file: Some(file) }),
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
    /// One per channel and view, as Stanford-ORB has it; `metrics.json` and the terminal then have
    /// its PSNR-H and PSNR-L, too.
    PerView,
    /// One per channel for the diffuse layer and one for the specular layer, shared by all views.
    PerLayer,
}

/// Writes the object as a scene file with side files.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SavePass {
    /// The pass's name. Default "saved".
    pub name: String,
    /// The `Edit` or `Relight` pass whose edited material and light are saved. Default: the
    /// material and light that were found.
    pub of: Option<String>,
}

impl Default for SavePass {
    fn default() -> Self {
        Self { name: "saved".into(), of: None }
    }
}

/// Writes the object as a mesh for other programs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ExportPass {
    /// The pass's name. Default "export".
    pub name: String,
    /// The `Edit` or `Relight` pass whose edited material is exported. Default: the material that
    /// was found.
    pub of: Option<String>,
    /// The files to write, at least one. Default `[Glb]`.
    pub formats: Vec<MeshFormat>,
    /// Write about this many triangles ≥ 4 instead of all, closed where the surface is, with new
    /// texture coordinates and the albedo carried over. Sharp edges become smoothly shaded.
    /// Default: all triangles, as they are.
    pub triangles: Option<u32>,
    /// Which way is up in the files; the light is turned with the object. Default `Data`.
    pub up: ExportUp,
    /// Put the middle of the object's box at the origin. Default false.
    pub center: bool,
    /// Size of the object in the files. Default `Factor(1)`.
    pub scale: ExportScale,
}

/// Which axis of an exported object is up. In the data, that is the scene's `up`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum ExportUp {
    /// The axes of the data.
    #[default]
    Data,
    /// +Y, as glTF has it.
    Y,
    /// +Z, for programs that take coordinates as they are and have +Z up.
    Z,
}

/// How large an exported object is.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum ExportScale {
    /// Lengths of the data times this, > 0. glTF counts in meters.
    Factor(f32),
    /// The longest side of the object's box is this long, > 0.
    Size(f32),
}

impl Default for ExportPass {
    fn default() -> Self {
        Self {
            name: "export".into(),
            of: None,
            formats: vec![MeshFormat::Glb],
            triangles: None,
            up: ExportUp::Data,
            center: false,
            scale: ExportScale::Factor(1.0),
        }
    }
}

/// Writes a page, `view.html`, that shows the object in a browser: to be turned, relit and edited,
/// with nothing else needed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ViewPass {
    /// The pass's name. Default "view".
    pub name: String,
    /// The `Edit` or `Relight` pass whose edited material and light the page begins with. Default:
    /// the material and light that were found.
    pub of: Option<String>,
    /// Most photographs in the page, to be laid over its own picture under a wipe: test views, then
    /// training views, evenly chosen and made small; 0: none. Default 24.
    pub photographs: u32,
}

impl Default for ViewPass {
    fn default() -> Self {
        Self { name: "view".into(), of: None, photographs: 24 }
    }
}

/// A file that a mesh is written to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum MeshFormat {
    /// `mesh.glb`: binary glTF with textures, roughness and reflectance; the light as `light.hdr`
    /// and `light_blender.hdr`; and a page for browsers, `model-viewer.html`.
    Glb,
    /// `mesh.usda`: USD as text, with textures and the light beside it.
    Usda,
    /// `mesh.usdz`: USD with its textures in one file; the light lies beside it.
    Usdz,
}
