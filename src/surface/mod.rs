//! Surfaces: meshes, primitives, ray casting and the texel atlas.

pub mod point;
