//! One world, two ways to shade it: a box on a slab with the published SG formulas, then path traced, by a swap of one system.
//! Only the second picture has the box's shadow.
//!
//! `cargo run --release --example swap_shading` writes two pictures under `out/examples/`.

use glam::Vec3;
use lobelia::Result;
use lobelia::codec::frame::Frame;
use lobelia::light::LightLobe;
use lobelia::material::{DiffuseAlbedo, SpecularBlend, SpecularLobe};
use lobelia::mesh::Surface;
use lobelia::mesh::primitive::box_mesh;
use lobelia::mesh::triangles::Mesh;
use lobelia::pass::render::resolve;
use lobelia::pipeline::{Phase, Pipeline, Slot};
use lobelia::report::tone::{Backdrop, Look, Picture, write_png};
use lobelia::shade::frame::{FramePlugin, render_frame};
use lobelia::shade::{PathTracing, Scenery, shade_path_traced};
use lobelia::view::Camera;
use std::sync::Arc;

fn main() -> Result<()> {
    let mut pipeline = small_world()?;
    let camera = Camera::look_at(Vec3::new(1.6, 1.2, 2.0), Vec3::ZERO, Vec3::Y, 38.0, 160, 160)?;
    const RAYS_PER_PIXEL: u32 = 4;

    // The plugin put the published formulas into the slot.
    let published = resolve(&render_frame(&mut pipeline, camera, RAYS_PER_PIXEL)?);

    // 4 rays × 32 paths = 128 paths a pixel; the path tracer reads its settings from a resource.
    pipeline.world.insert_resource(PathTracing {
        paths_per_sample: 32,
        max_bounces: 4,
        seed: 0,
        samples_per_pixel: RAYS_PER_PIXEL,
    });
    pipeline.swap(Phase::Frame, Slot::Shading, shade_path_traced);
    let traced = resolve(&render_frame(&mut pipeline, camera, RAYS_PER_PIXEL)?);

    write("swap_shading_published", &published)?;
    write("swap_shading_path_traced", &traced)?;
    println!("mean radiance: published {:.4}, path traced {:.4}", mean(&published), mean(&traced));
    Ok(())
}

/// A grey glossy box on a slab, under a sky and a lamp.
fn small_world() -> Result<Pipeline> {
    let slab = box_mesh(Vec3::new(0.0, -0.4, 0.0), Vec3::new(1.6, 0.1, 1.6))?;
    let on_slab = box_mesh(Vec3::ZERO, Vec3::new(0.5, 0.7, 0.4))?;
    // Both use the whole texture, which is of one colour.
    let surface = Arc::new(Surface::new(joined(slab, &on_slab), 64)?);
    let mut pipeline = Pipeline::new();
    pipeline.add_plugin(&FramePlugin);
    let world = &mut pipeline.world;
    let texel = (DiffuseAlbedo(Vec3::new(0.5, 0.45, 0.4)), SpecularBlend::default());
    world.spawn_batch(vec![texel; surface.atlas().position.len()]);
    world.spawn(SpecularLobe::new(Vec3::splat(0.1), 0.3));
    world.spawn_batch([
        LightLobe { axis: Vec3::Y, sharpness: 0.8, amplitude: Vec3::new(0.4, 0.45, 0.55) },
        LightLobe { axis: Vec3::new(-0.6, 0.64, 0.48), sharpness: 60.0, amplitude: Vec3::splat(12.0) },
    ]);
    world.insert_resource(Scenery(surface));
    Ok(pipeline)
}

fn joined(mut mesh: Mesh, other: &Mesh) -> Mesh {
    let shift = mesh.positions.len() as u32;
    mesh.positions.extend(&other.positions);
    mesh.normals.extend(&other.normals);
    mesh.triangles.extend(other.triangles.iter().map(|corners| corners.map(|corner| corner + shift)));
    if let (Some(uvs), Some(others)) = (&mut mesh.uvs, &other.uvs) {
        uvs.extend(others);
    }
    mesh
}

fn mean(frame: &Frame) -> f32 {
    let covered: f32 = frame.alpha.iter().sum();
    frame.color.iter().map(|color| color.element_sum() / 3.0).sum::<f32>() / covered
}

fn write(name: &str, frame: &Frame) -> Result<()> {
    std::fs::create_dir_all("out/examples").map_err(lobelia::Error::io("create", "out/examples"))?;
    let path = format!("out/examples/{name}.png");
    let picture =
        Picture { width: frame.width, height: frame.height, color: &frame.color, alpha: &frame.alpha };
    write_png(&path, &picture, &Look::default(), Backdrop::Transparent)?;
    println!("{path}");
    Ok(())
}
