//! Components, stages and slots: the world that systems of a render or a fit share.
//!
//! | module | holds |
//! | --- | --- |
//! | [`sample`] | pixel samples: rays, surface points, windows |
//! | [`material`] | texels, base materials, edits, and the material that is shown |
//! | [`light`] | named lights, and how a slot provides them |
//! | [`checkpoint`] | state that a run resumes from after it was killed |
//! | [`pipeline`] | phases, stages, slots, plugins, and pools of entities as slices |

pub mod checkpoint;
pub mod light;
pub mod material;
pub mod pipeline;
pub mod sample;
