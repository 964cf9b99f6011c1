//! A shader of one's own in a fit: diffuse light and a Phong lobe, under light lobes that count as
//! lamps far away. By its adjoint, photographs that it has rendered itself give back the albedo and
//! the lobe.
//!
//! `cargo run --release --example own_shader`

use lobelia::light::lights::IncidentLight;
use lobelia::sg::shading::{Layers, LobeColumns, PointAdjoint, RadianceAdjoint, ShadePoint, SpecularAdjoint};
use lobelia::{ecs::*, prelude::*};
use lobelia::{fit::components::StepGradient, material::material_source::BaseMaterials};
use std::{f32::consts::FRAC_1_PI, ops::ControlFlow};

/// The kernel: of each point the diffuse and the specular light for albedos of 1, and the derivative
/// of the latter by the roughness R, with the exponent 1/R².
pub fn phong(points: &[ShadePoint], lamps: &LobeColumns, roughness: f32) -> Vec<[Vec3; 3]> {
    let add_lamp = |point: &ShadePoint, sums: [Vec3; 3], i: usize| {
        let (axis, light) = (Vec3::from(lamps.get(i).axis), Vec3::from(lamps.get(i).amplitude));
        // A ray without a hit has a zero normal, and gets no light.
        let cosine = axis.dot(point.normal.into()).max(0.0);
        let mirrored = axis.dot(-Vec3::from(point.to_viewer).reflect(point.normal.into())).max(1e-6);
        let power = cosine * mirrored.powf(roughness.powi(-2));
        let slope = -2.0 * power * mirrored.ln() / roughness.powi(3);
        [sums[0] + FRAC_1_PI * cosine * light, sums[1] + power * light, sums[2] + slope * light]
    };
    let all = |point| (0..lamps.len()).fold([Vec3::ZERO; 3], |sums, i| add_lamp(point, sums, i));
    points.iter().map(all).collect()
}

type Inputs<'w> = (Res<'w, IncidentLight>, Res<'w, BaseMaterials>);

fn shade((light, materials): Inputs, samples: Samples<(&ShadePoint, &mut Layers)>) -> SystemResult {
    let ((points, mut shaded), lobe) = (samples.columns()?, materials.lobes[0].1);
    let light = phong(&points, &light.lobes, lobe.roughness);
    for (i, [diffuse, specular, _]) in light.into_iter().enumerate() {
        let diffuse = (diffuse * Vec3::from(points[i].albedo)).into();
        shaded[i] = Layers { diffuse, specular: (specular * lobe.albedo).into() };
    }
    Ok(())
}

fn pull_back(
    (light, materials): Inputs,
    samples: Samples<(&ShadePoint, &RadianceAdjoint, &mut PointAdjoint)>,
    mut gradient: ResMut<StepGradient>,
) -> SystemResult {
    let ((points, adjoint, mut back), lobe) = (samples.columns()?, materials.lobes[0].1);
    let light = phong(&points, &light.lobes, lobe.roughness);
    let (mut albedo, mut roughness) = (Vec3::ZERO, 0.0);
    for (i, [diffuse, specular, slope]) in light.into_iter().enumerate() {
        let adjoint = Vec3::from(adjoint[i].0);
        back[i].albedo = (diffuse * adjoint).into();
        albedo += specular * adjoint;
        roughness += (slope * lobe.albedo).dot(adjoint);
    }
    gradient.specular = vec![SpecularAdjoint { albedo: albedo.into(), roughness }];
    Ok(())
}

/// A sphere that is photographed and then fitted from another albedo and lobe on.
pub fn fitted(truth: (Vec3, SpecularLobe), start: (Vec3, SpecularLobe)) -> Result<Pipeline> {
    let mut pipeline = Pipeline::new();
    pipeline.add_plugin(&FramePlugin).add_plugin(&FitPlugin);
    pipeline.set_shader(Phase::Frame, Shader::new(shade));
    pipeline.set_shader(Phase::FitStep, Shader::new(shade).with_adjoint(pull_back));
    let surface = Arc::new(Surface::new(sphere_mesh(Vec3::ZERO, 0.8)?, 16)?);
    let texels = surface.atlas().position.len();
    spawn_object(&mut pipeline.world, &surface, &vec![truth.0; texels], &[truth.1], &LightLobe::even(12));
    for camera in Camera::around(8, 2.8, 38.0, 32)? {
        let pixels = resolve(&render_frame(&mut pipeline, camera, 1)?).color;
        let photograph = Some(Photograph::of_image(&Image { width: 32, height: 32, pixels }));
        let view = ViewRecord::of_camera(String::new(), Split::Train, camera);
        spawn_views(&mut pipeline.world, vec![ViewRecord { photograph, ..view }]);
    }
    write_column::<TexelIndex, _>(&mut pipeline.world, &vec![Diffuse::of_albedo(start.0); texels])?;
    let mut lobes = pipeline.world.query::<&mut SpecularLobe>();
    lobes.iter_mut(&mut pipeline.world).for_each(|mut lobe| *lobe = start.1);
    let unknowns = Unknowns { light: false, ..Unknowns::default() };
    let options = FitOptions { unknowns, initialize: Initialize::NONE, ..FitOptions::default() };
    run_fit(&mut pipeline, &options, &mut |_, _| ControlFlow::Continue(()))?;
    Ok(pipeline)
}

fn main() -> Result<()> {
    let truth = (Vec3::new(0.6, 0.3, 0.1), SpecularLobe::new(Vec3::splat(0.3), 0.3));
    let start = (Vec3::splat(0.4), SpecularLobe::new(Vec3::splat(0.15), 0.5));
    let mut world = fitted(truth, start)?.world;
    let found = world.query::<&SpecularLobe>().iter(&world).next();
    println!("found {found:?}; the truth is {:?}", truth.1);
    Ok(())
}
