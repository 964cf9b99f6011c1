//! Shadows and interreflection in closed-form shading: occlusion by other parts of the object, and light that they reflect.
//!
//! A separate capability in [`Slot::Visibility`](lobelia_world::pipeline::Slot::Visibility); without it all light reaches every point.
//!
//! | module | holds |
//! | --- | --- |
//! | `object_visibility` | [`ObjectVisibility`]: the occlusion of an object, and the light on it; the visibility of points |
//! | `texel_visibility` | the occluded directions of each texel, and the texels that occlude them |
//! | `occlusion` | kernels: light on a set of directions, and the part of it that reaches texels |
//! | `point_visibility` | kernels: the part of it that reaches points, and what narrow lobes mirror of the object |
//! | [`systems`] | the systems in `Slot::Visibility`, and their run conditions |
//!
//! Diffuse light has one factor per texel and lobe, interpolated at the point like albedo, so that the light can be fitted with it.
//! Specular light has one per point, for the mirror direction and the mean roughness of the base materials there. In the adjoint all
//! factors and the interreflection are constant.

mod object_visibility;
pub(crate) mod occlusion;
mod point_visibility;
pub mod systems;
pub mod texel_visibility;

pub use object_visibility::{ObjectVisibility, VisibilitySettings, WindowVisibility};
pub use occlusion::Reflectance;
pub use point_visibility::LobeRays;
pub use systems::FrameVisibilityPlugin;
