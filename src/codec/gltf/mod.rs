//! glTF 2.0: triangle meshes and their material in and out.

pub mod export;
mod file;
pub mod import;
pub mod material;
