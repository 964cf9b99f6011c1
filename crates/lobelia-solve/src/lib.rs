//! Shading and visibility, and the fits of light, material and shape.
//!
//! | module | holds |
//! | --- | --- |
//! | [`shape`] | the fit of the shape |
//! | [`fit`] | the fit of light and material |
//! | [`shade`] | the Frame phase: closed forms and the path tracer |
//! | [`visibility`] | shadows and interreflection for closed forms |

pub mod fit;
pub mod shade;
pub mod shape;
pub mod visibility;
