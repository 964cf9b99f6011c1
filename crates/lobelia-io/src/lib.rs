//! File formats and data sets, as plain data.
//!
//! | module | holds |
//! | --- | --- |
//! | [`dataset`] | folders of photographs with cameras, in several layouts |
//! | [`codec`] | file formats of images, films, environment maps, lobes and meshes |

pub mod codec;
pub mod dataset;
