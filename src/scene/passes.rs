//! What a scene file's `passes` list can say, and the passes that render the object as it is, edited or relit.

use crate::scene::edit::Edit;
use crate::scene::evaluate::EvaluatePass;
use crate::scene::fit::{FitPass, ShapePass};
use crate::scene::light::LightSource;
use crate::scene::output::{ExportPass, SavePass, ViewPass};
use crate::scene::render::RenderSettings;
use serde::{Deserialize, Serialize};

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
    /// Writes a page that shows the object in a browser.
    View(ViewPass),
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
            Self::View(pass) => &pass.name,
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
            | Self::Export(_)
            | Self::View(_) => None,
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
            | Self::Export(_)
            | Self::View(_) => &[],
        }
    }

    /// How the pass renders, if it renders.
    pub fn render(&self) -> Option<&RenderSettings> {
        match self {
            Self::Render(pass) => Some(&pass.render),
            Self::Edit(pass) => Some(&pass.render),
            Self::Relight(pass) => Some(&pass.render),
            Self::Fit(_)
            | Self::Shape(_)
            | Self::Evaluate(_)
            | Self::Save(_)
            | Self::Export(_)
            | Self::View(_) => None,
        }
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
