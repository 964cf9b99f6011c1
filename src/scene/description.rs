//! A whole scene file.
//!
//! Unless a field says otherwise, lengths are in the data set's own unit, colors are linear Rec. 709 and
//! paths may begin with `$DATA` (the folder given by `--data`) or are relative to the scene file.

use crate::fit::scale::ScaleRule;
use crate::scene::defaults::y_axis;
use crate::scene::light::{Light, LightFrameChoice};
use crate::scene::material::Material;
use crate::scene::passes::Pass;
use crate::scene::surface::Surface;
use crate::scene::views::Views;
use crate::scene::visibility::Visibility;
use glam::Vec3;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// The version of the format that this crate reads and writes.
pub const VERSION: u32 = 1;

/// A whole scene file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scene {
    /// Format version; must be [`VERSION`].
    pub version: u32,
    /// Seed of every random choice. Default 0.
    #[serde(default)]
    pub seed: u64,
    /// The world's up direction, for orbits (not zero; need not be unit). Default (0, 1, 0).
    #[serde(default = "y_axis")]
    pub up: Vec3,
    /// The object's surface.
    pub surface: Surface,
    /// The cameras, with or without photographs.
    pub views: Views,
    /// The light around the object. Default `Unknown(lobes: 128)`.
    #[serde(default)]
    pub light: Light,
    /// In which frame the light stands still. Default `Auto`: found from the photographs, if the light is unknown.
    #[serde(default)]
    pub light_frame: LightFrameChoice,
    /// The object's material. Default: all unknown.
    #[serde(default)]
    pub material: Material,
    /// What decides the scale between light and albedo, if both are unknown: the two are known only up to one factor a channel.
    /// Default `Highlights()`.
    #[serde(default)]
    pub scale: ScaleRule,
    /// Shadows that the object throws on itself, and light that it reflects onto itself, in fits and closed-form renders.
    /// Default `Traced()`.
    #[serde(default)]
    pub visibility: Visibility,
    /// What to do, in order. Default: nothing.
    #[serde(default)]
    pub passes: Vec<Pass>,
}

impl Scene {
    /// The mesh file that the material is read from, if it is not `material` that says it.
    pub fn own_material(&self) -> Option<&Path> {
        match &self.surface {
            Surface::Mesh { path, own_material: true, .. } => Some(path),
            _ => None,
        }
    }
}
