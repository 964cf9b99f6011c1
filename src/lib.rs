//! Lobelia: a data-oriented scene processor for inverse rendering with spherical Gaussians.

pub mod error;
pub mod file;
pub mod fit;
pub mod light;
pub mod material;
pub mod math;
pub mod pass;
pub mod report;
pub mod scene;
pub mod shade;
pub mod shape;
pub mod stage;
pub mod surface;
pub mod view;

pub use error::{Error, Result};
