//! The scene file: its RON description, where each value stands in the text, and reading it with good errors.
//!
//! A scene file is RON with the extensions `implicit_some` (an optional value is written without `Some`) and
//! `unwrap_variant_newtypes` (`Fit(name: "fit")`, `Constant(0.5, 0.5, 0.5)`) always on. Every field is
//! documented, with unit, range and default, on the types in [`types`] and [`pass_types`].

pub mod check;
mod check_passes;
pub mod diagnostic;
pub mod gloss_types;
pub mod light_file;
pub mod load;
pub mod output_types;
pub mod pass_types;
pub mod paths;
pub mod render_types;
pub mod ron_tree;
pub mod source;
pub mod spawn;
pub mod texture;
pub mod truth_types;
pub mod types;

pub use check_passes::unknown_parts;
pub use load::{LoadOptions, LoadedScene, RunOptions, load, to_ron};
