//! The Gather and Shade stages, which compute outgoing radiance from surface points, light and
//! material; and the phases Compose and Frame.
//!
//! | system | stage, slot | reads | writes |
//! | --- | --- | --- | --- |
//! | [`gather_points`] | Gather | surface points, rays, texels | [`ShadePoint`](lobelia_sg::shading::ShadePoint) |
//! | [`gather_blends`] | Gather | the same | [`PointBlend`](lobelia_world::sample::point::PointBlend) |
//! | [`shade_closed_form`] | Shade, `Slot::Shading` | gathered points, light, base materials, visibility | [`Layers`](lobelia_sg::shading::Layers) |
//! | [`shade_path_traced`] | Shade, `Slot::Shading` | the same, [`Scenery`](lobelia_world::sample::point::Scenery) | the same |
//!
//! A fit also needs the adjoint of what shades:
//! [`closed_form_shader`](crate::fit::systems::closed_form_shader).
//!
//! The other systems of the Gather stage: [`material::shown`](lobelia_world::material::shown) in
//! `Slot::Material`, [`light::lights`](lobelia_world::light::lights) in `Slot::Light`,
//! [`visibility`](crate::visibility) in `Slot::Visibility`.

pub mod adaptive;
pub mod device;
pub mod frame;
pub mod path_tracer;
pub mod sampling;
pub mod systems;

pub use systems::{PathTracing, gather_blends, gather_points, shade_closed_form, shade_path_traced};
