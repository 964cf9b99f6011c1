//! The scene file: its RON description, where each value stands in the text, and reading it with good errors.
//!
//! A scene file is RON with the extensions `implicit_some` (an optional value is written without `Some`) and
//! `unwrap_variant_newtypes` (`Fit(name: "fit")`, `Constant(0.5, 0.5, 0.5)`) always on. Every field is
//! documented, with unit, range and default, on the types in [`description`] and [`passes`].

pub mod description;
pub mod diagnostic;
pub mod load;
pub mod output;
pub mod passes;
pub mod paths;
pub mod photographed;
pub mod render;
pub mod ron_tree;
pub mod roughness;
pub mod source;
pub mod validate;

pub use load::{LoadOptions, LoadedScene, RunOptions, load, to_ron};
pub use validate::passes::unknown_parts;
