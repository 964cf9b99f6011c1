//! Reports: what a pass leaves behind for people and for other programs.
//!
//! Frames as layered EXR, pictures as PNG, contact sheets, animations, and the scores of a prediction against its truth.
//! Kernels ([`metrics`], [`ssim`], [`tone`], [`heat`]) work on slices; every file goes through [`crate::codec::file`], so that
//! nothing half-written ever bears a final name.
//!
//! | name | type | unit | default | meaning |
//! | --- | --- | --- | --- | --- |
//! | [`tone::Look::exposure`] | `f32` | stops | 0 | radiance is multiplied by 2^exposure before the tone curve |
//! | [`tone::Look::tone`] | [`tone::Tone`] | | `Srgb` | `Srgb` clips; `Filmic` and `Neutral` roll highlights off |
//! | [`tone::Backdrop`] | enum | | `Transparent` | what is seen where the object is not |
//! | [`sheet::Sheet::cell_width`] | `u32` | pixel | 256 | width that every picture of a sheet is brought to |
//! | [`sheet::Sheet::theme`] | [`sheet::Theme`] | | `Light` | neutral paper or neutral slate |
//! | [`heat::factor_for`] | `f32` | | 4–64 | amplification of an error map: error × factor = 1 is the hottest colour |
//! | [`metrics::PSNR_CAP_DB`] | `f64` | dB | 100 | what equal images score (JSON has no infinity) |
//! | [`scores::Scaling`] | enum | | `None` | least-squares scale that is taken out before scoring |

pub mod compare;
pub mod font;
pub mod heat;
pub mod metrics;
pub mod scores;
pub mod sheet;
pub mod ssim;
pub mod tone;
