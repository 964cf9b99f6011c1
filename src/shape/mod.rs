//! The object's shape from photographs with masks: a signed distance field, fitted through the same stages as light and material.
//!
//! | file | holds |
//! | --- | --- |
//! | [`hull`] | the position of the object, and the robust visual hull of its masks as a signed distance field |
//! | `unseen` | spans what no photograph sees of the hull |
//! | [`hollows`] | removes from the hull what photographs look through |
//! | `parts` | which components of a surface are the object's |
//! | `trust` | finds masks that no other mask contradicts, which may carve alone |
//! | `hull_repair` | restores parts that a few wrong masks remove from the hull, and selects the silhouettes that the other masks confirm |
//! | [`field`] | the field as parameters: bricks of values (entities) and the field as a whole (a resource) |
//! | `field_adjoint` | kernels that propagate adjoints of normals, positions and silhouettes back to the values |
//! | [`silhouette`] | a mask with its camera, and distances from it |
//! | `shrunk` | photographs made smaller, with the object alone |
//! | `silhouette_loss` | the loss of masks |
//! | [`systems`] | the systems, which are swapped in during the fit of a shape ([`run`]) |
//! | [`outline`] | moves the contours of the surface to the outlines of the masks |
//! | `displace` | moves a field by displacements of the vertices of its surface |
//! | [`stereo`] | moves a mesh to where neighboring photographs agree |
//! | [`mirror`] | gives vertices normals that explain what the surface mirrors |
//! | `vertex_graph` | the vertices of a mesh as a graph |
//! | [`vertices`] | a mesh's vertices as parameters of a fit |

pub(crate) mod displace;
pub mod field;
pub(crate) mod field_adjoint;
pub mod hollows;
pub mod hull;
pub(crate) mod hull_repair;
pub mod mirror;
pub mod outline;
pub(crate) mod parts;
pub mod run;
mod shrunk;
pub mod silhouette;
pub(crate) mod silhouette_loss;
pub mod stereo;
pub mod systems;
pub(crate) mod trust;
pub(crate) mod unseen;
pub(crate) mod vertex_graph;
pub mod vertices;
