//! The names of other crates that many modules here use.

pub(crate) use bevy_ecs::prelude::{
    Component, Entity, IntoScheduleConfigs, Query, Res, ResMut, Resource, With, World,
};
pub(crate) use glam::{DVec3, Mat3, UVec3, Vec2, Vec3, Vec4};
pub(crate) use lobelia_geometry::error::stop::{check_interrupted, is_stopping};
pub(crate) use lobelia_geometry::view::{ByView, Camera, Photograph, Placement, ViewIndex};
pub(crate) use lobelia_geometry::{
    Error, Result, mesh::bvh::TriangleBvh, mesh::triangles::Mesh, sdf::SdfGrid,
};
pub(crate) use lobelia_sg::shading::{
    ClosedForm, Layers, LobeColumns, PointAdjoint, PointVisibility, ShadePoint,
};
pub(crate) use lobelia_sg::{ray::Ray, statistics::median};
pub(crate) use lobelia_world::light::LightLobe;
pub(crate) use lobelia_world::light::placement::{LightGroup, Placements};
pub(crate) use lobelia_world::material::{
    BaseMaterial, DiffuseAlbedo, DiffuseSheen, SpecularBlend, SpecularLobe, TexelIndex, Texels, USUAL_ALBEDO,
    recovered_albedo, recovered_materials,
};
pub(crate) use lobelia_world::pipeline::{
    Phase, Pipeline, Plugin, Slot, Stage, SystemResult, pool::read_column,
};
pub(crate) use lobelia_world::sample::pixel::{Observed, PixelOf, ViewRay};
pub(crate) use lobelia_world::sample::point::{Scenery, SurfacePoint};
pub(crate) use lobelia_world::sample::{Observation, Samples};
pub(crate) use rayon::prelude::*;
pub(crate) use serde::{Deserialize, Serialize};
pub(crate) use tracing::info_span;
