//! One world, two lights: the scene's own lobes, then a named light with an environment map, by a
//! swap of the light's system.
//!
//! `cargo run --release --example swap_light` writes two pictures under `out/examples/`.

use lobelia::prelude::*;

fn main() -> Result<()> {
    let surface = Arc::new(Surface::new(sphere_mesh(Vec3::ZERO, 0.8)?, 64)?);
    let mut pipeline = Pipeline::new();
    pipeline.add_plugin(&FramePlugin);
    let albedo = vec![Vec3::new(0.3, 0.1, 0.08); surface.atlas().position.len()];
    let material = SpecularLobe::new(Vec3::splat(0.5), 0.2);

    // First light: lobes that are of no named light. The plugin's choice for the slot shows these.
    let lamp = LightLobe { axis: Vec3::new(0.6, 0.64, 0.48), sharpness: 40.0, amplitude: Vec3::splat(6.0) };
    spawn_object(&mut pipeline.world, &surface, &albedo, &[material], &[lamp]);
    picture(&mut pipeline, "swap_light_lobes")?;

    // Second light: a map. The path tracer would sample the map itself, closed forms take the lobes
    // fitted to it.
    let sky = evening_sky();
    let fitted = fit_map(&sky, 16, &MapFit::default())?;
    spawn_light(&mut pipeline.world, "evening", &fitted.lobes, Some(Arc::new(MapLight::new(sky))));
    pipeline.swap(Phase::Compose, Slot::Light, provide_light(LightChoice::Named("evening".into()), true));
    picture(&mut pipeline, "swap_light_map")
}

/// A blue dome over a dark ground, with a low orange sun; any EXR or HDR file would do
/// (`codec::envmap::read_map`).
fn evening_sky() -> EnvironmentMap {
    EnvironmentMap::from_directions(128, 64, |omega| {
        let dome = Vec3::new(0.1, 0.2, 0.5) * omega.y.max(0.0) + Vec3::new(0.05, 0.04, 0.03);
        let towards_sun = omega.dot(Vec3::new(-0.8, 0.2, 0.566).normalize());
        dome + Vec3::new(8.0, 3.0, 0.8) * (60.0 * (towards_sun - 1.0)).exp()
    })
}

fn picture(pipeline: &mut Pipeline, name: &str) -> Result<()> {
    let camera = Camera::look_at(Vec3::new(0.0, 0.3, 2.6), Vec3::ZERO, Vec3::Y, 38.0, 160, 160)?;
    let path = format!("out/examples/{name}.png");
    save_png(&path, &resolve(&render_frame(pipeline, camera, 4)?), &Look::default())?;
    println!("{path}");
    Ok(())
}
