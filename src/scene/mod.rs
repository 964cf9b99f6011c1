//! The scene file: its RON description, where each value stands in the text, and reading it with
//! good errors.
//!
//! A scene file is RON with the extensions `implicit_some` (an optional value is written without
//! `Some`) and `unwrap_variant_newtypes` (`Fit(name: "fit")`, `Constant(0.5, 0.5, 0.5)`) always on.
//! Every field is documented, with unit, range and default, on the types below [`Scene`].
//!
//! The enums here are exhaustive on purpose: a pass or a choice that is added fails to compile
//! wherever it is not handled yet. Most of those of other modules are `#[non_exhaustive]` and may
//! grow.
//!
//! Nothing here makes a world or runs a pass: that is for [`spawn`](crate::spawn) and
//! [`pass`](crate::pass).

mod description;
mod diagnostic;
pub mod load;
mod passes;
mod render;
pub(crate) mod ron_tree;
mod source;
mod validate;
mod views;

pub use description::*;
pub use load::{LoadedScene, load, to_ron};
pub use passes::*;
pub use render::*;
pub use source::LoadOptions;
pub use source::fields;
pub use validate::{MIN_ROUGHNESS, unknown_parts};
pub(crate) use validate::{check_shown, check_without_views, uses_published};
pub use views::*;
