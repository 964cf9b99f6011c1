//! One world, two ways to shade it: a box on a slab in closed form, then path traced, by a swap of
//! one system. Only the second picture has the box's shadow: the closed form gets it from a system
//! in a slot of its own, `see_material`.
//!
//! `cargo run --release --example swap_shading` writes two pictures under `out/examples/`.

use lobelia::prelude::*;

/// Camera rays a pixel.
const RAYS: u32 = 4;

fn main() -> Result<()> {
    let mut pipeline = small_world()?;
    let camera = Camera::look_at(Vec3::new(1.6, 1.2, 2.0), Vec3::ZERO, Vec3::Y, 38.0, 160, 160)?;

    // The plugin put the accurate closed form into the slot.
    let closed_form = resolve(&render_frame(&mut pipeline, camera, RAYS)?);

    // 4 rays × 32 paths = 128 paths a pixel.
    let paths = PathTracing { paths_per_sample: 32, max_bounces: 4, seed: 0, samples_per_pixel: RAYS };
    pipeline.swap(Phase::Frame, Slot::Shading, shade_path_traced(paths));
    let traced = resolve(&render_frame(&mut pipeline, camera, RAYS)?);

    write("swap_shading_closed_form", &closed_form)?;
    write("swap_shading_path_traced", &traced)?;
    println!("mean radiance: closed form {:.4}, path traced {:.4}", mean(&closed_form), mean(&traced));
    Ok(())
}

/// A gray glossy box on a slab, under a sky and a lamp.
fn small_world() -> Result<Pipeline> {
    let slab = box_mesh(Vec3::new(0.0, -0.4, 0.0), Vec3::new(1.6, 0.1, 1.6))?;
    let on_slab = box_mesh(Vec3::ZERO, Vec3::new(0.5, 0.7, 0.4))?;
    // Both use the whole texture, which is of one color.
    let surface = Arc::new(Surface::new(joined(slab, &on_slab), 64)?);
    let albedo = vec![Vec3::new(0.5, 0.45, 0.4); surface.atlas().position.len()];
    let light = [
        LightLobe { axis: Vec3::Y, sharpness: 0.8, amplitude: Vec3::new(0.4, 0.45, 0.55) },
        LightLobe { axis: Vec3::new(-0.6, 0.64, 0.48), sharpness: 60.0, amplitude: Vec3::splat(12.0) },
    ];
    let mut pipeline = Pipeline::new();
    pipeline.add_plugin(&FramePlugin);
    let material = SpecularLobe::new(Vec3::splat(0.1), 0.3);
    spawn_object(&mut pipeline.world, &surface, &albedo, &[material], &light);
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
    let path = format!("out/examples/{name}.png");
    save_png(&path, frame, &Look::default())?;
    println!("{path}");
    Ok(())
}
