//! How accurate, and how costly, the specular quadrature is.

use serde::{Deserialize, Serialize};

/// How many nodes the specular quadrature has; the module's documentation tabulates accuracy and cost.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Quality {
    /// 3 × 2 nodes.
    #[default]
    Default,
    /// 4 × 3 nodes.
    High,
}
