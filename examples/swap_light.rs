//! One world, two lights: lobes that live in it as entities, then an environment map, by a swap of the light's provider.
//!
//! `cargo run --release --example swap_light` writes two pictures under `out/examples/`.

use glam::Vec3;
use lobelia::Result;
use lobelia::light::illuminate::MapLight;
use lobelia::light::map_fit::{MapFit, fit_map};
use lobelia::light::{EnvironmentMap, LightLobe};
use lobelia::material::{DiffuseAlbedo, SpecularBlend, SpecularLobe};
use lobelia::math::shading::LobeColumns;
use lobelia::mesh::Surface;
use lobelia::mesh::primitive::sphere_mesh;
use lobelia::pass::render::resolve;
use lobelia::pipeline::{Phase, Pipeline, Slot};
use lobelia::report::tone::{Backdrop, Look, Picture, write_png};
use lobelia::shade::frame::{FramePlugin, render_frame};
use lobelia::shade::systems::kernel_lobe;
use lobelia::shade::{DistantLight, Scenery, provide_distant};
use lobelia::view::Camera;
use std::sync::Arc;

fn main() -> Result<()> {
    let surface = Arc::new(Surface::new(sphere_mesh(Vec3::ZERO, 0.8)?, 64)?);
    let mut pipeline = Pipeline::new();
    pipeline.add_plugin(&FramePlugin);
    let texel = (DiffuseAlbedo(Vec3::new(0.3, 0.1, 0.08)), SpecularBlend::default());
    pipeline.world.spawn_batch(vec![texel; surface.atlas().position.len()]);
    pipeline.world.spawn(SpecularLobe::new(Vec3::splat(0.5), 0.2));
    pipeline.world.insert_resource(Scenery(surface));

    // First light: entities, which `provide_lobes` (the plugin's choice) collects before each frame.
    let lamp = LightLobe { axis: Vec3::new(0.6, 0.64, 0.48), sharpness: 40.0, amplitude: Vec3::splat(6.0) };
    pipeline.world.spawn(lamp);
    picture(&mut pipeline, "swap_light_lobes")?;

    // Second light: a map. The path tracer would sample the map itself, closed-form shading takes the lobes fitted to it.
    let sky = evening_sky();
    let fitted = fit_map(&sky, 16, &MapFit::default())?;
    pipeline.world.insert_resource(DistantLight {
        lobes: LobeColumns::from_lobes(fitted.lobes.iter().map(kernel_lobe)),
        light: Arc::new(MapLight::new(sky)),
    });
    pipeline.swap(Phase::Frame, Slot::Light, provide_distant);
    picture(&mut pipeline, "swap_light_map")
}

/// A blue dome over a dark ground, with a low orange sun; any EXR or HDR file would do (`EnvironmentMap::read`).
fn evening_sky() -> EnvironmentMap {
    EnvironmentMap::from_directions(128, 64, |omega| {
        let dome = Vec3::new(0.1, 0.2, 0.5) * omega.y.max(0.0) + Vec3::new(0.05, 0.04, 0.03);
        let towards_sun = omega.dot(Vec3::new(-0.8, 0.2, 0.566).normalize());
        dome + Vec3::new(8.0, 3.0, 0.8) * (60.0 * (towards_sun - 1.0)).exp()
    })
}

fn picture(pipeline: &mut Pipeline, name: &str) -> Result<()> {
    let camera = Camera::look_at(Vec3::new(0.0, 0.3, 2.6), Vec3::ZERO, Vec3::Y, 38.0, 160, 160)?;
    let frame = resolve(&render_frame(pipeline, camera, 4)?);
    std::fs::create_dir_all("out/examples").map_err(lobelia::Error::io("create", "out/examples"))?;
    let path = format!("out/examples/{name}.png");
    let picture =
        Picture { width: frame.width, height: frame.height, color: &frame.color, alpha: &frame.alpha };
    write_png(&path, &picture, &Look::default(), Backdrop::Transparent)?;
    println!("{path}");
    Ok(())
}
