//! Reports: the outputs of passes.
//!
//! Contact sheets ([`sheet`]), the scores of a prediction against its truth ([`published`],
//! [`scores`], [`compare`]), and the page that shows all of a run ([`html`]). Kernels work on slices; every file is written by [`lobelia_io::codec::file`],
//! so that incomplete files never have their final name.

pub mod compare;
pub mod html;
pub mod published;
pub mod scores;
pub mod sheet;
