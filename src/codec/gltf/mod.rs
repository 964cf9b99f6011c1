//! Reading and writing of glTF 2.0: triangle meshes and their material.

pub mod dielectric;
pub mod export;
mod file;
pub mod import;
pub mod material;

pub(crate) use file::side_files;
