//! Names that a program needs to write a scene in code, render it, fit it, edit it and relight it.
//!
//! | group | names |
//! | --- | --- |
//! | results | [`Result`], [`Error`], [`SystemResult`] |
//! | the pipeline | [`Pipeline`], [`Plugin`], [`Phase`], [`Stage`], [`Slot`], [`GatherPoints`], [`ScatterAdjoints`], [`Shader`] |
//! | pools | [`Texels`], [`Samples`], [`TexelIndex`], [`SampleIndex`], [`Observation`], [`ObservationIndex`], [`read_column`], [`write_column`] |
//! | surfaces | [`Surface`], [`Mesh`], [`sphere_mesh`], [`box_mesh`] |
//! | views | [`Camera`], [`ViewRecord`], [`ViewIndex`], [`Photograph`], [`StoredMask`], [`Image`], [`Mask`], [`Split`] |
//! | light | [`LightLobe`], [`EnvironmentMap`], [`MapLight`], [`MapConvention`], [`render_lobes`], [`fit_map`], [`MapFit`] |
//! | lights in a world | [`spawn_light`], [`provide_light`], [`LightChoice`], [`LightName`], [`LobeOf`] |
//! | recovered material | [`DiffuseAlbedo`], [`DiffuseSheen`], [`DiffuseTilt`], [`SpecularBlend`], [`SpecularLobe`], [`BaseMaterial`] |
//! | shown material | [`Shown`], [`show_recovered`], [`show_edited`], [`Composition`], [`recovered_changed`], [`frame_material`] |
//! | edits | [`EditName`], [`EditOrder`], [`EditTarget`], [`EditAction`], [`EditRegion`] |
//! | rendering | [`spawn_object`], [`FramePlugin`], [`render_frame`], [`resolve`], [`Frame`], [`save_png`], [`Look`] |
//! | shading | [`shade_closed_form`], [`ClosedForm`], [`Quality`], [`shade_path_traced`], [`PathTracing`], [`closed_form_shader`] |
//! | shadows and interreflection | [`see_material`], [`ShownMaterial`], [`see_material_of_step`], [`ObjectVisibility`], [`VisibilitySettings`] |
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
pub use lobelia_geometry::error::{Error, Result};
pub use lobelia_world::pipeline::SystemResult;

// The pipeline and its pools.
pub use lobelia_world::material::{TexelIndex, Texels};
pub use lobelia_world::pipeline::pool::{read_column, write_column};
pub use lobelia_world::pipeline::{
    GatherPoints, Phase, Pipeline, Plugin, ScatterAdjoints, Shader, Slot, Stage,
};
pub use lobelia_world::sample::pixel::SampleIndex;
pub use lobelia_world::sample::{Observation, ObservationIndex, Samples};

// Surfaces and views.
pub use lobelia_geometry::mesh::Surface;
pub use lobelia_geometry::mesh::primitive::{box_mesh, sphere_mesh};
pub use lobelia_geometry::mesh::triangles::Mesh;
pub use lobelia_geometry::view::{Camera, Image, Mask, Photograph, Split, StoredMask, ViewIndex, ViewRecord};

// Light.
pub use lobelia_world::light::convention::MapConvention;
pub use lobelia_world::light::illuminate::MapLight;
pub use lobelia_world::light::lights::{LightChoice, LightName, LobeOf, provide_light, spawn_light};
pub use lobelia_world::light::map_fit::{MapFit, fit_map};
pub use lobelia_world::light::{EnvironmentMap, LightLobe, render_lobes};

// Material and edits.
pub use lobelia_world::material::edit::{EditAction, EditName, EditOrder, EditRegion, EditTarget};
pub use lobelia_world::material::shown::{Composition, recovered_changed, show_edited, show_recovered};
pub use lobelia_world::material::{
    BaseMaterial, DiffuseAlbedo, DiffuseSheen, DiffuseTilt, Shown, SpecularBlend, SpecularLobe,
};

// Rendering.
pub use lobelia_geometry::view::Frame;
pub use lobelia_io::codec::tone::{Look, save_png};
pub use lobelia_sg::accurate::Quality;
pub use lobelia_sg::shading::ClosedForm;
pub use lobelia_solve::fit::systems::closed_form_shader;
pub use lobelia_solve::shade::frame::{FramePlugin, frame_material, render_frame, resolve};
pub use lobelia_solve::shade::{PathTracing, shade_closed_form, shade_path_traced};
pub use lobelia_solve::visibility::{ObjectVisibility, VisibilitySettings};
pub use lobelia_solve::visibility::{see_material, see_material_of_step};
pub use lobelia_world::material::material_source::ShownMaterial;
pub use lobelia_world::sample::spawn_object;

// Fitting.
pub use lobelia_geometry::view::spawn_views;
pub use lobelia_solve::fit::components::Unknowns;
pub use lobelia_solve::fit::run::{FitOptions, FitPlugin, FitProgress, FitSummary, Initialize, run_fit};

// Other crates. The derive macros of bevy_ecs look for a crate or module of that name.
pub use bevy_ecs;
pub use bevy_ecs::prelude::*;
pub use bevy_ecs::schedule::ScheduleLabel;
pub use glam::Vec3;
pub use std::sync::Arc;
