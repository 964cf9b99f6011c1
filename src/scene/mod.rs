//! The scene file: its RON description, where each value stands in the text, and reading it with good errors.
//!
//! A scene file is RON with the extensions `implicit_some` (an optional value is written without `Some`) and
//! `unwrap_variant_newtypes` (`Fit(name: "fit")`, `Constant(0.5, 0.5, 0.5)`) always on. Every field is
//! documented, with unit, range and default, on the types below [`Scene`].
//!
//! The enums here are exhaustive on purpose: a pass or a choice that is added fails to compile wherever it is not handled yet. Most of
//! those of other modules are `#[non_exhaustive]` and may grow.
//!
//! Nothing here makes a world or runs a pass: that is for [`spawn`](crate::spawn) and [`pass`](crate::pass).

mod defaults;
mod description;
pub mod diagnostic;
mod edit;
mod evaluate;
pub mod fields;
mod film;
mod fit;
mod light;
pub mod load;
mod material;
mod output;
mod passes;
pub mod paths;
mod photographed;
mod render;
pub mod ron_tree;
pub mod source;
mod surface;
pub mod validate;
mod views;
mod visibility;

pub use description::{Scene, VERSION};
pub use edit::{ColorAction, DiffuseAction, Edit, Region, ScalarAction};
pub use evaluate::{EvaluatePass, LayerTruth, Score, ScoreScale, Truth, VIEW};
pub use film::{Easing, LightSweep, MaterialSweep, OrbitKey};
pub use fit::{FitPass, FitShading, GridLevel, Rates, ShapePass};
pub use light::{Light, LightFrameChoice, LightSource, UnknownLight};
pub use load::{LoadOptions, LoadedScene, load, to_ron};
pub use material::{
    Albedo, AlbedoSource, Gloss, Material, NdfChoice, Roughness, Sheen, Specular, SpecularAlbedo, Tilt,
};
pub use output::{ExportPass, ExportScale, ExportUp, MeshFormat, SavePass, ViewPass};
pub use passes::{EditPass, Pass, RelightPass, RenderPass};
pub use photographed::{CameraRing, Pattern, Photographed, TruthObject};
pub use render::{Orbit, OrbitFormat, RenderSettings, Shading, ViewChoice};
pub use surface::Surface;
pub use validate::passes::unknown_parts;
pub(crate) use validate::passes::uses_published;
pub use views::{CameraSpec, Dataset, PlacementLight, PlacementSpec, Views};
pub use visibility::Visibility;
