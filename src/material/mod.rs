//! Material: diffuse albedo and blend weights of texels, base materials, and edits.
//!
//! A texel has a [`TexelIndex`], its number in the atlas. A base material is an entity with a [`SpecularLobe`] and a number
//! ([`BaseMaterial`]); weight k of a texel's [`SpecularBlend`] belongs to base material k, independently of the order of entities.
//!
//! The result of a fit is the *recovered* material. The system in [`Slot::Material`](crate::pipeline::Slot::Material) computes the
//! *shown* material from it, in separate components ([`shown`]).
//!
//! | module | holds |
//! | --- | --- |
//! | `components` | components of texels and base materials, recovered and shown |
//! | `recovered` | spawns, replaces and reads the recovered material |
//! | [`shown`] | the shown material and its systems: as recovered, or edited |
//! | [`sheen`] | albedo that depends on the angle of view |
//! | [`tilt`] | albedo that depends on the side of view |
//! | [`edit`] | edits as components, and the kernel that applies them |
//! | [`material_source`] | traits for systems that read the recovered or the shown material |

mod components;
pub mod edit;
pub mod material_source;
mod recovered;
pub mod sheen;
pub mod shown;
pub mod tilt;

pub use components::{
    BaseMaterial, DiffuseAlbedo, DiffuseSheen, DiffuseTilt, MAX_SPECULAR_LOBES, SpecularBlend, SpecularLobe,
    TexelIndex, Texels, USUAL_ALBEDO,
};
pub use recovered::{
    first_material, recovered_albedo, recovered_materials, replace_materials, spawn_materials, spawn_texels,
    texels_in_order,
};
