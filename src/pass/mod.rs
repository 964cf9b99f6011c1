//! The passes of a scene file, one module per kind, and the run that takes them in order.
//!
//! | pass | file | writes into `OUT/<name>/` |
//! | --- | --- | --- |
//! | `Fit` | `fit` | the recovered light (`light.npy`, `environment.exr`), `albedo.png`, `materials.ron`, `log.csv`; of several base materials `blend.exr`, `.png`, with one roughness per texel `roughness.exr`, `.png` |
//! | `Shape` | `fit` | with `--debug-every N`, normals, depth and mesh every N steps |
//! | both | `fit` | `cam_dict_norm.json` of optimized cameras, `exposures.csv` |
//! | `Render`, `Edit`, `Relight` | `render` | an EXR with layers and a PNG per view, the animation of an orbit |
//! | `Evaluate` | `evaluate` | a contact sheet, `views.csv`, and a folder per scored pass with small pictures of its views; scores go to `OUT/metrics.json` |
//! | `Save` | [`object::save`](crate::object::save) | `scene.ron` with side files |
//! | `Export` | [`object::export`](crate::object::export) | `mesh.glb`, `mesh.usda`, `mesh.usdz` with their textures; the light as `.hdr`; a page |
//! | `View` | [`view`] | `view.html` |
//!
//! Passes call an [`Object`](crate::object::Object) and write what comes of it; everything that is of
//! no single pass is in `run`.

pub(crate) mod evaluate;
pub(crate) mod fit;
pub(crate) mod render;
mod run;
pub mod view;

pub use run::{OwnPass, RunOptions, looks, memory, preflight, rehearse, run, summary, write_view};
