//! The documentation is tested like code: the scene-file reference is what the types say, RON blocks load, commands and
//! flags exist, and links lead somewhere.

#[path = "docs/blocks.rs"]
mod blocks;
#[path = "docs/defaults.rs"]
mod defaults;
#[path = "docs/markdown.rs"]
mod markdown;
#[path = "docs/pages.rs"]
mod pages;
#[path = "docs/reference.rs"]
mod reference;
#[path = "docs/rust_items.rs"]
mod rust_items;
