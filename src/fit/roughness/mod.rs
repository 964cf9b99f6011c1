//! Roughness that varies over the surface: [`blend`] of a few base materials, or a roughness for each [`texel`].

pub mod blend;
pub mod texel;
