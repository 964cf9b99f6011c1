//! Reports: the outputs of passes.
//!
//! Frames as layered EXR, pictures as PNG, contact sheets, animations, the scores of a prediction against its truth, and the page that
//! shows all of a run ([`html`]).
//! Kernels ([`metrics`], [`ssim`], [`srgb`], [`orb`], [`normals`], [`tone`], [`heat`]) work on slices; every file is written by
//! [`crate::codec::file`], so that incomplete files never have their final name.
//!
//! | name | type | unit | default | meaning |
//! | --- | --- | --- | --- | --- |
//! | [`tone::Look::exposure`] | `f32` | stops | 0 | radiance is multiplied by 2^exposure before the tone curve |
//! | [`tone::Look::tone`] | [`tone::Tone`] | | `Srgb` | `Srgb` clips; `Filmic` and `Neutral` compress highlights |
//! | [`tone::Backdrop`] | enum | | `Transparent` | the background outside the object |
//! | [`sheet::Sheet::cell_width`] | `u32` | pixel | 256 | width of every picture of a sheet |
//! | [`sheet::Sheet::theme`] | [`sheet::Theme`] | | `Light` | light or dark neutral gray |
//! | [`heat::factor_for`] | `f32` | | 4–64 | amplification of an error map: error × factor = 1 is the end of the scale |
//! | [`metrics::PSNR_CAP_DB`] | `f64` | dB | 100 | score of equal images (JSON has no infinity) |
//! | [`scores::Scaling`] | enum | | `None` | least-squares scale that is removed before scoring |

pub mod compare;
pub mod font;
pub mod heat;
pub mod html;
pub mod metrics;
pub mod normals;
pub mod orb;
pub(crate) mod profile;
mod score_table;
pub mod scores;
pub mod sheet;
pub mod srgb;
pub mod ssim;
pub(crate) mod thumbnail;
pub mod tone;
