//! Reading and writing of files: images, environment maps, light lobes, meshes. Formats do not depend on systems.
//!
//! | module | reads | writes |
//! | --- | --- | --- |
//! | [`mod@file`] | whole files of bounded size | whole files, never incomplete |
//! | [`finite`] | | the check that every writer of floats makes |
//! | [`image`] | PNG, JPEG, TIFF, WebP, EXR, HDR: headers, samples, linear images and masks | PNG and JPEG in memory |
//! | [`deflate`] | | compressed bytes |
//! | [`exr`], [`exr_frame`], `exr_rows` | EXR layers | EXR layers, rendered frames |
//! | [`png_file`], [`animation`], [`video`] | | PNG; GIF, APNG; MP4 |
//! | [`envmap`], `hdr` | EXR and Radiance HDR environment maps | the same |
//! | [`npy`] | light lobes in both conventions; matrices | light lobes |
//! | [`npz`] | archives of matrices | |
//! | [`texture`] | images as texels of an atlas | |
//! | [`gltf`], [`ply_obj`], [`usd`] | glTF meshes and materials | glTF; PLY, OBJ; USDA, USDZ |
//! | [`nearby`] | | suggestions for wrong file and view names |

pub mod animation;
pub mod deflate;
pub mod envmap;
pub mod exr;
pub mod exr_frame;
mod exr_rows;
#[cfg(test)]
mod fault_tests;
pub mod file;
pub mod film;
pub mod finite;
pub mod gltf;
mod hdr;
pub mod image;
pub mod nearby;
pub mod npy;
pub mod npz;
mod palette;
pub mod ply_obj;
pub mod png_file;
#[cfg(test)]
pub(crate) mod test_data;
pub mod texture;
pub mod usd;
pub mod video;
