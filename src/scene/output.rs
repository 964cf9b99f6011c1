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
}

impl Default for ExportPass {
    fn default() -> Self {
        Self { name: "export".into(), of: None, formats: vec![MeshFormat::Glb], triangles: None }
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
}

impl Default for ViewPass {
    fn default() -> Self {
        Self { name: "view".into(), of: None }
    }
}

/// A file that a mesh is written to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum MeshFormat {
    /// `mesh.glb`: binary glTF with textures, roughness and reflectance.
    Glb,
    /// `mesh.ply`: binary, with normals and the albedo as vertex colours.
    Ply,
    /// `mesh.obj` with `mesh.mtl` and `mesh_albedo.png`.
    Obj,
}
