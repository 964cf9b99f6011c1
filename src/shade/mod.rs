//! The Gather and Shade stages: from surface points, light and material to outgoing radiance.
//!
//! | system | stage, slot | reads | writes |
//! | --- | --- | --- | --- |
//! | [`gather_points`] | Gather | [`SurfacePoint`](crate::sample::point::SurfacePoint), [`ViewRay`](crate::sample::pixel::ViewRay), texels | [`ShadePoint`] |
//! | [`gather_blends`] | Gather | the same | [`PointBlend`] |
//! | systems of [`visibility`] | Gather, `Slot::Visibility` | [`IncidentLight`], points, material | [`PointVisibility`] |
//! | [`provide_lobes`] | Gather, `Slot::Light` | light-lobe entities | [`IncidentLight`] |
//! | [`provide_distant`] | Gather, `Slot::Light` | [`DistantLight`] | [`IncidentLight`] |
//! | [`shade_closed_form`] | Shade, `Slot::Shading` | [`ShadePoint`], [`IncidentLight`], [`ShadingForm`], specular lobes | [`Layers`] |
//! | [`shade_path_traced`] | Shade, `Slot::Shading` | the same, [`Scenery`], [`PathTracing`] | [`Layers`] |
//!
//! [`Layers`]: crate::math::shading::Layers
//! [`PointVisibility`]: crate::math::shading::PointVisibility
//! [`ShadePoint`]: crate::math::shading::ShadePoint

pub mod frame;
pub mod path_tracer;
pub mod sampling;
pub mod systems;

use crate::math::ray::{Illuminate, Intersect};
use crate::math::shading::{ClosedForm, LobeColumns};
use bevy_ecs::prelude::{Component, Resource};
use std::sync::Arc;

pub use systems::{
    gather_blends, gather_points, provide_distant, provide_lobes, shade_closed_form, shade_path_traced,
};

/// The surface that rays are cast against.
#[derive(Resource, Clone)]
pub struct Scenery(pub Arc<dyn Intersect>);

/// The light of this run, as the provider in `Slot::Light` gave it.
#[derive(Resource, Clone, Default)]
pub struct IncidentLight {
    /// SG lobes in columns, for closed-form shading.
    pub lobes: LobeColumns,
    /// The same light as something that can be sampled, for path tracing.
    pub distant: Option<Arc<dyn Illuminate>>,
}

/// The closed form that [`shade_closed_form`] shades by.
#[derive(Resource, Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ShadingForm(pub ClosedForm);

/// A light in place of the world's light lobes: an environment map or other lobes.
#[derive(Resource, Clone)]
pub struct DistantLight {
    /// The light, ready to be sampled.
    pub light: Arc<dyn Illuminate>,
    /// SG lobes that stand for it in closed-form shading.
    pub lobes: LobeColumns,
}

/// How paths are traced.
#[derive(Resource, Clone, Copy, Debug, PartialEq, Eq)]
pub struct PathTracing {
    /// Paths per pixel sample.
    pub paths_per_sample: u32,
    /// Most surface hits of a path; 1 is direct light only.
    pub max_bounces: u32,
    /// Seed of the random numbers.
    pub seed: u64,
    /// Samples of a pixel, which share its random sequence.
    pub samples_per_pixel: u32,
}

/// Blend weights of the specular lobes at a pixel sample; they sum to one.
#[derive(Component, Clone, Copy, Debug, PartialEq)]
pub struct PointBlend(pub [f32; crate::material::MAX_SPECULAR_LOBES]);

impl Default for PointBlend {
    fn default() -> Self {
        Self(crate::material::SpecularBlend::default().0)
    }
}
