//! What a program that uses the library needs to write a scene in code, render it, fit it, edit it and relight it.
//!
//! | group | names |
//! | --- | --- |
//! | results | [`Result`], [`Error`], [`SystemResult`] |
//! | the pipeline | [`Pipeline`], [`Plugin`], [`Phase`], [`Stage`], [`Slot`], [`SlotLabel`], [`GatherPoints`], [`ScatterAdjoints`] |
//! | pools | [`Texels`], [`Samples`], [`TexelIndex`], [`SampleIndex`], [`Observation`], [`ObservationIndex`], [`read_column`], [`write_column`] |
//! | surfaces | [`Surface`], [`Mesh`], [`sphere_mesh`], [`box_mesh`] |
//! | views | [`Camera`], [`ViewRecord`], [`ViewIndex`], [`Photograph`], [`StoredMask`], [`Image`], [`Mask`], [`Split`] |
//! | light | [`LightLobe`], [`EnvironmentMap`], [`MapLight`], [`MapConvention`], [`render_lobes`], [`fit_map`], [`MapFit`] |
//! | lights in a world | [`spawn_light`], [`provide_light`], [`LightChoice`], [`LightName`], [`LobeOf`] |
//! | recovered material | [`DiffuseAlbedo`], [`DiffuseSheen`], [`DiffuseTilt`], [`SpecularBlend`], [`SpecularLobe`], [`BaseMaterial`] |
//! | shown material | [`ShownAlbedo`], [`ShownSheen`], [`ShownTilt`], [`ShownBlend`], [`ShownSpecular`], [`show_recovered`], [`show_edited`], [`Composition`], [`recovered_changed`], [`frame_material`] |
//! | edits | [`EditName`], [`EditOrder`], [`EditTarget`], [`EditAction`], [`EditRegion`] |
//! | rendering | [`spawn_object`], [`FramePlugin`], [`render_frame`], [`resolve`], [`Frame`], [`save_png`], [`Look`] |
//! | shading | [`shade_closed_form`], [`ClosedForm`], [`Quality`], [`shade_path_traced`], [`PathTracing`] |
//! | shadows and interreflection | [`FrameVisibilityPlugin`], [`ObjectVisibility`], [`VisibilitySettings`] |
//! | fitting | [`spawn_views`], [`FitPlugin`], [`run_fit`], [`FitOptions`], [`Unknowns`], [`Initialize`], [`FitProgress`], [`FitSummary`] |
//! | from other crates | the prelude of [`bevy_ecs`], [`ScheduleLabel`], [`Vec3`], [`Arc`] |
//!
//! ```
//! use lobelia::prelude::*;
//!
//! let surface = Arc::new(Surface::new(sphere_mesh(Vec3::ZERO, 0.8)?, 16)?);
//! let mut pipeline = Pipeline::new();
//! pipeline.add_plugin(&FramePlugin);
//! let albedo = vec![Vec3::splat(0.5); surface.atlas().position.len()];
//! let lamp = LightLobe { axis: Vec3::Y, sharpness: 4.0, amplitude: Vec3::ONE };
//! spawn_object(&mut pipeline.world, &surface, &albedo, &[SpecularLobe::new(Vec3::splat(0.04), 0.5)], &[lamp]);
//! let camera = Camera::look_at(Vec3::new(0.0, 1.0, 3.0), Vec3::ZERO, Vec3::Y, 38.0, 16, 16)?;
//! let frame = resolve(&render_frame(&mut pipeline, camera, 1)?);
//! assert!(frame.color.iter().any(|c| c.y > 0.1));
//! # Ok::<(), lobelia::Error>(())
//! ```

// Results.
pub use crate::error::{Error, Result};
pub use crate::pipeline::SystemResult;

// The pipeline and its pools.
pub use crate::material::{TexelIndex, Texels};
pub use crate::pipeline::pool::{read_column, write_column};
pub use crate::pipeline::{GatherPoints, Phase, Pipeline, Plugin, ScatterAdjoints, Slot, SlotLabel, Stage};
pub use crate::sample::Samples;
pub use crate::sample::observation::{Observation, ObservationIndex};
pub use crate::sample::pixel::SampleIndex;

// Surfaces and views.
pub use crate::mesh::Surface;
pub use crate::mesh::primitive::{box_mesh, sphere_mesh};
pub use crate::mesh::triangles::Mesh;
pub use crate::view::{Camera, Image, Mask, Photograph, Split, StoredMask, ViewIndex, ViewRecord};

// Light.
pub use crate::light::convention::MapConvention;
pub use crate::light::illuminate::MapLight;
pub use crate::light::lights::{LightChoice, LightName, LobeOf, provide_light, spawn_light};
pub use crate::light::map_fit::{MapFit, fit_map};
pub use crate::light::{EnvironmentMap, LightLobe, render_lobes};

// Material and edits.
pub use crate::material::edit::{EditAction, EditName, EditOrder, EditRegion, EditTarget};
pub use crate::material::shown::{
    Composition, ShownAlbedo, ShownBlend, ShownSheen, ShownSpecular, ShownTilt, recovered_changed,
    show_edited, show_recovered,
};
pub use crate::material::{
    BaseMaterial, DiffuseAlbedo, DiffuseSheen, DiffuseTilt, SpecularBlend, SpecularLobe,
};

// Rendering.
pub use crate::codec::exr_frame::Frame;
pub use crate::math::accurate::Quality;
pub use crate::math::shading::ClosedForm;
pub use crate::report::tone::{Look, save_png};
pub use crate::shade::frame::{FramePlugin, frame_material, render_frame, resolve};
pub use crate::shade::{PathTracing, shade_closed_form, shade_path_traced};
pub use crate::spawn::spawn_object;
pub use crate::visibility::{FrameVisibilityPlugin, ObjectVisibility, VisibilitySettings};

// Fitting.
pub use crate::fit::components::Unknowns;
pub use crate::fit::run::{FitOptions, FitPlugin, FitProgress, FitSummary, Initialize, run_fit};
pub use crate::spawn::spawn_views;

// Other crates. The derive macros of bevy_ecs look for a crate or module of that name.
pub use bevy_ecs;
pub use bevy_ecs::prelude::*;
pub use bevy_ecs::schedule::ScheduleLabel;
pub use glam::Vec3;
pub use std::sync::Arc;
