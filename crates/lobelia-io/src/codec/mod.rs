//! Reading and writing of files: images, environment maps, light lobes, meshes. Formats do not
//! depend on systems.
//!
//! | module | reads | writes |
//! | --- | --- | --- |
//! | [`mod@file`] | whole files of bounded size | whole files, never incomplete |
//! | [`image`] | PNG, JPEG, TIFF, WebP, EXR, HDR: headers, samples, linear images and masks | PNG and JPEG in memory |
//! | [`exr`], [`exr_frame`] | EXR layers | EXR layers, rendered frames |
//! | [`png_file`], [`film`] | | PNG; MP4 (by `ffmpeg`), GIF |
//! | [`envmap`] | EXR and Radiance HDR environment maps | the same |
//! | [`npy`] | light lobes in both conventions; matrices, and archives of them | light lobes |
//! | [`tone`] | | radiance as 8-bit pictures |
//! | [`texture`] | images as texels of an atlas | |
//! | [`gltf`], [`usd`] | glTF meshes and materials | glTF; USDA, USDZ |
//! | [`nearby`] | | suggestions for wrong file and view names |

pub mod envmap;
pub mod exr;
pub mod exr_frame;
pub mod file;
pub mod film;
pub mod gltf;
pub mod image;
pub mod nearby;
pub mod npy;
pub mod png_file;
#[cfg(test)]
pub(crate) mod test_data;
pub mod texture;
pub mod tone;
pub mod usd;
