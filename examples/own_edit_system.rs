//! An edit of one's own: an ordinary bevy_ecs system that paints stripes by height, run on the world between two frames.
//!
//! `cargo run --release --example own_edit_system` writes two pictures under `out/examples/`.

use bevy_ecs::prelude::{IntoSystem, Query, Res, Resource, System};
use glam::Vec3;
use lobelia::light::LightLobe;
use lobelia::material::{DiffuseAlbedo, SpecularBlend, SpecularLobe};
use lobelia::mesh::Surface;
use lobelia::mesh::primitive::sphere_mesh;
use lobelia::pass::render::resolve;
use lobelia::pipeline::Pipeline;
use lobelia::report::tone::{Backdrop, Look, Picture, write_png};
use lobelia::shade::Scenery;
use lobelia::shade::frame::{FramePlugin, render_frame};
use lobelia::view::Camera;
use lobelia::{Error, Result};
use std::sync::Arc;

/// The surface, where the edit can see it: row i of the texel pool is texel i of the atlas.
#[derive(Resource)]
struct Painted(Arc<Surface>);

/// The edit. Its parameters are what it queries; nothing else in the pipeline knows of it.
fn paint_stripes(surface: Res<Painted>, mut texels: Query<&mut DiffuseAlbedo>) {
    let positions = &surface.0.atlas().position;
    for (mut albedo, position) in texels.iter_mut().zip(positions) {
        if (position.y / 0.2).floor().rem_euclid(2.0) == 0.0 {
            albedo.0 = albedo.0.lerp(Vec3::new(0.8, 0.5, 0.1), 0.9);
        }
    }
}

fn main() -> Result<()> {
    let surface = Arc::new(Surface::new(sphere_mesh(Vec3::ZERO, 0.8)?, 256)?);
    let mut pipeline = Pipeline::new();
    pipeline.add_plugin(&FramePlugin);
    let texel = (DiffuseAlbedo(Vec3::new(0.15, 0.25, 0.5)), SpecularBlend::default());
    pipeline.world.spawn_batch(vec![texel; surface.atlas().position.len()]);
    pipeline.world.spawn(SpecularLobe::new(Vec3::splat(0.1), 0.3));
    pipeline.world.spawn_batch([
        LightLobe { axis: Vec3::Y, sharpness: 0.8, amplitude: Vec3::splat(0.5) },
        LightLobe { axis: Vec3::new(0.6, 0.64, 0.48), sharpness: 30.0, amplitude: Vec3::splat(4.0) },
    ]);
    pipeline.world.insert_resource(Scenery(surface.clone()));
    pipeline.world.insert_resource(Painted(surface));

    picture(&mut pipeline, "own_edit_before")?;
    run_once(&mut pipeline, paint_stripes)?;
    picture(&mut pipeline, "own_edit_after")
}

/// Runs one system on the world, outside of any schedule.
fn run_once<M>(pipeline: &mut Pipeline, system: impl IntoSystem<(), (), M>) -> Result<()> {
    let mut system = IntoSystem::into_system(system);
    system.initialize(&mut pipeline.world);
    system.run((), &mut pipeline.world).map_err(|error| Error::run("the edit", error.to_string()))
}

fn picture(pipeline: &mut Pipeline, name: &str) -> Result<()> {
    let camera = Camera::look_at(Vec3::new(0.0, 0.6, 2.5), Vec3::ZERO, Vec3::Y, 38.0, 160, 160)?;
    let frame = resolve(&render_frame(pipeline, camera, 9)?);
    std::fs::create_dir_all("out/examples").map_err(Error::io("create", "out/examples"))?;
    let path = format!("out/examples/{name}.png");
    let picture =
        Picture { width: frame.width, height: frame.height, color: &frame.color, alpha: &frame.alpha };
    write_png(&path, &picture, &Look::default(), Backdrop::Transparent)?;
    println!("{path}");
    Ok(())
}
