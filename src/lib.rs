//! Lobelia is an inverse renderer: from photographs with known cameras it recovers albedo, specular
//! material, environment light and, where it is unknown, the shape of an object. Light is a set of
//! spherical Gaussians, and shading by them is in closed form, with analytic gradients. Everything
//! in flight is entities and components of one [`bevy_ecs`] world, so that editing, relighting and
//! choosing a renderer are changes to the world or swaps of one system.
//!
//! ```
//! use lobelia::{ecs::*, prelude::*};
//!
//! let surface = Arc::new(Surface::new(sphere_mesh(Vec3::ZERO, 0.8)?, 16)?);
//! let albedo = vec![Vec3::splat(0.5); surface.atlas().position.len()];
//! let lamp = |axis| LightLobe { axis, sharpness: 4.0, amplitude: Vec3::ONE };
//! let mut pipeline = Pipeline::new();
//! pipeline.add_plugin(&FramePlugin);
//! let material = SpecularLobe::new(Vec3::splat(0.04), 0.5);
//! spawn_object(&mut pipeline.world, &surface, &albedo, &[material], &[lamp(Vec3::Y)]);
//! let camera = Camera::look_at(Vec3::new(0.0, 3.0, 0.1), Vec3::ZERO, Vec3::Y, 38.0, 16, 16)?;
//! let day = resolve(&render_frame(&mut pipeline, camera, 1)?);
//! spawn_light(&mut pipeline.world, "below", &[lamp(Vec3::NEG_Y)], None);
//! pipeline.swap(Phase::Compose, Slot::Light, provide_light(LightChoice::Named("below".into()), false));
//! let night = resolve(&render_frame(&mut pipeline, camera, 1)?);
//! assert!(day.color[8 * 16 + 8].y > 10.0 * night.color[8 * 16 + 8].y);
//! # Ok::<(), lobelia::Error>(())
//! ```
//!
//! # Modules
//!
//! In the order in which data goes through them:
//!
//! | module | holds |
//! | --- | --- |
//! | [`scene`] | scene files: their types, reading and checks |
//! | [`dataset`] | folders of photographs with cameras, in several layouts |
//! | [`codec`] | file formats of images, environment maps, lobes and meshes |
//! | [`view`] | cameras, photographs, masks |
//! | [`mesh`], [`sdf`] | surfaces: triangles with a texel atlas; signed distance fields |
//! | [`light`] | lobes, environment maps, named lights, and maps fitted by lobes |
//! | [`material`] | texels, base materials, edits, and the material that is shown |
//! | [`progress`] | what long work says, and who hears it |
//! | [`spawn`] | from a scene, or from values in code, to entities |
//! | [`pipeline`] | phases, stages, slots, plugins, and pools of entities as slices |
//! | [`checkpoint`] | what a run goes on from after it was killed |
//! | [`sample`] | pixel samples: rays, surface points, windows |
//! | [`visibility`] | shadows and interreflection for closed forms |
//! | [`shade`] | the Frame phase: closed forms and the path tracer |
//! | [`fit`] | the fit of light and material |
//! | [`shape`] | the fit of the shape |
//! | [`report`] | pictures, contact sheets, scores |
//! | [`page`] | the page that shows the object in a browser |
//! | [`survey`] | what of a data set cannot work, before a run |
//! | [`prepare`] | from photographs without cameras to a data set and a scene file |
//! | [`capture`] | photographs with cameras, as a program reads or makes them |
//! | [`object`] | an object with its surface, material, light and photographs: how it is found and shown |
//! | [`pass`] | the passes of a scene file |
//! | [`sg`] | the kernels under all of these, from the crate `lobelia-sg` |
//! | [`error`] | the one error type |
//!
//! # Dependencies
//!
//! The command is the crate `lobelia-cli`; a program that uses the library needs none of it.
//! [`bevy_ecs`] and [`glam`] are exported, so that it needs no versions of its own that match;
//! derive macros such as `Component` work where [`ecs`] is imported.
//!
//! # The manual
//!
//! The folder `docs/src` holds the manual. *Getting started* and *Scene files* are about the
//! command; *The method*, *Spherical Gaussians and shading*, *The fit* and *Shape and cameras* have
//! the equations; *Conventions* has axes, units and parametrizations; *Extending Lobelia* is the
//! guide to systems, slots and plugins of your own. The folder `examples` has short programs.

pub mod capture;
pub mod ecs;
pub mod object;
pub mod page;
pub mod pass;
pub mod prelude;
pub mod prepare;
pub mod progress;
pub mod report;
pub mod scene;
pub mod spawn;
pub mod survey;

use std::sync::OnceLock;

pub use bevy_ecs;
pub use glam;
pub use lobelia_geometry::{Error, Result, error, mesh, sdf, view};
pub use lobelia_io::{codec, dataset};
pub use lobelia_sg as sg;
pub use lobelia_solve::{fit, shade, shape, visibility};
pub use lobelia_world::{checkpoint, light, material, pipeline, sample};

static VERSION: OnceLock<String> = OnceLock::new();

/// Version in manifests, reports and checkpoints: that of this crate, or of the program that called
/// [`set_version`].
pub fn version() -> &'static str {
    VERSION.get().map_or(env!("CARGO_PKG_VERSION"), String::as_str)
}

/// Names the version of the program, once and before its first run. A commit in it does not compile
/// this crate again.
pub fn set_version(version: &str) {
    VERSION.get_or_init(|| version.to_owned());
}

/// The `rust` blocks of the README, compiled as doctests.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
pub struct ReadmeDoctests;

/// The `rust` blocks of the manual's chapter on extensions, compiled as doctests.
#[cfg(doctest)]
#[doc = include_str!("../docs/src/extending.md")]
pub struct ExtendingDoctests;
