//! The Loss, Gradient and Update stages.

pub mod adam;
pub mod align;
pub mod cameras;
pub mod components;
pub mod exposure;
pub mod first_guess;
pub mod gloss;
mod guess;
pub mod loss;
pub mod observe;
pub mod place_lobes;
pub mod run;
pub mod scale;
pub mod systems;
pub mod texel_gloss;
