//! Names for systems, slots and components of one's own, beside those of [`prelude`](crate::prelude)
//! and of bevy's own prelude.
//!
//! | group | names |
//! | --- | --- |
//! | the pipeline | [`Pipeline`], [`Plugin`], [`Phase`], [`Stage`], [`Slot`], [`GatherPoints`], [`ScatterAdjoints`], [`Shader`], [`SystemResult`] |
//! | pools | [`Texels`], [`Samples`], [`TexelIndex`], [`SampleIndex`], [`Observation`], [`ObservationIndex`], [`read_column`], [`write_column`] |
//! | views | [`ViewIndex`], [`Photograph`], [`StoredMask`], [`Image`], [`Mask`], [`spawn_views`] |
//! | lights in a world | [`spawn_light`], [`provide_light`], [`LightChoice`], [`LightName`], [`LobeOf`], [`MapLight`], [`MapConvention`], [`render_lobes`], [`fit_map`], [`MapFit`] |
//! | material in a world | [`SpecularBlend`], [`BaseMaterial`], [`Shown`], [`show_recovered`], [`show_edited`], [`Composition`], [`recovered_changed`], [`frame_material`] |
//! | edits | [`EditName`], [`EditOrder`], [`EditTarget`], [`EditAction`], [`EditRegion`] |
//! | rendering | [`spawn_object`], [`FramePlugin`], [`render_frame`], [`resolve`] |
//! | shading | [`shade_closed_form`], [`ClosedForm`], [`Quality`], [`shade_path_traced`], [`PathTracing`], [`closed_form_shader`] |
//! | shadows and interreflection | [`see_shown`], [`see_recovered`], [`see_recovered_of_step`], [`ObjectVisibility`], [`VisibilitySettings`] |
//! | fitting | [`FitPlugin`], [`run_fit`], [`FitOptions`], [`Unknowns`], [`Initialize`], [`FitProgress`], [`FitSummary`] |
//!
//! The first page of the [crate] shows how they go together.

// Bevy's prelude has another.
pub use lobelia_geometry::Result;
pub use lobelia_geometry::view::{Image, Mask, Photograph, StoredMask, ViewIndex, spawn_views};
pub use lobelia_sg::{accurate::Quality, shading::ClosedForm};
pub use lobelia_solve::fit::components::Unknowns;
pub use lobelia_solve::fit::run::{FitOptions, FitPlugin, FitProgress, FitSummary, Initialize, run_fit};
pub use lobelia_solve::fit::systems::closed_form_shader;
pub use lobelia_solve::shade::frame::{FramePlugin, frame_material, render_frame, resolve};
pub use lobelia_solve::shade::{PathTracing, shade_closed_form, shade_path_traced};
pub use lobelia_solve::visibility::{
    ObjectVisibility, VisibilitySettings, see_recovered, see_recovered_of_step, see_shown,
};
pub use lobelia_world::light::lights::{LightChoice, LightName, LobeOf, provide_light, spawn_light};
pub use lobelia_world::light::map_fit::{MapFit, fit_map};
pub use lobelia_world::light::{convention::MapConvention, illuminate::MapLight, render_lobes};
pub use lobelia_world::material::edit::{EditAction, EditName, EditOrder, EditRegion, EditTarget};
pub use lobelia_world::material::shown::{Composition, recovered_changed, show_edited, show_recovered};
pub use lobelia_world::material::{BaseMaterial, Shown, SpecularBlend, TexelIndex, Texels};
pub use lobelia_world::pipeline::pool::{read_column, write_column};
pub use lobelia_world::pipeline::{
    GatherPoints, Phase, Pipeline, Plugin, ScatterAdjoints, Shader, Slot, Stage, SystemResult,
};
pub use lobelia_world::sample::pixel::SampleIndex;
pub use lobelia_world::sample::{Observation, ObservationIndex, Samples, spawn_object};

// The derive macros of bevy_ecs look for a crate or module of that name.
pub use bevy_ecs;
pub use bevy_ecs::prelude::*;
pub use bevy_ecs::schedule::ScheduleLabel;
