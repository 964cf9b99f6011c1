//! Names that a program needs to find an object from photographs, and to show, edit, relight and
//! keep it.
//!
//! | group | names |
//! | --- | --- |
//! | photographs | [`Capture`], [`ViewRecord`], [`Camera`], [`Split`], [`Frame`] |
//! | objects | [`Object`], [`ReconstructOptions`], [`FitPass`], [`ShapePass`], [`Progress`], [`Step`] |
//! | what is shown | [`Appearance`], [`Light`], [`Edit`], [`RenderSettings`], [`Look`], [`save_png`] |
//! | values | [`Surface`], [`Mesh`], [`sphere_mesh`], [`box_mesh`], [`LightLobe`], [`EnvironmentMap`], [`Diffuse`], [`SpecularLobe`] |
//! | results, and from other crates | [`Result`], [`Error`], [`Vec3`], [`Arc`] |
//!
//! The names of systems, slots and components of one's own are in [`ecs`](crate::ecs). Programs
//! with these names are in [`capture`](crate::capture) and [`object`](crate::object).

pub use crate::capture::Capture;
pub use crate::object::{Object, ReconstructOptions, show::Appearance};
pub use crate::progress::{Progress, Step};
pub use crate::scene::{Edit, FitPass, RenderSettings, ShapePass};
pub use crate::spawn::LoadedLight as Light;
pub use glam::Vec3;
pub use lobelia_geometry::error::{Error, Result};
pub use lobelia_geometry::mesh::primitive::{box_mesh, sphere_mesh};
pub use lobelia_geometry::mesh::{Surface, triangles::Mesh};
pub use lobelia_geometry::view::{Camera, Frame, Split, ViewRecord};
pub use lobelia_io::codec::tone::{Look, save_png};
pub use lobelia_world::light::{EnvironmentMap, LightLobe};
pub use lobelia_world::material::{Diffuse, SpecularLobe};
pub use std::sync::Arc;
