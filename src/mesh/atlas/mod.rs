//! The texel atlas: the surface point of each texel, and the texels of a surface point.
//!
//! Texel (i, j) has its center at uv = ((i + ½)/W, (j + ½)/H); lookups are bilinear and clamp at the borders.
//! [`unwrap_mesh`] gives a mesh that has none coordinates: `chart` takes the surface apart and lays the parts flat, `pack` puts them side
//! by side, `fill_uncovered` fills what no view sees.

mod chart;
mod fill;
#[cfg(test)]
mod meshes;
mod pack;
mod texels;
mod unwrap;

pub(crate) use fill::fill_uncovered;
pub use texels::{TexelAtlas, address};
pub use unwrap::{UnwrappedMesh, unwrap_mesh};
