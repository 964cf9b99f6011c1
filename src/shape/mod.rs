//! The object's shape from photographs with masks.
//!
//! | file | holds |
//! | --- | --- |
//! | [`hull`] | where the object is, and the robust visual hull of its masks as a signed distance field |

pub mod hull;
