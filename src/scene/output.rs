//! How the passes that write the object itself are described: `Save`, `Export` and `View`.

use serde::{Deserialize, Serialize};

/// Writes the object as a scene file with side files.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SavePass {
    /// The pass's name. Default "saved".
    pub name: String,
    /// The `Edit` or `Relight` pass whose edited material and light are saved. Default: the material and light that were found.
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
    /// The `Edit` or `Relight` pass whose edited material is exported. Default: the material that was found.
    pub of: Option<String>,
    /// The files to write, at least one. Default `[Glb]`.
    pub formats: Vec<MeshFormat>,
    /// Write about this many triangles ≥ 4 instead of all, closed where the surface is, with new texture coordinates and the albedo
    /// carried over. Sharp edges become smoothly shaded. Default: all triangles, as they are.
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

impl Default for ExportScale {
    fn default() -> Self {
        Self::Factor(1.0)
    }
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

/// Writes a page, `view.html`, that shows the object in a browser: to be turned, relit and edited, with nothing else needed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ViewPass {
    /// The pass's name. Default "view".
    pub name: String,
    /// The `Edit` or `Relight` pass whose edited material and light the page begins with. Default: the material and light that were
    /// found.
    pub of: Option<String>,
    /// Most photographs in the page, to be laid over its own picture under a wipe: test views, then training views, evenly chosen and
    /// made small; 0: none. Default 24.
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
    /// `mesh.glb`: binary glTF with textures, roughness and reflectance; the light as `light.hdr` and `light_blender.hdr`; and a page for
    /// browsers, `model-viewer.html`.
    Glb,
    /// `mesh.ply`: binary, with normals and the albedo as vertex colors.
    Ply,
    /// `mesh.obj` with `mesh.mtl` and `mesh_albedo.png`.
    Obj,
    /// `mesh.usda`: USD as text, with textures and the light beside it.
    Usda,
    /// `mesh.usdz`: USD with its textures in one file; the light lies beside it.
    Usdz,
}
