//! How cases are shaded, and in which numbers.

use lobelia::math::shading::ClosedForm;

/// How cases are shaded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ShadeMode {
    /// A closed form.
    ClosedForm(ClosedForm),
    /// The path tracer's sampling; adds `diffuse_stderr` and `specular_stderr`.
    PathTraced {
        /// Paths per case, at least 2; they are rounded up to a multiple of [`REPLICATES`] (or taken singly if fewer).
        samples: u32,
    },
}

/// The float that cases are shaded in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Precision {
    /// As renders are; values below about 1e-38 are zero.
    F32,
    /// For checks: same formulas and sampling code, without rounding or underflow to speak of.
    F64,
}

/// Independent repetitions of a case whose spread is its standard error.
pub(super) const REPLICATES: u32 = 32;
