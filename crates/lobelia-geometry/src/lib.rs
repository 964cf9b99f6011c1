//! Cameras, meshes, texel atlases, rays and signed distances.
//!
//! | module | holds |
//! | --- | --- |
//! | [`sdf`] | signed distance fields |
//! | [`mesh`] | surfaces: triangles with a texel atlas, and the rays that meet them |
//! | [`view`] | cameras, photographs, masks |
//! | [`parallel`] | loops on all threads |
//! | [`error`] | the one error type of all crates |

pub mod error;
pub mod mesh;
pub mod parallel;
pub mod sdf;
pub mod view;

pub use error::{Error, Result};
