//! The documentation is tested like code: the scene-file reference is what the types say, RON blocks load, commands and
//! flags exist, and links lead somewhere.

mod blocks;
mod defaults;
mod licenses;
mod markdown;
mod pages;
mod reference;
mod rust_items;
