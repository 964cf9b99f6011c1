//! A fit without a scene file and without files written: photographs are made in memory, then light
//! and material are found.
//!
//! `cargo run --release --example fit_in_code`

use lobelia::prelude::*;
use std::ops::ControlFlow;

/// Side of the photographs, pixels.
const SIZE: u32 = 48;

fn main() -> Result<()> {
    let surface = Arc::new(Surface::new(sphere_mesh(Vec3::ZERO, 0.8)?, 64)?);
    let truth = SpecularLobe::new(Vec3::splat(0.2), 0.3);
    let photographs = photographs_of(&surface, truth)?;

    // A world that starts ignorant: gray, 32 equal lobes, a middling roughness.
    let mut pipeline = Pipeline::new();
    pipeline.add_plugin(&FramePlugin).add_plugin(&FitPlugin);
    let gray = vec![Vec3::splat(0.4); surface.atlas().position.len()];
    let start = SpecularLobe::new(Vec3::splat(0.3), 0.45);
    spawn_object(&mut pipeline.world, &surface, &gray, &[start], &LightLobe::even(32));
    spawn_views(&mut pipeline.world, photographs);
    let summary = run_fit(&mut pipeline, &FitOptions::default(), &mut |at, _| {
        if at.step.is_multiple_of(50) {
            let psnr = at.sums.psnr();
            println!("step {:3}: {psnr:.1} dB, roughness {:.3}", at.step, at.specular.roughness);
        }
        // `Break` would end the fit here and keep what it has.
        ControlFlow::Continue(())
    })?;
    println!(
        "{} pixels, {:.2} s; the true roughness is {}",
        summary.pixels, summary.elapsed_secs, truth.roughness
    );
    Ok(())
}

/// Photographs of the truth, which only they know: an object of two colors under two lights. They
/// are taken with the closed form that the fit inverts; `swap_shading` shows how to take them with
/// the path tracer.
fn photographs_of(surface: &Arc<Surface>, gloss: SpecularLobe) -> Result<Vec<ViewRecord>> {
    let light = [
        LightLobe { axis: Vec3::Y, sharpness: 0.8, amplitude: Vec3::splat(0.5) },
        LightLobe { axis: Vec3::new(0.6, 0.64, 0.48), sharpness: 30.0, amplitude: Vec3::new(4.0, 3.6, 3.0) },
    ];
    let two_colors = |p: &Vec3| if p.y > 0.0 { Vec3::new(0.6, 0.2, 0.1) } else { Vec3::new(0.1, 0.2, 0.5) };
    let albedo: Vec<Vec3> = surface.atlas().position.iter().map(two_colors).collect();
    let mut studio = Pipeline::new();
    studio.add_plugin(&FramePlugin);
    spawn_object(&mut studio.world, surface, &albedo, &[gloss], &light);
    let cameras = Camera::around(12, 2.8, 38.0, SIZE)?.into_iter().enumerate();
    cameras.map(|(i, camera)| photograph(&mut studio, format!("view_{i}"), camera)).collect()
}

/// Renders the studio through a camera.
fn photograph(studio: &mut Pipeline, name: String, camera: Camera) -> Result<ViewRecord> {
    let frame = resolve(&render_frame(studio, camera, 4)?);
    let image = Image { width: SIZE, height: SIZE, pixels: frame.color };
    let mask = Mask { width: SIZE, height: SIZE, coverage: frame.alpha };
    let (photograph, mask) = (Some(Photograph::of_image(&image)), Some(StoredMask::new(&mask)));
    Ok(ViewRecord { photograph, mask, ..ViewRecord::of_camera(name, Split::Train, camera) })
}
