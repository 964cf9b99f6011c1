//! Ways to shade: exchanged in one world with lights and back again, shadows in closed form against
//! the path tracer, and known values.

use crate::common::{camera, day, evening, join, object, shoot, studio};
use bevy_ecs::{schedule::ScheduleConfigs, system::ScheduleSystem};
use glam::Vec2;
use lobelia::{ecs::*, prelude::*};
use serde_json::{Map, Value, json};

#[path = "../examples/shade_cases.rs"]
#[allow(dead_code)]
mod example;

/// The path tracer; a pixel has four samples.
fn traced_shading() -> ScheduleConfigs<ScheduleSystem> {
    shade_path_traced(PathTracing { paths_per_sample: 32, max_bounces: 2, seed: 7, samples_per_pixel: 4 })
}

/// Mean color over the pixels that are wholly on the object, in the part of the picture that `part`
/// picks by column.
fn mean(frame: &Frame, part: impl Fn(usize) -> bool) -> Vec3 {
    let inside = |i: &usize| frame.alpha[*i] == 1.0 && part(*i % frame.width);
    let pixels: Vec<Vec3> = (0..frame.color.len()).filter(inside).map(|i| frame.color[i]).collect();
    assert!(pixels.len() > 20, "the object is in the picture");
    pixels.iter().sum::<Vec3>() / pixels.len() as f32
}

/// How bright its left half and its right half are.
fn halves(frame: &Frame) -> [f32; 2] {
    [true, false].map(|left| mean(frame, |x| (x < frame.width / 2) == left).element_sum())
}

#[test]
fn shading_and_light_are_swapped_in_one_world_and_back() {
    let front = camera([0.0, 0.1, 1.0], 20);
    let mut pipeline = studio(&day());
    let accurate = shoot(&mut pipeline, front);

    // A convex object has no shadow of its own and no interreflection: only the closed form's
    // approximations differ.
    pipeline.swap(Phase::Frame, Slot::Shading, traced_shading());
    let traced = shoot(&mut pipeline, front);
    assert_ne!(traced.color, accurate.color);
    let (a, b) = (mean(&accurate, |_| true), mean(&traced, |_| true));
    for channel in 0..3 {
        let ratio = a[channel] / b[channel];
        assert!((ratio - 1.0).abs() < 0.06, "channel {channel}: closed form {a}, traced {b}");
    }
    // What does not depend on the shading is the same, bit for bit.
    assert_eq!([&traced.albedo, &traced.normal], [&accurate.albedo, &accurate.normal]);
    assert_eq!([&traced.depth, &traced.alpha], [&accurate.depth, &accurate.alpha]);

    // The map has no lobes here: the path tracer samples it, closed forms see a black light.
    let left_sky = EnvironmentMap::from_directions(64, 32, |d| {
        Vec3::new(1.0, 0.8, 0.6) * (3.0 * (6.0 * (d.dot(Vec3::NEG_X) - 1.0)).exp() + 0.05)
    });
    spawn_light(&mut pipeline.world, "sky", &[], Some(Arc::new(MapLight::new(left_sky))));
    pipeline.swap(Phase::Compose, Slot::Light, provide_light(LightChoice::Named("sky".into()), true));
    let relit = shoot(&mut pipeline, front);
    let ([left, right], [relit_left, relit_right]) = (halves(&traced), halves(&relit));
    assert!(right > 1.2 * left, "by day: {left} {right}");
    assert!(relit_left > 1.2 * relit_right, "under the sky: {relit_left} {relit_right}");
    pipeline.swap(Phase::Frame, Slot::Shading, shade_closed_form(ClosedForm::default()));
    let dark = shoot(&mut pipeline, front);
    assert!(dark.color.iter().all(|c| *c == Vec3::ZERO));

    pipeline.swap(Phase::Compose, Slot::Light, provide_light(LightChoice::Own, false));
    let again = shoot(&mut pipeline, front);
    assert_eq!(again, accurate, "the first systems give the first picture");
    pipeline.swap(Phase::Frame, Slot::Shading, traced_shading());
    assert_eq!(shoot(&mut pipeline, front), traced, "and the path tracer its own");

    pipeline.swap(Phase::Frame, Slot::Shading, shade_closed_form(ClosedForm::Published));
    let published = shoot(&mut pipeline, front);
    assert_ne!(published.color, accurate.color, "the published formulas are another system in the same slot");
    assert_eq!(published.alpha, accurate.alpha);
}

