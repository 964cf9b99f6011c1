//! A fit without a scene file and without files written: photographs are made in memory, then light and material are found.
//!
//! `cargo run --release --example fit_in_code`

use bevy_ecs::prelude::World;
use glam::Vec3;
use lobelia::Result;
use lobelia::fit::components::Unknowns;
use lobelia::fit::loss::Loss;
use lobelia::fit::observe::PixelChoice;
use lobelia::fit::run::{FirstGuess, FitOptions, FitPlugin, run_fit};
use lobelia::fit::scale::ScaleRule;
use lobelia::light::LightLobe;
use lobelia::light::fibonacci::{fibonacci_axes, spacing_sharpness};
use lobelia::material::{DiffuseAlbedo, SpecularBlend, SpecularLobe};
use lobelia::math::shading::ClosedForm;
use lobelia::mesh::Surface;
use lobelia::mesh::primitive::sphere_mesh;
use lobelia::pass::render::resolve;
use lobelia::pipeline::Pipeline;
use lobelia::shade::Scenery;
use lobelia::shade::frame::{FramePlugin, render_frame};
use lobelia::view::{Camera, Image, Mask, Photograph, Split, ViewMask, ViewName};
use std::ops::ControlFlow;
use std::sync::Arc;

fn main() -> Result<()> {
    let surface = Arc::new(Surface::new(sphere_mesh(Vec3::ZERO, 0.8)?, 64)?);
    let texels = surface.atlas().position.len();

    // The truth, which only the photographs know. They are taken with the published shading, which the fit inverts exactly;
    // `swap_shading` shows how to take them with the path tracer.
    let (sky, lamp) = (Vec3::splat(0.5), Vec3::new(4.0, 3.6, 3.0));
    let lights = [
        LightLobe { axis: Vec3::Y, sharpness: 0.8, amplitude: sky },
        LightLobe { axis: Vec3::new(0.6, 0.64, 0.48), sharpness: 30.0, amplitude: lamp },
    ];
    let albedo = |p: &Vec3| if p.y > 0.0 { Vec3::new(0.6, 0.2, 0.1) } else { Vec3::new(0.1, 0.2, 0.5) };
    let truth = SpecularLobe::new(Vec3::splat(0.2), 0.3);
    let mut studio = Pipeline::new();
    studio.add_plugin(&FramePlugin);
    fill(&mut studio.world, &surface, surface.atlas().position.iter().map(albedo), lights.to_vec(), truth);

    // A world that starts ignorant: grey, 32 equal lobes, a middling gloss.
    let sharpness = spacing_sharpness(32);
    let guess = |axis| LightLobe { axis, sharpness, amplitude: Vec3::ONE };
    let lobes = fibonacci_axes(32).into_iter().map(guess).collect();
    let start = SpecularLobe::new(Vec3::splat(0.3), 0.45);
    let mut pipeline = Pipeline::new();
    pipeline.add_plugin(&FramePlugin).add_plugin(&FitPlugin);
    fill(&mut pipeline.world, &surface, std::iter::repeat_n(Vec3::splat(0.4), texels), lobes, start);
    for (i, eye) in fibonacci_axes(12).into_iter().enumerate() {
        let up = if eye.y.abs() > 0.99 { Vec3::Z } else { Vec3::Y };
        let camera = Camera::look_at(eye * 2.8, Vec3::ZERO, up, 38.0, 48, 48)?;
        let frame = resolve(&render_frame(&mut studio, camera, 4)?);
        let saturated = vec![false; frame.color.len()];
        let photograph =
            Photograph { image: Image { width: 48, height: 48, pixels: frame.color }, saturated };
        let mask = ViewMask(Mask { width: 48, height: 48, coverage: frame.alpha });
        pipeline.world.spawn((ViewName(format!("view_{i}")), camera, Split::Train, photograph, mask));
    }

    let summary = run_fit(&mut pipeline, &options(), &mut |at, _| {
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

/// Puts an object and a light into a world.
fn fill(
    world: &mut World,
    surface: &Arc<Surface>,
    albedo: impl Iterator<Item = Vec3>,
    lobes: Vec<LightLobe>,
    specular: SpecularLobe,
) {
    let texels: Vec<_> = albedo.map(|a| (DiffuseAlbedo(a), SpecularBlend::default())).collect();
    world.spawn_batch(texels);
    world.spawn_batch(lobes);
    world.spawn(specular);
    world.insert_resource(Scenery(surface.clone()));
}

fn options() -> FitOptions {
    FitOptions {
        form: ClosedForm::default(),
        loss: Loss::L1,
        steps: 300,
        batch: 1024,
        rates: [0.05, 0.02, 0.01],
        milestones: vec![0.5, 0.75, 0.9],
        decay: 0.4,
        unknowns: Unknowns {
            albedo: true,
            light: true,
            specular_albedo: true,
            mono_specular: true,
            roughness: true,
            blends: false,
        },
        pixels: PixelChoice { seed: 0, max_pixels: 100_000 },
        guess: FirstGuess::ALL,
        visibility: false,
        exposure: false,
        scale: ScaleRule::default(),
    }
}
