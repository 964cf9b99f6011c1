//! What a scene file says about the surface.

use glam::Vec3;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// The object's surface.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum Surface {
    /// A glTF/GLB file.
    Mesh {
        /// The `.gltf` or `.glb` file; must exist.
        path: PathBuf,
        /// Width and height of the albedo texture in texels, 8 to 4096. Default 256.
        #[serde(default = "mesh_texture_size")]
        texture_size: u32,
        /// Take the file's own material, as `Export` writes it: one dielectric, no metal, no textures but the base color's. It
        /// counts as fixed, and `material` must not be given. Default false.
        #[serde(default)]
        own_material: bool,
    },
    /// The shape is not known: it is found from the photographs' masks. `views` must be a `Dataset`.
    Unknown {
        /// Cells a side of the grid that the shape is found on, 16 to 256. Default 128.
        #[serde(default = "unknown_cells")]
        cells: u32,
        /// Width and height of the albedo texture in texels, 8 to 4096. Default 512.
        #[serde(default = "unknown_texture_size")]
        texture_size: u32,
    },
    /// A sphere.
    Sphere {
        /// Center. Default (0, 0, 0).
        #[serde(default)]
        center: Vec3,
        /// Radius > 0. Default 0.8.
        #[serde(default = "sphere_radius")]
        radius: f32,
        /// Width and height of the albedo texture in texels, 8 to 4096. Default 128.
        #[serde(default = "primitive_texture_size")]
        texture_size: u32,
    },
    /// A box with axis-aligned faces.
    Box {
        /// Center. Default (0, 0, 0).
        #[serde(default)]
        center: Vec3,
        /// Edge lengths > 0. Default (1, 1, 1).
        #[serde(default = "ones")]
        size: Vec3,
        /// Width and height of the albedo texture in texels, 8 to 4096. Default 128.
        #[serde(default = "primitive_texture_size")]
        texture_size: u32,
    },
}

fn ones() -> Vec3 {
    Vec3::ONE
}

fn unknown_cells() -> u32 {
    128
}

fn unknown_texture_size() -> u32 {
    512
}

fn mesh_texture_size() -> u32 {
    256
}

fn primitive_texture_size() -> u32 {
    128
}

fn sphere_radius() -> f32 {
    0.8
}