#[test]
fn a_map_and_its_lobes_light_alike() {
    let front = camera([0.0, 0.1, 1.0], 16);
    let lobes = day();
    let mut pipeline = studio(&lobes);
    pipeline.swap(Phase::Frame, Slot::Shading, traced_shading());
    let by_lobes = shoot(&mut pipeline, front);
    let map = EnvironmentMap::from_directions(128, 64, |d| lobelia::light::lobes_radiance(&lobes, d));
    spawn_light(&mut pipeline.world, "day", &lobes, Some(Arc::new(MapLight::new(map))));
    let day = |by_map| provide_light(LightChoice::Named("day".into()), by_map);
    pipeline.swap(Phase::Compose, Slot::Light, day(true));
    let by_map = shoot(&mut pipeline, front);
    assert_ne!(by_lobes.color, by_map.color, "other samples are drawn");
    let (a, b) = (mean(&by_lobes, |_| true), mean(&by_map, |_| true));
    assert!((a / b - Vec3::ONE).abs().max_element() < 0.03, "lobes {a}, map {b}");
    pipeline.swap(Phase::Compose, Slot::Light, day(false));
    assert_eq!(shoot(&mut pipeline, front), by_lobes, "the same lobes under a name");
}

#[test]
fn a_light_that_is_not_there_is_one_clean_error() {
    let mut pipeline = studio(&day());
    spawn_light(&mut pipeline.world, "noon", &day(), None);
    pipeline.swap(Phase::Compose, Slot::Light, provide_light(LightChoice::Named("night".into()), false));
    let front = camera([0.0, 0.1, 1.0], 8);
    let error = render_frame(&mut pipeline, front, 1).map(|_| ()).unwrap_err();
    assert_eq!(error.exit_code(), 1);
    assert!(error.to_string().contains("night") && error.to_string().contains("noon"), "{error}");
    pipeline.swap(Phase::Compose, Slot::Light, provide_light(LightChoice::Own, false));
    assert_eq!(shoot(&mut pipeline, front), shoot(&mut studio(&day()), front));
}

// Shadows and reflections in closed form, against the path tracer that finds them ray by ray.

/// A ball that floats over a slab; each has half of the texture.
fn ball_over_slab() -> Mesh {
    let mut mesh = box_mesh(Vec3::new(0.0, -0.5, 0.0), Vec3::new(1.4, 0.2, 1.4)).unwrap();
    let ball = sphere_mesh(Vec3::new(0.0, 0.1, 0.0), 0.35).unwrap();
    join(&mut mesh, &ball);
    let [slab, ball] = [(mesh.uvs, 0.0), (ball.uvs, 0.5)].map(|(uvs, left)| -> Vec<Vec2> {
        uvs.unwrap().iter().map(|uv| Vec2::new(left + 0.5 * uv.x, uv.y)).collect()
    });
    mesh.uvs = Some([slab, ball].concat());
    mesh
}

fn psnr(a: &Frame, b: &Frame) -> f32 {
    let square: f32 = a.color.iter().zip(&b.color).map(|(a, b)| (*a - *b).length_squared()).sum();
    let peak = b.color.iter().map(|c| c.max_element()).fold(0.0, f32::max);
    10.0 * (peak * peak * 3.0 * a.color.len() as f32 / square).log10()
}

