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
//!
//! ```
//! use lobelia_sg::shading::{ClosedForm, Layers, LobeColumns, ShadePoint, SpecularValue};
//! use lobelia_sg::sg::Lobe;
//!
//! let up = [0.0, 0.0, 1.0];
//! let lamp = Lobe { axis: up, sharpness: 1000.0, amplitude: [1.0, 2.0, 3.0] };
//! let light = LobeColumns::from_lobes([lamp].into_iter());
//! let points = [ShadePoint { normal: up, to_viewer: up, albedo: [0.5; 3] }];
//! let specular = SpecularValue { albedo: [0.04; 3], roughness: 0.5, ..SpecularValue::default() };
//! let mut shaded = [Layers::default()];
//! ClosedForm::default().shade(&points, &specular, &light, &mut shaded);
//! // A lamp this sharp has an irradiance of nearly 2π μ/λ.
//! assert!((shaded[0].diffuse[1] / (0.5 * 2.0 * 2.0 / 1000.0) - 1.0).abs() < 0.01);
//! ```

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
