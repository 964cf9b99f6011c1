//! Accuracy and cost of the specular quadrature.

use serde::{Deserialize, Serialize};

/// Number of nodes of the specular quadrature; [`accurate`](super) tabulates accuracy and cost.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[non_exhaustive]
pub enum Quality {
    /// 3 × 2 nodes.
    #[default]
    Default,
    /// 4 × 3 nodes.
    High,
}
