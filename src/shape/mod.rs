//! The object's shape from photographs with masks: a signed distance field, fitted through the same stages as light and material.
//!
//! | file | holds |
//! | --- | --- |
//! | [`hull`] | where the object is, and the robust visual hull of its masks as a signed distance field |
//! | [`repair`] | parts that a few wrong masks carved away, put back; which outlines are to be believed |
//! | [`field`] | the field as parameters: bricks of values (entities) and the field as a whole (a resource) |
//! | `adjoint` | kernels that pull adjoints of normals, positions and silhouettes back to the values |
//! | [`silhouette`] | a mask with its camera, and distances from it |
//! | `silhouette_loss` | the loss of masks |
//! | [`systems`] | the systems, which are swapped in while a shape is fitted ([`run`]) |
//! | [`vertices`] | a mesh's vertices as parameters of a fit |

pub(crate) mod adjoint;
pub mod field;
pub mod hull;
pub mod repair;
pub mod run;
pub mod silhouette;
pub(crate) mod silhouette_loss;
pub mod systems;
pub mod vertices;
