//! Lobelia: a data-oriented scene processor for inverse rendering with spherical Gaussians.

pub mod codec;
pub mod dataset;
pub mod error;
pub mod fit;
pub mod light;
pub mod material;
pub mod mesh;
pub mod pass;
pub mod pipeline;
pub mod prelude;
pub mod report;
pub mod sample;
pub mod scene;
pub mod sdf;
pub mod shade;
pub mod shape;
pub mod spawn;
pub mod view;
pub mod visibility;

pub use error::{Error, Result};
pub use lobelia_math as math;
