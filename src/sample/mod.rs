//! Pixel samples: the entities that are traced, shaded and compared.

pub mod bundle;
pub mod pixel;
pub mod point;
