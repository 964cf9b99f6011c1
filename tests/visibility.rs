//! Shadows and reflections in closed form, against the path tracer that finds them ray by ray.

use crate::common::{camera, evening};
use glam::{Vec2, Vec3};
use lobelia::codec::exr_frame::Frame;
use lobelia::light::LightLobe;
use lobelia::material::SpecularLobe;
use lobelia::mesh::Surface;
use lobelia::mesh::primitive::{box_mesh, sphere_mesh};
use lobelia::mesh::triangles::Mesh;
use lobelia::pipeline::{Phase, Pipeline, Slot};
use lobelia::shade::frame::{FramePlugin, render_frame, resolve};
use lobelia::shade::{PathTracing, shade_path_traced};
use lobelia::spawn::spawn_object;
use lobelia::visibility::{FrameVisibilityPlugin, ObjectVisibility, VisibilitySettings};
use std::sync::Arc;

/// A ball that floats over a slab; each has half of the texture.
fn ball_over_slab() -> Mesh {
    let mut mesh = box_mesh(Vec3::new(0.0, -0.5, 0.0), Vec3::new(1.4, 0.2, 1.4)).unwrap();
    let ball = sphere_mesh(Vec3::new(0.0, 0.1, 0.0), 0.35).unwrap();
    let offset = mesh.positions.len() as u32;
    mesh.positions.extend(&ball.positions);
    mesh.normals.extend(&ball.normals);
    mesh.triangles.extend(ball.triangles.iter().map(|t| t.map(|v| v + offset)));
    let halves =
        |uvs: &[Vec2], left: f32| uvs.iter().map(|uv| Vec2::new(left + 0.5 * uv.x, uv.y)).collect::<Vec<_>>();
    mesh.uvs = Some([halves(&mesh.uvs.unwrap(), 0.0), halves(&ball.uvs.unwrap(), 0.5)].concat());
    mesh
}

fn studio(lobes: &[LightLobe], specular: SpecularLobe) -> (Pipeline, Arc<Surface>) {
    let surface = Arc::new(Surface::new(ball_over_slab(), 128).unwrap());
    let mut pipeline = Pipeline::new();
    pipeline.add_plugin(&FramePlugin);
    let color = |at: &Vec3| if at.y > -0.35 { Vec3::new(0.8, 0.3, 0.2) } else { Vec3::splat(0.6) };
    let albedo: Vec<Vec3> = surface.atlas().position.iter().map(color).collect();
    spawn_object(&mut pipeline.world, &surface, &albedo, &[specular], lobes);
    (pipeline, surface)
}

fn shoot(pipeline: &mut Pipeline) -> Frame {
    resolve(&render_frame(pipeline, camera([0.6, 0.5, 0.8], 64), 4).unwrap())
}

fn psnr(a: &Frame, b: &Frame) -> f32 {
    let square: f32 = a.color.iter().zip(&b.color).map(|(a, b)| (*a - *b).length_squared()).sum();
    let peak = b.color.iter().map(|c| c.max_element()).fold(0.0, f32::max);
    10.0 * (peak * peak * 3.0 * a.color.len() as f32 / square).log10()
}

#[test]
fn shadows_and_reflections_come_close_to_path_tracing() {
    let gloss = |albedo, roughness| SpecularLobe::new(Vec3::splat(albedo), roughness);
    // What the last mirrors of itself is finer than the directions that are traced for all.
    for (specular, least, gain) in
        [(gloss(0.04, 0.6), 34.0, 6.0), (gloss(0.3, 0.3), 32.0, 6.0), (gloss(0.8, 0.12), 36.0, 5.0)]
    {
        let (mut pipeline, surface) = studio(&evening(), specular);
        let plain = shoot(&mut pipeline);
        pipeline
            .world
            .insert_resource(ObjectVisibility::new(&surface, VisibilitySettings::default(), None).unwrap());
        pipeline.add_plugin(&FrameVisibilityPlugin);
        let shadowed = shoot(&mut pipeline);
        pipeline.remove_plugin::<FrameVisibilityPlugin>();
        assert_eq!(shoot(&mut pipeline), plain, "taken out again, nothing of it stays");
        let paths = PathTracing { paths_per_sample: 64, max_bounces: 4, seed: 1, samples_per_pixel: 4 };
        pipeline.swap(Phase::Frame, Slot::Shading, shade_path_traced(paths));
        let truth = shoot(&mut pipeline);
        let (without, with) = (psnr(&plain, &truth), psnr(&shadowed, &truth));
        println!("R {}: {without} dB without, {with} dB with", specular.roughness);
        assert!(with > least && with > without + gain, "{without} dB without, {with} dB with");
    }
}
