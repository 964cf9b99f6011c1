//! SG shading of many points by many lobes: the slice kernels behind the Shade and Gradient stages.
//!
//! Lobes are stored in columns, padded to a whole number of SIMD vectors. Points are processed one
//! by one, in chunks over the threads. Sums over points are computed per chunk and then over chunks
//! in order, so the result does not depend on the number of threads. The formulas are a
//! [`PairModel`](crate::model::PairModel)'s; [`ClosedForm`] chooses one at run time.
//!
//! Vector arithmetic belongs in `#[inline(always)]` functions and loops, not in large closures: a
//! closure that the compiler does not inline is compiled without the instructions of the level and
//! is ten times slower.

mod adjoint;
mod blocks;
mod closed_form;
mod cull;
mod forward;
mod loops;
mod respond;
mod slices;
mod walk;

pub use crate::brdf::{SpecularAdjoint, SpecularValue};
pub use crate::columns::{
    ChunkSums, LOBE_COLUMNS, Layers, Lighting, LobeColumns, LobeVisibility, PointAdjoint, PointVisibility,
    RadianceAdjoint, RadianceColumns, ShadePoint, SharedGradient,
};
pub use closed_form::{ClosedForm, Cpu, PairLoops, ShadeCall};
pub use respond::RESPONSE_ROWS;
pub use slices::{CHUNK, shade_adjoint_with, shade_with};