#[test]
fn shadows_and_reflections_come_close_to_path_tracing() {
    // What the last mirrors of itself is finer than the directions that are traced for all.
    for (albedo, roughness, least, gain) in
        [(0.04, 0.6, 34.0, 6.0), (0.3, 0.3, 32.0, 6.0), (0.8, 0.12, 36.0, 5.0)]
    {
        let specular = SpecularLobe::new(Vec3::splat(albedo), roughness);
        let color = |at: &Vec3| if at.y > -0.35 { Vec3::new(0.8, 0.3, 0.2) } else { Vec3::splat(0.6) };
        let (mut pipeline, surface) = object(ball_over_slab(), &evening(), 128, color, specular);
        let view = camera([0.6, 0.5, 0.8], 64);
        let plain = shoot(&mut pipeline, view);
        pipeline.world.insert_resource(ObjectVisibility::new(&surface, VisibilitySettings::default()));
        pipeline.swap(Phase::Frame, Slot::Visibility, see_shown());
        let shadowed = shoot(&mut pipeline, view);
        pipeline.clear(Phase::Frame, Slot::Visibility);
        assert_eq!(shoot(&mut pipeline, view), plain, "taken out again, nothing of it stays");
        let paths = PathTracing { paths_per_sample: 64, max_bounces: 4, seed: 1, samples_per_pixel: 4 };
        pipeline.swap(Phase::Frame, Slot::Shading, shade_path_traced(paths));
        let truth = shoot(&mut pipeline, view);
        let (without, with) = (psnr(&plain, &truth), psnr(&shadowed, &truth));
        println!("R {}: {without} dB without, {with} dB with", specular.roughness);
        assert!(with > least && with > without + gain, "{without} dB without, {with} dB with");
    }
}

// Known values: hemisphere integrals from elsewhere, and the published formulas in double
// precision.

/// Eight cases: rough and sharp, bright and in the far tails, light above and below the horizon,
/// viewers near it.
fn cases() -> Vec<Map<String, Value>> {
    serde_json::from_str(include_str!("data/sg_cases.json")).unwrap()
}

/// Expects found and known values of all cases to differ by no more than the tolerance of a known
/// value and a standard error.
#[track_caller]
fn agree(mode: &str, known: &str, tolerance: impl Fn(f64, f64) -> f64) {
    let mut cases = cases();
    example::shade(&mut cases, mode, 2048).unwrap();
    for (index, case) in cases.iter().enumerate() {
        for part in ["diffuse", "specular"] {
            let of = |field: String| -> [f64; 3] {
                case.get(&field).map_or([0.0; 3], |of| serde_json::from_value(of.clone()).unwrap())
            };
            let (found, known) = (of(part.to_owned()), of(format!("{known}_{part}")));
            let error = of(format!("{part}_stderr"));
            for c in 0..3 {
                let (off, known) = ((found[c] - known[c]).abs(), known[c]);
                let most = tolerance(known.abs(), error[c]);
                assert!(off <= most, "{mode}, case {index}, {part}: {off} from {known}");
            }
        }
    }
}

#[test]
fn closed_forms_and_the_path_tracer_agree_with_known_values() {
    agree("published", "approx", |known, _| 1e-3 * known + 1e-6);
    agree("accurate", "exact", |known, _| 5e-2 * known + 1e-4);
    agree("accurate-high", "exact", |known, _| 5e-2 * known + 1e-4);
    // Values that are too small for single precision are zero. The known integrals are good to 1 %
    // or so.
    agree("path-traced", "exact", |known, error| 4.0 * error + 0.02 * known + 1e-8);
}

#[test]
fn fields_are_carried_over_and_a_written_table_can_be_read_again() {
    let mut once = cases();
    once[1].insert("note".into(), json!({"zebra": 1}));
    example::shade(&mut once, "published", 0).unwrap();
    assert_eq!(once[1]["note"], json!({"zebra": 1}));
    assert_eq!(once[1]["specular_albedo"], cases()[1]["specular"]);
    let mut twice = once.clone();
    example::shade(&mut twice, "published", 0).unwrap();
    assert_eq!(once, twice);
}
