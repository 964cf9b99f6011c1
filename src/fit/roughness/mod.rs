//! Roughness that varies over the surface: a [`blend`] of a few base materials, or one roughness per [`texel`].

pub mod blend;
pub mod blend_adjoint;
pub mod texel;
