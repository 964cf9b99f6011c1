//! One object under another light, with another material, and path traced. Each picture is a swap
//! of systems, and nothing is copied; the object stays what it is.
//!
//! `cargo run --release --example relight_and_edit -- SCENE.ron` shows an object that was saved, and
//! writes pictures to `out/examples`.

use lobelia::prelude::*;
use lobelia::scene::Shading;

fn main() -> Result<()> {
    let studio = concat!(env!("CARGO_MANIFEST_DIR"), "/examples/studio.ron");
    let path = std::env::args().nth(1).unwrap_or_else(|| studio.to_owned());
    let mut object = Object::open(path)?;
    let camera = Camera::look_at(Vec3::new(0.0, 0.3, 2.6), Vec3::ZERO, Vec3::Y, 38.0, 160, 160)?;
    picture("as_found", object.render(camera)?)?;

    // A low evening sun; `Light::map("sky.hdr")` reads one from a file.
    let sun =
        LightLobe { axis: Vec3::new(-0.8, 0.2, 0.57), sharpness: 60.0, amplitude: Vec3::new(8.0, 3.0, 0.8) };
    let sky = LightLobe { axis: Vec3::Y, sharpness: 1.0, amplitude: Vec3::new(0.1, 0.2, 0.5) };
    let evening = Light::of_lobes(vec![sun, sky]);
    picture("evening", object.relit(&evening).render(camera)?)?;
    picture("gold", object.edited([Edit::metal("#d4af37", 0.2)?]).render(camera)?)?;
    object.relit(&evening).edited([Edit::plastic("#a02018", 0.1)?]).export("out/examples/red.glb")?;

    let shading = Shading::PathTraced { spp: 64, max_bounces: 4, map: true };
    let traced = RenderSettings { shading, ..RenderSettings::default() };
    picture("path_traced", object.relit(&evening).rendered_by(traced).render(camera)?)
}

fn picture(name: &str, frame: Frame) -> Result<()> {
    let path = format!("out/examples/{name}.png");
    println!("{path}");
    save_png(&path, &frame, &Look::default())
}
