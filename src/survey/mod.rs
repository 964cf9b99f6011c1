//! The survey of a data set before a run: what is there, and what of it cannot work.
//!
//! Each view is read once, small, and reduced to a [`ViewLook`]: a few numbers, a small mask, a thumbnail. Everything else is a pure function
//! over looks, in seconds for a hundred views, with the same result at every run.
//!
//! | module | holds |
//! | --- | --- |
//! | [`look`] | what is kept of one view |
//! | [`open`] | reading a scene's data |
//! | [`photographs`] | black, negative, absurdly bright, blurred, differently exposed or repeated photographs |
//! | `masks` | inverted, dim, soft or missing masks |
//! | [`meeting`] | cameras and masks that do not belong together |
//! | [`cameras`], [`turntable`] | how cameras lie, and whether the object turned instead |
//! | [`mesh_overlap`], [`agreement`] | whether the masks agree with a known mesh |
//! | [`mask_hull`], `consensus` | whether they agree with each other, and which views do not |
//! | [`change`], `order`, [`mesh_placement`], [`rivals`] | other axes, mirrored photographs, another order, another unit or focal length |
//! | `texture_detail` | texels beside pixels |
//! | [`estimate`] | memory and time of a scene's passes |
//! | [`table`], [`json`], [`contact_sheet`] | the survey as text, as JSON, and as a contact sheet |

pub mod agreement;
pub mod cameras;
pub mod change;
pub(crate) mod consensus;
pub mod contact_sheet;
pub mod estimate;
pub mod examine;
pub mod finding;
pub mod json;
pub mod look;
pub mod mask_hull;
pub(crate) mod masks;
pub mod meeting;
pub mod mesh_overlap;
pub mod mesh_placement;
pub mod open;
pub(crate) mod order;
pub mod photographs;
pub mod rivals;
pub mod sharpness;
pub mod statistics;
pub mod table;
pub(crate) mod texture_detail;
pub mod turntable;

pub use examine::{Subject, Survey, examine};
pub use finding::{Finding, Severity};
pub use look::{MaskOrigin, ViewLook};

#[cfg(test)]
mod tests;
