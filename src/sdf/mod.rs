//! A signed distance field on a regular grid: construction from silhouettes, tracing, texels, and mesh extraction.
//!
//! | file | holds |
//! | --- | --- |
//! | `grid` | [`SdfGrid`]: values, trilinear look-up, smooth gradient |
//! | `blocks` | values that are computed anew, without a look at blocks where nothing changes |
//! | `distance_transform` | signed distance in pixels to the silhouette of a mask |
//! | [`extract`] | a mesh of the zero level (surface nets) |
//! | `manifold` | splits non-manifold edges and vertices of that mesh |
//! | `trace` | intersections of rays with the zero level (sphere tracing), and their least distance |
//! | `redistance` | restores the distance property (fast sweeping) |
//! | [`volume`] | texels on a lattice around the zero level, and a field that can be shaded with them |
//!
//! | parameter | type | unit | default | meaning |
//! | --- | --- | --- | --- | --- |
//! | `resolution` | `u32` | cells per side | 96 | of the cubic grid |
//! | `origin`, `spacing` | `Vec3`, `f32` | world units | from the cameras | position of the first vertex of the grid, and the distance between neighbors |

mod blocks;
pub(crate) mod distance_transform;
pub mod extract;
mod grid;
mod manifold;
mod redistance;
mod trace;
pub mod volume;

pub use grid::SdfGrid;
pub use trace::LeastDistance;
