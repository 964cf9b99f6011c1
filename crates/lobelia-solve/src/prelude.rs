//! The names of other crates that many modules here use.

pub(crate) use bevy_ecs::prelude::{
    Component, Entity, IntoScheduleConfigs, Query, Res, ResMut, Resource, With, World,
};
pub(crate) use bevy_ecs::{schedule::ScheduleConfigs, system::ScheduleSystem};
pub(crate) use fearless_simd::{Level, dispatch};
pub(crate) use glam::{DVec3, Mat3, UVec3, Vec2, Vec3, Vec4};
pub(crate) use lobelia_geometry::error::stop::{check_interrupted, is_stopping};
pub(crate) use lobelia_geometry::view::{
    ByView, Camera, Photograph, Placement, StoredMask, ViewIndex, ViewName,
};
pub(crate) use lobelia_geometry::{
    Error, Result, mesh::bvh::TriangleBvh, mesh::triangles::Mesh, sdf::SdfGrid,
};
pub(crate) use lobelia_sg::ray::{Intersect, Ray};
pub(crate) use lobelia_sg::shading::{
    ClosedForm, Layers, Lighting, LobeColumns, LobeVisibility, PointAdjoint, PointVisibility,
    RadianceAdjoint, ShadePoint, SpecularValue,
};
pub(crate) use lobelia_sg::statistics::median;
pub(crate) use lobelia_world::light::placement::{LightGroup, PlacedFrame, Placements};
pub(crate) use lobelia_world::material::{
    BaseMaterial, DiffuseAlbedo, DiffuseSheen, DiffuseTilt, MAX_SPECULAR_LOBES, SpecularBlend, SpecularLobe,
    TexelIndex, Texels, USUAL_ALBEDO, material_source::BaseMaterials, recovered_albedo, recovered_materials,
};
pub(crate) use lobelia_world::pipeline::{Phase, Pipeline, Plugin, Slot, Stage, SystemResult};
pub(crate) use lobelia_world::sample::pixel::{Observed, PixelOf, ViewRay};
pub(crate) use lobelia_world::sample::point::{PointBlend, Scenery, SurfacePoint};
pub(crate) use lobelia_world::sample::{Observation, ObservationIndex, Samples};
pub(crate) use lobelia_world::{light::LightLobe, light::lights::IncidentLight, pipeline::pool::read_column};
pub(crate) use rayon::prelude::*;
pub(crate) use serde::{Deserialize, Serialize};
pub(crate) use std::ops::{ControlFlow, Range};
pub(crate) use std::sync::Arc;
pub(crate) use tracing::info_span;
