//! Errors of the GPU.

use lobelia_sg::brdf::Ndf;
use lobelia_sg::shading::ClosedForm;
use thiserror::Error;

/// Why there is no result from a GPU.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum GpuError {
    /// No adapter can run the kernels.
    #[error(
        "no GPU adapter is there that can compute; install a Vulkan driver (Debian: mesa-vulkan-drivers, which also has one in software)"
    )]
    NoAdapter,
    /// No adapter has this in its name.
    #[error("no GPU adapter has \"{wanted}\" in its name; there are: {}", found.join(", "))]
    NoSuchAdapter {
        /// The name that was searched for.
        wanted: String,
        /// The names of the adapters that can compute.
        found: Vec<String>,
    },
    /// The adapter gives no device, or the device failed.
    #[error("the GPU \"{name}\" failed: {cause}")]
    Failed {
        /// Name of the adapter.
        name: String,
        /// The message of `wgpu`.
        cause: String,
    },
    /// A closed form and distribution of normals without kernels.
    #[error("{form:?} shading with the {ndf:?} distribution is not on the GPU; shade on the CPU")]
    Unsupported {
        /// The closed form.
        form: ClosedForm,
        /// The distribution of microfacet normals.
        ndf: Ndf,
    },
    /// A slice whose length does not fit the points.
    #[error("{what}: {found} values, where the points need {expected}")]
    Length {
        /// Name of the slice.
        what: &'static str,
        /// Its length.
        found: usize,
        /// The required length.
        expected: usize,
    },
    /// More lobes than the kernels take.
    #[error("{lobes} lobes are more than the GPU takes; at most {most}")]
    TooManyLobes {
        /// Number of lobes.
        lobes: usize,
        /// Largest number.
        most: usize,
    },
}
