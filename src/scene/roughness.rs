//! What a scene file says about gloss that varies over the surface.

use crate::material::SpecularLobe;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// How gloss varies over the surface.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum Gloss {
    /// One: the lobe in `specular` everywhere.
    #[default]
    One,
    /// Several, which start from the lobe in `specular` with roughnesses spread around its own; a fit finds them, and for each
    /// texel how they blend.
    Blend {
        /// Base materials, 2 to 4. Default 2.
        #[serde(default = "base_materials")]
        materials: u32,
    },
    /// A roughness for each texel, in [0.1, 0.76], tied to its neighbours by a prior; the specular albedo in `specular` is one for all.
    /// Not together with a `Shape` pass.
    Texels {
        /// Weight ≥ 0, beside the image loss, of the mean difference of the logarithm of roughness (and of the specular lobe's share)
        /// between neighbouring texels. Default 0.003.
        #[serde(default = "gloss_smoothness")]
        smoothness: f32,
        /// Difference of chromaticity (albedo over its sum) > 0 at which neighbours are tied half as much as those of one colour.
        /// Default 0.1.
        #[serde(default = "gloss_color_width")]
        color_width: f32,
        /// Whether the strength of the specular lobe varies too: a factor up to 1 for each texel. Default false.
        #[serde(default)]
        specular: bool,
    },
    /// Known ones, as `Save` writes them; `specular` must not be given.
    Fixed {
        /// The base materials, 1 to 8.
        lobes: Vec<SpecularLobe>,
        /// An EXR of the texture's size with a channel of blend weights for each, `weight0` and so on; must exist.
        weights: PathBuf,
    },
}

fn gloss_smoothness() -> f32 {
    0.003
}

fn gloss_color_width() -> f32 {
    0.1
}

fn base_materials() -> u32 {
    2
}
